"""Surfaces of second order against least squares on each tile's pixels, and against exact curvatures."""

import copy
import pickle

import numpy as np
import oracle
import pytest
from curved_frames import ball, curvatures_of_quadric, inverse_depth_of_quadric, pipe, rays_of
from frames import DISTORTIONS, DTYPES_BY_LENS, HEIGHT, WIDTH, as_dtype, make_camera, make_holes

import rgbd_planes as rp

COLUMNS = ("coefficients", "rmse", "rmse_metric", "valid_count", "status")


def make_bent(camera, rng, noise=2e-3):
    """A bent sheet with noise, in metres."""
    x, y = camera.tan_x, camera.tan_y
    q = 0.6 + 0.1 * x - 0.2 * y + 0.3 * x * x + 0.2 * x * y - 0.15 * y * y
    return 1.0 / (q + noise * rng.standard_normal(q.shape))


def central_ray(camera, window):
    row, column, height, width = window
    part = (slice(row, row + height), slice(column, column + width))
    return camera.tan_x[part].mean(), camera.tan_y[part].mean()


def lstsq_surface(q, camera, window, centre, max_missing):
    """(status, count, β, rmse, rmse_metric, well posed) of a window, from its pixels."""
    row, column, height, width = window
    part = (slice(row, row + height), slice(column, column + width))
    u, v, q = camera.tan_x[part].ravel(), camera.tan_y[part].ravel(), q[part].ravel()
    valid = np.isfinite(q)
    count = int(valid.sum())
    nothing = (np.full(6, np.nan), np.nan, np.nan, True)
    if count < 6 or q.size - count > max_missing * q.size + 1e-9:
        return oracle.TOO_FEW, count, *nothing
    u, v, q = u[valid] - centre[0], v[valid] - centre[1], q[valid]
    s, t = max(np.abs(u).max(), 1e-9), max(np.abs(v).max(), 1e-9)
    terms = np.column_stack([np.ones_like(u), u / s, v / t, (u / s) ** 2, u * v / s / t, (v / t) ** 2])
    size = np.maximum(np.linalg.norm(terms, axis=0), 1e-9)
    singular = np.linalg.svd(terms / size, compute_uv=False)
    if singular[-1] < 1e-6 * singular[0]:
        return oracle.DEGENERATE, count, *nothing
    beta = np.linalg.lstsq(terms, q)[0]
    rmse = np.sqrt(np.mean((q - terms @ beta) ** 2))
    beta /= [1.0, s, t, s * s, s * t, t * t]
    alpha = np.array([beta[1], beta[2], beta[0] - beta[1] * centre[0] - beta[2] * centre[1]])
    if not beta[0] > 0.0:
        return oracle.DEGENERATE, count, *nothing
    return oracle.OK, count, beta, rmse, rmse / np.linalg.norm(alpha) / q.mean(), singular[-1] > 1e-2 * singular[0]


def assert_equals_lstsq(found, depth, camera, windows, max_missing):
    q = oracle.inverse_depth(depth, camera)
    status, count = found.status.ravel(), found.valid_count.ravel()
    beta, rmse, metric = found.coefficients.reshape(-1, 6), found.rmse.ravel(), found.rmse_metric.ravel()
    centre = found.central_rays.reshape(-1, 2)
    compared = 0
    for i, window in enumerate(windows):
        wanted = lstsq_surface(q, camera, window, centre[i], max_missing)
        assert count[i] == wanted[1]
        if wanted[5]:
            assert status[i] == wanted[0], (window, wanted)
        if status[i] in (oracle.TOO_FEW, oracle.DEGENERATE):
            assert np.isnan([*beta[i], rmse[i], metric[i]]).all()
        elif wanted[5]:
            compared += 1
            # Relative to what each term does over the tile.
            scale = 10.0 ** -np.array([0, 1, 1, 2, 2, 2])
            np.testing.assert_allclose(beta[i] * scale, wanted[2] * scale, rtol=1e-9, atol=1e-10)
            np.testing.assert_allclose([rmse[i], metric[i]], wanted[3:5], rtol=1e-6, atol=1e-8)
    return compared


@pytest.mark.parametrize("holes", ["none", "some", "most", "tiles"])
@pytest.mark.parametrize("tile", [16, (11, 13)], ids=["divides", "ragged"])
@pytest.mark.parametrize(("distortion", "dtype"), DTYPES_BY_LENS)
def test_equals_least_squares_of_each_tile(dtype, holes, tile, distortion, rng):
    camera = make_camera(DISTORTIONS[distortion])
    depth = as_dtype(make_holes(make_bent(camera, rng), holes, rng), dtype)
    windows = oracle.tile_windows(camera, tile)
    for max_missing in (0.5, 1.0):
        found = rp.fit_surfaces(depth, camera, tile, max_missing=max_missing)
        compared = assert_equals_lstsq(found, depth, camera, windows, max_missing)
        assert compared >= 0.7 * np.count_nonzero(found.fitted)
    if holes == "tiles":
        assert {rp.TileStatus.TOO_FEW, rp.TileStatus.OK} <= set(found.status.flat)


@pytest.mark.parametrize("tile", [(70, 1340), (40, 700), (66, 24)])
@pytest.mark.parametrize("distortion", ["pinhole", "five"])
def test_tiles_higher_and_wider_than_what_is_summed_at_once(tile, distortion, rng):
    camera = rp.Camera(1340, 70, 950.0, -940.0, 650.0, 38.0, DISTORTIONS[distortion], depth_scale=1000.0)
    depth = as_dtype(make_holes(make_bent(camera, rng), "some", rng), "uint16")
    depth[10:40, 100:180] = 0
    found = rp.fit_surfaces(depth, camera, tile, max_missing=1.0)
    assert assert_equals_lstsq(found, depth, camera, oracle.tile_windows(camera, tile), 1.0) > 0


def test_disparity_is_fitted_as_it_is(rng):
    camera = make_camera(depth_scale=None, disparity=(-1e-3, 1.5))
    raw = np.round((1.0 / make_bent(camera, rng) - 1.5) / -1e-3).astype(np.uint16)
    raw[5:9, 3:20] = 0
    camera = rp.Camera.from_dict(camera.to_dict() | {"invalid_values": [0]})
    found = rp.fit_surfaces(raw, camera, 12)
    assert assert_equals_lstsq(found, raw, camera, oracle.tile_windows(camera, 12), 0.5) > 15


def test_pixels_on_a_conic_determine_nothing(rng):
    camera = make_camera()
    depth = np.zeros(camera.shape)
    row, column = np.indices(camera.shape)
    depth[:16, :16] = np.where((row[:16, :16] % 16 == 3) | (row[:16, :16] % 16 == 9), 2.0, 0.0)  # two lines
    depth[16:32, :16] = np.where((row[16:32, :16] - 24) * (column[16:32, :16] - 8) == 0, 2.0, 0.0)  # a cross
    depth[:16, 16:32] = np.where((row[:16, 16:32] == 4) | (row[:16, 16:32] == 8) | (row[:16, 16:32] == 12), 2.0, 0.0)
    found = rp.fit_surfaces(depth, camera, 16, max_missing=1.0)
    assert found.status[0, 0] == found.status[1, 0] == rp.TileStatus.DEGENERATE
    assert found.status[0, 1] == rp.TileStatus.OK
    assert found.status[2, 2] == rp.TileStatus.TOO_FEW
    assert np.isnan(found.points[0, 0]).all()
    assert np.isnan(found.principal_curvatures[0, 0]).all()


@pytest.mark.parametrize("distortion", ["pinhole", "five"])
def test_same_bits_for_any_threads_batches_and_out(distortion, rng):
    camera = make_camera(DISTORTIONS[distortion], noise=rp.noise.kinect_v1())
    frames = np.stack([as_dtype(make_holes(make_bent(camera, rng), "some", rng), "uint16") for _ in range(3)])
    alone = [rp.fit_surfaces(frame, camera, 12, num_threads=1) for frame in frames]
    fitter = rp.SurfaceFitter(camera, 12, num_threads=3)
    batch = fitter.fit_batch(frames)
    streamed = list(fitter.fit_stream(iter(frames)))
    again = pickle.loads(pickle.dumps(fitter)).fit_batch(list(frames))
    for i, one in enumerate(alone):
        for other in (batch[i], streamed[i], again[i]):
            for name in COLUMNS:
                np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
            np.testing.assert_array_equal(one.mean_curvature, other.mean_curvature)
            np.testing.assert_array_equal(one.p_flat, other.p_flat)
    first = batch[0]
    before = first.mean_curvature.copy()
    assert fitter.fit_batch(frames[[1, 0, 2]], out=batch) is batch
    np.testing.assert_array_equal(first.mean_curvature, alone[1].mean_curvature)  # nothing stale
    assert not np.array_equal(first.mean_curvature, before)
    copied = copy.deepcopy(batch)
    fitter.fit_batch(frames, out=batch)
    np.testing.assert_array_equal(copied[0].coefficients, alone[1].coefficients)


@pytest.mark.filterwarnings("ignore:c[xy] = .* lies outside an image")
def test_geometry_of_random_ellipsoids_off_the_axis_and_behind_a_lens(rng):
    worst = 0.0
    for distortion in ((), (0.1, -0.05, 0.001, 0.001, 0.02)):
        for _ in range(100):
            # A long lens makes a small tile: nine pixels of 1e-5 each way, up to 30 degrees off the axis.
            cx, cy = 4.0 + 4e4 * rng.uniform(-1, 1, 2)
            camera = rp.Camera(9, 9, 1e5, 1e5, cx, cy, distortion)
            ray = np.array([camera.tan_x[4, 4], camera.tan_y[4, 4], 1.0])
            centre = 2.0 * ray + 0.05 * rng.standard_normal(3)
            turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
            matrix = turn @ np.diag(rng.uniform(0.25, 0.6, 3) ** -2.0) @ turn.T
            q = inverse_depth_of_quadric(rays_of(camera), matrix, centre)
            found = rp.fit_surfaces(1.0 / q, camera, 9)
            normal, curvatures = curvatures_of_quadric(found.points.reshape(1, 3), matrix, centre)
            worst = max(worst, np.abs(found.principal_curvatures[0, 0] / curvatures[0] - 1.0).max())
            np.testing.assert_allclose(found.normals[0, 0], normal[0], atol=1e-7)
            np.testing.assert_allclose(found.mean_curvature[0, 0], curvatures[0].mean(), rtol=1e-5)
            np.testing.assert_allclose(found.gaussian_curvature[0, 0], curvatures[0].prod(), rtol=2e-5)
    assert worst < 1e-6, worst


def test_directions_are_along_and_around_a_cylinder():
    camera = rp.Camera(64, 48, 525.0, 525.0, 31.5, 23.5)
    axis = np.array([1.0, 0.4, 0.2]) / np.linalg.norm([1.0, 0.4, 0.2])
    q = inverse_depth_of_quadric(rays_of(camera), *pipe((0.0, 0.0, 1.2), axis, 0.2))
    found = rp.fit_surfaces(1.0 / q, camera, 8)
    np.testing.assert_allclose(found.principal_curvatures[2:4, 2:6, 0], 5.0, rtol=2e-3)
    np.testing.assert_allclose(found.principal_curvatures[2:4, 2:6, 1], 0.0, atol=1e-2)
    directions = found.principal_directions[2:4, 2:6]
    np.testing.assert_allclose(directions[..., 1, :] @ axis, 1.0, atol=1e-5)
    np.testing.assert_allclose((directions**2).sum(axis=-1), 1.0, atol=1e-12)
    normals = found.normals[2:4, 2:6]
    assert np.abs((directions * normals[..., None, :]).sum(axis=-1)).max() < 1e-12
    assert (directions[..., 0] >= 0.0).all()


def test_a_bowl_is_curved_the_other_way():
    camera = rp.Camera(32, 32, 300.0, 300.0, 15.5, 15.5)
    rays = rays_of(camera)
    _, centre = ball((0.0, 0.0, 1.0), 0.5)
    mm, mc, k = (rays**2).sum(-1), rays @ centre, centre @ centre - 0.25
    far = (mc - np.sqrt(mc**2 - k * mm)) / k
    found = rp.fit_surfaces(1.0 / far, camera, 16)
    np.testing.assert_allclose(found.mean_curvature, -2.0, rtol=1e-2)
    np.testing.assert_allclose(found.gaussian_curvature, 4.0, rtol=2e-2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tile": 2}, "at least 3 x 3"),
        ({"tile": 1000}, "fit into the frame"),
        ({"max_missing": 2.0}, "between 0 and 1"),
        ({"significance": 0.1}, "needs a camera with a noise model"),
    ],
)
def test_wrong_arguments_say_what_was_expected(arguments, message):
    camera = make_camera()
    with pytest.raises(ValueError, match=message):
        rp.fit_surfaces(np.ones((HEIGHT, WIDTH)), camera, **arguments)


def test_uncertainties_need_a_noise_model():
    found = rp.fit_surfaces(np.ones((HEIGHT, WIDTH)), make_camera())
    with pytest.raises(ValueError, match="noise model"):
        found.p_flat  # noqa: B018
    with pytest.raises(TypeError, match="index an array"):
        found[0]


def test_saved_surfaces_come_back(tmp_path, rng):
    camera = make_camera(noise=rp.noise.kinect_v1())
    found = rp.fit_surfaces(make_bent(camera, rng), camera, 12)
    found.save(tmp_path / "bent.npz")
    again = rp.TileSurfaces.load(tmp_path / "bent.npz")
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(found, name), getattr(again, name))
    np.testing.assert_array_equal(found.p_flat, again.p_flat)
    with pytest.raises(ValueError, match="holds TileSurfaces"):
        rp.TilePlanes.load(tmp_path / "bent.npz")
    table = found.to_table()
    assert len({len(column) for column in table.values()}) == 1
    assert "p_flat" in table


@pytest.mark.parametrize("window", [5, 9])
@pytest.mark.parametrize("holes", ["none", "some", "most"])
@pytest.mark.parametrize("distortion", ["pinhole", "five"])
def test_dense_curvatures_equal_least_squares_of_each_window(window, holes, distortion, rng):
    camera = make_camera(DISTORTIONS[distortion], width=40, height=100)
    depth = as_dtype(make_holes(make_bent(camera, rng), holes, rng), "uint16")
    depth[50, 20] = 0 if holes == "none" else 1  # so near that it would leave rounding errors behind
    found = rp.principal_curvatures(depth, camera, window, max_missing=0.7, num_threads=2)
    np.testing.assert_array_equal(found, rp.principal_curvatures(depth, camera, window, max_missing=0.7, num_threads=1))
    q = oracle.inverse_depth(depth, camera)
    half, compared = window // 2, 0
    for row, column in zip(rng.integers(0, 100, 120), rng.integers(0, 40, 120), strict=True):
        top, left = max(row - half, 0), max(column - half, 0)
        box = (top, left, min(row + half, 99) + 1 - top, min(column + half, 39) + 1 - left)
        ray = camera.tan_x[row, column], camera.tan_y[row, column]
        status, _, beta, _, _, well = lstsq_surface(q, camera, box, ray, 0.7)
        if not np.isfinite(q[row, column]) or status == oracle.TOO_FEW:
            assert np.isnan(found[row, column]).all()
        elif well and status == oracle.OK:
            wanted = exact_curvatures(beta, *ray)
            np.testing.assert_allclose(found[row, column], wanted, rtol=1e-5, atol=1e-5 * np.abs(wanted).max())
            compared += 1
    assert compared > 30


def exact_curvatures(beta, u, v):
    """κ₁ and κ₂ of q = β·φ at its central ray, by the fundamental forms of X = m/q, from numerical derivatives."""
    q, a, b, r, s, t = beta[0], beta[1], beta[2], 2.0 * beta[3], beta[4], 2.0 * beta[5]
    m, z = np.array([u, v, 1.0]), 1.0 / q
    m_u, m_v = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    x_u, x_v = z * m_u - z * z * a * m, z * m_v - z * z * b * m
    x_uu = -2.0 * z * z * a * m_u + (2.0 * z**3 * a * a - z * z * r) * m
    x_uv = -z * z * (b * m_u + a * m_v) + (2.0 * z**3 * a * b - z * z * s) * m
    x_vv = -2.0 * z * z * b * m_v + (2.0 * z**3 * b * b - z * z * t) * m
    normal = np.cross(x_u, x_v)
    normal *= -np.sign(normal @ m) / np.linalg.norm(normal)
    first = np.array([[x_u @ x_u, x_u @ x_v], [x_u @ x_v, x_v @ x_v]])
    second = -np.array([[normal @ x_uu, normal @ x_uv], [normal @ x_uv, normal @ x_vv]])
    return np.sort(np.linalg.eigvals(np.linalg.solve(first, second)).real)[::-1]


def test_pictures_of_surfaces(rng):
    camera = rp.Camera(160, 120, 130.0, 130.0, 79.5, 59.5, noise=rp.noise.kinect_v1())
    q = inverse_depth_of_quadric(rays_of(camera), *ball((0.0, 0.0, 1.2), 0.4))
    depth = 1.0 / (np.where(np.isfinite(q), q, 0.5) + 1e-3 * rng.standard_normal(camera.shape))
    depth[:20, :30] = 0.0
    found = rp.fit_surfaces(depth, camera, 12)
    _, _, strokes = found.plot(depth).axes[:3]
    assert "curvature" in strokes.get_title().lower()
    assert len(strokes.collections[0].get_segments()) == np.count_nonzero(found.fitted & (found.p_flat < 0.01))
    picture = np.asarray(strokes.images[0].get_array())
    assert np.allclose(picture[3, 3], (0.86, 0.86, 0.86))  # missing
    red, _, blue = picture[60, 80]
    assert red > blue  # the ball bulges
    assert "bulging" in found._repr_html_()
    assert len(found.plot().axes) == len(found.plot(depth).axes)
    batch = rp.SurfaceFitter(camera, 12).fit_batch(np.stack([depth, depth]))
    with pytest.raises(ValueError, match="plot them"):
        batch.plot()
    assert "first frame" in batch._repr_html_()


@pytest.mark.parametrize("implementation", ["integral", "naive"])
@pytest.mark.parametrize("holes", ["none", "some"])
@pytest.mark.parametrize("distortion", ["pinhole", "five"])
def test_windows_equal_least_squares(implementation, holes, distortion, rng):
    camera = make_camera(DISTORTIONS[distortion], noise=rp.noise.kinect_v1())
    depth = as_dtype(make_holes(make_bent(camera, rng), holes, rng), "uint16")
    windows = np.array([(0, 0, 48, 64), (5, 7, 12, 14), (30, 40, 9, 9), (10, 20, 3, 3), (0, 0, 2, 20), (47, 0, 1, 60)])
    found = rp.fit_surface_windows(depth, camera, windows, implementation=implementation, max_missing=1.0)
    q = oracle.inverse_depth(depth, camera)
    for i, window in enumerate(windows):
        wanted = lstsq_surface(q, camera, window, found.central_rays[i], 1.0)
        assert found.valid_count[i] == wanted[1]
        assert found.fitted[i] == (wanted[0] == oracle.OK)
        if found.fitted[i] and wanted[5]:
            close = 1e-9 if implementation == "naive" else 1e-6
            scale = 10.0 ** -np.array([0, 1, 1, 2, 2, 2])
            np.testing.assert_allclose(found.coefficients[i] * scale, wanted[2] * scale, rtol=close, atol=close)
            np.testing.assert_allclose(found.rmse[i], wanted[3], rtol=1e-5, atol=1e-8)
    assert found.fitted.sum() >= 4
    one = rp.fit_surfaces(depth, camera, (12, 14), max_missing=1.0)
    same = rp.fit_surface_windows(depth, camera, oracle.tile_windows(camera, (12, 14)), max_missing=1.0)
    np.testing.assert_allclose(same.mean_curvature, one.mean_curvature.ravel(), rtol=0.2, atol=0.5)
    np.testing.assert_allclose(same.p_value, one.p_value.ravel(), atol=1e-5)


@pytest.mark.parametrize("distortion", ["pinhole", "five"])
def test_merged_surfaces_are_those_of_all_pixels(distortion, rng):
    camera = make_camera(DISTORTIONS[distortion], noise=rp.noise.kinect_v1())
    depth = as_dtype(make_holes(make_bent(camera, rng), "some", rng), "uint16")
    tiles = rp.fit_surfaces(depth, camera, 12)
    labels = np.zeros(tiles.shape, int)
    labels[:2, :3], labels[2:, 2:] = 1, 3
    merged = rp.merge(tiles, labels)
    q = oracle.inverse_depth(depth, camera)
    assert merged.status[1] == rp.TileStatus.TOO_FEW
    for i, window in ((0, (0, 0, 24, 36)), (2, (24, 24, 24, 40))):
        wanted = lstsq_surface(q, camera, window, merged.central_rays[i], 1.0)
        assert merged.valid_count[i] == wanted[1]
        scale = 10.0 ** -np.array([0, 1, 1, 2, 2, 2])
        np.testing.assert_allclose(merged.coefficients[i] * scale, wanted[2] * scale, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(merged.rmse[i], wanted[3], rtol=1e-6)
        whole = rp.fit_surface_windows(depth, camera, [window])
        np.testing.assert_allclose(merged.p_value[i], whole.p_value[0], rtol=0.05, atol=1e-4)
    with pytest.raises(ValueError, match="shape of the planes"):
        rp.merge(tiles, labels[:1])
    with pytest.raises(TypeError, match="merge their parts"):
        rp.merge(merged, [1, 1, 1])
