"""The paper's noise model: how uncertain the three coordinates of each pixel's point are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.checks import number
from rgbd_planes._core.user_warnings import warn_caller
from rgbd_planes.camera.camera import check_camera
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.camera.frame_warnings import warn_of_noise
from rgbd_planes.noise import KINECT_V1
from rgbd_planes.uncertainty.falloff import growth_of_pixels

if TYPE_CHECKING:
    from rgbd_planes.camera.camera import Camera


def measurement_noise(
    depth: npt.ArrayLike, camera: Camera, sigma_inverse_depth: float | None = None
) -> npt.NDArray[np.float64]:
    """Standard deviations of X, Y and Z of each pixel's point.

    Parameters
    ----------
    depth : (H, W) array_like
        Integers in the camera's ``depth_scale`` or ``disparity``, or floats: metres, or, where the camera has
        ``disparity``, disparities.
    camera : Camera
    sigma_inverse_depth : float, optional
        Standard deviation of 1/Z in 1/m: for a disparity sensor that of the disparity over focal length times
        baseline. By default that of ``camera.noise`` at each pixel.

    Returns
    -------
    (H, W, 3) float64
        Metres; NaN where the depth is missing.

    Raises
    ------
    TypeError, ValueError
        ``camera`` is not a `Camera`; ``sigma_inverse_depth`` is not a number, negative or not finite; or the frame is
        not this camera's.

    Warns
    -----
    UserWarning
        Something in the frame is most likely not meant as it is, such as its unit. Or neither the camera nor the call
        says what the noise is: a Kinect v1's is taken.

    Notes
    -----
    σ_Z = σ_q·Z², σ_X = |tanθx|·σ_Z and σ_Y = |tanθy|·σ_Z: eq. 2 of the paper, after Khoshelham and Oude Elberink 2012,
    lens distortion included. The three are one error along the ray, seen from three sides: fully correlated. A noise
    model's lateral error, which depends on the slope of the surface, is not included.
    """
    check_camera(camera)
    if sigma_inverse_depth is None and camera.noise is None:
        sigma_inverse_depth = KINECT_V1
        warn_caller(
            "the camera has no noise model, so a Kinect v1's noise is taken: rp.estimate_noise finds a sensor's own, "
            "and sigma_inverse_depth=rp.noise.KINECT_V1 says that this one is meant"
        )
    frame = as_depth_frame(depth, camera)
    along_axis = frame.metres**2
    if sigma_inverse_depth is None:
        assert camera.noise is not None
        warn_of_noise(frame, camera.noise, "standard deviations are far too large")
        valid, growth = frame.valid, growth_of_pixels(camera)
        q = frame.inverse_depth[valid]
        along_axis[valid] *= camera.noise._sigma(q, growth[valid] if growth.size else 1.0)
    else:
        sigma = number("sigma_inverse_depth", sigma_inverse_depth, finite=False)
        if not 0.0 <= sigma < np.inf:
            raise ValueError(f"sigma_inverse_depth must be 0 or more, and finite (1/m), got {sigma_inverse_depth!r}")
        along_axis *= sigma
    return np.stack([np.abs(camera.tan_x) * along_axis, np.abs(camera.tan_y) * along_axis, along_axis], axis=-1)
