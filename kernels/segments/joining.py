"""Segmentation: blocks that agree are joined by fours, and those by fours again."""

import math

import numpy as np

from .._jit import kernel
from .blocks import EMPTY, UNSEEN
from .noise import sensor_variances


@kernel(inline=True)
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
        For each block: see `noise.sensor_variance`.
    state : (T,) int8, written
        0 not planar, 1 planar, 2 too few pixels to say.
    """
    moments, rss, slope_square, offsets, shapes = pyramid
    lateral_variance = noise.lateral_variance
    # One-dimensional: see `kernels`.
    pixels, sum_q = moments[0], moments[3]
    variance = np.empty(len(rss))
    sensor_variances(pixels, sum_q, noise.sigma, variance)
    blocks = shapes[0, 0] * shapes[0, 1]
    rough, steep = rules.rough_block**2, rules.steep_block**2 * lateral_variance
    for i in range(blocks):
        n = pixels[i]
        sensor[i] = variance[i]
        planar = 1 if rss[i] <= (n - 3.0) * (rough * variance[i] + steep * slope_square[i]) else 0
        state[i] = 2 if (n < 6.0) | (rss[i] < 0.0) else planar
    for i in range(len(variance)):
        variance[i] += lateral_variance * slope_square[i]
    floor, spread = rules.square_floor**2, rules.square_spread
    for level in range(1, shapes.shape[0]):
        rows, columns = shapes[level, 0], shapes[level, 1]
        for row in range(rows):
            first = offsets[level - 1] + 4 * row * columns
            for column in range(columns):
                parent = offsets[level] + row * columns + column
                planar = rough_ones = 0
                total, smallest = 0.0, math.inf
                for k in range(4):
                    child = first + 2 * column + (k & 1) + (2 * columns if k > 1 else 0)
                    is_planar = state[child] == 1
                    rough_ones += state[child] == 0
                    planar += is_planar
                    total += rss[child] if is_planar else 0.0
                    smallest = min(smallest, variance[child] if is_planar else math.inf)
                allowed = smallest * (floor * pixels[parent] + spread)
                one = (planar > 0) & (rss[parent] >= 0.0) & (rss[parent] - total <= allowed)
                unknown = 2 if planar == 0 else np.int64(one)
                state[parent] = 0 if rough_ones > 0 else unknown


@kernel()
def leaves(pyramid, state, region, owner, region_moments):
    """Number the largest planar node over each planar block, in the order of their first blocks.

    ``region`` is (R, C) int32, written: the node's number, -1 where the block is not planar or has too few
    pixels; ``owner`` (R, C) int32 is written: EMPTY or UNSEEN; ``region_moments`` (R·C, 10) is written. Returns the
    number of nodes.
    """
    moments, _, _, offsets, shapes = pyramid
    pixels, top = moments[0], shapes.shape[0] - 1
    # Of each square: the largest planar one that it is in, or -1. Not all squares of a planar one need be planar: some
    # have too few pixels.
    largest = np.empty(len(state), np.int32)
    for i in range(offsets[top], offsets[top + 1]):
        largest[i] = i if state[i] == 1 else -1
    for level in range(top - 1, 0, -1):
        for row in range(shapes[level, 0]):
            first = offsets[level] + row * shapes[level, 1]
            above = largest[offsets[level + 1] + (row >> 1) * shapes[level + 1, 1] :]
            for column in range(shapes[level, 1]):
                i = first + column
                own = i if state[i] == 1 else -1
                largest[i] = above[column >> 1] if above[column >> 1] >= 0 else own
    number = np.full(len(state), np.int32(-1))
    rows, columns = region.shape
    count = 0
    for row in range(rows):
        above = largest[offsets[1] + (row >> 1) * shapes[1, 1] :]
        line, owners = region[row], owner[row]
        for column in range(columns):
            block = row * columns + column
            owners[column] = EMPTY if pixels[block] == 0.0 else UNSEEN
            if state[block] != 1:
                line[column] = -1
                continue
            # Unsigned: see `kernels`.
            i = np.uint64(above[column >> 1] if above[column >> 1] >= 0 else block)
            if number[i] < 0:
                number[i] = count
                for k in range(10):
                    region_moments[count, k] = moments[k, i]
                count += 1
            line[column] = number[i]
    return count
