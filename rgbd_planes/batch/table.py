"""The rows of a batch's table: columns in memory, and as a Parquet file."""

import threading
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.status import Primitive, TileStatus
from rgbd_planes.batch import seal
from rgbd_planes.fitting.surfaces.tile_surfaces import TileSurfaces
from rgbd_planes.fitting.tile_planes import TilePlanes
from rgbd_planes.kernels.fits import table_columns as row_kernels
from rgbd_planes.kernels.statistics.tiles.block import P_VALUE, PLANE_COVARIANCE
from rgbd_planes.primitives.result import PrimitiveFits
from rgbd_planes.segmentation.result import Segmentation

KEY = b"rgbd_planes"  # of the file's metadata about its rows
STATUSES = [status.name for status in TileStatus]
PLANE = ("nx", "ny", "nz", "d")
WRITTEN_AT_ONCE = 1 << 20  # bytes: a few large pieces are written faster than many small ones
COVARIANCES = {f"cov_{PLANE[i]}_{PLANE[j]}": (i, j) for i in range(4) for j in range(i, 4)}
# A tile's statistics that a table has, in the order of its columns.
_STATISTICS = np.array([P_VALUE, *(PLANE_COVARIANCE + 4 * i + j for i, j in COVARIANCES.values())])
CURVATURES = ("kappa_1", "kappa_2", "mean_curvature", "gaussian_curvature")
CURVATURE_STATISTICS = ("p_flat", "mean_curvature_std", "gaussian_curvature_std")
KINDS = [kind.name for kind in Primitive]
PRIMITIVES = ("radius", "radius_std", "centre_x", "centre_y", "centre_z", "axis_x", "axis_y", "axis_z")
_UPPER = tuple(np.array(list(COVARIANCES.values())).T)  # where the covariances are in (4, 4)
_NO_STATISTICS = np.empty((0, 0, 0)), np.empty(0, np.int64)


class Grid(NamedTuple):
    """The places of the tiles of a frame: numbers of rows and columns, and the sizes of frame and tile."""

    shape: tuple[int, int]
    frame: tuple[int, int]
    tile: tuple[int, int]


class Columns(NamedTuple):
    """What determines the columns of a table: the same for all its parts.

    Attributes
    ----------
    segments : bool
        The rows are segments, not tiles.
    noise : bool
        The sensor's noise is known.
    timed : bool
        The time of every frame is known.
    curvature : bool
        The rows of tiles have curvatures, too.
    primitives : bool
        There are rows for curved surfaces, too, and columns for what they are.
    """

    segments: bool
    noise: bool
    timed: bool
    curvature: bool = False
    primitives: bool = False


@lru_cache(maxsize=2)  # full parts and the last one: places are the same in every part
def _grid_places(grid: Grid, frames: int) -> NDArray[np.int32]:
    """(6, N) int32: row, column, top, left, height and width of each tile, frame after frame."""
    place = np.indices(grid.shape, np.int32).reshape(2, -1)
    tile, frame = np.array([grid.tile, grid.frame], np.int32)[..., None]
    corner = place * tile
    return np.tile(np.concatenate([place, corner, np.minimum(tile, frame - corner)]), frames)


class Rows:
    """Rows of some frames, column by column."""

    def __init__(self, columns: Columns) -> None:
        segments, noise, self._timed, curvature, self._primitives = columns
        uncertain = list(COVARIANCES) if segments else ["p_value", *COVARIANCES] if noise else []
        which = ["label"] if segments else ["row", "column"]
        self._place_names = [*which, "top", "left", "height", "width"]
        self._curvatures = ([*CURVATURES, *(CURVATURE_STATISTICS if noise else ())]) if curvature else []
        named = PRIMITIVES if self._primitives else ()
        self._float_names = [*PLANE, "rmse", "rmse_metric", *uncertain, *self._curvatures, *named]
        self._noise = noise
        self._frames: list[tuple[int, int, Grid | NDArray[np.int32]]] = []  # number, rows, their places
        self._count = 0
        self._status = np.empty(0, np.int8)
        self._kind = np.empty(0, np.int8)
        self._valid_count = np.empty(0, np.int32)
        # Single precision is finer than any sensor, and half as much to write.
        self._floats = np.empty((len(self._float_names), 0), np.float32)

    def clear(self, expected: int) -> None:
        """Begin again, with memory for at least ``expected`` rows."""
        self._count = 0
        self._frames.clear()
        self._reserve(expected)

    def _reserve(self, capacity: int) -> None:
        if capacity > len(self._status):
            for name in ("_status", "_kind", "_valid_count", "_floats"):
                old = getattr(self, name)
                setattr(self, name, new := np.empty((*old.shape[:-1], capacity), old.dtype))
                new[..., : old.shape[-1]] = old

    def add_tiles(self, frame: int, grid: Grid, tiles: TilePlanes, surfaces: TileSurfaces | None = None) -> None:
        """Add a row for each tile of a frame, which is counted from the first of the part."""
        statistics, which = (tiles._statistics.rows, _STATISTICS) if self._noise else _NO_STATISTICS
        start = self._begin(frame, tiles.status.size, grid)
        results = tiles.planes, tiles.rmse, tiles.rmse_metric, tiles.valid_count, tiles.status
        columns = self._floats, self._valid_count, self._status
        row_kernels.add_tiles(results, statistics, which, start, columns)
        if surfaces is not None:
            by_name = dict(zip(("kappa_1", "kappa_2"), surfaces.principal_curvatures.reshape(-1, 2).T, strict=True))
            for row, name in enumerate(self._curvatures, start=len(self._float_names) - len(self._curvatures)):
                values = by_name[name] if name in by_name else getattr(surfaces, name).ravel()
                self._floats[row, start : self._count] = values

    def add_segments(
        self, frame: int, places: NDArray[np.int32], segments: Segmentation, primitives: PrimitiveFits | None = None
    ) -> None:
        """Add a row for each segment of a frame, and then for each curved surface.

        Parameters
        ----------
        frame : int
            Counted from the first of the part.
        places : (5, n) int32
            Label, top, left, height and width, of the segments and then of the curved surfaces.
        segments : Segmentation
        primitives : PrimitiveFits, optional
            What its curved surfaces are.
        """
        start = self._begin(frame, places.shape[1], places)
        here, rest = slice(start, start + len(segments)), slice(start + len(segments), self._count)
        covariances = segments.plane_covariance[:, *_UPPER].T
        values = [*segments.planes.T, segments.rmse, segments.rmse_metric, *covariances]
        self._status[here], self._kind[here] = TileStatus.OK, Primitive.PLANE
        self._valid_count[here] = segments.sizes
        self._floats[:, start : self._count] = np.nan  # what a row does not have
        self._floats[: len(values), here] = values
        if primitives is not None:
            self._status[rest], self._kind[rest] = primitives.status, primitives.kind
            self._valid_count[rest] = primitives.valid_count
            self._floats[:4, rest] = primitives.planes.T
            self._floats[4:6, rest] = primitives.rmse, primitives.rmse_metric
            named = [primitives.radius, primitives.radius_std, *primitives.centre.T, *primitives.axis.T]
            self._floats[-len(named) :, rest] = named

    def _begin(self, frame: int, count: int, places: Grid | NDArray[np.int32]) -> int:
        """Make room for ``count`` rows of a frame; returns the index of the first."""
        start, self._count = self._count, self._count + count
        if self._count > len(self._status):
            self._reserve(max(self._count, 2 * len(self._status)))
        self._frames.append((frame, count, places))
        return start

    def status_counts(self) -> dict[str, int]:
        """Number of rows of each status that occurs."""
        status = self._status[: self._count]
        counts = {name: int(np.count_nonzero(status == i)) for i, name in enumerate(STATUSES)}
        return {name: count for name, count in counts.items() if count}

    def _places(self) -> NDArray[np.int32]:
        kinds = {places for _, _, places in self._frames if isinstance(places, Grid)}
        if len(kinds) == 1:
            return _grid_places(*kinds, len(self._frames))
        none = np.empty((len(self._place_names), 0), np.int32)
        blocks = (_grid_places(p, 1) if isinstance(p, Grid) else p for _, _, p in self._frames)
        return np.concatenate([none, *blocks], axis=1)

    def write(
        self, stream: Any, first: int, names: tuple[str, ...], timestamps: NDArray[np.float64], about: str
    ) -> None:
        """Write a Parquet file, which is to be sealed.

        Parameters
        ----------
        stream : pyarrow.NativeFile
            Written to, and closed.
        first : int
            Number of the part's first frame in the sequence.
        names, timestamps
            Of the part's frames.
        about : str
            The file's metadata about its rows.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        def dictionary(index: NDArray[Any], values: list[str]) -> Any:
            # Not checked, which takes as long as writing: the indices made here are in range.
            return pa.DictionaryArray.from_arrays(pa.array(index), pa.array(values, pa.string()), safe=False)

        numbers = np.array([number for number, _, _ in self._frames], np.int32)
        counts: Any = [count for _, count, _ in self._frames]
        if len(set(counts)) == 1:
            counts = counts[0]  # a single number, which NumPy repeats several times faster
        here = slice(self._count)
        columns = {
            "frame": pa.array(np.repeat(numbers + np.int32(first), counts)),
            "name": dictionary(np.repeat(numbers, counts), list(names)),
            # Parquet has its own mark for missing values.
            "timestamp": pa.array(np.repeat(timestamps[numbers], counts), from_pandas=not self._timed),
            **{name: pa.array(values) for name, values in zip(self._place_names, self._places(), strict=True)},
            "status": dictionary(self._status[here], STATUSES),
            **({"kind": dictionary(self._kind[here], KINDS)} if self._primitives else {}),
            "valid_count": pa.array(self._valid_count[here]),
            **{n: pa.array(values[here]) for n, values in zip(self._float_names, self._floats, strict=True)},
        }
        # For each nullable value Parquet writes whether it is null: that takes longer than the value.
        null = set() if self._timed else {"timestamp"}
        fields = [pa.field(name, values.type, nullable=name in null) for name, values in columns.items()]
        # The bits of fits all differ, but a tile's place repeats in every frame.
        compressed = {"frame", "timestamp", *self._place_names}
        with pa.BufferedOutputStream(stream, WRITTEN_AT_ONCE) as buffered:
            schema = pa.schema(fields, {KEY: about})
            with pq.ParquetWriter(
                buffered,
                schema,
                use_dictionary=["name", "status", *(["kind"] if self._primitives else [])],
                compression={name: "snappy" if name in compressed else "none" for name in columns},
                write_statistics=["frame", "timestamp"],  # the columns that rows are selected by
                write_batch_size=1 << 16,
            ) as file:
                file.write_table(pa.table(list(columns.values()), schema))
                file.add_key_value_metadata({seal.FIELD: seal.EMPTY})


def write_about(path: Path, columns: Columns, about: str) -> None:
    """Write a Parquet file of a table's columns without rows, whose metadata is a text about the table."""
    import pyarrow as pa

    # Arrow opens files by names in Unicode only, and a folder may have another.
    sink = pa.BufferOutputStream()
    Rows(columns).write(sink, 0, (), np.empty(0), about)
    path.write_bytes(sink.getvalue())


def read_about(path: Path) -> str:
    """The text of `write_about`.

    Raises
    ------
    ValueError
        The file is damaged.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with path.open("rb") as file:
            metadata = pq.read_schema(file).metadata or {}
    except (OSError, pa.ArrowException) as error:
        raise ValueError(str(error)) from None
    about: bytes = metadata.get(KEY, b"")
    return about.decode()


class _Kept(threading.local):
    """One `Rows` for each thread: allocating its memory anew for each part costs as much as filling it."""

    columns: Columns | None = None
    rows: Rows


_kept = _Kept()


def empty_rows(columns: Columns, expected: int) -> Rows:
    """Return a `Rows` that this thread may use until it asks for another, with memory for ``expected`` rows."""
    if _kept.columns != columns:
        _kept.columns, _kept.rows = columns, Rows(columns)
    _kept.rows.clear(expected)
    return _kept.rows
