"""The covariances of the planes of a block of tiles."""

import math

from ..._jit.kernel import kernel
from ..sandwich_covariance import sandwich
from .block import (
    ALPHA,
    ANGLE,
    COMMON,
    INDEPENDENT,
    MEAN_Q,
    N_X,
    N_Y,
    N_Z,
    OF_COUNT,
    OFFSET,
    PER_PIXEL,
    PLANE,
    POWER,
    ROUNDING,
    SHARED,
    SLOPE_U,
    SLOPE_V,
    TILES_AT_ONCE,
    U_0,
    UNEVENNESS,
    V_0,
    WEIGHTED,
    D,
)

# Largest variance of ln σ over a tile that counts as small, and square of the correlation of its rays.
MOST_CHANGE, MOST_SLANTED = 0.02, 0.8


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
def sigma_slopes(falloff, room):
    """Slopes of ln σ along u and v, by the depth and by the place in the image; 0 for tiles that `of_sigma` is not for.

    These are the ones over which σ changes much, and those whose pixels lie nearly in a slanted line.
    """
    for i in range(TILES_AT_ONCE):
        u, v, nearness = room[1, i], room[2, i], room[D, i] * room[MEAN_Q, i]
        square = 1.0 + u * u + v * v
        inverse = 1.0 / (nearness * square)
        of_q, of_place = -0.5 * room[POWER, i] * square * inverse, falloff * nearness * inverse
        k_u, k_v = of_q * room[N_X, i] + of_place * u, of_q * room[N_Y, i] + of_place * v
        c_uu, c_uv, c_vv = room[4, i], room[5, i], room[7, i]
        change = (k_u * k_u * c_uu + 2.0 * k_u * k_v * c_uv + k_v * k_v * c_vv) * room[PER_PIXEL, i]
        applies = change < MOST_CHANGE and c_uv * c_uv < MOST_SLANTED * c_uu * c_vv
        room[SLOPE_U, i] = k_u if applies else 0.0
        room[SLOPE_V, i] = k_v if applies else 0.0


@kernel(inline=True)
def of_sigma(k_u, k_v, of_one, f_a, f_b, f_mean):
    """What the slopes of ln σ add to the variances of the slopes of q, to their covariance, and to those with the mean.

    An error that all pixels share is larger where σ is, and tilts the plane. ``of_one`` is the variance of the mean by
    independent errors; errors that neighbours share multiply it by ``f_mean``, and the slopes' by ``f_a`` and ``f_b``.
    Independent errors, too, have a covariance with the mean.
    """
    least = min(f_a, f_b, f_mean)
    common, both = of_one * (f_mean - least), of_one * (f_mean + least)
    return k_u * k_u * common, k_u * k_v * common, k_v * k_v * common, k_u * both, k_v * both


@kernel(reduction=True, inline=True)
def covariances(room):
    """Covariances of α, σq²A⁻¹ with A = MᵀM, and of (n, d), in rows from ALPHA and from PLANE, and deviations.

    In the coordinates u - ū, v - v̄ the normal equations of slopes and mean separate, and each may have a variance of
    its own. To first order in its changes, the slopes of ln σ say what a σ that differs over the tile makes of that.
    """
    for i in range(TILES_AT_ONCE):
        c_uu, c_uv, c_vv = room[4, i], room[5, i], room[7, i]
        nothing = 0.0 * room[D, i]  # NaN where there is no plane
        shared, independent = room[SHARED, i], room[INDEPENDENT, i] + nothing
        inverse = 1.0 / (c_uu * c_vv - c_uv * c_uv)
        k_u, k_v, of_one = room[SLOPE_U, i], room[SLOPE_V, i], shared * room[PER_PIXEL, i]
        f_a, f_b, f_mean = room[OF_COUNT + 2, i], room[OF_COUNT + 4, i], room[OF_COUNT + 5, i]
        aa, ab, bb, a_mean, b_mean = of_sigma(k_u, k_v, of_one, f_a, f_b, f_mean)
        aa += (shared * f_a + independent) * inverse * c_vv
        ab -= (shared * room[OF_COUNT + 3, i] + independent) * inverse * c_uv
        bb += (shared * f_b + independent) * inverse * c_uu
        mean = of_one * f_mean + independent * room[PER_PIXEL, i]
        write_covariances(i, aa, ab, bb, a_mean, b_mean, mean, room)


@kernel(reduction=True, inline=True)
def uneven_covariances(room, of_shape):
    """As `covariances`, where some of a tile's pixels are noisier than others: see `sandwich_covariance.sandwich`.

    Errors that neighbours share raise them by the same factors as if all variances were alike, and by what `of_sigma`
    says. If ``of_shape`` has rows, they say instead what all errors along the ray make, but for the common one of
    rounding: see OF_SHAPE.
    """
    is_known = of_shape.shape[0] > 0
    for i in range(of_shape.shape[1]):
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
        per_pixel = room[PER_PIXEL, i]
        if is_known:
            aa, ab, bb = of_shape[0, i], of_shape[1, i], of_shape[2, i]
            a_mean, b_mean, mean = of_shape[3, i], of_shape[4, i], of_shape[5, i]
            of_u, of_v, of_mean = room[COMMON, i], room[COMMON + 1, i], room[COMMON + 2, i]
            aa, ab, bb = aa + of_u * even[0], ab + math.sqrt(of_u * of_v) * even[1], bb + of_v * even[2]
            mean += of_mean * per_pixel
        else:
            of_one = shared * per_pixel
            k_u, k_v = 0.5 * room[0, i] * with_mean[0], 0.5 * room[0, i] * with_mean[1]
            aa, ab, bb, a_mean, b_mean = of_sigma(k_u, k_v, of_one, f_a, f_b, f_mean)
            aa += shared * f_a * slopes[0]
            ab += shared * room[OF_COUNT + 3, i] * slopes[1]
            bb += shared * f_b * slopes[2]
            mean = of_one * f_mean
            # Of pixels in a slanted line slopes have nearly no variance along it, and that covariance may be too large.
            explained = aa * b_mean * b_mean - 2.0 * ab * a_mean * b_mean + bb * a_mean * a_mean
            most = mean * (aa * bb - ab * ab)
            share = math.sqrt(max(most, 0.0) / explained) if explained > most else 1.0
            a_mean, b_mean = share * a_mean, share * b_mean
        aa += rounding * slopes[0] + lateral * even[0]
        ab += rounding * slopes[1] + lateral * even[1]
        bb += rounding * slopes[2] + lateral * even[2]
        a_mean += rounding * with_mean[0]
        b_mean += rounding * with_mean[1]
        mean += (rounding + lateral) * per_pixel
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
