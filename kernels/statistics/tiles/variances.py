"""The variance of the pixels of each tile of a block, as the noise has it at their depths."""

import math

import numpy as np

from ..._jit.kernel import kernel
from ..noise_variances import DEPTH_STEP, DISPARITY_STEP, LATERAL_X, LATERAL_Y, SCALE, VARIANCES, entries_of, means_over
from .block import (
    BEND,
    ERROR,
    FOUND,
    INDEPENDENT,
    LATERAL,
    MEAN_Q,
    N_X,
    N_Y,
    N_Z,
    OF_LENS,
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
def mean_inverse_depth(in_range_space, room):
    """Mean inverse depth of each tile of a block, and one over its number of pixels."""
    for i in range(TILES_AT_ONCE):
        per_pixel = 1.0 / room[0, i]
        room[PER_PIXEL, i] = per_pixel
        room[MEAN_Q, i] = room[W_0, i] + room[3, i] * per_pixel
    if not in_range_space:
        for i in range(TILES_AT_ONCE):
            room[MEAN_Q, i] = 1.0 / room[MEAN_Q, i]


@kernel(inline=True)
def pixel_variance(noise, count, room):
    """Variances of errors along the ray and of rounding, of the pixels of each tile of a block, and how uneven."""
    depth, disparity = noise[DEPTH_STEP], noise[DISPARITY_STEP]
    is_constant = noise.shape[0] == VARIANCES + 1
    if depth > 0.0 or not is_constant:
        for i in range(TILES_AT_ONCE):
            mean_w = room[3, i] * room[PER_PIXEL, i]
            # Of q or, from the moments of (X, Y, Z), of Z: to first order the same share of the mean.
            spread = room[9, i] * room[PER_PIXEL, i] - mean_w * mean_w
            w = room[W_0, i] + mean_w
            room[SPREAD, i] = spread / (w * w)
    if is_constant:
        for i in range(TILES_AT_ONCE):
            room[SHARED, i] = noise[VARIANCES]
            room[UNEVENNESS, i] = 0.0
            room[POWER, i] = 0.0
    else:
        entries = entries_of(noise)
        scale, last = noise[SCALE], entries - 2.0
        for i in range(TILES_AT_ONCE):
            position = room[MEAN_Q, i] * scale
            inside = position if position > 0.0 else 0.0  # also for NaN
            inside = inside if inside < last else last
            room[SHARED, i] = np.floor(inside)
            room[POSITION, i] = position
        for i in range(count):
            k = VARIANCES + np.int64(room[SHARED, i])
            found = noise[k]
            room[FOUND, i], room[STEP, i] = found, noise[k + 1] - found
            room[BEND, i] = noise[k + entries]
        for i in range(TILES_AT_ONCE):
            variance, step = room[FOUND, i], room[STEP, i]
            position = room[POSITION, i]
            variance += (position - room[SHARED, i]) * step
            power = min(max(position * step / max(variance, 1e-300), -STEEPEST), STEEPEST)
            bend, spread = room[BEND, i], room[SPREAD, i]
            room[SHARED, i] = variance * (1.0 + max(0.5 * bend * spread, -LARGEST_LOSS))
            of_bend = BENT_SQUARE * bend * bend
            room[UNEVENNESS, i] = spread * max(power * power + of_bend * spread, MOST_EVEN * room[0, i] * spread)
            room[POWER, i] = power
    if depth > 0.0:
        for i in range(TILES_AT_ONCE):
            square = room[MEAN_Q, i] * room[MEAN_Q, i]
            rounding = depth * square * square
            power = 4.0 * rounding / (room[SHARED, i] + rounding + disparity)
            spread = room[SPREAD, i]
            unevenness = spread * max(power * power, MOST_EVEN * room[0, i] * spread)
            room[UNEVENNESS, i] = max(room[UNEVENNESS, i], unevenness)
            room[ROUNDING, i] = rounding + disparity
    else:
        for i in range(TILES_AT_ONCE):
            room[ROUNDING, i] = disparity


@kernel(reduction=True, inline=True)
def find_uneven(room):
    """Whether a tile of the block may differ too much in its variance; for those that do not, no UNEVENNESS."""
    number = 0.0
    for i in range(TILES_AT_ONCE):
        d, misfit = room[D, i], room[ERROR, i] * room[MEAN_Q, i]
        explained = (room[SHARED, i] + room[INDEPENDENT, i]) * d * d
        is_uneven = room[UNEVENNESS, i] > MOST_EVEN and d > 0.0 and misfit * misfit < HOPELESS * explained
        room[UNEVENNESS, i] = room[UNEVENNESS, i] if is_uneven else 0.0
        number += 1.0 if is_uneven else 0.0
    return number > 0.0


@kernel(inline=True)
def uneven_variance(noise, count, room):
    """As `pixel_variance`, for tiles that differ in it, in room as ``of_pixels`` of `assess` has it."""
    for i in range(count):
        if not room[UNEVENNESS, i] > 0.0:
            continue
        nearness, per_pixel = -1.0 / room[D, i], room[PER_PIXEL, i]
        plane = nearness * room[N_X, i], nearness * room[N_Y, i], nearness * room[N_Z, i]
        uu, uv, vv = room[4, i] * per_pixel, room[5, i] * per_pixel, room[7, i] * per_pixel
        means = means_over(plane, (room[1, i], room[2, i], uu, uv, vv), noise)
        total = means[0] + means[1]
        room[SHARED, i] = means[0]
        room[ROUNDING, i] = means[1]
        room[UNEVENNESS, i] = math.sqrt(means[2]) / total
        for k in range(5):
            room[WEIGHTED + k, i] = means[3 + k] / total


@kernel(inline=True)
def independent_variance(of_pixels, noise, room):
    """Variance of the errors that are independent: rounding, and what errors across the ray make of q."""
    x, y = noise[LATERAL_X], noise[LATERAL_Y]
    if of_pixels.shape[0] >= OF_LENS:
        for i in range(TILES_AT_ONCE):
            n_x, n_y, d = room[N_X, i], room[N_Y, i], room[D, i]
            xx, xy, yy = room[LATERAL, i], room[LATERAL + 1, i], room[LATERAL + 2, i]
            lateral = (xx * n_x * n_x + 2.0 * xy * n_x * n_y + yy * n_y * n_y) / (d * d)
            room[INDEPENDENT, i] = room[ROUNDING, i] + lateral
    elif x > 0.0:
        for i in range(TILES_AT_ONCE):
            n_x, n_y, d = room[N_X, i], room[N_Y, i], room[D, i]
            room[INDEPENDENT, i] = room[ROUNDING, i] + (x * n_x * n_x + y * n_y * n_y) / (d * d)
    else:
        for i in range(TILES_AT_ONCE):
            room[INDEPENDENT, i] = room[ROUNDING, i]
