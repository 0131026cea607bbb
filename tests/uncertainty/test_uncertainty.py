"""Covariances, p-values and what follows from them, against simulation and against plain linear algebra."""

import pickle
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy import special, stats

import rgbd_planes as rp
from bench import monte_carlo
from bench.monte_carlo import CORRELATED
from rgbd_planes.fitting.methods import METHODS
from rgbd_planes.kernels.statistics.distributions import chi_square, f_ratio
from rgbd_planes.kernels.statistics.distributions.normal import WORK
from rgbd_planes.kernels.statistics.distributions.normal import tails as normal_tails
from rgbd_planes.noise import correlation
from rgbd_planes.uncertainty import statistics

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
    camera = monte_carlo.tile_camera(tile, rp.noise.kinect_v1(), left=100, top=60)
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
    camera = monte_carlo.tile_camera(20, rp.noise.kinect_v1(), left=100)
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
    camera = monte_carlo.tile_camera(12, rp.noise.kinect_v1(), left=300)
    alpha = monte_carlo.plane_through_middle(camera, 1.5, 50.0)
    stack = monte_carlo.fit(camera, monte_carlo.measure(camera, alpha, 5, rng))
    for i in range(5):
        fitted = stack.alpha[i, 0, 0]
        ends = [[monte_carlo.plane_of(fitted + sign * 1e-6 * axis) for sign in (1, -1)] for axis in np.eye(3)]
        slope = np.array([(high - low) / 2e-6 for high, low in ends]).T
        wanted = slope @ stack.alpha_covariance[i, 0, 0] @ slope.T
        np.testing.assert_allclose(stack.plane_covariance[i, 0, 0], wanted, rtol=1e-5, atol=1e-12)


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
    inverse = correlation.inverse_freedom(spread)
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
        work[0], work[1] = ratio, 1.0 / freedom
        f_ratio.deviates(inverse, work, len(freedom))
        normal_tails(work, len(freedom))
        assert low * p < work[0].min() < work[0].max() < high * p
        deviate = correlation.deviate_of(ratio, freedom, spread)
        np.testing.assert_allclose(work[0], stats.norm.sf(deviate), rtol=1e-5)
        limit = correlation.ratio_at(stats.norm.isf(p), freedom, spread)
        np.testing.assert_allclose(correlation.deviate_of(limit, freedom, spread), stats.norm.isf(p), atol=1e-12)


def test_tails_end_at_one_and_zero_and_keep_nan():
    """No residual, one that is beyond all bounds, and none that is a number."""
    work = np.empty((WORK, 4))
    for deviates in (chi_square.deviates, partial(f_ratio.deviates, 0.01)):
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
    even = monte_carlo.fit(camera.with_noise(replace(model, spread=0.0)), frames)
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
    without = monte_carlo.fit(camera.with_noise(noise), frames)
    assert np.mean(without.p_value < 0.01) > 0.2


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
    limits = statistics._limits(statistics.DEFAULT_SIGNIFICANCE, 0.0)
    made = statistics._made_limits(statistics.DEFAULT_SIGNIFICANCE)
    np.testing.assert_allclose(limits, made, rtol=1e-7)  # a fit, whose last digits are the processor's
    freedom = np.geomspace(1.0, 1e5, 200)
    p = stats.chi2.sf(np.polynomial.Polynomial(limits)(freedom**-0.5) * freedom, freedom)
    np.testing.assert_allclose(p, statistics.DEFAULT_SIGNIFICANCE, atol=2e-5)


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
