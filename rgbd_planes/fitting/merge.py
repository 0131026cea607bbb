"""Exact planes of unions of tiles, from the tiles' moments: no pixel is read again."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, overload

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.checks import check_labels, label_array
from rgbd_planes.fitting.methods import solve_planes
from rgbd_planes.fitting.results import PlaneFits, allocate
from rgbd_planes.fitting.saving import Savable, Values, check_fits, check_label_image
from rgbd_planes.fitting.surfaces.results import SurfaceFits
from rgbd_planes.fitting.surfaces.windows import MergedSurfaces, merge_surfaces
from rgbd_planes.kernels.moments.merge import merge_by_label
from rgbd_planes.uncertainty.correlated_errors import covariances_by_shape, shares_errors
from rgbd_planes.uncertainty.falloff import EVEN
from rgbd_planes.uncertainty.footprints import like_rectangles
from rgbd_planes.uncertainty.pixel_errors import KeepsPixels, Pixels, mean_rays, sums_of_fits
from rgbd_planes.uncertainty.pixel_runs import joined
from rgbd_planes.uncertainty.statistics import Assessment


@dataclass(frozen=True, eq=False, repr=False)
class MergedPlanes(Savable, KeepsPixels, PlaneFits):
    """The planes of N unions of tiles, arrays of shape S = (N,): row i belongs to label i + 1.

    It has the p-values, covariances, `to_table`, `save` and `load` that `TilePlanes` has.

    Attributes
    ----------
    labels : int32, of the shape of the merged fits
        Which union each of the merged tiles or windows belongs to, 0 for none.
    """

    labels: npt.NDArray[np.int32]
    _pixels: Pixels
    _frame_total: float = field(metadata={"saved": "total"})

    @property
    def _total(self) -> float:
        return self._frame_total

    @classmethod
    def _checked(cls, values: Values) -> Values:
        count = len(values["status"])
        check_label_image(values["labels"], None, count)
        check_fits(values, (count,), np.iinfo(np.int32).max)  # pixels of overlapping windows count more than once
        return {**values, "_frame_total": float(values["_frame_total"])}


@overload
def merge(fits: PlaneFits, labels: npt.ArrayLike, *, significance: float | None = None) -> MergedPlanes: ...
@overload
def merge(fits: SurfaceFits, labels: npt.ArrayLike, *, significance: float | None = None) -> MergedSurfaces: ...


def merge(
    fits: PlaneFits | SurfaceFits, labels: npt.ArrayLike, *, significance: float | None = None
) -> MergedPlanes | MergedSurfaces:
    """Fit a plane, or a surface of second order, to each union of tiles.

    Moments about one point add, so the result is that of fitting all pixels of each union at once.

    Parameters
    ----------
    fits : TilePlanes, WindowPlanes, LabelPlanes or MergedPlanes; or TileSurfaces or WindowSurfaces
        Of one frame. Pixels that overlapping windows share count twice.
    labels : array_like of int or bool
        Of the shape of ``fits``: 0 for none, 1..N. Each label has a row in the result; a mask is label 1. Tiles that
        have no plane, but valid pixels, are merged as well.
    significance : float, optional
        Unions whose residual the camera's noise exceeds less often than this get ROUGH. None is 0.01; 0 is no such
        test.

    Returns
    -------
    MergedPlanes or MergedSurfaces
        N planes or surfaces; a label that no tile has gets TOO_FEW.

    Raises
    ------
    TypeError, ValueError
        The labels are not integers or a mask of this shape, or negative, or above the numbers of pixels and of planes.
        Or ``fits`` are a batch's: merge ``fits[i]``. Or ``significance`` is not from 0 to below 1, or the camera has no
        noise model for it.
    """
    if not isinstance(fits, PlaneFits | SurfaceFits):
        raise TypeError(f"expected the planes or surfaces of a fit, got {type(fits).__name__}")
    if isinstance(fits, MergedSurfaces):
        raise TypeError("expected surfaces of tiles or windows, got unions: merge their parts")
    array = label_array("labels", labels)
    if len(fits.shape) == 3:
        raise ValueError(f"expected the planes of one frame, got a batch of shape {fits.shape}: merge fits[i]")
    if array.shape != fits.shape:
        hint = ": Segmentation.tile_labels has those of tiles" if array.shape == fits.camera.shape else ""
        raise ValueError(f"labels must have the shape of the planes, {fits.shape}, got {array.shape}{hint}")
    # There may be more labels of segments than tiles, and more of overlapping windows than pixels.
    check_labels(array, max(array.size, fits.camera.width * fits.camera.height))
    flat = np.array(array, np.int32, order="C").ravel()  # which the result keeps
    if isinstance(fits, SurfaceFits):
        return merge_surfaces(fits, flat.reshape(fits.shape), significance)
    count = int(flat.max(initial=0))
    moments, reference = fits._moments.reshape(10, -1), fits._reference.reshape(3, -1)

    arrays = allocate((), (count,))
    if reference.any():  # otherwise about the origin, as its parts: by that it is known what may be rounding
        arrays["_reference"][:] = _means(moments, reference, flat, count)
    merge_by_label(
        moments[:, None], reference[:, None], flat, arrays["_moments"][:, None], arrays["_reference"][:, None]
    )
    solve_planes(fits.method, arrays, np.full(count, 3.0), np.inf, 0, count, fits._total)
    footprint = _sums(fits._footprint, flat, count).astype(np.int64)
    part_alpha = np.concatenate([np.full((1, 3), np.nan), arrays["alpha"]])[flat]
    error_sums = sums_of_fits(fits, part_alpha)
    if error_sums is not None:
        error_sums = _sums(error_sums, flat, count)
    sizes = like_rectangles(footprint)  # and no growth: the sums include it
    runs, shared = fits._runs if shares_errors(fits.camera.noise) else None, None
    if runs is not None:
        runs = joined(runs, flat, count)
        counts, rays, _ = mean_rays(fits.method, arrays["_moments"], arrays["_reference"])
        shared = covariances_by_shape(runs, fits.camera, counts, rays, arrays["alpha"])
    assessment = Assessment(fits.camera, fits.method, significance, sizes, footprint, EVEN)
    assessment.of(arrays, error_sums, shared)(0, count)
    return MergedPlanes(
        camera=fits.camera,
        method=fits.method,
        labels=flat.reshape(fits.shape),
        _pixels=Pixels(footprint, fits.camera.noise, error_sums, shared, runs),
        _frame_total=fits._total,
        **arrays,
    )


def _sums(values: npt.NDArray[Any], labels: npt.NDArray[np.int32], count: int) -> Floats:
    """(N, ...): sums of rows over each union."""
    sums = np.stack([np.bincount(labels, column, count + 1)[1:] for column in values.T], axis=1)
    return sums.astype(np.float64, copy=False)  # of no rows they are integers


def _means(
    moments: npt.NDArray[np.float64], reference: npt.NDArray[np.float64], labels: npt.NDArray[np.int32], count: int
) -> npt.NDArray[np.float64]:
    """(3, N): the mean of each union's valid pixels, about which nothing cancels."""
    valid = moments[0] > 0.0
    numbers = np.bincount(labels[valid], moments[0, valid], count + 1)[1:]
    means = np.zeros((3, count))
    for i in range(3):
        sums = moments[1 + i, valid] + moments[0, valid] * reference[i, valid]
        totals = np.bincount(labels[valid], sums, count + 1)[1:]
        np.divide(totals, numbers, out=means[i], where=numbers > 0.0)
    return means
