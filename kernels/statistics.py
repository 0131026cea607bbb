"""How good a plane is: the chi-square of its residual and the covariance of its coefficients.

Everything follows from a tile's moments and the noise of the inverse depth. Tiles come in blocks that stay in the
nearest cache, one quantity a row of a small room, and a block's arrays are slices, which begin at 0: so the loops
vectorise.
"""

import math

import numpy as np

from . import chi_square
from ._jit import kernel

# Tiles of a block, and the rows of its room: the moments and reference points, what all kernels need of them, and
# from OWN what each has of its own.
BLOCK = 64
W_0, MEAN_Q, SHARED, INDEPENDENT = 12, 13, 14, 15
OWN = 16
TAILS = OWN + 5
ROWS = TAILS + 16
# What ``noise`` holds. Of errors that are independent from pixel to pixel: variances across the ray in tanθx and
# tanθy, which count times the squared slopes of q, and of rounding in depth and in disparity. Half the squared spread
# of the variance from place to place. Then a scale and the variance of q of the other errors, at √q = 0, 1/scale,
# 2/scale, ..., linear in between and beyond, or a single one for all q.
LATERAL_X, LATERAL_Y, DEPTH_STEP, DISPARITY_STEP, HALF_SPREAD, SCALE = 0, 1, 2, 3, 4, 5
VARIANCES = np.uintp(6)
ONE = np.uintp(1)


@kernel(inline=True)
def load(rows, target, first, count, room):
    """Copy a block of tiles of each of ``rows`` into the room, from row ``target``."""
    for entry in range(rows.shape[0]):
        row = rows[entry, first : first + count]
        for i in range(count):
            room[target + entry, i] = row[i]


@kernel(inline=True)
def pixel_variance(alpha, in_range_space, noise, first, count, room):
    """Mean inverse depth of a block of tiles; the variance of its pixels' errors, and of those that are independent."""
    for i in range(count):
        w = room[W_0, i] + room[3, i] / room[0, i]
        room[MEAN_Q, i] = w if in_range_space else 1.0 / w
    if noise.shape[0] == VARIANCES + ONE:
        for i in range(count):
            room[SHARED, i] = noise[VARIANCES]
    else:
        scale, last = noise[SCALE], noise.shape[0] - VARIANCES - 2.0
        for i in range(count):
            position = math.sqrt(room[MEAN_Q, i]) * scale
            room[OWN, i] = position
            room[OWN + 1, i] = min(max(position, 0.0), last)
        for i in range(count):
            k = np.uintp(room[OWN + 1, i])
            room[OWN + 1, i] = room[OWN, i] - k
            room[OWN + 2, i] = noise[VARIANCES + k]
            room[OWN + 3, i] = noise[VARIANCES + k + ONE]
        for i in range(count):
            step = room[OWN + 3, i] - room[OWN + 2, i]
            variance = room[OWN + 2, i] + room[OWN + 1, i] * step
            # Averaged over the tile as a power of q is: this is its exponent times the variance.
            power = 0.5 * room[OWN, i] * step
            share = 1.0 / room[0, i]
            mean_w = room[3, i] * share
            w = room[W_0, i] + mean_w
            # Of q or, from the moments of (X, Y, Z), of Z: to first order the same share of the mean.
            spread = (room[9, i] * share - mean_w * mean_w) / (w * w)
            room[SHARED, i] = variance + 0.5 * power * (power / variance - 1.0) * spread
    slopes, x, y = alpha[first : first + count], noise[LATERAL_X], noise[LATERAL_Y]
    depth, disparity = noise[DEPTH_STEP], noise[DISPARITY_STEP]
    if x > 0.0 or depth > 0.0:
        for i in range(count):
            square = room[MEAN_Q, i] * room[MEAN_Q, i]
            lateral = x * slopes[i, 0] * slopes[i, 0] + y * slopes[i, 1] * slopes[i, 1]
            room[INDEPENDENT, i] = lateral + depth * square * square + disparity
    else:
        for i in range(count):
            room[INDEPENDENT, i] = disparity


@kernel(inline=True)
def residual_ratio(planes, rmse_metric, counts, half_spread, tables, first, count, room, target):
    """Sum of squared residuals over its expected value, and 1 over the degrees of freedom, into two rows of the room.

    With the covariance C of the errors that neighbours share, the variance a of those that are independent, and the
    projection P on residuals, half the variance of the sum is tr((PC + a·P)²) = tr((PC)²) + 2a·tr(PC) + a²·tr(P).

    Parameters
    ----------
    tables : (4, K) float64
        Its first rows are tr(PC) and tr((PC)²) by number of pixels, for a variance of 1.
    """
    number = counts[first : first + count]
    for i in range(count):
        k = np.uintp(number[i])
        room[target, i] = tables[0, k]
        room[target + 1, i] = tables[1, k]
    plane, error = planes[first : first + count], rmse_metric[first : first + count]
    for i in range(count):
        n = room[0, i]
        shared, independent = room[SHARED, i], room[INDEPENDENT, i]
        of_shared, of_independent = shared * room[target, i], independent * max(n - 3.0, 0.0)
        expected = max(of_shared + of_independent, 1e-150)
        half_variance = shared * shared * room[target + 1, i] + independent * (
            2.0 * of_shared + of_independent
        )
        # rmse_metric is d·Z̄·rmse: see ``solve.range_planes``. Three pixels fit exactly.
        rmse = error[i] * room[MEAN_Q, i] / plane[i, 3]
        share = 1.0 / expected
        room[target, i] = (n if n > 3.0 else 0.0) * rmse * rmse * share
        inverse = half_variance * share * share + half_spread
        room[target + 1, i] = min(max(inverse, 1e-9), 1.0 / chi_square.LEAST_FREEDOM)


@kernel()
def mark_rough(
    moments, reference, planes, alpha, rmse_metric, counts, in_range_space, noise, tables, limits, start, stop,
    status, rough,
):  # fmt: skip
    """Give status ``rough`` to the tiles whose sum of squared residuals is larger than noise explains.

    Of tiles ``start`` to ``stop`` of a frame: arrays are (10, T), (3, T), (T, 4), (T, 3), (T,), (T,).

    Parameters
    ----------
    counts, noise, tables
        As in `uncertainty`.
    limits : (K,) float64
        The largest permitted sum over its expected value, by powers of 1/√(degrees of freedom).
    """
    room = np.empty((ROWS, BLOCK))
    for first in range(start, stop, BLOCK):
        count = min(BLOCK, stop - first)
        load(moments[:1], 0, first, count, room)
        load(moments[3:4], 3, first, count, room)
        load(moments[9:], 9, first, count, room)
        load(reference[2:], W_0, first, count, room)
        pixel_variance(alpha, in_range_space, noise, first, count, room)
        residual_ratio(planes, rmse_metric, counts, noise[HALF_SPREAD], tables, first, count, room, OWN)
        for i in range(count):
            room[OWN + 1, i] = math.sqrt(room[OWN + 1, i])
            room[OWN + 2, i] = 0.0
        for k in range(limits.shape[0] - 1, -1, -1):
            limit = limits[k]
            for i in range(count):
                room[OWN + 2, i] = room[OWN + 2, i] * room[OWN + 1, i] + limit
        mark = status[first : first + count]
        for i in range(count):
            if room[OWN, i] > room[OWN + 2, i]:
                mark[i] = rough


# Rows of the results.
P_VALUE, ALPHA_COVARIANCE, PLANE_COVARIANCE, ANGLE_STD, OFFSET_STD = 0, 1, 10, 26, 27
RESULTS = 28
# A covariance's entries are kept as the rows of a matrix: where in the block's room each is.
ALPHA = TAILS
OF_ALPHA = ALPHA + np.array([0, 1, 2, 1, 3, 4, 2, 4, 5])
PLANE = ALPHA + 6
OF_PLANE = PLANE + np.array([0, 1, 2, 3, 1, 4, 5, 6, 2, 5, 7, 8, 3, 6, 8, 9])


@kernel()
def uncertainty(
    moments, reference, planes, alpha, rmse_metric, counts, tables, in_range_space, noise, results
):  # fmt: skip
    """P-values of the residuals, covariances of α and of (n, d), and deviations of the tiles of F frames.

    All are NaN where there is no plane.

    Parameters
    ----------
    moments, reference : (F, 10, T) and (F, 3, T) float64
    planes, alpha, rmse_metric : (F, T, 4), (F, T, 3), (F, T) float64
    counts : (F, T) integers
        Which column of ``tables`` belongs to a tile.
    tables : (4, K) float64
        By number of pixels: the first two as in `residual_ratio`; the factors of correlated noise on the variances of
        the slopes and of the mean inverse depth, 1 where pixels are independent.
    noise : (5 or more,) float64
        See LATERAL_X.
    results : (F, RESULTS, T) float64, written
        From row P_VALUE, ALPHA_COVARIANCE, PLANE_COVARIANCE, ANGLE_STD (degrees) and OFFSET_STD (metres).
    """
    room = np.empty((ROWS, BLOCK))
    tails = room[TAILS : TAILS + chi_square.WORK]
    for frame in range(moments.shape[0]):
        for first in range(0, moments.shape[2], BLOCK):
            stop = min(first + BLOCK, moments.shape[2])
            count = stop - first
            load(moments[frame], 0, first, count, room)
            load(reference[frame], 10, first, count, room)
            pixel_variance(alpha[frame], in_range_space, noise, first, count, room)
            residual_ratio(
                planes[frame], rmse_metric[frame], counts[frame], noise[HALF_SPREAD], tables, first, count, room,
                TAILS,
            )  # fmt: skip
            chi_square.tails(tails, count)
            store(tails[0], results[frame, P_VALUE, first:stop])

            ray_scatter(in_range_space, count, room)
            # The moments but for n are done with: their rows take what is needed next.
            plane, number = planes[frame, first:stop], counts[frame, first:stop]
            for i in range(count):
                k = np.uintp(number[i])
                room[1, i] = tables[2, k]
                room[2, i] = tables[3, k]
            for i in range(count):
                room[3, i] = plane[i, 0]
                room[4, i] = plane[i, 1]
                room[5, i] = plane[i, 2]
                room[6, i] = plane[i, 3]
            covariances(count, room)
            for entry in range(9):
                store(room[OF_ALPHA[entry]], results[frame, ALPHA_COVARIANCE + entry, first:stop])
            for entry in range(16):
                store(room[OF_PLANE[entry]], results[frame, PLANE_COVARIANCE + entry, first:stop])
            store(room[7], results[frame, ANGLE_STD, first:stop])
            store(room[8], results[frame, OFFSET_STD, first:stop])


@kernel(inline=True)
def store(row, target):
    """Copy the beginning of a row of the room to where it is kept."""
    for i in range(target.shape[0]):
        target[i] = row[i]


@kernel(inline=True)
def ray_scatter(in_range_space, count, room):
    """Mean ray and centred scatter of the rays of a block: ū, v̄, Suu, Suv, Svv, into rows from OWN.

    From the moments of (X, Y, Z) the scatter of the rays u = X/Z is that to first order: noise along the ray drops
    out of it.
    """
    for i in range(count):
        share = 1.0 / room[0, i]
        s_u = room[1, i]
        s_v = room[2, i]
        mean_u = room[10, i] + s_u * share
        mean_v = room[11, i] + s_v * share
        c_uu = room[4, i] - s_u * s_u * share
        c_uv = room[5, i] - s_u * s_v * share
        c_vv = room[7, i] - s_v * s_v * share
        if not in_range_space:
            s_w = room[3, i]
            c_uw = room[6, i] - s_u * s_w * share
            c_vw = room[8, i] - s_v * s_w * share
            c_ww = room[9, i] - s_w * s_w * share
            nearness = room[MEAN_Q, i]
            mean_u *= nearness
            mean_v *= nearness
            square = nearness * nearness
            c_uu = (c_uu - 2.0 * mean_u * c_uw + mean_u * mean_u * c_ww) * square
            c_uv = (c_uv - mean_u * c_vw - mean_v * c_uw + mean_u * mean_v * c_ww) * square
            c_vv = (c_vv - 2.0 * mean_v * c_vw + mean_v * mean_v * c_ww) * square
        room[OWN, i] = mean_u
        room[OWN + 1, i] = mean_v
        room[OWN + 2, i] = c_uu
        room[OWN + 3, i] = c_uv
        room[OWN + 4, i] = c_vv


@kernel(inline=True)
def covariances(count, room):
    """Covariances of α, σq²A⁻¹ with A = MᵀM, and of (n, d), in rows from ALPHA and from PLANE; deviations in 7 and 8.

    In the coordinates u - ū, v - v̄ the normal equations of slopes (factor in row 1) and mean (in row 2) separate, and
    each may have a variance of its own. The planes are in rows 3 to 6. Of (n, d) to first order: dn = -d·P·dα and
    dd = d²·nᵀdα with P = I - nnᵀ, so Σn = d²PΣP, cov(n, d) = -d³PΣn, σd² = d⁴nᵀΣn.
    """
    for i in range(count):
        mean_u, mean_v = room[OWN, i], room[OWN + 1, i]
        c_uu, c_uv, c_vv = room[OWN + 2, i], room[OWN + 3, i], room[OWN + 4, i]
        x, y, z, d = room[3, i], room[4, i], room[5, i], room[6, i]
        nothing = 0.0 * d  # NaN where there is no plane
        shared, independent = room[SHARED, i], room[INDEPENDENT, i] + nothing
        scale = (shared * room[1, i] + independent) / (c_uu * c_vv - c_uv * c_uv)
        aa = scale * c_vv
        ab = -scale * c_uv
        bb = scale * c_uu
        ac = -(aa * mean_u + ab * mean_v)
        bc = -(ab * mean_u + bb * mean_v)
        cc = (shared * room[2, i] + independent) / room[0, i] - (ac * mean_u + bc * mean_v)
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
        room[PLANE, i] = xx
        room[PLANE + 1, i] = square * (ab - x * h_y - h_x * y)
        room[PLANE + 2, i] = square * (ac - x * h_z - h_x * z)
        room[PLANE + 3, i] = cube * (s_x - s * x)
        room[PLANE + 4, i] = yy
        room[PLANE + 5, i] = square * (bc - y * h_z - h_y * z)
        room[PLANE + 6, i] = cube * (s_y - s * y)
        room[PLANE + 7, i] = zz
        room[PLANE + 8, i] = cube * (s_z - s * z)
        room[PLANE + 9, i] = square * square * s
        room[7, i] = math.sqrt(max(xx + yy + zz, 0.0)) * (180.0 / math.pi) + nothing
        room[8, i] = square * math.sqrt(max(s, 0.0)) + nothing


@kernel()
def add_moments(moments, reference, labels, totals, total_reference):
    """Moments of every union of tiles: label k's into column k - 1, label 0 is left out.

    Each tile's moments are shifted to the union's reference point, which is exact, and added.

    Parameters
    ----------
    labels : (T,) int32
    totals : (10, N) float64, written
    total_reference : (3, N) float64
        The reference points of the unions.
    """
    totals[:] = 0.0
    for i in range(labels.shape[0]):
        k = labels[i] - 1
        n = moments[0, i]
        if k < 0 or not n > 0.0:
            continue
        du = reference[0, i] - total_reference[0, k]
        dv = reference[1, i] - total_reference[1, k]
        dw = reference[2, i] - total_reference[2, k]
        s_u = moments[1, i]
        s_v = moments[2, i]
        s_w = moments[3, i]
        totals[0, k] += n
        totals[1, k] += s_u + n * du
        totals[2, k] += s_v + n * dv
        totals[3, k] += s_w + n * dw
        totals[4, k] += moments[4, i] + du * (2.0 * s_u + n * du)
        totals[5, k] += moments[5, i] + du * s_v + dv * s_u + n * du * dv
        totals[6, k] += moments[6, i] + du * s_w + dw * s_u + n * du * dw
        totals[7, k] += moments[7, i] + dv * (2.0 * s_v + n * dv)
        totals[8, k] += moments[8, i] + dv * s_w + dw * s_v + n * dv * dw
        totals[9, k] += moments[9, i] + dw * (2.0 * s_w + n * dw)


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
