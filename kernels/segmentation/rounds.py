"""Segmentation: regions of one plane each.

In rounds: from joined blocks to regions, from regions to the pixels they own, and back.
"""

import numpy as np

from .._jit.kernel import kernel
from .assign.assign_pixels import own_pixels
from .assign.spread import move_on, spread_out
from .blocks.quadtree import join_blocks, leaves
from .curved.curved import find_curved
from .merge.contacts import neighbours, rename_pairs
from .merge.merge import merge, number_regions, renumber
from .merge.seed_growing import grow_together
from .merge.split_faces import part_again
from .model.planes import deviations, fit_regions
from .model.records import Contacts, Owned, Planes, Shares


@kernel(inline=True)
def merge_and_own(
    inverse_depth, rays, pyramid, sensor, state, noise, rules, least, region, owners, contended, contacts, moments
):  # fmt: skip
    """Merge what is one plane, give the pixels to the planes, fit the planes again to their pixels: in rounds.

    Parameters
    ----------
    inverse_depth, rays, pyramid, noise, rules, least, owners, contended, moments
        See `find_regions`, which calls the last ``region_moments``.
    sensor, state
        See `quadtree.join_blocks`.
    region : (R, C) int32, written
        Region that owns most of a block, or -1.
    contacts : Contacts, written
        Of the regions in the end.

    Returns
    -------
    number : (M,) int64
        What the regions of ``owners`` and ``shares`` became in the end, or -1.
    count : int
        Regions in the end.
    shares : Shares
    contact_count : int
    """
    count = leaves(pyramid, state, region, owners.block, moments)
    parent, number = np.empty(count, np.int64), np.empty(count, np.int64)
    grow_together(region, moments[:count], noise, rules, parent)
    count = number_regions(parent, moments, 0.0, number)
    renumber(region, number)
    before = np.empty_like(region)
    alpha = np.empty((0, 3))
    shares = Shares(np.empty(0, np.int32), np.empty(0, np.int32), np.empty((0, 10)))
    for trip in range(rules.trips + 1):
        pair_count = neighbours(region, rays, contacts)
        first_moments = moments[:count].copy()
        first = Contacts(contacts.pairs[:pair_count].copy(), contacts.where[:pair_count].copy(), contacts.table)
        parent = np.empty(count, np.int64)
        pair_count = merge(moments[:count], contacts, pair_count, noise, rules, 1.0, parent)
        is_parted = part_again(
            region, pyramid, owners, shares, moments[:count], first_moments, first, noise, rules, parent
        )  # fmt: skip
        number = np.empty(count, np.int64)
        merged = number_regions(parent, moments, least if trip else 0.0, number)
        renumber(region, number)
        if trip == rules.trips:
            if is_parted or not rename_pairs(contacts.pairs, pair_count, number):
                pair_count = neighbours(region, rays, contacts)
            return number, merged, shares, pair_count
        count = merged
        last_alpha = alpha
        alpha = np.empty((count, 3))
        planes = Planes(alpha, np.empty(count), np.empty(count), np.empty(count), rays.stretch)
        fit_regions(moments[:count], noise, planes)
        if trip == 1:  # earlier it would spread over what becomes a region of its own
            spread_out(region, owners.block, pyramid, sensor, planes, rules.settled)
        shares = own_pixels(
            inverse_depth, rays, pyramid, sensor, region, planes, noise.sigma, rules, trip == 0, before, number,
            last_alpha, owners, shares, contended, moments[:count],
        )  # fmt: skip
        if trip < rules.trips - 1:
            move_on(region, before, pyramid, planes)
    return number, count, shares, 0


@kernel(inline=True)
def find_regions(inverse_depth, rays, pyramid, noise, rules, least, owners, contended, contacts, region_moments):
    """The regions of a frame, which pixels they own, and which of them are curved.

    Parameters
    ----------
    inverse_depth, rays, pyramid, noise, rules
        See `pipeline.find_planes`.
    least : float
        Pixels that a region must have after the first round.
    owners : Owners, written
    contended, contacts
        Room: see `assign_pixels.own_pixels` and `contacts.neighbours`.
    region_moments : (R·C, 10) float64, written
        The first rows are those of the regions.

    Returns
    -------
    shares : Shares
    number : (M,) int64
        What the regions of ``owners`` and ``shares`` became in the end, or -1.
    curved : (N,) bool
        Of the regions in the end.
    deviation : (N,) float64
        Standard deviation of a pixel about the plane of each.
    """
    rows, columns = owners.block.shape
    sensor, state = np.empty(rows * columns), np.empty(len(pyramid.rss), np.int8)
    join_blocks(pyramid, noise, rules, sensor, state)
    region = np.empty((rows, columns), np.int32)
    number, count, shares, contact_count = merge_and_own(
        inverse_depth, rays, pyramid, sensor, state, noise, rules, least, region, owners, contended, contacts,
        region_moments,
    )  # fmt: skip
    moments = region_moments[:count]
    planes = Planes(np.empty((count, 3)), np.empty(count), np.empty(count), np.empty(count), rays.stretch)
    fit_regions(moments, noise, planes)
    curved, deviation = np.empty(count, np.bool_), np.empty(count)
    owned = Owned(region, number, owners, shares)
    find_curved(owned, inverse_depth, rays, pyramid, moments, planes, noise, rules, contacts, contact_count, curved)
    deviations(moments, planes, noise.sigma, deviation)
    return shares, number, curved, deviation
