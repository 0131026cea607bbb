"""Covariances of planes that are far from the origin, where numbers of 64 bits do not hold a plane's own error.

The error of d at the origin is that of the normal times the distance. At 5000 km it is kilometres, and its square
leaves no digit for the millimetres by which a plane is known where it was seen. About its surest point a covariance is
that of the normal and one number more: s², the variance across the plane. `covariance_from` keeps that number where a
covariance of (n, d) has no other use: in the variance along the normal, which to first order is 0, and becomes
1e-8 m⁻² s². At a point h off the plane this changes the variance by a share of 1e-8 m⁻² h².
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.arrays import Floats

_KEPT = 1e-8  # 1/m²: variance along the normal of what is kept, over s²
_LOST = 1e-6  # share of s² that rounding may change before it is kept apart
_NEAR = 1e3  # m: up to here no digit that counts is lost
_NOTHING = 1e-18  # m²: rounding of less than a nanometre changes nothing
_ROUNDING = 16.0 * float(np.finfo(np.float64).eps)
# Share of the normal's variance: above what rounding leaves along the normal, and below what is no first-order error.
_LEAST, _MOST = 1e-13, 1e-5


def about(point: Floats) -> Floats:
    """(..., 4, 4): takes (n, d) to that of the same plane in axes whose origin is a point."""
    matrix = np.zeros((*point.shape[:-1], 4, 4))
    matrix[...] = np.eye(4)
    matrix[..., 3, :3] = point
    return matrix


def is_far(covariance: Floats, variance: Floats) -> NDArray[np.bool_]:
    """(...) bool: whether rounding of a covariance (..., 4, 4) changes a variance that was worked out from it."""
    at_origin = np.abs(covariance[..., 3, 3])
    spread = np.trace(covariance[..., :3, :3], axis1=-2, axis2=-1)
    with np.errstate(invalid="ignore"):
        distant = (spread > 0.0) & (at_origin > _NEAR * _NEAR * spread)
        return np.asarray(distant & (_ROUNDING * at_origin > np.maximum(_LOST * variance, _NOTHING)))


def covariance_about(plane: Floats, covariance: Floats, point: Floats, surest: Floats) -> Floats:
    """(..., 4, 4): covariances of (n, d) in axes whose origin is a point, of planes near or far.

    Parameters
    ----------
    plane : (..., 4) float64
    covariance : (..., 4, 4) float64
    point, surest : (..., 3) float64
        The new origin, and where the errors of d and of the normal are uncorrelated.

    Raises
    ------
    ValueError
        Planes are so far that their covariances have lost what is asked for.
    """
    shift = about(point)
    there = shift @ covariance @ np.swapaxes(shift, -1, -2)
    far = is_far(covariance, there[..., 3, 3])
    if not far.any():
        return np.asarray(there)
    along, spread = _along(plane, covariance)
    with np.errstate(invalid="ignore"):
        lost = far & ~((along > _LEAST * spread) & (along < _MOST * spread))
    if lost.any():
        distance = float(np.max(np.abs(np.broadcast_to(plane[..., 3], lost.shape)[lost])))
        raise ValueError(
            f"expected planes near the origin, or covariances that transform_planes took there, got planes up to "
            f"{distance:.3g} m from it, whose covariances have lost the planes' own errors to rounding: compare planes "
            "in axes with an origin near them, and move them after that"
        )
    normal = covariance[..., :3, :3]
    lever = point - surest
    mixed = np.sum(normal * lever[..., None, :], axis=-1)
    made = np.zeros(np.broadcast_shapes(there.shape, (*mixed.shape[:-1], 4, 4)))
    made[..., :3, :3] = normal
    made[..., :3, 3] = made[..., 3, :3] = mixed
    made[..., 3, 3] = np.sum(mixed * lever, axis=-1) + along / _KEPT
    return np.where(far[..., None, None], made, there)


def covariance_from(plane: Floats, local: Floats, point: Floats, variance: Floats, surest: Floats) -> Floats:
    """(..., 4, 4): the inverse of `covariance_about`: from axes whose origin is a point to those of the plane.

    Parameters
    ----------
    plane : (..., 4) float64
    local : (..., 4, 4) float64
        Covariance about the point.
    point, surest : (..., 3) float64
    variance : (...) float64
        s², that of the distance of the surest point.
    """
    shift = about(-point)
    made = np.asarray(shift @ local @ np.swapaxes(shift, -1, -2))
    far = is_far(made, variance) & (variance > 0.0)
    if not far.any():
        return made
    along, _ = _along(plane, made)
    normal = plane[..., :3]
    kept = np.concatenate([normal, -np.sum(normal * surest, axis=-1, keepdims=True)], axis=-1)
    more = np.where(far, _KEPT * variance - along, 0.0)
    return np.asarray(made + more[..., None, None] * kept[..., :, None] * kept[..., None, :])


def _along(plane: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """(...) each: the variance along the normal, and the sum of all variances of the normal."""
    normal = plane[..., :3]
    along = np.einsum("...i,...ij,...j->...", normal, covariance[..., :3, :3], normal)
    return np.asarray(along), np.asarray(np.trace(covariance[..., :3, :3], axis1=-2, axis2=-1))
