"""Segmentation, in turns with the merging: every pixel goes to the plane it fits."""

import math

import numpy as np

from ._jit import kernel
from .copying import copy
from .segment_blocks import BLOCK, MIXED
from .segment_contest import (
    AREA,
    NEIGHBOURS,
    contend,
    contenders,
    gather,
    is_undisputed,
    line_between,
    misfits,
    sum_owned,
    sums_of_nine,
    take_middle,
)
from .segment_merge import WORD
from .segment_moments import misfit
from .segment_records import Shares
from .segment_settled import OPEN, SAME, SPARSE, add_up, give_whole, keep_unchanged, look_around


@kernel()
def own_pixels(
    inverse_depth, rays, pyramid, sensor, region, planes, sigma, rules, is_first, before, number, last_alpha,
    owners, shares, sums,
):  # fmt: skip
    """Give each pixel to a region, or to none, and sum the moments of what each region owns.

    Parameters
    ----------
    inverse_depth : (H, W) float32
        0 where there is no measurement.
    rays : Rays
    pyramid : Pyramid
    sensor : (R·C,) float64
        Of each block: see `segment_noise.sensor_variance`.
    region : (R, C) int32
        Region of each block, or -1; a block becomes, on return, the region that owns most of its pixels.
    planes : Planes
        Of the regions: see `segment_planes.fit_regions`.
    sigma : see `segment_noise.sensor_variance`
    rules : Rules
        A region contends for a pixel within ``reach`` standard deviations of its plane. Two planes meet where both
        fit a pixel's neighbourhood within ``close``. A block without rivals goes whole to a region that fits it
        within ``settled``. Squared residuals count as ``cut``² variances at most.
    is_first : bool
        Whether there was no round before.
    before : (R, C) int32
        ``region`` before the last round; on return, before this one.
    number : (M,) int64
        Which of the regions each region of the last round has become, or -1.
    last_alpha : (M, 3) float64
        ``planes.alpha`` in the last round.
    owners : Owners
        Of the last round, at first EMPTY or UNSEEN.
    shares : Shares
        Of the last round.
    sums : Sums, written

    Returns
    -------
    Shares
        Of this round.
    """
    rows, columns = region.shape
    tasks = np.zeros(-(-rows * columns // WORD) * WORD, np.int8)
    task = tasks[: rows * columns].reshape(rows, columns)
    look_around(region, owners.block, task)
    if not is_first:
        keep_unchanged(
            region, before, number, planes, last_alpha, sigma, rays, sums.moments, owners.block, task
        )
    for row in range(rows):
        copy(region[row], before[row])
    give_whole(pyramid, sensor, region, planes, rules.settled, task, owners)
    opened, same = np.empty(rows * columns, np.int32), np.empty(rows * columns, np.int32)
    open_count, same_count = list_blocks(tasks, opened, same)
    shares_of = owners.count.reshape(-1)
    room = NEIGHBOURS * open_count  # at most: the system gives no memory for what nobody writes to
    for i in same[:same_count]:
        room += shares_of[i]
    new = Shares(np.empty(room, np.int32), np.empty(room, np.int32), np.empty((room, 11)))
    count = take_over(same[:same_count], number, owners, shares, new)
    count = contest(
        opened[:open_count], inverse_depth, rays, before, pyramid, sensor, planes, rules, region, owners, new, count
    )  # fmt: skip
    add_up(pyramid, owners, new, count, sums)
    return new


@kernel()
def list_blocks(tasks, opened, same):
    """Write which blocks are OPEN, and which are the SAME; how many of each.

    ``tasks`` (K,) int8 are of whole words, DONE after the last block.
    """
    words = tasks.view(np.uint64)
    open_count = same_count = 0
    for w in range(len(words)):
        if words[w] == 0:
            continue
        for i in range(w * WORD, (w + 1) * WORD):
            opened[open_count] = same[same_count] = i
            open_count += tasks[i] == OPEN
            same_count += tasks[i] == SAME
    return open_count, same_count


@kernel()
def take_over(blocks, number, owners, shares, new):
    """Take over the shares of blocks that stay the SAME, by their regions' new ``number``; returns how many."""
    first, shares_of = owners.first.reshape(-1), owners.count.reshape(-1)
    region, pixels, sums = shares
    new_region, new_pixels, new_sums = new
    count = 0
    for i in blocks:
        start = count
        for s in range(first[i], first[i] + shares_of[i]):
            a = number[region[s]]
            if a < 0:
                continue
            k = start
            while k < count and new_region[k] != a:  # regions that have become one
                k += 1
            if k == count:
                new_region[k] = a
                new_pixels[k] = 0
                for j in range(11):
                    new_sums[k, j] = 0.0
                count += 1
            new_pixels[k] |= pixels[s]
            for j in range(11):
                new_sums[k, j] += sums[s, j]
        first[i] = start
        shares_of[i] = count - start
    return count


@kernel()
def contest(
    blocks, inverse_depth, rays, before, pyramid, sensor, planes, rules, region, owners, shares, count
):
    """Give blocks whole to a region that no other contends for, or each pixel to one, or to none.

    The shares are added after the first ``count``. Arguments as in `own_pixels`.

    Returns
    -------
    int
        How many there are then.
    """
    columns = region.shape[1]
    tan_x, tan_y, centre_u, centre_v = rays.tan_x, rays.tan_y, rays.centre_u, rays.centre_v
    # All by names of their own: to look into a tuple within a loop costs more than most of what is done there.
    of_block, alpha, slope_variance = pyramid.moments, planes.alpha, planes.slope_variance
    waviness_square, stretch = planes.waviness_square, planes.square_stretch
    owner, errors, first, shares_of, measured = owners
    settled_square, reach, cut_square = (
        rules.settled * rules.settled,
        rules.reach,
        np.float32(rules.cut * rules.cut),
    )
    limit, close_square = np.float32(reach * reach), np.float32(rules.close * rules.close)
    candidate, near = np.empty(NEIGHBOURS, np.int64), np.empty(NEIGHBOURS, np.int64)
    owned = np.empty(NEIGHBOURS, np.int64)
    centre, variance = np.empty((NEIGHBOURS, 3)), np.empty(NEIGHBOURS)
    penalty = np.empty(NEIGHBOURS, np.float32)
    # Few arrays, of sizes that are known beforehand: so the compiler sees which rows are apart.
    space = np.zeros((6 + NEIGHBOURS, AREA), np.float32)
    around, down, square = space[:4], space[4], space[5:]
    small = np.zeros((5 + NEIGHBOURS, BLOCK * BLOCK), np.float32)
    middle, nearby = small[:4], small[4:]
    whole = np.zeros((1 + NEIGHBOURS, BLOCK * BLOCK), np.int32)
    winner, within = whole[0], whole[1:]
    share_region, share_pixels, share_sums = shares
    for here in blocks:
        row, column = (
            np.int64(np.uint32(here) // np.uint32(columns)),
            np.int64(np.uint32(here) % np.uint32(columns)),
        )
        pixels = of_block[0, here]
        contending = contenders(before, row, column, centre_u, centre_v, candidate, centre)
        own = np.int64(before[row, column])
        a = candidate[0] if contending == 1 else own
        fits, error, total = False, 0.0, 1.0
        if a >= 0:
            total = (sensor[here] + slope_variance[a] * stretch[here]) * waviness_square[a]
            error = misfit(of_block, here, alpha, a)
            fits = error <= settled_square * pixels * total
            if fits and contending > 1:
                fits = is_undisputed(
                    a,
                    contending,
                    candidate,
                    centre,
                    alpha,
                    tan_x,
                    tan_y,
                    row,
                    column,
                    reach * math.sqrt(total),
                )
            if fits and pixels > SPARSE:
                owner[row, column] = region[row, column] = a
                errors[row, column] = max(error, 0.0) / total
                continue
        gather(inverse_depth, tan_x, tan_y, row, column, around)
        owner[row, column] = MIXED
        first[row, column] = count
        for c in range(3):
            take_middle(around, c, middle, c)
        valid = np.int32(0)
        for p in range(BLOCK * BLOCK):
            valid |= np.int32(middle[0, p] > 0.0) << np.int32(p)
        measured[row, column] = valid
        if fits:
            share_region[count] = region[row, column] = a
            share_pixels[count] = valid
            for k in range(10):
                share_sums[count, k] = of_block[k, here]
            share_sums[count, 10] = max(error, 0.0) / total
            shares_of[row, column] = 1
            count += 1
            continue
        near_count = 0
        for i in range(contending):
            a = candidate[i]
            variance[i] = (sensor[here] + slope_variance[a] * stretch[here]) * waviness_square[a]
            owned[i] = 0
            near[near_count] = i
            if misfits(around, alpha, a, math.sqrt(variance[i]), limit, square, i, within):
                near_count += 1
        if near_count > 1:
            for k in range(near_count):
                i = near[k]
                penalty[i] = math.log(variance[i])
                sums_of_nine(square, i, down, nearby, i + 1)
            for p in range(AREA):
                around[3, p] = 1.0 if around[0, p] > 0.0 else 0.0
            sums_of_nine(around, 3, down, nearby, 0)
        for p in range(BLOCK * BLOCK):
            winner[p] = -1
        for k in range(near_count):
            j = near[k]
            for other in range(k):
                i = near[other]
                line_u, line_v, line_1 = line_between(i, j, candidate, centre, alpha)
                contend(i, j, within, middle, line_u, line_v, line_1, nearby, penalty, close_square, winner)
            for p in range(BLOCK * BLOCK):
                winner[p] = j if (winner[p] < 0) & (within[j, p] == 1) else winner[p]
        for k in range(near_count):
            i = near[k]
            mask = np.int32(0)
            for p in range(BLOCK * BLOCK):
                mask |= np.int32(winner[p] == i) << np.int32(p)
            if mask == 0:
                continue
            take_middle(square, i, middle, 3)
            owned[i] = sum_owned(i, winner, middle, cut_square, share_sums, count)
            share_region[count] = candidate[i]
            share_pixels[count] = mask
            count += 1
        shares_of[row, column] = count - first[row, column]
        # A thin region may own most of no block: a block stays with a region that owns a quarter of it.
        most = 0
        for i in range(1, contending):
            if owned[i] > owned[most]:
                most = i
        for i in range(contending):
            if candidate[i] == own and 4 * owned[i] >= pixels:
                most = i
        region[row, column] = candidate[most] if contending > 0 and owned[most] > 2 else -1
    return count
