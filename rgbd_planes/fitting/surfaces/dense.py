"""Principal curvatures around every pixel of a depth frame."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.checks import check_num_threads, check_share, check_window
from rgbd_planes._core.compile_notice import announced
from rgbd_planes._core.threads import choose_num_threads, run_in_ranges
from rgbd_planes.camera.camera import Camera, check_camera
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.fitting.surfaces.tiles import needed_for_surfaces
from rgbd_planes.kernels.fits.curvatures import distorted_curvatures, separable_curvatures
from rgbd_planes.kernels.moments.sliding_window import BAND


def principal_curvatures(
    depth: npt.ArrayLike, camera: Camera, window: int = 15, *, max_missing: float = 0.5, num_threads: int | None = None
) -> npt.NDArray[np.float32]:
    """Fit a surface of second order to the window around every pixel and return its principal curvatures.

    The surface is that of `fit_surfaces`, for the window's valid pixels, whatever is missing; at the border the window
    is clipped. The time hardly depends on the window's size.

    Parameters
    ----------
    depth : (H, W) array_like
        The frame: floats in metres, or integers in the camera's ``depth_scale``; disparities of a camera that has
        ``disparity``.
    camera : Camera
    window : int
        Side of the square window in pixels: odd, 3 to 31. Wide windows pay: the standard deviation of a curvature falls
        with the third power of it.
    max_missing : float
        Share of the window's pixels inside the frame above which there is none. At 1 any pixels that determine a
        surface will do.
    num_threads : int, optional
        None takes threads when the frame is large enough to pay for them. The result is the same for any number.

    Returns
    -------
    (H, W, 2) ndarray of float32
        κ₁ >= κ₂ in 1/m on the pixel's ray, positive where the surface is convex towards the camera. They are NaN where
        the pixel is missing, or too much of its window. They are NaN, too, where the window's valid pixels lie on a
        conic, or the pixel's ray does not meet the fitted surface. Sums and solution are float64.

    Raises
    ------
    TypeError, ValueError
        For an argument that cannot be used, saying what was expected and what came.

    Warns
    -----
    UserWarning
        Something in the frame is most likely not meant as it is, such as its unit: `fit_tiles` lists what.

    Notes
    -----
    Across depth edges the curvature is the edge's. `fit_surfaces` tells how sure it is of a curvature. `curvature` is
    another quantity: the surface variation that PCL calls curvature, which noise changes most.
    """
    check_camera(camera)
    side = check_window(window)
    needed = needed_for_surfaces(np.arange(side**2 + 1), check_share("max_missing", max_missing))
    frame = as_depth_frame(depth, camera)
    threads = choose_num_threads(check_num_threads(num_threads), frame.raw.size)
    made = np.empty((*frame.raw.shape, 2), np.float32)
    flat = made.reshape(-1)
    kernel: Any = distorted_curvatures if camera.is_distorted else separable_curvatures
    rays = (camera.tan_x, camera.tan_y) if camera.is_distorted else (camera.tan_x_columns, camera.tan_y_rows)

    def work(start: int, stop: int) -> None:
        kernel(frame.values, camera.fx, camera.fy, *rays, side, needed, start, stop, flat)

    with announced(("curvatures", camera.is_distorted, frame.raw.dtype)):
        run_in_ranges(work, -(-frame.raw.shape[0] // BAND), threads)
    return made
