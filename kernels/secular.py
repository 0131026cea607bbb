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
    # The identity and the vectors in centred coordinates: c' = c + a·u0 + b·v0.
    b_uu = 1.0 + u0 * u0
    b_uv = u0 * v0
    b_vv = 1.0 + v0 * v0
    p0 = c0 + a0 * u0 + b0 * v0
    # B α₀', then b' = right-hand side of (A' - λB) α' = b' with q, not q - q0.
    ba = b_uu * a0 + b_uv * b0 - u0 * p0
    bb = b_uv * a0 + b_vv * b0 - v0 * p0
    bc = p0 - u0 * a0 - v0 * b0
    right_u = s_uq + q0 * s_u
    right_v = s_vq + q0 * s_v
    right_1 = s_q + q0 * n

    a, b, p = a0, b0, p0
    eigenvalue = rss / (1.0 + a0 * ba + b0 * bb + p0 * bc)
    for _ in range(20):
        # (A' - λB) by LDLᵀ, eliminating the constant first: its pivot n is the largest.
        d1 = n - eigenvalue
        m_u = s_u + eigenvalue * u0
        m_v = s_v + eigenvalue * v0
        l_u = m_u / d1
        l_v = m_v / d1
        e_uu = s_uu - eigenvalue * b_uu - l_u * m_u
        e_uv = s_uv - eigenvalue * b_uv - l_u * m_v
        e_vv = s_vv - eigenvalue * b_vv - l_v * m_v
        determinant = e_uu * e_vv - e_uv * e_uv
        if not (d1 > 0.0 and e_uu > 0.0 and determinant > 0.0):
            return math.nan, math.nan, math.nan, math.nan
        f_u = right_u - l_u * right_1
        f_v = right_v - l_v * right_1
        a = (e_vv * f_u - e_uv * f_v) / determinant
        b = (e_uu * f_v - e_uv * f_u) / determinant
        p = right_1 / d1 - l_u * a - l_v * b
        value = rss - eigenvalue * (1.0 + a * ba + b * bb + p * bc)
        c = p - u0 * a - v0 * b
        step = value / (1.0 + a * a + b * b + c * c)
        if abs(step) <= 1e-14 * eigenvalue:
            break
        eigenvalue += step
    return eigenvalue, a, b, p - u0 * a - v0 * b
