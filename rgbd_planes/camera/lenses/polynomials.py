"""Zeros of the polynomials that describe lenses."""

import numpy as np
from numpy.typing import ArrayLike


def first_zero(*polynomials: ArrayLike) -> float:
    """The smallest r > 0 at which one of some polynomials in r² is zero; inf if none ever is.

    Coefficients are those of 1, r², r⁴, ..., and the first of them is 1: read from there on, they are those of a
    polynomial in 1 / r², and no division overflows.
    """
    inverse = np.concatenate([np.roots(coefficients) for coefficients in polynomials])
    real = inverse.real[(abs(inverse.imag) <= 1e-9 * abs(inverse)) & (inverse.real > 0)]
    return float(1.0 / np.sqrt(real.max())) if len(real) else np.inf
