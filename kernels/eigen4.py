"""Smallest eigenvector of the 4x4 scatter matrix of (u, v, w, 1), from its centred 3x3 part.

With C the centred scatter matrix and μ the mean of the n points, the 4x4 matrix is

    M = [[C + n μμᵀ, nμ], [nμᵀ, n]],

and M (x, δ) = λ (x, δ) gives x = -λδ (C - λI)⁻¹ μ and the secular equation

    1 - λ/n - λ μᵀ (C - λI)⁻¹ μ = 0,

whose smallest root lies between 0 and C's smallest eigenvalue λ₁. Solved in s, where λ = λ₁ s / (1 + s),
it is nearly a straight line, also where λ₁ is 0 and M singular: forming M and its quartic would lose the
digits that the answer is made of.
"""

import math

from ._jit import kernel
from .eigen3 import smallest_eigenpair


@kernel()
def smallest_eigenvector(n, mean_u, mean_v, mean_w, a, b, c, d, e, f):
    """Smallest eigenvalue of M and (x, y, z) of its eigenvector (x, y, z, -1).

    Parameters
    ----------
    n, mean_u, mean_v, mean_w
        Number of points and their mean.
    a, b, c, d, e, f
        Entries of the centred scatter matrix: uu, uv, uw, vv, vw, ww.

    Returns
    -------
    eigenvalue, x, y, z : float
        x = y = z = 0 where the vector is not determined.
    """
    first, x1, y1, z1 = smallest_eigenpair(a, b, c, d, e, f)
    if x1 == 0.0 and y1 == 0.0 and z1 == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    # Two directions orthogonal to the eigenvector (Frisvad's construction, on the largest component).
    if abs(z1) >= abs(x1) and abs(z1) >= abs(y1):
        x2, y2, z2 = z1, 0.0, -x1
    elif abs(y1) >= abs(x1):
        x2, y2, z2 = -y1, x1, 0.0
    else:
        x2, y2, z2 = -z1, 0.0, x1
    norm = math.sqrt(x2 * x2 + y2 * y2 + z2 * z2)
    x2, y2, z2 = x2 / norm, y2 / norm, z2 / norm
    x3, y3, z3 = y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2
    # C and μ in these directions.
    cx, cy, cz = a * x2 + b * y2 + c * z2, b * x2 + d * y2 + e * z2, c * x2 + e * y2 + f * z2
    b22 = x2 * cx + y2 * cy + z2 * cz
    b23 = x3 * cx + y3 * cy + z3 * cz
    cx, cy, cz = a * x3 + b * y3 + c * z3, b * x3 + d * y3 + e * z3, c * x3 + e * y3 + f * z3
    b33 = x3 * cx + y3 * cy + z3 * cz
    m1 = x1 * mean_u + y1 * mean_v + z1 * mean_w
    m2 = x2 * mean_u + y2 * mean_v + z2 * mean_w
    m3 = x3 * mean_u + y3 * mean_v + z3 * mean_w

    square = m1 * m1
    if square == 0.0:  # the plane of C passes through the origin
        return first, 0.0, 0.0, 0.0
    low = 0.0
    high = 1.0 / square
    s = high
    eigenvalue = g2 = g3 = 0.0
    for _ in range(60):
        eigenvalue = first * s / (1.0 + s)
        determinant = (b22 - eigenvalue) * (b33 - eigenvalue) - b23 * b23
        g2 = ((b33 - eigenvalue) * m2 - b23 * m3) / determinant
        g3 = ((b22 - eigenvalue) * m3 - b23 * m2) / determinant
        spread = m2 * g2 + m3 * g3
        value = 1.0 - eigenvalue / n - square * s - eigenvalue * spread
        slope = -square - first / ((1.0 + s) * (1.0 + s)) * (
            1.0 / n + spread + eigenvalue * (g2 * g2 + g3 * g3)
        )
        if value > 0.0:
            low = s
        else:
            high = s
        step = -value / slope
        if abs(step) <= 1e-15 * s:
            break
        s = s + step if low < s + step < high else 0.5 * (low + high)
    p1 = m1 * s
    p2 = eigenvalue * g2
    p3 = eigenvalue * g3
    return eigenvalue, p1 * x1 + p2 * x2 + p3 * x3, p1 * y1 + p2 * y2 + p3 * y3, p1 * z1 + p2 * z2 + p3 * z3
