"""Segmentation: what each region owns, as runs of pixels along the rows, united into connected parts."""

import numpy as np

from ..._jit.kernel import kernel
from ...common.arrays import copy
from ...common.bit_marks import list_marked, lowest_bit, room_for_marks
from ...common.union_find import root_of, unite
from ..model.records import BLOCK, EMPTY, MIXED, Runs, as_regions

# Pixels in a row or a column, missing or without a region, that are still a hole in a surface.
GAP = 3
# In place of a region, of pixels that are not measured.
MISSING = np.int32(-1)
# All pixels of a block, a bit each.
ALL = np.int32((1 << BLOCK * BLOCK) - 1)


@kernel(inline="compiled")
def write_share(pixels, region, left, band):
    """Write a region to the pixels of a block, whose first column is ``left``, that are its share."""
    while pixels != 0:
        p = lowest_bit(pixels)
        pixels &= pixels - np.int32(1)
        band[p // BLOCK, left + p % BLOCK] = region


@kernel(arrays=False)
def write_band(regions, row, band):
    """Write the region of each pixel of a row of blocks, from 1 on, to ``band``; 0 for none, and MISSING.

    Missing pixels of blocks that one region has are its own. ``band`` is (BLOCK, W) int32, W filling whole blocks.
    """
    _, _, number, owners, shares = regions
    owner, first_line = owners.block[row], band[0]
    for column in range(band.shape[1] // BLOCK):
        a = owner[column]
        region = number[a] + 1 if a >= 0 else MISSING if a == EMPTY else 0
        for x in range(column * BLOCK, (column + 1) * BLOCK):
            first_line[x] = region
    for y in range(1, BLOCK):
        copy(first_line, band[y])
    for column in range(band.shape[1] // BLOCK):
        if owner[column] != MIXED:
            continue
        left, first = column * BLOCK, owners.first[row, column]
        write_share(ALL & ~owners.measured[row, column], MISSING, left, band)
        for s in range(first, first + owners.count[row, column]):
            if number[shares.region[s]] >= 0:
                write_share(shares.pixels[s], number[shares.region[s]] + 1, left, band)


@kernel(inline="compiled")
def unite_over_gap(parent, nearest, is_hole, region, row, k, first, stop):
    """Unite run ``k`` with the ``nearest`` runs above some columns, if close and its region's.

    Returns over how many columns only a hole lies in between.
    """
    count = 0
    for x in range(first, stop):
        j = nearest[x]
        if j >= 0 and region[j] == region[k] and row[k] - row[j] - 1 <= GAP:
            unite(parent, j, k)
            count += is_hole[x]
    return count


@kernel()
def connect(regions, width, runs):
    """List the runs of regions along the rows, and number their connected parts.

    Runs of a region are connected where their pixels touch, if only at a corner, or where at most GAP pixels of no
    region lie between them along a row or a column. If all of these are missing, they are a hole, and end no run.

    Parameters
    ----------
    regions : Regions
    width : int
        Pixels in a row.
    runs : Runs, written
        With room for as many runs as there are pixels.

    Returns
    -------
    tuple of int
        Numbers of runs and of parts.
    """
    regions = as_regions(regions)
    first, row, start, stop, region, starts, starts_down, part = Runs(*runs)
    height = len(first) - 1
    band = np.empty((BLOCK, -(-width // BLOCK) * BLOCK), np.int32)
    change, words, columns = room_for_marks(width)
    nearest = np.full(width, np.int32(-1))  # the run with the nearest pixel above that has a region
    is_hole = np.ones(width, np.bool_)  # whether all pixels since are missing
    parent = np.empty(len(row), np.int32)
    count = 0
    for y in range(height):
        if y % BLOCK == 0:
            write_band(regions, y // BLOCK, band)
        line, first[y], row_is_hole = band[y % BLOCK], count, True
        above = first[max(y - 1, 0)]  # the run of the row above that is next
        change[0] = True
        for x in range(1, width):
            change[x] = line[x] != line[x - 1]
        stretches = list_marked(change, words, True, columns)
        columns[stretches] = width
        for i in range(stretches):
            left, right, a = columns[i], columns[i + 1], line[columns[i]] - 1
            if line[left] == MISSING:
                continue
            if line[left] == 0:
                row_is_hole = False
                for x in range(left, right):
                    is_hole[x] = False
                continue
            k = count
            row[k], start[k], stop[k], region[k], parent[k] = y, left, right, a, k
            starts[k] = 1
            if k > first[y] and region[k - 1] == a and left - stop[k - 1] <= GAP:
                unite(parent, k - 1, k)
                starts[k] = 0 if row_is_hole else 1
            row_is_hole = True
            while above < first[y] and stop[above] < left:
                above += 1
            covered, x, j = 0, left, above
            while j < first[y] and start[j] <= right:  # the runs right above, those at the corners among them
                if region[j] == a:
                    unite(parent, j, k)
                    covered += max(min(stop[j], right) - max(start[j], left), 0)
                covered += unite_over_gap(parent, nearest, is_hole, region, row, k, x, min(start[j], right))
                x = max(stop[j], left)
                j += 1
            covered += unite_over_gap(parent, nearest, is_hole, region, row, k, x, right)
            starts_down[k] = right - left - covered
            for x in range(left, right):
                nearest[x], is_hole[x] = k, True
            count += 1
    first[height] = count
    parts = 0
    for k in range(count):
        root = root_of(parent, k)
        part[k] = parts if root == k else part[root]
        parts += root == k
    return count, parts
