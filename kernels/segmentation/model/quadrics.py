"""Segmentation: the quadric that fits a region, q = α·(u, v, 1) + a u² + b uv + c v².

It has as many parameters as two planes. The blocks' means are enough for it.
"""

import math

import numpy as np

from ..._jit.kernel import kernel
from ...common.union_find import root_of
from .records import MIXED

TERMS = 6  # of a quadric: 1, x, y, x², xy, y²
PLANE_TERMS = 3
# A direction in which a region extends by less than this share (squared) of the others says nothing.
SLIGHT = 1e-6
SHAPE_BLOCKS = 256  # blocks that are enough to show a shape
# Of what two planes gain over one, a quadric gains 1/15 more on a parabola, and 1/16 less on an edge.
MARGIN = 1.0 / 32.0


@kernel()
def owned_means(regions, pyramid):
    """Number and mean (u, v, q) of the pixels of each block that its region owns.

    Parameters
    ----------
    regions : Regions
    pyramid : Pyramid

    Returns
    -------
    (R, C, 4) float32
        Of blocks that have a region; of the others it means nothing.
    """
    region, _, number, owners, shares = regions
    moments = pyramid.moments
    rows, columns = region.shape
    means = np.empty((rows, columns, 4), np.float32)
    sums = np.empty(4)
    for row in range(rows):
        for column in range(columns):
            a = region[row, column]
            if a < 0:
                continue
            for k in range(4):
                sums[k] = moments[k, row * columns + column]
            if owners.block[row, column] == MIXED:
                sums[:] = 0.0
                first = owners.first[row, column]
                for s in range(first, first + owners.count[row, column]):
                    if number[shares.region[s]] == a:
                        for k in range(4):
                            sums[k] += shares.moments[s, k]
            per_pixel = 1.0 / max(sums[0], 1.0)
            means[row, column, 0] = sums[0]
            for k in range(1, 4):
                means[row, column, k] = sums[k] * per_pixel
    return means


@kernel(arrays=False)
def extent(m):
    """Root mean square distance of a region's pixels from their middle."""
    n = m[0]
    return math.sqrt(max(m[4] / n - (m[1] / n) ** 2 + m[7] / n - (m[2] / n) ** 2, 1e-30))


@kernel(arrays=False)
def sampling_step(window):
    """Step between the rows, and the columns, of blocks that are enough."""
    area = (window[1] - window[0]) * (window[3] - window[2])
    return max(1, int(math.sqrt(area / SHAPE_BLOCKS)))


@kernel()
def add_blocks(region, means, a, window, step, m, alpha, products):
    """Add the blocks of region ``a`` in a window to the sums of products that a fit needs.

    Parameters
    ----------
    region, means : (R, C) int32 and (R, C, 4) float32
        Regions of blocks, and what `owned_means` returns.
    window : (4,) int64
        First row, row after the last, first column, column after the last: every ``step``-th row and column counts.
    m : (10,) float64
        Moments of what is fitted: x and y are u and v, less their means, over its extent.
    alpha : (3,) float64
        Plane from which residuals are taken.
    products : (7, 7) float64, added to
        Upper triangle, of 1, x, y, x², xy, y² and the residual, weighted by pixels.
    """
    u_0, v_0, per_length = m[1] / m[0], m[2] / m[0], 1.0 / extent(m)
    a_u, a_v, a_1 = alpha[0], alpha[1], alpha[2]
    terms = np.ones(TERMS + 1)
    for row in range(window[0], window[1], step):
        for column in range(window[2], window[3], step):
            if region[row, column] != a:
                continue
            n, u, v = np.float64(means[row, column, 0]), means[row, column, 1], means[row, column, 2]
            x, y = (u - u_0) * per_length, (v - v_0) * per_length
            terms[1], terms[2], terms[3], terms[4], terms[5] = x, y, x * x, x * y, y * y
            terms[6] = means[row, column, 3] - (a_u * u + a_v * v + a_1)
            for i in range(TERMS + 1):
                weighted = n * terms[i]
                for j in range(i, TERMS + 1):
                    products[i, j] += weighted * terms[j]


@kernel(arrays=False)
def residuals(products):
    """Regress the residual on a plane, then on a quadric; returns the sums of squares that they leave.

    ``products`` (7, 7) are those of `add_blocks`, and become triangular. A term that the others span is skipped.
    """
    flat = 0.0
    for k in range(TERMS):
        if k == PLANE_TERMS:
            flat = products[TERMS, TERMS]
        pivot = products[k, k]
        if not pivot > SLIGHT * products[0, 0] or not pivot > 0.0:
            products[k, k:] = 0.0
            continue
        for i in range(k + 1, TERMS + 1):
            factor = products[k, i] / pivot
            for j in range(i, TERMS + 1):
                products[i, j] -= factor * products[k, j]
    return max(flat, 0.0), max(products[TERMS, TERMS], 0.0)


@kernel(arrays=False)
def turn(products, m, alpha):
    """Mean squared angle, in radians, of a bent region's normals against the normal of its plane.

    A step (du, dv) away from the middle the tangent plane is α + dα, dα = (g, -g·(u, v)) with g = H (du, dv) for the
    quadric's second derivatives H; the normal turns by the part of dα / ‖α‖ across α.

    Parameters
    ----------
    products : (7, 7) float64
        As `residuals` leaves them.
    m, alpha : (10,) and (3,) float64
        Moments and plane of the region.
    """
    c_vv = products[5, 6] / products[5, 5] if products[5, 5] > 0.0 else 0.0
    c_uv = (products[4, 6] - products[4, 5] * c_vv) / products[4, 4] if products[4, 4] > 0.0 else 0.0
    rest = products[3, 6] - products[3, 4] * c_uv - products[3, 5] * c_vv
    c_uu = rest / products[3, 3] if products[3, 3] > 0.0 else 0.0
    unit = 1.0 / extent(m) ** 2
    q_uu, q_uv, q_vv = 2.0 * c_uu * unit, c_uv * unit, 2.0 * c_vv * unit
    n = m[0]
    u, v = m[1] / n, m[2] / n
    # The columns of dα/d(u, v), and their parts along α.
    d_u, d_v = -(q_uu * u + q_uv * v), -(q_uv * u + q_vv * v)
    square = alpha[0] ** 2 + alpha[1] ** 2 + alpha[2] ** 2
    along_u = (q_uu * alpha[0] + q_uv * alpha[1] + d_u * alpha[2]) / math.sqrt(square)
    along_v = (q_uv * alpha[0] + q_vv * alpha[1] + d_v * alpha[2]) / math.sqrt(square)
    total = (
        (m[4] / n - u * u) * (q_uu * q_uu + q_uv * q_uv + d_u * d_u - along_u * along_u)
        + 2.0 * (m[5] / n - u * v) * (q_uu * q_uv + q_uv * q_vv + d_u * d_v - along_u * along_v)
        + (m[7] / n - v * v) * (q_uv * q_uv + q_vv * q_vv + d_v * d_v - along_v * along_v)
    )
    return max(total, 0.0) / square


@kernel()
def group_turns(parent, weight, alpha, turned, turn_square):
    """Mean squared angle of the normals of each group of regions about their mean, written at the group's root.

    ``parent`` (N,) leads to the roots; ``turned`` (N,) is the mean squared angle of the normals within each region.
    Each counts by its ``weight`` (N,).
    """
    normal = np.zeros((len(parent), 4))  # and the sum of the weights
    turn_square[:] = 0.0
    for a in range(len(parent)):
        if alpha[a, 0] < math.inf:
            root = root_of(parent, a)
            length = math.sqrt(alpha[a, 0] ** 2 + alpha[a, 1] ** 2 + alpha[a, 2] ** 2)
            for k in range(3):
                normal[root, k] += weight[a] * alpha[a, k] / length
            normal[root, 3] += weight[a]
            turn_square[root] += weight[a] * turned[a]
    for a in range(len(parent)):
        total = normal[a, 3]
        if total > 0.0:
            # 1 - |mean normal|² is the mean squared sine of the normals about their mean.
            mean = (normal[a, 0] ** 2 + normal[a, 1] ** 2 + normal[a, 2] ** 2) / total**2
            turn_square[a] = 1.0 - mean + turn_square[a] / total
