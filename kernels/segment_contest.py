"""Segmentation: the regions around a block contend for its pixels.

Where two planes are far apart, the residual averaged over the pixel and its neighbours decides; where both fit
within the noise, which is along the line in which they meet, the side of that line decides: it is the one thing
there that is free of noise.
"""

import math

import numpy as np

from ._jit import kernel
from .segment_blocks import BLOCK
from .segment_moments import difference

NEIGHBOURS = 9  # blocks, and so the regions that can contend for one
SIDE = BLOCK + 2  # of a block with the pixels around it
WIDE = 8  # places that each of its rows takes: as many as a vector has
AREA = SIDE * WIDE


@kernel(inline=True)
def place_of(a, listed, count):
    """Where a region stands in a list of ``count``; ``count`` where it does not."""
    i = 0
    while i < count and listed[i] != a:
        i += 1
    return i


@kernel(inline=True)
def contenders(region, row, column, centre_u, centre_v, candidate, centre):
    """The regions in the 3x3 blocks around one, and where their blocks lie; returns how many.

    ``candidate`` (NEIGHBOURS,) int64 and ``centre`` (NEIGHBOURS, 3) are written, these with the sums of (u, v) of the
    blocks' centres and the number of blocks.
    """
    rows, columns = region.shape
    count = 0
    for r in range(max(row - 1, 0), min(row + 2, rows)):
        for c in range(max(column - 1, 0), min(column + 2, columns)):
            a = region[r, c]
            if a < 0:
                continue
            i = place_of(a, candidate, count)
            if i == count:
                candidate[count] = a
                centre[count, 0] = centre[count, 1] = centre[count, 2] = 0.0
                count += 1
            centre[i, 0] += centre_u[r, c]
            centre[i, 1] += centre_v[r, c]
            centre[i, 2] += 1.0
    return count


@kernel(inline=True)
def is_undisputed(a, count, candidate, centre, alpha, tan_x, tan_y, row, column, distance):
    """Whether no other contender comes near to region a's plane in a block, or only beyond where they meet.

    Planes are farthest apart, and on one side of the line in which they meet, at the corners.
    """
    top, left = row * BLOCK, column * BLOCK
    bottom, right = min(top + BLOCK, tan_y.shape[0]) - 1, min(left + BLOCK, tan_x.shape[1]) - 1
    step_y, step_x = np.int64(tan_x.shape[0] > 1), np.int64(tan_y.shape[1] > 1)
    own = place_of(a, candidate, count)
    disputed = False
    for i in range(count):
        if i == own:
            continue
        d_u, d_v, d_1 = difference(alpha, candidate[i], a)
        low, high = math.inf, -math.inf
        for k in range(4):
            y, x = bottom if k > 1 else top, right if k % 2 else left
            d = d_u * tan_x[y * step_y, x] + d_v * tan_y[y, x * step_x] + d_1
            low, high = min(low, d), max(high, d)
        side_a = d_u * centre[own, 0] + d_v * centre[own, 1] + d_1 * centre[own, 2]
        side_b = d_u * centre[i, 0] + d_v * centre[i, 1] + d_1 * centre[i, 2]
        beyond = (side_a * side_b < 0.0) & (low > 0.0 if side_a > 0.0 else high < 0.0)
        disputed |= not ((low > distance) | (high < -distance) | beyond)
    return not disputed


@kernel(inline=True)
def gather(inverse_depth, tan_x, tan_y, row, column, around):
    """Copy q, tanθx and tanθy of a block and its rim, (3, AREA); outside the image nothing is measured."""
    height, width = inverse_depth.shape
    step_y, step_x = int(tan_x.shape[0] > 1), int(tan_y.shape[1] > 1)
    top, left = row * BLOCK - 1, column * BLOCK - 1
    if top >= 0 and left >= 0 and top + SIDE <= height and left + WIDE <= width:
        for i in range(SIDE):
            for j in range(WIDE):
                around[0, i * WIDE + j] = inverse_depth[top + i, left + j]
            for j in range(WIDE):
                around[1, i * WIDE + j] = tan_x[(top + i) * step_y, left + j]
            if step_x:
                for j in range(WIDE):
                    around[2, i * WIDE + j] = tan_y[top + i, left + j]
            else:
                v = np.float32(tan_y[top + i, 0])
                for j in range(WIDE):
                    around[2, i * WIDE + j] = v
        return
    for p in range(AREA):
        around[0, p] = around[1, p] = around[2, p] = 0.0
    for y in range(max(top, 0), min(top + SIDE, height)):
        for x in range(max(left, 0), min(left + SIDE, width)):
            p = (y - top) * WIDE + x - left
            around[0, p] = inverse_depth[y, x]
            around[1, p] = tan_x[y * step_y, x]
            around[2, p] = tan_y[y, x * step_x]


@kernel(inline=True)
def misfits(around, alpha, a, deviation, limit, square, i, within):
    """Squared residuals of a block and its rim against plane ``a``, in variances, to row ``i`` of ``square``.

    They are cut off at ``limit``, so that pixels beyond a depth jump do not outweigh the others, and 0 where
    nothing was measured. ``within[i]`` becomes 1 for the block's pixels below the limit, 0 for the others; returns
    how many they are.
    """
    scale = np.float32(1.0 / deviation)
    c_u, c_v, c_1 = (
        np.float32(alpha[a, 0]) * scale,
        np.float32(alpha[a, 1]) * scale,
        np.float32(alpha[a, 2]) * scale,
    )
    for p in range(AREA):
        q = around[0, p]
        e = q * scale - (c_u * around[1, p] + c_v * around[2, p] + c_1)
        square[i, p] = min(e * e, limit) if q > 0.0 else np.float32(0.0)
    count = 0
    for y in range(BLOCK):
        for x in range(BLOCK):
            p = (y + 1) * WIDE + x + 1
            near = np.int32((square[i, p] < limit) & (around[0, p] > 0.0))
            within[i, y * BLOCK + x] = near
            count += near
    return count


@kernel(inline=True)
def take_middle(values, i, middle, j):
    """Leave out the rim around a block: from row ``i`` to row ``j``."""
    for y in range(BLOCK):
        for x in range(BLOCK):
            middle[j, y * BLOCK + x] = values[i, (y + 1) * WIDE + x + 1]


@kernel(inline=True)
def sums_of_nine(values, i, down, sums, j):
    """Sums of the 3x3 around every pixel of a block, of row ``i`` to row ``j``; ``down`` is room to work in."""
    for p in range(BLOCK * WIDE):
        down[p] = values[i, p] + values[i, p + WIDE] + values[i, p + 2 * WIDE]
    for y in range(BLOCK):
        for x in range(BLOCK):
            p = y * WIDE + x
            sums[j, y * BLOCK + x] = down[p] + down[p + 1] + down[p + 2]


@kernel(inline=True)
def line_between(i, j, candidate, centre, alpha):
    """Where the planes of two contending regions meet between the regions.

    Returns the line's coefficients, positive on j's side, or zeros where the planes do not meet between the two.
    """
    a, b = candidate[i], candidate[j]
    d_u, d_v, d_1 = difference(alpha, b, a)
    side_i = d_u * centre[i, 0] + d_v * centre[i, 1] + d_1 * centre[i, 2]
    side_j = d_u * centre[j, 0] + d_v * centre[j, 1] + d_1 * centre[j, 2]
    sign = 0.0
    if side_i * side_j < 0.0:
        sign = 1.0 if side_j > 0.0 else -1.0
    return np.float32(sign * d_u), np.float32(sign * d_v), np.float32(sign * d_1)


@kernel(inline=True)
def contend(i, j, within, middle, line_u, line_v, line_1, sums, penalty, close, winner):
    """Let region ``j`` contend with region ``i`` for those pixels of a block that this one has.

    Without branches, which no processor could foresee. The first row of ``sums`` has the measured pixels around each,
    the next one the sums of squares of the first region, and so on.
    """
    meet = (line_u != 0.0) | (line_v != 0.0) | (line_1 != 0.0)
    for k in range(BLOCK * BLOCK):
        by_side = meet & (sums[i + 1, k] < close * sums[0, k]) & (sums[j + 1, k] < close * sums[0, k])
        beyond = line_u * middle[1, k] + line_v * middle[2, k] + line_1 > 0.0
        cheaper = sums[j + 1, k] + penalty[j] * sums[0, k] < sums[i + 1, k] + penalty[i] * sums[0, k]
        wins = (winner[k] == i) & (within[j, k] == 1) & ((by_side & beyond) | (cheaper & ~by_side))
        winner[k] = j if wins else winner[k]


@kernel(inline=True, reduction=True)
def sum_owned(i, winner, middle, cut, sums, s):
    """Sum up the pixels that contender ``i`` has: to row ``s`` of ``sums``, as those of `Shares`; returns how many.

    ``middle`` (4, BLOCK²) has q, tanθx, tanθy and squared residuals, of which each counts as ``cut`` at most.
    """
    n = s_u = s_v = s_q = s_uu = s_uv = s_uq = s_vv = s_vq = s_qq = error = 0.0
    for k in range(BLOCK * BLOCK):
        w = 1.0 if winner[k] == i else 0.0
        q, u, v = middle[0, k], middle[1, k], middle[2, k]
        error += w * min(middle[3, k], cut)
        n += w
        s_u += w * u
        s_v += w * v
        s_q += w * q
        s_uu += w * u * u
        s_uv += w * u * v
        s_uq += w * u * q
        s_vv += w * v * v
        s_vq += w * v * q
        s_qq += w * q * q
    sums[s, 0], sums[s, 1], sums[s, 2], sums[s, 3], sums[s, 4], sums[s, 5] = n, s_u, s_v, s_q, s_uu, s_uv
    sums[s, 6], sums[s, 7], sums[s, 8], sums[s, 9], sums[s, 10] = s_uq, s_vv, s_vq, s_qq, error
    return np.int64(n)
