"""Segmentation, third stage, with the merging in turns: every pixel goes to the plane it fits."""

import math

import numpy as np

from ._jit import kernel
from .segment_blocks import BLOCK, MIXED
from .segment_contest import (
    SIDE,
    add_owned,
    contend,
    contenders,
    find_lines,
    gather,
    is_undisputed,
    misfits,
    sums_of_nine,
    take_middle,
)
from .segment_moments import misfit
from .segment_noise import sensor_variance
from .segment_settled import (
    OTHERS,
    SETTLED,
    SPARSE,
    look_around,
    settle_squares,
    settle_unchanged,
    take_out,
)

NEIGHBOURS = 9
# Owner of a pixel: measured but nobody's; not measured.
UNOWNED, MISSING = -1, -2


@kernel()
def own_pixels(
    inverse_depth, tan_x, tan_y, centre_u, centre_v, region, alpha, slope_variance, spread, sigma,
    reach, close, settled, cut, pyramid, offsets, shapes, is_first, before, number, last_alpha,
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
        Of `segment_planes.planes`.
    sigma : see `segment_noise.sensor_variance`
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
        Whether there was no round before.
    before : (R, C) int32
        ``region`` before the last round; on return, before this one.
    number : (M,) int64
        Which of the regions each region of the last round has become, or -1.
    last_alpha : (M, 3) float64
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
            region, before, number, alpha, last_alpha, slope_variance, spread, sigma, centre_u, centre_v, moments,
            around,
        )  # fmt: skip
        take_out(
            inverse_depth, tan_x, tan_y, pyramid, number, last_alpha, slope_variance, spread, sigma, cut, around,
            owner, pixel_owner, moments, squares,
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
                        pixel_owner[row * columns + column, :] = MISSING
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
