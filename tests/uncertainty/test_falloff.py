"""Noise that grows away from the optical axis: in whatever is fitted, and found again in frames."""

from dataclasses import replace

import numpy as np
import pytest
from noisy_scenes import CAMERA as SEEING
from noisy_scenes import VIEWS, rendering, smooth
from scipy import stats
from scipy.ndimage import gaussian_filter

import rgbd_planes as rp
from bench import real_data
from rgbd_planes.fitting.tile_grid import tile_footprints, tile_windows
from rgbd_planes.kernels.statistics.label_variances import label_variances
from rgbd_planes.kernels.statistics.tiles.assess import assess
from rgbd_planes.noise_estimation import estimation
from rgbd_planes.uncertainty.falloff import growth_of_parts, growth_of_pixels, growth_of_tiles, growth_of_windows
from rgbd_planes.uncertainty.footprints import footprints

PINHOLE = rp.Camera(192, 144, 120.0, 120.0, 90.5, 74.5)  # up to 40 degrees off the axis
CAMERAS = {
    "pinhole": PINHOLE,
    "barrel": replace(PINHOLE, distortion=(-0.2, 0.03, 0.002, -0.001, 0.0)),
    "fisheye": rp.Camera(192, 144, 110.0, 110.0, 95.5, 71.5, (0.01, -0.005, 0.0, 0.0), "fisheye"),
}
NOISES = {
    "constant": rp.noise.NoiseModel((1.4e-3,), falloff=4.0),
    "by depth": replace(rp.noise.time_of_flight(0.002, 0.001), falloff=4.0),
    "lateral": rp.noise.NoiseModel((1e-3,), lateral=0.5, falloff=3.0),
    "rounded": rp.noise.NoiseModel((1e-3,), disparity_step=2e-3, falloff=4.0),
}
ALPHA = np.array([0.25, -0.35, 0.8])


def away(camera, rows, columns):
    """Which ring of the image places are in: centre, middle, edge."""
    reach = np.hypot(camera.width, camera.height) / 2.0
    radius = np.hypot(rows - camera.height / 2.0, columns - camera.width / 2.0) / reach
    return np.digitize(radius, (0.4, 0.7))


def measured(camera, frames, rng):
    """(frames, H, W): the depth of the plane `ALPHA` with the camera's noise."""
    noise = camera.noise
    q = ALPHA[0] * camera.tan_x + ALPHA[1] * camera.tan_y + ALPHA[2]
    slope = np.hypot(*np.gradient(q))
    exact = replace(noise, disparity_step=0.0)
    errors = rng.standard_normal((2, frames, *q.shape))
    q = q + exact.sigma(q, camera.tan_x, camera.tan_y) * errors[0] + noise.lateral * slope * errors[1]
    if noise.disparity_step:
        q = noise.disparity_step * np.rint(q / noise.disparity_step)
    return 1.0 / q


def fits_of(kind, depth, camera):
    """Planes of parts of the image of 12 to 16 pixels, and the rows and columns of their middles."""
    if kind == "tiles":
        windows = tile_windows(camera.shape, (12, 12))
        return rp.fit_tiles(depth, camera, 12, significance=0.0), windows
    windows = tile_windows(camera.shape, (16, 16))
    if kind == "windows":
        return rp.fit_windows(depth, camera, windows, significance=0.0), windows
    blocks = np.arange(1, len(windows) + 1).reshape(9, 12)
    if kind == "labels":
        return rp.fit_labels(depth, camera, np.kron(blocks, np.ones((16, 16), int)), significance=0.0), windows
    tiles = rp.fit_tiles(depth, camera, 8, significance=0.0)
    return rp.merge(tiles, np.kron(blocks, np.ones((2, 2), int)), significance=0.0), windows


@pytest.mark.parametrize("kind", ["tiles", "windows", "labels", "unions"])
@pytest.mark.parametrize(
    ("lens", "name"),
    [
        ("pinhole", "constant"),
        ("pinhole", "by depth"),
        ("pinhole", "rounded"),
        ("barrel", "lateral"),
        ("fisheye", "constant"),
    ],
)
def test_p_values_and_covariances_are_right_all_over_the_image(lens, name, kind, rng):
    camera = replace(CAMERAS[lens], noise=NOISES[name])
    p_values, squares, rings = [], [], []
    for depth in measured(camera, 25, rng):
        fits, windows = fits_of(kind, depth, camera)
        error = fits.alpha.reshape(-1, 3) - ALPHA
        covariance = fits.alpha_covariance.reshape(-1, 3, 3)
        squares.append(np.sum(error * np.linalg.solve(covariance, error[..., None])[..., 0], axis=-1))
        p_values.append(fits.p_value.ravel())
        rings.append(away(camera, *(windows[:, :2] + windows[:, 2:] / 2.0).T))
    p_all, square, ring = (np.concatenate(of) for of in (p_values, squares, rings))
    for i in range(3):
        here = ring == i
        # Of three degrees of freedom, with the variance 6.
        assert np.mean(square[here]) == pytest.approx(3.0, abs=4.0 * np.sqrt(6.0 / here.sum()) + 0.06)
        assert np.mean(p_all[here] < 0.01) == pytest.approx(0.01, abs=4.0 * np.sqrt(0.01 / here.sum()) + 2e-3)
        if name != "rounded":  # rounding errors vary less than normal ones
            assert stats.kstest(p_all[here], "uniform").pvalue > 1e-4
    # Without it there is too much noise at the edge.
    plain = replace(camera, noise=replace(camera.noise, falloff=0.0))
    assert np.mean(fits_of(kind, depth, plain)[0].p_value.ravel()[rings[-1] == 2] < 0.01) > 0.3


def test_large_tiles_at_the_edge_have_the_covariance_of_their_pixels(rng):
    """From one side of such a tile to the other the variance doubles."""
    camera = replace(PINHOLE, noise=rp.noise.NoiseModel((1.4e-3,), falloff=8.0))
    tiles = rp.fit_tiles(measured(camera, 1, rng)[0], camera, 48)
    labels = np.kron(np.arange(1, 13).reshape(tiles.shape), np.ones((48, 48), int))
    of_pixels = rp.fit_labels(measured(camera, 1, rng)[0], camera, labels)
    variances = np.diagonal(tiles.alpha_covariance, axis1=-2, axis2=-1).reshape(-1, 3)
    np.testing.assert_allclose(variances, np.diagonal(of_pixels.alpha_covariance, axis1=-2, axis2=-1), rtol=0.03)


@pytest.mark.parametrize("lens", CAMERAS)
def test_that_of_a_part_is_the_mean_over_its_pixels(lens):
    camera = replace(CAMERAS[lens], noise=NOISES["constant"])
    growth = growth_of_pixels(camera)
    assert growth.min() == pytest.approx(1.0, abs=1e-3)
    rays = np.dstack([camera.tan_x, camera.tan_y, np.ones(camera.shape)])
    np.testing.assert_allclose(growth, np.linalg.norm(rays, axis=-1) ** 8)
    windows = np.concatenate([tile_windows(camera.shape, (16, 16)), [(48, 60, 80, 64), (3, 7, 1, 1)]])
    mean = [growth[y : y + h, x : x + w].mean() for y, x, h, w in windows]
    np.testing.assert_allclose(growth_of_parts(camera, footprints(windows))[0], mean, rtol=0.02)
    np.testing.assert_allclose(growth_of_windows(camera, windows)[0], mean)


def test_what_a_steep_falloff_makes_of_the_rim_costs_the_middle_no_digits(rng):
    """Where the rim of a fisheye has 10^17 times the variance."""
    camera = rp.Camera(
        *(640, 480, 180.0, 180.0, 320.0, 240.0),
        distortion=(0,) * 4,
        distortion_model="fisheye",
        noise=rp.noise.NoiseModel((1e-3,), falloff=8.0),
    )
    depth = 1.0 / (1.0 + 1e-3 * rng.standard_normal(camera.shape))
    depth[camera._without_ray] = 0.0
    tiles = rp.fit_tiles(depth, camera, 16)
    middle = np.s_[12:18, 17:23]
    windows = [[16 * row, 16 * column, 16, 16] for row in range(12, 18) for column in range(17, 23)]
    found = rp.fit_windows(depth, camera, windows)
    assert (tiles.p_value[middle] > 1e-3).all()
    np.testing.assert_allclose(found.angle_std, tiles.angle_std[middle].ravel(), rtol=0.01)
    labels = np.zeros(camera.shape, int)
    labels[16 * 15 : 16 * 16, 16 * 20 : 16 * 21] = 1
    assert tiles.angle_std[15, 20] == pytest.approx(rp.fit_labels(depth, camera, labels).angle_std[0], rel=0.02)


def test_windows_at_the_rim_of_a_fisheye_have_that_of_their_rays():
    noise = replace(rp.noise.kinect_v1(), falloff=2.0)
    camera = rp.Camera(
        48, 36, 15.0, 15.0, 23.5, 17.5, (0.0,) * 4, distortion_model="fisheye", noise=noise, depth_scale=1.0
    )
    windows = tile_windows(camera.shape, (12, 12))
    seen = ~camera._without_ray
    growth = growth_of_pixels(camera)
    mean = [
        growth[y : y + h, x : x + w][seen[y : y + h, x : x + w]].mean() if seen[y : y + h, x : x + w].any() else 1.0
        for y, x, h, w in windows
    ]
    assert 0.0 < seen.mean() < 1.0
    np.testing.assert_allclose(growth_of_windows(camera, windows)[0], mean)
    np.testing.assert_allclose(growth_of_tiles(camera, (12, 12))[0], mean)


@pytest.mark.parametrize("kind", ["tiles", "windows", "labels", "unions"])
def test_none_at_all_is_the_same_bits(kind, rng):
    """As next to none, of which every factor is 1; and it is the same kernels, compiled once."""
    noise = rp.noise.NoiseModel((1e-3, 2e-4), step=1e-3, lateral=0.3, spread=0.2, correlation=((0.3, 2.0),))
    camera = replace(CAMERAS["barrel"], noise=noise)
    (depth,) = measured(camera, 1, rng)
    assert not growth_of_parts(camera, tile_footprints(camera.shape, (12, 12))).size
    fits, _ = fits_of(kind, depth, camera)
    assert np.isfinite(fits.p_value).all()
    compiled = len(assess.signatures), len(label_variances.signatures)
    hardly, _ = fits_of(kind, depth, replace(camera, noise=replace(noise, falloff=1e-300)))
    assert np.isfinite(hardly.p_value).all()
    assert compiled == (len(assess.signatures), len(label_variances.signatures))
    for name in ("p_value", "alpha_covariance", "plane_covariance", "angle_std", "offset_std"):
        np.testing.assert_array_equal(getattr(fits, name), getattr(hardly, name))
    again = replace(hardly, camera=camera)  # another noise, given to what is fitted
    np.testing.assert_allclose(again.p_value, fits.p_value, rtol=5e-3, atol=1e-6)


def test_rough_by_significance_is_a_small_p_value(rng):
    camera = replace(PINHOLE, noise=NOISES["by depth"])
    (depth,) = measured(camera, 1, rng)
    tiles = rp.fit_tiles(depth, camera, 6, significance=0.2)
    sure = np.abs(tiles.p_value / 0.2 - 1.0) > 0.02
    rough = tiles.status == rp.TileStatus.ROUGH
    np.testing.assert_array_equal(rough[sure], (tiles.p_value < 0.2)[sure])
    assert 0.1 < rough.mean() < 0.3
    batch = rp.TileFitter(camera, 6).fit_batch([depth, depth])
    np.testing.assert_array_equal(batch.p_value, np.stack([tiles.p_value] * 2))


def test_rough_by_significance_is_a_small_p_value_of_labels_and_unions(rng):
    camera = replace(PINHOLE, noise=NOISES["constant"])
    (depth,) = measured(camera, 1, rng)
    blocks = np.arange(1, 433).reshape(18, 24)
    labels, tiles = np.kron(blocks, np.ones((8, 8), int)), rp.fit_tiles(depth, camera, 4)
    for fits in (
        rp.fit_labels(depth, camera, labels, significance=0.2),
        rp.merge(tiles, np.kron(blocks, np.ones((2, 2), int)), significance=0.2),
    ):
        rough, sure = fits.status == rp.TileStatus.ROUGH, np.abs(fits.p_value / 0.2 - 1.0) > 0.02
        np.testing.assert_array_equal(rough[sure], (fits.p_value < 0.2)[sure])
        assert 0.1 < rough.mean() < 0.3


def test_sums_of_labels_are_those_of_numpy(rng):
    noise = NOISES["by depth"]
    camera = replace(CAMERAS["barrel"], noise=noise)
    (depth,) = measured(camera, 1, rng)
    labels = rng.integers(0, 4, camera.shape)
    fits = rp.fit_labels(depth, camera, labels)
    rays = np.dstack([camera.tan_x, camera.tan_y, np.ones(camera.shape)])
    for i in range(3):
        here = labels == i + 1
        variance = noise.sigma(rays[here] @ fits.alpha[i], camera.tan_x[here], camera.tan_y[here]) ** 2
        wanted = [variance.sum(), 0.0, np.sum(variance**2)]
        np.testing.assert_allclose(fits._pixels.error_sums[i, :3], wanted, rtol=1e-4, atol=1e-20)


def test_sigma_on_the_axis_and_off_it(tmp_path, rng):
    noise = rp.noise.NoiseModel((1e-3,), step=0.01, falloff=4.0)
    assert noise.sigma(0.5) == replace(noise, falloff=0.0).sigma(0.5)
    angle = np.radians(40.0)
    rounding = (0.01 * 0.25) ** 2 / 12.0
    tan = np.tan(angle) * np.array([0.6, 0.8])
    wanted = np.sqrt((1e-3 / np.cos(angle) ** 4) ** 2 + rounding)
    np.testing.assert_allclose(noise.sigma([0.5, 0.5], *tan), wanted)
    np.testing.assert_allclose(noise.sigma_depth(2.0, *tan), 4.0 * wanted)
    assert "; 1.78 times as much 30 degrees off the axis" in repr(noise)
    assert "off the axis" not in repr(replace(noise, falloff=0.0))
    with pytest.raises(ValueError, match=r"falloff of at most 50, got 1000000000\.0"):
        rp.noise.NoiseModel(falloff=1e9)
    with pytest.raises(ValueError, match=r"falloff of 0 or more, got -1\.0"):
        rp.noise.NoiseModel(falloff=-1)
    with pytest.raises(TypeError, match="falloff as a number, got 'a'"):
        rp.noise.NoiseModel(falloff="a")

    camera = replace(PINHOLE, noise=noise)
    camera.save(tmp_path / "camera.json")
    assert rp.Camera.load(tmp_path / "camera.json") == camera
    older = {name: value for name, value in noise.to_dict().items() if name != "falloff"}
    assert rp.noise.NoiseModel.from_dict(older) == replace(noise, falloff=0.0)
    assert "falloff" not in replace(noise, falloff=0.0).to_dict()
    depth = measured(camera, 1, rng)[0]
    tiles = rp.fit_tiles(depth, camera, 12)
    tiles.save(tmp_path / "tiles.npz")
    np.testing.assert_array_equal(rp.TilePlanes.load(tmp_path / "tiles.npz").p_value, tiles.p_value)

    depth[3, 5] = 0.0
    points = rp.measurement_noise(depth, camera)
    assert np.isnan(points[3, 5]).all()
    depth[3, 5] = np.nan
    np.testing.assert_allclose(points[..., 2], noise.sigma_depth(depth, camera.tan_x, camera.tan_y))


def seen_with(falloff, rng, length=0.0, views=VIEWS):
    """Frames of the furnished room with a noise that grows so, a half of it correlated where there is a length."""
    noise = rp.noise.NoiseModel((1.4e-3,), falloff=falloff)
    for view in views:
        q = 1.0 / rendering(*view).depth
        errors = rng.standard_normal(q.shape)
        if length:
            errors = np.sqrt(0.5) * (errors + smooth(rng, length))
        yield 1.0 / (q + noise.sigma(q, SEEING.tan_x, SEEING.tan_y) * errors)


@pytest.mark.parametrize(("falloff", "length"), [(2.0, 0.0), (4.0, 2.0), (8.0, 0.0)])
def test_is_found_again(falloff, length, rng):
    """And serves frames that it was not estimated from, in the centre as at the edge."""
    camera = replace(SEEING, depth_scale=None)
    model = rp.estimate_noise(list(seen_with(falloff, rng, length)), camera)
    assert model.falloff == pytest.approx(falloff, rel=0.1)
    assert model.sigma(0.5) * np.hypot(1.0, model.floor) == pytest.approx(1.4e-3, rel=0.08)
    assert model.spread < 0.15
    assert model.floor < 0.1
    evidence = model.evidence
    farthest = 1.0 + SEEING.tan_x.max() ** 2 + SEEING.tan_y.max() ** 2  # nearly: there are flat tiles
    assert evidence.edge_growth == pytest.approx(farthest ** (0.5 * model.falloff), rel=0.2)
    figure = evidence.plot()
    (noise_map,) = (axes for axes in figure.axes if axes.get_title().startswith("Noise over"))
    assert "-fold towards the edge" in noise_map.get_xlabel()
    map_ = evidence.noise_map
    ring = away(SEEING, *(12 * np.indices(map_.shape) + 6))
    for i in range(3):
        assert np.nanmean(map_[ring == i]) == pytest.approx(1.0, abs=0.05)

    view = ((0.1, -1.4, 0.0), (0.2, -1.0, 2.6))
    labels = rendering(*view).tile_labels((8, 8))
    ring = away(SEEING, *(8 * np.indices(labels.shape) + 4))
    p_values = np.array(
        [
            rp.fit_tiles(depth, replace(camera, noise=model), 8).p_value
            for depth in seen_with(falloff, rng, length, [view] * 3)
        ]
    )
    for i in range(3):
        assert 0.004 < np.mean(p_values[:, (labels > 0) & (ring == i)] < 0.01) < 0.025


def test_chance_in_the_map_of_the_bias_grows_with_it(rng):
    """Of six planes over the whole image, which have no bias."""
    camera, noise, seen = replace(SEEING, depth_scale=None), rp.noise.NoiseModel((1.4e-3,), falloff=6.0), []
    for tilt in np.linspace(-0.3, 0.3, 6):
        q = 1.0 / rp.scenes.plane((tilt, 0.2, -1.0), 1.5).render(camera).depth
        seen.append(1.0 / (q + noise.sigma(q, camera.tan_x, camera.tan_y) * rng.standard_normal(q.shape)))
    model = rp.estimate_noise(seen, camera)
    assert model.falloff == pytest.approx(6.0, rel=0.1)
    of_chance = model.evidence.flatness / model.evidence.flatness_std
    ring = away(camera, *(8 * np.indices(of_chance.shape) + 4))
    for i in range(3):
        assert np.sqrt(np.nanmean(of_chance[ring == i] ** 2)) == pytest.approx(1.0, abs=0.15)


def test_where_there_is_none_nothing_changes(rng, monkeypatch):
    """Not one bit of what was estimated by depth alone."""
    seen = list(seen_with(0.0, rng))
    found = rp.estimate_noise(seen, replace(SEEING, depth_scale=None))
    assert found.falloff == 0.0
    assert found.evidence.edge_growth == 1.0
    assert "towards the edge" not in "".join(axes.get_xlabel() for axes in found.evidence.plot().axes)
    monkeypatch.setattr(estimation, "_fit_falloff", lambda samples, model: model)
    assert rp.estimate_noise(seen, replace(SEEING, depth_scale=None)) == found


def test_what_differs_from_surface_to_surface_is_none(rng):
    """Noisy surfaces here and there, also towards the edge: these make a spread."""
    seen = []
    for view in VIEWS:
        scene = rendering(*view)
        times = rng.uniform(0.6, 1.8, len(scene.planes) + 1)[np.maximum(scene.labels, 0)]
        q = 1.0 / scene.depth
        seen.append(1.0 / (q + 1.4e-3 * times * rng.standard_normal(q.shape)))
    model = rp.estimate_noise(seen, replace(SEEING, depth_scale=None))
    assert model.falloff == 0.0
    assert model.spread > 0.15


WIDE = rp.Camera(320, 240, 210.0, 210.0, 159.5, 119.5)


def corridor(rng):
    """Inverse depth, slopes and number of the surface of each pixel: far in the middle, near at the edges."""
    half, eye = np.array([0.9, 1.25, 8.0]), np.append(rng.uniform(-0.2, 0.2, 2), rng.uniform(-7.5, 3.0))
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    alpha = normals / (np.tile(half, 2) - normals @ eye)[:, None]
    q = alpha @ np.stack([WIDE.tan_x, WIDE.tan_y, np.ones(WIDE.shape)]).reshape(3, -1)
    surface = q.argmax(axis=0).reshape(WIDE.shape)
    return q.max(axis=0).reshape(WIDE.shape), *alpha[:, :2].T[:, surface], surface


def estimated(make, frames, falloff, rng):
    """What is found in a corridor; ``make`` (q, slope_x, slope_y, wall) makes errors on the axis, and those beside."""
    seen = []
    for _ in range(frames):
        q, *of_pixels = corridor(rng)
        growing, other = make(q, *of_pixels)
        growth = rp.noise.NoiseModel((1.0,), falloff=falloff).sigma(q, WIDE.tan_x, WIDE.tan_y)
        seen.append(1.0 / (q + growth * growing + other))
    return rp.estimate_noise(seen, WIDE)


@pytest.mark.parametrize("falloff", [0.0, 4.0])
def test_the_lateral_error_does_not_grow(falloff, rng):
    """Where it is as large as all else: σq is not what is left of it, nor the falloff that of both together."""

    def errors(q, slope_x, slope_y, wall):
        across = [slope * rng.standard_normal(q.shape) for slope in (slope_x, slope_y)]
        return 1.4e-3 * rng.standard_normal(q.shape), 0.5 / WIDE.fx * (across[0] + across[1])

    model = estimated(errors, 8, falloff, rng)
    assert model.falloff == pytest.approx(falloff, abs=0.3)
    assert model.lateral == pytest.approx(0.5, abs=0.051)
    assert np.median(model.sigma(model.evidence.inverse_depth) / 1.4e-3) == pytest.approx(1.0, abs=0.07)


def test_a_small_error_beside_a_lateral_one(rng):
    def errors(q, slope_x, slope_y, wall):
        across = [slope * rng.standard_normal(q.shape) for slope in (slope_x, slope_y)]
        return 7e-4 * rng.standard_normal(q.shape), 0.6 / WIDE.fx * (across[0] + across[1])

    model = estimated(errors, 6, 0.0, rng)
    assert np.median(model.sigma(model.evidence.inverse_depth) / 7e-4) == pytest.approx(1.0, abs=0.08)
    assert np.mean(model.evidence.p_values < 0.01) < 0.0165


@pytest.mark.parametrize("falloff", [0.0, 4.0])
def test_noise_that_differs_within_a_tile_is_no_error_that_reaches_far(falloff, rng):
    of_depth = rp.noise.time_of_flight(0.0015, 0.001)

    def errors(q, slope_x, slope_y, wall):
        near = gaussian_filter(rng.standard_normal(q.shape), 1.5, mode="wrap")
        both = rng.standard_normal(q.shape) + near / near.std()
        return of_depth.sigma(q) * np.sqrt(0.5) * both, 0.0

    assert estimated(errors, 6, falloff, rng).floor < 0.1


@pytest.mark.filterwarnings("ignore:what is taken for flat differs")
def test_walls_that_differ_are_none(rng):
    """Each covers much of the image: it is not as many parts as it has pixels."""
    of_depth = rp.noise.time_of_flight(0.0015, 0.001)

    def errors(q, slope_x, slope_y, wall):
        return of_depth.sigma(q) * np.exp(0.4 * rng.standard_normal(6))[wall] * rng.standard_normal(q.shape), 0.0

    assert [estimated(errors, 4, 0.0, rng).falloff for _ in range(8)] == [0.0] * 8


@pytest.mark.parametrize(
    ("corners", "most"),
    [
        (((0, 0), (2, 2)), 0.0),
        (((0, 0), (2, 0)), 0.0),
        (((2, 2),), 0.0),
        (((2, 0), (2, 1), (2, 2)), 0.0),
        (((0, 0), (0, 2), (2, 0)), 1.0),  # nearly what a falloff is: then it is no larger than they make it
    ],
)
def test_large_noisy_things_in_corners_are_none(corners, most, rng):
    """Small parts of the image are each but little of them; without a large one, a whole thing, less is left."""
    row, column = np.indices(WIDE.shape) * 3 // np.reshape(WIDE.shape, (2, 1, 1))
    noisy = np.any([(row == y) & (column == x) for y, x in corners], axis=0)
    for _ in range(2):
        seen = []
        for tilt in np.linspace(-0.3, 0.3, 4):
            q = 0.6 + tilt * WIDE.tan_x + 0.1 * WIDE.tan_y
            q += 1.4e-3 * np.where(noisy, 1.2, 1.0) * rng.standard_normal(q.shape)
            seen.append(1.0 / q)
        assert 0.0 <= rp.estimate_noise(seen, WIDE).falloff <= most


def test_tiles_at_the_rim_of_a_fisheye(rng):
    """What of a tile the lens does not see does not count: p-values were above 0.99 in nine of ten such tiles."""
    camera = rp.Camera.from_opencv(
        [[120.0, 0.0, 199.5], [0.0, 120.0, 199.5], [0.0, 0.0, 1.0]], [0.01, -0.005, 0.0, 0.0], (400, 400),
        distortion_model="fisheye",
    )  # fmt: skip
    camera = replace(camera, noise=replace(rp.noise.kinect_v1(), falloff=2.0))
    unseen = camera._without_ray
    q = 0.5 + 0.02 * camera.tan_x
    sigma = camera.noise.sigma(q, camera.tan_x, camera.tan_y)
    share = unseen.reshape(25, 16, 25, 16).mean(axis=(1, 3))
    p_values = []
    for _ in range(10):
        noisy = q + sigma * rng.standard_normal(q.shape)
        depth = np.where(unseen | (noisy <= 0.0), 0.0, 1.0 / np.where(noisy > 0.0, noisy, 1.0))
        p_values.append(rp.fit_tiles(depth, camera, 16).p_value[(share > 0.0) & (share < 0.5)])
    p_value = np.concatenate(p_values)
    p_value = p_value[np.isfinite(p_value)]
    assert len(p_value) > 200
    assert (p_value < 0.01).mean() < 0.06
    assert (p_value > 0.99).mean() < 0.12


@pytest.mark.parametrize(("top", "left"), [(0, 0), (3, 0), (0, 3), (5, 5)])
def test_where_a_real_frame_begins_does_not_decide(top, left):
    folder = real_data.FOLDER / "azure_kinect_nfov"
    if not folder.is_dir():
        pytest.skip(real_data.REASON)
    camera = rp.Camera.load(folder / "camera.json")
    (path,) = (folder / "depth").glob("*.png")
    depth = rp.images.read_depth(path)[top:, left:]
    height, width = depth.shape
    cut = replace(camera, height=height, width=width, cx=camera.cx - left, cy=camera.cy - top)
    assert 4.0 < rp.estimate_noise(depth, cut).falloff < 6.0
