"""Tiles of a frame against the planes that other frames, the references, have where the tiles are seen there.

A motion takes points of the frame to a reference's camera: Y = R·X + t. A plane α of the reference, α·Y = 1, is
α' = Rᵀα / (1 - α·t) in the frame. A tile's residual is r = α'·m - q, with its ray m and its inverse depth q. For a
small motion δ = (ω, τ) before that one, X → X + ω × X + τ, its derivative is (m × α', (α'·m) α'). Steps τ are in units
of a depth, so that turns and steps have derivatives of one size.
"""

import math

from .._jit.kernel import kernel

COLUMNS = 8  # of a match: the derivative's six, the residual, the number of the tile


@kernel(arrays=False)
def match_tiles(tiles, motions, models, table, bounds, limits, matches, counts):
    """Match each tile with the plane that each reference has where the tile's middle is seen there.

    Parameters
    ----------
    tiles : (N, 6) float64
        Ray (tanθx, tanθy), q, and the tile's own α.
    motions : (K, 3, 4) float64
        [R | t] from the frame to each reference.
    models : (K, T, 3) float64
        α of the tiles of each reference; NaN where there is none.
    table : (A, B) int32
        Tile that a ray meets, by the cells of a grid of rays; -1 outside the image.
    bounds : (4,) float64
        Least tanθx and tanθy of the grid, and cells per tangent along both.
    limits : tuple of float
        Largest residual, as a share of q; least cosine of the angle between the tile's own normal and the reference's
        plane; the unit of steps, in metres.
    matches : (>= K·N, COLUMNS) float64
        Written: the matches of one reference after those of the other.
    counts : (K,) int64
        Written: how many of each reference.

    Returns
    -------
    int
        Number of matches.
    """
    height, width = table.shape
    gate, least_cosine, unit = limits
    total = 0
    for k in range(len(motions)):
        first = total
        r00, r01, r02, t0 = motions[k, 0, 0], motions[k, 0, 1], motions[k, 0, 2], motions[k, 0, 3]
        r10, r11, r12, t1 = motions[k, 1, 0], motions[k, 1, 1], motions[k, 1, 2], motions[k, 1, 3]
        r20, r21, r22, t2 = motions[k, 2, 0], motions[k, 2, 1], motions[k, 2, 2], motions[k, 2, 3]
        for i in range(len(tiles)):
            u, v, q = tiles[i, 0], tiles[i, 1], tiles[i, 2]
            # The point times q, so that nothing is divided before it is known to be in front.
            z = r20 * u + r21 * v + r22 + t2 * q
            if not z > 0.01:
                continue
            nearness = 1.0 / z
            column = ((r00 * u + r01 * v + r02 + t0 * q) * nearness - bounds[0]) * bounds[2]
            row = ((r10 * u + r11 * v + r12 + t1 * q) * nearness - bounds[1]) * bounds[3]
            if not (0.0 <= row < height and 0.0 <= column < width):
                continue
            there = table[int(row), int(column)]
            if there < 0:
                continue
            a, b, c = models[k, there, 0], models[k, there, 1], models[k, there, 2]
            scale = 1.0 - (a * t0 + b * t1 + c * t2)
            if not scale > 0.0:  # behind the plane, or there is none
                continue
            scale = 1.0 / scale
            x = (r00 * a + r10 * b + r20 * c) * scale
            y = (r01 * a + r11 * b + r21 * c) * scale
            w = (r02 * a + r12 * b + r22 * c) * scale
            predicted = x * u + y * v + w
            residual = predicted - q
            if not abs(residual) < gate * q:
                continue
            own_x, own_y, own_w = tiles[i, 3], tiles[i, 4], tiles[i, 5]
            lengths = math.sqrt((x * x + y * y + w * w) * (own_x * own_x + own_y * own_y + own_w * own_w))
            if not x * own_x + y * own_y + w * own_w > least_cosine * lengths:
                continue
            matches[total, 0] = v * w - y
            matches[total, 1] = x - u * w
            matches[total, 2] = u * y - v * x
            step = unit * predicted
            matches[total, 3] = step * x
            matches[total, 4] = step * y
            matches[total, 5] = step * w
            matches[total, 6] = residual
            matches[total, 7] = i
            total += 1
        counts[k] = total - first
    return total
