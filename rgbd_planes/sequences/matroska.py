"""Matroska recordings of depth, as the Azure Kinect and its successors make them, read by PyAV."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.files import MOST_PIXELS, check_pixels, existing_file, identity, json_of, naming, readable
from rgbd_planes._core.optional_imports import needs
from rgbd_planes._core.text import counted, shown
from rgbd_planes._core.user_warnings import warn_caller
from rgbd_planes.camera.camera import Camera
from rgbd_planes.sequences.frames import FrameEntry, FrameSequence, kept_open

_RECORDING = "a Matroska recording"
_TRACK = "DEPTH"
_EBML, _SEGMENT = bytes.fromhex("1A45DFA3"), bytes.fromhex("18538067")  # the elements of a file, by their names
_CALIBRATION = "calibration.json"
# For each size (width, height) of a depth frame: side in pixels of the whole sensor, a square, and where in it the
# frame begins, as in the Azure Kinect's SDK.
_MODES = {(320, 288): (512, 96, 90), (640, 576): (1024, 192, 180), (512, 512): (512, 0, 0), (1024, 1024): (1024, 0, 0)}


def mkv(path: str | os.PathLike[str], camera: Camera | None = None) -> FrameSequence:
    """Open the depth of a Matroska recording of an Azure Kinect, or of a camera whose recorder writes the same.

    Parameters
    ----------
    path : .mkv file
        With a track of 16-bit grey named DEPTH, or only one such track, uncompressed (b16g) or lossless.
    camera : Camera, optional
        If not given, that of the calibration attached to the recording; depth in millimetres.

    Returns
    -------
    FrameSequence
        Seconds on the recording's clock.

    Raises
    ------
    ModuleNotFoundError
        PyAV is not installed.
    FileNotFoundError
        There is no such file.
    ValueError
        It is not a recording, or damaged; it has no depth, or several tracks of it; it has no calibration.

    Warns
    -----
    UserWarning
        Its end is missing, as after an incomplete copy, and the frames there.
    """
    source = existing_file(path).absolute()
    recording = _OpenRecording(source)
    try:
        camera = camera or recording.camera()
        entries = [
            FrameEntry(f"{i:06d}", seconds, camera, _Location(source, time))
            for i, (seconds, time) in enumerate(recording.times())
        ]
    finally:
        recording.close()
    if not entries:
        raise ValueError(f"{shown(path)}: expected depth frames, found none")
    if missing := _missing_bytes(source):
        left = counted(len(entries), "frame")
        warn_caller(
            f"{shown(path)}: the recording lacks its last {counted(missing, 'byte')}: its first {left} can be read"
        )
    return FrameSequence(entries, _read_frame)


def _missing_bytes(path: Path) -> int:
    """How much shorter a file is than its header says; 0 if that does not tell."""
    with path.open("rb") as file:
        end = 0
        for name in (_EBML, _SEGMENT):  # the second element holds all but the first
            file.seek(end)
            found, first = file.read(4), file.read(1)
            if found != name or not first:
                return 0
            length = 9 - first[0].bit_length()  # bytes of the element's size, of which the first bit that is set tells
            size = int.from_bytes(first + file.read(length - 1), "big") & ((1 << 7 * length) - 1)
            end = file.tell() + size
    is_open = size == (1 << 7 * length) - 1  # of a recording that was never closed it is not known
    return 0 if is_open else max(end - path.stat().st_size, 0)


class _Location(NamedTuple):
    """Where a frame is: its time in the units of its track."""

    path: Path
    time: int


class _OpenRecording:
    """A recording that is open for reading."""

    def __init__(self, path: Path) -> None:
        with needs("av", "mkv"):
            import av
        self.path, self.identity = path, identity(path)
        with readable(path, _RECORDING):
            with path.open("rb") as file:
                if file.read(4) != _EBML:
                    raise ValueError("another format")
            # Of that format only: any other might be a list of files and of places in the net.
            self._container = av.open(str(path), format="matroska")
            tracks = [s for s in self._container.streams.video if s.codec_context is not None and s.time_base]
            grey = [s for s in tracks if str(s.codec_context.pix_fmt).startswith("gray16")]
            named = [stream for stream in grey if stream.metadata.get("title") == _TRACK]
        if len(named or grey) != 1:
            self.close()
            raise ValueError(
                f"{shown(path)}: expected a track named {_TRACK}, or one track alone, of 16-bit grey, got {len(grey)}"
            )
        (self._stream,) = named or grey
        with naming(path):
            check_pixels(self._stream.codec_context.width, self._stream.codec_context.height)
        self._stream.codec_context.options = {"max_pixels": str(MOST_PIXELS)}  # frames may differ from the header
        # A forked child would wait for ever for the end of a decoder's threads, which it does not have.
        self._stream.codec_context.thread_count = 1
        assert self._stream.time_base is not None  # it is not None for any of these tracks
        self._unit = self._stream.time_base

    def close(self) -> None:
        self._container.close()

    def __del__(self) -> None:
        with suppress(Exception):  # closed already, or never opened
            self._container.close()

    def camera(self) -> Camera:
        """The depth camera of the attached calibration."""
        with readable(self.path, _RECORDING):
            found = [a.data for a in self._container.streams.attachments if a.name == _CALIBRATION]
        if found:
            size = self._stream.codec_context.width, self._stream.codec_context.height
            return _depth_camera(found[0], size, self.path)
        raise ValueError(f"{shown(self.path)}: expected {_CALIBRATION} attached to the recording, or a camera")

    def times(self) -> list[tuple[float, int]]:
        """(seconds, units of the track) of each frame, in order."""
        with readable(self.path, _RECORDING):
            times = [p.pts for p in self._container.demux(self._stream) if p.pts is not None and p.size]
        return [(float(time * self._unit), time) for time in times]

    def read(self, time: int) -> NDArray[Any]:
        """The frame at a time."""
        with readable(self.path, _RECORDING):
            self._container.seek(time, stream=self._stream)
            for frame in self._container.decode(self._stream):
                if frame.pts == time:
                    return np.asarray(frame.to_ndarray()).astype(np.uint16)
                if frame.pts is not None and frame.pts > time:
                    break
        raise ValueError(f"{shown(self.path)}: the frame of {float(time * self._unit):.6f} s is gone")


_open = kept_open()


def _read_frame(location: _Location) -> NDArray[Any]:
    # A recording stays open in its thread: opening it reads its index.
    recording: _OpenRecording | None = getattr(_open, "recording", None)
    if recording is None or (recording.path, recording.identity) != (location.path, identity(location.path)):
        recording = _open.recording = _OpenRecording(location.path)
    return recording.read(location.time)


def _depth_camera(content: bytes, size: tuple[int, int], path: Path) -> Camera:
    """The camera of an Azure Kinect's calibration, which is for the whole sensor and in units of its sides."""
    if size not in _MODES:
        known = ", ".join(f"{width} x {height}" for width, height in _MODES)
        raise ValueError(f"{shown(path)}: expected depth of {known}, or a camera, got {size[0]} x {size[1]}")
    side, left, top = _MODES[size]
    try:
        cameras = json_of(content.decode("utf-8-sig"))["CalibrationInformation"]["Cameras"]
        (found,) = (one for one in cameras if one["Purpose"] == "CALIBRATION_CameraPurposeDepth")
        values = [float(value) for value in found["Intrinsics"]["ModelParameters"]]
        cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, _, _, p2, p1 = values[:14]
    except (KeyError, OverflowError, RecursionError, TypeError, ValueError) as error:
        raise ValueError(f"{shown(path)}: cannot read the calibration that is attached ({error!r})") from None
    with naming(path):
        return Camera(
            *size,
            fx=side * fx,
            fy=side * fy,
            cx=side * cx - left - 0.5,  # there pixels begin at integers, here they have their centres there
            cy=side * cy - top - 0.5,
            distortion=(k1, k2, p1, p2, k3, k4, k5, k6),
            depth_scale=1000.0,
        )
