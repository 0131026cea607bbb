"""What a noise model says of the pixels of each label of an image, at whichever depths they are."""

import math

from ._jit import kernel
from .depth import inverse_depth
from .statistics import DEPTH_STEP, DISPARITY_STEP, ONE, SCALE, VARIANCES


@kernel(inline=True)
def variance_at(q, noise):
    """Variance of the errors along the ray at an inverse depth; ``noise`` is that of `statistics.assess`."""
    if noise.shape[0] == VARIANCES + ONE:
        return noise[VARIANCES]
    position = max(q * noise[SCALE], 0.0)
    k = min(int(position), noise.shape[0] - 8)
    below, above = noise[VARIANCES + k], noise[VARIANCES + k + ONE]
    return below + (position - k) * (above - below)


@kernel()
def label_variances(
    raw, lowest, highest, scale, offset, is_disparity, tan_x, tan_y, labels, alpha, noise, sums
):  # fmt: skip
    """Sums over the valid pixels of labels 1 to K of the variances of their errors, at the depths of their planes.

    Parameters
    ----------
    tan_x, tan_y : (H, W) float64, or (1, W) and (H, 1)
    labels : (H, W) int32
        0 for none.
    alpha : (K, 3) float64
        Where it is NaN, each pixel's own depth counts.
    noise : see `statistics.assess`
    sums : (K, 3) float64, written
        Of the variances of q along the ray, of those of rounding, and of the squares of both together.
    """
    height, width = raw.shape
    step_y, step_x = int(tan_x.shape[0] > 1), int(tan_y.shape[1] > 1)
    sums[:] = 0.0
    for row in range(height):
        for column in range(width):
            i = labels[row, column] - 1
            value = raw[row, column]
            if i < 0 or not lowest <= value <= highest:
                continue
            u, v = tan_x[row * step_y, column], tan_y[row, column * step_x]
            q = alpha[i, 0] * u + alpha[i, 1] * v + alpha[i, 2]
            if math.isnan(q):
                q = inverse_depth(value, scale, offset, is_disparity)
            variance = variance_at(q, noise)
            square = q * q
            rounding = noise[DEPTH_STEP] * square * square + noise[DISPARITY_STEP]
            total = variance + rounding
            sums[i, 0] += variance
            sums[i, 1] += rounding
            sums[i, 2] += total * total
