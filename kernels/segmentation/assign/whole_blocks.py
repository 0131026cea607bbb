"""Segmentation: the blocks whose pixels go to a region without being looked at, and the moments of what regions have.

A block whose whole neighbourhood is one region hands its pixels to it, if its moments say that they fit.
"""

import math

import numpy as np

from ..._jit.kernel import kernel
from ...common.arrays import copy
from ..model.moments import moment_rows
from ..model.pixel_noise import grown_variance
from ..model.records import BLOCK, EMPTY, MIXED

# No region, as a number above those of all regions.
NO_REGION = np.int32(np.iinfo(np.int32).max)
# A block with more measured pixels than this is a solid one: what is missing there are holes.
SPARSE = BLOCK * BLOCK // 2


@kernel()
def look_around(region, alone):
    """Say of every block, in (R, C) bool ``alone``, whether it and its eight neighbours have one region."""
    rows, columns = region.shape
    # With a rim of no regions. Two columns more, so that all loops below go over the same number of them.
    width = columns + 2
    beside = np.full((3, width), -1, np.int32)  # three rows of blocks, the middle one among them
    most, lowest = np.empty(width, np.int32), np.empty(width, np.int32)
    for row in range(rows):
        above, regions_here, below = beside[(row + 2) % 3], beside[row % 3], beside[(row + 1) % 3]
        if row == 0:
            copy(region[0], regions_here[1 : columns + 1])
        if row + 1 < rows:
            copy(region[row + 1], below[1 : columns + 1])
        else:
            below[:] = -1
        for c in range(width):
            a, b, d = above[c], regions_here[c], below[c]
            most[c] = max(a, b, d)
            lowest[c] = min(a if a >= 0 else NO_REGION, b if b >= 0 else NO_REGION, d if d >= 0 else NO_REGION)
        line = alone[row]
        for c in range(columns):
            a = regions_here[c + 1]
            high = max(most[c], most[c + 1], most[c + 2])
            low = min(lowest[c], lowest[c + 1], lowest[c + 2])
            line[c] = (high == a) & (low == a)


@kernel()
def give_whole(pyramid, sensor, region, planes, settled, owner):
    """Give the solid blocks around which there is one region to it, if they fit it within ``settled`` deviations.

    The others become MIXED in ``owner``, (R, C) int32, unless they are EMPTY. Arguments as in
    `assign_pixels.assign_pixels`.
    """
    moments, stretch, alpha = pyramid.moments, planes.square_stretch, planes.alpha
    slope_variance, waviness_square = planes.slope_variance, planes.waviness_square
    rows, columns = region.shape
    alone = np.empty((rows, columns), np.bool_)
    look_around(region, alone)
    allowed = settled * settled
    square_sums, limit = np.empty(columns), np.empty(columns)
    for row in range(rows):
        regions_here, line, owners = region[row], alone[row], owner[row]
        here = slice(row * columns, (row + 1) * columns)
        n, s_u, s_v, s_q, s_uu = moment_rows(moments, 0, here)
        s_uv, s_uq, s_vv, s_vq, s_qq = moment_rows(moments, 5, here)
        sensor_here, stretched = sensor[here], stretch[here]
        stop = 0
        while stop < columns:
            start = stop  # of blocks around which there is one region, the same if they are side by side
            while stop < columns and line[stop]:
                stop += 1
            if stop == start:
                stop += 1
                continue
            a = regions_here[start]
            a_u, a_v, a_1 = alpha[a, 0], alpha[a, 1], alpha[a, 2]
            slope, waves = slope_variance[a], waviness_square[a]
            for c in range(start, stop):
                total = grown_variance(sensor_here[c], slope, stretched[c], waves)
                square = (
                    s_qq[c] - 2.0 * (a_u * s_uq[c] + a_v * s_vq[c] + a_1 * s_q[c])
                    + a_u * (a_u * s_uu[c] + 2.0 * (a_v * s_uv[c] + a_1 * s_u[c]))
                    + a_v * (a_v * s_vv[c] + 2.0 * a_1 * s_v[c])
                    + a_1 * a_1 * n[c]
                )  # fmt: skip
                square_sums[c] = square / total
                limit[c] = allowed * n[c] if n[c] > SPARSE else -math.inf
        for c in range(columns):
            is_whole = line[c] & (square_sums[c] <= limit[c])
            owners[c] = EMPTY if owners[c] == EMPTY else regions_here[c] if is_whole else MIXED


@kernel(inline="compiled")
def add_square(square_moments, i, moments, a):
    """Add the moments of square or block ``i`` to those of region ``a``; both arrays have one dimension."""
    there, step = 10 * a, len(square_moments) // 10
    for _ in range(10):
        moments[there] += square_moments[i]
        i, there = i + step, there + 1


@kernel()
def add_up(pyramid, owner, shares, count, region_moments):
    """Sum up what each region has: whole blocks, of which the pyramid knows squares of 4x4, and ``count`` shares.

    ``owner`` is (R, C) int32, ``region_moments`` (N, 10) float64 are written.
    """
    square_moments, offsets, shapes = pyramid.moments.reshape(-1), pyramid.offsets, pyramid.shapes
    moments = region_moments.reshape(-1)
    moments[:] = 0.0
    rows, columns = owner.shape
    same = np.empty(columns, np.bool_)
    for row in range(0, rows, 4):
        a, b, c, d = owner[row], owner[row + 1], owner[row + 2], owner[row + 3]
        for x in range(columns):
            same[x] = (a[x] == b[x]) & (b[x] == c[x]) & (c[x] == d[x])
        for column in range(0, columns, 4):
            first = a[column]
            if (
                same[column] & same[column + 1] & same[column + 2] & same[column + 3]
                & (a[column + 1] == first) & (a[column + 2] == first) & (a[column + 3] == first)
            ):  # fmt: skip
                if first >= 0:
                    i = offsets[2] + (row >> 2) * shapes[2, 1] + (column >> 2)
                    add_square(square_moments, i, moments, first)
                continue
            for r in range(row, row + 4):
                for k in range(column, column + 4):
                    if owner[r, k] >= 0:
                        add_square(square_moments, r * columns + k, moments, owner[r, k])
    for s in range(count):
        for k in range(10):
            region_moments[shares.region[s], k] += shares.moments[s, k]
