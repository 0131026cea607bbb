"""How good quadratic surfaces of tiles are: p-values, covariances, and whether noise explains their curvature.

With A = LLᵀ, the coefficients of L⁻¹φ have the covariance I·σ² under independent noise. Errors that neighbours share
make a matrix F of it, which a table has by the number of pixels. Everything else follows: Cov β = L⁻ᵀFL⁻¹, the sum of
squares that the three terms of second order explain, and the curvatures' deviations by their gradients.
"""

import math

import numpy as np

from .._jit.kernel import kernel
from ..moments.surface_tiles import UU, VV, N, U, V
from ..solvers.curvatures import gaussian_curvature, mean_curvature, principal_pair, principal_steps, tangent_distance
from ..solvers.methods import ROUGH
from .distributions import chi_square, f_ratio, normal
from .noise_variances import (
    DEPTH_STEP,
    INVERSE_FREEDOM,
    LATERAL_X,
    LATERAL_Y,
    PLACES,
    VARIANCES,
    WEIGHTS,
    rounding_at,
    variance_at,
)

# Columns of a table: with the covariance C of errors of variance 1 and the projection P on residuals, tr(PC) and
# tr((PC)²); then F, row by row.
EXPECTED, HALF_VARIANCE, SHAPE = 0, 1, 2
SURFACE_TABLE = SHAPE + 36

# Rows of the results.
P_VALUE, P_FLAT, MEAN_STD, GAUSSIAN_STD, FIRST_STD, SECOND_STD, DIRECTION_STD = range(7)
COVARIANCE = 7
SURFACE_RESULTS = COVARIANCE + 36

BLOCK = 64
EVENLY = 180.0 / math.sqrt(12.0)  # degrees: standard deviation of directions that are spread evenly
# The matrix of the sums: which moment is at row j and column k.
SUMS = np.array([
    (0, 1, 2, 3, 4, 5),
    (1, 3, 4, 6, 7, 8),
    (2, 4, 5, 7, 8, 9),
    (3, 6, 7, 10, 11, 12),
    (4, 7, 8, 11, 12, 13),
    (5, 8, 9, 12, 13, 14),
])  # fmt: skip


@kernel(inline=True)
def pixel_variances(moments, beta, i, centre_u, centre_v, noise, growth):
    """Mean variances of q over a tile, by its surface: of errors along the ray, and of rounding.

    At Gauss's nine places of a rectangle with the scatter of the valid pixels' rays.
    """
    if noise.shape[0] == VARIANCES + 1 and not noise[DEPTH_STEP] > 0.0:
        return variance_at(beta[0], noise) * growth, rounding_at(beta[0], noise)
    per_pixel = 1.0 / moments[N, i]
    mean_u, mean_v = moments[U, i] * per_pixel, moments[V, i] * per_pixel
    side_u = math.sqrt(max(moments[UU, i] * per_pixel - mean_u * mean_u, 0.0))
    side_v = math.sqrt(max(moments[VV, i] * per_pixel - mean_v * mean_v, 0.0))
    along = rounding = 0.0
    for j in range(3):
        u = mean_u + PLACES[j] * side_u
        for k in range(3):
            v = mean_v + PLACES[k] * side_v
            q = beta[0] + beta[1] * u + beta[2] * v + (beta[3] * u + beta[4] * v) * u + beta[5] * v * v
            q = max(q, 0.0)
            along += WEIGHTS[j] * WEIGHTS[k] * variance_at(q, noise)
            rounding += WEIGHTS[j] * WEIGHTS[k] * rounding_at(q, noise)
    return along * growth, rounding


@kernel(inline=True)
def lateral_variance(beta, i, noise, lens):
    """Mean variance of q by errors across the ray, by the slopes at the central ray."""
    a, b = beta[1], beta[2]
    if lens.shape[0] > 0:
        return lens[0, i] * a * a + 2.0 * lens[1, i] * a * b + lens[2, i] * b * b
    return noise[LATERAL_X] * a * a + noise[LATERAL_Y] * b * b


@kernel(reduction=True, inline=True)
def write_tails(inverse_freedom, work, count):
    """Turn ratios to expected values and one over degrees of freedom, rows 0 and 1, into probabilities, row 0."""
    if inverse_freedom > 0.0:
        f_ratio.deviates(inverse_freedom, work, count)
    else:
        for i in range(count):
            work[1, i] = math.sqrt(work[1, i])
        chi_square.deviates(work, count)
    normal.tails(work, count)


@kernel()
def assess_surfaces(
    moments, coefficients, rmse, index, tables, centre, noise, growth, lens, level, start, stop, status, p_value
):  # fmt: skip
    """Write p-values of tiles ``start`` to ``stop`` of a frame, and ROUGH where they are below a level.

    Parameters
    ----------
    moments : (SURFACE_SUMS, T) float64
    coefficients : (6 * T,) float64
    rmse : (T,) float64
    index : (T,) int
        Which row of ``tables`` belongs to a tile.
    tables : (K, SURFACE_TABLE) float64, or without rows where pixels are independent
    centre : (2, T) float64
    noise : (8 or more,) float64
        See `noise_variances.LATERAL_X`.
    growth : (2, T) or (2, 0) float64
        Factors on the variances along the ray, at each tile's place in the image.
    lens : (3, T) or (0, T) float64
        Variance of tanθx, covariance and variance of tanθy across the ray, where a lens makes them differ.
    level : float
    status, p_value : (T,), changed and written
    """
    work = np.empty((normal.WORK, BLOCK))
    for first in range(start, stop, BLOCK):
        count = min(BLOCK, stop - first)
        for k in range(BLOCK):
            work[0, k], work[1, k] = math.nan, 1.0
        for k in range(count):
            i = first + k
            beta = coefficients[6 * i : 6 * i + 6]
            n = moments[N, i]
            if not rmse[i] >= 0.0:
                continue
            grown = growth[0, i] if growth.shape[1] > 0 else 1.0
            along, rounding = pixel_variances(moments, beta, i, centre[0, i], centre[1, i], noise, grown)
            alone = rounding + lateral_variance(beta, i, noise, lens)
            freedom = max(n - 6.0, 0.0)
            shared_part = half = freedom
            if tables.shape[0] > 0:
                shared_part, half = tables[index[i], EXPECTED], tables[index[i], HALF_VARIANCE]
            shared_part *= along
            expected = max(shared_part + alone * freedom, 1e-150)
            half = along * along * half + alone * (2.0 * shared_part + alone * freedom)
            work[0, k] = n * rmse[i] * rmse[i] / expected if n > 6.0 else 0.0
            work[1, k] = min(max(half / (expected * expected), 1e-9), 1.0 / chi_square.LEAST_FREEDOM)
        write_tails(noise[INVERSE_FREEDOM], work, BLOCK)
        for k in range(count):
            p_value[first + k] = work[0, k]
            if work[0, k] < level:
                status[first + k] = ROUGH


@kernel()
def factor_inverse(moments, i, low, inverse):
    """Write L and L⁻¹ of a tile's matrix A = LLᵀ; both (6, 6), and only what is not above their diagonal."""
    for j in range(6):
        for k in range(j + 1):
            total = moments[SUMS[j, k], i]
            for m in range(k):
                total -= low[j, m] * low[k, m]
            low[j, k] = math.sqrt(total) if j == k else total / low[k, k]
    for j in range(6):
        inverse[j, j] = 1.0 / low[j, j]
        for k in range(j):
            total = 0.0
            for m in range(k, j):
                total += low[j, m] * inverse[m, k]
            inverse[j, k] = -total * inverse[j, j]


@kernel(inline=True)
def curvature_gradients(q, a, b, r, s, t, u, v, d, mean_gradient, gaussian_gradient):
    """Write the gradients of H and K by β: of q, a, b, and of half of r, of s and of half of t."""
    square = u * u + v * v + 1.0
    c = q - a * u - b * v
    p_u = q * q - 2.0 * q * u * a + square * a * a
    p_v = q * q - 2.0 * q * v * b + square * b * b
    p_m = square * a * b - q * (u * b + v * a)
    total = p_v * r - 2.0 * p_m * s + p_u * t
    cube = d * d * d
    # Of d: -d³ times a, b and c with their own derivatives.
    d_q, d_a, d_b = -cube * c, -cube * (a - u * c), -cube * (b - v * c)
    by_q = 2.0 * ((q - v * b) * r + (u * b + v * a) * s + (q - u * a) * t)
    by_a = -2.0 * (square * b - q * v) * s + 2.0 * (square * a - q * u) * t
    by_b = 2.0 * (square * b - q * v) * r - 2.0 * (square * a - q * u) * s
    by_d = 3.0 * d * d * q * total
    mean_gradient[0] = -0.5 * (by_d * d_q + cube * (total + q * by_q))
    mean_gradient[1] = -0.5 * (by_d * d_a + cube * q * by_a)
    mean_gradient[2] = -0.5 * (by_d * d_b + cube * q * by_b)
    mean_gradient[3] = -cube * q * p_v
    mean_gradient[4] = cube * q * p_m
    mean_gradient[5] = -cube * q * p_u
    fourth = (d * q) ** 4
    gaussian = 4.0 * fourth * (r * t - s * s)
    gaussian_gradient[0] = gaussian * (d_q / d + 1.0 / q)
    gaussian_gradient[1] = gaussian * d_a / d
    gaussian_gradient[2] = gaussian * d_b / d
    gaussian_gradient[3] = 2.0 * fourth * t
    gaussian_gradient[4] = -2.0 * fourth * s
    gaussian_gradient[5] = 2.0 * fourth * r


@kernel(inline=True)
def deviation(gradient, covariance):
    """Standard deviation of what has this gradient."""
    total = 0.0
    for j in range(6):
        for k in range(6):
            total += gradient[j] * covariance[j, k] * gradient[k]
    return math.sqrt(max(total, 0.0))


@kernel(inline=True)
def square_of_product(scale, covariance):
    """tr((HΣ)²) with the Hessian H of scale·(β₃β₅ - β₄²/4) and the covariance Σ of these three."""
    total = 0.0
    for j in range(3):
        for k in range(3):
            one = -0.5 * covariance[4, 3 + k] if j == 1 else covariance[5 - j, 3 + k]
            other = -0.5 * covariance[4, 3 + j] if k == 1 else covariance[5 - k, 3 + j]
            total += one * other
    return scale * scale * total


@kernel()
def surface_statistics(
    moments, coefficients, rmse, index, tables, centre, noise, growth, lens, start, stop, results
):  # fmt: skip
    """Write how uncertain surfaces ``start`` to ``stop`` of a frame are: arguments as in `assess_surfaces`.

    ``results`` (SURFACE_RESULTS, T) are written, but for P_VALUE: how often the noise alone explains as much of
    second order; standard deviations of H, K, κ₁, κ₂ (1/m) and of the principal directions (degrees); and the
    covariance of β, row by row. NaN where there is no surface.
    """
    low, inverse = np.zeros((6, 6)), np.zeros((6, 6))
    spread, covariance, half = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    mean_gradient, gaussian_gradient, gradient = np.empty(6), np.empty(6), np.empty(6)
    work = np.empty((normal.WORK, BLOCK))
    for first in range(start, stop, BLOCK):
        count = min(BLOCK, stop - first)
        for k in range(BLOCK):
            work[0, k], work[1, k] = math.nan, 1.0
        for place in range(count):
            i = first + place
            beta = coefficients[6 * i : 6 * i + 6]
            u, v = centre[0, i], centre[1, i]
            if not rmse[i] >= 0.0:
                results[P_FLAT:, i] = math.nan
                continue
            grown = growth[0, i] if growth.shape[1] > 0 else 1.0
            along, rounding = pixel_variances(moments, beta, i, u, v, noise, grown)
            alone = rounding + lateral_variance(beta, i, noise, lens)
            for j in range(6):
                for k in range(6):
                    independent = 1.0 if j == k else 0.0
                    shared = tables[index[i], SHAPE + 6 * j + k] if tables.shape[0] > 0 else independent
                    spread[j, k] = along * shared + alone * independent
            factor_inverse(moments, i, low, inverse)
            # Cov β = L⁻ᵀ·spread·L⁻¹; L⁻¹ is lower triangular.
            for j in range(6):
                for k in range(6):
                    total = 0.0
                    for m in range(k, 6):
                        total += spread[j, m] * inverse[m, k]
                    half[j, k] = total
            for j in range(6):
                for k in range(6):
                    total = 0.0
                    for m in range(j, 6):
                        total += inverse[m, j] * half[m, k]
                    covariance[j, k] = total
                    results[COVARIANCE + 6 * j + k, i] = total
            # What the terms of second order explain: the last three entries of Lᵀβ, squared.
            explained = trace = squares = 0.0
            for j in range(3, 6):
                total = 0.0
                for k in range(j, 6):
                    total += low[k, j] * beta[k]
                explained += total * total
                trace += spread[j, j]
                for k in range(3, 6):
                    squares += spread[j, k] * spread[j, k]
            work[0, place] = explained / max(trace, 1e-150)
            work[1, place] = min(max(squares / max(trace * trace, 1e-300), 1e-9), 1.0)
            q, a, b, r, s, t = beta[0], beta[1], beta[2], 2.0 * beta[3], beta[4], 2.0 * beta[5]
            d = tangent_distance(q, a, b, u, v)
            k_1, k_2 = principal_pair(mean_curvature(q, a, b, r, s, t, u, v, d), gaussian_curvature(q, r, s, t, d))
            curvature_gradients(q, a, b, r, s, t, u, v, d, mean_gradient, gaussian_gradient)
            results[MEAN_STD, i] = deviation(mean_gradient, covariance)
            # K is a product: at its estimate the gradient is too large by what noise adds, twice what noise itself
            # does to a product (Goodman, "On the exact variance of products", JASA 55, 1960).
            own = 0.5 * square_of_product(4.0 * (d * q) ** 4, covariance)
            results[GAUSSIAN_STD, i] = math.sqrt(max(deviation(gaussian_gradient, covariance) ** 2 - own, own))
            # The entries of the shape operator along the principal directions: their sum is 2H, their product K.
            apart = k_1 - k_2
            for row in range(2):
                one, sign = (k_1, 1.0) if row == 0 else (k_2, -1.0)
                for k in range(6):
                    gradient[k] = mean_gradient[k]
                    if apart > 1e-9 * (abs(k_1) + abs(k_2)):
                        gradient[k] = sign * (2.0 * one * mean_gradient[k] - gaussian_gradient[k]) / apart
                results[FIRST_STD + row, i] = deviation(gradient, covariance)
            x_1, y_1, x_2, y_2 = principal_steps(q, a, b, r, s, t, u, v, d, k_1)
            scale = d / (q * max(apart, 1e-150))
            gradient[0] = gradient[1] = gradient[2] = 0.0
            gradient[3] = 2.0 * scale * x_1 * x_2
            gradient[4] = scale * (x_1 * y_2 + y_1 * x_2)
            gradient[5] = 2.0 * scale * y_1 * y_2
            results[DIRECTION_STD, i] = min(math.degrees(deviation(gradient, covariance)), EVENLY)
        write_tails(noise[INVERSE_FREEDOM], work, BLOCK)
        for k in range(count):
            results[P_FLAT, first + k] = work[0, k]
