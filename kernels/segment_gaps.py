"""Segmentation: parts of one plane that a thin thing in front separates are one plane again.

A lamp's pole cuts the wall behind it in two. The two halves are one plane if their moments agree that they are
and nothing between them is farther away than the plane: through what is farther one would see that there is a gap
in the wall itself.
"""

import numpy as np

from ._jit import kernel
from .copying import copy
from .disjoint_sets import root_of, unite
from .segment_moments import difference, ray_of, rise
from .segment_planes import fit_planes

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
        The first K of them, nearest labels first.

    Returns
    -------
    int
        How many there are.
    """
    count = 0
    for a in range(len(moments)):
        for b in range(a - 1, -1, -1):
            m, k = moments[a], moments[b]
            variance = min(deviation[a], deviation[b]) ** 2
            smaller = m if m[0] < k[0] else k
            allowed = floor * floor + spread / smaller[0]
            u, v = smaller[1] / smaller[0], smaller[2] / smaller[0]
            d_u, d_v, d_1 = difference(alpha, a, b)
            d = d_u * u + d_v * v + d_1
            # The smaller one's pixels are nearly all of the rise: a quick way to say no.
            if not d * d <= 4.0 * allowed * variance:
                continue
            if rise(m, k) <= allowed * variance * smaller[0]:
                if count < len(pairs):
                    pairs[count, 0], pairs[count, 1] = b, a
                count += 1
    return count


@kernel()
def label_boxes(runs, box):
    """First row, row after the last, first column, column after the last of each label.

    ``box`` (N + 1, 4) int64 is written, row a for label a.
    """
    row_runs, run_start, run_stop, run_label = runs.first, runs.start, runs.stop, runs.label
    box[:, 0] = box[:, 2] = FARTHEST
    box[:, 1] = box[:, 3] = 0
    for y in range(len(row_runs) - 1):
        for i in range(row_runs[y], row_runs[y + 1]):
            b = box[run_label[i]]
            b[0], b[1] = min(b[0], y), y + 1
            b[2], b[3] = min(b[2], run_start[i]), max(b[3], run_stop[i])


@kernel(inline=True)
def sees_through(inverse_depth, rays, alpha, reach, y, x):
    """Whether something farther away than a plane is seen at a pixel."""
    u, v = ray_of(rays, y, x)
    return 0.0 < inverse_depth[y, x] < alpha[0] * u + alpha[1] * v + alpha[2] - reach


@kernel()
def gaps_across(runs, inverse_depth, rays, a, b, alpha, reach, box, look, gaps):
    """Gaps between labels a and b along the rows.

    ``gaps`` (G,) int64 is written: how many gaps of 0, 1, 2, ... pixels one does not see through. Returns how many
    one sees through, and does not. Unless told to ``look`` it takes it that one sees through none.
    """
    row_runs, run_start, run_stop, run_label = runs.first, runs.start, runs.stop, runs.label
    closed = opened = 0
    gaps[:] = 0
    for y in range(max(box[a, 0], box[b, 0]), min(box[a, 1], box[b, 1])):
        last = -1  # run of a or of b
        for i in range(row_runs[y], row_runs[y + 1]):
            if run_label[i] != a and run_label[i] != b:
                continue
            if last >= 0 and run_label[last] != run_label[i]:
                through = False
                for x in range(run_stop[last], run_start[i] if look else 0):
                    if sees_through(inverse_depth, rays, alpha, reach, y, x):
                        through = True
                        break
                opened += through
                closed += not through
                width = run_start[i] - run_stop[last]
                if not through and width < len(gaps):
                    gaps[width] += 1
            last = i
    return opened, closed


@kernel()
def gaps_down(runs, inverse_depth, rays, a, b, alpha, reach, box, look, gaps):
    """The same along the columns."""
    row_runs, run_start, run_stop, run_label = runs.first, runs.start, runs.stop, runs.label
    closed = opened = 0
    gaps[:] = 0
    first, stop = max(box[a, 2], box[b, 2]), min(box[a, 3], box[b, 3])
    last = np.full((2, stop - first), -1, np.int64)  # row where each column last met a, and b
    for y in range(min(box[a, 0], box[b, 0]), max(box[a, 1], box[b, 1])):
        for i in range(row_runs[y], row_runs[y + 1]):
            if run_label[i] != a and run_label[i] != b:
                continue
            own, other = (last[0], last[1]) if run_label[i] == a else (last[1], last[0])
            start, end = max(run_start[i], first) - first, min(run_stop[i], stop) - first
            met = False
            for k in range(start, end):
                met |= other[k] > own[k]
            if met:
                for k in range(start, end):
                    if other[k] <= own[k]:
                        continue
                    through = False
                    for r in range(other[k] + 1, y if look else 0):
                        if sees_through(inverse_depth, rays, alpha, reach, r, k + first):
                            through = True
                            break
                    opened += through
                    closed += not through
                    height = y - other[k] - 1
                    if not through and height < len(gaps):
                        gaps[height] += 1
            for k in range(start, end):
                own[k] = y
    return opened, closed


@kernel()
def is_thin(gaps, opened, closed):
    """Whether a gap, of which `gaps_across` or `gaps_down` tells, is longer than wide and none to see through."""
    if opened > OPEN * (opened + closed):
        return False
    crossed = 0
    for gap in range(len(gaps)):
        crossed += gaps[gap]
        if crossed >= LEAST and crossed >= gap:
            return True
    return False


@kernel()
def join_across(runs, inverse_depth, rays, alpha, deviation, pairs, count, parent):
    """Unite planes whose gaps are thin; ``parent`` (N,) int64 becomes the first that each goes with.

    Parameters
    ----------
    runs : Runs
        Row i of ``alpha`` (N, 3) and ``deviation`` (N,) is label i + 1.
    inverse_depth : (H, W) float32
    rays : Rays
    pairs, count : see `find_coplanar`
    """
    box = np.empty((len(parent) + 1, 4), np.int64)
    label_boxes(runs, box)
    for k in range(count):
        a, b = pairs[k]
        if root_of(parent, a) == root_of(parent, b):
            continue
        reach = BEYOND * deviation[a]  # 1/m: what is farther than the plane by this one sees through the gap
        thin = False
        for side in range(2):
            # No gap counts as thin that is wider than there are rows, or columns.
            widest = min(box[a + 1, 2 * side + 1], box[b + 1, 2 * side + 1]) - max(
                box[a + 1, 2 * side], box[b + 1, 2 * side]
            )
            if thin or widest < LEAST:
                continue
            gaps = np.empty(widest + 1, np.int64)
            for look in (False, True):  # into the gaps only if they are not too wide anyway
                if side == 0:
                    opened, closed = gaps_across(
                        runs, inverse_depth, rays, a + 1, b + 1, alpha[a], reach, box, look, gaps
                    )  # fmt: skip
                else:
                    opened, closed = gaps_down(
                        runs, inverse_depth, rays, a + 1, b + 1, alpha[a], reach, box, look, gaps
                    )  # fmt: skip
                thin = is_thin(gaps, opened, closed)
                if not thin:
                    break
        if thin:
            unite(parent, a, b)
    for a in range(len(parent)):
        parent[a] = parent[parent[a]]


@kernel()
def join_planes(parent, number, moments, alpha, rss, deviation):
    """Make one plane of those that have one parent; returns how many are left.

    ``parent`` (N,) int64 is of `join_across` and overwritten; ``number`` (P,) int32, a part's plane from 1 on or 0,
    becomes that of the joined ones; ``moments`` (N, 10), ``alpha`` (N, 3), ``rss`` and ``deviation`` (N,) keep theirs
    in their first rows.
    """
    count = 0
    for a in range(len(parent)):
        if parent[a] == a:
            copy(moments[a], moments[count])
            deviation[count] = deviation[a]
            parent[a] = count
            count += 1
        else:
            parent[a] = parent[parent[a]]
            for k in range(10):
                moments[parent[a], k] += moments[a, k]
    for i in range(len(number)):
        if number[i] > 0:
            number[i] = parent[number[i] - 1] + 1
    fit_planes(moments[:count], alpha[:count], rss[:count])
    return count
