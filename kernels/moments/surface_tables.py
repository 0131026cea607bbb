"""Summed-area tables for surfaces of second order: explicit and implicit, in range space and in the standard form.

Explicitly a quadratic is fitted to one coordinate; its tables are the sums of the products that the normal equations
hold. Implicitly a quadric's coefficients are an eigenvector of the scatter of all its terms, and the tables are the
sums of all products of these. In range space, of q along rays (u, v, 1), products without q are the camera's: they are
no tables of the frame. In the standard form, of (X, Y, Z), all depend on the frame.
"""

import numpy as np

from .._jit.kernel import kernel
from ..common.depth import depth, inverse_depth
from .summed_area import value_row
from .surface_tiles import QQ, QU, QUU, QUV, QV, QVV, N, Q

# Channels of the tables of the explicit quadratic in range space: q, qu, qv, quu, quv, qvv and, for residuals, q².
RANGE_EXPLICIT, RANGE_EXPLICIT_RESIDUAL = 6, 7
# In the standard form: XⁱYʲ with 1 <= i + j <= 4, then ZXⁱYʲ with i + j <= 2.
STANDARD_EXPLICIT = 20


@kernel()
def range_surface_tables(frame, rays, reference, tables):
    """Tables of the explicit quadratic in range space.

    Parameters
    ----------
    frame : RawFrame
    rays : tan_x, tan_y, (H, W) float64 each
    reference : float
        Inverse depth that q is relative to, for residuals that lose no digits.
    tables : (H + 1, W + 1, RANGE_EXPLICIT or RANGE_EXPLICIT_RESIDUAL) float64, written
    """
    tan_x, tan_y = rays
    height, width = tan_x.shape
    squares = tables.shape[2] == RANGE_EXPLICIT_RESIDUAL
    line = np.empty(width)
    tables[0] = 0.0
    for row in range(height):
        value_row(frame, None, row, line)  # in a loop of its own: so the divisions vectorise
        above, below = tables[row], tables[row + 1]
        below[0] = 0.0
        u_row, v_row = tan_x[row], tan_y[row]
        s_q = s_qu = s_qv = s_quu = s_quv = s_qvv = s_qq = 0.0
        for column in range(width):
            q = line[column]
            q = q - reference if q != 0.0 else 0.0
            u, v = u_row[column], v_row[column]
            qu, qv = q * u, q * v
            s_q += q
            s_qu += qu
            s_qv += qv
            s_quu += qu * u
            s_quv += qu * v
            s_qvv += qv * v
            to = column + 1
            below[to, 0] = above[to, 0] + s_q
            below[to, 1] = above[to, 1] + s_qu
            below[to, 2] = above[to, 2] + s_qv
            below[to, 3] = above[to, 3] + s_quu
            below[to, 4] = above[to, 4] + s_quv
            below[to, 5] = above[to, 5] + s_qvv
            if squares:
                s_qq += q * q
                below[to, 6] = above[to, 6] + s_qq


@kernel()
def standard_surface_tables(frame, rays, tables):
    """Tables of the explicit quadratic Z(X, Y): arguments as in `range_surface_tables`.

    ``tables`` (H + 1, W + 1, STANDARD_EXPLICIT) are X, Y, XX, XY, YY, XXX, XXY, XYY, YYY, XXXX, XXXY, XXYY, XYYY, YYYY,
    Z, ZX, ZY, ZXX, ZXY and ZYY.
    """
    raw, lowest, highest, scale, offset, is_disparity = frame
    tan_x, tan_y = rays
    height, width = tan_x.shape
    tables[0] = 0.0
    for row in range(height):
        above, below = tables[row], tables[row + 1]
        below[0] = 0.0
        values, u_row, v_row = raw[row], tan_x[row], tan_y[row]
        s_x = s_y = s_xx = s_xy = s_yy = s_xxx = s_xxy = s_xyy = s_yyy = 0.0
        s_xxxx = s_xxxy = s_xxyy = s_xyyy = s_yyyy = s_z = s_zx = s_zy = s_zxx = s_zxy = s_zyy = 0.0
        for column in range(width):
            value = values[column]
            z = depth(value, scale, offset, is_disparity)
            z = z if lowest <= value <= highest else 0.0
            x, y = z * u_row[column], z * v_row[column]
            xx, xy, yy = x * x, x * y, y * y
            s_x += x
            s_y += y
            s_xx += xx
            s_xy += xy
            s_yy += yy
            s_xxx += xx * x
            s_xxy += xx * y
            s_xyy += x * yy
            s_yyy += yy * y
            s_xxxx += xx * xx
            s_xxxy += xx * xy
            s_xxyy += xx * yy
            s_xyyy += xy * yy
            s_yyyy += yy * yy
            s_z += z
            s_zx += z * x
            s_zy += z * y
            s_zxx += z * xx
            s_zxy += z * xy
            s_zyy += z * yy
            to = column + 1
            below[to, 0] = above[to, 0] + s_x
            below[to, 1] = above[to, 1] + s_y
            below[to, 2] = above[to, 2] + s_xx
            below[to, 3] = above[to, 3] + s_xy
            below[to, 4] = above[to, 4] + s_yy
            below[to, 5] = above[to, 5] + s_xxx
            below[to, 6] = above[to, 6] + s_xxy
            below[to, 7] = above[to, 7] + s_xyy
            below[to, 8] = above[to, 8] + s_yyy
            below[to, 9] = above[to, 9] + s_xxxx
            below[to, 10] = above[to, 10] + s_xxxy
            below[to, 11] = above[to, 11] + s_xxyy
            below[to, 12] = above[to, 12] + s_xyyy
            below[to, 13] = above[to, 13] + s_yyyy
            below[to, 14] = above[to, 14] + s_z
            below[to, 15] = above[to, 15] + s_zx
            below[to, 16] = above[to, 16] + s_zy
            below[to, 17] = above[to, 17] + s_zxx
            below[to, 18] = above[to, 18] + s_zxy
            below[to, 19] = above[to, 19] + s_zyy


@kernel(inline=True)
def corner_sum(tables, top, bottom, left, right, channel):
    """Sum of a channel over a rectangle."""
    return (
        tables[bottom, right, channel]
        - tables[top, right, channel]
        - tables[bottom, left, channel]
        + tables[top, left, channel]
    )


@kernel()
def missing_places(frame, before, columns):
    """List the columns of the missing pixels in the order of the pixels.

    Parameters
    ----------
    before : (H, W + 1) int32, written
        Number of missing pixels before a column of a row, those in all earlier rows included.
    columns : (missing,) int32, written
    """
    missing = 0
    for row in range(frame.raw.shape[0]):
        for column in range(frame.raw.shape[1]):
            before[row, column] = missing
            # Of a frame that is overwritten meanwhile, by a camera's driver, more may be missing than were counted.
            if not frame.lowest <= frame.raw[row, column] <= frame.highest and missing < len(columns):
                columns[missing] = column
                missing += 1
        before[row, frame.raw.shape[1]] = missing


@kernel(inline=True)
def add_ray(u, v, sign, moments, i):
    """Add the camera's 15 sums of a ray, times ``sign``."""
    uu, uv, vv = u * u, u * v, v * v
    moments[N, i] += sign
    moments[1, i] += sign * u
    moments[2, i] += sign * v
    moments[3, i] += sign * uu
    moments[4, i] += sign * uv
    moments[5, i] += sign * vv
    moments[6, i] += sign * uu * u
    moments[7, i] += sign * uu * v
    moments[8, i] += sign * uv * v
    moments[9, i] += sign * vv * v
    moments[10, i] += sign * uu * uu
    moments[11, i] += sign * uu * uv
    moments[12, i] += sign * uv * uv
    moments[13, i] += sign * uv * vv
    moments[14, i] += sign * vv * vv


@kernel()
def surface_window_pixels(frame, rays, windows, centre, reference, start, stop, moments):
    """Moments of windows ``start`` to ``stop`` from their pixels.

    Parameters
    ----------
    windows : (K, 4) int64
        Row, column, height and width.
    centre : (2, K) float64
        The rays that they are relative to.
    reference : float
        The inverse depth that sums of q are relative to.
    moments : (SURFACE_SUMS, K) float64, written
    """
    raw, lowest, highest, scale, offset, is_disparity = frame
    tan_x, tan_y = rays
    for i in range(start, stop):
        moments[:, i] = 0.0
        for row in range(windows[i, 0], windows[i, 0] + windows[i, 2]):
            for column in range(windows[i, 1], windows[i, 1] + windows[i, 3]):
                value = raw[row, column]
                if lowest <= value <= highest:
                    u, v = tan_x[row, column] - centre[0, i], tan_y[row, column] - centre[1, i]
                    q = inverse_depth(value, scale, offset, is_disparity) - reference
                    add_ray(u, v, 1.0, moments, i)
                    moments[Q, i] += q
                    moments[QU, i] += q * u
                    moments[QV, i] += q * v
                    moments[QUU, i] += q * u * u
                    moments[QUV, i] += q * u * v
                    moments[QVV, i] += q * v * v
                    moments[QQ, i] += q * q


@kernel()
def surface_window_tables(tables, missing, rays, windows, centre, start, stop, moments):
    """Moments of windows from the tables of `range_surface_tables`; the rest as in `surface_window_pixels`.

    The camera's sums are taken over rows and columns of rays where these separate, or else over the window's rays:
    fourth powers of a distance from the image's centre would leave no digits for a small window. ``missing`` are what
    `missing_places` writes, before and columns, empty for a frame without holes.
    """
    before, columns = missing
    tan_x, tan_y = rays
    is_separable = tan_x.strides[0] == 0 and tan_y.strides[1] == 0
    by_u, by_v = np.empty(5), np.empty(5)
    for i in range(start, stop):
        top, left = windows[i, 0], windows[i, 1]
        bottom, right = top + windows[i, 2], left + windows[i, 3]
        u_0, v_0 = centre[0, i], centre[1, i]
        moments[:, i] = 0.0
        if is_separable:
            by_u[:] = 0.0
            by_v[:] = 0.0
            for column in range(left, right):
                power = 1.0
                for k in range(5):
                    by_u[k] += power
                    power *= tan_x[0, column] - u_0
            for row in range(top, bottom):
                power = 1.0
                for k in range(5):
                    by_v[k] += power
                    power *= tan_y[row, 0] - v_0
            entry = 0
            for order in range(5):
                for j in range(order + 1):
                    moments[entry, i] = by_u[order - j] * by_v[j]
                    entry += 1
        else:
            for row in range(top, bottom):
                for column in range(left, right):
                    add_ray(tan_x[row, column] - u_0, tan_y[row, column] - v_0, 1.0, moments, i)
        if len(before):
            for row in range(top, bottom):
                for k in range(before[row, left], before[row, right]):
                    add_ray(tan_x[row, columns[k]] - u_0, tan_y[row, columns[k]] - v_0, -1.0, moments, i)
        q = corner_sum(tables, top, bottom, left, right, 0)
        q_u, q_v = corner_sum(tables, top, bottom, left, right, 1), corner_sum(tables, top, bottom, left, right, 2)
        moments[Q, i] = q
        moments[QU, i] = q_u - u_0 * q
        moments[QV, i] = q_v - v_0 * q
        moments[QUU, i] = corner_sum(tables, top, bottom, left, right, 3) - u_0 * (2.0 * q_u - u_0 * q)
        moments[QUV, i] = corner_sum(tables, top, bottom, left, right, 4) - u_0 * q_v - v_0 * q_u + u_0 * v_0 * q
        moments[QVV, i] = corner_sum(tables, top, bottom, left, right, 5) - v_0 * (2.0 * q_v - v_0 * q)
        moments[QQ, i] = corner_sum(tables, top, bottom, left, right, 6)


@kernel()
def merge_surfaces(moments, centre, reference, labels, to_centre, to_reference, merged):
    """Add up moments of parts by label, moved to the central ray and the reference of their union.

    Parameters
    ----------
    moments, centre, reference : (SURFACE_SUMS, T), (2, T) and (T,) float64
    labels : (T,) int32
        0 for none, or 1 to M.
    to_centre, to_reference, merged : (2, M), (M,) and (SURFACE_SUMS, M) float64
        The last is added to.
    """
    by_power = np.empty(15)
    for part in range(len(labels)):
        into = labels[part] - 1
        if into < 0 or not moments[N, part] > 0.0:
            continue
        x, y = centre[0, part] - to_centre[0, into], centre[1, part] - to_centre[1, into]
        # (u + x)ⁱ(v + y)ʲ by the binomial theorem.
        for order in range(5):
            for j in range(order + 1):
                i = order - j
                total = 0.0
                for a in range(i + 1):
                    for b in range(j + 1):
                        # C(i, a)·C(j, b)·uᵃvᵇ·xⁱ⁻ᵃyʲ⁻ᵇ
                        factor = 1.0
                        for k in range(a):
                            factor *= (i - k) / (k + 1.0)
                        for k in range(b):
                            factor *= (j - k) / (k + 1.0)
                        together = a + b
                        total += (
                            factor * moments[together * (together + 1) // 2 + b, part] * x ** (i - a) * y ** (j - b)
                        )
                by_power[order * (order + 1) // 2 + j] = total
        for k in range(15):
            merged[k, into] += by_power[k]
        shift = reference[part] - to_reference[into]
        q, q_u, q_v = moments[Q, part], moments[QU, part], moments[QV, part]
        merged[Q, into] += q + shift * by_power[0]
        merged[QU, into] += q_u + x * q + shift * by_power[1]
        merged[QV, into] += q_v + y * q + shift * by_power[2]
        merged[QUU, into] += moments[QUU, part] + x * (2.0 * q_u + x * q) + shift * by_power[3]
        merged[QUV, into] += moments[QUV, part] + x * q_v + y * q_u + x * y * q + shift * by_power[4]
        merged[QVV, into] += moments[QVV, part] + y * (2.0 * q_v + y * q) + shift * by_power[5]
        merged[QQ, into] += moments[QQ, part] + shift * (2.0 * q + shift * moments[N, part])
