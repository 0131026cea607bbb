"""Segmentation, first stage: the frame in blocks of a few pixels, and blocks that agree joined by fours.

A block's moments are the ten sums [n, Σu, Σv, Σq, Σuu, Σuv, Σuq, Σvv, Σvq, Σqq] over its valid pixels,
(u, v) = (tanθx, tanθy), all about the origin: so the moments of any union of blocks are the sum of theirs,
and the plane, the residual and the covariance of the union follow without touching a pixel again. In double
precision the cancellation this costs is far below any sensor's noise: 1e-8 of the inverse depth.
"""

import math

import numpy as np

from ._jit import kernel

# Pixels along a block's side.
BLOCK = 4
# Owner of a block: EMPTY where no pixel is measured; MIXED where each pixel has an owner of its own.
EMPTY, MIXED = -1, -2
# Blocks of a row that are worked on together.
CHUNK = 84
# Where the smaller eigenvalue of the pixels' spread is below this share of the larger, they are a line.
COLLINEAR = 1e-6


@kernel(inline=True)
def solve(n, s_u, s_v, s_q, s_uu, s_uv, s_uq, s_vv, s_vq, s_qq):
    """Least squares plane q = α·(u, v, 1) of ten sums: the sum of squared residuals, and α.

    The residual is -1 and α 0 where the pixels do not determine a plane.
    """
    share = 1.0 / max(n, 1.0)
    mean_u, mean_v, mean_q = s_u * share, s_v * share, s_q * share
    uu = s_uu - s_u * mean_u
    uv = s_uv - s_u * mean_v
    vv = s_vv - s_v * mean_v
    uq = s_uq - s_u * mean_q
    vq = s_vq - s_v * mean_q
    qq = s_qq - s_q * mean_q
    determinant = uu * vv - uv * uv
    known = (n >= 3.0) & (determinant > COLLINEAR * uu * vv)
    inverse = 1.0 / (determinant if known else math.inf)
    a = (vv * uq - uv * vq) * inverse
    b = (uu * vq - uv * uq) * inverse
    rss = max(qq - (a * uq + b * vq), 0.0) if known else -1.0
    return rss, a, b, mean_q - a * mean_u - b * mean_v if known else 0.0


@kernel(inline=True)
def residual(m):
    """Sum of squared residuals of the plane fitted to moments; -1 where there is none."""
    return solve(m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9])[0]


@kernel(inline=True)
def joint_residual(m, k):
    """The same for the union of two."""
    return solve(
        m[0] + k[0], m[1] + k[1], m[2] + k[2], m[3] + k[3], m[4] + k[4],
        m[5] + k[5], m[6] + k[6], m[7] + k[7], m[8] + k[8], m[9] + k[9],
    )[0]  # fmt: skip


@kernel(inline=True)
def fit(m, alpha):
    """Write α of the plane fitted to moments; False where the pixels do not determine it."""
    rss, a, b, c = solve(m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9])
    if rss < 0.0:
        return False
    alpha[0] = a
    alpha[1] = b
    alpha[2] = c
    return True


@kernel(inline=True)
def inverse_of(value, lowest, highest, scale, offset, is_disparity):
    """Inverse depth of a raw value, 0 where it is no measurement."""
    valid = (value >= lowest) & (value <= highest)
    if is_disparity:
        return np.float32(scale * value + offset) if valid else np.float32(0.0)
    return np.float32(scale) / np.float32(value if valid else lowest) if valid else np.float32(0.0)


@kernel(inline=True)
def solve_squares(sums, count, pitch_x, pitch_y, rss, slope):
    """Sums of squared residuals, and squared slopes, of the planes of squares with moments ``sums`` (10, CHUNK)."""
    for c in range(count):
        error, a, b, _ = solve(
            sums[0, c], sums[1, c], sums[2, c], sums[3, c], sums[4, c],
            sums[5, c], sums[6, c], sums[7, c], sums[8, c], sums[9, c],
        )  # fmt: skip
        rss[c] = error
        slope[c] = (pitch_x * a) ** 2 + (pitch_y * b) ** 2


@kernel(inline=True)
def copy(values, to):
    """Copy as many values as there is room for."""
    for i in range(len(to)):
        to[i] = values[i]


@kernel(inline=True)
def fold(along, sums, count):
    """Sums over blocks of sums over columns of pixels."""
    for c in range(count):
        x = c * BLOCK
        sums[c] = (along[x] + along[x + 1]) + (along[x + 2] + along[x + 3])


@kernel(inline=True)
def add_columns(q, u, v, count, along):
    """Moments of the columns of pixels, ``along`` (10, CHUNK·BLOCK), of ``count`` blocks beside each other."""
    for x in range(count * BLOCK):
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


@kernel(inline=True)
def add_separable(q, u, row_v, count, along):
    """The same where tanθx, ``u[0]``, is that of the column and tanθy, ``row_v`` (BLOCK,), that of the row."""
    for x in range(count * BLOCK):
        n = s_v = s_q = s_vv = s_vq = s_qq = 0.0
        for k in range(BLOCK):
            p = np.float64(q[k, x])
            valid = 1.0 if p > 0.0 else 0.0
            v_x = valid * row_v[k]
            n += valid
            s_v += v_x
            s_q += p
            s_vv += v_x * row_v[k]
            s_vq += p * row_v[k]
            s_qq += p * p
        c = u[0, x]
        along[0, x], along[1, x], along[2, x], along[3, x], along[4, x] = n, c * n, s_v, s_q, c * c * n
        along[5, x], along[6, x], along[7, x], along[8, x], along[9, x] = c * s_v, c * s_q, s_vv, s_vq, s_qq


@kernel(reduction=True)
def block_moments(
    raw, lowest, highest, scale, offset, is_disparity, tan_x, tan_y, pitch_x, pitch_y, rows, columns,
    inverse_depth, moments, rss, slope,
):  # fmt: skip
    """Read the frame once: the inverse depth of every pixel, and moments and plane of every block.

    The sums are added up down the image columns first, which runs along the rows and vectorises. Where tanθx
    is the same down a column, it multiplies the column's sums.

    Parameters
    ----------
    raw : (H, W) array
        The frame; a pixel is valid if ``lowest <= raw <= highest``.
    scale, offset, is_disparity
        q = scale / raw, or scale * raw + offset if ``is_disparity``.
    tan_x, tan_y : (1, W) and (H, 1), or (H, W) and (H, W) float64
    pitch_x, pitch_y : float
        Change of tanθx and tanθy from pixel to pixel.
    rows, columns : int
        How many blocks there are, at least so many that they cover the frame.
    inverse_depth : (H, W) float32, written
        0 where there is no measurement.
    moments : (10, T) float64, written
        One block after another, row after row; T may be larger than their number.
    rss : (T,) float64, written
        Sum of squared residuals of each block's plane, or -1.
    slope : (T,) float64, written
        Squared slope of each block's plane: change of q from pixel to pixel.

    Returns
    -------
    float
        The largest inverse depth.
    """
    height, width = raw.shape
    # Of a size that is known beforehand: so the compiler sees that their rows are apart, and uses vectors.
    q = np.zeros((BLOCK, CHUNK * BLOCK), np.float32)
    u, v = np.zeros((BLOCK, CHUNK * BLOCK)), np.zeros((BLOCK, CHUNK * BLOCK))
    along = np.empty((10, CHUNK * BLOCK))
    sums = np.empty((10, CHUNK))
    largest = np.zeros(CHUNK * BLOCK, np.float32)
    separable = tan_x.shape[0] == 1 and tan_y.shape[1] == 1
    row_v = np.empty(BLOCK)
    for row in range(rows):
        top, bottom = row * BLOCK, min(row * BLOCK + BLOCK, height)
        for start in range(0, columns, CHUNK):
            count = min(CHUNK, columns - start)
            left = start * BLOCK
            right = max(left, min((start + count) * BLOCK, width))
            if bottom - top < BLOCK or right - left < count * BLOCK:
                q[:] = 0.0
            for y in range(top, bottom):
                k = y - top
                values, inverse = raw[y, left:right], inverse_depth[y, left:right]
                for x in range(right - left):
                    inverse[x] = inverse_of(values[x], lowest, highest, scale, offset, is_disparity)
                    largest[x] = inverse[x] if inverse[x] > largest[x] else largest[x]
                copy(inverse, q[k, : right - left])
                if separable:
                    row_v[k] = tan_y[y, 0]
                else:
                    copy(tan_x[y, left:right], u[k, : right - left])
                    copy(tan_y[y, left:right], v[k, : right - left])
            if separable:
                copy(tan_x[0, left:right], u[0, : right - left])
                add_separable(q, u, row_v, count, along)
            else:
                add_columns(q, u, v, count, along)
            for k in range(10):
                fold(along[k], sums[k], count)
            i = row * columns + start
            solve_squares(sums, count, pitch_x, pitch_y, rss[i : i + count], slope[i : i + count])
            for k in range(10):
                copy(sums[k], moments[k, i : i + count])
    nearest = largest[0]
    for x in range(1, len(largest)):
        nearest = max(nearest, largest[x])
    return nearest


@kernel(inline=True)
def sensor_variance(q, sigma):
    """Variance of an inverse depth.

    ``sigma`` holds the step of a table and then the standard deviation at q = 0, step, 2 step, ...; between
    the entries it is linear, beyond the last it is the last.
    """
    position = min(q / sigma[0], sigma.shape[0] - 2.0)
    i = min(int(position), sigma.shape[0] - 3)
    share = position - i
    value = sigma[i + 1] * (1.0 - share) + sigma[i + 2] * share
    return value * value


@kernel()
def waviness(pixels, growth):
    """How much larger noise is over a region of so many pixels than over 8x8: correlated noise grows.

    ``growth`` holds the ratio for squares of 8, 16, 32, ... pixels; in between it follows log2 of the side.
    """
    if pixels <= 64.0:
        return growth[0]
    if pixels >= 64.0 * 4.0 ** (len(growth) - 1):
        return growth[-1]
    position = 0.5 * math.log2(pixels) - 3.0
    i = min(int(position), len(growth) - 2)
    share = position - i
    return growth[i] * (1.0 - share) + growth[i + 1] * share


@kernel(inline=True)
def variance(m, alpha, sigma, lateral_x, lateral_y):
    """Variance of one pixel about its plane: the sensor's at the mean inverse depth, and the slope's.

    A pixel sees its surface somewhere within itself; where the inverse depth changes across a pixel, that
    is noise too (the paper's σX, σY). ``lateral_x`` and ``lateral_y`` are the variances of tanθx, tanθy.
    """
    return (
        sensor_variance(m[3] / m[0], sigma)
        + lateral_x * alpha[0] * alpha[0]
        + lateral_y * alpha[1] * alpha[1]
    )


@kernel(reduction=True)
def sum_by_fours(moments, offsets, shapes, pitch_x, pitch_y, rss, slope):
    """Moments and planes of squares of 2x2, 4x4, ... blocks: one level of the pyramid after another.

    Level l of ``shapes`` (L, 2) begins at ``offsets[l]`` of ``moments`` (10, T), ``rss`` and ``slope`` (T,), and
    each is twice as high and wide as the next; level 0 is given, see `block_moments`.
    """
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
                solve_squares(sums, count, pitch_x, pitch_y, rss[i : i + count], slope[i : i + count])


@kernel()
def square_residuals(moments, rss, slope, least, mean_square, slope_square):
    """Mean squared residual and squared slope of the squares with a plane and ``least`` valid pixels.

    Returns how many are written.
    """
    count = 0
    for i in range(len(rss)):
        if moments[0, i] < least or rss[i] < 0.0:
            continue
        mean_square[count] = rss[i] / (moments[0, i] - 3.0)
        slope_square[count] = slope[i]
        count += 1
    return count


@kernel()
def together(moments, offsets, shapes, rss, coarse, fine, least, most, ratio):
    """By how much more the means of small squares scatter about the plane of a large one than independent noise's.

    Where noise is independent the mean of n pixels has an n-th of their variance; where they go together it has
    more, by as many as go together. Of the squares of level ``coarse`` with at least ``least`` pixels and a mean
    squared residual of at most ``most``, by their parts of level ``fine``: ``ratio`` is written; returns how many.
    """
    side = 1 << (coarse - fine)
    alpha = np.empty(3)
    count = 0
    for row in range(shapes[coarse, 0]):
        for column in range(shapes[coarse, 1]):
            i = offsets[coarse] + row * shapes[coarse, 1] + column
            m = moments[:, i]
            if m[0] < least or rss[i] <= 0.0 or rss[i] > most * (m[0] - 3.0) or not fit(m, alpha):
                continue
            total = 0.0
            parts = -3.0  # the plane takes as many
            for r in range(row * side, row * side + side):
                for c in range(column * side, column * side + side):
                    k = moments[:, offsets[fine] + r * shapes[fine, 1] + c]
                    if k[0] > 0.0:
                        e = k[3] - (alpha[0] * k[1] + alpha[1] * k[2] + alpha[2] * k[0])
                        total += e * e / k[0]
                        parts += 1.0
            if parts > 0.0:
                ratio[count] = total / parts * (m[0] - 3.0) / rss[i]
                count += 1
    return count


@kernel()
def join_blocks(
    moments, offsets, shapes, rss, slope, sigma, lateral, roughness, steepness, floor, spread, state
):
    """Build the quadtree: which blocks are planar, and which four planar neighbours are one plane.

    Parameters
    ----------
    moments, offsets, shapes, rss, slope
        See `sum_by_fours`.
    sigma : see `sensor_variance`
    lateral : float
        Variance, in pixels, of where a measurement lies: see `variance`.
    roughness, steepness : float
        A block is planar if its residual is below ``roughness`` standard deviations, the slope's part of
        which counts ``steepness`` times (a block across a depth jump looks steep, too).
    floor, spread : float
        Four are one plane if joining them adds at most ``floor``² variances per pixel, plus ``spread``.
    state : (T,) int8, written
        0 not planar, 1 planar, 2 too few pixels to say.
    """
    for i in range(shapes[0, 0] * shapes[0, 1]):
        n = moments[0, i]
        allowed = roughness * roughness * sensor_variance(moments[3, i] / max(n, 1.0), sigma) + (
            steepness * steepness * lateral * slope[i]
        )
        planar = 1 if rss[i] <= (n - 3.0) * allowed else 0
        state[i] = 2 if (n < 6.0) | (rss[i] < 0.0) else planar
    for level in range(1, shapes.shape[0]):
        rows, columns = shapes[level, 0], shapes[level, 1]
        finer = shapes[level - 1, 1]
        for row in range(rows):
            for column in range(columns):
                parent = offsets[level] + row * columns + column
                planar = 0
                total = 0.0
                smallest = math.inf
                for r in range(2 * row, 2 * row + 2):
                    for c in range(2 * column, 2 * column + 2):
                        child = offsets[level - 1] + r * finer + c
                        if state[child] == 0:
                            planar = -9
                        if state[child] != 1:
                            continue
                        planar += 1
                        total += rss[child]
                        mean_q = moments[3, child] / moments[0, child]
                        smallest = min(smallest, sensor_variance(mean_q, sigma) + lateral * slope[child])
                if planar <= 0:
                    state[parent] = 2 if planar == 0 else 0
                    continue
                rise = rss[parent] - total
                agree = rss[parent] >= 0.0 and rise <= smallest * (
                    floor * floor * moments[0, parent] + spread
                )
                state[parent] = 1 if agree else 0


@kernel()
def leaves(offsets, shapes, state, moments, region, owner, region_moments):
    """Number the largest planar node over each planar block, in the order of their first blocks.

    ``region`` is (R, C) int32, written: the node's number, -1 where the block is not planar or has too few
    pixels; ``owner`` (R, C) int32 is written: EMPTY or MIXED; ``region_moments`` (R·C, 10) is written.
    Returns how many there are.
    """
    levels = shapes.shape[0]
    number = np.full(len(state), -1, np.int64)
    count = 0
    for row in range(shapes[0, 0]):
        for column in range(shapes[0, 1]):
            region[row, column] = -1
            owner[row, column] = EMPTY if moments[0, row * shapes[0, 1] + column] == 0.0 else MIXED
            if state[row * shapes[0, 1] + column] != 1:
                continue
            for level in range(levels - 1, -1, -1):
                i = offsets[level] + (row >> level) * shapes[level, 1] + (column >> level)
                if state[i] == 1:
                    if number[i] < 0:
                        number[i] = count
                        region_moments[count] = moments[:, i]
                        count += 1
                    region[row, column] = number[i]
                    break
    return count
