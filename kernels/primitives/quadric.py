"""Planes, spheres and cylinders in one form, and their inverse depth along rays.

A surface passes through X₀ = m₀ / q₀ on the ray m₀, where its unit normal n looks at the camera. With κ = 1/R, positive
where it is convex towards the camera, and P = I for a sphere, P = I - aaᵀ for a cylinder along the unit vector a:

    κ·|P(X - X₀)|² + 2 n·(X - X₀) = 0

κ = 0 is a plane, and nothing is singular about it, nor about a camera inside a sphere. Along a ray m, with X = m / q
and y = m - q·X₀, that is γq² - 2βq + α = 0. It is met from the side that n shows at q = (β + √(β² - γα)) / γ, where the
square root is -m times the unit normal: how steeply the ray meets the surface.
"""

import math

from .._jit.kernel import kernel
from ..statistics.noise_variances import FALLOFF, LATERAL_X, LATERAL_Y, rounding_at, variance_at

# A surface: q₀, κ, the unit vectors a, b and n, and the ray (u₀, v₀).
Q0, KAPPA, A, B, NORMAL, RAY = 0, 1, 2, 5, 8, 11
SURFACE = 13
# Kinds, and the parameters that each has of q₀, the turns of n towards a and b, κ, and the turn of a towards b.
PLANE, SPHERE, CYLINDER = range(3)
PARAMETERS = 5
# Pixels at a time; and the rows of what is worked out of them: derivatives by the parameters, and residuals.
BLOCK = 256
RESIDUAL = PARAMETERS
# A ray that grazes the surface counts as meeting it at least so steeply: derivatives stay finite.
LEAST_SLOPE = 1e-3


@kernel(inline=True)
def parameters_of(kind):
    """Number of parameters of a kind: 3, 4 or 5."""
    return 3 + kind


@kernel(inline=True)
def in_frame(surface):
    """X₀ along a, b and n."""
    z, u, v = 1.0 / surface[Q0], surface[RAY], surface[RAY + 1]
    x_a = z * (surface[A] * u + surface[A + 1] * v + surface[A + 2])
    x_b = z * (surface[B] * u + surface[B + 1] * v + surface[B + 2])
    x_n = z * (surface[NORMAL] * u + surface[NORMAL + 1] * v + surface[NORMAL + 2])
    return x_a, x_b, x_n


@kernel(inline=True)
def inverse_depth_at(kappa, f, place, m_a, m_b, m_n):
    """q along the ray m, and the root.

    Where the ray misses the surface the root is minus that of the negative discriminant: q goes on falling behind the
    outline as it does before it.

    Parameters
    ----------
    kappa, f : float
        κ, and 1 for a sphere, 0 for a cylinder.
    place : tuple of 3 floats
        `in_frame`.
    m_a, m_b, m_n : float
        The ray along a, b and n.
    """
    x_a, x_b, x_n = place
    beta = kappa * (f * m_a * x_a + m_b * x_b + m_n * x_n) - m_n
    gamma = kappa * (f * x_a * x_a + x_b * x_b + x_n * x_n) - 2.0 * x_n
    alpha = kappa * (f * m_a * m_a + m_b * m_b + m_n * m_n)
    square = beta * beta - gamma * alpha
    root = math.sqrt(abs(square))
    root = root if square >= 0.0 else -root
    # From inside of a surface that the camera is close to, γ is about 0 or negative.
    top, bottom = (beta + root, gamma) if beta >= 0.0 else (alpha, beta - root)
    return top / bottom, root


@kernel(reduction=True)
def evaluate(us, vs, qs, weights, begin, end, surface, f, work):
    """Write derivatives of q and residuals of pixels ``begin`` to ``end``, all divided by their standard deviations.

    Parameters
    ----------
    us, vs, qs, weights : (M,) float64
        tanθx, tanθy, q and 1/σ of each pixel.
    begin, end : int
        At most BLOCK pixels.
    surface : (SURFACE,) float64
    f : float
        1 for a sphere or plane, 0 for a cylinder.
    work : (PARAMETERS + 1, BLOCK) float64, written
        By the implicit function theorem, from F = κ·|Py|² + 2q·n·y.
    """
    q0, kappa = surface[Q0], surface[KAPPA]
    a_x, a_y, a_z = surface[A], surface[A + 1], surface[A + 2]
    b_x, b_y, b_z = surface[B], surface[B + 1], surface[B + 2]
    n_x, n_y, n_z = surface[NORMAL], surface[NORMAL + 1], surface[NORMAL + 2]
    place = in_frame(surface)
    x_a, x_b, x_n = place
    by_q, by_a, by_b, by_kappa, by_turn, left = work[0], work[1], work[2], work[3], work[4], work[5]
    for i in range(begin, end):
        u, v, k = us[i], vs[i], i - begin
        m_a, m_b, m_n = a_x * u + a_y * v + a_z, b_x * u + b_y * v + b_z, n_x * u + n_y * v + n_z
        q, root = inverse_depth_at(kappa, f, place, m_a, m_b, m_n)
        scale = weights[i] / max(abs(root), LEAST_SLOPE)
        s, t, z = m_a - q * x_a, m_b - q * x_b, m_n - q * x_n
        left[k] = (qs[i] - q) * weights[i]
        by_q[k] = -q / q0 * (kappa * (f * s * x_a + t * x_b + z * x_n) + q * x_n) * scale
        by_a[k] = -s * (kappa * (1.0 - f) * z + q) * scale
        by_b[k] = -q * t * scale
        by_kappa[k] = -0.5 * (f * s * s + t * t + z * z) * scale
        by_turn[k] = kappa * (1.0 - f) * s * t * scale


@kernel()
def weigh(us, vs, surface, f, noise, weights, shares):
    """Write 1/σ of pixels by a noise model at the surface, and the share of σ that neighbours may have in common.

    Parameters
    ----------
    us, vs : (M,) float64
    surface, f
        As for `evaluate`.
    noise : (8 or more,) float64
        Variances of the noise model: `noise_variances` says which entry is which.
    weights, shares : (M,) float64, written
        1/σ, and √(variance along the ray / σ²): the rest of the variance is rounding and errors across the ray.
    """
    kappa = surface[KAPPA]
    place = in_frame(surface)
    x_a, x_b, x_n = place
    falloff, lateral_x, lateral_y = noise[FALLOFF], noise[LATERAL_X], noise[LATERAL_Y]
    for i in range(len(us)):
        u, v = us[i], vs[i]
        m_a = surface[A] * u + surface[A + 1] * v + surface[A + 2]
        m_b = surface[B] * u + surface[B + 1] * v + surface[B + 2]
        m_n = surface[NORMAL] * u + surface[NORMAL + 1] * v + surface[NORMAL + 2]
        q, root = inverse_depth_at(kappa, f, place, m_a, m_b, m_n)
        q = max(q, 0.0)
        along, independent = variance_at(q, noise), rounding_at(q, noise)
        if falloff > 0.0:
            along *= (1.0 + u * u + v * v) ** falloff
        if lateral_x + lateral_y > 0.0:
            s, t, z = f * (m_a - q * x_a), m_b - q * x_b, m_n - q * x_n
            slope = 1.0 / max(abs(root), LEAST_SLOPE)
            q_u = slope * (kappa * (s * surface[A] + t * surface[B] + z * surface[NORMAL]) + q * surface[NORMAL])
            q_v = slope * (
                kappa * (s * surface[A + 1] + t * surface[B + 1] + z * surface[NORMAL + 1]) + q * surface[NORMAL + 1]
            )
            independent += lateral_x * q_u * q_u + lateral_y * q_v * q_v
        variance = along + independent
        weights[i], shares[i] = 1.0 / math.sqrt(variance), math.sqrt(along / variance)


@kernel()
def normalise(surface):
    """Make a, b and n unit vectors at right angles again: n keeps its direction, and b = n x a."""
    n = surface[NORMAL : NORMAL + 3]
    a = surface[A : A + 3]
    b = surface[B : B + 3]
    length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    for k in range(3):
        n[k] /= length
    along = a[0] * n[0] + a[1] * n[1] + a[2] * n[2]
    for k in range(3):
        a[k] -= along * n[k]
    length = math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    for k in range(3):
        a[k] /= length
    b[0] = n[1] * a[2] - n[2] * a[1]
    b[1] = n[2] * a[0] - n[0] * a[2]
    b[2] = n[0] * a[1] - n[1] * a[0]


@kernel()
def moved(surface, step, result):
    """Write the surface that is a step of the parameters away."""
    result[:] = surface
    result[Q0] += step[0]
    result[KAPPA] += step[3]
    for k in range(3):
        a, b, n = surface[A + k], surface[B + k], surface[NORMAL + k]
        result[NORMAL + k] = n + step[1] * a + step[2] * b
        result[A + k] = a - step[1] * n + step[4] * b
    normalise(result)
