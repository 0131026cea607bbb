"""How good a plane is: the chi-square of its residual and the covariance of its coefficients.

Everything follows from a tile's moments and the noise of the inverse depth. Arrays are flat, one entry a
tile. ``counts[i]`` says which entry of the tables by number of valid pixels belongs to tile i.
"""

import math

from ._jit import kernel

# The upper tail of the normal distribution is exp(-z²/2)·t·P(t) with t = 2/(2 + z): P, lowest power first,
# interpolates SciPy's erfcx at the Chebyshev points of [0, 1]. Its relative error is below 2e-7.
TAIL_0, TAIL_1, TAIL_2, TAIL_3 = 0.1994711528305864, 0.19946815321121372, 0.14970880095785122, 0.04863429921021592
TAIL_4, TAIL_5, TAIL_6 = -0.057593120028867975, -0.09997488775586835, -0.20365999696080236
TAIL_7, TAIL_8, TAIL_9, TAIL_10 = 0.7432728996205819, -0.7913807918587487, 0.3871027683456883, -0.0750493065385275


@kernel()
def inverse_depths(moments, reference, in_range_space, start, stop, mean, spread):
    """Mean inverse depth of each tile and the standard deviation about it, both (T,), written.

    From the moments of (X, Y, Z) they are those of Z to first order.
    """
    for i in range(start, stop):
        n = moments[0, i]
        mean_w = moments[3, i] / n
        deviation = math.sqrt(max(moments[9, i] / n - mean_w * mean_w, 0.0))
        w = reference[2, i] + mean_w
        mean[i] = w if in_range_space else 1.0 / w
        spread[i] = deviation if in_range_space else deviation / (w * w)


@kernel()
def residual_ratio(planes, rmse_metric, valid_count, mean, variance, counts, expected, start, stop, ratio):
    """Sum of squared residuals in inverse depth over what the noise alone makes it on average.

    Parameters
    ----------
    mean, variance : (T,) float64
        Inverse depth of the tile, and the variance of one pixel's.
    expected : (K,) float64
        Expected sum of squared residuals for each count, in units of ``variance``.
    ratio : (T,) float64, written
        NaN where there is no plane; 0 where no residual is expected, as of three pixels.
    """
    for i in range(start, stop):
        # rmse_metric is d·Z̄·rmse: see ``solve.range_planes``.
        rmse = rmse_metric[i] * mean[i] / planes[i, 3]
        total = variance[i] * expected[counts[i]]
        ratio[i] = valid_count[i] * rmse * rmse / total if total > 0.0 else rmse * 0.0


@kernel()
def mark_rough(planes, rmse_metric, valid_count, mean, variance, limit, start, stop, status, rough):
    """Give status ``rough`` to the tiles whose sum of squared residuals is above ``limit[n]·variance``."""
    for i in range(start, stop):
        rmse = rmse_metric[i] * mean[i] / planes[i, 3]
        if valid_count[i] * rmse * rmse > limit[valid_count[i]] * variance[i]:
            status[i] = rough


@kernel(reduction=True)
def chi_square_tail(ratio, counts, freedom, p_value):
    """Probability that chi-square over its degrees of freedom exceeds ``ratio``.

    L = x^(1/6) - x^(1/3)/2 + x^(1/2)/3 is very nearly normal (Canal, "A normal approximation for the
    chi-square distribution", Computational Statistics & Data Analysis 48, 2005). For 10 degrees of freedom
    or more p is right to 1e-4, for 100 to 2e-6. Plain arithmetic without a branch, so that it vectorises.
    """
    for i in range(ratio.shape[0]):
        x = math.sqrt(min(max(ratio[i], 1e-6), 1e6))
        v = 1.0 / freedom[counts[i]]
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
        e = 1.0 + e * (1.0 + e * (1.0 / 2.0 + e * (1.0 / 6.0 + e * (1.0 / 24.0 + e * (1.0 / 120.0 + e / 720.0)))))
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
def alpha_covariance(
    moments, reference, alpha, in_range_space, variance, counts, tilt, offset, start, stop, covariance
):
    """Covariance of α: σq²A⁻¹ with A = MᵀM, written from the centred rays.

    Parameters
    ----------
    variance : (T,) float64
        Of one pixel's inverse depth.
    tilt, offset : (K,) float64
        Correlated noise: the factors, by count, on the variances of the slopes and of the mean. 1 where
        pixels are independent.
    covariance : (T, 3, 3) float64, written
        NaN where there is no plane.

    Notes
    -----
    In the coordinates u - ū, v - v̄ the normal equations of slopes and mean separate. From the moments of
    (X, Y, Z) the scatter of the rays u = X/Z is that to first order: noise along the ray drops out of it.
    """
    for i in range(start, stop):
        n = moments[0, i]
        mean_u = reference[0, i] + moments[1, i] / n
        mean_v = reference[1, i] + moments[2, i] / n
        c_uu = moments[4, i] - moments[1, i] * (moments[1, i] / n)
        c_uv = moments[5, i] - moments[1, i] * (moments[2, i] / n)
        c_vv = moments[7, i] - moments[2, i] * (moments[2, i] / n)
        if not in_range_space:
            c_uw = moments[6, i] - moments[1, i] * (moments[3, i] / n)
            c_vw = moments[8, i] - moments[2, i] * (moments[3, i] / n)
            c_ww = moments[9, i] - moments[3, i] * (moments[3, i] / n)
            mean_w = reference[2, i] + moments[3, i] / n
            mean_u /= mean_w
            mean_v /= mean_w
            c_uu = (c_uu - 2.0 * mean_u * c_uw + mean_u * mean_u * c_ww) / (mean_w * mean_w)
            c_uv = (c_uv - mean_u * c_vw - mean_v * c_uw + mean_u * mean_v * c_ww) / (mean_w * mean_w)
            c_vv = (c_vv - 2.0 * mean_v * c_vw + mean_v * mean_v * c_ww) / (mean_w * mean_w)
        nan = 0.0 * alpha[i, 0]
        scale = nan + variance[i] * tilt[counts[i]] / (c_uu * c_vv - c_uv * c_uv)
        aa = scale * c_vv
        ab = -scale * c_uv
        bb = scale * c_uu
        ac = -(aa * mean_u + ab * mean_v)
        bc = -(ab * mean_u + bb * mean_v)
        covariance[i, 0, 0] = aa
        covariance[i, 0, 1] = ab
        covariance[i, 0, 2] = ac
        covariance[i, 1, 0] = ab
        covariance[i, 1, 1] = bb
        covariance[i, 1, 2] = bc
        covariance[i, 2, 0] = ac
        covariance[i, 2, 1] = bc
        covariance[i, 2, 2] = variance[i] * offset[counts[i]] / n - (ac * mean_u + bc * mean_v)


@kernel()
def plane_covariance(planes, alpha_covariance, start, stop, covariance):
    """Covariance of (n, d) from that of α, to first order, (T, 4, 4), written.

    dn = -d·P·dα and dd = d²·nᵀdα with P = I - nnᵀ, so Σn = d²PΣP, cov(n, d) = -d³PΣn, σd² = d⁴nᵀΣn.
    """
    for i in range(start, stop):
        x = planes[i, 0]
        y = planes[i, 1]
        z = planes[i, 2]
        d = planes[i, 3]
        c = alpha_covariance[i]
        # Σn, and nᵀΣn
        s_x = c[0, 0] * x + c[0, 1] * y + c[0, 2] * z
        s_y = c[1, 0] * x + c[1, 1] * y + c[1, 2] * z
        s_z = c[2, 0] * x + c[2, 1] * y + c[2, 2] * z
        s = x * s_x + y * s_y + z * s_z
        dd = d * d
        out = covariance[i]
        # PΣP = Σ - n(Σn)ᵀ - (Σn)nᵀ + s·nnᵀ
        out[0, 0] = dd * (c[0, 0] - 2.0 * x * s_x + s * x * x)
        out[1, 1] = dd * (c[1, 1] - 2.0 * y * s_y + s * y * y)
        out[2, 2] = dd * (c[2, 2] - 2.0 * z * s_z + s * z * z)
        out[0, 1] = out[1, 0] = dd * (c[0, 1] - x * s_y - s_x * y + s * x * y)
        out[0, 2] = out[2, 0] = dd * (c[0, 2] - x * s_z - s_x * z + s * x * z)
        out[1, 2] = out[2, 1] = dd * (c[1, 2] - y * s_z - s_y * z + s * y * z)
        out[0, 3] = out[3, 0] = -dd * d * (s_x - s * x)
        out[1, 3] = out[3, 1] = -dd * d * (s_y - s * y)
        out[2, 3] = out[3, 2] = -dd * d * (s_z - s * z)
        out[3, 3] = dd * dd * s


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
def difference(alpha, covariance, first, second, statistic):
    """δᵀ(Σi + Σj)⁻¹δ of δ = αi - αj for pairs of planes: chi-square with 3 degrees of freedom.

    ``first`` and ``second`` are (K,) indices; ``statistic`` is (K,), written.
    """
    for k in range(first.shape[0]):
        i = first[k]
        j = second[k]
        x = alpha[i, 0] - alpha[j, 0]
        y = alpha[i, 1] - alpha[j, 1]
        z = alpha[i, 2] - alpha[j, 2]
        s = covariance[i] + covariance[j]
        # Cholesky, s = LLᵀ, and the norm of L⁻¹δ.
        l_11 = math.sqrt(s[0, 0])
        l_21 = s[0, 1] / l_11
        l_31 = s[0, 2] / l_11
        l_22 = math.sqrt(s[1, 1] - l_21 * l_21)
        l_32 = (s[1, 2] - l_31 * l_21) / l_22
        l_33 = math.sqrt(s[2, 2] - l_31 * l_31 - l_32 * l_32)
        a = x / l_11
        b = (y - l_21 * a) / l_22
        c = (z - l_31 * a - l_32 * b) / l_33
        statistic[k] = a * a + b * b + c * c
