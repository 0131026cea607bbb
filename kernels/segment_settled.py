"""Segmentation: the blocks whose pixels go to a region without being looked at.

A block whose whole neighbourhood is one region hands its pixels to it, if its moments say that they fit; and where
no region and no plane has changed since the last round, nobody has to look again.
"""

import math

import numpy as np

from ._jit import kernel
from .segment_blocks import BLOCK, EMPTY, MIXED
from .segment_moments import add, misfit
from .segment_noise import sensor_variance

# What is around a block: its own region only, or nothing else, or other regions. SETTLED: no need to know.
OTHERS, OWN_OR_NONE, ALIKE, SETTLED = 0, 1, 2, 3
# No region, above all that there are.
NO_REGION = np.int32(np.iinfo(np.int32).max)
# A block with more measured pixels than this is a solid one.
SPARSE = BLOCK * BLOCK // 2
# Deviations by which planes may move without anything that they own being looked at again.
STILL = 0.25


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
def settle_squares(
    pyramid, offsets, shapes, level, region, around, alpha, slope_variance, spread, sigma, settled,
    owner, moments, squares,
):  # fmt: skip
    """Settle squares of blocks at once where even one block with all of their misfit would be settled.

    ``around`` becomes SETTLED for their blocks; the rest is as in `own_pixels`.
    """
    side = 1 << level
    others = float(BLOCK * BLOCK * (side * side - 1))
    for row in range(region.shape[0] // side):
        for column in range(region.shape[1] // side):
            top, left = row * side, column * side
            a = region[top, left]
            if a < 0:
                continue
            m = pyramid[:, offsets[level] + row * shapes[level, 1] + column]
            least = m[0] - others  # pixels that each block has, at least
            if least <= SPARSE:
                continue
            alike = True
            for r in range(top, top + side):
                for c in range(left, left + side):
                    alike &= around[r, c] == ALIKE
            if not alike:
                continue
            total = (sensor_variance(m[3] / m[0], sigma) + slope_variance[a]) * spread[a]
            error = misfit(m, alpha[a])
            if error <= settled * settled * least * total:
                for k in range(10):
                    moments[a, k] += m[k]
                squares[a] += max(error, 0.0) / total
                for r in range(top, top + side):
                    for c in range(left, left + side):
                        around[r, c] = SETTLED
                        owner[r, c] = a


@kernel()
def settle_unchanged(
    before, last_before, number, alpha, last_alpha, slope_variance, spread, sigma, centre_u, centre_v, moments, around
):  # fmt: skip
    """Let blocks be around which no region has changed since the last round, and no plane has moved.

    ``around`` becomes SETTLED for them; the rest is as in `own_pixels`.
    """
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
        deviation = math.sqrt(
            (sensor_variance(moments[a, 3] / moments[a, 0], sigma) + slope_variance[a]) * spread[a]
        )
        for k in range(3):
            moved[b, k] = (alpha[a, k] - last_alpha[b, k]) / deviation
    changed = np.zeros((rows + 2, columns + 2), np.int8)  # with a rim
    for row in range(rows):
        own, last, u, v, line = (
            before[row],
            last_before[row],
            centre_u[row],
            centre_v[row],
            changed[row + 1, 1:],
        )
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
def take_out(
    inverse_depth, tan_x, tan_y, pyramid, number, last_alpha, slope_variance, spread, sigma, cut, around, owner,
    pixel_owner, moments, squares,
):  # fmt: skip
    """Subtract what the blocks that are not SETTLED gave to the regions, and rename the owners of the others."""
    height, width = inverse_depth.shape
    step_y, step_x = int(tan_x.shape[0] > 1), int(tan_y.shape[1] > 1)
    rows, columns = around.shape
    for row in range(rows):
        for column in range(columns):
            b = owner[row, column]
            i = row * columns + column
            if around[row, column] == SETTLED:
                if b >= 0:
                    owner[row, column] = number[b]
                elif b == MIXED:
                    for k in range(BLOCK * BLOCK):
                        b = pixel_owner[i, k]
                        pixel_owner[i, k] = number[b] if b >= 0 else b
                continue
            m = pyramid[:, i]
            sensor = sensor_variance(m[3] / m[0], sigma)
            if b >= 0:
                a = number[b]
                if a >= 0:
                    for k in range(10):
                        moments[a, k] -= m[k]
                    total = (sensor + slope_variance[a]) * spread[a]
                    squares[a] -= max(misfit(m, last_alpha[b]), 0.0) / total
                continue
            for y in range(row * BLOCK, min(row * BLOCK + BLOCK, height)):
                for x in range(column * BLOCK, min(column * BLOCK + BLOCK, width)):
                    b = pixel_owner[i, y % BLOCK * BLOCK + x % BLOCK]
                    a = number[b] if b >= 0 else -1
                    if a < 0:
                        continue
                    u, v, q = tan_x[y * step_y, x], tan_y[y, x * step_x], inverse_depth[y, x]
                    add(moments[a], u, v, q, -1.0)
                    e = q - (last_alpha[b, 0] * u + last_alpha[b, 1] * v + last_alpha[b, 2])
                    squares[a] -= min(e * e / ((sensor + slope_variance[a]) * spread[a]), cut * cut)
