"""Least squares where some pixels are noisier than others: the sandwich covariance (White 1980)."""

import math

from .._jit.kernel import kernel


@kernel(inline=True)
def sandwich(n, u, v, uu, uv, vv, weighted):
    """Covariances of a plane's slopes and mean inverse depth, in units of the mean variance of its pixels.

    A⁻¹BA⁻¹ with A = Σxᵢxᵢᵀ and B = Σtᵢxᵢxᵢᵀ of n pixels with variances tᵢ of mean 1, at x = (u - ū, v - v̄, 1).

    Parameters
    ----------
    n, u, v, uu, uv, vv : float
        Number of pixels, their mean ray (ū, v̄) and the scatter about it.
    weighted : tuple of 5 floats
        Means of u, v, u², uv and v², weighted by the variances.

    Returns
    -------
    inverse : tuple of 3 floats
        Inverse of the scatter: the slopes' variance along u, covariance, and variance along v, if all variances were
        alike.
    slopes : tuple of 3 floats
        The same three with the variances as they are.
    with_mean : tuple of 2 floats
        Covariances of the slopes with the mean.
    """
    w_u, w_v, w_uu, w_uv, w_vv = weighted
    scale = 1.0 / (uu * vv - uv * uv)
    g_uu, g_uv, g_vv = vv * scale, -uv * scale, uu * scale
    b_u, b_v = w_u - u, w_v - v
    m_u, m_v = g_uu * b_u + g_uv * b_v, g_uv * b_u + g_vv * b_v
    # B without what its means explain is LLᵀ. Of pixels nearly in a line A⁻¹ magnifies rounding errors: A⁻¹L times its
    # own transpose has no negative direction, whatever they are.
    l_uu = math.sqrt(n * max(w_uu - w_u * w_u, 0.0))
    l_uv = n * (w_uv - w_u * w_v) / max(l_uu, 1e-150)
    l_vv = math.sqrt(max(n * (w_vv - w_v * w_v) - l_uv * l_uv, 0.0))
    a_u, a_v = g_uu * l_uu + g_uv * l_uv, g_uv * l_vv
    b_u, b_v = g_uv * l_uu + g_vv * l_uv, g_vv * l_vv
    slopes = (
        a_u * a_u + a_v * a_v + n * m_u * m_u,
        a_u * b_u + a_v * b_v + n * m_u * m_v,
        b_u * b_u + b_v * b_v + n * m_v * m_v,
    )
    return (g_uu, g_uv, g_vv), slopes, (m_u, m_v)
