"""Every method and implementation against the oracle, tile by tile."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import oracle
import pytest
from frames import (
    CHANGE,
    DISTORTIONS,
    DTYPES_BY_LENS,
    HEIGHT,
    METHODS,
    RMSE_FLOOR,
    WIDTH,
    as_dtype,
    assert_equals_oracle,
    make_camera,
    make_depth,
    make_holes,
)
from hypothesis import given, settings
from hypothesis import strategies as st

import rgbd_planes as rp
from rgbd_planes.kernels.fits import tiles as tile_kernels

IMPLEMENTATIONS = ("direct", "integral", "naive")


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
@pytest.mark.parametrize(
    ("holes", "tile"),
    [("none", (11, 13)), ("some", 16), ("most", (11, 13)), ("tiles", 16)],
    ids=lambda value: str(value),
)
@pytest.mark.parametrize(("distortion", "dtype"), [pair for pair in DTYPES_BY_LENS if pair[0] != "five"])
def test_equals_oracle(method, implementation, dtype, holes, tile, distortion, rng):
    camera = make_camera(DISTORTIONS[distortion])
    depth = as_dtype(make_holes(make_depth(camera, rng), holes, rng), dtype)
    windows = oracle.tile_windows(camera, tile)
    for max_missing in (0.5, 1.0):
        tiles = rp.fit_tiles(depth, camera, tile, method, implementation=implementation, max_missing=max_missing)
        expected = oracle.fit_windows(
            depth, camera, windows, method, max_missing=max_missing, change=CHANGE[implementation]
        )
        compared = assert_equals_oracle(tiles, expected, rmse_floor=RMSE_FLOOR[implementation])
        assert compared >= 0.8 * np.count_nonzero(tiles.fitted)
    if holes == "tiles":
        assert {rp.TileStatus.TOO_FEW, rp.TileStatus.OK} <= set(tiles.status.flat)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("tile", [(70, 1340), (40, 700), (33, 24)])  # of the last, the last column is ragged
@pytest.mark.parametrize("distortion", ["pinhole", "five"])
def test_tiles_higher_and_wider_than_what_is_summed_at_once_equal_the_oracle(method, tile, distortion, rng):
    camera = rp.Camera(1340, 70, 950.0, -940.0, 650.0, 38.0, DISTORTIONS[distortion], depth_scale=1000.0)
    q = 0.5 + 0.1 * camera.tan_x - 0.3 * camera.tan_y + 1e-3 * rng.standard_normal(camera.shape)
    depth = as_dtype(make_holes(1.0 / q, "some", rng), "uint16")
    tiles = rp.fit_tiles(depth, camera, tile, method)
    expected = oracle.fit_windows(depth, camera, oracle.tile_windows(camera, tile), method, change=CHANGE["direct"])
    compared = assert_equals_oracle(tiles, expected, rmse_floor=RMSE_FLOOR["direct"])
    assert compared >= 0.8 * np.count_nonzero(tiles.fitted) > 0


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
def test_circular_image_of_a_fisheye_equals_oracle(method, implementation, rng):
    # It sees as far as 57 degrees from the axis: rays at nearly a right angle cost the sums of whole frames digits.
    camera = rp.Camera(64, 48, 42.0, -42.0, 31.0, 24.5, (-1 / 3, 0, 0, 0), "fisheye", depth_scale=1000.0)
    row, column = np.indices(camera.shape)
    unseen = np.hypot(row - 24.5, column - 31.0) >= 42.0 * 2 / 3
    assert 0.05 < unseen.mean() < 0.5
    depth = as_dtype(make_holes(make_depth(camera, rng), "some", rng), "uint16")
    with pytest.warns(UserWarning, match="where the fisheye lens has no ray within"):
        tiles = rp.fit_tiles(depth, camera, 8, method, implementation=implementation)
    windows = oracle.tile_windows(camera, 8)
    expected = oracle.fit_windows(np.where(unseen, 0, depth), camera, windows, method, change=CHANGE[implementation])
    compared = assert_equals_oracle(tiles, expected, rmse_floor=RMSE_FLOOR[implementation])
    assert compared >= 0.8 * np.count_nonzero(tiles.fitted) > 0
    assert {rp.TileStatus.TOO_FEW, rp.TileStatus.OK} <= set(tiles.status.flat)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
def test_disparity_equals_oracle(method, implementation, rng):
    camera = make_camera(depth_scale=None, disparity=(-0.002, 3.0), invalid_values=(2047, 1100))
    raw = np.round((1.0 / make_depth(camera, rng) - 3.0) / -0.002).astype(np.uint16)
    raw[rng.random(raw.shape) < 0.2] = 2047
    tiles = rp.fit_tiles(raw, camera, 16, method, implementation=implementation)
    expected = oracle.fit_windows(raw, camera, oracle.tile_windows(camera, 16), method)
    assert assert_equals_oracle(tiles, expected, rmse_floor=RMSE_FLOOR[implementation]) == tiles.status.size


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
def test_depths_out_of_range_are_missing_at_either_end(method, implementation, rng):
    camera = make_camera(depth_range=(1.0, 2.5))
    depth = as_dtype(make_depth(camera, rng), "uint16")
    assert (depth > 2500).any()
    for value in (999, 1000, 2500, 2501):  # the two in the middle count
        depth[rng.random(depth.shape) < 0.05] = value
    tiles = rp.fit_tiles(depth, camera, 16, method, implementation=implementation)
    expected = oracle.fit_windows(depth, camera, oracle.tile_windows(camera, 16), method)
    assert assert_equals_oracle(tiles, expected, rmse_floor=RMSE_FLOOR[implementation]) > 0


@settings(max_examples=60)
@given(data=st.data())
def test_any_holes_any_tile(data):
    """Whatever is missing, whatever the tile: the oracle's planes and reasons."""
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    camera = make_camera(data.draw(st.sampled_from(list(DISTORTIONS.values()))), 24, 17)
    depth = make_depth(camera, rng)
    depth[rng.random(depth.shape) < data.draw(st.floats(0, 1))] = data.draw(
        st.sampled_from([0.0, -1.0, np.nan, np.inf, -np.inf])
    )
    tile = (data.draw(st.integers(2, 17)), data.draw(st.integers(2, 24)))
    method = data.draw(st.sampled_from(METHODS))
    implementation = data.draw(st.sampled_from(IMPLEMENTATIONS))
    max_missing = data.draw(st.floats(0, 1))
    tiles = rp.fit_tiles(depth, camera, tile, method, implementation=implementation, max_missing=max_missing)
    expected = oracle.fit_windows(
        depth, camera, oracle.tile_windows(camera, tile), method,
        max_missing=max_missing, change=CHANGE[implementation],
    )  # fmt: skip
    assert_equals_oracle(tiles, expected, rmse_floor=RMSE_FLOOR[implementation])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("incidence", [0, 30, 60, 75, 80])
@pytest.mark.parametrize("distance", [0.3, 3.0, 30.0])
def test_noise_free_plane_is_exact(method, incidence, distance):
    """Tiles in every part of a wide image whose rays meet the plane at up to 80°."""
    camera = rp.Camera(320, 240, 262.0, 262.0, 159.5, 119.5, depth_range=(0.0, 1e4))
    rays = np.stack([camera.tan_x, camera.tan_y, np.ones(camera.shape)], axis=-1)
    for row, column in [(8, 8), (8, 310), (120, 160), (230, 100), (230, 310)]:
        # A normal at this angle to the ray of the tile's middle, tilted in both directions.
        ray = rays[row, column] / np.linalg.norm(rays[row, column])
        across = np.cross(ray, [0.6, 0.8, 0.1])
        across /= np.linalg.norm(across)
        normal = -np.cos(np.deg2rad(incidence)) * ray + np.sin(np.deg2rad(incidence)) * across
        d = -distance * normal @ ray
        q = -(rays @ normal) / d
        depth = np.where(q > 0.01 / distance, 1.0 / np.where(q > 0, q, 1.0), 0.0)
        top, left = row - row % 16, column - column % 16
        for implementation in ("direct", "naive"):
            tiles = rp.fit_tiles(depth, camera, 16, method, implementation=implementation, max_missing=1.0)
            plane = tiles.planes[top // 16, left // 16]
            assert oracle.angle(plane[:3], normal) < 1e-9
            assert abs(plane[3] - d) < 1e-9 * d
            assert tiles.status[top // 16, left // 16] == rp.TileStatus.OK


@pytest.mark.parametrize("distortion", [(), DISTORTIONS["five"]], ids=["pinhole", "five"])
@pytest.mark.parametrize("method", METHODS)
def test_however_the_image_lies_the_planes_are_the_same(method, distortion, rng):
    """Mirrored, with a focal length of the other sign; or rows for columns, and so x for y."""
    camera = make_camera(distortion, noise=rp.noise.kinect_v1())
    depth = make_holes(make_depth(camera, rng), "some", rng)
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    last_column, last_row = camera.width - 1, camera.height - 1
    across = {"width": HEIGHT, "height": WIDTH, "fx": fy, "fy": fx, "cx": cy, "cy": cx}
    if distortion:
        k1, k2, p1, p2, k3 = distortion
        across["distortion"] = (k1, k2, p2, p1, k3)
    tiles, normals = rp.fit_tiles(depth, camera, 8, method), rp.normals(depth, camera)
    for changed, turn, axes in (
        ({"fx": -fx, "cx": last_column - cx}, np.fliplr, (0, 1, 2)),
        ({"fy": -fy, "cy": last_row - cy}, np.flipud, (0, 1, 2)),
        (across, lambda image: np.swapaxes(image, 0, 1), (1, 0, 2)),
    ):
        other = replace(camera, **changed)
        turned = rp.fit_tiles(turn(depth), other, 8, method)
        np.testing.assert_array_equal(turn(turned.status), tiles.status)
        np.testing.assert_allclose(turn(turned.planes)[..., (*axes, 3)], tiles.planes, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(turn(turned.p_value), tiles.p_value, rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(turn(turned.offset_std), tiles.offset_std, rtol=1e-6)
        np.testing.assert_allclose(turn(rp.normals(turn(depth), other))[..., axes], normals, atol=1e-6)


@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
@pytest.mark.parametrize("method", METHODS)
def test_threads_change_no_bit(method, implementation, rng):
    camera = make_camera()
    frames = np.stack([make_holes(make_depth(camera, rng), "some", rng) for _ in range(5)])
    results = [
        rp.TileFitter(camera, (7, 9), method, implementation=implementation, num_threads=n) for n in (1, 2, 3, 8, None)
    ]
    single = [results[0].fit(frame) for frame in frames]
    for fitter in results:
        stack = fitter.fit_batch(frames)
        assert len(stack) == 5
        for i, one in enumerate(single):
            for name in ("planes", "alpha", "rmse", "rmse_metric", "valid_count", "status"):
                np.testing.assert_array_equal(getattr(stack[i], name), getattr(one, name))
                np.testing.assert_array_equal(getattr(fitter.fit(frames[i]), name), getattr(one, name))


def test_rough_keeps_its_plane(rng):
    camera = make_camera()
    depth = make_depth(camera, rng)
    for method in METHODS:
        plain = rp.fit_tiles(depth, camera, method=method)
        limit = float(np.sort(plain.rmse_metric, axis=None)[5])  # which is not above itself
        tiles = rp.fit_tiles(depth, camera, method=method, max_error=limit)
        np.testing.assert_array_equal(tiles.status == rp.TileStatus.ROUGH, plain.rmse_metric > limit)
        np.testing.assert_array_equal(tiles.planes, plain.planes)
        assert tiles.fitted.all()
        assert 0 < np.count_nonzero(tiles.status == rp.TileStatus.ROUGH) < tiles.status.size


@pytest.mark.parametrize("method", METHODS)
def test_degenerate_has_a_reason(method):
    """Collinear pixels; a plane through the camera centre, which no camera sees from the front."""
    camera = make_camera(width=16, height=16)
    row = np.zeros((16, 16))
    row[5, :] = 2.0
    tiles = rp.fit_tiles(row, camera, 16, method, max_missing=1.0)
    assert tiles.status.item() == rp.TileStatus.DEGENERATE
    assert np.isnan(tiles.planes).all()
    assert tiles.valid_count.item() == 16
    row[5, ::2] = 3.0
    edge_on = rp.fit_tiles(row, camera, 16, method, max_missing=1.0)
    assert edge_on.status.item() == rp.TileStatus.DEGENERATE
    assert np.isnan(edge_on.planes).all()
    slanted = 1.0 / (0.5 + 0.1 * camera.tan_x + 0.2 * camera.tan_y)
    y, x = np.indices(slanted.shape)
    for line in (y == 5, x == 3, x == y, x + y == 15, x == 2 * y):
        on_line = rp.fit_tiles(np.where(line, slanted, 0.0), camera, 16, method, max_missing=1.0)
        assert on_line.status.item() == rp.TileStatus.DEGENERATE
    two = np.zeros((16, 16))
    two[3, 3] = two[9, 5] = 1.0
    assert rp.fit_tiles(two, camera, 16, method, max_missing=1.0).status.item() == rp.TileStatus.TOO_FEW


@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
def test_a_plane_that_all_but_contains_the_camera_is_none(implementation):
    """Where 1/Z varies far more than the rays do, and hardly with them, the implicit plane is one of rays."""
    camera = rp.Camera(16, 16, 52.0, -51.0, 7.5, 7.5)
    row, column = np.indices(camera.shape)
    for slope, status in ((1e-8, rp.TileStatus.DEGENERATE), (1e-2, rp.TileStatus.OK)):
        depth = 1.0 / (1.0 + 0.5 * (-1.0) ** (row + column) + slope * camera.tan_x)
        tile = rp.fit_tiles(depth, camera, 16, "range_implicit", implementation=implementation)
        (expected,) = oracle.fit_windows(depth, camera, [(0, 0, 16, 16)], "range_implicit")
        assert tile.status.item() == expected.status == status


def test_out_is_written_into(rng):
    camera = make_camera()
    fitter = rp.TileFitter(camera, 16)
    first, second = make_depth(camera, rng), make_depth(camera, rng)
    out = fitter.fit(first)
    planes = out.planes
    again = fitter.fit(second, out=out)
    assert again is out
    assert again.planes is planes
    np.testing.assert_array_equal(planes, fitter.fit(second).planes)
    stack = fitter.fit_batch([first, second])
    assert fitter.fit_batch([second, first], out=stack) is stack
    np.testing.assert_array_equal(stack[0].planes, planes)
    copied = copy.deepcopy(out)  # and with it the camera, as it comes from another process
    assert fitter.fit(first, out=copied) is copied
    np.testing.assert_array_equal(copied.planes, stack[1].planes)
    for other in (
        rp.TileFitter(camera, 8),
        rp.TileFitter(camera, (16, 17)),  # as many tiles
        rp.TileFitter(camera, 16, "range_implicit"),
        rp.TileFitter(replace(camera, fx=53.0), 16),
    ):
        with pytest.raises(ValueError, match="out must be a result of this fitter"):
            other.fit(first, out=out)
    for frames, result in (([first], stack), ([first] * 3, stack), ([first], out)):
        with pytest.raises(ValueError, match=r"of shape \(\d, 3, 4\), got"):
            fitter.fit_batch(frames, out=result)
    with pytest.raises(ValueError, match=r"of shape \(3, 4\), got"):
        fitter.fit(first, out=stack)
    for name in ("planes", "_moments"):
        array = getattr(out, name).copy(order="F")
        read_only = getattr(out, name).copy()
        read_only.flags.writeable = False
        for wrong in (array, read_only):
            with pytest.raises(ValueError, match=f"contiguous and may be written, {name} is not"):
                fitter.fit(first, out=replace(out, **{name: wrong}))


@pytest.mark.parametrize("implementation", ["integral", "naive"])
def test_a_result_of_another_implementation_is_written_into(implementation, rng):
    """Its moments were about the tiles' own points, those of these are about the origin."""
    camera = make_camera()
    first, second = make_depth(camera, rng), make_depth(camera, rng)
    fitter = rp.TileFitter(camera, 16, implementation=implementation)
    out = fitter.fit(second, out=rp.TileFitter(camera, 16).fit(first))
    np.testing.assert_array_equal(out.planes, fitter.fit(second).planes)


@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
@pytest.mark.parametrize("method", METHODS)
def test_a_fitter_goes_to_another_process_without_kernels(method, implementation, rng):
    """Those of another Python do not load, and those that are compiled or in the cache there will do."""
    camera = make_camera(noise=rp.noise.NoiseModel((2e-3,)))  # that of the depth: p-values are even
    options = {"max_missing": 0.1, "max_error": 0.02, "significance": 0.2, "num_threads": 2}
    fitter = rp.TileFitter(camera, (8, 9), method, implementation=implementation, **options)
    depth = make_holes(make_depth(camera, rng), "tiles", rng)
    wanted = fitter.fit(depth)
    compiled = tile_kernels.fit_tiles.signatures
    pickled = pickle.dumps(fitter)
    assert b"numba" not in pickled
    unpickled = pickle.loads(pickled)
    found = unpickled.fit(depth)
    np.testing.assert_array_equal(found.planes, wanted.planes)
    np.testing.assert_array_equal(found.status, wanted.status)
    assert len(np.unique(found.status)) > 2
    assert (unpickled.camera, unpickled._num_threads) == (camera, 2)
    assert tile_kernels.fit_tiles.signatures == compiled


def test_inputs_of_any_kind_are_the_same_frame(rng):
    """Byte order, strides, read-only and integer width do not matter."""
    camera = make_camera()
    raw = as_dtype(make_holes(make_depth(camera, rng), "some", rng), "uint16")
    wanted = rp.fit_tiles(raw, camera).planes
    wide = np.zeros((HEIGHT, 2 * WIDTH), np.uint16)
    wide[:, ::2] = raw
    read_only = raw.copy()
    read_only.flags.writeable = False
    kinds = [raw.astype(">u2"), np.asfortranarray(raw), wide[:, ::2], read_only, raw[::-1][::-1]]
    for kind in [*kinds, raw.astype(np.int32), raw.astype(np.uint64)]:
        np.testing.assert_allclose(rp.fit_tiles(kind, camera).planes, wanted, rtol=1e-12)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"tile": 0}, ValueError, "tile must be at least 2 x 2 pixels, got 0"),
        ({"tile": (1, 16)}, ValueError, r"got \(1, 16\)"),
        ({"tile": 49}, ValueError, r"fit into the frame of \(height, width\) = \(48, 64\), got 49"),
        ({"tile": 16.5}, TypeError, "whole number of pixels"),
        ({"tile": (4, 4, 4)}, TypeError, "tile must be"),
        ({"tile": "16"}, TypeError, "tile must be"),
        ({"method": "pca"}, ValueError, "range_explicit, .* got 'pca'"),
        ({"implementation": "fast"}, ValueError, "direct, integral, naive, got 'fast'"),
        ({"max_missing": 1.5}, ValueError, "between 0 and 1, got 1.5"),
        ({"max_missing": float("nan")}, ValueError, "between 0 and 1"),
        ({"max_error": -1.0}, ValueError, "positive length"),
        ({"num_threads": 0}, ValueError, "num_threads must be at least 1"),
    ],
)
def test_bad_arguments_are_refused(options, error, message):
    camera = make_camera()
    with pytest.raises(error, match=message):
        rp.fit_tiles(np.ones(camera.shape), camera, **options)


def test_bad_frames_are_refused():
    camera = make_camera()
    with pytest.raises(TypeError, match="expected a Camera, got dict"):
        rp.fit_tiles(np.ones(camera.shape), {})
    with pytest.raises(ValueError, match="at least one frame"):
        rp.TileFitter(camera).fit_batch([])
    with pytest.raises(ValueError, match="transposed"):
        rp.fit_tiles(np.ones((WIDTH, HEIGHT)), camera)


def test_nothing_valid_is_no_error():
    camera = make_camera()
    for depth in (np.full(camera.shape, np.nan), np.zeros(camera.shape, np.uint16)):
        tiles = rp.fit_tiles(depth, camera)
        assert (tiles.status == rp.TileStatus.TOO_FEW).all()
        assert np.isnan(tiles.planes).all()
        assert "TOO_FEW" in repr(tiles)


@pytest.mark.parametrize("method", METHODS)
def test_range_without_a_raw_value(method):
    """Nothing of a frame that ends before the nearest depth is valid, not even the ends of the empty interval."""
    camera = make_camera(depth_range=(70.0, 80.0))
    depth = np.zeros(camera.shape, np.uint16)
    depth[1::2], depth[:, ::3] = 1, 65535
    tiles = rp.fit_tiles(depth, camera, (9, 16), method)
    assert (tiles.valid_count == 0).all()
    assert (tiles.status == rp.TileStatus.TOO_FEW).all()


@pytest.mark.parametrize("method", METHODS)
def test_real_frame_equals_oracle(real_frame, method):
    """The changes that a well-posed problem survives are larger here than above.

    Sums over a whole frame of this size carry a hundred times the rounding, and the standard fits of steep
    surfaces square what they are given.
    """
    depth, camera = real_frame
    windows = np.array(oracle.tile_windows(camera, 40))
    chosen = np.arange(0, len(windows), 5)
    for implementation in IMPLEMENTATIONS:
        tiles = rp.fit_tiles(depth, camera, 40, method, implementation=implementation)
        change = {"direct": 1e-12, "naive": 1e-9, "integral": 1e-8}[implementation]
        expected = oracle.fit_windows(depth, camera, windows[chosen], method, change=change)
        assert_equals_oracle(tiles, expected, chosen=chosen, rmse_floor=RMSE_FLOOR[implementation])


@pytest.mark.parametrize("implementation", ["naive", "integral"])
def test_small_tiles_of_large_frames_have_their_implicit_plane(implementation, rng):
    """Of sums about the optical axis rounding left so little that one tile of 3 x 3 in fifteen had none."""
    camera = rp.Camera(1920, 1080, 1400.0, 1400.0, 959.5, 539.5).cropped(0, 0, 480, 270)
    depth = 1.0 / (1.0 / 3.0 + 1.425e-3 * rng.standard_normal(camera.shape))
    expected = rp.fit_tiles(depth, camera, 3, "range_implicit")
    found = rp.fit_tiles(depth, camera, 3, "range_implicit", implementation=implementation)
    assert np.count_nonzero(found.fitted != expected.fitted) <= 3
    both = found.fitted & expected.fitted
    assert np.median(np.linalg.norm(found.planes[both] - expected.planes[both], axis=1)) < 1e-6


def test_out_of_another_fitter_is_refused(rng):
    """Even if it has as many tiles: it would say that its planes are of another camera, method or tile."""
    camera = make_camera()
    depth = make_depth(camera, rng)
    fitter = rp.TileFitter(camera, 16)
    out, batch = fitter.fit(depth), fitter.fit_batch([depth])
    before = out.planes.copy()
    for other in (
        rp.TileFitter(replace(camera, fx=53.0), 16),
        rp.TileFitter(camera, 16, "standard_pca"),
        rp.TileFitter(camera, (17, 16)),
    ):
        assert other.fit(depth).shape == out.shape
        with pytest.raises(ValueError, match="out must be a result of this fitter"):
            other.fit(depth, out=out)
        with pytest.raises(ValueError, match="out must be a result of this fitter"):
            other.fit_batch([depth], out=batch)
    np.testing.assert_array_equal(out.planes, before)


@pytest.mark.parametrize("implementation", ["integral", "naive"])
def test_out_of_another_implementation_is_as_good(implementation, rng):
    """Its moments were about the middle of each tile; these are about the origin."""
    camera = make_camera()
    depth = make_depth(camera, rng)
    fitter = rp.TileFitter(camera, 16, implementation=implementation)
    out = rp.fit_tiles(depth, camera, 16)
    np.testing.assert_array_equal(fitter.fit(depth, out=out).planes, fitter.fit(depth).planes)


def test_a_share_of_missing_pixels_is_no_number_of_binary_digits():
    """0.29 of 100 pixels are 29, although their product is less."""
    camera = make_camera(width=10, height=10)
    for missing, status in ((29, rp.TileStatus.OK), (30, rp.TileStatus.TOO_FEW)):
        depth = np.ones(100)
        depth[:missing] = 0.0
        assert rp.fit_tiles(depth.reshape(10, 10), camera, 10, max_missing=0.29).status[0, 0] == status


@pytest.mark.parametrize("method", METHODS)
def test_range_without_a_raw_value_behind_a_lens(method):
    camera = make_camera(DISTORTIONS["five"], depth_range=(70.0, 80.0))
    depth = np.zeros(camera.shape, np.uint16)
    depth[1::2], depth[:, ::3] = 1, 65535
    tiles = rp.fit_tiles(depth, camera, (9, 16), method)
    assert (tiles.valid_count == 0).all()
    assert (tiles.status == rp.TileStatus.TOO_FEW).all()
