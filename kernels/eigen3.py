"""Smallest eigenvalue and eigenvector of a symmetric 3x3 matrix.

The matrix is given by its entries a = m11, b = m12, c = m13, d = m22, e = m23, f = m33.
"""

import math

from ._jit import kernel


@kernel()
def smallest_eigenvalue(a, b, c, d, e, f):
    """Smallest root of the characteristic cubic of a positive semi-definite matrix.

    Newton's method from 0, which is left of every root: it rises to the smallest one and never passes
    it. For a scatter matrix of points near a plane that takes two or three steps.
    """
    trace = a + d + f
    minors = (d * f - e * e) + (a * f - c * c) + (a * d - b * b)
    determinant = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    root = 0.0
    for _ in range(60):
        value = ((root - trace) * root + minors) * root - determinant
        slope = (3.0 * root - 2.0 * trace) * root + minors
        if slope <= 0.0 or value >= 0.0:
            break
        step = -value / slope
        root += step
        if step <= 1e-15 * root:
            break
    return root


@kernel()
def eigenvector(a, b, c, d, e, f, eigenvalue):
    """Unit eigenvector: the largest column of the adjugate of M - λI.

    Where the eigenvalue is double, any vector of its plane, or zero.
    """
    a = a - eigenvalue
    d = d - eigenvalue
    f = f - eigenvalue
    a11 = d * f - e * e
    a22 = a * f - c * c
    a33 = a * d - b * b
    a12 = c * e - b * f
    a13 = b * e - c * d
    a23 = b * c - a * e
    if abs(a11) >= abs(a22) and abs(a11) >= abs(a33):
        x, y, z = a11, a12, a13
    elif abs(a22) >= abs(a33):
        x, y, z = a12, a22, a23
    else:
        x, y, z = a13, a23, a33
    norm = math.sqrt(x * x + y * y + z * z)
    if norm == 0.0:
        return 0.0, 0.0, 0.0
    return x / norm, y / norm, z / norm


@kernel()
def smallest_eigenpair(a, b, c, d, e, f):
    """Smallest eigenvalue and its unit eigenvector; the vector is zero for a zero matrix.

    The root of the cubic has lost digits to the determinant. A Rayleigh quotient, which cubes the error of
    the vector, brings them back.
    """
    scale = a + d + f
    if not scale > 0.0:
        return 0.0, 0.0, 0.0, 0.0
    a, b, c, d, e, f = a / scale, b / scale, c / scale, d / scale, e / scale, f / scale
    root = smallest_eigenvalue(a, b, c, d, e, f)
    x, y, z = eigenvector(a, b, c, d, e, f, root)
    root = a * x * x + d * y * y + f * z * z + 2.0 * (b * x * y + c * x * z + e * y * z)
    x, y, z = eigenvector(a, b, c, d, e, f, root)
    return max(root, 0.0) * scale, x, y, z
