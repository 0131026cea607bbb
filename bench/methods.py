"""The paper's four methods as it timed them, on the paper's sensor: what the times are times of.

The sensor is the paper's: rays through the pixels of a 640x480 camera meet an arbitrary plane, and Gaussian
noise moves each point along its ray (Papadakis and Willis 2017, section "Results"). Everything runs in double
precision on the calling thread.
"""

from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
import numpy.typing as npt

from rgbd_planes import Camera
from rgbd_planes.camera.depth_frame import DepthFrame, as_depth_frame
from rgbd_planes.camera.rays import ray_tables
from rgbd_planes.evaluation import scenes
from rgbd_planes.fitting.methods import solve_planes, valid_needed
from rgbd_planes.fitting.results import allocate
from rgbd_planes.kernels.moments import summed_area
from rgbd_planes.kernels.moments import windows as window_pixels

WINDOW = 50
"""Side in pixels of the paper's subsets: 2500 points."""

TABLES = {"standard_implicit": 9, "range_implicit": 4, "standard_explicit": 8, "range_explicit": 3}
"""The paper's methods, and how many summed-area tables each needs for a frame."""

_camera = partial(Camera, width=640, height=480, fx=525.0, fy=525.0, cx=319.5, cy=239.5)
# Units of disparity a little finer than a Kinect v1's: 1/Z = scale·raw + offset, 0.47 m at 2047 and 7.7 m at 1000.
_DISPARITY = (1.9e-3, -1.77)


@cache
def sensor(disparity: bool = False) -> tuple[DepthFrame, Camera]:
    """The frame that everything is timed on, in millimetres or, of the same scene, in disparity units."""
    camera = _camera(disparity=_DISPARITY, invalid_values=(0.0,)) if disparity else _camera(depth_scale=1000.0)
    frame = scenes.plane((0.3, -0.2, -1.0), 2.0).render(camera).measure(seed=2017)
    return as_depth_frame(frame, camera), camera


def windows(count: int, side: int = WINDOW) -> npt.NDArray[np.int64]:
    """(count, 4) squares at random places of the frame; the same ones every time."""
    rng = np.random.default_rng(20170331)
    _, camera = sensor()
    rows = rng.integers(0, camera.height - side, count, endpoint=True)
    columns = rng.integers(0, camera.width - side, count, endpoint=True)
    return np.column_stack([rows, columns, np.full((count, 2), side)])


@dataclass
class Fit:
    """Planes of some windows of the sensor's frame, by one method and implementation, step by step.

    The explicit methods sum what their solution needs and no more, as the paper does, so integral ones come
    without a residual.
    """

    method: str
    windows: npt.NDArray[np.int64]
    implementation: str = "integral"
    disparity: bool = False

    def __post_init__(self) -> None:
        frame, camera = sensor(self.disparity)
        self._range = self.method.startswith("range")
        self._frame = frame.values, ray_tables(camera), None if self._range else True
        shape = camera.height + 1, camera.width + 1
        self._full = np.empty((6, len(self.windows)))
        nothing_missing = np.empty((0, 0), np.int32), np.empty((0, 5))
        self._missing = nothing_missing if self._range else (np.empty((0, 0, 1)),)
        if self._range:
            self._camera_tables = np.empty((*shape, 6))
            summed_area.camera_tables(*ray_tables(camera), self._camera_tables)
            self._look_up_camera()
        self._tables = np.zeros((*shape, TABLES[self.method]))
        self.arrays = allocate((), (len(self.windows),))
        self._needed = valid_needed(self.windows[:, 2] * self.windows[:, 3], 0.5)

    def build(self) -> None:
        """Build the frame's summed-area tables."""
        summed_area.frame_tables(*self._frame, self._tables)

    def _look_up_camera(self) -> None:
        summed_area.camera_window_moments(self._camera_tables, self.windows, 0, len(self.windows), self._full)

    def planes_of_new_windows(self) -> None:
        """Fit all windows as if no frame before had them: the camera's terms are looked up, too."""
        if self._range:
            self._look_up_camera()
        self.planes()

    def planes(self) -> None:
        """Fit all windows, from the tables or from their pixels; what depends on the camera alone is there."""
        kernel: Any
        source: tuple[Any, ...]
        if self.implementation == "integral":
            kernel = summed_area.range_window_moments if self._range else summed_area.standard_window_moments
            source = (self._tables, *self._missing)
        else:
            kernel, source = window_pixels.window_moments, self._frame
        count = len(self.windows)
        kernel(*source, self.windows, self._full, 0, count, self.arrays["_moments"])
        solve_planes(self.method, self.arrays, self._needed, np.inf, 0, count)

    def frame(self) -> None:
        """Do all that one frame needs: build the tables, if any, and fit the windows."""
        if self.implementation == "integral":
            self.build()
        self.planes()
