"""How far rays are apart: with it the lateral error counts, through any lens."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import rgbd_planes as rp
from rgbd_planes.camera.pixel_pitch import lens_by_angle, pitch_square, slope_square
from rgbd_planes.fitting.tile_grid import tile_footprints, tile_windows
from rgbd_planes.kernels.segmentation.model.pixel_noise import through_lens

PINHOLE = rp.Camera(160, 120, 90.0, -95.0, 81.0, 57.0)
LENSES = {
    "pinhole": PINHOLE,
    "barrel": replace(PINHOLE, distortion=(-0.25, 0.05, 0.002, -0.001, 0.0)),
    "inverse": replace(PINHOLE, distortion=(0.12, 0.05, 0.002, -0.001, 0.0), distortion_model="inverse_brown_conrady"),
    "fisheye": rp.Camera(160, 160, 52.0, 52.0, 79.5, 79.5, (0.01, -0.005, 0.0, 0.0), "fisheye"),
}


def gradient(camera, alpha):
    """Change of q = α·m from pixel to pixel along x and y, (2, H, W)."""
    y, x = np.gradient(alpha[0] * camera.tan_x + alpha[1] * camera.tan_y + alpha[2])
    return np.stack([x, y])


@pytest.mark.parametrize("lens", LENSES)
def test_slopes_are_the_means_over_the_pixels(lens):
    camera = LENSES[lens]
    alpha = np.array([0.3, -0.5, 0.8])
    square = np.sum(gradient(camera, alpha) ** 2, axis=0)
    footprint = tile_footprints(camera.shape, (16, 16))
    made = slope_square(np.tile(alpha, (len(footprint), 1)), camera, footprint)
    mean = [square[y : y + h, x : x + w].mean() for y, x, h, w in tile_windows(camera.shape, (16, 16))]
    middle = np.ones(len(mean), bool)
    if lens == "fisheye":  # at its border a tile of 16 pixels sees 15 degrees or has pixels without a ray
        rows, columns = np.indices((10, 10))
        middle = (np.hypot(rows - 4.5, columns - 4.5) < 3.5).ravel()
    np.testing.assert_allclose(made[middle], np.array(mean)[middle], rtol=0.01)


def test_one_row_or_column_of_pixels_is_a_part_of_an_image_too():
    for size in ((40, 1), (1, 40)):
        camera = rp.Camera(*size, 90.0, 90.0, 0.0, 0.0, (-0.1, 0.0, 0.0, 0.0))
        uu, uv, vv = pitch_square(camera, np.array([[40, 0, 0, 0, 0]]))
        assert uu == pytest.approx(90.0**-2, rel=0.1)
        assert vv == pytest.approx(90.0**-2, rel=0.1)
        assert abs(uv) < 0.1 * 90.0**-2


@pytest.mark.parametrize("lens", LENSES)
def test_lateral_error_is_in_p_values_and_covariances(lens, rng):
    """Errors of half a pixel across the ray: a hundredth of the p-values below 0.01, and covariances that hold."""
    noise = rp.noise.NoiseModel((5e-4,), lateral=0.5)
    camera = replace(LENSES[lens], noise=noise)
    alpha = np.array([0.5, 0.3, 0.9])
    q = alpha[0] * camera.tan_x + alpha[1] * camera.tan_y + alpha[2]
    far_out = np.hypot(camera.tan_x, camera.tan_y) > 3.0  # there a tile of a fisheye spans a range of depths
    across = 0.5 * np.hypot(*gradient(camera, alpha))
    errors = rng.standard_normal((2, 60, *q.shape))
    depth = 1.0 / (q + 5e-4 * errors[0] + across * errors[1])
    depth[:, far_out | (q < 0.05)] = 0.0
    tiles = rp.TileFitter(camera, 8, max_missing=0.0).fit_batch(depth)
    outer = np.hypot(*(np.indices(tiles.shape[1:]) - 7.0)) > 5.0
    for where in (outer, ~outer):
        chosen = tiles.fitted & where
        assert np.mean(tiles.p_value[chosen] < 0.01) == pytest.approx(0.01, abs=0.008)
        error = tiles.alpha[chosen] - alpha
        squares = error[:, None] @ np.linalg.solve(tiles.alpha_covariance[chosen], error[..., None])
        assert np.mean(squares) == pytest.approx(3.0, abs=0.2)


@pytest.mark.parametrize("lens", ["pinhole", "barrel"])
def test_labels_windows_and_unions_have_that_of_their_pixels(lens, rng):
    """Of the same pixels nearly the same, however they are fitted: of labels each pixel counts, of windows a mean."""
    camera = replace(LENSES[lens], noise=rp.noise.NoiseModel((5e-4,), lateral=0.5))
    depth = 1.0 / (0.9 + 0.5 * camera.tan_x + 1e-3 * rng.standard_normal(camera.shape))
    of_tiles = np.zeros((15, 20), int)
    of_tiles[2:6, 3:9], of_tiles[8:12, 11:19] = 1, 2
    merged = rp.merge(rp.fit_tiles(depth, camera, 8), of_tiles)
    labelled = rp.fit_labels(depth, camera, np.kron(of_tiles, np.ones((8, 8), int)))
    windows = rp.fit_windows(depth, camera, [(16, 24, 32, 48), (64, 88, 32, 64)])
    for fits, nearly in ((merged, 0.01), (windows, 0.08)):
        np.testing.assert_allclose(fits.p_value, labelled.p_value, rtol=5.0 * nearly, atol=1e-12)
        trace = np.trace(labelled.alpha_covariance, axis1=1, axis2=2)[:, None, None]
        np.testing.assert_allclose(fits.alpha_covariance / trace, labelled.alpha_covariance / trace, atol=nearly)


@pytest.mark.parametrize("noise", [rp.noise.NoiseModel(), rp.noise.time_of_flight(0.002, 0.001)])
@pytest.mark.parametrize("focal_length", [105.0, 80.0])  # 54 and 70 degrees off the axis
def test_labels_and_unions_behind_a_wide_fisheye(focal_length, noise, rng):
    """The error across the ray is that of each pixel: at the rim the lens makes it many times as large."""
    noise = replace(noise, lateral=0.5)
    lens = focal_length, focal_length, 79.5, 59.5, (0.02, -0.01, 0.003, -0.001), "fisheye"
    camera = rp.Camera(160, 120, *lens, noise=noise)
    alpha = np.array([0.0, 0.6, 0.2])
    rays = np.dstack([camera.tan_x, camera.tan_y, np.ones(camera.shape)])
    q = rays @ alpha
    down, across = np.gradient(q)
    deviation = np.sqrt(noise.sigma(np.maximum(q, 0.01)) ** 2 + 0.25 * (down**2 + across**2))
    mask = np.indices(camera.shape)[0] >= 64
    solve = np.linalg.pinv(rays[mask])
    exact = (solve * deviation[mask] ** 2) @ solve.T
    p_values = []
    for _ in range(60):
        depth = np.where(mask, 1.0 / np.maximum(q + deviation * rng.standard_normal(q.shape), 0.01), np.nan)
        labelled = rp.fit_labels(depth, camera, mask.astype(int), significance=0.0)
        p_values.append(labelled.p_value[0])
    tiles = rp.fit_tiles(depth, camera, 8)
    merged = rp.merge(tiles, np.where(np.arange(15)[:, None] >= 8, np.ones(20, int), 0))
    for fits in (labelled, merged):
        ratios = np.linalg.eigvals(np.linalg.solve(exact, fits.alpha_covariance[0])).real
        np.testing.assert_allclose(ratios, 1.0, atol=0.1)
    assert stats.kstest(p_values, "uniform").pvalue > 1e-3


@pytest.mark.parametrize("lens", ["barrel", "inverse", "fisheye"])
def test_table_by_angle_is_that_of_round_lenses(lens):
    """What segments know of a lens: slopes by the angle off the axis alone."""
    camera = LENSES[lens]
    camera = replace(camera, fy=abs(camera.fy))
    alpha = np.array([0.3, -0.5, 0.8])
    windows = tile_windows(camera.shape, (4, 4))
    square = slope_square(np.tile(alpha, (len(windows), 1)), camera, tile_footprints(camera.shape, (4, 4)))
    table = lens_by_angle(camera)
    found = np.empty(len(windows))
    for i, (y, x, h, w) in enumerate(windows):
        u, v = camera.tan_x[y : y + h, x : x + w].ravel(), camera.tan_y[y : y + h, x : x + w].ravel()
        sums = float(len(u)), u @ u, u @ v, v @ v
        found[i] = through_lens(alpha[0], alpha[1], camera.fx**-2, camera.fy**-2, table, *sums)
    radius = np.hypot(camera.tan_x, camera.tan_y)[windows[:, 0] + 2, windows[:, 1] + 2]
    ratio = found[radius < 3.0] / square[radius < 3.0]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.02)
    assert np.quantile(np.abs(np.log(ratio)), 0.98) < 0.1
    assert lens_by_angle(PINHOLE).shape == (2, 0)


def test_a_pixel_on_the_axis_is_no_direction():
    distortion = (0.1, -0.2, 0.001, -0.002, 0.05)
    on_axis, beside = (
        rp.Camera(320, 240, 200.0, 200.0, cx, cy, distortion=distortion) for cx, cy in ((161, 121), (161.3, 121.2))
    )
    angles = np.linspace(0.0, 0.5, 65)  # radius / (1 + radius)
    square = (angles / (1.0 - angles)) ** 2
    (across, along), (expected_across, expected_along) = lens_by_angle(on_axis), lens_by_angle(beside)
    np.testing.assert_allclose(across[:65], expected_across[:65], rtol=0.02)
    np.testing.assert_allclose(along[:65] * square, expected_along[:65] * square, atol=0.02)


@pytest.mark.parametrize("given", [True, False])
def test_segments_of_a_fisheye_with_a_lateral_error(given, rng):
    """Half a pixel is much of 1/Z where a lens sees far to the side: that was several times too little there."""
    camera = rp.Camera(320, 320, 100.0, 100.0, 159.5, 159.5, (0.01, -0.005, 0.0, 0.0), "fisheye")
    noise = rp.noise.NoiseModel((1e-3,), lateral=0.5)
    rendering = rp.scenes.room().render(camera)
    planes = rendering.planes[np.maximum(rendering.labels, 1) - 1]
    slopes = -planes[..., :2] / planes[..., 3:]
    (u_y, u_x), (v_y, v_x) = np.gradient(camera.tan_x), np.gradient(camera.tan_y)
    across = np.stack([slopes[..., 0] * u_x + slopes[..., 1] * v_x, slopes[..., 0] * u_y + slopes[..., 1] * v_y])
    errors = rng.standard_normal((3, *camera.shape))
    q = 1.0 / rendering.depth + 1e-3 * errors[0] + 0.5 * np.sum(across * errors[1:], axis=0)
    depth = np.where((q > 0.0) & (rendering.labels > 0), 1.0 / q, 0.0)
    found = rp.segment(depth, camera, noise=noise if given else None)
    seen = depth > 0.0
    assert np.mean(found.labels[seen] > 0) > 0.98
    covering = rp.metrics.compare_labels(found.labels, rendering.labels * seen).covering
    assert covering > (0.95 if given else 0.85)  # what the frame shows of the error is more than there is
