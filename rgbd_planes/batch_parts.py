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
from rgbd_planes.segmentation import segment
from rgbd_planes.sequences.frames import Frame, FrameSequence
from rgbd_planes.tile_planes import TilePlanes
from rgbd_planes.tiles import TileFitter

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
    segments : bool
        The planes of `rgbd_planes.segment`, one row a plane, instead of one row a tile.
    tile, method, max_missing, max_error, significance
        Of tiles, as `rgbd_planes.fit_tiles` takes them.
    """

    segments: bool = False
    tile: int | tuple[int, int] = 16
    method: str = "range_explicit"
    max_missing: float = 0.5
    max_error: float | None = None
    significance: float | None = None

    def check(self, camera: Camera) -> None:
        """Raise what fitting a frame of this camera would raise for these settings."""
        if not self.segments:
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
    columns = _segment_columns if settings.segments else _tile_columns
    for i, entry in enumerate(sequence.entries):
        if stopped():
            raise StoppedError
        begin = middle = time.perf_counter()
        try:
            frame = sequence[i]
            middle = time.perf_counter()
            rows.append((i, columns(frame, settings)))
        except (ImportError, MemoryError):
            raise
        except Exception as error:  # whatever is wrong with one frame, the others are worth having
            reason = " ".join(str(error).split()) or type(error).__name__
            problems.append(Problem(first + i, entry.name, reason))
        seconds["read"] += middle - begin
        seconds["fit"] += time.perf_counter() - middle
    begin = time.perf_counter()
    content, status = _write(sequence, first, settings, rows, problems)
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


def _tile_columns(frame: Frame, settings: FitSettings) -> Columns:
    """One row a tile: columns after frame, name and timestamp."""
    tiles: TilePlanes = _fitter(frame.camera, settings).fit(frame.depth)
    rows, columns = tiles.shape
    made = {
        **_places((rows, columns), frame.camera.shape, tiles.tile),
        "status": tiles.status.ravel(),
        "valid_count": tiles.valid_count.ravel(),
        **_plane_columns(tiles.planes),
        "rmse": tiles.rmse.ravel(),
        "rmse_metric": tiles.rmse_metric.ravel(),
    }
    if frame.camera.noise is not None:
        made["p_value"] = tiles.p_value.ravel()
        made |= _covariance_columns(tiles.plane_covariance)
    return made


def _segment_columns(frame: Frame, settings: FitSettings) -> Columns:
    """One row a segment: columns after frame, name and timestamp."""
    from scipy.ndimage import find_objects

    segments = segment(frame.depth, frame.camera)
    boxes = np.array(
        [
            (rows.start, columns.start, rows.stop - rows.start, columns.stop - columns.start)
            for rows, columns in find_objects(segments.labels, max_label=len(segments))
        ],
        np.int32,
    ).reshape(-1, 4)
    return {
        "label": np.arange(1, len(segments) + 1, dtype=np.int32),
        **{name: boxes[:, i] for i, name in enumerate(("top", "left", "height", "width"))},
        "status": np.full(len(segments), TileStatus.OK, np.uint8),
        "valid_count": segments.sizes,
        **_plane_columns(segments.planes),
        "rmse": segments.rmse,
        "rmse_metric": segments.rmse_metric,
        **_covariance_columns(segments.plane_covariance),
    }


def _plane_columns(planes: NDArray[np.float64]) -> Columns:
    return dict(zip(_PLANE, planes.reshape(-1, 4).T, strict=True))


def _covariance_columns(covariance: NDArray[np.float64]) -> Columns:
    matrices = covariance.reshape(-1, 4, 4)
    return {name: matrices[:, i, j] for name, (i, j) in _COVARIANCES.items()}


def _dtypes(settings: FitSettings, noise: bool) -> dict[str, type]:
    """Columns of `_tile_columns` or `_segment_columns`, in order."""
    which = ["label"] if settings.segments else ["row", "column"]
    statistics = list(_COVARIANCES) if settings.segments else ["p_value", *_COVARIANCES] if noise else []
    return {
        **dict.fromkeys([*which, "top", "left", "height", "width"], np.int32),
        "status": np.uint8,
        "valid_count": np.int32,
        **dict.fromkeys([*_PLANE, "rmse", "rmse_metric", *statistics], np.float64),
    }


def _write(
    sequence: FrameSequence,
    first: int,
    settings: FitSettings,
    rows: list[tuple[int, Columns]],
    problems: list[Problem],
) -> tuple[bytes, dict[str, int]]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns: Columns = {
        name: np.concatenate([np.empty(0, dtype), *(made[name] for _, made in rows)], dtype=dtype)
        for name, dtype in _dtypes(settings, sequence.camera.noise is not None).items()
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
