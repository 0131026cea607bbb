"""From a frame to the moments of any rectangles of it: by summed-area tables, or from the pixels of each."""

import threading
from typing import Any

import numpy as np
import numpy.typing as npt

from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.depth_frame import DepthFrame
from rgbd_planes.camera.rays import ray_tables
from rgbd_planes.kernels.moments import summed_area
from rgbd_planes.kernels.moments import windows as window_pixels


class WindowMoments:
    """Moments of any windows of one camera's frames, from summed-area tables or from the pixels.

    Parameters
    ----------
    camera : Camera
    method : str
        One of `fitting.methods.METHODS`.
    implementation : {"integral", "naive"}
    """

    def __init__(self, camera: Camera, method: str, implementation: str) -> None:
        self._arguments = camera, method, implementation
        self._rays = ray_tables(camera)
        self._arrays = threading.local()
        self._range = method.startswith("range")
        self._standard = None if self._range else True  # as the kernels take it
        self._integral = implementation == "integral"
        self._table_shape = (camera.height + 1, camera.width + 1)
        self._camera_tables = np.empty((0, 0, 6))
        if self._range and self._integral:
            self._camera_tables = np.empty((*self._table_shape, 6))
            summed_area.camera_tables(*self._rays, self._camera_tables)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._arguments  # tables stay in their threads

    def camera_moments(
        self, windows: npt.NDArray[np.int64], start: int, stop: int, full: npt.NDArray[np.float64]
    ) -> None:
        """Write the camera terms of windows ``start`` to ``stop``, whatever the frame, into (6, K) ``full``.

        Nothing is written for a method or an implementation that does not use it.
        """
        if len(self._camera_tables):
            summed_area.camera_window_moments(self._camera_tables, _as_one_type(windows), start, stop, full)

    def prepare(self, frame: DepthFrame) -> "Source":
        """Build the tables of a frame, if any, once for all its windows.

        They are valid until the same thread prepares its next frame.
        """
        values = frame.values
        if not self._integral:
            return Source(window_pixels.window_moments, (values, self._rays, self._standard), 0.0)
        height, width = self._table_shape
        holes = summed_area.count_missing(values)
        tables = self._scratch("tables", (height, width, 4 if self._range else 9))
        summed_area.frame_tables(values, self._rays, self._standard, tables)
        if not self._range:
            missing = np.empty((0, 0, 1))
            if holes:
                missing = self._scratch("missing", (height, width, 1))
                summed_area.missing_table(values, missing)
            return Source(summed_area.standard_window_moments, (tables, missing), _total(tables, 3, 6, 8))
        before, sums = np.empty((0, 0), np.int32), np.empty((0, 5))
        if holes:
            before = self._scratch("before", (height - 1, width), np.int32)
            sums = np.empty((holes + 1, 5))
            summed_area.missing_rays(values, self._rays, before, sums)
        total = _total(self._camera_tables, 3, 5)
        return Source(summed_area.range_window_moments, (tables, before, sums), total)

    def _scratch(self, name: str, shape: tuple[int, ...], dtype: npt.DTypeLike = np.float64) -> npt.NDArray[Any]:
        """This thread's array with a name: fresh memory for every frame would cost as much as filling it."""
        arrays = self._arrays.__dict__
        if name not in arrays:
            arrays[name] = np.empty(shape, dtype)
        array: npt.NDArray[Any] = arrays[name]
        return array


def _as_one_type(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Contiguous and read-only: for other arrays the kernels would be compiled again."""
    view = np.ascontiguousarray(array).view()
    view.flags.writeable = False
    return view


def _total(tables: npt.NDArray[np.float64], *channels: int) -> float:
    """The sum over all pixels of the frame of some channels."""
    return float(tables[-1, -1, list(channels)].sum())


class Source:
    """A prepared frame: call it for the moments of some windows.

    ``total`` is the sum of the squares in the tables, by which `fitting.methods.solve_planes` tells rounding from
    scatter.
    """

    def __init__(self, kernel: Any, arguments: tuple[Any, ...], total: float) -> None:
        self._kernel = kernel
        self._arguments = arguments
        self.total = total

    def __call__(
        self,
        windows: npt.NDArray[np.int64],
        full: npt.NDArray[np.float64],
        start: int,
        stop: int,
        moments: npt.NDArray[np.float64],
    ) -> None:
        """Write the moments, about the origin, of windows ``start`` to ``stop`` into (10, K) ``moments``.

        ``full`` is what `WindowMoments.camera_moments` wrote for these windows.
        """
        self._kernel(*self._arguments, _as_one_type(windows), _as_one_type(full), start, stop, moments)
