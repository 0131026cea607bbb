"""Segmentation: parts of one plane that something thin in front separates become one plane again.

A lamp's pole cuts the wall behind it in two. The two halves are one plane if their moments agree that they are
and nothing between them is farther away than the plane: anything farther would be seen through a gap in the wall
itself.
"""

import numpy as np

from ..._jit.kernel import kernel
from ...common.arrays import copy
from ...common.union_find import root_of, unite
from ..model.boxes import overlap
from ..model.moments import difference, pixel_ray, rise
from ..model.planes import fit_planes
from ..model.records import BLOCK, Found, Runs, as_view
from .labels import label_runs
from .runs import TOP, WHOLE

LEAST = 4  # rows or columns that must cross a gap
BEYOND = 4.0  # deviations by which something is farther than the plane
FARTHEST = np.iinfo(np.int64).max  # a row or column after all others
NO_RUN = np.int32(-1)  # label where there is no run
# For any four bits, the first that is set, and the one after the last.
FIRST = (0, 0, 1, 0, 2, 0, 1, 0, 3, 0, 1, 0, 2, 0, 1, 0)
STOP = (0, 1, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4)
SEE_THROUGH_SHARE = 0.1  # share of the rows or columns that may be open


@kernel(inline="compiled")
def may_be_thin(box, a, b, down):
    """Whether a gap between labels a and b may be longer than wide, along the rows or, if ``down`` is 1, columns.

    A gap wider than the number of rows, or columns, that cross it is not thin; none is narrower than the distance of
    the boxes.
    """
    widest, narrowest = BLOCK * overlap(box, a, b, down), -BLOCK * (overlap(box, a, b, 1 - down) + 1)
    return widest >= LEAST and narrowest <= widest


@kernel(inline="compiled")
def are_coplanar(moments, deviation, a, b, floor, spread):
    """Whether planes a and b are one plane; the arguments are those of `find_coplanar`."""
    smaller = min(moments[a, 0], moments[b, 0])
    variance = min(deviation[a], deviation[b]) ** 2
    return rise(moments, a, b) <= variance * (floor * floor * smaller + spread)


@kernel()
def find_coplanar(moments, alpha, deviation, box, floor, spread, pairs):
    """Pairs of planes whose union is also one plane, and that are near enough for a thin gap.

    Parameters
    ----------
    moments, alpha, deviation : (N, 10), (N, 3), (N,) float64
        Moments and plane of each, and standard deviation of a pixel about it.
    box : (N + 1, 4) int64
        See `label_boxes`.
    floor, spread : float
        Joining two may raise the sum of squared residuals by floor² n + spread variances, n being the smaller one's
        pixels.
    pairs : (K, 2) int64, written
        The first K of them, nearest labels first.

    Returns
    -------
    int
        Number of pairs.
    """
    count = 0
    for a in range(len(moments)):
        for b in range(a - 1, -1, -1):
            if not (may_be_thin(box, a + 1, b + 1, 0) or may_be_thin(box, a + 1, b + 1, 1)):
                continue
            m, k = moments[a], moments[b]
            variance = min(deviation[a], deviation[b]) ** 2
            smaller = m if m[0] < k[0] else k
            allowed = floor * floor + spread / smaller[0]
            u, v = smaller[1] / smaller[0], smaller[2] / smaller[0]
            d_u, d_v, d_1 = difference(alpha, a, b)
            d = d_u * u + d_v * v + d_1
            # The smaller one's pixels make nearly all of the rise: a quick rejection.
            if not d * d <= 4.0 * allowed * variance:
                continue
            if are_coplanar(moments, deviation, a, b, floor, spread):
                if count < len(pairs):
                    pairs[count, 0], pairs[count, 1] = b, a
                count += 1
    return count


@kernel()
def label_boxes(runs, box):
    """First row, row after the last, first column, column after the last of each label's blocks.

    ``box`` (N + 1, 4) int64 is written, row a for label a.
    """
    row_runs, run_start, run_stop, run_label = runs.first, runs.start, runs.stop, runs.label
    box[:, 0] = box[:, 2] = FARTHEST
    box[:, 1] = box[:, 3] = 0
    for row in range(len(row_runs) - 1):
        for i in range(row_runs[row], row_runs[row + 1]):
            b = box[run_label[i]]
            b[0], b[1] = min(b[0], row), row + 1
            b[2], b[3] = min(b[2], run_start[i]), max(b[3], run_stop[i])


@kernel(inline="compiled")
def columns_in_row(k, y, runs, width):
    """First column of a run's pixels in row ``y``, and the one after the last: equal if it has none there."""
    if runs.share[k] == WHOLE:
        return runs.start[k] * BLOCK, min(runs.stop[k] * BLOCK, width)
    four = (runs.pixels[k] >> np.int32(y % BLOCK * BLOCK)) & TOP
    return runs.start[k] * BLOCK + FIRST[four], runs.start[k] * BLOCK + STOP[four]


@kernel(inline="compiled")
def rows_in_column(k, row, x, runs, height):
    """First row of a run's pixels in column ``x``, and the one after the last; the run is in row ``row`` of blocks."""
    if runs.share[k] == WHOLE:
        return row * BLOCK, min(row * BLOCK + BLOCK, height)
    column = runs.pixels[k] >> np.int32(x % BLOCK)
    four = np.int32(0)
    for y in range(BLOCK):
        four |= ((column >> np.int32(y * BLOCK)) & np.int32(1)) << np.int32(y)
    return row * BLOCK + FIRST[four], row * BLOCK + STOP[four]


@kernel(inline="compiled")
def sees_through(inverse_depth, rays, alpha, reach, y, x):
    """Whether something farther away than a plane is seen at a pixel."""
    u, v = pixel_ray(rays, y, x)
    return 0.0 < inverse_depth[y, x] < alpha[0] * u + alpha[1] * v + alpha[2] - reach


@kernel()
def gaps_across(runs, inverse_depth, rays, a, b, alpha, reach, box, look, gaps):
    """Gaps between labels a and b along the rows.

    ``gaps`` (G,) int64 is written: the number of closed gaps, which cannot be seen through, of 0, 1, 2, ... pixels.
    Returns the numbers of open and of closed gaps. Without ``look`` all are taken to be closed.
    """
    height, width = inverse_depth.shape
    closed = opened = 0
    gaps[:] = 0
    most = 0
    for row in range(len(runs.first) - 1):
        most = max(most, runs.first[row + 1] - runs.first[row])
    mine = np.empty(most + 1, np.int32)  # the runs of a and b in a row of blocks
    for row in range(max(box[a, 0], box[b, 0]), min(box[a, 1], box[b, 1])):
        count = 0
        for i in range(runs.first[row], runs.first[row + 1]):
            mine[count] = i
            count += (runs.label[i] == a) | (runs.label[i] == b)
        for y in range(row * BLOCK, min(row * BLOCK + BLOCK, height)):
            last, end = NO_RUN, 0  # the label of the last run, and where it ends
            for k in range(count):
                i = mine[k]
                start, stop = columns_in_row(i, y, runs, width)
                if start == stop:
                    continue
                if last != NO_RUN and last != runs.label[i]:
                    through = False
                    for x in range(end, start if look else 0):
                        if sees_through(inverse_depth, rays, alpha, reach, y, x):
                            through = True
                            break
                    opened += through
                    closed += not through
                    gap = max(start - end, 0)
                    if not through and gap < len(gaps):
                        gaps[gap] += 1
                last, end = runs.label[i], stop
    return opened, closed


@kernel()
def gaps_down(runs, inverse_depth, rays, a, b, alpha, reach, box, look, gaps):
    """Gaps between labels a and b along the columns, as `gaps_across` along the rows."""
    height, width = inverse_depth.shape
    closed = opened = 0
    gaps[:] = 0
    first, stop = max(box[a, 2], box[b, 2]), min(box[a, 3], box[b, 3])
    # The row of pixels up to which each column has a, and after them those up to which it has b.
    columns = (stop - first) * BLOCK
    last = np.full(2 * columns, -1, np.int64)
    for row in range(min(box[a, 0], box[b, 0]), max(box[a, 1], box[b, 1])):
        for i in range(runs.first[row], runs.first[row + 1]):
            if runs.label[i] != a and runs.label[i] != b:
                continue
            mine, other = (0, columns) if runs.label[i] == a else (columns, 0)
            for x in range(max(runs.start[i], first) * BLOCK, min(min(runs.stop[i], stop) * BLOCK, width)):
                upper, lower = rows_in_column(i, row, x, runs, height)
                if upper == lower:
                    continue
                k = x - first * BLOCK
                here, there = mine + k, other + k
                if last[there] > last[here]:
                    through = False
                    for y in range(last[there], upper if look else 0):
                        if sees_through(inverse_depth, rays, alpha, reach, y, x):
                            through = True
                            break
                    opened += through
                    closed += not through
                    gap = max(upper - last[there], 0)
                    if not through and gap < len(gaps):
                        gaps[gap] += 1
                last[here] = lower
    return opened, closed


@kernel()
def is_thin(gaps, opened, closed):
    """Whether a gap, as `gaps_across` or `gaps_down` gives it, is longer than wide and cannot be seen through."""
    if opened > SEE_THROUGH_SHARE * (opened + closed):
        return False
    crossed = 0
    for gap in range(len(gaps)):
        crossed += gaps[gap]
        if crossed >= LEAST and crossed >= gap:
            return True
    return False


@kernel()
def join_across(runs, inverse_depth, rays, moments, alpha, deviation, box, floor, spread, pairs, count, parent):
    """Unite planes whose gaps are thin; ``parent`` (N,) int64 becomes the first plane that each is united with.

    What they have been united with must be one plane, too: a strip along an edge may agree with both sides of it.

    Parameters
    ----------
    runs : Runs
        Row i of ``moments`` (N, 10), ``alpha`` (N, 3) and ``deviation`` (N,) is label i + 1.
    inverse_depth : (H, W) float32
    rays : Rays
    moments : (N, 10) float64, changed
        Those of each first plane become those of all that are united with it.
    box, floor, spread, pairs, count : see `find_coplanar`
    """
    for k in range(count):
        a, b = pairs[k]
        first, other = root_of(parent, a), root_of(parent, b)
        if first == other or not are_coplanar(moments, deviation, first, other, floor, spread):
            continue
        reach = BEYOND * deviation[a]  # 1/m: what is farther than the plane by this is seen through the gap
        thin = False
        for down in range(2):
            if thin or not may_be_thin(box, a + 1, b + 1, down):
                continue
            widest = BLOCK * overlap(box, a + 1, b + 1, down)
            gaps = np.empty(widest + 1, np.int64)
            for look in (False, True):  # into the gaps only if they are not too wide anyway
                if not down:
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
            first, other = min(first, other), max(first, other)
            for j in range(10):
                moments[first, j] += moments[other, j]
    for a in range(len(parent)):
        parent[a] = parent[parent[a]]


@kernel()
def join_planes(parent, number, moments, deviation):
    """Make one plane of those that have the same parent; returns how many planes are left.

    ``parent`` (N,) int64 comes from `join_across` and is overwritten; ``number`` (P,) int32, a part's plane from 1 on
    or 0, becomes that of the joined planes, and so do the first rows of ``moments`` (N, 10) and ``deviation`` (N,).
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
    for i in range(len(number)):
        if number[i] > 0:
            number[i] = parent[number[i] - 1] + 1
    return count


@kernel()
def join_across_gaps(view, runs, found):
    """Make one of the planes that something thin in front separates; returns how many planes are left.

    Joining two may raise the sum of squared residuals by floor² n + spread variances, n being the smaller one's
    pixels, floor being half of ``bend_deviations``.

    Parameters
    ----------
    view : View
    runs : Runs
        They get the new labels.
    found : Found
        Parts get the new labels; planes that are left come first.
    """
    view, runs, found = as_view(view), Runs(*runs), Found(*found)
    inverse_depth, rays, _, _, rules, _ = view
    floor, spread = 0.5 * rules.tolerance * rules.bend_deviations, rules.joint_variances
    number, moments, deviation = found.number, found.moments, found.deviation
    planes = len(moments)
    alpha, rss = np.empty((planes, 3)), np.empty(planes)
    fit_planes(moments, alpha, rss)
    box = np.empty((planes + 1, 4), np.int64)
    label_boxes(runs, box)
    count = 4 * planes
    pairs = np.empty((0, 2), np.int64)
    while len(pairs) < count:  # again where there are many: a wall behind bars
        pairs = np.empty((count, 2), np.int64)
        count = find_coplanar(moments, alpha, deviation, box, floor, spread, pairs)
    if count == 0:
        return planes
    parent = np.arange(planes)
    join_across(runs, inverse_depth, rays, moments, alpha, deviation, box, floor, spread, pairs, count, parent)
    left = join_planes(parent, number, moments, deviation)
    if left < planes:
        label_runs(runs, number)
    return left
