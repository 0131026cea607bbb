"""Segmentation: is what bends within one region two planes, side by side?

Where one plane went on beyond an edge, or over a step too narrow to be a region, a quadric fits better than a plane.
But it does not fit well: two planes do.
"""

import math

import numpy as np

from ..._jit.kernel import kernel
from ..model.quadrics import PLANE_TERMS, TERMS, add_products, eliminate, extent, sampling_step

STRIPS = 12  # of the region, between which it may break


@kernel()
def main_bend(h):
    """Unit vector of (u, v) along which the second derivative, of those of `second_derivatives`, is largest."""
    mean, half = 0.5 * (h[0] + h[2]), 0.5 * (h[0] - h[2])
    sign = 1.0 if mean >= 0.0 else -1.0
    angle = 0.5 * math.atan2(sign * h[1], sign * half)
    return math.cos(angle), math.sin(angle)


@kernel()
def two_planes(region, means, a, box, m, alpha, deviation, across):
    """What two planes, on both sides of a line, leave of the blocks of region ``a``; the line is the best of some.

    Parameters
    ----------
    region, means, box
        See `quadrics.add_blocks`.
    m, alpha : (10,) and (3,) float64
        Moments and plane of the region.
    deviation : float
        Unit of residuals, 1/m.
    across : (float, float)
        Unit vector across the line, in (u, v).

    Returns
    -------
    planes, quadrics : float
        Sums of squares that two planes leave, and, on both sides of the same line, two quadrics.
    """
    centre, scale, step = (m[1] / m[0], m[2] / m[0]), extent(m), sampling_step(box[a])
    block_pixels, block_u, block_v = means[0], means[1], means[2]
    strips = np.zeros((STRIPS, TERMS + 1, TERMS + 1))
    low, high = math.inf, -math.inf
    for is_known in (False, True):  # how far the region extends
        for row in range(box[a, 0], box[a, 1], step):
            for column in range(box[a, 2], box[a, 3], step):
                if region[row, column] != a or not block_pixels[row, column] > 0.0:
                    continue
                t = across[0] * block_u[row, column] + across[1] * block_v[row, column]
                if is_known:
                    k = min(int(STRIPS * (t - low) / (high - low)), STRIPS - 1)
                    add_products(means[:, row, column : column + 1], 1, alpha, deviation, centre, scale, strips[k])
                else:
                    low, high = min(low, t), max(high, t)
        if not high > low:
            return math.inf, math.inf
    best, bent = math.inf, math.inf  # what is left by planes, and there by quadrics
    for split in range(1, STRIPS):
        lower, upper = np.zeros((2, TERMS + 1, TERMS + 1))
        for k in range(STRIPS):
            if k < split:
                lower += strips[k]
            else:
                upper += strips[k]
        planes = eliminate(lower, 0, PLANE_TERMS) + eliminate(upper, 0, PLANE_TERMS)
        if planes < best:
            best = planes
            bent = eliminate(lower, PLANE_TERMS, TERMS) + eliminate(upper, PLANE_TERMS, TERMS)
    return best, bent
