"""Errors that neighbours share: how many degrees of freedom they leave, and what they add to covariances."""

from dataclasses import replace

import numpy as np
import pytest

import rgbd_planes as rp
from bench import monte_carlo
from bench.monte_carlo import CORRELATED
from rgbd_planes.noise.correlation import ResidualStatistics
from rgbd_planes.uncertainty.footprints import footprints, like_rectangles


def rows_and_columns(height, width):
    """(height * width,) each."""
    return np.mgrid[:height, :width].reshape(2, -1)


def pixel_covariance(model, height, width):
    """Of the errors of all pixels of a rectangle, in units of σq²."""
    return monte_carlo.correlations(model, np.ones((height, width), bool))


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


def test_a_line_of_pixels_is_taken_for_two():
    made, expected = (CORRELATED.statistics(20, size) for size in ((1, 20), (2, 10)))
    for name in ("expected", "freedom", "tilt_x", "tilt_y", "offset"):
        assert getattr(made, name) == getattr(expected, name)


def test_of_two_statistics_the_larger_errors_count():
    """Each on its own, but the degrees of freedom go with the residual."""
    first = ResidualStatistics(*np.array([[9.0, 7.0], [5.0, 4.0], [1.0, 8.0], [2.0, 6.0], [3.0, 1.0]]))
    second = ResidualStatistics(*np.array([[8.0, 9.0], [6.0, 5.0], [3.0, 7.0], [1.0, 9.0], [4.0, 0.5]]))
    for one, other in ((first, second), (second, first)):
        larger = one.or_larger(other)
        found = [larger.expected, larger.freedom, larger.tilt_x, larger.tilt_y, larger.offset]
        np.testing.assert_array_equal(found, [[9.0, 9.0], [5.0, 5.0], [3.0, 8.0], [2.0, 9.0], [4.0, 1.0]])


def test_parts_of_any_shape_are_like_rectangles():
    """Full ones are themselves, pixels strewn over one are like it, and a disc has as many pixels as it has."""
    windows = np.array([[3, 5, 7, 12], [0, 0, 40, 2], [10, 20, 1, 9]])
    np.testing.assert_allclose(like_rectangles(footprints(windows)), windows[:, 2:], rtol=1e-12)

    def of_mask(mask):
        y, x = np.nonzero(mask)
        return like_rectangles(np.array([[len(x), x.sum(), y.sum(), (x * x).sum(), (y * y).sum()]]))[0]

    y, x = np.indices((60, 60))
    assert of_mask((y < 30) & ((x + y) % 2 == 0)) == pytest.approx([30.0, 60.0], rel=1e-3)
    disc = np.hypot(y - 30, x - 30) < 25
    height, width = of_mask(disc)
    assert height == pytest.approx(width)
    assert height * width == pytest.approx(disc.sum())


def test_pixels_here_and_there_tilt_more_than_a_small_square(rng):
    """Where errors reach far, slopes over the whole tile share more of them: the larger error counts."""
    model = rp.noise.NoiseModel(floor=1.0, floor_length=16.0)
    seen = rng.random(256) < 0.6
    y, x = rows_and_columns(16, 16)
    covariance = pixel_covariance(model, 16, 16)[seen][:, seen]
    rays = np.stack([x, y, np.ones(256)], axis=1)[seen]
    solve = np.linalg.pinv(rays)
    factors = np.diag(solve @ covariance @ solve.T) / np.diag(np.linalg.inv(rays.T @ rays))
    made = model.statistics(np.count_nonzero(seen), (16, 16))
    np.testing.assert_allclose([made.tilt_x, made.tilt_y], factors[:2], rtol=0.1)


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


def test_correlated_noise_of_a_window_does_not_depend_on_the_others(rng):
    """The same bits for small windows alone, and together with large ones."""
    camera = rp.Camera(300, 200, 300.0, 300.0, 149.5, 99.5, noise=CORRELATED)
    depth = 1.0 / (0.5 + 2.0 * rp.noise.KINECT_V1 * rng.standard_normal(camera.shape))
    small = np.array([(5, 9, height, width) for height in (14, 23, 31) for width in (18, 27, 39)])
    alone = rp.fit_windows(depth, camera, small)
    together = rp.fit_windows(depth, camera, np.concatenate([small, [(0, 0, 200, 300), (0, 0, 200, 200)]]))
    np.testing.assert_array_equal(together.p_value[: len(small)], alone.p_value)
    np.testing.assert_array_equal(together.alpha_covariance[: len(small)], alone.alpha_covariance)


@pytest.mark.parametrize("narrow", [(3, 19), (19, 3), (3, 76), (7, 7), (2, 100)])
def test_correlated_noise_of_a_narrow_window_does_not_depend_on_the_others(narrow):
    """Also where a rectangle of its proportions, in whole pixels, is smaller than the largest that is asked for."""
    made = CORRELATED.statistics(np.array([np.prod(narrow)]), np.array([narrow]))
    sizes = np.array([narrow, (4 * narrow[0], 4 * narrow[1])])
    with_others = CORRELATED.statistics(sizes.prod(axis=1), sizes)
    for name in ("expected", "freedom", "tilt_x", "tilt_y", "offset"):
        np.testing.assert_allclose(getattr(with_others, name)[0], getattr(made, name)[0], rtol=1e-12)


@pytest.mark.parametrize("tile", [(16, 16), (4, 48), (40, 6), (12, 20)])
def test_simulated_correlated_noise(tile, rng):
    """Frames with that noise: p-values are nearly uniform, covariances hold, and ignoring it fails."""
    runs = 3000
    camera = monte_carlo.tile_camera(tile, CORRELATED)
    error = monte_carlo.correlated_errors(CORRELATED, np.ones(tile, bool), runs, rng)
    alpha = monte_carlo.plane_through_middle(camera, 1.0, 20.0)
    frames = monte_carlo.measure(camera, alpha, runs, rng, error=error)
    stack = monte_carlo.fit(camera, frames)
    assert np.mean(monte_carlo.normalised_error(stack, alpha)) == pytest.approx(3.0, abs=0.2)
    slopes = (stack.alpha[:, 0, 0, :2] - alpha[:2]) ** 2
    variances = np.diagonal(stack.alpha_covariance, axis1=-2, axis2=-1)[:, 0, 0, :2]
    np.testing.assert_allclose(slopes.mean(axis=0), variances.mean(axis=0), rtol=0.1)
    assert np.mean(stack.p_value < 0.01) == pytest.approx(0.01, abs=0.012)
    assert np.mean(stack.p_value) == pytest.approx(0.5, abs=0.03)
    naive = monte_carlo.fit(camera.with_noise(rp.noise.kinect_v1()), frames)
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
    error = monte_carlo.correlated_errors(noise, np.ones((36, 36), bool), runs, rng)
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
    error = monte_carlo.correlated_errors(noise, np.ones(tile, bool), runs, rng)
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
    np.testing.assert_allclose(whole.p_value[0], stack.p_value[0, 0, 0], rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(whole.alpha_covariance[0], stack.alpha_covariance[0, 0, 0], rtol=1e-5)
    # Where which pixels are missing is known, covariances are those of these pixels.
    exact = monte_carlo.exact_covariance(camera, np.isfinite(frames[0]), alpha)
    for other, precision in ((labels, 0.02), (merged, 0.4), (rp.merge(merged, [1]), 0.4)):
        ratio = np.linalg.eigvals(np.linalg.solve(exact, other.alpha_covariance[0])).real
        np.testing.assert_allclose(ratio, 1.0, atol=precision)


@pytest.mark.parametrize("incidence", [0.0, 30.0, 60.0, 70.0])
@pytest.mark.parametrize(
    "errors", [{}, {"floor": 1.0}, {"floor": 2.0, "floor_length": 128.0}, {"correlation": ((0.9, 4.0),)}]
)
@pytest.mark.parametrize(
    "noise",
    [
        rp.noise.time_of_flight(0.005),
        rp.noise.kinect_v1_nguyen(),
        replace(rp.noise.kinect_v1(), falloff=4.0),
        replace(rp.noise.time_of_flight(0.005), falloff=2.0),
    ],
    ids=["time of flight", "nguyen", "falloff", "both"],
)
def test_tiles_whose_noise_changes_within_them(noise, errors, incidence):
    """Covariances are those of its pixels: an error that they share is larger where σ is, and tilts the plane."""
    camera = monte_carlo.tile_camera(16, replace(noise, **errors), left=500, top=100)
    alpha = monte_carlo.plane_through_middle(camera, 1.5, incidence, incidence / 10.0)
    q = alpha[0] * camera.tan_x + alpha[1] * camera.tan_y + alpha[2]
    exact = monte_carlo.exact_covariance(camera, np.ones(camera.shape, bool), alpha)
    for fits in (rp.fit_tiles(1.0 / q, camera, 16), rp.fit_windows(1.0 / q, camera, [(0, 0, 16, 16)])):
        covariance = fits.alpha_covariance.reshape(3, 3)
        np.testing.assert_allclose(covariance, covariance.T)
        np.testing.assert_allclose(np.linalg.eigvals(np.linalg.solve(exact, covariance)).real, 1.0, atol=0.03)


@pytest.mark.parametrize("depth", [0.8, 1.0, 1.25])
def test_p_values_where_noise_is_least(depth, rng):
    """At 1 m σq has a minimum: its slope there does not say by how much it differs over a tile."""
    noise, runs = rp.noise.axial(0.004, -0.008, 0.0045), 3000
    camera = rp.Camera(20, 20, 70.0, 70.0, 9.5, 9.5, noise=noise)
    q = 1.0 / depth + 2.5 * camera.tan_y
    frames = 1.0 / (q + noise.sigma(q) * rng.standard_normal((runs, 20, 20)))
    stack = rp.TileFitter(camera, 20).fit_batch(frames)
    assert np.mean(stack.p_value < 0.01) == pytest.approx(0.01, abs=0.008)
    assert np.mean(stack.p_value) == pytest.approx(0.5, abs=0.03)
    alpha = np.array([0.0, 2.5, 1.0 / depth])
    assert np.mean(monte_carlo.normalised_error(stack, alpha)) == pytest.approx(3.0, abs=0.2)
