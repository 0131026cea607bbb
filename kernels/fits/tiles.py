"""The tiles of frames from raw depth to planes in one call: moments, strip by strip, and the solve, block by block.

Everything between the frame and the planes stays in the nearest caches.
"""

import numpy as np

from .._jit.kernel import kernel
from ..common.arrays import copy_columns, copy_columns_back
from ..moments.column_sums import standard_from_sums
from ..moments.strips import TILES, Strip, strip_scratch, tiles_in_strip
from ..moments.tiles import separable_strip, strip_of_rays
from ..solvers import methods


@kernel()
def fit_tiles(
    raw, lowest, highest, scale, offset, tan_x, tan_y, tile_height, tile_width, centre, needed,
    implicit, standard, max_error, tile_row_start, tile_row_stop,
    moments, reference, planes, alpha, rmse, rmse_metric, valid_count, status,
):  # fmt: skip
    """Fit the tiles of some tile rows, counted through all frames.

    Parameters
    ----------
    raw : (F, H, W) array
        The frames; a pixel is valid if ``lowest <= raw <= highest``.
    scale, offset
        q = scale / raw, or scale * raw + offset unless ``offset`` is None.
    tan_x, tan_y : (H, W) float64
        tanθx and tanθy of each pixel; for a camera without lens distortion (C * tile_width,) and (H,), those of each
        column and row relative to its tile's centre.
    centre : (2, T) float64
        The ray (tanθx, tanθy) that each tile's moments are relative to, tiles counted row by row.
    needed : (T,) float64
        Number of valid pixels that a tile needs.
    implicit, standard
        In range space ``standard`` is None, and ``implicit`` True or, for the explicit solution, None. Otherwise
        ``standard`` is the number of a method in (X, Y, Z): `methods.STANDARD_EXPLICIT` and so on.
    max_error : float
        Tiles with a larger ``rmse_metric`` get ROUGH.
    moments, reference : (F, 10 * T) and (F, 3 * T) float64, written
    planes, alpha, rmse, rmse_metric, valid_count, status : (F, 4 * T), (F, 3 * T), (F, T)..., written
    """
    height, width = raw.shape[1:]
    tile_rows, tile_columns = (height - 1) // tile_height + 1, (width - 1) // tile_width + 1
    tiles_at_once = tiles_in_strip(tile_width)
    block = np.empty((25 + methods.WORK, TILES))
    block_moments, block_reference, block_sums, work = block[:10], block[10:13], block[13:25], block[25:]
    block_moments[:] = 0.0
    if standard is not None:
        block_sums[:] = 0.0
    scratch = strip_scratch()

    first = filled = np.int64(0)
    for row in range(tile_row_start, tile_row_stop):
        frame, tile_row = row // tile_rows, row % tile_rows
        if row == tile_row_start or tile_row == 0:
            first = tile_row * tile_columns
        row_start = tile_row * tile_height
        row_stop = min(row_start + tile_height, height)
        for tile_start in range(0, tile_columns, tiles_at_once):
            tile_stop = min(tile_start + tiles_at_once, tile_columns)
            strip = Strip(row_start, row_stop, tile_start, tile_stop, tile_width)
            image = raw[frame], lowest, highest, scale
            if tan_x.ndim == 1:
                separable_strip(
                    image, offset, standard, (tan_x, tan_y), strip, scratch, block_reference[2, filled:],
                    (block_moments[:, filled:], block_sums[:, filled:]),
                )  # fmt: skip
            else:
                strip_of_rays(
                    image, offset, standard, (tan_x, tan_y), centre[:, first + filled :], strip, scratch,
                    (block_moments[:, filled:], block_reference[:, filled:]),
                )  # fmt: skip
            filled += tile_stop - tile_start
            is_last = (row + 1 == tile_row_stop or tile_row + 1 == tile_rows) and tile_stop == tile_columns
            if filled + tiles_at_once > TILES or is_last:
                last = first + filled
                if tan_x.ndim == 1:
                    copy_columns(centre, first, last, block_reference)
                if standard is not None and tan_x.ndim == 1:
                    standard_from_sums(block_sums, filled, block_reference, block_moments)
                copy_columns_back(block_moments, first, last, moments[frame])
                copy_columns_back(block_reference, first, last, reference[frame])
                if standard is None:
                    methods.range_planes(
                        implicit, block_moments, block_reference, None, needed[first:last], filled, work
                    )
                else:
                    methods.standard_planes(standard, block_moments, block_reference, None, filled, work)
                methods.write_planes(
                    work, block_moments[0], needed[first:last], max_error, filled,
                    (
                        planes[frame, 4 * first : 4 * last], alpha[frame, 3 * first : 3 * last],
                        rmse[frame, first:last], rmse_metric[frame, first:last], valid_count[frame, first:last],
                        status[frame, first:last],
                    ),
                )  # fmt: skip
                first = last
                filled = 0
                block_moments[:] = 0.0
                if standard is not None:
                    block_sums[:] = 0.0
