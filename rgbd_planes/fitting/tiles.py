"""Fit a plane to every tile of a depth frame."""

from __future__ import annotations

import functools
import math
import operator
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Arrays
from rgbd_planes._core.checks import check_choice, check_max_error, check_num_threads, check_share
from rgbd_planes._core.threads import Work
from rgbd_planes.camera.camera import Camera, check_camera
from rgbd_planes.camera.depth_frame import DepthFrame
from rgbd_planes.fitting.grid_fitter import GridFitter
from rgbd_planes.fitting.methods import ARRAYS, METHODS, SOLVES, in_order, solve_planes, valid_needed
from rgbd_planes.fitting.results import allocate
from rgbd_planes.fitting.tile_grid import check_tile, grid_shape, tile_footprints, tile_rays, tile_windows
from rgbd_planes.fitting.tile_planes import TilePlanes, assessment_of_tiles
from rgbd_planes.fitting.window_moments import WindowMoments
from rgbd_planes.kernels.fits import tiles as tile_kernels

IMPLEMENTATIONS = ("direct", "integral", "naive")

_arrays_of = operator.attrgetter(*ARRAYS)


@functools.lru_cache(maxsize=16)
def _valid_needed(frame: tuple[int, int], tile: tuple[int, int], max_missing: float) -> npt.NDArray[np.float64]:
    """`valid_needed` of all tiles of a frame of (height, width)."""
    needed = valid_needed(tile_footprints(frame, tile)[:, 0], max_missing)
    needed.flags.writeable = False
    return needed


class TileFitter(GridFitter[TilePlanes]):
    """Fits the tiles of one camera's frames; what depends on the camera alone is computed once, here.

    Its attributes camera, tile, method and implementation cannot be changed: make a new one.

    Parameters
    ----------
    camera : Camera
    tile : int or (height, width)
        Size of a tile in pixels, at least 2 each way.
    method : str
        ``range_explicit``, ``range_implicit``, ``standard_explicit``, ``standard_implicit`` or ``standard_pca``:
        `fit_tiles` explains them.
    implementation : {"direct", "integral", "naive"}
        Single-pass tile moments; summed-area tables; each tile's pixels in turn.
    max_missing : float
        Share of missing pixels above which a tile gets TOO_FEW.
    max_error : float, optional
        Tiles with a larger ``rmse_metric``, in metres, get ROUGH.
    significance : float, optional
        Tiles whose residual the camera's noise exceeds less often than this get ROUGH. None is 0.01; 0 is no such test.
    num_threads : int, optional
        Threads that share a frame, or frames. None takes threads when the work is large enough to pay for them.

    Raises
    ------
    TypeError, ValueError
        An argument cannot be used: the message says what was expected and what came.
    """

    method: str
    implementation: str

    def __init__(
        self,
        camera: Camera,
        tile: int | tuple[int, int] = 16,
        method: str = "range_explicit",
        *,
        implementation: str = "direct",
        max_missing: float = 0.5,
        max_error: float | None = None,
        significance: float | None = None,
        num_threads: int | None = None,
    ) -> None:
        check_camera(camera)
        check_choice("method", method, METHODS)
        check_choice("implementation", implementation, IMPLEMENTATIONS)
        max_missing = check_share("max_missing", max_missing)
        tile = check_tile(tile, camera.shape)
        vars(self).update(camera=camera, tile=tile, method=method, implementation=implementation)
        self._options: dict[str, Any] = {
            "implementation": implementation, "max_missing": max_missing, "max_error": max_error,
            "significance": significance, "num_threads": num_threads,
        }  # fmt: skip
        self._max_error = check_max_error(max_error)
        self._num_threads = check_num_threads(num_threads)

        self._noise_is_asked = threading.Lock()
        self._takes_stacks = implementation == "direct"
        self._grid = grid_shape(camera, self.tile)
        # A copy: for a read-only array kernels would be compiled again.
        self._needed = _valid_needed(camera.shape, self.tile, max_missing).copy()
        self._compiled_for = method, implementation, camera.is_distorted
        self._assessment = assessment_of_tiles(camera, method, significance, self.tile)
        if implementation == "direct":
            centre, tan_x, tan_y = tile_rays(camera, self.tile)
            self._camera_arguments = (
                tan_x, tan_y, *self.tile, centre.reshape(2, -1), self._needed, *SOLVES[method], self._max_error,
            )  # fmt: skip
        else:
            self._windows = tile_windows(camera.shape, self.tile)
            self._window_moments = WindowMoments(camera, method, implementation)
            self._full_windows = np.empty((6, len(self._windows)))
            self._window_moments.camera_moments(self._windows, 0, len(self._windows), self._full_windows)

    def __repr__(self) -> str:
        (rows, columns), (height, width) = self._grid, self.tile
        return f"<TileFitter: {rows} x {columns} tiles of {height} x {width} pixels, {self.method}>"

    def __reduce__(self) -> tuple[Any, ...]:
        # Numba pickles a kernel as code to be compiled without its cache, and arrays come back writable, for which
        # kernels would be compiled again.
        return functools.partial(type(self), **self._options), (self.camera, self.tile, self.method)

    def _arrays(self, frames: tuple[int, ...], out: TilePlanes | None) -> Arrays:
        if out is None:
            return allocate(frames, self._grid)
        shape = frames + self._grid
        if (
            not isinstance(out, TilePlanes)
            or out.shape != shape
            or out.tile != self.tile
            or out.camera != self.camera
            or out.method != self.method
        ):
            raise ValueError(f"out must be a result of this fitter of shape {shape}, got {out!r}")
        arrays = dict(zip(ARRAYS, _arrays_of(out), strict=True))
        for name, array in arrays.items():
            if not (array.flags.c_contiguous and array.flags.writeable):
                raise ValueError(f"expected an out whose arrays are contiguous and may be written, {name} is not")
        statistics = out._asked_for
        if statistics is not None:
            arrays["_statistics"] = statistics.rows
        return arrays

    def _result(self, arrays: Arrays) -> TilePlanes:
        return TilePlanes(camera=self.camera, method=self.method, tile=self.tile, **arrays)

    def _into_result(self, out: TilePlanes) -> Callable[[DepthFrame], Work]:
        """`_into` the arrays of a result; kept with it, since checking and making it takes 5 µs."""
        statistics = getattr(out, "_asked_for", None)
        prepared = getattr(out, "_kept", None)
        if prepared is None or prepared[0] is not self or prepared[1] is not statistics:
            prepared = self, statistics, self._into(self._arrays((), out))
            out.__dict__["_kept"] = prepared
        fit: Callable[[DepthFrame], Work] = prepared[2]
        return fit

    def _into(self, arrays: Arrays) -> Callable[[DepthFrame], Work]:
        """Return a function of a frame, which returns a function that fits some of its tile rows into ``arrays``.

        The frame may hold several frames, as many as there are arrays for.
        """
        fit = self._direct(arrays) if self.implementation == "direct" else self._windowed(arrays)
        if self.camera.noise is None:
            return fit
        assess, columns = self._assessment.of(arrays), self._grid[1]

        def fit_and_assess(frame: DepthFrame) -> Work:
            if not self._noise_is_asked.locked():
                self._warn_of_noise(frame)
            fit_rows = fit(frame)

            def work(start: int, stop: int) -> None:
                fit_rows(start, stop)
                assess(start * columns, stop * columns)

            return work

        return fit_and_assess

    def _direct(self, arrays: Arrays) -> Callable[[DepthFrame], Work]:
        frames = arrays["status"].size // math.prod(self._grid)
        results = [array.reshape(frames, -1) for array in in_order(arrays)]

        def fit(frame: DepthFrame) -> Work:
            # Numba compiles for depth images and for disparity images.
            offset = frame.offset if frame.is_disparity else None
            values = frame.raw.reshape(frames, *self.camera.shape), frame.lowest, frame.highest, frame.scale, offset
            return lambda start, stop: tile_kernels.fit_tiles(*values, *self._camera_arguments, start, stop, *results)

        return fit

    def _windowed(self, arrays: Arrays) -> Callable[[DepthFrame], Work]:
        moments = arrays["_moments"].reshape(10, -1)
        columns = self._grid[1]

        def fit(frame: DepthFrame) -> Work:
            arrays["_reference"][:] = 0.0
            source = self._window_moments.prepare(frame)

            def work(start: int, stop: int) -> None:
                start, stop = start * columns, stop * columns
                source(self._windows, self._full_windows, start, stop, moments)
                solve_planes(self.method, arrays, self._needed, self._max_error, start, stop, source.total)

            return work

        return fit


def fit_tiles(
    depth: npt.ArrayLike,
    camera: Camera,
    tile: int | tuple[int, int] = 16,
    method: str = "range_explicit",
    *,
    implementation: str = "direct",
    max_missing: float = 0.5,
    max_error: float | None = None,
    significance: float | None = None,
    num_threads: int | None = None,
) -> TilePlanes:
    """Fit a plane to every tile of a depth frame.

    For many frames of one camera, make a `TileFitter` once; it has the same parameters.

    Parameters
    ----------
    depth : (H, W) array_like
        Depth along the optical axis, not along the ray: floats in metres, or integers in the camera's ``depth_scale``.
        Of a camera with ``disparity``, disparities. Missing is NaN, infinity, 0 and negative depth, one of the camera's
        ``invalid_values`` or outside its ``depth_range``.
    camera : Camera
    tile : int or (height, width)
        Size of a tile in pixels, at least 2 each way. A frame that is not a multiple of it keeps its ragged last row
        and column of tiles.
    method : str
        - ``range_explicit``: least squares of the inverse depth (the paper's eq. 15). It is the maximum-likelihood fit
          for a disparity sensor whose pixels err independently.
        - ``range_implicit``: eq. 14.
        - ``standard_explicit``: least squares of Z (eq. 7).
        - ``standard_implicit``: eq. 6.
        - ``standard_pca``: orthogonal regression.
    implementation : {"direct", "integral", "naive"}
        Single-pass tile moments; summed-area tables; each tile's pixels in turn. They give the same planes, up to
        rounding.
    max_missing : float
        Share of missing pixels above which a tile gets TOO_FEW. At 1 any pixels that determine a plane are fitted.
    max_error : float, optional
        Tiles with a larger ``rmse_metric``, in metres, get ROUGH.
    significance : float, optional
        For a camera with a noise model: tiles whose residual the noise alone exceeds less often than this get ROUGH, at
        any depth. None is 0.01, which is about one flat tile in a hundred; 0 is no such test.
    num_threads : int, optional
        None takes threads when the work is large enough to pay for them. The result is the same for any number.

    Returns
    -------
    TilePlanes
        Arrays of shape (R, C, ...).

    Raises
    ------
    TypeError, ValueError
        An argument cannot be used: the message says what was expected and what came.

    Warns
    -----
    UserWarning
        Something is most likely not meant as it is:

        - The unit of the frame. Its typical depth is above 50 m, or all of its depths are below 2 cm, or it has 8 bits
          and ends before 1 m, as a picture does.
        - The unit of the ``depth_range``. It begins beyond 50 m and leaves nothing of the frame, which lies between
          those numbers of millimetres.
        - A number that means missing, but counts as depth in more than one pixel of a hundred. It is 65535 or 32767,
          the largest of 16 bits, or a disparity of 0 or less. Or it is beyond 50 m and more than three times as far as
          all else, such as the 1e10 of a renderer's sky.
        - The direction of z. All depths are negative.
        - The unit of the camera's noise model. It says more than a fifth of 1/Z. A `TileFitter` asks one frame for it.

        A ``depth_range`` that reaches beyond 50 m says that such depths are meant, and one that ends below 2 cm, or
        1 m, says so of small ones. A ``disparity`` of scale 1 says that the depth has no unit, as a network's.

    Notes
    -----
    The implicit methods depend on the unit of length, since the paper's norm mixes the normal with an offset. Here it
    is the metre. Summed-area tables leave more rounding than single-pass moments: by the ``standard_`` methods small
    tiles may be DEGENERATE.
    """
    fitter = TileFitter(
        camera,
        tile,
        method,
        implementation=implementation,
        max_missing=max_missing,
        max_error=max_error,
        significance=significance,
        num_threads=num_threads,
    )
    return fitter.fit(depth)
