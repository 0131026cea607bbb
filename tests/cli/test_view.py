"""``rgbd-planes view``: what it writes, and what a browser shows of it."""

import io
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from PIL import Image
from recordings import columns_of

import rgbd_planes as rp
from bench import browser
from rgbd_planes.cli import main as cli
from rgbd_planes.plotting.colours import label_colours
from rgbd_planes.sequences import images

pytest.importorskip("rerun")
pytest.importorskip("shapely")

CAMERA = rp.Camera(160, 120, 131.0, 131.0, 79.5, 59.5, depth_scale=1000.0)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder to work in: three frames in ``frames``, of which one is no image, with their poses."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "frames").mkdir()
    CAMERA.save("frames/camera.json")
    for i in range(3):
        room = rp.scenes.room((0.35, -1.5, -0.2 + 0.1 * i))
        images.write_png(f"frames/{i}.png", room.render(CAMERA).measure(holes=0.03, seed=i))
    return tmp_path


def test_view_writes_what_the_viewer_shows(folder, capsys):
    (folder / "frames/1.png").write_bytes(b"no image")
    assert cli.main(["view", "frames", "--out", "planes.rrd", "--min-size", "200"]) == 1
    out, err = capsys.readouterr()
    assert err == "rgbd-planes view: skipped frame 1, 1.png: not a PNG image, or damaged\n"
    assert "2 frames, " in out
    columns = columns_of("planes.rrd")
    assert columns["/camera/depth", "frame"] == [0, 1]
    for number, name in enumerate("02"):
        depth = images.read_depth(f"frames/{name}.png")
        found = rp.segment(depth, CAMERA, min_size=200)
        assert columns["/found", "Scalars:scalars"][number] == [len(found)]
        points = np.array(columns["/points", "Points3D:positions"][number])
        measured = CAMERA.points(depth)[depth > 0]
        np.testing.assert_allclose(points, measured, rtol=1e-6)
    assert len(columns["/camera/curvature", "EncodedImage:blob"]) == 2
    (path,) = columns["/path", "LineStrips3D:strips"][1]  # estimated: the data set has no poses
    length = np.linalg.norm(np.subtract(path[1], path[0]))
    assert "path is estimated" in out
    assert abs(length - 0.2) < 0.02


def test_view_moves_the_camera_where_the_data_set_has_poses(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    poses = [np.eye(4) for _ in range(2)]
    poses[0][:3, 3] = 1.0, 2.0, 3.0
    poses[1][:3] = [[0.0, 0.0, 1.0, 1.5], [0.0, 1.0, 0.0, 2.0], [-1.0, 0.0, 0.0, 3.0]]
    for i, pose in enumerate(poses):
        depth = rp.scenes.room().render(CAMERA).measure(seed=i)
        images.write_png(f"frame-{i:06}.depth.png", depth)
        np.savetxt(f"frame-{i:06}.pose.txt", pose)
    CAMERA.save("camera.json")
    assert cli.main(["view", ".", "--camera", "camera.json", "--out", "../planes.rrd"]) == 0
    columns = columns_of("../planes.rrd")
    np.testing.assert_allclose(columns["/path", "LineStrips3D:strips"][1], [[[0.0] * 3, [0.5, 0.0, 0.0]]], atol=1e-6)
    for entity in ("/camera", "/points", "/planes"):
        turn = np.reshape(columns[entity, "Transform3D:mat3x3"][1], (3, 3)).T
        np.testing.assert_allclose(turn, poses[1][:3, :3], atol=1e-6)


def test_view_says_what_is_wrong(folder, capsys):
    for options, message in (
        (["frames/0.png"], "a depth image needs --camera"),
        (["frames", "--count", "0"], "--count must be at least 1, got 0"),
        (["frames", "--out", "planes.png"], "expected a name that ends in .rrd"),
        (["none"], "none"),
        (["frames/0.png", "--camera", "frames/camera.json", "--topic", "/depth"], "--topic is for a data set"),
    ):
        assert cli.main(["view", *options]) == 2
        out, err = capsys.readouterr()
        assert (out, err.count("\n")) == ("", 1)
        assert message in err
    for path in (folder / "frames").glob("*.png"):
        path.write_bytes(b"")
    assert cli.main(["view", "frames", "--out", "planes.rrd"]) == 2
    assert "expected a frame that can be read, got none: 3 frames, 0 to 2: " in capsys.readouterr().err
    assert not (folder / "planes.rrd").exists()


@pytest.mark.skipif(browser.find() is None, reason="there is no Chromium here to open the page")
def test_a_browser_shows_the_planes(folder, tmp_path_factory):
    command = [sys.executable, "-m", "rgbd_planes", "view", "frames", "--no-browser", "--min-size", "500"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            url = process.stdout.readline().split()[-1]
            assert "3 frames" in process.stdout.readline()
            profile = tmp_path_factory.mktemp("profile")
            with browser.Browser(profile) as page:
                page.open(url, 5.0)
                end = time.monotonic() + 120.0
                while (shown := colours_shown(page.screenshot())) < 5 and time.monotonic() < end:
                    page.wait(2.0)
            assert shown >= 5, f"expected planes in at least 5 colours, found {shown}"
        finally:
            process.send_signal(signal.SIGINT)
        assert process.wait(60.0) == 0


def colours_shown(picture):
    """How many of the first planes' colours the picture has in 200 pixels or more."""
    pixels = np.asarray(Image.open(io.BytesIO(picture)).convert("RGB")).reshape(-1, 3).astype(int)
    colours = np.rint(255.0 * label_colours(12)).astype(int)
    return sum(np.count_nonzero(np.abs(pixels - colour).max(axis=1) <= 3) >= 200 for colour in colours)
