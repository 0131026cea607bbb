"""A batch of segments has rows for what is round, too."""

import numpy as np
import pytest

import rgbd_planes as rp
from rgbd_planes import Primitive, TileStatus, scenes
from rgbd_planes.cli import main as cli
from rgbd_planes.sequences import images

parquet = pytest.importorskip("pyarrow.parquet")
CAMERA = rp.Camera(320, 240, 262.0, 262.0, 159.5, 119.5, depth_scale=5000.0, noise=rp.noise.NoiseModel((1e-3,)))


@pytest.fixture
def recording(tmp_path):
    """Three frames: a ball and a pipe, nothing round, nothing at all."""
    root = tmp_path / "recording"
    (root / "depth").mkdir(parents=True)
    CAMERA.save(root / "camera.json")
    wall = scenes.polygon("wall", [(-9, -9, 2), (9, -9, 2), (9, 9, 2), (-9, 9, 2)])
    things = (
        scenes.ellipsoid("ball", (-0.3, 0.0, 1.3), (0.15,) * 3),
        *scenes.cylinder("pipe", (0.3, 0.0, 1.3), 0.1, 0.5),
    )
    for i, surfaces in enumerate([(wall, *things), (wall,)]):
        depth = scenes.Scene(surfaces, np.eye(4)).render(CAMERA).measure(noise=1e-3, seed=i)
        images.write_png(root / "depth" / f"{i}.png", depth)
    images.write_png(root / "depth" / "2.png", np.zeros(CAMERA.shape, np.uint16))
    return root


@pytest.mark.parametrize("from_python", [True, False])
def test_what_is_round_has_rows_after_the_planes(recording, tmp_path, from_python):
    pytest.importorskip("pandas")
    sequence = rp.open_sequence(recording)
    if from_python:
        rp.fit_sequence(sequence, tmp_path / "out", rp.FitSettings(segments=True, primitives=True), num_threads=1)
    else:
        assert cli.main(["batch", str(recording), "--out", str(tmp_path / "out"), "--segments", "--primitives"]) == 0
    table = parquet.read_table(tmp_path / "out").to_pandas().sort_values("frame", kind="stable")
    for i in range(3):
        rows = table[table.frame == i]
        found = rp.segment(sequence[i].depth, CAMERA)
        fits = rp.fit_primitives(sequence[i].depth, CAMERA, found.curved_labels)
        assert len(rows) == len(found) + len(fits)
        planes, curved = rows[: len(found)], rows[len(found) :]
        assert list(planes.label) == list(range(1, len(found) + 1))
        assert list(curved.label) == list(range(1, len(fits) + 1))
        assert set(planes.kind) <= {"PLANE"}
        assert list(curved.kind) == [Primitive(kind).name for kind in fits.kind]
        assert list(curved.status) == [TileStatus(status).name for status in fits.status]
        np.testing.assert_array_equal(planes[["nx", "ny", "nz", "d"]], found.planes.astype(np.float32))
        np.testing.assert_array_equal(planes.cov_d_d, found.plane_covariance[:, 3, 3].astype(np.float32))
        assert planes[["radius", "centre_x", "axis_z"]].isna().all(axis=None)
        assert curved[["nx", "cov_d_d"]].isna().all(axis=None)
        for name in ("radius", "radius_std", "rmse", "rmse_metric", "valid_count"):
            np.testing.assert_array_equal(curved[name], getattr(fits, name).astype(curved[name].dtype))
        np.testing.assert_array_equal(curved[["centre_x", "centre_y", "centre_z"]], fits.centre.astype(np.float32))
        np.testing.assert_array_equal(curved[["axis_x", "axis_y", "axis_z"]], fits.axis.astype(np.float32))
        for row in curved.itertuples():
            y, x = np.nonzero(found.curved_labels == row.label)
            assert (row.top, row.left, row.height, row.width) == (y.min(), x.min(), np.ptp(y) + 1, np.ptp(x) + 1)
    assert sorted(table.kind[table.frame == 0])[-1] == "SPHERE"
    assert (table.kind == "CYLINDER").sum() == 1


def test_tiles_have_no_such_rows(recording, tmp_path):
    sequence = rp.open_sequence(recording)
    with pytest.raises(ValueError, match="tiles take no options of segments, got primitives"):
        rp.fit_sequence(sequence, tmp_path / "out", rp.FitSettings(primitives=True))
    rp.fit_sequence(sequence, tmp_path / "planes", rp.FitSettings(segments=True))
    assert not {"kind", "radius"} & set(parquet.read_table(tmp_path / "planes").column_names)
