"""Tiles of a frame against the planes that other frames, the references, have where the tiles are seen there.

A motion takes points of the frame to a reference's camera: Y = R·X + t. A plane α of the reference, α·Y = 1, is
α' = Rᵀα / (1 - α·t) in the frame. A tile's residual is r = α'·m - q, with its ray m and its inverse depth q. For a
small motion δ = (ω, τ) before that one, X → X + ω × X + τ, its derivative is (m × α', (α'·m) α').
"""

import math

from .._jit.kernel import kernel

COLUMNS = 8  # of a match: the derivative's six, the residual, the number of the tile

# Entries of the sums of a group, see `sum_groups`: where each part begins, and how many there are.
WEIGHT, SQUARES, NORMAL, RIGHT, CROSS, SUMS = 0, 1, 2, 8, 11, 29


@kernel(arrays=False)
def match_tiles(tiles, motions, models, table, bounds, gate, least_cosine, matches, counts):
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
    gate : float
        Largest residual, as a share of q.
    least_cosine : float
        Of the angle between the tile's own normal and the reference's plane.
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
            column = ((r00 * u + r01 * v + r02 + t0 * q) / z - bounds[0]) * bounds[2]
            row = ((r10 * u + r11 * v + r12 + t1 * q) / z - bounds[1]) * bounds[3]
            if not (0.0 <= row < height and 0.0 <= column < width):
                continue
            there = table[int(row), int(column)]
            if there < 0:
                continue
            a, b, c = models[k, there, 0], models[k, there, 1], models[k, there, 2]
            scale = 1.0 - (a * t0 + b * t1 + c * t2)
            if not scale > 0.0:  # behind the plane, or there is none
                continue
            x = (r00 * a + r10 * b + r20 * c) / scale
            y = (r01 * a + r11 * b + r21 * c) / scale
            w = (r02 * a + r12 * b + r22 * c) / scale
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
            matches[total, 3] = predicted * x
            matches[total, 4] = predicted * y
            matches[total, 5] = predicted * w
            matches[total, 6] = residual
            matches[total, 7] = i
            total += 1
        counts[k] = total - first
    return total


@kernel(arrays=False)
def sum_groups(matches, tiles, groups, weights, sums):
    """Sum matches by the planes of the frame.

    Parameters
    ----------
    matches : (M, COLUMNS) float64
    tiles : (N, 6) float64
    groups : (N,) intp
        Group of each tile, from 0.
    weights : (M,) float64
    sums : (G, SUMS) float64
        Written: from WEIGHT, Σw; SQUARES, Σw²; NORMAL, Σw·m·mᵀ as xx, xy, xz, yy, yz, zz; RIGHT, Σw·m·r; CROSS,
        Σw·J·mᵀ, row by row.
    """
    sums[:] = 0.0
    for k in range(len(matches)):
        i = int(matches[k, 7])
        g, w = groups[i], weights[k]
        u, v, r = tiles[i, 0], tiles[i, 1], matches[k, 6]
        sums[g, 0] += w
        sums[g, 1] += w * w
        sums[g, 2] += w * u * u
        sums[g, 3] += w * u * v
        sums[g, 4] += w * u
        sums[g, 5] += w * v * v
        sums[g, 6] += w * v
        sums[g, 7] += w
        sums[g, 8] += w * r * u
        sums[g, 9] += w * r * v
        sums[g, 10] += w * r
        for j in range(6):
            derivative = w * matches[k, j]
            sums[g, 11 + 3 * j] += derivative * u
            sums[g, 12 + 3 * j] += derivative * v
            sums[g, 13 + 3 * j] += derivative
