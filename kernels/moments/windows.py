"""Moments of rectangles from their pixels, one rectangle after the other: the ``naive`` implementation.

This is the paper's naive version, MᵗM summed over the window, and the result that the fast ones must equal.
"""

from .._jit.kernel import kernel
from ..common.depth import depth, inverse_depth


@kernel()
def window_moments(frame, rays, standard, windows, full, start, stop, moments):
    """Moments of windows ``start`` to ``stop``, about the origin.

    Parameters
    ----------
    frame : RawFrame
    rays : tan_x, tan_y, (H, W) float64 each
    standard : True or None
        Sums of (X, Y, Z), of eq. 6, or with None of (tanθx, tanθy, q), of eq. 14.
    windows : (K, 4) int64
        Row, column, height and width.
    full
        Not used: `summed_area`, which is called in the same way, takes camera terms. This version knows nothing
        beforehand.
    moments : (10, K) float64, written
    """
    raw, lowest, highest, scale, offset, is_disparity = frame
    tan_x, tan_y = rays
    for i in range(start, stop):
        n = s_u = s_v = s_w = s_uu = s_uv = s_uw = s_vv = s_vw = s_ww = 0.0
        for row in range(windows[i, 0], windows[i, 0] + windows[i, 2]):
            for column in range(windows[i, 1], windows[i, 1] + windows[i, 3]):
                value = raw[row, column]
                if lowest <= value <= highest:
                    u = tan_x[row, column]
                    v = tan_y[row, column]
                    if standard is None:
                        w = inverse_depth(value, scale, offset, is_disparity)
                    else:
                        w = depth(value, scale, offset, is_disparity)
                        u *= w
                        v *= w
                    n += 1.0
                    s_u += u
                    s_v += v
                    s_w += w
                    s_uu += u * u
                    s_uv += u * v
                    s_uw += u * w
                    s_vv += v * v
                    s_vw += v * w
                    s_ww += w * w
        moments[0, i] = n
        moments[1, i] = s_u
        moments[2, i] = s_v
        moments[3, i] = s_w
        moments[4, i] = s_uu
        moments[5, i] = s_uv
        moments[6, i] = s_uw
        moments[7, i] = s_vv
        moments[8, i] = s_vw
        moments[9, i] = s_ww
