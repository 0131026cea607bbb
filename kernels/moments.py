"""Moments of the tiles of a grid in one pass over the frame: the ``direct`` implementation.

A pixel is a triple (u, v, w): (tanθx, tanθy, q) with q = 1/Z in range space, (X, Y, Z) in the standard
one. A tile's moments are the ten sums [n, Σu, Σv, Σw, Σuu, Σuv, Σuw, Σvv, Σvw, Σww] over its valid pixels,
of coordinates taken relative to a reference point of the tile, so that nothing cancels later.

A strip is a run of neighbouring tiles of one tile row. Its rows are added to one accumulator per image column,
and columns are folded into tiles after the last row. So the inner loop runs along the image row, vectorises
without tails at tile borders, and for a camera without lens distortion, where tanθx depends on the column
alone and tanθy on the row alone, multiplies by tanθx once per column instead of once per pixel. Four rows are read
at a time, two at the end: the accumulators' loads and stores would otherwise cost more than the arithmetic, and
one division gives the inverse of two depths, 1/a = b/(ab) and 1/b = a/(ab).

Missing pixels are counted. Without lens distortion tanθx and tanθy are linear in a tile's column j and row k, and
its sums of 1, u, v, uu, uv and vv over missing pixels follow from those of 1, j, k, jj, jk and kk, which are whole
numbers: a column adds up 1, k and kk in three fields of one number, and a tile that number times 1, j and jj.
"""

import numpy as np

from ._jit import kernel

# Columns of a strip: their accumulators stay in the first-level cache. A multiple of 8, for whole vectors, but not
# of 512, or all accumulators of a column would compete for the same few lines of that cache.
COLUMNS = 648
# Tiles of a block: no fewer than a strip can have.
TILES = 328
# Rows and columns whose missing pixels are counted at a time: so few that Σ1, Σjj, Σk and Σjk fit into fields of 22
# bits and Σkk into one of 20. What a field has no room for is not used.
BAND_ROWS = 32
BAND_COLUMNS = 64
FIELD = np.uint64(22)
LAST_FIELD = np.uint64(44)
FIELD_MASK = np.uint64((1 << 22) - 1)
# What a missing pixel in row k of a band adds. The last is for no row: nothing.
ROW_CODES = np.array([*(1 + (k << 22) + (k * k << 44) for k in range(BAND_ROWS)), 0], np.uint64)
NO_CODE = np.uint64(0)
# Entries of the moments that the camera alone determines, in the order of `full_tile_moments`.
CAMERA_TERMS = np.array([0, 1, 2, 4, 5, 7])


@kernel()
def tiles_in_strip(tile_width):
    """How many tiles make a strip: eight or a multiple where possible, for whole vectors of tiles and columns."""
    tiles = max(1, COLUMNS // tile_width)
    return tiles if tiles < 8 else tiles // 8 * 8


@kernel()
def first_valid(raw, row_start, row_stop, column_start, column_stop, lowest, highest):
    """Return a valid raw value of the tile, its centre's if that is valid, or 1 if there is none."""
    value = raw[(row_start + row_stop) // 2, (column_start + column_stop) // 2]
    if lowest <= value <= highest:
        return value
    for row in range(row_start, row_stop):
        for column in range(column_start, column_stop):
            value = raw[row, column]
            if lowest <= value <= highest:
                return value
    return raw.dtype.type(1)


@kernel(inline=True)
def find_references(
    raw, lowest, highest, scale, offset, in_range, row_start, row_stop, tile_start, tile_stop, tile_width,
    references_raw, references,
):  # fmt: skip
    """Take a valid pixel of each tile for its reference.

    Parameters
    ----------
    in_range : bool
        Whether inverse depths are wanted, or depths.
    references_raw, references : (TILES,), written
        Raw value and (inverse) depth.
    """
    for tile in range(tile_start, tile_stop):
        start = tile * tile_width
        stop = min(start + tile_width, raw.shape[1])
        references_raw[tile - tile_start] = first_valid(
            raw, row_start, row_stop, start, stop, lowest, highest
        )
    for i in range(tile_stop - tile_start):
        value = np.float64(references_raw[i])
        if offset is None:
            references[i] = scale / value if in_range else value / scale
        else:
            inverse = scale * value + offset
            references[i] = inverse if in_range else 1.0 / inverse


@kernel(inline=True)
def spread_to_columns(values, count, tile_width, columns):
    """Give every column of ``count`` tiles the value of its tile."""
    for tile in range(count):
        value = values[tile]
        # Eight at a time: what goes beyond the tile is overwritten by the next.
        for i in range(tile * tile_width, (tile + 1) * tile_width, 8):
            part = columns[i : i + 8]
            for k in range(8):
                part[k] = value


@kernel(inline=True)
def inverse_depths(a, b, scale, offset):
    """Inverse depths of two raw values, for one division."""
    if offset is None:
        inverse = scale / (a * b)
        return b * inverse, a * inverse
    return scale * a + offset, scale * b + offset


@kernel(inline=True)
def range_pair(
    a, b, lowest, highest, lowest_b, highest_b, scale, offset, va, vb, code_a, code_b, reference_q
):  # fmt: skip
    """Σq, Σqv, Σqq and the codes of the missing ones of two pixels of a column."""
    valid_a = (a >= lowest) & (a <= highest)
    valid_b = (b >= lowest_b) & (b <= highest_b)
    # Any number that is not 0 will do for a missing pixel.
    qa, qb = inverse_depths(
        np.float64(a if valid_a else lowest), np.float64(b if valid_b else lowest), scale, offset
    )
    qa = qa - reference_q if valid_a else 0.0
    qb = qb - reference_q if valid_b else 0.0
    missing = (NO_CODE if valid_a else code_a) + (NO_CODE if valid_b else code_b)
    return qa + qb, qa * va + qb * vb, qa * qa + qb * qb, missing


@kernel(inline=True)
def last_of_rows(raw, row, row_stop, lowest, highest):
    """An image row's number and its least and largest valid value; from ``row_stop`` on no value is valid."""
    if row < row_stop:
        return row, lowest, highest
    return row_stop - 1, raw.dtype.type(1), raw.dtype.type(0)


@kernel(reduction=True, inline=True)
def add_two_range_rows(
    raw, lowest, highest, scale, offset, v, row, row_stop, k, left, count,
    reference_q, sums, codes,
):  # fmt: skip
    """Add two image rows, see `add_range_rows`; the second may be missing."""
    sum_q, sum_qv, sum_qq = sums[0], sums[1], sums[2]
    last, low, high = last_of_rows(raw, row + 1, row_stop, lowest, highest)
    a, b = raw[row, left : left + count], raw[last, left : left + count]
    va, vb = v[row], v[last]
    code_a, code_b = ROW_CODES[k], ROW_CODES[k + 1 if row + 1 < row_stop else BAND_ROWS]
    for i in range(count):
        q, qv, qq, missing = range_pair(
            a[i], b[i], lowest, highest, low, high, scale, offset, va, vb, code_a, code_b,
            reference_q[i],
        )  # fmt: skip
        sum_q[i] += q
        sum_qv[i] += qv
        sum_qq[i] += qq
        codes[i] += missing


@kernel(reduction=True, inline=True)
def add_four_range_rows(
    raw, lowest, highest, scale, offset, v, row, row_stop, k, left, count,
    reference_q, sums, codes,
):  # fmt: skip
    """Add four image rows, see `add_range_rows`; the fourth may be missing."""
    sum_q, sum_qv, sum_qq = sums[0], sums[1], sums[2]
    last, low, high = last_of_rows(raw, row + 3, row_stop, lowest, highest)
    a, b = raw[row, left : left + count], raw[row + 1, left : left + count]
    c, d = raw[row + 2, left : left + count], raw[last, left : left + count]
    va, vb, vc, vd = v[row], v[row + 1], v[row + 2], v[last]
    code_a, code_b, code_c = ROW_CODES[k], ROW_CODES[k + 1], ROW_CODES[k + 2]
    code_d = ROW_CODES[k + 3 if row + 3 < row_stop else BAND_ROWS]
    for i in range(count):
        q, qv, qq, missing = range_pair(
            a[i], b[i], lowest, highest, lowest, highest, scale, offset, va, vb, code_a, code_b,
            reference_q[i],
        )  # fmt: skip
        q_, qv_, qq_, missing_ = range_pair(
            c[i], d[i], lowest, highest, low, high, scale, offset, vc, vd, code_c, code_d,
            reference_q[i],
        )  # fmt: skip
        sum_q[i] += q + q_
        sum_qv[i] += qv + qv_
        sum_qq[i] += qq + qq_
        codes[i] += missing + missing_


@kernel(inline=True)
def add_range_rows(
    raw, lowest, highest, scale, offset, v, row_start, row_stop, left, count,
    reference_q, sums, codes,
):  # fmt: skip
    """Add a band of at most `BAND_ROWS` image rows to the sums of their columns.

    Parameters
    ----------
    left, count
        The first column and the number of columns.
    reference_q : (COLUMNS,) float64
        Inverse depth of the reference of each column's tile.
    sums : (3, COLUMNS) float64, added to
        Σq, Σqv, Σqq of the valid pixels.
    codes : (COLUMNS,) uint64, added to
        The band's missing pixels.
    """
    row = row_start
    while row < row_stop:
        if row + 2 < row_stop:
            add_four_range_rows(
                raw, lowest, highest, scale, offset, v, row, row_stop, row - row_start, left, count,
                reference_q, sums, codes,
            )  # fmt: skip
            row += 4
        else:
            add_two_range_rows(
                raw, lowest, highest, scale, offset, v, row, row_stop, row - row_start, left, count,
                reference_q, sums, codes,
            )  # fmt: skip
            row += 2


@kernel(inline=True)
def add_missing(codes, u, step_u, v, tiles, span, counts, first_u, moments):
    """Add the missing pixels of a band of rows to the sums of 1, u, v, uu, uv and vv of its tiles.

    Parameters
    ----------
    codes : (COLUMNS,) uint64
        Of ``span`` columns a tile.
    u, step_u, v
        tanθx of the columns, its step, and tanθy of the rows, relative to their tile's centre.
    counts, first_u : (3, TILES) uint64 and (TILES,) float64
        Room.
    """
    v_0 = v[0]
    step_v = (v[-1] - v_0) / max(len(v) - 1, 1)
    for part in range(0, span, BAND_COLUMNS):
        size = min(span - part, BAND_COLUMNS)
        for tile in range(tiles):
            start = tile * span + part
            once = by_j = by_jj = NO_CODE
            for column in range(size):
                j = np.uint64(column)
                code = codes[start + column]
                once += code
                by_j += code * j
                by_jj += code * (j * j)
            counts[0, tile] = once
            counts[1, tile] = by_j
            counts[2, tile] = by_jj
            first_u[tile] = u[start]
        for tile in range(tiles):
            n = np.float64(counts[0, tile] & FIELD_MASK)
            k = np.float64((counts[0, tile] >> FIELD) & FIELD_MASK)
            kk = np.float64(counts[0, tile] >> LAST_FIELD)
            j = np.float64(counts[1, tile] & FIELD_MASK)
            jk = np.float64((counts[1, tile] >> FIELD) & FIELD_MASK)
            jj = np.float64(counts[2, tile] & FIELD_MASK)
            u_0 = first_u[tile]
            n_v = n * v_0 + k * step_v
            moments[0, tile] += n
            moments[1, tile] += n * u_0 + j * step_u
            moments[2, tile] += n_v
            moments[4, tile] += n * (u_0 * u_0) + j * (2.0 * u_0 * step_u) + jj * (step_u * step_u)
            moments[5, tile] += u_0 * n_v + step_u * (j * v_0 + jk * step_v)
            moments[7, tile] += n * (v_0 * v_0) + k * (2.0 * v_0 * step_v) + kk * (step_v * step_v)


@kernel(reduction=True, inline=True)
def fold_range_columns(sums, u, tiles, span, moments):
    """Add columns, ``span`` a tile, to the sums of their tiles."""
    sum_q, sum_qv, sum_qq = sums[0], sums[1], sums[2]
    for tile in range(tiles):
        s_q = s_qu = s_qv = s_qq = 0.0
        for column in range(span):
            i = tile * span + column
            s_q += sum_q[i]
            s_qu += sum_q[i] * u[i]
            s_qv += sum_qv[i]
            s_qq += sum_qq[i]
        moments[3, tile] += s_q
        moments[6, tile] += s_qu
        moments[8, tile] += s_qv
        moments[9, tile] += s_qq


@kernel(inline=True)
def add_camera_terms(centre, full, count, reference, moments):
    """Give tiles their central rays, and the camera terms of all their pixels less the missing ones."""
    for axis in range(2):
        for i in range(count):
            reference[axis, i] = centre[axis, i]
    for term in range(6):
        sums = moments[CAMERA_TERMS[term]]
        for i in range(count):
            sums[i] = full[term, i] - sums[i]


@kernel(inline=True)
def range_strip_separable(
    raw, lowest, highest, scale, offset, u, v, tile_width,
    row_start, row_stop, tile_start, tile_stop, room, references, moments,
):  # fmt: skip
    """Range-space sums of a strip of tiles, for a camera without lens distortion.

    Only Σq, Σq·tanθx, Σq·tanθy and Σq² come from the frame (the paper's eq. tan_theta_scattermatrix). The
    other entries are summed over the missing pixels: A_valid = A_full - Σ_missing m mᵀ, see `add_camera_terms`.

    Parameters
    ----------
    raw : (H, W) array
        The frame; a pixel is valid if ``lowest <= raw <= highest``.
    scale, offset
        q = scale / raw, or scale * raw + offset unless ``offset`` is None.
    u, v : (C * tile_width,) and (H,) float64
        tanθx of each column and tanθy of each row, relative to its tile's centre.
    row_start, row_stop
        Image rows of the tiles.
    room
        See `strip_room`.
    references : (N,) float64, written
        Inverse depth of the reference of each of the strip's tiles.
    moments : (10, N) float64, added to
    """
    sums, columns, references_raw, codes, counts = room
    tiles = tile_stop - tile_start
    find_references(
        raw, lowest, highest, scale, offset, True, row_start, row_stop, tile_start, tile_stop, tile_width,
        references_raw, references,
    )  # fmt: skip
    # More than one turn only where a tile is wider than a strip.
    start, last = tile_start * tile_width, min(tile_stop * tile_width, raw.shape[1])
    step_u = step_of_columns(u, start, last, tile_width)
    for left in range(start, last, COLUMNS):
        span, count = columns_in_strip(left, last, tile_width, raw.shape[1])
        spread_to_columns(references, tiles, span, columns[0])
        for entry in range(3):
            for i in range(max(count, tiles * span)):
                sums[entry, i] = 0.0
        for band in range(row_start, row_stop, BAND_ROWS):
            band_stop = min(band + BAND_ROWS, row_stop)
            for i in range(max(count, tiles * span)):
                codes[i] = NO_CODE
            add_range_rows(
                raw, lowest, highest, scale, offset, v, band, band_stop, left, count,
                columns[0], sums, codes,
            )  # fmt: skip
            add_missing(codes, u[left:], step_u, v[band:band_stop], tiles, span, counts, columns[1], moments)
        fold_range_columns(sums, u[left:], tiles, span, moments)


@kernel(inline=True)
def columns_in_strip(left, last, tile_width, width):
    """Columns of each tile from ``left`` on, and how many of the image to read for those up to ``last``."""
    right = min(left + COLUMNS, last)
    # Whole vectors: the sums of a few columns more are not looked at.
    return tile_width if tile_width <= COLUMNS else right - left, min(
        (right - left + 7) // 8 * 8, width - left
    )


@kernel(inline=True)
def step_of_columns(u, start, last, tile_width):
    """How much tanθx differs between neighbouring columns, from those of one tile."""
    size = min(tile_width, last - start)
    return (u[start + size - 1] - u[start]) / max(size - 1, 1)


@kernel(inline=True)
def strip_room(raw):
    """Room for sums of columns, references of columns and tiles, counts of missing pixels."""
    return (
        np.empty((10, COLUMNS)),
        np.zeros((3, COLUMNS + 8)),
        np.empty(TILES, raw.dtype),
        np.empty(COLUMNS, np.uint64),
        np.empty((3, TILES), np.uint64),
    )


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


@kernel(inline=True)
def fold_columns(sums, tiles, span, moments):
    """Add columns, ``span`` a tile, to the ten sums of their tiles."""
    for entry in range(10):
        fold(sums[entry], tiles, span, moments[entry])


@kernel(reduction=True, inline=True)
def fold(columns, tiles, span, sums):
    """Add up the columns of each tile."""
    for tile in range(tiles):
        total = 0.0
        for column in range(span):
            total += columns[tile * span + column]
        sums[tile] += total


@kernel(inline=True)
def range_strip(
    raw, lowest, highest, scale, offset, tan_x, tan_y, tile_width, centre,
    row_start, row_stop, tile_start, tile_stop, room, references, moments,
):  # fmt: skip
    """Range-space sums as in `range_strip_separable`, for any camera: tan_x, tan_y are (H, W).

    ``centre`` (2, N) are the central rays of the tiles.
    """
    sums, columns, references_raw = room[:3]
    tiles = tile_stop - tile_start
    find_references(
        raw, lowest, highest, scale, offset, True, row_start, row_stop, tile_start, tile_stop, tile_width,
        references_raw, references,
    )  # fmt: skip
    last = min(tile_stop * tile_width, raw.shape[1])
    for left in range(tile_start * tile_width, last, COLUMNS):
        span, count = columns_in_strip(left, last, tile_width, raw.shape[1])
        for axis in range(2):
            spread_to_columns(centre[axis], tiles, span, columns[axis])
        spread_to_columns(references, tiles, span, columns[2])
        for entry in range(10):
            for i in range(max(count, tiles * span)):
                sums[entry, i] = 0.0
        add_range_rows_of_rays(
            raw, lowest, highest, scale, offset, tan_x, tan_y, row_start, row_stop, left, count, columns, sums
        )
        fold_columns(sums, tiles, span, moments)


@kernel(inline=True)
def depths(a, b, scale, offset):
    """Depths of two raw values, for one division at most."""
    if offset is None:
        metres = 1.0 / scale
        return metres * a, metres * b
    qa = scale * a + offset
    qb = scale * b + offset
    inverse = 1.0 / (qa * qb)
    return qb * inverse, qa * inverse


@kernel(inline=True)
def standard_pair(
    a, b, lowest, highest, lowest_b, highest_b, scale, offset, va, vb, code_a, code_b, reference_z
):  # fmt: skip
    """Σz, Σzv, Σzvv, Σzz, Σzzv, Σzzvv and the codes of the missing ones of two pixels of a column."""
    valid_a = (a >= lowest) & (a <= highest)
    valid_b = (b >= lowest_b) & (b <= highest_b)
    za, zb = depths(np.float64(a if valid_a else lowest), np.float64(b if valid_b else lowest), scale, offset)
    za = za - reference_z if valid_a else 0.0
    zb = zb - reference_z if valid_b else 0.0
    zva, zvb = za * va, zb * vb
    missing = (NO_CODE if valid_a else code_a) + (NO_CODE if valid_b else code_b)
    return (
        za + zb,
        zva + zvb,
        zva * va + zvb * vb,
        za * za + zb * zb,
        za * zva + zb * zvb,
        zva * zva + zvb * zvb,
        missing,
    )


@kernel(reduction=True, inline=True)
def add_two_standard_rows(
    raw, lowest, highest, scale, offset, v, row, row_stop, k, left, count,
    reference_z, sums, codes,
):  # fmt: skip
    """Add two image rows, see `add_standard_rows`; the second may be missing."""
    sum_z, sum_zv, sum_zvv, sum_zz, sum_zzv, sum_zzvv = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
    last, low, high = last_of_rows(raw, row + 1, row_stop, lowest, highest)
    a, b = raw[row, left : left + count], raw[last, left : left + count]
    va, vb = v[row], v[last]
    code_a, code_b = ROW_CODES[k], ROW_CODES[k + 1 if row + 1 < row_stop else BAND_ROWS]
    for i in range(count):
        z, zv, zvv, zz, zzv, zzvv, missing = standard_pair(
            a[i], b[i], lowest, highest, low, high, scale, offset, va, vb, code_a, code_b,
            reference_z[i],
        )  # fmt: skip
        sum_z[i] += z
        sum_zv[i] += zv
        sum_zvv[i] += zvv
        sum_zz[i] += zz
        sum_zzv[i] += zzv
        sum_zzvv[i] += zzvv
        codes[i] += missing


@kernel(inline=True)
def add_standard_rows(
    raw, lowest, highest, scale, offset, v, row_start, row_stop, left, count,
    reference_z, sums, codes,
):  # fmt: skip
    """Add a band of image rows to the sums of their columns: as `add_range_rows`.

    ``sums`` (6, COLUMNS) are Σz, Σzv, Σzvv, Σzz, Σzzv, Σzzvv; z is relative to ``reference_z``.
    """
    for row in range(row_start, row_stop, 2):
        add_two_standard_rows(
            raw, lowest, highest, scale, offset, v, row, row_stop, row - row_start, left, count,
            reference_z, sums, codes,
        )  # fmt: skip


@kernel(reduction=True, inline=True)
def fold_twice(columns, u, tiles, span, sums):
    """Sums of each tile's columns, once and times u, are added to ``sums`` (2, TILES)."""
    for tile in range(tiles):
        total = by_u = 0.0
        for column in range(span):
            i = tile * span + column
            total += columns[i]
            by_u += columns[i] * u[i]
        sums[0, tile] += total
        sums[1, tile] += by_u


@kernel(reduction=True, inline=True)
def fold_thrice(columns, u, tiles, span, sums):
    """Sums of each tile's columns, once and times u and u², are added to ``sums`` (3, TILES)."""
    for tile in range(tiles):
        total = by_u = by_uu = 0.0
        for column in range(span):
            i = tile * span + column
            by = columns[i] * u[i]
            total += columns[i]
            by_u += by
            by_uu += by * u[i]
        sums[0, tile] += total
        sums[1, tile] += by_u
        sums[2, tile] += by_uu


@kernel(inline=True)
def standard_from_sums(sums, count, reference, moments):
    """Moments of (X, Y, Z) from sums of z, u and v and the camera terms of the valid pixels.

    With z = Z - Z0, u = tanθx - u0 and v = tanθy - v0, a point relative to the reference Z0·(u0, v0, 1) is

        X = Zu + u0·z,    Y = Zv + v0·z,    Z = z,    where Zu = z·u + Z0·u.

    ``sums`` (12, TILES) are those of z, zu, zuu, zz, zzu, zzuu, zv, zvu, zzv, zzvu, zvv and zzvv. The first two rows
    of ``reference`` are u0, v0 on entry, X0, Y0 on return.
    """
    for i in range(count):
        z, zu, zuu, zz, zzu, zzuu = sums[0, i], sums[1, i], sums[2, i], sums[3, i], sums[4, i], sums[5, i]
        zv, zvu, zzv, zzvu, zvv, zzvv = (
            sums[6, i],
            sums[7, i],
            sums[8, i],
            sums[9, i],
            sums[10, i],
            sums[11, i],
        )
        u0, v0, z0 = reference[0, i], reference[1, i], reference[2, i]
        u, v, uu, uv, vv = moments[1, i], moments[2, i], moments[4, i], moments[5, i], moments[7, i]
        # Sums of Zu, Zv and their products.
        x = zu + z0 * u
        y = zv + z0 * v
        xz = zzu + z0 * zu
        yz = zzv + z0 * zv
        xx = zzuu + z0 * (2.0 * zuu + z0 * uu)
        xy = zzvu + z0 * (2.0 * zvu + z0 * uv)
        yy = zzvv + z0 * (2.0 * zvv + z0 * vv)
        moments[1, i] = x + u0 * z
        moments[2, i] = y + v0 * z
        moments[3, i] = z
        moments[4, i] = xx + u0 * (2.0 * xz + u0 * zz)
        moments[5, i] = xy + u0 * yz + v0 * (xz + u0 * zz)
        moments[6, i] = xz + u0 * zz
        moments[7, i] = yy + v0 * (2.0 * yz + v0 * zz)
        moments[8, i] = yz + v0 * zz
        moments[9, i] = zz
        reference[0, i] = z0 * u0
        reference[1, i] = z0 * v0


@kernel(inline=True)
def standard_strip_separable(
    raw, lowest, highest, scale, offset, u, v, tile_width,
    row_start, row_stop, tile_start, tile_stop, room, references, tile_sums, moments,
):  # fmt: skip
    """Sums of a strip of tiles for the moments of (X, Y, Z), for a camera without lens distortion.

    As `range_strip_separable`, but depth is Z = raw / scale, or 1 / (scale * raw + offset), and every entry depends
    on the frame (the paper's eq. XYZ_scattermatrix). ``moments`` get the sums over missing pixels, and ``tile_sums``
    (12, N) those of which `standard_from_sums` makes the rest.
    """
    sums, columns, references_raw, codes, counts = room
    tiles = tile_stop - tile_start
    find_references(
        raw, lowest, highest, scale, offset, False, row_start, row_stop, tile_start, tile_stop, tile_width,
        references_raw, references,
    )  # fmt: skip
    start, last = tile_start * tile_width, min(tile_stop * tile_width, raw.shape[1])
    step_u = step_of_columns(u, start, last, tile_width)
    for left in range(start, last, COLUMNS):
        span, count = columns_in_strip(left, last, tile_width, raw.shape[1])
        spread_to_columns(references, tiles, span, columns[0])
        for entry in range(6):
            for i in range(max(count, tiles * span)):
                sums[entry, i] = 0.0
        for band in range(row_start, row_stop, BAND_ROWS):
            band_stop = min(band + BAND_ROWS, row_stop)
            for i in range(max(count, tiles * span)):
                codes[i] = NO_CODE
            add_standard_rows(
                raw, lowest, highest, scale, offset, v, band, band_stop, left, count,
                columns[0], sums, codes,
            )  # fmt: skip
            add_missing(codes, u[left:], step_u, v[band:band_stop], tiles, span, counts, columns[1], moments)
        fold_thrice(sums[0], u[left:], tiles, span, tile_sums[0:])
        fold_thrice(sums[3], u[left:], tiles, span, tile_sums[3:])
        fold_twice(sums[1], u[left:], tiles, span, tile_sums[6:])
        fold_twice(sums[4], u[left:], tiles, span, tile_sums[8:])
        fold(sums[2], tiles, span, tile_sums[10])
        fold(sums[5], tiles, span, tile_sums[11])


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


@kernel(inline=True)
def standard_strip(
    raw, lowest, highest, scale, offset, tan_x, tan_y, tile_width, centre,
    row_start, row_stop, tile_start, tile_stop, room, reference, moments,
):  # fmt: skip
    """Moments of (X, Y, Z) of a strip of tiles, for any camera: tan_x, tan_y are (H, W).

    ``centre`` (2, N) are the central rays of the tiles; ``reference`` (3, N) is written, all of it.
    """
    sums, columns, references_raw = room[:3]
    tiles = tile_stop - tile_start
    find_references(
        raw, lowest, highest, scale, offset, False, row_start, row_stop, tile_start, tile_stop, tile_width,
        references_raw, reference[2],
    )  # fmt: skip
    for axis in range(2):
        for i in range(tiles):
            reference[axis, i] = reference[2, i] * centre[axis, i]
    last = min(tile_stop * tile_width, raw.shape[1])
    for left in range(tile_start * tile_width, last, COLUMNS):
        span, count = columns_in_strip(left, last, tile_width, raw.shape[1])
        for axis in range(3):
            spread_to_columns(reference[axis], tiles, span, columns[axis])
        for entry in range(10):
            for i in range(max(count, tiles * span)):
                sums[entry, i] = 0.0
        add_standard_rows_of_rays(
            raw, lowest, highest, scale, offset, tan_x, tan_y, row_start, row_stop, left, count, columns, sums
        )
        fold_columns(sums, tiles, span, moments)


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
