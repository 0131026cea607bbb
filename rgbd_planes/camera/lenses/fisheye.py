"""The distortion of fisheye lenses in normalised image coordinates, and its inverse.

The model of Kannala and Brandt ("A generic camera model and calibration method for conventional, wide-angle, and
fish-eye lenses", 2006) as OpenCV's fisheye module has it, and ROS as ``equidistant``: a ray at the angle θ to the
optical axis meets the image at the radius

    r' = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸),

in the direction of the ray. Where all coefficients are zero, r' is θ: not tan θ, as without distortion.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes.camera.lenses.polynomials import first_zero

_MAX_ITERATIONS = 60

FARTHEST = np.radians(85.0)
"""The largest angle whose rays count: farther out the depth, along the axis, is hardly a tenth of the distance, and a
millimetre of it, or of its rounding, is far more than any noise."""


def distort(x: Floats, y: Floats, coefficients: Sequence[float]) -> tuple[Floats, Floats]:
    """Where the lens puts the ray (x, y, 1); NaN from `widest_angle` on.

    Parameters
    ----------
    x, y : ndarray of float64
        Normalised undistorted coordinates, of one shape.
    coefficients : sequence of 4 floats
        k1 k2 k3 k4.

    Returns
    -------
    x, y : ndarray of float64
        Normalised distorted coordinates.
    """
    radius = np.hypot(x, y)
    angle = np.arctan(radius)
    image_radius = np.where(angle < widest_angle(coefficients), _radius(angle, coefficients), np.nan)
    ratio = np.divide(image_radius, radius, out=np.ones_like(radius), where=radius != 0)
    return x * ratio, y * ratio


def undistort(x: Floats, y: Floats, coefficients: Sequence[float]) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """The ray (x, y, 1) that the lens puts at the given place: the inverse of `distort`.

    Parameters
    ----------
    x, y : ndarray of float64
        Normalised distorted coordinates, of one shape.
    coefficients : sequence of 4 floats

    Returns
    -------
    x, y : ndarray of float64
        Normalised undistorted coordinates, to rounding; NaN where there is none.
    found : ndarray of bool
        False where no ray below `widest_angle` meets the place.
    """
    image_radius = np.hypot(x, y)
    angle, found = _angle(image_radius, coefficients)
    ratio = np.divide(np.tan(angle), image_radius, out=np.ones_like(angle), where=image_radius != 0)
    return x * ratio, y * ratio, found


def widest_angle(coefficients: Sequence[float]) -> float:
    """The angle up to which rays count: `FARTHEST`, or where the image's radius stops growing with the angle."""
    k1, k2, k3, k4 = coefficients
    return float(min(FARTHEST, first_zero([1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3, 9.0 * k4])))  # of dr'/dθ


def _radius(angle: Floats, coefficients: Sequence[float]) -> Floats:
    k1, k2, k3, k4 = coefficients
    squared = angle * angle
    return angle * (1.0 + squared * (k1 + squared * (k2 + squared * (k3 + squared * k4))))


def _slope(angle: Floats, coefficients: Sequence[float]) -> Floats:
    k1, k2, k3, k4 = coefficients
    squared = angle * angle
    return 1.0 + squared * (3.0 * k1 + squared * (5.0 * k2 + squared * (7.0 * k3 + squared * 9.0 * k4)))


def _angle(radius: Floats, coefficients: Sequence[float]) -> tuple[Floats, NDArray[np.bool_]]:
    """The angles whose rays meet the image at given radii, NaN where there is none, and whether there is one.

    Newton's iteration, kept within an interval known to hold the root: as far as rays count, the radius grows.
    """
    widest = widest_angle(coefficients)
    found = radius < _radius(np.array(widest), coefficients)
    wanted = radius[found]
    low, high = np.zeros_like(wanted), np.full_like(wanted, widest)
    angle = np.minimum(wanted, 0.5 * widest)
    active = np.arange(len(wanted))
    with np.errstate(divide="ignore", invalid="ignore"):  # where the slope is zero the interval is halved
        for _ in range(_MAX_ITERATIONS):
            last = angle[active]
            error = _radius(last, coefficients) - wanted[active]
            low, high = np.where(error <= 0, last, low), np.where(error >= 0, last, high)
            following = last - error / _slope(last, coefficients)
            following = np.where((following >= low) & (following <= high), following, 0.5 * (low + high))
            angle[active] = following
            if (np.abs(following - last) <= 1e-16 * widest).all():
                break
            # Most stand still after a few steps; some go to and fro by the last bit, to the end.
            moves = following != last
            active, low, high = active[moves], low[moves], high[moves]
    angles = np.full_like(radius, np.nan)
    angles[found] = angle
    return angles, found
