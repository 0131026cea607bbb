"""How good a plane is: the chi-square of its residual and the covariance of its coefficients.

Everything follows from a tile's moments and the noise of the inverse depth. Arrays are flat, one entry a
tile. ``counts[i]`` says which entry of the tables by number of valid pixels belongs to tile i.
"""

import math

from ._jit import kernel

# The upper tail of the normal distribution is exp(-z²/2)·t·P(t) with t = 2/(2 + z): P, lowest power first,
# interpolates SciPy's erfcx at the Chebyshev points of [0, 1]. Its relative error is below 2e-7.
TAIL_0, TAIL_1, TAIL_2 = 0.1994711528305864, 0.19946815321121372, 0.14970880095785122
TAIL_3, TAIL_4, TAIL_5 = 0.04863429921021592, -0.057593120028867975, -0.09997488775586835
TAIL_6, TAIL_7, TAIL_8 = -0.20365999696080236, 0.7432728996205819, -0.7913807918587487
TAIL_9, TAIL_10 = 0.3871027683456883, -0.0750493065385275


@kernel()
def inverse_depths(moments, reference, in_range_space, start, stop, mean, spread):
    """Mean inverse depth of each tile and the standard deviation about it, both (T,), written.

    From the moments of (X, Y, Z) they are those of Z to first order. An empty ``spread`` is left out.
    """
    for i in range(start, stop):
        w = reference[2, i] + moments[3, i] / moments[0, i]
        mean[i] = w if in_range_space else 1.0 / w
    for i in range(start, min(stop, spread.shape[0])):
        mean_w = moments[3, i] / moments[0, i]
        deviation = math.sqrt(max(moments[9, i] / moments[0, i] - mean_w * mean_w, 0.0))
        spread[i] = deviation if in_range_space else deviation * mean[i] * mean[i]


@kernel()
def residual_ratio(
    planes, rmse_metric, valid_count, mean, variance, counts, expected, freedom, ratio, inverse_freedom,
):  # fmt: skip
    """Sum of squared residuals in inverse depth over what the noise alone makes it on average.

    Parameters
    ----------
    mean, variance : (T,) float64
        Inverse depth of the tile, and the variance of one pixel's.
    expected, freedom : (K,) float64
        Expected sum of squared residuals for each count, in units of ``variance``, and its degrees of
        freedom.
    ratio, inverse_freedom : (T,) float64, written
        The ratio is NaN where there is no plane, and 0 where no residual is expected, as of three pixels.
    """
    for i in range(ratio.shape[0]):
        k = counts[i]
        # rmse_metric is d·Z̄·rmse: see ``solve.range_planes``.
        rmse = rmse_metric[i] * mean[i] / planes[i, 3]
        total = variance[i] * expected[k]
        ratio[i] = valid_count[i] * rmse * rmse / total if total > 0.0 else rmse * 0.0
        inverse_freedom[i] = 1.0 / freedom[k]


@kernel()
def mark_rough(planes, rmse_metric, valid_count, mean, variance, limit, start, stop, status, rough):
    """Give status ``rough`` to the tiles whose sum of squared residuals is above ``limit[n]·variance``."""
    for i in range(start, stop):
        rmse = rmse_metric[i] * mean[i] / planes[i, 3]
        if valid_count[i] * rmse * rmse > limit[valid_count[i]] * variance[i]:
            status[i] = rough


@kernel(reduction=True)
def chi_square_tail(ratio, inverse_freedom, p_value):
    """Probability that chi-square over its degrees of freedom exceeds ``ratio``.

    L = x^(1/6) - x^(1/3)/2 + x^(1/2)/3 is very nearly normal (Canal, "A normal approximation for the
    chi-square distribution", Computational Statistics & Data Analysis 48, 2005). For 10 degrees of freedom
    or more p is right to 1e-4, for 100 to 2e-6. Plain arithmetic without a branch, so that it vectorises.
    """
    for i in range(ratio.shape[0]):
        x = math.sqrt(min(max(ratio[i], 1e-6), 1e6))
        v = inverse_freedom[i]
        # Cube root of x by Halley's method.
        y = math.sqrt(math.sqrt(x))
        for _ in range(3):
            cube = y * y * y
            y = y * (cube + 2.0 * x) / (2.0 * cube + x)
        value = y - 0.5 * y * y + y * y * y / 3.0
        mean = 5.0 / 6.0 - v * (1.0 / 9.0 + v * (7.0 / 648.0 - v * 25.0 / 2187.0))
        variance = v * (1.0 / 18.0 + v * (1.0 / 162.0 - v * 37.0 / 11664.0))
        z = (value - mean) / math.sqrt(variance)
        size = min(abs(z), 37.0)
        # exp(-z²/2): the exponential series of a 1024th of the exponent, squared ten times.
        e = -size * size * (0.5 / 1024.0)
        e = 1.0 + e * (
            1.0 + e * (1.0 / 2.0 + e * (1.0 / 6.0 + e * (1.0 / 24.0 + e * (1.0 / 120.0 + e / 720.0))))
        )
        e = e * e
        e = e * e
        e = e * e
        e = e * e
        e = e * e
        e = e * e
        e = e * e
        e = e * e
        e = e * e
        e = e * e
        t = 2.0 / (2.0 + size)
        p = TAIL_6 + t * (TAIL_7 + t * (TAIL_8 + t * (TAIL_9 + t * TAIL_10)))
        p = TAIL_0 + t * (TAIL_1 + t * (TAIL_2 + t * (TAIL_3 + t * (TAIL_4 + t * (TAIL_5 + t * p)))))
        tail = t * e * p
        tail = tail if z > 0.0 else 1.0 - tail
        p_value[i] = tail if ratio[i] >= 0.0 else math.nan


@kernel()
def ray_covariance(moments, reference, in_range_space, tilt_variance, offset_variance, i):
    """Covariance of tile i's α, as its entries aa, ab, ac, bb, bc, cc: σq²A⁻¹ with A = MᵀM.

    In the coordinates u - ū, v - v̄ the normal equations of slopes and mean separate, and each may have a
    variance of its own. From the moments of (X, Y, Z) the scatter of the rays u = X/Z is that to first
    order: noise along the ray drops out of it.
    """
    share = 1.0 / moments[0, i]
    s_u = moments[1, i]
    s_v = moments[2, i]
    mean_u = reference[0, i] + s_u * share
    mean_v = reference[1, i] + s_v * share
    c_uu = moments[4, i] - s_u * s_u * share
    c_uv = moments[5, i] - s_u * s_v * share
    c_vv = moments[7, i] - s_v * s_v * share
    if not in_range_space:
        s_w = moments[3, i]
        c_uw = moments[6, i] - s_u * s_w * share
        c_vw = moments[8, i] - s_v * s_w * share
        c_ww = moments[9, i] - s_w * s_w * share
        nearness = 1.0 / (reference[2, i] + s_w * share)
        mean_u *= nearness
        mean_v *= nearness
        square = nearness * nearness
        c_uu = (c_uu - 2.0 * mean_u * c_uw + mean_u * mean_u * c_ww) * square
        c_uv = (c_uv - mean_u * c_vw - mean_v * c_uw + mean_u * mean_v * c_ww) * square
        c_vv = (c_vv - 2.0 * mean_v * c_vw + mean_v * mean_v * c_ww) * square
    scale = tilt_variance / (c_uu * c_vv - c_uv * c_uv)
    aa = scale * c_vv
    ab = -scale * c_uv
    bb = scale * c_uu
    ac = -(aa * mean_u + ab * mean_v)
    bc = -(ab * mean_u + bb * mean_v)
    return aa, ab, ac, bb, bc, offset_variance * share - (ac * mean_u + bc * mean_v)


@kernel()
def alpha_covariance(moments, reference, alpha, in_range_space, variance, counts, tilt, offset, covariance):
    """Covariance of α, (T, 3, 3), written; NaN where there is no plane.

    Parameters
    ----------
    variance : (T,) float64
        Of one pixel's inverse depth.
    tilt, offset : (K,) float64
        Correlated noise: the factors, by count, on the variances of the slopes and of the mean. 1 where
        pixels are independent.
    """
    for i in range(covariance.shape[0]):
        k = counts[i]
        scale = variance[i] + 0.0 * alpha[i, 0]
        aa, ab, ac, bb, bc, cc = ray_covariance(
            moments, reference, in_range_space, scale * tilt[k], scale * offset[k], i
        )
        covariance[i, 0, 0] = aa
        covariance[i, 0, 1] = ab
        covariance[i, 0, 2] = ac
        covariance[i, 1, 0] = ab
        covariance[i, 1, 1] = bb
        covariance[i, 1, 2] = bc
        covariance[i, 2, 0] = ac
        covariance[i, 2, 1] = bc
        covariance[i, 2, 2] = cc


@kernel()
def plane_covariance(moments, reference, planes, in_range_space, variance, counts, tilt, offset, covariance):
    """Covariance of (n, d), (T, 4, 4), written, from that of α to first order.

    dn = -d·P·dα and dd = d²·nᵀdα with P = I - nnᵀ, so Σn = d²PΣP, cov(n, d) = -d³PΣn, σd² = d⁴nᵀΣn.
    """
    for i in range(covariance.shape[0]):
        k = counts[i]
        x = planes[i, 0]
        y = planes[i, 1]
        z = planes[i, 2]
        d = planes[i, 3]
        scale = variance[i] * d * d
        aa, ab, ac, bb, bc, cc = ray_covariance(
            moments, reference, in_range_space, scale * tilt[k], scale * offset[k], i
        )
        # Σn, and nᵀΣn
        s_x = aa * x + ab * y + ac * z
        s_y = ab * x + bb * y + bc * z
        s_z = ac * x + bc * y + cc * z
        s = x * s_x + y * s_y + z * s_z
        # PΣP = Σ - n(Σn)ᵀ - (Σn)nᵀ + s·nnᵀ
        xy = ab - x * s_y - s_x * y + s * x * y
        xz = ac - x * s_z - s_x * z + s * x * z
        yz = bc - y * s_z - s_y * z + s * y * z
        xd = -d * (s_x - s * x)
        yd = -d * (s_y - s * y)
        zd = -d * (s_z - s * z)
        covariance[i, 0, 0] = aa - (2.0 * s_x - s * x) * x
        covariance[i, 0, 1] = xy
        covariance[i, 0, 2] = xz
        covariance[i, 0, 3] = xd
        covariance[i, 1, 0] = xy
        covariance[i, 1, 1] = bb - (2.0 * s_y - s * y) * y
        covariance[i, 1, 2] = yz
        covariance[i, 1, 3] = yd
        covariance[i, 2, 0] = xz
        covariance[i, 2, 1] = yz
        covariance[i, 2, 2] = cc - (2.0 * s_z - s * z) * z
        covariance[i, 2, 3] = zd
        covariance[i, 3, 0] = xd
        covariance[i, 3, 1] = yd
        covariance[i, 3, 2] = zd
        covariance[i, 3, 3] = d * d * s


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
