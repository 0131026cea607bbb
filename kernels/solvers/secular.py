"""Smallest eigenvector of the range-space 4x4 scatter matrix, from the explicit solution.

The matrix of eq. 14 is [[A, b], [bᵀ, κ]], with A the camera's 3x3 block. An eigenvector (α, -1) satisfies
(A - λI) α = b, and with α₀ = A⁻¹b the least-squares solution and RSS its residual, the eigenvalue is the root between 0
and A's smallest eigenvalue of

    RSS - λ h(λ) = 0,    h(λ) = 1 + α₀ᵀ α_λ,    α_λ = (A - λI)⁻¹ b.

No term of it cancels. A step goes to where λ / RSS - 1 / h(λ) would have its root if it were a straight line. It nearly
is, even beside h's pole at A's smallest eigenvalue, where Newton's steps for RSS - λ h go no more than half of the way.
The slope of h needs nothing new: that of λ h is 1 + α_λᵀ α_λ.

The Rayleigh quotient of (α₀, -1) bounds the root from above, and 1 / tr A⁻¹ is between a third and all of A's smallest
eigenvalue. From the smaller of the two it takes one or two steps where the noise is small. Where the noise is larger
than what the rays tell apart, as across a depth edge or in the smallest tiles, the root lies close to the pole, and it
takes some more. Steps that leave the interval in which the root is known to lie are replaced by bisection. The plane
then passes near the camera's centre.

All is done in coordinates relative to the tile's reference (u0, v0, q0), where A is well conditioned. There the
identity becomes B = T⁻¹T⁻ᵀ, with T the change of coordinates.
"""

import math

import numpy as np

from .._jit.kernel import kernel

# Tiles that take steps side by side, filling several vectors, and how many steps: tiles that need more take them alone.
TOGETHER = 64
STEPS = 4
# Steps, as shares of λ, that count as none, and that rounding alone may make.
PRECISION, STEP_ROUNDING = 1e-14, 1e-10
# Rows of the tiles' state: λ, the interval in which it lies, whether it is still to be found; α_λ in centred
# coordinates; RSS; B α₀'.
ROOT, LOW, HIGH, MOVES, ALPHA_U, ALPHA_V, ALPHA_1, RSS, START_U, START_V, START_1 = range(11)


@kernel(inline=True)
def start(i, state, solution_u, solution_v, solution_1, rss, n, s_u, s_v, s_uu, s_uv, s_vv, u0, v0):
    """Write the state of tile ``i`` from its explicit solution."""
    # Centred coordinates have p = c + a·u0 + b·v0, the value at the reference.
    a, b = solution_u[i], solution_v[i]
    p = solution_1[i] + a * u0[i] + b * v0[i]
    b_u = (1.0 + u0[i] * u0[i]) * a + u0[i] * v0[i] * b - u0[i] * p
    b_v = u0[i] * v0[i] * a + (1.0 + v0[i] * v0[i]) * b - v0[i] * p
    b_1 = p - u0[i] * a - v0[i] * b
    quotient = rss[i] / (1.0 + a * b_u + b * b_v + p * b_1)
    # tr A⁻¹ is tr C⁻¹ + μᵀC⁻¹μ + 1/n, with C the centred scatter of the rays and μ their mean.
    per_pixel = 1.0 / n[i]
    mean_u, mean_v = s_u[i] * per_pixel, s_v[i] * per_pixel
    c_uu, c_uv, c_vv = s_uu[i] - s_u[i] * mean_u, s_uv[i] - s_u[i] * mean_v, s_vv[i] - s_v[i] * mean_v
    u, v = u0[i] + mean_u, v0[i] + mean_v
    determinant = c_uu * c_vv - c_uv * c_uv
    adjugate = c_uu + c_vv + u * u * c_vv - 2.0 * u * v * c_uv + v * v * c_uu
    bound = determinant / (adjugate + determinant * per_pixel)
    state[ROOT, i] = bound if bound < quotient else quotient  # NaN stays NaN
    state[LOW, i], state[HIGH, i] = 0.0, quotient
    state[RSS, i], state[START_U, i], state[START_V, i], state[START_1, i] = rss[i], b_u, b_v, b_1


@kernel(inline=True)
def step(i, state, n, s_u, s_v, s_q, s_uu, s_uv, s_uq, s_vv, s_vq, u0, v0, q0):
    """Find α_λ of tile ``i``, and go on to a better λ, or to NaN where it can lie nowhere."""
    eigenvalue, rss = state[ROOT, i], state[RSS, i]
    # (A' - λB) α' = b' by LDLᵀ, eliminating the constant first: its pivot n is the largest.
    d1 = n[i] - eigenvalue
    inverse_1 = 1.0 / d1
    m_u = s_u[i] + eigenvalue * u0[i]
    m_v = s_v[i] + eigenvalue * v0[i]
    l_u = m_u * inverse_1
    l_v = m_v * inverse_1
    e_uu = s_uu[i] - eigenvalue * (1.0 + u0[i] * u0[i]) - l_u * m_u
    e_uv = s_uv[i] - eigenvalue * (u0[i] * v0[i]) - l_u * m_v
    e_vv = s_vv[i] - eigenvalue * (1.0 + v0[i] * v0[i]) - l_v * m_v
    determinant = e_uu * e_vv - e_uv * e_uv
    inverse = 1.0 / determinant
    right_1 = s_q[i] + q0[i] * n[i]
    f_u = s_uq[i] + q0[i] * s_u[i] - l_u * right_1
    f_v = s_vq[i] + q0[i] * s_v[i] - l_v * right_1
    a = (e_vv * f_u - e_uv * f_v) * inverse
    b = (e_uu * f_v - e_uv * f_u) * inverse
    p = right_1 * inverse_1 - l_u * a - l_v * b
    state[ALPHA_U, i], state[ALPHA_V, i], state[ALPHA_1, i] = a, b, p
    c = p - u0[i] * a - v0[i] * b
    h = 1.0 + a * state[START_U, i] + b * state[START_V, i] + p * state[START_1, i]
    product = eigenvalue * h
    move = (rss - product) * product / (product * h + rss * (1.0 + a * a + b * b + c * c - h))
    # Beyond A's smallest eigenvalue h begins again far below 0, and 1/h continues smoothly.
    below = (e_uu > 0.0) & (determinant > 0.0)
    beyond = (determinant < 0.0) & (h < 0.0)
    move = move if (d1 > 0.0) & (below | beyond) else math.nan
    low = eigenvalue if move > 0.0 else state[LOW, i]
    high = state[HIGH, i] if move > 0.0 else eigenvalue  # also where it is NaN: comparisons with it are false
    after = eigenvalue + move
    after = after if (low < after) & (after < high) else 0.5 * (low + high)
    found = (abs(move) <= PRECISION * eigenvalue) | (rss == 0.0)
    moves = (not found) & (low < after) & (after < high)
    # Where nothing is left between the bounds, only rounding moves it, or there is no such eigenvector.
    stays = eigenvalue if found | (abs(move) <= STEP_ROUNDING * eigenvalue) else math.nan
    state[ROOT, i], state[LOW, i], state[HIGH, i] = after if moves else stays, low, high
    state[MOVES, i] = 1.0 if moves else 0.0


@kernel()
def smallest_eigenvectors(moments, reference, count, solution, eigenvalue):
    """Smallest eigenvalue λ and α of the eigenvector (α, -1) of many tiles at a time.

    A tile that has converged stays where it is, so that its result does not depend on its neighbours.

    Parameters
    ----------
    moments, reference : (10, N) and (3, N) float64
        Of ``count`` tiles.
    solution : (3, N) float64
        On entry the explicit solution q = a·tanθx + b·tanθy + c, on return α.
    eigenvalue : (N,) float64
        The explicit solution's sum of squared residuals on entry, λ on return: NaN, and α meaningless, where
        the plane passes through the camera's centre or NaN came in.
    """
    # Of a fixed size, so that the compiler sees that rows are apart.
    state = np.empty((START_1 + 1, TOGETHER))
    for first in range(0, count, TOGETHER):
        last = min(first + TOGETHER, count)
        # One-dimensional, so that the compiler knows their strides.
        u0, v0, q0 = reference[0][first:last], reference[1][first:last], reference[2][first:last]
        n, s_u, s_v = moments[0][first:last], moments[1][first:last], moments[2][first:last]
        s_q, s_uu, s_uv = moments[3][first:last], moments[4][first:last], moments[5][first:last]
        s_uq, s_vv, s_vq = moments[6][first:last], moments[7][first:last], moments[8][first:last]
        alpha_u, alpha_v, alpha_1 = solution[0][first:last], solution[1][first:last], solution[2][first:last]
        roots = eigenvalue[first:last]
        for i in range(last - first):
            start(i, state, alpha_u, alpha_v, alpha_1, roots, n, s_u, s_v, s_uu, s_uv, s_vv, u0, v0)
        for _ in range(STEPS):
            moving = 0
            for i in range(last - first):
                step(i, state, n, s_u, s_v, s_q, s_uu, s_uv, s_uq, s_vv, s_vq, u0, v0, q0)
            for i in range(last - first):
                moving += 1 if state[MOVES, i] > 0.0 else 0
            if moving == 0:
                break
        for i in range(last - first):
            while state[MOVES, i] > 0.0:
                step(i, state, n, s_u, s_v, s_q, s_uu, s_uv, s_uq, s_vv, s_vq, u0, v0, q0)
        for i in range(last - first):
            a, b = state[ALPHA_U, i], state[ALPHA_V, i]
            roots[i] = state[ROOT, i]
            alpha_u[i], alpha_v[i], alpha_1[i] = a, b, state[ALPHA_1, i] - u0[i] * a - v0[i] * b
