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
