"""The command line: what it prints and writes, and one line on stderr for whatever goes wrong."""

import argparse
import importlib
import json
import os
import re
import shlex
import subprocess
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import rgbd_planes as rp
from rgbd_planes import export
from rgbd_planes._core.text import percent
from rgbd_planes.cli import COMMANDS
from rgbd_planes.cli import main as cli
from rgbd_planes.evaluation import scenes
from rgbd_planes.fitting.methods import METHODS
from rgbd_planes.sequences import images

CAMERA = rp.Camera(width=80, height=60, fx=65.0, fy=65.0, cx=39.5, cy=29.5, depth_scale=1000.0)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder to work in with a depth frame and its camera."""
    monkeypatch.chdir(tmp_path)
    images.write_png("depth.png", scenes.room().render(CAMERA).measure(holes=0.05, seed=1))
    CAMERA.save("camera.json")
    return tmp_path


def fails(capsys, *arguments):
    """Run a command that must fail, and return its one line on stderr."""
    try:
        status = cli.main([str(argument) for argument in arguments])
    except SystemExit as exit_:  # from argparse
        status = exit_.code
    out, err = capsys.readouterr()
    assert status == 2
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("rgbd-planes")
    assert "Traceback" not in err
    return err


def test_demo_writes_a_picture_and_says_what_it_found(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["demo", "--out", "here/and/there", "--tile", "20", "--seed", "4"]) == 0
    out = capsys.readouterr().out
    assert sorted(os.listdir("here/and/there")) == ["demo.png", "demo_camera.json", "demo_depth.png"]
    with Image.open("here/and/there/demo.png") as picture:
        assert picture.width > 1000
        assert np.ptp(np.asarray(picture.convert("L"))) > 200

    depth = images.read_depth("here/and/there/demo_depth.png")
    camera = rp.Camera.load("here/and/there/demo_camera.json")
    tiles = rp.fit_tiles(depth, camera, tile=20)
    assert (tiles.status == rp.TileStatus.ROUGH).sum() > 100
    assert f"768 tiles of 20 x 20 pixels by range_explicit: {(tiles.status == 0).sum()} OK" in out
    assert re.search(r"One fit takes [\d.]+ ms", out)
    # The printed accuracy, again from the files.
    rendering = scenes.room().render(camera)
    assert np.array_equal(depth, rendering.measure(holes=0.05, patches=0.03, baseline=0.075, seed=4))
    labels = np.where(tiles.fitted, rendering.tile_labels((20, 20)), 0)
    truth = rendering.planes[labels[labels > 0] - 1]
    cosines = (tiles.planes[labels > 0][:, :3] * truth[:, :3]).sum(axis=1)
    angle = np.median(np.degrees(np.arccos(cosines)))
    x, y = np.meshgrid(np.arange(10, 640, 20), np.arange(10, 480, 20))
    ray = np.stack([(x - 319.5) / 525, (y - 239.5) / 525, np.ones(x.shape)], -1)[labels > 0]
    true, found = (-planes[:, 3] / (planes[:, :3] * ray).sum(axis=1) for planes in (truth, tiles.planes[labels > 0]))
    cosine = np.abs((tiles.planes[labels > 0][:, :3] * ray).sum(axis=1))
    off = np.median(np.abs(true - found) * cosine) * 1000  # from the point on the surface along the plane's normal
    count, *printed = re.search(r"^  all\s+(\d+)\s+([\d.]+)°\s+([\d.]+) mm", out, re.M).groups()
    printed_angle, printed_off = map(float, printed)
    assert int(count) == (labels > 0).sum()
    assert printed_angle == pytest.approx(angle, abs=0.006)
    assert printed_off == pytest.approx(off, abs=0.006)
    assert angle < 1.5  # degrees: the paper's noise on 20 x 20 tiles, 2 to 4 m away
    assert re.search(r"floor\s+\d+", out)

    # The line that it offers works as it stands.
    command = re.search(r"^  rgbd-planes (fit .*)$", out, re.MULTILINE)[1]
    assert cli.main(command.split()) == 0
    with Image.open("planes.png") as again, Image.open("here/and/there/demo.png") as picture:
        assert np.array_equal(np.asarray(again), np.asarray(picture))


def test_demo_compares_tiles_that_end_before_their_middle_with_the_truth(tmp_path, capsys):
    # 480 x 640 in tiles of 25 leaves a last row of 5 pixels, and in tiles of 12 a last column of 4.
    for tile, columns, rows in ((25, 26, 20), (12, 54, 40)):
        assert cli.main(["demo", "--out", str(tmp_path), "--tile", str(tile)]) == 0
        out = capsys.readouterr().out
        assert f"{rows * columns} tiles" in out
        assert float(re.search(r"^  all\s+\d+\s+[\d.]+°\s+([\d.]+) mm", out, re.M)[1]) < 1.0


def test_demo_says_what_can_be_pasted(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["demo", "--out", "d\u00e9mo dir", "--tile", "40x80"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert cli.main(shlex.split(said[-1])[1:]) == 0
    (tiles,) = (line for line in said if "tiles of 40 x 80 pixels" in line)
    assert capsys.readouterr().out.splitlines()[0] == tiles  # the same tiles


def test_demo_with_tiles_as_large_as_the_frame(tmp_path, capsys):
    assert cli.main(["demo", "--out", str(tmp_path), "--tile", "480x640"]) == 0
    assert "nothing to compare" in capsys.readouterr().out
    assert "fit into the frame" in fails(capsys, "demo", "--out", tmp_path / "new", "--tile", "481")
    assert not (tmp_path / "new").exists()
    (tmp_path / "file").touch()
    assert "file: expected a folder for the files, got a file" in fails(capsys, "demo", "--out", tmp_path / "file")
    assert "expected the name of a folder" in fails(capsys, "demo", "--out", tmp_path / "new.png")


@pytest.mark.parametrize("method", METHODS)
def test_fit_writes_what_fit_tiles_returns(folder, capsys, method):
    arguments = ["--tile", "12x16", "--method", method, "--max-missing", "0.04", "--max-error", "0.02"]
    assert cli.main(["fit", "depth.png", "--camera", "camera.json", "--out", "p.npz", *arguments]) == 0
    expected = rp.fit_tiles(images.read_depth("depth.png"), CAMERA, (12, 16), method, max_missing=0.04, max_error=0.02)
    loaded = rp.TilePlanes.load("p.npz")
    assert np.array_equal(loaded.planes, expected.planes, equal_nan=True)
    assert np.array_equal(loaded.status, expected.status)
    assert len(np.unique(loaded.status)) > 1
    out = capsys.readouterr().out
    assert out.startswith(f"25 tiles of 12 x 16 pixels by {method}: ")
    for status in rp.TileStatus:
        count = (expected.status == status).sum()
        assert (f"{count} {status.name}" in out) == (count > 0)
    assert "Wrote p.npz" in out
    assert cli.main(["fit", "depth.png", "--camera", "camera.json", "--out", "p.json", *arguments]) == 0
    assert json.loads((folder / "p.json").read_text()) == export.to_dict(expected)


def test_fit_by_another_significance(folder, capsys):
    arguments = ["fit", "depth.png", "--camera", "camera.json", "--noise", "kinect_v1", "--out", "p.npz"]
    depth, camera = images.read_depth("depth.png"), replace(CAMERA, noise=rp.noise.kinect_v1())
    rough = []
    for level in ("0", "0.5"):
        assert cli.main([*arguments, "--significance", level]) == 0
        status = rp.TilePlanes.load("p.npz").status
        assert np.array_equal(status, rp.fit_tiles(depth, camera, significance=float(level)).status)
        rough.append(np.count_nonzero(status == rp.TileStatus.ROUGH))
    assert rough[0] == 0 < rough[1]
    capsys.readouterr()
    assert "significance must be at least 0 and below 1, got 1" in fails(capsys, *arguments, "--significance", "1")
    without = ["fit", "depth.png", "--camera", "camera.json", "--significance", "0.1"]
    assert "significance needs a camera with a noise model" in fails(capsys, *without)


def test_fit_says_where_rough_tiles_need_the_noise(folder, capsys):
    arguments = ["fit", "depth.png", "--camera", "camera.json"]
    for options, is_said in (([], True), (["--max-error", "0.02"], False), (["--noise", "kinect_v1"], False)):
        assert cli.main([*arguments, *options]) == 0
        assert ("rgbd-planes noise finds it" in capsys.readouterr().out) == is_said


def test_noise_writes_the_camera_with_what_estimate_noise_finds(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    camera = rp.Camera(width=320, height=240, fx=260.0, fy=260.0, cx=159.5, cy=119.5, depth_scale=1000.0)
    camera.save("camera.json")
    frames = [scenes.room().render(camera).measure(holes=0.05, seed=seed) for seed in range(3)]
    for i, frame in enumerate(frames):
        images.write_png(f"{i}.png", frame)
    command = ["noise", "0.png", "1.png", "2.png", "--camera", "camera.json"]
    assert cli.main([*command, "--out", "with_noise.json", "--figure", "noise.png"]) == 0
    out = capsys.readouterr().out
    found = rp.estimate_noise(frames, camera)
    assert rp.Camera.load("with_noise.json") == replace(camera, noise=found)
    assert f"3 of 3 frames, {found.evidence.windows} flat windows" in out
    assert repr(found)[len("<NoiseModel: ") : -1] in " ".join(out.split())
    assert max(map(len, out.splitlines())) < 100
    with Image.open("noise.png") as picture:
        assert picture.width > 1000
    # A folder; the first and the last of its frames.
    os.mkdir("frames")
    for i, frame in enumerate(frames):
        images.write_png(f"frames/{i}.png", frame)
    arguments = ["--camera", "camera.json", "--count", "2", "--out", "of_two.json"]
    assert cli.main(["noise", "frames", *arguments]) == 0
    assert "2 of 3 frames" in capsys.readouterr().out
    assert rp.Camera.load("of_two.json").noise == rp.estimate_noise(frames[::2], camera)


def test_noise_skips_what_cannot_be_read(tmp_path, monkeypatch, capsys):
    """As a batch does, for which it is made."""
    monkeypatch.chdir(tmp_path)
    camera = rp.Camera(width=320, height=240, fx=260.0, fy=260.0, cx=159.5, cy=119.5, depth_scale=1000.0)
    os.mkdir("frames")
    camera.save("frames/camera.json")
    frames = [scenes.room().render(camera).measure(holes=0.05, seed=seed) for seed in range(3)]
    for i, frame in enumerate(frames):
        images.write_png(f"frames/{i}.png", frame)
    damaged = tmp_path / "frames" / "1.png"
    damaged.write_bytes(damaged.read_bytes()[:1000])
    assert cli.main(["noise", "frames", "--out", "with_noise.json"]) == 1
    out, err = capsys.readouterr()
    assert "2 of 3 frames" in out
    assert err.startswith("rgbd-planes noise: skipped frame 1, 1.png: damaged")
    assert err.count("\n") == 1
    assert rp.Camera.load("with_noise.json").noise == rp.estimate_noise(frames[::2], camera)
    images.write_png(damaged, frames[1][1:])
    assert cli.main(["noise", "frames"]) == 1
    out, err = capsys.readouterr()
    assert "2 of 3 frames" in out
    assert "skipped frame 1, 1.png: expected a depth frame of shape (height, width) = (240, 320)" in err
    for i in range(3):
        (tmp_path / "frames" / f"{i}.png").write_bytes(b"")
    assert "2.png: not a PNG image, or damaged" in fails(capsys, "noise", "frames")


def test_noise_says_what_is_wrong(folder, capsys):
    assert "depth images need --camera" in fails(capsys, "noise", "depth.png")
    assert "there is no such file" in fails(capsys, "noise", "nowhere")
    os.mkdir("other")
    message = fails(capsys, "noise", "depth.png", "other", "--camera", "camera.json")
    assert "expected depth images, or one folder, got 2 paths with the folder other" in message
    for option in ("--format", "--topic"):
        message = fails(capsys, "noise", "depth.png", "--camera", "camera.json", option, "tum")
        assert f"{option} is for a data set or a recording, got depth images" in message
    arguments = ["noise", "depth.png", "--camera", "camera.json"]
    assert "--count must be at least 1" in fails(capsys, *arguments, "--count", "0")
    assert "another file of this command" in fails(capsys, *arguments, "--out", "camera.json")
    assert "ends in .json" in fails(capsys, *arguments, "--out", "noise.npz")
    assert "flat windows" in fails(capsys, *arguments, "--out", "new.json")  # so small a frame has few
    assert not os.path.exists("new.json")


@pytest.mark.parametrize("linked", [False, True])
def test_noise_writes_over_no_file_of_the_folder_that_it_reads(folder, capsys, link, linked):
    images_in = folder / "seen" / "depth"
    images_in.mkdir(parents=True)
    os.rename("camera.json", "seen/camera.json")
    os.rename("depth.png", images_in / "0.png")
    if linked:
        images_in.rename("elsewhere")
        link(images_in, folder / "elsewhere")
    before = {path: path.read_bytes() for path in folder.glob("*/**/*.*")}
    outputs = {"--figure": ["seen/depth/0.png", "seen/../seen/depth/0.png"], "--out": ["seen/camera.json"]}
    if linked:
        outputs["--figure"].append("elsewhere/0.png")
    for option, paths in outputs.items():
        for path in paths:
            message = fails(capsys, "noise", "seen", option, path)
            assert f"{path}: {option} would write over a file in seen, which is read" in message

    for path in ("seen/noise.png", "seen/depth/noise.png"):  # which are new, and would be frames the next time
        message = fails(capsys, "noise", "seen", "--figure", path)
        assert f"{path}: --figure would be taken for a depth image of {os.path.dirname(path)}, which is read" in message
    assert {path: path.read_bytes() for path in folder.glob("*/**/*.*")} == before
    assert "flat windows" in fails(capsys, "noise", "seen", "--out", "seen/noise.json")  # which is new


def test_noise_is_a_name_or_a_number(folder, capsys):
    arguments = ["fit", "depth.png", "--camera", "camera.json", "--out", "p.npz", "--noise"]
    depth = images.read_depth("depth.png")
    models = {"kinect_v1": rp.noise.kinect_v1(), "kinect_v1_nguyen": rp.noise.kinect_v1_nguyen()}
    for given, model in (models | {"2e-3": rp.noise.NoiseModel((2e-3,))}).items():
        assert cli.main([*arguments, given]) == 0
        wanted = rp.fit_tiles(depth, replace(CAMERA, noise=model))
        np.testing.assert_array_equal(rp.TilePlanes.load("p.npz").p_value, wanted.p_value)
        value = 2e-3 if given == "2e-3" else model  # a segmentation takes a number at its word
        assert cli.main(["segment", *arguments[1:4], "--out", "p.json", "--noise", given]) == 0
        wanted_planes = [list(plane) for plane in rp.segment(depth, CAMERA, noise=value).planes]
        assert [plane["plane"] for plane in json.loads((folder / "p.json").read_text())["planes"]] == wanted_planes
    capsys.readouterr()
    for command in (["fit", "depth.png"], ["segment", "depth.png"], ["batch", "here", "--out", "table"]):
        for given in ("kinect", "-1", "0", "nan", "inf"):
            message = fails(capsys, *command, "--camera", "camera.json", "--noise", given)
            assert f"expected kinect_v1, kinect_v1_nguyen or a positive number in 1/m, got '{given}'" in message
    message = fails(capsys, "fit", "depth.png", "--camera", "camera.json", "--noise", "1e300")
    assert "argument --noise: expected noise of 0 to 1e+60 1/m at all inverse depths, got 1e+300" in message


def test_an_option_that_there_is_not_is_named_before_one_that_is_missing(folder, capsys):
    message = fails(capsys, "fit", "depth.png", "--camra", "camera.json")
    assert message == (
        "rgbd-planes fit: unrecognized arguments: --camra (did you mean --camera?) (see rgbd-planes fit --help)\n"
    )
    arguments = ["fit", "depth.png", "--camera", "camera.json"]
    assert "--tiles (did you mean --tile?), --methd (did" in fails(capsys, *arguments, "--tiles=20", "--methd", "x")
    assert "--xyzzy (see" in fails(capsys, *arguments, "--xyzzy", "3")
    assert "unrecognized arguments: more" in fails(capsys, *arguments, "more")
    assert "invalid choice: 'fitt'" in fails(capsys, "fitt", "depth.png", "--camera", "camera.json")
    assert "could match" in fails(capsys, *arguments, "--m", "1")
    said = fails(capsys, "fit", "depth.png", "--max-e", "1")
    assert "required: --camera, a file such as camera.json, or a preset such as kinect_v1 (see" in said


@pytest.mark.parametrize("suffix", [".png", ".tif", ".pgm", ".pfm", ".npy", ".npz"])
def test_fit_reads_every_format(folder, suffix):
    frame = images.read_depth("depth.png")
    if suffix == ".npy":
        np.save("frame.npy", frame / 1000.0)  # metres
    elif suffix == ".npz":
        np.savez("frame.npz", frame)
    elif suffix == ".pfm":
        header = f"Pf\n{frame.shape[1]} {frame.shape[0]}\n-1.0\n".encode()
        (folder / "frame.pfm").write_bytes(header + (frame[::-1] / 1000.0).astype("<f4").tobytes())
    elif suffix == ".pgm":
        header = f"P5 {frame.shape[1]} {frame.shape[0]} 10000\n".encode()
        (folder / "frame.pgm").write_bytes(header + frame.astype(">u2").tobytes())
    else:
        Image.fromarray(frame).save(f"frame{suffix}")
    assert cli.main(["fit", f"frame{suffix}", "--camera", "camera.json", "--out", "p.npz"]) == 0
    expected = rp.fit_tiles(frame, CAMERA)
    rtol = 1e-4 if suffix == ".pfm" else 1e-9  # single precision
    np.testing.assert_allclose(rp.TilePlanes.load("p.npz").planes, expected.planes, rtol=rtol, atol=rtol / 1e3)


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_fit_draws(folder, suffix):
    figure = f"planes{suffix}"
    assert cli.main(["fit", "depth.png", "--camera", "camera.json", "--figure", figure]) == 0
    start = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}[suffix]
    assert (folder / figure).read_bytes().startswith(start)
    assert sorted(os.listdir()) == ["camera.json", "depth.png", figure]


def test_fit_draws_the_depth_as_measured(folder, monkeypatch):
    figures = []
    command = importlib.import_module("rgbd_planes.cli.fit")
    monkeypatch.setattr(command, "write_figure", lambda figure, path: figures.append(figure))
    assert cli.main(["fit", "depth.png", "--camera", "camera.json", "--figure", "p.png"]) == 0
    panel = figures[0].axes[0]
    assert panel.get_title() == "Measured depth"
    depth = images.read_depth("depth.png")
    np.testing.assert_allclose(panel.get_images()[0].get_array()[depth > 0], depth[depth > 0] / 1000.0)


def test_names_of_outputs_may_end_in_capitals(folder, capsys):
    """Whatever the format is known by."""
    camera = ["--camera", "camera.json"]
    assert cli.main(["fit", "depth.png", *camera, "--out", "P.JSON", "--figure", "P.PNG"]) == 0
    assert json.loads((folder / "P.JSON").read_text())["method"] == "range_explicit"
    assert (folder / "P.PNG").read_bytes().startswith(b"\x89PNG")
    assert cli.main(["segment", "depth.png", *camera, "--out", "S.NPZ", "--labels", "L.PNG"]) == 0
    labels = rp.Segmentation.load("S.NPZ").labels
    assert np.array_equal(np.asarray(Image.open("L.PNG")), labels)
    capsys.readouterr()
    os.rename("depth.png", "DEPTH.PNG")
    assert "depth images need --camera" in fails(capsys, "noise", "DEPTH.PNG")


def cut(name, share=0.5):
    def make(folder):
        content = (folder / name).read_bytes()
        (folder / name).write_bytes(content[: int(share * len(content))])

    return make


def store(array):
    def make(folder):
        Image.fromarray(array).save(folder / "depth.png")

    return make


def camera(**changes):
    def make(folder):
        values = {name: value for name, value in (CAMERA.to_dict() | changes).items() if value != "none"}
        (folder / "camera.json").write_text(json.dumps(values))

    return make


BAD_INPUT = {
    "missing depth": (lambda folder: os.remove("depth.png"), [], r"depth\.png: there is no such file"),
    "missing camera": (lambda folder: os.remove("camera.json"), [], r"camera\.json: there is no such file"),
    "camera is a folder": (
        lambda folder: (os.remove("camera.json"), os.mkdir("camera.json")),
        [],
        r"camera\.json: expected a file, got a folder",
    ),
    "truncated depth": (cut("depth.png"), [], r"depth\.png: damaged or truncated PNG"),
    "empty depth": (cut("depth.png", 0.0), [], r"depth\.png: not a PNG"),
    "truncated camera": (cut("camera.json"), [], r"camera\.json"),
    "colour": (store(np.zeros((60, 80, 3), np.uint8)), [], "colour"),
    "another size": (store(np.ones((50, 80), np.uint16)), [], r"depth\.png: .*\(60, 80\).*\(50, 80\)"),
    "no scale": (camera(depth_scale=None), [], r"depth.scale .* disparity"),
    "unknown key": (camera(focal=3.0), [], "focal"),
    "lacking key": (camera(fx="none"), [], "fx"),
    "tile too large": (None, ["--tile", "61"], r"\(60, 80\)"),
    "tile too small": (None, ["--tile", "1"], "at least 2"),
    "tile no number": (None, ["--tile", "16y12"], "16 or 12x20, got '16y12'"),
    "tile half a size": (None, ["--tile", "16x"], "16 or 12x20, got '16x'"),
    "method": (None, ["--method", "ransac"], "range_explicit.*ransac"),
    "share": (None, ["--max-missing", "2"], "fit: --max-missing must be between 0 and 1, got 2"),
    "threads": (None, ["--threads", "0"], "fit: --threads must be at least 1"),
    "YAML": (lambda folder: (folder / "c.yaml").write_text("a: 1"), ["--camera", "c.yaml"], "expected the camera keys"),
    "out is no npz": (None, ["--out", "p.txt"], r"ends in \.npz or \.json"),
    "figure is no picture": (None, ["--figure", "p.docx"], r"\.png or"),
    "out in no folder": (None, ["--out", "none/p.npz"], "no folder"),
    "out is a folder": (lambda folder: os.mkdir("p.npz"), ["--out", "p.npz"], "is a folder"),
    "figure is read": (None, ["--figure", "./depth.png"], r"depth\.png: --figure would write over another file"),
    "unknown option": (None, ["--colour"], "--colour"),
}


@pytest.mark.parametrize(("spoil", "options", "message"), BAD_INPUT.values(), ids=BAD_INPUT.keys())
def test_bad_input_is_one_line_and_nothing_written(folder, capsys, spoil, options, message):
    if spoil is not None:
        spoil(folder)
    before = sorted(os.listdir())
    outputs = [] if "--out" in options else ["--out", "planes.npz"]
    outputs += [] if "--figure" in options else ["--figure", "planes.png"]
    err = fails(capsys, "fit", "depth.png", "--camera", "camera.json", *outputs, *options)
    assert re.search(message, err)
    assert sorted(os.listdir()) == before


def test_a_frame_without_any_measurement_is_fitted_and_drawn(folder, capsys):
    np.save("depth.npy", np.full((60, 80), np.nan))
    assert cli.main(["fit", "depth.npy", "--camera", "camera.json", "--figure", "p.png"]) == 1
    out, err = capsys.readouterr()
    assert "20 TOO_FEW; 0.0 % of the pixels are measured." in out
    assert os.path.exists("p.png")
    assert err == "rgbd-planes fit: depth.npy: no pixel is a measurement: all values are NaN or infinite\n"
    some = np.full((60, 80), np.nan)
    some[3, 4] = -9.0
    np.save("depth.npy", some)
    assert cli.main(["fit", "depth.npy", "--camera", "camera.json"]) == 1
    assert capsys.readouterr().err.endswith("no pixel is a measurement: the values are -9 to -9\n")
    some[:, ::10] = 1.5
    np.save("depth.npy", some)
    assert cli.main(["fit", "depth.npy", "--camera", "camera.json"]) == 0
    assert "20 TOO_FEW; 10.0 % of the pixels are measured." in capsys.readouterr().out
    replace(CAMERA, depth_range=(20.0, 30.0)).save("far.json")
    for command in ("segment", "normals"):
        assert cli.main([command, "depth.png", "--camera", "far.json"]) == 1
        err = capsys.readouterr().err
        assert re.search(r"the values are 0 to \d{4}, the camera's depth_range is 20 to 30 m\n$", err)


def test_a_failure_in_the_middle_of_writing_leaves_the_old_file(folder, capsys, monkeypatch):
    (folder / "p.png").write_bytes(b"old")

    def fail(self, content):
        with open(self, "wb") as file:
            file.write(content[:1000])
        raise OSError(28, "No space left on device", str(self))

    monkeypatch.setattr("pathlib.Path.write_bytes", fail)
    assert cli.main(["fit", "depth.png", "--camera", "camera.json", "--figure", "p.png"]) == 2
    assert "No space left on device" in capsys.readouterr().err
    assert (folder / "p.png").read_bytes() == b"old"
    assert sorted(os.listdir()) == ["camera.json", "depth.png", "p.png"]


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no disk that is always full")
def test_a_full_disk_is_said_in_a_line(folder, capsys, link):
    for option, name in (("--out", "full.npy"), *(("--figure", f"full.{kind}") for kind in ("png", "pdf", "svg"))):
        link(folder / name, "/dev/full")
        assert cli.main(["normals", "depth.png", "--camera", "camera.json", option, name]) == 2
        assert capsys.readouterr().err == f"rgbd-planes normals: {name}: No space left on device\n"


@pytest.mark.filterwarnings("default")
def test_warnings_are_one_line(folder, capsys):
    np.save("depth.npy", images.read_depth("depth.png").astype(np.float64))  # millimetres, as metres
    assert cli.main(["fit", "depth.npy", "--camera", "camera.json", "--figure", "twice.png"]) == 0
    err = capsys.readouterr().err
    assert err.startswith("rgbd-planes: warning: ")
    assert "millimetres" in err
    assert err.count("\n") == 1


@pytest.mark.filterwarnings("error")
def test_warnings_that_are_to_be_errors_are_one_line(folder, capsys):
    """As with PYTHONWARNINGS=error."""
    np.save("depth.npy", images.read_depth("depth.png").astype(np.float64))
    assert "millimetres" in fails(capsys, "fit", "depth.npy", "--camera", "camera.json", "--out", "planes.npz")
    assert not (folder / "planes.npz").exists()


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("command", ["fit", "segment"])
def test_noise_in_other_units(folder, capsys, command):
    assert cli.main([command, "depth.png", "--camera", "camera.json", "--noise", "5"]) == 0
    err = capsys.readouterr().err
    assert err.startswith("rgbd-planes: warning: the noise that is given is 5 1/m where 1/Z is 0.")
    assert "most likely it is not in 1/m" in err
    assert cli.main([command, "depth.png", "--camera", "camera.json", "--noise", "0.0014"]) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.filterwarnings("default")
def test_noise_in_other_units_in_a_batch(folder, capsys):
    """Of tiles: how large the noise is, segments take from their frame."""
    pytest.importorskip("pyarrow")
    command = ["batch", ".", "--threads", "1", "--noise"]
    assert cli.main([*command, "5", "--out", "large"]) == 0
    err = capsys.readouterr().err
    assert err.startswith("rgbd-planes: warning: depth.png: the noise that is given is 5 1/m where 1/Z is 0.")
    assert err.count("\n") == 1
    assert cli.main([*command, "0.0014", "--out", "right"]) == 0
    assert capsys.readouterr().err == ""


def test_a_seed_that_is_none(tmp_path, capsys):
    assert "seed must be at least 0, got -1" in fails(capsys, "demo", "--out", tmp_path / "new", "--seed", "-1")
    assert not (tmp_path / "new").exists()


def test_no_command_and_an_unknown_one(capsys):
    assert "COMMAND" in fails(capsys)
    assert "segmint" in fails(capsys, "segmint")


def test_an_unknown_option_names_the_command(folder, capsys):
    said = fails(capsys, "fit", "depth.png", "--camera", "camera.json", "--certainty", "0.01")
    assert "rgbd-planes fit: unrecognized arguments: --certainty (see" in said
    assert "rgbd-planes fit --help" in said


@pytest.mark.parametrize("command", [command.__name__ for command in COMMANDS])
def test_help_shows_an_example(capsys, command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit) as exit_:
        cli.main([command, "--help"])
    assert exit_.value.code == 0
    out = capsys.readouterr().out
    assert f"example: rgbd-planes {command}" in out
    assert max(map(len, out.splitlines())) < 80
    assert "rgbd-\n" not in out
    if command == "fit":
        assert all(method in out for method in METHODS)
    if command == "batch":
        assert all(format in out for format in rp.sequences.FORMATS)


def test_defaults_are_those_that_the_help_says():
    said = []
    for command in COMMANDS:
        parser = argparse.ArgumentParser()
        command(parser)
        for action in parser._actions:
            if found := re.search(r"\(([\d.]+)\)$", action.help or ""):
                assert float(np.ravel(action.default)[0]) == float(found[1]), (command.__name__, action.dest)
                said.append(action.dest)
    assert set(said) == {"tile", "max_missing", "min_size", "count", "window", "seed", "mask_threshold", "every"}


def run_module(*arguments, **options):
    return subprocess.run([sys.executable, "-m", "rgbd_planes", *arguments], capture_output=True, text=True, **options)


def test_python_m_and_version():
    ran = run_module("--version")
    assert (ran.returncode, ran.stdout) == (0, rp.__version__ + "\n")
    ran = run_module("fit", "gone.png", "--camera", "gone.json")
    assert ran.returncode == 2
    assert ran.stderr == "rgbd-planes fit: gone.json: there is no such file\n"


def test_help_needs_no_heavy_import():
    program = (
        "import sys; from rgbd_planes.cli import main as cli\n"
        "try: cli.main(['fit', '--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'numba', 'numpy', 'matplotlib', 'PIL', 'scipy'} & set(sys.modules)\n"
        "sys.exit(str(heavy) if heavy else 0)"
    )
    subprocess.run([sys.executable, "-c", program], check=True, capture_output=True)


@pytest.mark.skipif(os.name != "posix", reason="without a shell of POSIX")
def test_without_a_place_for_what_it_says(folder):
    command = f"{sys.executable} -m rgbd_planes fit depth.png --camera camera.json"
    ran = subprocess.run(f"{command} --out p.npz >&-", shell=True, stderr=subprocess.PIPE, text=True)
    assert (ran.returncode, "Traceback" in ran.stderr) == (0, False)
    assert rp.TilePlanes.load("p.npz").fitted.any()


@pytest.mark.skipif(os.name != "posix", reason="without a shell of POSIX")
def test_without_a_place_for_what_went_wrong(folder):
    """It does not come out between the results."""
    command = f"{sys.executable} -m rgbd_planes fit gone.png --camera camera.json 2>&-"
    ran = subprocess.run(command, shell=True, stdout=subprocess.PIPE, text=True)
    assert (ran.returncode, ran.stdout) == (2, "")


@pytest.mark.skipif(os.name != "posix", reason="without a shell of POSIX")
def test_a_batch_without_a_place_for_what_went_wrong(folder):
    pytest.importorskip("pyarrow")
    pytest.importorskip("tqdm")
    command = f"{sys.executable} -m rgbd_planes batch depth --camera camera.json --out table 2>&-"
    (folder / "depth").mkdir()
    os.rename("depth.png", "depth/0.png")
    (folder / "depth" / "1.png").touch()
    ran = subprocess.run(command, shell=True, stdout=subprocess.PIPE, text=True)
    assert ran.returncode == 1
    assert ran.stdout.startswith("1 of 2 frames, 20 rows")


@pytest.mark.parametrize("options", [[], ["--segments"]])
def test_a_batch_without_any_plane_says_so(folder, capsys, options):
    pytest.importorskip("pyarrow")
    pytest.importorskip("tqdm")
    (folder / "depth").mkdir()
    os.rename("depth.png", "depth/0.png")
    replace(CAMERA, depth_range=(40.0, 50.0)).save("far.json")
    assert cli.main(["batch", "depth", "--camera", "far.json", "--out", "table", *options]) == 1
    out, err = capsys.readouterr()
    assert out.startswith("1 of 1 frame, ")
    assert "batch: no plane in any frame: are the camera's unit, depth_range" in err


@pytest.mark.skipif(os.name != "posix", reason="without a shell of POSIX")
@pytest.mark.parametrize("option", ["--version", "fit --help"])
def test_a_reader_of_help_that_leaves_early_is_no_error(option):
    read, write = os.pipe()
    os.close(read)
    ran = subprocess.run(
        [sys.executable, "-m", "rgbd_planes", *option.split()], stdout=write, stderr=subprocess.PIPE, text=True
    )
    os.close(write)
    assert (ran.returncode, ran.stderr) == (0, "")


def test_a_terminal_without_width(folder, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "1")
    assert cli.main(["fit", "depth.png", "--camera", "camera.json"]) == 0


def test_a_name_that_stdout_has_no_letters_for(folder):
    ran = run_module(
        *("fit", "depth.png", "--camera", "camera.json", "--out", "tür.npz"),
        env=os.environ | {"PYTHONIOENCODING": "ascii", "PYTHONUTF8": "1"},
    )
    assert (ran.returncode, ran.stdout.splitlines()[-1]) == (0, r"Wrote t\xfcr.npz")


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (MemoryError(), "not enough memory"),
        (ImportError("no libGL\nat all"), "no libGL at all"),
        (RuntimeError("can't start new thread"), "can't start new thread"),
    ],
)
def test_what_the_machine_lacks_is_one_line(folder, capsys, monkeypatch, error, words):
    def fail(*arguments, **options):
        raise error

    monkeypatch.setattr(rp, "fit_tiles", fail)
    assert words in fails(capsys, "fit", "depth.png", "--camera", "camera.json")


def test_an_interrupt_that_an_import_hides(folder, capsys, monkeypatch):
    def fail(*arguments, **options):
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise ImportError("initialization failed") from error

    monkeypatch.setattr(rp, "fit_tiles", fail)
    assert cli.main(["fit", "depth.png", "--camera", "camera.json"]) == 130
    assert "failed" not in capsys.readouterr().err


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("measured", [True, False])
def test_a_reader_that_leaves_early_is_no_error(folder, unbuffered, measured):
    """The work is done, and the exit status what it always is."""
    if not measured:
        images.write_png("depth.png", np.zeros((60, 80), np.uint16))
    read, write = os.pipe()
    os.close(read)
    arguments = ["fit", "depth.png", "--camera", "camera.json", "--out", "p.npz"]
    ran = subprocess.run(
        [sys.executable, "-m", "rgbd_planes", *arguments],
        stdout=write,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": unbuffered},
    )
    os.close(write)
    assert rp.TilePlanes.load("p.npz").fitted.any() == measured
    noise = [line for line in ran.stderr.splitlines() if not line.startswith("compiling kernels")]
    assert (ran.returncode, len(noise)) == ((0, 0) if measured else (1, 1))


@pytest.mark.skipif(os.name != "posix", reason="without pipes of POSIX")
@pytest.mark.parametrize("where", ["pipe", "/dev/full"])
def test_work_is_done_whoever_reads_its_warnings(folder, where):
    if where != "pipe" and not os.path.exists(where):
        pytest.skip("this system has no disk that is always full")
    frame = images.read_depth("depth.png")
    frame[:30] = 65535
    images.write_png("depth.png", frame)
    read, write = os.pipe() if where == "pipe" else (os.open(where, os.O_RDONLY), os.open(where, os.O_WRONLY))
    os.close(read)
    arguments = ["fit", "depth.png", "--camera", "camera.json", "--out", "p.npz"]
    ran = subprocess.run([sys.executable, "-m", "rgbd_planes", *arguments], stdout=subprocess.PIPE, stderr=write)
    os.close(write)
    assert (ran.returncode, ran.stdout.splitlines()[-1]) == (0, b"Wrote p.npz")
    assert rp.TilePlanes.load("p.npz").fitted.any()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="without pipes of POSIX")
def test_a_reader_of_the_result_that_leaves_early_is_an_error(folder, capsys):
    """Of one that is more than a pipe holds."""
    os.mkfifo("p.json")
    reader = threading.Thread(target=lambda: os.close(os.open("p.json", os.O_RDONLY)))
    reader.start()
    assert cli.main(["fit", "depth.png", "--camera", "camera.json", "--tile", "3", "--out", "p.json"]) == 2
    assert capsys.readouterr().err == "rgbd-planes fit: p.json: Broken pipe\n"
    reader.join()


def test_fit_on_real_frames(tmp_path, monkeypatch, capsys, real_frame):
    monkeypatch.chdir(tmp_path)
    depth, camera = real_frame
    images.write_png("depth.png", depth)
    camera.save("camera.json")
    assert cli.main(["fit", "depth.png", "--camera", "camera.json", "--out", "planes.npz"]) == 0
    assert "warning" not in capsys.readouterr().err
    tiles = rp.TilePlanes.load("planes.npz")
    assert np.array_equal(tiles.status, rp.fit_tiles(depth, camera).status)
    assert (tiles.status == rp.TileStatus.OK).mean() > 0.5


def test_noise_refuses_frames_of_several_cameras(tmp_path, capsys):
    """As those of a phone, which refocuses."""
    for folder in ("lowres_depth", "lowres_wide_intrinsics"):
        (tmp_path / folder).mkdir()
    for time, focal in ((1.0, 65.0), (1.1, 66.0)):
        images.write_png(tmp_path / "lowres_depth" / f"4_{time}.png", np.full((60, 80), 900, np.uint16))
        (tmp_path / "lowres_wide_intrinsics" / f"4_{time}.pincam").write_text(f"80 60 {focal} 65 39.5 29.5\n")
    assert "expected frames of one camera, got 2: give --camera" in fails(capsys, "noise", tmp_path)


def test_fit_says_how_large_residuals_are(folder, capsys):
    assert cli.main(["fit", "depth.png", "--camera", "camera.json"]) == 0
    tiles = rp.fit_tiles(images.read_depth("depth.png"), CAMERA)
    median = 1e3 * np.median(tiles.rmse_metric[tiles.fitted])
    assert median > 1.0
    assert f"; median residual {median:.1f} mm along the normal.\n" in capsys.readouterr().out


def test_demo_knows_before_the_work_that_it_cannot_write(tmp_path, capsys):
    (tmp_path / "demo_camera.json").mkdir()
    assert "demo_camera.json: it is a folder" in fails(capsys, "demo", "--out", tmp_path)
    assert os.listdir(tmp_path) == ["demo_camera.json"]


def test_a_share_is_none_or_all_only_if_it_is():
    shares = {0.0: "0.0 %", 1e-5: "0.1 %", 0.5: "50.0 %", 0.99999: "99.9 %", 1.0: "100.0 %"}
    assert {share: percent(share) for share in shares} == shares


def test_curvature_writes_surfaces_a_table_and_a_picture(folder, capsys):
    arguments = ["curvature", "depth.png", "--camera", "camera.json", "--noise", "kinect_v1", "--tile", "12"]
    assert cli.main([*arguments, "--out", "bent.npz", "--figure", "bent.png"]) == 0
    out = capsys.readouterr().out
    assert "5 x 7 tiles of 12 x 12 pixels" in out
    assert "Curved (p < 0.01):" in out
    assert "rgbd-planes noise finds" in out
    found = rp.TileSurfaces.load("bent.npz")
    assert found.shape == (5, 7)
    with Image.open("bent.png") as picture:
        assert picture.width > 1000
    assert cli.main([*arguments, "--out", "bent.csv"]) == 0
    capsys.readouterr()
    lines = (folder / "bent.csv").read_text().splitlines()
    assert len(lines) == 1 + found.status.size
    assert lines[0].startswith("row,column,top,left")
    assert cli.main(["curvature", "depth.png", "--camera", "camera.json"]) == 0
    assert "--noise" in capsys.readouterr().out
    assert "at least 3 x 3" in fails(capsys, "curvature", "depth.png", "--camera", "camera.json", "--tile", "2")
