"""Moments of every tile of a grid in one pass over the frame: the ``direct`` implementation.

A pixel is a triple (u, v, w): (tanθx, tanθy, q) with q = 1/Z in range space, (X, Y, Z) in the standard
one. A tile's moments are the ten sums [n, Σu, Σv, Σw, Σuu, Σuv, Σuw, Σvv, Σvw, Σww] over its valid pixels,
of coordinates taken relative to a reference point of the tile, so that nothing cancels later.

Rows are added to one accumulator per image column, and columns are folded into tiles after the tile's
last row. So the inner loop runs along the image row, vectorises without tails at tile borders, and for a
camera without lens distortion, where tanθx depends on the column alone and tanθy on the row alone,
multiplies by tanθx once per column instead of once per pixel. Two rows are read at a time because the
accumulators' loads and stores would otherwise cost more than the arithmetic.
"""

import numpy as np

from ._jit import kernel
from .depth import depth, inverse_depth

# Columns handled at a time: their accumulators stay in the first-level cache.
COLUMNS = 256


@kernel()
def first_valid(raw, row_start, row_stop, column_start, column_stop, lowest, highest):
    """Return a valid raw value of the tile, its centre's if that is valid, or 0 if there is none."""
    value = raw[(row_start + row_stop) // 2, (column_start + column_stop) // 2]
    if lowest <= value <= highest:
        return value
    for row in range(row_start, row_stop):
        for column in range(column_start, column_stop):
            value = raw[row, column]
            if lowest <= value <= highest:
                return value
    return raw.dtype.type(0)


@kernel(reduction=True)
def range_moments_separable(
    raw, lowest, highest, scale, offset, is_disparity, tan_x, tan_y,
    tile_height, tile_width, full, tile_row_start, tile_row_stop, reference, moments,
):  # fmt: skip
    """Range-space moments of the tiles in some tile rows, for a camera without lens distortion.

    The entries that hold camera terms only are those of the full tile, ``full``, less the sums over the
    missing pixels: A_valid = A_full - Σ_missing m mᵀ. Only Σq, Σq·tanθx, Σq·tanθy and Σq² come from the
    frame (the paper's eq. tan_theta_scattermatrix).

    Parameters
    ----------
    raw : (H, W) array
        The frame; a pixel is valid if ``lowest <= raw <= highest``.
    scale, offset, is_disparity
        q = scale / raw, or scale * raw + offset if ``is_disparity``.
    tan_x, tan_y : (W,) and (H,) float64
    full : (6, R, C) float64
        n, Σu, Σv, Σuu, Σuv, Σvv of the full tile about ``reference``.
    reference : (3, R, C) float64
        Reference point; the third row, the inverse depth, is written here.
    moments : (10, R, C) float64, written
    """
    height, width = raw.shape
    tile_columns = moments.shape[2]
    tiles_at_once = max(1, COLUMNS // tile_width)
    sums = np.empty((6, max(COLUMNS, tile_width)))
    sum_q, sum_qv, sum_qq, lost, lost_v, lost_vv = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
    reference_q = np.empty(max(COLUMNS, tile_width))

    for tile_row in range(tile_row_start, tile_row_stop):
        row_start = tile_row * tile_height
        row_stop = min(row_start + tile_height, height)
        v0 = reference[1, tile_row, 0]
        for first_tile in range(0, tile_columns, tiles_at_once):
            last_tile = min(first_tile + tiles_at_once, tile_columns)
            left = first_tile * tile_width
            right = min(last_tile * tile_width, width)

            for tile in range(first_tile, last_tile):
                column_start = tile * tile_width
                column_stop = min(column_start + tile_width, width)
                value = first_valid(raw, row_start, row_stop, column_start, column_stop, lowest, highest)
                q0 = inverse_depth(value, scale, offset, is_disparity)
                reference[2, tile_row, tile] = q0
                reference_q[column_start - left : column_stop - left] = q0

            sums[:, : right - left] = 0.0
            for row in range(row_start, row_stop, 2):
                # An odd last row is paired with itself, at weight zero.
                second = 1.0 if row + 1 < row_stop else 0.0
                a = raw[row, left:right]
                b = raw[min(row + 1, row_stop - 1), left:right]
                va = tan_y[row] - v0
                vb = tan_y[min(row + 1, row_stop - 1)] - v0
                vva = va * va
                vvb = vb * vb
                for column in range(right - left):
                    valid_a = (a[column] >= lowest) & (a[column] <= highest)
                    valid_b = (b[column] >= lowest) & (b[column] <= highest)
                    if is_disparity:
                        qa = scale * a[column] + offset
                        qb = scale * b[column] + offset
                    else:
                        qa = scale / a[column]
                        qb = scale / b[column]
                    qa = qa - reference_q[column] if valid_a else 0.0
                    qb = (qb - reference_q[column]) * second if valid_b else 0.0
                    lost_a = 0.0 if valid_a else 1.0
                    lost_b = 0.0 if valid_b else second
                    sum_q[column] += qa + qb
                    sum_qv[column] += qa * va + qb * vb
                    sum_qq[column] += qa * qa + qb * qb
                    lost[column] += lost_a + lost_b
                    lost_v[column] += lost_a * va + lost_b * vb
                    lost_vv[column] += lost_a * vva + lost_b * vvb

            for tile in range(first_tile, last_tile):
                column_start = tile * tile_width
                column_stop = min(column_start + tile_width, width)
                u0 = reference[0, tile_row, tile]
                s_q = s_qu = s_qv = s_qq = 0.0
                l_1 = l_u = l_v = l_uu = l_uv = l_vv = 0.0
                for column in range(column_start, column_stop):
                    u = tan_x[column] - u0
                    i = column - left
                    s_q += sum_q[i]
                    s_qu += sum_q[i] * u
                    s_qv += sum_qv[i]
                    s_qq += sum_qq[i]
                    l_1 += lost[i]
                    l_u += lost[i] * u
                    l_v += lost_v[i]
                    l_uu += lost[i] * (u * u)
                    l_uv += lost_v[i] * u
                    l_vv += lost_vv[i]
                moments[0, tile_row, tile] = full[0, tile_row, tile] - l_1
                moments[1, tile_row, tile] = full[1, tile_row, tile] - l_u
                moments[2, tile_row, tile] = full[2, tile_row, tile] - l_v
                moments[3, tile_row, tile] = s_q
                moments[4, tile_row, tile] = full[3, tile_row, tile] - l_uu
                moments[5, tile_row, tile] = full[4, tile_row, tile] - l_uv
                moments[6, tile_row, tile] = s_qu
                moments[7, tile_row, tile] = full[5, tile_row, tile] - l_vv
                moments[8, tile_row, tile] = s_qv
                moments[9, tile_row, tile] = s_qq


@kernel(reduction=True)
def range_moments(
    raw, lowest, highest, scale, offset, is_disparity, tan_x, tan_y,
    tile_height, tile_width, full, tile_row_start, tile_row_stop, reference, moments,
):  # fmt: skip
    """Range-space moments as in `range_moments_separable`, for any camera: tan_x, tan_y are (H, W)."""
    height, width = raw.shape
    tile_columns = moments.shape[2]
    tiles_at_once = max(1, COLUMNS // tile_width)
    sums = np.empty((10, max(COLUMNS, tile_width)))
    sum_q, sum_qu, sum_qv, sum_qq = sums[0], sums[1], sums[2], sums[3]
    lost, lost_u, lost_v, lost_uu, lost_uv, lost_vv = sums[4], sums[5], sums[6], sums[7], sums[8], sums[9]
    references = np.empty((3, max(COLUMNS, tile_width)))
    reference_u, reference_v, reference_q = references[0], references[1], references[2]

    for tile_row in range(tile_row_start, tile_row_stop):
        row_start = tile_row * tile_height
        row_stop = min(row_start + tile_height, height)
        for first_tile in range(0, tile_columns, tiles_at_once):
            last_tile = min(first_tile + tiles_at_once, tile_columns)
            left = first_tile * tile_width
            right = min(last_tile * tile_width, width)

            for tile in range(first_tile, last_tile):
                column_start = tile * tile_width
                column_stop = min(column_start + tile_width, width)
                value = first_valid(raw, row_start, row_stop, column_start, column_stop, lowest, highest)
                q0 = inverse_depth(value, scale, offset, is_disparity)
                reference[2, tile_row, tile] = q0
                reference_u[column_start - left : column_stop - left] = reference[0, tile_row, tile]
                reference_v[column_start - left : column_stop - left] = reference[1, tile_row, tile]
                reference_q[column_start - left : column_stop - left] = q0

            sums[:, : right - left] = 0.0
            for row in range(row_start, row_stop):
                values = raw[row, left:right]
                tan_x_row = tan_x[row, left:right]
                tan_y_row = tan_y[row, left:right]
                for column in range(right - left):
                    valid = (values[column] >= lowest) & (values[column] <= highest)
                    if is_disparity:
                        q = scale * values[column] + offset
                    else:
                        q = scale / values[column]
                    q = q - reference_q[column] if valid else 0.0
                    missing = 0.0 if valid else 1.0
                    u = tan_x_row[column] - reference_u[column]
                    v = tan_y_row[column] - reference_v[column]
                    sum_q[column] += q
                    sum_qu[column] += q * u
                    sum_qv[column] += q * v
                    sum_qq[column] += q * q
                    lost[column] += missing
                    lost_u[column] += missing * u
                    lost_v[column] += missing * v
                    lost_uu[column] += missing * u * u
                    lost_uv[column] += missing * u * v
                    lost_vv[column] += missing * v * v

            for tile in range(first_tile, last_tile):
                i = tile * tile_width - left
                j = min((tile + 1) * tile_width, width) - left
                moments[0, tile_row, tile] = full[0, tile_row, tile] - lost[i:j].sum()
                moments[1, tile_row, tile] = full[1, tile_row, tile] - lost_u[i:j].sum()
                moments[2, tile_row, tile] = full[2, tile_row, tile] - lost_v[i:j].sum()
                moments[3, tile_row, tile] = sum_q[i:j].sum()
                moments[4, tile_row, tile] = full[3, tile_row, tile] - lost_uu[i:j].sum()
                moments[5, tile_row, tile] = full[4, tile_row, tile] - lost_uv[i:j].sum()
                moments[6, tile_row, tile] = sum_qu[i:j].sum()
                moments[7, tile_row, tile] = full[5, tile_row, tile] - lost_vv[i:j].sum()
                moments[8, tile_row, tile] = sum_qv[i:j].sum()
                moments[9, tile_row, tile] = sum_qq[i:j].sum()


@kernel(reduction=True)
def standard_moments_separable(
    raw, lowest, highest, scale, offset, is_disparity, tan_x, tan_y,
    tile_height, tile_width, tile_row_start, tile_row_stop, reference, moments,
):  # fmt: skip
    """Moments of (X, Y, Z) of the tiles in some tile rows, for a camera without lens distortion.

    Every entry depends on the frame (the paper's eq. XYZ_scattermatrix). With z = Z - Z0, u = tanθx - u0
    and v = tanθy - v0, a point relative to the reference Z0·(u0, v0, 1) is

        X = z·tanθx + Z0·u,    Y = z·tanθy + Z0·v,    Z = z,

    so eight sums down a column give the ten of X, Y and Z, whatever the column's tanθx.

    Parameters
    ----------
    raw, lowest, highest, scale, offset, is_disparity, tan_x, tan_y, moments
        As in `range_moments_separable`; depth is Z = raw / scale, or 1 / (scale * raw + offset).
    reference : (3, R, C) float64
        u0 and v0 of the tile on entry in the first two rows, X0, Y0, Z0 on return.
    """
    height, width = raw.shape
    tile_columns = moments.shape[2]
    tiles_at_once = max(1, COLUMNS // tile_width)
    sums = np.empty((8, max(COLUMNS, tile_width)))
    sum_1, sum_v, sum_vv, sum_z = sums[0], sums[1], sums[2], sums[3]
    sum_zv, sum_zz, sum_zzv, sum_zzvv = sums[4], sums[5], sums[6], sums[7]
    sum_zvv = np.empty(max(COLUMNS, tile_width))
    reference_z = np.empty(max(COLUMNS, tile_width))
    metres = 1.0 / scale

    for tile_row in range(tile_row_start, tile_row_stop):
        row_start = tile_row * tile_height
        row_stop = min(row_start + tile_height, height)
        v0 = reference[1, tile_row, 0]
        for first_tile in range(0, tile_columns, tiles_at_once):
            last_tile = min(first_tile + tiles_at_once, tile_columns)
            left = first_tile * tile_width
            right = min(last_tile * tile_width, width)

            for tile in range(first_tile, last_tile):
                column_start = tile * tile_width
                column_stop = min(column_start + tile_width, width)
                value = first_valid(raw, row_start, row_stop, column_start, column_stop, lowest, highest)
                z0 = depth(value, scale, offset, is_disparity)
                reference[2, tile_row, tile] = z0
                reference_z[column_start - left : column_stop - left] = z0

            sums[:, : right - left] = 0.0
            sum_zvv[: right - left] = 0.0
            for row in range(row_start, row_stop, 2):
                # An odd last row is paired with itself, at weight zero.
                second = 1.0 if row + 1 < row_stop else 0.0
                a = raw[row, left:right]
                b = raw[min(row + 1, row_stop - 1), left:right]
                va = tan_y[row] - v0
                vb = tan_y[min(row + 1, row_stop - 1)] - v0
                vva = va * va
                vvb = vb * vb
                for column in range(right - left):
                    valid_a = (a[column] >= lowest) & (a[column] <= highest)
                    valid_b = (b[column] >= lowest) & (b[column] <= highest)
                    if is_disparity:
                        za = 1.0 / (scale * a[column] + offset)
                        zb = 1.0 / (scale * b[column] + offset)
                    else:
                        za = metres * a[column]
                        zb = metres * b[column]
                    za = za - reference_z[column] if valid_a else 0.0
                    zb = (zb - reference_z[column]) * second if valid_b else 0.0
                    one_a = 1.0 if valid_a else 0.0
                    one_b = second if valid_b else 0.0
                    zza = za * za
                    zzb = zb * zb
                    sum_1[column] += one_a + one_b
                    sum_v[column] += one_a * va + one_b * vb
                    sum_vv[column] += one_a * vva + one_b * vvb
                    sum_z[column] += za + zb
                    sum_zv[column] += za * va + zb * vb
                    sum_zvv[column] += za * vva + zb * vvb
                    sum_zz[column] += zza + zzb
                    sum_zzv[column] += zza * va + zzb * vb
                    sum_zzvv[column] += zza * vva + zzb * vvb

            for tile in range(first_tile, last_tile):
                u0 = reference[0, tile_row, tile]
                z0 = reference[2, tile_row, tile]
                n = s_x = s_y = s_z = s_xx = s_xy = s_xz = s_yy = s_yz = s_zz = 0.0
                for column in range(tile * tile_width, min((tile + 1) * tile_width, width)):
                    i = column - left
                    t = tan_x[column]
                    p = z0 * (t - u0)  # X = z·t + p
                    # Sums of Y = z·(v0 + v) + z0·v, of zY and of YY, in this column.
                    c_y = v0 * sum_z[i] + sum_zv[i] + z0 * sum_v[i]
                    c_zy = v0 * sum_zz[i] + sum_zzv[i] + z0 * sum_zv[i]
                    c_yy = (
                        v0 * (v0 * sum_zz[i] + 2.0 * sum_zzv[i])
                        + sum_zzvv[i]
                        + 2.0 * z0 * (v0 * sum_zv[i] + sum_zvv[i])
                        + z0 * z0 * sum_vv[i]
                    )
                    n += sum_1[i]
                    s_x += t * sum_z[i] + p * sum_1[i]
                    s_y += c_y
                    s_z += sum_z[i]
                    s_xx += t * (t * sum_zz[i] + 2.0 * p * sum_z[i]) + p * p * sum_1[i]
                    s_xy += t * c_zy + p * c_y
                    s_xz += t * sum_zz[i] + p * sum_z[i]
                    s_yy += c_yy
                    s_yz += c_zy
                    s_zz += sum_zz[i]
                reference[0, tile_row, tile] = u0 * z0
                reference[1, tile_row, tile] = v0 * z0
                moments[0, tile_row, tile] = n
                moments[1, tile_row, tile] = s_x
                moments[2, tile_row, tile] = s_y
                moments[3, tile_row, tile] = s_z
                moments[4, tile_row, tile] = s_xx
                moments[5, tile_row, tile] = s_xy
                moments[6, tile_row, tile] = s_xz
                moments[7, tile_row, tile] = s_yy
                moments[8, tile_row, tile] = s_yz
                moments[9, tile_row, tile] = s_zz


@kernel(reduction=True)
def standard_moments(
    raw, lowest, highest, scale, offset, is_disparity, tan_x, tan_y,
    tile_height, tile_width, tile_row_start, tile_row_stop, reference, moments,
):  # fmt: skip
    """Moments of (X, Y, Z) as in `standard_moments_separable`, for any camera: tan_x, tan_y are (H, W)."""
    height, width = raw.shape
    tile_columns = moments.shape[2]
    tiles_at_once = max(1, COLUMNS // tile_width)
    sums = np.empty((10, max(COLUMNS, tile_width)))
    sum_1, sum_x, sum_y, sum_z = sums[0], sums[1], sums[2], sums[3]
    sum_xx, sum_xy, sum_xz, sum_yy, sum_yz, sum_zz = sums[4], sums[5], sums[6], sums[7], sums[8], sums[9]
    references = np.empty((3, max(COLUMNS, tile_width)))
    reference_x, reference_y, reference_z = references[0], references[1], references[2]
    metres = 1.0 / scale

    for tile_row in range(tile_row_start, tile_row_stop):
        row_start = tile_row * tile_height
        row_stop = min(row_start + tile_height, height)
        for first_tile in range(0, tile_columns, tiles_at_once):
            last_tile = min(first_tile + tiles_at_once, tile_columns)
            left = first_tile * tile_width
            right = min(last_tile * tile_width, width)

            for tile in range(first_tile, last_tile):
                column_start = tile * tile_width
                column_stop = min(column_start + tile_width, width)
                value = first_valid(raw, row_start, row_stop, column_start, column_stop, lowest, highest)
                z0 = depth(value, scale, offset, is_disparity)
                reference[0, tile_row, tile] *= z0
                reference[1, tile_row, tile] *= z0
                reference[2, tile_row, tile] = z0
                reference_x[column_start - left : column_stop - left] = reference[0, tile_row, tile]
                reference_y[column_start - left : column_stop - left] = reference[1, tile_row, tile]
                reference_z[column_start - left : column_stop - left] = z0

            sums[:, : right - left] = 0.0
            for row in range(row_start, row_stop):
                values = raw[row, left:right]
                tan_x_row = tan_x[row, left:right]
                tan_y_row = tan_y[row, left:right]
                for column in range(right - left):
                    valid = (values[column] >= lowest) & (values[column] <= highest)
                    if is_disparity:
                        z = 1.0 / (scale * values[column] + offset)
                    else:
                        z = metres * values[column]
                    one = 1.0 if valid else 0.0
                    x = z * tan_x_row[column] - reference_x[column] if valid else 0.0
                    y = z * tan_y_row[column] - reference_y[column] if valid else 0.0
                    z = z - reference_z[column] if valid else 0.0
                    sum_1[column] += one
                    sum_x[column] += x
                    sum_y[column] += y
                    sum_z[column] += z
                    sum_xx[column] += x * x
                    sum_xy[column] += x * y
                    sum_xz[column] += x * z
                    sum_yy[column] += y * y
                    sum_yz[column] += y * z
                    sum_zz[column] += z * z

            for tile in range(first_tile, last_tile):
                i = tile * tile_width - left
                j = min((tile + 1) * tile_width, width) - left
                for entry in range(10):
                    moments[entry, tile_row, tile] = sums[entry, i:j].sum()


@kernel(reduction=True)
def full_tile_moments(tan_x, tan_y, tile_height, tile_width, reference, full):
    """Camera terms of every tile, as if no pixel were missing: computed once for a camera.

    Parameters
    ----------
    tan_x, tan_y : (H, W) float64
    reference : (3, R, C) float64
        The mean ray of each tile is written into the first two rows.
    full : (6, R, C) float64, written
        n, Σu, Σv, Σuu, Σuv, Σvv of u = tanθx - u0, v = tanθy - v0 (the paper's
        eq. tan_theta_scattermatrix-1).
    """
    height, width = tan_x.shape
    for tile_row in range(full.shape[1]):
        row_start = tile_row * tile_height
        row_stop = min(row_start + tile_height, height)
        for tile in range(full.shape[2]):
            column_start = tile * tile_width
            column_stop = min(column_start + tile_width, width)
            u0 = tan_x[row_start:row_stop, column_start:column_stop].mean()
            v0 = tan_y[row_start:row_stop, column_start:column_stop].mean()
            s_u = s_v = s_uu = s_uv = s_vv = 0.0
            for row in range(row_start, row_stop):
                for column in range(column_start, column_stop):
                    u = tan_x[row, column] - u0
                    v = tan_y[row, column] - v0
                    s_u += u
                    s_v += v
                    s_uu += u * u
                    s_uv += u * v
                    s_vv += v * v
            reference[0, tile_row, tile] = u0
            reference[1, tile_row, tile] = v0
            full[0, tile_row, tile] = (row_stop - row_start) * (column_stop - column_start)
            full[1, tile_row, tile] = s_u
            full[2, tile_row, tile] = s_v
            full[3, tile_row, tile] = s_uu
            full[4, tile_row, tile] = s_uv
            full[5, tile_row, tile] = s_vv
