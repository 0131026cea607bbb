"""Segmentation, in turns with the merging: every pixel goes to the plane it fits."""

import math

import numpy as np

from ._jit import kernel
from .copying import copy
from .segment_blocks import BLOCK, MISSING, MIXED, UNOWNED, UNSEEN
from .segment_contest import (
    AREA,
    NEIGHBOURS,
    add_owned,
    contend,
    contenders,
    find_centres,
    gather,
    line_between,
    misfits,
    place_of,
    sums_of_nine,
    take_middle,
)
from .segment_moments import misfit
from .segment_noise import in_square, sensor_variance
from .segment_settled import (
    decide,
    list_unsettled,
    look_around,
    rename_owners,
    settle,
    settle_squares,
    settle_unchanged,
)


@kernel()
def own_pixels(
    inverse_depth, rays, pyramid, region, planes, sigma, rules, is_first, before, number, last_alpha, owners, sums
):  # fmt: skip
    """Give each pixel to a region, or to none, and sum the moments of what each region owns.

    Parameters
    ----------
    inverse_depth : (H, W) float32
        0 where there is no measurement.
    rays : Rays
    pyramid : Pyramid
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
        Of the last round, at first EMPTY or UNSEEN; a block that one region owns has more measured pixels than not.
    sums : Sums
        After the last round; on return, after this one.
    """
    rows, columns = region.shape
    around = np.empty((rows, columns), np.int8)
    block = np.empty((rows * columns, 3), np.int32)
    look_around(region, owners.block, around)
    if is_first:
        sums.moments[:] = 0.0
        sums.squares[:] = 0.0
    else:
        settle_unchanged(region, before, number, planes, last_alpha, sigma, rays, sums.moments, around)
        rename_owners(around, number, owners)
    for row in range(region.shape[0]):
        copy(region[row], before[row])
    count = np.int64(0)  # a literal 0 has a type of its own, for which all that gets it is compiled once more
    for level in (2, 1):
        count = settle_squares(
            pyramid, level, region, planes, sigma, rules.settled, number, around, owners.block, sums, block, count
        )  # fmt: skip
    count = list_unsettled(around, block, count)
    decide(block, count, rays, before, around, pyramid, planes, sigma, rules)
    if not is_first:
        take_out(
            block, count, inverse_depth, rays, pyramid, number, last_alpha, planes, sigma, rules.cut, owners, sums
        )  # fmt: skip
    count = settle(block, count, inverse_depth, pyramid, planes, sigma, region, owners, sums)
    contest(block, count, inverse_depth, rays, before, pyramid, planes, sigma, rules, region, owners, sums)


@kernel()
def take_out(
    block, count, inverse_depth, rays, pyramid, number, last_alpha, planes, sigma, cut, owners, sums
):  # fmt: skip
    """Subtract what the blocks that get another owner gave to the regions in the last round: see `decide`.

    Their owner becomes UNSEEN, that of the others what it was, by its new number.
    """
    owner, pixel_owner = owners
    moments, squares = sums
    of_block = pyramid.moments
    around = np.empty((3, AREA), np.float32)
    middle = np.empty((4, BLOCK * BLOCK), np.float32)
    own = np.empty(BLOCK * BLOCK, np.int32)
    listed = np.empty(NEIGHBOURS, np.int64)  # owners of the block's pixels
    for k in range(count):
        row, column = block[k, 0], block[k, 1]
        i = row * owner.shape[1] + column
        b = owner[row, column]
        a = number[b] if b >= 0 else -1
        if a >= 0 and a == block[k, 2]:
            owner[row, column] = a
            continue
        owner[row, column] = UNSEEN
        sensor = sensor_variance(of_block[3, i] / of_block[0, i], sigma)
        if a >= 0:
            for j in range(10):
                moments[a, j] -= of_block[j, i]
            error = max(misfit(of_block, i, last_alpha, b), 0.0)
            squares[a] -= error / in_square(sensor, planes, a, i)
        if b != MIXED:
            continue
        found = 0
        for p in range(BLOCK * BLOCK):
            own[p] = pixel_owner[i, p]
            j = place_of(own[p], listed, found)
            if j == found and own[p] >= 0 and number[own[p]] >= 0:
                listed[j] = own[p]
                found += 1
        if found == 0:
            continue
        gather(inverse_depth, rays.tan_x, rays.tan_y, row, column, around)
        for c in range(3):
            take_middle(around, c, middle, c)
        for j in range(found):
            b = listed[j]
            a = number[b]
            share = 1.0 / in_square(sensor, planes, a, i)
            for p in range(BLOCK * BLOCK):
                e = middle[0, p] - (
                    last_alpha[b, 0] * middle[1, p] + last_alpha[b, 1] * middle[2, p] + last_alpha[b, 2]
                )
                middle[3, p] = e * e * share
            squares[a] += add_owned(b, own, middle, np.float32(cut * cut), -1.0, moments, a)


@kernel()
def contest(
    block, count, inverse_depth, rays, before, pyramid, planes, sigma, rules, region, owners, sums
):  # fmt: skip
    """Give each pixel of the first ``count`` blocks to one of the regions around its block, or to none.

    ``block`` (R·C, 3) int32 has their rows and columns, first of all; the rest is as in `own_pixels`.
    """
    columns = region.shape[1]
    tan_x, tan_y, centre_u, centre_v = rays.tan_x, rays.tan_y, rays.centre_u, rays.centre_v
    of_block, alpha = pyramid.moments, planes.alpha
    owner, pixel_owner = owners
    moments, squares = sums
    limit, close_square = np.float32(rules.reach * rules.reach), np.float32(rules.close * rules.close)
    cut_square = np.float32(rules.cut * rules.cut)
    candidate, near = np.empty(NEIGHBOURS, np.int64), np.empty(NEIGHBOURS, np.int64)
    owned = np.empty(NEIGHBOURS, np.int64)
    centre, penalty = np.empty((NEIGHBOURS, 3)), np.empty(NEIGHBOURS, np.float32)
    # Few arrays, of sizes that are known beforehand: so the compiler sees which rows are apart.
    room = np.zeros((5 + NEIGHBOURS, AREA), np.float32)
    around, down, measured, square = room[:3], room[3], room[4:5], room[5:]
    small = np.zeros((5 + NEIGHBOURS, BLOCK * BLOCK), np.float32)
    middle, n, nearby = small[:4], small[4:5], small[5:]
    whole = np.zeros((1 + NEIGHBOURS, BLOCK * BLOCK), np.int32)
    winner, within = whole[0], whole[1:]
    for b in range(count):
        row, column = block[b, 0], block[b, 1]
        here = row * columns + column
        pixels = of_block[0, here]
        sensor = sensor_variance(of_block[3, here] / pixels, sigma)
        contending = contenders(before, row, column, candidate)
        gather(inverse_depth, tan_x, tan_y, row, column, around)
        for c in range(3):
            take_middle(around, c, middle, c)
        near_count = 0
        for i in range(contending):
            a = candidate[i]
            total = in_square(sensor, planes, a, here)
            owned[i] = 0
            near[near_count] = i
            penalty[i] = total
            if misfits(around, alpha, a, math.sqrt(total), limit, square, i, within):
                near_count += 1
        if near_count > 1:
            find_centres(before, row, column, centre_u, centre_v, contending, candidate, centre)
            for k in range(near_count):
                i = near[k]
                penalty[i] = math.log(penalty[i])
                sums_of_nine(square, i, down, nearby)
            for p in range(AREA):
                measured[0, p] = 1.0 if around[0, p] > 0.0 else 0.0
            sums_of_nine(measured, 0, down, n)
        for p in range(BLOCK * BLOCK):
            winner[p] = -1
        for k in range(near_count):
            j = near[k]
            for other in range(k):
                i = near[other]
                line_u, line_v, line_1 = line_between(i, j, candidate, centre, alpha)
                contend(
                    i, j, within, middle, n, line_u, line_v, line_1, nearby, penalty, close_square, winner
                )  # fmt: skip
            for p in range(BLOCK * BLOCK):
                winner[p] = j if (winner[p] < 0) & (within[j, p] == 1) else winner[p]
        for k in range(near_count):
            i = near[k]
            a = candidate[i]
            for p in range(BLOCK * BLOCK):
                owned[i] += winner[p] == i
            if owned[i] > 0:
                take_middle(square, i, middle, 3)
                squares[a] += add_owned(i, winner, middle, cut_square, 1.0, moments, a)
        owner[row, column] = MIXED
        for p in range(BLOCK * BLOCK):
            a = UNOWNED if middle[0, p] > 0.0 else MISSING
            pixel_owner[here, p] = candidate[winner[p]] if winner[p] >= 0 else a
        # A thin region may own most of no block: a block stays with a region that owns a quarter of it.
        most = 0
        for i in range(1, contending):
            if owned[i] > owned[most]:
                most = i
        for i in range(contending):
            if candidate[i] == before[row, column] and 4 * owned[i] >= pixels:
                most = i
        region[row, column] = candidate[most] if contending > 0 and owned[most] > 2 else -1
