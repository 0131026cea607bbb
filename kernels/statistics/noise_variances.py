"""Variances by a noise model: at one inverse depth, and means of them over a part of the image."""

import math

import numpy as np

from .._jit.kernel import kernel

# What ``noise`` holds. For errors that are independent from pixel to pixel: variances across the ray in tanθx and
# tanθy, to be multiplied by the squared slopes of q, and those of rounding in depth and in disparity. One over the
# degrees of freedom of a variance that differs from place to place, 0 for one that does not. The exponent of
# 1 + tan²θx + tan²θy, by which the variance of q by other errors grows. Then a scale and this variance on the axis, at
# q = 0, 1/scale, 2/scale, ..., linear in between and beyond, or a single one for all q. Behind a table of them one of
# how they bend there: their second derivatives by q, times q² over the variance.
LATERAL_X, LATERAL_Y, DEPTH_STEP, DISPARITY_STEP, INVERSE_FREEDOM, FALLOFF, SCALE, VARIANCES = range(8)
# Three places of Gauss's quadrature along a side, in standard deviations of values spread evenly along it, and their
# weights.
PLACES = np.array([-(1.8**0.5), 0.0, 1.8**0.5])
WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0
# A side over which q changes more than LITTLE, in standard deviations relative to the mean, is taken in PIECES: the
# variance of q may have kinks.
LITTLE, PIECES = 0.2, 4


@kernel(inline=True)
def entries_in(noise):
    """Number of variances in the table of ``noise``."""
    return (noise.shape[0] - VARIANCES) // 2


@kernel(inline=True)
def variance_at(q, noise):
    """Variance of the errors along the ray at an inverse depth, on the axis."""
    if noise.shape[0] == VARIANCES + 1:
        return noise[VARIANCES]
    position = q * noise[SCALE]
    position = position if position > 0.0 else 0.0  # also for NaN
    whole = np.floor(min(position, entries_in(noise) - 2.0))
    k = VARIANCES + np.int64(whole)
    return noise[k] + (position - whole) * (noise[k + 1] - noise[k])


@kernel(inline=True)
def rounding_at(q, noise):
    """Variance of the rounding errors at an inverse depth."""
    square = q * q
    return noise[DEPTH_STEP] * square * square + noise[DISPARITY_STEP]


@kernel(inline=True)
def place_in(i, pieces):
    """The ``i``th place of a side in equal pieces, each with its own three places, and its weight."""
    piece, k = i // 3, i % 3
    return (math.sqrt(3.0) * (2 * piece + 1 - pieces) + PLACES[k]) / pieces, WEIGHTS[k] / pieces


@kernel(inline="compiled")
def means_over(plane, rays, noise):
    """Means of variances over a part of the image, as if its rays filled a parallelogram with their mean and scatter.

    Parameters
    ----------
    plane : tuple of 3 floats
        α.
    rays : tuple of 5 floats
        Means of u and v, their variances and covariance: uu, uv, vv; (u, v) = (tanθx, tanθy).

    Returns
    -------
    along, rounding, squares, u, v, uu, uv, vv : float
        Means of the variances of q along the ray, of those of rounding, of the squares of their total, and of their
        total times u, v, u², uv and v².
    """
    a, b, c = plane
    mean_u, mean_v, uu, uv, vv = rays
    side_u, side_v = math.sqrt(max(uu, 0.0)), math.sqrt(max(vv, 0.0))
    slant = min(max(uv / max(side_u, 1e-150), -side_v), side_v)  # of pixels in a column rounding may leave anything
    side_v = math.sqrt(max(vv - slant * slant, 0.0))
    # Changes of q along the sides, relative to its mean; of the growth by a falloff, about those of the ray itself.
    falloff, scale = noise[FALLOFF], 1.0 / max(a * mean_u + b * mean_v + c, 1e-150)
    change_u, change_v = scale * abs(a * side_u + b * slant), scale * abs(b * side_v)
    if falloff > 0.0:
        change_u, change_v = max(change_u, side_u), max(change_v, side_v)
    pieces_u, pieces_v = PIECES if change_u > LITTLE else 1, PIECES if change_v > LITTLE else 1
    m_along = m_rounding = squares = m_u = m_v = m_uu = m_uv = m_vv = 0.0
    for j in range(3 * pieces_u):
        place, weight_u = place_in(j, pieces_u)
        u, middle = mean_u + side_u * place, mean_v + slant * place
        for k in range(3 * pieces_v):
            place, weight = place_in(k, pieces_v)
            v, weight = middle + side_v * place, weight * weight_u
            q = max(a * u + b * v + c, 0.0)
            along, rounding = variance_at(q, noise), rounding_at(q, noise)
            if falloff > 0.0:
                along *= (1.0 + u * u + v * v) ** falloff
            total = along + rounding
            m_along += weight * along
            m_rounding += weight * rounding
            squares += weight * total * total
            total *= weight
            m_u += total * u
            m_v += total * v
            m_uu += total * u * u
            m_uv += total * u * v
            m_vv += total * v * v
    return m_along, m_rounding, squares, m_u, m_v, m_uu, m_uv, m_vv


@kernel()
def part_variances(alpha, rays, noise, means):
    """`means_over` N parts: ``alpha`` (N, 3), ``rays`` (N, 5) and ``means`` (N, 8), written."""
    for i in range(alpha.shape[0]):
        plane = alpha[i, 0], alpha[i, 1], alpha[i, 2]
        part = means_over(plane, (rays[i, 0], rays[i, 1], rays[i, 2], rays[i, 3], rays[i, 4]), noise)
        for k in range(8):
            means[i, k] = part[k]
