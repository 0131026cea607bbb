"""Segmentation: how many independent samples a plane's pixels are.

Where errors are smooth over many pixels, neighbours have one error between them, and a patch of them fits a plane by
itself. How smooth they are shows in what the residuals of neighbours share: with a correlation of exp(-r²/(2·length²))
a pixel differs from the next by 2·variance·(1 - exp(-1/(2·length²))) in the mean square, and the errors of
2π·length² pixels count as one.
"""

import math

import numpy as np

from ..._jit.kernel import kernel

# Pixels after which a plane's own residuals tell as much of the correlation as those of the frame's large planes.
OF_FRAME = 1000.0
# Two of so many rows are looked at.
ROWS = 8
# Share of the variance by which neighbours differ: errors are neither quite the same nor quite independent.
LEAST_DIFFERENCE, MOST_DIFFERENCE = 1e-3, 0.999


@kernel()
def residual_sums(label, inverse_depth, rays, alpha, sums):
    """Sums over the residuals of each plane's pixels, in two rows of ROWS.

    Parameters
    ----------
    label : (H, W) int32
        0 for none, 1..N.
    inverse_depth : (H, W) float32
    rays : Rays
    alpha : (N, 3) float64
    sums : (N, 4) float64, written
        Pixels, and the sum of their squared residuals; pairs of them side by side, along rows and columns, and the sum
        of the squares by which their residuals differ.
    """
    height, width = label.shape
    tan_x, tan_y = rays.tan_x, rays.tan_y
    sums[:] = 0.0
    above, label_above = np.zeros(width), np.zeros(width, np.int32)
    for y in range(height):
        if y % ROWS > 1:
            continue
        if y % ROWS == 0:
            label_above[:] = 0
        line, q = label[y], inverse_depth[y]
        u, v = tan_x[y if tan_x.shape[0] > 1 else 0], tan_y[y]
        last_v = np.int64(len(v) - 1)
        x = 0
        while x < width:
            a = line[x]
            start = x
            if a == 0:
                while x < width and line[x] == 0:
                    label_above[x] = 0
                    x += 1
                continue
            on_u, on_v, on_1 = alpha[a - 1, 0], alpha[a - 1, 1], alpha[a - 1, 2]
            square = differ = last = 0.0
            pairs = 0
            while x < width and line[x] == a:
                r = q[x] - (on_u * u[x] + on_v * v[min(x, last_v)] + on_1)
                square += r * r
                if x > start:
                    differ += (r - last) ** 2
                if label_above[x] == a:
                    differ += (r - above[x]) ** 2
                    pairs += 1
                above[x], label_above[x] = r, a
                last = r
                x += 1
            sums[a - 1, 0] += x - start
            sums[a - 1, 1] += square
            sums[a - 1, 2] += pairs + x - start - 1
            sums[a - 1, 3] += differ


@kernel()
def independent_samples(sums, moments, flat, samples):
    """How many independent samples the pixels of each plane are, to ``samples`` (N,) float64.

    A small plane's residuals hold little of errors that reach farther than the plane: its fit follows them. So the
    correlation of the frame's large planes counts as `OF_FRAME` pixels of the plane's own.

    Parameters
    ----------
    sums : (N, 4) float64
        From `residual_sums`.
    moments : (N, 10) float64
        Of all pixels of the planes.
    flat : (N,) float64
        Variance of a pixel without any noise, which no two pixels share: surfaces are no flatter.
    samples : (N,) float64, written
    """
    count = len(sums)
    difference = np.empty(count)
    total = 0.0
    for k in range(count):
        pixels, square, pairs, differ = sums[k, 0], sums[k, 1], sums[k, 2], sums[k, 3]
        share = (0.5 * differ / max(pairs, 1.0) + flat[k]) / (square / max(pixels, 1.0) + flat[k])
        difference[k] = math.log(min(max(share, LEAST_DIFFERENCE), MOST_DIFFERENCE))
        total += moments[k, 0]
    half, frame_difference = 0.5 * total, 0.0
    for k in np.argsort(difference):  # the median pixel's
        half -= moments[k, 0]
        frame_difference = difference[k]
        if half <= 0.0:
            break
    for k in range(count):
        pixels = moments[k, 0]
        share = math.exp((pixels * difference[k] + OF_FRAME * frame_difference) / (pixels + OF_FRAME))
        samples[k] = pixels / max(-math.pi / math.log(1.0 - share), 1.0)
