"""Segmentation: the noise of a pixel about its plane."""

import math

from ._jit import kernel


@kernel(inline=True)
def sensor_variance(q, sigma):
    """Variance of an inverse depth.

    ``sigma`` holds the step of a table and then the standard deviation at q = 0, step, 2 step, ...; between
    the entries it is linear, beyond the last it is the last.
    """
    position = min(q / sigma[0], sigma.shape[0] - 2.0)
    i = min(int(position), sigma.shape[0] - 3)
    share = position - i
    value = sigma[i + 1] * (1.0 - share) + sigma[i + 2] * share
    return value * value


@kernel()
def waviness(pixels, growth):
    """How much larger noise is over a region of so many pixels than over 8x8: correlated noise grows.

    ``growth`` holds the ratio for squares of 8, 16, 32, ... pixels; in between it follows log2 of the side.
    """
    if pixels <= 64.0:
        return growth[0]
    if pixels >= 64.0 * 4.0 ** (len(growth) - 1):
        return growth[-1]
    position = 0.5 * math.log2(pixels) - 3.0
    i = min(int(position), len(growth) - 2)
    share = position - i
    return growth[i] * (1.0 - share) + growth[i + 1] * share


@kernel(inline=True)
def slope_variance(alpha, noise):
    """What a plane's slope adds to the variance of its pixels.

    A pixel sees its surface somewhere within itself; where the inverse depth changes across a pixel, that
    is noise too.
    """
    return noise.lateral_variance_x * alpha[0] * alpha[0] + noise.lateral_variance_y * alpha[1] * alpha[1]


@kernel(inline=True)
def variance(m, alpha, noise):
    """Variance of one pixel about its plane: the sensor's at the mean inverse depth, and the slope's."""
    return sensor_variance(m[3] / m[0], noise.sigma) + slope_variance(alpha, noise)


@kernel(inline=True)
def about_plane(sensor, planes, a):
    """Variance of a pixel about the plane of region ``a``: the sensor's and the slope's, grown with the region."""
    return (sensor + planes.slope_variance[a]) * planes.waviness_square[a]
