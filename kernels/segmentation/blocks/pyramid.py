"""Segmentation: the frame in blocks of a few pixels, and in squares of 2x2, 4x4, ... blocks.

The frame is read once, for the moments and the plane of each block and of each square.
"""

import numpy as np

from ..._jit.kernel import kernel
from ...common.arrays import copy
from ..model.moments import solve
from ..model.pixel_noise import through_lens
from ..model.records import BLOCK

# Blocks of a row that are processed together: half of 640 pixels, whole vectors, and whole squares of 8 blocks, so that
# none begins beyond the frame.
CHUNK = 80


@kernel(inline=True)
def inverse_of(value, lowest, highest, scale, offset, is_disparity):
    """Inverse depth of a raw value, 0 if it is not a measurement."""
    valid = (value >= lowest) & (value <= highest)
    if is_disparity:
        return np.float32(scale * value + offset) if valid else np.float32(0.0)
    return np.float32(scale) / np.float32(value if valid else lowest) if valid else np.float32(0.0)


@kernel(inline=True)
def solve_squares(sums, count, rays, rss, slope_square):
    """Sums of squared residuals, and squared slopes, of the planes of squares with moments ``sums`` (10, CHUNK)."""
    for c in range(count):
        error, a, b, _ = solve(
            sums[0, c], sums[1, c], sums[2, c], sums[3, c], sums[4, c],
            sums[5, c], sums[6, c], sums[7, c], sums[8, c], sums[9, c],
        )  # fmt: skip
        rss[c] = error
        slope_square[c] = (rays.pitch_x * a) ** 2 + (rays.pitch_y * b) ** 2
    if rays.lens.shape[1] > 0:
        for c in range(count):
            _, a, b, _ = solve(
                sums[0, c], sums[1, c], sums[2, c], sums[3, c], sums[4, c],
                sums[5, c], sums[6, c], sums[7, c], sums[8, c], sums[9, c],
            )  # fmt: skip
            slope_square[c] = through_lens(
                a, b, rays.pitch_x**2, rays.pitch_y**2, rays.lens,
                sums[0, c], sums[4, c], sums[5, c], sums[7, c],
            )  # fmt: skip


@kernel(inline=True)
def apart(values, where):
    """Copy a row's pixels of adjacent blocks: the first column of each block, then the second ones, and so on."""
    for c in range(len(values) // BLOCK):
        x = c * BLOCK
        where[c], where[CHUNK + c] = values[x], values[x + 1]
        where[2 * CHUNK + c], where[3 * CHUNK + c] = values[x + 2], values[x + 3]
    for x in range(len(values) // BLOCK * BLOCK, len(values)):
        where[x % BLOCK * CHUNK + x // BLOCK] = values[x]


@kernel(inline=True)
def fold(along, sums, count):
    """Add up sums over columns of pixels, in the order of `apart`, to sums over blocks."""
    for c in range(count):
        sums[c] = (along[c] + along[CHUNK + c]) + (along[2 * CHUNK + c] + along[3 * CHUNK + c])


@kernel(inline=True)
def add_columns(q, u, v, count, along):
    """Moments of the columns of pixels, ``along`` (10, CHUNK·BLOCK), of ``count`` adjacent blocks."""
    for j in range(BLOCK):
        for x in range(j * CHUNK, j * CHUNK + count):
            n = s_u = s_v = s_q = s_uu = s_uv = s_uq = s_vv = s_vq = s_qq = 0.0
            for k in range(BLOCK):
                p = np.float64(q[k, x])
                valid = 1.0 if p > 0.0 else 0.0
                u_x, v_x = valid * u[k, x], valid * v[k, x]
                n += valid
                s_u += u_x
                s_v += v_x
                s_q += p
                s_uu += u_x * u_x
                s_uv += u_x * v_x
                s_uq += u_x * p
                s_vv += v_x * v_x
                s_vq += v_x * p
                s_qq += p * p
            along[0, x], along[1, x], along[2, x], along[3, x], along[4, x] = n, s_u, s_v, s_q, s_uu
            along[5, x], along[6, x], along[7, x], along[8, x], along[9, x] = s_uv, s_uq, s_vv, s_vq, s_qq


@kernel(reduction=True)
def sum_by_fours(pyramid, rays):
    """Moments and planes of squares of 2x2, 4x4, ... blocks, from the pyramid's lowest level: one after another."""
    moments, rss, slope_square, offsets, shapes = pyramid
    sums = np.empty((10, CHUNK))
    for level in range(1, shapes.shape[0]):
        columns = shapes[level, 1]
        for row in range(shapes[level, 0]):
            for start in range(0, columns, CHUNK):
                count = min(CHUNK, columns - start)
                child = offsets[level - 1] + 4 * row * columns + 2 * start
                i = offsets[level] + row * columns + start
                for k in range(10):
                    upper, lower = moments[k, child:], moments[k, child + 2 * columns :]
                    for c in range(count):
                        sums[k, c] = (upper[2 * c] + upper[2 * c + 1]) + (lower[2 * c] + lower[2 * c + 1])
                    copy(sums[k], moments[k, i : i + count])
                solve_squares(sums, count, rays, rss[i : i + count], slope_square[i : i + count])


@kernel(reduction=True)
def read_frame(raw, lowest, highest, scale, offset, is_disparity, rays, inverse_depth, pyramid):
    """Read the frame once: the inverse depth of every pixel, and moments and plane of every block and square.

    Sums are first taken down the image columns, in loops along the rows, which vectorise.

    Parameters
    ----------
    raw : (H, W) array
        The frame; a pixel is valid if ``lowest <= raw <= highest``.
    scale, offset, is_disparity
        q = scale / raw, or scale * raw + offset if ``is_disparity``.
    rays : Rays
    inverse_depth : (H, W) float32, written
        0 where there is no measurement.
    pyramid : Pyramid, written
        Its lowest level covers the frame.

    Returns
    -------
    float
        The largest inverse depth of a pixel.
    """
    height, width = raw.shape
    tan_x, tan_y = rays.tan_x, rays.tan_y
    values, inverse = raw.reshape(-1), inverse_depth.reshape(-1)  # one row after the other
    bits = inverse.view(np.int32)  # of numbers from 0 on, in the same order
    moments, rss, slope_square = pyramid.moments, pyramid.rss, pyramid.slope_square
    rows, columns = pyramid.shapes[0]
    # Of fixed sizes: see `kernels`.
    q = np.zeros((BLOCK, CHUNK * BLOCK), np.float32)
    u, v = np.zeros((BLOCK, CHUNK * BLOCK)), np.zeros((BLOCK, CHUNK * BLOCK))
    along = np.empty((10, CHUNK * BLOCK))
    sums = np.empty((10, CHUNK))
    has_lens, nearest = len(tan_x) > 1, np.int32(0)
    for start in range(0, columns, CHUNK):
        count = min(CHUNK, columns - start)
        left, right = start * BLOCK, min((start + count) * BLOCK, width)
        q[:] = 0.0
        for k in range(BLOCK):
            apart(tan_x[0, left:right], u[k])
        for row in range(rows):
            top, bottom = row * BLOCK, min(row * BLOCK + BLOCK, height)
            # A band of rows is in one piece in memory.
            begin, end = min(top, bottom) * width, bottom * width if start == 0 else 0
            if is_disparity:  # two loops: in one, the compiler would work out both
                for i in range(begin, end):
                    inverse[i] = inverse_of(values[i], lowest, highest, scale, offset, True)
            else:
                for i in range(begin, end):
                    inverse[i] = inverse_of(values[i], lowest, highest, scale, offset, False)
            for i in range(begin, end):
                nearest = max(nearest, bits[i])
            if bottom - top < BLOCK:
                q[:] = 0.0
            for y in range(top, bottom):
                k = y - top
                here = y * width + left
                apart(inverse[here : here + right - left], q[k])
                if has_lens:
                    apart(tan_x[y, left:right], u[k])
                    apart(tan_y[y, left:right], v[k])
                else:
                    v[k] = tan_y[y, 0]
            add_columns(q, u, v, count, along)
            for k in range(10):
                fold(along[k], sums[k], count)
            i = row * columns + start
            solve_squares(sums, count, rays, rss[i : i + count], slope_square[i : i + count])
            for k in range(10):
                copy(sums[k], moments[k, i : i + count])
    sum_by_fours(pyramid, rays)
    largest = np.full(1, nearest)
    return largest.view(np.float32)[0]
