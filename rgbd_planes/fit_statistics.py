"""What the sensor's noise says of fitted planes: covariances, p-values, and which tiles are too rough."""

import functools
import math
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from rgbd_planes.camera import Camera
from rgbd_planes.kernels import chi_square, statistics
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
        self._most = fits._most_pixels
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
        self._settings = fits.method.startswith("range"), *_of_camera(fits.camera)
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
            matrix = rows.reshape(self._frames + (side, side) + self._cells)
            n = len(self._frames)
            self._shown[first] = matrix.transpose(*range(n), *range(n + 2, matrix.ndim), n, n + 1)
        return self._shown[first]

    def compute(self) -> None:
        """Compute what the fit's arrays say now."""
        counts = self._counts
        most = int(counts.max(initial=0)) if self._most is None else self._most
        if most <= _MOST_COUNTS:
            tables = _all_tables(self._noise, _round_up(most))
        else:
            numbers, index = np.unique(counts, return_inverse=True)
            counts, tables = index.reshape(counts.shape).astype(np.int32), _tables(self._noise, numbers)
        statistics.uncertainty(*self._arrays, counts, *self._settings, tables, self._rows)
        self.is_current = True


def _of_camera(camera: Camera) -> tuple[Float, Float]:
    """The noise along and across the ray, as the kernels take it."""
    assert camera.noise is not None
    pitch = np.array([1.0 / camera.fx, 1.0 / camera.fy])
    return camera.noise._variances, (camera.noise.lateral * pitch) ** 2


def _tables(noise: NoiseModel, counts: npt.NDArray[np.integer]) -> Float:
    """What `kernels.statistics.uncertainty` needs by number of pixels."""
    made = noise.statistics(counts)
    exact = made.expected <= 0.0  # three pixels fit exactly: p is 1, of however many degrees of freedom
    half = 0.5 * np.maximum(np.where(exact, 1e3, made.freedom), chi_square.LEAST_FREEDOM)
    inverse = np.divide(1.0, made.expected, out=np.zeros(half.shape), where=~exact)
    return np.stack(
        [inverse, np.sqrt(half), 1.0 / np.sqrt(half), 1.0 / (half + 0.5), made.tilt, made.offset]
    )


@functools.lru_cache(maxsize=32)
def _all_tables(noise: NoiseModel, most: int) -> Float:
    """For every number of pixels from 0 to ``most``."""
    return _tables(noise, np.arange(most + 1))


@functools.lru_cache(maxsize=32)
def _limits(noise: NoiseModel, level: float, largest: int) -> Float:
    """Largest sum of squared residuals in units of σq² that passes the test, for every count."""
    from scipy.special import chdtri

    # Of thousands of pixels the limit per pixel hardly changes: between some of them it is interpolated.
    counts = np.arange(largest + 1.0)
    some = np.append(counts[:2048], np.geomspace(2048.0, max(largest, 2048.0) + 1.0, 200))
    table = noise.statistics(some)
    limit = table.expected * chdtri(table.freedom, level) / table.freedom / np.maximum(some, 1.0)
    limits = counts * np.interp(counts, some, limit)
    limits[:4] = np.inf  # three pixels fit exactly
    return np.asarray(limits)


def _round_up(count: int) -> int:
    """The next of few sizes, so that tables are shared."""
    return max(256, 1 << (count - 1).bit_length()) if count else 256


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
            self._settings = *_of_camera(camera), _limits(camera.noise, level, _round_up(largest))

    def mark(self, method: str, arrays: "Arrays", start: int, stop: int) -> None:
        """Mark tiles ``start`` to ``stop`` of one frame: flat arrays, as in `fitting.solve_planes`."""
        if self.is_empty:
            return
        statistics.mark_rough(
            arrays["_moments"], arrays["_reference"], arrays["planes"], arrays["alpha"], arrays["rmse_metric"],
            method.startswith("range"), *self._settings, start, stop, arrays["status"], ROUGH,
        )  # fmt: skip
