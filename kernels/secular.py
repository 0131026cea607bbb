"""Smallest eigenvector of the range-space 4x4 scatter matrix, from the explicit solution.

The matrix of eq. tan_theta_scattermatrix is [[A, b], [bᵀ, κ]], with A the camera's 3x3 block. An
eigenvector (α, -1) satisfies (A - λI) α = b, and with α₀ = A⁻¹b the least-squares solution and RSS its
residual, the eigenvalue is the root between 0 and A's smallest eigenvalue of

    RSS - λ (1 + α₀ᵀ α_λ) = 0,    α_λ = (A - λI)⁻¹ b.

No term of it cancels. With β = dα/dλ = (A - λI)⁻¹ α_λ, its derivatives are -(1 + α_λᵀ α_λ) and -2 α_λᵀ β. The
function is concave, so Newton's method from the Rayleigh quotient of (α₀, -1), which bounds the eigenvalue
from above, falls to it and never passes it. The second derivative costs a few products, which make the step
cubic and take α along: for a tile of some size one step is enough. Where even the quotient is not below A's
smallest eigenvalue, the noise is larger than what the rays tell apart, and the smallest eigenvector is a
plane through the camera's centre.

All is done in coordinates relative to the tile's reference (u0, v0, q0), where A is well conditioned;
there the identity becomes B = T⁻¹T⁻ᵀ, T being the change of coordinates.
"""

import math

from ._jit import kernel

# What a step δ leaves undone in α is (δ / (μ - λ))² of it, μ being A's smallest eigenvalue: 1e-11 with this.
CLOSE = 3e-6


@kernel()
def rayleigh_quotient(a0, b0, c0, rss):
    """Rayleigh quotient of the explicit solution (α₀, -1): also Newton's step from 0."""
    return rss / (1.0 + a0 * a0 + b0 * b0 + c0 * c0)


@kernel()
def improve(n, s_u, s_v, s_uu, s_uv, s_vv, u0, v0, q0, s_q, s_uq, s_vq, a0, b0, c0, rss, eigenvalue):
    """One step of the eigenvalue towards the root, and α there.

    The arguments are those of `smallest_eigenvector`, and an estimate of the eigenvalue not below it.

    Returns
    -------
    eigenvalue, a, b, c : float
    left : float
        Bound on |δ| / (μ - λ) for the step δ that was taken; NaN where the estimate is above A's smallest
        eigenvalue.
    """
    # The identity in centred coordinates; α' is (a, b, c + a·u0 + b·v0).
    b_uu = 1.0 + u0 * u0
    b_uv = u0 * v0
    b_vv = 1.0 + v0 * v0
    # (A' - λB) by LDLᵀ, eliminating the constant first: its pivot d is the largest. e is d times the rest.
    d = n - eigenvalue
    m_u = s_u + eigenvalue * u0
    m_v = s_v + eigenvalue * v0
    e_uu = d * (s_uu - eigenvalue * b_uu) - m_u * m_u
    e_uv = d * (s_uv - eigenvalue * b_uv) - m_u * m_v
    e_vv = d * (s_vv - eigenvalue * b_vv) - m_v * m_v
    determinant = e_uu * e_vv - e_uv * e_uv
    definite = (d > 0.0) & (e_uu > 0.0) & (determinant > 0.0)
    # Two reciprocals from one division.
    by_both = 1.0 / (d * determinant)
    by_d = by_both * determinant
    by_determinant = by_both * d
    i_uu = e_vv * by_determinant
    i_uv = -e_uv * by_determinant
    i_vv = e_uu * by_determinant
    # (A' - λB) α' = b' with q, not q - q0.
    right_1 = s_q + q0 * n
    f_u = d * (s_uq + q0 * s_u) - m_u * right_1
    f_v = d * (s_vq + q0 * s_v) - m_v * right_1
    a = i_uu * f_u + i_uv * f_v
    b = i_uv * f_u + i_vv * f_v
    c = (right_1 - m_u * a - m_v * b) * by_d - u0 * a - v0 * b
    # (A' - λB) β' = B α'
    f_u = d * (a - u0 * c) - m_u * c
    f_v = d * (b - v0 * c) - m_v * c
    a1 = i_uu * f_u + i_uv * f_v
    b1 = i_uv * f_u + i_vv * f_v
    c1 = (c - m_u * a1 - m_v * b1) * by_d - u0 * a1 - v0 * b1
    by_slope = 1.0 / (1.0 + a * a + b * b + c * c)
    step = (rss - eigenvalue * (1.0 + a * a0 + b * b0 + c * c0)) * by_slope
    # Far from the root the parabola could throw the step past it: there the line alone, which cannot.
    bend = (a * a1 + b * b1 + c * c1) * by_slope * step
    step *= 1.0 - (bend if abs(bend) < 0.01 else 0.0)
    bound = abs(step) * d * (i_uu + i_vv) * (b_uu + b_vv)
    left = bound if definite else math.nan
    return (
        eigenvalue + step,
        a + step * a1,
        b + step * b1,
        c + step * c1,
        left,
    )


@kernel()
def smallest_eigenvector(n, s_u, s_v, s_uu, s_uv, s_vv, u0, v0, q0, s_q, s_uq, s_vq, a0, b0, c0, rss):
    """Smallest eigenvalue λ and α of the eigenvector (α, -1).

    Parameters
    ----------
    n, s_u, s_v, s_uu, s_uv, s_vv, s_q, s_uq, s_vq
        Moments relative to the reference (u0, v0, q0).
    a0, b0, c0, rss
        The explicit solution q = a·tanθx + b·tanθy + c and its sum of squared residuals.

    Returns
    -------
    eigenvalue, a, b, c : float
        NaN where the plane passes through the camera's centre.
    """
    eigenvalue = rayleigh_quotient(a0, b0, c0, rss)
    a, b, c = a0, b0, c0
    for _ in range(20):
        eigenvalue, a, b, c, left = improve(
            n, s_u, s_v, s_uu, s_uv, s_vv, u0, v0, q0, s_q, s_uq, s_vq, a0, b0, c0, rss, eigenvalue
        )
        if math.isnan(left):
            return math.nan, math.nan, math.nan, math.nan
        if left <= CLOSE:
            break
    return eigenvalue, a, b, c
