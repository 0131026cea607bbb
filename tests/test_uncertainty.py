"""Covariances, p-values and what follows from them, against simulation and against plain linear algebra."""

import pickle
from dataclasses import replace
from functools import partial

import monte_carlo
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import special, stats
from scipy.spatial.transform import Rotation

import rgbd_planes as rp
from rgbd_planes import fit_statistics
from rgbd_planes.kernels.statistics import chi_square, variance_ratio
from rgbd_planes.kernels.statistics.normal_distribution import WORK
from rgbd_planes.kernels.statistics.normal_distribution import tails as normal_tails
from rgbd_planes.noise import residuals

METHODS = ("range_explicit", "range_implicit", "standard_explicit", "standard_implicit", "standard_pca")
CORRELATED = rp.noise.NoiseModel(correlation=((0.3, 1.5), (0.2, 5.0)), floor=0.5, floor_length=20.0)
# Depth, incidence, tile, share of holes: where the angle's error stays below a few degrees, so that what is
# to first order can be held to a few per cent.
CASES = [
    (0.5, 0, 5, 0.0),
    (0.5, 60, 10, 0.3),
    (1.0, 30, 20, 0.0),
    (1.6, 0, 20, 0.1),
    (3.0, 45, 40, 0.0),
    (2.0, 75, 40, 0.3),
]


def interval(values, variance, expected):
    """How many standard errors the mean of ``values`` is from what it should be."""
    return abs(np.mean(values) - expected) / np.sqrt(variance / len(values))


@pytest.mark.parametrize(("depth", "incidence", "tile", "holes"), CASES)
def test_simulated_errors_are_those_predicted(depth, incidence, tile, holes, rng):
    runs = 4000
    camera = monte_carlo.tile_camera(tile, rp.noise.kinect_v1(), left=100.0, top=60.0)
    alpha = monte_carlo.plane_through_middle(camera, depth, incidence)
    stack = monte_carlo.fit(camera, monte_carlo.measure(camera, alpha, runs, rng, holes=holes))
    error = stack.alpha.reshape(-1, 3) - alpha
    covariance = stack.alpha_covariance[0, 0, 0]
    # Unbiased: within 4 standard errors (one in 16000 by chance).
    assert (np.abs(error.mean(axis=0)) < 4.0 * np.sqrt(np.diag(covariance) / runs)).all()
    # The error's chi-square (NEES) and the residual's, and the shape of both.
    assert interval(monte_carlo.normalised_error(stack, alpha), 6.0, 3.0) < 4.0
    freedom = int(stack.valid_count[0, 0, 0]) - 3
    rss = stack.valid_count.ravel() * stack.rmse.ravel() ** 2 / rp.noise.KINECT_V1**2
    assert interval(rss, 2.0 * freedom, freedom) < 4.0
    p = stack.p_value.ravel()
    assert stats.kstest(p, "uniform").pvalue > 1e-4
    np.testing.assert_allclose(p, stats.chi2.sf(rss, freedom), rtol=0.02, atol=1e-4)
    # Predicted and observed spread of normal and distance: the standard error of the ratio is 1.1 % at most.
    truth = monte_carlo.plane_of(alpha)
    angle = np.degrees(np.linalg.norm(stack.planes.reshape(-1, 4)[:, :3] - truth[:3], axis=1))
    assert np.sqrt(np.mean(angle**2)) == pytest.approx(np.median(stack.angle_std), rel=0.05)
    offset = truth[3] ** 2 * error @ truth[:3]
    predicted = truth[3] ** 2 * np.sqrt(truth[:3] @ covariance @ truth[:3])
    assert np.sqrt(np.mean(offset**2)) == pytest.approx(predicted, rel=0.05)
    # d itself bends with the angle's error where the plane faces the camera: there the prediction is high.
    spread = np.std(stack.planes[..., 3])
    assert 0.95 * spread < np.sqrt(np.mean(stack.offset_std**2)) < (1.6 if incidence < 30 else 1.05) * spread


@pytest.mark.parametrize("method", METHODS)
def test_other_methods_are_held_to_the_same_bound(method, rng):
    """Their covariance is that of range_explicit to first order; only range_explicit reaches it."""
    camera = monte_carlo.tile_camera(20, rp.noise.kinect_v1(), left=100.0)
    alpha = monte_carlo.plane_through_middle(camera, 2.0, 40.0)
    frames = monte_carlo.measure(camera, alpha, 1500, rng)
    stack = monte_carlo.fit(camera, frames, method)
    best = monte_carlo.fit(camera, frames)
    np.testing.assert_allclose(np.median(stack.angle_std), np.median(best.angle_std), rtol=0.1)
    np.testing.assert_allclose(np.median(stack.offset_std), np.median(best.offset_std), rtol=0.1)
    mean = np.mean(monte_carlo.normalised_error(stack, alpha))
    if method == "range_explicit":
        assert mean == pytest.approx(3.0, abs=0.25)
    else:
        assert mean > 3.5


def test_plane_covariance_is_that_of_alpha_carried_over(rng):
    """J Σ Jᵀ with the derivatives of n = -α/|α| and d = 1/|α|, taken numerically."""
    camera = monte_carlo.tile_camera(12, rp.noise.kinect_v1(), left=300.0)
    alpha = monte_carlo.plane_through_middle(camera, 1.5, 50.0)
    stack = monte_carlo.fit(camera, monte_carlo.measure(camera, alpha, 5, rng))
    for i in range(5):
        fitted = stack.alpha[i, 0, 0]
        ends = [[monte_carlo.plane_of(fitted + sign * 1e-6 * axis) for sign in (1, -1)] for axis in np.eye(3)]
        slope = np.array([(high - low) / 2e-6 for high, low in ends]).T
        wanted = slope @ stack.alpha_covariance[i, 0, 0] @ slope.T
        np.testing.assert_allclose(stack.plane_covariance[i, 0, 0], wanted, rtol=1e-5, atol=1e-12)


def rows_and_columns(height, width):
    """(height * width,) each."""
    return np.mgrid[:height, :width].reshape(2, -1)


def pixel_covariance(model, height, width):
    """Of the errors of all pixels of a rectangle, in units of σq²."""
    y, x = rows_and_columns(height, width)
    squared = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2
    covariance = (1.0 - sum(share for share, _ in model.correlation)) * np.eye(height * width)
    for share, length in (*model.correlation, (model.floor**2, model.floor_length)):
        covariance += share * np.exp(-0.5 * squared / length**2)
    return covariance


@pytest.mark.parametrize("size", [(4, 4), (9, 9), (16, 16), (4, 16), (16, 8), (20, 5)])
def test_correlated_noise_is_worked_out_exactly(size):
    """Against the covariance matrix of all pixels."""
    y, x = rows_and_columns(*size)
    model = replace(CORRELATED, correlation=((0.3, 1.5), (0.2, 5.0), (0.25, 20.0)), floor=0.0)
    covariance = pixel_covariance(model, *size)
    rays = np.stack([x - x.mean(), y - y.mean(), np.ones(x.size)], axis=1)
    solve = np.linalg.pinv(rays)
    residual = np.eye(x.size) - rays @ solve
    expected = np.trace(residual @ covariance)
    variance = 2.0 * np.trace(residual @ covariance @ residual @ covariance)
    factors = np.diag(solve @ covariance @ solve.T) / np.diag(np.linalg.inv(rays.T @ rays))
    made = model.statistics(x.size, size)
    np.testing.assert_allclose(made.expected, expected, rtol=1e-9)
    np.testing.assert_allclose(made.freedom, 2.0 * expected**2 / variance, rtol=1e-9)
    np.testing.assert_allclose([made.tilt_x, made.tilt_y, made.offset], factors, rtol=1e-9)
    turned = model.statistics(x.size, size[::-1])
    np.testing.assert_array_equal([turned.tilt_y, turned.tilt_x], [made.tilt_x, made.tilt_y])


def test_correlated_noise_of_proportions_between():
    """Rectangles of any sides, between those that are worked out: right to some per cent."""
    model = replace(CORRELATED, floor=0.0)
    for size in ((10, 12), (7, 19), (3, 17), (31, 18)):
        y, x = rows_and_columns(*size)
        covariance = pixel_covariance(model, *size)
        rays = np.stack([x - x.mean(), y - y.mean(), np.ones(x.size)], axis=1)
        solve = np.linalg.pinv(rays)
        residual = np.eye(x.size) - rays @ solve
        factors = np.diag(solve @ covariance @ solve.T) / np.diag(np.linalg.inv(rays.T @ rays))
        made = model.statistics(x.size, size)
        np.testing.assert_allclose(made.expected, np.trace(residual @ covariance), rtol=0.01)
        np.testing.assert_allclose([made.tilt_x, made.tilt_y, made.offset], factors, rtol=0.06)


def test_independent_errors_beside_correlated_ones():
    """Expected sum and degrees of freedom of both together, against the covariance matrix of all pixels."""
    side = 9
    y, x = np.mgrid[:side, :side].reshape(2, -1)
    squared = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2
    rays = np.stack([x, y, np.ones(side * side)], axis=1)
    residual = np.eye(side * side) - rays @ np.linalg.pinv(rays)
    both = 1.7 * np.exp(-0.5 * squared / 3.0**2) + 0.4 * np.eye(side * side)
    expected = np.trace(residual @ both)
    freedom = expected**2 / np.trace(residual @ both @ residual @ both)
    model = rp.noise.NoiseModel(correlation=((1.0, 3.0),))
    made = model.statistics(np.array([side * side])).with_independent(1.7, 0.4, np.array([side * side]))
    np.testing.assert_allclose(made[0], expected, rtol=1e-9)
    np.testing.assert_allclose(made[1], freedom, rtol=1e-9)


@pytest.mark.parametrize(("low", "high", "error"), [(1.0, 2.0, 2e-3), (2.0, 5.0, 2e-4), (5.0, 1e6, 2e-5)])
def test_tail_of_chi_square(low, high, error, rng):
    """As accurate as documented for any degrees of freedom, wherever p is above 1e-12."""
    freedom = np.exp(rng.uniform(np.log(low), np.log(high), 20000))
    p = np.where(
        rng.random(freedom.shape) < 0.5, 10.0 ** rng.uniform(-12.0, 0.0, freedom.shape), rng.random(freedom.shape)
    )
    ratio = special.chdtri(freedom, p) / freedom
    work = np.empty((WORK, len(freedom)))
    work[0], work[1] = ratio, freedom**-0.5
    chi_square.deviates(work, len(freedom))
    normal_tails(work, len(freedom))
    np.testing.assert_allclose(work[0], special.chdtrc(freedom, ratio * freedom), rtol=error)


@pytest.mark.parametrize("spread", [0.05, 0.2, 0.4, 0.6])
def test_tail_of_a_ratio_of_variances(spread, rng):
    """As near to Fisher's F as documented, for 3 degrees of freedom or more; its limits are its inverse."""
    freedom = np.exp(rng.uniform(np.log(3.0), np.log(1e4), 2000))
    inverse = residuals.inverse_freedom(spread)
    assert stats.invgamma(0.5 / inverse, scale=0.5 / inverse - 1.0).std() == pytest.approx(spread, rel=1e-6)
    work = np.empty((WORK, len(freedom)))
    for p, low, high in (
        (0.99, 0.99, 1.01),
        (0.5, 0.99, 1.01),
        (0.05, 0.97, 1.01),
        (0.01, 0.99, 1.08),
        (1e-3, 0.97, 1.35),
    ):
        ratio = stats.f.isf(p, freedom, 1.0 / inverse) * (1.0 - 2.0 * inverse)
        work[0], work[1] = ratio, freedom**-0.5
        variance_ratio.deviates(inverse, work, len(freedom))
        normal_tails(work, len(freedom))
        assert low * p < work[0].min() < work[0].max() < high * p
        deviate = residuals.deviate_of(ratio, freedom, spread)
        np.testing.assert_allclose(work[0], stats.norm.sf(deviate), rtol=1e-5)
        variance_ratio.limits(stats.norm.isf(p), inverse, work, len(freedom))
        np.testing.assert_allclose(work[2], residuals.ratio_at(stats.norm.isf(p), freedom, spread))
        np.testing.assert_allclose(residuals.deviate_of(work[2], freedom, spread), stats.norm.isf(p), atol=1e-12)


def test_tails_end_at_one_and_zero_and_keep_nan():
    """No residual, one that is beyond all bounds, and none that is a number."""
    work = np.empty((WORK, 4))
    for deviates in (chi_square.deviates, partial(variance_ratio.deviates, 0.01)):
        work[0], work[1] = [0.0, 1e12, np.nan, 1e3], 0.1
        deviates(work, 4)
        normal_tails(work, 4)
        np.testing.assert_allclose(work[0], [1.0, 0.0, np.nan, 0.0], atol=1e-12)


def test_noise_that_differs_from_place_to_place(rng):
    """Each frame's noise of a variance of its own: uniform p-values, and ROUGH is a small one."""
    model = rp.noise.NoiseModel((2e-3,), spread=0.5)
    camera = monte_carlo.tile_camera(9, model)
    alpha = monte_carlo.plane_through_middle(camera, 1.0, 30.0)
    runs, shape = 4000, 2.0 + 1.0 / 0.5**2
    variance = (shape - 1.0) / rng.gamma(shape, size=(runs, 1, 1))
    error = 2e-3 * np.sqrt(variance) * rng.standard_normal((runs, 9, 9))
    frames = monte_carlo.measure(camera, alpha, runs, rng, error=error)
    stack = monte_carlo.fit(camera, frames)
    assert stats.kstest(stack.p_value.ravel(), "uniform").pvalue > 1e-3
    assert np.mean(stack.p_value < 0.01) == pytest.approx(0.01, abs=0.006)
    assert np.mean(monte_carlo.normalised_error(stack, alpha)) == pytest.approx(3.0, abs=0.2)
    even = monte_carlo.fit(replace(camera, noise=replace(model, spread=0.0)), frames)
    assert np.mean(even.p_value < 0.01) > 0.1


@pytest.mark.parametrize("noise", [rp.noise.kinect_v1(), rp.noise.time_of_flight(0.0005, 0.001)])
def test_lateral_error_is_in_p_values_and_covariances(noise, rng):
    """Errors of half a pixel across the ray, on a steep plane: uniform p-values, and covariances that hold."""
    tile, runs = 16, 3000
    camera = monte_carlo.tile_camera(tile, replace(noise, lateral=0.5))
    alpha = monte_carlo.plane_through_middle(camera, 1.0, 60.0)
    slope = np.hypot(alpha[0] / camera.fx, alpha[1] / camera.fy)
    along = noise.sigma(alpha[0] * camera.tan_x + alpha[1] * camera.tan_y + alpha[2])
    assert slope > along.mean()
    error = rng.standard_normal((runs, tile, tile)) * np.hypot(along, 0.5 * slope)
    frames = monte_carlo.measure(camera, alpha, runs, rng, error=error)
    stack = monte_carlo.fit(camera, frames)
    assert np.mean(monte_carlo.normalised_error(stack, alpha)) == pytest.approx(3.0, abs=0.2)
    assert np.mean(stack.p_value < 0.01) == pytest.approx(0.01, abs=0.006)
    assert stats.kstest(stack.p_value.ravel(), "uniform").pvalue > 1e-4
    without = monte_carlo.fit(replace(camera, noise=noise), frames)
    assert np.mean(without.p_value < 0.01) > 0.2


def test_correlated_noise_between_whole_sides():
    """Counts that are no squares lie between those that are."""
    for model in (CORRELATED, replace(CORRELATED, floor=0.0), replace(CORRELATED, correlation=(), spread=0.3)):
        made = model.statistics(np.arange(3000))
        for values in (made.expected[4:], made.offset[4:]):
            assert (np.diff(values) >= -1e-9).all()
        assert (np.diff(made.freedom[4:400]) > 0.0).all()
        np.testing.assert_array_equal(made.expected[:4], 0.0)
    # Independent pixels by the general formulas: what the short cut says.
    general = rp.noise.NoiseModel(correlation=((1.0, 1e-3),)).statistics(np.arange(4, 40) ** 2)
    np.testing.assert_allclose(general.expected, np.arange(4, 40) ** 2 - 3, rtol=2e-3)
    np.testing.assert_allclose(general.freedom, np.arange(4, 40) ** 2 - 3, rtol=2e-3)
    np.testing.assert_allclose([general.tilt_x, general.tilt_y, general.offset], 1.0)


def correlated_errors(model, height, width, runs, rng):
    """(runs, height, width): errors of 1/Z as the model has them."""
    root = np.linalg.cholesky(pixel_covariance(model, height, width) + 1e-9 * np.eye(height * width))
    error = rng.standard_normal((runs, height * width)) @ root.T
    return error.reshape(runs, height, width) * model.sigma(1.0)


def test_correlated_noise_of_a_window_does_not_depend_on_the_others(rng):
    """The same bits for small windows alone, and together with large ones."""
    camera = rp.Camera(300, 200, 300.0, 300.0, 149.5, 99.5, noise=CORRELATED)
    depth = 1.0 / (0.5 + 2.0 * rp.noise.KINECT_V1 * rng.standard_normal(camera.shape))
    small = np.array([(5, 9, height, width) for height in (14, 23, 31) for width in (18, 27, 39)])
    alone = rp.fit_windows(depth, camera, small)
    together = rp.fit_windows(depth, camera, np.concatenate([small, [(0, 0, 200, 300), (0, 0, 200, 200)]]))
    np.testing.assert_array_equal(together.p_value[: len(small)], alone.p_value)
    np.testing.assert_array_equal(together.alpha_covariance[: len(small)], alone.alpha_covariance)


@pytest.mark.parametrize("tile", [(16, 16), (4, 48), (40, 6), (12, 20)])
def test_simulated_correlated_noise(tile, rng):
    """Frames with that noise: p-values are nearly uniform, covariances hold, and ignoring it fails."""
    runs = 3000
    camera = monte_carlo.tile_camera(tile, CORRELATED)
    error = correlated_errors(CORRELATED, *tile, runs, rng)
    alpha = monte_carlo.plane_through_middle(camera, 1.0, 20.0)
    frames = monte_carlo.measure(camera, alpha, runs, rng, error=error)
    stack = monte_carlo.fit(camera, frames)
    assert np.mean(monte_carlo.normalised_error(stack, alpha)) == pytest.approx(3.0, abs=0.2)
    slopes = (stack.alpha[:, 0, 0, :2] - alpha[:2]) ** 2
    variances = np.diagonal(stack.alpha_covariance, axis1=-2, axis2=-1)[:, 0, 0, :2]
    np.testing.assert_allclose(slopes.mean(axis=0), variances.mean(axis=0), rtol=0.1)
    assert np.mean(stack.p_value < 0.01) == pytest.approx(0.01, abs=0.012)
    assert np.mean(stack.p_value) == pytest.approx(0.5, abs=0.03)
    naive = monte_carlo.fit(replace(camera, noise=rp.noise.kinect_v1()), frames)
    assert np.mean(monte_carlo.normalised_error(naive, alpha)) > 20.0


@pytest.mark.parametrize("shape", ["strip", "diagonal strip", "every third pixel", "ring", "chessboard"])
def test_simulated_correlated_noise_on_masks(shape, rng):
    """Of flat ones not many more than the level says are rejected, and covariances are not too small."""
    noise, runs = rp.noise.NoiseModel(correlation=((0.5, 5.0),)), 600
    camera = monte_carlo.tile_camera(36, noise)
    y, x = np.mgrid[:36, :36]
    mask = {
        "strip": abs(y - 18) < 4,
        "diagonal strip": abs(x - y) < 5,
        "every third pixel": (x + 2 * y) % 3 == 0,
        "ring": abs(np.hypot(x - 17.5, y - 17.5) - 14.0) < 3.0,
        "chessboard": (x // 6 + y // 6) % 2 == 0,
    }[shape]
    alpha = monte_carlo.plane_through_middle(camera, 1.0, 20.0)
    error = correlated_errors(noise, 36, 36, runs, rng)
    frames = monte_carlo.measure(camera, alpha, runs, rng, error=error)
    fits = [rp.fit_labels(frame, camera, mask) for frame in frames]
    assert np.mean([fit.p_value[0] < 0.01 for fit in fits]) < 0.045
    errors = [fit.alpha[0] - alpha for fit in fits]
    normalised = [e @ np.linalg.solve(fit.alpha_covariance[0], e) for e, fit in zip(errors, fits, strict=True)]
    assert 1.4 < np.mean(normalised) < 3.3


@pytest.mark.parametrize("missing", ["here and there", "a corner"])
@pytest.mark.parametrize(
    "noise",
    [
        rp.noise.NoiseModel(correlation=((0.9, 6.0),), floor=1.0, floor_length=30.0),
        rp.noise.NoiseModel(correlation=((0.5, 2.0), (0.25, 4.0)), floor=0.8, floor_length=32.0),
    ],
    ids=["smooth", "rough"],
)
@pytest.mark.parametrize("tile", [(16, 16), (8, 32)])
def test_simulated_correlated_noise_with_missing_pixels(tile, noise, missing, rng):
    """Neither are pixels that lie apart taken for a small square, nor those in one piece for a thin large one."""
    runs = 3000
    camera = monte_carlo.tile_camera(tile, noise)
    alpha = monte_carlo.plane_through_middle(camera, 1.0, 20.0)
    error = correlated_errors(noise, *tile, runs, rng)
    frames = monte_carlo.measure(camera, alpha, runs, rng, error=error)
    if missing == "a corner":
        frames[:, : 11 * tile[0] // 16, 5 * tile[1] // 16 :] = np.nan
    else:
        frames[rng.random(frames.shape) < 0.5] = np.nan
    stack = monte_carlo.fit(camera, frames)
    assert 1.8 < np.mean(monte_carlo.normalised_error(stack, alpha)) < 4.2
    assert 0.001 < np.mean(stack.p_value < 0.01) < 0.03
    whole = rp.fit_windows(frames[0], camera, [(0, 0, *tile)], max_missing=1.0)
    labels = rp.fit_labels(frames[0], camera, np.ones(camera.shape, int), max_missing=1.0)
    parts = rp.fit_tiles(frames[0], camera, 8, max_missing=1.0)
    merged = rp.merge(parts, np.ones(parts.shape, int))
    for other in (whole, labels, merged, rp.merge(merged, [1])):
        np.testing.assert_allclose(other.p_value[0], stack.p_value[0, 0, 0], rtol=1e-4, atol=1e-9)
        np.testing.assert_allclose(other.alpha_covariance[0], stack.alpha_covariance[0, 0, 0], rtol=1e-5)


@pytest.mark.parametrize(
    "noise", [rp.noise.kinect_v1(), rp.noise.time_of_flight(0.001, 0.002), CORRELATED, replace(CORRELATED, spread=0.4)]
)
@pytest.mark.parametrize("method", METHODS)
def test_rough_is_a_small_p_value(method, noise, rng):
    """ROUGH by significance is p_value < significance, for tiles of every size and with holes."""
    camera = rp.Camera(70, 52, 80.0, 80.0, 34.5, 25.5, noise=noise)
    depth = rp.scenes.plane((0.3, 0.2, -1.0), 1.0).render(camera).depth
    depth = 1.0 / (1.0 / depth + rng.standard_normal(depth.shape) * 1.2 * noise.sigma(1.0 / depth))
    depth[rng.random(depth.shape) < 0.2] = np.nan
    depth[:8, :16] = np.nan
    depth[10:14, 20:24] *= 1.1
    for level in (0.01, 0.3):
        tiles = rp.fit_tiles(depth, camera, 8, method, significance=level)
        sure = np.abs(tiles.p_value / level - 1.0) > 0.02
        rough = tiles.status == rp.TileStatus.ROUGH
        np.testing.assert_array_equal(rough[sure], (tiles.p_value < level)[sure])
        assert rough.any()
        assert np.isnan(tiles.p_value[~tiles.fitted]).all()
        assert np.isnan(tiles.plane_covariance[~tiles.fitted]).all()
        assert np.isfinite(tiles.plane_covariance[tiles.fitted]).all()
    unset = rp.fit_tiles(depth, camera, 8, method)
    np.testing.assert_array_equal(unset.status, rp.fit_tiles(depth, camera, 8, method, significance=0.01).status)
    off = rp.fit_tiles(depth, camera, 8, method, significance=0.0)
    assert not (off.status == rp.TileStatus.ROUGH).any()
    least = rp.fit_tiles(depth, camera, 8, method, significance=1e-300)
    assert not (least.status == rp.TileStatus.ROUGH)[least.p_value > 1e-290].any()
    both = rp.fit_tiles(depth, camera, 8, method, significance=0.01, max_error=1e-6)
    assert (both.status[both.fitted] == rp.TileStatus.ROUGH).all()
    windows = np.array([(r, c, 8, 8) for r in range(0, 48, 8) for c in range(0, 64, 8)])
    fits = rp.fit_windows(depth, camera, windows, method)
    np.testing.assert_array_equal(fits.status.reshape(6, 8), unset.status[:6, :8])
    np.testing.assert_allclose(fits.p_value.reshape(6, 8), unset.p_value[:6, :8], rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("noise", [rp.noise.kinect_v1(), CORRELATED])
def test_rough_is_a_small_p_value_for_any_number_of_pixels(noise, rng):
    """Also where the limit is interpolated: windows of 4 to 40000 pixels, with more noise than the model's."""
    camera = rp.Camera(200, 200, 300.0, 300.0, 99.5, 99.5, noise=noise)
    windows = np.array([(0, 0, side, side) for side in range(2, 201)])
    errors = rng.standard_normal(camera.shape)
    for more in (1.0, 1.02, 1.05, 1.1, 1.3):
        depth = 1.0 / (0.5 + more * rp.noise.KINECT_V1 * np.hypot(1.0, noise.floor) * errors)
        fits = rp.fit_windows(depth, camera, windows)
        sure = np.abs(fits.p_value - 0.01) > 3e-4
        np.testing.assert_array_equal((fits.status == rp.TileStatus.ROUGH)[sure], (fits.p_value < 0.01)[sure])


def test_limits_of_the_default_level():
    """The numbers that are there are those that SciPy gives, and the quantiles of chi-square."""
    limits = fit_statistics._limits(fit_statistics.DEFAULT_SIGNIFICANCE, 0.0)
    made = fit_statistics._made_limits(fit_statistics.DEFAULT_SIGNIFICANCE)
    np.testing.assert_allclose(limits, made, rtol=1e-7)  # a fit, whose last digits are the processor's
    freedom = np.geomspace(1.0, 1e5, 200)
    p = stats.chi2.sf(np.polynomial.Polynomial(limits)(freedom**-0.5) * freedom, freedom)
    np.testing.assert_allclose(p, fit_statistics.DEFAULT_SIGNIFICANCE, atol=2e-5)


def test_one_level_at_every_depth(rng):
    """The share of flat tiles that are rejected does not depend on the distance; a step is found at all."""
    for distance in (0.5, 6.0):
        camera = rp.Camera(320, 240, 525.0, 525.0, 159.5, 119.5, noise=rp.noise.kinect_v1())
        rendering = rp.scenes.plane((0.1, 0.2, -1.0), distance).render(camera)
        tiles = rp.fit_tiles(rendering.measure(quantise=False, seed=rng), camera, 8)
        share = np.mean(tiles.status == rp.TileStatus.ROUGH)
        assert 0.003 < share < 0.02


def test_p_value_of_few_pixels(rng):
    """Three pixels always lie in a plane; of four to ten the chi-square is exact."""
    camera = monte_carlo.tile_camera(4, rp.noise.kinect_v1())
    alpha = monte_carlo.plane_through_middle(camera, 1.0, 10.0)
    frames = monte_carlo.measure(camera, alpha, 400, rng)
    for valid in range(3, 17):
        some = frames.copy()
        some.reshape(400, 16)[:, [0, 15, 3, 12, *(i for i in range(16) if i not in (0, 3, 12, 15))][valid:]] = np.nan
        stack = monte_carlo.fit(camera, some)
        rss = stack.valid_count * stack.rmse**2 / rp.noise.KINECT_V1**2
        wanted = stats.chi2.sf(rss, valid - 3) if valid > 3 else np.ones(rss.shape)
        np.testing.assert_allclose(stack.p_value, wanted, rtol=0.01, atol=1e-4)


@pytest.mark.parametrize("significance", [None, 0.0])
def test_statistics_follow_the_arrays(significance, rng):
    """A result that is written into again has the new frame's; a batch has each frame's own, for any threads."""
    camera = rp.Camera(64, 48, 60.0, 60.0, 31.5, 23.5, noise=rp.noise.NoiseModel((0.01,)))
    fitter = rp.TileFitter(camera, 6, significance=significance)
    frames = [1.0 + 0.1 * k + 0.01 * rng.standard_normal(camera.shape) for k in range(3)]
    for frame in frames:
        frame[rng.random(frame.shape) < 0.2] = np.nan
    names = ("status", "p_value", "alpha_covariance", "plane_covariance", "angle_std", "offset_std")
    single = [fitter.fit(frame) for frame in frames]
    out = fitter.fit(frames[0])
    rewritten = [{name: getattr(fitter.fit(frame, out=out), name).copy() for name in names} for frame in frames[::-1]][
        ::-1
    ]
    threaded = rp.TileFitter(camera, 6, significance=significance, num_threads=3)
    stack = threaded.fit_batch(frames[::-1])
    assert stack.p_value.shape == (3, 8, 11)
    threaded.fit_batch(frames, out=stack)
    fresh = fitter.fit_batch(frames)
    assert not np.allclose(single[0].p_value, single[1].p_value)
    for name in names:
        for i in range(3):
            wanted = getattr(single[i], name)
            np.testing.assert_array_equal(rewritten[i][name], wanted)
            for batch in (stack, fresh):
                np.testing.assert_array_equal(getattr(batch, name)[i], wanted)
                np.testing.assert_array_equal(getattr(batch[i], name), wanted)


def test_results_whose_arrays_are_read_only(rng):
    """As Ray and joblib give them to other processes, and a user may make them: Numba refused these."""
    camera = rp.Camera(64, 48, 60.0, 60.0, 31.5, 23.5, noise=rp.noise.kinect_v1())
    depth = 1.0 + 0.01 * rng.standard_normal(camera.shape)
    tiles = rp.fit_tiles(depth, camera, 8)
    for made in (
        tiles,
        rp.TileFitter(camera, 8).fit_batch([depth, depth]),
        rp.fit_windows(depth, camera, [(0, 0, 8, 8)]),
        rp.fit_labels(depth, camera, np.ones(camera.shape, int)),
        rp.merge(tiles, np.ones(tiles.shape, int)),
    ):
        buffers = []
        content = pickle.dumps(made, 5, buffer_callback=buffers.append)
        given = pickle.loads(content, buffers=[bytes(buffer.raw()) for buffer in buffers])
        assert not given.planes.flags.writeable
        np.testing.assert_array_equal(given.p_value, made.p_value)
        np.testing.assert_array_equal(given.plane_covariance, made.plane_covariance)
        if len(given.shape) < 3:
            numbers = np.ones(given.shape, int)
            np.testing.assert_array_equal(rp.merge(given, numbers).p_value, rp.merge(made, numbers).p_value)


@pytest.mark.parametrize("first", ["batch", "frame", "neither"])
def test_a_frame_of_a_batch_has_the_batch_s_statistics(first, rng):
    """Whichever of them was asked first, and whichever is then written into."""
    camera = rp.Camera(64, 48, 60.0, 60.0, 31.5, 23.5, noise=rp.noise.NoiseModel((0.01,)))
    fitter = rp.TileFitter(camera, 6)
    frames = [1.0 + 0.01 * rng.standard_normal(camera.shape) for _ in range(4)]
    wanted = [fitter.fit(frame).p_value for frame in frames]
    batch = fitter.fit_batch(frames[:2])
    frame = batch[1]
    for asked in {"batch": [batch], "frame": [frame], "neither": []}[first]:
        assert np.isfinite(asked.p_value).all()
    fitter.fit(frames[2], out=frame)
    fitter.fit(frames[3], out=batch[0])
    np.testing.assert_array_equal(batch.p_value, [wanted[3], wanted[2]])
    np.testing.assert_array_equal(frame.p_value, wanted[2])
    np.testing.assert_array_equal(batch[0].p_value, wanted[3])
    fitter.fit_batch(frames[:2], out=batch)
    np.testing.assert_array_equal(batch.p_value, wanted[:2])
    np.testing.assert_array_equal(frame.p_value, wanted[1])
    fitter.fit(frames[2], out=frame)
    np.testing.assert_array_equal(frame.p_value, wanted[2])


@pytest.mark.parametrize("method", METHODS)
def test_merging_is_fitting_all_pixels(method, rng):
    """Any union of tiles, also over holes: as one window of the same pixels."""
    camera = rp.Camera(64, 48, 60.0, -58.0, 31.5, 20.5, depth_scale=1000.0, noise=rp.noise.kinect_v1())
    depth = rp.scenes.room().render(camera).measure(holes=0.1, seed=rng)
    depth[:8, :8] = 0
    tiles = rp.fit_tiles(depth, camera, 8, method)
    labels = np.zeros(tiles.shape, int)
    labels[:3, :4], labels[3:, 5:7], labels[5, 0] = 1, 2, 4
    merged = rp.merge(tiles, labels)
    windows = rp.fit_windows(
        depth, camera, [(0, 0, 24, 32), (24, 40, 24, 16), (0, 0, 2, 2), (40, 0, 8, 8)], method,
        implementation="naive", max_missing=1.0,
    )  # fmt: skip
    some = [0, 1, 3]
    np.testing.assert_array_equal(merged.valid_count[some], windows.valid_count[some])
    np.testing.assert_allclose(merged.planes[some], windows.planes[some], rtol=1e-7, atol=1e-9)
    # About the mean of the union, where nothing cancels.
    assert np.abs(merged._moments[1:4, some]).max() < 1e-9
    np.testing.assert_allclose(merged.rmse[some], windows.rmse[some], rtol=1e-6)
    np.testing.assert_allclose(merged.p_value[some], windows.p_value[some], rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(merged.plane_covariance[some], windows.plane_covariance[some], rtol=1e-6, atol=1e-15)
    assert merged.status[2] == rp.TileStatus.TOO_FEW
    assert np.isnan(merged.planes[2]).all()
    # Merging what is merged, in another order.
    again = rp.merge(rp.merge(tiles, np.arange(tiles.status.size).reshape(tiles.shape) + 1), labels.ravel())
    np.testing.assert_allclose(again.planes[some], merged.planes[some], rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(rp.merge(tiles, labels == 1).planes, merged.planes[:1])
    with pytest.raises(ValueError, match="shape of the planes"):
        rp.merge(tiles, labels[1:])
    with pytest.raises(TypeError, match="integers"):
        rp.merge(tiles, labels.astype(float))
    with pytest.raises(ValueError, match="labels must be 0 for none"):
        rp.merge(tiles, -labels)


def test_same_plane_is_uniform_on_one_plane_and_small_on_two(rng):
    camera = rp.Camera(640, 480, 525.0, 525.0, 319.5, 239.5, noise=rp.noise.kinect_v1())
    depth = rp.scenes.plane((0.3, 0.2, -1.0), 2.0).render(camera).measure(quantise=False, seed=rng)
    tiles = rp.fit_tiles(depth, camera, 16)
    a, c = tiles.alpha, tiles.alpha_covariance
    p = rp.uncertainty.same_plane(a[:, :-1:2], c[:, :-1:2], a[:, 1::2], c[:, 1::2])
    assert stats.kstest(p.ravel(), "uniform").pvalue > 1e-4
    delta = a[0, 0] - a[5, 7]
    statistic = delta @ np.linalg.solve(c[0, 0] + c[5, 7], delta)
    one = rp.uncertainty.same_plane(a[0, 0], c[0, 0], a[5, 7], c[5, 7])
    np.testing.assert_allclose(one, stats.chi2.sf(statistic, 3), rtol=1e-10)
    # Two parallel planes 6 cm apart, of 64x64 pixels each.
    labels = np.zeros(tiles.shape, int)
    labels[:4, :4], labels[8:12, 8:12] = 1, 2
    merged = rp.merge(tiles, labels)
    other = rp.merge(rp.fit_tiles(depth * 1.03, camera, 16), labels)
    assert (
        rp.uncertainty.same_plane(
            merged.alpha[0], merged.alpha_covariance[0], merged.alpha[1], merged.alpha_covariance[1]
        )
        > 1e-4
    )
    assert (
        rp.uncertainty.same_plane(
            merged.alpha[0], merged.alpha_covariance[0], other.alpha[1], other.alpha_covariance[1]
        )
        < 1e-6
    )
    assert np.isnan(rp.uncertainty.same_plane(np.full(3, np.nan), c[0, 0], a[0, 0], c[0, 0]))
    # In the frame of the plane itself, where d is 0 and α infinite, it is the same test.
    x, y = np.linalg.svd(tiles.planes[0, 0, :3][None])[2][1:]
    motion = np.eye(4)
    motion[:3, :3] = np.stack([x, y, np.cross(x, y)])
    motion[:3, 3] = motion[:3, :3] @ (tiles.planes[0, 0, 3] * tiles.planes[0, 0, :3])
    planes, covariance = rp.uncertainty.transform_planes(tiles.planes, tiles.plane_covariance, motion)
    left, right = np.s_[:, :-1:2], np.s_[:, 1::2]
    moved = rp.uncertainty.same_plane(planes[left], covariance[left], planes[right], covariance[right])
    assert abs(planes[0, 0, 3]) < 1e-12
    np.testing.assert_allclose(moved, p, atol=0.03)
    assert stats.kstest(moved.ravel(), "uniform").pvalue > 1e-4
    assert rp.uncertainty.same_plane(planes[0, 0], covariance[0, 0], -planes[0, 0], covariance[0, 0]) == 0.0
    assert rp.uncertainty.same_plane(planes[0, 0], covariance[0, 0], planes[0, 0], covariance[0, 0]) == 1.0
    missing = np.full(4, np.nan)
    assert np.isnan(rp.uncertainty.same_plane(missing, covariance[0, 0], planes[0, 0], covariance[0, 0]))
    with pytest.raises(ValueError, match=r"covariance of shape \(..., 3, 3\)"):
        rp.uncertainty.same_plane(a, c[..., 0], a, c)


@pytest.mark.parametrize(
    ("depth", "error"), [(0.0501, 2e-3), (0.2, 2e-3), (1.0, 2e-3), (19.5, 2e-3), (62.8, 0.05), (91.0, 0.05)]
)
def test_noise_by_depth_is_as_right_as_documented(depth, error):
    """Against a model of the same noise that is one number; some of these depths are half-way between entries."""
    frame, by_depth = np.full((48, 64), depth), rp.noise.time_of_flight(0.02)
    one_number = rp.noise.NoiseModel((float(by_depth.sigma(1.0 / depth)),))
    deviations = []
    for noise in (by_depth, one_number):
        camera = rp.Camera(64, 48, 52.0, 52.0, 31.5, 23.5, depth_range=(0.01, 1000.0), noise=noise)
        tiles = rp.fit_tiles(frame, camera)
        deviations.append(np.sqrt(np.diagonal(tiles.alpha_covariance, axis1=-2, axis2=-1)))
    assert np.isfinite(deviations).all()
    np.testing.assert_allclose(deviations[0], deviations[1], rtol=error)


@pytest.mark.parametrize(
    "noise",
    [
        rp.noise.NoiseModel((0.0, 0.0, 0.0), step=1e-3),
        rp.noise.NoiseModel(formula=lambda q: np.where(q > 1.0, 1e-3, 0.0), step=1e-3),
    ],
    ids=["nowhere", "near"],
)
def test_where_there_is_no_noise_but_rounding(noise):
    """p-values and covariances are those of a model that has none but rounding."""
    frame = np.rint(1e3 / (0.5 + 0.02 * CAMERA_OF_ROUNDING.tan_x)) / 1e3
    steps = frame + 0.2 * (np.arange(48) % 2)[:, None]
    wanted = rp.noise.NoiseModel((0.0,), step=1e-3)
    for depth, status in ((frame, rp.TileStatus.OK), (steps, rp.TileStatus.ROUGH)):
        by_depth, alone = (rp.fit_tiles(depth, replace(CAMERA_OF_ROUNDING, noise=model)) for model in (noise, wanted))
        assert (by_depth.status == status).all()
        np.testing.assert_allclose(by_depth.p_value, alone.p_value, rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(by_depth.alpha_covariance, alone.alpha_covariance, rtol=1e-6)


def test_a_jump_of_the_noise_is_one_from_the_lower_to_the_higher():
    noise = rp.noise.function(lambda q: np.where(q > 1.0, 2e-3, 2e-4))
    camera = replace(CAMERA_OF_ROUNDING, noise=noise)
    for q in (0.9999, 1.0001):  # in the middle
        depth = 1.0 / (q + 0.2 * camera.tan_x + 0.1 * camera.tan_y)
        with_noise = rp.fit_tiles(depth, camera, camera.shape)
        without = rp.fit_tiles(depth, replace(camera, noise=rp.noise.NoiseModel((1.0,))), camera.shape)
        sigma = with_noise.angle_std / without.angle_std
        assert sigma.min() > 1.9e-4
        assert sigma.max() < 2.2e-3


CAMERA_OF_ROUNDING = rp.Camera(64, 48, 52.0, 52.0, 31.5, 23.5)


@pytest.fixture
def two_planes(rng):
    """Planes with covariances, and draws of both from them."""
    planes, covariances, draws = [], [], []
    for normal, d in (((0.2, 0.1, -1.0), 1.5), ((0.8, -0.4, -0.7), 2.0)):
        unit = np.array(normal) / np.linalg.norm(normal)
        root = 1e-3 * rng.standard_normal((3, 3))
        alpha = -unit / d + rng.standard_normal((200_000, 3)) @ root.T
        projection = np.eye(3) - np.outer(unit, unit)
        slope = np.vstack([-d * projection, d * d * unit])
        planes.append(np.append(unit, d))
        covariances.append(slope @ root @ root.T @ slope.T)
        length = np.linalg.norm(alpha, axis=1, keepdims=True)
        draws.append(np.hstack([-alpha / length, 1.0 / length]))
    return planes, covariances, draws


def test_propagation_against_draws(two_planes, rng):
    (plane, other), (covariance, other_covariance), (draws, other_draws) = two_planes
    np.testing.assert_allclose(np.cov(draws.T), covariance, rtol=0.03, atol=2e-8)

    point, point_covariance = np.array([0.3, -0.2, 1.7]), np.diag([1e-6, 4e-6, 2e-6])
    distance, std = rp.uncertainty.point_distance(point, plane, covariance)
    alike = rp.uncertainty.point_distance(point, plane, np.stack([covariance, 4.0 * covariance]))
    np.testing.assert_allclose(alike, [[distance, distance], [std, 2.0 * std]])
    assert distance == pytest.approx(plane[:3] @ point + plane[3])
    assert std == pytest.approx((draws[:, :3] @ point + draws[:, 3]).std(), rel=0.01)
    points = point + rng.standard_normal((200_000, 3)) * np.sqrt(np.diag(point_covariance))
    _, std = rp.uncertainty.point_distance(point, plane, covariance, point_covariance)
    assert std == pytest.approx((np.sum(draws[:, :3] * points, axis=1) + draws[:, 3]).std(), rel=0.01)

    angle, std = rp.uncertainty.angle_between(plane, covariance, other, other_covariance)
    angles = np.degrees(np.arccos(np.sum(draws[:, :3] * other_draws[:, :3], axis=1)))
    assert angle == pytest.approx(angles.mean(), rel=1e-3)
    assert std == pytest.approx(angles.std(), rel=0.01)
    angle, std = rp.uncertainty.angle_between(plane, covariance, plane, covariance)
    assert angle == pytest.approx(0.0, abs=1e-6)
    assert 0.0 < std < 10.0

    rotation = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = rotation, [0.5, -1.0, 2.0]
    moved, moved_covariance = rp.uncertainty.transform_planes(plane, covariance, motion)
    foot = -plane[3] * plane[:3]
    assert moved[:3] @ (rotation @ foot + motion[:3, 3]) + moved[3] == pytest.approx(0.0, abs=1e-12)
    pose_covariance = np.diag([1e-6, 2e-6, 3e-6, 4e-6, 1e-6, 2e-6])
    moved, moved_covariance = rp.uncertainty.transform_planes(plane, covariance, motion, pose_covariance)
    pose = rng.standard_normal((200_000, 6)) * np.sqrt(np.diag(pose_covariance))
    normals = draws[:, :3] @ rotation.T
    normals = normals + np.cross(pose[:, :3], normals)
    offsets = draws[:, 3] - np.sum(normals * (motion[:3, 3] + pose[:, 3:]), axis=1)
    np.testing.assert_allclose(np.cov(np.column_stack([normals, offsets]).T), moved_covariance, rtol=0.03, atol=1e-7)
    for no_motion in (2.0 * motion, np.diag([1.0, 1.0, -1.0, 1.0]), np.nan * motion):
        with pytest.raises(ValueError, match=r"rigid motion .*\]$"):
            rp.uncertainty.transform_planes(plane, covariance, no_motion)


def test_a_pose_of_a_few_digits_is_its_nearest_rotation():
    """As poses of data sets are: with R as it stands the normals would lose their length."""
    rotation = Rotation.from_rotvec([0.3, -0.2, 0.1])
    motion = np.eye(4)
    plane, covariance = np.array([0.0, 0.6, -0.8, 2.0]), np.zeros((4, 4))
    for digits in (3, 4):
        motion[:3, :3] = rotation.as_matrix().round(digits)
        moved, _ = rp.uncertainty.transform_planes(plane, covariance, np.stack([motion, np.eye(4)]))
        nearest = Rotation.from_matrix(motion[:3, :3])
        np.testing.assert_allclose(moved[0, :3], nearest.apply(plane[:3]), atol=1e-9)
        np.testing.assert_allclose(np.linalg.norm(moved[:, :3], axis=1), 1.0, atol=1e-12)
        np.testing.assert_array_equal(moved[1], plane)
    motion[:3, :3] = rotation.as_matrix().round(2)
    with pytest.raises(ValueError, match=r"rigid motion .*: R·Rᵀ is off by 0.0"):
        rp.uncertainty.transform_planes(plane, covariance, motion)


def test_nothing_depends_on_the_frame_of_axes(rng):
    """Motions one after the other are one; distances and angles stay, and how far they may be off."""
    camera = rp.Camera(80, 64, 66.0, 66.0, 39.5, 31.5, noise=rp.noise.kinect_v1())
    tiles = rp.fit_tiles(rp.scenes.room().render(camera).measure(quantise=False, seed=rng), camera, 16)
    planes, covariance = tiles.planes, tiles.plane_covariance
    motions = np.tile(np.eye(4), (2, 1, 1))
    motions[:, :3, :3] = Rotation.from_rotvec(rng.standard_normal((2, 3))).as_matrix()
    motions[:, :3, 3] = rng.standard_normal((2, 3))
    there = rp.uncertainty.transform_planes(planes, covariance, motions[0])
    for made, wanted in zip(
        (
            *rp.uncertainty.transform_planes(*there, motions[1]),
            *rp.uncertainty.transform_planes(*there, np.linalg.inv(motions[0])),
        ),
        (*rp.uncertainty.transform_planes(planes, covariance, motions[1] @ motions[0]), planes, covariance),
        strict=True,
    ):
        np.testing.assert_allclose(made, wanted, rtol=1e-9, atol=1e-12 * np.abs(wanted).max())
    point, spread = rng.standard_normal(3), np.diag([1e-4, 4e-4, 9e-4])
    turn, shift = motions[0, :3, :3], motions[0, :3, 3]
    np.testing.assert_allclose(
        rp.uncertainty.point_distance(turn @ point + shift, *there, turn @ spread @ turn.T),
        rp.uncertainty.point_distance(point, planes, covariance, spread),
        rtol=1e-9,
    )
    np.testing.assert_allclose(
        rp.uncertainty.angle_between(there[0][1:], there[1][1:], there[0][:-1], there[1][:-1]),
        rp.uncertainty.angle_between(planes[:-1], covariance[:-1], planes[1:], covariance[1:]),
        rtol=1e-7,
    )


def test_leading_shapes_that_do_not_broadcast():
    eye, plane, planes = np.eye(4), np.array([0.0, 0.0, -1.0, 2.0]), np.ones((2, 3, 4))
    alpha = np.ones((2, 3, 3))
    for call in (
        lambda: rp.uncertainty.same_plane(alpha, np.eye(3), alpha[:1, :2], np.eye(3)),
        lambda: rp.uncertainty.point_distance(np.ones((5, 3)), planes, eye),
        lambda: rp.uncertainty.point_distance(np.ones(3), planes, eye, np.ones((5, 3, 3))),
        lambda: rp.uncertainty.angle_between(planes, eye, planes[0, :2], eye),
        lambda: rp.uncertainty.transform_planes(planes, eye, np.stack([eye, eye])),
        lambda: rp.uncertainty.transform_planes(plane, np.stack([eye] * 2), eye, np.ones((3, 6, 6))),
    ):
        with pytest.raises(ValueError, match=r"leading shapes that broadcast, got .*\("):
            call()


@pytest.mark.parametrize("metres", [0.0, 100.0, 1e5])
def test_same_plane_of_planes_far_from_the_origin(metres):
    """In a map's frame as in the camera's: it took planes 3 cm apart for one, 100 m away."""
    camera = rp.Camera(320, 240, 262.0, 262.0, 159.5, 119.5, noise=rp.noise.kinect_v1())
    near, far = (
        rp.fit_tiles(rp.scenes.plane((0.2, -0.3, -1.0), z).render(camera).measure(seed=3, quantise=False), camera, 8)
        for z in (2.0, 2.03)
    )
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()
    pose[:3, 3] = metres * np.array([0.8, 0.5, -0.3])
    moved, other = (rp.uncertainty.transform_planes(fits.planes, fits.plane_covariance, pose) for fits in (near, far))
    left, right = np.s_[:, :-1], np.s_[:, 1:]
    one = rp.uncertainty.same_plane(moved[0][left], moved[1][left], moved[0][right], moved[1][right])
    planes, covariance = near.planes, near.plane_covariance
    at_home = rp.uncertainty.same_plane(planes[left], covariance[left], planes[right], covariance[right])
    np.testing.assert_allclose(one, at_home, atol=1e-3)
    two = rp.uncertainty.same_plane(moved[0][left], moved[1][left], other[0][right], other[1][right])
    assert two.max() < 1e-3


def test_fused_tiles_are_the_plane_of_all_their_pixels(rng):
    camera = rp.Camera(64, 48, 60.0, 60.0, 31.5, 23.5, noise=rp.noise.kinect_v1())
    depth = rp.scenes.plane((0.3, 0.2, -1.0), 1.5).render(camera).measure(quantise=False, seed=rng)
    tiles = rp.fit_tiles(depth, camera, 16)
    whole = rp.merge(tiles, np.ones(tiles.shape, int))
    planes, covariance = tiles.planes.reshape(-1, 4), tiles.plane_covariance.reshape(-1, 4, 4)
    for metres in (0.0, 50.0):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()
        pose[:3, 3] = metres
        plane, of_plane = rp.uncertainty.fuse_planes(*rp.uncertainty.transform_planes(planes, covariance, pose))
        wanted, of_wanted = rp.uncertainty.transform_planes(whole.planes[0], whole.plane_covariance[0], pose)
        assert np.linalg.norm(plane[:3]) == pytest.approx(1.0)
        scale = np.sqrt(np.diag(of_wanted))
        assert (np.abs(plane - wanted) < 0.3 * scale).all()
        np.testing.assert_allclose(of_plane / np.outer(scale, scale), of_wanted / np.outer(scale, scale), atol=0.03)


def test_fused_planes_err_as_they_say(rng):
    """Of one wall, seen from several places; stacked, with one that is missing."""
    camera = rp.Camera(64, 48, 60.0, 60.0, 31.5, 23.5, noise=rp.noise.kinect_v1())
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.1, 0.4, -0.2]).as_matrix()
    pose[:3, 3] = [20.0, -5.0, 3.0]
    views = [rp.scenes.plane((0.3 * i, 0.2, -1.0), 1.5 + 0.2 * i).render(camera) for i in range(3)]
    turns = [np.eye(4) for _ in views]
    first = views[0].planes[0]
    for turn, view in zip(turns, views, strict=True):  # to where the first camera sees the same wall
        n, d = view.planes[0, :3], view.planes[0, 3]
        axis = np.cross(n, first[:3])
        angle = np.arctan2(np.linalg.norm(axis), n @ first[:3])
        turn[:3, :3] = Rotation.from_rotvec(axis / max(np.linalg.norm(axis), 1e-12) * angle).as_matrix()
        turn[:3, 3] = first[:3] * (d - first[3])
    truth = rp.uncertainty.transform_planes(first, np.zeros((4, 4)), pose)[0]
    squares = []
    for _ in range(100):
        seen = []
        for view, turn in zip(views, turns, strict=True):
            fits = rp.fit_labels(view.measure(quantise=False, seed=rng), camera, np.ones(camera.shape, int))
            seen.append(rp.uncertainty.transform_planes(fits.planes[0], fits.plane_covariance[0], pose @ turn))
        planes, covariance = (np.stack(values) for values in zip(*seen, strict=True))
        planes = np.stack([np.concatenate([planes, np.full((1, 4), np.nan)]), np.full((4, 4), np.nan)])
        covariance = np.stack([np.concatenate([covariance, covariance[:1]])] * 2)
        (plane, nothing), (of_plane, _) = rp.uncertainty.fuse_planes(planes, covariance)
        assert np.isnan(nothing).all()
        squares.append((plane - truth) @ np.linalg.pinv(of_plane, rcond=1e-9) @ (plane - truth))
    assert np.mean(squares) == pytest.approx(3.0, abs=1.0)


@pytest.mark.parametrize("degrees", [3.0, 6.0, 12.0])
def test_planes_are_fused_to_the_same_whichever_comes_first(degrees):
    """A poor one, turned by so much, and a good one: where errors are linear is where the good one is."""
    planes, covariance = [], []
    for turn, of_turn, of_offset in ((np.radians(degrees), np.radians(degrees) / 1.5, 0.05), (0.0, 1e-3, 1e-3)):
        normal = np.array([np.sin(turn), 0.2, -np.cos(turn)]) / np.sqrt(1.04)
        planes.append([*normal, 2.0 + of_offset])
        covariance.append(np.diag([0.0, 0.0, 0.0, of_offset**2]))
        covariance[-1][:3, :3] = of_turn**2 * (np.eye(3) - np.outer(normal, normal))
    fused, of_fused = rp.uncertainty.fuse_planes(planes, covariance)
    other, of_other = rp.uncertainty.fuse_planes(planes[::-1], covariance[::-1])
    assert (np.abs(fused - other) < 1e-3 * np.sqrt(np.diag(of_other))).all()
    np.testing.assert_allclose(of_fused, of_other, atol=1e-3 * of_other.max())


def test_planes_that_are_not_one_are_fused_to_something():
    planes = np.array([[0.0, 0.0, -1.0, 3.0], [0.0, -0.99, -0.14106736, 1.2]])
    covariance = np.diag([1e-6, 1e-6, 0.0, 1e-6]), np.diag([4e-4, 4e-4, 4e-4, 1e-6])
    fused, of_fused = rp.uncertainty.fuse_planes(planes, np.stack(covariance))
    assert np.linalg.norm(fused[:3]) == pytest.approx(1.0)
    assert np.isfinite(of_fused).all()


@given(st.integers(0, 2**32), st.sampled_from([-1.0, 1.0]))
def test_a_covariance_of_no_plane_is_refused(seed, sign):
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    errors = rng.normal(size=(1 if sign > 0.0 else 3, 4)) * [0.01, 0.01, 0.01, 0.03]
    errors[:, :3] -= (errors[:, :3] @ normal)[:, None] * normal
    with pytest.raises(ValueError, match="covariances of rank 3"):
        rp.uncertainty.fuse_planes([[*normal, 2.0]] * 2, [sign * errors.T @ errors] * 2)


def test_what_is_missing_has_no_angle_and_no_part_in_what_is_fused():
    """A plane, or its covariance alone, as from elsewhere."""
    normal = np.array([0.0, 0.6, -0.8])
    across = np.eye(3) - np.outer(normal, normal)
    plane, covariance = np.append(normal, 2.0), np.zeros((4, 4))
    covariance[:3, :3], covariance[3, 3] = 1e-4 * across, 1e-4
    none, unknown = np.full(4, np.nan), np.full((4, 4), np.nan)
    for missing in ((none, covariance), (plane, unknown)):
        assert np.isnan(rp.uncertainty.angle_between(*missing, plane, covariance)[1])
        both = (np.stack(pair) for pair in zip(missing, (plane, covariance), strict=True))
        fused, of_fused = rp.uncertainty.fuse_planes(*both)
        np.testing.assert_allclose(fused, plane, atol=1e-12)
        np.testing.assert_allclose(of_fused, covariance, atol=1e-12)
        assert np.isnan(np.vstack(rp.uncertainty.fuse_planes(*(part[None] for part in missing)))).all()


def test_what_cannot_be_fused_is_refused():
    plane, covariance = np.array([[0.0, 0.0, -1.0, 2.0]]), np.zeros((1, 4, 4))
    with pytest.raises(ValueError, match="covariances of rank 3"):
        rp.uncertainty.fuse_planes(plane, covariance)
    with pytest.raises(ValueError, match="point to one side"):
        rp.uncertainty.fuse_planes(np.concatenate([plane, -plane]), covariance)
    with pytest.raises(ValueError, match=r"\(..., K, 4\), K at least 1, got \(4,\)"):
        rp.uncertainty.fuse_planes(plane[0], covariance[0])


def test_same_plane_without_errors_is_refused():
    """It was NaN, as of planes that are missing; one of the two may be known exactly."""
    plane, other, none = np.array([0.0, 0.0, -1.0, 2.0]), np.array([0.0, 0.6, -0.8, 2.0]), np.zeros((4, 4))
    some = np.diag([1e-6, 1e-6, 0.0, 1e-6])
    for second in (plane, other):
        with pytest.raises(ValueError, match="covariances whose sums are of rank 3"):
            rp.uncertainty.same_plane(plane, none, second, none)
        with pytest.raises(ValueError, match="covariances whose sums are of rank 3"):
            rp.uncertainty.same_plane(-plane[:3] / 2.0, none[:3, :3], -second[:3] / 2.0, none[:3, :3])
    assert rp.uncertainty.same_plane(plane, none, plane, some) == 1.0
    missing = np.stack([plane, np.full(4, np.nan)])
    assert np.isnan(rp.uncertainty.same_plane(missing, some, plane, some)).tolist() == [False, True]
    assert np.isnan(rp.uncertainty.same_plane(plane, np.full((4, 4), np.nan), plane, none))
    assert rp.uncertainty.same_plane(missing[:0], some, plane, some).shape == (0,)


def test_same_plane_takes_every_correlation(rng):
    """Of whole tiles the two slopes have next to none."""
    factors = rng.standard_normal((2, 200, 3, 3))
    one, other = factors @ np.swapaxes(factors, -1, -2)
    alpha, other_alpha = 3.0 * rng.standard_normal((2, 200, 3))
    delta = alpha - other_alpha
    statistic = np.einsum("ki,kij,kj->k", delta, np.linalg.inv(one + other), delta)
    found = rp.uncertainty.same_plane(alpha, one, other_alpha, other)
    np.testing.assert_allclose(found, stats.chi2.sf(statistic, 3), rtol=1e-8)


def test_models_have_their_published_sigma_and_show_it():
    noise = rp.noise
    assert repr(noise.kinect_v1()) == "<NoiseModel: sigma 0.36 mm at 0.5 m, 1.4 mm at 1 m, 5.7 mm at 2 m>"
    assert "34 mm at 0.5 m, 140 mm at 1 m, 540 mm at 2 m" in repr(noise.axial(quadratic=0.135))
    for part in (
        "30 % correlated over 1.5 pixels",
        "floor 0.5 sigma over 20 pixels",
        "spread 0.2",
        "lateral 0.3 pixels",
    ):
        assert part in repr(replace(CORRELATED, spread=0.2, lateral=0.3))
    assert "0.4 % correlated over 8 pixels" in repr(rp.noise.NoiseModel(correlation=((0.004, 8.0),)))
    assert "a function" in repr(noise.function(lambda q: 1e-3 * q))
    for model in (CORRELATED, noise.function(lambda q: 1e-3 * q)):
        assert repr(rp.Camera(4, 4, 5.0, 5.0, 2.0, 2.0, noise=model)).isascii()
    assert noise.kinect_v1().sigma(0.3) == 1.425e-3
    np.testing.assert_allclose(noise.kinect_v1().sigma_depth([1.0, 2.0]), [1.425e-3, 5.7e-3])
    np.testing.assert_allclose(noise.stereo(0.05, 400.0, 0.08).sigma([0.2, 2.0]), 0.08 / 20.0)
    nguyen = noise.kinect_v1_nguyen().sigma_depth([0.4, 1.0, 3.0])
    np.testing.assert_allclose(nguyen, [0.0012, 0.0012 + 0.0019 * 0.36, 0.0012 + 0.0019 * 6.76])
    np.testing.assert_allclose(noise.time_of_flight(0.002, 0.001).sigma_depth([1.0, 4.0]), [0.003, 0.006])
    measured = noise.table([0.2, 1.0], [1e-3, 2e-3])
    np.testing.assert_allclose(measured.sigma([0.1, 0.6, 3.0]), [1e-3, 1.5e-3, 2e-3])
    np.testing.assert_allclose(noise.function(lambda q: 1e-3 * q).sigma([0.5, 2.0]), [5e-4, 2e-3])
    rounded = noise.quantised(noise.kinect_v1(), 0.001)
    np.testing.assert_allclose(rounded.sigma(2.0) ** 2, 1.425e-3**2 + 1e-6 * 16.0 / 12.0)
    camera = rp.Camera(4, 4, 5.0, 5.0, 2.0, 2.0, disparity=(-0.003, 3.0))
    assert noise.quantised(noise.kinect_v1(), camera).disparity_step == pytest.approx(0.003)
    np.testing.assert_allclose(rp.noise.kinect_v1().statistics([4, 100]).offset, 1.0)
    assert (np.diff(CORRELATED.statistics([4, 16, 64, 256, 1024]).offset) > 0.0).all()


def test_a_function_without_a_hash_is_a_noise(rng):
    """As polynomials of NumPy are; models of different ones stay apart where something is kept for a model."""
    camera = rp.Camera(64, 48, 52.5, 52.5, 31.5, 23.5)
    depth = 1.0 / rng.normal(0.5, 1.4e-3, camera.shape)
    models = [rp.noise.function(np.polynomial.Polynomial([sigma, 0.0, 1e-4])) for sigma in (1.4e-3, 2.8e-3)]
    assert models[0] != models[1] != rp.noise.function(np.poly1d([1e-4, 0.0, 2.8e-3]))
    once, twice = (rp.fit_tiles(depth, replace(camera, noise=model), 8).angle_std for model in models)
    ratio = models[1].sigma(0.5) / models[0].sigma(0.5)
    np.testing.assert_allclose(twice / once, ratio, rtol=0.01)


def test_a_model_is_pickled_without_its_table():
    model = rp.noise.kinect_v1_nguyen()
    before = pickle.dumps(model)
    assert len(before) < 1000
    camera = rp.Camera(64, 48, 52.5, 52.5, 31.5, 23.5, noise=model)
    p_value = rp.fit_tiles(np.full(camera.shape, 2.0), camera, 8).p_value
    assert pickle.dumps(model) == before
    copied = replace(camera, noise=pickle.loads(before))
    assert copied == camera
    np.testing.assert_array_equal(rp.fit_tiles(np.full(camera.shape, 2.0), copied, 8).p_value, p_value)


def test_rounding_alone_is_a_noise():
    for step in ({"step": 1e-3}, {"disparity_step": 1e-3}):
        np.testing.assert_allclose(rp.noise.NoiseModel((0.0,), **step).sigma(1.0), 1e-3 / np.sqrt(12.0))


def test_quantisation_is_part_of_the_covariance(rng):
    """Integer millimetres at 0.4 m, where rounding is most of the noise.

    Rounding errors vary less than normal ones of the same variance: the p-values crowd around their mean.
    """
    quiet = rp.noise.NoiseModel((1e-3,))
    camera = replace(monte_carlo.tile_camera(12, None), depth_scale=1000.0)
    camera = replace(camera, noise=rp.noise.quantised(quiet, camera))
    alpha = monte_carlo.plane_through_middle(camera, 0.4, 35.0)
    exact = replace(camera, noise=quiet)
    frames = np.rint(1000.0 * monte_carlo.measure(exact, alpha, 3000, rng)).astype(np.uint16)
    stack = monte_carlo.fit(camera, frames)
    assert np.mean(stack.p_value) == pytest.approx(0.5, abs=0.1)
    assert np.mean(monte_carlo.fit(exact, frames).p_value) < 1e-3


@pytest.mark.parametrize(
    "model",
    [
        rp.noise.kinect_v1_nguyen(), rp.noise.table([0.2, 1.0], [1e-3, 2e-3]), CORRELATED,
        rp.noise.quantised(replace(CORRELATED, spread=0.2), 0.001),
    ],
)  # fmt: skip
def test_model_goes_with_the_camera(model, tmp_path, rng):
    camera = rp.Camera(32, 32, 40.0, 40.0, 15.5, 15.5, noise=model)
    camera.save(tmp_path / "camera.json")
    assert rp.Camera.load(tmp_path / "camera.json") == camera
    assert hash(camera) == hash(rp.Camera.load(tmp_path / "camera.json"))
    tiles = rp.fit_tiles(1.0 + 0.001 * rng.standard_normal((32, 32)), camera)
    tiles.save(tmp_path / "tiles.npz")
    np.testing.assert_array_equal(rp.TilePlanes.load(tmp_path / "tiles.npz").p_value, tiles.p_value)
    with pytest.raises(ValueError, match="make a table"):
        replace(camera, noise=rp.noise.function(np.sqrt)).save(tmp_path / "camera.json")


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: rp.noise.stereo(0.0, 400.0), ValueError, "positive baseline, got 0.0"),
        (lambda: rp.noise.axial(), ValueError, "at least one coefficient"),
        (lambda: rp.noise.axial(None), TypeError, "constant as a number, got None"),
        (lambda: rp.noise.time_of_flight(1e-3, "a"), TypeError, "linear as a number, got 'a'"),
        (lambda: rp.noise.table([1.0, 2.0], "ab"), TypeError, "sigma as numbers, got an array of <U2"),
        (lambda: rp.noise.table([1.0, 0.5], [1e-3, 1e-3]), ValueError, "growing inverse depth"),
        (lambda: rp.noise.table([1.0], [1e-3, 1e-3]), ValueError, "one length"),
        (lambda: rp.noise.function(3.0), TypeError, "function"),
        (lambda: rp.noise.quantised(rp.noise.kinect_v1(), 0.0), ValueError, "positive step"),
        (lambda: rp.noise.quantised(1e-3, 0.001), TypeError, "NoiseModel"),
        (lambda: rp.noise.NoiseModel(correlation=((0.7, 2.0), (0.6, 5.0))), ValueError, "at most 1"),
        (lambda: rp.noise.NoiseModel(correlation=((0.7, 0.0),)), ValueError, "positive correlation lengths"),
        (lambda: rp.noise.NoiseModel(floor=-1.0), ValueError, "floor of 0 or more"),
        (lambda: rp.noise.NoiseModel((1e-3, np.nan)), ValueError, "coefficients as a finite number, got nan"),
        (lambda: rp.noise.NoiseModel(2e-3), TypeError, "coefficients as a sequence of numbers, got 0.002"),
        (lambda: rp.noise.NoiseModel(spread="a"), TypeError, "spread as a number, got 'a'"),
        (lambda: rp.noise.axial(-1e-3), ValueError, r"noise of 0 to 1e\+60 1/m at all inverse depths"),
        (lambda: rp.noise.NoiseModel((1e200,)), ValueError, r"got 1e\+200 at 0.0012207 1/m"),
        (lambda: rp.noise.time_of_flight(1e-3, -0.01), ValueError, "got -1.22055e-05 at 0.0012207 1/m"),
        (lambda: rp.noise.function(lambda q: q * np.nan), ValueError, "got nan at 0.0012207 1/m"),
        (lambda: rp.noise.function(lambda q: np.where(q < 2.0, q, np.inf)), ValueError, "got inf at 2.00195 1/m"),
        (lambda: rp.noise.function(np.diff), ValueError, r"of shape \(8193,\), got shape \(8192,\)"),
        (lambda: rp.noise.NoiseModel((0.0,)), ValueError, "noise above 0, or a step of rounding, got 0"),
        (lambda: rp.noise.function(lambda q: 0.0), ValueError, "noise above 0, or a step of rounding, got 0"),
        (lambda: rp.noise.stereo("a", 400.0), TypeError, "baseline as a number, got 'a'"),
        (lambda: rp.noise.NoiseModel.from_dict({"sigma": 1}), ValueError, "keys"),
        (lambda: rp.Camera(4, 4, 1.0, 1.0, 2.0, 2.0, noise=1e-3), TypeError, "NoiseModel or None, got float"),
        (lambda: rp.fit_tiles(np.ones((4, 4)), CAMERA, 4, significance=0.1), ValueError, "needs a camera"),
        (lambda: rp.fit_tiles(np.ones((4, 4)), CAMERA, 4, significance=1.0), ValueError, "below 1, got 1.0"),
        (lambda: rp.fit_tiles(np.ones((4, 4)), CAMERA, 4).p_value, ValueError, "noise model for uncert"),
    ],
)  # fmt: skip
def test_bad_arguments_are_refused(make, error, message):
    with pytest.raises(error, match=message):
        make()


CAMERA = rp.Camera(4, 4, 5.0, 5.0, 1.5, 1.5)


def test_angle_between_planes_that_coincide_has_its_largest_deviation():
    plane = np.array([0.0, 0.0, -1.0, 2.0])
    one, other = np.diag([9e-6, 1e-6, 0.0, 1e-6]), np.diag([7e-6, 3e-6, 0.0, 1e-6])
    angle, std = rp.uncertainty.angle_between(plane, one, plane, other)
    assert angle == 0.0
    assert std == pytest.approx(np.degrees(4e-3))


def test_rounding_is_added_to_the_rounding_that_there_is():
    model = rp.noise.NoiseModel((1e-3,), step=3e-3, disparity_step=4e-3)
    metres = rp.Camera(4, 4, 5.0, 5.0, 2.0, 2.0, depth_scale=250.0)
    disparity = rp.Camera(4, 4, 5.0, 5.0, 2.0, 2.0, disparity=(-3e-3, 3.0))
    for step, wanted in ((4e-3, (5e-3, 4e-3)), (metres, (5e-3, 4e-3)), (disparity, (3e-3, 5e-3))):
        made = rp.noise.quantised(model, step)
        assert (made.step, made.disparity_step) == pytest.approx(wanted)
