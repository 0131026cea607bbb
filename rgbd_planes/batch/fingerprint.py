"""Digests of what a table on disk was made from: by them a call recognises a table that it may resume."""

import contextlib
import functools
import hashlib
import io
import json
import os
import pickle
import stat
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rgbd_planes.camera.camera import Camera
from rgbd_planes.sequences.frames import FrameSequence

UNKNOWN = {
    "locations": "the function that reads the frames, or where they are, cannot be pickled",
    "cameras": "the noise model is a function, not numbers: rgbd_planes.noise.table makes a table of it",
}
"""Why there may be no digest, by its key."""


def digests(sequence: FrameSequence) -> dict[str, str | None]:
    """Digests of a sequence, which differ wherever what is fitted may differ.

    Returns
    -------
    dict
        "sequence", of the names and times of the frames; "locations", of where they are read from and by what;
        "cameras". None where different ones could not be told apart: `UNKNOWN` says why.
    """
    entries = sequence.entries
    return {
        "sequence": _digest(f"{entry.name}\n{entry.timestamp}\n".encode() for entry in entries),
        "locations": _location_digest(sequence),
        "cameras": _camera_digest([entry.camera for entry in entries]),
    }


def stamps(location: Any) -> str:
    """The sizes and times of change of the files that a frame is read from, as far as its location names them.

    Not of folders, where others may write.
    """
    paths = [path for path in (location if isinstance(location, tuple) else (location,)) if isinstance(path, Path)]
    texts = []
    for path in paths:
        with contextlib.suppress(OSError):
            status = path.stat()
            if stat.S_ISREG(status.st_mode):
                texts.append(f"{status.st_size} {status.st_mtime_ns}")
    return " ".join(texts)


def files_digest(stamps_of_frames: Iterable[str]) -> str:
    """Digest of the `stamps` of some frames."""
    return _digest(f"{text}\n".encode() for text in stamps_of_frames)


def _digest(texts: Iterable[bytes | memoryview]) -> str:
    digest = hashlib.sha256()
    for text in texts:
        digest.update(text)
    return digest.hexdigest()


def _location_digest(sequence: FrameSequence) -> str | None:
    # Kept for this call only: the target of a link may change.
    folder = functools.cache(os.path.realpath)

    @functools.cache
    def resolved(path: Path) -> str:
        """As `os.path.realpath`, which would follow each folder of each path anew."""
        place = os.path.join(folder(path.parent), path.name)
        return os.path.realpath(place) if os.path.islink(place) else place

    class Pickler(pickle.Pickler):
        def persistent_id(self, thing: Any) -> str | None:
            """Pickle a path as the place that it leads to, from whatever folder and over whatever links."""
            return resolved(thing) if isinstance(thing, Path) else None

    stream = io.BytesIO()
    pickler = Pickler(stream, protocol=5)
    pickler.fast = True  # equal objects are written alike, whether or not they are the same one
    try:
        steps = (sequence._steps,) if sequence._steps else ()
        pickler.dump((sequence._read, *steps, [entry.location for entry in sequence.entries]))
    except Exception:  # whatever an object raises that cannot be pickled
        return None
    return _digest([stream.getbuffer()])


def _camera_digest(cameras: list[Camera]) -> str | None:
    different = {id(camera): camera for camera in cameras}  # few: faster than comparing all
    if any(camera.noise is not None and camera.noise.formula is not None for camera in different.values()):
        return None
    texts = {key: json.dumps(camera.to_dict()).encode() for key, camera in different.items()}
    return _digest(texts[id(camera)] for camera in cameras)
