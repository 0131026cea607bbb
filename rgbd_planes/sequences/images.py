"""Depth frames in files: PNG, TIFF, PGM, PFM, NPY, NPZ."""

from __future__ import annotations

import math
import os
import re
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.checks import check_choice, plain_array
from rgbd_planes._core.files import TooLargeError, check_pixels, damage, existing_file, naming, write_beside
from rgbd_planes._core.text import shown
from rgbd_planes.camera.camera import FLIPS, quarter_turns

Frame = NDArray[Any]

RECORDINGS = {".sens": "scannet_sens", ".bag": "rosbag", ".mcap": "rosbag", ".db3": "rosbag", ".mkv": "mkv"}
"""Files of many depth images, by suffix: the formats as which `rgbd_planes.open_sequence` reads them."""


def read_depth(path: str | os.PathLike[str]) -> Frame:
    """Read a depth frame as it is stored: no value is scaled or converted.

    Parameters
    ----------
    path : path
        A .png (2 to 16 bits), .tif or .tiff (integers of 2 to 32 bits, or float32), .pgm (8 or 16 bits), .pfm
        (float32), .npy, or .npz with one array. Of arrays, a first or last axis of length one is dropped.

    Returns
    -------
    (H, W) array
        Raw units (integers) or, by the library's contract, metres (floats).

    Raises
    ------
    FileNotFoundError
        There is no such file.
    ValueError
        The suffix is none of these, the file is damaged or truncated or of another format, or it does not hold one
        image of one channel, or holds numbers of another kind.
    """
    if Path(path).is_dir():
        raise ValueError(f"{shown(path)}: expected one depth image, got a folder (rgbd-planes view and batch take one)")
    file = existing_file(path)
    reader = _READERS.get(file.suffix.lower())
    if file.suffix.lower() in RECORDINGS:
        raise ValueError(
            f"{shown(path)}: expected one depth image, got a recording (`rgbd-planes batch` takes recordings)"
        )
    if reader is None:
        raise ValueError(
            f"{shown(path)}: a depth image must be one of {', '.join(_READERS)}, got {file.suffix!r}: "
            "read other formats with another library and write them with numpy.save"
        )
    frame = reader(file)
    if frame.ndim != 2 or 0 in frame.shape:
        raise ValueError(f"{shown(path)}: expected one depth image (height, width), got shape {frame.shape}")
    if frame.dtype.kind not in "uif":
        raise ValueError(f"{shown(path)}: expected a depth image of integers or floats, got dtype {frame.dtype}")
    return frame


def write_png(path: str | os.PathLike[str], image: Frame) -> None:
    """Write an (H, W) uint8 or uint16 image, a depth frame or labels, as PNG; whole or not at all.

    Raises
    ------
    TypeError
        The image is masked.
    ValueError
        The image has another shape or dtype, or the path another suffix.
    OSError
        It cannot be written there.
    """
    from PIL import Image

    if Path(path).suffix.lower() != ".png":
        raise ValueError(f"{shown(path)}: expected a path that ends in .png")
    image = plain_array("image", image)
    native = image.dtype.newbyteorder("=")
    if image.ndim != 2 or not image.size or native not in (np.uint8, np.uint16):
        raise ValueError(f"expected an (H, W) image of uint8 or uint16, got {image.shape} of {image.dtype}")
    with write_beside(path) as beside:
        # Noise does not repeat: to look for more than runs takes up to nine times as long, and saves a seventh at most.
        Image.fromarray(np.ascontiguousarray(image, native)).save(beside, format="PNG", compress_type=zlib.Z_RLE)


def rotated(frame: ArrayLike, degrees: int) -> Frame:
    """A frame, labels or normals turned counter-clockwise, for `Camera.rotated` of as many degrees.

    Parameters
    ----------
    frame : (H, W, ...) array_like
    degrees : {0, 90, 180, 270}

    Returns
    -------
    (H, W, ...) or (W, H, ...) array
        A view of the same numbers: vectors, such as normals, are not turned.

    Raises
    ------
    TypeError, ValueError
        The angle is none of these, or the frame is masked or no image.
    """
    quarters = quarter_turns(degrees)
    return np.rot90(_image(frame), quarters)


def flipped(frame: ArrayLike, direction: str) -> Frame:
    """A frame or labels mirrored, for `Camera.flipped` in the same direction.

    Parameters
    ----------
    frame : (H, W, ...) array_like
    direction : {"horizontal", "vertical"}

    Returns
    -------
    (H, W, ...) array
        A view of the same numbers.

    Raises
    ------
    TypeError, ValueError
        The direction is neither, or the frame is masked or no image.
    """
    check_choice("direction", direction, FLIPS)
    return np.flip(_image(frame), 1 if direction == "horizontal" else 0)


def _image(frame: ArrayLike) -> Frame:
    image = plain_array("frame", frame)
    if image.ndim < 2:
        raise ValueError(f"expected a frame of shape (height, width), got {image.shape}")
    return image


def check_png_size(image: Any, size: int) -> None:
    """Raise a ValueError if an open PNG image of so many bytes has too many pixels, or cannot have them.

    Its compression makes at most 1032 bytes of one, and a byte has at most 8 pixels.
    """
    check_pixels(image.width, image.height)
    if image.width * image.height > 8 * 1032 * size:
        raise ValueError(f"{size} bytes for {image.width} x {image.height} pixels")


def _read_png(path: Path) -> Frame:
    return _read_with_pillow(path, "PNG")


def _read_tiff(path: Path) -> Frame:
    return _read_with_pillow(path, "TIFF")


# Tags of TIFF, and the values of the one for the kind of numbers.
_BITS, _ORIENTATION, _SAMPLE_FORMAT = 258, 274, 339
_UNSIGNED, _SIGNED, _FLOAT = 1, 2, 3
# Modes of Pillow whose numbers were of the same size, but of another kind, in the file.
_STORED_AS = {("I", _UNSIGNED): np.uint32, ("L", _SIGNED): np.int8}
_UNREAD = {
    (_FLOAT, 16): "float16", (_FLOAT, 64): "float64", (_SIGNED, 64): "int64", (_UNSIGNED, 64): "uint64",
    (_UNSIGNED, 32): "uint32",  # of the other byte order
}  # fmt: skip

# Formats that Pillow stretches to 0..255: number of bits, inverted (0 is white), bits in reverse.
_STRETCHED = re.compile("L;([24]?)(I?)R?")
# In compressed images of the other byte order, Pillow swaps the bytes that libtiff has already swapped.
_SWAPPED_TWICE = {"F;32BF": "float32", "I;32BS": "int32", "I;16BS": "int16"}


def _unread_kind(path: Path) -> str | None:
    """The kind of numbers in a TIFF image, where Pillow has no mode for it."""
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    try:
        with path.open("rb") as file:
            tags = ImageFileDirectory_v2(file.read(8))
            file.seek(tags.next)
            tags.load(file)
            (bits,), (sample_format,) = tags[_BITS], tags.get(_SAMPLE_FORMAT, (_UNSIGNED,))
    except Exception:  # it is not a TIFF image, is damaged, or has several channels
        return None
    return _UNREAD.get((sample_format, bits))


def _read_with_pillow(path: Path, file_format: str) -> Frame:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path, formats=[file_format]) as image:
            if file_format == "PNG":
                check_png_size(image, path.stat().st_size)
            check_pixels(image.width, image.height)
            mode, count = image.mode, getattr(image, "n_frames", 1)
            codec, stored_as = _encoding(image)
            tags = getattr(image, "tag_v2", {})
            swapped = _SWAPPED_TWICE.get(stored_as) if codec == "libtiff" else None
            turned = 1 < tags.get(_ORIENTATION, 1) <= 8  # Pillow turns some of these, and scrambles others
            if swapped is not None or turned:
                frame = None
            elif mode.startswith(("L", "I", "F")) and mode not in ("LA", "La", "LAB") and count == 1:
                frame = np.array(image)
                stretched = _STRETCHED.fullmatch(stored_as)
                if stretched is not None:
                    bits, inverted = stretched.groups()
                    frame = (255 - frame if inverted else frame) // (255 // (2 ** int(bits or 8) - 1))
                if file_format == "TIFF":
                    sample_format = tags.get(_SAMPLE_FORMAT, (_UNSIGNED,))
                    frame = frame.view(_STORED_AS.get((mode, *sample_format), frame.dtype))
            else:
                frame = None
    except UnidentifiedImageError:
        kind = _unread_kind(path) if file_format == "TIFF" else None
        if kind is not None:
            raise ValueError(
                f"{shown(path)}: a TIFF image of {kind}, which Pillow does not read: save float32 or uint16, or NPY"
            ) from None
        raise ValueError(f"{shown(path)}: not a {file_format} image, or damaged") from None
    except TooLargeError as error:
        raise ValueError(f"{shown(path)}: {error}") from None
    except Exception as error:  # many kinds come out of Pillow for files that end early or hold nonsense
        raise damage(f"{shown(path)}: damaged or truncated {file_format} image", error) from error
    if swapped is not None:
        raise ValueError(
            f"{shown(path)}: a compressed TIFF image of big-endian {swapped}, which Pillow misreads: "
            "save it little-endian or uncompressed, or NPY"
        )
    if turned:
        raise ValueError(
            f"{shown(path)}: a TIFF image that is to be turned or mirrored (Orientation {tags[_ORIENTATION]}): "
            "save it upright"
        )
    if frame is None:
        what, labels = _MODES.get(mode, ("a colour image", ""))
        reason = f"{count} images" if count != 1 else f"{what} (mode {mode})"
        raise ValueError(f"{shown(path)}: expected one depth image of one channel, got {reason}{labels}")
    if file_format == "PNG" and mode == "I":  # how some versions of Pillow open 16 bits
        frame = frame.astype(np.uint16)
    return frame


def _encoding(image: Any) -> tuple[str, str]:
    """Pillow's names for an open image's compression, and for how its pixels are stored."""
    if not image.tile:
        return "", ""
    codec, _, _, arguments = image.tile[0]
    return codec, arguments if isinstance(arguments, str) else str(arguments[0])


_LONGEST_HEADER = 1 << 16  # bytes, comments included
_PART_OF_TEXT = 1 << 20
# What Pillow's modes are that hold no depth as they are, and the way on.
_FIRST = ": if its first channel is depth, save that alone"
_MODES = {
    "LA": ("grey with transparency", _FIRST),
    "La": ("grey with transparency", _FIRST),
    "RGB": ("a colour image", ": a picture of depth, or depth coded in colours? The page on depth formats says how"),
    "RGBA": ("a colour image with transparency", ": a picture of depth, or depth coded in colours?"),
    "P": ("a palette image", ": if its colours are labels, numpy.asarray(PIL.Image.open(path)) has them"),
    "1": ("a black-and-white image", ""),
}

# No side of an image has more digits, and Python makes no number of thousands of them.
_PGM_HEADER = re.compile(rb"P([25])" + rb"(?:\s|#[^\n]*\n)+(\d{1,9})" * 3 + rb"\s")


def _read_pgm(path: Path) -> Frame:
    # Not with Pillow, which stretches values to the full range when the largest is not 255 or 65535.
    with path.open("rb") as file:
        header = _PGM_HEADER.match(file.read(_LONGEST_HEADER))
        if header is None:
            raise ValueError(f"{shown(path)}: not a PGM image (P5 or P2), or damaged")
        width, height, largest = (int(number) for number in header.groups()[1:])
        if not 0 < largest < 65536:
            raise ValueError(f"{shown(path)}: expected a largest value of 1 to 65535 in the PGM header, got {largest}")
        with naming(path):
            check_pixels(width, height)
        dtype = np.dtype(np.uint8 if largest < 256 else np.uint16)
        if header[1] == b"5":
            values = _pixels(file, header.end(), dtype.newbyteorder(">"), height * width)
        else:
            file.seek(header.end())
            try:
                values = _numbers(file, dtype, height * width)
            except (ValueError, OverflowError):
                most = 255 if largest < 256 else 65535
                raise ValueError(f"{shown(path)}: expected numbers from 0 to {most} in the PGM image") from None
    return _rows(path, "PGM", values, height, width).astype(dtype)


def _numbers(file: IO[bytes], dtype: np.dtype[Any], count: int) -> Frame:
    """The numbers of a text, as many as there are, up to a count: a part after the other, as they take memory."""
    values, found, rest = [np.empty(0, dtype)], 0, b""
    while found < count and (text := file.read(_PART_OF_TEXT)):
        *words, rest = re.split(rb"\s+", rest + text)
        if len(rest) > _PART_OF_TEXT:
            raise ValueError
        values.append(np.array([word for word in words if word], dtype))
        found += len(values[-1])
    if found < count and rest:
        values.append(np.array([rest], dtype))
    return np.concatenate(values)


_PFM_HEADER = re.compile(rb"P([Ff])\s+(\d{1,9})\s+(\d{1,9})\s+([-+.\deE]+)\s")


def _read_pfm(path: Path) -> Frame:
    with path.open("rb") as file:
        header = _PFM_HEADER.match(file.read(_LONGEST_HEADER))
        if header is None:
            raise ValueError(f"{shown(path)}: not a PFM image, or damaged")
        kind, width, height, scale = header[1], int(header[2]), int(header[3]), header[4]
        if kind == b"F":
            raise ValueError(f"{shown(path)}: expected one depth image of one channel, got a colour image (PF)")
        with naming(path):
            check_pixels(width, height)
        # The scale is for display; its sign tells the byte order.
        values = _pixels(file, header.end(), np.dtype("<f4" if scale.startswith(b"-") else ">f4"), height * width)
    return _rows(path, "PFM", values, height, width)[::-1].astype(np.float32)  # the lowest row comes first


def _pixels(file: IO[bytes], start: int, dtype: np.dtype[Any], count: int) -> Frame:
    """The numbers after a header, as many as there are, up to a count."""
    # One character ends the header. If it is the first of a Windows line ending, there is a byte too many.
    file.seek(start - 1)
    content = file.read(count * dtype.itemsize + 2)
    first = 2 if content.startswith(b"\r\n") and len(content) == count * dtype.itemsize + 2 else 1
    return np.frombuffer(content, dtype, min(count, (len(content) - first) // dtype.itemsize), first)


def _rows(path: Path, kind: str, values: Frame, height: int, width: int) -> Frame:
    """The image made of the first numbers, if there are enough."""
    if len(values) < height * width:
        raise ValueError(f"{shown(path)}: truncated {kind} image: {len(values)} of {height * width} pixels")
    return values[: height * width].reshape(height, width)


class NoNumbersError(ValueError):
    """A file is whole, but holds no numbers."""


_NPY = b"\x93NUMPY"  # how an array begins
_NAMED = 5  # arrays of a file that has several


def _read_npy(path: Path) -> Frame:
    with path.open("rb") as file:
        if file.read(len(_NPY)) != _NPY:
            raise ValueError(f"{shown(path)}: not an NPY file")
        try:
            return _array(file, path.stat().st_size)
        except (NoNumbersError, TooLargeError) as error:
            raise ValueError(f"{shown(path)}: {error}") from None
        except Exception as error:  # also from parsing the header, which is Python text
            raise damage(f"{shown(path)}: damaged or truncated NPY file", error) from error


def _read_npz(path: Path) -> Frame:
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if len(members) == 1:
                with archive.open(members[0]) as file:
                    if file.read(len(_NPY)) == _NPY:
                        return _array(file, members[0].file_size)
    except (NoNumbersError, TooLargeError) as error:
        raise ValueError(f"{shown(path)}: {error}") from None
    except Exception as error:  # from the archive, its compression, or the array
        raise damage(f"{shown(path)}: damaged or truncated NPZ file", error) from error
    names = ", ".join(shown(member.filename.removesuffix(".npy")) for member in members[:_NAMED])
    names += ", ..." if len(members) > _NAMED else ""
    found = f"{names}, which is none" if len(members) == 1 else f"{len(members)}{names and ': '}{names}"
    raise ValueError(f"{shown(path)}: expected an NPZ file with one array, got {found}")


def _array(file: IO[bytes], size: int) -> Frame:
    """The array in a file of so many bytes, without axes of length one.

    Simulators put these last and neural networks first.
    """
    file.seek(0)
    formats = np.lib.format
    version = formats.read_magic(file)
    read_header = formats.read_array_header_1_0 if version == (1, 0) else formats.read_array_header_2_0
    shape, _, dtype = read_header(file)
    # There would be no memory for nonsense in a header, as for a good frame when memory is short.
    if not dtype.hasobject and math.prod(shape) * dtype.itemsize > size - file.tell():
        raise ValueError(f"{size} bytes for an array of shape {shape} of {dtype}")
    if dtype.kind in "uif":
        check_pixels(math.prod(shape), 1)
        file.seek(0)
        array = np.asarray(formats.read_array(file, allow_pickle=False))
    elif dtype.hasobject:
        raise NoNumbersError(
            "expected an array of numbers, got one of Python objects, which are not loaded from files: save the depth "
            "itself, numpy.save(path, numpy.asarray(depth, numpy.float32))"
        )
    else:  # no depth image: its shape and dtype say enough
        array = np.broadcast_to(np.zeros((), dtype), shape)
    while array.ndim > 2 and 1 in (array.shape[0], array.shape[-1]):
        array = array[..., 0] if array.shape[-1] == 1 else array[0]
    return array


_READERS: dict[str, Callable[[Path], Frame]] = {
    ".png": _read_png,
    ".tif": _read_tiff,
    ".tiff": _read_tiff,
    ".pgm": _read_pgm,
    ".pfm": _read_pfm,
    ".npy": _read_npy,
    ".npz": _read_npz,
}

DEPTH_SUFFIXES = tuple(_READERS)
"""Suffixes of the files that `read_depth` reads."""
