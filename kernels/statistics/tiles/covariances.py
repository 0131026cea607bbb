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


@kernel(inline=True)
def products(by_a, by_b, by_mean, aa, ab, bb, a_mean, b_mean, mean):
    """A row times the covariance of (a, b, mean)."""
    return (
        by_a * aa + by_b * ab + by_mean * a_mean,
        by_a * ab + by_b * bb + by_mean * b_mean,
        by_a * a_mean + by_b * b_mean + by_mean * mean,
    )


@kernel(reduction=True, inline=True)
def write_covariances(i, aa, ab, bb, a_mean, b_mean, mean, block):
    """Covariances of α = (a, b, c) and of (n, d), and deviations, from those of a, b and the mean inverse depth.

    With α = T(a, b, mean) and P = I - nnᵀ, dn = -d·PT(da, db, dmean) and dd = d²·nᵀT(da, db, dmean) to first order. PT
    is taken as a whole: a normal's variances may be so much smaller than those of α that no digit of them is in these.
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
    # Rows of PT, and nᵀT.
    tilt = x * x + y * y
    x_a, x_b, x_m = y * y + z * z + mean_u * x * z, mean_v * x * z - x * y, -x * z
    y_a, y_b, y_m = mean_u * y * z - x * y, x * x + z * z + mean_v * y * z, -y * z
    z_a, z_b, z_m = -x * z - mean_u * tilt, -y * z - mean_v * tilt, tilt
    d_a, d_b, d_m = x - mean_u * z, y - mean_v * z, z
    # Their products with the covariance of (a, b, mean).
    a_x, b_x, m_x = products(x_a, x_b, x_m, aa, ab, bb, a_mean, b_mean, mean)
    a_y, b_y, m_y = products(y_a, y_b, y_m, aa, ab, bb, a_mean, b_mean, mean)
    a_z, b_z, m_z = products(z_a, z_b, z_m, aa, ab, bb, a_mean, b_mean, mean)
    a_d, b_d, m_d = products(d_a, d_b, d_m, aa, ab, bb, a_mean, b_mean, mean)
    square = d * d
    cube = -square * d
    xx = square * (x_a * a_x + x_b * b_x + x_m * m_x)
    yy = square * (y_a * a_y + y_b * b_y + y_m * m_y)
    zz = square * (z_a * a_z + z_b * b_z + z_m * m_z)
    s = d_a * a_d + d_b * b_d + d_m * m_d
    # What rounding leaves of a variance that is 0.
    xx, yy, zz = max(xx, 0.0) + nothing, max(yy, 0.0) + nothing, max(zz, 0.0) + nothing
    block[PLANE, i] = xx
    block[PLANE + 1, i] = square * (x_a * a_y + x_b * b_y + x_m * m_y)
    block[PLANE + 2, i] = square * (x_a * a_z + x_b * b_z + x_m * m_z)
    block[PLANE + 3, i] = cube * (x_a * a_d + x_b * b_d + x_m * m_d)
    block[PLANE + 4, i] = yy
    block[PLANE + 5, i] = square * (y_a * a_z + y_b * b_z + y_m * m_z)
    block[PLANE + 6, i] = cube * (y_a * a_d + y_b * b_d + y_m * m_d)
    block[PLANE + 7, i] = zz
    block[PLANE + 8, i] = cube * (z_a * a_d + z_b * b_d + z_m * m_d)
    offset_variance = square * square * (max(s, 0.0) + nothing)
    block[PLANE + 9, i] = offset_variance
    block[ANGLE, i] = math.sqrt(xx + yy + zz) * (180.0 / math.pi)
    block[OFFSET, i] = math.sqrt(offset_variance)
