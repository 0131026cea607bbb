"""What a noise model says of the pixels of each label of an image, at whichever depths they are."""

import math

from ._jit import kernel
from .depth import inverse_depth
from .statistics import DEPTH_STEP, DISPARITY_STEP, SCALE, VARIANCES


@kernel(inline=True)
def variance_at(q, noise):
    """Variance of the errors along the ray at an inverse depth; ``noise`` is that of `statistics.assess`."""
    table = noise[VARIANCES:]
    if len(table) == 1:
        return table[0]
    position = max(q * noise[SCALE], 0.0)
    k = int(min(position, len(table) - 2.0))
    return table[k] + (position - k) * (table[k + 1] - table[k])


@kernel()
def label_variances(
    raw, lowest, highest, scale, offset, is_disparity, tan_x, tan_y, labels, alpha, noise, growth, sums
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
    growth : (H, W) float64, or empty
        How many times those of ``noise`` the variances of q along the ray are.
    sums : (K, 3) float64, written
        Of the variances of q along the ray, of those of rounding, and of the squares of both together.
    """
    height, width = raw.shape
    step_y, step_x = int(tan_x.shape[0] > 1), int(tan_y.shape[1] > 1)
    grows = growth.shape[0] > 0
    sums[:] = 0.0
    for row in range(height):
        line = labels[row]
        stop = 0
        while stop < width:
            start, label = stop, line[stop]
            while stop < width and line[stop] == label:
                stop += 1
            i = label - 1
            if i < 0:
                continue
            a, b, c = alpha[i, 0], alpha[i, 1], alpha[i, 2]
            along = of_rounding = squares = 0.0
            for column in range(start, stop):
                value = raw[row, column]
                if not lowest <= value <= highest:
                    continue
                q = a * tan_x[row * step_y, column] + b * tan_y[row, column * step_x] + c
                if math.isnan(q):
                    q = inverse_depth(value, scale, offset, is_disparity)
                variance = variance_at(q, noise)
                if grows:
                    variance *= growth[row, column]
                square = q * q
                rounding = noise[DEPTH_STEP] * square * square + noise[DISPARITY_STEP]
                along += variance
                of_rounding += rounding
                squares += (variance + rounding) * (variance + rounding)
            sums[i, 0] += along
            sums[i, 1] += of_rounding
            sums[i, 2] += squares
