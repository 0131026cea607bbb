"""Normals, residuals and surface variation of the plane in the window around every pixel.

Least squares of q on m (the paper's eq. RGBD_explicit_fit) over the valid pixels of each window, from the
sums that `sliding` moves over the frame. Each kernel works on some bands of rows.
"""

import math

import numpy as np

from . import sliding
from ._jit import kernel
from .sliding import BAND, PITCH

# Pixels count as collinear as in `solve`.
COLLINEAR = 1e-9


@kernel(reduction=True)
def normals_row(sums, valid_sums, valid, needed, fx, fy, tan_x, tan_y, normals):
    """Normals of a row of windows from their sums, for a camera without lens distortion.

    Only the direction of α matters, so the normal equations are solved up to the factor n·det(MᵀM): one
    division and one square root a pixel.
    """
    for i in range(needed.shape[0]):
        n = np.float64(valid_sums[i])
        x = np.float64(valid_sums[PITCH + i])
        y = np.float64(valid_sums[3 * PITCH + i])
        c_xx = n * valid_sums[2 * PITCH + i] - x * x
        c_xy = n * valid_sums[4 * PITCH + i] - x * y
        c_yy = n * valid_sums[5 * PITCH + i] - y * y
        q = sums[i]
        c_xq = n * sums[PITCH + i] - x * q
        c_yq = n * sums[2 * PITCH + i] - y * q
        determinant = c_xx * c_yy - c_xy * c_xy
        slope_x = c_yy * c_xq - c_xy * c_yq
        slope_y = c_xx * c_yq - c_xy * c_xq
        centre = determinant * q - slope_x * x - slope_y * y
        a = fx * (n * slope_x)
        b = fy * (n * slope_y)
        c = centre - a * tan_x[i] - b * tan_y
        enough = (valid_sums[i] >= needed[i]) & (valid[i] > np.float32(0.0))
        there = enough & (determinant > 0.0) & (centre > 0.0)
        inverse_norm = -1.0 / math.sqrt(a * a + b * b + c * c)
        inverse_norm = inverse_norm if there else math.nan
        normals[3 * i] = a * inverse_norm
        normals[3 * i + 1] = b * inverse_norm
        normals[3 * i + 2] = c * inverse_norm


@kernel(reduction=True)
def surface_row(
    sums, squares, valid_sums, wanted, needed, fx, fy, x_pixel, y_pixel, tan_x, tan_y,
    normals, variance, variation,
):  # fmt: skip
    """Normal, residual variance and surface variation of a row of windows.

    With C the covariance of the rays m in the window, m̄ and q̄ the means and s² the mean squared residual, the
    points X = m/q of the fitted plane spread by tr(J C Jᵀ), J = (I - m̄αᵀ/q̄)/q̄, to first order, and those
    measured leave the plane by s²d²/q̄².

    Parameters
    ----------
    sums, squares, valid_sums
        Σq, Σqx, Σqy; Σq²; Σ1, Σx, Σxx, Σy, Σxy, Σyy. tanθx is x / fx and tanθy y / fy but for a constant.
    wanted : (N,) float32
        1, or 0 for NaN.
    needed : (N,) float32
        Fewer valid pixels give NaN.
    x_pixel, y_pixel : (N,) float64
        The centre pixel in these coordinates.
    tan_x, tan_y : (N,) float64
        Its ray.
    normals, variance, variation : (3 N,), (N,), (N,) float32, written
        Variance of q about the plane in 1/m², with N - 3 degrees of freedom.
    """
    inverse_fx = 1.0 / fx
    inverse_fy = 1.0 / fy
    for i in range(needed.shape[0]):
        n = np.float64(valid_sums[i])
        share = 1.0 / n
        x = share * valid_sums[PITCH + i]
        y = share * valid_sums[3 * PITCH + i]
        q = share * sums[i]
        c_xx = share * valid_sums[2 * PITCH + i] - x * x
        c_xy = share * valid_sums[4 * PITCH + i] - x * y
        c_yy = share * valid_sums[5 * PITCH + i] - y * y
        c_xq = share * sums[PITCH + i] - x * q
        c_yq = share * sums[2 * PITCH + i] - y * q
        c_qq = share * squares[i] - q * q
        determinant = c_xx * c_yy - c_xy * c_xy
        trace = c_xx + c_yy
        inverse_determinant = 1.0 / determinant
        slope_x = (c_yy * c_xq - c_xy * c_yq) * inverse_determinant
        slope_y = (c_xx * c_yq - c_xy * c_xq) * inverse_determinant
        mean_square = c_qq - slope_x * c_xq - slope_y * c_yq
        mean_square = mean_square if mean_square > 0.0 else 0.0
        away_x = x - x_pixel[i]
        away_y = y - y_pixel[i]
        at_pixel = q - slope_x * away_x - slope_y * away_y
        a = fx * slope_x
        b = fy * slope_y
        c = at_pixel - a * tan_x[i] - b * tan_y[i]
        enough = (n >= needed[i]) & (wanted[i] > np.float32(0.0))
        there = enough & (determinant > COLLINEAR * trace * trace) & (at_pixel > 0.0)
        nan = 0.0 if there else math.nan
        inverse_norm = nan - 1.0 / math.sqrt(a * a + b * b + c * c)
        normals[3 * i] = a * inverse_norm
        normals[3 * i + 1] = b * inverse_norm
        normals[3 * i + 2] = c * inverse_norm
        variance[i] = nan + mean_square * n / (n - 3.0)
        # The spread of the points, times q̄².
        c_uu = c_xx * (inverse_fx * inverse_fx)
        c_uv = c_xy * (inverse_fx * inverse_fy)
        c_vv = c_yy * (inverse_fy * inverse_fy)
        u = tan_x[i] + away_x * inverse_fx
        v = tan_y[i] + away_y * inverse_fy
        z = 1.0 / q
        across = a * (u * c_uu + v * c_uv) + b * (u * c_uv + v * c_vv)
        along = a * a * c_uu + 2.0 * a * b * c_uv + b * b * c_vv
        spread = c_uu + c_vv + z * (z * (u * u + v * v + 1.0) * along - 2.0 * across)
        off_plane = mean_square * (inverse_norm * inverse_norm)
        variation[i] = nan + off_plane / (off_plane + spread)


@kernel()
def needed_pixels(row, left, half, height, width, max_missing, needed):
    """Number of valid pixels that the windows of a row need: at least three, and not too many missing.

    Windows are clipped at the frame.
    """
    rows = min(row + half, height - 1) - max(row - half, 0) + 1
    for i in range(needed.shape[0]):
        column = left + i
        pixels = rows * (min(column + half, width - 1) - max(column - half, 0) + 1)
        needed[i] = max(3, pixels - math.floor(pixels * max_missing + 1e-9))


@kernel()
def separable(
    raw, lowest, highest, scale, offset, is_disparity, fx, fy, tan_x, tan_y, window, max_missing,
    surfaces, everywhere, band_start, band_stop, normals, variance, variation,
):  # fmt: skip
    """The planes around the pixels of some bands, for a camera without lens distortion.

    Parameters
    ----------
    tan_x, tan_y : (W,) and (H,) float64
    surfaces : bool
        Write the variance and the variation too.
    everywhere : bool
        With ``surfaces``: the planes around missing pixels too, which otherwise get NaN.
    normals, variance, variation : (H W 3,), (H W,) and (H W,) float32, written
        The last two are left alone without ``surfaces``.
    """
    height, width = raw.shape
    half = (window - 1) // 2
    strip = sliding.strip_width(width, window)
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
    sizes, between = np.empty(5, np.int64), np.empty(5, np.int64)
    steps = sliding.plan_steps(window, sizes, between)
    row_start = band_start * BAND
    row_stop = min(band_stop * BAND, height)

    for left in range(0, width, strip):
        columns = min(strip, width - left)
        count = columns + 2 * half
        missing[:] = count  # a slot without missing pixels holds the sums of such a row
        total_missing = 0
        for row in range(row_start - half, row_stop + half):
            # This row enters the window around row - half, and the one above the window leaves.
            slot = (row + half) % slots
            old = (row + half + 1) % slots
            was_missing = missing[slot]
            missing[slot], wild[slot] = sliding.read_row(
                raw, row, left - half, lowest, highest, scale, offset, is_disparity,
                q[:count], valid[slot, :count],
            )  # fmt: skip
            total_missing += missing[slot]
            sliding.depth_sums_along_row(steps, sizes, between, q, count, work, rows[slot])
            if surfaces:
                for i in range(count):
                    squared[i] = q[i] * q[i]
                sliding.sums_along_row(steps, sizes, between, squared, count, work, square_rows[slot])
            if missing[slot] > 0 or was_missing > 0:
                sliding.valid_sums_along_row(
                    steps, sizes, between, valid[slot], count, valid_work, valid_rows[slot]
                )
            centre = row - half
            if centre < row_start:
                continue
            if centre == row_start:
                valid_sums[:] = 0
                for y in range(-half, half + 1):
                    sliding.add_valid_row(y, valid_rows[(row + y) % slots], columns, valid_sums)
            else:
                if total_missing > 0:
                    sliding.move_valid_sums(half, valid_rows[old], valid_rows[slot], columns, valid_sums)
                total_missing -= missing[old]
            if centre % BAND == 0 or wild[old] > 0:
                sums[:] = 0.0
                squares[:] = 0.0
                for y in range(-half, half + 1):
                    sliding.add_depth_row(y, rows[(row + y) % slots], columns, sums)
                    sliding.add_row(square_rows[(row + y) % slots], columns, squares)
            else:
                sliding.move_depth_sums(half, rows[old], rows[slot], columns, sums)
                if surfaces:
                    sliding.move_sums(square_rows[old], square_rows[slot], columns, squares)

            if (
                centre <= max(row_start, half) or centre >= height - half
            ):  # between, windows have all their rows
                needed_pixels(centre, left, half, height, width, max_missing, needed[:columns])
            first = centre * width + left
            at_pixels = valid[row % slots, half:]
            if surfaces:
                tan_y_row[:] = tan_y[centre]
                surface_row(
                    sums, squares, valid_sums, all_wanted if everywhere else at_pixels, needed[:columns],
                    fx, fy, at_centre, at_centre, tan_x[left:], tan_y_row,
                    normals[3 * first :], variance[first:], variation[first:],
                )  # fmt: skip
            else:
                normals_row(
                    sums, valid_sums, at_pixels, needed[:columns], fx, fy,
                    tan_x[left:], tan_y[centre], normals[3 * first :],
                )  # fmt: skip


@kernel()
def distorted(
    raw, lowest, highest, scale, offset, is_disparity, tan_x, tan_y, window, max_missing,
    everywhere, band_start, band_stop, normals, variance, variation,
):  # fmt: skip
    """The planes around the pixels of some bands as `separable` with ``surfaces``, for any camera.

    Every pixel has its own ray, taken relative to one of the strip's: the sums over valid pixels are real numbers.

    Parameters
    ----------
    tan_x, tan_y : (H, W) float64
    """
    height, width = raw.shape
    half = (window - 1) // 2
    strip = sliding.strip_width(width, window)
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
    sizes, between = np.empty(5, np.int64), np.empty(5, np.int64)
    steps = sliding.plan_steps(window, sizes, between)
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
            _, wild[slot] = sliding.read_row(
                raw, row, left - half, lowest, highest, scale, offset, is_disparity,
                q[:count], valid[slot, :count],
            )  # fmt: skip
            nearest = min(max(row, 0), height - 1)  # beyond the frame nothing is valid, and any rays will do
            ray_channels(
                q[margin:], valid[slot, margin:], tan_x[nearest, first_column:last_column],
                tan_y[nearest, first_column:last_column], x_reference, y_reference, row_channels[margin:],
            )  # fmt: skip
            sliding.sums_along_row(steps, sizes, between, row_channels, length, work, rows[slot])
            centre = row - half
            if centre < row_start:
                continue
            if centre % BAND == 0 or wild[old] > 0:
                sums[:] = 0.0
                for y in range(-half, half + 1):
                    sliding.add_row(rows[(row + y) % slots], used, sums)
            else:
                sliding.move_sums(rows[old], rows[slot], used, sums)

            if centre <= max(row_start, half) or centre >= height - half:
                needed_pixels(centre, left, half, height, width, max_missing, needed[:columns])
            for i in range(columns):
                x_pixel[i] = tan_x[centre, left + i] - x_reference
                y_pixel[i] = tan_y[centre, left + i] - y_reference
            first = centre * width + left
            surface_row(
                sums, sums[9 * PITCH :], sums[3 * PITCH :],
                all_wanted if everywhere else valid[row % slots, half:], needed[:columns], 1.0, 1.0,
                x_pixel, y_pixel, tan_x[centre, left:], tan_y[centre, left:],
                normals[3 * first :], variance[first:], variation[first:],
            )  # fmt: skip


@kernel(reduction=True)
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


@kernel()
def calmer(other, place, smallest, best):
    """Take the windows of smaller variance: ``place`` counts those of ``other`` in the frame."""
    for i in range(other.shape[0]):
        is_calmer = other[i] < smallest[i]
        smallest[i] = other[i] if is_calmer else smallest[i]
        best[i] = place + i if is_calmer else best[i]


@kernel()
def choose_windows(
    raw, lowest, highest, tan_x, tan_y, reach, ratio, normals, variance, variation, row_start, row_stop,
    chosen_normals, chosen_variation,
):  # fmt: skip
    """Give each valid pixel its window, or one of the eight that are moved by ``reach`` but still hold it.

    A moved window is taken, the one with the smallest residual variance, if its own window's is more than
    ``ratio`` times as large: an edge runs through it. The same idea as Kuwahara's filter of means (1976).
    At the border windows are moved less. A plane that the pixel's ray does not meet is none. Missing pixels
    get NaN.

    Parameters
    ----------
    tan_x, tan_y : (H, W) float64
    normals, variance, variation : (H W 3,), (H, W) and (H W,) float32
        Of `separable` or `distorted`.
    reach : int
        At least 1.
    chosen_normals, chosen_variation : (H, W, 3) and (H, W) float32, written
    """
    height, width = raw.shape
    smallest = np.empty(width, np.float32)
    best = np.empty(width, np.int64)
    inner = max(width - 2 * reach, 0)
    for row in range(row_start, row_stop):
        for column in range(width):
            own = variance[row, column]
            # Not a number, where the pixel's own window has no plane, is larger than everything.
            smallest[column] = own / ratio if own == own else math.inf
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
