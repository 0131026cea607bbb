"""Fit the constants of `kernels.statistics.chi_square`: ``python -m bench.chi_square`` prints them and their errors.

C(η, 1/a) is taken from SciPy's incomplete gamma functions wherever the deviate z is between -5.6 and 7.2, and from the
saddlepoint approximation, with next to no weight, beyond, so that the polynomial stays small there. Weights make the
relative error of the tail alike everywhere, and let it grow below five degrees of freedom; they are raised where the
error is largest until it hardly varies (Lawson's algorithm).
"""

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial, chebyshev
from scipy import special

from rgbd_planes.kernels.statistics.distributions.chi_square import ETA_LEAST, ETA_MOST

POWERS = (6, 3)
LEAST_A, SHIFT = 0.5, 0.5
ROUNDS = 40


def samples(of_a: int, of_z: int) -> tuple[np.ndarray, ...]:
    """Values of a, z, η and C, where SciPy has them."""
    s = (0.5 + 0.5 * np.cos(np.pi * (np.arange(of_a) + 0.5) / of_a)) / (LEAST_A + SHIFT)
    a, z = np.meshgrid(1.0 / s - SHIFT, 0.8 + 6.4 * np.cos(np.pi * (np.arange(of_z) + 0.5) / of_z), indexing="ij")
    x = np.where(z > 0.0, special.gammainccinv(a, special.ndtr(-z)), special.gammaincinv(a, special.ndtr(z)))
    with np.errstate(all="ignore"):
        more = x / a - 1.0
        series = more**2 * (1 / 2 - more * (1 / 3 - more * (1 / 4 - more * (1 / 5 - more / 6))))
        half_square = np.where(abs(more) < 1e-3, series, more - np.log(x / a))
    eta = np.sign(more) * np.sqrt(2.0 * half_square)
    c = (z - np.sqrt(a) * eta) * np.sqrt(a)
    good = np.isfinite(c) & (x > 1e-280) & (abs(eta) * np.sqrt(a) > 1e-2) & (a < 1e5)
    return a[good], z[good], eta[good], c[good]


def beyond() -> tuple[np.ndarray, ...]:
    """Values of a, η and C by the saddlepoint approximation, ln((λ - 1)/η)/η, where the tail is below 1e-9 or so."""
    s, eta = np.meshgrid(
        np.linspace(1e-4, 1.0 / (LEAST_A + SHIFT), 40), np.linspace(ETA_LEAST, ETA_MOST, 60), indexing="ij"
    )
    # λ = -W(-exp(-1 - η²/2)), the two branches of Lambert's function.
    at = -np.exp(-1.0 - 0.5 * eta**2)
    ratio = -np.where(eta > 0.0, special.lambertw(at, -1).real, special.lambertw(at, 0).real)
    a = 1.0 / s - SHIFT
    far = abs(eta) * np.sqrt(a) > 6.0
    return a[far], eta[far], (np.log((ratio - 1.0) / eta) / eta)[far]


def to_powers(degree: int, low: float, high: float) -> np.ndarray:
    """The Chebyshev polynomials of [low, high], one a row, by powers."""
    rows = np.zeros((degree + 1, degree + 1))
    for j in range(degree + 1):
        made = Chebyshev.basis(j, domain=[low, high]).convert(kind=Polynomial).coef
        rows[j, : len(made)] = made
    return rows


def main() -> None:
    """Fit and print."""
    a, z, eta, c = samples(44, 100)
    a_far, eta_far, c_far = beyond()
    hazard = np.where(z > 0.0, np.maximum(z, 0.8), 2.0 * np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi))
    to_error = hazard / np.sqrt(a)  # of C to the relative error of the tail
    allowed = np.maximum(1.0, 2.5 / a) ** 3
    most_s = 1.0 / (LEAST_A + SHIFT)
    t = 2.0 * (np.concatenate([eta, eta_far]) - ETA_LEAST) / (ETA_MOST - ETA_LEAST) - 1.0
    s = 2.0 / (np.concatenate([a, a_far]) + SHIFT) / most_s - 1.0
    terms = chebyshev.chebvander2d(t, s, POWERS)
    values = np.concatenate([c, c_far])
    weights = np.concatenate([to_error / allowed, np.full(len(c_far), 1e-5)])
    best, chosen = np.inf, np.empty(0)
    raised = weights.copy()
    for _ in range(ROUNDS):
        solution = np.linalg.lstsq(terms * raised[:, None], values * raised, rcond=None)[0]
        error = (np.abs(terms @ solution - values) * weights)[: len(c)]
        if error.max() < best:
            best, chosen = error.max(), solution
        raised[: len(c)] *= np.sqrt(error / error.mean() + 1e-2)
        raised[: len(c)] *= weights[: len(c)].max() / raised[: len(c)].max()
    coefficients = chosen.reshape(POWERS[0] + 1, POWERS[1] + 1)
    powers = to_powers(POWERS[0], ETA_LEAST, ETA_MOST).T @ coefficients @ to_powers(POWERS[1], 0.0, most_s)
    for row in powers:
        print(f"    ({', '.join(f'{value:.15g}' for value in row)}),")
    made = np.polynomial.polynomial.polyval2d(eta, 1.0 / (a + SHIFT), powers)
    for low, high in ((0.5, 1.0), (1.0, 2.5), (2.5, 5.0), (5.0, np.inf)):
        inside = (a >= low) & (a < high)
        print(f"{2 * low:g} to {2 * high:g} degrees of freedom: {(abs(made - c) * to_error)[inside].max():.1e}")


if __name__ == "__main__":
    main()
