"""Depth in bags: PNG, RVL, disparities, CameraInfo with one matrix, and what is not read, by its name."""

import io
import struct

import numpy as np
import pytest

pytest.importorskip("rosbags")
from bags import messages, type_store, write_bag
from PIL import Image

import rgbd_planes as rp
from rgbd_planes import sequences
from rgbd_planes.sequences.contents import rvl


@pytest.fixture
def frames(rng):
    made = rng.integers(500, 65535, (3, 6, 8)).astype(np.uint16)
    made[:, 2, 3:6] = 0
    return made


def encoded(frame):
    """RVL by its definition, number for number."""
    halves = []

    def add(value):
        while True:
            half = value & 7
            value >>= 3
            halves.append(half | (8 if value else 0))
            if not value:
                return

    pixels, at, previous = [int(value) for value in frame.ravel()], 0, 0
    while at < len(pixels):
        zeros = 0
        while at < len(pixels) and pixels[at] == 0:
            zeros, at = zeros + 1, at + 1
        run = []
        while at < len(pixels) and pixels[at] != 0:
            run.append(pixels[at])
            at += 1
        add(zeros)
        add(len(run))
        for value in run:
            delta, previous = value - previous, value
            add((delta << 1) ^ (delta >> 63))
    halves += [0] * (-len(halves) % 8)
    words = [sum(half << (28 - 4 * i) for i, half in enumerate(halves[k : k + 8])) for k in range(0, len(halves), 8)]
    return struct.pack(f"<{len(words)}I", *words)


def compressed(store, like, content, form):
    kind = store.types["sensor_msgs/msg/CompressedImage"]
    return kind(header=like.header, format=form, data=np.frombuffer(content, np.uint8))


def png(frame):
    stream = io.BytesIO()
    Image.fromarray(frame).save(stream, format="PNG")
    return stream.getvalue()


@pytest.mark.parametrize("name", ["a.bag", "ros2"])
@pytest.mark.parametrize("kind", ["png", "rvl"])
def test_compressed_depth(tmp_path, frames, name, kind):
    store, _ = type_store(tmp_path / name)
    images, info = messages(store, frames)
    topic = "/depth/image_raw/compressed" + ("Depth" if kind == "rvl" else "")
    made = []
    for frame, image in zip(frames, images, strict=True):
        if kind == "png":
            made.append(compressed(store, image, png(frame), "16UC1; png compressed "))
        else:
            content = struct.pack("<iffII", 0, 0.0, 0.0, 8, 6) + encoded(frame)
            made.append(compressed(store, image, content, "16UC1; compressedDepth rvl"))
    timed = [(i + 1, message) for i, message in enumerate(made)]
    write_bag(tmp_path / name, {topic: timed, "/depth/camera_info": [(1, info)]})
    sequence = rp.open_sequence(tmp_path / name)
    np.testing.assert_array_equal([frame.depth for frame in sequence], frames)
    assert sequence.camera.fx == 7.0


def test_rvl_of_any_image(rng):
    for frame in (np.zeros((4, 5), np.uint16), np.full((4, 5), 65535, np.uint16), rng.integers(0, 3, (30, 40))):
        np.testing.assert_array_equal(rvl.decode(encoded(frame), frame.size), frame.ravel())
    content = encoded(rng.integers(0, 3, (30, 40)))
    for damaged in (b"", content[:8], b"\xff" * 40, content[:-4]):
        with pytest.raises(ValueError, match="RVL image"):
            rvl.decode(damaged, 1200)


@pytest.mark.parametrize("name", ["a.bag", "ros2"])
def test_disparity_images(tmp_path, rng, name):
    store, ros1 = type_store(tmp_path / name)
    disparity = rng.uniform(1, 30, (3, 6, 8)).astype(np.float32)
    disparity[:, 0, 0] = -1.0
    images, info = messages(store, disparity, encoding="32FC1")
    region = store.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    made = [
        store.types["stereo_msgs/msg/DisparityImage"](
            header=image.header, image=image, f=7.1, valid_window=region, min_disparity=0.0, max_disparity=64.0,
            delta_d=0.125, **{"T" if ros1 else "t": 0.12},
        )
        for image in images
    ]  # fmt: skip
    timed = [(i + 1, message) for i, message in enumerate(made)]
    write_bag(tmp_path / name, {"/stereo/disparity": timed, "/stereo/left/camera_info": [(1, info)]})
    sequence = rp.open_sequence(tmp_path / name)
    frame = sequence[0]
    assert (frame.camera.fx, frame.camera.is_distorted) == (7.1, False)  # the rectified one
    expected = np.where(disparity[0] > 0, 7.1 * 0.12 / disparity[0], np.nan)
    np.testing.assert_allclose(frame.camera.points(frame.depth)[..., 2], expected, rtol=1e-5)


def test_encodings_that_are_not_read_are_named_at_opening(tmp_path, frames):
    store, _ = type_store(tmp_path / "a.bag")
    images, info = messages(store, frames)
    jpeg = [compressed(store, image, b"\xff\xd8", "bgr8; jpeg compressed bgr8") for image in images]
    grey, _ = messages(store, frames.astype(np.uint8), encoding="mono8")
    topics = {"/colour": [(1, jpeg[0])], "/infrared": [(2, grey[0])], "/camera_info": [(1, info)]}
    write_bag(tmp_path / "a.bag", topics)
    with pytest.raises(
        ValueError, match=r"depth is in none; there is .*jpeg compressed bgr8, which is not read.*mono8"
    ):
        rp.open_sequence(tmp_path / "a.bag")


@pytest.mark.parametrize("empty", ["k", "p"])
def test_a_camera_info_with_one_matrix(tmp_path, frames, empty):
    store, _ = type_store(tmp_path / "ros2")
    images, info = messages(store, frames)
    setattr(info, empty, np.zeros_like(getattr(info, empty)))
    topic = "/oak/depth/image_rect" if empty == "p" else "/oak/depth/image_raw"
    write_bag(tmp_path / "ros2", {topic: [(1, images[0])], "/oak/depth/camera_info": [(1, info)]})
    assert rp.open_sequence(tmp_path / "ros2").camera.fx == (7.1 if empty == "k" else 7.0)
    assert sequences.rosbag(tmp_path / "ros2", rectified=empty == "k").camera.fx == (7.1 if empty == "k" else 7.0)
    with pytest.raises(ValueError, match="is there: rectified="):
        sequences.rosbag(tmp_path / "ros2", rectified=empty == "p")
