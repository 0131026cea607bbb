"""ROS 1 and ROS 2 bags, read by rosbags: no ROS needed. RealSense recordings are ROS 1 bags."""

import atexit
import bz2
import io
import math
import os
import re
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from functools import partial
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.files import TooLargeError, check_pixels, damage, existing_file, identity, naming, readable
from rgbd_planes._core.optional_imports import needs
from rgbd_planes._core.text import shown
from rgbd_planes.camera.calibrations.systems import depth_scale_of
from rgbd_planes.camera.camera import Camera
from rgbd_planes.sequences.contents import rvl
from rgbd_planes.sequences.frames import FrameEntry, FrameSequence, kept_open
from rgbd_planes.sequences.images import check_png_size
from rgbd_planes.sequences.unpacking import check_chunk, check_packed_file, unpacked

_BAG = "a ROS bag"
_IMAGES = "sensor_msgs/msg/Image"
_COMPRESSED = "sensor_msgs/msg/CompressedImage"
_INFOS = "sensor_msgs/msg/CameraInfo"
_DISPARITIES = "stereo_msgs/msg/DisparityImage"
_GREY = "mono16"  # infrared images have it, too
_ENCODINGS = {"16UC1": "u2", _GREY: "u2", "32FC1": "f4"}

_BEFORE_CHUNK = 49  # bytes of an MCAP file, from the record of a chunk to its data, but for the compression's name
_LONGEST_ABOUT = 2**22  # bytes of a metadata.yaml
_TRIED = 10  # messages of a topic, until one is whole

# What saves a recording that was cut off, as by a power cut, by the suffix of its files.
_SAVED_BY = {".bag": "rosbag reindex", ".mcap": "mcap recover", ".db3": "sqlite3's .recover"}


def rosbag(
    path: str | os.PathLike[str], camera: Camera | None = None, topic: str | None = None, rectified: bool | None = None
) -> FrameSequence:
    """Open the depth images of a ROS 1 bag, a ROS 2 bag or a RealSense recording.

    Parameters
    ----------
    path : .bag, .mcap or .db3 file, or folder of a ROS 2 bag
    camera : Camera, optional
        If not given, that of the topic's CameraInfo: the P of a topic named as rectified (``image_rect...``),
        the K and D of any other. ROS has 16-bit depth in millimetres (REP 118); if a RealSense recording states its
        unit, that is used.
    topic : str, optional
        A topic of sensor_msgs/Image (16UC1, mono16, 32FC1), of CompressedImage (PNG, compressedDepth as PNG or RVL) or
        of stereo_msgs/DisparityImage. Needed if a bag has more than one with depth, or one of mono16 without "depth" in
        its name.
    rectified : bool, optional
        Whether the camera is the CameraInfo's P, or its K and D, whatever the topic's name. A matrix that is 0, as some
        drivers leave one of them, is passed over if this is not given.

    Returns
    -------
    FrameSequence
        Timestamps are the messages' stamps in seconds, or the times of recording where they have none.

    Raises
    ------
    ModuleNotFoundError
        rosbags is not installed.
    FileNotFoundError
        There is no such file.
    ValueError
        It is not a bag, or damaged; it has no depth, or several topics of depth; it has no CameraInfo for them.
    """
    source = Path(path).absolute()
    bag = _OpenBag(source)
    try:
        topics = bag.depth_topics()
        named = [name for name, encoding in topics.items() if encoding != _GREY or "depth" in name.lower()]
        if topic is None and len(named) == 1:
            topic = named[0]
        if topic not in topics:
            asked = "expected the topic of depth images" if topic is None else f"got the topic {topic!r}"
            where = (
                f"depth is in {', '.join(map(shown, named))}"
                if named
                else f"depth is in none; there is {bag.contents()}"
            )
            raise ValueError(f"{shown(path)}: {asked}; {where}")
        bag.check_type(topic)
        camera = camera or bag.camera(topic, rectified)
        entries = [
            FrameEntry(f"{i:06d}", seconds, camera, _Location(source, topic, recorded, nth))
            for i, (seconds, recorded, nth) in enumerate(bag.times(topic))
        ]
    finally:
        bag.close()
    return FrameSequence(entries, _read_message)


class _Location(NamedTuple):
    """Where a message is: the `nth` that was recorded at a certain time, in nanoseconds."""

    path: Path
    topic: str
    recorded: int
    nth: int


class _OpenBag:
    """A bag that is open for reading."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.unread: dict[str, str] = {}  # encodings of topics of images that are no depth, or in no known form
        if path.is_dir() and not (path / "metadata.yaml").is_file():
            raise ValueError(
                f"{shown(path)}: expected a ROS bag, a file or a folder with metadata.yaml, found none; "
                "ros2 bag reindex makes one for the files of a recording"
            )
        if path.name.endswith(".bag.active"):
            raise ValueError(
                f"{shown(path)}: a ROS bag that was not closed: rosbag reindex mends it, to be named .bag then"
            )
        if not path.is_dir():
            existing_file(path)
        with needs("rosbags", "ros"):
            from rosbags import rosbag1, rosbag2
            from rosbags.typesys import Stores, get_typestore
        self.identity = identity(path)
        self.is_ros1 = path.suffix == ".bag"
        # Not the definitions of the bag, which those of older ROS 2 lack, and one of which may be damaged: what is read
        # here is the same in all releases.
        self._types = get_typestore(Stores.ROS1_NOETIC if self.is_ros1 else Stores.ROS2_HUMBLE)
        suffixes = {file.suffix for file in (path.iterdir() if path.is_dir() else [path])}
        tool = next((tool for suffix, tool in _SAVED_BY.items() if suffix in suffixes), None)
        remedy = f"; if the recording was cut off, {tool} saves what is there" if tool else ""
        with readable(self.path, _BAG, remedy):
            if not self.is_ros1:
                _check_files(path)
            self._reader: Any = rosbag1.Reader(path) if self.is_ros1 else rosbag2.Reader(path)
            self._reader.open()
            self._limit_unpacking()

    def _limit_unpacking(self) -> None:
        """Have the library unpack chunks up to a limit; itself it has none."""
        self._unpack: Callable[[bytes], bytes] | None = None
        if self.is_ros1:
            from lz4.frame import LZ4FrameDecompressor
            from rosbags.rosbag1.reader import decompressors

            limited = {
                decompressors["bz2"]: partial(unpacked, decompressor=bz2.BZ2Decompressor),
                decompressors["lz4"]: partial(unpacked, decompressor=LZ4FrameDecompressor),
            }
            chunks = self._reader.chunks
            for place, chunk in chunks.items():
                chunks[place] = chunk._replace(decompressor=limited.get(chunk.decompressor, chunk.decompressor))
            return
        storage = self._reader.storage
        if storage.metadata.compression_mode == "message":
            zstd = import_module("rosbags.rosbag2.reader").zstd  # Python's own, or a package that is the same
            storage.metadata = storage.metadata._replace(compression_mode=None)
            self._unpack = partial(unpacked, decompressor=zstd.ZstdDecompressor)
        for part in getattr(storage, "storages", [storage]):
            if storage.metadata.compression_mode == "file" and Path(part.path).suffix == ".db3":
                _check_database(Path(part.path))
            for chunk in getattr(part, "chunks", []):  # an MCAP file's
                part.bio.seek(chunk.chunk_start_offset + _BEFORE_CHUNK + len(chunk.compression))
                check_chunk(part.bio.read(chunk.compressed_size) if chunk.compression else b"", chunk.compression)

    def close(self) -> None:
        self._reader.close()

    def __del__(self) -> None:
        with suppress(Exception):  # closed already, or never opened
            self._reader.close()

    def messages(self, topic: str, **times: int) -> Iterator[tuple[int, bytes, str]]:
        """Time in nanoseconds, content and type of the messages of a topic."""
        connections = [c for c in self._reader.connections if c.topic == topic]
        if connections:
            with readable(self.path, _BAG):
                for connection, time, content in self._reader.messages(connections, **times):
                    yield time, self._unpack(content) if self._unpack else content, connection.msgtype

    def check_type(self, topic: str) -> None:
        """Refuse a topic whose type is not what ROS has under that name."""
        for connection in self._reader.connections:
            kind = connection.msgtype
            if connection.topic == topic and connection.digest:
                known = self._types.generate_msgdef(kind)[1] if self.is_ros1 else self._types.hash_rihs01(kind)
                if connection.digest != known:
                    raise ValueError(
                        f"{shown(self.path)}: {shown(topic)}: expected {shown(kind)} as ROS defines it, got another"
                    )

    def first(self, topic: str) -> Any:
        """The first message of a topic that is whole; None if there is none."""
        for _, content, kind in islice(self.messages(topic), _TRIED):
            with suppress(ValueError):
                return self.message(content, kind)
        return None

    def message(self, content: bytes, kind: str) -> Any:
        with readable(self.path, _BAG):
            read = self._types.deserialize_ros1 if self.is_ros1 else self._types.deserialize_cdr
            return read(content, kind)

    def depth_topics(self) -> dict[str, str]:
        """Encodings of the topics whose first message may be a depth image."""
        found = {}
        for topic, about in sorted(self._reader.topics.items()):
            message = self.first(topic) if about.msgtype in (_IMAGES, _COMPRESSED, _DISPARITIES) else None
            if message is None:
                continue
            encoding = _encoding_of(message, about.msgtype)
            if about.msgtype == _DISPARITIES or (about.msgtype == _IMAGES and encoding in _ENCODINGS):
                found[topic] = encoding
            elif about.msgtype == _COMPRESSED and _is_read(encoding):
                found[topic] = _GREY if encoding.startswith(_GREY) else encoding
            else:
                self.unread[topic] = encoding
        return found

    def contents(self) -> str:
        """The topics and their types, in words."""
        topics = sorted(self._reader.topics.items())
        said = {name: f", {self.unread[name]}, which is not read" if name in self.unread else "" for name, _ in topics}
        return ", ".join(f"{shown(n)} ({shown(a.msgtype)}{shown(said[n])})" for n, a in topics) or "no topic at all"

    def camera(self, topic: str, rectified: bool | None = None) -> Camera:
        """The camera of the CameraInfo that is nearest to a topic in the tree of names."""
        infos = {name for name, about in self._reader.topics.items() if about.msgtype == _INFOS}
        parents = [topic.rsplit("/", i)[0] for i in range(1, topic.count("/") + 1)]
        nearest = [f"{p}{info}" for p in parents for info in ("/camera_info", "/info/camera_info", "/left/camera_info")]
        name = next((name for name in nearest if name in infos), "")
        self.check_type(name)
        info = self.first(name)
        if info is None:
            raise ValueError(
                f"{shown(self.path)}: expected a CameraInfo beside {shown(topic)}, or a camera; "
                f"there is {', '.join(map(shown, sorted(infos))) or 'none'}"
            )
        kind = self._reader.topics[topic].msgtype
        which = rectified
        if which is None and (kind == _DISPARITIES or re.search(r"(^|[_/])rect", topic) is not None):
            which = bool(np.any(getattr(info, "p", getattr(info, "P", 0)))) or None  # None: whichever is there
        with naming(self.path):
            if kind == _DISPARITIES:
                return Camera.from_ros(info, rectified=which, disparity=self._disparity(topic))
            return Camera.from_ros(info, rectified=which, depth_scale=self._depth_scale(topic))

    def _disparity(self, topic: str) -> tuple[float, float]:
        """Scale and offset of the disparities of a topic of stereo_msgs/DisparityImage: Z = f T / d."""
        message = self.first(topic)
        focal, baseline = float(message.f), abs(float(getattr(message, "t", getattr(message, "T", 0.0))))
        if not focal * baseline > 0.0:
            raise ValueError(f"expected f and T of the disparity images of {topic}, got {focal:g} and {baseline:g}")
        return 1.0 / (focal * baseline), 0.0

    def _depth_scale(self, topic: str) -> float:
        sensor = re.match(r"(/device_\d+/sensor_\d+)/", topic)
        if sensor is not None:
            for name in self._reader.topics:
                if re.fullmatch(re.escape(sensor[1]) + r"/option/Depth[_ ]Units/value", name):
                    return depth_scale_of(getattr(self.first(name), "data", None))  # type: ignore[arg-type]
        return 1000.0

    def times(self, topic: str) -> Iterator[tuple[float, int, int]]:
        """(seconds, nanoseconds of recording, index among those recorded then) of every message, in order."""
        previous, nth = None, 0
        for recorded, content, _ in self.messages(topic):
            nth = nth + 1 if recorded == previous else 0
            previous = recorded
            stamp = self._stamp(content)
            yield stamp or recorded * 1e-9, recorded, nth

    def _stamp(self, content: bytes) -> float:
        """Seconds of the header that both kinds of message begin with; 0 where it is not set."""
        # ROS 1: the header's number, then its time. CDR: the encoding, then the header's time.
        with readable(self.path, _BAG):
            order = "<" if self.is_ros1 or content[1] & 1 else ">"
            seconds, nanoseconds = struct.unpack_from(f"{order}II", content, 4)
        return float(seconds + nanoseconds * 1e-9)


def _check_files(path: Path) -> None:
    """Refuse files of a ROS 2 bag whose reading might have no end: their library trusts them.

    A database may have views and columns that are programs, in place of messages that are stored.
    """
    about = path / "metadata.yaml"
    if path.is_dir() and existing_file(about).stat().st_size > _LONGEST_ABOUT:
        raise ValueError(f"{about.name} of more than {_LONGEST_ABOUT >> 20} MiB")
    for file in path.iterdir() if path.is_dir() else [path]:
        if file.suffix == ".db3":
            _check_database(file)
        elif file.suffix == ".zstd":  # which the library unpacks to the disk, whatever comes out
            check_packed_file(existing_file(file))


def _check_database(file: Path) -> None:
    """Refuse a database that computes what it does not store."""
    if not existing_file(file).stat().st_size:
        return
    with closing(sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
        for kind, name in database.execute("SELECT type, name FROM sqlite_master"):
            columns = database.execute("SELECT hidden FROM pragma_table_xinfo(?)", (name,))
            if kind in ("view", "trigger") or (kind == "table" and any(hidden for (hidden,) in columns)):
                raise ValueError(f"a database whose {name} is computed, not stored")


_open = kept_open()


@atexit.register
def _close_the_last_one() -> None:
    # At its end the interpreter would warn about the bag's file before it lets go of the bag.
    _open.__dict__.clear()


def _read_message(location: _Location) -> NDArray[Any]:
    # A bag stays open in its thread: opening it reads its index.
    bag: _OpenBag | None = getattr(_open, "bag", None)
    if bag is None or (bag.path, bag.identity) != (location.path, identity(location.path)):
        bag = _open.bag = _OpenBag(location.path)
    times = {"start": location.recorded, "stop": location.recorded + 1}
    for nth, (_, content, kind) in enumerate(bag.messages(location.topic, **times)):
        if nth == location.nth:
            message = bag.message(content, kind)
            try:
                if kind == _DISPARITIES:
                    return _decode_disparities(message)
                return _decode_compressed(message) if kind == _COMPRESSED else _decode(message)
            except ValueError as error:
                raise ValueError(f"{shown(location.path)}: {shown(location.topic)}: {error}") from None
    raise ValueError(f"{shown(location.path)}: the message of {location.recorded * 1e-9:.6f} s is gone")


def _encoding_of(message: Any, kind: str) -> str:
    """The encoding of an image, or the format of a compressed one."""
    if kind == _DISPARITIES:
        return str(message.image.encoding)
    return str(message.encoding if kind == _IMAGES else message.format)


def _is_read(format: str) -> bool:
    """Whether a format of sensor_msgs/CompressedImage is that of depth which is read."""
    encoding = format.split(";")[0].strip()
    if "compressedDepth" in format:
        return encoding in ("16UC1", "32FC1")
    return encoding in ("16UC1", _GREY) and "png" in format.lower()


def _decode_disparities(message: Any) -> NDArray[Any]:
    """The disparities of a stereo_msgs/DisparityImage; NaN below the smallest that was searched."""
    disparities = _decode(message.image).astype(np.float32)
    least = max(float(message.min_disparity), 0.0)
    return np.where(disparities > least, disparities, np.float32(np.nan))


def _decode(image: Any) -> NDArray[Any]:
    """The depth in a sensor_msgs/Image, whose rows may be padded."""
    if image.encoding not in _ENCODINGS:
        raise ValueError(f"expected the encoding {', '.join(_ENCODINGS)}, got {image.encoding!r}")
    dtype = np.dtype(_ENCODINGS[image.encoding]).newbyteorder(">" if image.is_bigendian else "<")
    height, width, step = int(image.height), int(image.width), int(image.step)
    if step < width * dtype.itemsize or len(image.data) < height * step:
        raise ValueError(f"truncated image: {len(image.data)} bytes for {height} rows of {step} bytes, {width} pixels")
    rows = np.asarray(image.data, np.uint8)[: height * step].reshape(height, step)
    return rows[:, : width * dtype.itemsize].copy().view(dtype).astype(dtype.newbyteorder("="))


def _decode_compressed(image: Any) -> NDArray[Any]:
    """The depth in a sensor_msgs/CompressedImage: a PNG, or as compressed_depth_image_transport writes it.

    Before the latter's PNG or RVL there are twelve bytes: a number and the A and B with which floats were quantised, as
    A / Z + B.
    """
    from PIL import Image

    encoding = image.format.split(";")[0].strip()
    if not _is_read(image.format):
        raise ValueError(f"expected depth compressed as PNG or RVL, 16UC1 or 32FC1, got {image.format!r}")
    content = bytes(image.data)
    plain = "compressedDepth" not in image.format
    try:
        _, a, b = (0, 0.0, 0.0) if plain else struct.unpack_from("<iff", content)
        content = content if plain else content[12:]
        if "rvl" in image.format.lower():
            width, height = struct.unpack_from("<II", content)
            check_pixels(width, height)
            pixels = rvl.decode(content[8:], width * height).reshape(height, width)
        else:
            with Image.open(io.BytesIO(content), formats=["PNG"]) as png:
                check_png_size(png, len(content))
                pixels = np.array(png)
    except TooLargeError:
        raise
    except Exception as error:  # from the bytes before it, or one of Pillow's many
        raise damage("damaged compressed image", error) from None
    if pixels.ndim != 2:
        raise ValueError(f"expected a depth image of one channel, got shape {pixels.shape}")
    if plain and pixels.dtype == np.uint8:
        raise ValueError("expected depth of 16 bits, got 8 bits, as of a picture")
    if encoding != "32FC1":
        return pixels.astype(np.uint16)
    with np.errstate(all="ignore"):
        return np.where(pixels == 0, math.nan, a / (pixels.astype(np.float32) - b)).astype(np.float32)
