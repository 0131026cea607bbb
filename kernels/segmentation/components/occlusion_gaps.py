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
from ..model.records import Runs, as_view

LEAST = 4  # rows or columns that must cross a gap
BEYOND = 4.0  # deviations by which something is farther than the plane
FARTHEST = np.iinfo(np.int32).max  # a row or column after all others
SEE_THROUGH_SHARE = 0.1  # share of the rows or columns that may be open


@kernel(inline="compiled")
def may_be_thin(box, a, b, down):
    """Whether a gap between planes a and b may be longer than wide, along the rows or, if ``down`` is 1, columns.

    A gap wider than the number of rows, or columns, that cross it is not thin; none is narrower than the distance of
    the boxes.
    """
    widest, narrowest = overlap(box, a, b, down), -overlap(box, a, b, 1 - down)
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
    box : (N, 4) int64
        First row, row after the last, first column, column after the last of each one's pixels.
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
            if not (may_be_thin(box, a, b, 0) or may_be_thin(box, a, b, 1)):
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
def link_runs(runs, count, number, head, following, box):
    """Link the runs of each plane, and find its box.

    Parameters
    ----------
    runs : Runs
    count : int
        Their number.
    number : (P,) int32
        Plane of each part, from 1 on, or 0.
    head : (N,) int32, written
        First run of each plane.
    following : (count,) int32, written
        The plane's run after each, or the number of runs.
    box : (N, 4) int64, written
        First row, row after the last, first column, column after the last of each one's pixels.
    """
    head[:] = count
    for a in range(len(box)):
        box[a, 0], box[a, 1], box[a, 2], box[a, 3] = FARTHEST, 0, FARTHEST, 0
    for k in range(count - 1, -1, -1):
        a = number[runs.part[k]] - 1
        if a >= 0:
            following[k], head[a] = head[a], k
            b, y = box[a], runs.row[k]
            b[0], b[1] = min(b[0], y), max(b[1], y + 1)
            b[2], b[3] = min(b[2], runs.start[k]), max(b[3], runs.stop[k])


@kernel(inline="compiled")
def sees_through(inverse_depth, rays, alpha, reach, y, x, down, gap):
    """Whether something farther than a plane is seen in the ``gap`` pixels before one, along a row or a column."""
    for step in range(1, gap + 1):
        r, c = y - step * down, x - step * (1 - down)
        u, v = pixel_ray(rays, r, c)
        if 0.0 < inverse_depth[r, c] < alpha[0] * u + alpha[1] * v + alpha[2] - reach:
            return True
    return False


@kernel()
def is_thin(runs, following, first, other, inverse_depth, rays, alpha, reach, down, widest, look):
    """Whether what lies between two planes is longer than wide, and cannot be seen through.

    Parameters
    ----------
    runs, following
        From `link_runs`.
    first, other : int
        First run of either plane.
    inverse_depth : (H, W) float32
    rays : Rays
    alpha, reach : (3,) float64 and float
        The plane, and by how much more than the noise something is farther, 1/m.
    down : int
        0 along rows, 1 along columns.
    widest : int
        Pixels of the widest gap that counts.
    look : bool
        Whether to look through the gaps. A no without looking is final: most gaps are too wide in any case.
    """
    height, width = inverse_depth.shape
    gaps = np.zeros(widest + 2, np.int64)  # closed ones of 0, 1, 2, ... pixels
    opened = closed = 0
    # Where each row, or column, has been left by either plane.
    left = np.full((2, width if down == 1 else height), np.int32(-1))
    while min(first, other) < len(following):
        mine = 0 if first < other else 1
        k = min(first, other)
        first, other = (following[k], other) if mine == 0 else (first, following[k])
        y, start, stop = runs.row[k], runs.start[k], runs.stop[k]
        # Along rows the one row of the run, and along columns its columns; where it begins and ends there.
        line, after, begin, end = (start, stop, y, y + 1) if down == 1 else (y, y + 1, start, stop)
        own, others = left[mine], left[1 - mine]
        crosses = False
        for i in range(line, after):
            crosses |= others[i] > own[i]
        for i in range(line, after if crosses else line):
            if others[i] > own[i]:
                gap = max(begin - others[i], 0)
                x = i if down == 1 else begin
                through = look and sees_through(inverse_depth, rays, alpha, reach, y, x, down, gap)
                opened += through
                closed += not through
                gaps[min(gap, widest + 1)] += not through
        for i in range(line, after):
            own[i] = end
    if opened > SEE_THROUGH_SHARE * (opened + closed):
        return False
    crossed = 0
    for gap in range(widest + 1):
        crossed += gaps[gap]
        if crossed >= LEAST and crossed >= gap:
            return True
    return False


@kernel()
def join_planes(parent, number, moments, deviation):
    """Make one plane of those that have the same parent; returns how many planes are left.

    ``parent`` (N,) int64, the first plane that each is united with, is overwritten; ``number`` (P,) int32, a part's
    plane from 1 on or 0, becomes that of the joined planes, and so do the first rows of ``moments`` (N, 10) and
    ``deviation`` (N,).
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
def join_across_gaps(view, runs, count, number, moments, deviation):
    """Make one of the planes that something thin in front separates; returns how many planes are left.

    Joining two may raise the sum of squared residuals by floor² n + spread variances, n being the smaller one's
    pixels, floor being half of ``bend_deviations``. What they have been united with must be one plane, too: a strip
    along an edge may agree with both sides of it.

    Parameters
    ----------
    view : View
    runs : Runs
    count : int
        Their number.
    number, moments, deviation
        Plane of each part, from 1 on, or 0; moments of the planes, and deviations of their pixels; changed.
    """
    view, runs = as_view(view), Runs(*runs)
    inverse_depth, rays, rules = view.inverse_depth, view.rays, view.rules
    floor, spread = 0.5 * rules.tolerance * rules.bend_deviations, rules.joint_variances
    planes = len(moments)
    alpha, rss = np.empty((planes, 3)), np.empty(planes)
    fit_planes(moments, alpha, rss)
    box, head, following = np.empty((planes, 4), np.int64), np.empty(planes, np.int32), np.empty(count, np.int32)
    link_runs(runs, count, number, head, following, box)
    found = 4 * planes
    pairs = np.empty((0, 2), np.int64)
    while len(pairs) < found:  # again where there are many: a wall behind bars
        pairs = np.empty((found, 2), np.int64)
        found = find_coplanar(moments, alpha, deviation, box, floor, spread, pairs)
    parent = np.arange(planes)
    for k in range(found):
        a, b = pairs[k]
        one, other = root_of(parent, a), root_of(parent, b)
        if one == other or not are_coplanar(moments, deviation, one, other, floor, spread):
            continue
        reach = BEYOND * deviation[a]
        thin = False
        for down in range(2):
            if not thin and may_be_thin(box, a, b, down):
                widest = overlap(box, a, b, down)
                thin = True
                for look in (False, True):
                    thin = thin and is_thin(
                        runs, following, head[a], head[b], inverse_depth, rays, alpha[a], reach, down, widest, look
                    )
        if thin:
            unite(parent, a, b)
            one, other = min(one, other), max(one, other)
            for j in range(10):
                moments[one, j] += moments[other, j]
    for a in range(planes):
        parent[a] = root_of(parent, a)
    return join_planes(parent, number, moments, deviation)
