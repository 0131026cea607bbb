"""Strips: runs of neighbouring tiles of one tile row, which are summed together.

The rows of a strip are added to one accumulator per image column, and columns are folded into tiles after the last
row. So the inner loop runs along the image row and vectorises without tails at tile borders.
"""

from typing import NamedTuple

import numpy as np

from .._jit.kernel import kernel

# Columns of a strip: their accumulators stay in the first-level cache. A multiple of 8, for whole vectors, but not
# of 512, or all accumulators of a column would compete for the same few lines of that cache.
COLUMNS = 648
# Tiles of a block, which is solved at once: no fewer than a strip can have.
TILES = 328


class Strip(NamedTuple):
    """Tiles ``tile_start`` to ``tile_stop`` of one tile row, and the image rows that they cover."""

    row_start: int
    row_stop: int
    tile_start: int
    tile_stop: int
    tile_width: int  # pixels


@kernel(inline=True)
def tiles_in_strip(tile_width):
    """Number of tiles in a strip: a multiple of eight where possible, for whole vectors of tiles and columns."""
    tiles = max(1, COLUMNS // tile_width)
    return tiles if tiles < 8 else tiles // 8 * 8


@kernel(inline=True)
def columns_in_strip(left, last, tile_width, width):
    """Columns of each tile from ``left`` on, and the number of the image's to read for those up to ``last``."""
    right = min(left + COLUMNS, last)
    # Whole vectors: the sums of a few extra columns are not used.
    return tile_width if tile_width <= COLUMNS else right - left, min((right - left + 7) // 8 * 8, width - left)


@kernel(inline=True)
def step_of_columns(u, start, last, tile_width):
    """Step of tanθx between neighbouring columns, from those of one tile."""
    size = min(tile_width, last - start)
    return (u[start + size - 1] - u[start]) / max(size - 1, 1)


@kernel(inline=True)
def strip_scratch():
    """Scratch memory: sums of columns, references of columns, codes of columns and counts of valid pixels."""
    scratch = np.empty((13, COLUMNS + 8))
    codes = np.empty((4, COLUMNS), np.uint64)
    sums, columns = scratch[:10], scratch[10:]
    columns[:] = 0.0
    return sums, columns, codes[0], codes[1:]


@kernel(inline=True)
def reference_value(raw, row_start, row_stop, column_start, column_stop, lowest, highest):
    """Return a valid raw value of the tile, its centre's if that is valid, or 1 if there is none."""
    value = raw[(row_start + row_stop) // 2, (column_start + column_stop) // 2]
    if (lowest <= value) & (value <= highest):
        return np.float64(value)
    for row in range(row_start, row_stop):
        for column in range(column_start, column_stop):
            value = raw[row, column]
            if (lowest <= value) & (value <= highest):
                return np.float64(value)
    return 1.0


@kernel(inline=True)
def find_references(frame, offset, standard, strip, references):
    """Take a valid pixel of each tile as its reference.

    Parameters
    ----------
    frame, offset
        The frame (H, W), its lowest and highest valid raw values, and scale: q = scale / raw, or
        scale * raw + offset unless ``offset`` is None.
    standard
        None if inverse depths are wanted, anything else for depths.
    strip : Strip
    references : (TILES,) float64, written
        Their (inverse) depths.
    """
    raw, lowest, highest, scale = frame
    for tile in range(strip.tile_start, strip.tile_stop):
        start = tile * strip.tile_width
        stop = min(start + strip.tile_width, raw.shape[1])
        value = reference_value(raw, strip.row_start, strip.row_stop, start, stop, lowest, highest)
        references[tile - strip.tile_start] = value
    for i in range(strip.tile_stop - strip.tile_start):
        value = references[i]
        if offset is None:
            references[i] = scale / value if standard is None else value / scale
        else:
            inverse = scale * value + offset
            references[i] = inverse if standard is None else (1.0 / inverse if inverse > 0.0 else 0.0)


@kernel(inline=True)
def spread_to_columns(values, count, tile_width, columns):
    """Give every column of ``count`` tiles the value of its tile."""
    for tile in range(count):
        value = values[tile]
        # Eight at a time: what goes beyond the tile is overwritten by the next.
        for i in range(tile * tile_width, (tile + 1) * tile_width, 8):
            part = columns[i : i + 8]
            for k in range(8):
                part[k] = value


@kernel(reduction=True, inline=True)
def fold(columns, tiles, span, sums):
    """Add up the columns of each tile."""
    for tile in range(tiles):
        total = 0.0
        for column in range(span):
            total += columns[tile * span + column]
        sums[tile] += total


@kernel(inline=True)
def fold_columns(sums, tiles, span, moments):
    """Add columns, ``span`` per tile, to the ten sums of their tiles."""
    for entry in range(10):
        fold(sums[entry], tiles, span, moments[entry])
