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
    sums : (K, 8) float64, written
        Of the variances of q along the ray, of those of rounding, of the squares of both together, and of both together
        times u, v, u², uv and v², with (u, v) = (tanθx, tanθy).
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
            along = of_rounding = squares = s_u = s_v = s_uu = s_uv = s_vv = 0.0
            for column in range(start, stop):
                value = raw[row, column]
                if not lowest <= value <= highest:
                    continue
                u, v = tan_x[row * step_y, column], tan_y[row, column * step_x]
                q = a * u + b * v + c
                if math.isnan(q):
                    q = inverse_depth(value, scale, offset, is_disparity)
                variance = variance_at(q, noise)
                if grows:
                    variance *= growth[row, column]
                square = q * q
                rounding = noise[DEPTH_STEP] * square * square + noise[DISPARITY_STEP]
                along += variance
                of_rounding += rounding
                total = variance + rounding
                squares += total * total
                s_u += total * u
                s_v += total * v
                s_uu += total * u * u
                s_uv += total * u * v
                s_vv += total * v * v
            sums[i, 0] += along
            sums[i, 1] += of_rounding
            sums[i, 2] += squares
            sums[i, 3] += s_u
            sums[i, 4] += s_v
            sums[i, 5] += s_uu
            sums[i, 6] += s_uv
            sums[i, 7] += s_vv
