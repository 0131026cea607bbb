"""Moments of the tiles of a grid in one pass over the frame: the ``direct`` implementation.

A pixel is a triple (u, v, w): (tanθx, tanθy, q) with q = 1/Z in range space, (X, Y, Z) in the standard
one. A tile's moments are the ten sums [n, Σu, Σv, Σw, Σuu, Σuv, Σuw, Σvv, Σvw, Σww] over its valid pixels,
of coordinates taken relative to a reference point of the tile, so that nothing cancels later.

A strip is a run of neighbouring tiles of one tile row. Its rows are added to one accumulator per image column,
and columns are folded into tiles after the last row. So the inner loop runs along the image row, vectorises
without tails at tile borders, and for a camera without lens distortion, where tanθx depends on the column
alone and tanθy on the row alone, multiplies by tanθx once per column instead of once per pixel. Two rows are read
at a time: the accumulators' loads and stores would otherwise cost more than the arithmetic, and one division
gives the inverse of two depths, 1/a = b/(ab) and 1/b = a/(ab).

Missing pixels are counted in whole numbers of 16 bits, four times as many to a vector as the sums: their number
in the low bits with the sum of their rows k above, and the sum of k².
"""

import numpy as np

from ._jit import kernel
from .depth import depth, inverse_depth

# Columns of a strip: their accumulators stay in the first-level cache. A multiple of 8, for whole vectors, but not
# of 512, or all accumulators of a column would compete for the same few lines of that cache.
COLUMNS = 648
# Tiles of a block: no fewer than a strip can have.
TILES = 328
# Rows whose pixels are counted at a time: so many that n <= BAND and Σk share 16 bits, and Σk² fits into them.
BAND = 32
COUNT_BITS = 6
COUNT_MASK = (1 << COUNT_BITS) - 1
# What a pixel in row k of a band adds. The last is for no row: nothing.
ROW_CODES = np.array([*(1 + (k << COUNT_BITS) for k in range(BAND)), 0], np.uint16)
ROW_SQUARES = np.array([*(k * k for k in range(BAND)), 0], np.uint16)
NOTHING = np.uint16(0)


@kernel()
def tiles_in_strip(tile_width):
    """How many tiles make a strip: eight or a multiple where possible, for whole vectors of tiles and columns."""
    tiles = max(1, COLUMNS // tile_width)
    return tiles if tiles < 8 else tiles // 8 * 8


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


@kernel(inline=True)
def spread_to_columns(values, tile_start, tile_stop, tile_width, left, right, columns):
    """Give every column between ``left`` and ``right`` the value of its tile."""
    for tile in range(tile_start, tile_stop):
        value = values[tile - tile_start]
        # Four at a time: what goes beyond the tile is overwritten by the next.
        for column in range(max(tile * tile_width, left), min((tile + 1) * tile_width, right), 4):
            i = column - left
            columns[i] = value
            columns[i + 1] = value
            columns[i + 2] = value
            columns[i + 3] = value


@kernel(reduction=True, inline=True)
def add_range_rows(
    raw, lowest, highest, scale, offset, tan_y, v0, row_start, row_stop, left, count,
    reference_q, sums, counts, add,
):  # fmt: skip
    """Add a band of at most `BAND` image rows to the sums of their columns.

    Parameters
    ----------
    left, count
        The first column and the number of columns.
    reference_q : (COLUMNS,) float64
        Reference inverse depth of each column's tile.
    sums : (6, COLUMNS) float64
        Σq, Σqv, Σqq of the valid pixels, added to; 1, Σv, Σvv of the missing ones, added to if ``add``, else
        written.
    counts : (2, COLUMNS) uint16
        Room for the band's missing pixels.
    """
    sum_q, sum_qv, sum_qq = sums[0], sums[1], sums[2]
    codes, squares = counts[0], counts[1]
    for i in range(count):
        codes[i] = NOTHING
        squares[i] = NOTHING
    for row in range(row_start, row_stop, 2):
        # An odd last row is paired with itself, of which nothing counts.
        is_pair = row + 1 < row_stop
        other = row + 1 if is_pair else row
        a = raw[row, left : left + count]
        b = raw[other, left : left + count]
        va = tan_y[row] - v0
        vb = tan_y[other] - v0
        k = row - row_start
        k_other = k + 1 if is_pair else BAND
        code_a, code_b = ROW_CODES[k], ROW_CODES[k_other]
        square_a, square_b = ROW_SQUARES[k], ROW_SQUARES[k_other]
        for i in range(count):
            valid_a = (a[i] >= lowest) & (a[i] <= highest)
            valid_b = (b[i] >= lowest) & (b[i] <= highest)
            if offset is None:
                za = np.float64(a[i] if valid_a else lowest)
                zb = np.float64(b[i] if valid_b else lowest)
                inverse = scale / (za * zb)
                qa = zb * inverse
                qb = za * inverse
            else:
                qa = scale * a[i] + offset
                qb = scale * b[i] + offset
            qa = qa - reference_q[i] if valid_a else 0.0
            qb = qb - reference_q[i] if valid_b & is_pair else 0.0
            sum_q[i] += qa + qb
            sum_qv[i] += qa * va + qb * vb
            sum_qq[i] += qa * qa + qb * qb
            codes[i] += (NOTHING if valid_a else code_a) + (NOTHING if valid_b else code_b)
            squares[i] += (NOTHING if valid_a else square_a) + (NOTHING if valid_b else square_b)

    v = tan_y[row_start] - v0
    step = (tan_y[row_stop - 1] - tan_y[row_start]) / max(row_stop - 1 - row_start, 1)
    count_rows(codes, squares, count, v, step, add, sums[3], sums[4], sums[5])


@kernel(inline=True)
def count_rows(codes, squares, count, v, step, add, ones, sum_v, sum_vv):
    """Turn counted pixels of rows v + k·step into the sums of 1, v and v²; they are added to if ``add``."""
    for i in range(count):
        n = np.float64(codes[i] & COUNT_MASK)
        sum_k = np.float64(codes[i] >> COUNT_BITS)
        sum_kk = np.float64(squares[i])
        n_v = n * v + sum_k * step
        n_vv = n * (v * v) + sum_k * (2.0 * v * step) + sum_kk * (step * step)
        ones[i] = ones[i] + n if add else n
        sum_v[i] = sum_v[i] + n_v if add else n_v
        sum_vv[i] = sum_vv[i] + n_vv if add else n_vv


@kernel()
def fold_range_columns(sums, left, right, tan_x, u0, tile_start, tile_stop, tile_width, first, add, moments):
    """Sum the columns ``left`` to ``right`` over their tiles, into ``moments`` from entry ``first``.

    The camera terms are those of the missing pixels. Without leave to reorder: tiles are too narrow for these
    sums to vectorise, and trying costs more.
    """
    sum_q, sum_qv, sum_qq, lost, lost_v, lost_vv = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
    for tile in range(tile_start, tile_stop):
        centre = u0[tile]
        s_q = s_qu = s_qv = s_qq = 0.0
        l_1 = l_u = l_v = l_uu = l_uv = l_vv = 0.0
        for column in range(max(tile * tile_width, left), min((tile + 1) * tile_width, right)):
            u = tan_x[column] - centre
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
        t = first + tile - tile_start
        if add:
            l_1 += moments[0, t]
            l_u += moments[1, t]
            l_v += moments[2, t]
            s_q += moments[3, t]
            l_uu += moments[4, t]
            l_uv += moments[5, t]
            s_qu += moments[6, t]
            l_vv += moments[7, t]
            s_qv += moments[8, t]
            s_qq += moments[9, t]
        moments[0, t] = l_1
        moments[1, t] = l_u
        moments[2, t] = l_v
        moments[3, t] = s_q
        moments[4, t] = l_uu
        moments[5, t] = l_uv
        moments[6, t] = s_qu
        moments[7, t] = l_vv
        moments[8, t] = s_qv
        moments[9, t] = s_qq


@kernel()
def range_strip_separable(
    raw, lowest, highest, scale, offset, tan_x, tan_y, tile_width, u0, v0,
    row_start, row_stop, tile_start, tile_stop, first, reference_q, moments,
):  # fmt: skip
    """Range-space sums of a strip of tiles, for a camera without lens distortion.

    Only Σq, Σq·tanθx, Σq·tanθy and Σq² come from the frame (the paper's eq. tan_theta_scattermatrix). The
    other entries are summed over the missing pixels: A_valid = A_full - Σ_missing m mᵀ.

    Parameters
    ----------
    raw : (H, W) array
        The frame; a pixel is valid if ``lowest <= raw <= highest``.
    scale, offset
        q = scale / raw, or scale * raw + offset unless ``offset`` is None.
    tan_x, tan_y : (W,) and (H,) float64
    u0 : (C,) float64
    v0 : float
        Reference point of each tile of the tile row.
    row_start, row_stop
        Image rows of the tiles.
    reference_q, moments : (TILES,) and (10, TILES) float64, written
        From entry ``first``.
    """
    sums = np.empty((10, COLUMNS))
    counts = np.empty((2, COLUMNS), np.uint16)
    columns = np.zeros((3, COLUMNS + 8))
    width = raw.shape[1]
    for tile in range(tile_start, tile_stop):
        start = tile * tile_width
        stop = min(start + tile_width, width)
        value = first_valid(raw, row_start, row_stop, start, stop, lowest, highest)
        reference_q[first + tile - tile_start] = (
            inverse_depth(value, scale, 0.0, False)
            if offset is None
            else inverse_depth(value, scale, offset, True)
        )
    last = min(tile_stop * tile_width, width)
    # More than one turn only where a tile is wider than a strip.
    for left in range(tile_start * tile_width, last, COLUMNS):
        right = min(left + COLUMNS, last)
        # Whole vectors: the sums of a few columns more are not looked at.
        count = min((right - left + 7) // 8 * 8, width - left)
        spread_to_columns(reference_q[first:], tile_start, tile_stop, tile_width, left, right, columns[0])
        for entry in range(3):
            for i in range(count):
                sums[entry, i] = 0.0
        for band in range(row_start, row_stop, BAND):
            add_range_rows(
                raw, lowest, highest, scale, offset, tan_y, v0, band, min(band + BAND, row_stop), left, count,
                columns[0], sums, counts, band > row_start,
            )  # fmt: skip
        fold_range_columns(
            sums, left, right, tan_x, u0, tile_start, tile_stop, tile_width,
            first, left > tile_start * tile_width, moments,
        )  # fmt: skip


@kernel(reduction=True, inline=True)
def add_range_rows_of_rays(
    raw, lowest, highest, scale, offset, tan_x, tan_y, row_start, row_stop, left, count, columns, sums
):
    """Add image rows to the sums of their columns, for rays that differ from pixel to pixel.

    ``columns`` (3, COLUMNS) holds each column's reference point; ``sums`` (10, COLUMNS) are in the order of the
    moments, those without q over the missing pixels.
    """
    lost, lost_u, lost_v, sum_q, lost_uu = sums[0], sums[1], sums[2], sums[3], sums[4]
    lost_uv, sum_qu, lost_vv, sum_qv, sum_qq = sums[5], sums[6], sums[7], sums[8], sums[9]
    u0, v0, q0 = columns[0], columns[1], columns[2]
    for row in range(row_start, row_stop, 2):
        is_pair = row + 1 < row_stop
        other = row + 1 if is_pair else row
        a = raw[row, left : left + count]
        b = raw[other, left : left + count]
        tan_xa, tan_xb = tan_x[row, left : left + count], tan_x[other, left : left + count]
        tan_ya, tan_yb = tan_y[row, left : left + count], tan_y[other, left : left + count]
        for i in range(count):
            valid_a = (a[i] >= lowest) & (a[i] <= highest)
            valid_b = (b[i] >= lowest) & (b[i] <= highest)
            if offset is None:
                za = np.float64(a[i] if valid_a else lowest)
                zb = np.float64(b[i] if valid_b else lowest)
                inverse = scale / (za * zb)
                qa = zb * inverse
                qb = za * inverse
            else:
                qa = scale * a[i] + offset
                qb = scale * b[i] + offset
            qa = qa - q0[i] if valid_a else 0.0
            qb = qb - q0[i] if valid_b & is_pair else 0.0
            ua, ub = tan_xa[i] - u0[i], tan_xb[i] - u0[i]
            va, vb = tan_ya[i] - v0[i], tan_yb[i] - v0[i]
            sum_q[i] += qa + qb
            sum_qu[i] += qa * ua + qb * ub
            sum_qv[i] += qa * va + qb * vb
            sum_qq[i] += qa * qa + qb * qb
            lost_a = 0.0 if valid_a else 1.0
            lost_b = 0.0 if valid_b | (not is_pair) else 1.0
            lost[i] += lost_a + lost_b
            lost_ua, lost_ub = lost_a * ua, lost_b * ub
            lost_va, lost_vb = lost_a * va, lost_b * vb
            lost_u[i] += lost_ua + lost_ub
            lost_v[i] += lost_va + lost_vb
            lost_uu[i] += lost_ua * ua + lost_ub * ub
            lost_uv[i] += lost_ua * va + lost_ub * vb
            lost_vv[i] += lost_va * va + lost_vb * vb


@kernel()
def fold_columns(sums, left, right, tile_start, tile_stop, tile_width, first, add, moments):
    """Sum the columns ``left`` to ``right`` over their tiles, into ``moments`` from entry ``first``."""
    for tile in range(tile_start, tile_stop):
        t = first + tile - tile_start
        start = max(tile * tile_width, left) - left
        stop = min((tile + 1) * tile_width, right) - left
        for entry in range(10):
            total = moments[entry, t] if add else 0.0
            for i in range(start, stop):
                total += sums[entry, i]
            moments[entry, t] = total


@kernel()
def range_strip(
    raw, lowest, highest, scale, offset, tan_x, tan_y, tile_width, u0, v0,
    row_start, row_stop, tile_start, tile_stop, first, reference_q, moments,
):  # fmt: skip
    """Range-space sums as in `range_strip_separable`, for any camera: tan_x, tan_y are (H, W), v0 is (C,)."""
    sums = np.empty((10, COLUMNS))
    columns = np.zeros((3, COLUMNS + 8))
    width = raw.shape[1]
    for tile in range(tile_start, tile_stop):
        start = tile * tile_width
        stop = min(start + tile_width, width)
        value = first_valid(raw, row_start, row_stop, start, stop, lowest, highest)
        reference_q[first + tile - tile_start] = (
            inverse_depth(value, scale, 0.0, False)
            if offset is None
            else inverse_depth(value, scale, offset, True)
        )
    last = min(tile_stop * tile_width, width)
    for left in range(tile_start * tile_width, last, COLUMNS):
        right = min(left + COLUMNS, last)
        count = min((right - left + 7) // 8 * 8, width - left)
        spread_to_columns(u0[tile_start:], tile_start, tile_stop, tile_width, left, right, columns[0])
        spread_to_columns(v0[tile_start:], tile_start, tile_stop, tile_width, left, right, columns[1])
        spread_to_columns(reference_q[first:], tile_start, tile_stop, tile_width, left, right, columns[2])
        for entry in range(10):
            for i in range(count):
                sums[entry, i] = 0.0
        add_range_rows_of_rays(
            raw, lowest, highest, scale, offset, tan_x, tan_y, row_start, row_stop, left, count, columns, sums
        )
        fold_columns(
            sums,
            left,
            right,
            tile_start,
            tile_stop,
            tile_width,
            first,
            left > tile_start * tile_width,
            moments,
        )


@kernel(reduction=True, inline=True)
def add_standard_rows(
    raw, lowest, highest, scale, offset, tan_y, v0, row_start, row_stop, left, count,
    reference_z, sums, counts, add,
):  # fmt: skip
    """Add a band of at most `BAND` image rows to the sums of their columns.

    ``sums`` (9, COLUMNS) are Σz, Σzv, Σzvv, Σzz, Σzzv, Σzzvv, added to, and Σ1, Σv, Σvv, added to if ``add``, else
    written; z is relative to ``reference_z``. See `add_range_rows` for the rest.
    """
    sum_z, sum_zv, sum_zvv, sum_zz, sum_zzv, sum_zzvv = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
    codes, squares = counts[0], counts[1]
    metres = 1.0 / scale
    for i in range(count):
        codes[i] = NOTHING
        squares[i] = NOTHING
    for row in range(row_start, row_stop, 2):
        is_pair = row + 1 < row_stop
        other = row + 1 if is_pair else row
        a = raw[row, left : left + count]
        b = raw[other, left : left + count]
        va = tan_y[row] - v0
        vb = tan_y[other] - v0
        vva = va * va
        vvb = vb * vb
        k = row - row_start
        k_other = k + 1 if is_pair else BAND
        code_a, code_b = ROW_CODES[k], ROW_CODES[k_other]
        square_a, square_b = ROW_SQUARES[k], ROW_SQUARES[k_other]
        for i in range(count):
            valid_a = (a[i] >= lowest) & (a[i] <= highest)
            valid_b = (b[i] >= lowest) & (b[i] <= highest)
            if offset is None:
                za = metres * a[i]
                zb = metres * b[i]
            else:
                qa = scale * a[i] + offset if valid_a else 1.0
                qb = scale * b[i] + offset if valid_b else 1.0
                depths = 1.0 / (qa * qb)
                za = qb * depths
                zb = qa * depths
            za = za - reference_z[i] if valid_a else 0.0
            zb = zb - reference_z[i] if valid_b & is_pair else 0.0
            zza = za * za
            zzb = zb * zb
            sum_z[i] += za + zb
            sum_zv[i] += za * va + zb * vb
            sum_zvv[i] += za * vva + zb * vvb
            sum_zz[i] += zza + zzb
            sum_zzv[i] += zza * va + zzb * vb
            sum_zzvv[i] += zza * vva + zzb * vvb
            codes[i] += (code_a if valid_a else NOTHING) + (code_b if valid_b else NOTHING)
            squares[i] += (square_a if valid_a else NOTHING) + (square_b if valid_b else NOTHING)

    v = tan_y[row_start] - v0
    step = (tan_y[row_stop - 1] - tan_y[row_start]) / max(row_stop - 1 - row_start, 1)
    count_rows(codes, squares, count, v, step, add, sums[6], sums[7], sums[8])


@kernel(reduction=True)
def standard_columns(sums, z0, v0, tan_x, u0, left, count):
    """Turn a strip's sums of columns into those of 1, X, Y, Z and their products, in the order of the moments.

    With z = Z - Z0, u = tanθx - u0 and v = tanθy - v0, a point relative to the reference Z0·(u0, v0, 1) is

        X = z·tanθx + Z0·u,    Y = z·tanθy + Z0·v,    Z = z,

    so nine sums down a column give the ten of X, Y and Z, whatever the column's tanθx.
    """
    for i in range(count):
        s_z, s_zv, s_zvv = sums[0, i], sums[1, i], sums[2, i]
        s_zz, s_zzv, s_zzvv = sums[3, i], sums[4, i], sums[5, i]
        n, s_v, s_vv = sums[6, i], sums[7, i], sums[8, i]
        t = tan_x[left + i]
        x = z0[i] * (t - u0[i])  # X = z·t + x
        # Sums of Y = z·(v0 + v) + z0·v, of zY and of YY.
        c_y = v0 * s_z + s_zv + z0[i] * s_v
        c_zy = v0 * s_zz + s_zzv + z0[i] * s_zv
        c_yy = (
            v0 * (v0 * s_zz + 2.0 * s_zzv) + s_zzvv + 2.0 * z0[i] * (v0 * s_zv + s_zvv) + z0[i] * z0[i] * s_vv
        )
        sums[0, i] = n
        sums[1, i] = t * s_z + x * n
        sums[2, i] = c_y
        sums[3, i] = s_z
        sums[4, i] = t * (t * s_zz + 2.0 * x * s_z) + x * x * n
        sums[5, i] = t * c_zy + x * c_y
        sums[6, i] = t * s_zz + x * s_z
        sums[7, i] = c_yy
        sums[8, i] = c_zy
        sums[9, i] = s_zz


@kernel()
def standard_strip_separable(
    raw, lowest, highest, scale, offset, tan_x, tan_y, tile_width, u0, v0,
    row_start, row_stop, tile_start, tile_stop, first, reference, moments,
):  # fmt: skip
    """Moments of (X, Y, Z) of a strip of tiles, for a camera without lens distortion.

    Every entry depends on the frame (the paper's eq. XYZ_scattermatrix). As `range_strip_separable`, but
    depth is Z = raw / scale, or 1 / (scale * raw + offset), ``reference`` (3, TILES), all of it, is written,
    and the moments are complete.
    """
    sums = np.empty((10, COLUMNS))
    counts = np.empty((2, COLUMNS), np.uint16)
    columns = np.zeros((3, COLUMNS + 8))
    width = raw.shape[1]
    standard_reference(
        raw,
        lowest,
        highest,
        scale,
        offset,
        tile_width,
        row_start,
        row_stop,
        tile_start,
        tile_stop,
        first,
        reference,
    )
    last = min(tile_stop * tile_width, width)
    for left in range(tile_start * tile_width, last, COLUMNS):
        right = min(left + COLUMNS, last)
        count = min((right - left + 7) // 8 * 8, width - left)
        spread_to_columns(u0[tile_start:], tile_start, tile_stop, tile_width, left, right, columns[0])
        spread_to_columns(reference[2, first:], tile_start, tile_stop, tile_width, left, right, columns[2])
        for entry in range(6):
            for i in range(count):
                sums[entry, i] = 0.0
        for band in range(row_start, row_stop, BAND):
            add_standard_rows(
                raw, lowest, highest, scale, offset, tan_y, v0, band, min(band + BAND, row_stop), left, count,
                columns[2], sums, counts, band > row_start,
            )  # fmt: skip
        standard_columns(sums, columns[2], v0, tan_x, columns[0], left, count)
        fold_columns(
            sums,
            left,
            right,
            tile_start,
            tile_stop,
            tile_width,
            first,
            left > tile_start * tile_width,
            moments,
        )
    for tile in range(tile_start, tile_stop):
        t = first + tile - tile_start
        reference[0, t] = reference[2, t] * u0[tile]
        reference[1, t] = reference[2, t] * v0


@kernel()
def standard_reference(
    raw,
    lowest,
    highest,
    scale,
    offset,
    tile_width,
    row_start,
    row_stop,
    tile_start,
    tile_stop,
    first,
    reference,
):
    """Write each tile's reference depth, Z0, into the third row of ``reference``."""
    for tile in range(tile_start, tile_stop):
        start = tile * tile_width
        stop = min(start + tile_width, raw.shape[1])
        value = first_valid(raw, row_start, row_stop, start, stop, lowest, highest)
        reference[2, first + tile - tile_start] = (
            depth(value, scale, 0.0, False) if offset is None else depth(value, scale, offset, True)
        )


@kernel(reduction=True, inline=True)
def add_standard_rows_of_rays(
    raw, lowest, highest, scale, offset, tan_x, tan_y, row_start, row_stop, left, count, columns, sums
):
    """Add image rows to the sums of their columns, for rays that differ from pixel to pixel.

    ``columns`` (3, COLUMNS) holds each column's reference point (X0, Y0, Z0); ``sums`` (10, COLUMNS) are in the
    order of the moments.
    """
    sum_1, sum_x, sum_y, sum_z, sum_xx = sums[0], sums[1], sums[2], sums[3], sums[4]
    sum_xy, sum_xz, sum_yy, sum_yz, sum_zz = sums[5], sums[6], sums[7], sums[8], sums[9]
    x0, y0, z0 = columns[0], columns[1], columns[2]
    metres = 1.0 / scale
    for row in range(row_start, row_stop, 2):
        is_pair = row + 1 < row_stop
        other = row + 1 if is_pair else row
        a = raw[row, left : left + count]
        b = raw[other, left : left + count]
        tan_xa, tan_xb = tan_x[row, left : left + count], tan_x[other, left : left + count]
        tan_ya, tan_yb = tan_y[row, left : left + count], tan_y[other, left : left + count]
        for i in range(count):
            valid_a = (a[i] >= lowest) & (a[i] <= highest)
            valid_b = (b[i] >= lowest) & (b[i] <= highest)
            if offset is None:
                za = metres * a[i]
                zb = metres * b[i]
            else:
                qa = scale * a[i] + offset if valid_a else 1.0
                qb = scale * b[i] + offset if valid_b else 1.0
                depths = 1.0 / (qa * qb)
                za = qb * depths
                zb = qa * depths
            counts_b = valid_b & is_pair
            xa = za * tan_xa[i] - x0[i] if valid_a else 0.0
            xb = zb * tan_xb[i] - x0[i] if counts_b else 0.0
            ya = za * tan_ya[i] - y0[i] if valid_a else 0.0
            yb = zb * tan_yb[i] - y0[i] if counts_b else 0.0
            za = za - z0[i] if valid_a else 0.0
            zb = zb - z0[i] if counts_b else 0.0
            sum_1[i] += (1.0 if valid_a else 0.0) + (1.0 if counts_b else 0.0)
            sum_x[i] += xa + xb
            sum_y[i] += ya + yb
            sum_z[i] += za + zb
            sum_xx[i] += xa * xa + xb * xb
            sum_xy[i] += xa * ya + xb * yb
            sum_xz[i] += xa * za + xb * zb
            sum_yy[i] += ya * ya + yb * yb
            sum_yz[i] += ya * za + yb * zb
            sum_zz[i] += za * za + zb * zb


@kernel()
def standard_strip(
    raw, lowest, highest, scale, offset, tan_x, tan_y, tile_width, u0, v0,
    row_start, row_stop, tile_start, tile_stop, first, reference, moments,
):  # fmt: skip
    """Moments as in `standard_strip_separable`, for any camera: tan_x, tan_y are (H, W), v0 is (C,)."""
    sums = np.empty((10, COLUMNS))
    columns = np.zeros((3, COLUMNS + 8))
    width = raw.shape[1]
    standard_reference(
        raw,
        lowest,
        highest,
        scale,
        offset,
        tile_width,
        row_start,
        row_stop,
        tile_start,
        tile_stop,
        first,
        reference,
    )
    for tile in range(tile_start, tile_stop):
        t = first + tile - tile_start
        reference[0, t] = reference[2, t] * u0[tile]
        reference[1, t] = reference[2, t] * v0[tile]
    last = min(tile_stop * tile_width, width)
    for left in range(tile_start * tile_width, last, COLUMNS):
        right = min(left + COLUMNS, last)
        count = min((right - left + 7) // 8 * 8, width - left)
        for axis in range(3):
            spread_to_columns(
                reference[axis, first:], tile_start, tile_stop, tile_width, left, right, columns[axis]
            )
        for entry in range(10):
            for i in range(count):
                sums[entry, i] = 0.0
        add_standard_rows_of_rays(
            raw, lowest, highest, scale, offset, tan_x, tan_y, row_start, row_stop, left, count, columns, sums
        )
        fold_columns(
            sums,
            left,
            right,
            tile_start,
            tile_stop,
            tile_width,
            first,
            left > tile_start * tile_width,
            moments,
        )


@kernel(reduction=True)
def full_tile_moments(tan_x, tan_y, tile_height, tile_width, centre, full):
    """Camera terms of every tile, as if no pixel were missing: computed once for a camera.

    Parameters
    ----------
    tan_x, tan_y : (H, W) float64
    centre : (2, R, C) float64, written
        The mean ray of each tile, its reference point.
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
            centre[0, tile_row, tile] = u0
            centre[1, tile_row, tile] = v0
            full[0, tile_row, tile] = (row_stop - row_start) * (column_stop - column_start)
            full[1, tile_row, tile] = s_u
            full[2, tile_row, tile] = s_v
            full[3, tile_row, tile] = s_uu
            full[4, tile_row, tile] = s_uv
            full[5, tile_row, tile] = s_vv
