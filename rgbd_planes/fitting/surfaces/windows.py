"""Fit surfaces of second order to arbitrary rectangles of a depth frame, and to unions of parts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Floats, Indices
from rgbd_planes._core.checks import check_choice, check_max_error, check_num_threads, check_share
from rgbd_planes._core.compile_notice import announced
from rgbd_planes._core.threads import choose_num_threads, run_in_ranges
from rgbd_planes.camera.camera import Camera, check_camera
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.camera.frame_warnings import warn_of_noise
from rgbd_planes.camera.rays import ray_tables
from rgbd_planes.fitting.saving import Savable, Values
from rgbd_planes.fitting.surfaces.results import SURFACE_RESULTS, SurfaceFits, allocate_surfaces, flat_frame
from rgbd_planes.fitting.surfaces.saving import check_surfaces
from rgbd_planes.fitting.surfaces.statistics import SurfaceAssessment
from rgbd_planes.fitting.surfaces.tiles import needed_for_surfaces
from rgbd_planes.fitting.windows import check_windows
from rgbd_planes.kernels.fits.surfaces import fit_surface_moments
from rgbd_planes.kernels.moments import surface_tables
from rgbd_planes.kernels.moments.summed_area import count_missing
from rgbd_planes.uncertainty.falloff import growth_of_windows
from rgbd_planes.uncertainty.footprints import footprints
from rgbd_planes.uncertainty.statistics import check_significance

_AS_TABLES = 3
"""Summed-area tables take as long as the pixels of windows that have so many times those of the frame."""


@dataclass(frozen=True, eq=False, repr=False)
class WindowSurfaces(Savable, SurfaceFits):
    """The surfaces of K windows of a frame, arrays of shape S = (K,); all else is as in `TileSurfaces`.

    Attributes
    ----------
    windows : (K, 4) int64
        Row, column, height, width of each window in pixels.
    """

    windows: Indices

    @property
    def _centre(self) -> Floats:
        return central_rays_of(self.camera, self.windows)

    @property
    def _footprint(self) -> Indices:
        return footprints(self.windows)

    @property
    def _assessment(self) -> SurfaceAssessment:
        return assessment_of_windows(self.camera, 0.0, self.windows)

    def _places(self) -> dict[str, npt.NDArray[Any]]:
        return dict(zip(("top", "left", "height", "width"), self.windows.T, strict=True))

    @classmethod
    def _checked(cls, values: Values) -> dict[str, Any]:
        windows = check_windows(values["windows"], values["camera"])
        check_surfaces(values, (len(windows),), windows[:, 2:].prod(axis=1))
        return {**values, "windows": windows, "_writes": [0]}


def central_rays_of(camera: Camera, windows: Indices) -> Floats:
    """(2, K) float64: the mean of tanθx and tanθy over the rows and columns in the middle of each window."""
    tan_x, tan_y = ray_tables(camera)
    top, left, height, width = windows.T
    made = np.zeros((2, len(windows)))
    for row in (top + (height - 1) // 2, top + height // 2):
        for column in (left + (width - 1) // 2, left + width // 2):
            made += 0.25 * np.stack([tan_x[row, column], tan_y[row, column]])
    return made


def assessment_of_windows(camera: Camera, significance: float | None, windows: Indices) -> SurfaceAssessment:
    """What tests the surfaces of windows, and works out their statistics."""
    growth = growth_of_windows(camera, windows)
    centre = central_rays_of(camera, windows)
    return SurfaceAssessment(camera, significance, centre, windows[:, 2:], footprints(windows), growth)


def fit_surface_windows(
    depth: npt.ArrayLike,
    camera: Camera,
    windows: npt.ArrayLike,
    *,
    implementation: str | None = None,
    max_missing: float = 0.5,
    max_error: float | None = None,
    significance: float | None = None,
    num_threads: int | None = None,
) -> WindowSurfaces:
    """Fit a surface of second order to each of many rectangles of a frame, which may overlap.

    The pixels of each window are summed up. Windows that together have more than three times the pixels of the frame
    take seven summed-area tables instead. The standard form of a quadratic needs twenty.

    Parameters
    ----------
    depth, camera, max_missing, max_error, significance, num_threads
        The parameters of `fit_surfaces`.
    windows : (K, 4) array_like of int
        Row, column, height, width of each window in pixels, inside the frame.
    implementation : {"integral", "naive"}, optional
        Summed-area tables, or each window's pixels. By default what takes less time. With tables, a window costs its
        missing pixels, too; behind a lens, the rays of all of its pixels.

    Returns
    -------
    WindowSurfaces
        Arrays of shape (K, ...).

    Raises
    ------
    TypeError, ValueError
        For an argument that cannot be used; also for windows that are masked, not (K, 4) integers, empty, or not wholly
        inside the frame.

    Warns
    -----
    UserWarning
        Something in the frame is most likely not meant as it is, such as its unit: `fit_tiles` lists what.

    Notes
    -----
    Differences of sums over the whole frame round. In 640 x 480, coefficients of second order by tables are right to
    about 1e-4 1/m for windows of 20 x 20 pixels. A Kinect's noise makes 1 1/m of them.
    """
    check_camera(camera)
    if implementation is not None:
        check_choice("implementation", implementation, ("integral", "naive"))
    max_missing = check_share("max_missing", max_missing)
    threads = check_num_threads(num_threads)
    error = check_max_error(max_error)
    check_significance(significance, camera)
    rectangles = check_windows(windows, camera)
    frame = as_depth_frame(depth, camera)
    warn_of_noise(frame, camera.noise)

    arrays = allocate_surfaces((), (len(rectangles),))
    areas = rectangles[:, 2:].prod(axis=1)
    pixels = int(areas.sum())
    if implementation is None:
        implementation = "naive" if pixels <= _AS_TABLES * frame.raw.size else "integral"
    assess = None if camera.noise is None else assessment_of_windows(camera, significance, rectangles)
    centre, rays, needed = (
        central_rays_of(camera, rectangles),
        ray_tables(camera),
        needed_for_surfaces(areas, max_missing),
    )
    # The middle of what is measured, so that residuals lose few digits.
    q = frame.inverse_depth
    reference = float(np.nanmedian(q[:: max(q.shape[0] // 50, 1)])) if np.isfinite(q).any() else 0.0
    reference = reference if np.isfinite(reference) else 0.0
    arrays["_reference"][:] = reference
    results = [arrays[name].reshape(-1) for name in SURFACE_RESULTS]
    values = frame.values
    with announced(("surface windows", implementation, camera.is_distorted, frame.raw.dtype)):
        if implementation == "integral":
            tables = np.empty((camera.height + 1, camera.width + 1, surface_tables.RANGE_EXPLICIT_RESIDUAL))
            surface_tables.range_surface_tables(values, rays, reference, tables)
            before, columns = np.empty((0, 0), np.int32), np.empty(0, np.int32)
            holes = count_missing(values)
            if holes:
                before, columns = np.empty((camera.height, camera.width + 1), np.int32), np.empty(holes, np.int32)
                surface_tables.missing_places(values, before, columns)

        def fit_some(start: int, stop: int) -> None:
            if implementation == "integral":
                surface_tables.surface_window_tables(
                    tables, (before, columns), rays, rectangles, centre, start, stop, arrays["_moments"]
                )
            else:
                surface_tables.surface_window_pixels(
                    values, rays, rectangles, centre, reference, start, stop, arrays["_moments"]
                )
            sums = arrays["_moments"], arrays["_reference"]
            fit_surface_moments(sums, centre, needed, error, (start, stop), tuple(results))
            if assess is not None and assess.level > 0.0:
                assess.mark(flat_frame(arrays, 1, 0), start, stop)

        run_in_ranges(fit_some, len(rectangles), choose_num_threads(threads, max(pixels, frame.raw.size)))
    return WindowSurfaces(camera=camera, windows=rectangles, _writes=[0], **arrays)


@dataclass(frozen=True, eq=False, repr=False)
class MergedSurfaces(SurfaceFits):
    """The surfaces of unions 1 to N of tiles or windows, arrays of shape S = (N,); all else is as in `TileSurfaces`.

    Attributes
    ----------
    labels : (R, C) or (K,) int32
        Of the parts: 0 for none; row i of the arrays belongs to label i + 1.
    """

    labels: npt.NDArray[np.int32]
    _union_centre: Floats
    _pixels: Indices

    @property
    def _footprint(self) -> Indices:
        return self._pixels

    @property
    def _centre(self) -> Floats:
        return self._union_centre

    @property
    def _assessment(self) -> SurfaceAssessment:
        return assessment_of_unions(self.camera, 0.0, self._union_centre, self._pixels)


def union_sizes(footprint: Indices) -> Indices:
    """(N, 2) int64: sides of rectangles that are spread over the image as unions are."""
    from rgbd_planes.uncertainty.footprints import like_rectangles

    return np.maximum(np.rint(like_rectangles(footprint)), 1.0).astype(np.int64)


def assessment_of_unions(
    camera: Camera, significance: float | None, centre: Floats, footprint: Indices
) -> SurfaceAssessment:
    """What tests the surfaces of unions, and works out their statistics."""
    from rgbd_planes.uncertainty.falloff import growth_of_parts

    growth = growth_of_parts(camera, footprint)
    return SurfaceAssessment(camera, significance, centre, union_sizes(footprint), footprint, growth)


def merge_surfaces(fits: SurfaceFits, labels: npt.NDArray[np.int32], significance: float | None) -> MergedSurfaces:
    """Fit a surface to each union of parts; ``labels`` have the shape of ``fits``."""
    flat = labels.ravel()
    count = int(flat.max(initial=0))
    moments, part_centre = np.ascontiguousarray(fits._moments).reshape(22, -1), np.array(fits._centre)
    reference = np.array(fits._reference).ravel()
    n = np.where(flat > 0, moments[0], 0.0)
    total = np.bincount(flat, n, count + 1)[1:]

    def mean(sums: Floats) -> Floats:
        return np.asarray(np.bincount(flat, sums, count + 1)[1:] / np.maximum(total, 1.0))

    has = np.where(n > 0.0, 1.0, 0.0)
    centre = np.stack([mean(has * (n * part_centre[k] + moments[1 + k])) for k in range(2)])
    arrays = allocate_surfaces((), (count,))
    arrays["_reference"][:] = mean(has * (n * np.where(n > 0.0, reference, 0.0) + moments[15]))
    arrays["_moments"][:] = 0.0
    surface_tables.merge_surfaces(
        moments, part_centre, reference, flat, centre, arrays["_reference"], arrays["_moments"]
    )
    results = tuple(arrays[name].reshape(-1) for name in SURFACE_RESULTS)
    fit_surface_moments(
        (arrays["_moments"], arrays["_reference"]), centre, np.full(count, 6.0), np.inf, (0, count), results
    )
    sums = np.stack([np.bincount(flat, column, count + 1)[1:] for column in fits._footprint.T], axis=1).astype(np.int64)
    if fits.camera.noise is not None and count:
        assessment = assessment_of_unions(fits.camera, significance, centre, sums)
        if assessment.level > 0.0:
            assessment.mark(flat_frame(arrays, 1, 0), 0, count)
    return MergedSurfaces(camera=fits.camera, labels=labels, _union_centre=centre, _pixels=sums, _writes=[0], **arrays)
