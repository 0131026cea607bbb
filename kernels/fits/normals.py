"""Normals, residuals and surface variation of the plane in the window around every pixel.

`sliding_window` moves the sums over the frame, `normals_row` makes planes of them. Each kernel works on some bands of
rows.
"""

import numpy as np

from .._jit.kernel import kernel
from ..moments import sliding_window
from ..moments.sliding_window import BAND, PITCH
from .normals_row import needed_pixels, normals_row, surface_row


@kernel()
def separable(frame, focal, rays, window, needed_by_size, wanted, bands, results):
    """The planes around the pixels of some bands, for a camera without lens distortion.

    Parameters
    ----------
    frame : RawFrame
    focal : (fx, fy)
    rays : tan_x and tan_y, (W,) and (H,) float64
    window : int
        Side of the windows in pixels.
    needed_by_size : (window² + 1,) float64
        Number of valid pixels that a window needs, by the number of its pixels.
    wanted : (surfaces, everywhere)
        Whether to write the variance and the variation, too; and if so, whether also around missing pixels, which
        otherwise get NaN.
    bands : (start, stop)
        Bands of `sliding_window.BAND` rows to write.
    results : normals, variance, variation; (H W 3,), (H W,) and (H W,) float32, written
        The last two are left alone unless they are wanted.
    """
    tan_x, tan_y = rays
    surfaces, everywhere = wanted
    band_start, band_stop = bands
    normals, variance, variation = results
    height, width = frame.raw.shape
    half = (window - 1) // 2
    strip = sliding_window.strip_width(width, window)
    slots = window + 1  # for the window's rows and the one that leaves
    rows = np.zeros((slots, 2 * PITCH))
    square_rows = np.zeros((slots, PITCH))
    valid_rows = np.zeros((slots, 3 * PITCH), np.float32)
    valid = np.zeros((slots, 3 * PITCH), np.float32)
    missing = np.zeros(slots, np.int64)
    wild = np.zeros(slots, np.int64)
    q = np.zeros(2 * PITCH)
    work = np.zeros((3, 2 * PITCH))
    valid_work = np.zeros((3, 3 * PITCH), np.float32)
    sums = np.zeros(3 * PITCH)
    squared = np.zeros(PITCH)
    squares = np.zeros(PITCH)
    valid_sums = np.zeros(6 * PITCH, np.float32)
    needed = np.empty(strip, np.float32)
    at_centre = np.zeros(strip)
    tan_y_row = np.empty(strip)
    all_wanted = np.ones(strip, np.float32)
    between = sliding_window.plan_steps(window)
    # Put together here: a tuple of arrays costs counted references each time.
    plane_sums, surface_sums, pixel = (sums, valid_sums), (sums, squares, valid_sums), (at_centre, at_centre)
    row_start = band_start * BAND
    row_stop = min(band_stop * BAND, height)

    for left in range(0, width, strip):
        columns = min(strip, width - left)
        count = columns + 2 * half
        row_tan_x = tan_x[left:]
        row_rays = row_tan_x, tan_y_row
        missing[:] = count  # a slot with none missing would have to hold the sums of a full row
        total_missing = 0
        for row in range(row_start - half, row_stop + half):
            # This row enters the window around row - half, and the one above the window leaves.
            slot = (row + half) % slots
            old = (row + half + 1) % slots
            was_missing = missing[slot]
            missing[slot], wild[slot] = sliding_window.read_row(
                frame, row, left - half, q[:count], valid[slot, :count]
            )  # fmt: skip
            total_missing += missing[slot]
            sliding_window.depth_sums_along_row(between, q, count, work, rows[slot])
            if surfaces:
                for i in range(count):
                    squared[i] = q[i] * q[i]
                sliding_window.sums_along_row(between, squared, count, work, square_rows[slot])
            if missing[slot] > 0 or was_missing > 0:
                sliding_window.valid_sums_along_row(between, valid[slot], count, valid_work, valid_rows[slot])
            centre = row - half
            if centre < row_start:
                continue
            if centre == row_start:
                valid_sums[:] = 0
                for y in range(-half, half + 1):
                    sliding_window.add_valid_row(y, valid_rows[(row + y) % slots], columns, valid_sums)
            else:
                if total_missing > 0:
                    sliding_window.move_valid_sums(half, valid_rows[old], valid_rows[slot], columns, valid_sums)
                total_missing -= missing[old]
            if centre % BAND == 0 or wild[old] > 0:
                sums[:] = 0.0
                squares[:] = 0.0
                for y in range(-half, half + 1):
                    sliding_window.add_depth_row(y, rows[(row + y) % slots], columns, sums)
                    sliding_window.add_row(square_rows[(row + y) % slots], columns, squares)
            else:
                sliding_window.move_depth_sums(half, rows[old], rows[slot], columns, sums)
                if surfaces:
                    sliding_window.move_sums(square_rows[old], square_rows[slot], columns, squares)

            if centre <= max(row_start, half) or centre >= height - half:  # in between, windows have all their rows
                needed_pixels(centre, left, half, (height, width), needed_by_size, needed[:columns])
            first = centre * width + left
            at_pixels = valid[row % slots, half:]
            if surfaces:
                tan_y_row[:] = tan_y[centre]
                surface_row(
                    surface_sums, all_wanted if everywhere else at_pixels, needed[:columns], focal, pixel, row_rays,
                    (normals[3 * first :], variance[first:], variation[first:]),
                )  # fmt: skip
            else:
                normals_row(
                    plane_sums, at_pixels, needed[:columns], focal, row_tan_x, tan_y[centre], normals[3 * first :]
                )  # fmt: skip


@kernel()
def distorted(frame, rays, window, needed_by_size, everywhere, bands, results):
    """The planes around the pixels of some bands, for any camera.

    Every pixel has a ray of its own, taken relative to the strip's middle one: the sums over valid pixels are not
    integers.

    Parameters
    ----------
    frame, window, needed_by_size, bands, results
        The same as for `separable`; all three results are written.
    rays : tan_x, tan_y, (H, W) float64 each
    everywhere : bool
        Whether to write planes around missing pixels, too, which otherwise get NaN.
    """
    tan_x, tan_y = rays
    band_start, band_stop = bands
    normals, variance, variation = results
    height, width = frame.raw.shape
    half = (window - 1) // 2
    strip = sliding_window.strip_width(width, window)
    slots = window + 1
    # Σq, Σqx, Σqy; Σ1, Σx, Σxx, Σy, Σxy, Σyy; Σq²
    channels = 10
    rows = np.zeros((slots, channels * PITCH))
    wild = np.zeros(slots, np.int64)
    valid = np.zeros((slots, PITCH), np.float32)
    q = np.zeros(PITCH)
    row_channels = np.zeros(channels * PITCH)
    work = np.zeros((3, channels * PITCH))
    sums = np.zeros(channels * PITCH)
    needed = np.empty(strip, np.float32)
    all_wanted = np.ones(strip, np.float32)
    x_pixel, y_pixel = np.empty(strip), np.empty(strip)
    between = sliding_window.plan_steps(window)
    row_start = band_start * BAND
    row_stop = min(band_stop * BAND, height)

    for left in range(0, width, strip):
        columns = min(strip, width - left)
        count = columns + 2 * half
        length = (channels - 1) * PITCH + count
        used = (channels - 1) * PITCH + columns
        x_reference = tan_x[height // 2, left + columns // 2]
        y_reference = tan_y[height // 2, left + columns // 2]
        first_column, last_column = max(left - half, 0), min(left + columns + half, width)
        margin = first_column - (left - half)
        row_channels[:] = 0.0
        for row in range(row_start - half, row_stop + half):
            slot = (row + half) % slots
            old = (row + half + 1) % slots
            _, wild[slot] = sliding_window.read_row(frame, row, left - half, q[:count], valid[slot, :count])
            nearest = min(max(row, 0), height - 1)  # beyond the frame nothing is valid, and any rays will do
            ray_channels(
                q[margin:], valid[slot, margin:], tan_x[nearest, first_column:last_column],
                tan_y[nearest, first_column:last_column], x_reference, y_reference, row_channels[margin:],
            )  # fmt: skip
            sliding_window.sums_along_row(between, row_channels, length, work, rows[slot])
            centre = row - half
            if centre < row_start:
                continue
            if centre % BAND == 0 or wild[old] > 0:
                sums[:] = 0.0
                for y in range(-half, half + 1):
                    sliding_window.add_row(rows[(row + y) % slots], used, sums)
            else:
                sliding_window.move_sums(rows[old], rows[slot], used, sums)

            if centre <= max(row_start, half) or centre >= height - half:
                needed_pixels(centre, left, half, (height, width), needed_by_size, needed[:columns])
            for i in range(columns):
                x_pixel[i] = tan_x[centre, left + i] - x_reference
                y_pixel[i] = tan_y[centre, left + i] - y_reference
            first = centre * width + left
            surface_row(
                (sums, sums[9 * PITCH :], sums[3 * PITCH :]),
                all_wanted if everywhere else valid[row % slots, half:], needed[:columns], (1.0, 1.0),
                (x_pixel, y_pixel), (tan_x[centre, left:], tan_y[centre, left:]),
                (normals[3 * first :], variance[first:], variation[first:]),
            )  # fmt: skip


@kernel(reduction=True, arrays=False)
def ray_channels(q, valid, tan_x, tan_y, x_reference, y_reference, channels):
    """q, qx, qy; 1, x, xx, y, xy, yy; q² of a row's valid pixels; zeros where missing."""
    for i in range(tan_x.shape[0]):
        there = np.float64(valid[i])
        x = there * (tan_x[i] - x_reference)
        y = there * (tan_y[i] - y_reference)
        channels[i] = q[i]
        channels[PITCH + i] = q[i] * x
        channels[2 * PITCH + i] = q[i] * y
        channels[3 * PITCH + i] = there
        channels[4 * PITCH + i] = x
        channels[5 * PITCH + i] = x * x
        channels[6 * PITCH + i] = y
        channels[7 * PITCH + i] = x * y
        channels[8 * PITCH + i] = y * y
        channels[9 * PITCH + i] = q[i] * q[i]
