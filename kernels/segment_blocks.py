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
# Owner of a block: EMPTY where no pixel is measured; MIXED - i where row i of a table has the owner of each.
EMPTY, MIXED = -1, -2
# Where the smaller eigenvalue of the pixels' spread is below this share of the larger, they are a line.
COLLINEAR = 1e-6


@kernel()
def camera_sums(tan_x, tan_y, sums):
    """What a block's moments hold of the camera alone, where every pixel is valid.

    ``sums`` is (6, R, C), written: n, Σu, Σv, Σuu, Σuv, Σvv.
    """
    height, width = tan_x.shape
    sums[:] = 0.0
    for y in range(height):
        for x in range(width):
            u, v = tan_x[y, x], tan_y[y, x]
            total = sums[:, y // BLOCK, x // BLOCK]
            total[0] += 1.0
            total[1] += u
            total[2] += v
            total[3] += u * u
            total[4] += u * v
            total[5] += v * v


@kernel(inline=True)
def read_row(raw, lowest, highest, scale, offset, is_disparity, q):
    """Inverse depths of a row, 0 where there is no measurement."""
    if is_disparity:
        for x in range(len(q)):
            valid = (raw[x] >= lowest) & (raw[x] <= highest)
            q[x] = scale * raw[x] + offset if valid else 0.0
    else:
        scale = np.float32(scale)
        for x in range(len(q)):
            valid = (raw[x] >= lowest) & (raw[x] <= highest)
            q[x] = scale / np.float32(raw[x] if valid else lowest) if valid else np.float32(0.0)


@kernel(reduction=True)
def block_moments(
    raw, lowest, highest, scale, offset, is_disparity, tan_x, tan_y, camera, inverse_depth, moments
):
    """Read the frame once: the inverse depth of every pixel and the moments of every block.

    The sums that hold q are added up down the image columns first, which runs along the rows and
    vectorises; those that don't are the camera's, unless pixels are missing.

    Parameters
    ----------
    raw : (H, W) array
        The frame; a pixel is valid if ``lowest <= raw <= highest``.
    scale, offset, is_disparity
        q = scale / raw, or scale * raw + offset if ``is_disparity``.
    tan_x, tan_y : (1, W) and (H, 1), or (H, W) and (H, W) float64
    camera : (6, R, C) float64
        Of `camera_sums`.
    inverse_depth : (H, W) float32, written
        0 where there is no measurement.
    moments : (R, C, 10) float64, written

    Returns
    -------
    float
        The largest inverse depth.
    """
    height, width = raw.shape
    rows, columns = moments.shape[0], moments.shape[1]
    step_y, step_x = int(tan_x.shape[0] > 1), int(tan_y.shape[1] > 1)
    n = np.zeros(columns * BLOCK)
    s_q, s_uq, s_vq, s_qq = (
        np.zeros(columns * BLOCK),
        np.zeros(columns * BLOCK),
        np.zeros(columns * BLOCK),
        np.zeros(columns * BLOCK),
    )
    largest = np.float32(0.0)
    v = np.empty(width)
    for row in range(rows):
        n[:] = 0.0
        s_q[:] = 0.0
        s_uq[:] = 0.0
        s_vq[:] = 0.0
        s_qq[:] = 0.0
        for y in range(row * BLOCK, min(row * BLOCK + BLOCK, height)):
            q = inverse_depth[y]
            read_row(raw[y], lowest, highest, scale, offset, is_disparity, q)
            u = tan_x[y * step_y]
            if step_x:
                v[:] = tan_y[y]
            else:
                v[:] = tan_y[y, 0]
            for x in range(width):
                largest = max(largest, q[x])
            for x in range(width):
                p = np.float64(q[x])
                n[x] += 1.0 if p > 0.0 else 0.0
                s_q[x] += p
                s_qq[x] += p * p
                s_uq[x] += u[x] * p
                s_vq[x] += v[x] * p
        for column in range(columns):
            m = moments[row, column]
            x = column * BLOCK
            m[0] = (n[x] + n[x + 1]) + (n[x + 2] + n[x + 3])
            m[3] = (s_q[x] + s_q[x + 1]) + (s_q[x + 2] + s_q[x + 3])
            m[6] = (s_uq[x] + s_uq[x + 1]) + (s_uq[x + 2] + s_uq[x + 3])
            m[8] = (s_vq[x] + s_vq[x + 1]) + (s_vq[x + 2] + s_vq[x + 3])
            m[9] = (s_qq[x] + s_qq[x + 1]) + (s_qq[x + 2] + s_qq[x + 3])
            m[1] = camera[1, row, column]
            m[2] = camera[2, row, column]
            m[4] = camera[3, row, column]
            m[5] = camera[4, row, column]
            m[7] = camera[5, row, column]
        for column in range(columns):
            m = moments[row, column]
            if m[0] == camera[0, row, column]:
                continue
            m[1] = m[2] = m[4] = m[5] = m[7] = 0.0
            if m[0] == 0.0:
                continue
            for y in range(row * BLOCK, min(row * BLOCK + BLOCK, height)):
                for x in range(column * BLOCK, min(column * BLOCK + BLOCK, width)):
                    valid = 1.0 if inverse_depth[y, x] > 0.0 else 0.0
                    u_x, v_x = tan_x[y * step_y, x], tan_y[y, x * step_x]
                    m[1] += valid * u_x
                    m[2] += valid * v_x
                    m[4] += valid * u_x * u_x
                    m[5] += valid * u_x * v_x
                    m[7] += valid * v_x * v_x
    return largest


@kernel(inline=True)
def residual(m):
    """Sum of squared residuals of the plane q = α·(u, v, 1) fitted to moments; -1 where there is none."""
    return residual_of(m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9])


@kernel(inline=True)
def joint_residual(m, k):
    """The same for the union of two."""
    return residual_of(
        m[0] + k[0], m[1] + k[1], m[2] + k[2], m[3] + k[3], m[4] + k[4],
        m[5] + k[5], m[6] + k[6], m[7] + k[7], m[8] + k[8], m[9] + k[9],
    )  # fmt: skip


@kernel(inline=True)
def residual_of(n, s_u, s_v, s_q, s_uu, s_uv, s_uq, s_vv, s_vq, s_qq):
    """`residual` of the ten sums."""
    if n < 3.0:
        return -1.0
    mean_u = s_u / n
    mean_v = s_v / n
    mean_q = s_q / n
    uu = s_uu - s_u * mean_u
    uv = s_uv - s_u * mean_v
    vv = s_vv - s_v * mean_v
    uq = s_uq - s_u * mean_q
    vq = s_vq - s_v * mean_q
    qq = s_qq - s_q * mean_q
    determinant = uu * vv - uv * uv
    if not determinant > COLLINEAR * uu * vv:
        return -1.0
    return max(qq - (vv * uq * uq - 2.0 * uv * uq * vq + uu * vq * vq) / determinant, 0.0)


@kernel(inline=True)
def fit(m, alpha):
    """Least squares α of q = α·(u, v, 1); False where the pixels do not determine it."""
    n = m[0]
    if n < 3.0:
        return False
    mean_u = m[1] / n
    mean_v = m[2] / n
    mean_q = m[3] / n
    uu = m[4] - m[1] * mean_u
    uv = m[5] - m[1] * mean_v
    vv = m[7] - m[2] * mean_v
    uq = m[6] - m[1] * mean_q
    vq = m[8] - m[2] * mean_q
    determinant = uu * vv - uv * uv
    if not determinant > COLLINEAR * uu * vv:
        return False
    a = (vv * uq - uv * vq) / determinant
    b = (uu * vq - uv * uq) / determinant
    alpha[0] = a
    alpha[1] = b
    alpha[2] = mean_q - a * mean_u - b * mean_v
    return True


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
    position = min(0.5 * math.log2(pixels) - 3.0, len(growth) - 1.0)
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


@kernel()
def sum_by_fours(moments, offsets, shapes):
    """Moments of squares of 2x2, 4x4, ... blocks, whatever they hold: one level of the pyramid after another.

    Level l of ``shapes`` (L, 2) is at rows ``offsets[l]`` and on of ``moments`` (T, 10); level 0 is given.
    """
    for level in range(1, shapes.shape[0]):
        finer_rows, finer_columns = shapes[level - 1, 0], shapes[level - 1, 1]
        for row in range(shapes[level, 0]):
            for column in range(shapes[level, 1]):
                m = moments[offsets[level] + row * shapes[level, 1] + column]
                m[:] = 0.0
                for r in range(2 * row, min(2 * row + 2, finer_rows)):
                    for c in range(2 * column, min(2 * column + 2, finer_columns)):
                        child = moments[offsets[level - 1] + r * finer_columns + c]
                        for k in range(10):
                            m[k] += child[k]


@kernel()
def square_residuals(moments, least, pitch_x, pitch_y, mean_square, slope_square):
    """Mean squared residual of the squares with at least ``least`` valid pixels, and their squared slope.

    The slope is the change of inverse depth from pixel to pixel, ``pitch_x`` and ``pitch_y`` being the
    change of tanθx and tanθy. Returns how many are written.
    """
    alpha = np.empty(3)
    count = 0
    for i in range(len(moments)):
        if moments[i, 0] < least or not fit(moments[i], alpha):
            continue
        mean_square[count] = residual(moments[i]) / (moments[i, 0] - 3.0)
        slope_square[count] = (pitch_x * alpha[0]) ** 2 + (pitch_y * alpha[1]) ** 2
        count += 1
    return count


@kernel()
def join_blocks(
    moments, offsets, shapes, sigma, lateral_x, lateral_y, roughness, steepness, floor, spread, state
):
    """Build the quadtree: which blocks are planar, and which four planar neighbours are one plane.

    Parameters
    ----------
    moments, offsets, shapes
        See `sum_by_fours`.
    roughness, steepness : float
        A block is planar if its residual is below ``roughness`` standard deviations, the slope's part of
        which counts ``steepness`` times (a block across a depth jump looks steep, too).
    floor, spread : float
        Four are one plane if joining them adds at most ``floor``² variances per pixel, plus ``spread``.
    state : (T,) int8, written
        0 not planar, 1 planar, 2 too few pixels to say.
    """
    alpha = np.empty(3)
    for i in range(shapes[0, 0] * shapes[0, 1]):
        n = moments[i, 0]
        if n < 6.0:
            state[i] = 2
            continue
        rss = residual(moments[i])
        if rss < 0.0 or not fit(moments[i], alpha):
            state[i] = 2
            continue
        allowed = roughness * roughness * sensor_variance(moments[i, 3] / n, sigma) + (
            steepness * steepness * (lateral_x * alpha[0] * alpha[0] + lateral_y * alpha[1] * alpha[1])
        )
        state[i] = 1 if rss <= (n - 3.0) * allowed else 0
    for level in range(1, shapes.shape[0]):
        rows, columns = shapes[level, 0], shapes[level, 1]
        finer = shapes[level - 1, 1]
        for row in range(rows):
            for column in range(columns):
                parent = offsets[level] + row * columns + column
                m = moments[parent]
                planar = 0
                rss = 0.0
                smallest = math.inf
                for r in range(2 * row, min(2 * row + 2, shapes[level - 1, 0])):
                    for c in range(2 * column, min(2 * column + 2, finer)):
                        child = offsets[level - 1] + r * finer + c
                        if state[child] == 0:
                            planar = -9
                        if state[child] != 1:
                            continue
                        planar += 1
                        rss += residual(moments[child])
                        fit(moments[child], alpha)
                        smallest = min(smallest, variance(moments[child], alpha, sigma, lateral_x, lateral_y))
                if planar <= 0:
                    state[parent] = 2 if planar == 0 else 0
                    continue
                joint = residual(m)
                agree = joint >= 0.0 and joint - rss <= smallest * (floor * floor * m[0] + spread)
                state[parent] = 1 if agree else 0


@kernel()
def leaves(offsets, shapes, state, moments, region, owner, region_moments):
    """Number the largest planar node over each planar block, in the order of their first blocks.

    ``region`` is (R, C) int32, written: the node's number, -1 where the block is not planar or has too few
    pixels; ``owner`` (R, C) int32 is written: EMPTY or MIXED; ``region_moments`` (R·C, 10) is written. Returns how many there are.
    """
    levels = shapes.shape[0]
    number = np.full(len(state), -1, np.int64)
    count = 0
    for row in range(shapes[0, 0]):
        for column in range(shapes[0, 1]):
            region[row, column] = -1
            owner[row, column] = EMPTY if moments[row * shapes[0, 1] + column, 0] == 0.0 else MIXED
            if state[row * shapes[0, 1] + column] != 1:
                continue
            for level in range(levels - 1, -1, -1):
                i = offsets[level] + (row >> level) * shapes[level, 1] + (column >> level)
                if state[i] == 1:
                    if number[i] < 0:
                        number[i] = count
                        region_moments[count] = moments[i]
                        count += 1
                    region[row, column] = number[i]
                    break
    return count
