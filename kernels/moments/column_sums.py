"""Sums down the columns of some image rows, and from columns to tiles, for a camera without lens distortion.

tanθx depends on the column alone there, and tanθy on the row alone. A column adds up what depends on the row; columns
are multiplied by tanθx once, when they are folded into tiles.

Several rows are read at a time. The accumulators' loads and stores would otherwise cost more than the arithmetic, and
one division gives the inverse of two depths: 1/a = b/(ab) and 1/b = a/(ab). Rows that are read together lie a quarter
or half of the band apart. Each of them goes on where the one before it ended, so that the processor prefetches it from
memory, as it would not for neighbours.
"""

from .._jit.kernel import kernel
from .camera_terms import NO_CODE, ROW_CODES
from .pixel_pairs import BOTH, read_pair
from .strips import fold


@kernel(reduction=True, inline=True)
def range_pair(pixels, is_pair, limits, scale, offset, v, codes, reference):
    """Σq, Σqv, Σqq and codes of the valid ones among two pixels of a column, or of the first alone."""
    valid_a, valid_b, qa, qb = read_pair(pixels, is_pair, limits, scale, offset, None)
    va, vb = v
    code_a, code_b = codes
    qa = qa - reference if valid_a else 0.0
    qb = qb - reference if valid_b else 0.0
    valid = (code_a if valid_a else NO_CODE) + (code_b if valid_b else NO_CODE)
    return qa + qb, qa * va + qb * vb, qa * qa + qb * qb, valid


@kernel(inline=True)
def standard_pair(pixels, is_pair, limits, scale, offset, v, codes, reference):
    """Σz, Σzv, Σzvv, Σzz, Σzzv, Σzzvv and codes of the valid ones among two pixels of a column, or of the first."""
    valid_a, valid_b, za, zb = read_pair(pixels, is_pair, limits, scale, offset, True)
    va, vb = v
    code_a, code_b = codes
    za = za - reference if valid_a else 0.0
    zb = zb - reference if valid_b else 0.0
    zva, zvb = za * va, zb * vb
    valid = (code_a if valid_a else NO_CODE) + (code_b if valid_b else NO_CODE)
    return (
        za + zb,
        zva + zvb,
        zva * va + zvb * vb,
        za * za + zb * zb,
        za * zva + zb * zvb,
        zva * zva + zvb * zvb,
        valid,
    )


@kernel(inline=True)
def add_two_range_rows(frame, offset, v, rows, columns, reference, sums, codes):
    """Add two neighbouring image rows, of which the second may be missing.

    ``rows`` are the first of them, the one after the band's last, and the first one's number in the band.
    """
    raw, lowest, highest, scale = frame
    row, row_stop, k = rows
    left, count = columns
    sum_q, sum_qv, sum_qq = sums[0], sums[1], sums[2]
    is_pair = row + 1 < row_stop
    other = row + 1 if is_pair else row
    a, b = raw[row, left : left + count], raw[other, left : left + count]
    va, vb = v[row], v[other]
    code_a, code_b = ROW_CODES[k], ROW_CODES[k + 1]
    for i in range(count):
        q, qv, qq, valid = range_pair(
            (a[i], b[i]), is_pair, (lowest, highest), scale, offset, (va, vb), (code_a, code_b), reference[i]
        )
        sum_q[i] += q
        sum_qv[i] += qv
        sum_qq[i] += qq
        codes[i] += valid


@kernel(inline=True)
def add_four_range_rows(frame, offset, v, rows, columns, reference, sums, codes):
    """Add four image rows: ``rows`` are the first of them, its number in the band, and how far they are apart."""
    raw, lowest, highest, scale = frame
    row, k, apart = rows
    left, count = columns
    sum_q, sum_qv, sum_qq = sums[0], sums[1], sums[2]
    row_b, row_c, row_d = row + apart, row + 2 * apart, row + 3 * apart
    a, b = raw[row, left : left + count], raw[row_b, left : left + count]
    c, d = raw[row_c, left : left + count], raw[row_d, left : left + count]
    va, vb, vc, vd = v[row], v[row_b], v[row_c], v[row_d]
    code_a, code_b = ROW_CODES[k], ROW_CODES[k + apart]
    code_c, code_d = ROW_CODES[k + 2 * apart], ROW_CODES[k + 3 * apart]
    for i in range(count):
        q, qv, qq, valid = range_pair(
            (a[i], b[i]), BOTH, (lowest, highest), scale, offset, (va, vb), (code_a, code_b), reference[i]
        )
        q_, qv_, qq_, valid_ = range_pair(
            (c[i], d[i]), BOTH, (lowest, highest), scale, offset, (vc, vd), (code_c, code_d), reference[i]
        )
        sum_q[i] += q + q_
        sum_qv[i] += qv + qv_
        sum_qq[i] += qq + qq_
        codes[i] += valid + valid_


@kernel(reduction=True, inline=True)
def add_range_rows(frame, offset, v, rows, columns, reference, sums, codes):
    """Add a band of image rows to the range-space sums of their columns.

    Parameters
    ----------
    frame, offset
        The frame (H, W), its lowest and highest valid raw values, and scale: q = scale / raw, or
        scale * raw + offset unless ``offset`` is None.
    v : (H,) float64
        tanθy of each row, relative to its tile's centre.
    rows : (start, stop)
        At most `BAND_ROWS` image rows.
    columns : (left, count)
        The first column and the number of columns.
    reference : (COLUMNS,) float64
        Inverse depth of the reference of each column's tile.
    sums : (3, COLUMNS) float64, added to
        Σq, Σqv, Σqq of the valid pixels, q relative to ``reference``.
    codes : (COLUMNS,) uint64, added to
        The band's valid pixels, each with the code of its row in `ROW_CODES`.
    """
    row_start, row_stop = rows
    if frame[1] > frame[2]:
        return  # no value is valid
    apart = (row_stop - row_start) // 4
    for k in range(apart):
        add_four_range_rows(frame, offset, v, (row_start + k, k, apart), columns, reference, sums, codes)
    row = row_start + 4 * apart
    while row < row_stop:
        add_two_range_rows(frame, offset, v, (row, row_stop, row - row_start), columns, reference, sums, codes)
        row += 2


@kernel(reduction=True, inline=True)
def add_two_standard_rows(frame, offset, v, rows, columns, reference, sums, codes):
    """Add two image rows, of which the second may be missing.

    ``rows`` are the first of them, the one after the band's last, the first one's number in the band, and how far they
    are apart.
    """
    raw, lowest, highest, scale = frame
    row, row_stop, k, apart = rows
    left, count = columns
    sum_z, sum_zv, sum_zvv, sum_zz, sum_zzv, sum_zzvv = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
    is_pair = row + apart < row_stop
    other = row + apart if is_pair else row
    a, b = raw[row, left : left + count], raw[other, left : left + count]
    va, vb = v[row], v[other]
    code_a, code_b = ROW_CODES[k], ROW_CODES[k + apart]
    for i in range(count):
        z, zv, zvv, zz, zzv, zzvv, valid = standard_pair(
            (a[i], b[i]), is_pair, (lowest, highest), scale, offset, (va, vb), (code_a, code_b), reference[i]
        )
        sum_z[i] += z
        sum_zv[i] += zv
        sum_zvv[i] += zvv
        sum_zz[i] += zz
        sum_zzv[i] += zzv
        sum_zzvv[i] += zzvv
        codes[i] += valid


@kernel(inline=True)
def add_standard_rows(frame, offset, v, rows, columns, reference, sums, codes):
    """Add a band of image rows to the sums of their columns for moments of (X, Y, Z).

    The arguments are those of `add_range_rows`, but for ``sums``: (6, COLUMNS) Σz, Σzv, Σzvv, Σzz, Σzzv, Σzzvv of the
    depths z, relative to ``reference``.
    """
    row_start, row_stop = rows
    if frame[1] > frame[2]:
        return  # no value is valid
    apart = (row_stop - row_start + 1) // 2
    for k in range(apart):
        add_two_standard_rows(
            frame, offset, v, (row_start + k, row_stop, k, apart), columns, reference, sums, codes
        )  # fmt: skip


@kernel(reduction=True, inline=True)
def fold_range_columns(sums, u, tiles, span, moments):
    """Add columns, ``span`` per tile, to those moments of their tiles in range space that depend on the frame."""
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
def fold_standard_columns(sums, u, tiles, span, tile_sums):
    """Add columns to the twelve sums of their tiles from which `standard_from_sums` makes moments of (X, Y, Z)."""
    fold_thrice(sums[0], u, tiles, span, tile_sums[0:])
    fold_thrice(sums[3], u, tiles, span, tile_sums[3:])
    fold_twice(sums[1], u, tiles, span, tile_sums[6:])
    fold_twice(sums[4], u, tiles, span, tile_sums[8:])
    fold(sums[2], tiles, span, tile_sums[10])
    fold(sums[5], tiles, span, tile_sums[11])


@kernel(inline="compiled")
def standard_from_sums(sums, count, reference, moments):
    """Moments of (X, Y, Z) from sums of z, u and v and the camera terms of the valid pixels.

    With z = Z - Z0, u = tanθx - u0 and v = tanθy - v0, a point relative to the reference Z0·(u0, v0, 1) is

        X = Zu + u0·z,    Y = Zv + v0·z,    Z = z,    where Zu = z·u + Z0·u.

    ``sums`` (12, TILES) are of z, zu, zuu, zz, zzu, zzuu, zv, zvu, zzv, zzvu, zvv and zzvv. The first two rows
    of ``reference`` are u0, v0 on entry, X0, Y0 on return.
    """
    for i in range(count):
        z, zu, zuu, zz, zzu, zzuu = sums[0, i], sums[1, i], sums[2, i], sums[3, i], sums[4, i], sums[5, i]
        zv, zvu, zzv, zzvu, zvv, zzvv = (sums[6, i], sums[7, i], sums[8, i], sums[9, i], sums[10, i], sums[11, i])
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
