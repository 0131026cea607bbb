"""What the sensor's noise says about fitted surfaces: p-values, covariances, and whether a curvature is noise."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Arrays, Floats
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.pixel_pitch import pitch_square, uneven_lateral
from rgbd_planes.kernels.statistics.surfaces import (
    P_VALUE,
    SURFACE_RESULTS,
    SURFACE_TABLE,
    assess_surfaces,
    surface_statistics,
)
from rgbd_planes.noise.quadratics import quadratic_statistics, statistics_of_counts
from rgbd_planes.uncertainty.statistics import DEFAULT_SIGNIFICANCE, check_significance, settings_of

# Tables have an entry for each number of pixels up to this one, for as many sizes of tiles as a grid has.
_MOST_COUNTS, _MOST_SIZES = 10_000, 4


def _read_only(array: npt.NDArray[np.float64]) -> Floats:
    """A contiguous view that cannot be written: of other kinds kernels would be compiled again."""
    made = np.ascontiguousarray(array).view()
    made.flags.writeable = False
    return made


class SurfaceAssessment:
    """Gives ROUGH to surfaces whose residual the noise explains less often than a level; says how good they are.

    Parameters
    ----------
    camera : Camera
        With a noise model.
    significance : float or None
        Share of tiles with such a surface that become ROUGH by chance. None is 0.01; 0 is no test.
    centre : (2, T) float64
        The central rays of the parts of a frame.
    sizes : (T, 2) int64
        Height and width of each part.
    footprint : (T, 5) int64
        Its pixels, missing ones included: their number, Σx, Σy, Σx² and Σy².
    growth : (2, T) or (2, 0) float64
        Factors on the noise's variance at each part's place.
    """

    def __init__(
        self,
        camera: Camera,
        significance: float | None,
        centre: Floats,
        sizes: npt.NDArray[np.int64],
        footprint: npt.NDArray[np.int64],
        growth: Floats,
    ) -> None:
        level = check_significance(significance, camera)
        assert camera.noise is not None
        self.level = DEFAULT_SIGNIFICANCE if level is None else level
        self._noise, self._sizes = camera.noise, sizes
        lens = np.empty((0, len(sizes)))
        lateral = uneven_lateral(camera)
        if lateral > 0.0:
            lens = lateral**2 * pitch_square(camera, footprint)
        self._settings = (_read_only(centre), _read_only(settings_of(camera)), _read_only(growth), _read_only(lens))
        self._table, self._first = np.empty((0, SURFACE_TABLE)), np.zeros(len(sizes), np.int64)
        self._by_size = True
        if not camera.noise.is_independent:
            different, which = np.unique(sizes, axis=0, return_inverse=True)
            whole = different.prod(axis=1)
            self._by_size = 0 < len(different) <= _MOST_SIZES and int(whole.max()) <= _MOST_COUNTS
            if self._by_size:
                components = camera.noise._components
                tables = [quadratic_statistics(components, int(height), int(width)) for height, width in different]
                self._table = np.concatenate(tables)
                self._first = (np.cumsum(whole + 1) - whole - 1)[which.ravel()]

    def _rows(self, counts: npt.NDArray[np.int32], start: int, stop: int) -> tuple[npt.NDArray[np.int64], Floats]:
        """The row of each of some parts of a frame, and the table; of the other parts nothing is known yet."""
        if self._by_size:
            index = self._first + (counts if len(self._table) else 0)
            return index, _read_only(self._table)
        index, table = np.zeros(len(counts), np.int64), np.empty((stop - start, SURFACE_TABLE))
        index[start:stop] = np.arange(stop - start)
        different, which = np.unique(self._sizes[start:stop], axis=0, return_inverse=True)
        for i, (height, width) in enumerate(different.tolist()):
            some = np.flatnonzero(which.ravel() == i)
            table[some] = statistics_of_counts(self._noise._components, height, width, counts[start:stop][some])
        return index, _read_only(table)

    def mark(self, arrays: Arrays, start: int, stop: int, level: float | None = None) -> Floats:
        """Give ROUGH to parts ``start`` to ``stop`` of a frame; return the p-values of all, of others nothing.

        ``arrays`` are those of one frame, in one dimension each, moments in two.
        """
        index, table = self._rows(arrays["valid_count"], start, stop)
        p_value = np.full(len(index), np.nan)
        assess_surfaces(
            arrays["_moments"], arrays["coefficients"], arrays["rmse"], index, table, *self._settings,
            self.level if level is None else level, start, stop, arrays["status"], p_value,
        )  # fmt: skip
        return p_value

    def statistics(self, arrays: Arrays) -> Floats:
        """(SURFACE_RESULTS, T) float64: see `kernels.statistics.surfaces.surface_statistics`."""
        results = np.empty((SURFACE_RESULTS, len(arrays["rmse"])))
        index, table = self._rows(arrays["valid_count"], 0, len(arrays["rmse"]))
        kept = dict(arrays) | {"status": arrays["status"].copy()}
        results[P_VALUE] = self.mark(kept, 0, len(index), 0.0)
        surface_statistics(
            arrays["_moments"], arrays["coefficients"], arrays["rmse"], index, table, *self._settings, 0, len(index),
            results,
        )  # fmt: skip
        return results
