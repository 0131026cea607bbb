"""Sums of plane fits in inverse depth that the paper cites, as they were written.

Tang, Lui and Li, "A lightweight approach to 6-DOF plane-based egomotion estimation using inverse depth", ACRA 2011:
a·X/Z + b·Y/Z + c = 1/Z over points (X, Y, Z). All eight sums depend on the frame, although X/Z and Y/Z are the
camera's. Erdogan, Paluri and Dellaert, "Planar segmentation of RGBD images using fast linear fitting and Markov chain
Monte Carlo", CRV 2012: measured disparity is linear in the pixel's column and row. So no depth is converted.
"""

from rgbd_planes.kernels._jit.kernel import kernel
from rgbd_planes.kernels.common.depth import depth


@kernel()
def tang_tables(frame, rays, standard, tables):
    """Summed-area tables of Tang, Lui and Li's normal equations.

    Parameters
    ----------
    frame : RawFrame
    rays : tan_x, tan_y, (H, W) float64 each
    standard
        Not used: tables of all forms are called in the same way.
    tables : (H + 1, W + 1, 8) float64, written
        Of u = X/Z, v = Y/Z and q = 1/Z: uu, uv, u, vv, v, uq, vq, q.
    """
    raw, lowest, highest, scale, offset, is_disparity = frame
    tan_x, tan_y = rays
    tables[0] = 0.0
    for row in range(raw.shape[0]):
        tables[row + 1, 0] = 0.0
        s_uu = s_uv = s_u = s_vv = s_v = s_uq = s_vq = s_q = 0.0
        for column in range(raw.shape[1]):
            value = raw[row, column]
            if lowest <= value <= highest:
                z = depth(value, scale, offset, is_disparity)
                x = tan_x[row, column] * z
                y = tan_y[row, column] * z
                u, v, q = x / z, y / z, 1.0 / z
                s_uu += u * u
                s_uv += u * v
                s_u += u
                s_vv += v * v
                s_v += v
                s_uq += u * q
                s_vq += v * q
                s_q += q
            tables[row + 1, column + 1, 0] = s_uu + tables[row, column + 1, 0]
            tables[row + 1, column + 1, 1] = s_uv + tables[row, column + 1, 1]
            tables[row + 1, column + 1, 2] = s_u + tables[row, column + 1, 2]
            tables[row + 1, column + 1, 3] = s_vv + tables[row, column + 1, 3]
            tables[row + 1, column + 1, 4] = s_v + tables[row, column + 1, 4]
            tables[row + 1, column + 1, 5] = s_uq + tables[row, column + 1, 5]
            tables[row + 1, column + 1, 6] = s_vq + tables[row, column + 1, 6]
            tables[row + 1, column + 1, 7] = s_q + tables[row, column + 1, 7]


@kernel()
def erdogan_tables(frame, pixels, standard, tables):
    """Summed-area tables of Erdogan, Paluri and Dellaert's normal equations; what pixels alone say is known.

    Parameters
    ----------
    frame : RawFrame
        Of disparities.
    pixels : column, row, (H, W) float64 each
        From any origin.
    standard
        Not used.
    tables : (H + 1, W + 1, 3) float64, written
        Of the disparity δ: column·δ, row·δ, δ.
    """
    raw, lowest, highest, _, _, _ = frame
    x, y = pixels
    tables[0] = 0.0
    for row in range(raw.shape[0]):
        tables[row + 1, 0] = 0.0
        s_x = s_y = s = 0.0
        for column in range(raw.shape[1]):
            value = raw[row, column]
            if lowest <= value <= highest:
                s_x += x[row, column] * value
                s_y += y[row, column] * value
                s += value
            tables[row + 1, column + 1, 0] = s_x + tables[row, column + 1, 0]
            tables[row + 1, column + 1, 1] = s_y + tables[row, column + 1, 1]
            tables[row + 1, column + 1, 2] = s + tables[row, column + 1, 2]


@kernel()
def prior_moments(frame, coordinates, is_tang, windows, moments):
    """The ten moments of windows from their pixels, as `window_moments` sums them, in either form.

    Parameters
    ----------
    frame : RawFrame
    coordinates : tan_x, tan_y, or column, row, (H, W) float64 each
        Of Tang, Lui and Li; of Erdogan, Paluri and Dellaert, from the principal point.
    is_tang : bool
    windows : (K, 4) int64
        Row, column, height and width.
    moments : (10, K) float64, written
    """
    raw, lowest, highest, scale, offset, is_disparity = frame
    first, second = coordinates
    for i in range(len(windows)):
        n = s_u = s_v = s_w = s_uu = s_uv = s_uw = s_vv = s_vw = s_ww = 0.0
        for row in range(windows[i, 0], windows[i, 0] + windows[i, 2]):
            for column in range(windows[i, 1], windows[i, 1] + windows[i, 3]):
                value = raw[row, column]
                if lowest <= value <= highest:
                    u, v = first[row, column], second[row, column]
                    if is_tang:
                        z = depth(value, scale, offset, is_disparity)
                        u, v, w = (u * z) / z, (v * z) / z, 1.0 / z
                    else:
                        w = 1.0 * value
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
        moments[0, i], moments[1, i], moments[2, i], moments[3, i] = n, s_u, s_v, s_w
        moments[4, i], moments[5, i], moments[6, i] = s_uu, s_uv, s_uw
        moments[7, i], moments[8, i], moments[9, i] = s_vv, s_vw, s_ww
