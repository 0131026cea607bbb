"""Matroska recordings of depth, made here element by element."""

import json
import sys
import warnings

import numpy as np
import pytest
from matroska import write_recording

import rgbd_planes as rp
from bench import real_data
from rgbd_planes import sequences
from rgbd_planes.cli import main as cli
from rgbd_planes.evaluation import scenes
from rgbd_planes.sequences.matroska import _depth_camera

pytest.importorskip("av")

# cx cy fx fy k1..k6, two that are not used, p2 p1, in sides of the sensor of 1024 x 1024 pixels.
PARAMETERS = [0.51, 0.52, 0.4928, 0.4929, 0.5, -0.02, -0.003, 0.85, 0.08, -0.01, 0, 0, -7e-5, 2e-5, 1.7]


def calibration(purposes=("CALIBRATION_CameraPurposePhotoVideo", "CALIBRATION_CameraPurposeDepth")):
    cameras = [{"Purpose": p, "Intrinsics": {"ModelParameters": PARAMETERS if "Depth" in p else []}} for p in purposes]
    return json.dumps({"CalibrationInformation": {"Cameras": cameras}}).encode()


@pytest.fixture
def frames(rng):
    return rng.integers(0, 65535, (4, 288, 320)).astype(np.uint16)


def timed(frames, first=100_000):
    return [(first + 33_333 * i, frame) for i, frame in enumerate(frames)]


def test_a_recording_of_an_azure_kinect(tmp_path, frames):
    tracks = {"IR": timed(frames[::-1] // 2), "DEPTH": timed(frames)}
    write_recording(tmp_path / "a.mkv", tracks, {"calibration.json": calibration(), "other.txt": b"?"})
    sequence = rp.open_sequence(tmp_path / "a.mkv")
    assert len(sequence) == 4
    for i in (2, 0, 3, 1, 2):
        assert sequence[i].depth.dtype == np.uint16
        assert np.array_equal(sequence[i].depth, frames[i])
    assert sequence.timestamps == pytest.approx([0.1, 0.133333, 0.166666, 0.199999], abs=1e-9)
    camera = sequence.camera
    assert camera.shape == (288, 320)
    # Half the sensor's resolution, of which a part: 96 pixels from the left, 90 from the top.
    assert (camera.fx, camera.fy) == pytest.approx((512 * 0.4928, 512 * 0.4929))
    assert (camera.cx, camera.cy) == pytest.approx((512 * 0.51 - 96 - 0.5, 512 * 0.52 - 90 - 0.5))
    assert camera.distortion == (0.5, -0.02, 2e-5, -7e-5, -0.003, 0.85, 0.08, -0.01)
    assert camera.depth_scale == 1000.0


@pytest.mark.parametrize(
    ("size", "side", "left", "top"),
    [((320, 288), 512, 96, 90), ((640, 576), 1024, 192, 180), ((512, 512), 512, 0, 0), ((1024, 1024), 1024, 0, 0)],
)
def test_each_mode_is_a_part_of_the_sensor_at_its_resolution(tmp_path, size, side, left, top):
    camera = _depth_camera(calibration(), size, tmp_path)
    assert (camera.width, camera.height) == size
    assert (camera.fx, camera.fy) == pytest.approx((side * 0.4928, side * 0.4929))
    assert (camera.cx, camera.cy) == pytest.approx((side * 0.51 - left - 0.5, side * 0.52 - top - 0.5))


def test_the_camera_is_that_of_the_sdk():
    folder = real_data.FOLDER / "azure_kinect_nfov"
    if not folder.is_dir():
        pytest.skip(real_data.REASON)
    content = (folder / "k4a_calibration.json").read_bytes()
    found = _depth_camera(content, (640, 576), folder).to_dict()
    stated = json.loads((folder / "camera.json").read_text())
    for name in ("width", "height", "fx", "fy", "cx", "cy", "distortion", "depth_scale"):
        assert found[name] == pytest.approx(stated[name], rel=1e-6), name


def test_a_recording_is_read_from_another_working_directory(tmp_path, frames, monkeypatch):
    write_recording(tmp_path / "a.mkv", {"DEPTH": timed(frames)}, {"calibration.json": calibration()})
    monkeypatch.chdir(tmp_path)
    sequence = rp.open_sequence("a.mkv")
    monkeypatch.chdir("/")
    assert np.array_equal(sequence[0].depth, frames[0])


def test_one_track_and_a_camera_will_do(tmp_path):
    camera = rp.Camera(80, 60, 65.0, 65.0, 39.5, 29.5, depth_scale=1000.0)
    depth = scenes.room().render(camera).measure(seed=1)
    write_recording(tmp_path / "a.mkv", {"grey": timed([depth])}, {})
    assert np.array_equal(sequences.mkv(tmp_path / "a.mkv", camera)[0].depth, depth)
    with pytest.raises(ValueError, match=r"expected calibration\.json attached to the recording, or a camera"):
        sequences.mkv(tmp_path / "a.mkv")
    pytest.importorskip("pyarrow")
    camera.save(tmp_path / "c.json")
    arguments = ["--camera", str(tmp_path / "c.json"), "--out", str(tmp_path / "out")]
    assert cli.main(["batch", str(tmp_path / "a.mkv"), *arguments]) == 0


def test_what_is_wrong_with_a_recording(tmp_path, frames):
    def error_of(tracks, attached, **options):
        write_recording(tmp_path / "a.mkv", tracks, attached, **options)
        with pytest.raises(ValueError) as caught:  # noqa: PT011 (its words are what this is for)
            rp.open_sequence(tmp_path / "a.mkv")
        return str(caught.value)

    good = {"calibration.json": calibration()}
    two = {"a": timed(frames), "b": timed(frames)}
    assert "expected a track named DEPTH, or one track alone, of 16-bit grey, got 2" in error_of(two, good)
    depth = {"DEPTH": timed(frames)}
    bad = {"calibration.json": calibration(purposes=["CALIBRATION_CameraPurposePhotoVideo"])}
    assert "cannot read the calibration that is attached" in error_of(depth, bad)
    assert "cannot read the calibration" in error_of(depth, {"calibration.json": b"{"})
    deep = {"calibration.json": b"[" * 100_000}
    assert "cannot read the calibration" in error_of(depth, deep)
    odd = {"DEPTH": timed(frames[:, :60, :80])}
    assert "expected depth of 320 x 288, 640 x 576" in error_of(odd, good)
    (tmp_path / "b.mkv").write_bytes(b"nothing" * 100)
    with pytest.raises(ValueError, match=r"b\.mkv: not a Matroska recording, or damaged"):
        rp.open_sequence(tmp_path / "b.mkv")
    with pytest.raises(FileNotFoundError):
        rp.open_sequence(tmp_path / "gone.mkv")
    write_recording(tmp_path / "d.mkv", depth, good)
    whole = (tmp_path / "d.mkv").read_bytes()
    (tmp_path / "d.mkv").write_bytes(whole.replace(b"DEPTH", b"D\xff\xffTH"))
    try:  # a name that is no text: one track alone needs none, but PyAV before 19 stumbles over it
        assert len(rp.open_sequence(tmp_path / "d.mkv")) == len(frames)
    except ValueError as error:
        assert "d.mkv: not a Matroska recording, or damaged" in str(error)  # noqa: PT017
    write_recording(tmp_path / "c.mkv", depth, good)
    (tmp_path / "c.mkv").write_bytes((tmp_path / "c.mkv").read_bytes()[:4000])
    with pytest.raises(ValueError, match=r"c\.mkv: expected depth frames, found none"):
        rp.open_sequence(tmp_path / "c.mkv")


def test_a_recording_that_ends_early_has_the_frames_before(tmp_path, frames):
    write_recording(tmp_path / "a.mkv", {"DEPTH": timed(frames)}, {"calibration.json": calibration()})
    whole = (tmp_path / "a.mkv").read_bytes()
    missing = frames[0].nbytes // 2
    (tmp_path / "a.mkv").write_bytes(whole[:-missing])
    message = rf"a\.mkv: the recording lacks its last {missing} bytes: its first 3 frames can be read"
    with pytest.warns(UserWarning, match=message) as told:
        sequence = rp.open_sequence(tmp_path / "a.mkv")
    assert told[0].filename == __file__
    for frame, expected in zip(sequence, frames[:3], strict=True):
        assert np.array_equal(frame.depth, expected)
    segment = whole.index(bytes.fromhex("18538067")) + 4
    unclosed = whole[:segment] + b"\x01" + 7 * b"\xff" + whole[segment + 8 :]  # by a recorder that was killed
    (tmp_path / "a.mkv").write_bytes(unclosed[:-missing])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(rp.open_sequence(tmp_path / "a.mkv")) == 3


def test_a_recording_in_the_place_of_another(tmp_path, frames):
    for these in (frames, frames[::-1]):
        write_recording(tmp_path / "b.mkv", {"DEPTH": timed(these)}, {"calibration.json": calibration()})
        (tmp_path / "b.mkv").replace(tmp_path / "a.mkv")
        assert np.array_equal(rp.open_sequence(tmp_path / "a.mkv")[0].depth, these[0])


def test_a_frame_that_another_recording_does_not_have_is_gone(tmp_path, frames):
    """Whether there is one later or none."""
    attached = {"calibration.json": calibration()}
    write_recording(tmp_path / "a.mkv", {"DEPTH": timed(frames)}, attached)
    sequence = rp.open_sequence(tmp_path / "a.mkv")
    for left in ([0, 3], [0]):
        write_recording(tmp_path / "b.mkv", {"DEPTH": [timed(frames)[i] for i in left]}, attached)
        (tmp_path / "b.mkv").replace(tmp_path / "a.mkv")
        assert np.array_equal(sequence[0].depth, frames[0])
        with pytest.raises(ValueError, match=r"a\.mkv: the frame of 0\.133333 s is gone$"):
            sequence[1]


def test_without_the_library(tmp_path, monkeypatch):
    (tmp_path / "a.mkv").touch()
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ModuleNotFoundError, match=r'pip install "rgbd-planes\[mkv\]"'):
        rp.open_sequence(tmp_path / "a.mkv")
