"""Rounding errors that all pixels of a surface have in common."""

from dataclasses import replace

import numpy as np
import pytest

import rgbd_planes as rp
from rgbd_planes.kernels.statistics.rounding import between_codes, in_common

STEP = 1.0 / (525.0 * 0.075 * 8)  # 1/m: an eighth of a pixel of disparity
CAMERA = rp.Camera(160, 128, 525.0, 525.0, 79.5, 63.5, disparity=(STEP, 0.0), invalid_values=(0,))


def series(sigma, x):
    """Mean of rounded values x + noise, less x, in steps: by the normal distribution, not by the series."""
    from scipy.stats import norm

    levels = np.arange(-6, 7)
    upper, lower = (levels + side - x[:, None] for side in (0.5, -0.5))
    if sigma == 0.0:
        return np.rint(x) - x
    return (norm.cdf(upper / sigma) - norm.cdf(lower / sigma)) @ levels - x


@pytest.mark.parametrize("sigma", [0.0, 0.1, 0.2, 0.3, 0.4, 0.5])
def test_mean_square_is_that_of_rounded_noise(sigma):
    x = np.linspace(-0.5, 0.5, 20_001)[:-1] + 2.5e-5
    slope_u, slope_v, mean = in_common(STEP**2, (sigma * STEP) ** 2, 100.0, 0.0, 0.0)
    wanted = np.mean(series(sigma, x) ** 2) * STEP**2
    assert 0.99 * wanted <= mean / 100.0 + 1e-5 * STEP**2 <= 1.12 * wanted + 2e-5 * STEP**2
    assert slope_u == slope_v <= 1.5 * mean  # a fit of one value shows no slope, which may be there


def test_over_many_steps_hardly_anything_is_left():
    few, many = (in_common(STEP**2, 0.0, 100.0, 0.0, steps)[2] for steps in (0.0, 30.0))
    assert many < 1e-3 * few
    assert in_common(STEP**2, STEP**2, 100.0, 0.0, 0.0) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("sigma", [0.0, 0.1, 0.3, 0.5])
def test_half_way_between_two_codes_the_variance_is_that_of_rounded_noise(sigma):
    from scipy.stats import norm

    levels = np.arange(-6, 7)
    edges = np.array([levels - 1.0, levels]) / max(sigma, 1e-9)  # of what is rounded to 1/2 off, and so on
    wanted = np.diff(norm.cdf(edges), axis=0)[0] @ (levels - 0.5) ** 2
    found = between_codes(STEP**2, (sigma * STEP) ** 2, 0.0, 0.0) / STEP**2
    assert found + sigma**2 + 1.0 / 12.0 == pytest.approx(wanted, abs=1e-3)
    assert between_codes(STEP**2, (sigma * STEP) ** 2, 1.0, 1.1) == pytest.approx(0.0, abs=1e-9 * STEP**2)


@pytest.mark.parametrize("steps", [0.0, 0.6, 1.25, 1.5, 2.5, 3.3])
@pytest.mark.parametrize("sigma", [0.0, 0.1, 0.25, 0.4])
def test_a_surface_over_some_steps_has_no_larger_residual_than_that(sigma, steps):
    """Wherever its codes lie: of the largest variance only what other waves than the first leave is missing."""
    from scipy.stats import norm

    place, codes = np.linspace(-0.5, 0.5, 401), np.arange(-9, 10)
    largest = 0.0
    for middle in np.arange(0.0, 1.0, 0.05):
        x = (middle + steps * place)[:, None]
        share = np.diff(norm.cdf((np.append(codes - 0.5, 9.5) - x) / max(sigma, 1e-9)), axis=1)
        mean = share @ codes
        line = np.polyval(np.polyfit(place, mean, 1), place)
        largest = max(largest, np.mean(share @ codes**2 - 2.0 * line * mean + line**2))
    found = between_codes(STEP**2, (sigma * STEP) ** 2, steps, 0.0) / STEP**2 + sigma**2 + 1.0 / 12.0
    assert 0.97 * largest < found < 3.0 * largest


@pytest.mark.parametrize("size", [16, 32])
def test_flat_tiles_that_climb_by_some_steps_are_not_rough(size, rng):
    """Integer millimetres, with a tenth of that as other noise."""
    camera = rp.Camera(size, size, 525.0, 525.0, 0.5 * (size - 1), 0.5 * (size - 1), depth_scale=1000.0)
    sigma = 1e-4 * 0.5**2  # at 2 m
    camera = camera.with_noise(rp.noise.quantised(rp.noise.NoiseModel((sigma,)), camera))
    across = camera.tan_x[0, -1] - camera.tan_x[0, 0]
    for steps in (1.25, 1.4, 1.5, 1.6, 2.5):
        q = 0.5 + 1e-3 * 0.5**2 * (rng.random((300, 1, 1)) + steps * camera.tan_x / across)
        measured = np.rint(1000.0 / (q + sigma * rng.standard_normal(q.shape))).astype(np.uint16)
        tiles = rp.TileFitter(camera, size).fit_batch(measured)
        assert np.mean(tiles.p_value < 0.01) <= 0.02


@pytest.mark.parametrize(
    "shared", [{}, {"correlation": ((0.5, 2.0),)}, {"floor": 1e-3}, {"correlation": ((0.5, 2.0),), "lateral": 0.3}]
)
@pytest.mark.parametrize("step", ["step", "disparity_step"])
def test_parts_of_any_kind_have_it_whatever_neighbours_share(step, shared):
    """Of a wall that faces the camera: a tile, a window, a label and a union of tiles are the same pixels."""
    noise = rp.noise.NoiseModel((1e-4,), **{step: 0.02}, **shared)
    camera = rp.Camera(32, 32, 60.0, 60.0, 15.5, 15.5, noise=noise)
    depth = np.ones(camera.shape)
    tile = rp.fit_tiles(depth, camera, 32).alpha_covariance[0, 0]
    assert tile[2, 2] == pytest.approx(0.02**2 / 12.0, rel=0.05)
    for others in (
        rp.fit_windows(depth, camera, [[0, 0, 32, 32]]),
        rp.fit_labels(depth, camera, np.ones(camera.shape, int)),
        rp.merge(rp.fit_tiles(depth, camera, 16), np.ones((2, 2), int)),
    ):
        np.testing.assert_allclose(others.alpha_covariance[0], tile, rtol=0.02, atol=1e-3 * tile.max())


@pytest.mark.parametrize("shared", [{}, {"correlation": ((0.5, 2.0),)}])
def test_of_a_slanting_strip_it_tilts_as_along_a_row(shared):
    """Along the strip there is no more of it than in an upright one of that length."""
    noise = rp.noise.NoiseModel((1e-4,), disparity_step=0.01, **shared)
    camera = rp.Camera(65, 65, 60.0, 60.0, 32.0, 32.0, noise=noise)
    y, x = np.mgrid[-32:33, -32:33]
    depth = np.ones(camera.shape)
    along = np.array([1.0, 1.0]) / np.sqrt(2.0)
    slanting = rp.fit_labels(depth, camera, (abs(y - x) <= 2) & (abs(x + y) <= 40)).alpha_covariance[0]
    lying = rp.fit_labels(depth, camera, (abs(y) <= 1) & (abs(x) <= 28)).alpha_covariance[0]
    assert along @ slanting[:2, :2] @ along == pytest.approx(lying[0, 0], rel=0.1)


@pytest.mark.parametrize("unit", ["depth", "disparity"])
@pytest.mark.parametrize("sigma", [0.05, 0.1, 0.2, 0.3, 0.6])
def test_walls_that_face_the_camera_are_not_rough(sigma, unit, rng):
    """Half-way between two codes, 20 to 100 % of the tiles were."""
    camera = CAMERA if unit == "disparity" else replace(CAMERA, disparity=None, depth_scale=1000.0, invalid_values=())
    of_error = rp.noise.NoiseModel((sigma * STEP,)) if unit == "disparity" else rp.noise.time_of_flight(sigma * 1e-3)
    camera = replace(camera, noise=rp.noise.quantised(of_error, camera))
    rejected = {"tile": [], "window": [], "label": []}
    for codes in 200.0 + np.arange(24) / 24.0:
        for slope in (0.0, 0.1, 0.4, 1.0):  # codes across a tile
            exact = codes + slope * (np.arange(camera.width) - 80) / 16 + np.zeros(camera.shape)
            raw = np.rint(exact + sigma * rng.standard_normal(exact.shape)).astype(np.uint16)
            tiles = rp.fit_tiles(raw, camera, 16)
            assert np.array_equal(tiles.status == rp.TileStatus.ROUGH, tiles.p_value < 0.01)
            rejected["tile"].append(tiles.p_value < 0.01)
            rejected["window"].append(rp.fit_windows(raw, camera, [[0, 0, 8, 8], [50, 60, 40, 20]]).p_value < 0.01)
            label = (np.indices(raw.shape)[1] // 16 == 5).astype(int)
            rejected["label"].append(rp.fit_labels(raw, camera, label).p_value < 0.01)
    assert all(np.mean(which) <= (0.02 if name == "tile" else 0.04) for name, which in rejected.items())


def test_what_rounding_adds_to_one_frame_is_not_left_in_the_next(rng):
    """A near wall is rounded alike, a far slope is not: in one frame of a batch all tiles, some, or none."""
    camera = replace(CAMERA, disparity=None, depth_scale=1000.0, invalid_values=())
    inverse_depths = np.array([0.2, 0.5, 0.8, 2.2])
    errors = rp.noise.table(inverse_depths, 4e-4 * (0.75 / inverse_depths) ** 1.5)
    camera = replace(camera, noise=rp.noise.quantised(errors, camera))
    near, far = np.full(camera.shape, 2.0), 0.5 + 1.6 * camera.tan_x
    scenes = np.array([near, np.where(camera.tan_y < 0.0, near, far), near, far])
    raw = np.rint(1000.0 / (scenes + errors.sigma(scenes) * rng.standard_normal(scenes.shape))).astype(np.uint16)
    together = rp.TileFitter(camera, 32, num_threads=1).fit_batch(raw)
    for i, frame in enumerate(raw):
        alone = rp.fit_tiles(frame, camera, 32)
        np.testing.assert_array_equal(together[i].p_value, alone.p_value)
        np.testing.assert_array_equal(together[i].alpha_covariance, alone.alpha_covariance)


def test_what_rounding_adds_to_some_labels_is_not_left_in_others(rng):
    """In the upper half of the image pixels are rounded alike; the noise is correlated."""
    camera = replace(CAMERA, disparity=None, depth_scale=1000.0, invalid_values=())
    errors = rp.noise.NoiseModel((2e-4,), correlation=((0.5, 2.0),))
    camera = replace(camera, noise=rp.noise.quantised(errors, camera))
    q = np.where(camera.tan_y < 0.0, 2.0, 0.5 + 0.0 * camera.tan_x)
    raw = np.rint(1000.0 / (q + 2e-4 * rng.standard_normal(q.shape))).astype(np.uint16)
    labels = np.kron(np.arange(1, 321).reshape(16, 20), np.ones((8, 8), int))
    all_of_them, far = rp.fit_labels(raw, camera, labels), rp.fit_labels(raw, camera, np.maximum(labels - 160, 0))
    np.testing.assert_allclose(all_of_them.alpha_covariance[160:], far.alpha_covariance, rtol=1e-9)


@pytest.mark.parametrize("noise", [None, 1e-3])  # what is given may be far more than the sensor has
@pytest.mark.parametrize("sigma", [0.1, 0.2, 0.7])
def test_offsets_of_segments_that_face_the_camera(sigma, noise, rng):
    """Without a noise model they were up to eight deviations off."""
    camera = replace(CAMERA, disparity=None, depth_scale=1000.0, invalid_values=())
    errors = []
    for depth in 1.0 + np.arange(20) / 20e3:
        raw = np.rint(1000.0 * depth + sigma * rng.standard_normal(camera.shape)).astype(np.uint16)
        found = rp.segment(raw, camera, noise=noise)
        errors.append((found.planes[0, 3] - depth) / found.offset_std[0])
    assert np.sqrt(np.mean(np.square(errors))) < 1.2


@pytest.mark.parametrize("degrees", [0.0, 1.0, 5.0])
@pytest.mark.parametrize("sigma", [0.05, 0.2, 0.35, 0.6])
def test_errors_of_walls_are_those_of_their_covariance(sigma, degrees, rng):
    """Of tiles, labels and unions. Taken for independent from pixel to pixel they were up to a hundred deviations."""
    camera = replace(CAMERA, noise=rp.noise.quantised(rp.noise.NoiseModel((sigma * STEP,)), CAMERA))
    errors = {"tile": [], "label": [], "union": []}
    for _ in range(60):
        tilt = np.radians(degrees * rng.uniform(0.5, 1.5))
        turned = rng.uniform(0.0, 2.0 * np.pi)
        normal = np.array([np.sin(tilt) * np.cos(turned), np.sin(tilt) * np.sin(turned), -np.cos(tilt)])
        alpha = normal / (normal[2] * rng.uniform(1.0, 3.0))
        q = alpha[0] * camera.tan_x + alpha[1] * camera.tan_y + alpha[2]
        raw = np.rint(q / STEP + sigma * rng.standard_normal(q.shape)).astype(np.uint16)
        tiles = rp.fit_tiles(raw, camera, 16)
        label = rp.fit_labels(raw, camera, np.ones(raw.shape, int))
        union = rp.merge(tiles, np.ones(tiles.shape, int))
        ray = np.array([camera.tan_x[72, 88], camera.tan_y[72, 88], 1.0])
        for name, fits, i in (("tile", tiles, (4, 5)), ("label", label, 0), ("union", union, 0)):
            error, covariance = fits.alpha[i] - alpha, fits.alpha_covariance[i]
            errors[name].append(error @ ray / np.sqrt(ray @ covariance @ ray))
    for values in errors.values():
        assert 0.4 < np.sqrt(np.mean(np.square(values))) < 1.5


def test_segments_of_walls_say_so_too(rng):
    """Two walls side by side, of which one is slanted and shows the other noise."""
    errors = []
    for _ in range(30):
        wall, slanted = rng.uniform(0.35, 0.9), rng.uniform(1.1, 1.6)
        q = np.where(CAMERA.tan_x < 0.0, wall, slanted + 3.0 * CAMERA.tan_x)
        raw = np.rint(q / STEP + 0.2 * rng.standard_normal(q.shape)).astype(np.uint16)
        found = rp.segment(raw, CAMERA)
        label = found.labels[64, 20]
        assert label > 0
        error, covariance = found.alpha[label - 1] - [0.0, 0.0, wall], found.alpha_covariance[label - 1]
        ray = np.array([CAMERA.tan_x[64, 40], 0.0, 1.0])
        errors.append(error @ ray / np.sqrt(ray @ covariance @ ray))
    assert 0.3 < np.sqrt(np.mean(np.square(errors))) < 3.0


@pytest.mark.parametrize("upright", [False, True])
@pytest.mark.parametrize("find", ["tile", "label", "segment"])
def test_of_a_wall_tilted_about_one_axis_each_slope_errs_as_it_says(find, upright, rng):
    """Along one side of the image it spans many steps, along the other hardly one: their variances differ."""
    camera = rp.Camera(144, 64, 525.0, 525.0, 71.5, 31.5, disparity=(STEP, 0.0), invalid_values=(0,))
    noise = rp.noise.quantised(rp.noise.NoiseModel((0.05 * STEP,)), camera)
    errors = []
    for _ in range(100):
        many, few = rng.uniform(3.0, 8.0), rng.uniform(-1.0, 1.0)
        slopes = np.array([few, many] if upright else [many, few]) * STEP * 525.0 / [camera.width, camera.height]
        alpha = np.append(slopes, rng.uniform(0.4, 0.8))
        q = alpha[0] * camera.tan_x + alpha[1] * camera.tan_y + alpha[2]
        raw = np.rint(q / STEP + 0.05 * rng.standard_normal(q.shape)).astype(np.uint16)
        if find == "tile":
            fits = rp.fit_tiles(raw, replace(camera, noise=noise), camera.shape)
        elif find == "label":
            fits = rp.fit_labels(raw, replace(camera, noise=noise), np.ones(raw.shape, int))
        else:
            fits = rp.segment(raw, camera)
        found, covariance = fits.alpha.reshape(-1, 3), fits.alpha_covariance.reshape(-1, 3, 3)
        assert len(found) == 1
        errors.append((found[0] - alpha)[:2] / np.sqrt(np.diag(covariance[0])[:2]))
    of_slopes = np.sqrt(np.mean(np.square(errors), axis=0))
    assert (of_slopes > 0.4).all()
    assert (of_slopes < 1.0).all()
