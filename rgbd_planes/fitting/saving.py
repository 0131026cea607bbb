"""Results in NPZ files: a file holds the fields of a result, arrays as arrays and all else as JSON.

A class that derives from `Savable` says in `_checked` which values its fields may have. The names in a file are those
of the fields without leading underscores, or what a field's metadata says under "saved": with None it is not saved.
"""

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import IO, Any, ClassVar, Self

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from rgbd_planes._core.checks import check_choice
from rgbd_planes._core.files import TooLargeError, existing_file, json_of, naming, readable, write_beside
from rgbd_planes._core.status import TileStatus
from rgbd_planes._core.text import shown
from rgbd_planes._core.user_warnings import collected_warnings
from rgbd_planes.camera.camera import Camera
from rgbd_planes.fitting.methods import METHODS
from rgbd_planes.fitting.results import allocate
from rgbd_planes.kernels.statistics.pixel_runs import PixelRuns
from rgbd_planes.kernels.statistics.tiles.block import COLUMNS, MEAN, SLOPES
from rgbd_planes.noise.model import NoiseModel
from rgbd_planes.uncertainty.pixel_errors import KeepsPixels, Pixels

Arrays = Mapping[str, Any]
Values = Mapping[str, Any]
"""The fields of a result, by their names."""

# Arrays of a file, in bytes: that much may come of any. Beyond that only of a file that holds something: planes are
# compressed to a half, and labels to a fiftieth.
_MOST_UNPACKED, _MOST_RATIO = 2**28, 64
_LONGEST_ABOUT = 2**27  # four bytes a character
# Keys that tell the classes of files that do not name them: earlier versions wrote such files.
_ONLY_IN = {"tile": "TilePlanes", "sigma": "Segmentation"}
# Public classes that read files.
_KINDS = {
    "LabelPlanes", "MergedPlanes", "PrimitiveFits", "Segmentation", "TilePlanes", "TileSurfaces", "WindowPlanes",
    "WindowSurfaces",
}  # fmt: skip


class _Arrays(Mapping[str, Any]):
    """The arrays of an NPZ file, each of which is read when it is first asked for: others may be anything.

    Raises
    ------
    ValueError
        The whole is too large, and by its compression most likely made to be.
    """

    def __init__(self, opened: IO[bytes]) -> None:
        packed = opened.seek(0, os.SEEK_END)
        opened.seek(0)
        self._file = np.load(opened, allow_pickle=False)
        sizes = {member.filename: member.file_size for member in self._file.zip.infolist()}
        whole = sum(sizes.values())
        if whole > max(_MOST_UNPACKED, _MOST_RATIO * packed) or sizes.get("about.npy", 0) > _LONGEST_ABOUT:
            raise TooLargeError(f"expected at most {_MOST_UNPACKED >> 20} MiB from {packed} bytes, got {whole} bytes")
        self._read: dict[str, NDArray[Any]] = {}

    def about(self) -> Any:
        """The file's JSON."""
        return json_of(str(self._file["about"]))

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self._read:
            self._read[name] = np.ascontiguousarray(self._file[name])
        return self._read[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._file)

    def __len__(self) -> int:
        return len(self._file)


class Savable:
    """A base beside those of a result, a dataclass with a ``camera``: `save` and `load`."""

    _later: ClassVar[frozenset[str]] = frozenset()
    """Fields that files of earlier versions may not have."""

    @classmethod
    def _checked(cls, values: Values) -> Values:
        """The fields of a result as a file has them, in the types of the class; any error says that they are none."""
        raise NotImplementedError

    @classmethod
    def _kind(cls) -> str:
        """The name of the class that files state: that of the nearest base with a `_checked`."""
        return next(base.__name__ for base in cls.__mro__ if "_checked" in vars(base))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an NPZ file, camera included, that `load` reads; whole or not at all.

        Raises
        ------
        ValueError
            The camera's noise model is a function, or the path has the suffix of another format.
        OSError
            It cannot be written there.
        """
        about, arrays = _content(self)
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
        with existing_file(path).open("rb") as opened:
            with readable(path, expected):
                if opened.read(2) != b"PK":  # NumPy would take it for a pickle, and say how to load one
                    raise ValueError("not an NPZ file")
                arrays = _Arrays(opened)
                about = arrays.about()
                held, newer = _kind_of(about), _unknown_keys(about)
            with naming(path):
                if held not in (None, cls._kind()):
                    raise ValueError(f"expected {expected}, got one that holds {shown(held)}: {_reader_of(held)}")
                if newer:
                    names = ", ".join(map(shown, newer))
                    raise ValueError(f"expected {expected}, got one of a newer version: it has {names}, too")
            # The camera's warnings were issued when it was made: they are not repeated.
            with readable(path, expected), collected_warnings([]):
                return cls(**cls._checked(_values(cls, about, arrays)))


def _saved_fields(result: Any) -> list[tuple[str, str]]:
    """The names of the fields that are saved, and those that they have in a file."""
    names = [(field.name, field.metadata.get("saved", field.name.lstrip("_"))) for field in fields(result)]
    return [(name, saved) for name, saved in names if saved is not None]


def _content(result: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """The fields of a result as a file has them: what JSON can hold, and arrays."""
    about: dict[str, Any] = {}
    arrays: dict[str, Any] = {}
    for field, name in _saved_fields(result):
        value = getattr(result, field)
        if isinstance(value, Pixels):
            about["pixels_have_noise"] = value.noise == result.camera.noise
            arrays |= _pixel_arrays(result)
        elif isinstance(value, np.ndarray):
            arrays[name] = value
        else:
            about[name] = value.to_dict() if isinstance(value, Camera) else value
    return about, arrays


def _values(cls: Any, about: Mapping[str, Any], arrays: Arrays) -> dict[str, Any]:
    """The fields of a result from what a file holds."""
    values: dict[str, Any] = {}
    for field, name in _saved_fields(cls):
        if field == "camera":
            values[field] = Camera.from_dict(about[name])
        elif field == "_pixels":
            values[field] = _pixels_in(about, arrays, values["camera"], len(values["status"]))
        else:
            if name not in arrays and name not in about and field in cls._later:
                continue
            values[field] = arrays[name] if name in arrays else about[name]
    return values


def _kind_of(about: Mapping[str, Any]) -> str | None:
    """The name of the class whose result a file holds, if it tells."""
    named = about.get("class")
    return next((kind for key, kind in _ONLY_IN.items() if key in about), None) if named is None else str(named)


def _reader_of(kind: str) -> str:
    """The end of a message, which says what reads such results."""
    return f"rp.{kind}.load reads it" if kind in _KINDS else "a newer version reads it"


def _unknown_keys(about: Mapping[str, Any]) -> list[str]:
    """Keys of a file's camera, or of its noise model, that this version does not know."""
    camera = about.get("camera", {})
    noise = camera.get("noise") or {}
    return sorted(
        key
        for cls, keys in ((Camera, camera), (NoiseModel, noise))
        if isinstance(keys, Mapping)  # anything else is damage
        for key in set(keys) - {field.name for field in fields(cls)}
    )


def check_alike(arrays: Arrays, expected: Arrays) -> None:
    """Raise a ValueError unless arrays have the shapes and dtypes of others."""
    for name, other in expected.items():
        if (arrays[name].shape, arrays[name].dtype) != (other.shape, other.dtype):
            raise ValueError(f"{name} of another shape or dtype")


def check_covariances(covariances: NDArray[np.float64]) -> None:
    """Raise a ValueError unless (N, K, K) covariances are finite and symmetric, and no variance is negative."""
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    symmetric = np.array_equal(covariances, covariances.transpose(0, 2, 1))
    if not (np.isfinite(covariances).all() and (variances >= 0.0).all() and symmetric):
        raise ValueError("covariances that are infinite, negative or not symmetric")


def check_variances(values: NDArray[np.float64]) -> None:
    """Raise a ValueError if any of (N, K) variances, or sums of squares, is more negative than rounding makes it."""
    if (values < -1e-6 * np.nanmax(values, axis=0, initial=0.0)).any():
        raise ValueError("negative variances")


def check_planes(planes: NDArray[np.float64], alpha: NDArray[np.float64]) -> None:
    """Raise a ValueError unless (N, 4) planes are finite, with unit normals and d > 0, and (N, 3) alpha is -n / d."""
    normal, d = planes[:, :3], planes[:, 3:]
    with np.errstate(all="ignore"):
        length = np.linalg.norm(normal, axis=1)
        if not (np.allclose(length, 1.0) and (d > 0.0).all() and np.allclose(-alpha * d, normal)):
            raise ValueError("planes without a unit normal, d > 0 and alpha = -n / d")


def check_fits(values: Values, shape: tuple[int, ...], most: npt.ArrayLike) -> None:
    """Raise a ValueError unless the fields that all fits have are those of parts in this shape.

    ``most`` are the pixels that the parts have at most.
    """
    check_choice("method", values["method"], METHODS)
    check_alike(values, allocate(shape[:-2], shape[-2:]))
    count, status = values["valid_count"], values["status"]
    if status.max(initial=0) > max(TileStatus) or ((count < 0) | (count > most)).any():
        raise ValueError("an invalid status or number of pixels")
    fitted = np.isin(status, (TileStatus.OK, TileStatus.ROUGH))
    check_planes(values["planes"][fitted], values["alpha"][fitted])
    sums = np.moveaxis(values["_moments"], len(shape[:-2]), -1)[fitted]
    check_variances(sums[:, [4, 7, 9]])  # Σuu, Σvv, Σww


def check_label_image(labels: npt.NDArray[Any], shape: tuple[int, ...] | None, count: int) -> None:
    """Raise a ValueError unless labels are int32 from 0 to ``count``, of this shape if there is one."""
    if labels.dtype != np.int32 or shape not in (None, labels.shape):
        raise ValueError("labels of another shape or dtype")
    if not 0 <= labels.min(initial=0) <= labels.max(initial=0) <= count:
        raise ValueError("labels of other planes")


# Columns of variances: along the ray, of rounding, squared, and weighted by u² and v²; of a plane's errors.
_VARIANCES = {"error_sums": [0, 1, 2, 5, 7], "shared": [SLOPES, SLOPES + 2, MEAN]}
_RUNS = {name: f"run_{name}" for name in PixelRuns._fields}


def _pixel_arrays(fits: KeepsPixels) -> dict[str, npt.NDArray[Any]]:
    """The arrays of a fit's pixels, by their names in a file."""
    pixels = fits._pixels
    arrays = {"footprint": pixels.footprint, "error_sums": fits._error_sums, "shared": fits._shared}
    if pixels.runs is not None:
        arrays |= {_RUNS[name]: array for name, array in pixels.runs._asdict().items()}
    return {name: array for name, array in arrays.items() if array is not None}


def _pixels_in(about: Mapping[str, Any], arrays: Arrays, camera: Camera, count: int) -> Pixels:
    """The pixels of ``count`` parts in a file."""
    expected = {
        "footprint": np.empty((count, 5), np.int64),
        "error_sums": np.empty((count, 8)),
        "shared": np.empty((count, COLUMNS)),
    }
    needed = ("footprint", "error_sums") if "shared" in arrays else ("footprint",)
    found = {name: arrays[name] for name in expected if name in needed or name in arrays}
    check_alike(found, {name: expected[name] for name in found})
    for name, columns in _VARIANCES.items():
        if name in found:
            known = np.isfinite(found[name]).all(axis=1)  # of parts without a plane they are not
            check_variances(found[name][known][:, columns])
    noise = camera.noise if about["pixels_have_noise"] else None
    runs = _runs_in(arrays, camera, count)
    return Pixels(found["footprint"], noise, found.get("error_sums"), found.get("shared"), runs)


def _runs_in(arrays: Arrays, camera: Camera, count: int) -> PixelRuns | None:
    """The runs of a file, checked to lie in the image, as kernels assume without asking."""
    if _RUNS["first"] not in arrays:
        return None
    runs = PixelRuns(*(arrays[name] for name in _RUNS.values()))
    number, dtypes = len(runs.row), (np.int32, np.int32, np.int32, np.float64)
    check_alike(runs._asdict(), {"first": np.empty(count + 1, np.int64)})
    expected = {name: np.empty(number, dtype) for name, dtype in zip(runs._fields[1:], dtypes, strict=True)}
    check_alike(runs._asdict(), expected)
    in_order = runs.first[0] == 0 and runs.first[-1] == number and (np.diff(runs.first) >= 0).all()
    inside = (runs.row >= 0) & (runs.row < camera.height) & (runs.start >= 0) & (runs.stop <= camera.width)
    if not (in_order and (inside & (runs.start < runs.stop)).all()):
        raise ValueError("pixels that are not in the image")
    return runs
