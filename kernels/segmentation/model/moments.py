"""Segmentation: the plane of any union of pixels, from its moments.

Moments are the ten sums [n, Σu, Σv, Σq, Σuu, Σuv, Σuq, Σvv, Σvq, Σqq] over valid pixels, (u, v) =
(tanθx, tanθy), all about the origin: so the moments of any union of blocks are the sum of theirs, and the
plane, the residual and the covariance of the union follow without touching a pixel again. In double
precision the cancellation this costs is far below any sensor's noise: 1e-8 of the inverse depth, also where
most of the frame has been added to a region of tens of pixels and taken out again.
"""

import math

import numpy as np

from ..._jit.kernel import kernel

# Where 1 less the squared correlation of u and v is no more than this, or one of them is constant, pixels lie on a
# line.
ON_A_LINE = 1e-6


@kernel(inline="compiled")
def solve(n, s_u, s_v, s_q, s_uu, s_uv, s_uq, s_vv, s_vq, s_qq):
    """Least squares plane q = α·(u, v, 1) of ten sums (the paper's eq. 15): sum of squared residuals, α.

    The residual is -1 and α 0 where the pixels do not determine a plane.
    """
    per_pixel = 1.0 / max(n, 1.0)
    mean_u, mean_v, mean_q = s_u * per_pixel, s_v * per_pixel, s_q * per_pixel
    uu = s_uu - s_u * mean_u
    uv = s_uv - s_u * mean_v
    vv = s_vv - s_v * mean_v
    uq = s_uq - s_u * mean_q
    vq = s_vq - s_v * mean_q
    qq = s_qq - s_q * mean_q
    determinant = uu * vv - uv * uv
    known = (n >= 3.0) & (determinant > ON_A_LINE * uu * vv)
    inverse = 1.0 / (determinant if known else math.inf)
    a = (vv * uq - uv * vq) * inverse
    b = (uu * vq - uv * uq) * inverse
    rss = max(qq - (a * uq + b * vq), 0.0) if known else -1.0
    return rss, a, b, mean_q - a * mean_u - b * mean_v if known else 0.0


@kernel(inline="compiled")
def residual(m):
    """Sum of squared residuals of the plane fitted to moments; -1 where there is none."""
    return solve(m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9])[0]


@kernel(inline="compiled")
def joint_residual(moments, a, b):
    """Sum of squared residuals of one plane fitted to rows ``a`` and ``b`` of moments; -1 where there is none."""
    return solve(
        moments[a, 0] + moments[b, 0], moments[a, 1] + moments[b, 1], moments[a, 2] + moments[b, 2],
        moments[a, 3] + moments[b, 3], moments[a, 4] + moments[b, 4], moments[a, 5] + moments[b, 5],
        moments[a, 6] + moments[b, 6], moments[a, 7] + moments[b, 7], moments[a, 8] + moments[b, 8],
        moments[a, 9] + moments[b, 9],
    )[0]  # fmt: skip


@kernel(inline="compiled")
def region_residual(moments, a):
    """Sum of squared residuals of the plane fitted to row ``a`` of moments; -1 where there is none."""
    return solve(
        moments[a, 0], moments[a, 1], moments[a, 2], moments[a, 3], moments[a, 4], moments[a, 5], moments[a, 6],
        moments[a, 7], moments[a, 8], moments[a, 9],
    )[0]  # fmt: skip


@kernel(inline="compiled")
def rise(moments, a, b):
    """By how much the sum of squared residuals is larger for rows ``a`` and ``b`` together than for the two apart."""
    return joint_residual(moments, a, b) - region_residual(moments, a) - region_residual(moments, b)


@kernel(inline="compiled")
def fit(m, alpha):
    """Write α of the plane fitted to moments; returns the sum of squared residuals. Both as in `methods`."""
    rss, alpha[0], alpha[1], alpha[2] = solve(m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9])
    return rss


@kernel(inline="compiled")
def difference(alpha, a, b):
    """α of region ``a`` less that of ``b``: by how much its plane's inverse depth is larger."""
    return alpha[a, 0] - alpha[b, 0], alpha[a, 1] - alpha[b, 1], alpha[a, 2] - alpha[b, 2]


@kernel(inline="compiled")
def jump_at(alpha, a, b, where):
    """By how much region a's inverse depth is larger where it touches b: ``where`` is that of their `Contacts`."""
    d_u, d_v, d_1 = difference(alpha, a, b)
    return (d_u * where[1] + d_v * where[2]) / where[0] + d_1


@kernel(inline="compiled")
def angle_between(alpha, beta):
    """Angle between the normals of two planes, radians."""
    along = alpha[0] * beta[0] + alpha[1] * beta[1] + alpha[2] * beta[2]
    square_a = alpha[0] ** 2 + alpha[1] ** 2 + alpha[2] ** 2
    square_b = beta[0] ** 2 + beta[1] ** 2 + beta[2] ** 2
    return math.acos(min(max(along / math.sqrt(square_a * square_b), -1.0), 1.0))


@kernel(inline="compiled")
def pixel_ray(rays, y, x):
    """tanθx and tanθy of a pixel."""
    tan_x, tan_y = rays.tan_x, rays.tan_y
    return tan_x[y if tan_x.shape[0] > 1 else 0, x], tan_y[y, x if tan_y.shape[1] > 1 else 0]


@kernel(inline="compiled")
def misfit(m, i, alpha, region):
    """Sum of squared residuals of the pixels of square ``i``, of moments m (10, T), about a region's plane."""
    a, b, c = alpha[region, 0], alpha[region, 1], alpha[region, 2]
    return (
        m[9, i] - 2.0 * (a * m[6, i] + b * m[8, i] + c * m[3, i])
        + a * (a * m[4, i] + 2.0 * (b * m[5, i] + c * m[1, i]))
        + b * (b * m[7, i] + 2.0 * c * m[2, i])
        + c * c * m[0, i]
    )  # fmt: skip


@kernel(inline=True)
def moment_rows(moments, first, part):
    """Columns ``part`` of five rows of moments, from the ``first`` on, each an array of its own.

    Reading a row by one index takes the processor's vectors a quarter of the time of reading the whole array by two.
    """
    return (
        moments[first, part], moments[first + 1, part], moments[first + 2, part], moments[first + 3, part],
        moments[first + 4, part],
    )  # fmt: skip


@kernel(inline="compiled")
def add(m, u, v, q):
    """Add a pixel to moments."""
    q = np.float64(q)  # the square of a single-precision number has single precision
    m[0] += 1.0
    m[1] += u
    m[2] += v
    m[3] += q
    m[4] += u * u
    m[5] += u * v
    m[6] += u * q
    m[7] += v * v
    m[8] += v * q
    m[9] += q * q
