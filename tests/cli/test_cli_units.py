"""The command line: presets by name, units, masks, bytes."""

import numpy as np
import pytest

import rgbd_planes as rp
from rgbd_planes.cli import main as cli
from rgbd_planes.sequences import images

CAMERA = rp.Camera(64, 48, 52.0, 52.0, 31.5, 23.5, depth_scale=1000.0)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "frames").mkdir()
    return tmp_path


def depth_of(camera):
    return rp.scenes.room().render(camera).measure(seed=1)


@pytest.mark.filterwarnings("default")
def test_presets_by_name(folder, capsys):
    images.write_png("depth.png", depth_of(rp.presets.kinect_v1()))
    assert cli.main(["fit", "depth.png", "--camera", "kinect_v1"]) == 0
    assert "1200 tiles" in capsys.readouterr().out
    assert cli.main(["fit", "depth.png", "--camera", "kinekt"]) == 2
    assert "no such file, and no preset; presets are primesense, kinect_v1, " in capsys.readouterr().err


@pytest.mark.filterwarnings("default")
def test_units_and_bytes(folder, capsys):
    depth = depth_of(CAMERA)
    CAMERA.save("camera.json")
    np.save("mm.npy", depth.astype(np.float32))
    images.write_png("swapped.png", depth.byteswap())
    images.write_png("plain.png", depth)
    said = []
    for options in (["mm.npy", "--float-scale", "1000"], ["swapped.png", "--swap-bytes"], ["plain.png"]):
        assert cli.main(["fit", options[0], "--camera", "camera.json", *options[1:], "--tile", "8"]) == 0
        out = capsys.readouterr()
        assert "warning" not in out.err
        said.append(out.out)
    assert said[0] == said[1] == said[2]


@pytest.mark.filterwarnings("default")
def test_a_batch_in_other_units_ends_with_an_error(folder, capsys):
    pytest.importorskip("pyarrow")
    CAMERA.save("frames/camera.json")
    for i in range(2):
        np.save(f"frames/{i}.npy", depth_of(CAMERA).astype(np.float32))
    assert cli.main(["batch", "frames", "--out", "a"]) == 2
    err = capsys.readouterr().err
    assert "most of this frame is beyond 50 m: millimetres?" in err
    assert "--float-scale" in err
    assert not (folder / "a").exists()
    assert cli.main(["batch", "frames", "--out", "a", "--float-scale", "1000"]) == 0
    assert cli.main(["batch", "frames", "--out", "b", "--despite-warnings"]) == 0


@pytest.mark.filterwarnings("default")
def test_masks(folder, capsys):
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    CAMERA.save("frames/camera.json")
    (folder / "confidence").mkdir()
    sure = np.full(CAMERA.shape, 2, np.uint8)
    sure[:, :32] = 1
    for i in range(2):
        images.write_png(f"frames/{i}.png", depth_of(CAMERA))
        images.write_png(f"confidence/{i}.png", sure)
    options = ["--mask", "confidence", "--mask-threshold", "2", "--tile", "16"]
    assert cli.main(["batch", "frames", "--out", "a", *options]) == 0
    table = pandas.read_parquet("a")
    assert (table.valid_count[table.column < 2] == 0).all()
    assert (table.valid_count[table.column >= 2] > 0).all()
