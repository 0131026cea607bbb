"""What correlated noise does to the residual and the errors of a plane."""

import functools
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.arrays import Floats

Components = tuple[tuple[float, float], ...]

# Proportions of rectangles that are worked out: 1, √2, 2, ...; in between, values are interpolated.
_PER_DOUBLING = 2


@dataclass(frozen=True, eq=False)
class ResidualStatistics:
    """What noise does to plane fits, by number of pixels; for independent pixels N - 3, N - 3, and 1.

    Attributes
    ----------
    expected : float64
        Expected sum of squared residuals in units of σq².
    freedom : float64
        The sum of squared residuals is distributed as expected · χ²(freedom) / freedom, by its first two
        moments (Satterthwaite 1946), where the noise has no spread.
    tilt_x, tilt_y, offset : float64
        Factors on the variances of the slopes along x and along y, and of the mean inverse depth, over those of
        independent pixels.
    """

    expected: Floats
    freedom: Floats
    tilt_x: Floats
    tilt_y: Floats
    offset: Floats

    def at(self, which: NDArray[np.intp]) -> "ResidualStatistics":
        """The statistics of those of their numbers of pixels."""
        return ResidualStatistics(
            self.expected[which], self.freedom[which], self.tilt_x[which], self.tilt_y[which], self.offset[which]
        )

    def with_independent(self, along: Floats, independent: Floats, count: NDArray[Any]) -> tuple[Floats, Floats]:
        """Expected sum of squared residuals and degrees of freedom, with an independent part of the variance.

        ``along`` is this model's σq², ``independent`` the other; ``count`` the pixels, three or more.
        """
        number = np.maximum(count - 3.0, 1e-9)
        expected = along * self.expected + independent * number
        # Half the variance of a quadratic form is tr((PC)²), C = C₁ + independent·I.
        half = (along * self.expected) ** 2 / self.freedom
        half = half + independent * (2.0 * along * self.expected + independent * number)
        return expected, expected**2 / half

    def scaled_to(self, count: Floats, whole: Floats) -> "ResidualStatistics":
        """The statistics if only ``count`` of ``whole`` pixels have a measurement, here and there.

        With P and C as in `kernels.statistics.assess`: the part of single pixels, the diagonal of PCP, falls with their
        number, that of pairs with its square.
        """
        more = count > 3.0
        freedoms = np.maximum(whole - 3.0, 1.0)
        share = np.where(more, (count - 3.0) / freedoms, 0.0)
        alone = self.expected / freedoms
        half = self.expected**2 / self.freedom
        single = np.minimum(alone * self.expected, half)
        half = share * single + share**2 * (half - single)
        expected = share * self.expected
        freedom = np.where(more, expected**2 / np.where(more, half, 1.0), 1e-3)
        pairs = count / np.maximum(whole, 1.0)
        factors = (alone + pairs * (factor - alone) for factor in (self.tilt_x, self.tilt_y, self.offset))
        return ResidualStatistics(expected, freedom, *factors)

    def or_larger(self, other: "ResidualStatistics") -> "ResidualStatistics":
        """Of each statistic, the one of two with the larger errors."""
        rougher = other.expected > self.expected
        return ResidualStatistics(
            np.where(rougher, other.expected, self.expected),
            np.where(rougher, other.freedom, self.freedom),
            np.maximum(self.tilt_x, other.tilt_x),
            np.maximum(self.tilt_y, other.tilt_y),
            np.maximum(self.offset, other.offset),
        )


def inverse_freedom(spread: float | Floats) -> Any:
    """One over the degrees of freedom ν of a noise's variance: of mean 1, distributed as (ν - 2) / χ²(ν)."""
    return spread**2 / (2.0 + 4.0 * spread**2)


def ratio_at(deviate: float, freedom: float | Floats, spread: float | Floats) -> Floats:
    """The sum of squared residuals over its expected value that is exceeded as often as this normal deviate.

    A chi-square over its degrees of freedom, times a variance that differs from place to place, is a multiple of
    Fisher's F. Paulson's approximation (1942) is used; without a spread it is Wilson and Hilferty's (1931).
    """
    v, w = 2.0 / 9.0 / freedom, 2.0 / 9.0 * inverse_freedom(spread)
    a, b = 1.0 - w, 1.0 - v
    root = a * b + deviate * np.sqrt(a * a * v + b * b * w - deviate**2 * v * w)
    return np.asarray((root / (a * a - deviate**2 * w)) ** 3 * (1.0 - 2.0 * inverse_freedom(spread)))


def deviate_of(ratio: Floats, freedom: float | Floats, spread: float) -> Floats:
    """The normal deviate that is exceeded as often as this ratio: the inverse of `ratio_at`."""
    v, w = 2.0 / 9.0 / freedom, 2.0 / 9.0 * inverse_freedom(spread)
    root = np.cbrt(ratio / (1.0 - 2.0 * inverse_freedom(spread)))
    return np.asarray(((1.0 - w) * root - (1.0 - v)) / np.sqrt(w * root * root + v))


def correlated_statistics(components: Components, count: Floats, proportions: Floats) -> ResidualStatistics:
    """The statistics of full rectangles of ``count`` pixels, whose width over height is ``proportions``.

    ``components`` are (variance, length) of each part of the error; length 0 is independent.
    """
    pixels = np.maximum(count.ravel(), 4.0)
    # A rectangle is at least two pixels wide.
    long = np.minimum(np.maximum(proportions, 1.0 / proportions).ravel(), 0.25 * pixels)
    step = _PER_DOUBLING * np.log2(long)
    below = np.floor(step + 1e-9)
    beyond = np.maximum(step - below, 0.0)
    root = 0.5 * np.log(pixels)
    sums = np.zeros((len(pixels), 5))
    for node in np.unique(np.concatenate([below, below[beyond > 0.0] + 1.0])).tolist():
        weight = np.where(below == node, 1.0 - beyond, np.where(below == node - 1.0, beyond, 0.0))
        used = np.flatnonzero(weight)
        at = root[used]
        most = max(int(np.ceil(at.max() / np.log(2.0) - 1e-9)), 3)
        roots, curves = _rectangles(components, int(node), 2**most)
        i = np.clip(np.searchsorted(roots, at) - 1, 0, len(roots) - 2)
        share = np.clip((at - roots[i]) / (roots[i + 1] - roots[i]), 0.0, 1.0)[:, None]
        sums[used] += weight[used, None] * (curves[i] * (1.0 - share) + curves[i + 1] * share)
    expected, log_freedom, along, across, offset = sums.T.reshape(5, *count.shape)
    more = count > 3.0
    wide = proportions >= 1.0
    return ResidualStatistics(
        np.where(more, count * expected, 0.0),
        np.where(more, np.exp(log_freedom), 1e-3),
        np.where(wide, along, across),
        np.where(wide, across, along),
        offset,
    )


class _Side(NamedTuple):
    """Along one side of a rectangle, the Toeplitz matrices T of exp(-h²/(2 length²)), one for each component.

    With the unit constant p0 and the unit slope p1: T itself by lag, T·p0, T·p1, p0ᵀTp0, p1ᵀTp1; and how often each lag
    occurs in T.
    """

    by_lag: Floats
    on_constant: Floats
    on_slope: Floats
    constant: Floats
    slope: Floats
    often: NDArray[np.int64]


def _along(components: Components, n: int) -> _Side:
    lags = np.arange(n)
    p0 = np.full(n, n**-0.5)
    p1 = lags - 0.5 * (n - 1)
    p1 = p1 / np.linalg.norm(p1)
    by_lag = np.array(
        [np.exp(-0.5 * (lags / length) ** 2) if length else (lags == 0).astype(float) for _, length in components]
    )
    rows = [np.concatenate([rho[:0:-1], rho]) for rho in by_lag]
    t0, t1 = (np.array([np.convolve(row, p, "valid") for row in rows]) for p in (p0, p1))
    return _Side(by_lag, t0, t1, t0 @ p0, t1 @ p1, np.where(lags == 0, n, 2 * (n - lags)))


@functools.lru_cache(maxsize=128)
@np.errstate(under="ignore")  # of errors far apart
def _rectangles(components: Components, step: int, largest: int) -> tuple[Floats, Floats]:
    """Statistics of rectangles whose sides are as 1 to 2^(step / `_PER_DOUBLING`), by the root of their area.

    (S,) logarithms of roots, up to about the root of ``largest``, and (S, 5) expected per pixel, log freedom, the tilts
    along the long side and along the short one, offset.

    The covariance of the pixels is C = Σ w T⊗T', of the T of each side. The fit removes the constant and the two
    slopes, H = Σ φφᵀ with φ = p0⊗p0, p1⊗p0, p0⊗p1. So tr((I - H)C) and tr(((I - H)C)²) are products of
    one-dimensional sums.
    """
    long = 2.0 ** (step / _PER_DOUBLING)
    # The same sides for any ``largest``, and one that is not rounded to less: a rectangle's result does not depend on
    # those that are asked for with it.
    octaves = np.log2(max(largest / np.sqrt(long), 3.0)) - 1.0
    sides = np.unique(np.round(2.0 ** (1.0 + np.arange(np.ceil(9.0 * octaves) + 2.0) / 9.0)).astype(int))
    w = np.array([share for share, _ in components])
    roots, rows = [], []
    for m in sides:
        n = round(m * long)
        b = _along(components, m)
        a = b if n == m else _along(components, n)
        offset, along, across = (w @ (a.constant * b.constant), w @ (a.slope * b.constant), w @ (a.constant * b.slope))
        expected = n * m * w.sum() - offset - along - across
        a_00, a_11, b_00, b_11 = (t @ t.T for t in (a.on_constant, a.on_slope, b.on_constant, b.on_slope))
        all_pairs = (a.by_lag * a.often) @ a.by_lag.T * ((b.by_lag * b.often) @ b.by_lag.T)
        squares = all_pairs - 2.0 * (a_00 * b_00 + a_11 * b_00 + a_00 * b_11)
        half_variance = w @ squares @ w + offset**2 + along**2 + across**2
        freedom = expected**2 / half_variance
        roots.append(0.5 * np.log(n * m))
        rows.append((expected / (n * m), np.log(max(freedom, 1e-3)), along, across, offset))
    return np.array(roots), np.array(rows)
