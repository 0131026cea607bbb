"""What correlated noise does to the residual and the errors of a plane."""

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ResidualStatistics:
    """What noise does to plane fits, by number of pixels; for independent pixels N - 3, N - 3, 1 and 1.

    Attributes
    ----------
    expected : float64
        Expected sum of squared residuals in units of σq².
    freedom : float64
        The sum of squared residuals is distributed as expected · χ²(freedom) / freedom, by its first two
        moments (Satterthwaite 1946), where the noise has no spread.
    tilt, offset : float64
        Factors on the variances of the slopes and of the mean inverse depth, over those of independent
        pixels.
    """

    expected: Floats
    freedom: Floats
    tilt: Floats
    offset: Floats

    def with_independent(
        self, along: Floats, independent: Floats, count: NDArray[Any]
    ) -> tuple[Floats, Floats]:
        """Expected sum of squared residuals and degrees of freedom, with an independent part of the variance.

        ``along`` is this model's σq², ``independent`` the other; ``count`` the pixels, three or more.
        """
        number = np.maximum(count - 3.0, 1e-9)
        expected = along * self.expected + independent * number
        # Half the variance of a quadratic form is tr((PC)²), C = C₁ + independent·I.
        half = (along * self.expected) ** 2 / self.freedom
        half = half + independent * (2.0 * along * self.expected + independent * number)
        return expected, expected**2 / half

    def of_some(self, count: Floats, whole: Floats) -> "ResidualStatistics":
        """The same where only ``count`` of ``whole`` pixels have a measurement, here and there.

        With P and C as in `kernels.statistics.assess`: what pixels do alone, the diagonal of PCP, falls with their
        number, what they do in pairs with its square.
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
        tilt, offset = (alone + pairs * (factor - alone) for factor in (self.tilt, self.offset))
        return ResidualStatistics(expected, freedom, tilt, offset)

    def or_larger(self, other: "ResidualStatistics") -> "ResidualStatistics":
        """Of each of two, the one that says that errors are larger."""
        rougher = other.expected > self.expected
        return ResidualStatistics(
            np.where(rougher, other.expected, self.expected),
            np.where(rougher, other.freedom, self.freedom),
            np.maximum(self.tilt, other.tilt),
            np.maximum(self.offset, other.offset),
        )


def inverse_freedom(spread: float | Floats) -> Any:
    """One over the degrees of freedom ν of a noise's variance: of mean 1, distributed as (ν - 2) / χ²(ν)."""
    return spread**2 / (2.0 + 4.0 * spread**2)


def ratio_at(deviate: float, freedom: float | Floats, spread: float | Floats) -> Floats:
    """The sum of squared residuals over its expected value that is as likely exceeded as this normal deviate.

    A chi-square over its degrees of freedom times a variance as in `inverse_freedom` is a multiple of Fisher's F:
    by Paulson's approximation (1942), which without a spread is Wilson and Hilferty's (1931).
    """
    v, w = 2.0 / 9.0 / freedom, 2.0 / 9.0 * inverse_freedom(spread)
    a, b = 1.0 - w, 1.0 - v
    root = a * b + deviate * np.sqrt(a * a * v + b * b * w - deviate**2 * v * w)
    return np.asarray((root / (a * a - deviate**2 * w)) ** 3 * (1.0 - 2.0 * inverse_freedom(spread)))


def deviate_of(ratio: Floats, freedom: float | Floats, spread: float) -> Floats:
    """The normal deviate that is as likely exceeded as this ratio: the inverse of `ratio_at`."""
    v, w = 2.0 / 9.0 / freedom, 2.0 / 9.0 * inverse_freedom(spread)
    root = np.cbrt(ratio / (1.0 - 2.0 * inverse_freedom(spread)))
    return np.asarray(((1.0 - w) * root - (1.0 - v)) / np.sqrt(w * root * root + v))


@functools.lru_cache(maxsize=64)
def square_statistics(
    components: tuple[tuple[float, float], ...], largest: int
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Sides of squares, and the four statistics for each: expected per pixel, log freedom, tilt, offset.

    The covariance of the pixels is C = Σ w T⊗T with T the Toeplitz matrix of exp(-h²/(2 length²)). The fit
    removes the constant and the two slopes, H = Σ φφᵀ with φ = p0⊗p0, p1⊗p0, p0⊗p1 for the unit constant p0
    and the unit slope p1. So tr((I - H)C) and tr(((I - H)C)²) are products of one-dimensional sums.
    """
    sides = np.unique(np.round(np.geomspace(2, largest, 8 * int(np.log2(largest)))).astype(int))
    rows = []
    for n in sides:
        lags = np.arange(n)
        weights = np.where(lags == 0, n, 2.0 * (n - lags))  # how often a lag occurs in a T
        p0 = np.full(n, n**-0.5)
        p1 = lags - 0.5 * (n - 1)
        p1 = p1 / np.linalg.norm(p1)
        shares, correlations, smooth0, smooth1 = [], [], [], []
        for share, length in components:
            rho = np.exp(-0.5 * (lags / length) ** 2) if length else (lags == 0).astype(float)
            both_sides = np.concatenate([rho[:0:-1], rho])
            shares.append(share)
            correlations.append(rho)
            smooth0.append(np.convolve(both_sides, p0, "valid") if n > 1 else p0)
            smooth1.append(np.convolve(both_sides, p1, "valid") if n > 1 else p1)
        w = np.array(shares)
        rho, t0, t1 = np.array(correlations), np.array(smooth0), np.array(smooth1)
        t00, t11 = t0 @ p0, t1 @ p1
        offset, tilt = w @ t00**2, w @ (t11 * t00)
        expected = n * n * w.sum() - offset - 2.0 * tilt
        s00, s11 = t0 @ t0.T, t1 @ t1.T
        squares = ((rho * weights) @ rho.T) ** 2 - 2.0 * (s00**2 + 2.0 * s00 * s11)
        half_variance = w @ squares @ w + offset**2 + 2.0 * tilt**2
        freedom = expected**2 / half_variance
        rows.append((expected / n**2, np.log(max(freedom, 1e-3)), tilt, offset))
    expected_per_pixel, log_freedom, tilts, offsets = np.array(rows).T
    return sides.astype(np.float64), expected_per_pixel, log_freedom, tilts, offsets
