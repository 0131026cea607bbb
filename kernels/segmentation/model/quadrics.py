"""Segmentation: the quadric that fits a region, q = α·(u, v, 1) + a u² + b uv + c v².

It has as many parameters as two planes. The blocks' means are enough for it; pixels are touched only of small regions.
"""

import math

import numpy as np

from ..._jit.kernel import kernel
from ...common.union_find import root_of
from .moments import moment_rows, pixel_ray
from .records import BLOCK, MIXED, UNSEEN

TERMS = 6  # of a quadric: 1, x, y, x², xy, y²
PLANE_TERMS = 3
# A direction in which a region extends by less than this share (squared) of the others says nothing.
SLIGHT = 1e-6
SHAPE_BLOCKS = 256  # blocks that are enough to show a shape
TOGETHER = 256  # blocks that are summed up together
# Variances that three more terms must gain, times the pixels that share an error: of χ²(3) one in fifty is 10.
SURE = 10.0


@kernel(inline="compiled")
def is_whole(owner):
    """Whether one region has all measured pixels of a block, by its `Owners`: all had, before the first round."""
    return owner >= 0 or owner == UNSEEN


@kernel()
def owned_means(regions, pyramid):
    """Number and mean (u, v, q) of the pixels of each block that its region owns.

    Parameters
    ----------
    regions : Regions
    pyramid : Pyramid

    Returns
    -------
    (4, R, C) float32
        Of blocks that have a region; of the others it means nothing.
    """
    region, _, number, owners, shares = regions
    block, first_share, shares_of = owners.block, owners.first, owners.count
    share_region, share_moments = shares.region, shares.moments
    rows, columns = region.shape
    moments = pyramid.moments
    means = np.empty((4, rows, columns), np.float32)
    for row in range(rows):
        here = slice(row * columns, (row + 1) * columns)
        n, s_u, s_v, s_q, _ = moment_rows(moments, 0, here)
        block_pixels, block_u, block_v, block_q = means[0, row], means[1, row], means[2, row], means[3, row]
        for column in range(columns):
            per_pixel = 1.0 / max(n[column], 1.0)
            block_pixels[column] = n[column]
            block_u[column] = s_u[column] * per_pixel
            block_v[column] = s_v[column] * per_pixel
            block_q[column] = s_q[column] * per_pixel
        owned, owner = region[row], block[row]
        for column in range(columns):
            a = owned[column]
            if a < 0 or owner[column] != MIXED:
                continue
            n_a, u_a, v_a, q_a = 0.0, 0.0, 0.0, 0.0
            first = first_share[row, column]
            for s in range(first, first + shares_of[row, column]):
                if number[share_region[s]] == a:
                    n_a += share_moments[s, 0]
                    u_a += share_moments[s, 1]
                    v_a += share_moments[s, 2]
                    q_a += share_moments[s, 3]
            per_pixel = 1.0 / max(n_a, 1.0)
            block_pixels[column], block_u[column] = n_a, u_a * per_pixel
            block_v[column], block_q[column] = v_a * per_pixel, q_a * per_pixel
    return means


@kernel(arrays=False)
def owned_bits(regions, a, row, column):
    """Which pixels of a block region ``a`` owns, as in `Shares`; -1 for all that are measured."""
    region, _, number, owners, shares = regions
    bits = 0
    if region[row, column] != a:
        return bits
    if is_whole(owners.block[row, column]):
        bits = -1
    elif owners.block[row, column] == MIXED:
        first = owners.first[row, column]
        for s in range(first, first + owners.count[row, column]):
            if number[shares.region[s]] == a:
                bits |= shares.pixels[s]
    return bits


@kernel()
def inner_pixels(regions, a, box, inverse_depth, rays, pixels):
    """Write the pixels inside region ``a`` to ``pixels`` (4, K), as `owned_means` does blocks; returns how many.

    Those that are beside what is not the region's are left out, if they are less than half: a sensor's pixel may see
    both. ``box`` (N, 4) int64 is that of `boxes`, ``inverse_depth`` (H, W) float32.
    """
    height, width = inverse_depth.shape
    top, left = BLOCK * box[a, 0] - 1, BLOCK * box[a, 2] - 1  # with a rim
    owned = np.zeros((BLOCK * box[a, 1] - top + 1, BLOCK * box[a, 3] - left + 1), np.bool_)
    buffer = pixels.shape[1]
    places = np.empty((buffer, 2), np.int32)
    count = 0
    for row in range(box[a, 0], box[a, 1]):
        for column in range(box[a, 2], box[a, 3]):
            bits = owned_bits(regions, a, row, column)
            if bits == 0:
                continue
            for y in range(BLOCK * row, min(BLOCK * row + BLOCK, height)):
                for x in range(BLOCK * column, min(BLOCK * column + BLOCK, width)):
                    is_own = bits >> (BLOCK * (y % BLOCK) + x % BLOCK) & 1 and inverse_depth[y, x] > 0.0
                    if is_own and count < buffer:
                        owned[y - top, x - left] = True
                        places[count, 0], places[count, 1] = y - top, x - left
                        count += 1
    inside = np.empty(count, np.bool_)
    inner = 0
    for i in range(count):
        y, x = places[i, 0], places[i, 1]
        inside[i] = owned[y - 1, x] & owned[y + 1, x] & owned[y, x - 1] & owned[y, x + 1]
        inner += inside[i]
    everything = 2 * inner < count
    chosen = 0
    for i in range(count):
        if inside[i] or everything:
            y, x = top + places[i, 0], left + places[i, 1]
            u, v = pixel_ray(rays, y, x)
            pixels[0, chosen], pixels[1, chosen], pixels[2, chosen] = 1.0, u, v
            pixels[3, chosen] = inverse_depth[y, x]
            chosen += 1
    return chosen


@kernel(inline="compiled")
def first_from(start, step, least):
    """The first of ``start``, ``start + step``, ... that is at least ``least``."""
    return start + (max(least - start, 0) + step - 1) // step * step


@kernel(inline=True)
def block_buffer():
    """Room in which `add_blocks` collects blocks."""
    return np.empty((4, TOGETHER), np.float32)


@kernel(arrays=False)
def add_blocks(region, means, a, box, reference, deviation, window, step, centre, scale, buffer, products):
    """Add the blocks of region ``a`` in a window to the sums of products that a fit needs.

    Parameters
    ----------
    region, means : (R, C) int32, (4, R, C) float32
        See `owned_means`.
    box : (N, 4) int64
        See `boxes`.
    reference : (3,) float64
        α of the plane from which residuals are taken.
    deviation : float
        Their unit, 1/m.
    window : (4,) int64
        As in `boxes`; every ``step``-th row and column counts.
    centre, scale
        x = (u - centre[0]) / scale, y = (v - centre[1]) / scale.
    room
        See `block_buffer`.
    products : (7, 7) float64, added to
        Of 1, x, y, x², xy, y² and the residual, weighted by pixels.

    Returns
    -------
    float
        Pixels of the blocks that were added.
    """
    count, pixels = 0, 0.0
    first_row, first_column = first_from(window[0], step, box[a, 0]), first_from(window[2], step, box[a, 2])
    for row in range(first_row, min(window[1], box[a, 1]), step):
        row_regions = region[row]
        block_pixels, block_u, block_v, block_q = means[0, row], means[1, row], means[2, row], means[3, row]
        for column in range(first_column, min(window[3], box[a, 3]), step):
            buffer[0, count], buffer[1, count] = block_pixels[column], block_u[column]
            buffer[2, count], buffer[3, count] = block_v[column], block_q[column]
            count += row_regions[column] == a
            if count == TOGETHER:
                pixels += add_products(buffer, count, reference, deviation, centre, scale, products)
                count = 0
    return pixels + add_products(buffer, count, reference, deviation, centre, scale, products)


@kernel(reduction=True)
def add_products(chosen, count, reference, deviation, centre, scale, products):
    """Add n, u, v and q of the first ``count`` of the ``chosen`` blocks, as `add_blocks` does; returns the sum of n."""
    # Sums of n·xⁱ·yʲ, of n·xⁱ·yʲ·e, and of n·e² over the blocks: each of them once.
    n_00 = n_10 = n_01 = n_20 = n_11 = n_02 = n_30 = n_21 = n_12 = n_03 = n_40 = n_31 = n_22 = n_13 = n_04 = 0.0
    e_00 = e_10 = e_01 = e_20 = e_11 = e_02 = ee = 0.0
    c_u, c_v, c_1 = reference[0], reference[1], reference[2]
    u_0, v_0, per_length, per_deviation = centre[0], centre[1], 1.0 / scale, 1.0 / deviation
    block_pixels, block_u, block_v, block_q = chosen[0], chosen[1], chosen[2], chosen[3]
    for i in range(count):
        n, u, v = np.float64(block_pixels[i]), np.float64(block_u[i]), np.float64(block_v[i])
        e = (block_q[i] - (c_u * u + c_v * v + c_1)) * per_deviation
        x, y = (u - u_0) * per_length, (v - v_0) * per_length
        n_x, n_y, n_e = n * x, n * y, n * e
        n_xx, n_xy, n_yy = n_x * x, n_x * y, n_y * y
        n_00 += n
        n_10 += n_x
        n_01 += n_y
        n_20 += n_xx
        n_11 += n_xy
        n_02 += n_yy
        n_30 += n_xx * x
        n_21 += n_xx * y
        n_12 += n_yy * x
        n_03 += n_yy * y
        n_40 += n_xx * x * x
        n_31 += n_xx * x * y
        n_22 += n_xx * y * y
        n_13 += n_xy * y * y
        n_04 += n_yy * y * y
        e_00 += n_e
        e_10 += n_e * x
        e_01 += n_e * y
        e_20 += n_e * x * x
        e_11 += n_e * x * y
        e_02 += n_e * y * y
        ee += n_e * e
    add_row(products, 0, (n_00, n_10, n_01, n_20, n_11, n_02, e_00))
    add_row(products, 1, (n_20, n_11, n_30, n_21, n_12, e_10))
    add_row(products, 2, (n_02, n_21, n_12, n_03, e_01))
    add_row(products, 3, (n_40, n_31, n_22, e_20))
    add_row(products, 4, (n_22, n_13, e_11))
    add_row(products, 5, (n_04, e_02))
    products[6, 6] += ee
    return n_00


@kernel(inline="compiled")
def add_row(products, row, values):
    """Add to a row of the upper triangle."""
    for k in range(len(values)):
        products[row, row + k] += values[k]


@kernel(arrays=False)
def eliminate(products, first, stop):
    """Regress the remainder on terms ``first`` to ``stop``; returns the sum of squares that is left.

    Only the upper triangle is used. A term that the others already span is skipped.
    """
    last = TERMS
    for k in range(first, stop):
        pivot = products[k, k]
        if not pivot > SLIGHT * products[0, 0] or (k > 0 and not pivot > 0.0):
            products[k, k:] = 0.0
            continue
        for i in range(k + 1, last + 1):
            factor = products[k, i] / pivot
            for j in range(i, last + 1):
                products[i, j] -= factor * products[k, j]
    return max(products[last, last], 0.0)


@kernel()
def second_derivatives(products, scale, deviation):
    """The quadric's second derivatives q_uu, q_uv, q_vv, after `eliminate`."""
    c = np.zeros(TERMS)
    for k in range(TERMS - 1, PLANE_TERMS - 1, -1):
        if products[k, k] > 0.0:
            total = products[k, TERMS]
            for i in range(k + 1, TERMS):
                total -= products[k, i] * c[i]
            c[k] = total / products[k, k]
    unit = deviation / (scale * scale)
    return 2.0 * c[3] * unit, c[4] * unit, 2.0 * c[5] * unit


@kernel(arrays=False)
def extent(m):
    """Root mean square distance of a region's pixels from their middle."""
    n = m[0]
    return math.sqrt(max(m[4] / n - (m[1] / n) ** 2 + m[7] / n - (m[2] / n) ** 2, 1e-30))


@kernel(arrays=False)
def turn(m, alpha, h):
    """Mean squared angle, in radians, of a bent region's normals against the normal of its plane.

    A step (du, dv) away from the middle the tangent plane is α + dα, dα = (g, -g·(u, v)) with g = H (du, dv);
    the normal turns by the part of dα / ‖α‖ across α.
    """
    n = m[0]
    u, v = m[1] / n, m[2] / n
    uu, uv, vv = m[4] / n - u * u, m[5] / n - u * v, m[7] / n - v * v
    square = alpha[0] ** 2 + alpha[1] ** 2 + alpha[2] ** 2
    # The columns of dα/d(u, v), and their parts along α.
    a_u, b_u = h[0], h[1]
    a_v, b_v = h[1], h[2]
    c_u, c_v = -(a_u * u + b_u * v), -(a_v * u + b_v * v)
    along_u = (a_u * alpha[0] + b_u * alpha[1] + c_u * alpha[2]) / math.sqrt(square)
    along_v = (a_v * alpha[0] + b_v * alpha[1] + c_v * alpha[2]) / math.sqrt(square)
    total = (
        uu * (a_u * a_u + b_u * b_u + c_u * c_u - along_u * along_u)
        + 2.0 * uv * (a_u * a_v + b_u * b_v + c_u * c_v - along_u * along_v)
        + vv * (a_v * a_v + b_v * b_v + c_v * c_v - along_v * along_v)
    )
    return max(total, 0.0) / square


@kernel(arrays=False)
def sampling_step(window):
    """Step between the rows, and the columns, of blocks that are enough."""
    area = (window[1] - window[0]) * (window[3] - window[2])
    return max(1, int(math.sqrt(area / SHAPE_BLOCKS)))


@kernel()
def region_turn(region, means, a, box, m, alpha, variance, waviness_square, rules, buffer, products):
    """How far the normals of a region turn within it: mean squared angle, 0 where noise explains it.

    Parameters
    ----------
    region, means
        See `owned_means`.
    a : int
        The region.
    box : (N, 4) int64
        See `boxes`.
    m, alpha : (10,) and (3,) float64
        Its moments and its plane.
    variance, waviness_square : float
        Of a pixel about the plane, without the waviness.
    rules : Rules
    room
        See `block_buffer`.
    products : (7, 7) float64, written
        Those of the quadric, after `eliminate`.

    Returns
    -------
    turned : float
    bending : float
        The same, also where noise explains it.
    gain, rest : float
        By how much the quadric lowers the mean squared residual of the plane, and what it leaves, in variances.
    """
    deviation, scale, step = math.sqrt(variance), extent(m), sampling_step(box[a])
    centre = m[1] / m[0], m[2] / m[0]
    products[:] = 0.0
    pixels = add_blocks(region, means, a, box, alpha, deviation, box[a], step, centre, scale, buffer, products)
    if pixels == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    flat = eliminate(products, 0, PLANE_TERMS)
    rest = eliminate(products, PLANE_TERMS, TERMS)
    bending = turn(m, alpha, second_derivatives(products, scale, deviation))
    turned = bending if (flat - rest) * step * step > rules.joint_variances * waviness_square else 0.0
    return turned, bending, (flat - rest) / pixels, rest / pixels


@kernel()
def group_turns(parent, weight, alpha, turned, turn_square, total, members):
    """Mean squared angle of the normals of each group of regions about their mean, written at the group's root.

    ``parent`` (N,) leads to the roots; ``turned`` (N,) is the mean squared angle of the normals within each region.
    Also written: ``total`` (N,), the sum of the ``weight`` (N,), and ``members`` (N,) of each group.
    """
    regions = len(parent)
    normal = np.zeros((regions, 3))
    turn_square[:] = total[:] = 0.0
    members[:] = 0
    for a in range(regions):
        if not alpha[a, 0] < math.inf:
            continue
        root = root_of(parent, a)
        length = math.sqrt(alpha[a, 0] ** 2 + alpha[a, 1] ** 2 + alpha[a, 2] ** 2)
        for k in range(3):
            normal[root, k] += weight[a] * alpha[a, k] / length
        total[root] += weight[a]
        turn_square[root] += weight[a] * turned[a]
        members[root] += 1
    for a in range(regions):
        if total[a] > 0.0:
            mean = (normal[a, 0] ** 2 + normal[a, 1] ** 2 + normal[a, 2] ** 2) / total[a] ** 2
            # 1 - |mean normal|² is the mean squared sine of the normals about their mean.
            turn_square[a] = 1.0 - mean + turn_square[a] / total[a]


# Of what two planes gain over one, a quadric gains 1/15 more on a parabola, and 1/16 less on an edge.
MARGIN = 1.0 / 32.0
