"""What the camera alone determines of a tile's moments: the sums of 1, u, v, uu, uv and vv over its valid pixels.

They are the paper's eq. 16: the block of eq. 14 that has no depth in it. Without lens distortion tanθx and tanθy are
linear in a tile's column j, counted from its last, and row k. So the sums follow from the sums of 1, j, k, jj, jk and
kk over the valid pixels, which are integers. A column adds up 1, k and kk in three fields of one number, and a tile
adds up that number times 1, j and jj.
"""

import numpy as np

from .._jit.kernel import kernel

# Rows and columns whose valid pixels are counted at a time: few enough for Σ1, Σjj, Σk and Σjk to fit into fields of 22
# bits and Σkk into one of 20. Sums that overflow their field are not used.
BAND_ROWS = 32
BAND_COLUMNS = 64
FIELD = np.uint64(22)
LAST_FIELD = np.uint64(44)
FIELD_MASK = np.uint64((1 << 22) - 1)
# What a valid pixel in row k of a band adds.
ROW_CODES = np.array([1 + (k << 22) + (k * k << 44) for k in range(BAND_ROWS)], np.uint64)
NO_CODE = np.uint64(0)


@kernel(inline=True)
def add_valid(codes, u, step_u, v, grid, scratch, moments):
    """Add the valid pixels of a band of rows to the sums of 1, u, v, uu, uv and vv of its tiles.

    Parameters
    ----------
    codes : (COLUMNS,) uint64
        Sums of the `ROW_CODES` of the valid pixels of each column.
    u, step_u, v
        tanθx of the columns, its step, and tanθy of the rows, relative to their tile's centre.
    grid : (tiles, span)
        Number of tiles, and of the columns of each.
    scratch : (3, TILES or more) uint64 and (TILES or more,) float64
    moments : (10, TILES) float64, added to
    """
    tiles, span = grid
    counts, last_u = scratch
    v_0 = v[0]
    step_v = (v[-1] - v_0) / max(len(v) - 1, 1)
    for part in range(0, span, BAND_COLUMNS):
        size = min(span - part, BAND_COLUMNS)
        for tile in range(tiles):
            start = tile * span + part
            # A column's share of one sum enters the next once for each column still to come.
            once = by_j = by_triangle = NO_CODE
            for column in range(start, start + size):
                by_triangle += by_j
                by_j += once
                once += codes[column]
            counts[0, tile] = once
            counts[1, tile] = by_j
            counts[2, tile] = by_triangle
            last_u[tile] = u[start] + (size - 1) * step_u  # the image may end before the tile
        for tile in range(tiles):
            n = np.float64(counts[0, tile] & FIELD_MASK)
            k = np.float64((counts[0, tile] >> FIELD) & FIELD_MASK)
            kk = np.float64(counts[0, tile] >> LAST_FIELD)
            j = np.float64(counts[1, tile] & FIELD_MASK)
            jk = np.float64((counts[1, tile] >> FIELD) & FIELD_MASK)
            # The triangle's j-th number is j(j - 1)/2.
            jj = 2.0 * np.float64(counts[2, tile] & FIELD_MASK) + j
            u_0 = last_u[tile]
            n_v = n * v_0 + k * step_v
            moments[0, tile] += n
            moments[1, tile] += n * u_0 - j * step_u
            moments[2, tile] += n_v
            moments[4, tile] += n * (u_0 * u_0) - j * (2.0 * u_0 * step_u) + jj * (step_u * step_u)
            moments[5, tile] += u_0 * n_v - step_u * (j * v_0 + jk * step_v)
            moments[7, tile] += n * (v_0 * v_0) + k * (2.0 * v_0 * step_v) + kk * (step_v * step_v)
