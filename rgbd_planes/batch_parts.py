"""Some frames of a sequence, fitted, as the bytes of a Parquet file: what a worker does."""

import io
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rgbd_planes.camera import Camera
from rgbd_planes.plane_fits import TileStatus
from rgbd_planes.sequences.frames import Frame, FrameSequence
from rgbd_planes.tiles import TileFitter, TilePlanes

if TYPE_CHECKING:
    import pyarrow

Columns = dict[str, NDArray[Any]]

_STATUSES = [status.name for status in TileStatus]
_KEY = b"rgbd_planes"
_PLANE = ("nx", "ny", "nz", "d")
_COVARIANCES = {f"cov_{_PLANE[i]}_{_PLANE[j]}": (i, j) for i in range(4) for j in range(i, 4)}
# Few different values each: written once, and numbers after. Of residuals and planes all values differ.
_REPEATED = [
    "frame",
    "name",
    "timestamp",
    "row",
    "column",
    "label",
    "top",
    "left",
    "height",
    "width",
    "status",
]


@dataclass(frozen=True)
class FitSettings:
    """What is fitted to each frame.

    Attributes
    ----------
    tile, method, max_missing, max_error, significance
        As `rgbd_planes.fit_tiles` takes them.
    """

    tile: int | tuple[int, int] = 16
    method: str = "range_explicit"
    max_missing: float = 0.5
    max_error: float | None = None
    significance: float | None = None

    def check(self, camera: Camera) -> None:
        """Raise what fitting a frame of this camera would raise for these settings."""
        _fitter(camera, self)


class Problem(NamedTuple):
    """A frame that was skipped, and why."""

    frame: int
    name: str
    reason: str


class Part(NamedTuple):
    """Some frames' rows: the content of a Parquet file, and what is in it."""

    content: bytes
    status: dict[str, int]
    problems: tuple[Problem, ...]
    seconds: dict[str, float]

    @classmethod
    def of_file(cls, path: Path) -> "Part | None":
        """What a file that was written earlier has, but the rows; None if there is none, or no whole one."""
        import pyarrow
        import pyarrow.parquet

        try:
            about = json.loads(pyarrow.parquet.read_schema(path).metadata[_KEY])
            return cls(b"", about["status"], tuple(Problem(*p) for p in about["problems"]), {})
        except (OSError, pyarrow.ArrowException, KeyError, TypeError, ValueError):
            return None


class StoppedError(Exception):
    """The caller has no more use for the part."""


def fit_part(
    sequence: FrameSequence,
    first: int,
    settings: FitSettings,
    stopped: Callable[[], bool] = lambda: False,
) -> Part:
    """Read and fit some frames, and write their rows into memory.

    Parameters
    ----------
    sequence : FrameSequence
        These frames only.
    first : int
        Number of the first of them in the whole sequence.
    settings : FitSettings
    stopped : callable
        Whether to give up, asked before each frame.
    """
    rows: list[tuple[int, Columns]] = []
    problems: list[Problem] = []
    seconds = {"read": 0.0, "fit": 0.0, "write": 0.0}
    for i, entry in enumerate(sequence.entries):
        if stopped():
            raise StoppedError
        begin = middle = time.perf_counter()
        try:
            frame = sequence[i]
            middle = time.perf_counter()
            rows.append((i, _columns(frame, settings)))
        except (ImportError, MemoryError):
            raise
        except Exception as error:  # whatever is wrong with one frame, the others are worth having
            reason = " ".join(str(error).split()) or type(error).__name__
            problems.append(Problem(first + i, entry.name, reason))
        seconds["read"] += middle - begin
        seconds["fit"] += time.perf_counter() - middle
    begin = time.perf_counter()
    content, status = _write(sequence, first, rows, problems)
    seconds["write"] = time.perf_counter() - begin
    return Part(content, status, tuple(problems), seconds)


@lru_cache(maxsize=4)
def _fitter(camera: Camera, settings: FitSettings) -> TileFitter:
    tile = settings.tile if isinstance(settings.tile, int) else tuple(settings.tile)
    return TileFitter(
        camera,
        tile,  # type: ignore[arg-type]
        settings.method,
        max_missing=settings.max_missing,
        max_error=settings.max_error,
        significance=settings.significance,
        num_threads=1,  # the frames are shared between threads, not each frame's tiles
    )


@lru_cache(maxsize=4)
def _places(shape: tuple[int, int], size: tuple[int, int], tile: tuple[int, int]) -> Columns:
    """Where the tiles of a frame are."""
    row, column = (index.ravel().astype(np.int32) for index in np.indices(shape))
    top, left = row * np.int32(tile[0]), column * np.int32(tile[1])
    height = np.minimum(np.int32(tile[0]), np.int32(size[0]) - top)
    width = np.minimum(np.int32(tile[1]), np.int32(size[1]) - left)
    return {"row": row, "column": column, "top": top, "left": left, "height": height, "width": width}


def _columns(frame: Frame, settings: FitSettings) -> Columns:
    """One row a tile: columns after frame, name and timestamp."""
    tiles: TilePlanes = _fitter(frame.camera, settings).fit(frame.depth)
    rows, columns = tiles.shape
    planes = tiles.planes.reshape(-1, 4)
    made = {
        **_places((rows, columns), frame.camera.shape, tiles.tile),
        "status": tiles.status.ravel(),
        "valid_count": tiles.valid_count.ravel(),
        **{name: planes[:, i] for i, name in enumerate(_PLANE)},
        "rmse": tiles.rmse.ravel(),
        "rmse_metric": tiles.rmse_metric.ravel(),
    }
    if frame.camera.noise is not None:
        covariance = tiles.plane_covariance.reshape(-1, 4, 4)
        made["p_value"] = tiles.p_value.ravel()
        made |= {name: covariance[:, i, j] for name, (i, j) in _COVARIANCES.items()}
    return made


def _dtypes(noise: bool) -> dict[str, type]:
    """Columns of `_columns`, in order."""
    statistics = ["p_value", *_COVARIANCES] if noise else []
    return {
        **dict.fromkeys(["row", "column", "top", "left", "height", "width"], np.int32),
        "status": np.uint8,
        "valid_count": np.int32,
        **dict.fromkeys([*_PLANE, "rmse", "rmse_metric", *statistics], np.float64),
    }


def _write(
    sequence: FrameSequence,
    first: int,
    rows: list[tuple[int, Columns]],
    problems: list[Problem],
) -> tuple[bytes, dict[str, int]]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns: Columns = {
        name: np.concatenate([np.empty(0, dtype), *(made[name] for _, made in rows)], dtype=dtype)
        for name, dtype in _dtypes(sequence.camera.noise is not None).items()
    }
    which = np.repeat([i for i, _ in rows], [len(made["status"]) for _, made in rows]).astype(np.int32)
    counts = np.bincount(columns["status"], minlength=len(_STATUSES))
    status = {name: int(count) for name, count in zip(_STATUSES, counts, strict=True) if count}
    arrays: dict[str, pyarrow.Array] = {
        "frame": pa.array(which.astype(np.int64) + first),
        "name": pa.DictionaryArray.from_arrays(pa.array(which), pa.array(sequence.names, pa.string())),
        # Parquet has a mark of its own for what is not known.
        "timestamp": pa.array(sequence.timestamps[which], from_pandas=True),
    }
    for name, values in columns.items():
        if name == "status":
            arrays[name] = pa.DictionaryArray.from_arrays(pa.array(values.view(np.int8)), _STATUSES)
        else:
            arrays[name] = pa.array(values)
    about = json.dumps({"status": status, "problems": problems})
    table = pa.table(arrays).replace_schema_metadata({_KEY: about})
    stream = io.BytesIO()
    pq.write_table(
        table,
        stream,
        compression="snappy",
        use_dictionary=[name for name in _REPEATED if name in arrays],
        write_statistics=["frame", "timestamp"],  # what one selects by
    )
    return stream.getvalue(), status
