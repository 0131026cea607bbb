"""Moments of the tiles of a grid in one pass over the frame, strip by strip: the ``direct`` implementation.

A tile's moments are the ten sums [n, Σu, Σv, Σw, Σuu, Σuv, Σuw, Σvv, Σvw, Σww] over its valid pixels. Coordinates are
relative to a reference point of the tile, so that nothing cancels later.

- In range space, where ``standard`` is None, a pixel is (u, v, w) = (tanθx, tanθy, q). Without lens distortion only
  Σq, Σq·tanθx, Σq·tanθy and Σq² come from the frame (the paper's eq. 14). For the others it is enough to know which
  pixels are valid: they are in `camera_terms`.
- In the standard form it is the point (X, Y, Z) of the paper's eq. 11, and every sum depends on the frame (eq. 6).
"""

from .._jit.kernel import kernel
from . import ray_sums
from .camera_terms import BAND_ROWS, NO_CODE, add_valid
from .column_sums import add_range_rows, add_standard_rows, fold_range_columns, fold_standard_columns
from .strips import COLUMNS, columns_in_strip, find_references, fold_columns, spread_to_columns, step_of_columns


@kernel(inline="compiled")
def separable_strip(frame, offset, standard, rays, strip, work, references, targets):
    """Sums of a strip of tiles, for a camera without lens distortion.

    Parameters
    ----------
    frame, offset
        The frame (H, W), its lowest and highest valid raw values, and scale: q = scale / raw, or
        scale * raw + offset unless ``offset`` is None.
    standard
        None for sums in range space, anything else for (X, Y, Z).
    rays : (C * tile_width,) and (H,) float64
        tanθx of each column and tanθy of each row, relative to its tile's centre.
    strip : Strip
    work
        Scratch memory, from `strips.strip_scratch`.
    references : (N,) float64, written
        Inverse depth, or depth, of the reference of each of the strip's tiles.
    targets : (10, N) and (12, N) float64, added to
        Moments; of the standard form only the camera terms among them, and beside them the sums from which
        `column_sums.standard_from_sums` makes its moments.
    """
    width = frame[0].shape[1]
    u, v = rays
    sums, columns, codes, counts = work
    moments, tile_sums = targets
    tiles, tile_width = strip.tile_stop - strip.tile_start, strip.tile_width
    find_references(frame, offset, standard, strip, references)
    # More than one pass only where a tile is wider than a strip.
    start, last = strip.tile_start * tile_width, min(strip.tile_stop * tile_width, width)
    step_u = step_of_columns(u, start, last, tile_width)
    for left in range(start, last, COLUMNS):
        span, count = columns_in_strip(left, last, tile_width, width)
        spread_to_columns(references, tiles, span, columns[0])
        for entry in range(3 if standard is None else 6):
            for i in range(max(count, tiles * span)):
                sums[entry, i] = 0.0
        for band in range(strip.row_start, strip.row_stop, BAND_ROWS):
            band_stop = min(band + BAND_ROWS, strip.row_stop)
            for i in range(max(count, tiles * span)):
                codes[i] = NO_CODE
            if standard is None:
                add_range_rows(frame, offset, v, (band, band_stop), (left, count), columns[0], sums, codes)
            else:
                add_standard_rows(frame, offset, v, (band, band_stop), (left, count), columns[0], sums, codes)
            add_valid(codes, u[left:], step_u, v[band:band_stop], (tiles, span), (counts, columns[1]), moments)
        if standard is None:
            fold_range_columns(sums, u[left:], tiles, span, moments)
        else:
            fold_standard_columns(sums, u[left:], tiles, span, tile_sums)


@kernel(inline="compiled")
def strip_of_rays(frame, offset, standard, rays, centre, strip, work, targets):
    """Moments of a strip of tiles, for any camera.

    Parameters
    ----------
    frame, offset, standard, strip, work
        The same as for `separable_strip`.
    rays : tan_x, tan_y, (H, W) float64 each
    centre : (2, N) float64
        The central rays of the tiles.
    targets : (10, N) and (3, N) float64
        Moments, added to, and the points that they are relative to, written.
    """
    width = frame[0].shape[1]
    sums, columns = work[:2]
    moments, reference = targets
    tiles, tile_width = strip.tile_stop - strip.tile_start, strip.tile_width
    find_references(frame, offset, standard, strip, reference[2])
    for axis in range(2):
        for i in range(tiles):
            reference[axis, i] = centre[axis, i] if standard is None else reference[2, i] * centre[axis, i]
    last = min(strip.tile_stop * tile_width, width)
    for left in range(strip.tile_start * tile_width, last, COLUMNS):
        span, count = columns_in_strip(left, last, tile_width, width)
        for axis in range(3):
            spread_to_columns(reference[axis], tiles, span, columns[axis])
        for entry in range(10):
            for i in range(max(count, tiles * span)):
                sums[entry, i] = 0.0
        ray_sums.add_rows(
            frame, offset, standard, rays, (strip.row_start, strip.row_stop), (left, count), columns, sums
        )  # fmt: skip
        fold_columns(sums, tiles, span, moments)
