"""Segmentation: how large the connected parts of the regions are, and which of them are planes."""

import numpy as np

from ..._jit.kernel import kernel
from ...common.arrays import copy
from ...common.bit_marks import how_many, lowest_bit
from ...common.union_find import root_of
from ..model.moments import add, pixel_ray, residual
from ..model.records import BLOCK, Found, Parts, Reasons, Runs, as_regions, as_view
from .labels import label_runs
from .runs import WHOLE, find_runs


@kernel()
def add_piece(pixels, row, column, inverse_depth, rays, moments, k):
    """Add pixels of a block to row ``k`` of moments."""
    while pixels != 0:
        p = lowest_bit(pixels)
        pixels &= pixels - np.int32(1)
        y, x = row * BLOCK + p // BLOCK, column * BLOCK + p % BLOCK
        u, v = pixel_ray(rays, y, x)
        add(moments[k], u, v, inverse_depth[y, x])


@kernel(inline="compiled")
def first_of_run(start, stop, row, inverse_depth):
    """Row and column of the first measured pixel of whole blocks, which may have holes."""
    height, width = inverse_depth.shape
    for y in range(row * BLOCK, min(row * BLOCK + BLOCK, height)):
        for x in range(start * BLOCK, min(stop * BLOCK, width)):
            if inverse_depth[y, x] > 0.0:
                return y, x
    return row * BLOCK, start * BLOCK


@kernel()
def measure_parts(runs, owners, shares, pyramid, inverse_depth, rays, region_moments, parts):
    """Number the parts and share out what the regions own.

    The largest part of a region gets the region's moments less those of the other parts, whose blocks are added up.

    Parameters
    ----------
    runs : Runs
        ``part`` is written.
    owners : Owners
    shares : Shares
    pyramid : Pyramid
    inverse_depth : (H, W) float32
    rays : Rays
    region_moments : (N, 10) float64
        Changed.
    parts : Parts, written

    Returns
    -------
    int
        Number of parts.
    """
    row_runs, run_start, run_stop, run_share = runs.first, runs.start, runs.stop, runs.share
    run_pixels, run_label, run_across, run_down = runs.pixels, runs.label, runs.across, runs.down
    parent, part = runs.parent, runs.part
    moments, size, across, down, first, owner = parts
    width = inverse_depth.shape[1]
    count = 0
    for row in range(len(row_runs) - 1):
        for i in range(row_runs[row], row_runs[row + 1]):
            root = root_of(parent, i)
            y, x = row * BLOCK, run_start[i] * BLOCK
            pixels = np.int64(BLOCK * BLOCK * (run_stop[i] - run_start[i]))  # holes and all
            if run_share[i] != WHOLE:
                mask = run_pixels[i]
                pixels = how_many(mask)
                p = lowest_bit(mask)
                y, x = y + p // BLOCK, x + p % BLOCK
            elif root == i or y * width + x < first[part[root]]:
                y, x = first_of_run(run_start[i], run_stop[i], row, inverse_depth)
            if root == i:
                part[i] = count
                size[count] = 0.0
                across[count] = down[count] = 0
                moments[count, :] = 0.0
                owner[count] = run_label[i]
                first[count] = y * width + x
                count += 1
            else:
                part[i] = part[root]
            k = part[i]
            first[k] = min(first[k], y * width + x)
            size[k] += pixels
            across[k] += run_across[i]
            down[k] += run_down[i]
    largest = np.full(len(region_moments), -1, np.int64)
    for k in range(count):
        a = owner[k]
        if largest[a] < 0 or size[k] > size[largest[a]]:
            largest[a] = k
    columns, block_moments = owners.block.shape[1], pyramid.moments
    share_pixels, share_moments = shares.pixels, shares.moments
    for row in range(len(row_runs) - 1):
        for i in range(row_runs[row], row_runs[row + 1]):
            k = part[i]
            if largest[owner[k]] == k:
                continue
            s = run_share[i]
            if s == WHOLE:
                for c in range(run_start[i], run_stop[i]):
                    for j in range(10):
                        moments[k, j] += block_moments[j, row * columns + c]
            elif run_pixels[i] == share_pixels[s]:
                for j in range(10):
                    moments[k, j] += share_moments[s, j]
            else:
                add_piece(run_pixels[i], row, run_start[i], inverse_depth, rays, moments, k)
    for k in range(count):
        a = owner[k]
        if largest[a] != k:
            for j in range(10):
                region_moments[a, j] -= moments[k, j]
    for k in range(count):
        a = owner[k]
        if largest[a] == k:
            copy(region_moments[a], moments[k])
        size[k] = moments[k, 0]
    return count


@kernel()
def judge_parts(parts, count, curved, deviation, rules, least, reasons, why, stray, number, chosen):
    """Decide whether each part is a plane, and if not, why.

    Parameters
    ----------
    parts, count
        From `measure_parts`.
    curved, deviation : (N,) bool and float64
        For each region: see `rounds.find_regions`.
    rules : Rules
        A plane's runs have at least ``least_width`` pixels on average, and its residual is at most ``fit_deviations``.
    least : int
        Pixels that a plane must have.
    reasons : Reasons
    why : (P,) uint8, written
    stray : (P,) bool, written
        Whether a part is so small or narrow that its pixels may be specks in another.
    number : (P,) int32, written
        1, 2, ... for planes in the order of their first pixels, 0 for the others.
    kept : (P,) int64, written
        The parts that are planes, in this order.

    Returns
    -------
    int
        Number of planes.
    """
    moments, size, across, down, first, region = parts
    planes = 0
    for k in range(count):
        why[k] = reasons.plane
        if size[k] < rules.least_width * max(across[k], down[k]):
            why[k] = reasons.narrow
        if curved[region[k]]:
            why[k] = reasons.curved
        if residual(moments[k]) > (rules.fit_deviations * deviation[region[k]]) ** 2 * size[k]:
            why[k] = reasons.rough
        if size[k] < least:
            why[k] = reasons.small
        stray[k] = why[k] == reasons.small or why[k] == reasons.narrow
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


@kernel()
def find_parts(view, regions, curved, deviation, least, reasons, runs, found):
    """Split the regions into connected parts, and find those that are planes.

    Parameters
    ----------
    view : View
    regions : Regions
        ``moments`` are changed.
    curved, deviation : (N,) bool and float64
        Of each region: see `curved.find_curved`.
    least, reasons
        See `judge_parts`.
    runs : Runs, written
        With their labels.
    found : Found, written
        With room for as many parts and planes as there is for runs.

    Returns
    -------
    tuple of int
        Numbers of planes, of parts and of loose pixels.
    """
    view, regions = as_view(view), as_regions(regions)
    reasons, runs, found = Reasons(*reasons), Runs(*runs), Found(*found)
    inverse_depth, rays, pyramid, _, rules, _ = view
    _, region_moments, region_number, owners, shares = regions
    loose = found.loose
    height, width = inverse_depth.shape
    run_count, loose_count = find_runs(owners, shares, region_number, height, width, runs, loose)
    parts = Parts(
        np.empty((run_count, 10)), np.empty(run_count), np.empty(run_count, np.int64),
        np.empty(run_count, np.int64), np.empty(run_count, np.int64), np.empty(run_count, np.int64),
    )  # fmt: skip
    count = measure_parts(runs, owners, shares, pyramid, inverse_depth, rays, region_moments[: len(curved)], parts)
    chosen = np.empty(count, np.int64)
    planes = judge_parts(
        parts, count, curved, deviation, rules, least, reasons, found.why, found.stray, found.number, chosen
    )
    label_runs(runs, found.number)
    for i in range(planes):
        copy(parts.moments[chosen[i]], found.moments[i])
        found.deviation[i] = deviation[parts.region[chosen[i]]]
    return planes, count, loose_count
