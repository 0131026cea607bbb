"""A frame's tiles from raw depth to planes in one call: moments, then the solve, strip by strip.

Everything between the frame and the planes stays in the nearest caches.
"""

import numpy as np

from . import moments as tile_moments
from . import solve
from ._jit import kernel
from .moments import TILES, tiles_in_strip


@kernel()
def fit_range_tiles(
    raw, lowest, highest, scale, offset, tan_x, tan_y, tile_height, tile_width, centre, full, needed,
    method, max_error, tile_row_start, tile_row_stop,
    moments, reference, planes, alpha, rmse, rmse_metric, valid_count, status,
):  # fmt: skip
    """Fit the tiles of some tile rows in range space.

    Parameters
    ----------
    raw : (H, W) array
        The frame; a pixel is valid if ``lowest <= raw <= highest``.
    scale, offset
        q = scale / raw, or scale * raw + offset unless ``offset`` is None.
    tan_x, tan_y : (H, W) float64
        tanθx and tanθy of each pixel; of a camera without lens distortion (C * tile_width,) and (H,), those of each
        column and row relative to its tile's centre.
    centre : (2, R, C) float64
        The ray (tanθx, tanθy) that each tile's moments are relative to.
    full : (6, R, C) float64
        n, Σu, Σv, Σuu, Σuv, Σvv of the full tiles.
    needed : (T,) float64
    method
        `solve.RANGE_EXPLICIT` or `solve.RANGE_IMPLICIT`.
    max_error
        As in `solve.range_planes`.
    moments, reference : (10, T) and (3, T) float64, written
        Of the T = R * C tiles.
    planes, alpha, rmse, rmse_metric, valid_count, status : (T, 4), (T, 3), (T,)..., written
    """
    height = raw.shape[0]
    tile_columns = centre.shape[2]
    tiles_at_once = tiles_in_strip(tile_width)
    room = np.empty((13 + solve.WORK, TILES))
    block_moments, block_reference, work = room[:10], room[10:13], room[13:]
    strip_room = tile_moments.strip_room(raw)

    first = tile_row_start * tile_columns
    filled = np.int64(0)
    for tile_row in range(tile_row_start, tile_row_stop):
        row_start = tile_row * tile_height
        row_stop = min(row_start + tile_height, height)
        for tile_start in range(0, tile_columns, tiles_at_once):
            tile_stop = min(tile_start + tiles_at_once, tile_columns)
            if tan_x.ndim == 1:
                tile_moments.range_strip_separable(
                    raw, lowest, highest, scale, offset, tan_x, tan_y, tile_width,
                    centre[:, tile_row, tile_start:tile_stop], full[:, tile_row, tile_start:tile_stop],
                    row_start, row_stop, tile_start, tile_stop,
                    strip_room, block_reference[:, filled:], block_moments[:, filled:],
                )  # fmt: skip
            else:
                tile_moments.range_strip(
                    raw, lowest, highest, scale, offset, tan_x, tan_y, tile_width,
                    centre[:, tile_row, tile_start:tile_stop], full[:, tile_row, tile_start:tile_stop],
                    row_start, row_stop, tile_start, tile_stop,
                    strip_room, block_reference[:, filled:], block_moments[:, filled:],
                )  # fmt: skip
            filled += tile_stop - tile_start
            is_last = tile_row + 1 == tile_row_stop and tile_stop == tile_columns
            if filled + tiles_at_once > TILES or is_last:
                store(first, filled, block_moments, block_reference, moments, reference)
                solve.range_planes(
                    method == solve.RANGE_IMPLICIT, block_moments, block_reference, needed,
                    max_error, filled, work, first,
                    planes, alpha, rmse, rmse_metric, valid_count, status,
                )  # fmt: skip
                first += filled
                filled = 0


@kernel()
def fit_standard_tiles(
    raw, lowest, highest, scale, offset, tan_x, tan_y, tile_height, tile_width, centre, full, needed,
    method, max_error, tile_row_start, tile_row_stop,
    moments, reference, planes, alpha, rmse, rmse_metric, valid_count, status,
):  # fmt: skip
    """Fit the tiles of some tile rows in (X, Y, Z): as `fit_range_tiles`.

    ``method`` is `solve.STANDARD_EXPLICIT`, `solve.STANDARD_IMPLICIT` or `solve.STANDARD_PCA`.
    """
    height = raw.shape[0]
    tile_columns = centre.shape[2]
    tiles_at_once = tiles_in_strip(tile_width)
    room = np.empty((13 + solve.WORK, TILES))
    block_moments, block_reference, work = room[:10], room[10:13], room[13:]
    strip_room = tile_moments.strip_room(raw)

    first = tile_row_start * tile_columns
    filled = np.int64(0)
    for tile_row in range(tile_row_start, tile_row_stop):
        row_start = tile_row * tile_height
        row_stop = min(row_start + tile_height, height)
        for tile_start in range(0, tile_columns, tiles_at_once):
            tile_stop = min(tile_start + tiles_at_once, tile_columns)
            if tan_x.ndim == 1:
                tile_moments.standard_strip_separable(
                    raw, lowest, highest, scale, offset, tan_x, tan_y, tile_width,
                    centre[:, tile_row, tile_start:tile_stop], full[:, tile_row, tile_start:tile_stop],
                    row_start, row_stop, tile_start, tile_stop,
                    strip_room, block_reference[:, filled:], block_moments[:, filled:],
                )  # fmt: skip
            else:
                tile_moments.standard_strip(
                    raw, lowest, highest, scale, offset, tan_x, tan_y, tile_width,
                    centre[:, tile_row, tile_start:tile_stop], full[:, tile_row, tile_start:tile_stop],
                    row_start, row_stop, tile_start, tile_stop,
                    strip_room, block_reference[:, filled:], block_moments[:, filled:],
                )  # fmt: skip
            filled += tile_stop - tile_start
            is_last = tile_row + 1 == tile_row_stop and tile_stop == tile_columns
            if filled + tiles_at_once > TILES or is_last:
                store(first, filled, block_moments, block_reference, moments, reference)
                solve.standard_planes(
                    method - solve.STANDARD_EXPLICIT, block_moments, block_reference, needed,
                    max_error, filled, work, first,
                    planes, alpha, rmse, rmse_metric, valid_count, status,
                )  # fmt: skip
                first += filled
                filled = 0


@kernel(inline=True)
def store(first, count, block_moments, block_reference, moments, reference):
    """Keep a block's moments and reference points."""
    for entry in range(10):
        for i in range(count):
            moments[entry, first + i] = block_moments[entry, i]
    for axis in range(3):
        for i in range(count):
            reference[axis, first + i] = block_reference[axis, i]
