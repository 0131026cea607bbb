"""Which window to take for a pixel: one that no edge runs through."""

import math

import numpy as np

from .._jit.kernel import kernel


@kernel(arrays=False)
def calmer(other, place, smallest, best):
    """Take the windows of ``other`` with a smaller variance; ``place`` is the first one's index in the frame."""
    for i in range(other.shape[0]):
        is_calmer = other[i] < smallest[i]
        smallest[i] = other[i] if is_calmer else smallest[i]
        best[i] = place + i if is_calmer else best[i]


@kernel()
def choose_windows(frame, rays, rounding, reach, tests, windows, rows, chosen):
    """Give each valid pixel its window, or one of the eight that are moved by ``reach`` but still hold it.

    Where an edge runs through the window around a pixel, the moved window with the smallest residual variance is taken.
    An edge is where the variance of the window around the pixel is more than ``ratio`` times as large. The idea is that
    of Kuwahara's filter of means (1976). There is none where rounding to raw values explains as much, or where as much
    is usual in the frame: the moved windows may lie on terraces, which have no variance. At the border windows are
    moved less. A plane that the pixel's ray does not meet does not count. Missing pixels get NaN.

    Parameters
    ----------
    frame : RawFrame
    rays : tan_x, tan_y, (H, W) float64 each
    rounding : float64
        Variance of inverse depth by rounding to raw values, times their 4th power where they are depths.
    reach : int
        In pixels, at least 1.
    tests : (typical, ratio)
        Residual variance of most windows of the frame, and how much more makes an edge.
    windows : normals, variance, variation; (H W 3,), (H, W) and (H W,) float32
        From `normals.separable` or `normals.distorted`.
    rows : (start, stop)
        The rows to write.
    chosen : normals and variation, (H, W, 3) and (H, W) float32, written
    """
    width = frame.raw.shape[1]
    smallest, best = np.empty(width, np.float32), np.empty(width, np.int64)
    row_start, row_stop = rows
    for row in range(row_start, row_stop):
        find_calmest(frame, rounding, reach, tests, windows[1], row, (smallest, best))
        write_chosen(frame, rays, windows, row, best, chosen)


@kernel(arrays=False)
def find_calmest(frame, rounding, reach, tests, variance, row, calmest):
    """Find which window each pixel of a row takes: its place in the frame, row by row.

    ``calmest`` are the variances of the windows that are taken, 0 for a pixel that keeps the one around it, and their
    places, (W,) float32 and int64, written.
    """
    raw, is_disparity = frame.raw, frame.is_disparity
    typical, ratio = tests
    smallest, best = calmest
    height, width = raw.shape
    inner = max(width - 2 * reach, 0)
    for column in range(width):
        around = variance[row, column]
        square = np.float64(raw[row, column]) ** 2
        usual = max(typical, rounding if is_disparity else rounding / (square * square))
        # NaN, where the window around the pixel has no plane, counts as larger than everything.
        smallest[column] = math.inf if around != around else around / ratio if around > ratio * usual else 0.0
        best[column] = row * width + column
    for y in range(-reach, reach + 1, reach):
        other_row = min(max(row + y, 0), height - 1)
        others = variance[other_row]
        for x in range(-reach, reach + 1, reach):
            if inner > 0:
                left = reach + x
                calmer(
                    others[left : left + inner], other_row * width + left,
                    smallest[reach : reach + inner], best[reach : reach + inner],
                )  # fmt: skip
            for side in range(2):
                start = 0 if side == 0 else max(reach, width - reach)
                stop = min(reach, width) if side == 0 else width
                for column in range(start, stop):
                    place = min(max(column + x, 0), width - 1)
                    calmer(
                        others[place : place + 1], other_row * width + place,
                        smallest[column : column + 1], best[column : column + 1],
                    )  # fmt: skip


@kernel(arrays=False)
def write_chosen(frame, rays, windows, row, best, chosen):
    """Write normals and variation of a row from the windows at the places ``best``, NaN for missing pixels."""
    raw, lowest, highest = frame.raw, frame.lowest, frame.highest
    tan_x, tan_y = rays
    normals, _, variation = windows
    chosen_normals, chosen_variation = chosen
    for column in range(len(best)):
        place = best[column]
        a, b, c = normals[3 * place], normals[3 * place + 1], normals[3 * place + 2]
        towards = a * tan_x[row, column] + b * tan_y[row, column] + c
        there = (raw[row, column] >= lowest) & (raw[row, column] <= highest) & (towards < 0.0)
        nan = np.float32(0.0 if there else math.nan)
        chosen_normals[row, column, 0] = a + nan
        chosen_normals[row, column, 1] = b + nan
        chosen_normals[row, column, 2] = c + nan
        chosen_variation[row, column] = variation[place] + nan
