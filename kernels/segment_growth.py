"""Segmentation: squares of the quadtree grow together where they are beyond doubt one plane.

What is left for `segment_merge` to weigh against each other are tens of regions, not thousands of squares.
"""

import numpy as np

from ._jit import kernel
from .segment_moments import joint_residual
from .segment_noise import sensor_variance


@kernel()
def grow(region, node, place, rss, slope, moments, sigma, lateral, floor, spread, most, number):
    """Grow regions from the largest squares on, neighbour by neighbour.

    Parameters
    ----------
    region : (R, C) int32
        Of `segment_quadtree.leaves`, largest squares first; changed to the numbers of the grown regions.
    node, place : (N,), (N, 3) int32
        Of `segment_quadtree.leaves`.
    rss, slope : (T,) float64
        See `segment_blocks.sum_by_fours`.
    moments : (N, 10) float64
        Of each square; those of the grown regions are written to the first rows.
    sigma, lateral
        See `segment_quadtree.join_blocks`.
    floor, spread : float
        A square joins a region if that raises the sum of squared residuals by at most floor² n + spread variances; n
        are the smaller one's pixels.
    most : float
        Pixels that a region has at most: what is bent a little by the sensor must be weighed in pieces.
    number : (N,) int64, written
        Grown region of each square.

    Returns
    -------
    int
        Number of grown regions.
    """
    rows, columns = region.shape
    # With a rim of no squares, so that a walk around a square needs no care where the frame ends.
    stride = columns + 2
    square_at = np.full((rows + 2) * stride, -1, np.int32)
    for row in range(rows):
        for column in range(columns):
            square_at[(row + 1) * stride + column + 1] = region[row, column]
    steps = (1, stride, -1, -stride)
    queue = np.empty(len(moments), np.int32)
    asked = np.full(len(moments), -1, np.int32)
    total = np.empty(10)
    number[:] = -1
    count = 0
    for seed in range(len(moments)):
        if number[seed] >= 0:
            continue
        number[seed] = asked[seed] = count
        total[:] = moments[seed]
        joint = rss[node[seed]]
        queue[0] = seed
        head, tail = 0, 1
        while head < tail:
            top, left, side = place[queue[head]]
            head += 1
            at = top * stride + left  # the corner outside the square
            for turn in range(4):
                for _ in range(side + 1):
                    at += steps[turn]
                    b = square_at[at]
                    if b < 0 or asked[b] == count or number[b] >= 0:
                        continue
                    asked[b] = count
                    m = moments[b]
                    if total[0] + m[0] > most:
                        continue
                    larger = joint_residual(total, m)
                    noise = sensor_variance(m[3] / m[0], sigma) + lateral * slope[node[b]]
                    rise = larger - joint - rss[node[b]]
                    if rise <= noise * (floor * floor * min(m[0], total[0]) + spread):
                        number[b] = count
                        for j in range(10):
                            total[j] += m[j]
                        joint = larger
                        queue[tail] = b
                        tail += 1
        for j in range(10):
            moments[count, j] = total[j]  # of a square that has been taken
        count += 1
    for row in range(rows):
        for column in range(columns):
            a = region[row, column]
            region[row, column] = number[a] if a >= 0 else -1
    return count
