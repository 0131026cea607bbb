"""Smallest eigenvectors of 4x4 scatter matrices of (u, v, w, 1), from their centred 3x3 part, many at a time.

With C the centred scatter matrix and μ the mean of the n points, the 4x4 matrix is

    M = [[C + n μμᵀ, nμ], [nμᵀ, n]],

and M (x, δ) = λ (x, δ), the paper's eq. 5, gives x = -λδ (C - λI)⁻¹ μ and the secular equation

    1 - λ/n - λ μᵀ (C - λI)⁻¹ μ = 0,

whose smallest root lies between 0 and C's smallest eigenvalue λ₁. Solved in s, where λ = λ₁ s / (1 + s), it is nearly a
straight line, even where λ₁ is 0 and M singular. Forming M and its quartic would lose the digits that the answer is
made of.
"""

from .._jit.kernel import kernel
from . import eigen3
from .eigen3 import orthogonal, restricted

# Rows of scratch memory that `smallest_eigenvectors` needs.
WORK = 9


@kernel(inline=True)
def secular_step(s, first, n, square, matrix, mean):
    """The secular function at s, Newton's step from there, λ and (C - λI)⁻¹ μ in the second and third direction.

    ``matrix`` and ``mean`` are entries 22, 23 and 33 of C, and 2 and 3 of μ; ``first`` is C's smallest eigenvalue.
    """
    b22, b23, b33 = matrix
    m2, m3 = mean
    eigenvalue = first * s / (1.0 + s)
    inverse = 1.0 / ((b22 - eigenvalue) * (b33 - eigenvalue) - b23 * b23)
    g2 = ((b33 - eigenvalue) * m2 - b23 * m3) * inverse
    g3 = ((b22 - eigenvalue) * m3 - b23 * m2) * inverse
    spread = m2 * g2 + m3 * g3
    value = 1.0 - eigenvalue / n - square * s - eigenvalue * spread
    slope = square + first / ((1.0 + s) * (1.0 + s)) * (1.0 / n + spread + eigenvalue * (g2 * g2 + g3 * g3))
    return value, value / slope, eigenvalue, g2, g3


@kernel(inline=True)
def smallest_eigenvectors(n, mean, matrix, count, work, eigenvalue, vector):
    """Smallest eigenvalue of M and (x, y, z) of its eigenvector (x, y, z, -1).

    Parameters
    ----------
    n, mean : (N,) and (3, N) float64
        Numbers of points and their means.
    matrix : (6, N) float64
        Entries uu, uv, uw, vv, vw, ww of the centred scatter matrices.
    work : (WORK, N) float64
        Scratch memory.
    eigenvalue, vector : (N,) and (3, N) float64, written
        (x, y, z) is not finite where the plane of C passes through the origin.
    """
    eigen3.smallest_eigenpairs(matrix, count, work, eigenvalue, vector)
    b22, b23, b33, m1, m2, m3 = work[0], work[1], work[2], work[3], work[4], work[5]
    low, high, s = work[6], work[7], work[8]
    for i in range(count):
        # C and μ in the directions of its smallest eigenvector and of two others.
        a, b, c, d, e, f = matrix[0, i], matrix[1, i], matrix[2, i], matrix[3, i], matrix[4, i], matrix[5, i]
        x1, y1, z1 = vector[0, i], vector[1, i], vector[2, i]
        x2, y2, z2, x3, y3, z3 = orthogonal(x1, y1, z1)
        b22[i], b23[i], b33[i] = restricted((a, b, c, d, e, f), (x2, y2, z2), (x3, y3, z3))
        m1[i] = x1 * mean[0, i] + y1 * mean[1, i] + z1 * mean[2, i]
        m2[i] = x2 * mean[0, i] + y2 * mean[1, i] + z2 * mean[2, i]
        m3[i] = x3 * mean[0, i] + y3 * mean[1, i] + z3 * mean[2, i]
        low[i] = 0.0
        high[i] = 1.0 / (m1[i] * m1[i])
        s[i] = high[i]
    for _ in range(60):
        moving = 0
        for i in range(count):
            here = s[i]
            value, step, _value, _g2, _g3 = secular_step(
                here, eigenvalue[i], n[i], m1[i] * m1[i], (b22[i], b23[i], b33[i]), (m2[i], m3[i])
            )
            low[i] = here if value > 0.0 else low[i]
            high[i] = high[i] if value > 0.0 else here
            after = here + step
            after = after if (low[i] < after) & (after < high[i]) else 0.5 * (low[i] + high[i])
            # Comparisons with NaN are false: a matrix without a solution does not move.
            moves = abs(step) > 1e-15 * here
            moving += 1 if moves else 0
            s[i] = after if moves else here
        if moving == 0:
            break
    for i in range(count):
        _value, _step, value, g2, g3 = secular_step(
            s[i], eigenvalue[i], n[i], m1[i] * m1[i], (b22[i], b23[i], b33[i]), (m2[i], m3[i])
        )
        eigenvalue[i] = value
        p1, p2, p3 = m1[i] * s[i], value * g2, value * g3
        x1, y1, z1 = vector[0, i], vector[1, i], vector[2, i]
        x2, y2, z2, x3, y3, z3 = orthogonal(x1, y1, z1)
        vector[0, i] = p1 * x1 + p2 * x2 + p3 * x3
        vector[1, i] = p1 * y1 + p2 * y2 + p3 * y3
        vector[2, i] = p1 * z1 + p2 * z2 + p3 * z3
