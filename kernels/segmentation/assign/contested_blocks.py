"""Segmentation: the regions around a block contend for its pixels.

Where two planes are far apart, the residual averaged over the pixel and its neighbours decides; where both fit
within the noise, which is along the line in which they meet, the side of that line decides: it is the only thing there
that is free of noise.

Blocks with one contender, with two, and with more are processed together, LANES of them: one for each lane of the
processor's vectors, pixel by pixel. So there are no branches, which no processor could predict.
"""

import math

import numpy as np

from ..._jit.kernel import kernel
from ..model.moments import difference
from ..model.records import BLOCK

NEIGHBOURS = 9  # blocks around a block, itself included, and so the regions that can contend for it
PAIRS = NEIGHBOURS * (NEIGHBOURS - 1) // 2
SIDE = BLOCK + 2  # of a block with the pixels around it
AREA = SIDE * SIDE
LANES = 64  # blocks that are processed together
ROOM = 4 * AREA + BLOCK * SIDE  # rows of ``space`` in `share_out`
LOG_2 = np.float32(math.log(2.0))
NOWHERE = np.float32(1e15)  # 1/m: inverse depth of a plane that no pixel is near


@kernel(inline="compiled")
def index_of(a, listed, count):
    """Index of a region in a list of ``count``, or ``count`` if it is not in it."""
    i = 0
    while i < count and listed[i] != a:
        i += 1
    return i


@kernel(inline="compiled")
def contenders(around, row, column, centre_u, centre_v, candidate, centre):
    """The regions in the 3x3 blocks around one, and where their blocks lie; returns their number.

    Parameters
    ----------
    around : (R + 2, C + 2) int32
        Region of each block, with a rim of none, -1.
    row, column : int
    centre_u, centre_v
        Those of `Rays`.
    candidate : (NEIGHBOURS,) int64, written
        The regions, in the order of their first blocks.
    centre : (NEIGHBOURS, 3) float64, written
        Sums of (u, v) of the centres of each one's blocks, and their number.
    """
    u_row, v_column = np.int64(centre_u.shape[0] > 1), np.int64(centre_v.shape[1] > 1)
    count = 0
    for y in range(row, row + 3):
        for x in range(column, column + 3):
            a = around[y, x]
            if a < 0:
                continue
            i = index_of(a, candidate, count)
            if i == count:
                candidate[i] = a
                centre[i, 0] = centre[i, 1] = centre[i, 2] = 0.0
                count += 1
            centre[i, 0] += centre_u[(y - 1) * u_row, x - 1]
            centre[i, 1] += centre_v[y - 1, (x - 1) * v_column]
            centre[i, 2] += 1.0
    return count


@kernel(inline="compiled")
def is_undisputed(a, count, candidate, centre, alpha, tan_x, tan_y, row, column, distance):
    """Whether no other contender comes near to region a's plane in a block, or only beyond where they meet.

    The corners decide: there planes are farthest apart, and on one side of the line in which they meet if all four are.
    """
    top, left = row * BLOCK, column * BLOCK
    bottom, right = min(top + BLOCK, tan_y.shape[0]) - 1, min(left + BLOCK, tan_x.shape[1]) - 1
    step_y, step_x = np.int64(tan_x.shape[0] > 1), np.int64(tan_y.shape[1] > 1)
    this = index_of(a, candidate, count)
    disputed = False
    for i in range(count):
        if i == this:
            continue
        d_u, d_v, d_1 = difference(alpha, candidate[i], a)
        low, high = math.inf, -math.inf
        for k in range(4):
            y, x = bottom if k > 1 else top, right if k % 2 else left
            d = d_u * tan_x[y * step_y, x] + d_v * tan_y[y, x * step_x] + d_1
            low, high = min(low, d), max(high, d)
        side_a = d_u * centre[this, 0] + d_v * centre[this, 1] + d_1 * centre[this, 2]
        side_b = d_u * centre[i, 0] + d_v * centre[i, 1] + d_1 * centre[i, 2]
        beyond = (side_a * side_b < 0.0) & (low > 0.0 if side_a > 0.0 else high < 0.0)
        disputed |= not ((low > distance) | (high < -distance) | beyond)
    return not disputed


@kernel(inline=True)
def middle(k):
    """Index of pixel ``k`` of a block within the block with its rim."""
    return (k // BLOCK + 1) * SIDE + k % BLOCK + 1


@kernel(inline="compiled")
def gather(inverse_depth, tan_x, tan_y, row, column, n, q, u, v):
    """Copy q, tanθx and tanθy of a block and its rim to lane ``n``; outside the image nothing is measured.

    ``q``, ``u`` and ``v`` (AREA, LANES) float32 are written; of tanθx only the first row, and of tanθy the first
    column, where the others are the same.
    """
    height, width = inverse_depth.shape
    separable = tan_x.shape[0] == 1 and tan_y.shape[1] == 1
    top, left = row * BLOCK - 1, column * BLOCK - 1
    if (top >= 0) & (left >= 0) & (top + SIDE <= height) & (left + SIDE <= width):  # all are, but those at the edges
        for i in range(SIDE):
            for j in range(SIDE):
                q[i * SIDE + j, n] = inverse_depth[top + i, left + j]
    else:
        for i in range(SIDE):
            y = top + i
            for j in range(SIDE):
                x = left + j
                inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
                q[i * SIDE + j, n] = inverse_depth[y, x] if inside else np.float32(0.0)
    for i in range(1 if separable else SIDE):
        y = 0 if separable else min(max(top + i, 0), height - 1)
        for j in range(SIDE):
            u[i * SIDE + j, n] = tan_x[y, min(max(left + j, 0), width - 1)]
    for i in range(SIDE):
        y = min(max(top + i, 0), height - 1)
        for j in range(1 if separable else SIDE):
            v[i * SIDE + j, n] = tan_y[y, 0 if separable else min(max(left + j, 0), width - 1)]


@kernel(inline=True)
def ray_steps(separable):
    """Rows from one row of a block to the next in an array of tanθx, and from a column to the next in one of tanθy."""
    return (0, 0) if separable else (SIDE, 1)


@kernel(inline=True)
def ray_rows(i, j, steps):
    """Where tanθx and tanθy of pixel (i, j) of a block with its rim are, by `ray_steps`."""
    return i * steps[0] + j, i * SIDE + j * steps[1]


@kernel(inline=True)
def line_between(a, b, alpha, centre, i, j):
    """The line in which the planes of two contending regions meet, where it lies between the regions.

    Rows ``i`` and ``j`` of ``centre`` are those of `contenders`. Returns the line's coefficients, positive on b's side,
    or zeros where the planes do not meet between the two.
    """
    d_u, d_v, d_1 = difference(alpha, b, a)
    side_i = d_u * centre[i, 0] + d_v * centre[i, 1] + d_1 * centre[i, 2]
    side_j = d_u * centre[j, 0] + d_v * centre[j, 1] + d_1 * centre[j, 2]
    sign = 0.0
    if side_i * side_j < 0.0:
        sign = 1.0 if side_j > 0.0 else -1.0
    return np.float32(sign * d_u), np.float32(sign * d_v), np.float32(sign * d_1)


@kernel(inline=True)
def misfits(q, u, v, steps, plane, k, limit, square):
    """Squared residuals of blocks and their rims against the planes of contender ``k``, in variances.

    They are written to rows k·AREA and following of ``square``, cut off at ``limit``, so that pixels beyond a depth
    jump do not outweigh the others, and 0 where nothing was measured. ``plane`` (4·NEIGHBOURS, LANES) holds α and 1
    over the standard deviation of each contender.
    """
    for p in range(AREA):
        x, y = ray_rows(p // SIDE, p % SIDE, steps)
        for n in range(LANES):
            e = q[p, n] - (plane[4 * k, n] * u[x, n] + plane[4 * k + 1, n] * v[y, n] + plane[4 * k + 2, n])
            e *= plane[4 * k + 3, n]
            square[k * AREA + p, n] = min(e * e, limit) if q[p, n] > 0.0 else np.float32(0.0)


@kernel(inline=True)
def sums_of_nine(values, first, sums, k, down):
    """Sums over the 3x3 around every pixel of blocks, which are with their rims in ``values`` from row ``first`` on.

    They are written to rows k·BLOCK² and following of ``sums``; ``down`` (BLOCK·SIDE, LANES) is room.
    """
    for p in range(BLOCK * SIDE):
        for n in range(LANES):
            down[p, n] = values[first + p, n] + values[first + p + SIDE, n] + values[first + p + 2 * SIDE, n]
    for i in range(BLOCK * BLOCK):
        p = middle(i) - SIDE - 1
        for n in range(LANES):
            sums[k * BLOCK * BLOCK + i, n] = down[p, n] + down[p + 1, n] + down[p + 2, n]


@kernel(inline=True)
def contend(i, j, pair, q, u, v, steps, square, line, sums, penalty, limit, close, winner):
    """Let contender ``j`` contend for the pixels that ``i`` holds.

    The first BLOCK² rows of ``sums`` hold the number of measured pixels around each pixel, the next ones the sums of
    squares of the first contender, and so on. ``winner`` (BLOCK², LANES) is changed.
    """
    for y in range(BLOCK):
        for x in range(BLOCK):
            k, p = y * BLOCK + x, (y + 1) * SIDE + x + 1
            row_u, row_v = ray_rows(y + 1, x + 1, steps)
            this, other = (i + 1) * BLOCK * BLOCK + k, (j + 1) * BLOCK * BLOCK + k
            for n in range(LANES):
                within = (square[j * AREA + p, n] < limit) & (q[p, n] > 0.0)
                a, b, c = line[3 * pair, n], line[3 * pair + 1, n], line[3 * pair + 2, n]
                meet = (a != 0.0) | (b != 0.0) | (c != 0.0)
                by_side = meet & (sums[this, n] < close * sums[k, n]) & (sums[other, n] < close * sums[k, n])
                beyond = a * u[row_u, n] + b * v[row_v, n] + c > 0.0
                cheaper = sums[other, n] + penalty[j, n] * sums[k, n] < sums[this, n] + penalty[i, n] * sums[k, n]
                wins = (winner[k, n] == i) & within & ((by_side & beyond) | (cheaper & ~by_side))
                winner[k, n] = j if wins else winner[k, n]


@kernel(inline=True)
def take_rest(j, q, square, limit, winner):
    """Give contender ``j`` the pixels within its limit that nobody has."""
    for k in range(BLOCK * BLOCK):
        p = middle(k)
        for n in range(LANES):
            wins = (winner[k, n] < 0) & (square[j * AREA + p, n] < limit) & (q[p, n] > 0.0)
            winner[k, n] = j if wins else winner[k, n]


@kernel(inline=True)
def sum_owned(k, winner, q, u, v, steps, owned, pixels):
    """Sum up the pixels that contender ``k`` has, as in `Shares`, and mark them.

    Written to rows 10·k and following of ``owned``, and row k of ``pixels``.
    """
    o = 10 * k
    for n in range(LANES):
        pixels[k, n] = 0
    for j in range(10):
        for n in range(LANES):
            owned[o + j, n] = 0.0
    for y in range(BLOCK):
        for n in range(LANES):
            s_n, s_u, s_v, s_q = owned[o, n], owned[o + 1, n], owned[o + 2, n], owned[o + 3, n]
            s_uu, s_uv, s_uq = owned[o + 4, n], owned[o + 5, n], owned[o + 6, n]
            s_vv, s_vq, s_qq = owned[o + 7, n], owned[o + 8, n], owned[o + 9, n]
            for x in range(BLOCK):  # a row at a time: sums stay in the processor's registers, and loops vectorise
                i, p = y * BLOCK + x, (y + 1) * SIDE + x + 1
                row_u, row_v = ray_rows(y + 1, x + 1, steps)
                w = 1.0 if winner[i, n] == k else 0.0
                u_p, v_p, q_p = np.float64(u[row_u, n]), np.float64(v[row_v, n]), np.float64(q[p, n])
                w_u, w_v, w_q = w * u_p, w * v_p, w * q_p
                s_n += w
                s_u += w_u
                s_v += w_v
                s_q += w_q
                s_uu += w_u * u_p
                s_uv += w_u * v_p
                s_uq += w_u * q_p
                s_vv += w_v * v_p
                s_vq += w_v * q_p
                s_qq += w_q * q_p
            owned[o, n], owned[o + 1, n], owned[o + 2, n], owned[o + 3, n] = s_n, s_u, s_v, s_q
            owned[o + 4, n], owned[o + 5, n], owned[o + 6, n] = s_uu, s_uv, s_uq
            owned[o + 7, n], owned[o + 8, n], owned[o + 9, n] = s_vv, s_vq, s_qq
    for i in range(BLOCK * BLOCK):
        for n in range(LANES):
            pixels[k, n] |= np.int32(winner[i, n] == k) << np.int32(i)


@kernel(inline=True)
def measured_pixels(q, pixels):
    """Write which pixels of the blocks are measured to the last row of ``pixels``."""
    for n in range(LANES):
        pixels[NEIGHBOURS, n] = 0
    for i in range(BLOCK * BLOCK):
        p = middle(i)
        for n in range(LANES):
            pixels[NEIGHBOURS, n] |= np.int32(q[p, n] > 0.0) << np.int32(i)


@kernel(inline=True)
def weigh_contenders(contending, variance, variance_bits, mantissa, mantissa_bits, plane, penalty):
    """Write 1 over contenders' standard deviation to ``plane``, and the logarithm of their variance to ``penalty``.

    ``variance`` (NEIGHBOURS, LANES) float32 is also seen as int32, and so is ``mantissa`` (LANES,), which is room. The
    other two are those of `share_out`. A logarithm of the library would be taken of one number after the other.
    """
    for k in range(contending):
        for n in range(LANES):
            plane[4 * k + 3, n] = np.float32(1.0) / np.sqrt(variance[k, n])
            mantissa_bits[n] = (variance_bits[k, n] & np.int32(0x7FFFFF)) | np.int32(0x3F800000)
        for n in range(LANES):
            # ln m = 2 artanh s with s = (m - 1) / (m + 1), at most 1/3, by its series: 1e-6 is left.
            s = (mantissa[n] - np.float32(1.0)) / (mantissa[n] + np.float32(1.0))
            t = s * s
            series = np.float32(1.0 / 9.0)
            series = series * t + np.float32(1.0 / 7.0)
            series = series * t + np.float32(1.0 / 5.0)
            series = series * t + np.float32(1.0 / 3.0)
            series = series * t + np.float32(1.0)
            exponent = np.float32((variance_bits[k, n] >> np.int32(23)) - np.int32(127))
            penalty[k, n] = np.float32(2.0) * s * series + exponent * LOG_2


@kernel(inline=True)
def share_out(contending, space, steps, plane, penalty, line, limit, close, square, sums, winner, owned, pixels):
    """Share out the pixels of LANES blocks among their contenders, of which each block has ``contending``.

    Parameters
    ----------
    space : (ROOM, LANES) float32
        q, tanθx and tanθy of the blocks and their rims, AREA rows each; then room.
    steps
        From `ray_steps`.
    plane, penalty, line : (4·NEIGHBOURS, LANES), (NEIGHBOURS, LANES), (3·PAIRS, LANES) float32
        α and 1 over the standard deviation of each contender, the logarithm of its variance; `line_between` every two.
    limit, close : float32
        Squares of ``reach_deviations`` and ``fit_deviations``.
    square, sums, winner
        Room for `misfits`, `sums_of_nine` and `contend`.
    owned, pixels : (10·NEIGHBOURS, LANES) float64 and (NEIGHBOURS + 1, LANES) int32, written
        From `sum_owned` and `measured_pixels`.
    """
    q, u, v, is_measured = (
        space[:AREA],
        space[AREA : 2 * AREA],
        space[2 * AREA : 3 * AREA],
        space[3 * AREA : 4 * AREA],
    )
    down = space[4 * AREA :]
    if contending > 1:
        for p in range(AREA):
            for n in range(LANES):
                is_measured[p, n] = 1.0 if q[p, n] > 0.0 else 0.0
        sums_of_nine(is_measured, 0, sums, 0, down)
    for k in range(BLOCK * BLOCK):
        for n in range(LANES):
            winner[k, n] = -1
    pair = 0
    for j in range(contending):
        misfits(q, u, v, steps, plane, j, limit, square)
        if contending > 1:
            sums_of_nine(square, j * AREA, sums, j + 1, down)
        for i in range(j):
            contend(i, j, pair, q, u, v, steps, square, line, sums, penalty, limit, close, winner)
            pair += 1
        take_rest(j, q, square, limit, winner)
    measured_pixels(q, pixels)
    for j in range(contending):
        sum_owned(j, winner, q, u, v, steps, owned, pixels)
