"""Fit a plane, a sphere or a cylinder to the pixels of each label."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Floats, Indices
from rgbd_planes._core.compile_notice import announced
from rgbd_planes.camera.camera import Camera, check_camera
from rgbd_planes.camera.depth_frame import DepthFrame, as_depth_frame
from rgbd_planes.camera.frame_warnings import warn_of_noise
from rgbd_planes.fitting.labels import check_labels_of
from rgbd_planes.kernels.primitives import pixels as label_pixels
from rgbd_planes.kernels.primitives.errors import write_errors_of_labels
from rgbd_planes.kernels.primitives.fit import fit_labels
from rgbd_planes.kernels.primitives.quadric import PARAMETERS, SURFACE
from rgbd_planes.noise.model import NoiseModel
from rgbd_planes.primitives.noise import PixelNoise, noise_of_pixels
from rgbd_planes.primitives.result import PrimitiveFits
from rgbd_planes.primitives.selection import Fitted, select
from rgbd_planes.uncertainty.statistics import DEFAULT_SIGNIFICANCE, check_level

_LEAST_INSIDE = 0.5
"""Labels with a smaller share of interior pixels are fitted with all of theirs."""


class LabelPixels(NamedTuple):
    """The pixels that K labels are fitted to, one label after the other."""

    first: Indices  # (K + 1,): those of label i are first[i] to first[i + 1]
    pixels: Floats  # (3, M): tanθx, tanθy and q
    places: npt.NDArray[np.int32]  # (2, M): rows and columns


def fit_primitives(
    depth: npt.ArrayLike,
    camera: Camera,
    labels: npt.ArrayLike,
    *,
    noise: NoiseModel | float | Callable[[Floats], npt.ArrayLike] | None = None,
    significance: float | None = None,
) -> PrimitiveFits:
    """Find out which labels are planes, spheres and cylinders, with radius, centre, axis and their covariance.

    Each label gets the maximum-likelihood fit in inverse depth of all three. It is a plane unless the curvature of a
    sphere or a cylinder is significant; else the one of these two that fits better. It is none of the three, as a cone
    is, if the noise does not explain the residual of that fit.

    Parameters
    ----------
    depth : (H, W) array_like
        The frame: floats in metres, or integers in the camera's ``depth_scale``; disparities of a camera that has
        ``disparity``.
    camera : Camera
    labels : (H, W) array_like of int or bool
        0 for none, 1..K. Each label has a row in the result; a mask is label 1. ``segment(...).labels`` are planes.
    noise : float, callable or noise model, optional
        Standard deviation of inverse depth in 1/m, a function of the inverse depth that gives it, or a noise model. By
        default ``camera.noise``; without either, it is what `segment` finds in the frame, which is known to a factor of
        two where neighbours share errors. A model by `estimate_noise` tells more surely what is none.
    significance : float, optional
        How often a surface that is of a kind is called none, and a plane curved, by chance. None is 0.01; at 0 each
        label is of the kind that fits best.

    Returns
    -------
    PrimitiveFits
        Arrays of shape (K, ...).

    Raises
    ------
    TypeError, ValueError
        An argument cannot be used: the message says what was expected and what came.

    Warns
    -----
    UserWarning
        Something in the frame is most likely not meant as it is, such as its unit: `fit_tiles` lists what. Or the
        labels are an image of 0 and 255, most likely a mask, or 255 seems to mean none.

    Notes
    -----
    Interior pixels count, whose measured neighbours have the label, too: at an outline a pixel may see both sides.
    Where fewer than half are interior, all count. Outliers of four standard deviations are left out, unless they are
    more than 15 % of a label: then it is none of the three. Pixels are weighted by their variance under the noise,
    errors across the ray included, at the depth and slope of the fit. The covariance is A⁻¹BA⁻¹, with A of the normal
    equations and B the covariance of their right-hand side, errors that neighbours share included. Curvature is tested
    by what it is in its standard deviations, and residuals by a chi-square of the mean and variance that the noise
    gives them (Satterthwaite 1946).
    """
    check_camera(camera)
    level = check_level(significance)
    level = DEFAULT_SIGNIFICANCE if level is None else level
    numbers = check_labels_of(labels, camera)
    frame = as_depth_frame(depth, camera)
    warn_of_noise(frame, camera.noise)
    with announced(("primitives", frame.raw.dtype)):
        found = pixels_of(frame, camera, numbers)
        fitted = _fit(found, noise_of_pixels(frame, camera, noise))
    return PrimitiveFits(camera=camera, labels=numbers, **select(fitted, level))


def pixels_of(frame: DepthFrame, camera: Camera, labels: npt.NDArray[np.int32]) -> LabelPixels:
    """Gather the pixels of labels that count."""
    count = int(labels.max(initial=0))
    interior, sizes = np.empty(labels.shape, np.bool_), np.empty((count, 2), np.int64)
    values: Any = frame.values
    label_pixels.mark_interior(values.raw, values.lowest, values.highest, labels, interior, sizes)
    whole = sizes[:, 1] < _LEAST_INSIDE * sizes[:, 0]
    first = np.concatenate([[0], np.cumsum(np.where(whole, sizes[:, 0], sizes[:, 1]))])
    pixels, places = np.empty((3, first[-1])), np.empty((2, first[-1]), np.int32)
    label_pixels.gather_pixels(values, camera._rays, labels, interior, whole, first[:-1].copy(), pixels, places)
    return LabelPixels(first, pixels, places)


def _fit(found: LabelPixels, noise: PixelNoise) -> Fitted:
    """Fit the three kinds to each label, and work out their errors."""
    count, number = len(found.first) - 1, found.pixels.shape[1]
    surfaces, totals = np.empty((count, 3, SURFACE)), np.empty((count, 3))
    weights, shares = np.ones((2, number))
    fit_labels(found.pixels, found.first, noise.settings, surfaces, totals, weights, shares)
    covariances, chances = np.empty((count, 3, PARAMETERS, PARAMETERS)), np.empty((count, 3, 2))
    write_errors_of_labels(
        found.pixels, found.places, found.first, (weights, shares), surfaces, noise.components, covariances, chances
    )
    row_of_pixel = np.repeat(np.arange(count), np.diff(found.first))
    weight = np.bincount(row_of_pixel, weights * weights, count).astype(np.float64)
    counts = np.bincount(row_of_pixel, weights > 0.0, count).astype(np.int32)
    return Fitted(surfaces, totals, covariances, chances, counts, weight, noise.spread)
