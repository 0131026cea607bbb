"""The least work that a fit in 1/Z can be, to measure fits against: a roofline in time.

Read the frame, take a reciprocal of every pixel and add up Σq, Σq·tanθx, Σq·tanθy and Σq² of every tile,
accumulating down image columns first. No missing pixels, no references, no planes.
"""

import numpy as np

from rgbd_planes.kernels._jit.kernel import kernel


@kernel(reduction=True)
def add_rows(a, b, tan_a, tan_b, sums):
    """Add two image rows, a division for each pixel."""
    sum_q, sum_qv, sum_qq = sums[0], sums[1], sums[2]
    for i in range(len(a)):
        qa = 1.0 / a[i]
        qb = 1.0 / b[i]
        sum_q[i] += qa + qb
        sum_qv[i] += qa * tan_a + qb * tan_b
        sum_qq[i] += qa * qa + qb * qb


@kernel(reduction=True)
def add_rows_sharing(a, b, tan_a, tan_b, sums):
    """Add two image rows, a division for two pixels."""
    sum_q, sum_qv, sum_qq = sums[0], sums[1], sums[2]
    for i in range(len(a)):
        za = np.float64(a[i])
        zb = np.float64(b[i])
        inverse = 1.0 / (za * zb)
        qa = zb * inverse
        qb = za * inverse
        sum_q[i] += qa + qb
        sum_qv[i] += qa * tan_a + qb * tan_b
        sum_qq[i] += qa * qa + qb * qb


@kernel()
def floor(raw, tan_x, tan_y, side, sharing, sums, tiles):
    """Sums of square tiles, an even number of pixels wide, of a frame that they fill.

    Parameters
    ----------
    raw : (H, W) array
    tan_x, tan_y : (W,) and (H,) float64
    sharing : bool
        Divide once for two pixels.
    sums : (3, W) float64
        Room.
    tiles : (4, R, C) float64, written
    """
    for tile_row in range(tiles.shape[1]):
        sums[:] = 0.0
        for row in range(tile_row * side, (tile_row + 1) * side, 2):
            if sharing:
                add_rows_sharing(raw[row], raw[row + 1], tan_y[row], tan_y[row + 1], sums)
            else:
                add_rows(raw[row], raw[row + 1], tan_y[row], tan_y[row + 1], sums)
        for tile in range(tiles.shape[2]):
            s_q = s_qu = s_qv = s_qq = 0.0
            for i in range(tile * side, (tile + 1) * side):
                s_q += sums[0, i]
                s_qu += sums[0, i] * tan_x[i]
                s_qv += sums[1, i]
                s_qq += sums[2, i]
            tiles[0, tile_row, tile] = s_q
            tiles[1, tile_row, tile] = s_qu
            tiles[2, tile_row, tile] = s_qv
            tiles[3, tile_row, tile] = s_qq
