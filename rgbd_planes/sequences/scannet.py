"""ScanNet: frames as its tools export them, and its .sens recordings."""

import math
import os
import struct
import zlib
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.files import check_pixels, existing_file, naming, text_of
from rgbd_planes._core.text import shown
from rgbd_planes.camera.calibrations.formats import from_sensor_info
from rgbd_planes.camera.camera import Camera
from rgbd_planes.sequences.contents.calibration import camera_of_matrix
from rgbd_planes.sequences.frames import FrameEntry, FrameSequence, existing_folder, image_sequence, numbered, some
from rgbd_planes.sequences.poses import beside, motion_of_numbers, poses_of_files

_ABOUT_FRAME = struct.Struct("<16fQQQQ")  # its pose, two stamps, the sizes of colour and depth
_MOST_ADDED = 1 << 16  # bytes that compression adds to a frame at worst
_SIZE = 640, 480  # of the depth that intrinsic_depth.txt is of, in all scenes
_COMPRESSIONS = {0: "raw_ushort", 1: "zlib_ushort", 2: "occi_ushort"}


def scannet(path: str | os.PathLike[str], camera: Camera | None = None) -> FrameSequence:
    """Open the exported frames of a ScanNet scene (Dai et al. 2017).

    Parameters
    ----------
    path : folder
        With ``depth/N.png`` (or .pgm) and ``intrinsic/intrinsic_depth.txt``, as its Python exporter writes
        them, or ``frame-NNNNNN.depth.pgm`` (or .png) and ``_info.txt``, as its C++ one does.
    camera : Camera, optional
        Instead of the one in these files, which is resized with the depth where that is smaller than ScanNet's own.

    Returns
    -------
    FrameSequence
        Without times: the exporters leave them out; `scannet_sens` has them. With the poses of ``pose/N.txt`` or
        ``frame-NNNNNN.pose.txt``.

    Raises
    ------
    NotADirectoryError, OSError, ValueError
        It is not such a folder, or the file with its camera is missing or damaged.
    """
    root = existing_folder(path)
    files = [file for file in root.glob("frame-*.depth.*") if file.suffix in (".pgm", ".png")]
    if files:
        files = numbered(files)
        poses = poses_of_files(beside(files))
        return image_sequence(files, camera or _camera_of_info(root / "_info.txt"), root, poses=poses)
    files = [file for file in (root / "depth").glob("*") if file.suffix in (".pgm", ".png")]
    files = some(numbered(files), "depth/N.png or frame-NNNNNN.depth.pgm", root)
    poses = poses_of_files(beside(files))
    return image_sequence(files, camera or _camera_of_matrix(root, files), root, poses=poses)


def scannet_sens(path: str | os.PathLike[str], camera: Camera | None = None) -> FrameSequence:
    """Open a ScanNet recording, a .sens file of version 4, without unpacking it.

    Parameters
    ----------
    path : .sens file
        With depth that is raw or compressed by zlib, as ScanNet's is.
    camera : Camera, optional
        Instead of the depth camera of the file.

    Returns
    -------
    FrameSequence
        Seconds on the sensor's clock; NaN for a frame without a stamp. With the file's poses.

    Raises
    ------
    FileNotFoundError, ValueError
        It is not such a file, of another version or compression, or damaged.
    """
    file = existing_file(path).absolute()
    with file.open("rb") as stream:
        try:
            header = _read_header(stream)
            _, size, _ = header.camera
            if camera is not None and (camera.width, camera.height) != size:
                raise ValueError(
                    f"expected depth of the camera's {camera.width} x {camera.height} pixels, got {size[0]} x {size[1]}"
                )
            entries = list(_entries(stream, file, header, camera or _camera(*header.camera)))
        except struct.error:
            raise ValueError(
                f"{shown(path)}: damaged or truncated: {file.stat().st_size} bytes end in the header of a .sens file"
            ) from None
        except ValueError as error:
            raise ValueError(f"{shown(path)}: {error}") from None
    if not entries:
        raise ValueError(f"{shown(path)}: expected depth frames, found none")
    return FrameSequence(entries, read_sens_frame)


class SensLocation(NamedTuple):
    """Where a depth frame is in a .sens file."""

    file: Path
    offset: int
    size: int
    compression: str
    shape: tuple[int, int]


def read_sens_frame(location: SensLocation) -> NDArray[np.uint16]:
    """Read one depth frame of a .sens file, (H, W) uint16."""
    file, offset, size, compression, (height, width) = location
    expected = 2 * height * width
    with file.open("rb") as stream:
        stream.seek(offset)
        content = stream.read(min(size, expected + _MOST_ADDED))  # compressed noise is hardly larger than it was
    if compression == "zlib_ushort":
        try:  # more than a frame's worth need not be unpacked to know that it is wrong
            content = zlib.decompressobj().decompress(content, expected + 1)
        except zlib.error as error:
            raise ValueError(f"{shown(file)}: damaged depth frame at byte {offset} ({error})") from None
    if len(content) != expected:
        raise ValueError(
            f"{shown(file)}: damaged depth frame at byte {offset}: expected {expected} bytes of {width} x {height} "
            f"pixels, got {'more' if len(content) > expected else len(content)}"
        )
    return np.frombuffer(content, "<u2").astype(np.uint16).reshape(height, width)


class _Header(NamedTuple):
    camera: tuple[NDArray[np.float64], tuple[int, int], float]  # as `_camera` takes it
    compression: str
    frames: int


def _read_header(stream: BinaryIO) -> _Header:
    version, name_length = _unpack(stream, "<IQ")
    if version != 4:
        raise ValueError(f"expected a .sens file of version 4, got {version}")
    if name_length > 10_000:
        raise ValueError(f"not a .sens file: a sensor's name of {name_length} bytes")
    _unpack(stream, f"<{name_length}s")
    matrices = np.array(_unpack(stream, "<64f")).reshape(4, 4, 4)  # colour, its pose, depth, its pose
    _, compression = _unpack(stream, "<ii")
    _, _, width, height = _unpack(stream, "<IIII")
    check_pixels(width, height)
    depth_scale, count = _unpack(stream, "<fQ")
    name = _COMPRESSIONS.get(compression, str(compression))
    if name not in ("raw_ushort", "zlib_ushort"):
        raise ValueError(f"expected depth compressed as raw_ushort or zlib_ushort, got {name}")
    return _Header((matrices[2], (width, height), depth_scale), name, count)


def _entries(stream: BinaryIO, file: Path, header: _Header, camera: Camera) -> Any:
    end = file.stat().st_size
    _, (width, height), _ = header.camera
    for i in range(header.frames):
        about = stream.read(_ABOUT_FRAME.size)
        if len(about) == _ABOUT_FRAME.size:
            *matrix, _, microseconds, colour_size, depth_size = _ABOUT_FRAME.unpack(about)
            start = stream.tell() + colour_size
        if len(about) < _ABOUT_FRAME.size or start + depth_size > end:
            raise ValueError(f"truncated: {end} bytes end in frame {i}, expected {header.frames} frames")
        stream.seek(start + depth_size)
        location = SensLocation(file, start, depth_size, header.compression, (height, width))
        time = microseconds * 1e-6 if microseconds else math.nan
        yield FrameEntry(f"{i:06d}", time, camera, location, motion_of_numbers(matrix))


def _unpack(stream: BinaryIO, layout: str) -> tuple[Any, ...]:
    return struct.unpack(layout, stream.read(struct.calcsize(layout)))


def _camera_of_matrix(root: Path, images: list[Path]) -> Camera:
    file = root / "intrinsic" / "intrinsic_depth.txt"
    if not file.is_file():
        raise ValueError(f"{shown(root)}: expected intrinsic/intrinsic_depth.txt, or a camera")
    try:
        matrix = np.array(text_of(file).split(), np.float64).reshape(4, 4)[:3, :3]
    except ValueError:
        raise ValueError(f"{shown(file)}: expected a 4 x 4 matrix") from None
    return camera_of_matrix(matrix, file, images, _SIZE, depth_scale=1000.0)


def _camera_of_info(file: Path) -> Camera:
    if not file.is_file():
        raise ValueError(f"{shown(file.parent)}: expected _info.txt, or a camera")
    text = text_of(file, errors="replace")
    with naming(file):
        return Camera.from_dict(from_sensor_info(text))


def _camera(matrix: NDArray[np.float64], size: tuple[int, int], depth_scale: float) -> Camera:
    return Camera.from_opencv(matrix[:3, :3], None, size, depth_scale=depth_scale)
