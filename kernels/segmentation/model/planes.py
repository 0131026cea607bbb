"""Segmentation: the planes of regions and of labels, how certain they are, and how well their pixels fit."""

import math

from ..._jit.kernel import kernel
from ...common.arrays import copy
from ...statistics.rounding import between_codes, in_common, is_left
from ...statistics.sandwich_covariance import sandwich
from .moments import fit
from .pixel_noise import region_stretch, slope_variance, step_at, waviness
from .records import Found, Modelled, Noise


@kernel()
def fit_regions(moments, noise, planes):
    """Plane of each region, and what adds to the variance of its pixels.

    A region without a plane gets an α of infinities, which no pixel fits.
    """
    noise = Noise(*noise)
    alpha, slope, waviness_square, stretch, _ = planes
    for i in range(len(moments)):
        if fit(moments[i], alpha[i]) < 0.0:
            alpha[i, :] = math.inf
            slope[i] = 1.0
            waviness_square[i] = stretch[i] = 1.0
            continue
        waviness_square[i] = waviness(moments[i, 0], noise.growth) ** 2
        stretch[i] = region_stretch(moments[i], noise.lens)
        slope[i] = slope_variance(moments[i], alpha[i], noise) / stretch[i]


@kernel()
def fit_planes(moments, alpha, rss):
    """α and the sum of squared residuals of each plane from the moments of its pixels; 0 and -1 if there is none."""
    for i in range(len(moments)):
        rss[i] = fit(moments[i], alpha[i])


@kernel()
def plane_covariance(m, weighted, variance_x, variance_y, mean_variance, more, shared, covariance):
    """Write the covariance of α, (3, 3), by `statistics.sandwich`.

    ``weighted`` (5,) comes from `weights.weigh_rays`. ``variance_x``, ``variance_y`` and ``mean_variance`` are
    variances of a pixel: for the slope along each axis, and for the mean. Then ``more`` times ``shared`` is added, the
    covariances of slopes and mean by `statistics.correlated_errors.shared_covariances`.
    """
    n, u, v = m[0], m[1] / m[0], m[2] / m[0]
    rays = weighted[0], weighted[1], weighted[2], weighted[3], weighted[4]
    _, slopes, with_mean = sandwich(n, u, v, m[4] - n * u * u, m[5] - n * u * v, m[7] - n * v * v, rays)
    a, c = slopes[0] * variance_x, slopes[2] * variance_y
    deviation_x, deviation_y, mean_deviation = math.sqrt(variance_x), math.sqrt(variance_y), math.sqrt(mean_variance)
    b = slopes[1] * (deviation_x * deviation_y)
    a_mean = with_mean[0] * (deviation_x * mean_deviation)
    b_mean = with_mean[1] * (deviation_y * mean_deviation)
    a, b, c = a + more * shared[0], b + more * shared[1], c + more * shared[2]
    a_mean, b_mean, mean = a_mean + more * shared[3], b_mean + more * shared[4], mean_variance / n + more * shared[5]
    covariance[0, 0], covariance[0, 1], covariance[1, 1] = a, b, c
    covariance[0, 2], covariance[1, 2] = a_mean - (a * u + b * v), b_mean - (b * u + c * v)
    covariance[2, 2] = mean + u * (a * u + b * v) + v * (b * u + c * v) - 2.0 * (a_mean * u + b_mean * v)
    covariance[1, 0], covariance[2, 0], covariance[2, 1] = (covariance[0, 1], covariance[0, 2], covariance[1, 2])


@kernel()
def describe_planes(
    found, noise, together, modelled, step_of_raw, scale, is_disparity, planes, alpha, covariance, rmse, sizes
):
    """Planes, their covariances and their residuals.

    Parameters
    ----------
    found : Found
    noise : Noise
    together : float
        Pixels that have one error between them.
    modelled : Modelled
    step_of_raw, scale, is_disparity
        Step between raw values, and how these are read.
    planes, alpha : (N, 4) and (N, 3) float64, written
        nx, ny, nz, d; and α.
    covariance : (N, 3, 3) float64, written
        Of α: from the residual or the noise, whichever is larger, and from the rounding error that all pixels have in
        common. A noise model that is believed gives its own, larger if the residual is larger than by the model.
    rmse : (N,) float64, written
    sizes : (N,) int32, written
        Pixels of each label.
    """
    found, noise, modelled = Found(*found), Noise(*noise), Modelled(*modelled)
    moments, rss, weighted, deviation = found.inside, found.rss, found.weighted, found.deviation
    for i in range(len(planes)):
        sizes[i] = found.size[i + 1]
        copy(found.alpha[i], alpha[i])
        n = moments[i, 0]
        rmse[i] = math.sqrt(rss[i] / max(n, 1.0))
        seen = rss[i] / max(n - 3.0, 1.0)
        expected = deviation[i] ** 2
        variance, more = together * max(seen, expected), 0.0
        if modelled.is_believed and modelled.residual[i] > 0.0:
            lateral = slope_variance(moments[i], alpha[i], noise) if modelled.has_lateral else 0.0
            expected = modelled.residual[i] + lateral
            more = max(seen / expected, 1.0)
            variance = more * (modelled.alone[i] + lateral)
        shared_x = shared_y = mean_variance = 0.0
        step = step_at(moments[i, 3] / n, step_of_raw, scale, is_disparity)
        if step > 0.0:
            u, v = moments[i, 1] / n, moments[i, 2] / n
            # Values spread evenly along a side span √12 of their standard deviations.
            u_steps = abs(alpha[i, 0]) * math.sqrt(12.0 * max(moments[i, 4] / n - u * u, 0.0)) / step
            v_steps = abs(alpha[i, 1]) * math.sqrt(12.0 * max(moments[i, 7] / n - v * v, 0.0)) / step
            others = max(min(seen, expected) - step**2 / 12.0, 0.0)
            if is_left(step**2, others):  # then half-way between two codes rounding makes up to Δ²/4 of what is seen
                others = max(others - between_codes(step**2, 0.0, u_steps, v_steps), 0.0)
            shared_x, shared_y, mean_variance = in_common(step**2, others, n, u_steps, v_steps)
        plane_covariance(
            moments[i], weighted[i], variance + shared_x, variance + shared_y, variance + mean_variance, more,
            modelled.shared[i], covariance[i],
        )  # fmt: skip
        d = 1.0 / math.sqrt(alpha[i, 0] ** 2 + alpha[i, 1] ** 2 + alpha[i, 2] ** 2)
        for k in range(3):
            planes[i, k] = -alpha[i, k] * d
        planes[i, 3] = d
