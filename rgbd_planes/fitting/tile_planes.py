"""The planes of a frame's tiles, as a fit of a grid returns them."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.lazy_property import kept
from rgbd_planes._core.text import counted
from rgbd_planes.camera.camera import Camera
from rgbd_planes.fitting.methods import ARRAYS
from rgbd_planes.fitting.results import PlacedFits
from rgbd_planes.fitting.saving import Savable, Values, check_fits
from rgbd_planes.fitting.tile_grid import check_tile, grid_shape, tile_footprints, tile_places, tile_sizes, tile_windows
from rgbd_planes.plotting.protocols import Outlines
from rgbd_planes.uncertainty.falloff import growth_of_tiles

if TYPE_CHECKING:
    from rgbd_planes.kernels.statistics.pixel_runs import PixelRuns
    from rgbd_planes.uncertainty.statistics import Assessment, FitStatistics


def assessment_of_tiles(camera: Camera, method: str, significance: float | None, tile: tuple[int, int]) -> Assessment:
    """The test and the statistics of the tiles of this camera, for any of its frames."""
    from rgbd_planes.uncertainty.statistics import Assessment

    sizes, footprint = tile_windows(camera.shape, tile)[:, 2:], tile_footprints(camera.shape, tile)
    return Assessment(camera, method, significance, sizes, footprint, growth_of_tiles(camera, tile))


@functools.lru_cache(maxsize=16)
def _without_test(camera: Camera, method: str, tile: tuple[int, int]) -> Assessment:
    # Cached: to make it takes as long as to use it.
    return assessment_of_tiles(camera, method, 0.0, tile)


@dataclass(frozen=True, eq=False, repr=False)
class TilePlanes(Savable, PlacedFits):
    """The planes of all tiles of a frame, arrays of shape S = (R, C), or of a batch, S = (F, R, C).

    Attributes
    ----------
    tile : (height, width)
        Size of a tile in pixels. The last row and column may be smaller: `tile_heights` and `tile_widths` say it.
    """

    tile: tuple[int, int]

    @property
    def tile_heights(self) -> npt.NDArray[np.int64]:
        """(R,) int64: height in pixels of each row of tiles."""
        return tile_sizes(self.camera.height, self.tile[0])

    @property
    def tile_widths(self) -> npt.NDArray[np.int64]:
        """(C,) int64: width in pixels of each column of tiles."""
        return tile_sizes(self.camera.width, self.tile[1])

    def _cells(self, rows: npt.NDArray[np.int64], columns: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """(H', W') int64: the tile at these rows and columns of pixels, counted row by row of tiles."""
        return (rows // self.tile[0])[:, None] * self.shape[-1] + columns // self.tile[1]

    @property
    def _title(self) -> str:
        return f"Tiles of {self.tile[0]} x {self.tile[1]} pixels"

    @property
    def _outlines(self) -> Outlines:
        rows, columns = np.cumsum(self.tile_heights[:-1]), np.cumsum(self.tile_widths[:-1])
        return Outlines(float(min(self.tile)), rows=rows, columns=columns)

    @property
    def _assessment(self) -> Assessment:
        return _without_test(self.camera, self.method, self.tile)

    @property
    def _footprint(self) -> npt.NDArray[np.int64]:
        return tile_footprints(self.camera.shape, self.tile)

    @property
    def _total(self) -> float:
        # About the origin, moments may be such differences: those of all tiles then add up to the sums over the frame.
        if self._reference.any():
            return 0.0
        rows = [4, 7] if self.method.startswith("range") else [4, 7, 9]
        return float(np.nansum(self._moments[rows]))  # those of tiles whose digits are lost are NaN

    @property
    def _runs(self) -> PixelRuns:
        from rgbd_planes.uncertainty.pixel_runs import runs_of_windows

        return runs_of_windows(tile_windows(self.camera.shape, self.tile), self.valid_count.ravel())

    def __getitem__(self, frame: int | slice) -> TilePlanes:
        """The planes of one frame of a batch, or of a slice, without copying.

        Raises
        ------
        TypeError
            The planes are of a single frame, or it is neither a whole number nor a slice.
        IndexError
            There are not so many frames.
        """
        if len(self.shape) != 3:
            raise TypeError(
                "only the planes of a batch of frames can be indexed, by a frame; index an array, such as .planes"
            )
        if isinstance(frame, bool) or not isinstance(frame, (int, np.integer, slice)):
            kind = type(frame).__name__
            raise TypeError(
                f"expected the number of a frame of the batch, or a slice, got {kind}; index an array, such as .planes"
            )
        if not isinstance(frame, slice) and not -len(self) <= frame < len(self):
            raise IndexError(f"expected the number of one of {len(self)} frames, got {frame}")
        one = TilePlanes(
            camera=self.camera, method=self.method, tile=self.tile,
            **{name: getattr(self, name)[frame] for name in ARRAYS},
        )  # fmt: skip
        one.__dict__["_batch"] = self, frame
        return one

    @property
    @kept
    def _statistics(self) -> FitStatistics:
        """The statistics of a frame are its batch's: a fit into one shows in the other."""
        batch = self.__dict__.get("_batch")
        return super()._statistics if batch is None else batch[0]._statistics.frame(batch[1])

    @property
    def _asked_for(self) -> FitStatistics | None:
        """The statistics that a fit into these planes must also write."""
        batch = self.__dict__.get("_batch")
        asked = "_statistics" in self.__dict__ or (batch is not None and batch[0]._asked_for is not None)
        return self._statistics if asked else None

    def __bool__(self) -> bool:
        return True  # however many frames: Python would ask for their number

    def __len__(self) -> int:
        """Number of frames of a batch.

        Raises
        ------
        TypeError
            The planes are of a single frame.
        """
        if len(self.shape) != 3:
            raise TypeError("the planes of a single frame have no length; see .shape")
        return self.shape[0]

    def __iter__(self) -> Iterator[TilePlanes]:
        return (self[i] for i in range(len(self)))

    def __repr__(self) -> str:
        *frames, rows, columns = self.shape
        count = f"{counted(frames[0], 'frame')} of " if frames else ""
        height, width = self.tile
        return f"<TilePlanes: {count}{rows} x {columns} tiles of {height} x {width} pixels, {self._summary()}>"

    def _places(self) -> dict[str, npt.NDArray[Any]]:
        return tile_places(self.camera.shape, self.tile, self.shape)

    @classmethod
    def _checked(cls, values: Values) -> Values:
        camera = values["camera"]
        tile = check_tile(tuple(values["tile"]), camera.shape)
        *frames, rows, columns = values["status"].shape
        # Before memory is asked for, of which nonsense takes any amount.
        if (rows, columns) != grid_shape(camera, tile):
            raise ValueError("planes of another grid")
        pixels = tile_windows(camera.shape, tile)[:, 2:].prod(axis=1).reshape(rows, columns)
        check_fits(values, (*frames, rows, columns), pixels)
        return {**values, "tile": tile}
