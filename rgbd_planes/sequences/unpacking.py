"""Compressed data from elsewhere is unpacked up to a limit: a few bytes may stand for all the memory there is."""

import mmap
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rgbd_planes._core.text import shown

MOST_UNPACKED = 2**28
"""Bytes of one piece, as a chunk of a bag: some frames of the largest cameras."""

MOST_RATIO = 64
"""Of a whole file: depth is compressed to a tenth at most."""

_ZSTD, _ZSTD_SKIPPED = 0xFD2FB528, 0x184D2A50  # how frames begin; of the second kind the last four bits differ
_ZSTD_BLOCK = 2**17  # bytes that a block makes at most
_LZ4_RATIO = 255  # bytes that it makes of one at most


def unpacked(data: bytes, decompressor: Callable[[], Any]) -> bytes:
    """The content of compressed data, in one or several parts that follow each other.

    Parameters
    ----------
    data : bytes
    decompressor : callable
        Makes an object with ``decompress(data, max_length)``, ``eof`` and ``unused_data``, as of `bz2.BZ2Decompressor`.

    Raises
    ------
    ValueError
        It is longer than `MOST_UNPACKED`, or ends early.
    """
    parts, length = [], 0
    while data:
        reader = decompressor()
        part = reader.decompress(data, MOST_UNPACKED - length + 1)
        length += len(part)
        if length > MOST_UNPACKED:
            raise ValueError(f"more than {MOST_UNPACKED >> 20} MiB in one piece")
        if not reader.eof:
            raise ValueError("compressed data that end early")
        parts.append(part)
        data = reader.unused_data or b""
    return b"".join(parts)


def check_chunk(data: bytes, compression: str) -> None:
    """Raise a ValueError if a chunk of an MCAP file, by the sizes of its blocks, may be larger than `MOST_UNPACKED`."""
    most = len(data)
    if compression == "zstd":
        most = _longest_zstd(data)
    elif compression == "lz4" and len(data) * _LZ4_RATIO > MOST_UNPACKED:
        from lz4.frame import LZ4FrameDecompressor

        most = len(unpacked(data, LZ4FrameDecompressor))
    if most > MOST_UNPACKED:
        raise ValueError(f"more than {MOST_UNPACKED >> 20} MiB in one piece")


def check_packed_file(path: Path) -> None:
    """Raise a ValueError if a file of Zstandard may be far longer once it is unpacked, or than there is room for."""
    packed = path.stat().st_size
    if not packed:
        return
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        most = _longest_zstd(data)
    free = shutil.disk_usage(tempfile.gettempdir()).free
    if most > max(MOST_UNPACKED, MOST_RATIO * packed) or most > free:
        raise ValueError(
            f"{shown(path.name)} of {packed} bytes, which may be up to {most >> 20} MiB once unpacked; "
            f"there is room for {free >> 20} MiB"
        )


def _longest_zstd(data: bytes | mmap.mmap) -> int:
    """How long the content of frames of Zstandard can be (RFC 8878, section 3.1), without unpacking it."""
    position = most = 0
    while position + 5 < len(data):
        begin = int.from_bytes(data[position : position + 4], "little")
        if begin & ~15 == _ZSTD_SKIPPED:
            position += 8 + int.from_bytes(data[position + 4 : position + 8], "little")
            continue
        if begin != _ZSTD:
            break  # an error for whoever reads it
        flags = data[position + 4]
        is_single = flags >> 5 & 1
        position += 5 + (1 - is_single) + (0, 1, 2, 4)[flags & 3] + (is_single, 2, 4, 8)[flags >> 6]
        is_last = False
        while not is_last and position + 3 <= len(data):
            block = int.from_bytes(data[position : position + 3], "little")
            is_last, kind, size = bool(block & 1), block >> 1 & 3, block >> 3
            position += 3 + (1 if kind == 1 else size)  # of a single byte that repeats there is one
            most += size if kind < 2 else _ZSTD_BLOCK
        position += 4 * (flags >> 2 & 1)
    return most
