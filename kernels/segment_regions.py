"""Segmentation, the rounds: from joined blocks to regions, from regions to the pixels they own, and back."""

import numpy as np

from ._jit import kernel
from .copying import copy
from .segment_blocks import EMPTY
from .segment_merge import find_rough, keep_pairs_inside, merge, neighbours, number_regions, renumber
from .segment_moments import misfit
from .segment_noise import sensor_variance
from .segment_pixels import own_pixels
from .segment_planes import planes
from .segment_quadtree import leaves

# The four blocks beside one.
DOWN, RIGHT = (1, -1, 0, 0), (0, 0, 1, -1)


@kernel()
def spread_out(region, owner, pyramid, alpha, slope_variance, spread, sigma, settled):
    """Give the blocks that are of no region, being too rough, to a region beside them that they fit.

    One after the other from the regions' edges on: where rounds go on by one block each, this goes all the way.
    A block fits within ``settled`` standard deviations, root mean square. The arguments are those of
    `segment_pixels.own_pixels`; ``region`` is changed.
    """
    rows, columns = region.shape
    # Blocks to look at: at first all, and then the neighbours of those that have joined a region.
    row_of, column_of = np.empty(4 * rows * columns, np.int32), np.empty(4 * rows * columns, np.int32)
    next_row, next_column = np.empty_like(row_of), np.empty_like(row_of)
    joins = np.empty(4 * rows * columns, np.int32)
    count = 0
    for row in range(rows):
        for column in range(columns):
            if region[row, column] < 0 and owner[row, column] != EMPTY:
                row_of[count], column_of[count] = row, column
                count += 1
    while count > 0:
        for k in range(count):
            row, column = row_of[k], column_of[k]
            i = row * columns + column
            pixels = pyramid[0, i]
            sensor = sensor_variance(pyramid[3, i] / pixels, sigma)
            best = settled * settled
            joins[k] = -1
            for side in range(4):
                r, c = row + DOWN[side], column + RIGHT[side]
                if r < 0 or c < 0 or r >= rows or c >= columns or region[r, c] < 0:
                    continue
                a = region[r, c]
                total = (sensor + slope_variance[a]) * spread[a]
                error = misfit(pyramid, i, alpha, a) / (pixels * total)
                if error < best:
                    best = error
                    joins[k] = a
        joined = 0
        for k in range(count):
            row, column = row_of[k], column_of[k]
            if joins[k] < 0 or region[row, column] >= 0:
                continue
            region[row, column] = joins[k]
            for side in range(4):
                r, c = row + DOWN[side], column + RIGHT[side]
                if r < 0 or c < 0 or r >= rows or c >= columns or region[r, c] >= 0 or owner[r, c] == EMPTY:
                    continue
                next_row[joined], next_column[joined] = r, c
                joined += 1
        row_of, next_row = next_row, row_of
        column_of, next_column = next_column, column_of
        count = joined


@kernel()
def find_regions(
    inverse_depth, tan_x, tan_y, centre_u, centre_v, pyramid, offsets, shapes, state,
    sigma, lateral_x, lateral_y, growth, floor, jump, spread, rough, reach, close, settled, cut, rounds, least,
    region, owner, pixel_owner, pairs, contact, table, moments, squares,
):  # fmt: skip
    """Merge what is one plane, give the pixels to the planes, fit the planes anew to their pixels: in rounds.

    Parameters
    ----------
    inverse_depth, tan_x, tan_y, centre_u, centre_v, reach, close, settled, cut, owner, pixel_owner
        See `segment_pixels.own_pixels`.
    pyramid, offsets, shapes, state
        See `segment_quadtree.join_blocks`.
    sigma, lateral_x, lateral_y, growth, floor, jump, spread, pairs, contact, table
        See `segment_merge.merge` and `segment_merge.neighbours`.
    rough : float
        See `segment_merge.find_rough`; such regions are merged anew, by half the tolerance.
    rounds : int
    least : float
        Pixels that a region must have after the first round.
    region : (R, C) int32, written
        Region that owns most of a block, or -1.
    moments, squares : (R·C, 10), (R·C,) float64, written
        Of the regions.

    Returns
    -------
    number : (M,) int64
        Region that the regions of ``owner`` and ``pixel_owner`` became in the end, or -1.
    count : int
        Regions in the end.
    """
    count = leaves(offsets, shapes, state, pyramid, region, owner, moments)
    number = np.empty(0, np.int64)
    before = np.empty_like(region)
    alpha = np.empty((0, 3))
    for trip in range(rounds + 1):
        pair_count = neighbours(region, centre_u, centre_v, pairs, contact, table)
        first_moments = moments[:count].copy()
        first_pairs, first_contact = pairs[:pair_count].copy(), contact[:pair_count].copy()
        parent = np.empty(count, np.int64)
        merge(
            moments[:count], pairs, contact, table, pair_count, sigma, lateral_x, lateral_y, growth,
            floor, jump, spread, parent,
        )  # fmt: skip
        several = np.empty(count, np.bool_)
        if find_rough(moments, parent, sigma, lateral_x, lateral_y, growth, rough, several):
            pair_count = keep_pairs_inside(first_pairs, first_contact, parent, several)
            again = np.empty(count, np.int64)
            merge(
                first_moments, first_pairs, first_contact, table, pair_count, sigma, lateral_x, lateral_y, growth,
                0.5 * floor, 0.5 * jump, spread, again,
            )  # fmt: skip
            for a in range(count):
                if several[parent[a]]:
                    copy(first_moments[a], moments[a])
                else:
                    again[a] = parent[a]
            parent = again
        number = np.empty(count, np.int64)
        merged = number_regions(parent, moments, least if trip else 0.0, number)
        renumber(region, number)
        own_squares = squares[:count].copy()
        squares[:merged] = 0.0
        for a in range(count):
            if number[a] >= 0:
                squares[number[a]] += own_squares[a]
        if trip == rounds:
            return number, merged
        count = merged
        last_alpha = alpha
        alpha, slope_variance, waves = np.empty((count, 3)), np.empty(count), np.empty(count)
        planes(moments[:count], sigma, lateral_x, lateral_y, growth, alpha, slope_variance, waves)
        if trip == 1:  # before that it would spread over what becomes a region of its own
            spread_out(region, owner, pyramid, alpha, slope_variance, waves, sigma, settled)
        own_pixels(
            inverse_depth, tan_x, tan_y, centre_u, centre_v, region, alpha, slope_variance, waves, sigma,
            reach, close, settled, cut, pyramid, offsets, shapes, trip == 0, before, number, last_alpha,
            owner, pixel_owner, moments[:count], squares[:count],
        )  # fmt: skip
    return number, count
