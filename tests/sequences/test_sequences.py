"""Readers of data sets and recordings: each on a small file of exactly its format, made here."""

import io
import json
import math
import os
import pickle
import re
import struct
import subprocess
import sys
import zlib
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from bags import Cut, messages, type_store, write_bag
from matroska import write_recording
from PIL import Image

import rgbd_planes as rp
from bench import real_data
from rgbd_planes import sequences
from rgbd_planes.camera import presets
from rgbd_planes.cli.arguments import read_sequence
from rgbd_planes.sequences import images
from rgbd_planes.sequences.frames import FrameEntry, FrameSequence, numbered
from rgbd_planes.sequences.problems import reason_to_skip
from rgbd_planes.sequences.rosbag import _decode, _decode_compressed, _OpenBag
from rgbd_planes.sequences.scannet import SensLocation, read_sens_frame

CAMERA = rp.Camera(8, 6, 7.0, 7.5, 3.5, 2.5, depth_scale=1000.0)


@pytest.fixture
def frames(rng):
    """Three small frames with values of both bytes."""
    return rng.integers(0, 65535, (3, 6, 8)).astype(np.uint16)


def write_tum(root, frames):
    """A folder as the archives of the TUM benchmark unpack."""
    (root / "depth").mkdir(parents=True)
    lines = ["# depth maps", "# file: 'x.bag'", "# timestamp filename"]
    for i, frame in enumerate(frames):
        time = f"{1305031102.160407 + i / 30:.6f}"
        images.write_png(root / "depth" / f"{time}.png", frame)
        lines.append(f"{time} depth/{time}.png")
    (root / "depth.txt").write_text("\n".join(lines) + "\n")


def write_sens(path, frames, camera=CAMERA, compression=1, stamps=(0, 33_000, 66_000)):
    """A ScanNet recording with colour of some bytes and one IMU record at the end."""
    matrix = np.eye(4, dtype="<f4")
    matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2] = camera.fx, camera.fy, camera.cx, camera.cy
    other = np.diag([9.0, 9.0, 1.0, 1.0]).astype("<f4")
    with open(path, "wb") as file:
        file.write(struct.pack("<IQ", 4, 9) + b"StructSen")
        for block in (other, np.eye(4, dtype="<f4"), matrix, np.eye(4, dtype="<f4")):
            file.write(block.tobytes())
        file.write(struct.pack("<iiIIIIfQ", 2, compression, 16, 12, 8, 6, 1000.0, len(frames)))
        for frame, stamp in zip(frames, stamps, strict=True):
            content = frame.astype("<u2").tobytes()
            content = zlib.compress(content) if compression == 1 else content
            colour = b"\xff\xd8colour"
            file.write(np.eye(4, dtype="<f4").tobytes())
            file.write(struct.pack("<QQQQ", stamp + 5, stamp, len(colour), len(content)) + colour + content)
        file.write(struct.pack("<Q", 1) + bytes(15 * 8 + 8))


def same(sequence, frames, camera, names=None, times=None):
    """Whether a sequence is what was written, however it is asked for."""
    assert len(sequence) == len(frames)
    for i, (frame, expected) in enumerate(zip(sequence, frames, strict=True)):
        assert np.array_equal(frame.depth, expected, equal_nan=expected.dtype.kind == "f")
        assert frame.depth.dtype == expected.dtype
        assert frame.camera == (camera[i] if isinstance(camera, list) else camera)
        assert frame.name == sequence.names[i]
    assert np.array_equal(sequence[-1].depth, frames[-1], equal_nan=True)
    assert np.array_equal(pickle.loads(pickle.dumps(sequence[1:]))[0].depth, frames[1], equal_nan=True)
    with pytest.raises(IndexError, match=rf"^expected the number of one of {len(frames)} frames, got {len(frames)}$"):
        sequence[len(frames)]
    with pytest.raises(TypeError, match=r"^expected the number of a frame, or a slice, got \[0, 1\]$"):
        sequence[[0, 1]]
    if names is not None:
        assert list(sequence.names) == names
    times = [math.nan] * len(frames) if times is None else times
    np.testing.assert_allclose(sequence.timestamps, times, rtol=0, atol=1e-6)


@pytest.mark.parametrize("number", "123")
def test_tum_frames_come_with_camera_and_times(tmp_path, frames, number):
    root = tmp_path / f"rgbd_dataset_freiburg{number}_xyz"
    write_tum(root, frames)
    camera = getattr(presets, f"tum_freiburg{number}")()
    times = 1305031102.160407 + np.arange(3) / 30
    names = [f"depth/{time:.6f}.png" for time in times]
    same(rp.open_sequence(root), frames, camera, names, times)
    same(sequences.tum(root, CAMERA), frames, CAMERA, names, times)
    sequence = rp.open_sequence(root)
    assert repr(sequence).startswith("<FrameSequence: 3 frames, 640 x 480 pixels, depth/")
    assert repr(sequence[:1]).startswith("<FrameSequence: 1 frame, 640 x 480 pixels, depth/")
    assert repr(sequence[0]) == f"<Frame: {names[0]}, 640 x 480 pixels, 1305031102.160407 s>"
    assert repr(replace(sequence[0], timestamp=math.nan)) == f"<Frame: {names[0]}, 640 x 480 pixels>"


@pytest.mark.parametrize(("name", "number"), [("fr1_xyz", 1), ("rgbd_fr3_office", 3), ("fr1_made_of_freiburg2", 2)])
def test_the_calibration_of_tum_is_known_by_the_last_number_in_its_name(tmp_path, frames, name, number):
    write_tum(tmp_path / name, frames)
    assert rp.open_sequence(tmp_path / name).camera == getattr(presets, f"tum_freiburg{number}")()


def test_a_longer_number_is_none_of_the_cameras_of_tum(tmp_path):
    (tmp_path / "kitchen_fr12").mkdir()
    with pytest.raises(ValueError, match="expected freiburg1, freiburg2 or freiburg3 in the folder's name"):
        sequences.tum(tmp_path / "kitchen_fr12")


def test_tum_by_a_link(tmp_path, frames, link):
    """The calibration is known by the name of a link, or by that of the folder that it leads to."""
    for folder, name in (("volume", "freiburg2_desk"), ("freiburg2_xyz", "frames")):
        write_tum(tmp_path / folder, frames)
        link(tmp_path / name, folder)
        assert rp.open_sequence(tmp_path / name).camera == presets.tum_freiburg2()


@pytest.mark.parametrize("name", ["freiburg1", "a.sens", "a.bag"])
def test_frames_are_read_from_another_working_directory(tmp_path, frames, monkeypatch, name):
    """What was opened by a relative path: after a change of directory, or in another process."""
    if name == "freiburg1":
        write_tum(tmp_path / name, frames)
    elif name == "a.sens":
        write_sens(tmp_path / name, frames)
    else:
        pytest.importorskip("rosbags")
        depth, info = messages(type_store(tmp_path / name)[0], frames)
        timed = [(i + 1, message) for i, message in enumerate(depth)]
        write_bag(tmp_path / name, {"/depth/image_raw": timed, "/depth/camera_info": [(1, info)]})
    monkeypatch.chdir(tmp_path)
    sequence = rp.open_sequence(name)
    monkeypatch.chdir("/")
    assert np.array_equal([frame.depth for frame in sequence], frames)


def write_lossless(path, frames):
    """A Matroska recording that is compressed."""
    import av

    with av.open(path, "w", format="matroska") as container:
        stream = container.add_stream("ffv1", rate=30)
        stream.height, stream.width = frames[0].shape
        stream.pix_fmt = "gray16le"
        for i, frame in enumerate(frames):
            image = av.VideoFrame.from_ndarray(frame, format="gray16le")
            image.pts = i
            container.mux(stream.encode(image))
        container.mux(stream.encode())


FORK_WHILE_OPEN = """
import os, signal, sys
import numpy as np
import rgbd_planes as rp

frames = np.load(sys.argv[2])
sequence = rp.open_sequence(sys.argv[1], rp.Camera(160, 120, 130.0, 130.0, 79.5, 59.5, depth_scale=1000.0))

def wrong(order):
    return sum(not np.array_equal(sequence[i].depth, frames[i]) for i in order)

sequence[0]
child = os.fork()
if child == 0:
    signal.alarm(60)  # which ends it if it waits for a thread that it does not have
    os._exit(wrong(2 * [*range(len(frames))]))
print(wrong(2 * [*reversed(range(len(frames)))]), os.waitpid(child, 0)[1])
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
@pytest.mark.parametrize("name", ["a.bag", "mcap", "raw.mkv", "lossless.mkv"])
def test_a_fork_while_a_recording_is_open(tmp_path, rng, name):
    frames = rng.integers(0, 65535, (40, 120, 160)).astype(np.uint16)
    if name.endswith(".mkv"):
        pytest.importorskip("av")
        timed = [(33_333 * i, frame) for i, frame in enumerate(frames)]
        path = tmp_path / name
        write_recording(path, {"DEPTH": timed}, {}) if name == "raw.mkv" else write_lossless(path, frames)
    else:
        pytest.importorskip("rosbags")
        depth, _ = messages(type_store(tmp_path / name)[0], frames)
        write_bag(tmp_path / name, {"/depth": [(i + 1, message) for i, message in enumerate(depth)]})
    np.save(tmp_path / "frames.npy", frames)
    command = [sys.executable, "-W", "ignore", "-c", FORK_WHILE_OPEN, tmp_path / name, tmp_path / "frames.npy"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert (done.stdout, done.stderr) == ("0 0\n", "")


def test_tum_says_what_is_wrong(tmp_path, frames):
    write_tum(tmp_path / "office", frames)
    with pytest.raises(ValueError, match="freiburg1, freiburg2 or freiburg3 in the folder's name"):
        rp.open_sequence(tmp_path / "office")
    root = tmp_path / "freiburg1"
    write_tum(root, frames)
    for text, message in (("# only a comment\n", "found none"), ("1.5 a.png\nsoon b.png\n", "line 2: expected")):
        (root / "depth.txt").write_text(text)
        with pytest.raises(ValueError, match=message):
            rp.open_sequence(root)
    (root / "depth.txt").write_bytes(b"\xff\xfe1\x00")
    with pytest.raises(ValueError, match=r"depth\.txt, line 1: expected"):
        rp.open_sequence(root)
    (root / "depth.txt").unlink()
    with pytest.raises(FileNotFoundError, match=r"freiburg1: expected depth\.txt, lines .* found none"):
        sequences.tum(root)
    with pytest.raises(ValueError, match=r"expected .* or depth\.txt \(tum\) in it, found depth; for a plain"):
        rp.open_sequence(root)


def test_icl_nuim_frames_come_in_the_order_of_their_numbers(tmp_path, frames):
    (tmp_path / "depth").mkdir()
    (tmp_path / "livingRoom0.gt.freiburg").touch()
    for number, frame in zip((9, 10, 100), frames, strict=True):
        images.write_png(tmp_path / "depth" / f"{number}.png", frame)
    names = ["depth/9.png", "depth/10.png", "depth/100.png"]
    same(rp.open_sequence(tmp_path), frames, presets.icl_nuim(), names)


def test_seven_scenes_frames_come_with_their_camera(tmp_path, frames):
    for i, frame in enumerate(frames):
        images.write_png(tmp_path / f"frame-{i:06d}.depth.png", frame)
        (tmp_path / f"frame-{i:06d}.pose.txt").touch()
        (tmp_path / f"frame-{i:06d}.color.png").touch()
    names = [f"frame-{i:06d}.depth.png" for i in range(3)]
    same(rp.open_sequence(tmp_path), frames, presets.seven_scenes(), names)


def test_scannet_as_exported_by_its_python_tool(tmp_path, frames):
    (tmp_path / "depth").mkdir()
    (tmp_path / "intrinsic").mkdir()
    matrix = np.eye(4)
    matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2] = 7.0, 7.5, 3.5, 2.5
    np.savetxt(tmp_path / "intrinsic" / "intrinsic_depth.txt", matrix, fmt="%f")
    for i, frame in zip((2, 11, 100), frames, strict=True):
        images.write_png(tmp_path / "depth" / f"{i}.png", frame)
    same(rp.open_sequence(tmp_path), frames, CAMERA, ["depth/2.png", "depth/11.png", "depth/100.png"])
    (tmp_path / "depth" / "2.png").write_bytes(b"damaged")
    assert len(rp.open_sequence(tmp_path)) == 3  # another image gives the size
    (tmp_path / "intrinsic" / "intrinsic_depth.txt").write_text("1 2 3")
    with pytest.raises(ValueError, match="expected a 4 x 4 matrix"):
        rp.open_sequence(tmp_path)
    (tmp_path / "intrinsic" / "intrinsic_depth.txt").write_text("0 " * 16)
    with pytest.raises(ValueError, match=r"intrinsic_depth\.txt: .*fx and fy not 0"):
        rp.open_sequence(tmp_path)
    for image in (tmp_path / "depth").iterdir():
        image.write_bytes(b"damaged")
    with pytest.raises(ValueError, match=r"2\.png: .*the first image that can be read gives the size"):
        rp.open_sequence(tmp_path)


def test_scannet_as_exported_by_its_cpp_tool(tmp_path, frames):
    for i, frame in enumerate(frames):
        with open(tmp_path / f"frame-{i:06d}.depth.pgm", "wb") as file:
            file.write(b"P5\n8 6\n65535\n" + frame.astype(">u2").tobytes())
    (tmp_path / "_info.txt").write_text(
        "m_versionNumber = 4\nm_sensorName = StructureSensor\nm_colorWidth = 16\nm_colorHeight = 12\n"
        "m_depthWidth = 8\nm_depthHeight = 6\nm_depthShift = 1000\n"
        "m_calibrationColorIntrinsic = 9 0 8 0 0 9 6 0 0 0 1 0 0 0 0 1 \n"
        "m_calibrationDepthIntrinsic = 7 0 3.5 0 0 7.5 2.5 0 0 0 1 0 0 0 0 1 \n"
        "m_frames.size = 3\n"
    )
    same(rp.open_sequence(tmp_path), frames, CAMERA)
    (tmp_path / "_info.txt").write_text("m_depthWidth = 8\n")
    with pytest.raises(ValueError, match="expected m_depthWidth, m_depthHeight"):
        rp.open_sequence(tmp_path)
    (tmp_path / "_info.txt").write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match=r"_info\.txt: expected m_depthWidth"):
        rp.open_sequence(tmp_path)


@pytest.mark.parametrize("compression", [0, 1])
def test_scannet_sens_frames_come_with_camera_and_times(tmp_path, frames, compression):
    path = tmp_path / "scene0000_00.sens"
    write_sens(path, frames, compression=compression)
    times = [math.nan, 0.033, 0.066]  # a stamp of zero is none
    same(rp.open_sequence(path), frames, CAMERA, times=times)
    # A given camera counts, even if the file's own is none.
    content = path.read_bytes()
    matrix = np.array([[7.0, 0, 3.5, 0], [0, 7.5, 2.5, 0], [0, 0, 1, 0], [0, 0, 0, 1]], "<f4").tobytes()
    assert content.count(matrix) == 1
    path.write_bytes(content.replace(matrix, bytes(64)))
    with pytest.raises(ValueError, match=r"00\.sens: expected camera_matrix"):
        rp.open_sequence(path)
    other = replace(CAMERA, fx=9.0)
    same(sequences.scannet_sens(path, other), frames, other, times=times)
    with pytest.raises(ValueError, match=r"00\.sens: expected depth of the camera's 640 x 480 pixels, got 8 x 6$"):
        sequences.scannet_sens(path, presets.scannet())


def test_sens_that_is_damaged(tmp_path, frames):
    path = tmp_path / "a.sens"
    write_sens(path, frames)
    whole = path.read_bytes()
    write_sens(path, frames[:0], stamps=())
    with pytest.raises(ValueError, match=r"a\.sens: expected depth frames, found none"):
        rp.open_sequence(path)
    path.write_bytes(whole)
    start = rp.open_sequence(path).entries[1].location.offset
    for content, message in (
        (whole[:5], "truncated: 5 bytes end in the header"),
        (whole[:300], "truncated: 300 bytes end in the header"),
        (whole[:-300], r"truncated: \d+ bytes end in frame 2, expected 3 frames"),
        (whole[: start + 3], rf"truncated: {start + 3} bytes end in frame 1, expected 3 frames"),
        (b"\x03" + whole[1:], "version 4, got 3"),
        (b"\x04\0\0\0" + b"\xff" * 40, "not a .sens file"),
        (whole[:281] + b"\x02" + whole[282:], "got occi_ushort"),
        # A size that no file of this length can hold is no reason to ask for the memory.
        (whole[:293] + b"\xff" * 8 + whole[301:], "at most 33554432 pixels in a file, got 4294967295 x 4294967295"),
        (whole[:293] + b"\xff\xff\xff\x7f" * 2 + whole[301:], "at most 33554432 pixels in a file, got 2147483647 x"),
    ):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=message) as error:
            rp.open_sequence(path)
        assert "a.sens" in str(error.value)
    # One bad frame does not hide the others.
    path.write_bytes(whole[:start] + b"nonsense" + whole[start + 8 :])
    sequence = rp.open_sequence(path)
    with pytest.raises(ValueError, match=f"damaged depth frame at byte {start}"):
        sequence[1]
    assert np.array_equal(sequence[2].depth, frames[2])


def test_a_frame_that_unpacks_to_more_than_its_pixels_is_damaged(tmp_path):
    content = zlib.compress(bytes(2 * 8 * 6 + 1))
    (tmp_path / "a.sens").write_bytes(content)
    location = SensLocation(tmp_path / "a.sens", 0, len(content), "zlib_ushort", (6, 8))
    with pytest.raises(ValueError, match="expected 96 bytes of 8 x 6 pixels, got more"):
        read_sens_frame(location)


def write_arkitscenes(root, frames, shift=0.0):
    (root / "lowres_depth").mkdir(parents=True)
    (root / "lowres_wide_intrinsics").mkdir()
    for i, frame in enumerate(frames):
        # Out of the alphabet's order: 99.9 comes before 100.0.
        time = 99.95 + 0.1 * i
        images.write_png(root / "lowres_depth" / f"41048190_{time:.3f}.png", frame)
        (root / "lowres_wide_intrinsics" / f"41048190_{time + shift:.3f}.pincam").write_text(
            f"8 6 {7.0 + (i > 1)} 7.5 3.5 2.5\n"
        )


def test_arkitscenes_has_a_camera_for_each_frame(tmp_path, frames):
    write_arkitscenes(tmp_path / "a", frames, shift=0.001)
    cameras = [CAMERA, CAMERA, rp.Camera(8, 6, 8.0, 7.5, 3.5, 2.5, depth_scale=1000.0)]
    sequence = rp.open_sequence(tmp_path / "a")
    same(sequence, frames, cameras, times=[99.95, 100.05, 100.15])
    assert sequence.entries[0].camera is sequence.entries[1].camera
    assert "2 cameras" in repr(sequence)
    assert sequence.cameras == (CAMERA, cameras[2])
    # Frames are 16 ms apart: up to half of that it is of the same one.
    write_arkitscenes(tmp_path / "near", frames, shift=0.008)
    assert rp.open_sequence(tmp_path / "near").cameras == sequence.cameras
    for name, shift in (("before", -0.009), ("b", 0.009)):
        write_arkitscenes(tmp_path / name, frames, shift=shift)
        with pytest.raises(ValueError, match="expected a calibration of its moment"):
            rp.open_sequence(tmp_path / name)
    same(rp.open_sequence(tmp_path / "b", CAMERA, "arkitscenes"), frames, CAMERA, times=[99.95, 100.05, 100.15])


@pytest.mark.parametrize("size", ["inf 6", "8.5 6", "nan 6", "8", "8 6 1"])
def test_arkitscenes_with_a_calibration_that_is_none(tmp_path, frames, size):
    write_arkitscenes(tmp_path, frames)
    file = tmp_path / "lowres_wide_intrinsics" / "41048190_100.050.pincam"
    file.write_text(f"{size} 7.0 7.5 3.5 2.5\n")
    with pytest.raises(ValueError, match=r"100\.050\.pincam: expected one line, width height fx fy cx cy"):
        rp.open_sequence(tmp_path)
    file.rename(file.with_name("41048190_nan.pincam"))
    with pytest.raises(ValueError, match=r"nan\.pincam: expected a name such as 41048190_3414\.453\.pincam"):
        rp.open_sequence(tmp_path)


def test_names_of_one_number_have_one_order_whatever_the_disk_says(tmp_path):
    paths = [tmp_path / name for name in ("007.png", "07.png", "7.png", "8.png", "10.png")]
    for given in (paths, paths[::-1]):
        assert numbered(given) == paths


def test_names_and_marks_of_other_systems(tmp_path, frames):
    """Digits that are no numbers, a byte order mark, Windows' ends of lines, files elsewhere."""
    for name, frame in zip(("1².png", "1²2.png", "é 1.png"), frames, strict=True):
        images.write_png(tmp_path / name, frame)
    sequence = rp.open_sequence(tmp_path, CAMERA)
    assert sorted(sequence.names) == ["1².png", "1²2.png", "é 1.png"]
    elsewhere = tmp_path / "é 1.png"
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "depth.txt").write_text(
        f"# times\r\n2 {elsewhere} # there\r\n\r\n1 ../1².png\r\n3 a b#3.png\r\n", encoding="utf-8-sig"
    )
    images.write_png(folder / "a b#3.png", frames[1])
    there = sequences.folder(folder, CAMERA, allow_outside=True)
    same(there, frames[[2, 0, 1]], CAMERA, times=[2.0, 1.0, 3.0])
    assert there.names == (elsewhere.as_posix(), "../1².png", "a b#3.png")
    write_arkitscenes(tmp_path / "scan", frames)
    for file in (tmp_path / "scan" / "lowres_wide_intrinsics").iterdir():
        file.write_text(file.read_text(), encoding="utf-8-sig")
    assert rp.open_sequence(tmp_path / "scan").camera == CAMERA


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
@pytest.mark.parametrize("suffix", ["sens", "bag", "mkv"])
def test_a_pipe_is_no_recording(tmp_path, suffix):
    for library in {"bag": ["rosbags"], "mkv": ["av"]}.get(suffix, []):
        pytest.importorskip(library)
    os.mkfifo(tmp_path / f"a.{suffix}")
    with pytest.raises(ValueError, match="expected a file, got a device or a pipe"):
        {"sens": sequences.scannet_sens, "bag": sequences.rosbag, "mkv": sequences.mkv}[suffix](
            tmp_path / f"a.{suffix}"
        )


def test_folder_of_images_needs_a_camera(tmp_path, frames):
    for place in (tmp_path / "flat", tmp_path / "nested" / "depth"):
        place.mkdir(parents=True)
        for name, frame in zip(("f9.png", "f10.npy", "f100.npy"), frames, strict=True):
            images.write_png(place / name, frame) if name == "f9.png" else np.save(place / name, frame)
        (place / "notes.txt").touch()
    with pytest.raises(ValueError, match="of no known format"):
        rp.open_sequence(tmp_path / "flat")
    with pytest.raises(ValueError, match=r"expected a camera, or its file camera\.json"):
        sequences.folder(tmp_path / "flat")
    same(rp.open_sequence(tmp_path / "flat", CAMERA), frames, CAMERA, ["f9.png", "f10.npy", "f100.npy"])
    CAMERA.save(tmp_path / "nested" / "camera.json")
    same(rp.open_sequence(tmp_path / "nested"), frames, CAMERA)
    (tmp_path / "nested" / "depth.txt").write_text("0.5 depth/f10.npy\n1.5 depth/f9.png\n")
    times = rp.open_sequence(tmp_path / "nested")
    same(times, frames[[1, 0]], CAMERA, times=[0.5, 1.5])


def test_images_of_colour_beside_those_of_depth_are_none_of_the_sequence(tmp_path, frames):
    for i, depth in enumerate(frames):
        images.write_png(tmp_path / f"{i}-color.png", np.full(depth.shape, 200, np.uint8))
        images.write_png(tmp_path / f"{i}-Depth.png", depth)
    sequence = rp.open_sequence(tmp_path, CAMERA)
    assert list(sequence.names) == [f"{i}-Depth.png" for i in range(len(frames))]
    for frame, depth in zip(sequence, frames, strict=True):
        np.testing.assert_array_equal(frame.depth, depth)


def test_a_folder_that_may_not_be_read_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *arguments: False)
    for open_one in (rp.open_sequence, sequences.tum, sequences.folder):
        with pytest.raises(PermissionError, match=f"^{re.escape(str(tmp_path))}: permission denied$"):
            open_one(tmp_path)


def test_of_no_frames_no_camera_is_known(frames):
    with pytest.raises(IndexError, match="expected at least one frame"):
        _ = FrameSequence([], frames.__getitem__).camera


def test_a_reader_without_a_frame_is_not_the_end_of_a_loop(frames):
    entries = [FrameEntry(str(i), math.nan, CAMERA, i) for i in range(len(frames) + 2)]
    with pytest.raises(IndexError, match="out of bounds"):
        list(FrameSequence(entries, frames.__getitem__))


def test_a_frame_that_is_a_link_to_nowhere_keeps_its_place(tmp_path, frames, link):
    for i in (0, 2):
        images.write_png(tmp_path / f"{i}.png", frames[i])
    link(tmp_path / "1.png", "gone.png")
    (tmp_path / "3.png").mkdir()
    sequence = sequences.folder(tmp_path, CAMERA)
    assert sequence.names == ("0.png", "1.png", "2.png")
    with pytest.raises(FileNotFoundError, match=r"1\.png: there is no such file"):
        sequence[1]
    np.testing.assert_array_equal(sequence[2].depth, frames[2])


def test_hidden_files_are_no_frames(tmp_path, frames):
    """Such as macOS leaves beside each file on disks of other systems."""
    for i, frame in enumerate(frames):
        images.write_png(tmp_path / f"{i}.png", frame)
    write_arkitscenes(tmp_path / "scan", frames)
    for file in list(tmp_path.glob("**/*.p*")):
        file.with_name(f"._{file.name}").write_bytes(b"\0\5\x16\7")
    same(sequences.folder(tmp_path, CAMERA), frames, CAMERA, ["0.png", "1.png", "2.png"])
    assert len(sequences.arkitscenes(tmp_path / "scan")) == 3
    (tmp_path / "scan").rename(tmp_path / "icl")
    (tmp_path / "icl" / "lowres_depth").rename(tmp_path / "icl" / "depth")
    assert len(sequences.icl_nuim(tmp_path / "icl")) == 3
    assert len(sequences.scannet(tmp_path / "icl", CAMERA)) == 3


def test_open_sequence_says_what_is_wrong(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such file or folder"):
        rp.open_sequence(tmp_path / "gone")
    (tmp_path / "x.mp4").touch()
    with pytest.raises(ValueError, match=r"expected a folder, or a \.sens"):
        rp.open_sequence(tmp_path / "x.mp4")
    with pytest.raises(ValueError, match="format must be one of arkitscenes"):
        rp.open_sequence(tmp_path, format="kitti")
    for name in ("icl_nuim", "seven_scenes", "scannet", "arkitscenes"):
        with pytest.raises(ValueError, match="found none"):
            rp.open_sequence(tmp_path, format=name)
    with pytest.raises(ValueError, match="found none"):
        rp.open_sequence(tmp_path, CAMERA)
    for i in range(9):
        (tmp_path / f"frame-{i}.color.png").touch()
    with pytest.raises(
        ValueError, match=r"expected .*frame-\*\.depth\.png \(seven_scenes\).*, found frame-0\.color"
    ) as e:
        rp.open_sequence(tmp_path)
    assert "frame-4.color.png and 5 more; for" in str(e.value)
    with pytest.raises(NotADirectoryError, match="expected a folder"):
        sequences.tum(tmp_path / "x.mp4")


RAW = rp.Camera(8, 6, 7.0, 7.5, 3.5, 2.5, distortion=(0.01, 0, 0, 0, 0), depth_scale=1000.0)
RECTIFIED = rp.Camera(8, 6, 7.1, 7.6, 3.5, 2.5, depth_scale=1000.0)


@pytest.mark.parametrize("name", ["ros1.bag", "ros2", "ros2_humble", "mcap"])
def test_rosbag_frames_come_with_camera_info_and_stamps(tmp_path, frames, name):
    pytest.importorskip("rosbags")
    path = tmp_path / name
    store, _ = type_store(path)
    depth, info = messages(store, frames, padding=6)
    metres, _ = messages(store, [(frame / 1000).astype(np.float32) for frame in frames], "32FC1", big_endian=True)
    infrared, _ = messages(store, frames, "mono16")
    times = [5_000_000_000, 6_000_000_000, 6_000_000_000]  # two recorded at once, the last one not stamped
    write_bag(
        path,
        {
            "/camera/depth/image_raw": list(zip(times, depth, strict=True)),
            "/camera/depth/camera_info": [(times[0], info)],
            "/other/depth/image_rect": list(zip(times, metres, strict=True)),
            "/other/depth/camera_info": [(times[0], info)],
            "/direct/depth/image_raw": list(zip(times, depth, strict=True)),
            "/direct/depth/camera_info": [(times[0], info)],
            "/camera/infra/image_raw": list(zip(times, infrared, strict=True)),
        },
    )
    with pytest.raises(ValueError, match="depth is in /camera/depth/image_raw, /direct/depth/image_raw, /other"):
        rp.open_sequence(path)
    with pytest.raises(ValueError, match="got the topic '/x'; depth is in /camera"):
        sequences.rosbag(path, topic="/x")
    seconds = [100.5, 101.5, 6.0]
    for topic in ("/camera/depth/image_raw", "/direct/depth/image_raw"):
        same(sequences.rosbag(path, topic=topic), frames, RAW, times=seconds)
    same(
        sequences.rosbag(path, topic="/other/depth/image_rect"),
        (frames / 1000).astype(np.float32), RECTIFIED, times=seconds,
    )  # fmt: skip
    if name != "ros1.bag":  # the file inside the folder, too
        inside = next(file for file in path.iterdir() if file.suffix in (".db3", ".mcap"))
        same(sequences.rosbag(inside, CAMERA, "/camera/depth/image_raw"), frames, CAMERA, times=seconds)


@pytest.mark.parametrize(
    ("is2", "content"),
    [
        (False, struct.pack("<III", 7, 100, 500_000_000)),
        (True, b"\x00\x01\x00\x00" + struct.pack("<II", 100, 500_000_000)),
        (True, b"\x00\x00\x00\x00" + struct.pack(">II", 100, 500_000_000)),
    ],
    ids=["ROS 1", "little-endian", "big-endian"],
)
def test_the_stamp_of_a_message_is_in_its_own_byte_order(is2, content):
    bag = SimpleNamespace(path=Path("a.bag"), is_ros1=not is2)
    assert _OpenBag._stamp(bag, content) == 100.5


@pytest.mark.parametrize("name", ["ros1.bag", "ros2", "mcap"])
def test_a_rosbag_in_the_place_of_another(tmp_path, frames, name):
    pytest.importorskip("rosbags")
    for i, these in enumerate((frames, frames[::-1])):
        depth, _ = messages(type_store(tmp_path / name)[0], these)
        (tmp_path / f"{i}").mkdir()
        write_bag(tmp_path / f"{i}" / name, {"/depth": [(5, depth[0])]})
        if (tmp_path / name).is_dir():
            (tmp_path / name).rename(tmp_path / "earlier")
        (tmp_path / f"{i}" / name).replace(tmp_path / name)
        assert np.array_equal(rp.open_sequence(tmp_path / name, CAMERA)[0].depth, these[0])


@pytest.mark.parametrize("name", ["ros1.bag", "mcap"])
def test_a_rosbag_is_closed_at_the_end_of_the_process(tmp_path, frames, name):
    pytest.importorskip("rosbags")
    depth, _ = messages(type_store(tmp_path / name)[0], frames)
    write_bag(tmp_path / name, {"/depth": [(5, depth[0])]})
    program = (
        "import sys, rgbd_planes as rp;"
        "camera = rp.Camera(8, 6, 7.0, 7.5, 3.5, 2.5, depth_scale=1000.0);"
        "rp.open_sequence(sys.argv[1], camera)[0]"
    )
    command = [sys.executable, "-W", "always::ResourceWarning", "-c", program, tmp_path / name]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")


def test_rosbag_of_any_topic_that_can_be_read(tmp_path, frames):
    """Grey of 16 bits may be infrared, where nobody says that it is depth."""
    pytest.importorskip("rosbags")
    path = tmp_path / "a.bag"
    grey, _ = messages(type_store(path)[0], frames, "mono16")
    write_bag(path, {"/stereo/range": [(i + 1, message) for i, message in enumerate(grey)]})
    with pytest.raises(ValueError, match="expected the topic of depth images; depth is in none; there is /ste"):
        rp.open_sequence(path, CAMERA)
    same(sequences.rosbag(path, CAMERA, "/stereo/range"), frames, CAMERA, times=[100.5, 101.5, 3e-9])


@pytest.mark.parametrize("name", ["ros1.bag", "ros2"])
def test_rosbag_of_compressed_depth(tmp_path, frames, name):
    pytest.importorskip("rosbags")
    path = tmp_path / name
    store, _ = type_store(path)
    frames = frames.copy()
    frames[:, 2:5, 3:9] = 0  # which floats have as NaN, and the formula of others as some depth
    plain, info = messages(store, frames)
    compressed = []
    for kind, quantisation in (("16UC1", (0.0, 0.0)), ("32FC1", (6000.0, -20.0))):
        made = []
        for message, frame in zip(plain, frames, strict=True):
            png = io.BytesIO()
            Image.fromarray(frame).save(png, "PNG")
            content = np.frombuffer(struct.pack("<iff", 0, *quantisation) + png.getvalue(), np.uint8)
            text = f"{kind}; compressedDepth png"
            made.append(store.types["sensor_msgs/msg/CompressedImage"](message.header, text, content))
        compressed.append(made)
    times = [1_000_000_000 * i for i in range(1, 4)]
    write_bag(
        path,
        {
            "/cam/image_raw/compressedDepth": list(zip(times, compressed[0], strict=True)),
            "/cam/metres/compressedDepth": list(zip(times, compressed[1], strict=True)),
            "/cam/camera_info": [(1_000_000_000, info)],
        },
    )
    seconds = [100.5, 101.5, 3.0]
    same(sequences.rosbag(path, topic="/cam/image_raw/compressedDepth"), frames, RAW, times=seconds)
    expected = np.where(frames == 0, np.nan, 6000 / (frames.astype(np.float64) + 20))
    sequence = sequences.rosbag(path, topic="/cam/metres/compressedDepth")
    for frame, metres in zip(sequence, expected, strict=True):
        assert frame.depth.dtype == np.float32
        np.testing.assert_allclose(frame.depth, metres, rtol=1e-6)


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
def test_a_compressed_image_with_more_pixels_than_its_bytes_can_hold_is_damaged():
    head = b"IHDR" + struct.pack(">IIBBBBB", 8, 4_000_000, 16, 0, 0, 0, 0)
    png = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + head + struct.pack(">I", zlib.crc32(head))
    message = SimpleNamespace(
        format="16UC1; compressedDepth png", data=bytes(12) + png + struct.pack(">I", 9) + b"IDAT"
    )
    with pytest.raises(ValueError, match=r"^damaged compressed image \(\d+ bytes for 8 x 4000000 pixels\)$"):
        _decode_compressed(message)


def test_rosbag_of_a_realsense(tmp_path, frames):
    pytest.importorskip("rosbags")
    path = tmp_path / "d405.bag"
    store, _ = type_store(path)
    depth, info = messages(store, frames, "mono16")
    infrared, _ = messages(store, frames, "mono16")
    info.distortion_model, info.D = "Brown Conrady", np.zeros(5)
    sensor = "/device_0/sensor_0"
    write_bag(
        path,
        {
            f"{sensor}/Depth_0/image/data": [(i + 1, message) for i, message in enumerate(depth)],
            f"{sensor}/Depth_0/info/camera_info": [(1, info)],
            f"{sensor}/Infrared_1/image/data": [(i + 1, message) for i, message in enumerate(infrared)],
            f"{sensor}/option/Depth_Units/value": [(1, store.types["std_msgs/msg/Float32"](1e-4))],
        },
    )
    camera = rp.Camera(8, 6, 7.0, 7.5, 3.5, 2.5, depth_scale=10000.0)
    same(rp.open_sequence(path), frames, camera, times=[100.5, 101.5, 3e-9])
    zero = store.types["std_msgs/msg/Float32"](0.0)
    topics = {f"{sensor}/Depth_0/image/data": [(1, depth[0])], f"{sensor}/Depth_0/info/camera_info": [(1, info)]}
    write_bag(tmp_path / "b.bag", topics | {f"{sensor}/option/Depth_Units/value": [(1, zero)]})
    with pytest.raises(ValueError, match=r"b\.bag: expected depth_units > 0"):
        rp.open_sequence(tmp_path / "b.bag")


def test_rosbag_says_what_is_wrong(tmp_path, frames, monkeypatch):
    pytest.importorskip("rosbags")
    path = tmp_path / "a.bag"
    store, _ = type_store(path)
    depth, info = messages(store, frames)
    colour, _ = messages(store, frames, "bgr8")
    depth[1].data = depth[1].data[:20]
    depth[2].step = 14  # of which a row has 16
    write_bag(path, {"/depth": [(i + 1, message) for i, message in enumerate(depth)]})
    with pytest.raises(ValueError, match="expected a CameraInfo beside /depth, or a camera; there is none"):
        rp.open_sequence(path)
    sequence = rp.open_sequence(path, CAMERA)
    assert np.array_equal(sequence[0].depth, frames[0])
    with pytest.raises(ValueError, match=r"a\.bag: /depth: truncated image: 20 bytes for 6 rows of 16 bytes"):
        sequence[1]
    with pytest.raises(ValueError, match=r"truncated image: 96 bytes for 6 rows of 14 bytes, 8 pixels"):
        sequence[2]
    write_bag(tmp_path / "b.bag", {"/colour": [(1, colour[0])], "/camera_info": [(1, info)]})
    with pytest.raises(
        ValueError, match=r"depth is in none; there is .*/colour \(sensor_msgs/msg/Image, bgr8, which is not read\)"
    ):
        rp.open_sequence(tmp_path / "b.bag")
    with pytest.raises(FileNotFoundError, match=r"gone\.bag: there is no such file"):
        sequences.rosbag(tmp_path / "gone.bag")
    with pytest.raises(ValueError, match=r"expected a ROS bag, a file or a folder with metadata\.yaml"):
        sequences.rosbag(tmp_path)
    for content in (b"", b"#ROSBAG V2.0\n", path.read_bytes()[:2000]):
        (tmp_path / "c.bag").write_bytes(content)
        with pytest.raises(ValueError, match=r"c\.bag: not a ROS bag, or damaged"):
            rp.open_sequence(tmp_path / "c.bag")
    # What its own library stumbles over, or would ask for memory for, is said with the file, too.
    depth2, info2 = messages(type_store(tmp_path / "two")[0], frames)
    write_bag(tmp_path / "two", {"/depth": [(1, depth2[0])], "/camera_info": [(1, info2)]})
    for file, content in (
        ("metadata.yaml", b"\xff\xfe"),
        ("two.db3", (tmp_path / "two" / "two.db3").read_bytes()[:5000] + b"\xff" * 3000),
    ):
        whole = (tmp_path / "two" / file).read_bytes()
        (tmp_path / "two" / file).write_bytes(content)
        with pytest.raises(ValueError, match="two: not a ROS bag, or damaged"):
            rp.open_sequence(tmp_path / "two")
        (tmp_path / "two" / file).write_bytes(whole)
    monkeypatch.setitem(__import__("sys").modules, "rosbags", None)
    with pytest.raises(ModuleNotFoundError, match=r'this needs rosbags: pip install "rgbd-planes\[ros\]"'):
        rp.open_sequence(path, CAMERA)


@pytest.mark.parametrize("name", ["a.bag", "ros2", "mcap"])
def test_what_a_rosbag_has_besides_may_be_damaged(tmp_path, frames, name, monkeypatch):
    """Definitions of other messages, colour images, and the first of the depth images."""
    pytest.importorskip("rosbags")
    path = tmp_path / name
    store, _ = type_store(path)
    depth, info = messages(store, frames)
    odd = store.types["std_msgs/msg/Float32"](1.0)
    define, kind = type(store).generate_msgdef, odd.__msgtype__

    def otherwise(self, typename, *arguments, **options):
        text, digest = define(self, typename, *arguments, **options)
        return (text.replace("float32 data", "my_msgs/Odd data"), "0" * 32) if typename == kind else (text, digest)

    monkeypatch.setattr(type(store), "generate_msgdef", otherwise)
    write_bag(path, {
        "/camera/depth/image_raw": [(i + 1, message) for i, message in enumerate([Cut(depth[0]), *depth[1:]])],
        "/camera/depth/camera_info": [(1, info)],
        "/camera/color/image_raw": [(1, Cut(depth[0]))],
        "/odd": [(1, odd)],
    })  # fmt: skip
    monkeypatch.undo()
    sequence = rp.open_sequence(path)
    assert sequence.camera == RAW
    assert np.array_equal(sequence[1].depth, frames[1])
    with pytest.raises(ValueError, match="not a ROS bag, or damaged"):
        sequence[0]


@pytest.mark.parametrize(
    ("name", "tool"), [("a.bag", "rosbag reindex"), ("mcap", "mcap recover"), ("db3", r"sqlite3's \.recover")]
)
def test_a_rosbag_that_was_cut_off_says_what_saves_it(tmp_path, frames, name, tool):
    pytest.importorskip("rosbags")
    path = tmp_path / name
    depth, info = messages(type_store(path)[0], frames)
    write_bag(path, {"/depth": [(i, message) for i, message in enumerate(depth)], "/camera_info": [(0, info)]})
    file = path if path.is_file() else next(file for file in path.iterdir() if file.suffix in (".mcap", ".db3"))
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 2 // 3])
    for place in (path, file):
        with pytest.raises(ValueError, match=rf"{place.name}: not .*; if the recording was cut off, {tool} saves"):
            rp.open_sequence(place)
    if path.is_dir():
        (path / "metadata.yaml").unlink()
        with pytest.raises(ValueError, match=r"metadata\.yaml, found none; ros2 bag reindex makes one"):
            rp.open_sequence(path)
    else:
        with pytest.raises(ValueError, match=r"a\.bag\.active: a ROS bag that was not closed: rosbag reindex mends it"):
            rp.open_sequence(path.rename(tmp_path / "a.bag.active"))


@pytest.mark.skipif(not real_data.sets(), reason=real_data.REASON)
def test_every_real_set_is_a_folder():
    for root in real_data.sets():
        about = json.loads((root / "camera.json").read_text())
        if about["depth_scale"] is None and about["disparity"] is None:
            continue  # its depth is relative
        sequence = rp.open_sequence(root)
        assert sequence.camera == rp.Camera.load(root / "camera.json")
        assert len(sequence) == len(list((root / "depth").glob("*.png")))
        assert sequence[-1].depth.shape == sequence.camera.shape


@pytest.mark.skipif(not real_data.sets(), reason=real_data.REASON)
def test_real_frames_in_the_form_of_7_scenes_and_of_the_tum_benchmark(tmp_path, link):
    source = real_data.FOLDER / "kinect1_7scenes_seq" / "depth"
    files = sorted(source.glob("*.png"))[:5]
    for i, file in enumerate(files):
        link(tmp_path / f"frame-{i:06d}.depth.png", file)
    sequence = rp.open_sequence(tmp_path)
    assert sequence.camera == presets.seven_scenes()
    for frame, file in zip(sequence, files, strict=True):
        assert np.array_equal(frame.depth, images.read_depth(file))
    tiles = rp.fit_tiles(sequence[0].depth, sequence.camera, 16)
    assert tiles.fitted.mean() > 0.8

    source = next((real_data.FOLDER / "tum_fr1_distorted" / "depth").glob("*.png"))
    root = tmp_path / "rgbd_dataset_freiburg1_desk"
    root.mkdir()
    link(root / "depth", source.parent)
    (root / "depth.txt").write_text(f"1305031103.027881 depth/{source.name}\n")
    frame = rp.open_sequence(root)[0]
    assert frame.timestamp == 1305031103.027881
    assert rp.fit_tiles(frame.depth, frame.camera).fitted.mean() > 0.5


def test_each_camera_of_a_sequence_gets_the_noise(tmp_path, frames):
    write_arkitscenes(tmp_path, frames)
    plain, noise = rp.open_sequence(tmp_path), rp.noise.kinect_v1()
    noisy = plain.with_noise(noise)
    assert len(noisy.cameras) == len(plain.cameras) == 2
    assert noisy.entries == tuple(replace(e, camera=replace(e.camera, noise=noise)) for e in plain.entries)
    assert noisy.with_noise(None).entries == plain.entries


@pytest.mark.parametrize("name", ["ros1.bag", "mcap"])
def test_rosbag_has_the_nearest_camera_info_of_several(tmp_path, frames, name):
    """Farther up in the tree of names there may be that of another camera."""
    pytest.importorskip("rosbags")
    store, ros1 = type_store(tmp_path / name)
    (depth, *_), info = messages(store, frames)
    _, other = messages(store, frames)
    setattr(other, "K" if ros1 else "k", np.array([9.0, 0, 3.5, 0, 9.5, 2.5, 0, 0, 1]))
    topics = {"/camera/depth/image_raw": depth, "/camera/depth/camera_info": info}
    topics |= {"/camera/camera_info": other, "/camera_info": other}
    write_bag(tmp_path / name, {topic: [(1, message)] for topic, message in topics.items()})
    assert sequences.rosbag(tmp_path / name).camera == RAW


def test_scannet_is_in_the_units_that_it_states(tmp_path, frames):
    write_sens(tmp_path / "a.sens", frames)
    content = (tmp_path / "a.sens").read_bytes()
    stated = struct.pack("<f", 1000.0)
    assert content.count(stated) == 1
    (tmp_path / "a.sens").write_bytes(content.replace(stated, struct.pack("<f", 4000.0)))
    same(
        rp.open_sequence(tmp_path / "a.sens"),
        frames,
        replace(CAMERA, depth_scale=4000.0),
        times=[math.nan, 0.033, 0.066],
    )
    (tmp_path / "frame-000000.depth.pgm").write_bytes(b"P5\n8 6\n65535\n" + frames[0].astype(">u2").tobytes())
    (tmp_path / "_info.txt").write_text(
        "m_depthWidth = 8\nm_depthHeight = 6\nm_depthShift = 4000\n"
        "m_calibrationDepthIntrinsic = 7 0 3.5 0 0 7.5 2.5 0 0 0 1 0 0 0 0 1 \n"
    )
    assert rp.open_sequence(tmp_path).camera == replace(CAMERA, depth_scale=4000.0)


def test_names_may_end_in_capitals(tmp_path, frames):
    write_sens(tmp_path / "A.SENS", frames)
    assert rp.open_sequence(tmp_path / "A.SENS").camera == CAMERA
    Image.fromarray(frames[0]).save(tmp_path / "1.PNG")
    Image.fromarray(frames[1]).save(tmp_path / "2.Tiff")
    with open(tmp_path / "3.NPY", "wb") as file:
        np.save(file, frames[2])
    same(sequences.folder(tmp_path, CAMERA), frames, CAMERA, ["1.PNG", "2.Tiff", "3.NPY"])


def test_a_folder_with_a_camera_file_is_a_plain_folder(tmp_path, frames):
    """Whatever else it looks like."""
    write_tum(tmp_path / "freiburg1", frames)
    CAMERA.save(tmp_path / "freiburg1" / "camera.json")
    assert rp.open_sequence(tmp_path / "freiburg1").camera == CAMERA
    for i, frame in enumerate(frames):
        images.write_png(tmp_path / f"frame-{i:06d}.depth.png", frame)
    (tmp_path / "a.gt.freiburg").touch()
    CAMERA.save(tmp_path / "camera.json")
    same(rp.open_sequence(tmp_path), frames, CAMERA)


def test_commands_read_the_format_topic_and_camera_that_they_are_given(tmp_path, frames):
    root = tmp_path / "freiburg1"
    write_tum(root, frames)
    CAMERA.save(root / "camera.json")
    given = Namespace(camera=None, format="tum", topic=None, allow_outside=False)
    assert read_sequence(given, root).camera == CAMERA  # which stands beside the frames, and not the preset
    assert read_sequence(given, root).timestamps[0] > 1e9
    given = Namespace(camera=root / "camera.json", format="tum", topic=None, allow_outside=False)
    assert read_sequence(given, root).camera == CAMERA
    pytest.importorskip("rosbags")
    bag = tmp_path / "a.bag"
    depth, _ = messages(type_store(bag)[0], frames)
    other, _ = messages(type_store(bag)[0], frames[::-1])
    times = range(1, len(frames) + 1)
    write_bag(bag, {"/a/depth": list(zip(times, depth, strict=True)), "/b/depth": list(zip(times, other, strict=True))})
    for format in (None, "rosbag"):
        given = Namespace(camera=root / "camera.json", format=format, topic="/b/depth")
        same(read_sequence(given, bag), frames[::-1], CAMERA, times=[100.5, 101.5, 3e-9])


@pytest.mark.parametrize("suffix", ["pgm", "png"])
def test_images_of_scannet_are_of_either_kind(tmp_path, frames, suffix):
    """As either tool writes them; colour images beside them have other suffixes."""
    (tmp_path / "python" / "depth").mkdir(parents=True)
    (tmp_path / "cpp").mkdir()
    for i, frame in enumerate(frames):
        for file in (
            tmp_path / "python" / "depth" / f"{i}.{suffix}",
            tmp_path / "cpp" / f"frame-{i:06d}.depth.{suffix}",
        ):
            if suffix == "png":
                images.write_png(file, frame)
            else:
                file.write_bytes(b"P5\n8 6\n65535\n" + frame.astype(">u2").tobytes())
            file.with_suffix(".txt").touch()
    for name in ("python", "cpp"):
        same(sequences.scannet(tmp_path / name, CAMERA), frames, CAMERA)
        with pytest.raises(ValueError, match=r"expected (intrinsic/intrinsic_depth|_info)\.txt, or a camera"):
            sequences.scannet(tmp_path / name)


@pytest.mark.parametrize("other", ["Image", "CameraInfo"])
@pytest.mark.parametrize("name", ["a.bag", "ros2", "mcap"])
def test_a_topic_of_a_type_that_ros_does_not_have_so_is_refused(tmp_path, frames, monkeypatch, name, other):
    """Its bytes would be read as something else. Of a CameraInfo only where it is read."""
    pytest.importorskip("rosbags")
    path, kind = tmp_path / name, f"sensor_msgs/msg/{other}"
    store, _ = type_store(path)
    depth, info = messages(store, frames)
    define, digest_of = type(store).generate_msgdef, type(store).hash_rihs01

    def defined(self, typename, *arguments, **options):
        text, digest = define(self, typename, *arguments, **options)
        return text, "0" * 32 if typename == kind else digest

    def digested(self, typename):
        return "RIHS01_" + "0" * 64 if typename == kind else digest_of(self, typename)

    monkeypatch.setattr(type(store), "generate_msgdef", defined)
    monkeypatch.setattr(type(store), "hash_rihs01", digested)
    write_bag(
        path, {"/depth/image": [(i, message) for i, message in enumerate(depth)], "/depth/camera_info": [(0, info)]}
    )
    monkeypatch.undo()
    topic = "/depth/image" if other == "Image" else "/depth/camera_info"
    with pytest.raises(ValueError, match=rf"{name}: {topic}: expected {kind} as ROS defines it, got another$"):
        rp.open_sequence(path)
    if other == "CameraInfo":
        assert np.array_equal(rp.open_sequence(path, CAMERA)[0].depth, frames[0])


@pytest.mark.parametrize("name", ["ros1.bag", "mcap"])
def test_a_message_that_another_bag_does_not_have_is_gone(tmp_path, frames, name):
    """Where it has taken the place of the one that was opened."""
    pytest.importorskip("rosbags")
    depth, _ = messages(type_store(tmp_path / name)[0], frames)
    for folder, count in (("long", 3), ("short", 2)):
        (tmp_path / folder).mkdir()
        write_bag(tmp_path / folder / name, {"/depth": [(10**9 * (i + 1), depth[i]) for i in range(count)]})
    (tmp_path / "long" / name).rename(tmp_path / name)
    sequence = rp.open_sequence(tmp_path / name, CAMERA)
    assert len(sequence) == 3
    (tmp_path / name).rename(tmp_path / "earlier")
    (tmp_path / "short" / name).rename(tmp_path / name)
    assert np.array_equal(sequence[1].depth, frames[1])
    with pytest.raises(ValueError, match=rf"{name}: the message of 3\.000000 s is gone$"):
        sequence[2]


def test_an_image_of_a_bag_that_is_no_depth(tmp_path, frames):
    """As one of colour among those of depth."""
    with pytest.raises(ValueError, match=r"^expected the encoding 16UC1, mono16, 32FC1, got 'bgr8'$"):
        _decode(SimpleNamespace(encoding="bgr8"))
    png = io.BytesIO()
    Image.fromarray(np.zeros((6, 8, 3), np.uint8)).save(png, "PNG")
    colour = bytes(12) + png.getvalue()
    for format, data, message in (
        ("8UC1; compressedDepth png", colour, "expected depth compressed as PNG or RVL, 16UC1 or 32FC1, got '8U"),
        ("16UC1; compressedDepth RVL", colour, r"expected at most \d+ pixels"),
        ("16UC1; compressedDepth png", colour, r"expected a depth image of one channel, got shape \(6, 8, 3\)"),
        ("16UC1; compressedDepth png", colour[:5], "damaged compressed image"),
    ):
        with pytest.raises(ValueError, match=f"^{message}"):
            _decode_compressed(SimpleNamespace(format=format, data=data))


def test_of_no_frames_a_sequence_says_so(frames):
    assert repr(FrameSequence([], frames.__getitem__)) == "<FrameSequence: no frames>"


def test_the_name_of_a_frame_is_left_out_of_its_reason_but_not_half_of_another():
    for words, reason in (
        ("/data/1.png: truncated", "truncated"),
        ("1.png: truncated", "truncated"),
        ("/data/11.png: truncated", "/data/11.png: truncated"),
        ("1.png: ", "1.png: "),
    ):
        assert reason_to_skip(ValueError(words), "1.png").strip() == reason.strip()
