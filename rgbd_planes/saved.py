"""Results in NPZ files: their arrays, and as JSON what else they consist of."""

import json
import os
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from rgbd_planes.caller_warnings import collected_warnings
from rgbd_planes.camera import Camera
from rgbd_planes.files import naming, readable, write_beside
from rgbd_planes.noise.model import NoiseModel

Arrays = Mapping[str, Any]

# What tells the classes of files that do not name them, as those of earlier versions.
_ONLY_IN = {"tile": "TilePlanes", "sigma": "Segmentation"}


class Savable:
    """A base beside those of a result: `save` and `load`, of what the result says it consists of."""

    def _content(self) -> tuple[Mapping[str, Any], Arrays]:
        """What JSON can hold, and the arrays by their names in a file."""
        raise NotImplementedError

    @classmethod
    def _from_content(cls, about: Mapping[str, Any], arrays: Arrays) -> Self:
        """The result again; any error says that it is not the content of one."""
        raise NotImplementedError

    @classmethod
    def _kind(cls) -> str:
        """The name of the class whose content it is: subclasses of it have no other."""
        return next(base.__name__ for base in cls.__mro__ if "_content" in vars(base))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an NPZ file, camera included, that `load` reads; whole or not at all.

        Raises
        ------
        ValueError
            The camera's noise model is a function, or the path has the suffix of another format.
        OSError
            It cannot be written there.
        """
        about, arrays = self._content()
        text = np.array(json.dumps({"class": self._kind(), **about}))
        with write_beside(path, ".npz") as beside, open(beside, "wb") as file:
            np.savez_compressed(file, about=text, **arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a file that `save` wrote.

        Raises
        ------
        OSError, ValueError
            There is none, or it is another file, of a newer version, or damaged.
        """
        expected = f"a file that {cls.__name__}.save wrote"
        with Path(path).open("rb") as opened, readable(path, expected):
            if opened.read(2) != b"PK":  # NumPy would take it for a pickle, and say how to load one
                raise ValueError("not an NPZ file")
            opened.seek(0)
            with np.load(opened, allow_pickle=False) as file:
                arrays = {name: np.ascontiguousarray(file[name]) for name in file.files}
                about = json.loads(str(file["about"]))
            held, newer = _kind_of(about), _unknown_keys(about)
        with naming(path):
            if held not in (None, cls._kind()):
                raise ValueError(f"expected {expected}, got one that holds {held}: {_reader_of(held)}")
            if newer:
                raise ValueError(f"expected {expected}, got one of a newer version: it has {', '.join(newer)}, too")
        # Of a doubtful camera whoever made it has been warned.
        with readable(path, expected), collected_warnings([]):
            return cls._from_content(about, arrays)


def _kind_of(about: Mapping[str, Any]) -> str | None:
    """The name of the class of which a file holds a result, if it tells."""
    named = about.get("class")
    return next((kind for key, kind in _ONLY_IN.items() if key in about), None) if named is None else str(named)


def _reader_of(kind: str) -> str:
    """The end of a message, which says what reads such results."""
    import rgbd_planes as rp

    has_load = hasattr(getattr(rp, kind, None), "load")
    return f"rp.{kind}.load reads it" if has_load else "a newer version reads it"


def _unknown_keys(about: Mapping[str, Any]) -> list[str]:
    """What the camera of a file, or its noise model, has and this version does not know."""
    camera = about.get("camera", {})
    noise = camera.get("noise") or {}
    return sorted(
        key
        for of, keys in ((Camera, camera), (NoiseModel, noise))
        if isinstance(keys, Mapping)  # anything else is damage
        for key in set(keys) - {f.name for f in fields(of)}
    )


def check_alike(arrays: Arrays, expected: Arrays) -> None:
    """Raise a ValueError unless arrays have the shapes and dtypes of others."""
    for name, other in expected.items():
        if (arrays[name].shape, arrays[name].dtype) != (other.shape, other.dtype):
            raise ValueError(f"{name} of another shape or dtype")


def check_planes(planes: NDArray[np.float64], alpha: NDArray[np.float64]) -> None:
    """Raise a ValueError unless (N, 4) planes are finite, with unit normals and d > 0, and (N, 3) alpha is -n / d."""
    normal, d = planes[:, :3], planes[:, 3:]
    with np.errstate(all="ignore"):
        length = np.linalg.norm(normal, axis=1)
        if not (np.allclose(length, 1.0) and (d > 0.0).all() and np.allclose(-alpha * d, normal)):
            raise ValueError("planes without a unit normal, d > 0 and alpha = -n / d")
