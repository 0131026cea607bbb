"""Files of every format, damaged by chance, and what reading them may do: give a frame, or an error in words."""

import functools
import io
import json
import shutil
import struct
import tempfile
import warnings
import zlib
from pathlib import Path

import numpy as np
from PIL import Image

import rgbd_planes as rp
from rgbd_planes.sequences import images

from . import promises
from .promises import promise

CAMERA = rp.Camera(8, 6, 7.0, 7.5, 3.5, 2.5, depth_scale=1000.0, noise=rp.noise.kinect_v1())
_FRAME = np.random.default_rng(5).integers(500, 3000, (6, 8)).astype(np.uint16)
_NUMBERS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)


def _encoded(suffix):
    stream = io.BytesIO()
    if suffix == ".npy":
        np.save(stream, _FRAME)
    elif suffix == ".npz":
        np.savez_compressed(stream, depth=_FRAME)
    elif suffix == ".pgm":
        return b"P5 # a comment\n8 6\n65535\n" + _FRAME.astype(">u2").tobytes()
    elif suffix == ".pfm":
        return b"Pf\n8 6\n-1.0\n" + (0.001 * _FRAME).astype("<f4").tobytes()
    elif suffix == ".tif":
        Image.fromarray(_FRAME).save(stream, "TIFF", compression="tiff_deflate")
    else:
        Image.fromarray(_FRAME).save(stream, "PNG")
    return stream.getvalue()


def _sens():
    matrix = np.diag([7.0, 7.5, 1.0, 1.0]).astype("<f4").tobytes()
    head = struct.pack("<IQ", 4, 9) + b"StructSen" + 4 * matrix
    head += struct.pack("<iiIIIIfQ", 2, 1, 16, 12, 8, 6, 1000.0, 2)
    content = zlib.compress(_FRAME.tobytes())
    one = bytes(64) + struct.pack("<QQQQ", 0, 33_000, 4, len(content)) + b"jpeg" + content
    return head + 2 * one + struct.pack("<Q", 0)


def _saved(kind):
    path = Path(tempfile.mkdtemp()) / "result.npz"
    depth = np.full((6, 8), 1500, np.uint16)
    found = rp.fit_tiles(depth, CAMERA, 3) if kind == "tiles" else rp.segment(depth, CAMERA, min_size=3)
    found.save(path)
    content = path.read_bytes()
    shutil.rmtree(path.parent)
    return content


def _folder(name, content):
    """A folder that a damaged list, camera or pose belongs to, and its other files."""

    def write(root):
        files = {"camera.json": json.dumps(CAMERA.to_dict()), "depth.txt": "1.0 0.png\n2.0 1.png\n"}
        for each, text in files.items():
            (root / each).write_text(text)
        for i in range(2):
            (root / f"{i}.png").write_bytes(_encoded(".png"))
        (root / name).write_bytes(content)
        return root

    return write


@functools.cache
def whole(name):
    """The content of a file that is right, and what writes a damaged one into a folder and says what to read."""
    if name in ("tiles", "segmentation"):
        return _saved(name), _file("result.npz")
    if name == "sens":
        return _sens(), _file("a.sens")
    if name == "camera":
        return json.dumps(CAMERA.to_dict()).encode(), _file("camera.json")
    if name == "list":
        return b"# depth\n1.0 0.png\n2.0 1.png\n", lambda content: _folder("depth.txt", content)
    if name == "trajectory":
        return b"1.0 0 0 0 0 0 0 1\n2.0 0.1 0 0 0 0 0 1\n", lambda content: _folder("groundtruth.txt", content)
    return _encoded(f".{name}"), _file(f"depth.{name}")


def _file(name):
    def of(content):
        def write(root):
            (root / name).write_bytes(content)
            return root / name

        return write

    return of


FORMATS = {
    "png": "depth", "tif": "depth", "pgm": "depth", "pfm": "depth", "npy": "depth", "npz": "depth", "sens": "sequence",
    "list": "sequence", "trajectory": "sequence", "camera": "camera", "tiles": "tiles", "segmentation": "segmentation",
}  # fmt: skip
"""Formats, and what reads them."""


def damaged(rng, content):
    """The content with a few changes: bits, bytes, numbers of extremes, parts that are cut, doubled or exchanged."""
    data = bytearray(content)
    for _ in range(rng.integers(1, 5)):
        place = int(rng.integers(len(data) or 1))
        kind = rng.integers(6)
        if kind == 0 and data:
            data[place] ^= 1 << int(rng.integers(8))
        elif kind == 1 and data:
            data[place] = int(rng.integers(256))
        elif kind == 2:
            data[place : place + 4] = struct.pack(rng.choice(["<I", ">I"]), int(rng.choice(_NUMBERS)))
        elif kind == 3:
            del data[place : place + int(rng.integers(1, 1 + len(data) // 2))]
        elif kind == 4:
            data[place:place] = data[: int(rng.integers(1, 1 + len(data)))]
        else:
            data[place:place] = rng.choice([b"9" * 12, b"-1", b"nan", b"inf", b"\0" * 9, b"\x1b[2J", b"../"])
    return bytes(data)


def _use(kind, path):
    if kind == "depth":
        frame = images.read_depth(path)
        promise(frame.ndim == 2 and frame.dtype.kind in "uif", "an image of numbers")
    elif kind == "camera":
        rp.Camera.load(path)
    elif kind == "sequence":
        sequence = rp.open_sequence(path)
        promise(len(repr(sequence)) < 1000 and repr(sequence).isprintable(), "a line that can be printed")
        for i in range(min(len(sequence), 3)):
            promise(sequence[i].depth.ndim == 2, "an image of numbers")
    elif kind == "tiles":
        promises.fits(rp.TilePlanes.load(path))
    else:
        found = rp.Segmentation.load(path)
        promises.segments(found, found.camera.shape)


def outcome(name, seed):
    """Damage a file and read it; returns "read", or "refused"."""
    rng = np.random.default_rng(seed)
    content, writer = whole(name)
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", UserWarning)
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        path = writer(damaged(rng, content))(Path(folder))
        try:
            _use(FORMATS[name], path)
        except (OSError, ValueError, TypeError) as error:
            promise(str(error).isprintable() and str(error), f"words that can be printed, got {error!s:.200}")
            return "refused"
    return "read"
