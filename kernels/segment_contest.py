"""Segmentation: the regions around a block contend for its pixels.

Where two planes are far apart, the residual averaged over the pixel and its neighbours decides; where both fit
within the noise, which is along the line in which they meet, the side of that line decides: it is the one thing
there that is free of noise.
"""

import math

import numpy as np

from ._jit import kernel
from .segment_blocks import BLOCK

SIDE = BLOCK + 2  # of a block with the pixels around it


@kernel(inline=True)
def contenders(region, row, column, centre_u, centre_v, candidate, centre):
    """The regions in the 3x3 blocks around one, and where their blocks lie: mean (u, v) of the centres.

    Returns how many.
    """
    rows, columns = region.shape
    count = 0
    for r in range(max(row - 1, 0), min(row + 2, rows)):
        for c in range(max(column - 1, 0), min(column + 2, columns)):
            a = region[r, c]
            if a < 0:
                continue
            i = 0
            while i < count and candidate[i] != a:
                i += 1
            if i == count:
                candidate[i] = a
                centre[i, :] = 0.0
                count += 1
            centre[i, 0] += centre_u[r, c]
            centre[i, 1] += centre_v[r, c]
            centre[i, 2] += 1.0
    for i in range(count):
        centre[i, 0] /= centre[i, 2]
        centre[i, 1] /= centre[i, 2]
    return count


@kernel(inline=True)
def is_undisputed(a, count, candidate, centre, alpha, tan_x, tan_y, top, left, bottom, right, distance):
    """Whether no other contender comes near to region a's plane in a block, or only beyond where they meet.

    Planes are farthest apart, and on one side of the line in which they meet, at the corners.
    """
    step_y, step_x = int(tan_x.shape[0] > 1), int(tan_y.shape[1] > 1)
    own = 0
    while candidate[own] != a:
        own += 1
    for i in range(count):
        b = candidate[i]
        if b == a:
            continue
        d_u, d_v, d_1 = alpha[b, 0] - alpha[a, 0], alpha[b, 1] - alpha[a, 1], alpha[b, 2] - alpha[a, 2]
        low, high = math.inf, -math.inf
        for y in (top, bottom - 1):
            for x in (left, right - 1):
                d = d_u * tan_x[y * step_y, x] + d_v * tan_y[y, x * step_x] + d_1
                low, high = min(low, d), max(high, d)
        side_a = d_u * centre[own, 0] + d_v * centre[own, 1] + d_1
        side_b = d_u * centre[i, 0] + d_v * centre[i, 1] + d_1
        beyond = side_a * side_b < 0.0 and (low > 0.0 if side_a > 0.0 else high < 0.0)
        if not (low > distance or high < -distance or beyond):
            return False
    return True


@kernel(inline=True)
def gather(inverse_depth, tan_x, tan_y, top, left, q, u, v):
    """Copy a block and its rim; outside the image nothing is measured."""
    height, width = inverse_depth.shape
    step_y, step_x = int(tan_x.shape[0] > 1), int(tan_y.shape[1] > 1)
    top, left = top - 1, left - 1
    if top >= 0 and left >= 0 and top + SIDE <= height and left + SIDE <= width:
        for i in range(SIDE):
            for j in range(SIDE):
                q[i * SIDE + j] = inverse_depth[top + i, left + j]
                u[i * SIDE + j] = tan_x[(top + i) * step_y, left + j]
            if step_x:
                for j in range(SIDE):
                    v[i * SIDE + j] = tan_y[top + i, left + j]
            else:
                v[i * SIDE : (i + 1) * SIDE] = tan_y[top + i, 0]
        return
    q[:] = u[:] = v[:] = 0.0
    for y in range(max(top, 0), min(top + SIDE, height)):
        for x in range(max(left, 0), min(left + SIDE, width)):
            p = (y - top) * SIDE + x - left
            q[p] = inverse_depth[y, x]
            u[p] = tan_x[y * step_y, x]
            v[p] = tan_y[y, x * step_x]


@kernel(inline=True)
def misfits(q, u, v, alpha, deviation, limit, square, within):
    """Squared residuals of a block and its rim against one plane, in variances.

    They are cut off at ``limit``, so that pixels beyond a depth jump do not outweigh the others, and 0 where
    nothing was measured. ``within`` becomes 1 for the block's pixels below the limit, 0 for the others; returns
    how many they are.
    """
    scale = np.float32(1.0 / deviation)
    a, b, c = np.float32(alpha[0]) * scale, np.float32(alpha[1]) * scale, np.float32(alpha[2]) * scale
    limit = np.float32(limit)
    for p in range(SIDE * SIDE):
        e = q[p] * scale - (a * u[p] + b * v[p] + c)
        square[p] = min(e * e, limit) if q[p] > 0.0 else np.float32(0.0)
    count = 0
    for y in range(BLOCK):
        for x in range(BLOCK):
            p = (y + 1) * SIDE + x + 1
            near = np.int32((square[p] < limit) & (q[p] > 0.0))
            within[y * BLOCK + x] = near
            count += near
    return count


@kernel(inline=True)
def take_middle(values, middle):
    """Leave out the rim around a block."""
    for y in range(BLOCK):
        for x in range(BLOCK):
            middle[y * BLOCK + x] = values[(y + 1) * SIDE + x + 1]


@kernel(inline=True)
def sums_of_nine(values, rows, sums):
    """Sums of the 3x3 around every pixel of a block; ``rows`` is room to work in."""
    for p in range(SIDE * BLOCK):
        rows[p] = values[p] + values[p + SIDE] + values[p + 2 * SIDE]
    for i in range(BLOCK):
        for j in range(BLOCK):
            p = i * SIDE + j
            sums[i * BLOCK + j] = rows[p] + rows[p + 1] + rows[p + 2]


@kernel(inline=True)
def find_lines(count, candidate, centre, alpha, line):
    """Where the planes of two contending regions meet between the regions.

    ``line`` (K, K, 4) is written for each pair i < j: the line's coefficients, positive on j's side, and 1;
    or zeros where the planes do not meet between the two.
    """
    for j in range(1, count):
        b = alpha[candidate[j]]
        for i in range(j):
            a = alpha[candidate[i]]
            d_u, d_v, d_1 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
            side_i = d_u * centre[i, 0] + d_v * centre[i, 1] + d_1
            side_j = d_u * centre[j, 0] + d_v * centre[j, 1] + d_1
            sign = 0.0
            if side_i * side_j < 0.0:
                sign = 1.0 if side_j > 0.0 else -1.0
            line[i, j, 0] = sign * d_u
            line[i, j, 1] = sign * d_v
            line[i, j, 2] = sign * d_1
            line[i, j, 3] = abs(sign)


@kernel(inline=True)
def contend(i, j, within, u, v, n, line, sums_i, sums_j, penalty_i, penalty_j, close, winner):
    """Let region ``j`` contend with region ``i`` for those pixels of a block that this one has.

    Without branches, which no processor could foresee.
    """
    meet = line[3] > 0.0
    for k in range(BLOCK * BLOCK):
        by_side = meet & (sums_i[k] < close * n[k]) & (sums_j[k] < close * n[k])
        beyond = line[0] * u[k] + line[1] * v[k] + line[2] > 0.0
        cheaper = sums_j[k] + penalty_j * n[k] < sums_i[k] + penalty_i * n[k]
        wins = (winner[k] == i) & (within[k] == 1) & ((by_side & beyond) | (cheaper & ~by_side))
        winner[k] = j if wins else winner[k]


@kernel(inline=True, reduction=True)
def add_owned(i, winner, u, v, q, square, cut, moments):
    """Add the pixels that region ``i`` has to its moments; returns the sum of their squared residuals."""
    n = s_u = s_v = s_q = s_uu = s_uv = s_uq = s_vv = s_vq = s_qq = error = 0.0
    for k in range(BLOCK * BLOCK):
        w = 1.0 if winner[k] == i else 0.0
        error += w * min(square[k], cut)
        n += w
        s_u += w * u[k]
        s_v += w * v[k]
        s_q += w * q[k]
        s_uu += w * u[k] * u[k]
        s_uv += w * u[k] * v[k]
        s_uq += w * u[k] * q[k]
        s_vv += w * v[k] * v[k]
        s_vq += w * v[k] * q[k]
        s_qq += w * q[k] * q[k]
    moments[0] += n
    moments[1] += s_u
    moments[2] += s_v
    moments[3] += s_q
    moments[4] += s_uu
    moments[5] += s_uv
    moments[6] += s_uq
    moments[7] += s_vv
    moments[8] += s_vq
    moments[9] += s_qq
    return error
