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
# Which moments hold q, with their number, and which are the camera's.
FRAME = (0, 3, 6, 8, 9)
CAMERA = (1, 2, 4, 5, 7)
# Blocks of a row that are worked on together.
CHUNK = 84
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


@kernel(reduction=True)
def block_moments(
    raw, lowest, highest, scale, offset, is_disparity, tan_x, tan_y, camera, pitch_x, pitch_y,
    inverse_depth, moments, rss, slope,
):  # fmt: skip
    """Read the frame once: the inverse depth of every pixel, and moments and plane of every block.

    The sums are added up down the image columns first, which runs along the rows and vectorises; those that
    don't hold q are the camera's, unless pixels are missing.

    Parameters
    ----------
    raw : (H, W) array
        The frame; a pixel is valid if ``lowest <= raw <= highest``.
    scale, offset, is_disparity
        q = scale / raw, or scale * raw + offset if ``is_disparity``.
    tan_x, tan_y : (1, W) and (H, 1), or (H, W) and (H, W) float64
    camera : (6, R, C) float64
        Of `camera_sums`.
    pitch_x, pitch_y : float
        Change of tanθx and tanθy from pixel to pixel.
    inverse_depth : (H, W) float32, written
        0 where there is no measurement.
    moments : (10, T) float64, written
        One block after another, row after row; there may be more columns than blocks.
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
    step_y, step_x = int(tan_x.shape[0] > 1), int(tan_y.shape[1] > 1)
    # Of a size that is known beforehand: so the compiler sees that their rows are apart, and uses vectors.
    q, u, v = (
        np.zeros((BLOCK, CHUNK * BLOCK)), np.zeros((BLOCK, CHUNK * BLOCK)), np.zeros((BLOCK, CHUNK * BLOCK))
    )  # fmt: skip
    along = np.empty((5, CHUNK * BLOCK))
    sums = np.empty((10, CHUNK))
    largest = np.zeros(CHUNK * BLOCK, np.float32)
    for row in range(camera.shape[1]):
        top, bottom = row * BLOCK, min(row * BLOCK + BLOCK, height)
        for start in range(0, camera.shape[2], CHUNK):
            count = min(CHUNK, camera.shape[2] - start)
            left, right = start * BLOCK, min((start + count) * BLOCK, width)
            if bottom - top < BLOCK or right - left < count * BLOCK:
                q[:] = 0.0
            for y in range(top, bottom):
                k = y - top
                values, inverse = raw[y, left:right], inverse_depth[y, left:right]
                row_u, row_v = tan_x[y * step_y, left:right], tan_y[y, left * step_x : right]
                for x in range(right - left):
                    inverse[x] = inverse_of(values[x], lowest, highest, scale, offset, is_disparity)
                    largest[x] = inverse[x] if inverse[x] > largest[x] else largest[x]
                for x in range(right - left):
                    q[k, x] = inverse[x]
                for x in range(right - left):
                    u[k, x] = row_u[x]
                if step_x:
                    for x in range(right - left):
                        v[k, x] = row_v[x]
                else:
                    v_y = row_v[0]
                    for x in range(right - left):
                        v[k, x] = v_y
            for x in range(count * BLOCK):
                n = s_q = s_uq = s_vq = s_qq = 0.0
                for k in range(BLOCK):
                    n += 1.0 if q[k, x] > 0.0 else 0.0
                    s_q += q[k, x]
                    s_uq += u[k, x] * q[k, x]
                    s_vq += v[k, x] * q[k, x]
                    s_qq += q[k, x] * q[k, x]
                along[0, x], along[1, x] = n, s_q
                along[2, x], along[3, x], along[4, x] = s_uq, s_vq, s_qq
            for k in range(5):
                fold(along[k], sums[FRAME[k]], count)
            all_pixels = camera[0, row, start : start + count]
            missing = False
            for c in range(count):
                missing |= sums[0, c] != all_pixels[c]
            if missing:
                for x in range(count * BLOCK):
                    s_u = s_v = s_uu = s_uv = s_vv = 0.0
                    for k in range(BLOCK):
                        valid = 1.0 if q[k, x] > 0.0 else 0.0
                        s_u += valid * u[k, x]
                        s_v += valid * v[k, x]
                        s_uu += valid * u[k, x] * u[k, x]
                        s_uv += valid * u[k, x] * v[k, x]
                        s_vv += valid * v[k, x] * v[k, x]
                    along[0, x], along[1, x] = s_u, s_v
                    along[2, x], along[3, x], along[4, x] = s_uu, s_uv, s_vv
            for k in range(5):
                if missing:
                    fold(along[k], sums[CAMERA[k]], count)
                known = camera[k + 1, row, start : start + count]
                for c in range(count):
                    sums[CAMERA[k], c] = known[c] if sums[0, c] == all_pixels[c] else sums[CAMERA[k], c]
            i = row * camera.shape[2] + start
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
