"""Small symmetric systems of linear equations by Cholesky's factors."""

import math

from .._jit.kernel import kernel

# A pivot is the share of a diagonal entry that the rows before it do not explain: below this there is no solution.
LEAST_PIVOT = 1e-13


@kernel()
def factorise(matrix, number, damping, lower):
    """Write L with LLᵀ = matrix + damping·diagonal; returns whether that is positive definite.

    Of ``matrix`` and ``lower``, (P, P) float64, the first ``number`` rows and columns count.
    """
    for j in range(number):
        for k in range(j + 1):
            total = matrix[j, k] * (1.0 + damping) if j == k else matrix[j, k]
            for i in range(k):
                total -= lower[j, i] * lower[k, i]
            if j == k:
                if not total > LEAST_PIVOT * matrix[j, j]:
                    return False
                lower[j, j] = math.sqrt(total)
            else:
                lower[j, k] = total / lower[k, k]
    return True


@kernel()
def solve(lower, number, right, solution):
    """Write the solution (P,) of LLᵀx = right."""
    for j in range(number):
        total = right[j]
        for i in range(j):
            total -= lower[j, i] * solution[i]
        solution[j] = total / lower[j, j]
    for j in range(number - 1, -1, -1):
        total = solution[j]
        for i in range(j + 1, number):
            total -= lower[i, j] * solution[i]
        solution[j] = total / lower[j, j]


@kernel()
def invert(lower, number, unit, inverse):
    """Write (LLᵀ)⁻¹; ``unit`` (P,) is scratch memory."""
    for j in range(number):
        unit[:number] = 0.0
        unit[j] = 1.0
        solve(lower, number, unit, inverse[j])
