"""What the sensor's noise says of fitted planes: covariances, p-values, and which tiles are too rough."""

import functools
import math
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from rgbd_planes.camera import Camera
from rgbd_planes.kernels import statistics
from rgbd_planes.noise import NoiseModel

if TYPE_CHECKING:
    from rgbd_planes.fitting import Arrays
    from rgbd_planes.plane_fits import PlaneFits

Float = npt.NDArray[np.float64]

DEFAULT_SIGNIFICANCE = 0.01
ROUGH = 3
# Tables have an entry for each number of pixels up to this one.
_MOST_COUNTS = 10_000


class FitStatistics:
    """The uncertainty of the planes of a fit, from its moments.

    Parameters
    ----------
    fits : PlaneFits

    Raises
    ------
    ValueError
        The camera has no noise model.
    """

    def __init__(self, fits: "PlaneFits") -> None:
        if fits.camera.noise is None:
            raise ValueError(
                "expected a camera with a noise model for uncertainties, got one without: "
                "Camera(..., noise=rp.noise.kinect_v1()), or rp.estimate_noise(frames, camera)"
            )
        self.is_current = False
        """Whether `compute` has been called for the arrays as they are."""
        self._noise = fits.camera.noise
        most = fits._most_pixels
        self._tables = None if most is None else _Tables(self._noise, most)
        shape = fits.status.shape
        dimensions = len(shape) - fits._cell_dimensions
        self._frames, self._cells = shape[:dimensions], shape[dimensions:]
        count, tiles = math.prod(self._frames), math.prod(self._cells)
        self._counts = fits.valid_count.reshape(count, tiles)
        self._arrays = (
            fits._moments.reshape(count, 10, tiles), fits._reference.reshape(count, 3, tiles),
            fits.planes.reshape(count, tiles, 4), fits.alpha.reshape(count, tiles, 3),
            fits.rmse_metric.reshape(count, tiles),
        )  # fmt: skip
        self._settings = fits.method.startswith("range"), _of_camera(fits.camera)
        self._rows = np.empty((count, statistics.RESULTS, tiles))
        self._read_only = self._rows.view()
        self._read_only.flags.writeable = False
        self._shown: dict[int, Float] = {}

    def row(self, first: int) -> Float:
        """Return one value a tile: S."""
        if first not in self._shown:
            self._shown[first] = self._read_only[:, first].reshape(self._frames + self._cells)
        return self._shown[first]

    def matrix(self, first: int, side: int) -> Float:
        """Return one matrix a tile: S + (side, side). Its entries are apart in memory: each is a row."""
        if first not in self._shown:
            rows = self._read_only[:, first : first + side * side]
            matrix = rows.reshape((*self._frames, side, side, *self._cells))
            n = len(self._frames)
            self._shown[first] = matrix.transpose(*range(n), *range(n + 2, matrix.ndim), n, n + 1)
        return self._shown[first]

    def compute(self) -> None:
        """Compute what the fit's arrays say now."""
        made = self._tables
        if made is None:
            made = _Tables(self._noise, int(self._counts.max(initial=0)))
        statistics.uncertainty(*self._arrays, *made.of(self._counts), *self._settings, self._rows)
        self.is_current = True


def _of_camera(camera: Camera) -> Float:
    """The camera's noise, as `kernels.statistics` takes it."""
    noise = camera.noise
    assert noise is not None
    lateral = np.array([noise.lateral / camera.fx, noise.lateral / camera.fy]) ** 2
    rounding = np.array([noise.step, noise.disparity_step]) ** 2 / 12.0
    return np.concatenate([lateral, rounding, [0.5 * noise.spread**2], noise._variances])


class _Tables:
    """Tables by number of pixels for `kernels.statistics`.

    Parameters
    ----------
    noise : NoiseModel
    most : int
        The largest number that can be.
    """

    def __init__(self, noise: NoiseModel, most: int) -> None:
        self._noise = noise
        self._all = None
        if most <= _MOST_COUNTS:
            self._all = _all_tables(noise, max(256, 1 << max(most - 1, 0).bit_length()))

    def of(
        self, counts: npt.NDArray[np.int32], part: slice = slice(None)
    ) -> tuple[npt.NDArray[np.int32], Float]:
        """Which column belongs to each of ``counts``, and the tables; in other parts there may be nothing yet."""
        if self._all is not None:
            return counts, self._all
        index = np.zeros_like(counts)
        numbers, inverse = np.unique(counts[part], return_inverse=True)
        index[part] = inverse.reshape(index[part].shape)
        return index, _some_tables(self._noise, numbers)


def _some_tables(noise: NoiseModel, counts: npt.NDArray[np.integer]) -> Float:
    made = noise.statistics(counts)
    half_variance = made.expected**2 * np.maximum(1.0 / made.freedom - 0.5 * noise.spread**2, 0.0)
    return np.stack([made.expected, half_variance, made.tilt, made.offset])


@functools.lru_cache(maxsize=32)
def _all_tables(noise: NoiseModel, most: int) -> Float:
    """For every number of pixels from 0 to ``most``: few sizes, so that tables are shared."""
    return _some_tables(noise, np.arange(most + 1))


@functools.lru_cache(maxsize=32)
def _limits(level: float) -> Float:
    """Quantiles of chi-square over its degrees of freedom, by powers of 1/√(degrees of freedom), right to 1e-5 of p."""
    from numpy.polynomial import Chebyshev, Polynomial
    from scipy.special import chdtri

    def limit(x: Float) -> Float:
        freedom = np.maximum(x, 1e-3) ** -2
        return np.asarray(chdtri(freedom, level) / freedom)

    return np.asarray(Chebyshev.interpolate(limit, 10, domain=[0.0, 1.0]).convert(kind=Polynomial).coef)


class RoughTest:
    """Gives ROUGH to the tiles whose residual the noise explains less often than a significance level.

    Parameters
    ----------
    camera : Camera
    significance : float or None
        As in `TileFitter`.
    largest : int
        Most pixels of a tile.
    """

    def __init__(self, camera: Camera, significance: float | None, largest: int) -> None:
        if significance is not None and not 0.0 <= significance < 1.0:
            raise ValueError(f"significance must be at least 0 and below 1, got {significance!r}")
        if significance is not None and camera.noise is None:
            raise ValueError(
                "significance needs a camera with a noise model: Camera(..., noise=rp.noise.kinect_v1()), "
                "or rp.estimate_noise(frames, camera)"
            )
        level = DEFAULT_SIGNIFICANCE if significance is None else significance
        self.is_empty = camera.noise is None or level == 0.0
        """Whether there is nothing to test."""
        if camera.noise is not None and not self.is_empty:
            self._tables = _Tables(camera.noise, largest)
            self._settings = _of_camera(camera), _limits(level)

    def mark(self, method: str, arrays: "Arrays", start: int, stop: int) -> None:
        """Mark tiles ``start`` to ``stop`` of one frame: flat arrays, as in `fitting.solve_planes`."""
        if self.is_empty:
            return
        noise, limits = self._settings
        counts, tables = self._tables.of(arrays["valid_count"], slice(start, stop))
        statistics.mark_rough(
            arrays["_moments"], arrays["_reference"], arrays["planes"], arrays["alpha"], arrays["rmse_metric"],
            counts, method.startswith("range"), noise, tables, limits, start, stop, arrays["status"], ROUGH,
        )  # fmt: skip
