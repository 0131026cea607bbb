"""The surfaces of a frame's tiles, as a fit of a grid returns them."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.text import counted
from rgbd_planes.camera.camera import Camera
from rgbd_planes.fitting.saving import Savable, Values
from rgbd_planes.fitting.surfaces.results import SURFACE_ARRAYS, SurfaceFits
from rgbd_planes.fitting.surfaces.saving import check_surfaces
from rgbd_planes.fitting.tile_grid import (
    check_tile,
    grid_shape,
    tile_footprints,
    tile_places,
    tile_rays,
    tile_sizes,
    tile_windows,
)
from rgbd_planes.uncertainty.falloff import growth_of_tiles

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rgbd_planes.fitting.surfaces.statistics import SurfaceAssessment


@functools.lru_cache(maxsize=16)
def assessment_of_surfaces(camera: Camera, significance: float | None, tile: tuple[int, int]) -> SurfaceAssessment:
    """What tests the surfaces of a camera's tiles, and works out their statistics."""
    from rgbd_planes.fitting.surfaces.statistics import SurfaceAssessment

    centre, sizes = tile_rays(camera, tile).centre.reshape(2, -1), tile_windows(camera.shape, tile)[:, 2:]
    footprint = tile_footprints(camera.shape, tile)
    return SurfaceAssessment(camera, significance, centre, sizes, footprint, growth_of_tiles(camera, tile))


@dataclass(frozen=True, eq=False, repr=False)
class TileSurfaces(Savable, SurfaceFits):
    """The surfaces of all tiles of a frame, arrays of shape S = (R, C), or of a batch, S = (F, R, C).

    Attributes
    ----------
    tile : (height, width)
        Size of a tile in pixels; the last row and column may be smaller.
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

    @property
    def _centre(self) -> Floats:
        return tile_rays(self.camera, self.tile).centre.reshape(2, -1)

    @property
    def _assessment(self) -> SurfaceAssessment:
        return assessment_of_surfaces(self.camera, 0.0, self.tile)

    @property
    def _footprint(self) -> npt.NDArray[np.int64]:
        return tile_footprints(self.camera.shape, self.tile)

    def _cells(self, rows: npt.NDArray[np.int64], columns: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """(H', W') int64: the tile at these rows and columns of pixels, counted row by row of tiles."""
        return (rows // self.tile[0])[:, None] * self.shape[-1] + columns // self.tile[1]

    def __getitem__(self, frame: int | slice) -> TileSurfaces:
        """The surfaces of one frame of a batch, or of a slice, without copying.

        Raises
        ------
        TypeError
            The surfaces are those of a single frame, or it is no whole number and no slice.
        IndexError
            There are not so many frames.
        """
        if len(self.shape) != 3:
            raise TypeError(
                "only the surfaces of a batch of frames can be indexed, by a frame; index an array, such as .points"
            )
        if isinstance(frame, bool) or not isinstance(frame, (int, np.integer, slice)):
            raise TypeError(f"expected the number of a frame of the batch, or a slice, got {type(frame).__name__}")
        if not isinstance(frame, slice) and not -len(self) <= frame < len(self):
            raise IndexError(f"expected the number of one of {len(self)} frames, got {frame}")
        arrays = {name: getattr(self, name)[frame] for name in SURFACE_ARRAYS}
        return TileSurfaces(camera=self.camera, tile=self.tile, _writes=self._writes, **arrays)

    def __bool__(self) -> bool:
        return True  # however many frames: Python would ask for their number

    def __len__(self) -> int:
        """Number of frames of a batch.

        Raises
        ------
        TypeError
            The surfaces are those of a single frame.
        """
        if len(self.shape) != 3:
            raise TypeError("the surfaces of a single frame have no length; see .shape")
        return self.shape[0]

    def __iter__(self) -> Iterator[TileSurfaces]:
        return (self[i] for i in range(len(self)))

    def __repr__(self) -> str:
        *frames, rows, columns = self.shape
        count = f"{counted(frames[0], 'frame')} of " if frames else ""
        height, width = self.tile
        return f"<TileSurfaces: {count}{rows} x {columns} tiles of {height} x {width} pixels, {self._summary()}>"

    def _repr_html_(self) -> str:
        """What a notebook shows: the counts and a small picture."""
        from rgbd_planes.plotting.preview import surfaces_html

        return surfaces_html(self)

    def plot(self, depth: npt.ArrayLike | None = None, figure: Figure | None = None) -> Figure:
        """Draw the depth, the normals as colours, and the mean curvature with strokes along the larger curvature.

        With a noise model, tiles that it takes for flat (p_flat of 0.01 or more) are white, and have no stroke.

        Parameters
        ----------
        depth : (H, W) array_like, optional
            The frame that was fitted; without it the fitted surfaces' own depth is drawn.
        figure : matplotlib Figure, optional
            Drawn into, with text for a width of 15 inches; a new one of that width by default.

        Returns
        -------
        matplotlib Figure

        Raises
        ------
        TypeError, ValueError
            The surfaces are those of a batch, or the frame is not their camera's.
        """
        from rgbd_planes.plotting.curvature import plot_surfaces

        return plot_surfaces(self, depth, figure)

    def _places(self) -> dict[str, npt.NDArray[Any]]:
        return tile_places(self.camera.shape, self.tile, self.shape)

    @classmethod
    def _checked(cls, values: Values) -> Values:
        camera, shape = values["camera"], values["status"].shape
        tile = check_tile(tuple(values["tile"]), camera.shape)
        if shape[-2:] != grid_shape(camera, tile):
            raise ValueError("surfaces of another grid")
        pixels = tile_windows(camera.shape, tile)[:, 2:].prod(axis=1).reshape(shape[-2:])
        check_surfaces(values, shape, pixels)
        return {**values, "tile": tile, "_writes": [0]}
