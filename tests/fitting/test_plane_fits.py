"""What a result shows, saves and turns into."""

import copy
import pickle
import re
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from frames import make_camera, make_depth, make_holes

import rgbd_planes as rp
from rgbd_planes.kernels.solvers import methods as solve


@pytest.fixture
def tiles(rng):
    camera = make_camera((0.1, -0.2, 0.001, 0.0, 0.0), depth_range=(0.1, 9.0))
    depth = make_holes(make_depth(camera, rng), "tiles", rng)
    return rp.fit_tiles(depth, camera, (11, 13), "range_implicit", max_error=0.01)


def test_the_kernels_number_the_status_as_the_library_does():
    numbers = {status.name: getattr(solve, status.name) for status in rp.TileStatus}
    assert numbers == {status.name: status.value for status in rp.TileStatus}


def test_arrays_have_the_types_that_are_documented(tiles):
    for name in ("planes", "alpha", "rmse", "rmse_metric"):
        assert getattr(tiles, name).dtype == np.float64
    assert (tiles.valid_count.dtype, tiles.status.dtype) == (np.int32, np.uint8)


def test_repr_says_what_there_is(tiles):
    text = repr(tiles)
    assert text.startswith("<TilePlanes: 5 x 5 tiles of 11 x 13 pixels, range_implicit: ")
    for status in rp.TileStatus:
        count = np.count_nonzero(tiles.status == status)
        assert (f"{count} {status.name}" in text) == (count > 0)
    median = 1e3 * np.median(tiles.rmse_metric[np.isfinite(tiles.rmse_metric)])
    shown = re.search(r"median rmse ([\d.]+) mm", text)
    assert shown
    assert float(shown[1]) == pytest.approx(median, rel=0.06)  # two digits


@pytest.mark.parametrize("frames", [None, 1, 3])
def test_save_and_load(tiles, frames, tmp_path, rng):
    if frames is not None:
        fitter = rp.TileFitter(tiles.camera, tiles.tile, tiles.method)
        tiles = fitter.fit_batch([make_depth(tiles.camera, rng) for _ in range(frames)])
    tiles.save(tmp_path / "planes.npz")
    loaded = rp.TilePlanes.load(tmp_path / "planes.npz")
    assert loaded.camera == tiles.camera
    assert (loaded.tile, loaded.method) == (tiles.tile, tiles.method)
    for name in ("planes", "alpha", "rmse", "rmse_metric", "valid_count", "status"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(tiles, name))
        assert getattr(loaded, name).dtype == getattr(tiles, name).dtype
    assert [path.name for path in tmp_path.iterdir()] == ["planes.npz"]


def test_a_slice_without_frames(tiles, tmp_path, rng):
    none = rp.TileFitter(tiles.camera, 8).fit_batch([make_depth(tiles.camera, rng)])[0:0]
    assert "0 frames" in none._repr_html_()
    none.save(tmp_path / "none.npz")
    assert rp.TilePlanes.load(tmp_path / "none.npz").shape == none.shape


WINDOWS = np.array([[0, 0, 20, 30], [10, 5, 30, 12], [40, 50, 8, 14], [3, 3, 1, 1]])


def of_windows(depth, camera):
    return rp.fit_windows(depth, camera, WINDOWS, "standard_pca")


def of_elements(depth, camera):
    return rp.segment_quadtree(depth, camera, 8, max_subdivisions=2).elements


def of_labels(depth, camera):
    return rp.fit_labels(depth, camera, np.arange(depth.size).reshape(depth.shape) // 1000 * (depth > 1.6))


def of_unions(depth, camera):
    return rp.merge(rp.fit_tiles(depth, camera, 8), np.arange(48).reshape(6, 8) % 5)


def of_unions_of_windows(depth, camera):
    return rp.merge(of_windows(depth, camera), [1, 1, 0, 2])


@pytest.mark.parametrize("fit", [of_windows, of_elements, of_labels, of_unions, of_unions_of_windows])
@pytest.mark.parametrize(
    "noise",
    [
        None,
        rp.noise.kinect_v1(),
        rp.noise.NoiseModel((1e-3, 2e-4), correlation=((0.4, 3.0),), floor=0.5, spread=0.2, lateral=0.3, falloff=1.0),
    ],
    ids=["without", "independent", "shared"],
)
def test_fits_of_all_kinds_are_saved(fit, noise, tmp_path, rng):
    """What is loaded is as good as new: for uncertainties, to be merged, and with another noise model."""
    camera = make_camera(noise=noise)
    depth = make_holes(make_depth(camera, rng), "tiles", rng)
    made = fit(depth, camera)
    made.save(tmp_path / "planes.npz")
    loaded = type(made).load(tmp_path / "planes.npz")
    assert (loaded.camera, loaded.method, repr(loaded)) == (made.camera, made.method, repr(made))
    every = ["planes", "alpha", "rmse", "rmse_metric", "valid_count", "status", "_moments", "_reference", "_footprint"]
    every += {of_windows: ["windows"], of_elements: ["windows", "level"]}.get(fit, ["labels"])
    every += ["p_value", "plane_covariance", "angle_std"] if noise is not None else []
    for name in every:
        np.testing.assert_array_equal(getattr(loaded, name), getattr(made, name))
        assert getattr(loaded, name).dtype == getattr(made, name).dtype
    assert str(loaded.to_table()) == str(made.to_table())
    both = np.ones(made.shape, np.int32)
    np.testing.assert_array_equal(rp.merge(loaded, both).planes, rp.merge(made, both).planes)
    if noise is not None:
        np.testing.assert_array_equal(rp.merge(loaded, both).p_value, rp.merge(made, both).p_value)
    other = rp.noise.time_of_flight(2e-3)
    changed = [replace(one, camera=camera.with_noise(other)) for one in (loaded, made)]
    np.testing.assert_array_equal(*(one.alpha_covariance for one in changed))
    changed[1].save(tmp_path / "other.npz")
    np.testing.assert_array_equal(type(made).load(tmp_path / "other.npz").p_value, changed[1].p_value)


def test_unions_of_nothing_are_saved(tmp_path):
    camera = make_camera(noise=rp.noise.quantised(rp.noise.kinect_v1(), 0.001))
    windows = rp.fit_windows(np.ones(camera.shape), camera, np.empty((0, 4), int))
    rp.merge(windows, np.empty(0, int)).save(tmp_path / "none.npz")
    assert rp.MergedPlanes.load(tmp_path / "none.npz").shape == (0,)


def test_elements_of_a_quadtree_are_windows(tmp_path, rng):
    camera = make_camera()
    depth = make_depth(camera, rng)
    elements, windows = of_elements(depth, camera), of_windows(depth, camera)
    elements.save(tmp_path / "planes.npz")
    loaded = rp.WindowPlanes.load(tmp_path / "planes.npz")
    np.testing.assert_array_equal(loaded.windows, elements.windows)
    windows.save(tmp_path / "windows.npz")
    with pytest.raises(ValueError, match=r"windows\.npz: not a file that QuadtreePlanes\.save wrote"):
        type(elements).load(tmp_path / "windows.npz")


@pytest.mark.parametrize("fit", [rp.fit_tiles, of_windows, of_elements, of_labels, of_unions, rp.segment])
def test_tables_are_the_caller_s_own(fit, rng):
    camera = make_camera(noise=rp.noise.kinect_v1())
    made = fit(make_depth(camera, rng), camera)
    table, again = made.to_table(), made.to_table()
    for column in table.values():
        column[...] = column[-1]
    for name, column in made.to_table().items():
        np.testing.assert_array_equal(column, again[name])


@pytest.mark.parametrize(
    ("fit", "name", "change"),
    [
        (of_elements, "level", lambda of: of[1:]),
        (of_elements, "level", lambda of: of.astype(float)),
        (of_windows, "windows", lambda of: of + np.array([0, 0, 100, 0])),
        (of_windows, "windows", lambda of: of[1:]),
        (of_windows, "windows", lambda of: of.astype(float)),
        (of_windows, "valid_count", lambda of: of + np.int32(1000)),
        (of_labels, "labels", lambda of: of + np.int32(9)),
        (of_labels, "labels", lambda of: of - np.int32(1)),
        (of_labels, "labels", lambda of: of[1:]),
        (of_labels, "footprint", lambda of: of[1:]),
        (of_labels, "error_sums", lambda of: of[:, 1:]),
        (of_labels, "shared", lambda of: of.astype(np.float32)),
        (of_labels, "run_first", lambda of: of + 1),
        (of_labels, "run_first", lambda of: of[::-1].copy()),
        (of_labels, "run_first", lambda of: of[1:]),
        (of_labels, "run_first", lambda of: np.append(1, of[1:])),
        (of_labels, "run_first", lambda of: np.append(of[:-1], of[-1] + 1)),
        (of_labels, "run_first", lambda of: np.append([of[0], 10**9], of[2:])),
        (of_labels, "run_row", lambda of: of + np.int32(48)),
        (of_labels, "run_row", lambda of: np.where(of == of.min(), np.int32(-1), of)),
        (of_labels, "run_row", lambda of: np.where(of == of.max(), np.int32(48), of)),
        (of_labels, "run_start", lambda of: of - np.int32(64)),
        (of_labels, "run_stop", lambda of: of + np.int32(64)),
        (of_labels, "run_stop", lambda of: np.where(of == of.max(), np.int32(65), of)),
        (of_labels, "run_stop", lambda of: 0 * of),
        (of_labels, "run_share", lambda of: of[1:]),
        (of_unions, "labels", lambda of: of.astype(np.int64)),
        (of_unions, "labels", lambda of: of + np.int32(1)),
        (of_unions, "status", lambda of: of + np.uint8(4)),
        (of_unions, "footprint", None),
        (of_unions, "error_sums", None),
        (of_unions, "run_row", None),
    ],
)
def test_load_of_damaged_fits(fit, name, change, tmp_path, rng):
    noise = rp.noise.NoiseModel(correlation=((0.4, 3.0),), lateral=0.3)
    camera = make_camera(noise=noise)
    made = fit(make_depth(camera, rng), camera)
    made.save(tmp_path / "planes.npz")
    with np.load(tmp_path / "planes.npz") as file:
        arrays = dict(file)
    if change is None:
        del arrays[name]
    else:
        arrays[name] = change(arrays[name])
    np.savez(tmp_path / "planes.npz", **arrays)
    with pytest.raises(ValueError, match=rf"planes.npz: not a file that {type(made).__name__}.save wrote, or damaged"):
        type(made).load(tmp_path / "planes.npz")


def test_load_of_something_else(tiles, tmp_path):
    np.savez(tmp_path / "other.npz", a=np.ones(3))
    np.savez(tmp_path / "about.npz", about=np.array('{"camera": {}}'))
    np.save(tmp_path / "other.npy", np.ones(3))
    (tmp_path / "other.txt").write_text("nothing")
    tiles.save(tmp_path / "planes.npz")
    (tmp_path / "half.npz").write_bytes((tmp_path / "planes.npz").read_bytes()[:4000])
    with np.load(tmp_path / "planes.npz") as file:
        arrays = dict(file)
    np.savez(tmp_path / "rows.npz", **arrays | {"rmse": arrays["rmse"][1:]})
    np.savez(tmp_path / "text.npz", **arrays | {"alpha": arrays["alpha"].astype(str)})
    np.savez(tmp_path / "batch.npz", **arrays | {"status": arrays["status"][None]})
    np.savez(tmp_path / "status.npz", **arrays | {"status": arrays["status"] + np.uint8(4)})
    np.savez(tmp_path / "count.npz", **arrays | {"valid_count": arrays["valid_count"] + np.int32(11 * 13)})
    np.savez(tmp_path / "negative.npz", **arrays | {"valid_count": arrays["valid_count"] - np.int32(11 * 13 + 1)})
    changed = str(arrays["about"]).replace(tiles.method, "ransac")
    np.savez(tmp_path / "method.npz", **arrays | {"about": np.array(changed)})
    np.savez(tmp_path / "nan.npz", **arrays | {"planes": np.full_like(arrays["planes"], np.nan)})
    rough = arrays["status"] == rp.TileStatus.ROUGH
    assert rough.any()
    np.savez(tmp_path / "rough.npz", **arrays | {"alpha": np.where(rough[..., None], np.nan, arrays["alpha"])})
    np.savez(tmp_path / "behind.npz", **arrays | {"planes": -arrays["planes"]})
    huge = str(arrays["about"]).replace('"height": 48', '"height": 2147483647')
    np.savez(tmp_path / "huge.npz", **arrays | {"about": np.array(huge)})
    list_of_noise = str(arrays["about"]).replace('"fx"', '"noise": [1], "fx"')
    np.savez(tmp_path / "noise.npz", **arrays | {"about": np.array(list_of_noise)})
    names = ("other.npz", "about.npz", "other.npy", "other.txt", "half.npz")
    names += ("rows.npz", "text.npz", "batch.npz", "status.npz", "count.npz", "negative.npz", "method.npz")
    names += ("nan.npz", "rough.npz", "behind.npz", "huge.npz", "noise.npz")
    for name in names:
        with pytest.raises(ValueError, match=rf"{name}: not a file that TilePlanes.save wrote"):
            rp.TilePlanes.load(tmp_path / name)
    with pytest.raises(ValueError, match=r"or damaged \(planes of another grid\)$"):  # no memory is asked for
        rp.TilePlanes.load(tmp_path / "huge.npz")
    for name in ("other.npy", "other.txt"):
        with pytest.raises(ValueError, match=r"wrote, or damaged \(not an NPZ file\)$"):
            rp.TilePlanes.load(tmp_path / name)


class Touches:
    """What makes a file where it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return type(self.path).touch, (self.path,)


def test_a_file_to_be_loaded_runs_no_code(tiles, tmp_path):
    tiles.save(tmp_path / "planes.npz")
    with np.load(tmp_path / "planes.npz") as file:
        arrays = dict(file)
    for name in ("rmse", "about", "other"):
        np.savez(tmp_path / "planes.npz", **arrays | {name: np.array([Touches(tmp_path / "touched")], object)})
        if name == "other":  # an array that no field needs is not even read
            np.testing.assert_array_equal(rp.TilePlanes.load(tmp_path / "planes.npz").rmse, tiles.rmse)
        else:
            with pytest.raises(ValueError, match=r"not a file that TilePlanes\.save wrote"):
                rp.TilePlanes.load(tmp_path / "planes.npz")
        assert not (tmp_path / "touched").exists()


def test_load_of_arrays_in_another_order(tiles, tmp_path):
    tiles.save(tmp_path / "planes.npz")
    with np.load(tmp_path / "planes.npz") as file:
        turned = {name: np.asfortranarray(file[name]) for name in file.files if name != "about"}
        np.savez(tmp_path / "other.npz", about=file["about"], **turned)
    loaded = rp.TilePlanes.load(tmp_path / "other.npz")
    assert all(getattr(loaded, name).flags.c_contiguous for name in ("_moments", "planes", "status"))


def test_a_save_that_fails_leaves_the_old_file(tiles, tmp_path, monkeypatch):
    tiles.save(tmp_path / "planes.npz")
    before = (tmp_path / "planes.npz").read_bytes()

    def fail(file, **arrays):
        file.write(before[:1000])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", fail)
    with pytest.raises(OSError, match="No space left"):
        tiles.save(tmp_path / "planes.npz")
    assert (tmp_path / "planes.npz").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["planes.npz"]


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda tiles: pickle.loads(pickle.dumps(tiles))])
def test_a_copy_is_a_result_like_any_other(copied, rng):
    """Also to fit into, statistics included."""
    camera = make_camera(noise=rp.noise.kinect_v1())
    first, second = make_depth(camera, rng), make_depth(camera, rng)
    tiles = rp.fit_tiles(first, camera)
    before = tiles.p_value.copy()
    made = copied(tiles)
    np.testing.assert_array_equal(made.p_value, before)
    assert not made.p_value.flags.writeable
    fitter = rp.TileFitter(made.camera)
    assert fitter.fit(second, out=made) is made
    np.testing.assert_array_equal(made.p_value, fitter.fit(second).p_value)


def test_save_to_nowhere_leaves_nothing(tiles, tmp_path):
    with pytest.raises(OSError, match="nowhere"):
        tiles.save(tmp_path / "nowhere" / "planes.npz")
    assert list(tmp_path.iterdir()) == []


def test_table_has_one_row_a_tile(tiles):
    table = tiles.to_table()
    assert {len(column) for column in table.values()} == {25}
    i = 13
    row, column = table["row"][i], table["column"][i]
    assert (row, column) == (2, 3)
    assert (table["top"][i], table["left"][i]) == (22, 39)
    assert table["height"][-1] == 48 - 44
    assert table["width"][-1] == 64 - 52
    np.testing.assert_array_equal(table["d"], tiles.planes[..., 3].ravel())
    assert table["status"][i] == rp.TileStatus(tiles.status[row, column]).name
    np.testing.assert_array_equal(tiles.tile_heights, [11, 11, 11, 11, 4])


def test_tables_of_other_parts_say_which(rng):
    camera = make_camera()
    depth = make_depth(camera, rng)
    tiles = rp.fit_tiles(depth, camera, 16)
    windows = rp.fit_windows(depth, camera, [(1, 2, 20, 30), (5, 6, 7, 8)])
    labels = rp.fit_labels(depth, camera, np.indices(depth.shape)[1] // 30)
    union = rp.merge(tiles, np.indices(tiles.shape)[1])
    assert list(windows.to_table())[:5] == ["top", "left", "height", "width", "status"]
    np.testing.assert_array_equal(
        [windows.to_table()[name][1] for name in ("top", "left", "height", "width")], [5, 6, 7, 8]
    )
    for fits in (labels, union):
        table = fits.to_table()
        assert list(table)[:2] == ["label", "status"]
        np.testing.assert_array_equal(table["label"], np.arange(len(fits.status)) + 1)
        np.testing.assert_array_equal(np.stack([table[name] for name in ("nx", "ny", "nz", "d")], axis=1), fits.planes)


def test_tables_have_uncertainties_if_the_noise_is_known(rng):
    camera = make_camera()
    frames = [make_depth(camera, rng) for _ in range(2)]
    uncertain = ["p_value", "angle_std", "offset_std"]
    assert not set(uncertain) & set(rp.fit_tiles(frames[0], camera).to_table())
    stack = rp.TileFitter(replace(camera, noise=rp.noise.kinect_v1()), 16).fit_batch(frames)
    table = stack.to_table()
    assert list(table)[-3:] == uncertain
    for name in uncertain:
        np.testing.assert_array_equal(table[name], getattr(stack, name).ravel())


def test_batch_is_indexed_by_frame(rng):
    camera = make_camera()
    frames = [make_depth(camera, rng) for _ in range(3)]
    stack = rp.TileFitter(camera, 16).fit_batch(frames)
    assert len(stack) == 3
    assert repr(stack).startswith("<TilePlanes: 3 frames of 3 x 4 tiles")
    assert list(stack.to_table()["frame"]) == [0] * 12 + [1] * 12 + [2] * 12
    np.testing.assert_array_equal(stack[-1].planes, stack.planes[2])
    assert isinstance(stack, Iterable)
    assert all(np.array_equal(one.planes, own) for one, own in zip(stack, stack.planes, strict=True))
    assert repr(stack[:1]).startswith("<TilePlanes: 1 frame of 3 x 4 tiles")
    for beyond in (3, -4, 2**63, np.int64(3)):
        with pytest.raises(IndexError, match=f"^expected the number of one of 3 frames, got {beyond}$"):
            stack[beyond]
    with pytest.raises(TypeError, match=r"batch of frames can be indexed, by a frame; .* such as \.planes"):
        stack[0][0, 0]
    for which, kind in (
        ([0, 1], "list"),
        (np.array([True]), "ndarray"),
        (None, "NoneType"),
        (1.0, "float"),
        ((0, 0), "tuple"),
    ):
        with pytest.raises(TypeError, match=rf"the number of a frame .*, or a slice, got {kind}; .* such as \.planes"):
            stack[which]
    with pytest.raises(TypeError, match="got bool"):
        stack[True]
    np.testing.assert_array_equal(stack[np.int64(1)].planes, stack.planes[1])
    assert all([stack[0], stack])  # a result is not nothing, whatever its length
    with pytest.raises(TypeError, match="batch"):
        stack[0][0]
    with pytest.raises(TypeError, match="no length"):
        len(stack[0])


def test_table_is_a_data_frame(tiles):
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    assert len(pandas.DataFrame(tiles.to_table())) == 25
