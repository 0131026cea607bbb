"""Sums down the columns of some image rows for any camera: rays differ from pixel to pixel.

As in `column_sums`, rows that are read together lie a quarter or half of the tile apart. All ten sums of a column
depend on the frame: the rays of the valid pixels have to be added up, too.
"""

from .._jit.kernel import kernel
from .pixel_pairs import BOTH, pair_of_rays


@kernel(inline=True)
def add_two_rows(frame, offset, standard, rays, rows, columns, reference, sums):
    """Add two image rows, of which the second may be missing.

    ``rows`` are the first of them, how far they are apart, and the one after the tile's last.
    """
    raw, lowest, highest, scale = frame
    tan_x, tan_y = rays
    row, apart, row_stop = rows
    left, count = columns
    is_pair = row + apart < row_stop
    other = row + apart if is_pair else row
    a, b = raw[row, left : left + count], raw[other, left : left + count]
    tan_xa, tan_xb = tan_x[row, left : left + count], tan_x[other, left : left + count]
    tan_ya, tan_yb = tan_y[row, left : left + count], tan_y[other, left : left + count]
    u0, v0, w0 = reference[0], reference[1], reference[2]
    for i in range(count):
        n, u, v, w, uu, uv, uw, vv, vw, ww = pair_of_rays(
            (a[i], b[i]), is_pair, (lowest, highest), scale, offset, standard,
            (tan_xa[i], tan_xb[i], tan_ya[i], tan_yb[i]), (u0[i], v0[i], w0[i]),
        )  # fmt: skip
        sums[0, i] += n
        sums[1, i] += u
        sums[2, i] += v
        sums[3, i] += w
        sums[4, i] += uu
        sums[5, i] += uv
        sums[6, i] += uw
        sums[7, i] += vv
        sums[8, i] += vw
        sums[9, i] += ww


@kernel(inline=True)
def add_four_rows(frame, offset, rays, rows, columns, reference, sums):
    """Add four image rows in range space: ``rows`` are the first of them, and how far they are apart."""
    raw, lowest, highest, scale = frame
    tan_x, tan_y = rays
    row, apart = rows
    left, count = columns
    row_b, row_c, row_d = row + apart, row + 2 * apart, row + 3 * apart
    a, b = raw[row, left : left + count], raw[row_b, left : left + count]
    c, d = raw[row_c, left : left + count], raw[row_d, left : left + count]
    tan_xa, tan_xb = tan_x[row, left : left + count], tan_x[row_b, left : left + count]
    tan_xc, tan_xd = tan_x[row_c, left : left + count], tan_x[row_d, left : left + count]
    tan_ya, tan_yb = tan_y[row, left : left + count], tan_y[row_b, left : left + count]
    tan_yc, tan_yd = tan_y[row_c, left : left + count], tan_y[row_d, left : left + count]
    u0, v0, q0 = reference[0], reference[1], reference[2]
    for i in range(count):
        n, u, v, q, uu, uv, qu, vv, qv, qq = pair_of_rays(
            (a[i], b[i]), BOTH, (lowest, highest), scale, offset, None,
            (tan_xa[i], tan_xb[i], tan_ya[i], tan_yb[i]), (u0[i], v0[i], q0[i]),
        )  # fmt: skip
        n_, u_, v_, q_, uu_, uv_, qu_, vv_, qv_, qq_ = pair_of_rays(
            (c[i], d[i]), BOTH, (lowest, highest), scale, offset, None,
            (tan_xc[i], tan_xd[i], tan_yc[i], tan_yd[i]), (u0[i], v0[i], q0[i]),
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
def add_rows(frame, offset, standard, rays, rows, columns, reference, sums):
    """Add image rows to the ten sums of their columns.

    Parameters
    ----------
    frame, offset
        The frame (H, W), its lowest and highest valid raw values, and scale: q = scale / raw, or
        scale * raw + offset unless ``offset`` is None.
    standard
        None for sums of (tanθx, tanθy, q); anything else for sums of (X, Y, Z).
    rays : tan_x, tan_y, (H, W) float64 each
    rows : (start, stop)
    columns : (left, count)
        The first column and the number of columns.
    reference : (3, COLUMNS) float64
        The point that each column's sums are relative to.
    sums : (10, COLUMNS) float64, added to
        In the order of the moments.
    """
    row_start, row_stop = rows
    if frame[1] > frame[2]:
        return  # no value is valid
    if standard is None:
        apart = (row_stop - row_start) // 4
        for row in range(row_start, row_start + apart):
            add_four_rows(frame, offset, rays, (row, apart), columns, reference, sums)
        row = row_start + 4 * apart
        while row < row_stop:
            add_two_rows(frame, offset, standard, rays, (row, 1, row_stop), columns, reference, sums)
            row += 2
    else:
        apart = (row_stop - row_start + 1) // 2
        for row in range(row_start, row_start + apart):
            add_two_rows(frame, offset, standard, rays, (row, apart, row_stop), columns, reference, sums)
