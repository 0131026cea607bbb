"""p-values and covariances of parts that span many depths, where the noise depends on the depth."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from frames import make_camera, make_depth
from scipy import stats
from scipy.linalg import eigvalsh

import rgbd_planes as rp
from bench import monte_carlo
from rgbd_planes.fitting.tile_grid import tile_windows
from rgbd_planes.uncertainty.pixel_errors import mean_rays

CAMERA = rp.Camera(128, 96, 105.0, 105.0, 63.5, 47.5)
FLOOR = np.array([0.0, np.cos(np.pi / 6), np.sin(np.pi / 6)]) / 1.2  # from 1.3 to 8 m
NOISES = {
    "time of flight": rp.noise.time_of_flight(0.005),
    "time of flight, with a constant": rp.noise.time_of_flight(0.002, 0.001),
    "Kinect v1 of Nguyen et al.": rp.noise.kinect_v1_nguyen(),
    "table": rp.noise.table([0.1, 0.3, 0.8], [4e-3, 1e-3, 5e-3]),
}


def measured_floor(camera, frames, rng):
    """(frames, H, W) depth, and where the floor is seen."""
    q = FLOOR[1] * camera.tan_y + FLOOR[2] + 0.0 * camera.tan_x
    seen = q > 1.0 / 8.0
    sigma = camera.noise.sigma(np.where(seen, q, 1.0))
    return np.where(seen, 1.0 / (q + sigma * rng.standard_normal((frames, *q.shape))), 0.0), seen


@pytest.mark.parametrize("name", NOISES)
def test_p_values_of_a_floor_are_uniform(name, rng):
    """As a mask, as a union of tiles, and as a union of unions; of tiles alone they always are."""
    camera = replace(CAMERA, noise=NOISES[name])
    depth, seen = measured_floor(camera, 150, rng)
    tiles = rp.TileFitter(camera, 8).fit_batch(depth)
    halves = np.where(tiles[0].fitted, 1 + (np.arange(16) > 5), 0)
    masks, unions, rejected = [], [], 0
    for i in range(len(depth)):
        mask = rp.fit_labels(depth[i], camera, seen)
        union = rp.merge(rp.merge(tiles[i], halves), [1, 1])
        masks.append(mask.p_value[0])
        unions.append(union.p_value[0])
        rejected += mask.status[0] == rp.TileStatus.ROUGH
    assert rejected == np.count_nonzero(np.array(masks) < 0.01)
    for p_values in (masks, unions):
        assert stats.kstest(p_values, "uniform").pvalue > 1e-3


@pytest.mark.parametrize("name", NOISES)
def test_p_value_is_that_of_uneven_variances(name, rng):
    """By NumPy and SciPy, from each pixel's variance on the plane."""
    camera = replace(CAMERA, noise=NOISES[name])
    depth, seen = measured_floor(camera, 20, rng)
    for frame in depth:
        fits = rp.fit_labels(frame, camera, seen)
        n = fits.valid_count[0]
        rays = np.dstack([camera.tan_x, camera.tan_y, np.ones(camera.shape)])[seen]
        variance = camera.noise.sigma(rays @ fits.alpha[0]) ** 2
        expected = (1.0 - 3.0 / n) * variance.sum()
        freedom = (n - 3.0) * variance.sum() ** 2 / (n * np.sum(variance**2))
        p_value = stats.chi2.sf(freedom * n * fits.rmse[0] ** 2 / expected, freedom)
        assert fits.p_value[0] == pytest.approx(p_value, abs=0.01)


def sandwich(camera, chosen, alpha):
    """A⁻¹BA⁻¹ of pixels that err independently, by NumPy."""
    rays = np.dstack([camera.tan_x, camera.tan_y, np.ones(camera.shape)])[chosen]
    noise = camera.noise
    variance = noise.sigma(rays @ alpha, *rays.T[:2]) ** 2
    variance = variance + (noise.lateral * alpha[0] / camera.fx) ** 2 + (noise.lateral * alpha[1] / camera.fy) ** 2
    inverse = np.linalg.inv(rays.T @ rays)
    return inverse @ (rays.T * variance @ rays) @ inverse


@pytest.mark.parametrize("method", ["range_explicit", "range_implicit", "standard_pca"])
@pytest.mark.parametrize(
    "noise",
    [
        *NOISES.values(),
        replace(rp.noise.kinect_v1(), falloff=4.0),
        rp.noise.NoiseModel((1e-4,)),
        rp.noise.NoiseModel((0.0,), step=0.002),  # rounding alone
    ],
    ids=str,
)
@pytest.mark.parametrize("lateral", [0.0, 0.5])
def test_covariance_is_that_of_uneven_variances(noise, lateral, method, rng):
    """Of a mask and of a union of tiles; the axis in a corner of the image. Rounding alone is uneven, too."""
    camera = replace(CAMERA, noise=replace(noise, lateral=lateral, step=0.002), fy=90.0, cx=0.0)
    (depth,), seen = measured_floor(camera, 1, rng)
    exact = method.startswith("range")  # of points the rays are known to first order: from 1.7 to 2.3 m
    if not exact:
        seen &= np.indices(seen.shape)[0] // 8 == 7
        depth[~seen] = 0.0
    mask = rp.fit_labels(depth, camera, seen, method)
    wanted = sandwich(camera, seen, mask.alpha[0])
    scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    np.testing.assert_allclose(mask.alpha_covariance[0] / scale, wanted / scale, atol=1e-3 if exact else 0.1)
    tiles = rp.fit_tiles(depth, camera, 4, method)
    union = rp.merge(tiles, np.where(tiles.valid_count > 0, 1, 0))
    np.testing.assert_allclose(union.alpha_covariance[0] / scale, wanted / scale, atol=0.02 if exact else 0.1)


@pytest.mark.parametrize("missing", [0.0, 0.3])
@pytest.mark.parametrize("distortion", [(), (-0.2, 0.05, 0.001, -0.001, 0.0)], ids=["pinhole", "barrel"])
@pytest.mark.parametrize("fit", ["window", "tiles", "union of windows"])
@pytest.mark.parametrize(
    "noise",
    [
        *NOISES.values(),
        replace(rp.noise.kinect_v1(), falloff=6.0),
        replace(NOISES["time of flight"], falloff=4.0),
        rp.noise.NoiseModel((1e-4,), step=0.01),
        replace(NOISES["table"], step=1e-3),  # rounding that is even beside errors that are not
    ],
    ids=str,
)
def test_covariance_of_a_window_is_that_of_uneven_variances(noise, fit, distortion, missing, rng):
    """A mean variance for all pixels makes that of a window over the floor .4 to 5 times as large."""
    camera = replace(CAMERA, noise=noise, distortion=distortion)
    q = FLOOR[1] * camera.tan_y + FLOOR[2] + 0.05 * camera.tan_x
    top = int(np.flatnonzero((q > 1.0 / 8.0).all(axis=1))[0])
    seen = (q > 1.0 / 8.0) & (rng.random(q.shape) >= missing)
    depth = np.where(seen, 1.0 / q, 0.0)
    windows = np.array([[top, 0, 96 - top, 128], [top, 0, 40, 40], [top, 40, 40, 88]])
    if fit == "tiles":  # ragged ones, too
        fits = rp.fit_tiles(depth, camera, (36, 50), max_missing=0.6)
        windows = tile_windows(camera.shape, (36, 50))[fits.fitted.ravel()]
    else:
        fits = rp.fit_windows(depth, camera, windows)
        if fit == "union of windows":
            fits, windows = rp.merge(fits, [1, 0, 0]), windows[:1]
    assert len(windows) == {"tiles": 9, "window": 3, "union of windows": 1}[fit]
    found = zip(fits.alpha[fits.fitted], fits.alpha_covariance[fits.fitted], windows, strict=True)
    for alpha, covariance, (y, x, height, width) in found:
        inside = np.zeros_like(seen)
        inside[y : y + height, x : x + width] = seen[y : y + height, x : x + width]
        wanted = sandwich(camera, inside, alpha)
        # In any direction. A lens spreads rays less evenly.
        assert eigvalsh(covariance, wanted) == pytest.approx(1.0, abs=0.25 if distortion else 0.15)


@pytest.mark.parametrize("significance", [None, 0.2])
@pytest.mark.parametrize("name", NOISES)
def test_p_values_of_windows_are_uniform(name, significance, rng):
    """And those below the level are ROUGH, which is found out before they are known."""
    camera = replace(CAMERA, noise=replace(NOISES[name], lateral=0.3, falloff=1.0))
    q = FLOOR[1] * camera.tan_y + FLOOR[2] + 0.0 * camera.tan_x
    top = int(np.flatnonzero(q[:, 0] > 1.0 / 8.0)[0])
    windows = [(top, x, 96 - top, 32) for x in range(0, 128, 32)] + [(top, 0, 8, 8)]
    p_values = []
    for _ in range(60):
        error = camera.noise.sigma(q, camera.tan_x, camera.tan_y) * rng.standard_normal(q.shape)
        error += 0.3 * FLOOR[1] / camera.fy * rng.standard_normal(q.shape)
        depth = 1.0 / np.maximum(q + error, 1e-3)
        fits = rp.fit_windows(depth, camera, windows, significance=significance)
        p_values.append(fits.p_value)
        if significance:
            sure = np.abs(fits.p_value / significance - 1.0) > 0.02
            np.testing.assert_array_equal(
                (fits.status == rp.TileStatus.ROUGH)[sure], (fits.p_value < significance)[sure]
            )
    p_value = np.array(p_values)
    assert stats.kstest(p_value[:, :4].ravel(), "uniform").pvalue > 1e-3
    assert stats.kstest(p_value[:, 4], "uniform").pvalue > 1e-3


def test_uncertainty_of_a_window_does_not_depend_on_the_others(rng):
    """To the last bit: on those in whose block it is, and whether variances within these differ."""
    camera = replace(CAMERA, noise=NOISES["time of flight"])
    (depth,), seen = measured_floor(camera, 1, rng)
    top = int(np.flatnonzero(seen.all(axis=1))[0])
    small = [(y, x, 4, 4) for y in range(88, top, -4) for x in range(0, 128, 4)]
    windows = [*small, (top, 0, 96 - top, 128), *small]
    together = rp.fit_windows(depth, camera, windows)
    for i in (3, len(small) - 1, len(small), len(windows) - 1):
        alone = rp.fit_windows(depth, camera, [windows[i]])
        for name in ("p_value", "alpha_covariance", "plane_covariance", "angle_std"):
            np.testing.assert_array_equal(getattr(together, name)[i], getattr(alone, name)[0])


@pytest.mark.parametrize("method", ["range_explicit", "standard_pca"])
@pytest.mark.parametrize("name", NOISES)
def test_a_window_across_an_edge_has_the_variance_in_its_middle(name, method, rng):
    """It is ROUGH by any mean of variances, which are only taken for its neighbour."""
    camera = replace(CAMERA, noise=NOISES[name])
    (depth,), seen = measured_floor(camera, 1, rng)
    top = int(np.flatnonzero(seen.all(axis=1))[0])
    depth[top : top + 16, :32] = 4.0
    depth[top : top + 16, 16:32] = 1.0
    windows = [(top, 0, 16, 32), (top + 16, 0, 80 - top, 128)]
    fits = rp.fit_windows(depth, camera, windows, method)
    assert fits.status[0] == rp.TileStatus.ROUGH
    assert fits.p_value[0] < 1e-12
    even = rp.fit_windows(depth, replace(camera, noise=rp.noise.NoiseModel((1e-3,))), windows, method)
    edge, floor = fits.alpha_covariance / even.alpha_covariance
    np.testing.assert_allclose(edge, edge[0, 0], rtol=0.1)
    assert np.ptp(floor) > 0.01 * floor[0, 0]


@pytest.mark.parametrize("noise", [rp.noise.NoiseModel((1e-4,), step=0.002), rp.noise.time_of_flight(1e-4)], ids=str)
@pytest.mark.parametrize("lens", [(-0.2, 0.03, 0.002, -0.001, 0.0), (0.01, -0.005, 0.0, 0.0)])
def test_the_lateral_error_is_that_of_rays_through_the_lens(lens, noise):
    """Of masks in corners, where rays are farther apart, or nearer to each other, than on the axis."""
    camera = rp.Camera(192, 144, 115.0, 115.0, 90.5, 74.5, lens, "brown_conrady" if lens[4:] else "fisheye")
    camera = replace(camera, noise=replace(noise, lateral=0.5))
    alpha = np.array([0.25, -0.1, 0.8])
    rays = np.dstack([camera.tan_x, camera.tan_y, np.ones(camera.shape)])
    q = rays @ alpha
    slope_x, slope_y = np.gradient(q, axis=1), np.gradient(q, axis=0)
    variance = camera.noise.sigma(q) ** 2 + 0.5**2 * (slope_x**2 + slope_y**2)
    for corner in (np.s_[8:40, 8:48], np.s_[100:136, 140:184]):
        seen = np.zeros(camera.shape, int)
        seen[corner] = 1
        found = rp.fit_labels(1.0 / q, camera, seen).alpha_covariance[0]
        m = rays[corner].reshape(-1, 3)
        inverse = np.linalg.inv(m.T @ m)
        wanted = inverse @ (m.T * variance[corner].ravel() @ m) @ inverse
        scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
        np.testing.assert_allclose(found / scale, wanted / scale, atol=0.1)


def test_variances_that_are_alike_make_no_difference(rng):
    """A table of one value says what a single coefficient says, of errors that neighbours share, too."""
    shared = {"correlation": ((0.5, 3.0),), "floor": 0.5, "lateral": 0.3, "spread": 0.2}
    constant = replace(CAMERA, noise=replace(rp.noise.kinect_v1(), **shared))
    as_table = replace(CAMERA, noise=replace(rp.noise.table([0.1, 2.0], [rp.noise.KINECT_V1] * 2), **shared))
    (depth,), seen = measured_floor(constant, 1, rng)
    labels = seen * rng.integers(0, 3, seen.shape)
    one, other = (rp.fit_labels(depth, camera, labels) for camera in (constant, as_table))
    for name in ("alpha_covariance", "plane_covariance", "angle_std", "offset_std", "p_value"):
        a, b = getattr(one, name), getattr(other, name)
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-9 * np.abs(b).max())


@pytest.mark.parametrize("find", ["mask", "union", "segment"])
def test_errors_of_a_floor_are_those_of_its_covariance(find, rng):
    """Each coefficient's, which a mean variance for all pixels makes .4 to 1.2 times as large as it says."""
    camera = replace(CAMERA, noise=NOISES["time of flight"])
    depth, seen = measured_floor(camera, 150, rng)
    truth = np.array([0.0, FLOOR[1], FLOOR[2]])
    squares, distances = [], []
    for frame in depth:
        if find == "mask":
            fits = rp.fit_labels(frame, camera, seen)
        elif find == "union":
            tiles = rp.fit_tiles(frame, camera, 8)
            fits = rp.merge(tiles, np.where(tiles.valid_count > 0, 1, 0))
        else:
            fits = rp.segment(frame, camera)
        error, covariance = fits.alpha[0] - truth, fits.alpha_covariance[0]
        squares.append(error**2 / np.diag(covariance))
        distances.append(error @ np.linalg.solve(covariance, error))
    assert np.mean(squares, axis=0) == pytest.approx(1.0, abs=0.4)
    assert np.mean(distances) == pytest.approx(3.0, abs=0.7)


@pytest.mark.parametrize("distortion", [(), (0.2, -0.5, 0.001, 0.002, 0.3)])
@pytest.mark.parametrize("disparity", [None, (-0.002, 3.0)])
def test_sums_are_those_of_numpy(distortion, disparity, rng):
    """Of each label's valid pixels at its plane's depth, or, where it has none, at their own."""
    noise = rp.noise.quantised(rp.noise.time_of_flight(0.003, 0.002), 0.01)
    scale = {"disparity": disparity, "depth_scale": None, "invalid_values": (0,)} if disparity else {}
    camera = make_camera(distortion, noise=noise, **scale)
    depth = make_depth(camera, rng)
    raw = (((1.0 / depth - 3.0) / -0.002) if disparity else 1000.0 * depth).round().astype(np.uint16)
    raw[rng.random(raw.shape) < 0.2] = 0
    labels = rng.integers(0, 4, raw.shape)
    labels[labels == 3] = 0
    labels[10, 10:12] = 3  # too few for a plane
    raw[10, 10:12] = 1200
    fits = rp.fit_labels(raw, camera, labels)
    assert not fits.fitted[2]
    sums = fits._pixels.error_sums
    for i in range(3):
        chosen = (labels == i + 1) & np.isfinite(camera.points(raw)[..., 2])
        rays = np.stack([camera.tan_x, camera.tan_y, np.ones(camera.shape)], axis=-1)
        q = (
            rays @ fits.alpha[i]
            if fits.fitted[i]
            else (3.0 - 0.002 * raw if disparity else 1000.0 / np.maximum(raw, 1))
        )
        along, rounding = noise._along(q[chosen]) ** 2, (0.01 * q[chosen] ** 2) ** 2 / 12.0
        u, v, _ = rays[chosen].T
        products = np.stack([u, v, u * u, u * v, v * v]) @ (along + rounding)
        wanted = [along.sum(), rounding.sum(), np.sum((along + rounding) ** 2), *products]
        # The kernel looks them up in a table.
        np.testing.assert_allclose(sums[i], wanted, rtol=1e-4, atol=1e-4 * np.abs(products).max())


def test_where_a_plane_goes_beyond_infinity_the_noise_is_that_of_the_farthest():
    """What is measured there is far from the plane of its label, which a near surface has drawn."""
    camera = replace(CAMERA, noise=NOISES["table"])
    q = np.maximum(1.0 - 2.0 * (camera.tan_x - camera.tan_x[0, 0]), 0.02)
    fits = rp.fit_labels(1.0 / q, camera, np.ones(camera.shape, int))
    on_plane = fits.alpha[0, 0] * camera.tan_x + fits.alpha[0, 1] * camera.tan_y + fits.alpha[0, 2]
    assert on_plane.min() < -0.1
    wanted = np.sum(camera.noise._along(np.maximum(on_plane, 0.0)) ** 2)
    assert fits._pixels.error_sums[0, 0] == pytest.approx(wanted, rel=1e-3)


@pytest.mark.parametrize("noise", [*NOISES.values(), replace(rp.noise.kinect_v1(), correlation=((0.5, 3.0),))], ids=str)
@pytest.mark.parametrize("kind", ["windows", "labels", "union"])
def test_of_no_parts_there_are_no_uncertainties(kind, noise):
    camera = replace(CAMERA, noise=noise)
    depth = np.ones(camera.shape)
    if kind == "windows":
        fits = rp.fit_windows(depth, camera, np.empty((0, 4), int))
    elif kind == "labels":
        fits = rp.fit_labels(depth, camera, np.zeros(camera.shape, int))
    else:
        tiles = rp.fit_tiles(depth, camera, 16)
        fits = rp.merge(tiles, np.zeros(tiles.shape, int))
    assert fits.p_value.shape == fits.angle_std.shape == (0,)
    assert fits.alpha_covariance.shape == (0, 3, 3)


def test_tiles_without_a_pixel_add_nothing(rng):
    """Whatever a function says of an inverse depth of 0."""
    camera = replace(CAMERA, noise=rp.noise.function(lambda q: 2e-3 / np.sqrt(q)))
    depth, seen = measured_floor(camera, 1, rng)
    depth[:, :16] = 0.0
    tiles = rp.fit_tiles(depth[0], camera, 8)
    assert (tiles.valid_count == 0).any()
    union = rp.merge(tiles, np.ones(tiles.shape, int))
    mask = rp.fit_labels(depth[0], camera, seen)
    sums = mask._pixels.error_sums
    np.testing.assert_allclose(union._pixels.error_sums[:, :3], sums[:, :3], rtol=2e-3)
    np.testing.assert_allclose(union._pixels.error_sums[:, 3:], sums[:, 3:], atol=1e-2 * sums[:, 5:].max())
    assert union.p_value[0] == pytest.approx(mask.p_value[0], abs=0.1)


def test_tiles_of_a_column_of_pixels_have_no_width(rng):
    """What rounding leaves of it was divided by."""
    camera = replace(CAMERA, noise=NOISES["time of flight"])
    (depth,), seen = measured_floor(camera, 1, rng)
    for column in range(8):
        shown = np.where(np.arange(128) % 8 == column, depth, 0.0)
        union = rp.merge(rp.fit_tiles(shown, camera, 8), np.ones((12, 16), int))
        mask = rp.fit_labels(shown, camera, seen, max_missing=1.0)
        np.testing.assert_allclose(union._pixels.error_sums, mask._pixels.error_sums, rtol=0.02, atol=1e-6)
        np.testing.assert_allclose(union.angle_std, mask.angle_std, rtol=0.02)


def test_unions_that_have_no_plane_yet_have_the_noise_at_their_mean_depth():
    """Merged again, they make one that is as uncertain as if its parts were merged at once."""
    camera = rp.Camera(64, 48, 40.0, 40.0, 5.0, 23.5, noise=NOISES["time of flight"])
    rows = [[row, 30, 1, 30] for row in range(48)]
    lines = rp.fit_windows(1.0 / (0.5 + 0.3 * camera.tan_x), camera, rows, max_missing=1.0)
    alone = rp.merge(lines, np.arange(1, 49))
    assert not alone.fitted.any()
    halves = np.arange(48) // 24 + 1
    np.testing.assert_allclose(rp.merge(alone, halves).angle_std, rp.merge(lines, halves).angle_std, rtol=0.05)


def test_constant_noise_needs_no_sums(rng):
    camera = make_camera(noise=rp.noise.kinect_v1())
    fits = rp.fit_labels(make_depth(camera, rng), camera, np.ones(camera.shape, int))
    assert fits._pixels.error_sums is None
    assert rp.merge(fits, [1])._pixels.error_sums is None
    assert rp.fit_labels(make_depth(camera, rng), replace(camera, noise=None), np.ones(camera.shape, int)).fitted


def test_pixels_differ_where_only_their_rounding_does(rng):
    camera = replace(CAMERA, noise=rp.noise.quantised(rp.noise.NoiseModel((1e-3,)), 0.01))
    (depth,), seen = measured_floor(camera, 1, rng)
    fits = rp.fit_labels(depth, camera, seen)
    a, b, c = fits.alpha[0]
    q = (a * camera.tan_x + b * camera.tan_y + c)[seen]
    assert fits._pixels.error_sums[0, :2] == pytest.approx([1e-6 * len(q), np.sum((0.01 * q**2) ** 2 / 12.0)], rel=1e-3)


def test_mean_rays_of_points_are_those_of_their_pixels(rng):
    """To first order: the points are of a plane at a slant, seen over a few degrees."""
    u, v = np.array([[1.0, 0.0], [0.5, 1.0]]) @ rng.normal(0.0, 0.02, (2, 300)) + [[0.3], [-0.2]]
    z = 1.0 / (0.5 * u - 0.8 * v + 0.6)
    points = np.stack([np.ones_like(u), u * z, v * z, z])
    moments = (points @ points.T)[np.triu_indices(4)][:, None]
    _, rays, _ = mean_rays("standard_explicit", moments, np.zeros((3, 1)))
    assert rays[0] == pytest.approx([u.mean(), v.mean(), u.var(), np.mean((u - u.mean()) * v), v.var()], rel=0.1)


def test_sums_are_those_of_the_noise_that_the_camera_has(rng):
    """Another noise, given to what is fitted, counts; and sums go with a copy."""
    camera = replace(CAMERA, noise=NOISES["time of flight"])
    depth, seen = measured_floor(camera, 1, rng)
    fits = rp.fit_labels(depth[0], camera, seen)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(fits)).p_value, fits.p_value)
    louder = replace(camera, noise=rp.noise.time_of_flight(0.01))
    other = replace(fits, camera=louder)
    assert other.p_value[0] > 0.999
    # Where pixels are how noisy, is unknown then.
    again = rp.fit_labels(depth[0], louder, seen)
    assert other.angle_std[0] == pytest.approx(again.angle_std[0], rel=0.3)


@pytest.mark.parametrize(
    "noise",
    [
        rp.noise.axial(1e-4),
        rp.noise.quantised(rp.noise.kinect_v1(), 1e-5),
        rp.noise.function(lambda q: np.maximum(0.021 - 0.001 * q, 0.0) + 1e-5),  # falls up to the end of the table
    ],
)
@pytest.mark.parametrize("depth", [0.045, 0.02])
def test_tiles_unions_and_labels_nearer_than_the_table_of_the_noise_have_one_uncertainty(noise, depth, rng):
    camera = rp.Camera(32, 32, 60.0, 60.0, 15.5, 15.5, noise=noise)
    near = 1.0 / (1.0 / depth + 1e-3 * rng.standard_normal(camera.shape))
    number = np.arange(1, 5).reshape(2, 2)
    tiles = rp.fit_tiles(near, camera, 16)
    labels = rp.fit_labels(near, camera, np.kron(number, np.ones((16, 16), int)))
    for other in (rp.merge(tiles, number), labels):
        assert (other.offset_std > 0.0).all()
        np.testing.assert_allclose(other.offset_std, tiles.offset_std.ravel(), rtol=1e-3)
        np.testing.assert_allclose(other.p_value, tiles.p_value.ravel(), atol=1e-3)


@pytest.mark.parametrize("name", ["time of flight", "table"])
def test_p_value_is_that_of_uneven_variances_beside_an_even_one(name, rng):
    """The lateral error is the same all over a plane: the more there is of it, the less uneven are the pixels."""
    noise = replace(NOISES[name], lateral=0.4)
    camera = replace(CAMERA, noise=noise)
    depth, seen = measured_floor(camera, 20, rng)
    lateral = noise.lateral * FLOOR[1] / camera.fy
    p_values = []
    for frame in depth:
        frame[seen] = 1.0 / (1.0 / frame[seen] + lateral * rng.standard_normal(np.count_nonzero(seen)))
        fits = rp.fit_labels(frame, camera, seen)
        n = fits.valid_count[0]
        rays = np.dstack([camera.tan_x, camera.tan_y, np.ones(camera.shape)])[seen]
        slopes = fits.alpha[0, :2] / [camera.fx, camera.fy]
        variance = noise.sigma(rays @ fits.alpha[0]) ** 2 + noise.lateral**2 * slopes @ slopes
        expected = (1.0 - 3.0 / n) * variance.sum()
        freedom = (n - 3.0) * variance.sum() ** 2 / (n * np.sum(variance**2))
        p_values.append(stats.chi2.sf(freedom * n * fits.rmse[0] ** 2 / expected, freedom))
        assert fits.p_value[0] == pytest.approx(p_values[-1], abs=0.01)
    assert min(p_values) < 0.15 < 0.85 < max(p_values)


@pytest.mark.parametrize("lower", [1.0, 0.6, 0.4])
def test_errors_that_neighbours_share_tilt_windows_where_noise_grows(lower):
    """Covariances of windows that are uneven, of few and of many times the least variance, and neighbours that share.

    An error common to all pixels is larger where σ is: it is a tilt.
    """
    camera = rp.Camera(48, 36, 105.0, 105.0, 23.5, 17.5)
    noise = replace(rp.noise.time_of_flight(0.005), correlation=((0.5, 3.0),), floor=1.5)
    alpha = np.array([0.2, 0.5, lower])
    q = alpha[0] * camera.tan_x + alpha[1] * camera.tan_y + alpha[2]
    assert (q.max() / q.min()) ** 4 > 1.9
    found = rp.fit_windows(1.0 / q, replace(camera, noise=noise), [(0, 0, *camera.shape)]).alpha_covariance[0]
    exact = monte_carlo.exact_covariance(replace(camera, noise=noise), np.ones(camera.shape, bool), alpha)
    ratios = eigvalsh(found, exact)
    assert 0.97 < ratios.min() < ratios.max() < 1.2
