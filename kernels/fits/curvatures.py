"""Principal curvatures around every pixel: quadratics in inverse depth of sliding windows.

Sums over windows slide down the columns as in `moments.sliding_window`, in plain coordinates (X, Y) of a strip of
columns and a band of rows. They are moved to a window's centre afterwards. Without lens distortion rays are a pixel
apart: a whole window's normal equations are solved in closed form, and what is missing is subtracted, in whole numbers.
Windows in which pixels are missing are gathered and solved side by side.
"""

import math

import numpy as np

from .._jit.kernel import kernel
from ..moments import sliding_window
from ..moments.sliding_window import BAND, PITCH
from ..moments.strips import TILES
from ..moments.surface_tiles import (
    QQ,
    QU,
    QUU,
    QUV,
    QV,
    QVV,
    SURFACE_SUMS,
    UU,
    UUU,
    UUUU,
    UUUV,
    UUV,
    UUVV,
    UV,
    UVV,
    UVVV,
    VV,
    VVV,
    VVVV,
    N,
    Q,
    U,
    V,
)
from ..solvers.curvatures import gaussian_curvature, mean_curvature, principal_pair, tangent_distance
from ..solvers.quadratic import QUADRATIC_WORK, RESIDUAL, solve_quadratics
from .normals_row import needed_pixels

# Channels of sums over windows: q·XⁱYʲ with i + j <= 2, then XⁱYʲ with i + j <= 4, each in the order of the moments.
DEPTHS, PIXELS = 6, 15
# Columns of a strip where each pixel has its own ray: powers of what is farther away cost digits.
NARROW = 128


@kernel(inline=True)
def write_curvatures(derivatives, u, v, place, curvatures):
    """Write κ₁ and κ₂ from q and its derivatives at the ray (u, v); NaN where it does not meet the surface.

    ``derivatives`` are q, the two of first order, and those along u twice, along u and v, and along v twice.
    """
    q, a, b, r, s, t = derivatives
    d = tangent_distance(q, a, b, u, v)
    k_1, k_2 = principal_pair(mean_curvature(q, a, b, r, s, t, u, v, d), gaussian_curvature(q, r, s, t, d))
    nothing = 0.0 if q > 0.0 else math.nan
    curvatures[2 * place] = k_1 + nothing
    curvatures[2 * place + 1] = k_2 + nothing


@kernel(inline=True)
def moved(pixels, depths, i, x, y, moments, column):
    """Write a window's sums relative to (x, y) as column ``column`` of moments."""
    n, s_x, s_y = pixels[0, i], pixels[1, i], pixels[2, i]
    s_xx, s_xy, s_yy = pixels[3, i], pixels[4, i], pixels[5, i]
    s_xxx, s_xxy, s_xyy, s_yyy = pixels[6, i], pixels[7, i], pixels[8, i], pixels[9, i]
    s_xxxx, s_xxxy, s_xxyy = pixels[10, i], pixels[11, i], pixels[12, i]
    s_xyyy, s_yyyy = pixels[13, i], pixels[14, i]
    # Along x first, highest powers first.
    s_xxxx += x * (-4.0 * s_xxx + x * (6.0 * s_xx + x * (-4.0 * s_x + x * n)))
    s_xxxy += x * (-3.0 * s_xxy + x * (3.0 * s_xy - x * s_y))
    s_xxyy += x * (-2.0 * s_xyy + x * s_yy)
    s_xyyy -= x * s_yyy
    s_xxx += x * (-3.0 * s_xx + x * (3.0 * s_x - x * n))
    s_xxy += x * (-2.0 * s_xy + x * s_y)
    s_xyy -= x * s_yy
    s_xx += x * (-2.0 * s_x + x * n)
    s_xy -= x * s_y
    s_x -= x * n
    s_yyyy += y * (-4.0 * s_yyy + y * (6.0 * s_yy + y * (-4.0 * s_y + y * n)))
    s_xyyy += y * (-3.0 * s_xyy + y * (3.0 * s_xy - y * s_x))
    s_xxyy += y * (-2.0 * s_xxy + y * s_xx)
    s_xxxy -= y * s_xxx
    s_yyy += y * (-3.0 * s_yy + y * (3.0 * s_y - y * n))
    s_xyy += y * (-2.0 * s_xy + y * s_x)
    s_xxy -= y * s_xx
    s_yy += y * (-2.0 * s_y + y * n)
    s_xy -= y * s_x
    s_y -= y * n
    moments[N, column], moments[U, column], moments[V, column] = n, s_x, s_y
    moments[UU, column], moments[UV, column], moments[VV, column] = s_xx, s_xy, s_yy
    moments[UUU, column], moments[UUV, column], moments[UVV, column] = s_xxx, s_xxy, s_xyy
    moments[VVV, column], moments[UUUU, column], moments[UUUV, column] = s_yyy, s_xxxx, s_xxxy
    moments[UUVV, column], moments[UVVV, column], moments[VVVV, column] = s_xxyy, s_xyyy, s_yyyy
    q, q_x, q_y = depths[0, i], depths[1, i], depths[2, i]
    moments[Q, column] = q
    moments[QU, column] = q_x - x * q
    moments[QV, column] = q_y - y * q
    moments[QUU, column] = depths[3, i] - x * (2.0 * q_x - x * q)
    moments[QUV, column] = depths[4, i] - x * q_y - y * q_x + x * y * q
    moments[QVV, column] = depths[5, i] - y * (2.0 * q_y - y * q)
    moments[QQ, column] = 0.0  # nobody asks for the residual


@kernel(inline=True)
def write_gathered(room, number, columns, focal, tan_x, tan_y, first, curvatures):
    """Solve the windows that were gathered, and write their curvatures."""
    fx, fy = focal
    moments, reference, work = room[:SURFACE_SUMS], room[SURFACE_SUMS], room[SURFACE_SUMS + 1 :]
    for k in range(number):
        reference[k] = 0.0
    solve_quadratics(moments, reference, number, work)
    for k in range(number):
        i = columns[k]
        nothing = 0.0 * work[RESIDUAL, k]  # NaN where the window's pixels lie on a conic
        write_curvatures(
            (
                work[0, k] + nothing, fx * work[1, k], fy * work[2, k],
                2.0 * fx * fx * work[3, k], fx * fy * work[4, k], 2.0 * fy * fy * work[5, k],
            ),
            tan_x[i], tan_y[i], first + i, curvatures,
        )  # fmt: skip


@kernel(reduction=True, arrays=False)
def add_depth_sums(row, y, sign, length, depths):
    """Add a row's sums of q, qX and qXX at Y = ``y``, times ``sign``, to those of windows."""
    from_q, from_x, from_xx = row[:PITCH], row[PITCH : 2 * PITCH], row[2 * PITCH :]
    to_q, to_x, to_y, to_xx, to_xy, to_yy = depths[0], depths[1], depths[2], depths[3], depths[4], depths[5]
    sign_y, sign_yy = sign * y, sign * y * y
    for i in range(length):
        to_q[i] += sign * from_q[i]
        to_x[i] += sign * from_x[i]
        to_y[i] += sign_y * from_q[i]
        to_xx[i] += sign * from_xx[i]
        to_xy[i] += sign_y * from_x[i]
        to_yy[i] += sign_yy * from_q[i]


@kernel(reduction=True, arrays=False)
def add_pixel_sums(row, y, sign, length, pixels):
    """Add a row's sums of 1, X, ..., X⁴ at Y = ``y``, times ``sign``, to those of windows."""
    from_1, from_x, from_xx = row[:PITCH], row[PITCH : 2 * PITCH], row[2 * PITCH : 3 * PITCH]
    from_xxx, from_xxxx = row[3 * PITCH : 4 * PITCH], row[4 * PITCH :]
    for k in range(PIXELS):
        power = POWERS_OF_Y[k]
        factor = sign
        for _ in range(power):
            factor *= y
        to = pixels[k]
        if POWERS_OF_X[k] == 0:
            for i in range(length):
                to[i] += factor * from_1[i]
        elif POWERS_OF_X[k] == 1:
            for i in range(length):
                to[i] += factor * from_x[i]
        elif POWERS_OF_X[k] == 2:
            for i in range(length):
                to[i] += factor * from_xx[i]
        elif POWERS_OF_X[k] == 3:
            for i in range(length):
                to[i] += factor * from_xxx[i]
        else:
            for i in range(length):
                to[i] += factor * from_xxxx[i]


POWERS_OF_X = np.array([0, 1, 0, 2, 1, 0, 3, 2, 1, 0, 4, 3, 2, 1, 0])
POWERS_OF_Y = np.array([0, 0, 1, 0, 1, 2, 0, 1, 2, 3, 0, 1, 2, 3, 4])


@kernel(reduction=True, arrays=False)
def depth_powers(q, x_first, count, channels):
    """q, qX and qXX of a row, X counted from ``x_first``."""
    for i in range(count):
        x = x_first + i
        channels[i] = q[i]
        channels[PITCH + i] = q[i] * x
        channels[2 * PITCH + i] = q[i] * x * x


@kernel(reduction=True, arrays=False)
def missing_powers(valid, x_first, count, channels):
    """1, X, ..., X⁴ of a row's missing pixels."""
    for i in range(count):
        x = x_first + i
        one = 1.0 - np.float64(valid[i])
        channels[i] = one
        one *= x
        channels[PITCH + i] = one
        one *= x
        channels[2 * PITCH + i] = one
        one *= x
        channels[3 * PITCH + i] = one
        one *= x
        channels[4 * PITCH + i] = one


@kernel(reduction=True, arrays=False)
def whole_windows(depths, missing, valid, count, x_0, y_0, fx, fy, terms, tan_x, v, curvatures):
    """Write κ₁ and κ₂ of a row of windows in which nothing is missing, in closed form; NaN for the others.

    Parameters
    ----------
    depths : (DEPTHS, PITCH) float64
    missing, valid
        Number of missing pixels of each window, and whether its centre is valid.
    x_0, y_0 : float
        The first window's centre in the coordinates of ``depths``.
    terms : tuple of 5 floats
        One over the number of pixels; the mean of x² over a window; one over the sums of x², of (x² - its mean)² and of
        x²y².
    tan_x : (W,) float64
        Of the windows' centres; ``v`` is their tanθy.
    """
    per_pixel, spread, per_xx, per_bend, per_xxyy = terms
    from_q, from_x, from_y, from_xx, from_xy, from_yy = depths[0], depths[1], depths[2], depths[3], depths[4], depths[5]
    for i in range(count):
        x = x_0 + i
        s_q, s_x, s_y = from_q[i], from_x[i], from_y[i]
        xx = from_xx[i] - x * (2.0 * s_x - x * s_q)
        xy = from_xy[i] - x * s_y - y_0 * s_x + x * y_0 * s_q
        yy = from_yy[i] - y_0 * (2.0 * s_y - y_0 * s_q)
        bend_x, bend_y = (xx - spread * s_q) * per_bend, (yy - spread * s_q) * per_bend
        q = s_q * per_pixel - spread * (bend_x + bend_y)
        there = (valid[i] > np.float32(0.0)) & (missing[i] == 0.0)
        write_curvatures(
            (
                q if there else math.nan, fx * per_xx * (s_x - x * s_q), fy * per_xx * (s_y - y_0 * s_q),
                2.0 * fx * fx * bend_x, fx * fy * per_xxyy * xy, 2.0 * fy * fy * bend_y,
            ),
            tan_x[i], v, i, curvatures,
        )  # fmt: skip


@kernel()
def separable_curvatures(
    frame, fx, fy, tan_x, tan_y, window, needed_by_size,
    band_start, band_stop, curvatures,
):  # fmt: skip
    """Principal curvatures around the pixels of some bands of `BAND` rows, for a camera without lens distortion.

    Parameters
    ----------
    frame : RawFrame
    fx, fy : float
        tanθx and tanθy change by 1 / fx and 1 / fy from pixel to pixel.
    tan_x, tan_y : (W,) and (H,) float64
    window : int
        Odd.
    needed_by_size : (window² + 1,) float64
        Number of valid pixels that a window needs, by the number of its pixels.
    curvatures : (H W 2,) float32, written
        κ₁ and κ₂ in 1/m, NaN where the pixel is missing or too much of its window is.
    """
    height, width = frame.raw.shape
    half = (window - 1) // 2
    strip = sliding_window.strip_width(width, window)
    slots = window + 1
    rows, missing_rows = np.zeros((slots, 3 * PITCH)), np.zeros((slots, 5 * PITCH))
    valid = np.zeros((slots, PITCH), np.float32)
    missing, wild = np.zeros(slots, np.int64), np.zeros(slots, np.int64)
    q, channels, work = np.zeros(PITCH), np.zeros(5 * PITCH), np.zeros((3, 5 * PITCH))
    depths, pixels = np.zeros((DEPTHS, PITCH)), np.zeros((PIXELS, PITCH))
    whole = np.zeros((PIXELS, 1))
    needed = np.empty(strip, np.float32)
    tan_y_row = np.empty(strip)
    room, gathered = np.empty((SURFACE_SUMS + 1 + QUADRATIC_WORK, TILES)), np.empty(TILES, np.int64)
    room[:] = 0.0
    between = sliding_window.plan_steps(window)
    row_start, row_stop = band_start * BAND, min(band_stop * BAND, height)
    size = float(window * window)
    for x in range(-half, half + 1):
        for y in range(-half, half + 1):
            for k in range(PIXELS):
                whole[k, 0] += float(x) ** POWERS_OF_X[k] * float(y) ** POWERS_OF_Y[k]
    spread = whole[3, 0] / size
    terms = 1.0 / size, spread, 1.0 / whole[3, 0], 1.0 / (whole[10, 0] - whole[3, 0] * spread), 1.0 / whole[12, 0]

    for left in range(0, width, strip):
        columns = min(strip, width - left)
        count = columns + 2 * half
        x_first = -float(count // 2)
        missing[:] = count
        for row in range(row_start - half, row_stop + half):
            slot, old = (row + half) % slots, (row + half + 1) % slots
            _, wild[slot] = sliding_window.read_row(frame, row, left - half, q[:count], valid[slot, :count])
            gone = 0  # what is beyond the frame is missing, too
            for i in range(count):
                gone += 1 if valid[slot, i] == np.float32(0.0) else 0
            missing[slot] = gone
            depth_powers(q, x_first, count, channels)
            sliding_window.sums_along_row(between, channels, 2 * PITCH + count, work, rows[slot])
            if gone > 0:
                missing_powers(valid[slot], x_first, count, channels)
                sliding_window.sums_along_row(between, channels, 4 * PITCH + count, work, missing_rows[slot])
            centre = row - half
            if centre < row_start:
                continue
            middle = centre // BAND * BAND + BAND // 2  # of the band: Y is counted from there
            if centre % BAND == 0 or wild[old] > 0:
                depths[:] = 0.0
                pixels[:] = 0.0
                for y in range(-half, half + 1):
                    source = (row + y) % slots
                    at = float(centre + y - middle)
                    add_depth_sums(rows[source], at, 1.0, columns, depths)
                    if missing[source] > 0:
                        add_pixel_sums(missing_rows[source], at, 1.0, columns, pixels)
            else:
                add_depth_sums(rows[slot], float(row - middle), 1.0, columns, depths)
                add_depth_sums(rows[old], float(centre - half - 1 - middle), -1.0, columns, depths)
                if missing[slot] > 0:
                    add_pixel_sums(missing_rows[slot], float(row - middle), 1.0, columns, pixels)
                if missing[old] > 0:
                    add_pixel_sums(missing_rows[old], float(centre - half - 1 - middle), -1.0, columns, pixels)
            if centre <= max(row_start, half) or centre >= height - half:
                needed_pixels(centre, left, half, frame.raw.shape, needed_by_size, needed[:columns])
            first = centre * width + left
            at_pixels = valid[row % slots, half:]
            v, y_0 = tan_y[centre], float(centre - middle)
            number = 0
            whole_windows(
                depths, pixels[0], at_pixels, columns, x_first + half, y_0, fx, fy, terms, tan_x[left:], v,
                curvatures[2 * first :],
            )  # fmt: skip
            for i in range(columns):
                if at_pixels[i] == np.float32(0.0) or pixels[0, i] == 0.0:
                    continue
                if size - pixels[0, i] >= needed[i]:
                    moved(pixels, depths, i, x_first + half + i, y_0, room, number)
                    for k in range(PIXELS):
                        room[k, number] = whole[k, 0] - room[k, number]
                    gathered[number] = i
                    number += 1
                    if number == TILES:
                        tan_y_row[:] = v
                        write_gathered(room, number, gathered, (fx, fy), tan_x[left:], tan_y_row, first, curvatures)
                        number = 0
            if number > 0:
                tan_y_row[:] = v
                write_gathered(room, number, gathered, (fx, fy), tan_x[left:], tan_y_row, first, curvatures)


@kernel(reduction=True, arrays=False)
def ray_powers(q, valid, tan_x, tan_y, reference, focal, channels):
    """The channels of a row of pixels whose rays are given, relative to a ray, in units of about a pixel."""
    x_reference, y_reference = reference
    fx, fy = focal
    for i in range(tan_x.shape[0]):
        there = np.float64(valid[i])
        x, y = there * fx * (tan_x[i] - x_reference), there * fy * (tan_y[i] - y_reference)
        xx, xy, yy = x * x, x * y, y * y
        channels[i] = q[i]
        channels[PITCH + i] = q[i] * x
        channels[2 * PITCH + i] = q[i] * y
        channels[3 * PITCH + i] = q[i] * xx
        channels[4 * PITCH + i] = q[i] * xy
        channels[5 * PITCH + i] = q[i] * yy
        channels[6 * PITCH + i] = there
        channels[7 * PITCH + i] = x
        channels[8 * PITCH + i] = y
        channels[9 * PITCH + i] = xx
        channels[10 * PITCH + i] = xy
        channels[11 * PITCH + i] = yy
        channels[12 * PITCH + i] = xx * x
        channels[13 * PITCH + i] = xx * y
        channels[14 * PITCH + i] = xy * y
        channels[15 * PITCH + i] = yy * y
        channels[16 * PITCH + i] = xx * xx
        channels[17 * PITCH + i] = xx * xy
        channels[18 * PITCH + i] = xx * yy
        channels[19 * PITCH + i] = xy * yy
        channels[20 * PITCH + i] = yy * yy


@kernel()
def distorted_curvatures(
    frame, fx, fy, tan_x, tan_y, window, needed_by_size,
    band_start, band_stop, curvatures,
):  # fmt: skip
    """As `separable_curvatures` for any camera, of which tan_x and tan_y are (H, W)."""
    height, width = frame.raw.shape
    half = (window - 1) // 2
    slots = window + 1
    total = DEPTHS + PIXELS
    rows, row_channels = np.zeros((slots, total * PITCH)), np.zeros(total * PITCH)
    valid, wild = np.zeros((slots, PITCH), np.float32), np.zeros(slots, np.int64)
    q, work, sums = np.zeros(PITCH), np.zeros((3, total * PITCH)), np.zeros(total * PITCH)
    by_channel = sums.reshape(total, PITCH)
    needed = np.empty(NARROW, np.float32)
    room, gathered = np.empty((SURFACE_SUMS + 1 + QUADRATIC_WORK, TILES)), np.empty(TILES, np.int64)
    room[:] = 0.0
    between = sliding_window.plan_steps(window)
    row_start, row_stop = band_start * BAND, min(band_stop * BAND, height)

    for left in range(0, width, NARROW):
        columns = min(NARROW, width - left)
        count = columns + 2 * half
        first_column, last_column = max(left - half, 0), min(left + columns + half, width)
        margin = first_column - (left - half)
        row_channels[:] = 0.0
        x_reference = y_reference = 0.0
        for centre in range(row_start, row_stop):
            # Sums are taken anew for short runs of rows, about a ray near them.
            is_new = centre == row_start or centre % BAND == 0 or wild[(centre - 1) % slots] > 0
            if is_new:
                middle = min(centre // BAND * BAND + BAND // 2, height - 1)
                x_reference, y_reference = tan_x[middle, left + columns // 2], tan_y[middle, left + columns // 2]
                sums[:] = 0.0
            for row in range(centre - half if is_new else centre + half, centre + half + 1):
                slot = (row + half) % slots
                _, wild[slot] = sliding_window.read_row(frame, row, left - half, q[:count], valid[slot, :count])
                nearest = min(max(row, 0), height - 1)  # beyond the frame nothing is valid, and any rays will do
                ray_powers(
                    q[margin:], valid[slot, margin:], tan_x[nearest, first_column:last_column],
                    tan_y[nearest, first_column:last_column], (x_reference, y_reference), (fx, fy),
                    row_channels[margin:],
                )  # fmt: skip
                sliding_window.sums_along_row(between, row_channels, (total - 1) * PITCH + count, work, rows[slot])
                sliding_window.add_row(rows[slot], (total - 1) * PITCH + columns, sums)
            if not is_new:
                old = rows[(centre - 1) % slots]
                for i in range((total - 1) * PITCH + columns):
                    sums[i] -= old[i]
            needed_pixels(centre, left, half, frame.raw.shape, needed_by_size, needed[:columns])
            first = centre * width + left
            at_pixels = valid[(centre + half) % slots, half:]
            number = 0
            for i in range(columns):
                curvatures[2 * (first + i)] = curvatures[2 * (first + i) + 1] = math.nan
                if at_pixels[i] > np.float32(0.0) and by_channel[DEPTHS, i] >= needed[i]:
                    x = fx * (tan_x[centre, left + i] - x_reference)
                    y = fy * (tan_y[centre, left + i] - y_reference)
                    moved(by_channel[DEPTHS:], by_channel[:DEPTHS], i, x, y, room, number)
                    gathered[number] = i
                    number += 1
            write_gathered(
                room, number, gathered, (fx, fy), tan_x[centre, left:], tan_y[centre, left:], first, curvatures
            )
