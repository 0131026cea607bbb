"""Segmentation: how large the connected parts of the regions are, and which of them are planes."""

import numpy as np

from ._jit import kernel
from .copying import copy
from .disjoint_sets import root_of
from .segment_moments import add, ray_of
from .segment_runs import GAP


@kernel()
def measure_parts(runs, inverse_depth, rays, alpha, deviation, cut, sums, parts):
    """Number the parts in the order of their first pixels, and share out what the regions own.

    The largest part of a region gets its moments less those of the other parts, whose pixels are counted.

    Parameters
    ----------
    runs : Runs
        ``part`` is written.
    inverse_depth : (H, W) float32
    rays : Rays
    alpha, deviation : (N, 3), (N,) float64
        Of the regions: see `segment_planes.deviations`.
    cut : float
        See `segment_pixels.own_pixels`.
    sums : Sums
        Of the regions; changed.
    parts : Parts, written

    Returns
    -------
    int
        Number of parts.
    """
    row_runs, run_start, run_stop, run_label, vertical, parent, part = runs
    region_moments, region_squares = sums
    moments, squares, size, across, down, owner = parts
    count = 0
    for y in range(len(row_runs) - 1):
        for i in range(row_runs[y], row_runs[y + 1]):
            root = root_of(parent, i)
            if root == i:
                part[i] = count
                size[count] = 0.0
                across[count] = 0
                down[count] = 0
                squares[count] = 0.0
                moments[count, :] = 0.0
                owner[count] = run_label[i]
                count += 1
            else:
                part[i] = part[root]
            k = part[i]
            size[k] += run_stop[i] - run_start[i]  # holes and all, until the moments say
            down[k] += vertical[i]
            # A run that goes on after a short gap is one run.
            goes_on = (
                i > row_runs[y] and run_label[i - 1] == run_label[i] and run_start[i] - run_stop[i - 1] <= GAP
            )
            across[k] += 0 if goes_on else 1
    largest = np.full(len(region_moments), -1, np.int64)
    for k in range(count):
        a = owner[k]
        if largest[a] < 0 or size[k] > size[largest[a]]:
            largest[a] = k
    for y in range(len(row_runs) - 1):
        for i in range(row_runs[y], row_runs[y + 1]):
            k = part[i]
            a = owner[k]
            if largest[a] == k:
                continue
            for x in range(run_start[i], run_stop[i]):
                q = inverse_depth[y, x]
                if q == 0.0:
                    continue
                u, v = ray_of(rays, y, x)
                e = (q - (alpha[a, 0] * u + alpha[a, 1] * v + alpha[a, 2])) / deviation[a]
                squares[k] += min(e * e, cut * cut)
                add(moments[k], u, v, q)
    for k in range(count):
        a = owner[k]
        if largest[a] != k:
            region_squares[a] -= squares[k]
            for j in range(10):
                region_moments[a, j] -= moments[k, j]
    for k in range(count):
        a = owner[k]
        if largest[a] == k:
            squares[k] = region_squares[a]
            copy(region_moments[a], moments[k])
        size[k] = moments[k, 0]
    return count


@kernel()
def judge_parts(parts, count, curved, rules, least, reasons, why, stray, number, kept):
    """Say of each part whether it is a plane, and why not.

    Parameters
    ----------
    parts, count
        Of `measure_parts`.
    curved : (N,) bool
        Of each region.
    rules : Rules
        A plane's runs have ``narrow`` pixels on average, and its pixels lie within ``rough`` deviations.
    least : int
        Pixels that a plane has.
    reasons : tuple of uint8
        For a plane, and for what is small, rough, curved or narrow.
    why : (P,) uint8, written
    stray : (P,) bool, written
        Whether a part is so small or narrow that its pixels may be specks in another.
    number : (P,) int32, written
        1, 2, ... for planes, 0 for the others.
    kept : (P,) int64, written
        The parts that are planes.

    Returns
    -------
    int
        How many planes there are.
    """
    plane, small, uneven, bent, thin = reasons
    _, squares, size, across, down, region = parts
    planes = 0
    for k in range(count):
        why[k] = plane
        if size[k] < rules.narrow * max(across[k], down[k]):
            why[k] = thin
        if curved[region[k]]:
            why[k] = bent
        if squares[k] > rules.rough * rules.rough * size[k]:
            why[k] = uneven
        if size[k] < least:
            why[k] = small
        stray[k] = why[k] == small or why[k] == thin
        number[k] = 0
        if why[k] == plane:
            kept[planes] = k
            planes += 1
            number[k] = planes
    return planes
