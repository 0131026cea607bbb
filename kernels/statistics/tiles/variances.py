"""The variance of the pixels of each tile of a block, by the noise model at their depths."""

import math

import numpy as np

from ..._jit.kernel import kernel
from ..noise_variances import DEPTH_STEP, DISPARITY_STEP, LATERAL_X, LATERAL_Y, SCALE, VARIANCES, entries_in, means_over
from .block import (
    BEND,
    ERROR,
    FOUND,
    INDEPENDENT,
    LATERAL,
    LENS_ROWS,
    MEAN_Q,
    N_X,
    N_Y,
    N_Z,
    PER_PIXEL,
    POSITION,
    POWER,
    ROUNDING,
    SHARED,
    SPREAD,
    STEP,
    TILES_AT_ONCE,
    UNEVENNESS,
    W_0,
    WEIGHTED,
    D,
)

# The mean over a tile of the variance of q along the ray is its series to second order, by the table's differences
# and its bends. Where the table is steeper than a power STEEPEST of q it jumps; bends end at that power's. Where
# depths differ a hundredfold the series may be below 0: at most LARGEST_LOSS is taken off. Where the variance of this
# variance, relative to its squared mean, is more than MOST_EVEN, or that of q so large that the series might be off
# by what a chi-square of the tile's pixels shows (about 1/√n), means come from `noise_variances.means_over` instead.
# Not where the squared residual is HOPELESS times what errors explain in the middle: such a tile crosses an edge, and
# is no plane by any mean.
STEEPEST = 8.0
LARGEST_LOSS = 0.5
BENT_SQUARE = 0.2  # the variance of half the square of what is spread evenly, over the square of its own variance
MOST_EVEN = 0.02
HOPELESS = 64.0


@kernel(inline=True)
def mean_inverse_depth(in_range_space, block):
    """Mean inverse depth of each tile of a block, and one over its number of pixels."""
    for i in range(TILES_AT_ONCE):
        per_pixel = 1.0 / block[0, i]
        block[PER_PIXEL, i] = per_pixel
        block[MEAN_Q, i] = block[W_0, i] + block[3, i] * per_pixel
    if not in_range_space:
        for i in range(TILES_AT_ONCE):
            block[MEAN_Q, i] = 1.0 / block[MEAN_Q, i]


@kernel(inline=True)
def pixel_variance(noise, count, block):
    """Variances of errors along the ray and of rounding, of the pixels of each tile of a block, and how uneven."""
    depth, disparity = noise[DEPTH_STEP], noise[DISPARITY_STEP]
    is_constant = noise.shape[0] == VARIANCES + 1
    if depth > 0.0 or not is_constant:
        for i in range(TILES_AT_ONCE):
            mean_w = block[3, i] * block[PER_PIXEL, i]
            # Of q or, from the moments of (X, Y, Z), of Z: to first order the same share of the mean.
            spread = block[9, i] * block[PER_PIXEL, i] - mean_w * mean_w
            w = block[W_0, i] + mean_w
            block[SPREAD, i] = spread / (w * w)
    if is_constant:
        for i in range(TILES_AT_ONCE):
            block[SHARED, i] = noise[VARIANCES]
            block[UNEVENNESS, i] = 0.0
            block[POWER, i] = 0.0
    else:
        entries = entries_in(noise)
        scale, last = noise[SCALE], entries - 2.0
        for i in range(TILES_AT_ONCE):
            position = block[MEAN_Q, i] * scale
            inside = position if position > 0.0 else 0.0  # also for NaN
            inside = inside if inside < last else last
            block[SHARED, i] = np.floor(inside)
            block[POSITION, i] = position
        for i in range(count):
            k = VARIANCES + np.int64(block[SHARED, i])
            found = noise[k]
            block[FOUND, i], block[STEP, i] = found, noise[k + 1] - found
            block[BEND, i] = noise[k + entries]
        for i in range(TILES_AT_ONCE):
            variance, step = block[FOUND, i], block[STEP, i]
            position = block[POSITION, i]
            variance += (position - block[SHARED, i]) * step
            power = min(max(position * step / max(variance, 1e-300), -STEEPEST), STEEPEST)
            bend, spread = block[BEND, i], block[SPREAD, i]
            block[SHARED, i] = variance * (1.0 + max(0.5 * bend * spread, -LARGEST_LOSS))
            bend_square = BENT_SQUARE * bend * bend
            block[UNEVENNESS, i] = spread * max(power * power + bend_square * spread, MOST_EVEN * block[0, i] * spread)
            block[POWER, i] = power
    if depth > 0.0:
        for i in range(TILES_AT_ONCE):
            square = block[MEAN_Q, i] * block[MEAN_Q, i]
            rounding = depth * square * square
            power = 4.0 * rounding / (block[SHARED, i] + rounding + disparity)
            spread = block[SPREAD, i]
            unevenness = spread * max(power * power, MOST_EVEN * block[0, i] * spread)
            block[UNEVENNESS, i] = max(block[UNEVENNESS, i], unevenness)
            block[ROUNDING, i] = rounding + disparity
    else:
        for i in range(TILES_AT_ONCE):
            block[ROUNDING, i] = disparity


@kernel(reduction=True, inline=True)
def find_uneven(block):
    """Whether a tile of the block may differ too much in its variance; for those that do not, no UNEVENNESS."""
    number = 0.0
    for i in range(TILES_AT_ONCE):
        d, misfit = block[D, i], block[ERROR, i] * block[MEAN_Q, i]
        explained = (block[SHARED, i] + block[INDEPENDENT, i]) * d * d
        is_uneven = block[UNEVENNESS, i] > MOST_EVEN and d > 0.0 and misfit * misfit < HOPELESS * explained
        block[UNEVENNESS, i] = block[UNEVENNESS, i] if is_uneven else 0.0
        number += 1.0 if is_uneven else 0.0
    return number > 0.0


@kernel(inline=True)
def uneven_variance(noise, count, block):
    """Means of variances over tiles over which these differ much, in the rows that `pixel_variance` writes."""
    for i in range(count):
        if not block[UNEVENNESS, i] > 0.0:
            continue
        nearness, per_pixel = -1.0 / block[D, i], block[PER_PIXEL, i]
        plane = nearness * block[N_X, i], nearness * block[N_Y, i], nearness * block[N_Z, i]
        uu, uv, vv = block[4, i] * per_pixel, block[5, i] * per_pixel, block[7, i] * per_pixel
        means = means_over(plane, (block[1, i], block[2, i], uu, uv, vv), noise)
        total = means[0] + means[1]
        block[SHARED, i] = means[0]
        block[ROUNDING, i] = means[1]
        block[UNEVENNESS, i] = math.sqrt(means[2]) / total
        for k in range(5):
            block[WEIGHTED + k, i] = means[3 + k] / total


@kernel(inline=True)
def independent_variance(pixel_terms, noise, block):
    """Variance of the errors that are independent: rounding, and what errors across the ray make of q."""
    x, y = noise[LATERAL_X], noise[LATERAL_Y]
    if pixel_terms.shape[0] >= LENS_ROWS:
        for i in range(TILES_AT_ONCE):
            n_x, n_y, d = block[N_X, i], block[N_Y, i], block[D, i]
            xx, xy, yy = block[LATERAL, i], block[LATERAL + 1, i], block[LATERAL + 2, i]
            lateral = (xx * n_x * n_x + 2.0 * xy * n_x * n_y + yy * n_y * n_y) / (d * d)
            block[INDEPENDENT, i] = block[ROUNDING, i] + lateral
    elif x > 0.0:
        for i in range(TILES_AT_ONCE):
            n_x, n_y, d = block[N_X, i], block[N_Y, i], block[D, i]
            block[INDEPENDENT, i] = block[ROUNDING, i] + (x * n_x * n_x + y * n_y * n_y) / (d * d)
    else:
        for i in range(TILES_AT_ONCE):
            block[INDEPENDENT, i] = block[ROUNDING, i]
