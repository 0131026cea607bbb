"""Segmentation: the noise of a pixel about its plane."""

import math

import numpy as np

from ..._jit.kernel import kernel


@kernel(inline="compiled")
def sensor_variance(q, sigma):
    """Variance of an inverse depth.

    ``sigma`` holds the step of a table and then the standard deviation at q = 0, step, 2 step, ...; it is linear
    between the entries and constant beyond the last. Rounding may have made ``q`` negative, or NaN: it counts as 0.
    """
    position = q / sigma[0]
    position = min(position, sigma.shape[0] - 2.0) if position > 0.0 else 0.0
    i = min(int(position), sigma.shape[0] - 3)
    share = position - i
    value = sigma[i + 1] * (1.0 - share) + sigma[i + 2] * share
    return value * value


@kernel(inline="compiled")
def expected_variance(q, sigma):
    """Variance of an inverse depth by `sensor_variance`; 1 where ``sigma`` is empty, that is unknown."""
    return sensor_variance(q, sigma) if len(sigma) > 0 else 1.0


@kernel(inline="compiled")
def step_at(q, step_of_raw, scale, is_disparity):
    """Step between neighbouring raw values, as a difference of inverse depth; 0 where there is none."""
    return step_of_raw * (abs(scale) if is_disparity else q * q / scale)


@kernel()
def sensor_variances(pixels, sum_q, sigma, variance):
    """Write `sensor_variance` at the mean inverse depth of squares, from ``pixels`` and ``sum_q``, (T,) each."""
    last, scale = sigma.shape[0] - 2.0, 1.0 / sigma[0]
    for i in range(len(variance)):  # by itself, since divisions vectorise
        position = min(sum_q[i] / max(pixels[i], 1.0) * scale, last)
        variance[i] = position if position > 0.0 else 0.0
    lower, upper, most = sigma[1:], sigma[2:], np.int32(sigma.shape[0] - 3)
    for i in range(len(variance)):
        position = variance[i]
        k = min(np.int32(position), most)
        share = position - k
        value = lower[k] * (1.0 - share) + upper[k] * share
        variance[i] = value * value


@kernel(inline="compiled")
def waviness(pixels, growth):
    """By what factor noise is larger over a region of ``pixels`` than over 8x8: correlated noise grows.

    ``growth`` holds the ratio for squares of 8, 16, 32, ... pixels; in between it follows log2 of the side.
    """
    position = min(max(0.5 * math.log2(pixels) - 3.0, 0.0), len(growth) - 1.0) if pixels > 64.0 else 0.0
    i = min(int(position), len(growth) - 2)
    share = position - i
    return growth[i] * (1.0 - share) + growth[i + 1] * share


@kernel(inline="compiled")
def at_angle(square, lens):
    """Squared factor by which a lens stretches a pixel across the radius, and how much more, in ρ², along it.

    ``square`` is ρ², tan² of the angle off the axis; ``lens`` (2, K) tabulates both by ρ / (1 + ρ), from 0 to 1.
    """
    radius = math.sqrt(square)
    position = radius / (1.0 + radius) * (lens.shape[1] - 1.0)
    k = min(int(position), lens.shape[1] - 2)
    part = position - k
    across = lens[0, k] + part * (lens[0, k + 1] - lens[0, k])
    along = lens[1, k] + part * (lens[1, k + 1] - lens[1, k])
    return across, along


@kernel(inline="compiled")
def through_lens(a, b, x, y, lens, n, s_uu, s_uv, s_vv):
    """Variance x·a² + y·b² that slopes a and b make, over n pixels seen through a lens."""
    per_pixel = 1.0 / max(n, 1.0)
    across, along = at_angle((s_uu + s_vv) * per_pixel, lens)
    radial = (a * a * s_uu + 2.0 * a * b * s_uv + b * b * s_vv) * per_pixel
    return across * (x * a * a + y * b * b) + along * math.sqrt(x * y) * radial


@kernel(inline="compiled")
def stretch_at(square, lens):
    """Squared factor by which a lens stretches a pixel, the mean across and along the radius."""
    across, along = at_angle(square, lens)
    return across + 0.5 * along * square


@kernel(inline="compiled")
def region_stretch(m, lens):
    """`stretch_at` for pixels of moments ``m``; 1 without a lens."""
    stretch = 1.0
    if lens.shape[1] > 0:
        stretch = stretch_at((m[4] + m[7]) / max(m[0], 1.0), lens)
    return stretch


@kernel()
def stretches(u, v, lens, stretch):
    """Write `stretch_at` for pixels that look at (u, v), (R, C) float64 each, to ``stretch`` (R, C)."""
    for row in range(u.shape[0]):
        for column in range(u.shape[1]):
            stretch[row, column] = stretch_at(u[row, column] ** 2 + v[row, column] ** 2, lens)


@kernel(inline="compiled")
def slope_variance(m, alpha, noise):
    """What a plane's slope adds to the variance of its pixels, whose moments are ``m``.

    A pixel sees its surface somewhere within itself; where the inverse depth changes across a pixel, that
    is noise too.
    """
    a, b, x, y = alpha[0], alpha[1], noise.lateral_variance_x, noise.lateral_variance_y
    added = x * a * a + y * b * b
    if noise.lens.shape[1] > 0:
        added = through_lens(a, b, x, y, noise.lens, m[0], m[4], m[5], m[7])
    return added


@kernel(inline="compiled")
def variance(m, alpha, noise):
    """Variance of one pixel about its plane: the sensor's at the mean inverse depth, and the slope's."""
    return sensor_variance(m[3] / m[0], noise.sigma) + slope_variance(m, alpha, noise)


@kernel(inline="compiled")
def grown_variance(sensor, slope, stretch, waviness_square):
    """Variance of a pixel about a plane: the sensor's and the slope's, grown with the region."""
    return (sensor + slope * stretch) * waviness_square


@kernel(inline="compiled")
def in_square(sensor, planes, a, i):
    """Variance of a pixel about the plane of region ``a``: the sensor's and the slope's, grown with the region.

    The pixel is in square ``i`` of a pyramid, or in a block.
    """
    return grown_variance(sensor, planes.slope_variance[a], planes.square_stretch[i], planes.waviness_square[a])


@kernel(inline="compiled")
def about_plane(sensor, planes, a):
    """Variance as of `in_square`, for a pixel anywhere in the region."""
    return grown_variance(sensor, planes.slope_variance[a], planes.stretch[a], planes.waviness_square[a])
