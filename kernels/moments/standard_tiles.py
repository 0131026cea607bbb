"""Moments of the tiles of a grid in the standard form, in one pass over the frame: the ``direct`` implementation.

As `range_tiles`, but a pixel is the point (X, Y, Z) of the paper's eq. 11, and a tile's moments
are [n, ΣX, ΣY, ΣZ, ΣXX, ΣXY, ΣXZ, ΣYY, ΣYZ, ΣZZ], all of which depend on the frame.
"""

import numpy as np

from .._jit.kernel import kernel
from .camera_terms import BAND_ROWS, NO_CODE, ROW_CODES, add_valid
from .strips import (
    COLUMNS,
    clip,
    columns_in_strip,
    find_references,
    fold,
    fold_columns,
    spread_to_columns,
    step_of_columns,
    sums_of_pair,
)


@kernel(inline=True)
def depths(a, b, scale, offset):
    """Depths of two raw values, with one division at most."""
    if offset is None:
        metres = 1.0 / scale
        return metres * a, metres * b
    qa = scale * a + offset
    qb = scale * b + offset
    inverse = 1.0 / (qa * qb)
    return qb * inverse, qa * inverse


@kernel(inline=True)
def standard_pair(a, b, is_pair, lowest, highest, scale, offset, va, vb, code_a, code_b, reference_z):
    """Σz, Σzv, Σzvv, Σzz, Σzzv, Σzzvv and codes of the valid ones among two pixels of a column, or of the first."""
    clipped_a, clipped_b = clip(a, lowest, highest), clip(b, lowest, highest)
    valid_a, valid_b = clipped_a == a, (clipped_b == b) & is_pair
    za, zb = depths(np.float64(clipped_a), np.float64(clipped_b), scale, offset)
    za = za - reference_z if valid_a else 0.0
    zb = zb - reference_z if valid_b else 0.0
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


@kernel(reduction=True, inline=True)
def add_two_standard_rows(
    raw, lowest, highest, scale, offset, v, row, row_stop, k, apart, left, count,
    reference_z, sums, codes,
):  # fmt: skip
    """Add two image rows, ``apart`` from each other, see `add_standard_rows`; the second may be missing."""
    sum_z, sum_zv, sum_zvv, sum_zz, sum_zzv, sum_zzvv = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
    is_pair = row + apart < row_stop
    other = row + apart if is_pair else row
    a, b = raw[row, left : left + count], raw[other, left : left + count]
    va, vb = v[row], v[other]
    code_a, code_b = ROW_CODES[k], ROW_CODES[k + apart]
    for i in range(count):
        z, zv, zvv, zz, zzv, zzvv, valid = standard_pair(
            a[i], b[i], is_pair, lowest, highest, scale, offset, va, vb, code_a, code_b, reference_z[i]
        )
        sum_z[i] += z
        sum_zv[i] += zv
        sum_zvv[i] += zvv
        sum_zz[i] += zz
        sum_zzv[i] += zzv
        sum_zzvv[i] += zzvv
        codes[i] += valid


@kernel(inline=True)
def add_standard_rows(
    raw, lowest, highest, scale, offset, v, row_start, row_stop, left, count,
    reference_z, sums, codes,
):  # fmt: skip
    """Add a band of image rows to the sums of their columns: as `range_tiles.add_range_rows`.

    ``sums`` (6, COLUMNS) are Σz, Σzv, Σzvv, Σzz, Σzzv, Σzzvv; z is relative to ``reference_z``.
    """
    if lowest > highest:
        return  # no value is valid
    apart = (row_stop - row_start + 1) // 2
    for k in range(apart):
        add_two_standard_rows(
            raw, lowest, highest, scale, offset, v, row_start + k, row_stop, k, apart, left, count,
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


@kernel(inline="compiled")
def standard_from_sums(sums, count, reference, moments):
    """Moments of (X, Y, Z) from sums of z, u and v and the camera terms of the valid pixels.

    With z = Z - Z0, u = tanθx - u0 and v = tanθy - v0, a point relative to the reference Z0·(u0, v0, 1) is

        X = Zu + u0·z,    Y = Zv + v0·z,    Z = z,    where Zu = z·u + Z0·u.

    ``sums`` (12, TILES) are those of z, zu, zuu, zz, zzu, zzuu, zv, zvu, zzv, zzvu, zvv and zzvv. The first two rows
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


@kernel(inline="compiled")
def standard_strip_separable(
    raw, lowest, highest, scale, offset, u, v, tile_width,
    row_start, row_stop, tile_start, tile_stop, room, references, tile_sums, moments,
):  # fmt: skip
    """Sums of a strip of tiles for the moments of (X, Y, Z), for a camera without lens distortion.

    As `range_tiles.range_strip_separable`, but depth is Z = raw / scale, or 1 / (scale * raw + offset), and every
    entry depends on the frame (the paper's eq. 6). ``moments`` get the camera terms, and ``tile_sums`` (12, N) the sums
    from which `standard_from_sums` makes the rest.
    """
    sums, columns, codes, counts = room
    tiles = tile_stop - tile_start
    find_references(
        raw, lowest, highest, scale, offset, False, row_start, row_stop, tile_start, tile_stop, tile_width,
        references,
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
            add_valid(codes, u[left:], step_u, v[band:band_stop], tiles, span, counts, columns[1], moments)
        fold_thrice(sums[0], u[left:], tiles, span, tile_sums[0:])
        fold_thrice(sums[3], u[left:], tiles, span, tile_sums[3:])
        fold_twice(sums[1], u[left:], tiles, span, tile_sums[6:])
        fold_twice(sums[4], u[left:], tiles, span, tile_sums[8:])
        fold(sums[2], tiles, span, tile_sums[10])
        fold(sums[5], tiles, span, tile_sums[11])


@kernel(inline=True)
def standard_pair_of_rays(
    a, b, is_pair, lowest, highest, scale, offset, tan_xa, tan_xb, tan_ya, tan_yb, x0, y0, z0
):  # fmt: skip
    """The ten sums of the valid ones among two pixels of a column, or of the first alone."""
    clipped_a, clipped_b = clip(a, lowest, highest), clip(b, lowest, highest)
    valid_a, valid_b = clipped_a == a, (clipped_b == b) & is_pair
    za, zb = depths(np.float64(clipped_a), np.float64(clipped_b), scale, offset)
    return sums_of_pair(
        valid_a, valid_b, za * tan_xa - x0, zb * tan_xb - x0, za * tan_ya - y0, zb * tan_yb - y0, za - z0, zb - z0
    )


@kernel(reduction=True, inline=True)
def add_standard_rows_of_rays(
    raw, lowest, highest, scale, offset, tan_x, tan_y, row_start, row_stop, left, count, columns, sums
):
    """Add image rows to the sums of their columns, for rays that differ from pixel to pixel.

    ``columns`` (3, COLUMNS) holds each column's reference point (X0, Y0, Z0); ``sums`` (10, COLUMNS) are in the
    order of the moments.
    """
    if lowest > highest:
        return  # no value is valid
    x0, y0, z0 = columns[0], columns[1], columns[2]
    apart = (row_stop - row_start + 1) // 2
    for row in range(row_start, row_start + apart):
        is_pair = row + apart < row_stop
        other = row + apart if is_pair else row
        a, b = raw[row, left : left + count], raw[other, left : left + count]
        tan_xa, tan_xb = tan_x[row, left : left + count], tan_x[other, left : left + count]
        tan_ya, tan_yb = tan_y[row, left : left + count], tan_y[other, left : left + count]
        for i in range(count):
            n, x, y, z, xx, xy, xz, yy, yz, zz = standard_pair_of_rays(
                a[i], b[i], is_pair, lowest, highest, scale, offset,
                tan_xa[i], tan_xb[i], tan_ya[i], tan_yb[i], x0[i], y0[i], z0[i],
            )  # fmt: skip
            sums[0, i] += n
            sums[1, i] += x
            sums[2, i] += y
            sums[3, i] += z
            sums[4, i] += xx
            sums[5, i] += xy
            sums[6, i] += xz
            sums[7, i] += yy
            sums[8, i] += yz
            sums[9, i] += zz


@kernel(inline="compiled")
def standard_strip(
    raw, lowest, highest, scale, offset, tan_x, tan_y, tile_width, centre,
    row_start, row_stop, tile_start, tile_stop, room, reference, moments,
):  # fmt: skip
    """Moments of (X, Y, Z) of a strip of tiles, for any camera: tan_x, tan_y are (H, W).

    ``centre`` (2, N) holds the central rays of the tiles; ``reference`` (3, N) is written, all of it.
    """
    sums, columns = room[:2]
    tiles = tile_stop - tile_start
    find_references(
        raw, lowest, highest, scale, offset, False, row_start, row_stop, tile_start, tile_stop, tile_width,
        reference[2],
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
