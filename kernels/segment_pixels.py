"""Segmentation, last stage: every pixel goes to the plane it fits.

A block whose whole neighbourhood is one region hands its pixels to it. In the other blocks the regions of
the neighbourhood contend for each pixel. Where two planes are far apart, the residual averaged over the pixel
and its neighbours decides; where both fit within the noise, which is along the line in which they meet, the
side of that line decides: it is the one thing there that is free of noise.
"""

import math

import numpy as np

from ._jit import kernel
from .segment_blocks import BLOCK, EMPTY, MIXED, fit, sensor_variance, variance, waviness

NEIGHBOURS = 9
# What is around a block: its own region only, or nothing else, or other regions. SETTLED: no need to know.
OTHERS, OWN_OR_NONE, ALIKE, SETTLED = 0, 1, 2, 3
SIDE = BLOCK + 2  # of a block with the pixels around it
# Owner of a pixel: measured but nobody's; not measured.
UNOWNED, MISSING = -1, -2
# No region, above all that there are.
NO_REGION = np.int32(np.iinfo(np.int32).max)
# A block with more measured pixels than this is a solid one.
SPARSE = BLOCK * BLOCK // 2
# Deviations by which planes may move without anything that they own being looked at again.
STILL = 0.1


@kernel()
def planes(moments, sigma, lateral_x, lateral_y, growth, alpha, slope_variance, spread):
    """Plane of each region, and the part of a pixel's variance that its slope makes.

    A region without a plane gets an α of infinities, which no pixel fits.
    """
    for i in range(len(moments)):
        if not fit(moments[i], alpha[i]):
            alpha[i, :] = math.inf
            slope_variance[i] = 1.0
            spread[i] = 1.0
            continue
        spread[i] = waviness(moments[i, 0], growth) ** 2
        slope_variance[i] = variance(moments[i], alpha[i], sigma, lateral_x, lateral_y) - sensor_variance(
            moments[i, 3] / moments[i, 0], sigma
        )


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
def misfit(m, alpha):
    """Sum of squared residuals of the pixels in some moments about a given plane."""
    a, b, c = alpha[0], alpha[1], alpha[2]
    return (
        m[9] - 2.0 * (a * m[6] + b * m[8] + c * m[3])
        + a * (a * m[4] + 2.0 * (b * m[5] + c * m[1]))
        + b * (b * m[7] + 2.0 * c * m[2])
        + c * c * m[0]
    )  # fmt: skip


@kernel(inline=True)
def add(m, u, v, q, sign):
    """Add a pixel to moments, or subtract it."""
    m[0] += sign
    m[1] += sign * u
    m[2] += sign * v
    m[3] += sign * q
    m[4] += sign * u * u
    m[5] += sign * u * v
    m[6] += sign * u * q
    m[7] += sign * v * v
    m[8] += sign * v * q
    m[9] += sign * q * q


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
    before, last_before, alpha, last_alpha, slope_variance, spread, sigma, centre_u, centre_v, moments, around
):  # fmt: skip
    """Let blocks be around which no region has changed since the last round, and no plane has moved.

    ``around`` becomes SETTLED for them; the rest is as in `own_pixels`.
    """
    rows, columns = before.shape
    moved = np.zeros((len(alpha) + 1, 3))  # in deviations; the last row is for blocks of no region
    for a in range(len(alpha)):
        deviation = math.sqrt(
            (sensor_variance(moments[a, 3] / moments[a, 0], sigma) + slope_variance[a]) * spread[a]
        )
        for k in range(3):
            moved[a, k] = (alpha[a, k] - last_alpha[a, k]) / deviation
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
            a = own[c] if own[c] >= 0 else len(alpha)
            d = moved[a, 0] * u[c] + moved[a, 1] * v[c] + moved[a, 2]
            line[c] = (own[c] != last[c]) | (abs(d) > STILL)
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
    inverse_depth, tan_x, tan_y, pyramid, alpha, slope_variance, spread, sigma, cut, around, owner, pixel_owner,
    moments, squares,
):  # fmt: skip
    """Subtract what the blocks that are not SETTLED gave to the regions, whose planes then were ``alpha``."""
    height, width = inverse_depth.shape
    step_y, step_x = int(tan_x.shape[0] > 1), int(tan_y.shape[1] > 1)
    rows, columns = around.shape
    for row in range(rows):
        for column in range(columns):
            if around[row, column] == SETTLED:
                continue
            m = pyramid[:, row * columns + column]
            sensor = sensor_variance(m[3] / m[0], sigma)
            a = owner[row, column]
            if a >= 0:
                for k in range(10):
                    moments[a, k] -= m[k]
                squares[a] -= max(misfit(m, alpha[a]), 0.0) / ((sensor + slope_variance[a]) * spread[a])
                continue
            for y in range(row * BLOCK, min(row * BLOCK + BLOCK, height)):
                for x in range(column * BLOCK, min(column * BLOCK + BLOCK, width)):
                    a = pixel_owner[row * columns + column, y % BLOCK * BLOCK + x % BLOCK]
                    if a < 0:
                        continue
                    u, v, q = tan_x[y * step_y, x], tan_y[y, x * step_x], inverse_depth[y, x]
                    add(moments[a], u, v, q, -1.0)
                    e = q - (alpha[a, 0] * u + alpha[a, 1] * v + alpha[a, 2])
                    squares[a] -= min(e * e / ((sensor + slope_variance[a]) * spread[a]), cut * cut)


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


@kernel()
def own_pixels(
    inverse_depth, tan_x, tan_y, centre_u, centre_v, region, alpha, slope_variance, spread, sigma,
    reach, close, settled, cut, pyramid, offsets, shapes, is_first, before, last_alpha,
    owner, pixel_owner, moments, squares,
):  # fmt: skip
    """Give each pixel to a region, or to none, and sum the moments of what each region owns.

    Parameters
    ----------
    inverse_depth : (H, W) float32
        0 where there is no measurement.
    tan_x, tan_y : (1, W) and (H, 1), or (H, W) and (H, W) float64
    centre_u, centre_v : (R, C) float64
        tanθx, tanθy in the middle of each block.
    region : (R, C) int32
        Region of each block, or -1; a block becomes, on return, the region that owns most of its pixels.
    alpha, slope_variance, spread : (N, 3), (N,), (N,) float64
        Of `planes`.
    sigma : see `segment_blocks.sensor_variance`
    reach : float
        A region contends for a pixel within so many standard deviations of its plane.
    close : float
        Two planes meet where both fit a pixel's neighbourhood within so many standard deviations.
    settled : float
        A block without rivals goes whole to a region that fits it within so many standard deviations.
    cut : float
        Squared residuals count in ``squares`` as so many variances at most.
    pyramid, offsets, shapes
        Moments of the squares of 1, 2, 4, ... blocks: see `segment_blocks.sum_by_fours`.
    is_first : bool
        Whether the regions are others than in the round before.
    before : (R, C) int32
        ``region`` before the last round; on return, before this one.
    last_alpha : (N, 3) float64
        ``alpha`` in the last round.
    owner : (R, C) int32
        EMPTY or not; on return region that owns all measured pixels of a block, which are most; or EMPTY, or
        MIXED.
    pixel_owner : (R * C, BLOCK²) int32
        On return, of each MIXED block, the region of each pixel, or UNOWNED or MISSING.
    moments : (N, 10) float64
        After the last round, and on return.
    squares : (N,) float64
        Sum of each region's squared residuals, in variances: after the last round, and on return.
    """
    height, width = inverse_depth.shape
    rows, columns = region.shape
    limit = np.float32(reach * reach)
    close_square = np.float32(close * close)
    candidate = np.empty(NEIGHBOURS, np.int64)
    centre = np.empty((NEIGHBOURS, 3))
    square = np.empty((NEIGHBOURS, SIDE * SIDE), np.float32)
    sums = np.zeros((NEIGHBOURS, BLOCK * BLOCK), np.float32)
    penalty = np.zeros(NEIGHBOURS, np.float32)
    near = np.empty(NEIGHBOURS, np.int64)
    owned = np.empty(NEIGHBOURS, np.int64)
    line = np.zeros((NEIGHBOURS, NEIGHBOURS, 4), np.float32)
    within = np.empty((NEIGHBOURS, BLOCK * BLOCK), np.int32)
    winner = np.empty(BLOCK * BLOCK, np.int32)
    middle_q, middle_u = np.empty(BLOCK * BLOCK, np.float32), np.empty(BLOCK * BLOCK, np.float32)
    middle_v, middle_square = np.empty(BLOCK * BLOCK, np.float32), np.empty(BLOCK * BLOCK, np.float32)
    cut_square = np.float32(cut * cut)
    q, u, v, measured, room = (
        np.empty(SIDE * SIDE, np.float32), np.empty(SIDE * SIDE, np.float32), np.empty(SIDE * SIDE, np.float32),
        np.empty(SIDE * SIDE, np.float32), np.empty(SIDE * SIDE, np.float32),
    )  # fmt: skip
    n = np.zeros(BLOCK * BLOCK, np.float32)
    around = np.empty((rows, columns), np.int8)
    look_around(region, owner, around)
    if is_first:
        moments[:] = 0.0
        squares[:] = 0.0
    else:
        settle_unchanged(
            region,
            before,
            alpha,
            last_alpha,
            slope_variance,
            spread,
            sigma,
            centre_u,
            centre_v,
            moments,
            around,
        )
        take_out(
            inverse_depth, tan_x, tan_y, pyramid, last_alpha, slope_variance, spread, sigma, cut, around, owner,
            pixel_owner, moments, squares,
        )  # fmt: skip
    before[:] = region
    for level in (2, 1):
        settle_squares(
            pyramid, offsets, shapes, level, region, around, alpha, slope_variance, spread, sigma, settled,
            owner, moments, squares,
        )  # fmt: skip
    for row in range(rows):
        top = row * BLOCK
        bottom = min(top + BLOCK, height)
        for column in range(columns):
            if around[row, column] == SETTLED:
                continue
            a = before[row, column]
            m = pyramid[:, row * columns + column]
            pixels = m[0]
            left = column * BLOCK
            right = min(left + BLOCK, width)
            count = 1
            candidate[0] = a
            if around[row, column] == OTHERS:
                count = contenders(before, row, column, centre_u, centre_v, candidate, centre)
                if count == 1:
                    a = candidate[0]
            elif a < 0:
                count = 0
            sensor = sensor_variance(m[3] / pixels, sigma)
            if a >= 0:
                total = (sensor + slope_variance[a]) * spread[a]
                error = misfit(m, alpha[a])
                if error <= settled * settled * pixels * total and is_undisputed(
                    a, count, candidate, centre, alpha, tan_x, tan_y, top, left, bottom, right,
                    reach * math.sqrt(total),
                ):  # fmt: skip
                    for k in range(10):
                        moments[a, k] += m[k]
                    squares[a] += max(error, 0.0) / total
                    region[row, column] = a
                    owner[row, column] = a
                    if pixels <= SPARSE:
                        owner[row, column] = MIXED
                        for y in range(top, bottom):
                            for x in range(left, right):
                                k = (y - top) * BLOCK + x - left
                                own = a if inverse_depth[y, x] > 0.0 else MISSING
                                pixel_owner[row * columns + column, k] = own
                    continue

            gather(inverse_depth, tan_x, tan_y, top, left, q, u, v)
            take_middle(q, middle_q)
            take_middle(u, middle_u)
            take_middle(v, middle_v)
            near_count = 0
            winner[:] = -1
            for i in range(count):
                a = candidate[i]
                total = (sensor + slope_variance[a]) * spread[a]
                owned[i] = 0
                if misfits(q, u, v, alpha[a], math.sqrt(total), limit, square[i], within[i]):
                    near[near_count] = i
                    near_count += 1
                    penalty[i] = total
            if near_count > 1:
                find_lines(count, candidate, centre, alpha, line)
                for k in range(near_count):
                    i = near[k]
                    penalty[i] = math.log(penalty[i])
                    sums_of_nine(square[i], room, sums[i])
                for p in range(SIDE * SIDE):
                    measured[p] = 1.0 if q[p] > 0.0 else 0.0
                sums_of_nine(measured, room, n)
            for k in range(near_count):
                j = near[k]
                for other in range(k):
                    i = near[other]
                    contend(
                        i, j, within[j], middle_u, middle_v, n, line[i, j], sums[i], sums[j],
                        penalty[i], penalty[j], close_square, winner,
                    )  # fmt: skip
                for p in range(BLOCK * BLOCK):
                    winner[p] = j if (winner[p] < 0) & (within[j, p] == 1) else winner[p]
            for p in range(BLOCK * BLOCK):
                if winner[p] >= 0:
                    owned[winner[p]] += 1
            for k in range(near_count):
                i = near[k]
                a = candidate[i]
                if owned[i] > 0:
                    take_middle(square[i], middle_square)
                    squares[a] += add_owned(
                        i, winner, middle_u, middle_v, middle_q, middle_square, cut_square, moments[a]
                    )  # fmt: skip
            owner[row, column] = MIXED
            for p in range(BLOCK * BLOCK):
                a = UNOWNED if middle_q[p] > 0.0 else MISSING
                pixel_owner[row * columns + column, p] = candidate[winner[p]] if winner[p] >= 0 else a
            # A thin region may own most of no block: a block stays with a region that owns a quarter of it.
            most = 0
            for i in range(1, count):
                if owned[i] > owned[most]:
                    most = i
            for i in range(count):
                if candidate[i] == before[row, column] and 4 * owned[i] >= pixels:
                    most = i
            region[row, column] = candidate[most] if count > 0 and owned[most] > 2 else -1
