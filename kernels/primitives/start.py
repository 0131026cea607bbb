"""Where the search for a surface begins: at the explicit quadratic of its pixels, which is linear."""

import math

import numpy as np

from .._jit.kernel import kernel
from ..solvers.cholesky import factorise, solve
from ..solvers.curvatures import gaussian_curvature, mean_curvature, principal_pair, principal_steps, tangent_distance
from .quadric import KAPPA, NORMAL, Q0, RAY, A, normalise

TERMS = 6


@kernel()
def central_ray(us, vs, surface):
    """Make the mean ray of some pixels that of a surface; returns their root mean square distance from it."""
    count = len(us)
    u = v = 0.0
    for i in range(count):
        u += us[i]
        v += vs[i]
    u, v = u / count, v / count
    square = 0.0
    for i in range(count):
        square += (us[i] - u) ** 2 + (vs[i] - v) ** 2
    surface[RAY], surface[RAY + 1] = u, v
    return math.sqrt(square / count)


@kernel()
def fit_quadratic(pixels, weights, surface, scale, terms, beta):
    """Least squares of q on (1, du, dv, du², du·dv, dv²) about the surface's ray.

    Parameters
    ----------
    pixels : us, vs, qs, (M,) float64 each
    weights : (M,) float64
    surface : (SURFACE,) float64
    scale : float
        Of du and dv, so that the normal equations are well conditioned.
    terms : int
        6, or 3 for a plane.
    beta : (TERMS,) float64, written

    Returns
    -------
    is_determined : bool
    """
    us, vs, qs = pixels
    u0, v0 = surface[RAY], surface[RAY + 1]
    phi, right, scaled = np.empty(TERMS), np.zeros(TERMS), np.zeros(TERMS)
    normal, lower = np.zeros((TERMS, TERMS)), np.zeros((TERMS, TERMS))
    for i in range(len(us)):
        u, v, w = (us[i] - u0) / scale, (vs[i] - v0) / scale, weights[i] * weights[i]
        phi[0], phi[1], phi[2], phi[3], phi[4], phi[5] = 1.0, u, v, u * u, u * v, v * v
        for j in range(terms):
            right[j] += w * phi[j] * qs[i]
            for k in range(j + 1):
                normal[j, k] += w * phi[j] * phi[k]
    beta[:] = 0.0
    if not factorise(normal, terms, 0.0, lower):
        return False
    solve(lower, terms, right, scaled)
    for j in range(terms):
        beta[j] = scaled[j] / (scale if 0 < j < 3 else scale * scale if j >= 3 else 1.0)
    return True


@kernel()
def write_start(beta, surface):
    """Write the tangent plane of a quadratic, and a along its direction of least curvature; returns κ₁ and κ₂.

    κ is 0. Of the two curvatures the first is that across a.
    """
    u, v = surface[RAY], surface[RAY + 1]
    q, slope_u, slope_v, r, s, t = beta[0], beta[1], beta[2], 2.0 * beta[3], beta[4], 2.0 * beta[5]
    d = tangent_distance(q, slope_u, slope_v, u, v)
    mean = mean_curvature(q, slope_u, slope_v, r, s, t, u, v, d)
    first, second = principal_pair(mean, gaussian_curvature(q, r, s, t, d))
    x_1, y_1, x_2, y_2 = principal_steps(q, slope_u, slope_v, r, s, t, u, v, d, first)
    larger, least, x, y = (first, second, x_2, y_2) if abs(first) >= abs(second) else (second, first, x_1, y_1)
    z = 1.0 / q
    along = z * z * (slope_u * x + slope_v * y)
    surface[Q0], surface[KAPPA] = q, 0.0
    surface[NORMAL], surface[NORMAL + 1] = -slope_u * d, -slope_v * d
    surface[NORMAL + 2] = -(q - slope_u * u - slope_v * v) * d
    surface[A], surface[A + 1], surface[A + 2] = z * x - along * u, z * y - along * v, -along
    normalise(surface)
    return larger, least
