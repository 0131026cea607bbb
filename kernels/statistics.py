"""How good a plane is: the chi-square of its residual and the covariance of its coefficients.

Everything follows from a tile's moments and the noise of the inverse depth. Tiles come in blocks that stay in the
nearest cache, one quantity per row of a small room. All loops but those that read and write go over whole blocks,
whatever these hold, and so vectorise without a remainder.
"""

import math

import numpy as np

from . import chi_square, normal_distribution, variance_ratio
from ._jit import kernel
from .rounding import between_codes, in_common, is_left
from .sandwich import sandwich
from .solve import ROUGH
from .variances import (
    DEPTH_STEP,
    DISPARITY_STEP,
    INVERSE_FREEDOM,
    LATERAL_X,
    LATERAL_Y,
    ONE,
    SCALE,
    VARIANCES,
    means_over,
)

# Tiles of a block, and the rows of its room: moments, reference points, planes and residuals; 1/n and the mean inverse
# depth; variances; what follows from the number of pixels.
TILES_AT_ONCE = 64
U_0, V_0, W_0 = 10, 11, 12
N_X, N_Y, N_Z, D, ERROR = 13, 14, 15, 16, 17
PER_PIXEL, MEAN_Q, SHARED, INDEPENDENT = 18, 19, 20, 21
OF_COUNT, TABLE_COLUMNS = 22, 6
# What is written in the end; until then the covariances' rows are used for other things.
P, ALPHA, PLANE, ANGLE, OFFSET = 28, 29, 35, 45, 46
RATIO, ROOT = P, P + 1
POSITION, FOUND, STEP = P, P + 1, P + 2
LIMIT = P + 2
LATERAL, SPREAD = PLANE, PLANE + 3
ROUNDING, UNEVENNESS, WEIGHTED = 47, 48, 49
BETWEEN = 54
ROWS = 55
# Terms of the polynomial for the largest permitted residual.
LIMITS = 11
# Within a tile the variance of q along the ray is taken as a power of q, of at most STEEPEST: where the table is
# steeper, it jumps. The mean of the power is its series to second order, which where depths differ a hundredfold may be
# below 0: at most LARGEST_LOSS is taken off. Where the variance of this variance, relative to its squared mean, is more
# than MOST_EVEN, or that of q so large that the series might be off by what a chi-square of the tile's pixels shows
# (about 1/√n), means come from `variances.means_over` instead. Not where the squared residual is HOPELESS times what
# errors explain in the middle: such a tile crosses an edge, and is no plane by any mean.
STEEPEST = 8.0
LARGEST_LOSS = 0.5
MOST_EVEN = 0.02
HOPELESS = 64.0
# Rows of what may be known of each tile's pixels beyond their moments, as means over them. Where a lens makes rays
# differ over the image: variance of tanθx, covariance of tanθx and tanθy and variance of tanθy across the ray, in place
# of those in ``noise``. And for a part of many depths: variances of q along the ray and of rounding; how uneven their
# sum is, its root mean square over its mean; and means, weighted by that sum, of u, v, u², uv and v².
OF_LENS, OF_DEPTHS = 3, 11

# Rows of the results.
P_VALUE, ALPHA_COVARIANCE, PLANE_COVARIANCE, ANGLE_STD, OFFSET_STD = 0, 1, 10, 26, 27
RESULTS = 28
# Where in the room each of them is: a matrix's entries are kept row by row.
OF_RESULTS = np.array(
    [P]
    + [ALPHA + k for k in (0, 1, 2, 1, 3, 4, 2, 4, 5)]
    + [PLANE + k for k in (0, 1, 2, 3, 1, 4, 5, 6, 2, 5, 7, 8, 3, 6, 8, 9)]
    + [ANGLE, OFFSET]
)


@kernel(reduction=True)
def assess(
    moments, reference, planes, rmse_metric, counts, tables, in_range_space, noise, growth, of_pixels, limits, start,
    stop, status, results,
):  # fmt: skip
    """Give status ROUGH to tiles whose residual is larger than noise explains; write how uncertain the planes are.

    For tiles ``start`` to ``stop`` of N in each of F frames, counted through all frames.

    Parameters
    ----------
    moments, reference : (F, 10, N) and (F, 3, N) float64
    planes, rmse_metric : (F, 4 * N) and (F, N) float64
    counts : (F, N) integers
        Which row of ``tables`` belongs to a tile.
    tables : (K, TABLE_COLUMNS) float64
        By number of pixels. With the covariance C of errors that neighbours share, of variance 1, and the projection P
        on residuals: tr(PC), tr((PC)²), and the factors of C on the variance of the slope along x, on the covariance of
        the slopes, on the variance of the slope along y and on that of the mean inverse depth. Without rows, pixels are
        independent.
    noise : (8 or more,) float64
        See `variances.LATERAL_X`.
    growth : (2, N) float64, or (2, 0)
        Factors on the variances of q along the ray in ``noise``, at each tile's place in the image, and the variances
        of their logarithms within the tiles.
    of_pixels : (OF_LENS or OF_DEPTHS, N) float64, or without rows
        See OF_LENS.
    limits : (LIMITS,) float64
        The largest permitted sum of squared residuals over its expected value, as a polynomial in 1/√(degrees of
        freedom); with a spread of the variance, the normal deviate of the level; empty for no test.
    status : (F, N) uint8, written
    results : (F, RESULTS, N) float64, written
        P-values of the residuals, covariances of α and of (n, d), and deviations, from row P_VALUE, ALPHA_COVARIANCE,
        PLANE_COVARIANCE, ANGLE_STD (degrees) and OFFSET_STD (metres). NaN where there is no plane. Without rows, only
        the test is made.
    """
    # Allocated first: later deallocations would hide its shape from the compiler.
    room = np.empty((ROWS, TILES_AT_ONCE))
    tails = room[RATIO : RATIO + normal_distribution.WORK]
    tiles = status.shape[1]
    everything = results.shape[1] > 0
    room[BETWEEN] = 0.0
    begin = start
    while begin < stop:
        frame, first = begin // tiles, begin % tiles
        last = min(first + TILES_AT_ONCE, first + stop - begin, tiles)
        begin += last - first
        if everything:
            load(moments[frame], first, last, room, 0)
            load(reference[frame], first, last, room, U_0)
        else:  # as much as even variances need
            load(moments[frame, :1], first, last, room, 0)
            load(moments[frame, 3:4], first, last, room, 3)
            load(moments[frame, 9:], first, last, room, 9)
            load(reference[frame, 2:], first, last, room, W_0)
        load(rmse_metric[frame : frame + 1], first, last, room, ERROR)
        plane = planes[frame, 4 * first : 4 * last]
        for i in range(last - first):
            room[N_X, i] = plane[4 * i]
            room[N_Y, i] = plane[4 * i + 1]
            room[N_Z, i] = plane[4 * i + 2]
            room[D, i] = plane[4 * i + 3]
        mean_inverse_depth(in_range_space, room)
        if everything:
            ray_scatter(in_range_space, room)
        uneven = of_pixels.shape[0] == OF_DEPTHS
        if uneven:
            load(of_pixels[OF_LENS : OF_LENS + 1], first, last, room, SHARED)
            load(of_pixels[OF_LENS + 1 :], first, last, room, ROUNDING)
        else:
            pixel_variance(noise, last - first, room)
            if growth.shape[1] > 0:
                of_variance, of_logarithm = growth[0, first:last], growth[1, first:last]
                for i in range(last - first):
                    room[SHARED, i] *= of_variance[i]
                    room[UNEVENNESS, i] += of_logarithm[i]
        if of_pixels.shape[0] >= OF_LENS:
            load(of_pixels[:OF_LENS], first, last, room, LATERAL)
        independent_variance(of_pixels, noise, room)
        must_integrate = not uneven and find_uneven(room)
        has_rounding = noise[DEPTH_STEP] + noise[DISPARITY_STEP] > 0.0
        may_be_between = has_rounding and find_rounded(noise, room)
        if (must_integrate or may_be_between) and not everything:
            load(moments[frame], first, last, room, 0)
            load(reference[frame], first, last, room, U_0)
            ray_scatter(in_range_space, room)
        if must_integrate:
            uneven = True
            uneven_variance(noise, last - first, room)
            independent_variance(of_pixels, noise, room)
        if may_be_between:
            rounded_apart(noise, last - first, room)
        elif has_rounding:
            room[BETWEEN] = 0.0
        by_count(counts[frame, first:last], tables, room)
        residual_ratio(room)
        if uneven:
            uneven_freedom(room)
        if limits.shape[0] > 0:
            if noise[INVERSE_FREEDOM] > 0.0:
                variance_ratio.limits(limits[0], noise[INVERSE_FREEDOM], tails, TILES_AT_ONCE)
            else:
                for i in range(TILES_AT_ONCE):
                    limit = 0.0
                    for k in range(LIMITS - 1, -1, -1):
                        limit = limit * room[ROOT, i] + limits[k]
                    room[LIMIT, i] = limit
            mark = status[frame, first:last]
            for i in range(last - first):
                if room[RATIO, i] > room[LIMIT, i]:
                    mark[i] = ROUGH
        if everything:
            if noise[INVERSE_FREEDOM] > 0.0:
                variance_ratio.deviates(noise[INVERSE_FREEDOM], tails, TILES_AT_ONCE)
            else:
                chi_square.deviates(tails, TILES_AT_ONCE)
            normal_distribution.tails(tails, TILES_AT_ONCE)
            if has_rounding:
                rounded_alike(noise, last - first, room)
            covariances(room)
            if uneven:
                uneven_covariances(room)
            store(room, results[frame], first, last)


@kernel(inline=True)
def load(rows, first, last, room, target):
    """Copy a block of tiles of each of ``rows`` into the room, from row ``target``."""
    for entry in range(rows.shape[0]):
        row, to = rows[entry, first:last], room[target + entry]
        for i in range(last - first):
            to[i] = row[i]


@kernel(inline=True)
def store(room, results, first, last):
    """Copy the block's results to where they are kept."""
    for entry in range(RESULTS):
        row, to = room[OF_RESULTS[entry]], results[entry, first:last]
        for i in range(last - first):
            to[i] = row[i]


@kernel(inline=True)
def mean_inverse_depth(in_range_space, room):
    """Mean inverse depth of each tile of a block, and one over its number of pixels."""
    for i in range(TILES_AT_ONCE):
        per_pixel = 1.0 / room[0, i]
        room[PER_PIXEL, i] = per_pixel
        room[MEAN_Q, i] = room[W_0, i] + room[3, i] * per_pixel
    if not in_range_space:
        for i in range(TILES_AT_ONCE):
            room[MEAN_Q, i] = 1.0 / room[MEAN_Q, i]


@kernel(inline=True)
def pixel_variance(noise, count, room):
    """Variances of errors along the ray and of rounding, of the pixels of each tile of a block, and how uneven."""
    for i in range(TILES_AT_ONCE):
        mean_w = room[3, i] * room[PER_PIXEL, i]
        # Of q or, from the moments of (X, Y, Z), of Z: to first order the same share of the mean.
        spread = room[9, i] * room[PER_PIXEL, i] - mean_w * mean_w
        w = room[W_0, i] + mean_w
        room[SPREAD, i] = spread / (w * w)
    if noise.shape[0] == VARIANCES + ONE:
        for i in range(TILES_AT_ONCE):
            room[SHARED, i] = noise[VARIANCES]
            room[UNEVENNESS, i] = 0.0
    else:
        scale, last = noise[SCALE], noise.shape[0] - VARIANCES - 2.0
        for i in range(TILES_AT_ONCE):
            position = room[MEAN_Q, i] * scale
            inside = position if position > 0.0 else 0.0  # also for NaN
            inside = inside if inside < last else last
            room[SHARED, i] = np.floor(inside)
            room[POSITION, i] = position
        for i in range(count):
            k = VARIANCES + np.uintp(room[SHARED, i])
            below = noise[k]
            room[FOUND, i], room[STEP, i] = below, noise[k + ONE] - below
        for i in range(TILES_AT_ONCE):
            variance, step = room[FOUND, i], room[STEP, i]
            position = room[POSITION, i]
            variance += (position - room[SHARED, i]) * step
            # Averaged over the tile, as this power of q.
            power = min(max(position * step / max(variance, 1e-300), -STEEPEST), STEEPEST)
            more = 0.5 * power * (power - 1.0) * room[SPREAD, i]
            room[SHARED, i] = variance * (1.0 + max(more, -LARGEST_LOSS))
            spread = room[SPREAD, i]
            room[UNEVENNESS, i] = spread * max(power * power, MOST_EVEN * room[0, i] * spread)
    depth, disparity = noise[DEPTH_STEP], noise[DISPARITY_STEP]
    if depth > 0.0:
        for i in range(TILES_AT_ONCE):
            square = room[MEAN_Q, i] * room[MEAN_Q, i]
            rounding = depth * square * square
            power = 4.0 * rounding / (room[SHARED, i] + rounding + disparity)
            spread = room[SPREAD, i]
            unevenness = spread * max(power * power, MOST_EVEN * room[0, i] * spread)
            room[UNEVENNESS, i] = max(room[UNEVENNESS, i], unevenness)
            room[ROUNDING, i] = rounding + disparity
    else:
        for i in range(TILES_AT_ONCE):
            room[ROUNDING, i] = disparity


@kernel(reduction=True, inline=True)
def find_uneven(room):
    """Whether a tile of the block may differ too much in its variance; for those that do not, no UNEVENNESS."""
    number = 0.0
    for i in range(TILES_AT_ONCE):
        d, misfit = room[D, i], room[ERROR, i] * room[MEAN_Q, i]
        explained = (room[SHARED, i] + room[INDEPENDENT, i]) * d * d
        is_uneven = room[UNEVENNESS, i] > MOST_EVEN and d > 0.0 and misfit * misfit < HOPELESS * explained
        room[UNEVENNESS, i] = room[UNEVENNESS, i] if is_uneven else 0.0
        number += 1.0 if is_uneven else 0.0
    return number > 0.0


@kernel(inline=True)
def uneven_variance(noise, count, room):
    """As `pixel_variance`, for tiles that differ in it, in room as ``of_pixels`` of `assess` has it."""
    for i in range(count):
        if not room[UNEVENNESS, i] > 0.0:
            continue
        nearness, per_pixel = -1.0 / room[D, i], room[PER_PIXEL, i]
        plane = nearness * room[N_X, i], nearness * room[N_Y, i], nearness * room[N_Z, i]
        uu, uv, vv = room[4, i] * per_pixel, room[5, i] * per_pixel, room[7, i] * per_pixel
        means = means_over(plane, (room[1, i], room[2, i], uu, uv, vv), noise)
        total = means[0] + means[1]
        room[SHARED, i] = means[0]
        room[ROUNDING, i] = means[1]
        room[UNEVENNESS, i] = math.sqrt(means[2]) / total
        for k in range(5):
            room[WEIGHTED + k, i] = means[3 + k] / total


@kernel(inline=True)
def independent_variance(of_pixels, noise, room):
    """Variance of the errors that are independent: rounding, and what errors across the ray make of q."""
    x, y = noise[LATERAL_X], noise[LATERAL_Y]
    if of_pixels.shape[0] >= OF_LENS:
        for i in range(TILES_AT_ONCE):
            n_x, n_y, d = room[N_X, i], room[N_Y, i], room[D, i]
            xx, xy, yy = room[LATERAL, i], room[LATERAL + 1, i], room[LATERAL + 2, i]
            lateral = (xx * n_x * n_x + 2.0 * xy * n_x * n_y + yy * n_y * n_y) / (d * d)
            room[INDEPENDENT, i] = room[ROUNDING, i] + lateral
    elif x > 0.0:
        for i in range(TILES_AT_ONCE):
            n_x, n_y, d = room[N_X, i], room[N_Y, i], room[D, i]
            room[INDEPENDENT, i] = room[ROUNDING, i] + (x * n_x * n_x + y * n_y * n_y) / (d * d)
    else:
        for i in range(TILES_AT_ONCE):
            room[INDEPENDENT, i] = room[ROUNDING, i]


@kernel(inline=True)
def by_count(counts, tables, room):
    """What follows for each tile from its number of pixels: see ``tables`` of `assess`."""
    if tables.shape[0] == 0:
        for i in range(TILES_AT_ONCE):
            freedom = room[0, i] - 3.0
            freedom = freedom if freedom > 0.0 else 0.0
            room[OF_COUNT, i] = freedom
            room[OF_COUNT + 1, i] = freedom
            for k in range(2, TABLE_COLUMNS):
                room[OF_COUNT + k, i] = 1.0
    else:
        found = room[FOUND : FOUND + TABLE_COLUMNS].reshape(TABLE_COLUMNS * TILES_AT_ONCE)
        for i in range(counts.shape[0]):
            row = tables[np.uintp(counts[i])]
            a, b, c, d, e, f = row[0], row[1], row[2], row[3], row[4], row[5]
            found[TABLE_COLUMNS * i] = a
            found[TABLE_COLUMNS * i + 1] = b
            found[TABLE_COLUMNS * i + 2] = c
            found[TABLE_COLUMNS * i + 3] = d
            found[TABLE_COLUMNS * i + 4] = e
            found[TABLE_COLUMNS * i + 5] = f
        for i in range(TILES_AT_ONCE):
            for k in range(TABLE_COLUMNS):
                room[OF_COUNT + k, i] = found[TABLE_COLUMNS * i + k]


@kernel(inline=True)
def residual_ratio(room):
    """Sum of squared residuals over its expected value, and 1/√(degrees of freedom), into two rows of the room.

    With C and P as in `assess` and the variance a of errors that are independent, half the variance of the sum is
    tr((PC + a·P)²) = tr((PC)²) + 2a·tr(PC) + a²·tr(P).
    """
    for i in range(TILES_AT_ONCE):
        n = room[0, i]
        shared, independent = room[SHARED, i], room[INDEPENDENT, i] + room[BETWEEN, i]
        freedom = n - 3.0
        of_independent = independent * (freedom if freedom > 0.0 else 0.0)
        of_shared = shared * room[OF_COUNT, i]
        expected = of_shared + of_independent
        expected = expected if expected > 1e-150 else 1e-150
        half_variance = shared * shared * room[OF_COUNT + 1, i] + independent * (2.0 * of_shared + of_independent)
        # rmse_metric is d·Z̄·rmse: see ``solve.range_planes``. Three pixels fit exactly. One division instead of two.
        square = room[D, i] * room[D, i]
        inverse = 1.0 / (expected * square)
        error = room[ERROR, i] * room[MEAN_Q, i]
        room[RATIO, i] = (n if n > 3.0 else 0.0) * error * error * inverse
        share = inverse * square
        inverse = half_variance * share * share
        room[ROOT, i] = math.sqrt(min(max(inverse, 1e-9), 1.0 / chi_square.LEAST_FREEDOM))


@kernel(inline=True)
def uneven_freedom(room):
    """Fewer degrees of freedom where variances differ: by their mean square over the square of their mean."""
    for i in range(TILES_AT_ONCE):
        if not room[UNEVENNESS, i] > 0.0:
            continue
        share = (room[SHARED, i] + room[ROUNDING, i]) / max(room[SHARED, i] + room[INDEPENDENT, i], 1e-150)
        more = max(room[UNEVENNESS, i] * room[UNEVENNESS, i] - 1.0, 0.0) * share * share
        room[ROOT, i] = min(room[ROOT, i] * math.sqrt(1.0 + more), chi_square.LEAST_FREEDOM**-0.5)


@kernel(reduction=True, inline=True)
def ray_scatter(in_range_space, room):
    """Mean ray and centred scatter of the rays, ū, v̄, Suu, Suv, Svv, in place of the moments.

    From the moments of (X, Y, Z) the scatter of the rays u = X/Z is taken to first order: noise along the ray drops out
    of it.
    """
    for i in range(TILES_AT_ONCE):
        per_pixel = room[PER_PIXEL, i]
        s_u = room[1, i]
        s_v = room[2, i]
        room[1, i] = room[U_0, i] + s_u * per_pixel
        room[2, i] = room[V_0, i] + s_v * per_pixel
        room[4, i] -= s_u * s_u * per_pixel
        room[5, i] -= s_u * s_v * per_pixel
        room[7, i] -= s_v * s_v * per_pixel
        if not in_range_space:
            s_w = room[3, i]
            c_uw = room[6, i] - s_u * s_w * per_pixel
            c_vw = room[8, i] - s_v * s_w * per_pixel
            c_ww = room[9, i] - s_w * s_w * per_pixel
            nearness = room[MEAN_Q, i]
            room[1, i] *= nearness
            room[2, i] *= nearness
            mean_u, mean_v = room[1, i], room[2, i]
            square = nearness * nearness
            room[4, i] = (room[4, i] - 2.0 * mean_u * c_uw + mean_u * mean_u * c_ww) * square
            room[5, i] = (room[5, i] - mean_u * c_vw - mean_v * c_uw + mean_u * mean_v * c_ww) * square
            room[7, i] = (room[7, i] - 2.0 * mean_v * c_vw + mean_v * mean_v * c_ww) * square


@kernel(inline=True)
def step_square_of(noise, i, room):
    """Square of the step to which the inverse depths of tile ``i`` are rounded."""
    square = room[MEAN_Q, i] * room[MEAN_Q, i]
    return 12.0 * (noise[DEPTH_STEP] * square * square + noise[DISPARITY_STEP])


@kernel(inline=True)
def steps_across(step_square, i, room):
    """Steps that the plane of tile ``i`` spans along its two sides: evenly spread, √12 of its standard deviations."""
    scale = math.sqrt(12.0 / (step_square * room[0, i])) / room[D, i]
    u_steps = abs(room[N_X, i]) * scale * math.sqrt(max(room[4, i], 0.0))
    return u_steps, abs(room[N_Y, i]) * scale * math.sqrt(max(room[7, i], 0.0))


@kernel(reduction=True, inline=True)
def find_rounded(noise, room):
    """Whether in some tile of the block errors are so small that rounding is not independent of them."""
    number = 0.0
    for i in range(TILES_AT_ONCE):
        others = room[SHARED, i] + room[INDEPENDENT, i] - room[ROUNDING, i]
        number += 1.0 if is_left(step_square_of(noise, i, room), others) else 0.0
    return number > 0.0


@kernel(inline=True)
def rounded_apart(noise, count, room):
    """Write what rounding may add to the variance of a tile's pixels if all lie near the limit between two codes."""
    for i in range(count):
        room[BETWEEN, i] = 0.0
        step_square = step_square_of(noise, i, room)
        others = room[SHARED, i] + room[INDEPENDENT, i] - room[ROUNDING, i]
        if is_left(step_square, others):
            u_steps, v_steps = steps_across(step_square, i, room)
            room[BETWEEN, i] = between_codes(step_square, others, u_steps, v_steps)


@kernel(inline=True)
def rounded_alike(noise, count, room):
    """Add the rounding error common to all pixels of a tile to the factors on the variance that neighbours share."""
    for i in range(count):
        lateral = room[INDEPENDENT, i] - room[ROUNDING, i]
        shared = max(room[SHARED, i], 1e-60)
        step_square = step_square_of(noise, i, room)
        if not is_left(step_square, shared + lateral):
            continue
        u_steps, v_steps = steps_across(step_square, i, room)
        of_u, of_v, of_mean = in_common(step_square, shared + lateral, room[0, i], u_steps, v_steps)
        room[SHARED, i] = shared
        room[OF_COUNT + 2, i] += of_u / shared
        room[OF_COUNT + 4, i] += of_v / shared
        room[OF_COUNT + 5, i] += of_mean / shared


@kernel(reduction=True, inline=True)
def covariances(room):
    """Covariances of α, σq²A⁻¹ with A = MᵀM, and of (n, d), in rows from ALPHA and from PLANE, and deviations.

    In the coordinates u - ū, v - v̄ the normal equations of slopes and mean separate, and each may have a variance of
    its own.
    """
    for i in range(TILES_AT_ONCE):
        c_uu, c_uv, c_vv = room[4, i], room[5, i], room[7, i]
        nothing = 0.0 * room[D, i]  # NaN where there is no plane
        shared, independent = room[SHARED, i], room[INDEPENDENT, i] + nothing
        inverse = 1.0 / (c_uu * c_vv - c_uv * c_uv)
        aa = (shared * room[OF_COUNT + 2, i] + independent) * inverse * c_vv
        ab = -(shared * room[OF_COUNT + 3, i] + independent) * inverse * c_uv
        bb = (shared * room[OF_COUNT + 4, i] + independent) * inverse * c_uu
        mean = (shared * room[OF_COUNT + 5, i] + independent) * room[PER_PIXEL, i]
        write_covariances(i, aa, ab, bb, 0.0, 0.0, mean, room)


@kernel(reduction=True, inline=True)
def uneven_covariances(room):
    """As `covariances`, where some of a tile's pixels are noisier than others: see `sandwich.sandwich`.

    Errors that neighbours share raise them by the same factors as if all variances were alike.
    """
    for i in range(TILES_AT_ONCE):
        if not room[UNEVENNESS, i] > 0.0:
            continue
        w = WEIGHTED
        weighted = room[w, i], room[w + 1, i], room[w + 2, i], room[w + 3, i], room[w + 4, i]
        even, slopes, with_mean = sandwich(
            room[0, i], room[1, i], room[2, i], room[4, i], room[5, i], room[7, i], weighted
        )
        shared, rounding = room[SHARED, i], room[ROUNDING, i]
        nothing = 0.0 * room[D, i]  # NaN where there is no plane
        lateral = room[INDEPENDENT, i] - rounding + nothing
        f_a, f_b, f_mean = room[OF_COUNT + 2, i], room[OF_COUNT + 4, i], room[OF_COUNT + 5, i]
        aa = (shared * f_a + rounding) * slopes[0] + lateral * even[0]
        ab = (shared * room[OF_COUNT + 3, i] + rounding) * slopes[1] + lateral * even[1]
        bb = (shared * f_b + rounding) * slopes[2] + lateral * even[2]
        a_mean = (shared * math.sqrt(f_a * f_mean) + rounding) * with_mean[0]
        b_mean = (shared * math.sqrt(f_b * f_mean) + rounding) * with_mean[1]
        mean = (shared * f_mean + rounding + lateral) * room[PER_PIXEL, i]
        write_covariances(i, aa, ab, bb, a_mean, b_mean, mean, room)


@kernel(reduction=True, inline=True)
def write_covariances(i, aa, ab, bb, a_mean, b_mean, mean, room):
    """Covariances of α = (a, b, c) and of (n, d), and deviations, from those of a, b and the mean inverse depth.

    For (n, d) to first order: dn = -d·P·dα and dd = d²·nᵀdα with P = I - nnᵀ, so Σn = d²PΣP, cov(n, d) = -d³PΣn,
    σd² = d⁴nᵀΣn.
    """
    mean_u, mean_v = room[1, i], room[2, i]
    x, y, z, d = room[N_X, i], room[N_Y, i], room[N_Z, i], room[D, i]
    nothing = 0.0 * d
    ac = a_mean - (aa * mean_u + ab * mean_v)
    bc = b_mean - (ab * mean_u + bb * mean_v)
    cc = mean - (a_mean * mean_u + b_mean * mean_v) - (ac * mean_u + bc * mean_v)
    room[ALPHA, i] = aa
    room[ALPHA + 1, i] = ab
    room[ALPHA + 2, i] = ac
    room[ALPHA + 3, i] = bb
    room[ALPHA + 4, i] = bc
    room[ALPHA + 5, i] = cc
    # Σn and s = nᵀΣn; with h = Σn - sn/2, PΣP = Σ - nhᵀ - hnᵀ.
    s_x = aa * x + ab * y + ac * z
    s_y = ab * x + bb * y + bc * z
    s_z = ac * x + bc * y + cc * z
    s = x * s_x + y * s_y + z * s_z
    h_x = s_x - 0.5 * s * x
    h_y = s_y - 0.5 * s * y
    h_z = s_z - 0.5 * s * z
    square = d * d
    cube = -square * d
    xx = square * (aa - 2.0 * h_x * x)
    yy = square * (bb - 2.0 * h_y * y)
    zz = square * (cc - 2.0 * h_z * z)
    # What rounding leaves of a variance that is 0.
    xx, yy, zz = max(xx, 0.0) + nothing, max(yy, 0.0) + nothing, max(zz, 0.0) + nothing
    room[PLANE, i] = xx
    room[PLANE + 1, i] = square * (ab - x * h_y - h_x * y)
    room[PLANE + 2, i] = square * (ac - x * h_z - h_x * z)
    room[PLANE + 3, i] = cube * (s_x - s * x)
    room[PLANE + 4, i] = yy
    room[PLANE + 5, i] = square * (bc - y * h_z - h_y * z)
    room[PLANE + 6, i] = cube * (s_y - s * y)
    room[PLANE + 7, i] = zz
    room[PLANE + 8, i] = cube * (s_z - s * z)
    of_offset = square * square * (max(s, 0.0) + nothing)
    room[PLANE + 9, i] = of_offset
    room[ANGLE, i] = math.sqrt(xx + yy + zz) * (180.0 / math.pi)
    room[OFFSET, i] = math.sqrt(of_offset)


@kernel()
def same_plane(alpha, covariance, other_alpha, other_covariance, p_value):
    """P-value of δᵀ(Σ + Σ')⁻¹δ with δ = α - α', chi-square with 3 degrees of freedom, for K pairs.

    ``alpha`` is (K, 3), ``covariance`` (K, 3, 3), ``p_value`` (K,), written.
    """
    for k in range(alpha.shape[0]):
        x = alpha[k, 0] - other_alpha[k, 0]
        y = alpha[k, 1] - other_alpha[k, 1]
        z = alpha[k, 2] - other_alpha[k, 2]
        # Cholesky, Σ + Σ' = LLᵀ, and L⁻¹δ.
        l_11 = math.sqrt(covariance[k, 0, 0] + other_covariance[k, 0, 0])
        l_21 = (covariance[k, 0, 1] + other_covariance[k, 0, 1]) / l_11
        l_31 = (covariance[k, 0, 2] + other_covariance[k, 0, 2]) / l_11
        l_22 = math.sqrt(covariance[k, 1, 1] + other_covariance[k, 1, 1] - l_21 * l_21)
        l_32 = (covariance[k, 1, 2] + other_covariance[k, 1, 2] - l_31 * l_21) / l_22
        l_33 = math.sqrt(covariance[k, 2, 2] + other_covariance[k, 2, 2] - l_31 * l_31 - l_32 * l_32)
        a = x / l_11
        b = (y - l_21 * a) / l_22
        c = (z - l_31 * a - l_32 * b) / l_33
        half = 0.5 * (a * a + b * b + c * c)
        p_value[k] = math.erfc(math.sqrt(half)) + 2.0 * math.sqrt(half / math.pi) * math.exp(-half)
