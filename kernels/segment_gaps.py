"""Segmentation, last of all: parts of one plane that a thin thing in front separates are one plane again.

A lamp's pole cuts the wall behind it in two. The two halves are one plane if their moments agree that they are
and nothing between them is farther away than the plane: through what is farther one would see that there is a gap
in the wall itself.
"""

import numpy as np

from ._jit import kernel
from .segment_blocks import joint_residual, residual

STEP = 1  # every so many rows and columns are looked along
LEAST = 4  # rows or columns that must cross a gap
BEYOND = 4.0  # deviations by which something is farther than the plane
OPEN = 0.1  # share of the rows or columns that may see through


@kernel()
def find_coplanar(moments, alpha, deviation, floor, spread, pairs):
    """Pairs of planes whose union is one plane as well.

    Parameters
    ----------
    moments, alpha, deviation : (N, 10), (N, 3), (N,) float64
        Moments and plane of each, and standard deviation of a pixel about it.
    floor, spread : float
        Joining two may raise the sum of squared residuals by floor² n + spread variances; n are the smaller
        one's pixels.
    pairs : (K, 2) int64, written

    Returns
    -------
    int
        How many there are, at most K.
    """
    count = 0
    for a in range(len(moments)):
        for b in range(a):
            m, k = moments[a], moments[b]
            variance = min(deviation[a], deviation[b]) ** 2
            smaller = m if m[0] < k[0] else k
            allowed = floor * floor + spread / smaller[0]
            u, v = smaller[1] / smaller[0], smaller[2] / smaller[0]
            d = (alpha[a, 0] - alpha[b, 0]) * u + (alpha[a, 1] - alpha[b, 1]) * v + alpha[a, 2] - alpha[b, 2]
            # The smaller one's pixels are nearly all of the rise: a quick way to say no.
            if not d * d <= 4.0 * allowed * variance or count == len(pairs):
                continue
            rise = joint_residual(m, k) - residual(m) - residual(k)
            if rise <= allowed * variance * smaller[0]:
                pairs[count, 0], pairs[count, 1] = b, a
                count += 1
    return count


@kernel()
def measure_gaps(labels, inverse_depth, tan_x, tan_y, alpha, deviation, pairs, across, closed, opened):
    """Look along rows, or along columns, from one plane of a pair to the other.

    Parameters
    ----------
    labels : (H, W) int32
        0 none; plane a has label a + 1.
    across : bool
        Along the rows.
    closed : (K, L) int64, written
        How many gaps of each width, in pixels, each pair has.
    opened : (K,) int64, written
        How many more one sees through.
    """
    height, width = labels.shape
    step_y, step_x = int(tan_x.shape[0] > 1), int(tan_y.shape[1] > 1)
    closed[:] = 0
    opened[:] = 0
    last = np.empty(len(alpha) + 1, np.int64)
    wanted = np.zeros(len(alpha) + 1, np.bool_)
    for k in range(len(pairs)):
        wanted[pairs[k, 0] + 1] = wanted[pairs[k, 1] + 1] = True
    lines, length = (height, width) if across else (width, height)
    for line in range(0, lines, STEP):
        last[:] = -1
        before = 0
        for s in range(length):
            a = labels[line, s] if across else labels[s, line]
            if a != before and wanted[a]:
                for k in range(len(pairs)):
                    if pairs[k, 0] + 1 != a and pairs[k, 1] + 1 != a:
                        continue
                    b = pairs[k, 0] + pairs[k, 1] + 2 - a
                    if last[b] <= last[a]:
                        continue
                    is_open = False
                    for t in range(last[b] + 1, s):
                        y, x = (line, t) if across else (t, line)
                        q = inverse_depth[y, x]
                        plane = (
                            alpha[b - 1, 0] * tan_x[y * step_y, x]
                            + alpha[b - 1, 1] * tan_y[y, x * step_x]
                            + alpha[b - 1, 2]
                        )
                        is_open |= 0.0 < q < plane - BEYOND * deviation[b - 1]
                    if is_open:
                        opened[k] += 1
                    else:
                        closed[k, s - last[b] - 1] += 1
            before = a
            last[a] = s


@kernel()
def join_across(pairs, closed, opened, parent):
    """Unite the pairs whose gaps are thin: no wider, for some way, than that way is long.

    ``parent`` (N,) int64 becomes the first plane that each goes with.
    """
    for k in range(len(pairs)):
        if opened[k] > OPEN * (closed[k].sum() + opened[k]):
            continue
        crossed = 0
        for gap in range(closed.shape[1]):
            crossed += closed[k, gap]
            if crossed >= LEAST and crossed * STEP >= gap:
                a, b = pairs[k]
                while parent[a] != a:
                    a = parent[a]
                while parent[b] != b:
                    b = parent[b]
                parent[max(a, b)] = min(a, b)
                break
    for a in range(len(parent)):
        parent[a] = parent[parent[a]]
