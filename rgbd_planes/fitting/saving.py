"""Results in NPZ files: their arrays, and as JSON what else they consist of."""

import json
import os
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from rgbd_planes._core.checks import check_choice
from rgbd_planes._core.files import naming, readable, write_beside
from rgbd_planes._core.status import TileStatus
from rgbd_planes._core.user_warnings import collected_warnings
from rgbd_planes.camera.camera import Camera
from rgbd_planes.fitting.methods import ARRAYS, METHODS
from rgbd_planes.fitting.results import PlaneFits, allocate
from rgbd_planes.kernels.statistics.pixel_runs import PixelRuns
from rgbd_planes.kernels.statistics.tiles.block import COLUMNS
from rgbd_planes.noise.model import NoiseModel
from rgbd_planes.uncertainty.pixel_errors import KeepsPixels, Pixels

Arrays = Mapping[str, Any]

# What tells the classes of files that do not name them, as those of earlier versions.
_ONLY_IN = {"tile": "TilePlanes", "sigma": "Segmentation"}
# Public classes that read files.
_KINDS = {
    "LabelPlanes", "MergedPlanes", "Segmentation", "TilePlanes", "TileSurfaces", "TrackedSegmentation", "WindowPlanes",
}  # fmt: skip


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
    return f"rp.{kind}.load reads it" if kind in _KINDS else "a newer version reads it"


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


def content_of_fits(
    fits: PlaneFits, about: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]
) -> tuple[dict[str, Any], dict[str, npt.NDArray[Any]]]:
    """What `Savable` writes of a fit, with what tells its parts."""
    whole = {"camera": fits.camera.to_dict(), "method": fits.method, **about}
    return whole, {**{name.lstrip("_"): getattr(fits, name) for name in ARRAYS}, **arrays}


def common_content(
    about: Mapping[str, Any], arrays: Arrays, camera: Camera, shape: tuple[int, ...], most: npt.ArrayLike
) -> dict[str, Any]:
    """The arguments that all fits are made from, of parts in this shape, which have ``most`` pixels."""
    check_choice("method", about["method"], METHODS)
    own = {name: arrays[name.lstrip("_")] for name in ARRAYS}
    check_alike(own, allocate(shape[:-2], shape[-2:]))
    count = own["valid_count"]
    if own["status"].max(initial=0) > max(TileStatus) or ((count < 0) | (count > most)).any():
        raise ValueError("an invalid status or number of pixels")
    fitted = np.isin(own["status"], (TileStatus.OK, TileStatus.ROUGH))
    check_planes(own["planes"][fitted], own["alpha"][fitted])
    return {"camera": camera, "method": about["method"], **own}


def labels_in(arrays: Arrays, shape: tuple[int, ...] | None, count: int) -> npt.NDArray[np.int32]:
    """The labels of a file: of this shape, if there is one, and 0 to ``count``."""
    labels: npt.NDArray[np.int32] = arrays["labels"]
    if labels.dtype != np.int32 or shape not in (None, labels.shape):
        raise ValueError("labels of another shape or dtype")
    if not 0 <= labels.min(initial=0) <= labels.max(initial=0) <= count:
        raise ValueError("labels of other planes")
    return labels


_RUNS = {name: f"run_{name}" for name in PixelRuns._fields}


def content_of_pixels(fits: KeepsPixels) -> tuple[dict[str, Any], dict[str, npt.NDArray[Any]]]:
    """The part of a fit's content that is its pixels."""
    pixels = fits._pixels
    several = {
        "footprint": pixels.footprint,
        "error_sums": fits._error_sums,
        "shared": fits._shared,
        **({} if pixels.runs is None else {_RUNS[name]: of for name, of in pixels.runs._asdict().items()}),
    }
    about = {"pixels_have_noise": pixels.noise == fits.camera.noise}
    return about, {name: array for name, array in several.items() if array is not None}


def pixels_in(about: Mapping[str, Any], arrays: Arrays, camera: Camera, count: int) -> Pixels:
    """The pixels of ``count`` parts in a file: `content_of_pixels`."""
    expected = {
        "footprint": np.empty((count, 5), np.int64),
        "error_sums": np.empty((count, 8)),
        "shared": np.empty((count, COLUMNS)),
    }
    needed = ("footprint", "error_sums") if "shared" in arrays else ("footprint",)
    own = {name: arrays[name] for name in expected if name in needed or name in arrays}
    check_alike(own, {name: expected[name] for name in own})
    noise = camera.noise if about["pixels_have_noise"] else None
    return Pixels(own["footprint"], noise, own.get("error_sums"), own.get("shared"), _runs_in(arrays, camera, count))


def _runs_in(arrays: Arrays, camera: Camera, count: int) -> PixelRuns | None:
    """Runs that lie in the image: kernels do not ask."""
    if _RUNS["first"] not in arrays:
        return None
    runs = PixelRuns(*(arrays[name] for name in _RUNS.values()))
    number, dtypes = len(runs.row), (np.int32, np.int32, np.int32, np.float64)
    check_alike(runs._asdict(), {"first": np.empty(count + 1, np.int64)})
    check_alike(runs._asdict(), {name: np.empty(number, of) for name, of in zip(runs._fields[1:], dtypes, strict=True)})
    in_order = runs.first[0] == 0 and runs.first[-1] == number and (np.diff(runs.first) >= 0).all()
    inside = (runs.row >= 0) & (runs.row < camera.height) & (runs.start >= 0) & (runs.stop <= camera.width)
    if not (in_order and (inside & (runs.start < runs.stop)).all()):
        raise ValueError("pixels that are not in the image")
    return runs
