"""Moments of the tiles of a grid in range space, in one pass over the frame: the ``direct`` implementation.

A pixel is a triple (u, v, q): (tanθx, tanθy, 1/Z). A tile's moments are the ten sums [n, Σu, Σv, Σq, Σuu, Σuv, Σuq,
Σvv, Σvq, Σqq] over its valid pixels, of coordinates taken relative to a reference point of the tile, so that nothing
cancels later. Without lens distortion only those with q come from the frame; the others are in `camera_terms`.

For a camera without lens distortion tanθx depends on the column alone and tanθy on the row alone: columns are
multiplied by tanθx once, when they are folded into tiles. Four rows are read at a time, two at the end: the
accumulators' loads and stores would otherwise cost more than the arithmetic, and one division gives the inverse of
two depths, 1/a = b/(ab) and 1/b = a/(ab). The four are a quarter of the tile, or of a band of its rows, apart, so that
each of them goes on where the one before it ended and the processor prefetches it from memory, as it would not for
neighbours.
"""

import numpy as np

from .._jit.kernel import kernel
from .camera_terms import BAND_ROWS, NO_CODE, ROW_CODES, add_valid
from .strips import (
    COLUMNS,
    clip,
    columns_in_strip,
    find_references,
    fold_columns,
    spread_to_columns,
    step_of_columns,
    sums_of_pair,
)

# Of the type of a comparison: for the literal True Numba would compile once more.
BOTH = np.bool_(True)


@kernel(inline=True)
def inverse_depths(a, b, scale, offset):
    """Inverse depths of two raw values, with one division."""
    if offset is None:
        inverse = scale / (a * b)
        return b * inverse, a * inverse
    return scale * a + offset, scale * b + offset


@kernel(reduction=True, inline=True)
def range_pair(a, b, is_pair, lowest, highest, scale, offset, va, vb, code_a, code_b, reference_q):
    """Σq, Σqv, Σqq and codes of the valid ones among two pixels of a column, or of the first alone."""
    clipped_a, clipped_b = clip(a, lowest, highest), clip(b, lowest, highest)
    valid_a, valid_b = clipped_a == a, (clipped_b == b) & is_pair
    qa, qb = inverse_depths(np.float64(clipped_a), np.float64(clipped_b), scale, offset)
    qa = qa - reference_q if valid_a else 0.0
    qb = qb - reference_q if valid_b else 0.0
    valid = (code_a if valid_a else NO_CODE) + (code_b if valid_b else NO_CODE)
    return qa + qb, qa * va + qb * vb, qa * qa + qb * qb, valid


@kernel(inline=True)
def add_two_range_rows(
    raw, lowest, highest, scale, offset, v, row, row_stop, k, left, count,
    reference_q, sums, codes,
):  # fmt: skip
    """Add two image rows, see `add_range_rows`; the second may be missing."""
    sum_q, sum_qv, sum_qq = sums[0], sums[1], sums[2]
    is_pair = row + 1 < row_stop
    other = row + 1 if is_pair else row
    a, b = raw[row, left : left + count], raw[other, left : left + count]
    va, vb = v[row], v[other]
    code_a, code_b = ROW_CODES[k], ROW_CODES[k + 1]
    for i in range(count):
        q, qv, qq, valid = range_pair(
            a[i], b[i], is_pair, lowest, highest, scale, offset, va, vb, code_a, code_b, reference_q[i]
        )
        sum_q[i] += q
        sum_qv[i] += qv
        sum_qq[i] += qq
        codes[i] += valid


@kernel(inline=True)
def add_four_range_rows(raw, lowest, highest, scale, offset, v, row, k, apart, left, count, reference_q, sums, codes):
    """Add four image rows, ``apart`` from one another, see `add_range_rows`."""
    sum_q, sum_qv, sum_qq = sums[0], sums[1], sums[2]
    row_b, row_c, row_d = row + apart, row + 2 * apart, row + 3 * apart
    a, b = raw[row, left : left + count], raw[row_b, left : left + count]
    c, d = raw[row_c, left : left + count], raw[row_d, left : left + count]
    va, vb, vc, vd = v[row], v[row_b], v[row_c], v[row_d]
    code_a, code_b = ROW_CODES[k], ROW_CODES[k + apart]
    code_c, code_d = ROW_CODES[k + 2 * apart], ROW_CODES[k + 3 * apart]
    for i in range(count):
        q, qv, qq, valid = range_pair(
            a[i], b[i], BOTH, lowest, highest, scale, offset, va, vb, code_a, code_b, reference_q[i]
        )
        q_, qv_, qq_, valid_ = range_pair(
            c[i], d[i], BOTH, lowest, highest, scale, offset, vc, vd, code_c, code_d, reference_q[i]
        )
        sum_q[i] += q + q_
        sum_qv[i] += qv + qv_
        sum_qq[i] += qq + qq_
        codes[i] += valid + valid_


@kernel(reduction=True, inline=True)
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
        The band's valid pixels, see `ROW_CODES`.
    """
    if lowest > highest:
        return  # no value is valid
    apart = (row_stop - row_start) // 4
    for k in range(apart):
        add_four_range_rows(
            raw, lowest, highest, scale, offset, v, row_start + k, k, apart, left, count,
            reference_q, sums, codes,
        )  # fmt: skip
    row = row_start + 4 * apart
    while row < row_stop:
        add_two_range_rows(
            raw, lowest, highest, scale, offset, v, row, row_stop, row - row_start, left, count,
            reference_q, sums, codes,
        )  # fmt: skip
        row += 2


@kernel(reduction=True, inline=True)
def fold_range_columns(sums, u, tiles, span, moments):
    """Add columns, ``span`` per tile, to the sums of their tiles."""
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


@kernel(inline="compiled")
def range_strip_separable(
    raw, lowest, highest, scale, offset, u, v, tile_width,
    row_start, row_stop, tile_start, tile_stop, room, references, moments,
):  # fmt: skip
    """Range-space sums of a strip of tiles, for a camera without lens distortion.

    Only Σq, Σq·tanθx, Σq·tanθy and Σq² come from the frame (the paper's eq. 14). For the other entries it is enough to
    know which pixels are valid.

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
        See `strips.strip_room`.
    references : (N,) float64, written
        Inverse depth of the reference of each of the strip's tiles.
    moments : (10, N) float64, added to
    """
    sums, columns, codes, counts = room
    tiles = tile_stop - tile_start
    find_references(
        raw, lowest, highest, scale, offset, True, row_start, row_stop, tile_start, tile_stop, tile_width,
        references,
    )  # fmt: skip
    # More than one pass only where a tile is wider than a strip.
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
            add_valid(codes, u[left:], step_u, v[band:band_stop], tiles, span, counts, columns[1], moments)
        fold_range_columns(sums, u[left:], tiles, span, moments)


@kernel(reduction=True, inline=True)
def range_pair_of_rays(
    a, b, is_pair, lowest, highest, scale, offset, tan_xa, tan_xb, tan_ya, tan_yb, u0, v0, q0
):  # fmt: skip
    """The ten sums of the valid ones among two pixels of a column, or of the first alone."""
    clipped_a, clipped_b = clip(a, lowest, highest), clip(b, lowest, highest)
    valid_a, valid_b = clipped_a == a, (clipped_b == b) & is_pair
    qa, qb = inverse_depths(np.float64(clipped_a), np.float64(clipped_b), scale, offset)
    return sums_of_pair(valid_a, valid_b, tan_xa - u0, tan_xb - u0, tan_ya - v0, tan_yb - v0, qa - q0, qb - q0)


@kernel(inline=True)
def add_two_range_rows_of_rays(
    raw, lowest, highest, scale, offset, tan_x, tan_y, row, row_stop, left, count, columns, sums
):
    """Add two image rows, see `add_range_rows_of_rays`; the second may be missing."""
    is_pair = row + 1 < row_stop
    other = row + 1 if is_pair else row
    a, b = raw[row, left : left + count], raw[other, left : left + count]
    tan_xa, tan_xb = tan_x[row, left : left + count], tan_x[other, left : left + count]
    tan_ya, tan_yb = tan_y[row, left : left + count], tan_y[other, left : left + count]
    u0, v0, q0 = columns[0], columns[1], columns[2]
    for i in range(count):
        n, u, v, q, uu, uv, qu, vv, qv, qq = range_pair_of_rays(
            a[i], b[i], is_pair, lowest, highest, scale, offset,
            tan_xa[i], tan_xb[i], tan_ya[i], tan_yb[i], u0[i], v0[i], q0[i],
        )  # fmt: skip
        sums[0, i] += n
        sums[1, i] += u
        sums[2, i] += v
        sums[3, i] += q
        sums[4, i] += uu
        sums[5, i] += uv
        sums[6, i] += qu
        sums[7, i] += vv
        sums[8, i] += qv
        sums[9, i] += qq


@kernel(inline=True)
def add_four_range_rows_of_rays(
    raw, lowest, highest, scale, offset, tan_x, tan_y, row, apart, left, count, columns, sums
):
    """Add four image rows, ``apart`` from one another, see `add_range_rows_of_rays`."""
    row_b, row_c, row_d = row + apart, row + 2 * apart, row + 3 * apart
    a, b = raw[row, left : left + count], raw[row_b, left : left + count]
    c, d = raw[row_c, left : left + count], raw[row_d, left : left + count]
    tan_xa, tan_xb = tan_x[row, left : left + count], tan_x[row_b, left : left + count]
    tan_xc, tan_xd = tan_x[row_c, left : left + count], tan_x[row_d, left : left + count]
    tan_ya, tan_yb = tan_y[row, left : left + count], tan_y[row_b, left : left + count]
    tan_yc, tan_yd = tan_y[row_c, left : left + count], tan_y[row_d, left : left + count]
    u0, v0, q0 = columns[0], columns[1], columns[2]
    for i in range(count):
        n, u, v, q, uu, uv, qu, vv, qv, qq = range_pair_of_rays(
            a[i], b[i], BOTH, lowest, highest, scale, offset,
            tan_xa[i], tan_xb[i], tan_ya[i], tan_yb[i], u0[i], v0[i], q0[i],
        )  # fmt: skip
        n_, u_, v_, q_, uu_, uv_, qu_, vv_, qv_, qq_ = range_pair_of_rays(
            c[i], d[i], BOTH, lowest, highest, scale, offset,
            tan_xc[i], tan_xd[i], tan_yc[i], tan_yd[i], u0[i], v0[i], q0[i],
        )  # fmt: skip
        sums[0, i] += n + n_
        sums[1, i] += u + u_
        sums[2, i] += v + v_
        sums[3, i] += q + q_
        sums[4, i] += uu + uu_
        sums[5, i] += uv + uv_
        sums[6, i] += qu + qu_
        sums[7, i] += vv + vv_
        sums[8, i] += qv + qv_
        sums[9, i] += qq + qq_


@kernel(reduction=True, inline=True)
def add_range_rows_of_rays(
    raw, lowest, highest, scale, offset, tan_x, tan_y, row_start, row_stop, left, count, columns, sums
):
    """Add image rows to the sums of their columns, for rays that differ from pixel to pixel.

    ``columns`` (3, COLUMNS) holds each column's reference point; ``sums`` (10, COLUMNS) are in the order of the
    moments.
    """
    if lowest > highest:
        return  # no value is valid
    apart = (row_stop - row_start) // 4
    for row in range(row_start, row_start + apart):
        add_four_range_rows_of_rays(
            raw, lowest, highest, scale, offset, tan_x, tan_y, row, apart, left, count, columns, sums
        )
    row = row_start + 4 * apart
    while row < row_stop:
        add_two_range_rows_of_rays(
            raw, lowest, highest, scale, offset, tan_x, tan_y, row, row_stop, left, count, columns, sums
        )
        row += 2


@kernel(inline="compiled")
def range_strip(
    raw, lowest, highest, scale, offset, tan_x, tan_y, tile_width, centre,
    row_start, row_stop, tile_start, tile_stop, room, references, moments,
):  # fmt: skip
    """Range-space sums as in `range_strip_separable`, for any camera: tan_x, tan_y are (H, W).

    ``centre`` (2, N) holds the central rays of the tiles.
    """
    sums, columns = room[:2]
    tiles = tile_stop - tile_start
    find_references(
        raw, lowest, highest, scale, offset, True, row_start, row_stop, tile_start, tile_stop, tile_width,
        references,
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
