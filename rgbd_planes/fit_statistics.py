"""What the sensor's noise says of fitted planes: covariances, p-values, and which tiles are too rough."""

import functools
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from rgbd_planes.kernels import statistics
from rgbd_planes.noise import NoiseModel, ResidualStatistics

if TYPE_CHECKING:
    from rgbd_planes.fitting import Arrays
    from rgbd_planes.plane_fits import PlaneFits

Float = npt.NDArray[np.float64]

DEFAULT_SIGNIFICANCE = 0.01
# Below this many degrees of freedom the normal approximation of the chi-square is off in the third digit.
FEW = 12.0


@functools.lru_cache(maxsize=32)
def _table(noise: NoiseModel, largest: int) -> ResidualStatistics:
    """Statistics for every count from 0 to ``largest``."""
    return noise.statistics(np.arange(largest + 1))


class FrameStatistics:
    """The uncertainty of the planes of one frame, from its moments.

    Parameters
    ----------
    fits : PlaneFits
    arrays : dict
        Those of the frame, flat: see `flat_frames`.

    Raises
    ------
    ValueError
        The camera has no noise model.
    """

    def __init__(self, fits: "PlaneFits", arrays: "Arrays") -> None:
        noise = fits.camera.noise
        if noise is None:
            raise ValueError(
                "expected a camera with a noise model for uncertainties, got one without: "
                "Camera(..., noise=rp.noise.kinect_v1()), or rp.estimate_noise(frames, camera)"
            )
        self._arrays = arrays
        self._in_range_space = in_range_space = fits.method.startswith("range")
        self._count = len(arrays["status"])
        moments, reference = arrays["_moments"], arrays["_reference"]
        self._mean = np.empty(self._count)
        spread = np.empty(0 if noise.is_constant else self._count)
        statistics.inverse_depths(moments, reference, in_range_space, 0, self._count, self._mean, spread)
        self._variance = noise.mean_variance(self._mean, spread)
        counts = arrays["valid_count"]
        largest = int(counts.max(initial=0))
        if largest <= 10_000:
            self._counts, self._table = counts, _table(noise, _round_up(largest))
        else:
            counts, self._counts = np.unique(counts, return_inverse=True)
            self._table = noise.statistics(counts)

    def p_value(self, out: Float) -> None:
        """Write the p-values of the residuals into (T,) ``out``."""
        ratio, inverse_freedom = np.empty((2, self._count))
        statistics.residual_ratio(
            self._arrays["planes"], self._arrays["rmse_metric"], self._arrays["valid_count"], self._mean,
            self._variance, self._counts, self._table.expected, self._table.freedom,
            ratio, inverse_freedom,
        )  # fmt: skip
        statistics.chi_square_tail(ratio, inverse_freedom, out)
        few = np.flatnonzero((inverse_freedom > 1.0 / FEW) & (ratio >= 0.0))
        if len(few):
            from scipy.special import chdtrc

            freedom = 1.0 / inverse_freedom[few]
            out[few] = np.where(freedom < 0.01, 1.0, chdtrc(freedom, freedom * ratio[few]))

    def alpha_covariance(self, out: Float) -> None:
        """Write the covariances of α into (T, 3, 3) ``out``."""
        self._covariance(statistics.alpha_covariance, "alpha", out)

    def plane_covariance(self, out: Float) -> None:
        """Write the covariances of (n, d) into (T, 4, 4) ``out``."""
        self._covariance(statistics.plane_covariance, "planes", out)

    def _covariance(self, kernel: Any, of: str, out: Float) -> None:
        kernel(
            self._arrays["_moments"], self._arrays["_reference"], self._arrays[of], self._in_range_space,
            self._variance, self._counts, self._table.tilt, self._table.offset, out,
        )  # fmt: skip


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
    noise : NoiseModel or None
    significance : float or None
        As in `TileFitter`.
    largest : int
        Most pixels of a tile.
    """

    def __init__(self, noise: NoiseModel | None, significance: float | None, largest: int) -> None:
        if significance is not None and not 0.0 <= significance < 1.0:
            raise ValueError(f"significance must be at least 0 and below 1, got {significance!r}")
        if significance is not None and noise is None:
            raise ValueError(
                "significance needs a camera with a noise model: Camera(..., noise=rp.noise.kinect_v1()), "
                "or rp.estimate_noise(frames, camera)"
            )
        level = DEFAULT_SIGNIFICANCE if significance is None else significance
        self._noise = noise if level > 0.0 else None
        if self._noise is None:
            return
        self._limit = _limits(self._noise, level, _round_up(largest))

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to test."""
        return self._noise is None

    def mark(self, method: str, arrays: "Arrays", start: int, stop: int) -> None:
        """Mark tiles ``start`` to ``stop`` of one frame: flat arrays, as in `fitting.solve_planes`."""
        if self._noise is None:
            return
        mean = np.empty(len(arrays["status"]))
        spread = np.empty(0 if self._noise.is_constant else len(mean))
        statistics.inverse_depths(
            arrays["_moments"], arrays["_reference"], method.startswith("range"), start, stop, mean, spread
        )
        variance = np.empty(len(mean))
        variance[start:stop] = self._noise.mean_variance(mean[start:stop], spread[start:stop])
        statistics.mark_rough(
            arrays["planes"], arrays["rmse_metric"], arrays["valid_count"], mean, variance, self._limit,
            start, stop, arrays["status"], ROUGH,
        )  # fmt: skip


ROUGH = 3


def flat_frames(fits: "PlaneFits", cells: int) -> list[dict[str, npt.NDArray[Any]]]:
    """The arrays of each frame of ``fits``, flat: (T, ...), and (10, T), (3, T).

    ``cells`` is the number of dimensions that count the planes of a frame.
    """
    names = ("planes", "alpha", "rmse_metric", "valid_count", "status", "_moments", "_reference")
    batch = fits.status.ndim > cells
    frames = []
    for i in range(len(fits.status) if batch else 1):
        flat = {}
        for name in names:
            array = getattr(fits, name)[i] if batch else getattr(fits, name)
            leading = name in ("_moments", "_reference")
            flat[name] = array.reshape((len(array), -1) if leading else (-1, *array.shape[cells:]))
        frames.append(flat)
    return frames
