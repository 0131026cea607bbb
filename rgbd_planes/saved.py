"""Results in NPZ files: their arrays, and the rest of them as JSON."""

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from rgbd_planes.files import readable, write_beside

Arrays = Mapping[str, Any]


def save_arrays(path: str | os.PathLike[str], about: Mapping[str, Any], arrays: Arrays) -> None:
    """Write a file that `saved_arrays` reads; whole or not at all."""
    text = np.array(json.dumps(about))
    with write_beside(path) as beside, open(beside, "wb") as file:
        np.savez_compressed(file, about=text, **arrays)


@contextmanager
def saved_arrays(path: str | os.PathLike[str], writer: str) -> Iterator[tuple[dict[str, Any], Arrays]]:
    """What `save_arrays` wrote into a file; errors of the block say that it is another file, or damaged.

    Raises
    ------
    OSError, ValueError
        There is none, or it is not a file that ``writer``, such as "TilePlanes.save", wrote, or it is damaged.
    """
    wrote = readable(path, f"a file that {writer} wrote")
    with Path(path).open("rb") as opened, wrote:
        if opened.read(2) != b"PK":  # NumPy would take it for a pickle, and say so
            raise ValueError("not an NPZ file")
        opened.seek(0)
        with np.load(opened, allow_pickle=False) as file:
            yield (json.loads(str(file["about"])), {name: np.ascontiguousarray(file[name]) for name in file.files})


def check_alike(arrays: Arrays, expected: Arrays) -> None:
    """Raise a ValueError unless arrays have the shapes and dtypes of others."""
    for name, other in expected.items():
        if (arrays[name].shape, arrays[name].dtype) != (other.shape, other.dtype):
            raise ValueError(f"{name} of another shape or dtype")
