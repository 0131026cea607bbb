"""Normals and surface variation around every pixel of a depth frame."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.checks import check_bool, check_num_threads, check_share, check_window
from rgbd_planes._core.compile_notice import announced
from rgbd_planes._core.threads import choose_num_threads, run_in_ranges
from rgbd_planes.camera.camera import Camera, check_camera
from rgbd_planes.camera.depth_frame import DepthFrame, as_depth_frame, some_of, step_of
from rgbd_planes.fitting.methods import valid_needed
from rgbd_planes.kernels.fits import edge_windows
from rgbd_planes.kernels.fits import normals as normal_kernels
from rgbd_planes.kernels.moments.sliding_window import BAND

_EDGES = 0.2  # most of the windows of a frame that are across edges


def normals(
    depth: npt.ArrayLike,
    camera: Camera,
    window: int = 7,
    *,
    avoid_edges: bool = False,
    max_missing: float = 0.5,
    num_threads: int | None = None,
) -> npt.NDArray[np.float32]:
    """Fit a plane to the window around every pixel and return its normal.

    The plane is the least-squares fit of the inverse depth to the window's valid pixels (the paper's eq. 15), whatever
    is missing; at the border the window is clipped. The time hardly depends on the window's size.

    Parameters
    ----------
    depth : (H, W) array_like
        The frame: floats in metres, or integers in the camera's ``depth_scale``; disparities of a camera that has
        ``disparity``.
    camera : Camera
    window : int
        Side of the square window in pixels: odd, 3 to 31.
    avoid_edges : bool
        Keep normals from bleeding over steps and creases. An edge may run through a pixel's window, or too much of it
        may be missing. Then the best of eight windows beside it is used, which still hold the pixel: the one with the
        smallest residual. It takes about four times as long.
    max_missing : float
        Share of the window's pixels inside the frame above which there is no normal. At 1 any pixels that determine a
        plane will do.
    num_threads : int, optional
        None takes threads when the frame is large enough to pay for them. The result is the same for any number.

    Returns
    -------
    (H, W, 3) ndarray of float32
        Unit normals towards the camera: n·m < 0 along the pixel's ray m. A normal is NaN where the pixel is missing, or
        too much of its window. It is NaN, too, where the window's valid pixels lie on one line, or the pixel's ray does
        not meet the fitted plane.

    Raises
    ------
    TypeError, ValueError
        An argument cannot be used: the message says what was expected and what came.

    Warns
    -----
    UserWarning
        Something in the frame is most likely not meant as it is, such as its unit: `fit_tiles` lists what.

    Notes
    -----
    A window counts as crossed by an edge when the variance of its residuals exceeds that of a window beside it by more
    than noise explains. Independent normal noise exceeds the limit in one to two cases of a thousand, or in four with a
    window of 3. There is no threshold to set. A window does not count where rounding to the frame's raw values makes as
    large a variance. Nor does it where most windows of the frame have one as large. Sensors round, too, and neighbours
    share errors, so some windows are far calmer than others by chance.

    Where the frame is much noisier than elsewhere, chance makes edges. With a window of 3 that happens to one pixel in
    a hundred, and to six where a fifth is missing. With a window of 7 it happens to five in a thousand.

    A surface that bends by more than its noise within a window counts as an edge, too. Its normals are then those half
    a window away. An example is a ball of 0.2 m radius at 1 m, with a window of 15. Seen at 60° to 70° from its normal
    it is off by 8°, at its very rim by 13° to 18°.

    A row of pixels that a lens bends counts as determining a plane, however badly. Sums and solution are float64.
    float32 only rounds the result, by less than 1e-7 rad.
    """
    return _surfaces(depth, camera, window, avoid_edges, max_missing, num_threads, normals_only=True)[0]


def curvature(
    depth: npt.ArrayLike,
    camera: Camera,
    window: int = 7,
    *,
    avoid_edges: bool = False,
    max_missing: float = 0.5,
    num_threads: int | None = None,
) -> npt.NDArray[np.float32]:
    """Surface variation around every pixel: how far the surface, or its noise, departs from the fitted plane.

    It has no sign and no unit, and noise makes most of it. For curvatures in 1/m use `principal_curvatures`.

    Parameters
    ----------
    depth : (H, W) array_like
        The frame: floats in metres, or integers in the camera's ``depth_scale``; disparities of a camera that has
        ``disparity``.
    camera : Camera
    window : int
        Side of the square window in pixels: odd, 3 to 31.
    avoid_edges : bool
        Where an edge runs through a pixel's window, use one of eight windows beside it.
    max_missing : float
        Share of the window's pixels above which there is no result.
    num_threads : int, optional
        None takes threads when the frame is large enough to pay for them.

    Returns
    -------
    (H, W) ndarray of float32
        Between 0 (flat) and 1. NaN where there is no normal.

    Raises
    ------
    TypeError, ValueError
        An argument cannot be used: the message says what was expected and what came.

    Warns
    -----
    UserWarning
        Something in the frame is most likely not meant as it is, such as its unit: `fit_tiles` lists what.

    Notes
    -----
    Surface variation is λ₁ / (λ₁ + λ₂ + λ₃), the share of the points' variance that lies across the plane. It comes
    from Pauly, Gross, Kobbelt, "Efficient simplification of point-sampled surfaces", IEEE Visualization 2002. PCL calls
    it curvature. Here the plane is the one that `normals` fits. λ₁ is the mean squared distance of the points from it,
    and λ₂ + λ₃ the variance of the plane's points under the window's rays. Both are to first order in the window's
    extent. Noise counts: a flat wall has λ₁ = σ². So a window must be wide enough for its points to spread farther than
    the sensor's noise. It does not find depth edges. A plane across an edge runs along the rays, on which the points
    spread far, so that the variation is small there. With ``avoid_edges`` it is the variation of one side.
    """
    return _surfaces(depth, camera, window, avoid_edges, max_missing, num_threads, normals_only=False)[1]


def _surfaces(
    depth: npt.ArrayLike,
    camera: Camera,
    window: int,
    avoid_edges: bool,
    max_missing: float,
    num_threads: int | None,
    normals_only: bool,
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return normals and surface variation, the latter empty for ``normals_only`` when that is quicker."""
    check_camera(camera)
    window = check_window(window)
    needed = valid_needed(np.arange(window**2 + 1), check_share("max_missing", max_missing))
    avoid_edges = check_bool("avoid_edges", avoid_edges)
    frame = as_depth_frame(depth, camera)
    height, width = frame.raw.shape
    needs_surfaces = avoid_edges or not normals_only or camera.is_distorted
    threads = choose_num_threads(check_num_threads(num_threads), frame.raw.size)

    found = np.empty((height, width, 3), np.float32)
    variance = np.empty((height, width) if needs_surfaces else (0, 0), np.float32)
    variation = np.empty_like(variance)
    arrays = found.reshape(-1), variance.reshape(-1), variation.reshape(-1)
    values, all_rays = frame.values, (camera.tan_x, camera.tan_y)
    work: Any
    if not camera.is_distorted:
        focal, rays = (camera.fx, camera.fy), (camera.tan_x_columns, camera.tan_y_rows)
        wanted = needs_surfaces, avoid_edges

        def work(start: int, stop: int) -> None:
            normal_kernels.separable(values, focal, rays, window, needed, wanted, (start, stop), arrays)
    else:

        def work(start: int, stop: int) -> None:
            normal_kernels.distorted(values, all_rays, window, needed, avoid_edges, (start, stop), arrays)

    with announced(("normals", camera.is_distorted, frame.raw.dtype)):
        run_in_ranges(work, -(-height // BAND), threads)
        if not avoid_edges:
            return found, variation
        chosen, chosen_variation = np.empty_like(found), np.empty_like(variation)
        step = float(step_of(frame) * frame.scale)
        rounding = step * step / 12.0  # which may be infinite, as a power may not
        tests = _typical(frame, rounding, variance), _ratio(window)
        windows = arrays[0], variance, arrays[2]

        def choose(start: int, stop: int) -> None:
            edge_windows.choose_windows(
                values, all_rays, rounding, window // 2, tests, windows, (start, stop), (chosen, chosen_variation)
            )

        run_in_ranges(choose, height, threads)
    return chosen, chosen_variation


def _typical(frame: DepthFrame, rounding: float, variance: npt.NDArray[np.float32]) -> float:
    """Median residual variance of a frame's windows, without those that are flat but for rounding; 0 if most are."""
    some = some_of(variance)
    with np.errstate(all="ignore"):  # of pixels nearer than anything; the median may overflow
        q = frame._replace(raw=some_of(frame.raw)).inverse_depth
        flat = rounding if frame.is_disparity else rounding * (q / frame.scale) ** 4
        uneven = some[some > np.maximum(flat, (1e-6 * q) ** 2)]  # which NaN is not
        # In frames without noise the others are those across edges; of a sensor with coarse steps, those across steps.
        return float(np.median(uneven)) if uneven.size > _EDGES * np.count_nonzero(np.isfinite(some)) else 0.0


def _ratio(window: int) -> float:
    """Ratio of two residual variances of full windows that noise exceeds in one to four cases of a thousand.

    Half the logarithm of a variance ratio of f and f degrees of freedom is about normal, with variance 1/f
    (Fisher's z).
    """
    return math.exp(2.0 * 3.09 / math.sqrt(window * window - 3))
