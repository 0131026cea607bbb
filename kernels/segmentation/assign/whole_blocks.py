"""Segmentation: the blocks whose pixels go to a region without being looked at, and the moments of what regions have.

A block whose whole neighbourhood is one region hands its pixels to it, if its moments say that they fit; and where
no region and no plane has changed since the last round, nobody has to look again.
"""

import math

import numpy as np

from ..._jit.kernel import kernel
from ...common.arrays import copy
from ..model.moments import moment_rows
from ..model.pixel_noise import about_plane, grown_variance, sensor_variance
from ..model.records import BLOCK, EMPTY, MIXED

# What is to be done with a block: nothing; look at it; give it to its own region, the only one around, if it fits that;
# take over what regions have of it.
DONE, OPEN, ALONE, SAME = 0, 1, 2, 3
# No region, as a number above those of all regions.
NO_REGION = np.int32(np.iinfo(np.int32).max)
# No region, and not what a block without one has: what a plane that has moved became.
MOVED = np.int32(-2)
# A block with more measured pixels than this is a solid one: what is missing there are holes.
SPARSE = BLOCK * BLOCK // 2
# Of a block that has changed: it is in another region than before, or in none, or was in none. In others only the plane
# of their region has moved.
OTHER = 2
# Deviations by which planes may move without anything that they own being looked at again.
STILL = 0.25


@kernel()
def look_around(region, owner, task):
    """Compare every block's region with its eight neighbours': (R, C) int8 ``task`` becomes ALONE, OPEN or DONE."""
    rows, columns = region.shape
    # With a rim of no regions. Two columns more, so that all loops below go over the same number of them.
    width = columns + 2
    beside = np.full((3, width), -1, np.int32)  # three rows of blocks, the middle one among them
    most, lowest = np.empty(width, np.int32), np.empty(width, np.int32)
    for row in range(rows):
        above, regions_here, below = beside[(row + 2) % 3], beside[row % 3], beside[(row + 1) % 3]
        if row == 0:
            copy(region[0], regions_here[1 : columns + 1])
        if row + 1 < rows:
            copy(region[row + 1], below[1 : columns + 1])
        else:
            below[:] = -1
        for c in range(width):
            a, b, d = above[c], regions_here[c], below[c]
            most[c] = max(a, b, d)
            lowest[c] = min(a if a >= 0 else NO_REGION, b if b >= 0 else NO_REGION, d if d >= 0 else NO_REGION)
        line, owners = task[row], owner[row]
        for c in range(columns):
            a = regions_here[c + 1]
            high = max(most[c], most[c + 1], most[c + 2])
            low = min(lowest[c], lowest[c + 1], lowest[c + 2])
            line[c] = DONE if owners[c] == EMPTY else ALONE if (high == a) & (low == a) else OPEN


@kernel()
def keep_unchanged(region, last_region, number, planes, last_alpha, sigma, rays, moments, owner, task):
    """Leave alone the blocks around which no region has changed since the last round, and no plane has moved.

    Their ``task`` becomes DONE, or SAME if they are MIXED. Of the others those that are ALONE become OPEN if their
    region did not have them whole in the last round, since only what is OPEN changes hands: a block that a region had
    whole was in it before the last round, or in none, and then it is OTHER or its neighbours have changed. The rest is
    as in `assign_pixels.assign_pixels`.
    """
    alpha, centre_u, centre_v = planes.alpha, rays.centre_u, rays.centre_v
    rows, columns = region.shape
    regions = len(number)
    # What regions became, and those of them whose planes have not moved anywhere in the frame; the last entries are for
    # blocks of no region.
    became, still = np.empty(regions + 1, np.int32), np.full(regions + 1, MOVED)
    became[regions] = still[regions] = -1
    moved = np.zeros((3, regions + 1))  # in deviations
    has_lens = centre_u.shape[0] > 1
    for b in range(regions):
        a = number[b]
        became[b] = a
        if a < 0:
            moved[2, b] = math.inf  # it is dropped, and what it had is anybody's
            continue
        sensor = sensor_variance(moments[a, 3] / moments[a, 0], sigma)
        deviation = math.sqrt(about_plane(sensor, planes, a))
        for k in range(3):
            moved[k, b] = (alpha[a, k] - last_alpha[b, k]) / deviation
        is_still = not has_lens  # with one, the blocks in the corners need not be the outermost
        for k in range(4):
            u, v = centre_u[0, (columns - 1) * (k & 1)], centre_v[(rows - 1) * (k >> 1), 0]
            is_still &= abs(moved[0, b] * u + moved[1, b] * v + moved[2, b]) <= STILL  # of no plane it is NaN
        if is_still:
            still[b] = a
    changed = np.zeros((rows + 2, columns + 2), np.int8)  # with a rim
    for row in range(rows):
        regions_here, last = region[row], last_region[row]
        row_u, row_v = centre_u[row if has_lens else 0], centre_v[row]
        for c in range(columns):
            b = last[c] if last[c] >= 0 else regions
            if regions_here[c] == still[b]:
                continue
            d = moved[0, b] * row_u[c] + moved[1, b] * row_v[c if has_lens else 0] + moved[2, b]
            changed[row + 1, c + 1] = OTHER if regions_here[c] != became[b] else not abs(d) <= STILL
    nearby = np.empty(columns + 2, np.int8)
    for row in range(rows):
        above, here, below, line, owners = (changed[row], changed[row + 1], changed[row + 2], task[row], owner[row])
        for c in range(columns + 2):
            nearby[c] = above[c] | here[c] | below[c]
        for c in range(columns):
            unchanged = SAME if owners[c] == MIXED else DONE
            changes_hands = (line[c] == ALONE) & ((here[c + 1] == OTHER) | (owners[c] == MIXED))
            again = OPEN if changes_hands else line[c]
            line[c] = again if nearby[c] | nearby[c + 1] | nearby[c + 2] else unchanged


@kernel()
def give_whole(pyramid, sensor, region, planes, settled, task, owners):
    """Give the blocks that are ALONE to their region if they fit it within ``settled`` deviations; else they are OPEN.

    Those that are DONE get their region's new number. Arguments as in `assign_pixels.assign_pixels`.
    """
    moments, stretch, alpha = pyramid.moments, planes.square_stretch, planes.alpha
    slope_variance, waviness_square = planes.slope_variance, planes.waviness_square
    rows, columns = region.shape
    allowed = settled * settled
    square_sums, limit = np.empty(columns), np.empty(columns)
    for row in range(rows):
        regions_here, line, owner = region[row], task[row], owners.block[row]
        alone = 0
        for c in range(columns):
            alone += line[c] == ALONE
        if alone == 0:  # as in most of the last rounds
            for c in range(columns):
                owner[c] = regions_here[c] if (line[c] == DONE) & (owner[c] >= 0) else owner[c]
            continue
        here = slice(row * columns, (row + 1) * columns)
        n, s_u, s_v, s_q, s_uu = moment_rows(moments, 0, here)
        s_uv, s_uq, s_vv, s_vq, s_qq = moment_rows(moments, 5, here)
        sensor_here, stretched = sensor[here], stretch[here]
        stop = 0
        while stop < columns:
            start = stop  # of blocks that are ALONE, which have one region if they are side by side
            while stop < columns and line[stop] == ALONE:
                stop += 1
            if stop == start:
                stop += 1
                continue
            a = regions_here[start]
            a_u, a_v, a_1 = alpha[a, 0], alpha[a, 1], alpha[a, 2]
            slope, waves = slope_variance[a], waviness_square[a]
            for c in range(start, stop):
                total = grown_variance(sensor_here[c], slope, stretched[c], waves)
                square = (
                    s_qq[c] - 2.0 * (a_u * s_uq[c] + a_v * s_vq[c] + a_1 * s_q[c])
                    + a_u * (a_u * s_uu[c] + 2.0 * (a_v * s_uv[c] + a_1 * s_u[c]))
                    + a_v * (a_v * s_vv[c] + 2.0 * a_1 * s_v[c])
                    + a_1 * a_1 * n[c]
                )  # fmt: skip
                square_sums[c] = square / total
                limit[c] = allowed * n[c] if n[c] > SPARSE else -math.inf
        for c in range(columns):
            fits = square_sums[c] <= limit[c]
            is_alone = line[c] == ALONE
            is_open = (line[c] == OPEN) | (is_alone & ~fits)
            is_whole = (is_alone & fits) | ((line[c] == DONE) & (owner[c] >= 0))
            owner[c] = regions_here[c] if is_whole else owner[c]
            line[c] = OPEN if is_open else SAME if line[c] == SAME else DONE


@kernel(inline="compiled")
def add_square(square_moments, i, moments, a):
    """Add the moments of square or block ``i`` to those of region ``a``; both arrays have one dimension."""
    there, step = 10 * a, len(square_moments) // 10
    for _ in range(10):
        moments[there] += square_moments[i]
        i, there = i + step, there + 1


@kernel()
def add_up(pyramid, owners, region_moments):
    """Sum up the whole blocks that each region has, in the first round.

    Of 4x4 blocks that one region has the pyramid knows the moments, and of 2x2.
    """
    square_moments, offsets, shapes = pyramid.moments.reshape(-1), pyramid.offsets, pyramid.shapes
    owner, moments = owners.block, region_moments.reshape(-1)
    moments[:] = 0.0
    rows, columns = owner.shape
    same = np.empty(columns, np.bool_)
    for row in range(0, rows, 4):
        a, b, c, d = owner[row], owner[row + 1], owner[row + 2], owner[row + 3]
        for x in range(columns):
            same[x] = (a[x] == b[x]) & (b[x] == c[x]) & (c[x] == d[x])
        for column in range(0, columns, 4):
            first = a[column]
            if (
                same[column] & same[column + 1] & same[column + 2] & same[column + 3]
                & (a[column + 1] == first) & (a[column + 2] == first) & (a[column + 3] == first)
            ):  # fmt: skip
                if first >= 0:
                    i = offsets[2] + (row >> 2) * shapes[2, 1] + (column >> 2)
                    add_square(square_moments, i, moments, first)
                continue
            for y in range(row, row + 4, 2):
                for x in range(column, column + 4, 2):
                    first = owner[y, x]
                    if (owner[y, x + 1] == first) & (owner[y + 1, x] == first) & (owner[y + 1, x + 1] == first):
                        if first >= 0:
                            add_square(square_moments, offsets[1] + (y >> 1) * shapes[1, 1] + (x >> 1), moments, first)
                        continue
                    for r in range(y, y + 2):
                        for k in range(x, x + 2):
                            if owner[r, k] >= 0:
                                add_square(square_moments, r * columns + k, moments, owner[r, k])


@kernel(arrays=False)
def add_shares(shares, start, stop, region_moments):
    """Add the shares from ``start`` to ``stop`` to the moments of their regions."""
    share_region, share_moments = shares.region, shares.moments
    for s in range(start, stop):
        a = share_region[s]
        for k in range(10):
            region_moments[a, k] += share_moments[s, k]


@kernel(arrays=False)
def take_back(blocks, number, owners, shares, region_moments, had):
    """Take the shares that regions have of ``blocks`` from their moments, and note which of them has one whole.

    Parameters
    ----------
    blocks : (K,) int32
        row · C + column.
    number, owners, shares
        Of the last round, as in `assign_pixels.assign_pixels`.
    region_moments : (N, 10) float64, changed
    had : (K,) int32, written
        The region, by its new number, that had all of a block, or -1.
    """
    owner, first, shares_of = owners.block.reshape(-1), owners.first.reshape(-1), owners.count.reshape(-1)
    share_region, share_moments = shares.region, shares.moments
    for k in range(len(blocks)):
        i = blocks[k]
        had[k] = number[owner[i]] if owner[i] >= 0 else -1
        if owner[i] != MIXED:
            continue
        for s in range(first[i], first[i] + shares_of[i]):
            a = number[share_region[s]]
            if a >= 0:
                for j in range(10):
                    region_moments[a, j] -= share_moments[s, j]


@kernel(arrays=False)
def hand_out(blocks, had, pyramid, owners, region_moments):
    """Move those of ``blocks`` that regions have whole, or ``had``, from one region's moments to another's.

    ``had`` is that of `take_back`, and ``owners`` are those of this round.
    """
    moments, owner = pyramid.moments, owners.block.reshape(-1)
    for k in range(len(blocks)):
        i = blocks[k]
        was, now = had[k], owner[i]
        if was >= 0 and was != now:
            for j in range(10):
                region_moments[was, j] -= moments[j, i]
        if now >= 0 and was != now:
            for j in range(10):
                region_moments[now, j] += moments[j, i]
