"""What errors that neighbours share do to parts of any shape, against the covariance of all pairs of pixels."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.ndimage import minimum_filter

import rgbd_planes as rp
from bench import monte_carlo
from bench.monte_carlo import CORRELATED
from rgbd_planes.camera.depth_frame import DepthFrame
from rgbd_planes.fitting.methods import METHODS
from rgbd_planes.fitting.tile_grid import tile_windows
from rgbd_planes.kernels.segmentation.refit.interior import runs_inside
from rgbd_planes.kernels.statistics.tiles.block import EXPECTED, FREEDOM
from rgbd_planes.uncertainty.pixel_runs import joined, runs_found, runs_of_labels, runs_of_windows

FAR = rp.noise.NoiseModel((1e-3,), correlation=((0.6, 9.0),), floor=1.2, floor_length=40.0)
NOISES = {
    "near": CORRELATED,
    "far": FAR,
    "all of it": rp.noise.NoiseModel((1e-3,), correlation=((0.3, 2.0), (0.7, 4.0)), floor=0.7, floor_length=24.0),
    "lateral": replace(CORRELATED, lateral=0.5),
}


def camera_of(shape, noise, **options):
    camera = rp.Camera(shape[1], shape[0], 300.0, 280.0, 0.45 * shape[1], 0.6 * shape[0], noise=noise)
    return replace(camera, **options)


def depth_of(camera, alpha):
    return 1.0 / (alpha[0] * camera.tan_x + alpha[1] * camera.tan_y + alpha[2])


def ratios(covariance, exact):
    """The least and the largest ratio of variances in any direction."""
    found = np.linalg.eigvals(np.linalg.solve(exact, covariance)).real
    return found.min(), found.max()


def mask_of(kind, shape, rng):
    y, x = np.indices(shape)
    height, width = shape
    return {
        "all": np.ones(shape, bool),
        "holes": rng.random(shape) > 0.3,
        "frame": (np.minimum(x, width - 1 - x) < 3) | (np.minimum(y, height - 1 - y) < 3),
        "corner": (x < width // 4) | (y < height // 3),
        "diagonal": abs(x * height - y * width) < 4 * max(shape),
        "two pieces": (x < width // 6) | (x >= width - width // 8),
        "strewn": rng.random(shape) < 0.1,
    }[kind]


def runs_as_labels(runs, shape):
    """(N, H, W): the share of each pixel in each part."""
    made = np.zeros((len(runs.first) - 1, *shape))
    for i in range(len(made)):
        for k in range(runs.first[i], runs.first[i + 1]):
            made[i, runs.row[k], runs.start[k] : runs.stop[k]] += runs.share[k]
    return made


@pytest.mark.parametrize("kind", ["all", "holes", "frame", "corner", "diagonal", "two pieces", "strewn"])
@pytest.mark.parametrize("noise", NOISES.values(), ids=NOISES)
def test_small_parts_are_exact(kind, noise, rng):
    """Of at most 512 pixels, each of which is a cell: but for what is beyond reach."""
    shape = (20, 25)
    camera, alpha = camera_of(shape, noise), np.array([0.3, -0.2, 0.6])
    mask = mask_of(kind, shape, rng)
    depth = depth_of(camera, alpha)
    fits = rp.fit_labels(depth, camera, mask)
    least, most = ratios(fits.alpha_covariance[0], monte_carlo.exact_covariance(camera, mask, alpha))
    assert least > 0.995
    assert most < 1.005


@pytest.mark.parametrize("kind", ["all", "holes", "frame", "corner", "diagonal", "two pieces", "strewn"])
@pytest.mark.parametrize("noise", NOISES.values(), ids=NOISES)
def test_parts_of_many_pixels_are_nearly_exact(kind, noise, rng):
    shape = (80, 110)
    mask = mask_of(kind, shape, rng) & (rng.random(shape) < 0.97)
    mask[::3] &= np.indices(shape)[1][::3] % 2 == 0  # no more than the exact covariance has room for
    camera, alpha = camera_of(shape, noise), np.array([0.3, -0.2, 0.6])
    depth = depth_of(camera, alpha)
    fits = rp.fit_labels(depth, camera, mask)
    least, most = ratios(fits.alpha_covariance[0], monte_carlo.exact_covariance(camera, mask, alpha))
    assert least > (0.75 if kind == "diagonal" else 0.85)  # it is narrow, and cells are four pixels wide
    assert most < 1.05


@pytest.mark.parametrize("shape", [(80, 100), (160, 200)], ids=["cells of two pixels", "cells of four"])
def test_pixels_here_and_there(shape, rng):
    """They have most of their errors alone, if these reach over few pixels, also where a cell has room for more."""
    noise = rp.noise.NoiseModel((1e-3,), correlation=((0.9, 1.0),))
    camera, alpha = camera_of(shape, noise), np.array([0.3, -0.2, 0.6])
    mask = rng.random(camera.shape) < 0.05
    depth = depth_of(camera, alpha)
    fits = rp.fit_labels(depth, camera, mask)
    exact = monte_carlo.exact_covariance(camera, mask, alpha)
    assert ratios(fits.alpha_covariance[0], exact) == pytest.approx((1.0, 1.0), abs=0.05)
    alone = rp.fit_labels(depth, camera.with_noise(rp.noise.NoiseModel((1e-3,))), mask)
    assert ratios(alone.alpha_covariance[0], exact)[1] < 0.9


@pytest.mark.parametrize("distortion", [(), (0.2, -0.5, 0.001, 0.002, 0.3)], ids=["pinhole", "lens"])
@pytest.mark.parametrize(
    "noise",
    [
        replace(rp.noise.time_of_flight(0.01), correlation=((0.7, 3.0),), floor=0.5, floor_length=20.0),
        rp.noise.quantised(replace(CORRELATED, falloff=2.0), 0.001),
    ],
    ids=["by depth", "falloff"],
)
def test_variances_that_differ(noise, distortion):
    """Over a floor from 0.8 to 6 m, or away from the axis."""
    camera = replace(rp.Camera(44, 33, 40.0, 40.0, 21.5, 16.5, noise=noise), distortion=distortion)
    top, bottom = camera.tan_y.min(), camera.tan_y.max()
    slope = (1.0 / 0.8 - 1.0 / 6.0) / (bottom - top)
    alpha = np.array([0.02, slope, 1.0 / 6.0 - slope * top])
    depth = depth_of(camera, alpha)
    y, x = np.indices(camera.shape)
    mask = (x + y < 40) | (x > 30)
    fits = rp.fit_labels(depth, camera, mask)
    least, most = ratios(fits.alpha_covariance[0], monte_carlo.exact_covariance(camera, mask, fits.alpha[0]))
    assert least > 0.97
    assert most < 1.03


@pytest.mark.parametrize("method", METHODS)
def test_of_all_methods(method, rng):
    """They have the covariance of `range_explicit` on the same pixels, whatever the depths: here 1 to 3 m."""
    shape = (20, 20)
    camera, alpha = replace(camera_of(shape, FAR), fx=40.0, fy=40.0), np.array([0.9, -0.6, 0.55])
    mask = mask_of("corner", shape, rng)
    depth = depth_of(camera, alpha)
    found = rp.fit_labels(depth, camera, mask, method).alpha_covariance[0]
    assert ratios(found, monte_carlo.exact_covariance(camera, mask, alpha)) == pytest.approx((1.0, 1.0), abs=0.03)


@pytest.mark.parametrize("shape", [(10, 12), (26, 40)], ids=["small", "large"])
@pytest.mark.parametrize("kind", ["all", "holes", "corner", "two pieces", "strewn"])
@pytest.mark.parametrize("noise", list(NOISES.values())[:3], ids=list(NOISES)[:3])
def test_residuals(kind, noise, shape, rng):
    """Expected sum and degrees of freedom, tr(PC) and tr(PC)² / tr((PC)²): exact where each pixel is a cell."""
    camera, alpha = camera_of(shape, noise), np.array([0.3, -0.2, 0.6])
    mask = mask_of(kind, shape, rng)
    depth = depth_of(camera, alpha)
    made = rp.fit_labels(depth, camera, mask)._pixels.shared[0]
    rays = np.dstack([*np.broadcast_arrays(camera.tan_x, camera.tan_y), np.ones(shape)])[mask]
    residual = np.eye(len(rays)) - rays @ np.linalg.pinv(rays)
    covariance = residual @ monte_carlo.correlations(noise, mask)
    expected = np.trace(covariance)
    freedom = expected**2 / np.trace(covariance @ covariance)
    is_exact = shape == (10, 12)
    assert made[EXPECTED] == pytest.approx(expected * noise.sigma(1.0) ** 2, rel=1e-3 if is_exact else 0.01)
    assert made[FREEDOM] == pytest.approx(freedom, rel=5e-3 if is_exact else 0.2)


@pytest.mark.parametrize("shares", [((0.7, 2.0),), ((0.001, 2.0),)], ids=["shared", "hardly shared"])
def test_p_values_where_variances_differ(shares, rng):
    """Of a floor from 0.6 to 4 m: the chi-square that has the mean and the variance of the sum of squared residuals."""
    noise = replace(rp.noise.time_of_flight(0.01), correlation=shares)
    camera = rp.Camera(20, 24, 15.0, 15.0, 9.5, 11.5, noise=noise)
    slope = (1.0 / 0.6 - 1.0 / 4.0) / (camera.tan_y.max() - camera.tan_y.min())
    alpha = np.array([0.0, slope, 1.0 / 4.0 - slope * camera.tan_y.min()])
    q = alpha[0] * camera.tan_x + alpha[1] * camera.tan_y + alpha[2]
    mask = mask_of("corner", camera.shape, rng)
    rays = np.dstack([*np.broadcast_arrays(camera.tan_x, camera.tan_y), np.ones(camera.shape)])[mask]
    residual = np.eye(len(rays)) - rays @ np.linalg.pinv(rays)
    sigma = noise.sigma(q[mask])
    of_errors = sigma[:, None] * sigma * monte_carlo.correlations(noise, mask)
    covariance = residual @ of_errors
    expected = np.trace(covariance)
    freedom = expected**2 / np.trace(covariance @ covariance)
    p_values = []
    for error in rng.standard_normal((20, len(rays))) @ np.linalg.cholesky(of_errors + 1e-12 * np.eye(len(rays))).T:
        measured = q.copy()
        measured[mask] += error
        fits = rp.fit_labels(1.0 / measured, camera, mask)
        square = fits.valid_count[0] * fits.rmse[0] ** 2
        p_values.append(stats.chi2.sf(square / expected * freedom, freedom))
        assert fits.p_value[0] == pytest.approx(p_values[-1], abs=0.05)
    assert min(p_values) < 0.2
    assert max(p_values) > 0.8


@pytest.mark.parametrize("kind", ["frame", "diagonal", "two pieces", "strewn"])
@pytest.mark.parametrize("noise", list(NOISES.values())[:3], ids=list(NOISES)[:3])
def test_p_values_of_any_shape_are_uniform(kind, noise, rng):
    shape, runs = (40, 64), 800
    camera = monte_carlo.tile_camera(shape, noise)
    mask = mask_of(kind, shape, rng)
    alpha = monte_carlo.plane_through_middle(camera, 1.0, 20.0)
    error = monte_carlo.correlated_errors(noise, mask, runs, rng)
    frames = monte_carlo.measure(camera, alpha, runs, rng, error=error)
    fits = [rp.fit_labels(frame, camera, mask) for frame in frames]
    p_values = np.array([fit.p_value[0] for fit in fits])
    assert 0.002 < np.mean(p_values < 0.01) < 0.045
    assert np.mean(p_values) == pytest.approx(0.5, abs=0.07)
    errors = [fit.alpha[0] - alpha for fit in fits]
    normalised = [e @ np.linalg.solve(fit.alpha_covariance[0], e) for e, fit in zip(errors, fits, strict=True)]
    assert np.mean(normalised) == pytest.approx(3.0, abs=0.4)


@pytest.mark.parametrize("noise", NOISES.values(), ids=NOISES)
def test_unions_are_as_uncertain_as_their_pixels(noise, rng):
    """Of tiles, windows, labels and unions of them, with pieces that lie far apart."""
    camera, alpha = camera_of((96, 128), noise), np.array([0.3, -0.2, 0.6])
    depth = depth_of(camera, alpha)
    depth[rng.random(depth.shape) < 0.05] = 0.0
    tiles = rp.fit_tiles(depth, camera, (12, 16))
    union = np.zeros(tiles.shape, int)
    union[:3, :2] = union[6:, 5:] = 1
    union[3:6, 3:] = union[0, 7] = 2
    pixels = np.kron(union, np.ones((12, 16), int))
    wanted = rp.fit_labels(depth, camera, pixels)
    windows = rp.fit_windows(depth, camera, tile_windows(camera.shape, (12, 16)))
    parts = rp.fit_labels(
        depth, camera, np.kron(np.arange(1, union.size + 1).reshape(union.shape), np.ones((12, 16))).astype(int)
    )
    halves = rp.merge(tiles, np.where(union > 0, 2 * union - np.indices(union.shape)[1] % 2, 0))
    merged = {
        "tiles": rp.merge(tiles, union),
        "windows": rp.merge(windows, union.ravel()),
        "labels": rp.merge(parts, union.ravel()),
        "unions": rp.merge(halves, [1, 1, 2, 2]),
    }
    for name, fits in merged.items():
        for i in range(2):
            found = ratios(fits.alpha_covariance[i], wanted.alpha_covariance[i])
            assert found == pytest.approx((1.0, 1.0), abs=1e-6 if name == "labels" else 0.03), name
        np.testing.assert_allclose(fits.p_value, wanted.p_value, atol=0.02)
    for i in range(2):
        exact = monte_carlo.exact_covariance(camera, (pixels == i + 1) & (depth > 0.0), alpha)
        assert ratios(wanted.alpha_covariance[i], exact) == pytest.approx((0.97, 1.0), abs=0.05)


def test_a_part_is_as_uncertain_wherever_it_lies_and_however_many_there_are(rng):
    camera, alpha = camera_of((90, 120), FAR), np.array([0.0, 0.0, 0.6])
    depth = np.full(camera.shape, 1.0 / alpha[2])
    shape = mask_of("corner", (20, 25), rng)
    alone, many = np.zeros(camera.shape, int), rng.integers(2, 7, camera.shape)
    alone[:20, :25][shape] = 1
    many[61:81, 87:112][shape] = 1
    found = [rp.fit_labels(depth, camera, labels) for labels in (alone, many)]
    first, second = (fits._pixels.shared[0] for fits in found)
    np.testing.assert_allclose(first, second, rtol=1e-9, atol=1e-9 * np.abs(first[:3]).max())


def test_an_image_of_one_row_with_a_lens():
    """Its tanθx has one row, as without a lens, but its tanθy has a column for each pixel."""
    lens = 0.2, -0.2, 0.02, 0.03, 0.0
    nine = rp.Camera(64, 9, 50.0, 50.0, 31.5, 4.0, distortion=lens, noise=FAR)
    one = nine.cropped(0, 5, 64, 1)
    depth = depth_of(nine, (0.02, 0.05, 0.5))
    labels = np.zeros(nine.shape, int)
    labels[5] = 1
    expected = rp.fit_labels(depth, nine, labels)
    assert np.isfinite(expected.angle_std).all()
    windows = rp.fit_windows(depth[5:6], one, [[0, 0, 1, 64]])
    for found in (rp.fit_labels(depth[5:6], one, labels[5:6]), rp.merge(windows, [1])):
        np.testing.assert_allclose(found.alpha_covariance, expected.alpha_covariance, rtol=1e-6)


def test_another_noise_that_is_given_to_a_fit_counts():
    louder = rp.noise.NoiseModel((2e-3,), correlation=FAR.correlation, floor=FAR.floor, floor_length=FAR.floor_length)
    camera = camera_of((30, 40), FAR)
    depth = depth_of(camera, np.array([0.3, -0.2, 0.6]))
    fits = rp.fit_labels(depth, camera, np.ones(camera.shape, int))
    other = replace(fits, camera=camera.with_noise(louder))
    assert ratios(other.alpha_covariance[0], 4.0 * fits.alpha_covariance[0]) == pytest.approx((1.0, 1.0), abs=0.3)


@pytest.mark.parametrize("method", ["range_explicit", "standard_explicit", "standard_pca"])
def test_labels_without_a_pixel_have_no_uncertainty(method):
    camera = camera_of((30, 40), FAR)
    fits = rp.fit_labels(np.full(camera.shape, 2.0), camera, np.full(camera.shape, 3), method)
    assert np.isfinite(fits.angle_std).tolist() == [False, False, True]


@pytest.mark.filterwarnings("ignore:about 67% of this frame")
def test_pixels_without_a_ray():
    """Behind a fisheye whose image does not fill the frame."""
    camera = rp.Camera(
        64, 48, 12.0, 12.0, 31.5, 23.5, distortion=(0.0, 0.0, 0.0, 0.0), distortion_model="fisheye", noise=FAR
    )
    assert camera._without_ray.any()
    depth = np.ones(camera.shape)
    tiles = rp.fit_tiles(depth, camera, 8, max_missing=0.9)
    labels = rp.fit_labels(depth, camera, np.ones(camera.shape, int), max_missing=0.9)
    union = rp.merge(tiles, np.ones(tiles.shape, int))
    for fits in (labels, union):
        assert np.isfinite(fits.alpha_covariance[0]).all()
        assert np.linalg.eigvalsh(fits.alpha_covariance[0]).min() > 0.0
    assert ratios(union.alpha_covariance[0], labels.alpha_covariance[0]) == pytest.approx((1.0, 1.0), abs=0.15)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_runs_are_the_pixels_of_labels(data):
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    shape = data.draw(st.tuples(st.integers(1, 12), st.integers(1, 20)))
    labels = rng.integers(0, data.draw(st.integers(1, 4)), shape).astype(np.int32)
    labels = np.repeat(labels, data.draw(st.integers(1, 3)), axis=1)
    raw = rng.integers(0, data.draw(st.integers(2, 9)), labels.shape).astype(np.uint16)
    count = int(labels.max()) + data.draw(st.integers(0, 2))
    runs = runs_of_labels(labels, DepthFrame(raw, np.uint16(1), np.uint16(7), 1.0, 0.0, False, 1.0), count)
    wanted = (labels == np.arange(1, count + 1)[:, None, None]) & (raw >= 1) & (raw <= 7)
    np.testing.assert_array_equal(runs_as_labels(runs, labels.shape), wanted)
    unions = rng.integers(0, 3, count).astype(np.int32)
    made = runs_as_labels(joined(runs, unions, 2), labels.shape)
    np.testing.assert_array_equal(made, [wanted[unions == i].sum(axis=0) for i in (1, 2)])


def test_runs_of_windows_have_the_share_that_is_measured():
    windows = np.array([[0, 1, 2, 3], [1, 0, 2, 2], [0, 0, 3, 5]])
    made = runs_as_labels(runs_of_windows(windows, np.array([3, 4, 0], np.int32)), (3, 5))
    wanted = np.zeros((3, 3, 5))
    wanted[0, :2, 1:4], wanted[1, 1:, :2] = 0.5, 1.0
    np.testing.assert_array_equal(made, wanted)


def test_errors_that_all_pixels_share(rng):
    """Whatever their reach beyond the part: they move the plane as a whole."""
    camera = camera_of((30, 40), rp.noise.NoiseModel((1e-3,), correlation=((0.9, 1e50),), floor=2.0, floor_length=1e60))
    depth, mask = np.full(camera.shape, 2.0), mask_of("corner", (30, 40), rng)
    fits = rp.fit_labels(depth, camera, mask)
    independent = rp.fit_labels(depth, camera.with_noise(rp.noise.NoiseModel((1e-3 * 0.1**0.5,))), mask)
    expected = independent.alpha_covariance[0].copy()
    expected[2, 2] += 1e-6 * (0.9 + 4.0)
    assert ratios(fits.alpha_covariance[0], expected) == pytest.approx((1.0, 1.0), rel=0.02)
    assert fits._pixels.shared[0, FREEDOM] == pytest.approx(np.count_nonzero(mask) - 3, rel=0.01)


@pytest.mark.parametrize("holes", [0.0, 0.2])
def test_runs_inside_are_those_that_planes_are_fitted_to(holes, rng):
    labels = np.zeros((24, 40), np.int32)
    labels[2:20, 3:20], labels[2:20, 20:37], labels[20:22, 5:30] = 1, 2, 3
    measured = rng.random(labels.shape) >= holes
    labels[~measured] = 0
    missing, unclaimed = np.uint8(1), np.uint8(2)
    reason = np.where(measured, np.where(labels > 0, 0, unclaimed), missing).astype(np.uint8)
    moments, inside = np.ones((3, 10)), np.zeros((3, 10))
    inside[2] = 1.0  # fitted to all its pixels
    found = runs_found(lambda found: runs_inside(labels, reason, missing, moments, inside, found), labels.size, 3)
    made = runs_as_labels(found, labels.shape)
    for i in (1, 2):
        alike = minimum_filter(((labels == i) | ~measured).astype(int), 3, mode="nearest") == 1
        np.testing.assert_array_equal(made[i - 1], alike & measured & (labels == i))
    np.testing.assert_array_equal(made[2], measured & (labels == 3))


def test_the_same_bits_from_run_to_run(rng):
    camera = camera_of((60, 80), FAR)
    depth = 1.0 + 0.01 * rng.random(camera.shape)
    labels = rng.integers(0, 5, camera.shape)
    one, other = (rp.fit_labels(depth, camera, labels) for _ in range(2))
    np.testing.assert_array_equal(one.alpha_covariance, other.alpha_covariance)
    np.testing.assert_array_equal(one.p_value, other.p_value)
