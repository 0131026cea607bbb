"""Models of a sensor's noise: what they say, what they take, and where they go."""

import pickle
import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

import rgbd_planes as rp
from bench import monte_carlo
from bench.monte_carlo import CORRELATED
from rgbd_planes.segmentation.quadtree import QuadtreeFitter

CAMERA = rp.Camera(4, 4, 5.0, 5.0, 1.5, 1.5)
CAMERA_OF_ROUNDING = rp.Camera(64, 48, 52.0, 52.0, 31.5, 23.5)


@pytest.mark.filterwarnings("ignore:the noise that is given")
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


@pytest.mark.filterwarnings("ignore:the noise that is given")
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


@pytest.mark.parametrize(
    ("inverse_depth", "says"),
    [([0.25, 0.33, 0.4, 1.0, 2.0], "0.36 mm at 0.5 m, 8.9 mm at 2.5 m, 23 mm at 4 m"), ([0.5], "5.7 mm at 2 m")],
)
def test_a_model_that_was_estimated_shows_its_sigma_where_it_was_seen(inverse_depth, says):
    evidence = SimpleNamespace(inverse_depth=np.array(inverse_depth))
    assert repr(replace(rp.noise.kinect_v1(), evidence=evidence)) == f"<NoiseModel: sigma {says}>"


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


def test_infinite_inverse_depth():
    """As 1 / 0, where nothing is measured."""
    with np.errstate(all="raise", under="ignore"):
        np.testing.assert_array_equal(rp.noise.kinect_v1().sigma([np.inf, 1.0]), [1.425e-3, 1.425e-3])
        assert rp.noise.kinect_v1().sigma_depth(1e-310) == 0.0


@pytest.mark.parametrize("side", [16, 40])
@pytest.mark.parametrize("slope", [0.15, 0.3, 0.45, 0.6])
@pytest.mark.parametrize(
    "noise", [rp.noise.kinect_v1_nguyen(), rp.noise.axial(0.001, 0.0, 0.002), rp.noise.time_of_flight(0.004)]
)
def test_the_variance_of_a_slanted_tile_is_the_mean_over_its_pixels(noise, slope, side):
    """Whether σq² is a power of q or not; inverse depths differ by ``slope``, relative to the middle."""
    for nearness in (0.4, 0.6, 1.1):
        camera = rp.Camera(side, side, 525.0, 525.0, side / 2 - 0.5, side / 2 - 0.5, noise=noise)
        q = nearness * (1.0 + slope * camera.tan_x / np.ptp(camera.tan_x))
        y, x = np.indices(camera.shape)
        variance = (noise.sigma(q) ** 2).mean()
        tiles = rp.fit_tiles(1.0 / (q + np.sqrt(variance) * (-1.0) ** (x + y)), camera, side, max_missing=1.0)
        statistic = side**2 * tiles.rmse[0, 0] ** 2 / variance
        taken = stats.chi2.isf(tiles.p_value[0, 0], side**2 - 3)
        assert taken == pytest.approx(statistic, rel=2e-3)  # uneven ones have fewer degrees of freedom


def test_a_slanted_tile_farther_than_the_first_entry_of_the_table():
    """Beyond 410 m noise that hardly changes with the depth is as one number, too."""
    deviations = []
    for coefficients in ((1e-5, 1e-9), (1e-5,)):
        noise = rp.noise.NoiseModel(coefficients)
        camera = rp.Camera(16, 16, 525.0, 525.0, 7.5, 7.5, depth_range=(0.1, 1e4), noise=noise)
        q = 2e-3 * (1.0 + 0.8 * camera.tan_x / np.ptp(camera.tan_x))
        deviations.append(rp.fit_tiles(1.0 / q, camera).angle_std)
    np.testing.assert_allclose(*deviations, rtol=1e-3)


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


@pytest.mark.filterwarnings("ignore:c[xy] =:UserWarning")  # of a part of an image
def test_quantisation_is_part_of_the_covariance(rng):
    """Integer millimetres at 0.4 m, where rounding is most of the noise.

    Rounding errors vary less than normal ones of the same variance: the p-values crowd around their mean. It is
    above one half, for where the codes lie they may leave more.
    """
    quiet = rp.noise.NoiseModel((1e-3,))
    camera = replace(monte_carlo.tile_camera(12, None), depth_scale=1000.0)
    camera = replace(camera, noise=rp.noise.quantised(quiet, camera))
    alpha = monte_carlo.plane_through_middle(camera, 0.4, 35.0)
    exact = replace(camera, noise=quiet)
    frames = np.rint(1000.0 * monte_carlo.measure(exact, alpha, 3000, rng)).astype(np.uint16)
    stack = monte_carlo.fit(camera, frames)
    assert 0.4 < np.mean(stack.p_value) < 0.7
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
        (lambda: rp.noise.NoiseModel(correlation=((0.7, 1e200),)), ValueError, r"lengths of at most 1e\+60 pixels"),
        (lambda: rp.noise.NoiseModel(floor=-1.0), ValueError, "floor of 0 or more"),
        (lambda: rp.noise.NoiseModel(floor=1e200), ValueError, r"floor of at most 1e\+60, got 1e\+200"),
        (lambda: rp.noise.NoiseModel(step=1e200), ValueError, r"step of at most 1e\+60, got 1e\+200"),
        (lambda: rp.noise.NoiseModel((1e-3, np.nan)), ValueError, "coefficients as a finite number, got nan"),
        (lambda: rp.noise.NoiseModel(2e-3), TypeError, "coefficients as a sequence of numbers, got 0.002"),
        (lambda: rp.noise.NoiseModel(spread="a"), TypeError, "spread as a number, got 'a'"),
        (lambda: rp.noise.axial(-1e-3), ValueError, r"noise of 0 to 1e\+60 1/m at all inverse depths"),
        (lambda: rp.noise.NoiseModel((1e200,)), ValueError, r"got 1e\+200 at 0.0012207 1/m"),
        (lambda: rp.noise.time_of_flight(1e-3, -0.01), ValueError, "got -1.22055e-05 at 0.0012207 1/m"),
        (lambda: rp.noise.function(lambda q: q * np.nan), ValueError, "got nan at 0.0012207 1/m"),
        (lambda: rp.noise.function(lambda q: np.where(q < 2.0, q, np.inf)), ValueError, "got inf at 2.00195 1/m"),
        (lambda: rp.noise.function(np.diff), ValueError, r"of shape \(8193,\), got shape \(8192,\)"),
        (lambda: rp.noise.kinect_v1().sigma(10**400), TypeError, "inverse_depth as numbers, got 1000"),
        (lambda: rp.noise.kinect_v1().sigma(1.0, "1"), TypeError, "tan_x as numbers, got an array of <U1"),
        (lambda: rp.noise.kinect_v1().sigma_depth(10**400), TypeError, "depth as numbers, got 1000"),
        (lambda: rp.noise.NoiseModel((0.0,)), ValueError, "noise above 0, or a step of rounding, got 0"),
        (lambda: rp.noise.function(lambda q: 0.0), ValueError, "noise above 0, or a step of rounding, got 0"),
        (lambda: rp.noise.stereo("a", 400.0), TypeError, "baseline as a number, got 'a'"),
        (lambda: rp.noise.function(lambda q: "a"), TypeError, "noise as numbers, got an array of <U1"),
        (lambda: rp.noise.function(lambda q: 1j * q), TypeError, "noise as numbers, got an array of complex128"),
        (lambda: rp.noise.NoiseModel.from_dict({"sigma": 1}), ValueError, "keys"),
        (lambda: rp.noise.NoiseModel.from_dict({"samples": None}), ValueError, "with coefficients or samples"),
        (lambda: rp.Camera(4, 4, 1.0, 1.0, 2.0, 2.0, noise=1e-3), TypeError, "NoiseModel or None, got float"),
        (lambda: rp.fit_tiles(np.ones((4, 4)), CAMERA, 4, significance=0.1), ValueError, "needs a camera"),
        (lambda: rp.fit_tiles(np.ones((4, 4)), CAMERA, 4, significance=1.0), ValueError, "below 1, got 1.0"),
        (lambda: rp.fit_tiles(np.ones((4, 4)), CAMERA, 4).p_value, ValueError, "noise model for uncert"),
    ],
)  # fmt: skip
def test_bad_arguments_are_refused(make, error, message):
    with pytest.raises(error, match=message):
        make()


def test_rounding_is_added_to_the_rounding_that_there_is():
    model = rp.noise.NoiseModel((1e-3,), step=3e-3, disparity_step=4e-3)
    metres = rp.Camera(4, 4, 5.0, 5.0, 2.0, 2.0, depth_scale=250.0)
    disparity = rp.Camera(4, 4, 5.0, 5.0, 2.0, 2.0, disparity=(-3e-3, 3.0))
    for step, wanted in ((4e-3, (5e-3, 4e-3)), (metres, (5e-3, 4e-3)), (disparity, (3e-3, 5e-3))):
        made = rp.noise.quantised(model, step)
        assert (made.step, made.disparity_step) == pytest.approx(wanted)


ROOM = replace(rp.presets.primesense(), width=160, height=120, fx=131.0, fy=131.0, cx=79.5, cy=59.5)
MEASURED = rp.scenes.room().render(ROOM).measure(holes=0.05)
USES = {
    "tiles": rp.fit_tiles,
    "windows": lambda depth, camera: rp.fit_windows(depth, camera, [(0, 0, 60, 80)]),
    "labels": lambda depth, camera: rp.fit_labels(depth, camera, np.ones(camera.shape, bool)),
    "quadtree": lambda depth, camera: rp.segment_quadtree(depth, camera, 16),
    "quadtree, integral": lambda depth, camera: QuadtreeFitter(camera, 16, implementation="integral").fit(depth),
    "segments": rp.segment,
    "points": rp.measurement_noise,
}


@pytest.mark.parametrize("use", USES.values(), ids=USES)
def test_models_of_other_units_are_doubted_where_they_are_used(use):
    for model in (rp.noise.NoiseModel(step=1000.0), rp.noise.time_of_flight(5.0), rp.noise.axial(1.2, 0.0, 1.9)):
        with pytest.warns(UserWarning, match=r"the noise that is given is .* lengths that are not in metres") as told:
            use(MEASURED, ROOM.with_noise(model))
        assert [warning.filename for warning in told] == [__file__]
    for model in (rp.noise.kinect_v1_nguyen(), rp.noise.time_of_flight(0.02), rp.noise.stereo(0.05, 600.0, 0.5)):
        use(MEASURED, ROOM.with_noise(model))  # warnings are errors here


@pytest.mark.parametrize("threads", [1, 2])
def test_a_fitter_doubts_its_noise_once(threads):
    fitter = rp.TileFitter(ROOM.with_noise(rp.noise.time_of_flight(5.0)), num_threads=threads)
    fitter.fit(np.zeros_like(MEASURED))  # which tells nothing
    with pytest.warns(UserWarning, match="the noise that is given") as told:
        fitter.fit_batch([MEASURED] * 4)
    assert [warning.filename for warning in told] == [__file__]
    fitter.fit(MEASURED)  # warnings are errors here
    list(fitter.fit_stream([MEASURED]))
    with pytest.warns(UserWarning, match="the noise that is given"):
        pickle.loads(pickle.dumps(fitter)).fit(MEASURED)


def test_depths_where_nothing_is_measured_have_no_deviation():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sigma = rp.noise.kinect_v1().sigma_depth([0.0, 2.0, -1.0, np.nan])
    np.testing.assert_allclose(sigma, [np.nan, 4.0 * rp.noise.KINECT_V1, np.nan, np.nan])


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"formula": 5}, TypeError, "formula as a function of inverse depth, got 5"),
        ({"formula": np.sqrt, "samples": ((1.0, 0.1),)}, ValueError, "samples or a formula, got both"),
    ],
)
def test_formulas_that_cannot_be_used(options, error, message):
    with pytest.raises(error, match=message):
        rp.noise.NoiseModel(**options)


def test_no_p_value_is_below_what_a_spread_allows():
    """A smaller significance would test nothing."""
    camera = rp.Camera(64, 64, 525.0, 525.0, 31.5, 31.5, noise=rp.noise.NoiseModel((1e-3,), spread=2.0))
    depth = np.where(np.arange(64) % 2 == 0, 3.0, 1.0) * np.ones((64, 1))
    assert rp.fit_tiles(depth, camera, 16).p_value.max() < 2e-5
    assert (rp.fit_tiles(depth, camera, 16, significance=1e-4).status == rp.TileStatus.ROUGH).all()
    with pytest.raises(ValueError, match=r"significance of 0, or of at least 9\.\de-06, with a noise whose spread"):
        rp.fit_tiles(depth, camera, 16, significance=1e-6)
