"""Segmentation: regions of one plane each.

In rounds: from joined blocks to regions, from regions to the pixels they own, and back.
"""

import numpy as np

from .._jit import kernel
from ..marked import list_marked, room_for_marks
from .blocks import EMPTY
from .folds import part_again
from .growth import grow_together
from .joining import join_blocks, leaves
from .merge import merge, neighbours, number_regions, rename_pairs, renumber
from .moments import misfit
from .noise import in_square
from .pixels import own_pixels
from .planes import deviations, fit_regions
from .records import Contacts, Owned, Planes, Shares
from .shape import find_curved

# The four blocks beside one.
BESIDE_DOWN, BESIDE_RIGHT = (1, -1, 0, 0), (0, 0, 1, -1)


@kernel()
def spread_out(region, owner, pyramid, sensor, planes, settled):
    """Give the blocks without a region, which are too rough, to a neighbouring region that they fit.

    One after the other from the regions' edges on: rounds advance by one block each, this goes all the way. A block
    fits within ``settled`` standard deviations, root mean square. The arguments are those of
    `pixels.own_pixels`, and ``owner`` that of the blocks; ``region`` is changed.
    """
    moments, alpha = pyramid.moments, planes.alpha
    rows, columns = region.shape
    # Blocks to look at: at first all, and then the neighbours of those that have joined a region.
    row_of, column_of = np.empty(4 * rows * columns, np.int32), np.empty(4 * rows * columns, np.int32)
    next_row, next_column = np.empty_like(row_of), np.empty_like(row_of)
    joins = np.empty(4 * rows * columns, np.int32)
    marks, words, marked = room_for_marks(columns)
    count = 0
    for row in range(rows):
        now, had = region[row], owner[row]
        for c in range(columns):
            marks[c] = (now[c] < 0) & (had[c] != EMPTY)
        for i in range(list_marked(marks, words, True, marked)):
            row_of[count], column_of[count] = row, marked[i]
            count += 1
    while count > 0:
        for k in range(count):
            row, column = row_of[k], column_of[k]
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
            row, column = row_of[k], column_of[k]
            if joins[k] < 0 or region[row, column] >= 0:
                continue
            region[row, column] = joins[k]
            for side in range(4):
                r, c = row + BESIDE_DOWN[side], column + BESIDE_RIGHT[side]
                if r < 0 or c < 0 or r >= rows or c >= columns or region[r, c] >= 0 or owner[r, c] == EMPTY:
                    continue
                next_row[joined], next_column[joined] = r, c
                joined += 1
        row_of, next_row = next_row, row_of
        column_of, next_column = next_column, column_of
        count = joined


@kernel()
def move_on(region, before, pyramid, planes):
    """Let borders that moved in this round go on, from block to block, as far as the blocks fit the region better.

    Rounds advance by a block each, and a square that grew over an edge may have many. ``region`` is changed; ``before``
    is as it was before the round.
    """
    moments, alpha = pyramid.moments, planes.alpha
    rows, columns = region.shape
    moved, left = np.empty(rows * columns, np.int32), np.empty(rows * columns, np.int32)
    marks, words, marked = room_for_marks(columns)
    count = 0
    for row in range(rows):
        now, was = region[row], before[row]
        for c in range(columns):
            marks[c] = (now[c] != was[c]) & (now[c] >= 0) & (was[c] >= 0)
        for i in range(list_marked(marks, words, True, marked)):
            c = marked[i]
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


@kernel(inline=True)
def merge_and_own(
    inverse_depth, rays, pyramid, sensor, state, noise, rules, least, region, owners, contended, contacts, moments
):  # fmt: skip
    """Merge what is one plane, give the pixels to the planes, fit the planes again to their pixels: in rounds.

    Parameters
    ----------
    inverse_depth, rays, pyramid, noise, rules, least, owners, contended, moments
        See `find_regions`, which calls the last ``region_moments``.
    sensor, state
        See `joining.join_blocks`.
    region : (R, C) int32, written
        Region that owns most of a block, or -1.
    contacts : Contacts, written
        Of the regions in the end.

    Returns
    -------
    number : (M,) int64
        What the regions of ``owners`` and ``shares`` became in the end, or -1.
    count : int
        Regions in the end.
    shares : Shares
    contact_count : int
    """
    count = leaves(pyramid, state, region, owners.block, moments)
    parent, number = np.empty(count, np.int64), np.empty(count, np.int64)
    grow_together(region, moments[:count], noise, rules, parent)
    count = number_regions(parent, moments, 0.0, number)
    renumber(region, number)
    before = np.empty_like(region)
    alpha = np.empty((0, 3))
    shares = Shares(np.empty(0, np.int32), np.empty(0, np.int32), np.empty((0, 10)))
    for trip in range(rules.trips + 1):
        pair_count = neighbours(region, rays, contacts)
        first_moments = moments[:count].copy()
        first = Contacts(contacts.pairs[:pair_count].copy(), contacts.where[:pair_count].copy(), contacts.table)
        parent = np.empty(count, np.int64)
        pair_count = merge(moments[:count], contacts, pair_count, noise, rules, 1.0, parent)
        is_parted = part_again(
            region, pyramid, owners, shares, moments[:count], first_moments, first, noise, rules, parent
        )  # fmt: skip
        number = np.empty(count, np.int64)
        merged = number_regions(parent, moments, least if trip else 0.0, number)
        renumber(region, number)
        if trip == rules.trips:
            if is_parted or not rename_pairs(contacts.pairs, pair_count, number):
                pair_count = neighbours(region, rays, contacts)
            return number, merged, shares, pair_count
        count = merged
        last_alpha = alpha
        alpha = np.empty((count, 3))
        planes = Planes(alpha, np.empty(count), np.empty(count), np.empty(count), rays.stretch)
        fit_regions(moments[:count], noise, planes)
        if trip == 1:  # earlier it would spread over what becomes a region of its own
            spread_out(region, owners.block, pyramid, sensor, planes, rules.settled)
        shares = own_pixels(
            inverse_depth, rays, pyramid, sensor, region, planes, noise.sigma, rules, trip == 0, before, number,
            last_alpha, owners, shares, contended, moments[:count],
        )  # fmt: skip
        if trip < rules.trips - 1:
            move_on(region, before, pyramid, planes)
    return number, count, shares, 0


@kernel(inline=True)
def find_regions(inverse_depth, rays, pyramid, noise, rules, least, owners, contended, contacts, region_moments):
    """The regions of a frame, which pixels they own, and which of them are curved.

    Parameters
    ----------
    inverse_depth, rays, pyramid, noise, rules
        See `search.find_planes`.
    least : float
        Pixels that a region must have after the first round.
    owners : Owners, written
    contended, contacts
        Room: see `pixels.own_pixels` and `merge.neighbours`.
    region_moments : (R·C, 10) float64, written
        The first rows are those of the regions.

    Returns
    -------
    shares : Shares
    number : (M,) int64
        What the regions of ``owners`` and ``shares`` became in the end, or -1.
    curved : (N,) bool
        Of the regions in the end.
    deviation : (N,) float64
        Standard deviation of a pixel about the plane of each.
    """
    rows, columns = owners.block.shape
    sensor, state = np.empty(rows * columns), np.empty(len(pyramid.rss), np.int8)
    join_blocks(pyramid, noise, rules, sensor, state)
    region = np.empty((rows, columns), np.int32)
    number, count, shares, contact_count = merge_and_own(
        inverse_depth, rays, pyramid, sensor, state, noise, rules, least, region, owners, contended, contacts,
        region_moments,
    )  # fmt: skip
    moments = region_moments[:count]
    planes = Planes(np.empty((count, 3)), np.empty(count), np.empty(count), np.empty(count), rays.stretch)
    fit_regions(moments, noise, planes)
    curved, deviation = np.empty(count, np.bool_), np.empty(count)
    owned = Owned(region, number, owners, shares)
    find_curved(owned, inverse_depth, rays, pyramid, moments, planes, noise, rules, contacts, contact_count, curved)
    deviations(moments, planes, noise.sigma, deviation)
    return shares, number, curved, deviation
