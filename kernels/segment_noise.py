"""Segmentation: the noise of a pixel about its plane, and what a frame's squares tell of it."""

import math

import numpy as np

from ._jit import kernel
from .segment_moments import fit


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
def variance(m, alpha, sigma, lateral_x, lateral_y):
    """Variance of one pixel about its plane: the sensor's at the mean inverse depth, and the slope's.

    A pixel sees its surface somewhere within itself; where the inverse depth changes across a pixel, that
    is noise too (the paper's σX, σY). ``lateral_x`` and ``lateral_y`` are the variances of tanθx, tanθy.
    """
    return (
        sensor_variance(m[3] / m[0], sigma)
        + lateral_x * alpha[0] * alpha[0]
        + lateral_y * alpha[1] * alpha[1]
    )


@kernel()
def square_residuals(moments, rss, slope, least, mean_square, slope_square):
    """Mean squared residual and squared slope of the squares with a plane and ``least`` valid pixels.

    Returns how many are written.
    """
    count = 0
    for i in range(len(rss)):
        if moments[0, i] < least or rss[i] < 0.0:
            continue
        mean_square[count] = rss[i] / (moments[0, i] - 3.0)
        slope_square[count] = slope[i]
        count += 1
    return count


@kernel()
def together(moments, offsets, shapes, rss, coarse, fine, least, most, ratio):
    """By how much more the means of small squares scatter about the plane of a large one than independent noise's.

    Where noise is independent the mean of n pixels has an n-th of their variance; where they go together it has
    more, by as many as go together. Of the squares of level ``coarse`` with at least ``least`` pixels and a mean
    squared residual of at most ``most``, by their parts of level ``fine``: ``ratio`` is written; returns how many.
    """
    side = 1 << (coarse - fine)
    alpha = np.empty(3)
    count = 0
    for row in range(shapes[coarse, 0]):
        for column in range(shapes[coarse, 1]):
            i = offsets[coarse] + row * shapes[coarse, 1] + column
            m = moments[:, i]
            if m[0] < least or rss[i] <= 0.0 or rss[i] > most * (m[0] - 3.0) or not fit(m, alpha):
                continue
            total = 0.0
            parts = -3.0  # the plane takes as many
            for r in range(row * side, row * side + side):
                for c in range(column * side, column * side + side):
                    k = moments[:, offsets[fine] + r * shapes[fine, 1] + c]
                    if k[0] > 0.0:
                        e = k[3] - (alpha[0] * k[1] + alpha[1] * k[2] + alpha[2] * k[0])
                        total += e * e / k[0]
                        parts += 1.0
            if parts > 0.0:
                ratio[count] = total / parts * (m[0] - 3.0) / rss[i]
                count += 1
    return count
