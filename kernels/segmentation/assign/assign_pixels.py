"""Segmentation, alternating with the merging: every pixel goes to the plane it fits."""

import math

import numpy as np

from ..._jit.kernel import kernel
from ...common.arrays import copy
from ..model.moments import misfit
from ..model.pixel_noise import grown_variance
from ..model.records import BLOCK, MIXED, Contended, Planes, Shares, as_regions, as_view, place
from .contested_blocks import (
    AREA,
    LANES,
    NEIGHBOURS,
    NOWHERE,
    PAIRS,
    ROOM,
    contenders,
    gather,
    is_undisputed,
    line_between,
    ray_steps,
    share_out,
    weigh_contenders,
)
from .whole_blocks import SPARSE, add_up, give_whole


@kernel()
def assign_pixels(view, regions, planes, before, contended, new):
    """Give each pixel to a region, or to none, and sum the moments of what each region owns.

    Parameters
    ----------
    view : View
        A region contends for a pixel within ``reach_deviations`` of its plane. Two planes meet where both fit a
        pixel's neighbourhood within ``fit_deviations``. A block without rivals goes whole to a region that fits it so.
    regions : Regions
        ``block`` becomes the region that owns most of its pixels; ``owners`` and ``moments`` are written.
    planes : Planes
        Of the regions.
    before : (R, C) int32, written
        ``regions.block`` before this round.
    contended : Contended
        Room for as many blocks as there are, and NEIGHBOURS regions for each.
    new : Shares, written
        Those of this round, with room for as many.

    Returns
    -------
    int
        Their number.
    """
    view, regions = as_view(view), as_regions(regions)
    planes, contended, new = Planes(*planes), Contended(*contended), Shares(*new)
    inverse_depth, rays, pyramid, _, rules, sensor = view
    region, region_moments, _, owners, _ = regions
    for row in range(len(region)):
        copy(region[row], before[row])
    give_whole(pyramid, sensor, region, planes, rules.fit_deviations, owners.block)
    sparse = np.empty(region.size, np.int32)
    sparse_count, count = decide(rays, before, pyramid, sensor, planes, rules, region, owners, contended, sparse)
    put = share_sparse(sparse[:sparse_count], inverse_depth, pyramid, region, owners, new)
    put = contest(
        contended, count, inverse_depth, rays, before, pyramid, sensor, planes, rules, region, owners, new, put
    )  # fmt: skip
    add_up(pyramid, owners.block, new, put, region_moments)
    return put


@kernel()
def decide(rays, before, pyramid, sensor, planes, rules, region, owners, contended, sparse):
    """Give MIXED blocks whole to a region without rivals, if they fit it; list the others.

    Parameters
    ----------
    rays, before, pyramid, sensor, planes, rules, region, owners
        As in `assign_pixels`.
    contended : Contended, written
    sparse : (R·C,) int32, written
        The first are those that went whole to a region with few measured pixels.

    Returns
    -------
    tuple of int
        Numbers of these sparse blocks, and of contended ones.
    """
    rows, columns = region.shape
    # With a rim of no regions.
    around = np.full((rows + 2, columns + 2), np.int32(-1))
    for row in range(rows):
        copy(before[row], around[row + 1, 1 : columns + 1])
    # Names for fields of tuples: see `kernels`.
    tan_x, tan_y, centre_u, centre_v = rays.tan_x, rays.tan_y, rays.centre_u, rays.centre_v
    block_moments, alpha, slope_variance = pyramid.moments, planes.alpha, planes.slope_variance
    waviness_square, stretch = planes.waviness_square, planes.square_stretch
    owner = owners.block
    block, many, first, all_candidates, all_centres = contended
    settled_square, reach = rules.fit_deviations * rules.fit_deviations, rules.reach_deviations
    # Of fixed sizes: see `kernels`.
    candidate, centre = np.empty(NEIGHBOURS, np.int64), np.empty((NEIGHBOURS, 3))
    sparse_count = count = listed = 0
    for here in range(rows * columns):
        row, column = place(here, columns)
        if owner[row, column] != MIXED:
            continue
        pixels = block_moments[0, here]
        contending = contenders(around, row, column, centre_u, centre_v, candidate, centre)
        a = candidate[0] if contending == 1 else np.int64(before[row, column])
        fits = False
        if a >= 0:
            total = grown_variance(sensor[here], slope_variance[a], stretch[here], waviness_square[a])
            fits = misfit(block_moments, here, alpha, a) <= settled_square * pixels * total
            if fits and contending > 1:
                distance = reach * math.sqrt(total)
                fits = is_undisputed(a, contending, candidate, centre, alpha, tan_x, tan_y, row, column, distance)
        if fits:
            owner[row, column] = region[row, column] = a
            sparse[sparse_count] = here
            sparse_count += pixels <= SPARSE
            continue
        block[count], many[count], first[count] = here, contending, listed
        for i in range(contending):
            all_candidates[listed] = candidate[i]
            for j in range(3):
                all_centres[listed, j] = centre[i, j]
            listed += 1
        count += 1
    return sparse_count, count


@kernel(arrays=False)
def share_sparse(blocks, inverse_depth, pyramid, region, owners, shares):
    """Turn mostly missing whole blocks into shares of their measured pixels; returns how many there are."""
    height, width = inverse_depth.shape
    columns = region.shape[1]
    block_moments = pyramid.moments
    owner, first, shares_of, measured = owners
    share_region, share_pixels, share_moments = shares
    put = 0
    for here in blocks:
        row, column = place(here, columns)
        mask = np.int32(0)
        for y in range(row * BLOCK, min(row * BLOCK + BLOCK, height)):
            for x in range(column * BLOCK, min(column * BLOCK + BLOCK, width)):
                mask |= np.int32(inverse_depth[y, x] > 0.0) << np.int32(y % BLOCK * BLOCK + x % BLOCK)
        share_region[put], share_pixels[put] = region[row, column], mask
        for k in range(10):
            share_moments[put, k] = block_moments[k, here]
        owner[row, column], measured[row, column] = MIXED, mask
        first[row, column], shares_of[row, column] = put, 1
        put += 1
    return put


@kernel()
def contest(contended, count, inverse_depth, rays, before, pyramid, sensor, planes, rules, region, owners, shares, put):
    """Give each pixel of the first ``count`` contended blocks to one of the contenders, or to none.

    The shares follow the first ``put``; returns how many there are then. The rest is as in `assign_pixels`.
    """
    columns = region.shape[1]
    # Names for fields of tuples: see `kernels`.
    tan_x, tan_y = rays.tan_x, rays.tan_y
    block_moments, alpha, slope_variance = pyramid.moments, planes.alpha, planes.slope_variance
    waviness_square, stretch = planes.waviness_square, planes.square_stretch
    first_share, shares_of, measured = owners.first, owners.count, owners.measured
    share_region, share_pixels, share_moments = shares
    block, many, first, candidate, centre = contended
    limit, close = np.float32(rules.reach_deviations**2), np.float32(rules.fit_deviations**2)
    steps = ray_steps(tan_x.shape[0] == 1 and tan_y.shape[1] == 1)
    # Of fixed sizes: see `kernels`.
    space = np.empty((ROOM, LANES), np.float32)
    q, u, v = space[:AREA], space[AREA : 2 * AREA], space[2 * AREA : 3 * AREA]
    plane, penalty = np.zeros((4 * NEIGHBOURS, LANES), np.float32), np.zeros((NEIGHBOURS, LANES), np.float32)
    line = np.zeros((3 * PAIRS, LANES), np.float32)
    square = np.empty((NEIGHBOURS * AREA, LANES), np.float32)
    sums = np.empty(((NEIGHBOURS + 1) * BLOCK * BLOCK, LANES), np.float32)
    winner = np.empty((BLOCK * BLOCK, LANES), np.int32)
    owned, pixels = np.empty((NEIGHBOURS * 10, LANES)), np.empty((NEIGHBOURS + 1, LANES), np.int32)
    variance, mantissa = np.ones((NEIGHBOURS, LANES), np.float32), np.empty(LANES, np.float32)
    variance_bits, mantissa_bits = variance.view(np.int32), mantissa.view(np.int32)
    # Blocks with one contender or none, with two, and with more.
    group, in_group = np.empty((3, count), np.int32), np.zeros(3, np.int64)
    for c in range(count):
        g = np.int64(many[c] > 1) + np.int64(many[c] > 2)
        group[g, in_group[g]] = c
        in_group[g] += 1
    for g in range(3):
        most = g + 1 if g < 2 else NEIGHBOURS
        for start in range(0, in_group[g], LANES):
            lanes = min(in_group[g] - start, LANES)
            contending = 0
            for n in range(lanes):
                c = group[g, start + n]
                here = block[c]
                row, column = place(here, columns)
                gather(inverse_depth, tan_x, tan_y, row, column, n, q, u, v)
                contending = max(contending, many[c])
                for j in range(many[c], most):  # unused slots get a plane that no pixel is near
                    plane[4 * j, n] = plane[4 * j + 1, n] = 0.0
                    plane[4 * j + 2, n], variance[j, n] = NOWHERE, 1.0
                for j in range(many[c]):
                    b = candidate[first[c] + j]
                    total = grown_variance(sensor[here], slope_variance[b], stretch[here], waviness_square[b])
                    plane[4 * j, n], plane[4 * j + 1, n] = alpha[b, 0], alpha[b, 1]
                    plane[4 * j + 2, n], variance[j, n] = alpha[b, 2], total
                    for i in range(j):
                        a = candidate[first[c] + i]
                        pair = 3 * (j * (j - 1) // 2 + i)
                        line[pair, n], line[pair + 1, n], line[pair + 2, n] = line_between(
                            a, b, alpha, centre, first[c] + i, first[c] + j
                        )
            for n in range(lanes, LANES):
                for p in range(AREA):
                    q[p, n] = 0.0
            weigh_contenders(contending, variance, variance_bits, mantissa, mantissa_bits, plane, penalty)
            share_out(contending, space, steps, plane, penalty, line, limit, close, square, sums, winner, owned, pixels)
            for n in range(lanes):
                c = group[g, start + n]
                row, column = place(block[c], columns)
                current, third = before[row, column], block_moments[0, block[c]] / 3.0
                measured[row, column], first_share[row, column] = pixels[NEIGHBOURS, n], put
                largest, most_pixels, stays = -1, 2.0, False
                for j in range(many[c]):
                    if pixels[j, n] == 0:
                        continue
                    a = candidate[first[c] + j]
                    share_region[put], share_pixels[put] = a, pixels[j, n]
                    for k in range(10):
                        share_moments[put, k] = owned[10 * j + k, n]
                    put += 1
                    # A thin region may not own most of any block: a block stays with a region that owns a third of
                    # it.
                    share_size = owned[10 * j, n]
                    stays |= (a == current) & (share_size >= third) & (share_size > 2.0)
                    if share_size > most_pixels:
                        largest, most_pixels = a, share_size
                shares_of[row, column] = put - first_share[row, column]
                region[row, column] = current if stays else largest
    return put
