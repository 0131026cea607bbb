"""Smallest eigenvalue and eigenvector of symmetric 3x3 matrices, many at a time.

A matrix is given by its entries a = m11, b = m12, c = m13, d = m22, e = m23, f = m33. The loops run over the
matrices and vectorise; one whose root has converged stays where it is, so that its result does not depend on its
neighbours.
"""

import math

from .._jit.kernel import kernel

# Rows of room that `smallest_eigenpairs` needs.
WORK = 3
# Where the second eigenvalue is below this share of the largest, the cubic has lost the digits that tell the two
# smaller ones apart.
NEARLY_A_LINE = 1e-5


@kernel(inline=True)
def laguerre_step(root, minors, determinant):
    """Laguerre's step from left of all roots of the characteristic cubic of a matrix of trace 1.

    All roots are real, so that it never passes the smallest one; it is exact for a triple root, where Newton's step
    falls short by half.
    """
    value = ((root - 1.0) * root + minors) * root - determinant
    slope = (3.0 * root - 2.0) * root + minors
    curvature = 6.0 * root - 2.0
    square = 4.0 * slope * slope - 6.0 * value * curvature
    step = -3.0 * value / (slope + math.sqrt(square if square > 0.0 else 0.0))
    return step if (value < 0.0) & (slope > 0.0) else 0.0


@kernel(inline=True)
def eigenvector(a, b, c, d, e, f, eigenvalue):
    """Unit eigenvector: the largest column of the adjugate of M - λI.

    Where the eigenvalue is double, any vector of its plane, or NaN.
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
    is_first = (abs(a11) >= abs(a22)) & (abs(a11) >= abs(a33))
    is_second = abs(a22) >= abs(a33)
    x = a11 if is_first else (a12 if is_second else a13)
    y = a12 if is_first else (a22 if is_second else a23)
    z = a13 if is_first else (a23 if is_second else a33)
    inverse = 1.0 / math.sqrt(x * x + y * y + z * z)
    return x * inverse, y * inverse, z * inverse


@kernel()
def eigenpair_of_line(a, b, c, d, e, f):
    """Smallest eigenvalue and unit eigenvector of a matrix whose two smaller eigenvalues are far below the largest.

    The largest one's eigenvector is any column after a few multiplications by the matrix. Orthogonal to it a 2x2 matrix
    remains, whose digits are those of the smaller eigenvalues.
    """
    is_first, is_second = (a >= d) & (a >= f), d >= f
    x = a if is_first else (b if is_second else c)
    y = b if is_first else (d if is_second else e)
    z = c if is_first else (e if is_second else f)
    for _ in range(3):
        x, y, z = a * x + b * y + c * z, b * x + d * y + e * z, c * x + e * y + f * z
        inverse = 1.0 / math.sqrt(x * x + y * y + z * z)
        x, y, z = x * inverse, y * inverse, z * inverse
    x1, y1, z1, x2, y2, z2 = orthogonal(x, y, z)
    b11, b12, b22 = restricted((a, b, c, d, e, f), (x1, y1, z1), (x2, y2, z2))
    half = 0.5 * (b11 - b22)
    radius = math.sqrt(half * half + b12 * b12)
    first = -b12 if half >= 0.0 else radius - half
    second = radius + half if half >= 0.0 else -b12
    norm = math.sqrt(first * first + second * second)
    first, second = (first / norm, second / norm) if norm > 0.0 else (1.0, 0.0)
    value = 0.5 * (b11 + b22) - radius
    x, y, z = first * x1 + second * x2, first * y1 + second * y2, first * z1 + second * z2
    return value if value > 0.0 else 0.0, x, y, z


@kernel(inline=True)
def orthogonal(x, y, z):
    """Two unit vectors that are orthogonal to a unit vector and to each other."""
    by_z = (abs(z) >= abs(x)) & (abs(z) >= abs(y))
    by_y = abs(y) >= abs(x)
    x2 = z if by_z else (-y if by_y else -z)
    y2 = 0.0 if by_z else (x if by_y else 0.0)
    z2 = -x if by_z else (0.0 if by_y else x)
    inverse = 1.0 / math.sqrt(x2 * x2 + y2 * y2 + z2 * z2)
    x2, y2, z2 = x2 * inverse, y2 * inverse, z2 * inverse
    return x2, y2, z2, y * z2 - z * y2, z * x2 - x * z2, x * y2 - y * x2


@kernel(inline=True)
def restricted(matrix, first, second):
    """Entries 11, 12 and 22 of a symmetric matrix, given by its six entries, in the plane of two unit vectors."""
    a, b, c, d, e, f = matrix
    x1, y1, z1 = first
    x2, y2, z2 = second
    x, y, z = a * x1 + b * y1 + c * z1, b * x1 + d * y1 + e * z1, c * x1 + e * y1 + f * z1
    m11, m12 = x1 * x + y1 * y + z1 * z, x2 * x + y2 * y + z2 * z
    x, y, z = a * x2 + b * y2 + c * z2, b * x2 + d * y2 + e * z2, c * x2 + e * y2 + f * z2
    return m11, m12, x2 * x + y2 * y + z2 * z


@kernel()
def smallest_eigenpairs(matrix, count, work, eigenvalue, vector):
    """Smallest eigenvalue and its unit eigenvector, which is NaN for a zero matrix.

    The root of the cubic has lost digits to the determinant. A Rayleigh quotient, which cubes the error of
    the vector, brings them back; where none are left, `eigenpair_of_line` does.

    Parameters
    ----------
    matrix : (6, N) float64
        Entries a to f of ``count`` positive semi-definite matrices.
    work : (WORK, N) float64
        Scratch memory.
    eigenvalue, vector : (N,) and (3, N) float64, written
    """
    root, minors, determinant = work[0], work[1], work[2]
    for i in range(count):
        inverse = 1.0 / (matrix[0, i] + matrix[3, i] + matrix[5, i])
        a, b, c = matrix[0, i] * inverse, matrix[1, i] * inverse, matrix[2, i] * inverse
        d, e, f = matrix[3, i] * inverse, matrix[4, i] * inverse, matrix[5, i] * inverse
        minors[i] = (d * f - e * e) + (a * f - c * c) + (a * d - b * b)
        determinant[i] = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
        root[i] = 0.0
    for _ in range(40):
        moving = 0
        for i in range(count):
            step = laguerre_step(root[i], minors[i], determinant[i])
            moving += 1 if step > 1e-15 * root[i] else 0
            root[i] += step if step > 1e-15 * root[i] else 0.0
        if moving == 0:
            break
    for i in range(count):
        trace = matrix[0, i] + matrix[3, i] + matrix[5, i]
        inverse = 1.0 / trace
        a, b, c = matrix[0, i] * inverse, matrix[1, i] * inverse, matrix[2, i] * inverse
        d, e, f = matrix[3, i] * inverse, matrix[4, i] * inverse, matrix[5, i] * inverse
        x, y, z = eigenvector(a, b, c, d, e, f, root[i])
        value = a * x * x + d * y * y + f * z * z + 2.0 * (b * x * y + c * x * z + e * y * z)
        x, y, z = eigenvector(a, b, c, d, e, f, value)
        eigenvalue[i] = (value if value > 0.0 else 0.0) * trace
        vector[0, i] = x
        vector[1, i] = y
        vector[2, i] = z
    lines = 0
    for i in range(count):
        lines += 1 if minors[i] < NEARLY_A_LINE else 0
    for i in range(count if lines > 0 else 0):
        if minors[i] < NEARLY_A_LINE:
            trace = matrix[0, i] + matrix[3, i] + matrix[5, i]
            inverse = 1.0 / trace
            value, x, y, z = eigenpair_of_line(
                matrix[0, i] * inverse, matrix[1, i] * inverse, matrix[2, i] * inverse,
                matrix[3, i] * inverse, matrix[4, i] * inverse, matrix[5, i] * inverse,
            )  # fmt: skip
            eigenvalue[i] = value * trace
            vector[0, i] = x
            vector[1, i] = y
            vector[2, i] = z
