"""Smallest eigenvector of the range-space 4x4 scatter matrix, from the explicit solution.

The matrix of eq. tan_theta_scattermatrix is [[A, b], [bᵀ, κ]], with A the camera's 3x3 block. An
eigenvector (α, -1) satisfies (A - λI) α = b, and with α₀ = A⁻¹b the least-squares solution and RSS its
residual, the eigenvalue is the root between 0 and A's smallest eigenvalue of

    RSS - λ (1 + α₀ᵀ α_λ) = 0,    α_λ = (A - λI)⁻¹ b.

No term of it cancels, and its derivative is -(1 + α_λᵀ α_λ). The function is concave, so Newton's method
from the Rayleigh quotient of (α₀, -1), which bounds the eigenvalue from above, falls to it and never passes
it, in one to five steps. Where even the quotient is not below A's smallest eigenvalue, the noise is larger
than what the rays tell apart, and the smallest eigenvector is a plane through the camera's centre.

All is done in coordinates relative to the tile's reference (u0, v0, q0), where A is well conditioned;
there the identity becomes B = T⁻¹T⁻ᵀ, T being the change of coordinates.
"""

import math

from ._jit import kernel

# Tiles that take steps until the last of them has converged: several vectors, but few tiles that wait.
TOGETHER = 64


@kernel(inline=True)
def newton_step(
    eigenvalue, n, s_u, s_v, s_uu, s_uv, s_vv, u0, v0, right_u, right_v, right_1, ba, bb, bc, rss
):  # fmt: skip
    """α_λ in centred coordinates (a, b, p) and the step from λ towards the root.

    The step is NaN where A' - λB is not positive definite. (ba, bb, bc) is B α₀' and the right-hand side that
    of (A' - λB) α' = b'.
    """
    # (A' - λB) by LDLᵀ, eliminating the constant first: its pivot n is the largest.
    d1 = n - eigenvalue
    inverse_1 = 1.0 / d1
    m_u = s_u + eigenvalue * u0
    m_v = s_v + eigenvalue * v0
    l_u = m_u * inverse_1
    l_v = m_v * inverse_1
    e_uu = s_uu - eigenvalue * (1.0 + u0 * u0) - l_u * m_u
    e_uv = s_uv - eigenvalue * (u0 * v0) - l_u * m_v
    e_vv = s_vv - eigenvalue * (1.0 + v0 * v0) - l_v * m_v
    determinant = e_uu * e_vv - e_uv * e_uv
    inverse = 1.0 / determinant
    f_u = right_u - l_u * right_1
    f_v = right_v - l_v * right_1
    a = (e_vv * f_u - e_uv * f_v) * inverse
    b = (e_uu * f_v - e_uv * f_u) * inverse
    p = right_1 * inverse_1 - l_u * a - l_v * b
    value = rss - eigenvalue * (1.0 + a * ba + b * bb + p * bc)
    c = p - u0 * a - v0 * b
    step = value / (1.0 + a * a + b * b + c * c)
    definite = (d1 > 0.0) & (e_uu > 0.0) & (determinant > 0.0)
    return a, b, p, step if definite else math.nan


@kernel()
def smallest_eigenvectors(moments, reference, count, work, solution, eigenvalue):
    """Smallest eigenvalue λ and α of the eigenvector (α, -1) of many tiles at a time.

    The tiles go through Newton's method side by side; one that has converged stays where it is, so that its
    result does not depend on its neighbours.

    Parameters
    ----------
    moments, reference : (10, N) and (3, N) float64
        Of ``count`` tiles.
    work : (4, N) float64
        Room.
    solution : (3, N) float64
        On entry the explicit solution q = a·tanθx + b·tanθy + c, on return α.
    eigenvalue : (N,) float64
        The explicit solution's sum of squared residuals on entry, λ on return: NaN, and α meaningless, where
        the plane passes through the camera's centre or NaN came in.
    """
    for first in range(0, count, TOGETHER):
        last = min(first + TOGETHER, count)
        # In one dimension, whose stride the compiler knows.
        u0, v0, q0 = reference[0][first:last], reference[1][first:last], reference[2][first:last]
        n, s_u, s_v, s_q = (
            moments[0][first:last],
            moments[1][first:last],
            moments[2][first:last],
            moments[3][first:last],
        )
        s_uu, s_uv, s_uq = moments[4][first:last], moments[5][first:last], moments[6][first:last]
        s_vv, s_vq = moments[7][first:last], moments[8][first:last]
        rss, ba, bb, bc = work[0], work[1], work[2], work[3]
        alpha_0, alpha_1, alpha_2 = solution[0][first:last], solution[1][first:last], solution[2][first:last]
        root = eigenvalue[first:last]
        for i in range(last - first):
            # B α₀' with p the value at the reference: centred coordinates have c' = c + a·u0 + b·v0.
            a, b = alpha_0[i], alpha_1[i]
            p = alpha_2[i] + a * u0[i] + b * v0[i]
            ba[i] = (1.0 + u0[i] * u0[i]) * a + u0[i] * v0[i] * b - u0[i] * p
            bb[i] = u0[i] * v0[i] * a + (1.0 + v0[i] * v0[i]) * b - v0[i] * p
            bc[i] = p - u0[i] * a - v0[i] * b
            rss[i] = root[i]
            # The Rayleigh quotient of (α₀, -1).
            root[i] = rss[i] / (1.0 + a * ba[i] + b * bb[i] + p * bc[i])
        for _ in range(20):
            moving = 0
            for i in range(last - first):
                a, b, p, step = newton_step(
                    root[i], n[i], s_u[i], s_v[i], s_uu[i], s_uv[i], s_vv[i], u0[i], v0[i],
                    s_uq[i] + q0[i] * s_u[i], s_vq[i] + q0[i] * s_v[i], s_q[i] + q0[i] * n[i],
                    ba[i], bb[i], bc[i], rss[i],
                )  # fmt: skip
                alpha_0[i] = a
                alpha_1[i] = b
                alpha_2[i] = p - u0[i] * a - v0[i] * b
                # Comparisons with NaN are false: a tile without a solution is NaN and does not move.
                moving += 1 if abs(step) > 1e-14 * root[i] else 0
                root[i] += 0.0 if abs(step) <= 1e-14 * root[i] else step
            if moving == 0:
                break
