"""Windows of any size and place, also overlapping, against the oracle."""

from dataclasses import replace

import numpy as np
import oracle
import pytest
from frames import CHANGE, METHODS, RMSE_FLOOR, assert_equals_oracle, make_camera, make_depth
from hypothesis import given, settings
from hypothesis import strategies as st

import rgbd_planes as rp
from rgbd_planes._core.status import TileStatus
from rgbd_planes.fitting.methods import solve_planes
from rgbd_planes.fitting.results import allocate
from rgbd_planes.kernels.common.depth import RawFrame
from rgbd_planes.kernels.moments.summed_area import missing_rays


@settings(max_examples=40)
@given(data=st.data())
def test_equals_oracle(data):
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    camera = make_camera(data.draw(st.sampled_from([(), (0.2, -0.5, 0.001, 0.002, 0.3)])), 31, 26)
    depth = make_depth(camera, rng)
    depth[rng.random(depth.shape) < data.draw(st.sampled_from([0.0, 0.1, 0.7]))] = np.nan
    count = data.draw(st.integers(1, 8))
    height, width = rng.integers(1, 27, count), rng.integers(1, 32, count)
    windows = np.column_stack([rng.integers(0, 27 - height), rng.integers(0, 32 - width), height, width])
    method = data.draw(st.sampled_from(METHODS))
    max_missing = data.draw(st.sampled_from([0.0, 0.5, 1.0]))
    for implementation in ("integral", "naive"):
        fits = rp.fit_windows(depth, camera, windows, method, implementation=implementation, max_missing=max_missing)
        expected = oracle.fit_windows(
            depth, camera, windows, method, max_missing=max_missing, change=CHANGE[implementation]
        )
        assert_equals_oracle(fits, expected, rmse_floor=RMSE_FLOOR[implementation])
        assert fits.shape == (count,)
        np.testing.assert_array_equal(fits.windows, windows)


@pytest.mark.parametrize("implementation", ["integral", "naive"])
def test_threads_change_no_bit(implementation, rng):
    camera = make_camera()
    depth = make_depth(camera, rng)
    windows = np.column_stack([rng.integers(0, 24, (50, 2)), np.full((50, 2), 24)])
    one, three = (rp.fit_windows(depth, camera, windows, implementation=implementation, num_threads=n) for n in (1, 3))
    np.testing.assert_array_equal(one.planes, three.planes)


@pytest.mark.parametrize("method", METHODS)
def test_one_line_of_pixels_is_no_plane(method):
    """Sums over a whole frame leave rounding errors in those of a row or a column: no scatter, no plane."""
    camera = rp.presets.primesense()
    depth = rp.scenes.room().render(camera).measure(holes=0.05, seed=1)
    rng = np.random.default_rng(0)
    for height, width in ((1, 3), (3, 1), (1, 7), (20, 1), (1, 200)):
        corner = rng.integers(0, (481 - height, 641 - width), (500, 2))
        windows = np.column_stack([corner, np.tile([height, width], (500, 1))])
        for implementation in ("integral", "naive"):
            fits = rp.fit_windows(depth, camera, windows, method, implementation=implementation, max_missing=1.0)
            assert set(fits.status) <= {rp.TileStatus.TOO_FEW, rp.TileStatus.DEGENERATE}
    corner = rng.integers(0, (479, 639), (500, 2))
    smallest = np.column_stack([corner, np.full((500, 2), 2)])  # but four pixels are one
    fits = rp.fit_windows(depth, camera, smallest, method, implementation="integral", max_missing=0.0)
    usual = rp.fit_windows(depth, camera, smallest, method, implementation="naive", max_missing=0.0)
    assert (fits.status == usual.status).mean() > 0.98


@pytest.mark.parametrize("method", METHODS)
def test_merging_lines_of_pixels_makes_no_plane(method):
    """What is rounding in the sums of a window is rounding in those of a union, also where that is merged again."""
    camera = rp.presets.primesense()
    depth = rp.scenes.room().render(camera).measure(holes=0.05, seed=1)
    rng = np.random.default_rng(0)
    corner = rng.integers(0, (470, 600), (500, 2))
    lines = np.column_stack([corner, np.tile([1, 20], (500, 1))])
    beside, below = np.add(lines, (0, 20, 0, 0)), np.add(lines, (3, 0, 0, 0))
    for implementation in ("integral", "naive"):
        fits = rp.fit_windows(
            depth, camera, np.concatenate([lines, beside, below]), method, implementation=implementation,
            max_missing=1.0,
        )  # fmt: skip
        number, none = np.arange(1, 501), np.zeros(500, int)
        for labels in ([number, none, none], [number, number, none]):
            union = rp.merge(fits, np.concatenate(labels))
            assert set(union.status) <= {rp.TileStatus.TOO_FEW, rp.TileStatus.DEGENERATE}
            assert set(rp.merge(union, number).status) <= {rp.TileStatus.TOO_FEW, rp.TileStatus.DEGENERATE}
        two = rp.merge(fits, np.concatenate([number, none, number]))
        around = rp.fit_windows(
            depth, camera, np.add(lines, (0, 0, 3, 0)), method, implementation=implementation, max_missing=1.0
        )
        assert two.fitted[around.fitted].mean() > 0.98  # but two rows do


@pytest.mark.parametrize("method", METHODS)
def test_merging_ragged_tiles_of_one_column_makes_no_plane(method):
    camera = replace(rp.presets.primesense(), width=577)
    depth = rp.scenes.room().render(camera).measure(seed=1)
    for implementation in ("direct", "integral", "naive"):
        tiles = rp.fit_tiles(depth, camera, 16, method, implementation=implementation, max_missing=1.0)
        last = np.zeros(tiles.shape, int)
        last[:, -1] = np.arange(1, 31)
        assert set(rp.merge(tiles, last).status) <= {rp.TileStatus.TOO_FEW, rp.TileStatus.DEGENERATE}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("far", [1e6, 1e8, 1e10, 3e38])
def test_what_a_far_pixel_leaves_of_the_sums_is_no_plane(method, far):
    camera = rp.Camera(160, 120, 131.0, 131.0, 79.5, 59.5)
    depth = rp.scenes.room().render(camera).depth
    depth[3, 40:60] = far
    windows = np.array([(row, column, 16, 16) for row in range(8, 104, 8) for column in range(0, 144, 8)])
    fits, expected = (rp.fit_windows(depth, camera, windows, method, implementation=i) for i in ("integral", "naive"))
    both = fits.fitted & expected.fitted
    assert oracle.angle(fits.planes[both, :3], expected.planes[both, :3]).max(initial=0.0) < 1.0
    off = np.abs(fits.rmse_metric - expected.rmse_metric)[both]
    assert off.max(initial=0.0) < 1e-3 * np.median(depth)
    assert not np.isnan(fits.planes[fits.fitted]).any()
    unions = np.arange(len(windows)) // 4 + 1
    union, wanted = rp.merge(fits, unions), rp.merge(expected, unions)
    joined = union.fitted & wanted.fitted
    assert oracle.angle(union.planes[joined, :3], wanted.planes[joined, :3]).max(initial=0.0) < 0.1
    assert method.startswith("standard") or both.sum() > 0.8 * len(windows)


@pytest.mark.parametrize(
    ("method", "width", "side", "least", "most"),
    [
        ("standard_explicit", 3840, 4, 0.99, 1.0),
        ("standard_pca", 3840, 8, 0.1, 0.3),
        ("standard_explicit", 1920, 3, 0.4, 0.6),
        ("standard_pca", 1920, 3, 0.1, 0.3),
        ("standard_pca", 640, 3, 0.0, 0.0),
        ("range_explicit", 3840, 3, 0.1, 0.4),
    ],
)
def test_small_windows_of_large_frames_are_degenerate_as_documented(method, width, side, least, most, rng):
    height, focal_length = 9 * width // 16, 525.0 * width / 640
    camera = rp.Camera(width, height, focal_length, focal_length, (width - 1) / 2, (height - 1) / 2)
    depth = rp.scenes.plane((0.0, 0.0, -1.0), 8.0).render(camera).measure(quantise=False)
    if method.startswith("range"):
        depth[: height // 2] = 0.1
    corners = rng.integers((height // 2, 0), (height - side, width - side), (500, 2))
    windows = np.column_stack([corners, np.full((500, 2), side)])
    fits = rp.fit_windows(depth, camera, windows, method, implementation="integral")
    assert least <= np.mean(fits.status == TileStatus.DEGENERATE) <= most


def test_small_windows_on_the_optical_axis_have_their_plane():
    """X and Y are as good as nothing there: it is their Z that sums over the frame keep."""
    camera = replace(rp.presets.primesense(), cx=638.0, cy=478.0, is_part=True)
    depth = rp.scenes.plane((0.1, 0.0, -1.0), 2.0).render(camera).measure(quantise=False)
    windows = [(477, 637, 3, 3)]
    fits = rp.fit_windows(depth, camera, windows, "standard_pca", implementation="integral")
    assert (fits.status == TileStatus.OK).all()


@pytest.mark.parametrize("method", METHODS)
def test_few_windows_are_fitted_from_their_own_pixels(method, rng):
    """Tables are for windows that have more than three times the pixels of the frame."""
    camera = rp.presets.primesense()
    depth = rp.scenes.room().render(camera).measure(holes=0.05, seed=1)
    side = 64
    corners = rng.integers(0, (480 - side, 640 - side), (3 * 480 * 640 // side**2, 2))
    few = np.column_stack([corners, np.full_like(corners, side)])
    for windows, implementation in ((few, "naive"), (np.concatenate([few, few[:1]]), "integral")):
        found = rp.fit_windows(depth, camera, windows, method)
        expected = rp.fit_windows(depth, camera, windows, method, implementation=implementation)
        np.testing.assert_array_equal(found.planes, expected.planes)
        np.testing.assert_array_equal(found.status, expected.status)
    other = rp.fit_windows(depth, camera, few, method, implementation="integral")
    assert (other.planes != rp.fit_windows(depth, camera, few, method).planes).any()


@pytest.mark.parametrize("method", ["range_explicit", "range_implicit"])
def test_tiles_that_lost_their_digits_do_not_spoil_unions_of_others(method):
    camera = rp.Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
    depth = 1.0 / (0.5 + 0.1 * camera.tan_x - 0.1 * camera.tan_y)
    depth[20, 20] = 1e-6
    tiles = rp.fit_tiles(depth, camera, 8, method, implementation="integral")
    assert (tiles.status == TileStatus.DEGENERATE).sum() == 23  # to the right of it and below
    labels = np.zeros(tiles.shape, int)
    labels[0, :2] = 1
    np.testing.assert_allclose(rp.merge(tiles, labels).alpha, [[0.1, -0.1, 0.5]], atol=1e-12)


@pytest.mark.parametrize("method", ["standard_explicit", "standard_pca"])
def test_windows_that_lost_their_digits_make_no_plane_as_unions_either(method, tmp_path):
    """Also if they are loaded, or merged again."""
    camera = rp.Camera(160, 120, 131.0, 131.0, 79.5, 59.5)
    depth = rp.scenes.room().render(camera).depth
    depth[3, 40:60] = 1e8
    windows = np.array([(row, column, 16, 16) for row in range(8, 104, 8) for column in range(0, 144, 8)])
    fits = rp.fit_windows(depth, camera, windows, method, implementation="integral")
    assert (fits.status == TileStatus.DEGENERATE).all()
    alone = np.arange(1, len(windows) + 1)
    union = rp.merge(fits, alone)
    for saved in (fits, union):
        saved.save(tmp_path / "planes.npz")
        for again in (saved, type(saved).load(tmp_path / "planes.npz")):
            assert (rp.merge(again, alone).status == TileStatus.DEGENERATE).all()


@pytest.mark.parametrize("near", [1e-4, 1e-6, 1e-9, 1e-12])
@pytest.mark.parametrize("method", ["range_explicit", "range_implicit"])
def test_what_a_near_pixel_leaves_of_the_sums_is_no_plane(method, near, rng):
    """Of sums of 1/Z². Windows before it, and all windows if it is not too near, have their planes."""
    camera = replace(rp.presets.primesense(), depth_scale=None, noise=rp.noise.kinect_v1())
    depth = rp.scenes.room().render(camera).measure(quantise=False, seed=1)
    depth[200, 300] = near
    corner = rng.integers(0, (464, 624), (500, 2))
    windows = np.column_stack([corner, np.full((500, 2), 16)])
    sums, pixels = (
        rp.fit_windows(depth, camera, windows, method, implementation=implementation)
        for implementation in ("integral", "naive")
    )
    without = (corner > (200, 300)).any(axis=1) | (corner + 16 <= (200, 300)).any(axis=1)
    after = (corner + 16 > (200, 300)).all(axis=1)
    lost = without & after & (near < 1e-5)
    assert (sums.status[lost] == TileStatus.DEGENERATE).all()
    assert (sums.fitted[~lost] == pixels.fitted[~lost]).all()
    assert np.isnan(rp.merge(sums, np.where(lost, 1, 0)).planes).all()
    both = sums.fitted & pixels.fitted
    np.testing.assert_allclose(sums.planes[both], pixels.planes[both], atol=1e-3)
    np.testing.assert_allclose(sums.rmse[both], pixels.rmse[both], rtol=1e-2, atol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_a_scatter_that_rounding_has_made_negative_is_no_plane(method):
    """Of nine pixels at one place: what is left of sums over a frame that were so large."""
    arrays = allocate((), (1,))
    u = np.array([1.0, 0.3, 0.3, 0.5])
    arrays["_moments"][:, 0] = 9.0 * np.outer(u, u)[np.triu_indices(4)] - 1e-10 * np.isin(np.arange(10), (4, 7))
    solve_planes(method, arrays, np.full(1, 3.0), np.inf, 0, 1, 1e5)
    assert arrays["status"][0] == TileStatus.DEGENERATE


def test_no_windows_no_planes():
    camera = make_camera()
    assert rp.fit_windows(np.ones(camera.shape), camera, []).planes.shape == (0, 4)


@pytest.mark.parametrize(
    ("windows", "error", "message"),
    [
        ([0, 0, 5, 5], ValueError, r"shape \(K, 4\)"),
        ([[0, 0, 5]], ValueError, r"got \(1, 3\)"),
        ([[0, 0, 5.0, 5]], TypeError, "must be integers"),
        ([[0, 0, 5, 5], [44, 0, 5, 5]], ValueError, r"got \[44, 0, 5, 5\] .* as window 1"),
        ([[-1, 0, 5, 5]], ValueError, r"inside the frame of \(height, width\) = \(48, 64\), got"),
        ([[0, 0, 0, 5]], ValueError, "inside the frame"),
        ([[0, 60, 5, 5]], ValueError, "inside the frame"),
        ([[0, -1, 5, 5]], ValueError, "inside the frame"),
        ([[0, 0, 5, 0]], ValueError, "inside the frame"),
        # Whose sums no int64 holds.
        ([[2**40, 0, 2**63 - 2**40, 4]], ValueError, r"got .* as window 0"),
        ([[0, 2**63 - 1, 4, 2**63 - 1]], ValueError, r"got .* as window 0"),
        ([[0, 0, -(2**63), 4]], ValueError, r"got .* as window 0"),
        (np.array([[2**64 - 1, 0, 5, 5]], np.uint64), ValueError, r"got .* as window 0"),
        (np.array([[0, 0, 2**63, 2**63]], np.uint64), ValueError, r"9223372036854775808\] .* as window 0"),
    ],
)
def test_bad_windows_are_refused(windows, error, message):
    camera = make_camera()
    with pytest.raises(error, match=message):
        rp.fit_windows(np.ones(camera.shape), camera, windows)


def test_bad_arguments_are_refused():
    camera = make_camera()
    with pytest.raises(ValueError, match="integral, naive, got 'direct'"):
        rp.fit_windows(np.ones(camera.shape), camera, [], implementation="direct")


def test_a_frame_of_which_more_is_missing_than_was_counted():
    """As where a camera's driver overwrites it meanwhile: nothing is written beyond the room that there is."""
    raw = np.zeros((4, 5), np.uint16)
    sums = np.full((7, 5), np.nan)
    before = np.zeros((4, 6), np.int32)
    missing_rays(RawFrame(raw, 1, 9, 1.0, 0.0, False), (np.ones((4, 5)), np.ones((4, 5))), before, sums[:4])
    assert before.max() == 3
    assert np.isfinite(sums[:4]).all()
    assert np.isnan(sums[4:]).all()
