"""Segmentation: the blocks whose pixels go to a region without being looked at.

A block whose whole neighbourhood is one region hands its pixels to it, if its moments say that they fit; and where
no region and no plane has changed since the last round, nobody has to look again.
"""

import math

import numpy as np

from ._jit import kernel
from .segment_blocks import BLOCK, EMPTY, MISSING, MIXED, UNSEEN
from .segment_contest import NEIGHBOURS, contenders, find_centres, is_undisputed
from .segment_moments import misfit
from .segment_noise import about_plane, in_square, sensor_variance

# What is around a block: its own region only, or nothing else, or other regions. SETTLED: no need to know.
OTHERS, OWN_OR_NONE, ALIKE, SETTLED = 0, 1, 2, 3
# No region, above all that there are.
NO_REGION = np.int32(np.iinfo(np.int32).max)
# A block with more measured pixels than this is a solid one.
SPARSE = BLOCK * BLOCK // 2
# Deviations by which planes may move without anything that they own being looked at again.
STILL = 0.25
# New owner of a block, before it is known; and where its pixels are contested.
UNDECIDED, CONTESTED = -1, -2


@kernel()
def look_around(region, owner, around):
    """Compare every block's region with its eight neighbours': ALIKE, OWN_OR_NONE or OTHERS; EMPTY is SETTLED."""
    rows, columns = region.shape
    for row in range(rows):
        for c in range(columns):
            around[row, c] = SETTLED if owner[row, c] == EMPTY else OTHERS
    least, most, lowest = (
        np.empty(columns, np.int32),
        np.empty(columns, np.int32),
        np.empty(columns, np.int32),
    )
    for row in range(1, rows - 1):
        for c in range(columns):
            a, b, d = region[row - 1, c], region[row, c], region[row + 1, c]
            most[c] = max(a, b, d)
            least[c] = min(a, b, d)
            lowest[c] = min(
                a if a >= 0 else NO_REGION, b if b >= 0 else NO_REGION, d if d >= 0 else NO_REGION
            )
        for c in range(1, columns - 1):
            a = region[row, c]
            high = max(most[c - 1], most[c], most[c + 1])
            alike = high == min(least[c - 1], least[c], least[c + 1])
            own_or_none = (high == a) & (a == min(lowest[c - 1], lowest[c], lowest[c + 1]))
            if around[row, c] == OTHERS:
                around[row, c] = ALIKE if alike else OWN_OR_NONE if own_or_none else OTHERS


@kernel()
def settle_unchanged(before, last_before, number, planes, last_alpha, sigma, rays, moments, around):
    """Let blocks be around which no region has changed since the last round, and no plane has moved.

    ``around`` becomes SETTLED for them; the rest is as in `segment_pixels.own_pixels`.
    """
    alpha, centre_u, centre_v = planes.alpha, rays.centre_u, rays.centre_v
    rows, columns = before.shape
    regions = len(number)
    became = np.empty(regions + 1, np.int32)  # the last row is for blocks of no region
    became[regions] = -1
    moved = np.zeros((regions + 1, 3))  # in deviations
    for b in range(regions):
        a = number[b]
        became[b] = a
        if a < 0:
            continue
        sensor = sensor_variance(moments[a, 3] / moments[a, 0], sigma)
        deviation = math.sqrt(about_plane(sensor, planes, a))
        for k in range(3):
            moved[b, k] = (alpha[a, k] - last_alpha[b, k]) / deviation
    changed = np.zeros((rows + 2, columns + 2), np.int8)  # with a rim
    for row in range(rows):
        own, last, u, v = before[row], last_before[row], centre_u[row], centre_v[row]
        line = changed[row + 1, 1:]
        for c in range(columns):
            b = last[c] if last[c] >= 0 else regions
            d = moved[b, 0] * u[c] + moved[b, 1] * v[c] + moved[b, 2]
            line[c] = (own[c] != became[b]) | (abs(d) > STILL)
    nearby = np.empty(columns + 2, np.int8)
    for row in range(rows):
        above, here, below, line = changed[row], changed[row + 1], changed[row + 2], around[row]
        for c in range(columns + 2):
            nearby[c] = above[c] | here[c] | below[c]
        left, right = nearby[1:], nearby[2:]
        for c in range(columns):
            line[c] = line[c] if nearby[c] | left[c] | right[c] else SETTLED


@kernel()
def rename_owners(around, number, owners):
    """Give the owners of SETTLED blocks the ``number`` that they have become since the last round."""
    owner, pixel_owner = owners
    for row in range(around.shape[0]):
        for column in range(around.shape[1]):
            if around[row, column] != SETTLED:
                continue
            b = owner[row, column]
            if b >= 0:
                owner[row, column] = number[b]
            elif b == MIXED:
                i = row * around.shape[1] + column
                for k in range(BLOCK * BLOCK):
                    b = pixel_owner[i, k]
                    pixel_owner[i, k] = number[b] if b >= 0 else b


@kernel()
def settle_squares(
    pyramid, level, region, planes, sigma, settled, number, around, owner, sums, block, count
):  # fmt: skip
    """Settle squares of blocks at once where even one block with all of their misfit would be settled.

    ``around`` becomes SETTLED for their blocks. They get their owner if they had none or the same; others are
    added to the first ``count`` of ``block``, see `decide`. Returns how many there are then.
    """
    of_square, alpha = pyramid.moments, planes.alpha
    moments, squares = sums
    first, across = pyramid.offsets[level], pyramid.shapes[level, 1]
    side = 1 << level
    others = float(BLOCK * BLOCK * (side * side - 1))
    for row in range(region.shape[0] // side):
        for column in range(region.shape[1] // side):
            top, left = row * side, column * side
            a = region[top, left]
            if a < 0:
                continue
            i = first + row * across + column
            pixels = of_square[0, i]
            least = pixels - others  # pixels that each block has, at least
            if least <= SPARSE:
                continue
            alike = True
            for r in range(top, top + side):
                for c in range(left, left + side):
                    alike &= around[r, c] == ALIKE
            if not alike:
                continue
            sensor = sensor_variance(of_square[3, i] / pixels, sigma)
            total = in_square(sensor, planes, a, i)
            error = misfit(of_square, i, alpha, a)
            if error > settled * settled * least * total:
                continue
            is_first = owner[top, left] == UNSEEN
            if is_first:
                for k in range(10):
                    moments[a, k] += of_square[k, i]
                squares[a] += max(error, 0.0) / total
            for r in range(top, top + side):
                for c in range(left, left + side):
                    around[r, c] = SETTLED
                    b = owner[r, c]
                    if is_first or (b >= 0 and number[b] == a):
                        owner[r, c] = a
                    else:
                        block[count, 0], block[count, 1], block[count, 2] = r, c, a
                        count += 1
    return count


@kernel()
def list_unsettled(around, block, count):
    """Add the blocks that are not SETTLED to the first ``count`` of ``block``, to decide; returns how many."""
    for row in range(around.shape[0]):
        for column in range(around.shape[1]):
            block[count, 0], block[count, 1], block[count, 2] = row, column, UNDECIDED
            count += 1 if around[row, column] != SETTLED else 0
    return count


@kernel()
def decide(block, count, rays, region, around, pyramid, planes, sigma, rules):
    """Which blocks fit a region that no other contends for.

    ``block`` (K, 3) int32 has the row, the column and the new owner of ``count`` blocks; where this is UNDECIDED
    it becomes such a region, or CONTESTED. The rest is as in `segment_pixels.own_pixels`.
    """
    centre_u, centre_v = rays.centre_u, rays.centre_v
    of_block, alpha = pyramid.moments, planes.alpha
    settled_square = rules.settled * rules.settled
    columns = region.shape[1]
    candidate, centre = np.empty(NEIGHBOURS, np.int64), np.empty((NEIGHBOURS, 3))
    for k in range(count):
        if block[k, 2] != UNDECIDED:
            continue
        block[k, 2] = CONTESTED
        row, column = block[k, 0], block[k, 1]
        i = row * columns + column
        a = region[row, column]
        contending = 1
        if around[row, column] == OTHERS:
            contending = contenders(region, row, column, candidate)
            if contending == 1:
                a = candidate[0]
        if a < 0:
            continue
        pixels = of_block[0, i]
        sensor = sensor_variance(of_block[3, i] / pixels, sigma)
        total = in_square(sensor, planes, a, i)
        if misfit(of_block, i, alpha, a) > settled_square * pixels * total:
            continue
        if contending > 1:
            find_centres(region, row, column, centre_u, centre_v, contending, candidate, centre)
            distance = rules.reach * math.sqrt(total)
            if not is_undisputed(a, contending, candidate, centre, alpha, rays, row, column, distance):
                continue
        block[k, 2] = a


@kernel()
def settle(block, count, inverse_depth, pyramid, planes, sigma, region, owners, sums):
    """Give the blocks whose owner is decided to it; the CONTESTED move to the front: returns how many."""
    of_block, alpha = pyramid.moments, planes.alpha
    owner, pixel_owner = owners
    moments, squares = sums
    height, width = inverse_depth.shape
    contested = 0
    for k in range(count):
        row, column, a = block[k, 0], block[k, 1], block[k, 2]
        if a == CONTESTED:
            block[contested, 0], block[contested, 1] = row, column
            contested += 1
            continue
        region[row, column] = a
        if owner[row, column] == a:
            continue
        i = row * region.shape[1] + column
        pixels = of_block[0, i]
        sensor = sensor_variance(of_block[3, i] / pixels, sigma)
        for j in range(10):
            moments[a, j] += of_block[j, i]
        error = max(misfit(of_block, i, alpha, a), 0.0)
        squares[a] += error / in_square(sensor, planes, a, i)
        owner[row, column] = a
        if pixels <= SPARSE:
            owner[row, column] = MIXED
            for j in range(BLOCK * BLOCK):
                y, x = row * BLOCK + j // BLOCK, column * BLOCK + j % BLOCK
                measured = y < height and x < width and inverse_depth[y, x] > 0.0
                pixel_owner[i, j] = a if measured else MISSING
    return contested
