"""Moments of rectangles from their pixels, one rectangle after the other: the ``naive`` implementation.

This is the paper's naive version, MᵗM summed over the window, and the result that the fast ones must equal.
"""

from .._jit.kernel import kernel
from ..common.depth import depth, inverse_depth


@kernel()
def write_moments(n, u, v, w, uu, uv, uw, vv, vw, ww, i, moments):
    """Write the ten moments of window i."""
    moments[0, i] = n
    moments[1, i] = u
    moments[2, i] = v
    moments[3, i] = w
    moments[4, i] = uu
    moments[5, i] = uv
    moments[6, i] = uw
    moments[7, i] = vv
    moments[8, i] = vw
    moments[9, i] = ww


@kernel()
def range_window_moments(
    raw, lowest, highest, scale, offset, is_disparity, tan_x, tan_y, windows, full, start, stop, moments
):
    """Range-space moments, about the origin, of windows ``start`` to ``stop``.

    The sums of eq. 14. ``full``, which `summed_area` has too, is not used: this version knows nothing beforehand.
    """
    for i in range(start, stop):
        n = s_x = s_y = s_q = s_xx = s_xy = s_xq = s_yy = s_yq = s_qq = 0.0
        for row in range(windows[i, 0], windows[i, 0] + windows[i, 2]):
            for column in range(windows[i, 1], windows[i, 1] + windows[i, 3]):
                value = raw[row, column]
                if lowest <= value <= highest:
                    q = inverse_depth(value, scale, offset, is_disparity)
                    x = tan_x[row, column]
                    y = tan_y[row, column]
                    n += 1.0
                    s_x += x
                    s_y += y
                    s_q += q
                    s_xx += x * x
                    s_xy += x * y
                    s_xq += x * q
                    s_yy += y * y
                    s_yq += y * q
                    s_qq += q * q
        write_moments(n, s_x, s_y, s_q, s_xx, s_xy, s_xq, s_yy, s_yq, s_qq, i, moments)


@kernel()
def standard_window_moments(
    raw, lowest, highest, scale, offset, is_disparity, tan_x, tan_y, windows, full, start, stop, moments
):
    """Moments of (X, Y, Z), about the origin, of windows ``start`` to ``stop``.

    The sums of eq. 6. ``full`` is not used here either.
    """
    for i in range(start, stop):
        n = s_x = s_y = s_z = s_xx = s_xy = s_xz = s_yy = s_yz = s_zz = 0.0
        for row in range(windows[i, 0], windows[i, 0] + windows[i, 2]):
            for column in range(windows[i, 1], windows[i, 1] + windows[i, 3]):
                value = raw[row, column]
                if lowest <= value <= highest:
                    z = depth(value, scale, offset, is_disparity)
                    x = z * tan_x[row, column]
                    y = z * tan_y[row, column]
                    n += 1.0
                    s_x += x
                    s_y += y
                    s_z += z
                    s_xx += x * x
                    s_xy += x * y
                    s_xz += x * z
                    s_yy += y * y
                    s_yz += y * z
                    s_zz += z * z
        write_moments(n, s_x, s_y, s_z, s_xx, s_xy, s_xz, s_yy, s_yz, s_zz, i, moments)
