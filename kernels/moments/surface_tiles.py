"""Moments of the tiles of a grid for a quadratic in inverse depth, in one pass over the frame.

The surface is q = β·φ with φ = (1, u, v, u², uv, v²), where (u, v) is a pixel's ray (tanθx, tanθy) relative to the
tile's central one. Its normal equations hold the 15 sums of uⁱvʲ, i + j <= 4, which are the camera's, and the six sums
of q·φ, which are the frame's; Σq² gives the residual. Sums of missing pixels are subtracted from those of the whole
tile, so that a tile's equations are those of its valid pixels, and the cost is that of the missing ones.
"""

import numpy as np

from .._jit.kernel import kernel
from .pixel_pairs import BOTH, read_pair
from .strips import COLUMNS, columns_in_strip, find_references, spread_to_columns

# Rows of moments: the camera's sums, by their exponents of u and v, and the frame's, of q relative to a reference.
N, U, V, UU, UV, VV, UUU, UUV, UVV, VVV, UUUU, UUUV, UUVV, UVVV, VVVV = range(15)
Q, QU, QV, QUU, QUV, QVV, QQ = range(15, 22)
CAMERA_SUMS, SURFACE_SUMS = 15, 22

# Rows whose valid pixels are marked in one number, a bit for each.
BAND_ROWS = 64
ROW_BITS = np.array([1 << k for k in range(BAND_ROWS)], np.uint64)
NO_BITS = np.uint64(0)
ALL_BITS = np.uint64(2**64 - 1)
ONE = np.uint64(1)
# The place of a number's only bit: its product with a de Bruijn sequence begins differently for each of the 64.
SEQUENCE = np.uint64(0x03F79D71B4CB0A89)
SEQUENCE_SHIFT = np.uint64(58)
PLACES = np.zeros(64, np.int64)
for _place in range(64):
    PLACES[((0x03F79D71B4CB0A89 << _place) & (2**64 - 1)) >> 58] = _place


@kernel(inline=True)
def surface_strip_scratch():
    """Scratch memory: sums of columns, references of columns, marks of valid pixels, and sums of missing ones."""
    columns = np.empty((10, COLUMNS + 8))
    marks = np.empty(COLUMNS + 8, np.uint64)
    columns[:] = 0.0
    return columns[:7], columns[7:], marks, np.empty((5, BAND_ROWS + 1))


@kernel(inline=True)
def place_of(bit):
    """The place of a number's only bit, from 0 to 63."""
    return PLACES[(bit * SEQUENCE) >> SEQUENCE_SHIFT]


@kernel(reduction=True, inline=True)
def surface_pair(pixels, is_pair, limits, scale, offset, v, bits, reference):
    """Σq, Σqv, Σqvv, Σqq and marks of the valid ones among two pixels of a column, or of the first alone.

    ``v`` are tanθy of the two and their squares.
    """
    valid_a, valid_b, qa, qb = read_pair(pixels, is_pair, limits, scale, offset, None)
    va, vb, vva, vvb = v
    bit_a, bit_b = bits
    qa = qa - reference if valid_a else 0.0
    qb = qb - reference if valid_b else 0.0
    valid = (bit_a if valid_a else NO_BITS) | (bit_b if valid_b else NO_BITS)
    return qa + qb, qa * va + qb * vb, qa * vva + qb * vvb, qa * qa + qb * qb, valid


@kernel(inline=True)
def add_two_surface_rows(frame, offset, v, rows, columns, reference, sums, marks):
    """Add two neighbouring image rows, of which the second may be missing.

    ``rows`` are the first of them, the one after the band's last, and the first one's number in the band.
    """
    raw, lowest, highest, scale = frame
    row, row_stop, k = rows
    left, count = columns
    sum_q, sum_qv, sum_qvv, sum_qq = sums[0], sums[1], sums[2], sums[3]
    is_pair = row + 1 < row_stop
    other = row + 1 if is_pair else row
    a, b = raw[row, left : left + count], raw[other, left : left + count]
    va, vb = v[row], v[other]
    vva, vvb = va * va, vb * vb
    bit_a, bit_b = ROW_BITS[k], ROW_BITS[k + 1 if is_pair else k]
    for i in range(count):
        q, qv, qvv, qq, valid = surface_pair(
            (a[i], b[i]), is_pair, (lowest, highest), scale, offset, (va, vb, vva, vvb), (bit_a, bit_b), reference[i]
        )
        sum_q[i] += q
        sum_qv[i] += qv
        sum_qvv[i] += qvv
        sum_qq[i] += qq
        marks[i] |= valid


@kernel(inline=True)
def add_four_surface_rows(frame, offset, v, rows, columns, reference, sums, marks):
    """Add four image rows: ``rows`` are the first of them, its number in the band, and how far they are apart."""
    raw, lowest, highest, scale = frame
    row, k, apart = rows
    left, count = columns
    sum_q, sum_qv, sum_qvv, sum_qq = sums[0], sums[1], sums[2], sums[3]
    row_b, row_c, row_d = row + apart, row + 2 * apart, row + 3 * apart
    a, b = raw[row, left : left + count], raw[row_b, left : left + count]
    c, d = raw[row_c, left : left + count], raw[row_d, left : left + count]
    va, vb, vc, vd = v[row], v[row_b], v[row_c], v[row_d]
    vva, vvb, vvc, vvd = va * va, vb * vb, vc * vc, vd * vd
    bit_a, bit_b = ROW_BITS[k], ROW_BITS[k + apart]
    bit_c, bit_d = ROW_BITS[k + 2 * apart], ROW_BITS[k + 3 * apart]
    for i in range(count):
        q, qv, qvv, qq, valid = surface_pair(
            (a[i], b[i]), BOTH, (lowest, highest), scale, offset, (va, vb, vva, vvb), (bit_a, bit_b), reference[i]
        )
        q_, qv_, qvv_, qq_, valid_ = surface_pair(
            (c[i], d[i]), BOTH, (lowest, highest), scale, offset, (vc, vd, vvc, vvd), (bit_c, bit_d), reference[i]
        )
        sum_q[i] += q + q_
        sum_qv[i] += qv + qv_
        sum_qvv[i] += qvv + qvv_
        sum_qq[i] += qq + qq_
        marks[i] |= valid | valid_


@kernel(reduction=True, inline=True)
def add_surface_rows(frame, offset, v, rows, columns, reference, sums, marks):
    """Add a band of image rows to the sums of their columns.

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
    sums : (4, COLUMNS) float64, added to
        Σq, Σqv, Σqvv and Σqq of the valid pixels.
    marks : (COLUMNS,) uint64, changed
        A bit for each valid pixel of the band, the lowest for its first row.
    """
    row_start, row_stop = rows
    if frame[1] > frame[2]:
        return  # no value is valid
    apart = (row_stop - row_start) // 4
    for k in range(apart):
        add_four_surface_rows(frame, offset, v, (row_start + k, k, apart), columns, reference, sums, marks)
    row = row_start + 4 * apart
    while row < row_stop:
        add_two_surface_rows(frame, offset, v, (row, row_stop, row - row_start), columns, reference, sums, marks)
        row += 2


@kernel(reduction=True, inline=True)
def fold_surface_columns(sums, u, tiles, span, moments):
    """Add the frame's sums of columns, ``span`` per tile, to those of their tiles."""
    sum_q, sum_qv, sum_qvv, sum_qq = sums[0], sums[1], sums[2], sums[3]
    for tile in range(tiles):
        s_q = s_qu = s_qv = s_quu = s_quv = s_qvv = s_qq = 0.0
        for column in range(span):
            i = tile * span + column
            q_u = sum_q[i] * u[i]
            s_q += sum_q[i]
            s_qu += q_u
            s_qv += sum_qv[i]
            s_quu += q_u * u[i]
            s_quv += sum_qv[i] * u[i]
            s_qvv += sum_qvv[i]
            s_qq += sum_qq[i]
        moments[Q, tile] += s_q
        moments[QU, tile] += s_qu
        moments[QV, tile] += s_qv
        moments[QUU, tile] += s_quu
        moments[QUV, tile] += s_quv
        moments[QVV, tile] += s_qvv
        moments[QQ, tile] += s_qq


@kernel(inline=True)
def band_mask(rows):
    """A number with a bit for each row of a band."""
    return ALL_BITS >> np.uint64(BAND_ROWS - rows)


@kernel(inline=True)
def write_difference(missing, tile, moments):
    """Subtract the 15 sums of missing pixels from a tile's, both in the order of the moments."""
    m_1, m_u, m_v, m_uu, m_uv, m_vv, m_uuu, m_uuv, m_uvv, m_vvv, m_uuuu, m_uuuv, m_uuvv, m_uvvv, m_vvvv = missing
    moments[N, tile] -= m_1
    moments[U, tile] -= m_u
    moments[V, tile] -= m_v
    moments[UU, tile] -= m_uu
    moments[UV, tile] -= m_uv
    moments[VV, tile] -= m_vv
    moments[UUU, tile] -= m_uuu
    moments[UUV, tile] -= m_uuv
    moments[UVV, tile] -= m_uvv
    moments[VVV, tile] -= m_vvv
    moments[UUUU, tile] -= m_uuuu
    moments[UUUV, tile] -= m_uuuv
    moments[UUVV, tile] -= m_uuvv
    moments[UVVV, tile] -= m_uvvv
    moments[VVVV, tile] -= m_vvvv


@kernel(inline=True)
def sums_before(v, rows, before):
    """Write Σ1, Σv, Σvv, Σvvv and Σvvvv over the rows of a band before each, and over all."""
    s_1 = s_v = s_vv = s_vvv = s_vvvv = 0.0
    for k in range(rows):
        before[0, k], before[1, k], before[2, k], before[3, k], before[4, k] = s_1, s_v, s_vv, s_vvv, s_vvvv
        square = v[k] * v[k]
        s_1 += 1.0
        s_v += v[k]
        s_vv += square
        s_vvv += square * v[k]
        s_vvvv += square * square
    before[0, rows], before[1, rows], before[2, rows], before[3, rows], before[4, rows] = s_1, s_v, s_vv, s_vvv, s_vvvv


@kernel(inline="compiled")
def subtract_missing(marks, rays, grid, before, moments):
    """Subtract the camera's sums of the missing pixels of a band of rows, for rays that separate.

    Pixels that are missing one below the other are taken together: the cost is that of the runs of missing pixels.

    Parameters
    ----------
    marks : (COLUMNS,) uint64
        A bit for each valid pixel of a column of the band, the lowest for its first row.
    rays : u and v
        tanθx of the columns and tanθy of the band's rows, relative to their tile's centre.
    grid : (tiles, span, columns)
        Number of tiles, columns of each, and columns that the image has of all of them.
    before : (5, BAND_ROWS + 1) float64
        Scratch memory.
    moments : (CAMERA_SUMS or more, N) float64, changed
    """
    u, v = rays
    tiles, span, columns = grid
    rows = len(v)
    full = band_mask(rows)
    sums_before(v, rows, before)
    sum_1, sum_v, sum_vv, sum_vvv, sum_vvvv = before[0], before[1], before[2], before[3], before[4]
    for tile in range(tiles):
        start, stop = tile * span, min(tile * span + span, columns)
        common = full
        for i in range(start, stop):
            common &= marks[i]
        if common == full:
            continue
        m_1 = m_u = m_v = m_uu = m_uv = m_vv = m_uuu = m_uuv = m_uvv = m_vvv = 0.0
        m_uuuu = m_uuuv = m_uuvv = m_uvvv = m_vvvv = 0.0
        for i in range(start, stop):
            missing = full & ~marks[i]
            if missing == NO_BITS:
                continue
            s_1 = s_v = s_vv = s_vvv = s_vvvv = 0.0
            if missing & (missing >> ONE) != NO_BITS:
                while missing != NO_BITS:
                    lowest = missing & (~missing + ONE)
                    # Adding it carries through its run: the bit behind the run appears, unless the band ends there.
                    after = missing + lowest
                    behind = after & ~missing
                    missing &= after
                    a = place_of(lowest)
                    b = place_of(behind) if behind != NO_BITS else rows
                    s_1 += sum_1[b] - sum_1[a]
                    s_v += sum_v[b] - sum_v[a]
                    s_vv += sum_vv[b] - sum_vv[a]
                    s_vvv += sum_vvv[b] - sum_vvv[a]
                    s_vvvv += sum_vvvv[b] - sum_vvvv[a]
            else:
                while missing != NO_BITS:
                    k = place_of(missing & (~missing + ONE))
                    missing &= missing - ONE
                    square = v[k] * v[k]
                    s_1 += 1.0
                    s_v += v[k]
                    s_vv += square
                    s_vvv += square * v[k]
                    s_vvvv += square * square
            x = u[i]
            xx = x * x
            m_1 += s_1
            m_u += s_1 * x
            m_v += s_v
            m_uu += s_1 * xx
            m_uv += s_v * x
            m_vv += s_vv
            m_uuu += s_1 * xx * x
            m_uuv += s_v * xx
            m_uvv += s_vv * x
            m_vvv += s_vvv
            m_uuuu += s_1 * xx * xx
            m_uuuv += s_v * xx * x
            m_uuvv += s_vv * xx
            m_uvvv += s_vvv * x
            m_vvvv += s_vvvv
        write_difference(
            (m_1, m_u, m_v, m_uu, m_uv, m_vv, m_uuu, m_uuv, m_uvv, m_vvv, m_uuuu, m_uuuv, m_uuvv, m_uvvv, m_vvvv),
            tile, moments,
        )  # fmt: skip


@kernel(inline="compiled")
def surface_strip_separable(frame, offset, rays, strip, scratch, references, moments):
    """Sums of a strip of tiles, for a camera without lens distortion.

    Parameters
    ----------
    frame, offset
        The frame (H, W), its lowest and highest valid raw values, and scale: q = scale / raw, or
        scale * raw + offset unless ``offset`` is None.
    rays : (C * tile_width,) and (H,) float64
        tanθx of each column and tanθy of each row, relative to its tile's centre.
    strip : Strip
    scratch
        From `surface_strip_scratch`.
    references : (N,) float64, written
        Inverse depth of the reference of each of the strip's tiles.
    moments : (SURFACE_SUMS, N) float64, changed
        The camera's sums over whole tiles, from which the sums over missing pixels are subtracted. The frame's are
        added.
    """
    width = frame[0].shape[1]
    u, v = rays
    sums, columns, marks, before = scratch
    tiles, tile_width = strip.tile_stop - strip.tile_start, strip.tile_width
    find_references(frame, offset, None, strip, references)
    # More than one pass only where a tile is wider than a strip.
    last = min(strip.tile_stop * tile_width, width)
    for left in range(strip.tile_start * tile_width, last, COLUMNS):
        span, count = columns_in_strip(left, last, tile_width, width)
        spread_to_columns(references, tiles, span, columns[0])
        for entry in range(4):
            for i in range(max(count, tiles * span)):
                sums[entry, i] = 0.0
        for band in range(strip.row_start, strip.row_stop, BAND_ROWS):
            band_stop = min(band + BAND_ROWS, strip.row_stop)
            for i in range(max(count, tiles * span)):
                marks[i] = NO_BITS
            add_surface_rows(frame, offset, v, (band, band_stop), (left, count), columns[0], sums, marks)
            subtract_missing(marks, (u[left:], v[band:band_stop]), (tiles, span, last - left), before, moments)
        fold_surface_columns(sums, u[left:], tiles, span, moments)


@kernel(reduction=True, inline=True)
def surface_pair_of_rays(pixels, limits, scale, offset, u, v, reference):
    """Σq, Σqu, Σqv, Σquu, Σquv, Σqvv, Σqq of the valid ones among two pixels of a column, and whether each is."""
    valid_a, valid_b, qa, qb = read_pair(pixels, BOTH, limits, scale, offset, None)
    ua, ub = u
    va, vb = v
    qa = qa - reference if valid_a else 0.0
    qb = qb - reference if valid_b else 0.0
    qua, qub, qva, qvb = qa * ua, qb * ub, qa * va, qb * vb
    return (
        qa + qb,
        qua + qub,
        qva + qvb,
        qua * ua + qub * ub,
        qua * va + qub * vb,
        qva * va + qvb * vb,
        qa * qa + qb * qb,
        valid_a,
        valid_b,
    )


@kernel(reduction=True, inline=True)
def add_surface_rows_of_rays(frame, offset, rays, rows, columns, reference, sums, marks):
    """Add a band of image rows to the sums of its columns, for rays that differ from pixel to pixel.

    The arguments are those of `add_surface_rows`, but for ``rays``, tan_x and tan_y (H, W); ``reference``
    (3, COLUMNS), each column's reference point; and ``sums`` (7, COLUMNS), the frame's in their order.
    """
    raw, lowest, highest, scale = frame
    tan_x, tan_y = rays
    row_start, row_stop = rows
    left, count = columns
    if lowest > highest:
        return  # no value is valid
    u0, v0, q0 = reference[0], reference[1], reference[2]
    apart = (row_stop - row_start + 1) // 2
    for row in range(row_start, row_start + apart):
        is_pair = row + apart < row_stop
        other = row + apart if is_pair else row
        bit_a = ROW_BITS[row - row_start]
        bit_b = ROW_BITS[other - row_start] if is_pair else NO_BITS
        once = 1.0 if is_pair else 0.5  # a row that is its own partner counts once
        a, b = raw[row, left : left + count], raw[other, left : left + count]
        tan_xa, tan_xb = tan_x[row, left : left + count], tan_x[other, left : left + count]
        tan_ya, tan_yb = tan_y[row, left : left + count], tan_y[other, left : left + count]
        for i in range(count):
            q, qu, qv, quu, quv, qvv, qq, valid_a, valid_b = surface_pair_of_rays(
                (a[i], b[i]), (lowest, highest), scale, offset, (tan_xa[i] - u0[i], tan_xb[i] - u0[i]),
                (tan_ya[i] - v0[i], tan_yb[i] - v0[i]), q0[i],
            )  # fmt: skip
            sums[0, i] += once * q
            sums[1, i] += once * qu
            sums[2, i] += once * qv
            sums[3, i] += once * quu
            sums[4, i] += once * quv
            sums[5, i] += once * qvv
            sums[6, i] += once * qq
            marks[i] |= (bit_a if valid_a else NO_BITS) | (bit_b if valid_b else NO_BITS)


@kernel(inline="compiled")
def subtract_missing_rays(marks, rays, centre, grid, band, left, moments):
    """Subtract the camera's sums of the missing pixels of a band of rows, for any rays.

    Parameters
    ----------
    marks : (COLUMNS,) uint64
        A bit for each valid pixel of a column of the band, the lowest for its first row.
    rays : tan_x, tan_y, (H, W) float64 each
    centre : (2, N) float64
        The tiles' central rays.
    grid : (tiles, span, columns)
        Number of tiles, columns of each, and columns that the image has of all of them.
    band : (row, rows)
        The first row of the band, and their number.
    left : int
        The first column.
    moments : (CAMERA_SUMS or more, N) float64, changed
    """
    tan_x, tan_y = rays
    tiles, span, columns = grid
    row, rows = band
    full = band_mask(rows)
    for tile in range(tiles):
        start, stop = tile * span, min(tile * span + span, columns)
        common = full
        for i in range(start, stop):
            common &= marks[i]
        if common == full:
            continue
        u0, v0 = centre[0, tile], centre[1, tile]
        m_1 = m_u = m_v = m_uu = m_uv = m_vv = m_uuu = m_uuv = m_uvv = m_vvv = 0.0
        m_uuuu = m_uuuv = m_uuvv = m_uvvv = m_vvvv = 0.0
        for i in range(start, stop):
            missing = full & ~marks[i]
            while missing != NO_BITS:
                k = row + place_of(missing & (~missing + ONE))
                missing &= missing - ONE
                u, v = tan_x[k, left + i] - u0, tan_y[k, left + i] - v0
                uu, uv, vv = u * u, u * v, v * v
                m_1 += 1.0
                m_u += u
                m_v += v
                m_uu += uu
                m_uv += uv
                m_vv += vv
                m_uuu += uu * u
                m_uuv += uu * v
                m_uvv += uv * v
                m_vvv += vv * v
                m_uuuu += uu * uu
                m_uuuv += uu * uv
                m_uuvv += uv * uv
                m_uvvv += uv * vv
                m_vvvv += vv * vv
        write_difference(
            (m_1, m_u, m_v, m_uu, m_uv, m_vv, m_uuu, m_uuv, m_uvv, m_vvv, m_uuuu, m_uuuv, m_uuvv, m_uvvv, m_vvvv),
            tile, moments,
        )  # fmt: skip


@kernel(inline="compiled")
def surface_strip(frame, offset, rays, centre, strip, scratch, references, moments):
    """Sums of a strip of tiles, for any camera.

    The arguments are those of `surface_strip_separable`, but for ``rays``, tan_x and tan_y (H, W), and ``centre``
    (2, N), the central rays of the tiles.
    """
    width = frame[0].shape[1]
    sums, columns, marks = scratch[:3]
    tiles, tile_width = strip.tile_stop - strip.tile_start, strip.tile_width
    find_references(frame, offset, None, strip, references)
    last = min(strip.tile_stop * tile_width, width)
    for left in range(strip.tile_start * tile_width, last, COLUMNS):
        span, count = columns_in_strip(left, last, tile_width, width)
        for axis in range(2):
            spread_to_columns(centre[axis], tiles, span, columns[axis])
        spread_to_columns(references, tiles, span, columns[2])
        for entry in range(7):
            for i in range(max(count, tiles * span)):
                sums[entry, i] = 0.0
        for band in range(strip.row_start, strip.row_stop, BAND_ROWS):
            band_stop = min(band + BAND_ROWS, strip.row_stop)
            for i in range(max(count, tiles * span)):
                marks[i] = NO_BITS
            add_surface_rows_of_rays(frame, offset, rays, (band, band_stop), (left, count), columns, sums, marks)
            subtract_missing_rays(
                marks, rays, centre, (tiles, span, last - left), (band, band_stop - band), left, moments
            )  # fmt: skip
        for tile in range(tiles):
            for entry in range(7):
                total = 0.0
                for column in range(span):
                    total += sums[entry, tile * span + column]
                moments[CAMERA_SUMS + entry, tile] += total
