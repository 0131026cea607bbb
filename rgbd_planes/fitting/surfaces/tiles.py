"""Fit a surface of second order to every tile of a depth frame."""

from __future__ import annotations

import functools
import math
import operator
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Arrays, Floats
from rgbd_planes._core.checks import check_max_error, check_num_threads, check_share
from rgbd_planes._core.threads import Work
from rgbd_planes.camera.camera import Camera, check_camera
from rgbd_planes.camera.depth_frame import DepthFrame
from rgbd_planes.fitting.grid_fitter import GridFitter
from rgbd_planes.fitting.methods import valid_needed
from rgbd_planes.fitting.surfaces.results import SURFACE_ARRAYS, allocate_surfaces, flat_frame
from rgbd_planes.fitting.surfaces.tile_surfaces import TileSurfaces, assessment_of_surfaces
from rgbd_planes.fitting.tile_grid import check_tile, grid_shape, tile_footprints, tile_rays, tile_sizes
from rgbd_planes.kernels.fits.surfaces import fit_surface_tiles
from rgbd_planes.uncertainty.statistics import check_significance

# Exponents of u and v of the camera's sums, in their order.
CAMERA_TERMS = (
    (0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3), (4, 0), (3, 1), (2, 2), (1, 3),
    (0, 4),
)  # fmt: skip
COEFFICIENTS = 6

_in_order = operator.itemgetter(*SURFACE_ARRAYS)


@functools.lru_cache(maxsize=4)
def whole_tiles(camera: Camera, tile: tuple[int, int]) -> Floats:
    """(15, T) float64: sums of uⁱvʲ over all pixels of each tile, about its central ray."""
    centre, tan_x, tan_y = tile_rays(camera, tile)
    rows, columns = (np.arange(0, length, side) for length, side in zip(camera.shape, tile, strict=True))
    made = np.empty((len(CAMERA_TERMS), len(rows), len(columns)))
    if tan_x.ndim == 1:
        by_column = [np.add.reduceat(tan_x[: camera.width] ** power, columns) for power in range(5)]
        by_row = [np.add.reduceat(tan_y**power, rows) for power in range(5)]
        for k, (i, j) in enumerate(CAMERA_TERMS):
            made[k] = by_row[j][:, None] * by_column[i]
    else:
        heights, widths = (tile_sizes(length, side) for length, side in zip(camera.shape, tile, strict=True))
        spread = [np.repeat(np.repeat(each, heights, axis=0), widths, axis=1) for each in centre]
        u, v = tan_x - spread[0], tan_y - spread[1]
        for k, (i, j) in enumerate(CAMERA_TERMS):
            made[k] = np.add.reduceat(np.add.reduceat(u**i * v**j, rows, axis=0), columns, axis=1)
    flat = made.reshape(len(CAMERA_TERMS), -1)
    flat.flags.writeable = False
    return flat


def needed_for_surfaces(pixels: npt.NDArray[Any], max_missing: float) -> Floats:
    """How many valid pixels tiles of ``pixels`` need: at least six."""
    return np.maximum(valid_needed(pixels, max_missing), COEFFICIENTS)


class SurfaceFitter(GridFitter[TileSurfaces]):
    """Fits surfaces to the tiles of one camera's frames; what depends on the camera alone is computed once, here.

    Its attributes camera and tile cannot be changed: make a new one. `fit`, `fit_batch` and `fit_stream` are those of
    `TileFitter`, and return `TileSurfaces`.

    Parameters
    ----------
    camera, tile, max_missing, max_error, significance, num_threads
        The parameters of `fit_surfaces`.

    Raises
    ------
    TypeError, ValueError
        For an argument that cannot be used, saying what was expected and what came.
    """

    def __init__(
        self,
        camera: Camera,
        tile: int | tuple[int, int] = 24,
        *,
        max_missing: float = 0.5,
        max_error: float | None = None,
        significance: float | None = None,
        num_threads: int | None = None,
    ) -> None:
        check_camera(camera)
        max_missing = check_share("max_missing", max_missing)
        tile = check_surface_tile(tile, camera)
        check_significance(significance, camera)
        vars(self).update(camera=camera, tile=tile)
        self._options: dict[str, Any] = {
            "max_missing": max_missing, "max_error": max_error, "significance": significance,
            "num_threads": num_threads,
        }  # fmt: skip
        error = check_max_error(max_error)
        self._num_threads = check_num_threads(num_threads)
        self._noise_is_asked = threading.Lock()
        self._takes_stacks = True
        self._grid = grid_shape(camera, tile)
        self._compiled_for = "surfaces", camera.is_distorted
        self._assessment = None if camera.noise is None else assessment_of_surfaces(camera, significance, tile)
        centre, tan_x, tan_y = tile_rays(camera, tile)
        needed = needed_for_surfaces(tile_footprints(camera.shape, tile)[:, 0], max_missing)
        self._of_camera = (tan_x, tan_y, *tile, centre.reshape(2, -1), whole_tiles(camera, tile), needed, error)

    def __repr__(self) -> str:
        (rows, columns), (height, width) = self._grid, self.tile
        return f"<SurfaceFitter: {rows} x {columns} tiles of {height} x {width} pixels>"

    def __reduce__(self) -> tuple[Any, ...]:
        # Numba pickles a kernel as code to be compiled without its cache.
        return functools.partial(type(self), **self._options), (self.camera, self.tile)

    def _arrays(self, frames: tuple[int, ...], out: TileSurfaces | None) -> Arrays:
        if out is None:
            return allocate_surfaces(frames, self._grid)
        shape = frames + self._grid
        if not isinstance(out, TileSurfaces) or (out.shape, out.tile, out.camera) != (shape, self.tile, self.camera):
            raise ValueError(f"out must be a result of this fitter of shape {shape}, got {out!r}")
        arrays = {name: getattr(out, name) for name in SURFACE_ARRAYS}
        for name, array in arrays.items():
            if not (array.flags.c_contiguous and array.flags.writeable):
                raise ValueError(f"expected an out whose arrays are contiguous and may be written, {name} is not")
        out._writes[0] += 1
        return arrays

    def _result(self, arrays: Arrays) -> TileSurfaces:
        return TileSurfaces(camera=self.camera, tile=self.tile, _writes=[0], **arrays)

    def _into(self, arrays: Arrays) -> Callable[[DepthFrame], Work]:
        frames = arrays["status"].size // math.prod(self._grid)
        results = [array.reshape(frames, -1) for array in _in_order(arrays)]

        def fit(frame: DepthFrame) -> Work:
            if self._assessment is not None and not self._noise_is_asked.locked():
                self._warn_of_noise(frame)
            # Numba compiles for depth images and for disparity images.
            offset = frame.offset if frame.is_disparity else None
            values = frame.raw.reshape(frames, *self.camera.shape), frame.lowest, frame.highest, frame.scale, offset

            def work(start: int, stop: int) -> None:
                fit_surface_tiles(*values, *self._of_camera, start, stop, *results)
                if self._assessment is not None and self._assessment.level > 0.0:
                    self._assess(arrays, frames, start, stop)

            return work

        return fit

    def _assess(self, arrays: Arrays, frames: int, start: int, stop: int) -> None:
        """Mark what is ROUGH of tile rows ``start`` to ``stop``, counted through all frames."""
        assert self._assessment is not None
        rows, columns = self._grid
        for i in range(start // rows, -(-stop // rows)):
            first, last = max(start - i * rows, 0), min(stop - i * rows, rows)
            self._assessment.mark(flat_frame(arrays, frames, i), first * columns, last * columns)


def check_surface_tile(tile: int | tuple[int, int], camera: Camera) -> tuple[int, int]:
    """Return a tile's (height, width): at least three pixels each way, since two rows of pixels lie on a conic."""
    height, width = check_tile(tile, camera.shape)
    if height < 3 or width < 3:
        raise ValueError(f"tile must be at least 3 x 3 pixels for a surface of second order, got {tile!r}")
    return height, width


def fit_surfaces(
    depth: npt.ArrayLike,
    camera: Camera,
    tile: int | tuple[int, int] = 24,
    *,
    max_missing: float = 0.5,
    max_error: float | None = None,
    significance: float | None = None,
    num_threads: int | None = None,
) -> TileSurfaces:
    """Fit a surface of second order to every tile of a depth frame: normals, curvatures, and how sure they are.

    Least squares of the inverse depth on (1, du, dv, du², du·dv, dv²), with (du, dv) the ray relative to the tile's
    central one: the paper's explicit form one order up. It is the maximum-likelihood fit for a disparity sensor whose
    pixels err independently, and removes the bias that noise gives curvatures in (X, Y, Z). For many frames of one
    camera, make a `SurfaceFitter` once; it has the same parameters.

    Parameters
    ----------
    depth : (H, W) array_like
        Along the optical axis. Integers in the camera's ``depth_scale`` or ``disparity``, or floats: metres, or, where
        the camera has ``disparity``, disparities. Missing is NaN, infinity, 0 and negative depth, one of the camera's
        ``invalid_values`` or outside its ``depth_range``.
    camera : Camera
    tile : int or (height, width)
        Size of a tile in pixels, at least 3 each way. The standard deviation of a curvature falls with the third power
        of it: larger tiles than for planes pay. The last row and column of tiles may be ragged.
    max_missing : float
        Share of missing pixels above which a tile gets TOO_FEW; at 1 any pixels that determine a surface are fitted.
    max_error : float, optional
        Tiles with a larger ``rmse_metric``, in metres, get ROUGH.
    significance : float, optional
        For a camera with a noise model: tiles get ROUGH whose residual the noise alone exceeds less often than this.
        None is 0.01; 0 is no such test.
    num_threads : int, optional
        None takes threads when the work is large enough to pay for them. The result is the same for any number.

    Returns
    -------
    TileSurfaces
        Arrays of shape (R, C, ...).

    Raises
    ------
    TypeError, ValueError
        For an argument that cannot be used, saying what was expected and what came.

    Warns
    -----
    UserWarning
        Something in the frame is most likely not meant as it is, such as its unit: `fit_tiles` lists what.
    """
    fitter = SurfaceFitter(
        camera, tile, max_missing=max_missing, max_error=max_error, significance=significance, num_threads=num_threads
    )
    return fitter.fit(depth)
