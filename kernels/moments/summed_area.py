"""Summed-area tables, and the moments of any rectangle from their corners: the ``integral`` implementation.

A table has a border of zeros, so table[r, c] sums rows < r and columns < c, and a rectangle is four
look-ups without special cases. The channels of a pixel lie side by side: one pass fills them all, and a
look-up touches one place in memory.
"""

import math

import numpy as np

from .._jit.kernel import kernel
from ..common.depth import depth, inverse_depth

# Differences that are a smaller share of the sums are off by a thousandth of the root mean square or more.
LOST = 2.0**-31


@kernel()
def count_missing(frame):
    """Return the number of missing pixels of a frame."""
    raw, lowest, highest = frame.raw, frame.lowest, frame.highest
    missing = 0
    for row in range(raw.shape[0]):
        values = raw[row]
        for column in range(values.shape[0]):
            missing += 0 if (values[column] >= lowest) & (values[column] <= highest) else 1
    return missing


@kernel()
def value_row(frame, standard, row, values):
    """(Inverse) depths of an image row, 0 where missing: in a loop of its own, so that the divisions vectorise."""
    raw, lowest, highest, scale, offset, is_disparity = frame
    line = raw[row]
    for column in range(line.shape[0]):
        value = line[column]
        if standard is None:
            read = inverse_depth(value, scale, offset, is_disparity)
        else:
            read = depth(value, scale, offset, is_disparity)
        values[column] = read if (lowest <= value) & (value <= highest) else 0.0


@kernel(inline=True)
def add_up(above, middle, below, column, channel, upper, lower):
    """Write a channel of two table rows at one column, from sums along the two image rows up to there."""
    total = above[column, channel] + upper
    middle[column, channel] = total
    below[column, channel] = total + lower


@kernel()
def frame_tables(frame, rays, standard, tables):
    """The tables that depend on the frame.

    Two image rows at a time: the table's row above them is read half as often, and their sums do not wait for
    each other. Where the height is odd, the first row is the lower one of a pair whose upper one is all missing.

    Parameters
    ----------
    frame : RawFrame
    rays : tan_x, tan_y, (H, W) float64 each
    standard : True or None
        Tables of (X, Y, Z), or with None of range space.
    tables : (H + 1, W + 1, CHANNELS) float64, written
        In range space q·tanθx, q·tanθy and q, which are all that the explicit solution needs (Mᵗb of the paper). A
        fourth channel is q², for the implicit fit (eq. 14) and for residuals. In the standard form X, Y, Z, XX, XY, XZ,
        YY and YZ, for the explicit solution (eq. 9). A ninth channel is ZZ, for the implicit fit (eq. 6) and for
        residuals.
    """
    tan_x, tan_y = rays
    height, width = tan_x.shape
    squares = tables.shape[2] == (4 if standard is None else 9)
    upper = np.empty(width)
    lower = np.empty(width)
    tables[0] = 0.0
    for row in range(-(height % 2), height, 2):
        if row < 0:
            upper[:] = 0.0
        else:
            value_row(frame, standard, row, upper)
        value_row(frame, standard, row + 1, lower)
        upper_tan_x, lower_tan_x = tan_x[max(row, 0)], tan_x[row + 1]
        upper_tan_y, lower_tan_y = tan_y[max(row, 0)], tan_y[row + 1]
        above, middle, below = tables[max(row, 0)], tables[row + 1], tables[row + 2]
        middle[0] = 0.0
        below[0] = 0.0
        upper_x = upper_y = upper_w = upper_xx = upper_xy = upper_xw = upper_yy = upper_yw = upper_ww = 0.0
        lower_x = lower_y = lower_w = lower_xx = lower_xy = lower_xw = lower_yy = lower_yw = lower_ww = 0.0
        for column in range(width):
            w = upper[column]
            x = w * upper_tan_x[column]
            y = w * upper_tan_y[column]
            upper_w += w
            upper_x += x
            upper_y += y
            if standard is not None:
                upper_xx += x * x
                upper_xy += x * y
                upper_xw += x * w
                upper_yy += y * y
                upper_yw += y * w
            if squares:
                upper_ww += w * w
            w = lower[column]
            x = w * lower_tan_x[column]
            y = w * lower_tan_y[column]
            lower_w += w
            lower_x += x
            lower_y += y
            to = column + 1
            add_up(above, middle, below, to, 0, upper_x, lower_x)
            add_up(above, middle, below, to, 1, upper_y, lower_y)
            add_up(above, middle, below, to, 2, upper_w, lower_w)
            if standard is not None:
                lower_xx += x * x
                lower_xy += x * y
                lower_xw += x * w
                lower_yy += y * y
                lower_yw += y * w
                add_up(above, middle, below, to, 3, upper_xx, lower_xx)
                add_up(above, middle, below, to, 4, upper_xy, lower_xy)
                add_up(above, middle, below, to, 5, upper_xw, lower_xw)
                add_up(above, middle, below, to, 6, upper_yy, lower_yy)
                add_up(above, middle, below, to, 7, upper_yw, lower_yw)
            if squares:
                lower_ww += w * w
                add_up(above, middle, below, to, 3 if standard is None else 8, upper_ww, lower_ww)


@kernel()
def camera_tables(tan_x, tan_y, tables):
    """The tables of range space that hold camera terms only: computed once for a camera.

    ``tables`` is (H + 1, W + 1, 6): 1, tanθx, tanθy, tanθx², tanθx·tanθy, tanθy² (eq. 16).
    """
    tables[0] = 0.0
    for row in range(tan_x.shape[0]):
        above = tables[row]
        below = tables[row + 1]
        below[0] = 0.0
        sum_1 = sum_x = sum_y = sum_xx = sum_xy = sum_yy = 0.0
        for column in range(tan_x.shape[1]):
            x = tan_x[row, column]
            y = tan_y[row, column]
            sum_1 += 1.0
            sum_x += x
            sum_y += y
            sum_xx += x * x
            sum_xy += x * y
            sum_yy += y * y
            below[column + 1, 0] = above[column + 1, 0] + sum_1
            below[column + 1, 1] = above[column + 1, 1] + sum_x
            below[column + 1, 2] = above[column + 1, 2] + sum_y
            below[column + 1, 3] = above[column + 1, 3] + sum_xx
            below[column + 1, 4] = above[column + 1, 4] + sum_xy
            below[column + 1, 5] = above[column + 1, 5] + sum_yy


@kernel()
def missing_table(frame, table):
    """The table of the number of missing pixels, (H + 1, W + 1, 1)."""
    raw, lowest, highest = frame.raw, frame.lowest, frame.highest
    table[0] = 0.0
    for row in range(raw.shape[0]):
        table[row + 1, 0, 0] = 0.0
        missing = 0.0
        for column in range(raw.shape[1]):
            if not lowest <= raw[row, column] <= highest:
                missing += 1.0
            table[row + 1, column + 1, 0] = table[row, column + 1, 0] + missing


@kernel()
def missing_rays(frame, rays, before, sums):
    """The camera terms of the missing pixels, to subtract from those of `camera_tables` where a frame has holes.

    They are few. So instead of five more tables there is a list of their running sums in the order of the pixels. A
    part of an image row is the difference of two of its entries.

    Parameters
    ----------
    frame : RawFrame
    rays : tan_x, tan_y, (H, W) float64 each
    before : (H, W + 1) int32, written
        Number of missing pixels before a column of a row, those in all earlier rows included.
    sums : (missing + 1, 5) float64, written
        tanθx, tanθy, tanθx², tanθx·tanθy, tanθy² summed over the first 0, 1, 2, ... missing pixels.
    """
    raw, lowest, highest = frame.raw, frame.lowest, frame.highest
    tan_x, tan_y = rays
    sums[0] = 0.0
    missing = 0
    for row in range(raw.shape[0]):
        for column in range(raw.shape[1]):
            before[row, column] = missing
            # Of a frame that is overwritten meanwhile, by a camera's driver, more may be missing than were counted.
            if not lowest <= raw[row, column] <= highest and missing + 1 < len(sums):
                x = tan_x[row, column]
                y = tan_y[row, column]
                sums[missing + 1, 0] = sums[missing, 0] + x
                sums[missing + 1, 1] = sums[missing, 1] + y
                sums[missing + 1, 2] = sums[missing, 2] + x * x
                sums[missing + 1, 3] = sums[missing, 3] + x * y
                sums[missing + 1, 4] = sums[missing, 4] + y * y
                missing += 1
        before[row, raw.shape[1]] = missing


@kernel(inline=True)
def window_sum(tables, window, channel):
    """Sum of a channel over a window (row, column, height, width)."""
    top, left = window[0], window[1]
    bottom, right = top + window[2], left + window[3]
    return (
        tables[bottom, right, channel]
        - tables[top, right, channel]
        - tables[bottom, left, channel]
        + tables[top, left, channel]
    )


@kernel()
def camera_window_moments(camera, windows, start, stop, full):
    """Camera terms of windows ``start`` to ``stop``, as if no pixel were missing: the same for every frame.

    ``full`` is (6, K): 1, tanθx, tanθy, tanθx², tanθx·tanθy, tanθy².
    """
    for i in range(start, stop):
        window = windows[i]
        for channel in range(6):
            full[channel, i] = window_sum(camera, window, channel)


@kernel()
def range_window_moments(tables, before, sums, windows, full, start, stop, moments):
    """Range-space moments, about the origin, of windows ``start`` to ``stop``.

    ``full`` holds the camera terms, from `camera_window_moments`, so only the 4 sums that depend on the frame are
    looked up. ``before`` and ``sums`` come from `missing_rays`, and are empty for a frame without holes; with them a
    window costs two look-ups for each of its rows. Where ``tables`` have no q², Σqq is NaN. Where hardly a digit of it
    is left, Σuu is NaN, which makes the window DEGENERATE.
    """
    squares = tables.shape[2] == 4
    for i in range(start, stop):
        window = windows[i]
        moments[0, i] = full[0, i]
        moments[1, i] = full[1, i]
        moments[2, i] = full[2, i]
        moments[3, i] = window_sum(tables, window, 2)
        moments[4, i] = full[3, i]
        moments[5, i] = full[4, i]
        moments[6, i] = window_sum(tables, window, 0)
        moments[7, i] = full[5, i]
        moments[8, i] = window_sum(tables, window, 1)
        moments[9, i] = window_sum(tables, window, 3) if squares else math.nan
        if before.shape[0] > 0:
            left, right = window[1], window[1] + window[3]
            for row in range(window[0], window[0] + window[2]):
                first, last = before[row, left], before[row, right]
                if last > first:
                    moments[0, i] -= last - first
                    moments[1, i] -= sums[last, 0] - sums[first, 0]
                    moments[2, i] -= sums[last, 1] - sums[first, 1]
                    moments[4, i] -= sums[last, 2] - sums[first, 2]
                    moments[5, i] -= sums[last, 3] - sums[first, 3]
                    moments[7, i] -= sums[last, 4] - sums[first, 4]
        largest = tables[window[0] + window[2], window[1] + window[3], 3] if squares else 0.0
        if moments[0, i] > 0.0 and moments[9, i] < LOST * largest:
            moments[4, i] = math.nan


@kernel()
def standard_window_moments(tables, missing, windows, full, start, stop, moments):
    """Moments of (X, Y, Z), about the origin, of windows ``start`` to ``stop``.

    ``missing`` comes from `missing_table`, and is empty for a frame without holes. All but the number of pixels depends
    on the frame: ``full``, which range space needs, is not used. Where hardly a digit is left, ΣXX is NaN.
    """
    moments[9, start:stop] = math.nan
    for i in range(start, stop):
        window = windows[i]
        moments[0, i] = window[2] * window[3]
        if missing.shape[0] > 0:
            moments[0, i] -= window_sum(missing, window, 0)
        for channel in range(tables.shape[2]):
            moments[channel + 1, i] = window_sum(tables, window, channel)
        corner = tables[window[0] + window[2], window[1] + window[3]]
        if moments[0, i] > 0.0 and tables.shape[2] == 9:
            squares = moments[4, i] + moments[7, i] + moments[9, i]
            if squares < LOST * (corner[3] + corner[6] + corner[8]):
                moments[4, i] = math.nan
