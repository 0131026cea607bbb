"""Segmentation: the noise that a frame shows, or that is given, decides what is a plane."""

import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.ndimage import gaussian_filter
from segment_frames import CAMERA, blocks_and_squares, smooth_noise, two_planes

from bench import block_scenes
from bench.segmentation import empty_room
from rgbd_planes import Camera, estimate_noise, segment
from rgbd_planes._core.status import Reason
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.evaluation import scenes
from rgbd_planes.evaluation.metrics import compare_labels
from rgbd_planes.kernels.common.quantiles import quantile
from rgbd_planes.kernels.segmentation.blocks.pyramid import read_frame
from rgbd_planes.kernels.segmentation.model import pixel_noise
from rgbd_planes.kernels.segmentation.model.pixel_noise import sensor_variance, sensor_variances, waviness
from rgbd_planes.kernels.segmentation.noise.estimate import estimate_noise as estimate_frame_noise
from rgbd_planes.kernels.segmentation.noise.estimate import grows_with_depth, varied_squares
from rgbd_planes.kernels.segmentation.noise.frame_noise import tolerance
from rgbd_planes.noise import NoiseModel, function, kinect_v1
from rgbd_planes.segmentation.frame_noise import correlation_table, noise_of
from rgbd_planes.segmentation.segment import _given, segment_frame
from rgbd_planes.segmentation.workspace import rays_of, workspaces


@pytest.mark.parametrize(("pixels", "expected"), [(0.0, 2), (1.5, 1)])
@pytest.mark.parametrize("seed", range(3))
def test_errors_that_neighbours_do_not_share_hide_less(pixels, expected, seed):
    # Four deviations apart: a sensor that bends its planes could make that of one, but not by independent errors.
    q, truth = two_planes(CAMERA, 0.004)
    found = segment(1.0 / (q + 1e-3 * smooth_noise(seed, pixels)), CAMERA)
    assert len(found) == expected
    if expected == 2:
        assert compare_labels(found.labels, truth).detection(0.9).recall == 1.0


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_a_bias_beside_independent_errors_costs_no_planes(share):
    rendering = empty_room().render(CAMERA)
    bias = (CAMERA.tan_x**2 + CAMERA.tan_y**2) / (CAMERA.tan_x**2 + CAMERA.tan_y**2).std()
    q = 1.0 / rendering.depth + 1e-3 * (smooth_noise(2, 0.0) + share * bias)
    found = segment(1.0 / q, CAMERA)
    assert compare_labels(found.labels, rendering.labels).detection(0.9).f_score == 1.0


@pytest.mark.parametrize(
    ("together", "sigma", "flattest", "expected"),
    [
        (0.0, 1e-3, 1e-4, 1.0),  # unknown
        (1.0, 1e-3, 1e-4, 1.0 / 3.0),
        (1.5, 1e-3, 1e-4, 2.0 / 3.0),
        (2.0, 1e-3, 1e-4, 1.0),
        (30.0, 1e-3, 1e-4, 1.0),
        (1.0, 1e-3, 5e-4, 0.5),  # surfaces bend by so much
        (1.0, 1e-4, 5e-4, 1.0),  # there is no noise
    ],
)
def test_what_is_tolerated(together, sigma, flattest, expected):
    assert tolerance(together, sigma, flattest) == pytest.approx(expected)


@pytest.mark.parametrize("noise", [None, 1e-4])
@pytest.mark.parametrize("wide", [8, 9, 11, 12])
def test_stripes_of_two_depths_are_no_waves_of_one_surface(wide, noise):
    stripe = np.arange(CAMERA.width) // wide
    q = np.where(stripe % 2 == 0, 1.0 + 0.1 * CAMERA.tan_x + 0.1 * CAMERA.tan_y, 0.5)
    found = segment(1.0 / q, CAMERA, noise=noise)
    assert (found.labels > 0).mean() > 0.99
    assert (found.rmse * found.mean_depth).max() < 1e-6


def test_waves_that_begin_at_16_pixels_do_not_make_one_of_what_is_far_apart(rng):
    # Mosaics of 8 pixels a stone: squares of 16 are fifty times as rough. One stands out by six times its roughness.
    stones = rng.standard_normal((CAMERA.height // 8, CAMERA.width // 8)).repeat(8, axis=0).repeat(8, axis=1)
    nearer = np.arange(CAMERA.width) >= CAMERA.width // 2
    q = 0.5 + 4e-3 * (stones + 6.0 * nearer) + rng.normal(0.0, 1e-4, CAMERA.shape)
    labels = segment(1.0 / q, CAMERA).labels
    assert (labels > 0).mean() > 0.9
    assert not {*labels[:, ~nearer].ravel()} & {*labels[:, nearer].ravel()} - {0}


def test_pixels_far_off_a_plane_do_not_make_it_rough(rng):
    # Two in ten by six deviations, by which they are still its own; they are most of its residual, 2.9 deviations of 3.
    q = 0.5 + rng.normal(0.0, 1e-3, CAMERA.shape)
    off = rng.random(CAMERA.shape) < 0.2
    q[off] += 6e-3 * rng.choice([-1.0, 1.0], np.count_nonzero(off))
    found = segment(1.0 / q, CAMERA, noise=1e-3)
    assert len(found) == 1
    assert (found.labels > 0).mean() > 0.98


@pytest.mark.parametrize(("deviations", "is_plane"), [(3.6, False), (2.6, True)])
def test_what_has_too_large_a_residual_is_no_plane(deviations, is_plane, rng):
    """What is nearer, on the right, is several times as noisy as the noise that is given."""
    q = np.full(CAMERA.shape, 0.5)
    q[:, 200:] = 0.7
    sigma = np.where(q > 0.6, deviations * 1e-3, 1e-3)
    frame = as_depth_frame((1.0 / (q + sigma * rng.normal(size=q.shape))).astype(np.float32), CAMERA)
    found = segment_frame(frame, CAMERA, _given(1e-3), 60)
    right = found.reason[:, 204:]
    assert np.mean((right == Reason.PLANE) == is_plane) > 0.95
    assert np.mean(found.reason[:, :196] == Reason.PLANE) > 0.99


@pytest.mark.parametrize(("noise", "warns"), [(5.0, True), (lambda q: 2.0 * q, True), (0.02, False)])
def test_noise_in_other_units_is_doubted(room, noise, warns):
    _, depth = room
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        segment(depth, CAMERA, noise=noise)
    assert [("most likely it is not in 1/m" in str(one.message)) for one in told] == [True] * warns


def test_a_function_of_noise_may_work_in_place(room):
    def in_place(q):
        q *= 4e-3
        return q

    _, depth = room
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = segment(depth, CAMERA, noise=in_place)
    assert np.array_equal(found.labels, segment(depth, CAMERA, noise=lambda q: 4e-3 * q).labels)


def test_noise_can_be_given():
    rng = np.random.default_rng(10)
    q, _ = two_planes(CAMERA, 0.01)
    depth = 1.0 / (q + rng.normal(0.0, 1e-3, q.shape))
    assert len(segment(depth, CAMERA)) == 2
    assert len(segment(depth, CAMERA, noise=1e-2)) == 1
    assert len(segment(depth, CAMERA, noise=lambda q: 1e-2 * np.ones_like(q))) == 1
    with pytest.warns(UserWarning, match="most likely it is not in 1/m"):
        found = segment(depth, CAMERA, noise=lambda q: np.full_like(q, 1e100))
    assert np.isfinite(found.alpha_covariance).all()
    with pytest.raises(ValueError, match="positive standard deviation"):
        segment(depth, CAMERA, noise=-1.0)
    with pytest.raises(TypeError, match="a number in 1/m"):
        segment(depth, CAMERA, noise="kinect")
    with pytest.raises(ValueError, match="min_size must be at least 3"):
        segment(depth, CAMERA, min_size=2)


@pytest.mark.parametrize("noise", [1e-4, lambda q: 1e-4 + 0.0 * q, kinect_v1()])
def test_the_noise_of_another_sensor_is_doubted(noise):
    """Where it costs planes: a frame of outliers is rough as well."""
    rendering = scenes.room().render(CAMERA)
    rng = np.random.default_rng(1)
    depth = np.rint(1000.0 / (1.0 / rendering.depth + rng.normal(0.0, 1e-2, CAMERA.shape))).astype(np.int32)
    with pytest.warns(UserWarning, match="several times as rough as the noise that is given"):
        segment(depth, CAMERA, noise=noise)
    strewn = np.where(rng.random(CAMERA.shape) < 0.05, 700, rendering.measure(seed=1))
    assert len(segment(strewn, CAMERA, noise=kinect_v1())) > 15


def room_of_correlated_noise(sigma, pixels):
    """The built-in room with errors that neighbours share, in steps of a millimetre, and its labels."""
    rendering = scenes.room().render(CAMERA)
    noise = gaussian_filter(np.random.default_rng(1).standard_normal(CAMERA.shape), pixels)
    q = 1.0 / rendering.depth + sigma * noise / noise.std()
    return np.rint(1000.0 / q).astype(np.uint16), rendering.labels


@pytest.mark.parametrize("pixels", [1.5, 2.5])
def test_a_sensors_noise_costs_no_planes_where_neighbours_share_their_errors(pixels):
    # All of such an error, as a tolerance between neighbours, would make one plane of many.
    depth, truth = room_of_correlated_noise(2e-3, pixels)

    def correct(noise):
        return compare_labels(segment(depth, CAMERA, noise=noise).labels, truth).hoover(0.8).correct

    assert correct(SimpleNamespace(sigma=lambda q: 2e-3 + 0.0 * q)) >= correct(None) >= 12
    assert correct(estimate_noise([depth], CAMERA)) >= correct(None) - 1
    assert correct(3e-3) < correct(None)  # a number is taken at its word


@pytest.mark.parametrize("pixels", [2.5, 4.0])
def test_crests_of_far_reaching_errors_are_no_planes(pixels):
    # A crest is flatter than any square of 8 pixels says of noise, and stands out by several times as much.
    rendering = empty_room().render(CAMERA)
    for seed in range(3):
        noise = gaussian_filter(np.random.default_rng(seed).standard_normal(CAMERA.shape), pixels)
        depth = np.rint(1000.0 / (1.0 / rendering.depth + 2e-3 * noise / noise.std())).astype(np.uint16)
        found = segment(depth, CAMERA)
        assert compare_labels(found.labels, rendering.labels).hoover(0.8).correct == 6
        assert len(found) <= 7


def test_a_model_counts_where_a_frame_shows_no_noise():
    # Rounding to coarse steps leaves most squares of a slanted wall without any residual.
    q = np.broadcast_to(0.6 + 0.1 * CAMERA.tan_x, CAMERA.shape)
    depth = np.rint(20.0 / q).astype(np.uint16)
    found = segment(depth, replace(CAMERA, depth_scale=20.0), noise=NoiseModel((5e-3,)))
    assert repr(found).startswith("<Segmentation: 1 plane, ")


def test_frames_of_few_pixels_do_not_pass_for_blurred():
    """With half a pixel of lateral error, as few steep squares made it, a tenth was on planes that it did not fit."""
    camera = Camera(54, 42, 50.0, 50.0, 26.5, 20.5)
    off = labelled = 0
    for seed in range(12):
        eye, look = (0.37 - 0.05 * seed, -0.14, 0.01), (-0.22 + 0.1 * seed, -0.32, 2.26)
        depth = scenes.room(eye, look).render(camera).measure(noise=1.425e-3, quantise=False, seed=seed)
        found = segment(depth, camera, noise=kinect_v1())
        error = np.abs(1.0 / depth - found.fitted_inverse_depth())
        off += np.count_nonzero((found.labels > 0) & (error > 20.0 * 1.425e-3))
        labelled += np.count_nonzero(found.labels)
    assert labelled > 0.6 * 12 * 54 * 42
    assert off < 0.01 * labelled


@pytest.mark.parametrize("farthest", [2.0, 45.0])
def test_noise_is_asked_for_where_it_is_known(farthest):
    asked = []

    def sigma(q):
        asked.append(q.min())
        return 1e-3 * np.sqrt(q)

    q = np.linspace(2.0 / farthest, 1.0 / farthest, CAMERA.height)  # of a plane
    depth = 1.0 / q[:, None] + np.zeros(CAMERA.shape)
    segment(depth, CAMERA, noise=sigma)
    assert min(asked) > 0.0
    asked.clear()
    segment(depth, CAMERA, noise=function(sigma))
    assert min(asked) > 1.2e-3


@pytest.mark.parametrize("noise", [None, NoiseModel((1e-3,)), lambda q: np.where(q > 0.0, 1e-3, np.nan)])
@pytest.mark.parametrize(("side", "millimetres"), [(1, 1), (1, 20), (10, 1), (40, 20)])
def test_specks_before_the_lens_change_nothing_elsewhere(room, noise, side, millimetres):
    _, depth = room
    expected = segment(depth, CAMERA, noise=noise)
    depth = depth.copy()
    depth[100 : 100 + side, 100 : 100 + side] = millimetres
    found = segment(depth, CAMERA, noise=noise)
    truth = expected.labels.copy()
    truth[100 : 100 + side, 100 : 100 + side] = 0
    comparison = compare_labels(found.labels, truth)
    assert comparison.hoover(0.8).correct >= len(np.unique(truth)) - 3 >= 15
    assert comparison.hoover(0.8).noise <= 1


@pytest.mark.parametrize(("lateral", "least", "most"), [(0.0, 0.0, 0.5), (1.5, 0.99, 1.0)])
def test_the_lateral_error_of_a_model_counts(lateral, least, most):
    # Each pixel of a steep floor is seen one and a half pixels too high or too low: no frame shows how much that is.
    rng = np.random.default_rng(20)
    y = np.indices(CAMERA.shape)[0] + rng.normal(0.0, 1.5, CAMERA.shape)
    q = np.where(np.arange(CAMERA.height)[:, None] < 120, 0.5, 0.5 + 3e-3 * (y - 119.5))
    noise = NoiseModel((5e-4,), lateral=lateral)
    found = segment(1.0 / (q + rng.normal(0.0, 5e-4, q.shape)), CAMERA, noise=noise)
    assert least <= (found.labels[120:] > 0).mean() <= most
    assert (found.labels[:100] == 1).all()


@pytest.mark.parametrize("share", [0.005, 0.01, 0.02, 0.03])
def test_outliers_strewn_over_the_image_cost_no_planes(share):
    # Hardly a square of 16 or 32 pixels is without one, which is no noise that grows; with more hardly one of 8. What
    # it may cost is knowing that errors are independent: then two that hardly differ are one.
    rendering = scenes.room().render(CAMERA)
    depth = rendering.measure(holes=0.05, quantise=False)
    correct = compare_labels(segment(depth, CAMERA).labels, rendering.labels).hoover(0.8).correct
    rng = np.random.default_rng(30)
    outliers = rng.random(depth.shape) < share
    depth[outliers] = 1.0 / rng.uniform(0.2, 2.0, np.count_nonzero(outliers))
    found = segment(depth, CAMERA)
    assert compare_labels(found.labels, rendering.labels).hoover(0.8).correct >= correct - 2


@pytest.mark.parametrize("reach", [2.8, 3.4])
def test_one_depth_for_all_that_is_beyond_the_range_is_not_taken_for_no_noise(reach):
    rendering = scenes.room().render(CAMERA)
    depth = rendering.measure(quantise=False)
    beyond = depth > reach
    truth = np.where(beyond, 0, rendering.labels)

    def measured(far: float) -> tuple[int, float]:
        found = segment(np.where(beyond, far, depth), CAMERA)
        return compare_labels(np.where(beyond, 0, found.labels), truth).hoover(0.8).correct, found.sigma

    correct, sigma = measured(np.nan)
    for far in (reach, 10.0):
        correct_so, sigma_so = measured(far)
        assert correct_so >= correct - 1
        assert sigma_so == pytest.approx(sigma, rel=0.05)


def test_steps_larger_than_the_noise_are_not_taken_for_no_noise():
    camera = Camera(width=640, height=480, fx=525.0, fy=525.0, cx=319.5, cy=239.5)
    rendering = scenes.room().render(camera)
    step = 0.5 / (525.0 * scenes.KINECT_BASELINE)  # half a pixel of disparity, in 1/m
    depth = rendering.measure(noise=0.1 * step, quantise=False)
    found = segment(1.0 / (step * np.rint(1.0 / (step * depth))), camera)
    assert compare_labels(found.labels, rendering.labels).hoover(0.8).correct >= 10


def test_edges_of_things_that_show_no_noise_are_not_taken_for_noise():
    camera = Camera(width=640, height=480, fx=525.0, fy=525.0, cx=319.5, cy=239.5)
    rng = np.random.default_rng(1)
    depth, truth = np.full(camera.shape, 3.0), np.ones(camera.shape, np.int32)
    for nearer in range(1, 41):
        y, x, height, width = rng.integers([0, 0, 15, 15], [440, 600, 160, 160])
        thing = np.s_[y : y + height, x : x + width]
        depth[thing], truth[thing] = 3.0 - 0.05 * nearer, 1 + nearer
    assert compare_labels(segment(depth, camera).labels, truth).hoover(0.8).correct >= 30


@given(
    arrays(np.float64, st.integers(2, 60), elements=st.one_of(st.floats(0, 1e6), st.sampled_from([0.0, 1.0, 2.0]))),
    st.floats(0, 0.99),
)
def test_a_quantile_is_numpys(values, share):
    np.testing.assert_allclose(quantile(values.copy(), share), np.quantile(values, share), rtol=1e-12, atol=1e-9)


def test_a_quantile_of_what_is_no_number_ends():
    assert np.isnan(quantile(np.full(5, np.nan), 0.3))
    quantile(np.array([1.0, np.nan, 0.0, np.nan, 2.0]), 0.3)


def test_noise_is_linear_between_the_entries_of_its_tables(rng):
    """That of squares as that of a pixel, and constant beyond the last; waves by the logarithm of a region's side."""
    table, growth = rng.uniform(1.0, 2.0, 9), np.array([1.0, 1.4, 2.3])
    sigma, q, variances = np.append(0.1, table), rng.uniform(0.0, 1.2, 50), np.empty(50)
    expected = np.interp(q, 0.1 * np.arange(9), table) ** 2
    assert [sensor_variance(of, sigma) for of in q] == pytest.approx(expected)
    sensor_variances(np.full(50, 16.0), 16.0 * q, sigma, variances)
    assert variances == pytest.approx(expected)
    side = 2.0 ** np.append([3.0, 4.0, 5.0], rng.uniform(1.0, 7.0, 20))
    assert [waviness(pixels, growth) for pixels in side**2] == pytest.approx(
        np.interp(np.log2(side), [3.0, 4.0, 5.0], growth)
    )


@pytest.mark.parametrize(
    "noise",
    [
        None,
        1e-5,  # less than surfaces are flat by
        2e-3,
        9e-3,  # so much that waves may be no higher
        lambda q: 1e-3 * (1.0 + q),
        kinect_v1(),
        replace(kinect_v1(), correlation=((0.5, 3.0),)),
    ],
)
@pytest.mark.parametrize("disparity", [None, (5e-4, 0.1)])
def test_the_noise_of_a_frame_is_what_is_given_and_what_it_shows(noise, disparity):
    # What `find_noise` does, on arrays.
    camera = replace(CAMERA, fy=200.0, disparity=disparity, depth_scale=None if disparity else 1000.0)
    q = 0.5 + 0.1 * camera.tan_x + 1.4e-3 * smooth_noise(3, 1.0)
    raw = np.rint((q - 0.1) / 5e-4 if disparity else 1000.0 / q).astype(np.uint16)
    frame, rays, given = as_depth_frame(raw, camera), rays_of(camera), _given(noise)
    _, pyramid, _ = blocks_and_squares(raw, camera)
    nearest, step_of_raw = 0.7, 2.0
    found, about = noise_of(frame, step_of_raw, rays, pyramid, nearest, given)

    inverse_depth = np.linspace(0.0, nearest, 33)
    step, flattest, growth = inverse_depth[1], 4e-4 * inverse_depth, np.empty(3)
    rounding = step_of_raw * (5e-4 if disparity else inverse_depth**2 / 1000.0) / np.sqrt(12.0)
    table, known = None, np.empty(0)
    if given.sigma is not None:
        table = np.maximum(given.sigma(np.maximum(inverse_depth, 0.5 * step)), flattest)
        known = np.concatenate([[step], table]) if given.is_sensors else known
    typical, lateral, by_32, together = estimate_frame_noise(pyramid, known, growth, correlation_table())
    if table is None:
        table = np.maximum(np.minimum(typical**0.5, 0.03 * np.maximum(inverse_depth, step)), rounding)
    elif given.is_sensors:
        table = np.minimum(np.maximum(typical**0.5 * table, rounding), table)
    sigma = np.maximum(table, flattest)
    shown = typical**0.5 * (known[17] if len(known) else 1.0)
    assert found.sigma == pytest.approx(np.concatenate([[step], sigma]), rel=1e-12)
    assert found.together == pytest.approx(1.0 + (max(together, 1.0) - 1.0) * min(shown / sigma[16], 1.0) ** 2)
    assert found.growth == pytest.approx(np.minimum(growth, max(0.03 * inverse_depth[16] / sigma[16], 1.0)))
    assert found.lateral_variance == pytest.approx(lateral**2)
    assert found.lateral_variance_x == pytest.approx((lateral / camera.fx) ** 2)
    assert found.lateral_variance_y == pytest.approx((lateral / camera.fy) ** 2)
    assert about.tolerance == pytest.approx(tolerance(by_32, table[16], flattest[16]))
    assert about.typical_sigma == pytest.approx(np.median(sigma))
    assert about.is_exact == (sigma[-1] <= flattest[-1])


def shows_noise_of_depth(depth: np.ndarray, camera: Camera) -> bool:
    """What the kernel says of a frame."""
    frame = as_depth_frame(depth.astype(np.float32), camera)
    with workspaces.lent(camera) as work:
        read_frame(*frame.values, rays_of(camera), work.inverse_depth, work.pyramid)
        return bool(grows_with_depth(work.pyramid))


@pytest.mark.parametrize(("power", "expected"), [(0.0, True), (1.0, False), (2.0, False)])
def test_noise_that_is_the_same_at_all_depths_is_told_from_that_of_triangulation(power, expected, rng):
    depth = np.broadcast_to(np.geomspace(4.0, 1.0, CAMERA.width), CAMERA.shape)
    noisy = depth + 0.004 * (depth / 2.0) ** power * rng.normal(size=depth.shape)
    assert shows_noise_of_depth(noisy, CAMERA) == expected


@pytest.mark.parametrize("share", [0.1, 0.3, 0.7, 0.9])
@pytest.mark.parametrize("near", [0.7, 2.0])
def test_noise_of_depth_is_seen_if_little_is_near_or_far(share, near, rng):
    camera = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
    is_near = (abs(camera.tan_x) < 320 / 525 * share**0.5) & (abs(camera.tan_y) < 240 / 525 * share**0.5)
    depth = np.where(is_near, near + 0.1 * camera.tan_x, 5.0 + 0.3 * camera.tan_x)
    noise = rng.normal(size=depth.shape)
    assert shows_noise_of_depth(depth + 5e-3 * noise, camera)
    assert not shows_noise_of_depth(1.0 / (1.0 / depth + 1e-3 * noise), camera)
    assert not shows_noise_of_depth(depth * (1.0 + 2e-3 * noise), camera)
    found = segment(depth + 5e-3 * noise, camera)
    assert len(found) == 2
    assert (found.labels[is_near] > 0).mean() > 0.99


def test_near_things_that_are_rough_do_not_make_noise_one_of_depth(rng):
    """Noise of 1/Z; only the nearest third is six times as noisy as the rest, as its square would make it."""
    depth = np.broadcast_to(np.geomspace(4.0, 1.0, CAMERA.width), CAMERA.shape)
    sigma = np.where(depth < 1.6, 6e-3, 1e-3)
    noisy = 1.0 / (1.0 / depth + sigma * rng.normal(size=depth.shape))
    assert not shows_noise_of_depth(noisy, CAMERA)


@pytest.mark.parametrize("depths", [(2.0, 2.0), (2.0, 2.5)])
def test_a_frame_of_hardly_different_depths_does_not_show_how_noise_depends_on_it(depths, rng):
    depth = np.broadcast_to(np.linspace(*depths, CAMERA.width), CAMERA.shape)
    assert not shows_noise_of_depth(depth + 0.004 * rng.normal(size=depth.shape), CAMERA)


def test_what_is_near_is_found_where_noise_is_one_of_depth():
    """Of 5 mm at all depths, that in 1/Z is six times as large for what is near."""
    sensor = replace(block_scenes.SENSORS[3], sigma_depth=5e-3)
    depth, truth = block_scenes.measure(sensor, 3)
    found = segment(depth, sensor.camera)
    given = segment(depth, sensor.camera, noise=lambda q: 5e-3 * q * q)
    for labels in (found.labels, given.labels):
        assert compare_labels(labels, truth).covering > 0.98
    assert found.share > 0.98


def test_squares_with_a_constant_quarter_show_no_noise():
    camera = Camera(256, 128, 300.0, 300.0, 127.5, 63.5, depth_scale=1000.0)
    rng = np.random.default_rng(3)
    flat = rng.random((32, 64)) < 0.1  # blocks, and squares of four
    flat |= (rng.random((16, 32)) < 0.3).repeat(2, axis=0).repeat(2, axis=1)
    depth = rng.integers(1000, 3000, camera.shape)
    depth = np.where(flat.repeat(4, axis=0).repeat(4, axis=1), 1500, depth).astype(np.uint16)
    _, pyramid, _ = blocks_and_squares(depth, camera)
    found = varied_squares(pyramid).rss
    for level, (rows, columns) in enumerate(pyramid.shapes):
        here = slice(pyramid.offsets[level], pyramid.offsets[level + 1])
        expected = pyramid.rss[here].copy()
        if level > 0:
            quarters = flat.reshape(rows, 2, columns, 2)
            expected[quarters.any(axis=(1, 3)).ravel()] = -1.0
            flat = quarters.all(axis=(1, 3))
        np.testing.assert_array_equal(found[here], expected)


@pytest.mark.parametrize("side", [8, 12, 14])
@pytest.mark.parametrize("noise", [None, 1e-3], ids=["estimated", "given"])
def test_steps_of_a_regular_grid_are_no_waves(side, noise, rng):
    """Squares of 16 pixels in which steps lie between squares of 8 passed for noise that grows, by six times."""
    camera = Camera(width=320, height=240, fx=262.5, fy=262.5, cx=159.5, cy=119.5)
    row, column = np.indices(camera.shape) // side
    q = 1.0 / (1.5 + 0.03 * rng.integers(0, 8, (30, 40))[row, column])
    q += 1e-3 * rng.standard_normal(q.shape)
    found = segment(1.0 / q, camera, noise=noise)
    there = found.labels > 0
    off = np.abs(q - found.fitted_inverse_depth())[there]
    assert np.mean(there) > 0.9
    assert np.mean(off > 6e-3) < 0.01


@pytest.mark.parametrize("q", [-1e-9, -1e3, -1e300, -np.inf, np.nan])
def test_a_mean_that_rounding_made_negative_counts_as_zero(q):
    """Where a sum of inverse depths cancels beside 1/Z of 1e17, no entry before the table is read."""
    sigma = np.array([0.25, 3.0, 4.0, 5.0])
    variance = np.empty(3)
    pixel_noise.sensor_variances(np.ones(3), np.array([q, 0.0, 0.25]), sigma, variance)
    assert variance.tolist() == [9.0, 9.0, 16.0]
    assert [pixel_noise.sensor_variance(value, sigma) for value in (q, 0.0, 0.25, 1e300)] == [9.0, 9.0, 16.0, 25.0]
