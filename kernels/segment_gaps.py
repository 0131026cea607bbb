"""Segmentation, last of all: parts of one plane that a thin thing in front separates are one plane again.

A lamp's pole cuts the wall behind it in two. The two halves are one plane if their moments agree that they are
and nothing between them is farther away than the plane: through what is farther one would see that there is a gap
in the wall itself.
"""

import numpy as np

from ._jit import kernel
from .segment_blocks import joint_residual, residual

LEAST = 4  # rows or columns that must cross a gap
BEYOND = 4.0  # deviations by which something is farther than the plane
FARTHEST = np.iinfo(np.int64).max  # a row or column after all others
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
def part_boxes(run_row, run_start, run_stop, runs, part, number, box):
    """First row, row after the last, first column, column after the last of each label.

    Runs and parts are those of `segment_parts.find_runs`; ``number`` (P,) int32 is the label of each part, 0 for
    none. ``box`` (N + 1, 4) int64 is written, row a for label a.
    """
    box[:, 0] = box[:, 2] = FARTHEST
    box[:, 1] = box[:, 3] = 0
    for i in range(runs):
        b = box[number[part[i]]]
        b[0], b[1] = min(b[0], run_row[i]), max(b[1], run_row[i] + 1)
        b[2], b[3] = min(b[2], run_start[i]), max(b[3], run_stop[i])


@kernel()
def is_thin(labels, inverse_depth, tan_x, tan_y, a, b, alpha, reach, box, across):
    """Whether the gap between labels a and b, looked at along rows or along columns, is longer than wide.

    Parameters
    ----------
    labels : (H, W) int32
    alpha : (3,) float64
        The plane of both.
    reach : float
        What is farther than the plane by this, in 1/m, one sees through the gap.
    box : (N + 1, 4) int64
        Of `part_boxes`.
    across : bool
        Along the rows.
    """
    step_y, step_x = int(tan_x.shape[0] > 1), int(tan_y.shape[1] > 1)
    i, j = (0, 2) if across else (2, 0)  # where lines, and places along them, stand in a box
    first, stop = max(box[a, i], box[b, i]), min(box[a, i + 1], box[b, i + 1])
    start, end = min(box[a, j], box[b, j]), max(box[a, j + 1], box[b, j + 1])
    widest = stop - first  # no gap counts as thin that is wider than there are lines
    if widest < LEAST:
        return False
    gaps = np.zeros(widest + 1, np.int64)
    closed = opened = 0
    for line in range(first, stop):
        last_a = last_b = -1
        for s in range(start, end):
            label = labels[line, s] if across else labels[s, line]
            if label != a and label != b:
                continue
            last = last_b if label == a else last_a
            if last > (last_a if label == a else last_b):
                through = False
                for t in range(last + 1, s):
                    y, x = (line, t) if across else (t, line)
                    plane = alpha[0] * tan_x[y * step_y, x] + alpha[1] * tan_y[y, x * step_x] + alpha[2]
                    through |= 0.0 < inverse_depth[y, x] < plane - reach
                if through:
                    opened += 1
                else:
                    closed += 1
                    if s - last - 1 <= widest:
                        gaps[s - last - 1] += 1
            if label == a:
                last_a = s
            else:
                last_b = s
    if opened > OPEN * (opened + closed):
        return False
    crossed = 0
    for gap in range(widest + 1):
        crossed += gaps[gap]
        if crossed >= LEAST and crossed >= gap:
            return True
    return False


@kernel()
def join_across(labels, inverse_depth, tan_x, tan_y, alpha, deviation, pairs, count, box, parent):
    """Unite the pairs of planes whose gaps are thin; ``parent`` (N,) int64 becomes the first each goes with."""
    for k in range(count):
        a, b = pairs[k]
        reach = BEYOND * deviation[a]
        if is_thin(labels, inverse_depth, tan_x, tan_y, a + 1, b + 1, alpha[a], reach, box, True) or is_thin(
            labels, inverse_depth, tan_x, tan_y, a + 1, b + 1, alpha[a], reach, box, False
        ):
            while parent[a] != a:
                a = parent[a]
            while parent[b] != b:
                b = parent[b]
            parent[max(a, b)] = min(a, b)
    for a in range(len(parent)):
        parent[a] = parent[parent[a]]
