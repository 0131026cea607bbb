"""Maximum likelihood of a surface by Levenberg and Marquardt's method."""

import math

import numpy as np

from .._jit.kernel import kernel
from ..solvers.cholesky import factorise, solve
from ..statistics.correlation_cells import sum_of_products
from .quadric import BLOCK, CYLINDER, KAPPA, PARAMETERS, Q0, RESIDUAL, SURFACE, evaluate, moved, parameters_of

# The search ends with a step that lowers the sum of squares, in units of the variance, by less: a thousandth of a
# standard deviation. Or after so many steps.
ENOUGH, ROUNDS = 1e-6, 40
# Damping, relative to the diagonal of the normal equations.
LEAST_DAMPING, MOST_DAMPING = 1e-9, 1e9


@kernel()
def normal_equations(pixels, weights, surface, kind, work, normal, right):
    """Write Σ J Jᵀ and Σ J·residual over pixels, whitened; returns the sum of squared residuals.

    Parameters
    ----------
    pixels : us, vs, qs, (M,) float64 each
    weights : (M,) float64
    surface : (SURFACE,) float64
    kind : int
    work : (PARAMETERS + 1, BLOCK) float64
        Scratch memory.
    normal, right : (PARAMETERS, PARAMETERS) and (PARAMETERS,) float64, written
        As far as the kind has parameters.
    """
    us, vs, qs = pixels
    f = 0.0 if kind == CYLINDER else 1.0
    number, total = parameters_of(kind), 0.0
    normal[:] = 0.0
    right[:] = 0.0
    for begin in range(0, len(us), BLOCK):
        end = min(begin + BLOCK, len(us))
        count = end - begin
        evaluate(us, vs, qs, weights, begin, end, surface, f, work)
        for j in range(number):
            for k in range(j + 1):
                normal[j, k] += sum_of_products(work[j], work[k], count)
            right[j] += sum_of_products(work[j], work[RESIDUAL], count)
        total += sum_of_products(work[RESIDUAL], work[RESIDUAL], count)
    for j in range(number):
        for k in range(j):
            normal[k, j] = normal[j, k]
    return total


@kernel()
def minimise(pixels, weights, kind, damping, enough, surface):
    """Move a surface to where the sum of squared residuals is least.

    Parameters
    ----------
    pixels, weights
        As for `normal_equations`.
    kind : int
    damping : float
        To begin with.
    enough : float
        The search ends with a step that lowers the sum of squares by less than this share of it.
    surface : (SURFACE,) float64, changed

    Returns
    -------
    total : float
        The sum of squared residuals, whitened; NaN where the pixels determine no such surface.
    """
    number = parameters_of(kind)
    work = np.empty((PARAMETERS + 1, BLOCK))
    normal, lower = np.empty((2, PARAMETERS, PARAMETERS)), np.zeros((PARAMETERS, PARAMETERS))
    right, step, candidate = np.empty((2, PARAMETERS)), np.zeros(PARAMETERS), np.empty(SURFACE)
    total = normal_equations(pixels, weights, surface, kind, work, normal[0], right[0])
    for _ in range(ROUNDS):
        while not factorise(normal[0], number, damping, lower):
            damping = max(10.0 * damping, 1e-6)
            if damping > MOST_DAMPING:
                return math.nan
        solve(lower, number, right[0], step)
        gain = 0.0
        for j in range(number):
            gain += step[j] * (right[0, j] + damping * normal[0, j, j] * step[j])
        moved(surface, step, candidate)
        is_last, squares = gain < max(ENOUGH, enough * total), math.inf
        if candidate[Q0] > 0.0:
            squares = normal_equations(pixels, weights, candidate, kind, work, normal[1], right[1])
        if squares < total or is_last:
            if squares < total:
                surface[:] = candidate
                total = squares
            if is_last:
                break
            normal[0], right[0] = normal[1], right[1]
            damping = max(0.1 * damping, LEAST_DAMPING)
        else:
            damping = max(10.0 * damping, 1e-4)
            if damping > MOST_DAMPING:
                break
    return total if abs(surface[KAPPA]) < math.inf else math.nan
