"""Fit a plane to every tile of a depth frame."""

import json
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import numpy.typing as npt

from rgbd_planes.camera import Camera
from rgbd_planes.compilation import announced
from rgbd_planes.depth import DepthFrame, as_depth_frame
from rgbd_planes.fit_statistics import RoughTest
from rgbd_planes.fitting import (
    METHODS,
    RESULTS,
    Arrays,
    WindowMoments,
    check_choice,
    check_error,
    check_share,
    solve_planes,
    valid_needed,
)
from rgbd_planes.kernels import grid, moments
from rgbd_planes.plane_fits import PlaneFits, TileStatus, allocate
from rgbd_planes.threads import check_num_threads, choose_num_threads, run_in_ranges, submit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

IMPLEMENTATIONS = ("direct", "integral", "naive")


@dataclass(frozen=True, eq=False, repr=False)
class TilePlanes(PlaneFits):
    """The planes of all tiles of a frame, (R, C), or of a batch of frames, (F, R, C).

    Attributes
    ----------
    tile : (height, width)
        Size of a tile in pixels; the last row and column may be smaller, see `tile_heights`, `tile_widths`.
    """

    tile: tuple[int, int]

    @property
    def tile_heights(self) -> npt.NDArray[np.int64]:
        """(R,) int64: height in pixels of each row of tiles."""
        return _sizes(self.camera.height, self.tile[0])

    @property
    def tile_widths(self) -> npt.NDArray[np.int64]:
        """(C,) int64: width in pixels of each column of tiles."""
        return _sizes(self.camera.width, self.tile[1])

    def __getitem__(self, frame: int) -> "TilePlanes":
        """The planes of one frame of a batch, without copying."""
        if len(self.shape) != 3:
            raise TypeError(
                "only the planes of a batch of frames can be indexed; index an array, such as .planes"
            )
        return TilePlanes(
            camera=self.camera, method=self.method, tile=self.tile,
            **{name: getattr(self, name)[frame] for name in _ARRAYS},
        )  # fmt: skip

    def __len__(self) -> int:
        """Number of frames of a batch."""
        if len(self.shape) != 3:
            raise TypeError("the planes of a single frame have no length; see .shape")
        return self.shape[0]

    def __repr__(self) -> str:
        *frames, rows, columns = self.shape
        count = f"{frames[0]} frames of " if frames else ""
        height, width = self.tile
        return (
            f"<TilePlanes: {count}{rows} x {columns} tiles of {height} x {width} pixels, {self._summary()}>"
        )

    def _repr_html_(self) -> str:
        """What a notebook shows: the counts and a small picture."""
        from rgbd_planes.preview import tiles_html

        return tiles_html(self)

    def to_table(self) -> dict[str, npt.NDArray[Any]]:
        """Return one row a tile as a dict of equally long columns, which `pandas.DataFrame` takes.

        Columns: frame (of a batch), row, column of the tile; top, left, height, width in pixels; status (its
        name), valid_count; nx, ny, nz, d; rmse, rmse_metric.
        """
        *frame, row, column = np.indices(self.shape).reshape(len(self.shape), -1)
        names = np.array([status.name for status in TileStatus])
        planes = self.planes.reshape(-1, 4)
        table = {"frame": frame[0]} if frame else {}
        return table | {
            "row": row,
            "column": column,
            "top": row * self.tile[0],
            "left": column * self.tile[1],
            "height": self.tile_heights[row],
            "width": self.tile_widths[column],
            "status": names[self.status.ravel()],
            "valid_count": self.valid_count.ravel(),
            "nx": planes[:, 0],
            "ny": planes[:, 1],
            "nz": planes[:, 2],
            "d": planes[:, 3],
            "rmse": self.rmse.ravel(),
            "rmse_metric": self.rmse_metric.ravel(),
        }

    def plot(self, depth: npt.ArrayLike | None = None, figure: "Figure | None" = None) -> "Figure":
        """Draw the depth, the normals as colours and the tiles by status; see `plotting.plot_tiles`.

        Parameters
        ----------
        depth : (H, W) array_like, optional
            The frame that was fitted; without it the fitted planes' own depth is drawn.
        figure : matplotlib Figure, optional
            Drawn into; a new one by default.
        """
        from rgbd_planes.plotting import plot_tiles

        metres = None if depth is None else as_depth_frame(depth, self.camera).metres
        return plot_tiles(self, metres, figure)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an NPZ file, camera included, that `load` reads; whole or not at all."""
        from rgbd_planes.files import write_beside

        arrays = {name.lstrip("_"): getattr(self, name) for name in _ARRAYS}
        about = json.dumps({"camera": self.camera.to_dict(), "tile": self.tile, "method": self.method})
        with write_beside(path) as beside, open(beside, "wb") as file:
            np.savez_compressed(file, about=np.array(about), **arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a file that `save` wrote."""
        with np.load(path, allow_pickle=False) as file:
            if "about" not in file:
                raise ValueError(f"expected a file that TilePlanes.save wrote, got {os.fspath(path)}")
            about = json.loads(str(file["about"]))
            arrays = {name: file[name.lstrip("_")] for name in _ARRAYS}
        height, width = about["tile"]
        return cls(
            camera=Camera.from_dict(about["camera"]),
            method=about["method"],
            tile=(height, width),
            **arrays,
        )


_ARRAYS = ("_moments", "_reference", *RESULTS)


class TileFitter:
    """Fits the tiles of one camera's frames; what depends on the camera alone is computed once, here.

    Parameters
    ----------
    camera : Camera
    tile : int or (height, width)
        Size of a tile in pixels, at least 2 each way. A frame that is no multiple of it keeps its ragged
        last row and column of tiles.
    method : str
        ``range_explicit``, least squares of the inverse depth (eq. RGBD_explicit_fit), the maximum-likelihood
        fit for a disparity sensor; ``range_implicit`` (eq. tan_theta_scattermatrix); ``standard_explicit``,
        least squares of Z (eq. explicit_fit_std); ``standard_implicit`` (eq. XYZ_scattermatrix);
        ``standard_pca``, the orthogonal regression. The implicit methods depend on the unit of length, since
        the paper's norm mixes the normal with an offset: here it is the metre.
    implementation : {"direct", "integral", "naive"}
        Single-pass tile moments; summed-area tables; each tile's pixels in turn. They give the same planes.
    max_missing : float
        Share of missing pixels above which a tile gets TOO_FEW; at 1 whatever determines a plane is fitted.
    max_error : float, optional
        Tiles with a larger ``rmse_metric``, in metres, get ROUGH.
    significance : float, optional
        Where the camera has a noise model: tiles whose residual the noise alone makes larger less often than
        this get ROUGH, at any depth. None is 0.01: about one flat tile in a hundred; 0 is no such test.
    num_threads : int, optional
        None takes threads when the work is large enough to pay for them. The result is the same for any.

    Raises
    ------
    TypeError, ValueError
        For an argument that cannot be used, saying what was expected and what came.
    """

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
        if not isinstance(camera, Camera):
            raise TypeError(f"expected a Camera, got {type(camera).__name__}")
        check_choice("method", method, METHODS)
        check_choice("implementation", implementation, IMPLEMENTATIONS)
        check_share("max_missing", max_missing)
        check_num_threads(num_threads)
        self.camera = camera
        self.tile = _check_tile(tile, camera)
        self.method = method
        self.implementation = implementation
        self._max_error = check_error(max_error)
        self._num_threads = num_threads

        self._grid = len(_sizes(camera.height, self.tile[0])), len(_sizes(camera.width, self.tile[1]))
        self._centre, self._full = _camera_terms(camera, self.tile)
        self._needed = valid_needed(self._full[0], max_missing).ravel()
        self._rough_test = RoughTest(camera.noise, significance, self.tile[0] * self.tile[1])
        if implementation == "direct":
            self._kernel: Any = (
                grid.fit_range_tiles if method.startswith("range") else grid.fit_standard_tiles
            )
            rays = (
                (camera.tan_x_columns, camera.tan_y_rows)
                if camera.is_separable
                else (camera.tan_x, camera.tan_y)
            )
            self._of_camera = (
                *rays, *self.tile, self._centre, self._full, self._needed, METHODS.index(method), self._max_error
            )  # fmt: skip
        else:
            self._windows = _windows(camera, self.tile)
            self._window_moments = WindowMoments(camera, method, implementation)
            self._full_windows = np.empty((6, len(self._windows)))
            self._window_moments.camera_moments(self._windows, 0, len(self._windows), self._full_windows)

    def fit(self, depth: npt.ArrayLike, out: TilePlanes | None = None) -> TilePlanes:
        """Fit the tiles of a frame.

        Parameters
        ----------
        depth : (H, W) array_like
            Unsigned integers in the camera's ``depth_scale`` or ``disparity``, or floats in metres.
        out : TilePlanes, optional
            An earlier result for a frame of this fitter: its arrays are written into, and it is returned.

        Returns
        -------
        TilePlanes
            Arrays of shape (R, C, ...).
        """
        frame = as_depth_frame(depth, self.camera)
        arrays = self._arrays((), out)
        threads = choose_num_threads(self._num_threads, frame.raw.size)
        with announced((self.method, self.implementation, self.camera.is_separable, frame.raw.dtype)):
            run_in_ranges(self._work(frame, arrays), self._grid[0], threads)
        return self._result(arrays) if out is None else out

    def fit_batch(
        self, frames: Sequence[npt.ArrayLike] | npt.NDArray[Any], out: TilePlanes | None = None
    ) -> TilePlanes:
        """Fit the tiles of many frames, which threads share.

        Parameters
        ----------
        frames : (F, H, W) array or sequence of (H, W)
        out : TilePlanes, optional
            An earlier result for as many frames, as in `fit`.

        Returns
        -------
        TilePlanes
            Arrays of shape (F, R, C, ...).
        """
        if len(frames) == 0:
            raise ValueError("expected at least one frame, got none")
        arrays = self._arrays((len(frames),), out)
        rows = self._grid[0]

        def fit_some(start: int, stop: int) -> None:
            """Fit tile rows ``start`` to ``stop``, counted through all frames."""
            for i in range(start // rows, -(-stop // rows)):
                work = self._work(
                    as_depth_frame(frames[i], self.camera), {name: array[i] for name, array in arrays.items()}
                )
                work(max(start - i * rows, 0), min(stop - i * rows, rows))

        pixels = len(frames) * self.camera.width * self.camera.height
        with announced(
            (self.method, self.implementation, self.camera.is_separable, np.asarray(frames[0]).dtype)
        ):
            run_in_ranges(fit_some, len(frames) * rows, choose_num_threads(self._num_threads, pixels))
        return self._result(arrays) if out is None else out

    def fit_stream(self, frames: Iterable[npt.ArrayLike]) -> Iterator[TilePlanes]:
        """Fit the tiles of frames one after the other, as they come, in constant memory.

        Parameters
        ----------
        frames : iterable of (H, W) array_like
            Of any length, even without end: a generator that reads a camera or files.

        Yields
        ------
        TilePlanes
            Of one frame, in order. With ``num_threads`` above 1 so many frames are fitted at a time, and read
            ahead: a frame must then not be overwritten before its planes have come. Otherwise each frame is
            done with before the next is asked for.
        """
        ahead = 1 if self._num_threads is None else self._num_threads
        if ahead == 1:
            for frame in frames:
                yield self.fit(frame)
            return
        waiting: deque[Future[TilePlanes]] = deque()
        for frame in frames:
            waiting.append(submit(self._fit_alone, frame, ahead))
            if len(waiting) == ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()

    def _fit_alone(self, depth: npt.ArrayLike) -> TilePlanes:
        """Fit a frame in this thread."""
        arrays = self._arrays((), None)
        self._work(as_depth_frame(depth, self.camera), arrays)(0, self._grid[0])
        return self._result(arrays)

    def _arrays(self, frames: tuple[int, ...], out: TilePlanes | None) -> Arrays:
        if out is None:
            return allocate(frames, self._grid)
        shape = frames + self._grid
        if (
            out.shape != shape
            or out.tile != self.tile
            or out.camera is not self.camera
            or out.method != self.method
        ):
            raise ValueError(f"out must be a result of this fitter of shape {shape}, got {out!r}")
        out._forget_statistics()
        return {name: getattr(out, name) for name in _ARRAYS}

    def _result(self, arrays: Arrays) -> TilePlanes:
        return TilePlanes(camera=self.camera, method=self.method, tile=self.tile, **arrays)

    def _work(self, frame: DepthFrame, arrays: Arrays) -> Callable[[int, int], None]:
        """Return what fits tile rows ``start`` to ``stop`` of a frame into arrays of shape (R, C, ...)."""
        columns = self._grid[1]
        flat = _flat(arrays)
        fit = self._direct(frame, flat) if self.implementation == "direct" else self._windowed(frame, flat)
        if self._rough_test.is_empty:
            return fit

        def fit_and_test(start: int, stop: int) -> None:
            fit(start, stop)
            self._rough_test.mark(self.method, flat, start * columns, stop * columns)

        return fit_and_test

    def _direct(self, frame: DepthFrame, flat: Arrays) -> Callable[[int, int], None]:
        # Numba compiles for a depth image or for a disparity image.
        offset = frame.offset if frame.is_disparity else None
        results = flat.values()

        def fit(start: int, stop: int) -> None:
            self._kernel(
                frame.raw, frame.lowest, frame.highest, frame.scale, offset, *self._of_camera,
                start, stop, *results,
            )  # fmt: skip

        return fit

    def _windowed(self, frame: DepthFrame, flat: Arrays) -> Callable[[int, int], None]:
        flat["_reference"][:] = 0.0
        source = self._window_moments.prepare(frame)
        columns = self._grid[1]

        def fit(start: int, stop: int) -> None:
            start, stop = start * columns, stop * columns
            source(self._windows, self._full_windows, start, stop, flat["_moments"])
            solve_planes(self.method, flat, self._needed, self._max_error, start, stop)

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

    For many frames of one camera, make a `TileFitter` once. See there for the parameters.

    Parameters
    ----------
    depth : (H, W) array_like
        Unsigned integers in the camera's ``depth_scale`` or ``disparity``, or floats in metres. Missing is 0,
        NaN, infinity, negative, one of the camera's ``invalid_values`` or outside its ``depth_range``.
    camera, tile, method, implementation, max_missing, max_error, significance, num_threads
        As in `TileFitter`.

    Returns
    -------
    TilePlanes
        Arrays of shape (R, C, ...).
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


def _check_tile(tile: int | tuple[int, int], camera: Camera) -> tuple[int, int]:
    """Return the tile's (height, width)."""
    sides = (tile, tile) if isinstance(tile, (int, np.integer)) else tuple(np.atleast_1d(tile))
    if len(sides) != 2 or not all(isinstance(side, (int, np.integer)) for side in sides):
        raise TypeError(f"tile must be a whole number of pixels or (height, width), got {tile!r}")
    height, width = int(sides[0]), int(sides[1])
    if height < 2 or width < 2:
        raise ValueError(f"tile must be at least 2 x 2 pixels, got {tile!r}")
    if height > camera.height or width > camera.width:
        raise ValueError(
            f"tile must fit into the frame of {camera.height} x {camera.width} pixels (height x width), "
            f"got {tile!r}"
        )
    return height, width


@lru_cache(maxsize=4)
def _camera_terms(
    camera: Camera, tile: tuple[int, int]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """The mean ray of each tile, (2, R, C), and the six camera terms of the full tile about it, (6, R, C)."""
    heights, widths = _sizes(camera.height, tile[0]), _sizes(camera.width, tile[1])
    centre = np.empty((2, len(heights), len(widths)))
    full = np.empty((6, len(heights), len(widths)))
    if camera.is_separable:
        u0, s_u, s_uu = _sums(camera.tan_x_columns, widths)
        v0, s_v, s_vv = _sums(camera.tan_y_rows, heights)
        centre[0], centre[1] = u0, v0[:, None]
        sums = ((heights, widths), (heights, s_u), (s_v, widths), (heights, s_uu), (s_v, s_u), (s_vv, widths))
        for term, (of_row, of_column) in zip(full, sums, strict=True):
            np.multiply(of_row[:, None], of_column, out=term)
    else:
        with announced("full_tile_moments"):
            moments.full_tile_moments(camera.tan_x, camera.tan_y, *tile, centre, full)
    centre.flags.writeable = full.flags.writeable = False
    return centre, full


def _sums(values: npt.NDArray[np.float64], sizes: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """Mean of each run of ``sizes`` values, and the sums of the deviations from it and of their squares."""
    starts = np.cumsum(sizes) - sizes
    mean = np.add.reduceat(values, starts) / sizes
    deviation = values - np.repeat(mean, sizes)
    return np.stack([mean, np.add.reduceat(deviation, starts), np.add.reduceat(deviation**2, starts)])


def _flat(arrays: Arrays) -> dict[str, npt.NDArray[Any]]:
    """The arrays of one frame in the order of `_ARRAYS`, tiles in one dimension: (10, T), (3, T), (T, ...)."""
    count = arrays["status"].size
    return {
        "_moments": arrays["_moments"].reshape(10, count),
        "_reference": arrays["_reference"].reshape(3, count),
        "planes": arrays["planes"].reshape(count, 4),
        "alpha": arrays["alpha"].reshape(count, 3),
    } | {name: arrays[name].reshape(count) for name in _ARRAYS[4:]}


def _sizes(length: int, tile: int) -> npt.NDArray[np.int64]:
    """Sizes of the tiles along a side, the last one ragged."""
    starts = np.arange(0, length, tile)
    return np.minimum(starts + tile, length) - starts


def _windows(camera: Camera, tile: tuple[int, int]) -> npt.NDArray[np.int64]:
    """(R * C, 4) int64: row, column, height, width of every tile."""
    heights, widths = _sizes(camera.height, tile[0]), _sizes(camera.width, tile[1])
    windows = np.empty((len(heights), len(widths), 4), np.int64)
    windows[..., 0] = (np.arange(len(heights)) * tile[0])[:, None]
    windows[..., 1] = np.arange(len(widths)) * tile[1]
    windows[..., 2] = heights[:, None]
    windows[..., 3] = widths
    return windows.reshape(-1, 4)
