"""Blocks that follow their neighbours: rough ones without a region, and those beside a border that moved."""

import numpy as np

from ..._jit.kernel import kernel
from ..model.moments import misfit
from ..model.pixel_noise import in_square
from ..model.records import EMPTY, Planes, as_regions, as_view

# The four blocks beside one.
BESIDE_DOWN, BESIDE_RIGHT = (1, -1, 0, 0), (0, 0, 1, -1)


@kernel()
def spread_out(view, regions, planes):
    """Give the blocks without a region, which are too rough, to a neighbouring region that they fit.

    One after the other from the regions' edges on: rounds advance by one block each, this goes all the way. A block
    fits within ``settled`` standard deviations, root mean square. The arguments are those of
    `assign_pixels.assign_pixels`; ``regions.block`` is changed.
    """
    view, regions, planes = as_view(view), as_regions(regions), Planes(*planes)
    pyramid, sensor, settled = view.pyramid, view.sensor, view.rules.fit_deviations
    region, owner = regions.block, regions.owners.block
    moments, alpha = pyramid.moments, planes.alpha
    rows, columns = region.shape
    # Blocks to look at: at first all, and then the neighbours of those that have joined a region.
    pair_row, column_of = np.empty(4 * rows * columns, np.int32), np.empty(4 * rows * columns, np.int32)
    next_row, next_column = np.empty_like(pair_row), np.empty_like(pair_row)
    joins = np.empty(4 * rows * columns, np.int32)
    count = 0
    for row in range(rows):
        for column in range(columns):
            if region[row, column] < 0 and owner[row, column] != EMPTY:
                pair_row[count], column_of[count] = row, column
                count += 1
    while count > 0:
        for k in range(count):
            row, column = pair_row[k], column_of[k]
            i = row * columns + column
            pixels = moments[0, i]
            best = settled * settled
            joins[k] = -1
            for side in range(4):
                r, c = row + BESIDE_DOWN[side], column + BESIDE_RIGHT[side]
                if r < 0 or c < 0 or r >= rows or c >= columns or region[r, c] < 0:
                    continue
                a = region[r, c]
                error = misfit(moments, i, alpha, a) / (pixels * in_square(sensor[i], planes, a, i))
                if error < best:
                    best = error
                    joins[k] = a
        joined = 0
        for k in range(count):
            row, column = pair_row[k], column_of[k]
            if joins[k] < 0 or region[row, column] >= 0:
                continue
            region[row, column] = joins[k]
            for side in range(4):
                r, c = row + BESIDE_DOWN[side], column + BESIDE_RIGHT[side]
                if r < 0 or c < 0 or r >= rows or c >= columns or region[r, c] >= 0 or owner[r, c] == EMPTY:
                    continue
                next_row[joined], next_column[joined] = r, c
                joined += 1
        pair_row, next_row = next_row, pair_row
        column_of, next_column = next_column, column_of
        count = joined


@kernel()
def move_on(view, region, before, alpha):
    """Let borders that moved in this round go on, from block to block, as far as the blocks fit the region better.

    Rounds advance by a block each, and a square that grew over an edge may have many. ``region`` is changed; ``before``
    is as it was before the round.
    """
    moments = as_view(view).pyramid.moments
    rows, columns = region.shape
    moved, left = np.empty(rows * columns, np.int32), np.empty(rows * columns, np.int32)
    count = 0
    for row in range(rows):
        now, was = region[row], before[row]
        for c in range(columns):
            if now[c] != was[c] and now[c] >= 0 and was[c] >= 0:
                moved[count], left[count] = row * columns + c, was[c]
                count += 1
    k = 0
    while k < count:
        here, a = moved[k], left[k]
        row, column = here // columns, here % columns
        b = region[row, column]
        for side in range(4):
            r, c = row + BESIDE_DOWN[side], column + BESIDE_RIGHT[side]
            if r < 0 or c < 0 or r >= rows or c >= columns or region[r, c] != a or before[r, c] != a:
                continue
            i = r * columns + c
            if misfit(moments, i, alpha, b) < misfit(moments, i, alpha, a):
                region[r, c] = b
                moved[count], left[count] = i, a
                count += 1
        k += 1
