"""The distortion of ordinary lenses in normalised image coordinates, and its inverse.

The model is OpenCV's, coefficients k1 k2 p1 p2 k3 [k4 k5 k6]: with r² = x² + y²,

    f  = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)
    x' = x f + 2 p1 x y + p2 (r² + 2 x²)
    y' = y f + p1 (r² + 2 y²) + 2 p2 x y

(D. C. Brown, "Close-range camera calibration", 1971; the rational factor as in OpenCV's calib3d
documentation.) The polynomial is a good description of a lens near the image only: farther out it folds, and
then several rays share one pixel. Inverting it means the ray on the unfolded sheet around the optical axis.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes.camera.lenses.polynomials import first_zero

TOLERANCE = 1e-10
"""Largest error of an inverted point, in normalised coordinates."""

_MAX_ITERATIONS = 50
_CHUNK = 32768  # points at a time, so that the temporaries stay in the cache
_WAY = np.linspace(0.0, 1.0, 17)[1:]  # steps from the optical axis to a place that is not found at once
_SEGMENT = np.linspace(0.0, 1.0, 65)[1:]  # where a line from the optical axis is checked for folds
_RADII = np.linspace(0.0, 8.0, 513)[1:]


def coefficients8(coefficients: Sequence[float]) -> Floats:
    """Coefficients k1 k2 p1 p2 k3 k4 k5 k6, with zeros where fewer were given."""
    padded = np.zeros(8)
    padded[: len(coefficients)] = coefficients
    return padded


def distort(x: Floats, y: Floats, coefficients: Sequence[float]) -> tuple[Floats, Floats]:
    """Where the lens puts the ray (x, y, 1): the forward model.

    Parameters
    ----------
    x, y : ndarray of float64
        Normalised undistorted coordinates, of one shape.
    coefficients : sequence of 0, 4, 5 or 8 floats
        k1 k2 p1 p2 [k3 [k4 k5 k6]].

    Returns
    -------
    x, y : ndarray of float64
        Normalised distorted coordinates.
    """
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients8(coefficients)
    r2 = x * x + y * y
    f = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    xy2 = 2.0 * x * y
    return x * f + p1 * xy2 + p2 * (r2 + 2.0 * x * x), y * f + p1 * (r2 + 2.0 * y * y) + p2 * xy2


def distortion_jacobian(x: Floats, y: Floats, coefficients: Sequence[float]) -> tuple[Floats, Floats, Floats, Floats]:
    """Partial derivatives of `distort`: (dx'/dx, dx'/dy, dy'/dx, dy'/dy), each of the shape of `x`."""
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients8(coefficients)
    r2 = x * x + y * y
    numerator = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    denominator = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    f = numerator / denominator
    # d f / d r²
    slope = (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3) - f * (k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6))) / denominator
    cross = 2.0 * (x * y * slope + p1 * x + p2 * y)
    return (
        f + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
        cross,
        cross,
        f + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
    )


def fold_radius(coefficients: Sequence[float]) -> float:
    """Undistorted radius at which the radial part r f(r²) stops growing or has a pole; inf if it never does.

    With s = r², N and D the numerator and denominator of f: d(r f)/dr = (N D + 2 s (N' D - N D')) / D².
    """
    k1, k2, _, _, k3, k4, k5, k6 = coefficients8(coefficients)
    numerator, denominator = np.array([1.0, k1, k2, k3]), np.array([1.0, k4, k5, k6])
    degree = np.arange(4)
    slope = np.convolve(degree * numerator, denominator) - np.convolve(numerator, degree * denominator)
    growth = np.convolve(numerator, denominator) + 2.0 * slope  # degree * c are the coefficients of s c'
    return first_zero(growth, denominator)


def undistort(x: Floats, y: Floats, coefficients: Sequence[float]) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """The ray (x, y, 1) that the lens puts at the given place: the inverse of `distort`.

    A Newton iteration with the analytic Jacobian, started at the inverse of the radial part. A step is halved
    until the residual falls and the Jacobian stays positive, so that no iterate crosses a fold. Where strong tangential
    coefficients make this fail, the place is approached from the optical axis.

    Parameters
    ----------
    x, y : ndarray of float64
        Normalised distorted coordinates, of one shape.
    coefficients : sequence of 0, 4, 5 or 8 floats

    Returns
    -------
    x, y : ndarray of float64
        Normalised undistorted coordinates, to `TOLERANCE`; NaN where there is none.
    found : ndarray of bool
        False where no ray on the unfolded sheet meets the place.
    """
    shape = x.shape
    target_x, target_y = x.ravel(), y.ravel()
    out_x, out_y = np.empty_like(target_x), np.empty_like(target_y)
    found = np.empty(target_x.shape, bool)
    if len(target_x):
        radii = _radial_table(coefficients, float(np.hypot(target_x, target_y).max()))
    for start in range(0, len(target_x), _CHUNK):
        part = slice(start, start + _CHUNK)
        out_x[part], out_y[part], found[part] = _invert(target_x[part], target_y[part], coefficients, *radii)
    return out_x.reshape(shape), out_y.reshape(shape), found.reshape(shape)


def _radial_table(coefficients: Sequence[float], distorted_radius: float) -> tuple[Floats, Floats]:
    """Radii and their distorted radii by the radial part, as far as the given distorted radius or the fold."""
    zero = np.zeros(1)
    fold = fold_radius(coefficients)
    radial = [c if i not in (2, 3) else 0.0 for i, c in enumerate(coefficients)]
    farthest = max(distorted_radius, 1e-3)
    while farthest < fold and farthest < 1e3 and distort(zero + farthest, zero, radial)[0][0] < distorted_radius:
        farthest *= 1.5
    radius = np.linspace(0.0, min(farthest, fold * (1 - 1e-9)), 1025)
    return radius, distort(radius, np.zeros_like(radius), radial)[0]


def _invert(
    target_x: Floats, target_y: Floats, coefficients: Sequence[float], radius: Floats, distorted_radius: Floats
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    target_radius = np.hypot(target_x, target_y)
    start = np.interp(target_radius, distorted_radius, radius)
    ratio = np.divide(start, target_radius, out=np.ones_like(start), where=target_radius > 0)
    x, y, found = _newton(target_x, target_y, coefficients, target_x * ratio, target_y * ratio)
    missed = ~found
    if missed.any():
        target_x, target_y = target_x[missed], target_y[missed]
        near_x, near_y = np.zeros_like(target_x), np.zeros_like(target_y)
        for share in _WAY:
            on_the_way = share * target_x, share * target_y
            near_x, near_y, reached = _newton(*on_the_way, coefficients, near_x, near_y)
        x[missed], y[missed], found[missed] = near_x, near_y, reached
    return x, y, found


def _newton(
    target_x: Floats, target_y: Floats, coefficients: Sequence[float], x: Floats, y: Floats
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """`undistort` from the given starting points, which are overwritten."""
    found = np.zeros(x.shape, bool)
    active = np.arange(len(x))
    with np.errstate(all="ignore"):
        error_x, error_y, squared, (a, b, c, d), det = _residual(x, y, target_x, target_y, coefficients)
        for _ in range(_MAX_ITERATIONS):
            step_x, step_y = (d * error_x - b * error_y) / det, (a * error_y - c * error_x) / det
            length = np.hypot(step_x, step_y)
            # Quadratic convergence: a step this short leaves an error far below the tolerance.
            last = (length <= 0.01 * TOLERANCE) & (det > 0)
            done = active[last]
            x[done] -= step_x[last]
            y[done] -= step_y[last]
            found[done] = True
            keep = ~last & (det > 0) & np.isfinite(length)
            active, step_x, step_y, squared = active[keep], step_x[keep], step_y[keep], squared[keep]
            if not len(active):
                break
            scale = np.ones(len(active))
            for _ in range(40):
                new_x, new_y = x[active] - scale * step_x, y[active] - scale * step_y
                error_x, error_y, new_squared, (a, b, c, d), det = _residual(
                    new_x, new_y, target_x[active], target_y[active], coefficients
                )
                worse = ~((new_squared < squared) & (det > 0))
                if not worse.any():
                    break
                scale[worse] *= 0.5
            better = ~worse
            active, squared = active[better], new_squared[better]
            x[active], y[active] = new_x[better], new_y[better]
            error_x, error_y, det = error_x[better], error_y[better], det[better]
            a, b, c, d = a[better], b[better], c[better], d[better]
    x[~found] = np.nan
    y[~found] = np.nan
    return x, y, found


def _residual(
    x: Floats, y: Floats, target_x: Floats, target_y: Floats, coefficients: Sequence[float]
) -> tuple[Floats, Floats, Floats, tuple[Floats, Floats, Floats, Floats], Floats]:
    distorted_x, distorted_y = distort(x, y, coefficients)
    error_x, error_y = distorted_x - target_x, distorted_y - target_y
    jacobian = distortion_jacobian(x, y, coefficients)
    det = jacobian[0] * jacobian[3] - jacobian[1] * jacobian[2]
    return error_x, error_y, error_x * error_x + error_y * error_y, jacobian, det


def unfolded(x: Floats, y: Floats, coefficients: Sequence[float]) -> NDArray[np.bool_]:
    """Whether `distort` is one-to-one all the way from the optical axis to each (x, y); not at NaN."""
    is_one_to_one = np.hypot(x, y) < _clear_radius(tuple(coefficients))
    far_x, far_y = x[~is_one_to_one], y[~is_one_to_one]
    far = [
        _keeps_sides(part_x[:, None] * _SEGMENT, part_y[:, None] * _SEGMENT, coefficients).all(axis=-1)
        for part_x, part_y in ((far_x[i : i + _CHUNK], far_y[i : i + _CHUNK]) for i in range(0, len(far_x), _CHUNK))
    ]
    is_one_to_one[~is_one_to_one] = np.concatenate([np.empty(0, np.bool_), *far])
    return is_one_to_one


@lru_cache(maxsize=16)
def _clear_radius(coefficients: tuple[float, ...]) -> float:
    """A radius within which `distort` folds in no direction."""
    angle = np.linspace(0.0, 2.0 * np.pi, 65)[:-1, None]
    is_clear = _keeps_sides(_RADII * np.cos(angle), _RADII * np.sin(angle), coefficients).all(axis=0)
    return float(0.9 * _RADII[np.argmin(is_clear)]) if not is_clear.all() else float(_RADII[-1])


def _keeps_sides(x: Floats, y: Floats, coefficients: Sequence[float]) -> NDArray[np.bool_]:
    """Whether `distort` does not turn the neighbourhood of each (x, y) inside out, nor has a pole before it."""
    k4, k5, k6 = coefficients8(coefficients)[5:]
    r2 = x**2 + y**2
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # far out
        a, b, c, d = distortion_jacobian(x, y, coefficients)
        return np.asarray((a * d - b * c > 0) & (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)) > 0))
