"""Segmentation: how large the connected parts of the regions are, and which of them are planes."""

import numpy as np

from ..._jit.kernel import kernel
from ...common.arrays import copy
from ..model.moments import add, pixel_ray, residual
from ..model.records import Parts, Reasons, Rules, Runs, as_view


@kernel()
def measure_parts(view, runs, count, region_moments, parts):
    """Measure the parts, and share out what the regions own.

    The largest part of a region gets the region's moments less those of the other parts, whose pixels are added up.

    Parameters
    ----------
    view : View
    runs : Runs
    count : int
        Number of runs.
    region_moments : (N, 10) float64
        Changed.
    parts : Parts, written
    """
    view, runs, parts = as_view(view), Runs(*runs), Parts(*parts)
    inverse_depth, rays = view.inverse_depth, view.rays
    _, row, start, stop, region, starts, starts_down, part = runs
    moments, size, across, down, first, owner = parts
    width = inverse_depth.shape[1]
    moments[:] = 0.0
    size[:] = across[:] = down[:] = 0
    first[:] = -1
    for k in range(count):
        p, y = part[k], row[k]
        owner[p] = region[k]
        size[p] += stop[k] - start[k]  # holes and all
        across[p] += starts[k]
        down[p] += starts_down[k]
        x = start[k]
        while first[p] < 0 and x < stop[k]:
            first[p] = y * width + x if inverse_depth[y, x] > 0.0 else -1
            x += 1
    largest = np.full(len(region_moments), -1, np.int64)
    for p in range(len(size)):
        if largest[owner[p]] < 0 or size[p] > size[largest[owner[p]]]:
            largest[owner[p]] = p
    for k in range(count):
        p, y = part[k], row[k]
        for x in range(start[k], stop[k] if largest[region[k]] != p else 0):
            if inverse_depth[y, x] > 0.0:
                u, v = pixel_ray(rays, y, x)
                add(moments[p], u, v, inverse_depth[y, x])
    for p in range(len(size)):
        if largest[owner[p]] != p:
            for j in range(10):
                region_moments[owner[p], j] -= moments[p, j]
    for p in range(len(size)):
        if largest[owner[p]] == p:
            copy(region_moments[owner[p]], moments[p])
        size[p] = moments[p, 0]


@kernel()
def judge_parts(parts, curved, deviation, rules, least, reasons, why, number, chosen):
    """Decide whether each part is a plane, and if not, why.

    Parameters
    ----------
    parts : Parts
        From `measure_parts`.
    curved, deviation : (N,) bool and float64
        For each region: whether it is curved, and the standard deviation of a pixel about its plane.
    rules : Rules
        A plane's runs have at least ``least_width`` pixels on average, and its residual is at most ``fit_deviations``.
    least : int
        Pixels that a plane must have.
    reasons : Reasons
    why : (P,) uint8, written
    number : (P,) int32, written
        1, 2, ... for planes in the order of their first pixels, 0 for the others.
    chosen : (P,) int64, written
        The parts that are planes, in this order.

    Returns
    -------
    int
        Number of planes.
    """
    moments, size, across, down, first, region = Parts(*parts)
    rules, reasons = Rules(*rules), Reasons(*reasons)
    planes = 0
    for k in range(len(size)):
        why[k] = reasons.plane
        if size[k] < rules.least_width * max(across[k], down[k]):
            why[k] = reasons.narrow
        if curved[region[k]]:
            why[k] = reasons.curved
        if residual(moments[k]) > (rules.fit_deviations * deviation[region[k]]) ** 2 * size[k]:
            why[k] = reasons.rough
        if size[k] < least:
            why[k] = reasons.small
        number[k] = 0
        if why[k] == reasons.plane:
            place = planes  # parts are nearly in the order of their first pixels
            while place > 0 and first[chosen[place - 1]] > first[k]:
                chosen[place] = chosen[place - 1]
                place -= 1
            chosen[place] = k
            planes += 1
    for place in range(planes):
        number[chosen[place]] = place + 1
    return planes
