"""Noise estimated from frames: a known one is found again, and it serves frames it was not estimated from."""

from dataclasses import replace

import numpy as np
import pytest
from noisy_scenes import CAMERA, VIEWS, rendering, smooth
from scipy import ndimage

import rgbd_planes as rp
from rgbd_planes._core.text import percent
from rgbd_planes.camera.pixel_pitch import WEIGHTS_OF_PLACES
from rgbd_planes.noise_estimation import estimation
from rgbd_planes.noise_estimation import large_planes as large
from rgbd_planes.noise_estimation.bias_map import flatness
from rgbd_planes.noise_estimation.large_planes import large_planes
from rgbd_planes.noise_estimation.samples import WINDOW, Samples, _mode, flat_windows, outlying, unevenness


def frames(model, rng, views=VIEWS):
    """The furnished room with a model's noise, missing pixels and rounding."""
    for view in views:
        depth = rendering(*view).depth
        white = 1.0 - sum(share for share, _ in model.correlation)
        error = np.sqrt(white) * rng.standard_normal(depth.shape) + model.floor * smooth(rng, model.floor_length)
        for share, length in model.correlation:
            error += np.sqrt(share) * smooth(rng, length)
        slope = np.hypot(*np.gradient(1.0 / depth))
        q = 1.0 / depth + error * model.sigma(1.0 / depth)
        q += model.lateral * np.minimum(slope, 0.02) * rng.standard_normal(depth.shape)
        raw = np.rint(CAMERA.depth_scale / q)
        raw[rng.random(raw.shape) < 0.02] = 0
        yield raw.astype(np.uint16)


@pytest.mark.parametrize(
    "truth",
    [
        rp.noise.kinect_v1(),
        rp.noise.axial(0.002, 0.001),
        rp.noise.NoiseModel((2e-3,), correlation=((0.6, 2.0),)),
        rp.noise.NoiseModel((2e-3,), correlation=((0.3, 1.0),), floor=0.7, floor_length=24.0),
        rp.noise.NoiseModel((1e-3,), correlation=((0.5, 2.0),), lateral=0.8),
    ],
    ids=["constant", "time of flight", "correlated", "with a floor", "lateral"],
)
def test_finds_the_noise_again(truth, rng):
    model = rp.estimate_noise(list(frames(truth, rng)), CAMERA)
    assert model.falloff == 0.0
    q = 1.0 / np.linspace(1.5, 3.2, 8)
    total = np.hypot(1.0, model.floor) * model.sigma(q)
    np.testing.assert_allclose(total, np.hypot(1.0, truth.floor) * truth.sigma(q), rtol=0.15)
    assert model.lateral == pytest.approx(truth.lateral, abs=0.3 if truth.lateral else 0.35)
    # What it does to tiles of every size: their residuals and the errors of their planes.
    sizes = np.array([6, 8, 16, 32, 64]) ** 2
    made, wanted = model.statistics(sizes), truth.statistics(sizes)
    scale = (model.sigma(0.5) / truth.sigma(0.5)) ** 2
    np.testing.assert_allclose(scale * made.expected, wanted.expected, rtol=0.25)
    np.testing.assert_allclose(scale * made.tilt_x[:-1], wanted.tilt_x[:-1], rtol=0.3)
    # Frames it has not seen.
    camera = replace(CAMERA, noise=model)
    view = ((0.1, -1.4, 0.0), (0.2, -1.0, 2.6))
    labels = rendering(*view).tile_labels((16, 16))
    rejected = []
    for depth in frames(truth, rng, [view] * 3):
        tiles = rp.fit_tiles(depth, camera, 16)
        rejected.append(tiles.status[(labels > 0) & tiles.fitted] == rp.TileStatus.ROUGH)
    assert np.mean(rejected) < 0.03


def small_frames(width, height, focal, count):
    """A camera, and what it sees of the furnished room as it goes past."""
    camera = rp.Camera(width, height, focal, focal, width / 2 - 0.5, height / 2 - 0.5, depth_scale=1000.0)
    ways = 1.2 * np.arange(count) / count
    views = VIEWS if width > 200 else [((x, -1.5, -0.2), (0.5 - x, -0.8, 2.6)) for x in ways]
    return camera, [rp.scenes.room(*view).render(camera).measure(seed=i) for i, view in enumerate(views)]


@pytest.mark.parametrize(
    ("width", "height", "focal", "count"), [(256, 192, 210.0, 4), (160, 120, 131.0, 12), (96, 72, 79.0, 40)]
)
def test_independent_noise_of_small_frames_stays_independent(width, height, focal, count):
    """Most of their windows of 48 pixels have edges, in the smaller ones most of 24: these are not what is usual."""
    camera, seen = small_frames(width, height, focal, count)
    model = rp.estimate_noise(seen, camera)
    assert model.floor < 0.1
    assert model.falloff == 0.0
    np.testing.assert_allclose(model.sigma([0.3, 0.5]), rp.noise.kinect_v1().sigma([0.3, 0.5]), rtol=0.15)


def test_shows_a_bias_over_the_image(rng):
    """A lens that bends floors: the flatness map has its shape."""
    bump = 8e-3 * np.exp(-0.5 * ((CAMERA.tan_x - 0.2) ** 2 + (CAMERA.tan_y - 0.1) ** 2) / 0.12**2)
    seen = []
    for tilt in np.linspace(-0.3, 0.3, 6):
        depth = rp.scenes.plane((tilt, 0.2, -1.0), 1.5).render(CAMERA).depth
        q = 1.0 / depth + bump + 1.4e-3 * rng.standard_normal(depth.shape)
        seen.append(1.0 / q)
    evidence = rp.estimate_noise(seen, CAMERA).evidence
    assert evidence.flatness.shape == (48, 60)
    wanted = bump.reshape(48, 8, 60, 8).mean(axis=(1, 3))
    known = np.isfinite(evidence.flatness)
    assert known.mean() > 0.7
    assert np.corrcoef(evidence.flatness[known], wanted[known])[0, 1] > 0.9
    figure = evidence.plot()
    shown = {axes.get_title().partition(" ")[0] for axes in figure.get_axes()}
    assert shown == {"Residual", "How", "p-values", "Noise", "Bias"}
    assert "flat tiles" in repr(evidence)
    assert "\n" not in repr(evidence)


def test_the_evidence_is_what_the_frames_show(rng):
    depths = [rp.scenes.plane((tilt, 0.2, -1.0), 1.5).render(CAMERA).depth for tilt in np.linspace(-0.3, 0.3, 5)]
    seen = [1.0 / (1.0 / depth + 1.4e-3 * rng.standard_normal(depth.shape)) for depth in depths]
    evidence = rp.estimate_noise(seen, CAMERA).evidence
    assert evidence.frames == 5
    share = np.mean(evidence.p_values < 0.01)
    assert share == pytest.approx(0.01, abs=0.006)
    assert np.median(evidence.p_values) == pytest.approx(0.5, abs=0.06)
    assert f"{percent(share)} of p-values below 1 %" in repr(evidence)
    q = 1.0 / np.array(depths)
    assert (np.diff(evidence.inverse_depth) > 0.0).all()
    assert q.min() < evidence.inverse_depth[0] < np.median(q) < evidence.inverse_depth[-1] < q.max()
    np.testing.assert_allclose(evidence.sigma, 1.4e-3, rtol=0.04)
    np.testing.assert_allclose(evidence.sigma_fit, 1.4e-3, rtol=0.04)
    np.testing.assert_allclose(evidence.residuals, evidence.expected, rtol=0.03)
    assert evidence.edge_growth == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("planar", [0.0, 4e-3])
def test_of_a_bias_a_planar_part_does_not_show(planar, rng):
    """Though most frames see only the half where it bends."""
    camera = rp.Camera(320, 240, 262.5, 262.5, 159.5, 119.5, noise=rp.noise.NoiseModel((1e-3,)))
    bump = 3e-3 * np.exp(-0.5 * ((camera.tan_x + 0.3) ** 2 + (camera.tan_y - 0.1) ** 2) / 0.15**2)
    seen = []
    for tilt in np.linspace(-0.15, 0.1, 6):
        q = 0.5 + tilt * camera.tan_x + bump + planar * (camera.tan_x - camera.tan_y + 0.5)
        q += 1e-3 * rng.standard_normal(q.shape)
        q[:, 160 if seen else 320 :] = np.nan
        seen.append(1.0 / q)
    bias, count, _ = flatness(seen, large_planes(seen, camera), camera)
    there = count > 0
    rays = np.stack(np.broadcast_arrays(camera.tan_x, camera.tan_y, np.ones(camera.shape), bump))
    *rays, wanted = rays.reshape(4, 30, 8, 40, 8).mean(axis=(2, 4))[:, there]
    design, root = np.stack(rays, axis=1), np.sqrt(count[there])
    design, found, wanted = root[:, None] * design, root * bias[there], root * wanted
    wanted -= design @ np.linalg.lstsq(design, wanted)[0]
    np.testing.assert_allclose(np.linalg.lstsq(design, found)[0], 0.0, atol=1e-7)
    assert np.linalg.norm(found - wanted) < 0.25 * np.linalg.norm(wanted)


@pytest.mark.parametrize("views", [1, 6])
def test_without_a_bias_things_before_a_wall_make_none(views, rng):
    """Where planes end, some pixels of the next surface are hardly off them."""
    seen = []
    for i in range(views):
        depth = rendering((0.35 - 0.05 * i, -1.5, -0.2)).depth
        seen.append(1.0 / (1.0 / depth + 1.4e-3 * rng.standard_normal(depth.shape)))
    evidence = rp.estimate_noise(seen, CAMERA).evidence
    assert np.sqrt(np.nanmean((evidence.flatness / evidence.flatness_std) ** 2)) < 1.3


@pytest.mark.parametrize("length", [0.0, 2.0])
def test_without_a_bias_the_map_shows_what_chance_makes(length, rng):
    """Its deviation is the one that is told, errors that neighbours share included, and its colours are pale."""
    seen = []
    for tilt in np.linspace(-0.3, 0.3, 6):
        errors = smooth(rng, length) if length else rng.standard_normal(CAMERA.shape)
        depth = rp.scenes.plane((tilt, 0.2, -1.0), 1.5).render(CAMERA).depth
        seen.append(1.0 / (1.0 / depth + 1.4e-3 * errors))
    evidence = rp.estimate_noise(seen, CAMERA).evidence
    of_chance = evidence.flatness / evidence.flatness_std
    assert np.sqrt(np.mean(of_chance**2)) == pytest.approx(1.0, abs=0.2)
    independent = 1.4e-3 / np.sqrt(evidence.flatness_count)
    apart = np.arange(8)[:, None] - np.arange(8)
    shared = np.exp(-0.5 * (apart / length) ** 2).sum() / 8 if length else 1.0  # along a side of a cell
    assert np.median(evidence.flatness_std / independent) == pytest.approx(shared, rel=0.1)
    figure = evidence.plot()
    (bias,) = (axes for axes in figure.axes if axes.get_title().startswith("Bias"))
    least, most = bias.get_images()[0].get_clim()
    assert -least == most >= 5e3 * np.median(evidence.flatness_std)
    assert "chance alone: ±" in bias.get_xlabel()


def test_the_map_of_noise_shows_where_there_is_more(rng):
    """Half as much again in the right half of the image."""
    sigma = np.where(np.arange(CAMERA.width) < CAMERA.width // 2, 1e-3, 1.5e-3)
    depths = 1.0 / (0.5 + 0.05 * CAMERA.tan_y + sigma * rng.standard_normal((2, *CAMERA.shape)))
    found = rp.estimate_noise(depths, replace(CAMERA, depth_scale=1.0)).evidence.noise_map
    left, right = (np.nanmean(half**2) for half in np.split(found, 2, axis=1))
    assert np.sqrt(right / left) == pytest.approx(1.5, abs=0.05)
    assert left < 1.0 < right


def test_tiles_with_more_noise_than_the_others_have_small_p_values(rng):
    sigma = np.full(CAMERA.shape, 1.4e-3)
    sigma[48:96, 48:144] *= 1.5  # 32 of 1280 tiles
    seen = [1.0 / (0.6 + 0.05 * i * CAMERA.tan_x + sigma * rng.standard_normal(CAMERA.shape)) for i in range(3)]
    p_values = rp.estimate_noise(seen, CAMERA).evidence.p_values
    assert np.mean(p_values < 1e-3) == pytest.approx(32 / 1280, abs=5e-3)
    assert np.mean(p_values > 0.999) < 5e-3


def test_p_values_of_the_evidence_know_the_spread(rng):
    """Where the variance differs from window to window, and no p-value is small for that."""
    seen = []
    for i in range(4):
        variance = np.exp(0.6 * rng.standard_normal((CAMERA.height // 24, CAMERA.width // 24)))
        sigma = 1.4e-3 * np.sqrt(variance.repeat(24, axis=0).repeat(24, axis=1))
        q = 0.6 + 0.05 * i * CAMERA.tan_x + 0.0 * CAMERA.tan_y
        q = q[: sigma.shape[0], : sigma.shape[1]] + sigma * rng.standard_normal(sigma.shape)
        depth = np.zeros(CAMERA.shape)
        depth[: q.shape[0], : q.shape[1]] = 1.0 / q
        seen.append(depth)
    model = rp.estimate_noise(seen, CAMERA)
    assert model.spread == pytest.approx(0.6, abs=0.1)
    assert np.mean(model.evidence.p_values < 0.01) < 0.03


def test_cells_of_the_bias_are_inside_planes_and_near_them(rng):
    """The last ones of a frame may be smaller; next to where a plane ends, and far off it, there are none."""
    camera = rp.Camera(130, 100, 105.0, 105.0, 64.5, 49.5, noise=rp.noise.NoiseModel((1e-3,)))
    labels = np.ones((7, 9), np.int64)
    labels[:, 5] = 0  # columns 80 to 95
    wall = large.LargePlanes(labels, np.array([[0.0, 0.0, 0.5]]), np.full(1, 110.0), np.zeros(1))
    q = 0.5 + 1e-3 * rng.standard_normal(camera.shape)
    q[40:48, 48:56] += 0.02
    bias, count, deviation = flatness([1.0 / q], [wall], camera)
    expected = np.full((13, 17), 64)
    expected[:, -1], expected[-1], expected[-1, -1] = 16, 32, 8
    expected[:, 9:13] = expected[5, 6] = 0
    np.testing.assert_array_equal(count, expected)
    for made in (bias, deviation):
        np.testing.assert_array_equal(np.isfinite(made), expected > 0)


def test_frames_without_large_planes_show_no_bias():
    camera = rp.Camera(128, 96, 105.0, 105.0, 63.5, 47.5, noise=rp.noise.NoiseModel((1e-3,)))
    none = large.LargePlanes(np.zeros((6, 8), np.int64), np.empty((0, 3)), np.empty(0), np.empty(0))
    bias, count, deviation = flatness([np.full(camera.shape, 2.0)], [none], camera)
    assert np.isnan(bias).all()
    assert np.isnan(deviation).all()
    assert bias.shape == deviation.shape == count.shape == (12, 16)
    assert not count.any()


@pytest.mark.parametrize("floor", [0.0, 3.0])
def test_what_chance_makes_of_a_bias_does_not_depend_on_its_size(floor, rng):
    """A cell of 8 x 8 pixels has an eighth of the deviation of one."""
    camera = rp.Camera(
        128, 96, 105.0, 105.0, 63.5, 47.5, noise=rp.noise.NoiseModel((1e-3,), floor=floor, floor_length=48.0)
    )
    wall = large.LargePlanes(np.ones((6, 8), np.int64), np.array([[0.0, 0.0, 0.5]]), np.full(1, 110.0), np.zeros(1))
    depth = 1.0 / (0.5 + 1e-3 * rng.standard_normal(camera.shape))
    _, count, deviation = flatness([depth], [wall], camera)
    assert (count == 64).all()
    np.testing.assert_allclose(deviation, 1e-3 / 8.0, rtol=1e-6)


@pytest.mark.parametrize("floor", [0.0, 1.0])
def test_planes_larger_than_tiles_show_how_far_a_bias_reaches(floor, rng):
    """Tiles of 96 pixels are as flat with it as without. The errors of large planes are what the covariance says."""
    bias = floor * 1.4e-3 * smooth(rng, 100.0)
    seen = []
    for i, view in enumerate(VIEWS):
        q = 1.0 / rendering(*view).measure(seed=i, quantise=False) + bias
        seen.append(1.0 / q)
    model = rp.estimate_noise(seen, CAMERA)
    assert model.floor == pytest.approx(floor, abs=0.4 if floor else 0.1)
    assert model.evidence.sizes[-1] > 150
    np.testing.assert_allclose(model.evidence.residuals, model.evidence.expected, rtol=0.15)
    camera, squares = replace(CAMERA, noise=model), []
    for depth, view in zip(seen, VIEWS, strict=True):
        scene = rendering(*view)
        fits = rp.fit_labels(depth, camera, scene.labels)
        true = -scene.planes[:, :3] / scene.planes[:, 3:]
        for i in np.flatnonzero(fits.valid_count > 15000):
            error = fits.alpha[i] - true[i]
            squares.append(error @ np.linalg.solve(fits.alpha_covariance[i], error) / 3.0)
    assert len(squares) > 8
    assert 0.2 < np.median(squares) < 3.0


@pytest.mark.parametrize("white", [0.0, 0.02, 0.1])
def test_where_nearly_all_errors_are_smooth_they_are_seen_in_their_size(white, rng):
    """And something counts as random, however little: else σ would be 0, and the floor infinite."""
    seen = []
    for tilt in (-0.2, 0.0, 0.2):
        depth = rp.scenes.plane((tilt, 0.2, -1.0), 1.5).render(CAMERA).depth
        error = smooth(rng, 24.0) + white * rng.standard_normal(depth.shape)
        seen.append(1.0 / (1.0 / depth + 3e-3 * error))
    model = rp.estimate_noise(seen, CAMERA)
    assert model.sigma(0.6) * np.hypot(1.0, model.floor) == pytest.approx(3e-3, rel=0.5)
    assert model.floor < 101.0


def test_a_bias_wider_than_any_surface():
    """Each sees a part of it, which is nearly planar: only together do they show it, and its size."""
    bend = 4e-3 * (CAMERA.tan_x**2 + CAMERA.tan_y**2)
    seen = []
    for i in range(6):
        room = rp.scenes.room((0.2 * i - 0.5, -1.5, 0.0), (0.5 - 0.3 * i, -0.9, 2.6)).render(CAMERA)
        seen.append(1.0 / (1.0 / room.measure(seed=i, quantise=False) + bend))
    found = rp.estimate_noise(seen, CAMERA).evidence.flatness
    known = np.isfinite(found)
    assert known.mean() > 0.75
    x, y, wanted = (of.reshape(48, 8, 60, 8).mean(axis=(1, 3))[known] for of in (CAMERA.tan_x, CAMERA.tan_y, bend))
    planar = np.stack([np.ones(len(x)), x, y], axis=1)
    wanted -= planar @ np.linalg.lstsq(planar, wanted, rcond=None)[0]
    assert np.std(found[known] - wanted) < 0.4 * np.std(wanted)
    assert 0.8 < found[known] @ wanted / (wanted @ wanted) < 1.1


def test_tilts_are_those_of_the_pixels_that_are_there(rng):
    """Of an even, whole tile x and y are not correlated: a corner is missing from each."""
    camera = rp.Camera(72, 48, 60.0, 60.0, 35.5, 23.5)
    corner = np.add.outer(np.arange(8), np.arange(8)) < 3
    frames = []
    for slope in (0.1, 0.3):
        q = 0.4 + slope * camera.tan_x - 0.2 * camera.tan_y + 1e-3 * rng.standard_normal(camera.shape)
        frames.append(np.where(np.tile(corner, (6, 9)), 0.0, 1.0 / q))
    frames[0][10, 10:15] = 0.0  # of too many pixels
    small, windows = (rp.TileFitter(camera, size).fit_batch(frames) for size in (8, WINDOW))
    found = Samples.of(small, np.ones(windows.shape, bool), windows, 0.13)
    assert len(found.tilt_square) == 2 * 54 - 1
    u, v = np.broadcast_arrays(camera.tan_x, camera.tan_y)
    for frame, row, column, tilt_square in zip(*found.place, found.tilt_square, strict=True):
        d_u, d_v, _ = small.alpha[frame, row, column] - windows.alpha[frame, row // 3, column // 3]
        here = slice(8 * row, 8 * row + 8), slice(8 * column, 8 * column + 8)
        rise = (d_u * u[here] + d_v * v[here])[~corner]
        assert tilt_square == pytest.approx(0.5 * np.sum((rise - rise.mean()) ** 2))


@pytest.mark.parametrize("size", [6, 12])
def test_a_window_shares_the_slopes_that_independent_errors_give_its_tiles(size, rng):
    """In the proportion of their squared numbers of pixels; half of the variance is known to be of rounding."""
    model = rp.noise.NoiseModel((1e-3,), disparity_step=1e-3 * np.sqrt(12.0))
    q = 0.4 + 0.1 * CAMERA.tan_x + 1e-3 * np.sqrt(2.0) * rng.standard_normal((6, *CAMERA.shape))
    tiles, windows = (rp.TileFitter(CAMERA, side).fit_batch(1.0 / q) for side in (size, WINDOW))
    found = Samples.of(tiles, np.ones(windows.shape, bool), windows, 0.1)
    own = 1.0 - (size / WINDOW) ** 4
    assert found.typical_tilt(model) == pytest.approx((own, 2.0 * own), rel=0.08)
    np.testing.assert_allclose(estimation._tilts((0.0, 0.0), np.array([size]), WINDOW, np.ones(1)), own)


def test_slopes_and_rays_are_those_at_the_tile_behind_a_lens(rng):
    """Where pixels are farther apart at one side than at another."""
    camera = rp.Camera(96, 72, 60.0, 62.0, 20.5, 15.5, (0.3, -0.1, 0.0, 0.0, 0.0))
    q = 0.4 + 0.1 * camera.tan_x - 0.2 * camera.tan_y
    depth = 1.0 / (q + 1e-6 * rng.standard_normal(q.shape))
    small, windows = (rp.TileFitter(camera, size).fit_batch([depth]) for size in (8, WINDOW))
    found = Samples.of(small, np.ones(windows.shape, bool), windows, 0.1)
    assert len(found.q) == 9 * 12
    slopes = sum(np.square(slope) for slope in np.gradient(q))
    for values, wanted in (
        (found.slope_square, slopes),
        (WEIGHTS_OF_PLACES @ found.rays[0], camera.tan_x),
        (WEIGHTS_OF_PLACES @ found.rays[1], camera.tan_y),
        (WEIGHTS_OF_PLACES @ found.depths, q),
    ):
        means = wanted.reshape(9, 8, 12, 8).mean(axis=(1, 3))[found.place[1:]]
        np.testing.assert_allclose(values, means, rtol=0.02, atol=2e-3 * np.abs(means).max())


def test_a_part_of_a_window_at_the_rim_is_none(rng):
    """However many of its pixels may be missing."""
    camera = rp.Camera(6 * WINDOW + 20, 5 * WINDOW + 20, 130.0, 130.0, 81.5, 69.5)
    frames = 1.0 / (0.4 + 0.1 * camera.tan_x + 1e-3 * rng.standard_normal((2, *camera.shape)))
    windows, parts = (rp.TileFitter(camera, size).fit_batch(frames) for size in (WINDOW, 8))
    flat = flat_windows(windows, parts, 0.5)
    assert flat.shape == (2, 6, 7)
    assert flat[:, :5, :6].mean() > 0.9
    assert not flat[:, 5].any()
    assert not flat[:, :, 6].any()


def test_outliers_are_looked_for_in_all_frames(rng):
    """And not only in the first one, whose windows are enough to look at."""
    q = 0.4 + 1e-3 * rng.standard_normal((4, *CAMERA.shape))
    q[1:][rng.random(q[1:].shape) < 0.02] = 0.5
    frames = list(1.0 / q)
    windows = rp.TileFitter(CAMERA, WINDOW).fit_batch(frames)
    found = [outlying(frames[:count], windows[:count], np.ones(windows[:count].shape, bool)) for count in (1, 4)]
    assert found[0] == pytest.approx(1.0, abs=0.02)
    assert found[1] > 2.0


def test_what_is_usual_is_before_clutter_of_which_there_is_more(rng):
    flat, clutter = 0.02 * rng.standard_normal(40), 1.0 + 0.05 * rng.standard_normal(100)
    assert _mode(np.concatenate([clutter, flat])) == pytest.approx(0.0, abs=0.02)
    assert _mode(np.concatenate([clutter, flat[:20]])) == pytest.approx(1.0, abs=0.05)  # too few to be what is flat


def test_a_large_tile_across_an_edge_is_left_out_although_its_windows_are_flat(rng):
    q = 0.4 + 1e-3 * rng.standard_normal(CAMERA.shape)
    q[3 * 48 : 4 * 48, 4 * 48 + WINDOW : 5 * 48] += 0.02
    tiles, windows = (rp.TileFitter(CAMERA, side).fit_batch([1.0 / q]) for side in (2 * WINDOW, WINDOW))
    found = Samples.of(tiles, np.ones(windows.shape, bool), windows, 0.1)
    places = set(map(tuple, np.transpose(found.place).tolist()))
    assert set(np.ndindex(tiles.shape)) - places == {(0, 3, 4)}


def test_frames_without_anything_flat(rng):
    noise = rng.random((2, *CAMERA.shape)) + 0.5
    depth = ndimage.gaussian_filter(noise, (0, 12, 12)) * 20.0 - 17.0
    with pytest.raises(ValueError, match=r"at least 16 flat windows of 24 x 24 pixels, found \d+ in 2 frames$"):
        rp.estimate_noise(depth[:, :64, :64], CAMERA.cropped(0, 0, 64, 64))
    with pytest.raises(ValueError, match="at least one frame, got none"):
        rp.estimate_noise([], CAMERA)
    with pytest.raises(ValueError, match="at least 24 x 24 pixels, got 22 x 20"):
        rp.estimate_noise([np.ones((20, 22))], CAMERA.cropped(0, 0, 22, 20))
    with pytest.raises(ValueError, match=r"^frame 1: expected a depth frame of shape"):
        rp.estimate_noise([depth[0], depth[0][1:]], CAMERA)
    with pytest.raises(TypeError, match=r"^frame 1: expected a plain array"):
        rp.estimate_noise([depth[0], np.ma.masked_equal(depth[0], 0)], CAMERA)


def test_what_may_be_edges_is_doubted():
    """Hardly any window of 24 pixels is flat."""
    camera, seen = small_frames(80, 60, 66.0, 40)
    with pytest.warns(UserWarning, match="may be edges, or outliers: are surfaces in the frames flat"):
        rp.estimate_noise(seen, camera)


@pytest.mark.parametrize("share", [0.01, 0.02, 0.07, 0.2])
def test_what_may_be_outliers_is_doubted(rng, share):
    """Hardly a window of 24 pixels is without one: the noise comes out a hundred times too large."""
    depth = rendering(*VIEWS[0]).measure(quantise=False)
    outliers = rng.random(depth.shape) < share
    depth[outliers] = 1.0 / rng.uniform(0.2, 2.0, np.count_nonzero(outliers))
    with pytest.warns(UserWarning, match="may be edges, or outliers"):
        rp.estimate_noise(depth, replace(CAMERA, depth_scale=None))


@pytest.mark.parametrize(
    ("frames", "error", "message"),
    [
        (b"depth.png", TypeError, "expected a sequence of frames, got bytes"),
        ({0: np.ones(CAMERA.shape)}, TypeError, "expected a sequence of frames, got dict"),
        (np.array(2.0), ValueError, r"expected a depth frame of shape .* got \(\)"),
        (np.ones(CAMERA.width), ValueError, r"expected a depth frame of shape .* got \(\)"),
    ],
)
def test_what_is_no_sequence_of_frames_is_refused(frames, error, message):
    with pytest.raises(error, match=message):
        rp.estimate_noise(frames, CAMERA)


def test_missing_pixels_are_named():
    depth = rendering(*VIEWS[0]).measure(holes=0.8)
    with pytest.raises(
        ValueError, match="found 0 in 1 frame: of most windows more than 70 % of the pixels are missing"
    ):
        rp.estimate_noise(depth, CAMERA)


@pytest.mark.parametrize("holes", [0.1, 0.25, 0.4, 0.6])
def test_frames_with_many_holes_show_the_same_noise(holes):
    whole, sparse = (
        rp.estimate_noise([rendering(*view).measure(holes=share, seed=1) for view in VIEWS[:2]], CAMERA)
        for share in (0.0, holes)
    )
    q = np.array([0.3, 0.5, 0.8])
    np.testing.assert_allclose(sparse.sigma(q), whole.sigma(q), rtol=0.05)
    assert sparse.floor < 0.1
    assert sparse.spread < 0.1


@pytest.mark.parametrize("holes", [0.2, 0.4, 0.5])
def test_single_pixels_that_are_missing_leave_the_correlation(holes, rng):
    """With 40 per cent missing σ came out 28 per cent too large."""
    seen = []
    for depth in frames(rp.noise.NoiseModel((1.4e-3,), correlation=((0.8, 4.0),)), rng, VIEWS[:3]):
        depth[rng.random(depth.shape) < holes] = 0
        seen.append(depth)
    model = rp.estimate_noise(seen, CAMERA)
    assert sum(share for share, _ in model.correlation) == pytest.approx(0.8, abs=0.03)
    assert model.sigma(0.5) == pytest.approx(1.4e-3, rel=0.1)
    assert model.floor < 0.1


def test_frames_without_noise():
    """What rounding leaves of flat tiles is no noise to make a model of."""
    with pytest.raises(ValueError, match="expected frames with noise"):
        rp.estimate_noise([rendering(*VIEWS[0]).depth], CAMERA)
    with pytest.raises(ValueError, match="expected frames with noise"):
        rp.estimate_noise(np.full(CAMERA.shape, 1500, np.uint16), CAMERA)  # a wall


def test_one_depth_for_all_that_is_beyond_the_range_is_no_measure_of_noise():
    camera = rp.Camera(width=640, height=480, fx=525.0, fy=525.0, cx=319.5, cy=239.5)
    views = [rp.scenes.room((0.35 + 0.02 * i, -1.5, -0.2)).render(camera) for i in range(3)]
    frames = [view.measure(noise=2e-3, holes=0.02, quantise=False, seed=i) for i, view in enumerate(views)]
    for reach in (3.0, 3.4):
        model = rp.estimate_noise([np.where(depth > reach, 10.0, depth) for depth in frames], camera)
        np.testing.assert_allclose(model.sigma([0.3, 0.4, 0.6]), 2e-3, rtol=0.1)


def test_unevenness_is_that_of_the_parts_of_flat_windows(rng):
    """Parts without any residual, as of a depth that is rounded, say nothing."""
    camera = replace(CAMERA, depth_scale=None)
    depth = 2.0 + 0.01 * rng.standard_normal(camera.shape)
    depth[:24, :8] = 2.0
    windows, parts = (rp.TileFitter(camera, size).fit_batch(depth[None]) for size in (24, 8))
    flat = rng.random(windows.shape) < 0.5
    flat[0, 0, 0] = True
    ratios = []
    for _, row, column in np.argwhere(flat):
        residuals = parts.rmse[0, 3 * row : 3 * row + 3, 3 * column : 3 * column + 3]
        if residuals.min() > 0.0:
            ratios.append(np.median(residuals) / residuals.min())
    assert len(ratios) == np.count_nonzero(flat) - 1
    assert unevenness(windows, parts, flat) == pytest.approx(np.median(ratios))


def test_what_coarse_rounding_adds_is_told_apart(rng):
    """2 cm are more than the noise; the evidence shows residuals without them."""
    camera = replace(CAMERA, depth_scale=50.0)
    seen = []
    for view in VIEWS:
        q = 1.0 / rendering(*view).depth
        seen.append(np.rint(50.0 / (q + 1.4e-3 * rng.standard_normal(q.shape))).astype(np.uint16))
    model = rp.estimate_noise(seen, camera)
    assert model.step == 0.02
    q = np.array([0.35, 0.5, 0.7])
    np.testing.assert_allclose(model.sigma(q), np.hypot(1.4e-3, 0.02 * q * q / np.sqrt(12.0)), rtol=0.1)
    shown = model.evidence
    np.testing.assert_allclose(shown.residuals, shown.expected, rtol=0.03)
    q = shown.inverse_depth
    of_tiles = np.sqrt(1.0 - 3.0 / 12**2) * np.hypot(1.4e-3, 0.02 * q * q / np.sqrt(12.0))
    np.testing.assert_allclose(shown.sigma, of_tiles, rtol=0.05)
    np.testing.assert_allclose(shown.sigma_fit, of_tiles, rtol=0.05)


def test_the_rounding_is_the_finest_step_of_most_frames():
    """In some frames values happen to be even; a frame of floats among many has none."""
    for steps, expected in (
        ([2e-4, 1e-4, 3e-4], 1e-4),
        ([1e-4, 0.0, 2e-4], 1e-4),
        ([1e-4, 0.0], 0.0),
        ([0.0, 0.0, 1e-4], 0.0),
    ):
        assert estimation._rounding(steps, False).step == pytest.approx(expected)
    model = estimation._rounding([0.004, 0.002], True)
    assert (model.step, model.disparity_step) == (0.0, pytest.approx(0.002))


@pytest.mark.parametrize("disparity", [(2e-3, 0.0), (-2e-3, 3.0)], ids=["rising", "falling"])
def test_the_rounding_of_a_disparity_is_its_scale(disparity):
    """Of which the Kinect's is negative: its codes grow with the distance."""
    scale, offset = disparity
    camera = replace(CAMERA, depth_scale=None, disparity=disparity)
    raw = np.rint((1.0 / rendering(*VIEWS[0]).depth - offset) / scale).astype(np.uint16)
    _, rounding = estimation._open([raw], camera)
    assert (rounding.step, rounding.disparity_step) == (0.0, pytest.approx(2e-3))


def test_all_tiles_at_one_depth(rng):
    """Bins by depth may have the very same one."""
    pattern = 20000 + rng.integers(-50, 51, (12, 12))
    model = rp.estimate_noise(np.tile(pattern, (32, 40)).astype(np.uint16), CAMERA)
    assert model.sigma_depth(2.0) == pytest.approx(1e-4 * pattern.std(), rel=0.3)


@pytest.mark.parametrize("seed", [2, 7])
def test_one_depth_does_not_tell_how_noise_changes_with_depth(seed):
    """The bins of a wall that faces the camera are at depths that differ by chance."""
    camera, rng = rp.Camera(320, 240, 290.0, 290.0, 159.5, 119.5), np.random.default_rng(seed)
    model = rp.estimate_noise([1.0 / (0.5 + 1.4e-3 * rng.standard_normal(camera.shape)) for _ in range(4)], camera)
    np.testing.assert_allclose(model.sigma(np.array([0.25, 0.5, 1.0])), 1.4e-3, rtol=0.1)


@pytest.mark.parametrize("degrees", [0.0, 1.0, 3.0])
def test_one_wall_does_not_tell_either(degrees):
    """In single frames; σ at 4 m came out up to 44 per cent too small."""
    camera = rp.presets.primesense()
    lean = np.radians(degrees)
    wall = rp.scenes.plane((np.sin(lean), 0.0, -np.cos(lean)), 1.5).render(camera)
    for seed in range(5):
        model = rp.estimate_noise([wall.measure(seed=seed, quantise=False)], camera)
        assert model.sigma(0.25) == pytest.approx(rp.scenes.KINECT_V1, rel=0.05)


@pytest.mark.parametrize("pattern", ["rows", "checkerboard"])
def test_pixels_that_are_missing_everywhere_are_no_errors_that_reach_far(pattern, rng):
    camera = replace(rp.presets.kinect_v1(), depth_scale=None, noise=None, depth_range=None)
    row, column = np.indices(camera.shape)
    missing = (row if pattern == "rows" else row + column) % 2 == 0
    seen = []
    for i in range(4):
        q = 1.0 / rp.scenes.room((0.3 - 0.15 * i, -1.5 + 0.1 * (i % 3), 0.05 * i)).render(camera).depth
        seen.append(np.where(missing, 0.0, 1.0 / (q + 1.4e-3 * rng.standard_normal(q.shape))))
    model = rp.estimate_noise(seen, camera)
    assert model.floor == 0.0
    assert sum(share for share, _ in model.correlation) < 0.01


def test_it_takes_no_more_threads_than_it_may(rng, monkeypatch):
    threads = []

    class Counted(rp.TileFitter):
        def __init__(self, *args, **options):
            threads.append(options.get("num_threads"))
            super().__init__(*args, **options)

    for module in (estimation, large):
        monkeypatch.setattr(module, "TileFitter", Counted)
    rp.estimate_noise(1.0 / (0.5 + 1e-3 * rng.standard_normal((4, *CAMERA.shape))), CAMERA, num_threads=1)
    assert set(threads) == {1}
    assert len(threads) >= 4


def test_one_frame_and_a_stack_are_taken(rng):
    seen = np.stack(list(frames(rp.noise.kinect_v1(), rng, VIEWS[:2])))
    as_stack, as_list = rp.estimate_noise(seen, CAMERA), rp.estimate_noise(list(seen), CAMERA)
    assert as_stack == as_list
    assert rp.estimate_noise(seen[0], CAMERA) == rp.estimate_noise([seen[0]], CAMERA)
    camera = replace(CAMERA, noise=as_stack)
    assert rp.Camera.from_dict(camera.to_dict()) == camera


@pytest.mark.parametrize("size", [0.0, 2e-3])
def test_a_bias_shows_where_neighbours_share_errors_too(size, rng):
    """As that of a lens; large tiles were taken for ten times as certain as they are."""
    model = rp.noise.NoiseModel((1.4e-3,), correlation=((0.5, 2.0),))
    places = rng.uniform(-1.0, 1.0, (6, 2))
    views = [((0.7 * x, -1.5, 0.3 * z), (1.4 * z, -0.9, 2.6)) for x, z in places]
    row, column = np.indices(CAMERA.shape)
    bend = size * ((column - 239.5) ** 2 + (row - 191.5) ** 2) / 240.0**2
    seen = [1.0 / (CAMERA.depth_scale / np.maximum(d, 1) + bend) * (d > 0) for d in frames(model, rng, views)]
    found = rp.estimate_noise(seen, CAMERA)
    assert (found.floor == 0.0) if size == 0.0 else (0.2 < found.floor < 1.0)


@pytest.mark.parametrize(("count", "apart"), [(4, 0.2), (8, 0.1)])
def test_a_board_that_leans_on_a_wall_is_no_wave(count, apart):
    """Its top is less than a standard deviation before the wall, and seen in each frame. It made floors of .2 to .7."""
    camera = rp.presets.primesense()
    views = [rp.scenes.room((0.3 - apart * i, -1.5, 0.0)).render(camera) for i in range(count)]
    noise = rp.estimate_noise([view.measure(holes=0.02, seed=i) for i, view in enumerate(views)], camera)
    assert noise.floor < 0.05


def test_a_board_before_a_wall_is_no_wave_where_errors_are_correlated(rng):
    """It is less than the random errors of a tile before the wall, and the frame has no other large plane."""
    model = rp.noise.NoiseModel((2e-3,), correlation=((0.7, 4.0),))
    noise = rp.estimate_noise([next(frames(model, rng, VIEWS[:1]))], CAMERA)
    assert noise.floor == 0.0


@pytest.mark.parametrize(("apart", "wide"), [(0.01, 0.3), (0.02, 0.7)])
def test_a_panel_on_a_wall_is_no_wave(apart, wide, rng):
    """One or two deviations of a pixel before it, in many frames: tiles along its edges link it to the wall."""
    camera = rp.Camera(320, 240, 280.0, 290.0, 160.3, 118.2)
    near = 2.5 - apart
    surfaces = (
        rp.scenes.polygon("wall", [(-3, -3, 2.5), (3, -3, 2.5), (3, 3, 2.5), (-3, 3, 2.5)]),
        rp.scenes.polygon("floor", [(-3, 0, -1), (3, 0, -1), (3, 0, 4), (-3, 0, 4)]),
        rp.scenes.polygon("panel", [(-wide, -2.2, near), (0, -2.2, near), (0, -0.3, near), (-wide, -0.3, near)]),
    )
    seen = []
    for i in range(8):
        pose = rp.scenes.look_at((0.1 * i - 0.3, -1.2 - 0.02 * i, -0.1 * (i % 3)), (0.05 * i - 0.2, -1.0, 2.5))
        seen.append(rp.scenes.Scene(surfaces, pose).render(camera).measure(seed=i, quantise=False))
    assert rp.estimate_noise(seen, camera).floor < 0.05


def test_integers_that_were_made_metres_are_as_rounded(rng):
    seen = [np.rint(depth / 10.0) for depth in frames(rp.noise.time_of_flight(5e-4), rng, VIEWS[:2])]
    millimetres = replace(CAMERA, depth_scale=1000.0)
    as_integers = rp.estimate_noise([depth.astype(np.uint16) for depth in seen], millimetres)
    as_metres = rp.estimate_noise([(depth / 1000.0).astype(np.float32) for depth in seen], CAMERA, num_threads=1)
    assert as_integers.step == pytest.approx(1e-3)
    q = np.array([0.3, 0.6, 1.2])
    np.testing.assert_allclose(as_metres.sigma(q), as_integers.sigma(q), rtol=1e-3)
    some_of_each = [seen[0].astype(np.uint16), (seen[1] / 1000.0).astype(np.float32)]
    for mixed in (some_of_each, some_of_each[::-1]):
        assert rp.estimate_noise(mixed, millimetres).step == pytest.approx(1e-3)
    fifths = [(5.0 * depth).astype(np.uint16) for depth in seen]  # as TUM's benchmark stores millimetres
    same = rp.estimate_noise(fifths, replace(CAMERA, depth_scale=5000.0))
    assert same.step == pytest.approx(1e-3)
    np.testing.assert_allclose(same.sigma(q), as_integers.sigma(q), rtol=1e-3)


def test_real_kinect_frames():
    """Estimated from every second frame, tested on the others: a few tiles in a thousand to a few in a hundred."""
    from bench import real_data

    folder = real_data.FOLDER / "kinect1_7scenes_seq"
    if not folder.exists():
        pytest.skip(real_data.REASON)
    from rgbd_planes.sequences.images import read_depth

    camera = rp.Camera.load(folder / "camera.json")
    paths = sorted((folder / "depth").glob("*.png"))[::4]
    noise = rp.estimate_noise([read_depth(path) for path in paths[::2]], camera)
    assert 1.0e-3 < noise.sigma(0.5) < 2.2e-3
    camera = replace(camera, noise=noise)
    rejected, naive = [], []
    for path in paths[1::2]:
        depth = read_depth(path)
        large = rp.fit_tiles(depth, camera, 64, max_missing=0.1, significance=1e-3)
        flat = (large.status == rp.TileStatus.OK).repeat(4, axis=0).repeat(4, axis=1)[:30, :40]
        tiles = rp.fit_tiles(depth, camera, 16, significance=0.0)
        rejected.append(tiles.p_value[flat & tiles.fitted] < 0.01)
        plain = replace(tiles, camera=replace(camera, noise=rp.noise.kinect_v1()))
        naive.append(plain.p_value[flat & tiles.fitted] < 0.01)
    assert 0.001 < np.mean(np.concatenate(rejected)) < 0.03
    assert np.mean(np.concatenate(naive)) > 0.1


@pytest.mark.parametrize("missing", [0.0, 0.4])
def test_a_plane_with_independent_errors_is_bent_by_what_its_tiles_take_in(missing, rng):
    """Three coefficients for each tile of 256 pixels, and no more where some of these are missing."""
    camera = rp.Camera(320, 240, 262.5, 262.5, 159.5, 119.5, noise=rp.noise.NoiseModel((1e-3,)))
    seen = []
    for _ in range(4):
        q = 0.5 + 0.05 * camera.tan_x + 0.03 * camera.tan_y + 1e-3 * rng.standard_normal(camera.shape)
        q[rng.random(q.shape) < missing] = np.nan
        seen.append(1.0 / q)
    found = large_planes(seen, camera)
    assert all((of.labels == 1).mean() > 0.97 for of in found)
    assert np.concatenate([of.bend for of in found]).mean() == pytest.approx(3.0 / 256.0, abs=0.002)
    assert np.concatenate([of.side for of in found]) == pytest.approx(np.sqrt(320 * 240), rel=0.02)


def test_few_large_planes_tell_of_bends_too():
    """Then by the median of all; of many by those of similar sides."""

    def planes(side):
        return large.LargePlanes(np.zeros((1, 1), np.int64), np.zeros((len(side), 3)), side, 1e-3 * side)

    side = np.array([100.0, 60.0, 90.0])
    assert [of.tolist() for of in large.bends_by_side([planes(side[:2]), planes(side[2:])])] == [[90.0], [0.09], [3.0]]
    assert [len(of) for of in large.bends_by_side([planes(side[:0])])] == [0, 0, 0]
    sides, bends, counts = large.bends_by_side([planes(np.arange(50.0, 66.0)[::-1])])
    assert (sides.tolist(), counts.tolist()) == ([53.5, 61.5], [8.0, 8.0])
    assert bends == pytest.approx(1e-3 * sides)


def test_what_lies_apart_is_told_from_what_is_wavy(rng):
    """By two groups with a step between them, or by few tiles that are far off; NaN is another plane's."""
    errors = 0.1 * rng.standard_normal((12, 20))
    y, x = np.indices(errors.shape)
    half = np.where(x < 10, -1.5, 1.5)
    board = np.where((x < 4) & (y < 6), 8.0, 0.0)
    bent = 10.0 * np.exp(-((x - 10.0) ** 2 + (y - 6.0) ** 2) / 18.0)  # without a step
    wavy = (0.15 * x, np.sin(x / 3.0))
    for off, apart in (*((off, True) for off in (half, half.T, board, bent)), *((off, False) for off in wavy)):
        seen = off + (errors.T if off.shape != errors.shape else errors)
        assert large._is_in_two(seen) == apart
        around = np.full((20, 30), np.nan)
        around[: seen.shape[0], : seen.shape[1]] = seen
        assert large._is_in_two(around) == apart
