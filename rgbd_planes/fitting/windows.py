"""Fit planes to arbitrary rectangles of a depth frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.checks import check_choice, check_max_error, check_num_threads, check_share, plain_array
from rgbd_planes._core.compile_notice import announced
from rgbd_planes._core.text import counted
from rgbd_planes._core.threads import choose_num_threads, run_in_ranges
from rgbd_planes.camera.camera import Camera, check_camera
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.camera.frame_warnings import warn_of_noise
from rgbd_planes.fitting.methods import METHODS, solve_planes, valid_needed
from rgbd_planes.fitting.results import PlacedFits, allocate
from rgbd_planes.fitting.saving import Savable, Values, check_fits
from rgbd_planes.fitting.window_moments import WindowMoments
from rgbd_planes.plotting.protocols import Outlines
from rgbd_planes.uncertainty.falloff import growth_of_windows
from rgbd_planes.uncertainty.footprints import footprints
from rgbd_planes.uncertainty.statistics import Assessment

if TYPE_CHECKING:
    from rgbd_planes.kernels.statistics.pixel_runs import PixelRuns

_AS_TABLES = 3
"""Summed-area tables take as long as the pixels of windows that have so many times those of the frame."""


@dataclass(frozen=True, eq=False, repr=False)
class WindowPlanes(Savable, PlacedFits):
    """The planes of K windows of a frame, arrays of shape S = (K,).

    It has the p-values, covariances, `plot`, `to_table`, `save` and `load` that `TilePlanes` has.

    Attributes
    ----------
    windows : (K, 4) int64
        Row, column, height, width of each window in pixels.
    """

    windows: npt.NDArray[np.int64]
    _frame_total: float = field(default=0.0, kw_only=True, metadata={"saved": "total"})

    @property
    def _total(self) -> float:
        return self._frame_total

    def _cells(self, rows: npt.NDArray[np.int64], columns: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """(H', W') int64: the window at these rows and columns of pixels, the smallest of several; -1 none."""
        cells = np.full(self.camera.shape, -1, np.int64)
        for i in np.argsort(-self.windows[:, 2:].prod(axis=1), kind="stable"):
            top, left, height, width = self.windows[i]
            cells[top : top + height, left : left + width] = i
        return cells[rows[:, None], columns]

    def _places(self) -> dict[str, npt.NDArray[Any]]:
        return dict(zip(("top", "left", "height", "width"), self.windows.T, strict=True))

    @property
    def _assessment(self) -> Assessment:
        return _assessment_of(self.camera, self.method, 0.0, self.windows)

    @property
    def _footprint(self) -> npt.NDArray[np.int64]:
        return footprints(self.windows)

    @property
    def _runs(self) -> PixelRuns:
        from rgbd_planes.uncertainty.pixel_runs import runs_of_windows

        return runs_of_windows(self.windows, self.valid_count.ravel())

    @property
    def _title(self) -> str:
        return counted(len(self.windows), "window")

    @property
    def _outlines(self) -> Outlines | None:
        if not len(self.windows):
            return None
        return Outlines(float(np.median(self.windows[:, 2:].min(axis=1))), windows=self.windows)

    @classmethod
    def _checked(cls, values: Values) -> Values:
        windows = check_windows(values["windows"], values["camera"])
        check_fits(values, (len(windows),), windows[:, 2:].prod(axis=1))
        return {**values, "windows": windows, "_frame_total": float(values["_frame_total"])}


def fit_windows(
    depth: npt.ArrayLike,
    camera: Camera,
    windows: npt.ArrayLike,
    method: str = "range_explicit",
    *,
    implementation: str | None = None,
    max_missing: float = 0.5,
    max_error: float | None = None,
    significance: float | None = None,
    num_threads: int | None = None,
) -> WindowPlanes:
    """Fit a plane to each of many rectangles of a frame, which may overlap.

    Many windows cost little more than a few. Windows that together have more than three times the pixels of the frame
    are fitted from summed-area tables (the paper's section on integral images).

    Parameters
    ----------
    depth : (H, W) array_like
        The frame: floats in metres, or integers in the camera's ``depth_scale``; disparities of a camera that has
        ``disparity``.
    camera : Camera
    windows : (K, 4) array_like of int
        Row, column, height, width of each window in pixels, inside the frame.
    method : str
        ``range_explicit``, ``range_implicit``, ``standard_explicit``, ``standard_implicit`` or ``standard_pca``:
        `fit_tiles` explains them.
    implementation : {"integral", "naive"}, optional
        Summed-area tables, or each window's pixels. By default what takes less time.
    max_missing : float
        Share of missing pixels above which a window gets TOO_FEW.
    max_error : float, optional
        Windows with a larger ``rmse_metric``, in metres, get ROUGH.
    significance : float, optional
        Windows whose residual the camera's noise exceeds less often than this get ROUGH. None is 0.01; 0 is no such
        test.
    num_threads : int, optional
        None takes threads when the work is large enough to pay for them.

    Returns
    -------
    WindowPlanes
        Arrays of shape (K, ...).

    Raises
    ------
    TypeError, ValueError
        An argument cannot be used: the message says what was expected and what came. Windows must be (K, 4) integers,
        not empty, and wholly inside the frame.

    Warns
    -----
    UserWarning
        Something in the frame is most likely not meant as it is, such as its unit: `fit_tiles` lists what.

    Notes
    -----
    Fits by tables differ from those of `fit_tiles` only by float64's rounding, which acts on differences of sums over
    the whole frame. So small windows of large frames may be DEGENERATE. The standard methods
    show it on a wall at 8 m with the noise of a Kinect v1 and a field of view of 63 degrees. In 3840 x 2160 all windows
    of 3x3 and 4x4 pixels are DEGENERATE, and some of 8x8. In 1920 x 1080 at most half of 3x3 are, in 640 x 480 none. In
    range space some of 3x3 are in 3840 x 2160, if half of the frame is nearer than 10 cm.

    Simulators give depths of hundreds of kilometres for none. By the standard methods they make all windows inexact:
    one of 1000 km by tenths of a degree. Beyond that nothing is left of the others, and they get DEGENERATE. In range
    space a depth of micrometres does the same. The camera's ``depth_range`` or ``invalid_values`` exclude such depths.
    """
    check_camera(camera)
    check_choice("method", method, METHODS)
    if implementation is not None:
        check_choice("implementation", implementation, ("integral", "naive"))
    max_missing = check_share("max_missing", max_missing)
    num_threads = check_num_threads(num_threads)
    error = check_max_error(max_error)
    rectangles = check_windows(windows, camera)
    frame = as_depth_frame(depth, camera)
    warn_of_noise(frame, camera.noise)

    arrays = allocate((), (len(rectangles),))
    areas = rectangles[:, 2:].prod(axis=1)
    pixels = int(areas.sum())
    if implementation is None:
        implementation = "naive" if pixels <= _AS_TABLES * frame.raw.size else "integral"
    assess = _assessment_of(camera, method, significance, rectangles).of(arrays)
    needed = valid_needed(areas, max_missing)
    threads = choose_num_threads(num_threads, pixels if implementation == "naive" else frame.raw.size)
    with announced(("windows", method, implementation, camera.is_distorted, frame.raw.dtype)):
        window_moments = WindowMoments(camera, method, implementation)
        source = window_moments.prepare(frame)
        full = np.empty((6, len(rectangles)))

        def fit_some(start: int, stop: int) -> None:
            window_moments.camera_moments(rectangles, start, stop, full)
            source(rectangles, full, start, stop, arrays["_moments"])
            solve_planes(method, arrays, needed, error, start, stop, source.total)
            assess(start, stop)

        run_in_ranges(fit_some, len(rectangles), threads)
    return WindowPlanes(camera=camera, method=method, windows=rectangles, _frame_total=source.total, **arrays)


def _assessment_of(
    camera: Camera, method: str, significance: float | None, windows: npt.NDArray[np.int64]
) -> Assessment:
    growth = growth_of_windows(camera, windows)
    return Assessment(camera, method, significance, windows[:, 2:], footprints(windows), growth)


def check_windows(windows: npt.ArrayLike, camera: Camera) -> npt.NDArray[np.int64]:
    """Return the windows as a new contiguous (K, 4) int64 array."""
    array = plain_array("windows", windows)
    if array.ndim == 0:
        raise TypeError(f"expected windows as an array of shape (K, 4), got {type(windows).__name__}")
    if array.size == 0:
        array = np.empty((0, 4), np.int64)
    if array.ndim != 2 or array.shape[1] != 4:
        raise ValueError(f"windows must have shape (K, 4): row, column, height, width; got {array.shape}")
    if array.dtype.kind not in "iu":
        raise TypeError(f"windows must be integers, got dtype {array.dtype}")
    top, left, height, width = array.T.astype(np.int64)  # what only uint64 holds comes out negative
    bad = (top < 0) | (left < 0) | (height < 1) | (width < 1)
    bad |= (top > camera.height - height) | (left > camera.width - width)  # a sum might overflow
    if bad.any():
        first = int(np.flatnonzero(bad)[0])
        raise ValueError(
            f"windows must lie inside the frame of (height, width) = {camera.shape}, "
            f"got {array[first].tolist()} (row, column, height, width) as window {first}"
        )
    return np.array(array, np.int64, order="C")
