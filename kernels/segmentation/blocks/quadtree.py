"""Segmentation: blocks that agree are joined by fours, and those by fours again."""

import math

import numpy as np

from ..._jit.kernel import kernel
from ..model.pixel_noise import sensor_variances
from ..model.records import EMPTY, UNSEEN, as_view


@kernel()
def join_blocks(view, region, owner, region_moments):
    """Build the quadtree, and number the largest planar square over each planar block.

    Parameters
    ----------
    view : View
        ``sensor`` is written.
    region, owner, region_moments
        Written, as `leaves` does.

    Returns
    -------
    int
        Number of regions.
    """
    view = as_view(view)
    pyramid = view.pyramid
    state = np.empty(len(pyramid.rss), np.int8)
    find_planar(pyramid, view.noise, view.rules, view.sensor, state)
    return leaves(pyramid, state, region, owner, region_moments)


@kernel()
def find_planar(pyramid, noise, rules, sensor, state):
    """Find which blocks are planar, and which four planar neighbours are one plane.

    Parameters
    ----------
    pyramid : Pyramid
    noise : Noise
    rules : Rules
        A block is planar if its residual is below ``fit_deviations`` of the sensor's noise, and ``steep_share`` of what
        its slope adds: a block across a depth jump looks steep, too. Four are one plane if joining them adds at most
        ``tolerance``² variances per pixel, plus ``joint_variances``.
    sensor : (R·C,) float64, written
        Variance of an inverse depth in each block.
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
    rough, steep = rules.fit_deviations**2, rules.steep_share**2 * lateral_variance
    for i in range(blocks):
        n = pixels[i]
        sensor[i] = variance[i]
        planar = 1 if rss[i] <= (n - 3.0) * (rough * variance[i] + steep * slope_square[i]) else 0
        state[i] = 2 if (n < 6.0) | (rss[i] < 0.0) else planar
    for i in range(len(variance)):
        variance[i] += lateral_variance * slope_square[i]
    floor, spread = rules.tolerance**2, rules.joint_variances
    for level in range(1, shapes.shape[0]):
        columns = shapes[level, 1]
        for row in range(shapes[level, 0]):
            here = offsets[level] + row * columns
            upper = offsets[level - 1] + 4 * row * columns
            lower, end = upper + 2 * columns, upper + 4 * columns
            join_squares(
                state[upper:lower], state[lower:end], rss[upper:lower], rss[lower:end], variance[upper:lower],
                variance[lower:end], pixels[here : here + columns], rss[here : here + columns], floor, spread,
                state[here : here + columns],
            )  # fmt: skip


@kernel(inline="compiled")
def join_squares(
    upper_state, lower_state, upper_rss, lower_rss, upper_variance, lower_variance, pixels, rss, floor, spread, state
):  # fmt: skip
    """Write the ``state`` of a row of squares from those of the two rows of squares that they are made of."""
    for c in range(len(state)):
        k = 2 * c
        one, two, three, four = upper_state[k], upper_state[k + 1], lower_state[k], lower_state[k + 1]
        rss_1, rss_2, rss_3, rss_4 = upper_rss[k], upper_rss[k + 1], lower_rss[k], lower_rss[k + 1]
        variance_1, variance_2, variance_3, variance_4 = (
            upper_variance[k],
            upper_variance[k + 1],
            lower_variance[k],
            lower_variance[k + 1],
        )
        total = (
            (rss_1 if one == 1 else 0.0) + (rss_2 if two == 1 else 0.0)
            + (rss_3 if three == 1 else 0.0) + (rss_4 if four == 1 else 0.0)
        )  # fmt: skip
        smallest = min(
            min(variance_1 if one == 1 else math.inf, variance_2 if two == 1 else math.inf),
            min(variance_3 if three == 1 else math.inf, variance_4 if four == 1 else math.inf),
        )
        planar = (one == 1) | (two == 1) | (three == 1) | (four == 1)
        rough = (one == 0) | (two == 0) | (three == 0) | (four == 0)
        joined = (rss[c] >= 0.0) & (rss[c] - total <= smallest * (floor * pixels[c] + spread))
        state[c] = 0 if rough else 2 if not planar else 1 if joined else 0


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
                leaf = i if state[i] == 1 else -1
                largest[i] = above[column >> 1] if above[column >> 1] >= 0 else leaf
    number = np.full(len(state), np.int32(-1))
    rows, columns = region.shape
    count = 0
    for row in range(rows):
        above = largest[offsets[1] + (row >> 1) * shapes[1, 1] :]
        line, owners, row_pixels = region[row], owner[row], pixels[row * columns : (row + 1) * columns]
        for column in range(columns):
            owners[column] = EMPTY if row_pixels[column] == 0.0 else UNSEEN
        for column in range(columns):
            block = row * columns + column
            if state[block] != 1:
                line[column] = -1
                continue
            i = above[column >> 1] if above[column >> 1] >= 0 else block
            if number[i] < 0:
                number[i] = count
                for k in range(10):
                    region_moments[count, k] = moments[k, i]
                count += 1
            line[column] = number[i]
    return count
