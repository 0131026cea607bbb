"""What the sensor's noise says about fitted planes: covariances, p-values, and which tiles are too rough."""

import copy
import functools
import math
import operator
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Arrays, Floats, aligned
from rgbd_planes._core.checks import number
from rgbd_planes._core.threads import Work
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.pixel_pitch import pitch_square, uneven_lateral
from rgbd_planes.kernels.statistics.noise_variances import LATERAL_X, LATERAL_Y
from rgbd_planes.kernels.statistics.tiles.assess import LIMITS, assess
from rgbd_planes.kernels.statistics.tiles.block import (
    DEPTH_ROWS,
    EXPECTED,
    FREEDOM,
    LENS_ROWS,
    MEAN,
    RESULTS,
    SHAPE_ROWS,
    TABLE_COLUMNS,
)
from rgbd_planes.noise.correlation import inverse_freedom
from rgbd_planes.noise.model import NoiseModel
from rgbd_planes.uncertainty.falloff import EVEN

if TYPE_CHECKING:
    from rgbd_planes.uncertainty.protocols import Fits


DEFAULT_SIGNIFICANCE = 0.01
# Tables have an entry for each number of pixels up to this one, for as many sizes of tiles as a grid has.
_MOST_COUNTS, _MOST_SIZES = 10_000, 4
_MOST_FOR_EACH = 64  # entries for each tile: most of a longer table would be made in vain
_ARGUMENTS = ("_moments", "_reference", "planes", "rmse_metric", "valid_count", "status")
_arguments = operator.itemgetter(*_ARGUMENTS)


class FitStatistics:
    """The uncertainty of the planes of a fit, from its moments.

    Parameters
    ----------
    fits : a result of a fit

    Raises
    ------
    ValueError
        The camera has no noise model.
    """

    def __init__(self, fits: "Fits") -> None:
        if fits.camera.noise is None:
            raise ValueError(
                "expected a camera with a noise model for uncertainties, got one without: "
                "Camera(..., noise=rp.noise.kinect_v1()), or rp.estimate_noise(frames, camera)"
            )
        dimensions = len(fits.shape) - fits._cell_dimensions
        frames, cells = fits.shape[:dimensions], fits.shape[dimensions:]
        self.rows = aligned((*frames, RESULTS, *cells))
        """Written by `kernels.statistics.assess`, and again whenever the fit's arrays are written into."""
        assessment = fits._assessment
        # Copied where they are read-only, as Ray and joblib hand over results: no kernel is compiled for such.
        results = {name: getattr(fits, name) for name in _ARGUMENTS}
        arrays = {name: array if array.flags.writeable else array.copy() for name, array in results.items()}
        arrays["_statistics"] = self.rows
        assessment.of(arrays, fits._error_sums, fits._shared)(0, math.prod(fits.shape))
        rows = self.rows.view()
        rows.flags.writeable = False
        self._by_row = rows.transpose(dimensions, *range(dimensions), *range(dimensions + 1, rows.ndim))

    def frame(self, index: int) -> Self:
        """Return the statistics of one frame of a batch, in the same memory."""
        one = copy.copy(self)
        one.rows, one._by_row = self.rows[index], self._by_row[:, index]
        return one

    def row(self, first: int) -> Floats:
        """Return one value per tile: S."""
        return np.asarray(self._by_row[first])

    def matrix(self, first: int, side: int) -> Floats:
        """Return one matrix per tile: S + (side, side). Its entries are apart in memory: each is a row."""
        rows = self._by_row[first : first + side * side]
        matrix = rows.reshape(side, side, *rows.shape[1:])
        return matrix.transpose(*range(2, matrix.ndim), 0, 1)


def settings_of(camera: Camera) -> Floats:
    """A camera's noise, as `kernels.statistics` takes it."""
    assert camera.noise is not None
    return _settings(camera.noise, camera.fx, camera.fy)


@functools.lru_cache(maxsize=32)
def _settings(noise: NoiseModel, fx: float, fy: float) -> Floats:
    lateral = np.array([noise.lateral / fx, noise.lateral / fy]) ** 2
    rounding = np.array([noise.step, noise.disparity_step]) ** 2 / 12.0
    return np.concatenate([lateral, rounding, [inverse_freedom(noise.spread), noise.falloff], noise._variances])


def _some_tables(noise: NoiseModel, counts: npt.NDArray[np.integer], sizes: npt.NDArray[Any]) -> Floats:
    found = noise.statistics(counts, sizes)
    # The covariance of slopes has the geometric mean of their variances' factors: for a square all three are equal.
    cross = np.sqrt(found.tilt_x * found.tilt_y)
    half_variance = found.expected**2 / found.freedom
    return np.stack([found.expected, half_variance, found.tilt_x, cross, found.tilt_y, found.offset], axis=1)


def _tables_of_shapes(
    noise: NoiseModel, counts: npt.NDArray[np.integer], sizes: npt.NDArray[Any], along: Floats, shared: Floats
) -> Floats:
    """A row for each part of any shape, whose pixels have a mean variance ``along`` the ray.

    ``shared`` says all that counts of the rows, or else the part counts as a rectangle.
    """
    expected, freedom = shared[:, EXPECTED] / along, shared[:, FREEDOM]
    known = np.isfinite(freedom) & (expected > 0.0)
    tables = np.ones((len(counts), TABLE_COLUMNS))
    tables[known, 0] = expected[known]
    tables[known, 1] = expected[known] ** 2 / freedom[known]
    others = ~known & np.isfinite(shared[:, MEAN])  # those that have a plane
    tables[others] = _some_tables(noise, counts[others], sizes[others])
    return tables


@functools.lru_cache(maxsize=32)
def _all_tables(noise: NoiseModel, height: int, width: int) -> Floats:
    """A row for every number of valid pixels of a tile."""
    return _some_tables(noise, np.arange(height * width + 1), np.array([height, width]))


def _tables_of(noise: NoiseModel, sizes: npt.NDArray[Any]) -> tuple[Floats | None, npt.NDArray[np.int32] | None]:
    """A row for every number of valid pixels, and each tile's first row, if not all have the same.

    None if tiles are of many sizes, large, or few: then each is worked out alone.
    """
    if not len(sizes) or sizes.dtype.kind == "f":
        return None, None
    different, which = sizes[:1], None
    if (sizes != different).any():
        different, which = np.unique(sizes, axis=0, return_inverse=True)
    whole = different.prod(axis=1)
    if len(different) > _MOST_SIZES or whole.max() > min(_MOST_COUNTS, _MOST_FOR_EACH * len(sizes)):
        return None, None
    tables = [_all_tables(noise, int(height), int(width)) for height, width in different]
    if which is None:
        return tables[0], None
    first = np.cumsum(whole + 1) - whole - 1
    return np.concatenate(tables), first[which.ravel()].astype(np.int32)


# The result of `_made_limits` for the default level, so that most users need no SciPy, which takes 0.3 s to load.
_DEFAULT_LIMITS = (
    0.99999997990416, 3.28995756496133, 2.94107146103008, -0.287355000926986, -0.564272188507147, 0.508657297303299,
    -0.595456492337689, 0.604215142100822, -0.356612220905266, 0.106879331901754, -0.0121882631104778,
)  # fmt: skip


@functools.lru_cache(maxsize=32)
def _limits(level: float, spread: float) -> Floats:
    """Quantiles of chi-square over its degrees of freedom, as a polynomial in 1/√(degrees of freedom), to 1e-5 of p.

    With a spread of the variance, only the normal deviate of the level.
    """
    if level == 0.0:
        return np.empty(0)
    if spread:
        return np.array([-NormalDist().inv_cdf(level)])
    return np.array(_DEFAULT_LIMITS) if level == DEFAULT_SIGNIFICANCE else _made_limits(level)


def _made_limits(level: float) -> Floats:
    from numpy.polynomial import Chebyshev, Polynomial
    from scipy.special import chdtri

    def limit(x: Floats) -> Floats:
        freedom = np.maximum(x, 1e-3) ** -2
        return np.asarray(chdtri(freedom, level) / freedom)

    fitted = Chebyshev.interpolate(limit, LIMITS - 1, domain=[0.0, 1.0])
    return np.asarray(fitted.convert(kind=Polynomial).coef)


def check_level(significance: float | None) -> float | None:
    """Return a share below 1 as a float, or None."""
    if significance is None:
        return None
    level = number("significance", significance, finite=False)
    if not 0.0 <= level < 1.0:
        raise ValueError(f"significance must be at least 0 and below 1, got {significance!r}")
    return level


def check_significance(significance: float | None, camera: Camera) -> float | None:
    """The same, for a camera, which needs a noise model unless it is None, and p-values as small as that."""
    level = check_level(significance)
    if level is not None and camera.noise is None:
        raise ValueError(
            "significance needs a camera with a noise model: Camera(..., noise=rp.noise.kinect_v1()), "
            "or rp.estimate_noise(frames, camera)"
        )
    if level and camera.noise is not None and camera.noise.spread:
        w = 2.0 / 9.0 * inverse_freedom(camera.noise.spread)
        least = NormalDist().cdf((w - 1.0) / w**0.5)  # the p-value of an infinite ratio
        if level < least:
            raise ValueError(
                f"expected a significance of 0, or of at least {least:.1e}, with a noise whose spread is "
                f"{camera.noise.spread:g}: no p-value is smaller; got {level:g}"
            )
    return level


class Assessment:
    """Gives ROUGH to tiles whose residual the noise explains less often than a significance level; writes statistics.

    Parameters
    ----------
    camera : Camera
    method : str
    significance : float or None
        Share of flat tiles that become ROUGH by chance. None is 0.01; 0 is no test.
    sizes : (N, 2) int64 or float64
        Height and width of each tile of a frame, row by row, missing pixels included. Other shapes have those of
        `footprints.like_rectangles`.
    footprint : (N, 5) int64
        For each tile's pixels, missing ones included: their number, Σx, Σy, Σx² and Σy².
    growth : (2, N) float64
        Factors by which a falloff multiplies the variances of tiles, and the variances of their logarithms within them.
    """

    def __init__(
        self,
        camera: Camera,
        method: str,
        significance: float | None,
        sizes: npt.NDArray[Any],
        footprint: npt.NDArray[np.int64],
        growth: Floats,
    ) -> None:
        significance = check_significance(significance, camera)
        self._noise = camera.noise
        if camera.noise is None:
            return
        level = DEFAULT_SIGNIFICANCE if significance is None else significance
        self._limits = _limits(level, camera.noise.spread)
        self._sizes = sizes
        self._tables: Floats | None = np.empty((0, TABLE_COLUMNS))
        self._first: npt.NDArray[np.int32] | None = None
        if not camera.noise.is_independent:
            self._tables, self._first = _tables_of(camera.noise, sizes)
        self._settings = settings_of(camera)
        self._lens_terms = np.empty((0, len(sizes)))
        lateral = uneven_lateral(camera)
        if lateral > 0.0:
            self._lens_terms = lateral**2 * pitch_square(camera, footprint)
        self._growth = growth
        self._in_range_space = method.startswith("range")

    def of(self, arrays: "Arrays", error_sums: Floats | None = None, shared: Floats | None = None) -> Work:
        """Return a function that marks tiles ``start`` to ``stop``, through all frames, and writes their statistics.

        ``arrays`` come from `results.allocate`, for one frame or several, and may have ``_statistics``, RESULTS rows
        for each frame. Labels and unions have ``error_sums`` and ``shared``, from `pixel_errors.Pixels`.
        """
        noise, results = self._noise, arrays.get("_statistics")
        if noise is None or (results is None and not len(self._limits)):
            return lambda start, stop: None
        moments, reference, planes, errors, counts, status = _arguments(arrays)
        tiles = len(self._sizes)
        frames = status.size // tiles if tiles else 1
        planes, errors = planes.reshape(frames, 4 * tiles), errors.reshape(frames, tiles)
        sums = moments.reshape(frames, 10, tiles), reference.reshape(frames, 3, tiles)
        counts, status = counts.reshape(frames, tiles), status.reshape(frames, tiles)
        results = np.empty((frames, 0, tiles)) if results is None else results.reshape(frames, RESULTS, tiles)
        terms, growth = self._lens_terms, self._growth
        if error_sums is not None:
            terms, growth = self._pixel_terms(error_sums, shared, counts), EVEN
        settings, in_range_space = (self._settings, (growth, terms), self._limits), self._in_range_space
        if self._tables is not None and self._first is None:
            # Of most grids, and put together beforehand: each step of Python counts beside a frame's few microseconds.
            before = (*sums, planes, errors, counts, status), in_range_space, self._tables, *settings
            return lambda start, stop: assess(*before, (start, stop), results)

        def assess_tiles(start: int, stop: int) -> None:
            tables = self._tables
            if tables is None:
                some = np.arange(start, stop)  # other parts may not be written yet
                parts = noise, counts.ravel()[some], self._sizes[some % tiles]
                if shared is None:
                    tables = _some_tables(*parts)
                else:
                    tables = _tables_of_shapes(*parts, terms[LENS_ROWS, some], shared[some])
                index = np.arange(-start, counts.size - start, dtype=counts.dtype).reshape(counts.shape)
            else:
                index = counts + self._first
            fits = *sums, planes, errors, index, status
            assess(fits, in_range_space, tables, *settings, (start, stop), results)

        return assess_tiles

    def _pixel_terms(self, error_sums: Floats, shared: Floats | None, counts: npt.NDArray[np.int32]) -> Floats:
        """(DEPTH_ROWS or SHAPE_ROWS, N) float64: means over the pixels of each part, and what their shape does."""
        terms = np.zeros((DEPTH_ROWS if shared is None else SHAPE_ROWS, counts.size))
        if not len(self._lens_terms):  # otherwise the sums include it, pixel by pixel
            terms[0], terms[2] = self._settings[[LATERAL_X, LATERAL_Y]]
        along, rounding, squares, *weighted = error_sums.T / np.maximum(counts.ravel(), 1)
        total = np.where(along + rounding > 0.0, along + rounding, 1.0)
        terms[LENS_ROWS:DEPTH_ROWS] = [along, rounding, np.sqrt(squares) / total, *(mean / total for mean in weighted)]
        if shared is not None:
            terms[DEPTH_ROWS:] = shared.T[:EXPECTED]
        return terms
