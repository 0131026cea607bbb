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
def choose_windows(
    raw, lowest, highest, rounding, typical, is_disparity, tan_x, tan_y, reach, ratio, normals, variance, variation,
    row_start, row_stop, chosen_normals, chosen_variation,
):  # fmt: skip
    """Give each valid pixel its window, or one of the eight that are moved by ``reach`` but still hold it.

    Of the moved windows the one with the smallest residual variance is taken if the variance of the pixel's own window
    is more than ``ratio`` times as large: an edge runs through it. The idea is that of Kuwahara's filter of means
    (1976). Not so where rounding to raw values explains as much, or where as much is usual in the frame: the moved
    windows may lie on terraces, which have none, and a sensor rounds, too. At the border windows are moved less. A
    plane that the pixel's ray does not meet does not count. Missing pixels get NaN.

    Parameters
    ----------
    rounding : float64
        Variance of inverse depth by rounding to raw values, times their 4th power where they are depths.
    typical : float64
        Residual variance of most windows of the frame.
    tan_x, tan_y : (H, W) float64
    reach : int
        At least 1.
    ratio : float64
    normals, variance, variation : (H W 3,), (H, W) and (H W,) float32
        From `normals.separable` or `normals.distorted`.
    row_start, row_stop
        The rows to write.
    chosen_normals, chosen_variation : (H, W, 3) and (H, W) float32, written
    """
    smallest, best = np.empty(raw.shape[1], np.float32), np.empty(raw.shape[1], np.int64)
    for row in range(row_start, row_stop):
        choose_in_row(
            raw, lowest, highest, rounding, typical, is_disparity, tan_x, tan_y, reach, ratio, normals, variance,
            variation, row, smallest, best, chosen_normals, chosen_variation,
        )  # fmt: skip


@kernel(arrays=False)
def choose_in_row(
    raw, lowest, highest, rounding, typical, is_disparity, tan_x, tan_y, reach, ratio, normals, variance, variation,
    row, smallest, best, chosen_normals, chosen_variation,
):  # fmt: skip
    """`choose_windows` of a row; ``smallest`` and ``best``, (W,) float32 and int64, are for work."""
    height, width = raw.shape
    inner = max(width - 2 * reach, 0)
    for column in range(width):
        own = variance[row, column]
        square = np.float64(raw[row, column]) ** 2
        usual = max(typical, rounding if is_disparity else rounding / (square * square))
        # NaN, where the pixel's own window has no plane, counts as larger than everything.
        smallest[column] = math.inf if own != own else own / ratio if own > ratio * usual else 0.0
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
    for column in range(width):
        place = best[column]
        a, b, c = normals[3 * place], normals[3 * place + 1], normals[3 * place + 2]
        towards = a * tan_x[row, column] + b * tan_y[row, column] + c
        there = (raw[row, column] >= lowest) & (raw[row, column] <= highest) & (towards < 0.0)
        nan = np.float32(0.0 if there else math.nan)
        chosen_normals[row, column, 0] = a + nan
        chosen_normals[row, column, 1] = b + nan
        chosen_normals[row, column, 2] = c + nan
        chosen_variation[row, column] = variation[place] + nan
