"""A frame's tiles from raw depth to planes in one call: moments, then the solve, strip by strip.

Everything between the frame and the planes stays in the nearest caches.
"""

import numpy as np

from . import moments as tile_moments
from . import solve
from ._jit import kernel
from .moments import COLUMNS, TILES, tiles_in_strip

# Which of the ten moments each of a tile's six camera terms is.
ENTRY = np.array([0, 1, 2, 4, 5, 7])


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
    tan_x, tan_y : (W,) and (H,) float64, or both (H, W)
        The first where the camera has no lens distortion.
    centre : (2, R, C) float64
        The ray (tanθx, tanθy) that each tile's moments are relative to.
    full : (6, R, C) float64
        n, Σu, Σv, Σuu, Σuv, Σvv of the full tiles.
    needed : (R, C) float64
    method
        `solve.RANGE_EXPLICIT` or `solve.RANGE_IMPLICIT`.
    max_error
        As in `solve.range_planes`.
    moments, reference : (10, R, C) and (3, R, C) float64, written
    planes, alpha, rmse, rmse_metric, valid_count, status : (R, C, 4), (R, C, 3), (R, C)..., written
    """
    height = raw.shape[0]
    tile_columns = status.shape[1]
    tiles_at_once = tiles_in_strip(tile_width)
    sums = np.empty((10, COLUMNS))
    counts = np.empty((2, COLUMNS), np.uint16)
    columns = np.zeros((3, COLUMNS + 8))
    room = np.empty((13 + solve.WORK, TILES))
    block_moments, block_reference, work = room[:10], room[10:13], room[13:]

    first = tile_row_start * tile_columns
    filled = 0
    for tile_row in range(tile_row_start, tile_row_stop):
        row_start = tile_row * tile_height
        row_stop = min(row_start + tile_height, height)
        for tile_start in range(0, tile_columns, tiles_at_once):
            tile_stop = min(tile_start + tiles_at_once, tile_columns)
            if tan_x.ndim == 1:
                tile_moments.range_strip_separable(
                    raw, lowest, highest, scale, offset, tan_x, tan_y, tile_width,
                    centre[0, tile_row], centre[1, tile_row, 0],
                    row_start, row_stop, tile_start, tile_stop, filled,
                    sums, counts, columns, block_reference[2], block_moments,
                )  # fmt: skip
            else:
                tile_moments.range_strip(
                    raw, lowest, highest, scale, offset, tan_x, tan_y, tile_width,
                    centre[0, tile_row], centre[1, tile_row],
                    row_start, row_stop, tile_start, tile_stop, filled,
                    sums, columns, block_reference[2], block_moments,
                )  # fmt: skip
            filled += tile_stop - tile_start
            is_last = tile_row + 1 == tile_row_stop and tile_stop == tile_columns
            if filled + tiles_at_once > TILES or is_last:
                add_camera_terms(centre, full, first, filled, block_moments, block_reference)
                store(first, filled, block_moments, block_reference, moments, reference)
                solve.range_planes(
                    method == solve.RANGE_IMPLICIT, block_moments, block_reference, needed.reshape(-1), max_error, filled, work, first,
                    planes.reshape(-1, 4), alpha.reshape(-1, 3), rmse.reshape(-1), rmse_metric.reshape(-1),
                    valid_count.reshape(-1), status.reshape(-1),
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

    ``method`` is `solve.STANDARD_EXPLICIT`, `solve.STANDARD_IMPLICIT` or `solve.STANDARD_PCA`; there are no camera terms, and ``full`` is not used.
    """
    height = raw.shape[0]
    tile_columns = status.shape[1]
    tiles_at_once = tiles_in_strip(tile_width)
    sums = np.empty((10, COLUMNS))
    counts = np.empty((2, COLUMNS), np.uint16)
    columns = np.zeros((3, COLUMNS + 8))
    room = np.empty((13 + solve.WORK, TILES))
    block_moments, block_reference, work = room[:10], room[10:13], room[13:]

    first = tile_row_start * tile_columns
    filled = 0
    for tile_row in range(tile_row_start, tile_row_stop):
        row_start = tile_row * tile_height
        row_stop = min(row_start + tile_height, height)
        for tile_start in range(0, tile_columns, tiles_at_once):
            tile_stop = min(tile_start + tiles_at_once, tile_columns)
            if tan_x.ndim == 1:
                tile_moments.standard_strip_separable(
                    raw, lowest, highest, scale, offset, tan_x, tan_y, tile_width,
                    centre[0, tile_row], centre[1, tile_row, 0],
                    row_start, row_stop, tile_start, tile_stop, filled,
                    sums, counts, columns, block_reference, block_moments,
                )  # fmt: skip
            else:
                tile_moments.standard_strip(
                    raw, lowest, highest, scale, offset, tan_x, tan_y, tile_width,
                    centre[0, tile_row], centre[1, tile_row],
                    row_start, row_stop, tile_start, tile_stop, filled,
                    sums, columns, block_reference, block_moments,
                )  # fmt: skip
            filled += tile_stop - tile_start
            is_last = tile_row + 1 == tile_row_stop and tile_stop == tile_columns
            if filled + tiles_at_once > TILES or is_last:
                store(first, filled, block_moments, block_reference, moments, reference)
                solve.standard_planes(
                    method - solve.STANDARD_EXPLICIT, block_moments, block_reference, needed.reshape(-1),
                    max_error, filled, work, first,
                    planes.reshape(-1, 4), alpha.reshape(-1, 3), rmse.reshape(-1), rmse_metric.reshape(-1),
                    valid_count.reshape(-1), status.reshape(-1),
                )  # fmt: skip
                first += filled
                filled = 0


@kernel(inline=True)
def add_camera_terms(centre, full, first, count, moments, reference):
    """Turn a block's sums over missing pixels into those over valid ones, and give it its reference points."""
    camera_terms = full.reshape(6, -1)
    for term in range(6):
        entry = ENTRY[term]
        for i in range(count):
            moments[entry, i] = camera_terms[term, first + i] - moments[entry, i]
    rays = centre.reshape(2, -1)
    for axis in range(2):
        for i in range(count):
            reference[axis, i] = rays[axis, first + i]


@kernel(inline=True)
def store(first, count, block_moments, block_reference, moments, reference):
    """Keep a block's moments and reference points."""
    flat_moments, flat_reference = moments.reshape(10, -1), reference.reshape(3, -1)
    for entry in range(10):
        for i in range(count):
            flat_moments[entry, first + i] = block_moments[entry, i]
    for axis in range(3):
        for i in range(count):
            flat_reference[axis, first + i] = block_reference[axis, i]
