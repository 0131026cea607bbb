"""The tiles of frames from raw depth to quadratics in inverse depth in one call, as `fits.tiles` fits planes."""

import numpy as np

from .._jit.kernel import kernel
from ..common.arrays import copy_columns, copy_columns_back
from ..moments.strips import TILES, Strip, tiles_in_strip
from ..moments.surface_tiles import (
    CAMERA_SUMS,
    SURFACE_SUMS,
    surface_strip,
    surface_strip_scratch,
    surface_strip_separable,
)
from ..solvers.quadratic import QUADRATIC_WORK, solve_quadratics, write_surfaces


@kernel()
def fit_surface_tiles(
    raw, lowest, highest, scale, offset, tan_x, tan_y, tile_height, tile_width, centre, full, needed, max_error,
    tile_row_start, tile_row_stop, moments, reference, coefficients, rmse, rmse_metric, valid_count, status,
):  # fmt: skip
    """Fit a quadratic to the tiles of some tile rows, counted through all frames.

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
    full : (CAMERA_SUMS, T) float64
        The camera's sums over whole tiles.
    needed : (T,) float64
        Number of valid pixels that a tile needs.
    max_error : float
        Tiles with a larger ``rmse_metric`` get ROUGH.
    moments, reference : (F, SURFACE_SUMS * T) and (F, T) float64, written
    coefficients, rmse, rmse_metric, valid_count, status : (F, 6 * T), (F, T)..., written
    """
    height, width = raw.shape[1:]
    tile_rows, tile_columns = (height - 1) // tile_height + 1, (width - 1) // tile_width + 1
    tiles_at_once = tiles_in_strip(tile_width)
    block = np.empty((SURFACE_SUMS + 3 + QUADRATIC_WORK, TILES))
    block_moments = block[:SURFACE_SUMS]
    block_centre, block_reference = block[SURFACE_SUMS : SURFACE_SUMS + 2], block[SURFACE_SUMS + 2]
    work = block[SURFACE_SUMS + 3 :]
    block_moments[:] = 0.0
    scratch = surface_strip_scratch()

    first = filled = np.int64(0)
    for row in range(tile_row_start, tile_row_stop):
        frame, tile_row = row // tile_rows, row % tile_rows
        if row == tile_row_start or tile_row == 0:
            first = tile_row * tile_columns
        row_start = tile_row * tile_height
        row_stop = min(row_start + tile_height, height)
        for tile_start in range(0, tile_columns, tiles_at_once):
            tile_stop = min(tile_start + tiles_at_once, tile_columns)
            into = block_moments[:, filled:]
            place = tile_row * tile_columns + tile_start
            copy_columns(full, place, place + tile_stop - tile_start, into[:CAMERA_SUMS])
            strip = Strip(row_start, row_stop, tile_start, tile_stop, tile_width)
            image = raw[frame], lowest, highest, scale
            if tan_x.ndim == 1:
                surface_strip_separable(
                    image, offset, (tan_x, tan_y), strip, scratch, block_reference[filled:], into
                )  # fmt: skip
            else:
                surface_strip(
                    image, offset, (tan_x, tan_y), centre[:, place:], strip, scratch, block_reference[filled:], into
                )  # fmt: skip
            filled += tile_stop - tile_start
            is_last = (row + 1 == tile_row_stop or tile_row + 1 == tile_rows) and tile_stop == tile_columns
            if filled + tiles_at_once > TILES or is_last:
                last = first + filled
                copy_columns(centre, first, last, block_centre)
                copy_columns_back(block_moments, first, last, moments[frame])
                out_reference = reference[frame, first:last]
                for i in range(filled):
                    out_reference[i] = block_reference[i]
                solve_quadratics(block_moments, block_reference, filled, work)
                write_surfaces(
                    work, block_moments, block_reference, block_centre, needed[first:last], max_error, filled,
                    (
                        coefficients[frame, 6 * first : 6 * last], rmse[frame, first:last],
                        rmse_metric[frame, first:last], valid_count[frame, first:last], status[frame, first:last],
                    ),
                )  # fmt: skip
                first = last
                filled = 0
                block_moments[:] = 0.0


@kernel()
def fit_surface_moments(sums, centre, needed, max_error, part, results):
    """Quadratics from moments.

    Parameters
    ----------
    sums : moments and reference, (SURFACE_SUMS, T) and (T,) float64
        The sums, and the inverse depths that the sums of q are relative to.
    centre : (2, T) float64
        The central rays.
    needed : (T,) float64
        Number of valid pixels that a part needs.
    max_error : float
        Parts with a larger ``rmse_metric`` get ROUGH.
    part : (start, stop)
        The parts to fit.
    results : coefficients, rmse, rmse_metric, valid_count, status; (6 * T,), (T,)..., written
    """
    moments, reference = sums
    start, stop = part
    coefficients, rmse, rmse_metric, valid_count, status = results
    block = np.empty((SURFACE_SUMS + 3 + QUADRATIC_WORK, TILES))
    block_moments = block[:SURFACE_SUMS]
    block_centre, block_reference = block[SURFACE_SUMS : SURFACE_SUMS + 2], block[SURFACE_SUMS + 2]
    work = block[SURFACE_SUMS + 3 :]
    for first in range(start, stop, TILES):
        last = min(first + TILES, stop)
        count = last - first
        copy_columns(moments, first, last, block_moments)
        copy_columns(centre, first, last, block_centre)
        for i in range(count):
            block_reference[i] = reference[first + i]
        solve_quadratics(block_moments, block_reference, count, work)
        write_surfaces(
            work, block_moments, block_reference, block_centre, needed[first:last], max_error, count,
            (
                coefficients[6 * first : 6 * last], rmse[first:last], rmse_metric[first:last],
                valid_count[first:last], status[first:last],
            ),
        )  # fmt: skip
