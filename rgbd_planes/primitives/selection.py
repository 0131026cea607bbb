"""Which of three fits a label is, by what the noise explains, and what it is in the camera's frame."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.status import Primitive, TileStatus
from rgbd_planes.kernels.primitives.quadric import CYLINDER, KAPPA, NORMAL, PLANE, Q0, RAY, SPHERE, A, B
from rgbd_planes.noise.correlation import deviate_of
from rgbd_planes.primitives.result import AXIS, CENTRE, PARAMETERS, RADIUS, allocate_primitives

_KINDS = np.array([Primitive.PLANE, Primitive.SPHERE, Primitive.CYLINDER], np.uint8)
_FEWEST = 6


class Fitted(NamedTuple):
    """The three kinds fitted to K labels; NaN where pixels determine no such surface."""

    surfaces: Floats  # (K, 3, SURFACE)
    totals: Floats  # (K, 3): sums of squared residuals over their variances
    covariances: Floats  # (K, 3, 5, 5): of their parameters
    chances: Floats  # (K, 3, 2): expected totals, and their degrees of freedom
    counts: npt.NDArray[np.int32]  # (K,): pixels of the fit
    weight: Floats  # (K,): sums of 1/σ²
    spread: float  # of the noise


def select(fitted: Fitted, level: float) -> dict[str, npt.NDArray[Any]]:
    """The arrays of a result."""
    made = allocate_primitives(len(fitted.counts))
    made["valid_count"][:] = fitted.counts
    made["p_flat"][:] = chance_of_flat(fitted)
    excess = fitted.totals - fitted.chances[:, :, 0]
    excess = np.where(np.isnan(excess), np.inf, excess)
    curved = np.where(excess[:, CYLINDER] < excess[:, SPHERE], CYLINDER, SPHERE)
    is_flat = ~(made["p_flat"] < level) if level > 0.0 else excess[:, PLANE] <= excess.min(axis=1)
    which = np.where(is_flat | ~np.isfinite(excess[:, 1:]).any(axis=1), PLANE, curved)
    every = np.arange(len(which))
    totals, chances = fitted.totals[every, which], fitted.chances[every, which]
    surfaces, covariances = fitted.surfaces[every, which], fitted.covariances[every, which]
    is_fitted = np.isfinite(totals) & np.isfinite(chances[:, 0])
    made["status"][fitted.counts >= _FEWEST] = TileStatus.DEGENERATE
    with np.errstate(invalid="ignore", divide="ignore"):
        made["rmse"][:] = np.sqrt(totals / fitted.weight)
        made["p_value"][:] = _tails(totals / chances[:, 0], chances[:, 1], fitted.spread)
        towards = -(surfaces[:, NORMAL : NORMAL + 3] * _points(surfaces)).sum(axis=1)
        made["rmse_metric"][:] = made["rmse"] * towards / surfaces[:, Q0]
    made["rmse"][~is_fitted] = made["rmse_metric"][~is_fitted] = np.nan
    is_kind = is_fitted & (made["p_value"] >= level)
    made["status"][is_fitted] = np.where(is_kind[is_fitted], TileStatus.OK, TileStatus.ROUGH)
    made["kind"][is_kind] = _KINDS[which[is_kind]]
    for k in np.flatnonzero(is_kind).tolist():
        _describe(surfaces[k], covariances[k], int(which[k]), made, k)
    return made


def chance_of_flat(fitted: Fitted) -> Floats:
    """(K,) float64: how often a plane looks as curved as the label, by the noise alone; NaN where nothing is known.

    κ² over its variance is a chi-square of one degree of freedom for the sphere. A cylinder takes the direction in
    which it is largest: the three terms of second order at most. Of the two the more significant counts, twice.
    """
    kappa, variance = fitted.surfaces[:, :, KAPPA], fitted.covariances[:, :, 3, 3]
    with np.errstate(invalid="ignore", divide="ignore"):
        square = kappa**2 / variance
        sphere = _tails(square[:, SPHERE], np.ones(len(square)), fitted.spread)
        cylinder = _tails(square[:, CYLINDER] / 3.0, np.full(len(square), 3.0), fitted.spread)
    return np.minimum(2.0 * np.fmin(sphere, cylinder), 1.0)


def _tails(ratio: Floats, freedom: Floats, spread: float) -> Floats:
    """Probability that a chi-square over its degrees of freedom is larger than a ratio."""
    deviates = deviate_of(ratio, freedom, spread)
    return np.array([0.5 * math.erfc(z / math.sqrt(2.0)) for z in deviates.tolist()])


def _points(surfaces: Floats) -> Floats:
    """(K, 3) float64: the points of surfaces on their mean rays."""
    rays = np.concatenate([surfaces[:, RAY : RAY + 2], np.ones((len(surfaces), 1))], axis=1)
    return np.asarray(rays / surfaces[:, Q0, None])


def _describe(surface: Floats, covariance: Floats, which: int, made: dict[str, npt.NDArray[Any]], k: int) -> None:
    """Write centre, axis, radius and their covariance of row ``k``, from a surface and that of its parameters.

    The derivatives are those by q₀, the turns of n towards a and b, κ, and the turn of a towards b.
    """
    point, kappa = _points(surface[None])[0], surface[KAPPA]
    a, b, n = surface[A : A + 3], surface[B : B + 3], surface[NORMAL : NORMAL + 3]
    by = np.zeros((PARAMETERS, 5))
    by[CENTRE, 0] = -point / surface[Q0]
    if which == PLANE:
        centre = point
        by[AXIS, 1], by[AXIS, 2] = a, b
        made["axis"][k] = n
    else:
        centre = point - n / kappa
        by[CENTRE, 1], by[CENTRE, 2], by[CENTRE, 3] = -a / kappa, -b / kappa, n / kappa**2
        by[RADIUS, 3] = -np.sign(kappa) / kappa**2
        made["radius"][k], made["convex"][k] = 1.0 / abs(kappa), kappa > 0.0
    if which == CYLINDER:
        by[CENTRE] -= np.outer(a, a @ by[CENTRE])
        sign = -1.0 if a[0] < 0.0 else 1.0
        by[AXIS, 1], by[AXIS, 4] = -sign * n, sign * b
        made["axis"][k] = sign * a
    made["centre"][k] = centre
    # Where a label hardly determines its surface, rounding leaves negative directions.
    deviation = np.sqrt(np.diagonal(covariance))
    scale = np.outer(deviation, deviation)
    correlation = np.divide(covariance, scale, out=np.zeros_like(covariance), where=scale > 0.0)
    values, directions = np.linalg.eigh(0.5 * (correlation + correlation.T))
    root = (by * deviation) @ (directions * np.sqrt(np.maximum(values, 0.0)))
    made["covariance"][k] = root @ root.T
