"""Segmentation: blocks that agree are joined by fours, and those by fours again."""

import math

import numpy as np

from ._jit import kernel
from .copying import copy
from .segment_blocks import EMPTY, UNSEEN
from .segment_noise import sensor_variance


@kernel()
def join_blocks(pyramid, noise, rules, sensor, state):
    """Build the quadtree: which blocks are planar, and which four planar neighbours are one plane.

    Parameters
    ----------
    pyramid : Pyramid
    noise : Noise
    rules : Rules
        A block is planar if its residual is below ``rough_block`` standard deviations, the slope's part of
        which counts ``steep_block`` times (a block across a depth jump looks steep, too). Four are one plane if
        joining them adds at most ``square_floor``² variances per pixel, plus ``square_spread``.
    sensor : (R·C,) float64, written
        Of each block: see `segment_noise.sensor_variance`.
    state : (T,) int8, written
        0 not planar, 1 planar, 2 too few pixels to say.
    """
    moments, rss, slope_square, offsets, shapes = pyramid
    sigma, lateral_variance = noise.sigma, noise.lateral_variance
    for i in range(shapes[0, 0] * shapes[0, 1]):
        n = moments[0, i]
        sensor[i] = sensor_variance(moments[3, i] / max(n, 1.0), sigma)
        allowed = rules.rough_block**2 * sensor[i] + rules.steep_block**2 * lateral_variance * slope_square[i]
        planar = 1 if rss[i] <= (n - 3.0) * allowed else 0
        state[i] = 2 if (n < 6.0) | (rss[i] < 0.0) else planar
    for level in range(1, shapes.shape[0]):
        rows, columns = shapes[level, 0], shapes[level, 1]
        finer = shapes[level - 1, 1]
        for row in range(rows):
            for column in range(columns):
                parent = offsets[level] + row * columns + column
                planar = 0
                total = 0.0
                smallest = math.inf
                for r in range(2 * row, 2 * row + 2):
                    for c in range(2 * column, 2 * column + 2):
                        child = offsets[level - 1] + r * finer + c
                        if state[child] == 0:
                            planar = -9  # below 0 whatever the other three are
                        if state[child] != 1:
                            continue
                        planar += 1
                        total += rss[child]
                        mean_q = moments[3, child] / moments[0, child]
                        variance = sensor_variance(mean_q, sigma) + lateral_variance * slope_square[child]
                        smallest = min(smallest, variance)
                if planar <= 0:
                    state[parent] = 2 if planar == 0 else 0
                    continue
                rise = rss[parent] - total
                allowed = smallest * (rules.square_floor**2 * moments[0, parent] + rules.square_spread)
                state[parent] = 1 if rss[parent] >= 0.0 and rise <= allowed else 0


@kernel()
def leaves(pyramid, state, region, owner, region_moments):
    """Number the largest planar node over each planar block, in the order of their first blocks.

    ``region`` is (R, C) int32, written: the node's number, -1 where the block is not planar or has too few
    pixels; ``owner`` (R, C) int32 is written: EMPTY or UNSEEN; ``region_moments`` (R·C, 10) is written.
    Returns how many there are.
    """
    moments, _, _, offsets, shapes = pyramid
    levels = shapes.shape[0]
    number = np.full(len(state), -1, np.int64)
    count = 0
    for row in range(shapes[0, 0]):
        for column in range(shapes[0, 1]):
            region[row, column] = -1
            owner[row, column] = EMPTY if moments[0, row * shapes[0, 1] + column] == 0.0 else UNSEEN
            if state[row * shapes[0, 1] + column] != 1:
                continue
            for level in range(levels - 1, -1, -1):
                i = offsets[level] + (row >> level) * shapes[level, 1] + (column >> level)
                if state[i] == 1:
                    if number[i] < 0:
                        number[i] = count
                        copy(moments[:, i], region_moments[count])
                        count += 1
                    region[row, column] = number[i]
                    break
    return count
