"""Files that an earlier version wrote, in `saved`, each from a frame of 64 x 48 pixels.

The version wrote them before results had their present places and names. Whatever these are, the files must load, and
be written again as they are.
"""

import json
from pathlib import Path

import numpy as np
import pytest

import rgbd_planes as rp

FOLDER = Path(__file__).parent / "saved"
KINDS = {
    "tiles": (rp.TilePlanes, (3, 4)),
    "batch": (rp.TilePlanes, (2, 3, 4)),
    "windows": (rp.WindowPlanes, (2,)),
    "labels": (rp.LabelPlanes, (2,)),
    "unions": (rp.MergedPlanes, (3,)),
}


def content(path):
    with np.load(path) as file:
        arrays = dict(file)
    return json.loads(str(arrays.pop("about"))), arrays


@pytest.mark.parametrize("name", [*KINDS, "segments"])
def test_files_of_an_earlier_version_load_and_are_written_again_as_they_are(name, tmp_path):
    kind = rp.Segmentation if name == "segments" else KINDS[name][0]
    loaded = kind.load(FOLDER / f"{name}.npz")
    loaded.save(tmp_path / "again.npz")
    about, arrays = content(FOLDER / f"{name}.npz")
    again, arrays_again = content(tmp_path / "again.npz")
    assert again == about
    if name == "segments":  # which had no evidence and no curved surfaces then: they are not known
        assert np.isnan(arrays_again.pop("evidence")).all()
        assert not arrays_again.pop("curved_labels").any()
    assert sorted(arrays_again) == sorted(arrays)
    for key, array in arrays.items():
        np.testing.assert_array_equal(arrays_again[key], array)
        assert arrays_again[key].dtype == array.dtype


@pytest.mark.parametrize(("name", "kind", "shape"), [(name, *kind) for name, kind in KINDS.items()])
def test_a_loaded_file_is_a_fit_like_any_other(name, kind, shape):
    fits = kind.load(FOLDER / f"{name}.npz")
    assert fits.shape == shape
    assert fits.fitted.any()
    if fits.camera.noise is not None:
        assert np.isfinite(fits.plane_covariance[fits.fitted]).all()
    np.testing.assert_allclose(np.linalg.norm(fits.planes[fits.fitted][:, :3], axis=1), 1.0)


def test_a_loaded_segmentation_labels_the_frame():
    found = rp.Segmentation.load(FOLDER / "segments.npz")
    assert found.labels.shape == (48, 64)
    assert len(found) == found.labels.max() >= 2


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("row", [4, 7, 9])
def test_sums_of_squares_are_not_negative(name, row, tmp_path):
    """Or covariances would have negative variances."""
    with np.load(FOLDER / f"{name}.npz") as file:
        arrays = dict(file)
    cells = min(len(KINDS[name][1]), 2)
    arrays["moments"][(..., row, *[slice(None)] * cells)] *= -1.0
    np.savez(tmp_path / "altered.npz", **arrays)
    with pytest.raises(ValueError, match="negative variances"):
        KINDS[name][0].load(tmp_path / "altered.npz")


@pytest.mark.parametrize("name", ["error_sums", "shared"])
def test_variances_of_labels_are_not_negative(name, tmp_path):
    rng = np.random.default_rng(0)
    camera = rp.Camera(64, 48, 60.0, 60.0, 31.5, 23.5, noise=rp.noise.NoiseModel((1e-3,), correlation=((0.5, 2.0),)))
    labels = np.ones(camera.shape, np.int32)
    fits = rp.fit_labels(2.0 + 0.002 * rng.normal(size=camera.shape), camera, labels)
    fits.save(tmp_path / "labels.npz")
    with np.load(tmp_path / "labels.npz") as file:
        arrays = dict(file)
    arrays[name][:, 0] *= -1.0
    np.savez(tmp_path / "labels.npz", **arrays)
    with pytest.raises(ValueError, match="negative variances"):
        rp.LabelPlanes.load(tmp_path / "labels.npz")


def test_sums_of_curved_tiles_are_not_negative(tmp_path):
    camera = rp.Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
    rp.fit_surfaces(np.full(camera.shape, 2.0), camera, 16).save(tmp_path / "bent.npz")
    rp.TileSurfaces.load(tmp_path / "bent.npz")
    with np.load(tmp_path / "bent.npz") as file:
        arrays = dict(file)
    arrays["moments"][3] *= -1.0
    np.savez(tmp_path / "bent.npz", **arrays)
    with pytest.raises(ValueError, match="negative variances"):
        rp.TileSurfaces.load(tmp_path / "bent.npz")
