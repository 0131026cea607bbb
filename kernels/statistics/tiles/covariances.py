"""The covariances of the planes of a block of tiles."""

import math

from ..._jit.kernel import kernel
from ..sandwich_covariance import sandwich
from .block import (
    ALPHA,
    ANGLE,
    BY_COUNT,
    COMMON,
    INDEPENDENT,
    MEAN_Q,
    N_X,
    N_Y,
    N_Z,
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
# Of rays from the moments of (X, Y, Z): below this share of what it is a difference of, a scatter is rounding, and rays
# are in one line but for rounding beyond this correlation.
ROUNDING_SHARE, MOST_CORRELATED = 2.0**-48, 1.0 - 1e-9


@kernel(reduction=True, inline=True)
def ray_scatter(in_range_space, block):
    """Mean ray and centred scatter of the rays, ū, v̄, Suu, Suv, Svv, in place of the moments.

    From the moments of (X, Y, Z) the scatter of the rays u = X/Z is taken to first order: noise along the ray drops out
    of it.
    """
    for i in range(TILES_AT_ONCE):
        per_pixel = block[PER_PIXEL, i]
        s_u = block[1, i]
        s_v = block[2, i]
        block[1, i] = block[U_0, i] + s_u * per_pixel
        block[2, i] = block[V_0, i] + s_v * per_pixel
        block[4, i] -= s_u * s_u * per_pixel
        block[5, i] -= s_u * s_v * per_pixel
        block[7, i] -= s_v * s_v * per_pixel
        if not in_range_space:
            s_w = block[3, i]
            c_uw = block[6, i] - s_u * s_w * per_pixel
            c_vw = block[8, i] - s_v * s_w * per_pixel
            c_ww = block[9, i] - s_w * s_w * per_pixel
            nearness = block[MEAN_Q, i]
            block[1, i] *= nearness
            block[2, i] *= nearness
            mean_u, mean_v = block[1, i], block[2, i]
            square = nearness * nearness
            least_u = ROUNDING_SHARE * (block[4, i] + mean_u * mean_u * c_ww)
            least_v = ROUNDING_SHARE * (block[7, i] + mean_v * mean_v * c_ww)
            c_uu = max(block[4, i] - 2.0 * mean_u * c_uw + mean_u * mean_u * c_ww, least_u)
            c_uv = block[5, i] - mean_u * c_vw - mean_v * c_uw + mean_u * mean_v * c_ww
            c_vv = max(block[7, i] - 2.0 * mean_v * c_vw + mean_v * mean_v * c_ww, least_v)
            most = MOST_CORRELATED * math.sqrt(c_uu) * math.sqrt(c_vv)
            block[4, i] = c_uu * square
            block[5, i] = min(max(c_uv, -most), most) * square
            block[7, i] = c_vv * square


@kernel(inline=True)
def sigma_slopes(falloff, block):
    """Slopes of ln σ along u and v, by the depth and by the place in the image; 0 for tiles where they do not apply.

    They don't where σ changes much over a tile, and where its pixels lie nearly in a slanted line.
    """
    for i in range(TILES_AT_ONCE):
        u, v, nearness = block[1, i], block[2, i], block[D, i] * block[MEAN_Q, i]
        square = 1.0 + u * u + v * v
        inverse = 1.0 / (nearness * square)
        by_depth, by_place = -0.5 * block[POWER, i] * square * inverse, falloff * nearness * inverse
        k_u, k_v = by_depth * block[N_X, i] + by_place * u, by_depth * block[N_Y, i] + by_place * v
        c_uu, c_uv, c_vv = block[4, i], block[5, i], block[7, i]
        change = (k_u * k_u * c_uu + 2.0 * k_u * k_v * c_uv + k_v * k_v * c_vv) * block[PER_PIXEL, i]
        applies = change < MOST_CHANGE and c_uv * c_uv < MOST_SLANTED * c_uu * c_vv
        block[SLOPE_U, i] = k_u if applies else 0.0
        block[SLOPE_V, i] = k_v if applies else 0.0


@kernel(inline=True)
def sigma_terms(k_u, k_v, mean_variance, f_a, f_b, f_mean):
    """What the slopes of ln σ add to the slopes' covariances: aa, ab, bb, and with the mean, a_mean and b_mean.

    An error that all pixels share is larger where σ is, and tilts the plane. ``mean_variance`` is the variance of the
    mean by independent errors; errors that neighbours share multiply it by ``f_mean``, and the slopes' by ``f_a`` and
    ``f_b``. Independent errors, too, have a covariance with the mean.
    """
    least = min(f_a, f_b, f_mean)
    common, both = mean_variance * (f_mean - least), mean_variance * (f_mean + least)
    return k_u * k_u * common, k_u * k_v * common, k_v * k_v * common, k_u * both, k_v * both


@kernel(reduction=True, inline=True)
def covariances(block):
    """Covariances of α, σq²A⁻¹ with A = MᵀM, and of (n, d), in rows from ALPHA and from PLANE, and deviations.

    In the coordinates u - ū, v - v̄ the normal equations of slopes and mean separate, and each may have a variance of
    its own. To first order in its changes, the slopes of ln σ say what a σ that differs over the tile makes of that.
    """
    for i in range(TILES_AT_ONCE):
        c_uu, c_uv, c_vv = block[4, i], block[5, i], block[7, i]
        nothing = 0.0 * block[D, i]  # NaN where there is no plane
        shared, independent = block[SHARED, i], block[INDEPENDENT, i] + nothing
        inverse = 1.0 / (c_uu * c_vv - c_uv * c_uv)
        k_u, k_v, mean_variance = block[SLOPE_U, i], block[SLOPE_V, i], shared * block[PER_PIXEL, i]
        f_a, f_b, f_mean = block[BY_COUNT + 2, i], block[BY_COUNT + 4, i], block[BY_COUNT + 5, i]
        aa, ab, bb, a_mean, b_mean = sigma_terms(k_u, k_v, mean_variance, f_a, f_b, f_mean)
        aa += (shared * f_a + independent) * inverse * c_vv
        ab -= (shared * block[BY_COUNT + 3, i] + independent) * inverse * c_uv
        bb += (shared * f_b + independent) * inverse * c_uu
        mean = mean_variance * f_mean + independent * block[PER_PIXEL, i]
        write_covariances(i, aa, ab, bb, a_mean, b_mean, mean, block)


@kernel(reduction=True, inline=True)
def uneven_covariances(block, shape_terms):
    """Covariances of tiles some of whose pixels are noisier than others, by the sandwich formula.

    Errors that neighbours share raise them by the same factors as if all variances were alike, and by what
    `sigma_terms` says. If ``shape_terms`` has rows, these are the covariances by all errors along the ray, but for the
    common error of rounding.
    """
    is_known = shape_terms.shape[0] > 0
    for i in range(shape_terms.shape[1]):
        if not block[UNEVENNESS, i] > 0.0:
            continue
        w = WEIGHTED
        weighted = block[w, i], block[w + 1, i], block[w + 2, i], block[w + 3, i], block[w + 4, i]
        even, slopes, with_mean = sandwich(
            block[0, i], block[1, i], block[2, i], block[4, i], block[5, i], block[7, i], weighted
        )
        shared, rounding = block[SHARED, i], block[ROUNDING, i]
        nothing = 0.0 * block[D, i]  # NaN where there is no plane
        lateral = block[INDEPENDENT, i] - rounding + nothing
        f_a, f_b, f_mean = block[BY_COUNT + 2, i], block[BY_COUNT + 4, i], block[BY_COUNT + 5, i]
        per_pixel = block[PER_PIXEL, i]
        if is_known:
            aa, ab, bb = shape_terms[0, i], shape_terms[1, i], shape_terms[2, i]
            a_mean, b_mean, mean = shape_terms[3, i], shape_terms[4, i], shape_terms[5, i]
            common_u, common_v, common_mean = block[COMMON, i], block[COMMON + 1, i], block[COMMON + 2, i]
            aa, ab, bb = aa + common_u * even[0], ab + math.sqrt(common_u * common_v) * even[1], bb + common_v * even[2]
            mean += common_mean * per_pixel
        else:
            mean_variance = shared * per_pixel
            k_u, k_v = 0.5 * block[0, i] * with_mean[0], 0.5 * block[0, i] * with_mean[1]
            aa, ab, bb, a_mean, b_mean = sigma_terms(k_u, k_v, mean_variance, f_a, f_b, f_mean)
            aa += shared * f_a * slopes[0]
            ab += shared * block[BY_COUNT + 3, i] * slopes[1]
            bb += shared * f_b * slopes[2]
            mean = mean_variance * f_mean
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
        write_covariances(i, aa, ab, bb, a_mean, b_mean, mean, block)


@kernel(reduction=True, inline=True)
def write_covariances(i, aa, ab, bb, a_mean, b_mean, mean, block):
    """Covariances of α = (a, b, c) and of (n, d), and deviations, from those of a, b and the mean inverse depth.

    For (n, d) to first order: dn = -d·P·dα and dd = d²·nᵀdα with P = I - nnᵀ, so Σn = d²PΣP, cov(n, d) = -d³PΣn,
    σd² = d⁴nᵀΣn.
    """
    mean_u, mean_v = block[1, i], block[2, i]
    x, y, z, d = block[N_X, i], block[N_Y, i], block[N_Z, i], block[D, i]
    nothing = 0.0 * d
    ac = a_mean - (aa * mean_u + ab * mean_v)
    bc = b_mean - (ab * mean_u + bb * mean_v)
    cc = mean - (a_mean * mean_u + b_mean * mean_v) - (ac * mean_u + bc * mean_v)
    block[ALPHA, i] = aa
    block[ALPHA + 1, i] = ab
    block[ALPHA + 2, i] = ac
    block[ALPHA + 3, i] = bb
    block[ALPHA + 4, i] = bc
    block[ALPHA + 5, i] = cc
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
    block[PLANE, i] = xx
    block[PLANE + 1, i] = square * (ab - x * h_y - h_x * y)
    block[PLANE + 2, i] = square * (ac - x * h_z - h_x * z)
    block[PLANE + 3, i] = cube * (s_x - s * x)
    block[PLANE + 4, i] = yy
    block[PLANE + 5, i] = square * (bc - y * h_z - h_y * z)
    block[PLANE + 6, i] = cube * (s_y - s * y)
    block[PLANE + 7, i] = zz
    block[PLANE + 8, i] = cube * (s_z - s * z)
    offset_variance = square * square * (max(s, 0.0) + nothing)
    block[PLANE + 9, i] = offset_variance
    block[ANGLE, i] = math.sqrt(xx + yy + zz) * (180.0 / math.pi)
    block[OFFSET, i] = math.sqrt(offset_variance)
