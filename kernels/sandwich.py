"""Least squares where some pixels are noisier than others: the sandwich covariance (White 1980)."""

from ._jit import kernel


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
    b_uu = n * (w_uu - u * (w_u + b_u))
    b_uv = n * (w_uv - u * w_v - v * b_u)
    b_vv = n * (w_vv - v * (w_v + b_v))
    h_uu, h_uv = g_uu * b_uu + g_uv * b_uv, g_uu * b_uv + g_uv * b_vv
    h_vu, h_vv = g_uv * b_uu + g_vv * b_uv, g_uv * b_uv + g_vv * b_vv
    slopes = h_uu * g_uu + h_uv * g_uv, h_uu * g_uv + h_uv * g_vv, h_vu * g_uv + h_vv * g_vv
    return (g_uu, g_uv, g_vv), slopes, (g_uu * b_u + g_uv * b_v, g_uv * b_u + g_vv * b_v)
