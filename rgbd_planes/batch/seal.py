"""A digest of a whole Parquet file, kept in its own footer: one flipped bit, and the file is no longer believed."""

import hashlib
from typing import BinaryIO

FIELD = b"rgbd_planes.sha256"
EMPTY = b"0" * 64
"""The digest as the file is first written, and as it counts in its own digest: the rest is known only at the end."""

# As Thrift writes the key, and that a text of 64 bytes comes. In no text of the footer can the second to last be.
_BEFORE = FIELD + b"\x18\x40"
_END = 8  # bytes: the footer's length, and four letters
_LONGEST_FOOTER = 1 << 26
_CHUNK = 1 << 20


def seal(stream: BinaryIO) -> None:
    """Write a file's digest where its footer has `EMPTY` for the key `FIELD`.

    Parameters
    ----------
    stream : binary file
        Open for reading and writing, at any position.
    """
    found = _digest(stream)
    assert found is not None, "expected a Parquet file with a field for its digest"
    place, _, digest = found
    stream.seek(place)
    stream.write(digest)


def is_sealed(stream: BinaryIO) -> bool:
    """Whether a file is, bit by bit, what `seal` left."""
    found = _digest(stream)
    return found is not None and found[1] == found[2]


def _digest(stream: BinaryIO) -> tuple[int, bytes, bytes] | None:
    """Where the digest stands, what stands there, and what should; None if the file has no such field."""
    size = stream.seek(0, 2)
    if size < _END:
        return None
    stream.seek(size - _END)
    footer = int.from_bytes(stream.read(4), "little") + _END
    if not footer <= min(size, _LONGEST_FOOTER):
        return None
    stream.seek(size - footer)
    at = stream.read(footer).find(_BEFORE)
    if at < 0:
        return None
    place = size - footer + at + len(_BEFORE)
    stream.seek(place)
    written = stream.read(len(EMPTY))
    stream.seek(0)
    digest = hashlib.sha256()
    position = 0
    while chunk := stream.read(_CHUNK):
        start, stop = max(place - position, 0), min(place + len(EMPTY) - position, len(chunk))
        if start < stop:
            chunk = chunk[:start] + EMPTY[: stop - start] + chunk[stop:]
        digest.update(chunk)
        position += len(chunk)
    return place, written, digest.hexdigest().encode()
