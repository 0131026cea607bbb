"""Points, normals and curvatures of surfaces that are quadratic in inverse depth, in closed form.

With q(u, v) along the rays m = (u, v, 1), Z = 1/q and X = Z·m: qX = m is linear in (u, v), so the second derivatives
of X times the normal are -Z·d times those of q (d: the distance of the tangent plane). Curvatures are in 1/m, positive
where the surface is convex towards the camera; κ₁ >= κ₂.
"""

import math

from .._jit.kernel import kernel


@kernel(inline=True)
def tangent_distance(q, a, b, u, v):
    """Distance of the tangent plane from the camera's centre, from q and its slopes a, b at the ray (u, v)."""
    c = q - a * u - b * v
    return 1.0 / math.sqrt(a * a + b * b + c * c)


@kernel(inline=True)
def mean_curvature(q, a, b, r, s, t, u, v, d):
    """H = ½·tr(I⁻¹II), from q, its slopes a, b and its second derivatives r, s, t (uu, uv, vv) at the ray (u, v)."""
    square = u * u + v * v + 1.0
    p_u = q * q - 2.0 * q * u * a + square * a * a
    p_v = q * q - 2.0 * q * v * b + square * b * b
    p_m = square * a * b - q * (u * b + v * a)
    return -0.5 * d * d * d * q * (p_v * r - 2.0 * p_m * s + p_u * t)


@kernel(inline=True)
def gaussian_curvature(q, r, s, t, d):
    """K = det II / det I = (n·m)⁴·det Q, with n·m = -d·q."""
    square = d * d * q * q
    return square * square * (r * t - s * s)


@kernel(inline=True)
def principal_pair(mean, gaussian):
    """κ₁ and κ₂ from H and K; the smaller one from their product, which loses no digits."""
    root = math.sqrt(max(mean * mean - gaussian, 0.0))
    larger = mean + root if mean >= 0.0 else mean - root
    smaller = gaussian / larger if larger != 0.0 else 0.0
    return max(larger, smaller), min(larger, smaller)


@kernel(inline=True)
def first_form(q, a, b, u, v):
    """E, F, G: the first fundamental form in (u, v)."""
    z = 1.0 / q
    square, zz = z * z * (u * u + v * v + 1.0), z * z
    return (
        zz * (1.0 - 2.0 * z * u * a + square * a * a),
        zz * (square * a * b - z * (u * b + v * a)),
        zz * (1.0 - 2.0 * z * v * b + square * b * b),
    )


@kernel(inline=True)
def principal_steps(q, a, b, r, s, t, u, v, d, k_1):
    """Steps (u, v) along the principal directions of κ₁ and κ₂ that move a point by a unit length.

    Where both curvatures are the same, all directions are principal, and those along u and across it are given.
    """
    e, f, g = first_form(q, a, b, u, v)
    scale = -d / q
    uu, uv, vv = scale * r - k_1 * e, scale * s - k_1 * f, scale * t - k_1 * g
    # II - κ₁·I is singular: what it takes to 0 is across the larger of its rows.
    if uu * uu * g >= vv * vv * e:
        x, y = -uv, uu
    else:
        x, y = vv, -uv
    if not abs(x) + abs(y) > 0.0:
        x, y = 1.0, 0.0
    across_x, across_y = -(f * x + g * y), e * x + f * y
    length = 1.0 / math.sqrt(e * x * x + 2.0 * f * x * y + g * y * y)
    other = 1.0 / math.sqrt(e * across_x * across_x + 2.0 * f * across_x * across_y + g * across_y * across_y)
    return x * length, y * length, across_x * other, across_y * other


@kernel()
def surface_geometry(coefficients, centre, tiles, points, normals, curvatures, directions, means):
    """Geometry at the central rays of surfaces, NaN where there is none.

    Parameters
    ----------
    coefficients : (N, 6) float64
        β of (1, du, dv, du², du·dv, dv²), in 1/m.
    centre : (2, T) float64
        The rays (tanθx, tanθy) of the tiles of a frame.
    tiles : int
        T: surface i has ray i modulo T.
    points, normals : (N, 3) float64, written
        Metres, and unit vectors towards the camera.
    curvatures, directions : (N, 2) and (N, 2, 3) float64, written
        κ₁ and κ₂, and unit vectors along which they are; of each the sign with x >= 0.
    means : (N, 2) float64, written
        H and K.
    """
    for i in range(len(coefficients)):
        beta = coefficients[i]
        u, v = centre[0, i % tiles], centre[1, i % tiles]
        q, a, b, r, s, t = beta[0], beta[1], beta[2], 2.0 * beta[3], beta[4], 2.0 * beta[5]
        d = tangent_distance(q, a, b, u, v)
        z = 1.0 / q
        mean, gaussian = mean_curvature(q, a, b, r, s, t, u, v, d), gaussian_curvature(q, r, s, t, d)
        k_1, k_2 = principal_pair(mean, gaussian)
        points[i, 0], points[i, 1], points[i, 2] = z * u, z * v, z
        normals[i, 0], normals[i, 1], normals[i, 2] = -a * d, -b * d, -(q - a * u - b * v) * d
        curvatures[i, 0], curvatures[i, 1] = k_1 + 0.0 * q, k_2 + 0.0 * q
        means[i, 0], means[i, 1] = mean, gaussian
        x_1, y_1, x_2, y_2 = principal_steps(q, a, b, r, s, t, u, v, d, k_1)
        for k in range(2):
            x, y = (x_1, y_1) if k == 0 else (x_2, y_2)
            slope = z * z * (a * x + b * y)
            d_x, d_y, d_z = z * x - slope * u, z * y - slope * v, -slope
            sign = -1.0 if d_x < 0.0 else 1.0
            directions[i, k, 0], directions[i, k, 1], directions[i, k, 2] = sign * d_x, sign * d_y, sign * d_z
