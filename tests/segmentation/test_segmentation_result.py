"""What a segmentation shows, saves and turns into."""

import json
from dataclasses import replace

import numpy as np
import pytest

import rgbd_planes as rp
from rgbd_planes.evaluation import scenes

CAMERA = rp.Camera(160, 120, 131.25, 131.25, 79.5, 59.5, distortion=(0.1, -0.05, 0.001, 0.0, 0.0), depth_scale=1000.0)


@pytest.fixture(scope="module")
def frame():
    return scenes.room().render(CAMERA).measure(holes=0.05, seed=3)


@pytest.fixture(scope="module")
def found(frame):
    return rp.segment(frame, CAMERA)


def test_standard_deviations_are_those_of_a_fit_with_this_covariance(found):
    n, d = found.planes[:, :3], found.planes[:, 3]
    rng = np.random.default_rng(5)
    for i, (alpha, covariance) in enumerate(zip(found.alpha, found.alpha_covariance, strict=True)):
        other = rng.multivariate_normal(alpha, covariance, 4000)
        sine = np.linalg.norm(np.cross(n[i], other), axis=1) * d[i]
        assert found.angle_std[i] == pytest.approx(np.degrees(np.sqrt(np.mean(sine**2))), rel=0.06)
        offsets = 1.0 / np.linalg.norm(other, axis=1)
        assert found.offset_std[i] == pytest.approx(offsets.std(), rel=0.06)


def test_table_has_one_row_a_plane(found):
    table = found.to_table()
    assert {len(column) for column in table.values()} == {len(found)}
    assert [np.count_nonzero(found.labels == label) for label in table["label"]] == list(table["size"])
    np.testing.assert_array_equal(np.stack([table[name] for name in ("nx", "ny", "nz", "d")], 1), found.planes)
    np.testing.assert_array_equal(table["offset_std"], found.offset_std)


def test_planes_of_which_a_part_is_kept_or_nothing(found, frame):
    kept = np.arange(CAMERA.height)[:, None] < 40
    cut = replace(found, labels=np.where(kept, found.labels, 0).astype(np.int32))
    depth = np.where(cut.labels > 0, found.fitted_depth(), np.nan)
    gone = [label for label in range(1, len(found) + 1) if not (cut.labels == label).any()]
    assert gone
    for label in range(1, len(found) + 1):
        if label in gone:
            assert np.isnan(cut.mean_depth[label - 1])
        else:
            harmonic = 1.0 / np.mean(1.0 / depth[cut.labels == label])
            assert cut.mean_depth[label - 1] == pytest.approx(harmonic)
    numbers = {text.get_text() for text in cut.plot(frame).axes[0].texts}
    assert numbers
    assert not numbers & set(map(str, gone))


@pytest.mark.parametrize("empty", [False, True])
def test_save_and_load(found, empty, tmp_path):
    if empty:
        found = rp.segment(np.zeros(CAMERA.shape, np.uint16), CAMERA)
        assert len(found) == 0
    found.save(tmp_path / "planes.npz")
    loaded = rp.Segmentation.load(tmp_path / "planes.npz")
    assert (loaded.camera, loaded.sigma, repr(loaded)) == (found.camera, found.sigma, repr(found))
    for name in ("labels", "planes", "alpha", "alpha_covariance", "sizes", "rmse", "reason"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(found, name))
        assert getattr(loaded, name).dtype == getattr(found, name).dtype
    assert [path.name for path in tmp_path.iterdir()] == ["planes.npz"]


def test_load_of_something_else(found, frame, tmp_path):
    found.save(tmp_path / "planes.npz")
    (tmp_path / "half.npz").write_bytes((tmp_path / "planes.npz").read_bytes()[:4000])
    with np.load(tmp_path / "planes.npz") as file:
        arrays = dict(file)
    np.savez(tmp_path / "fewer.npz", **arrays | {"planes": arrays["planes"][1:]})
    np.savez(tmp_path / "wide.npz", **arrays | {"labels": arrays["labels"].astype(np.int64)})
    np.savez(tmp_path / "larger.npz", **arrays | {"labels": arrays["labels"] + np.int32(1)})
    np.savez(tmp_path / "nan.npz", **arrays | {"alpha": np.full_like(arrays["alpha"], np.nan)})
    np.savez(tmp_path / "long.npz", **arrays | {"planes": 1e300 * arrays["planes"]})
    for name in ("half.npz", "fewer.npz", "wide.npz", "larger.npz", "nan.npz", "long.npz"):
        with pytest.raises(ValueError, match=rf"{name}: not a file that Segmentation.save wrote"):
            rp.Segmentation.load(tmp_path / name)
    with pytest.raises(FileNotFoundError):
        rp.Segmentation.load(tmp_path / "none.npz")
    huge = with_about(
        tmp_path / "planes.npz", tmp_path / "huge.npz", lambda about: about["camera"].update(height=2**31 - 1)
    )
    with pytest.raises(ValueError, match=r"or damaged \(labels of another image size\)$"):  # no memory is asked for
        rp.Segmentation.load(huge)


def with_about(path, to, change):
    """The file of a result with something else about it."""
    with np.load(path) as file:
        arrays = dict(file)
    about = json.loads(str(arrays["about"]))
    change(about)
    np.savez(to, **arrays | {"about": np.array(json.dumps(about))})
    return to


@pytest.mark.parametrize("named", [True, False])
def test_load_of_a_result_of_another_kind(found, frame, named, tmp_path):
    """Files of earlier versions do not name it."""
    tiles, other = rp.fit_tiles(frame, CAMERA), tmp_path / "other.npz"
    for saved, wrong in ((found, rp.TilePlanes), (tiles, rp.Segmentation)):
        right = type(saved)
        saved.save(tmp_path / "planes.npz")
        if not named:
            with_about(tmp_path / "planes.npz", tmp_path / "planes.npz", lambda about: about.pop("class"))
        message = rf"planes\.npz: expected .* {wrong.__name__}\.save wrote, .* rp\.{right.__name__}\.load reads it$"
        with pytest.raises(ValueError, match=message):
            wrong.load(tmp_path / "planes.npz")
        assert type(right.load(tmp_path / "planes.npz")) is right
        with_about(tmp_path / "planes.npz", other, lambda about: about.update({"class": "Volumes"}))
        with pytest.raises(ValueError, match=r"got one that holds Volumes: a newer version reads it$"):
            right.load(other)


def test_load_of_a_camera_of_a_newer_version(found, tmp_path):
    noisy = replace(found, camera=replace(CAMERA, noise=rp.noise.kinect_v1()))
    noisy.save(tmp_path / "planes.npz")
    for change in (
        lambda about: about["camera"].update(shutter="rolling"),
        lambda about: about["camera"]["noise"].update(shutter=1.0),
    ):
        with_about(tmp_path / "planes.npz", tmp_path / "newer.npz", change)
        with pytest.raises(ValueError, match=r"newer\.npz: .* got one of a newer version: it has shutter, too$"):
            rp.Segmentation.load(tmp_path / "newer.npz")


def test_a_result_of_a_class_of_one_s_own_is_saved_as_the_library_s(found, tmp_path):
    own = type("Own", (rp.Segmentation,), {})
    own(**vars(found)).save(tmp_path / "planes.npz")
    assert len(rp.Segmentation.load(tmp_path / "planes.npz")) == len(found)


def test_tile_labels(frame, found):
    tiles = found.tile_labels((8, 12))
    assert tiles.shape == rp.fit_tiles(frame, found.camera, tile=(8, 12)).status.shape
    for row, column in np.ndindex(tiles.shape):
        tile = np.s_[8 * row : 8 * row + 8, 12 * column : 12 * column + 12]
        own = np.unique(found.labels[tile][found.reason[tile] != rp.Reason.MISSING])
        assert tiles[row, column] == (own[0] if len(own) == 1 else 0)
    assert (tiles > 0).mean() > 0.3
    assert np.array_equal(found.tile_labels(9), found.tile_labels((9, 9)))


def test_labels_for_others(found):
    assert found.labels_from_minus_one().min() >= -1
    assert (found.labels_from_minus_one() + 1 == found.labels).all()
    opencv = found.labels_for_opencv()
    assert opencv.dtype == np.uint8
    assert ((opencv == 255) == (found.labels == 0)).all()
    assert (opencv[found.labels > 0] == found.labels[found.labels > 0] - 1).all()
    replace(found, planes=np.ones((255, 4))).labels_for_opencv()
    with pytest.raises(ValueError, match="at most 255 planes"):
        replace(found, planes=np.ones((256, 4))).labels_for_opencv()  # the last one's would be 255, too
