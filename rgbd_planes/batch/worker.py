"""The work of a worker: some frames of a sequence, fitted and written as a Parquet file."""

import io
import json
import re
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rgbd_planes._core.checks import check_bool, check_choice, check_max_error, check_share
from rgbd_planes._core.files import write_beside
from rgbd_planes._core.user_warnings import collected_warnings
from rgbd_planes.batch.fingerprint import files_digest, stamps
from rgbd_planes.batch.seal import is_sealed, seal
from rgbd_planes.batch.table import KEY, Columns, Grid, Rows, empty_rows
from rgbd_planes.camera.camera import Camera, check_camera
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.camera.frame import Frame
from rgbd_planes.camera.frame_warnings import warn_of_distances, warn_of_noise, warn_of_reach
from rgbd_planes.fitting.methods import METHODS
from rgbd_planes.fitting.surfaces.tile_surfaces import TileSurfaces
from rgbd_planes.fitting.surfaces.tiles import SurfaceFitter
from rgbd_planes.fitting.tile_grid import check_tile, grid_shape, tile_sides
from rgbd_planes.fitting.tile_planes import TilePlanes
from rgbd_planes.fitting.tiles import TileFitter
from rgbd_planes.primitives.fit import fit_primitives
from rgbd_planes.segmentation.result import boxes_of
from rgbd_planes.segmentation.segment import MIN_SIZE, check_min_size, segment
from rgbd_planes.sequences.frames import FrameSequence
from rgbd_planes.sequences.problems import Problem, reason_to_skip
from rgbd_planes.uncertainty.statistics import check_level


@dataclass(frozen=True)
class FitSettings:
    """What is fitted to each frame.

    Attributes
    ----------
    segments : bool
        The planes of `rgbd_planes.segment`, one row per plane, instead of one row per tile.
    tile, method, max_missing, max_error, significance
        For tiles, as `rgbd_planes.fit_tiles` takes them.
    min_size : int
        For segments, as `rgbd_planes.segment` takes it.
    curvature : bool
        For tiles: also the curvatures of `rgbd_planes.fit_surfaces`, for the same tiles.
    primitives : bool
        For segments: also a row for each curved surface, by `rgbd_planes.fit_primitives`, with its own labels.

    Raises
    ------
    TypeError, ValueError
        One of them can be used with no camera.
    """

    segments: bool = False
    tile: int | tuple[int, int] = 16
    method: str = "range_explicit"
    max_missing: float = 0.5
    max_error: float | None = None
    significance: float | None = None
    min_size: int = MIN_SIZE
    curvature: bool = False
    primitives: bool = False

    def __post_init__(self) -> None:
        # As Python's own types, whatever fit_tiles takes: they are keys of a cache, and are written to a file.
        sides = tile_sides(self.tile)
        plain: dict[str, Any] = {
            "segments": check_bool("segments", self.segments),
            "tile": sides if np.ndim(self.tile) else sides[0],
            "min_size": check_min_size(self.min_size),
            "curvature": check_bool("curvature", self.curvature),
            "primitives": check_bool("primitives", self.primitives),
            "max_missing": check_share("max_missing", self.max_missing),
            "max_error": None if self.max_error is None else check_max_error(self.max_error),
            "significance": check_level(self.significance),
        }
        check_choice("method", self.method, METHODS)
        for name, value in plain.items():
            object.__setattr__(self, name, value)

    def check(self, camera: Camera) -> None:
        """Raise what fitting a frame of this camera would raise for these settings.

        Raises
        ------
        TypeError, ValueError
            The settings cannot be used, or some are for tiles with `segments`, or for segments without it.
        """
        fitted, others = ("segments", "tiles") if self.segments else ("tiles", "segments")
        segment_options = ("segments", "min_size", "primitives")
        others_options = [
            f.name
            for f in fields(self)
            if (f.name in segment_options) != self.segments and getattr(self, f.name) != f.default
        ]
        if others_options:
            raise ValueError(f"{fitted} take no options of {others}, got {', '.join(others_options)}")
        check_camera(camera)
        if not self.segments:
            _fitter.__wrapped__(camera, self)  # what is no camera may not be hashable
            if self.curvature:
                _surface_fitter.__wrapped__(camera, self)

    def rows_of_frame(self, camera: Camera) -> int:
        """Number of tiles of a frame; 1 for segments, of which there are few."""
        check_camera(camera)
        if self.segments:
            return 1
        rows, columns = grid_shape(camera, check_tile(self.tile, camera.shape))
        return rows * columns


class Part(NamedTuple):
    """Some frames' rows: the content of a Parquet file, unless that is already written, and a summary of it.

    `files` is the digest of the files that its frames were read from. `warnings` has, for each kind of warning, the
    first frame that it is about and the message.
    """

    content: bytes
    status: dict[str, int]
    problems: tuple[Problem, ...]
    files: str
    seconds: dict[str, float]
    warnings: dict[str, tuple[str, str]]

    @classmethod
    def read(cls, path: Path) -> "Part | None":
        """Return all but the rows of a file that was written earlier; None if there is none, or it is damaged."""
        import pyarrow
        import pyarrow.parquet

        try:
            if not path.is_file():  # a pipe, say, would be waited for
                return None
            with path.open("rb") as file:
                if not is_sealed(file):
                    return None
            with open(path, "rb") as file:  # Arrow opens names in Unicode only
                about = json.loads(pyarrow.parquet.read_schema(file).metadata[KEY])
            return cls(b"", about["status"], tuple(Problem(*p) for p in about["problems"]), about["files"], {}, {})
        except (OSError, pyarrow.ArrowException, KeyError, TypeError, ValueError):
            return None


class StoppedError(Exception):
    """The caller no longer needs the part."""


def fit_part(
    sequence: FrameSequence,
    first: int,
    settings: FitSettings,
    columns: Columns,
    where: Path | None = None,
    stopped: Callable[[], bool] = lambda: False,
    fitted: Callable[[], object] = lambda: None,
) -> Part:
    """Read and fit some frames, and write their rows.

    Parameters
    ----------
    sequence : FrameSequence
        Of these frames only.
    first : int
        Number of the first of them in the whole sequence.
    settings : FitSettings
    columns : Columns
    where : path, optional
        Path of the file, which appears whole or not at all; without it the returned part holds the file's bytes.
    stopped : callable
        Whether to give up, asked before each frame.
    fitted : callable
        Called after each frame.
    """
    import pyarrow

    problems: list[Problem] = []
    files: list[str] = []  # before they are read: a file that changes meanwhile is another one then
    seconds = {"read": 0.0, "fit": 0.0, "write": 0.0}
    rows = empty_rows(columns, len(sequence) * settings.rows_of_frame(sequence.camera))
    add = partial(_add_segments, settings) if settings.segments else _TileAdder(settings)
    said: list[str] = []
    warnings: dict[str, tuple[str, str]] = {}
    asked = settings.segments  # by `segment` itself
    for i, entry in enumerate(sequence.entries):
        if stopped():
            raise StoppedError
        begin = middle = time.perf_counter()
        try:
            with collected_warnings(said):
                files.append(stamps(entry.location))
                frame = sequence[i]
                middle = time.perf_counter()
                add(frame, i, rows)
                if not asked:  # the fitter asks one frame of all that it ever fits
                    depth = as_depth_frame(frame.depth, frame.camera)
                    warn_of_noise(depth, frame.camera.noise)
                    warn_of_distances(depth, frame.camera)
                    warn_of_reach(depth, frame.camera)
            asked = True
        except Exception as error:  # whatever is wrong with one frame, the others are still wanted
            problems.append(Problem(first + i, entry.name, reason_to_skip(error, entry.name)))
        for message in said:
            warnings.setdefault(kind_of(message), (entry.name, message))
        said.clear()
        seconds["read"] += middle - begin
        seconds["fit"] += time.perf_counter() - middle
        fitted()
    begin = time.perf_counter()
    status = rows.status_counts()
    digest = files_digest(files)
    about = json.dumps({"status": status, "problems": problems, "files": digest})
    content = b""
    if where is None:
        stream = pyarrow.BufferOutputStream()
        rows.write(stream, first, sequence.names, sequence.timestamps, about)
        written = io.BytesIO(stream.getvalue())
        seal(written)
        content = written.getvalue()
    else:
        with write_beside(where) as beside:
            # Not a file of Arrow's, whose name would have to be Unicode.
            with open(beside, "wb") as file:
                rows.write(pyarrow.PythonFile(file), first, sequence.names, sequence.timestamps, about)
            with open(beside, "r+b") as file:
                seal(file)
    seconds["write"] = time.perf_counter() - begin
    return Part(content, status, tuple(problems), digest, seconds, warnings)


def kind_of(message: str) -> str:
    """A warning's text without its numbers, which differ from frame to frame."""
    return re.sub(r"\d+(\.\d+)?", "#", message)


@lru_cache(maxsize=4)
def _fitter(camera: Camera, settings: FitSettings) -> TileFitter:
    return TileFitter(
        camera,
        settings.tile,
        settings.method,
        max_missing=settings.max_missing,
        max_error=settings.max_error,
        significance=settings.significance,
        num_threads=1,  # threads share out the frames, not each frame's tiles
    )


@lru_cache(maxsize=4)
def _surface_fitter(camera: Camera, settings: FitSettings) -> SurfaceFitter:
    # No test of the residual: the status of a row is its plane's.
    significance = None if camera.noise is None else 0.0
    return SurfaceFitter(
        camera, settings.tile, max_missing=settings.max_missing, significance=significance, num_threads=1
    )


class _TileAdder:
    """Adds the tiles of frames, fitting each frame into the arrays of the one before."""

    def __init__(self, settings: FitSettings) -> None:
        self._settings = settings
        self._camera: Camera | None = None

    def __call__(self, frame: Frame, index: int, rows: Rows) -> None:
        if frame.camera is not self._camera:
            fitter = _fitter(frame.camera, self._settings)  # an error leaves all as it was
            self._grid = Grid(grid_shape(frame.camera, fitter.tile), frame.camera.shape, fitter.tile)
            self._tiles: TilePlanes | None = None
            self._surfaces: TileSurfaces | None = None
            self._surface_fitter = _surface_fitter(frame.camera, self._settings) if self._settings.curvature else None
            self._fitter, self._camera = fitter, frame.camera
        self._tiles = tiles = self._fitter.fit(frame.depth, self._tiles)
        if self._surface_fitter is not None:
            self._surfaces = self._surface_fitter.fit(frame.depth, self._surfaces)
        rows.add_tiles(index, self._grid, tiles, self._surfaces)


def _add_segments(settings: FitSettings, frame: Frame, index: int, rows: Rows) -> None:
    segments = segment(frame.depth, frame.camera, min_size=settings.min_size)
    boxes, primitives = [segments._boxes], None
    if settings.primitives:
        primitives = fit_primitives(frame.depth, frame.camera, segments.curved_labels)
        boxes.append(boxes_of(segments.curved_labels, len(primitives)))
    places = [
        (label, down.start, across.start, down.stop - down.start, across.stop - across.start)
        for own in boxes
        for label, (down, across) in enumerate(own, start=1)
    ]
    rows.add_segments(index, np.array(places, np.int32).reshape(-1, 5).T, segments, primitives)
