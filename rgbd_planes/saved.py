"""Results in NPZ files: their arrays, and as JSON what else they consist of."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np

from rgbd_planes.files import readable, write_beside

Arrays = Mapping[str, Any]


class Savable:
    """A base beside those of a result: `save` and `load`, of what the result says it consists of."""

    def _content(self) -> tuple[Mapping[str, Any], Arrays]:
        """What JSON can hold, and the arrays by their names in a file."""
        raise NotImplementedError

    @classmethod
    def _from_content(cls, about: Mapping[str, Any], arrays: Arrays) -> Self:
        """The result again; any error says that it is not the content of one."""
        raise NotImplementedError

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an NPZ file, camera included, that `load` reads; whole or not at all.

        Raises
        ------
        ValueError
            The camera's noise model is a function.
        OSError
            It cannot be written there.
        """
        about, arrays = self._content()
        text = np.array(json.dumps(about))
        with write_beside(path) as beside, open(beside, "wb") as file:
            np.savez_compressed(file, about=text, **arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a file that `save` wrote.

        Raises
        ------
        OSError, ValueError
            There is none, or it is another file, or damaged.
        """
        with Path(path).open("rb") as opened, readable(path, f"a file that {cls.__name__}.save wrote"):
            if opened.read(2) != b"PK":  # NumPy would take it for a pickle, and say how to load one
                raise ValueError("not an NPZ file")
            opened.seek(0)
            with np.load(opened, allow_pickle=False) as file:
                arrays = {name: np.ascontiguousarray(file[name]) for name in file.files}
                return cls._from_content(json.loads(str(file["about"])), arrays)


def check_alike(arrays: Arrays, expected: Arrays) -> None:
    """Raise a ValueError unless arrays have the shapes and dtypes of others."""
    for name, other in expected.items():
        if (arrays[name].shape, arrays[name].dtype) != (other.shape, other.dtype):
            raise ValueError(f"{name} of another shape or dtype")
