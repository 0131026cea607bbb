"""Regions of one plane each: in rounds, from blocks to regions, and from regions to the pixels that they own."""

from __future__ import annotations

from typing import Any

import numpy as np

from rgbd_planes._core.arrays import Floats
from rgbd_planes.kernels.segmentation.assign.assign_pixels import assign_pixels
from rgbd_planes.kernels.segmentation.assign.spread import move_on, spread_out
from rgbd_planes.kernels.segmentation.blocks.quadtree import join_blocks
from rgbd_planes.kernels.segmentation.merge.contacts import keep_pairs_inside, neighbours, rename_pairs
from rgbd_planes.kernels.segmentation.merge.merge import merge, renumber_regions
from rgbd_planes.kernels.segmentation.merge.seed_growing import grow_together
from rgbd_planes.kernels.segmentation.merge.split_faces import (
    STRICT,
    find_doubtful,
    keep_faces,
    keep_turned,
    take_parts,
)
from rgbd_planes.kernels.segmentation.model.planes import fit_regions
from rgbd_planes.kernels.segmentation.model.records import Contacts, Planes, Regions, Shares, View, plain
from rgbd_planes.segmentation.workspace import Workspace

Plain = tuple[Any, ...]


def find_regions(view: View, work: Workspace, least: int) -> tuple[Regions, int]:
    """Find the regions of a frame, and the pixels that they own.

    Blocks that are surely one plane grow together. Then in each round neighbours that are one plane are merged, regions
    that are several planes are split, and every pixel goes to the plane that it fits.

    Parameters
    ----------
    view : View
        Its ``sensor`` is written.
    work : Workspace
    least : int
        Pixels that a region must have after the first round.

    Returns
    -------
    regions : Regions
    contacts : int
        Pairs of regions that touch, in ``work.contacts``.
    """
    seen = plain(view)
    rounds, block, owners, moments = view.rules.rounds, work.region, work.owners, work.region_moments
    count = join_blocks(seen, block, owners.block, moments)
    parent, number = np.empty(count, np.int64), np.empty(count, np.int64)
    grow_together(block, moments[:count], plain(view.noise), plain(view.rules), parent)
    count = renumber_regions(block, parent, moments[:count], 0.0, number)
    regions = Regions(block, moments[:count], number, owners, _no_shares())
    for turn in range(rounds + 1):
        regions, touching = _merge_regions(seen, regions, work.contacts, float(least) if turn else 0.0, turn == rounds)
        if turn == rounds:
            break
        planes = plain(fitted(regions, view))
        if turn == 1:  # earlier it would spread over what becomes a region of its own
            spread_out(seen, plain(regions), planes)
        shares, contended = work.shares, plain(work.contended)
        many = assign_pixels(seen, plain(regions), planes, work.last_region, contended, plain(shares))
        regions = regions._replace(shares=Shares(shares.region[:many], shares.pixels[:many], shares.moments[:many]))
        if turn < rounds - 1:
            move_on(seen, block, work.last_region, planes[0])
    return regions, touching


def fitted(regions: Regions, view: View) -> Planes:
    """The planes of the regions."""
    count = len(regions.moments)
    planes = Planes(
        np.empty((count, 3)), np.empty(count), np.empty(count), np.empty(count), view.rays.stretch
    )  # fmt: skip
    fit_regions(regions.moments, plain(view.noise), plain(planes))
    return planes


def _no_shares() -> Shares:
    return Shares(np.empty(0, np.int32), np.empty(0, np.int32), np.empty((0, 10)))


def _merge_regions(
    view: Plain, regions: Regions, contacts: Contacts, least: float, is_last: bool
) -> tuple[Regions, int]:
    """Merge what is one plane, split what is several, and number the regions anew.

    Returns the regions, and, in the last round, how many pairs touch, in ``contacts``.
    """
    _, rays, _, noise, rules, _ = view
    block, moments, among = regions.block, regions.moments, plain(contacts)
    touching = neighbours(block, rays, among)
    parts, parts_touching = moments.copy(), touching
    among_parts = contacts.pairs[:touching].copy(), contacts.where[:touching].copy(), contacts.table
    parent, number = np.empty(len(moments), np.int64), np.empty(len(moments), np.int64)
    touching = merge(moments, among, touching, noise, rules, 1.0, parent)
    is_split = _split_faces(view, regions._replace(number=parent), parts, among_parts, parts_touching)
    count = renumber_regions(block, parent, moments, least, number)
    if is_last and (is_split or not rename_pairs(contacts.pairs, touching, number)):
        touching = neighbours(block, rays, among)
    return regions._replace(moments=moments[:count], number=number), touching


def _split_faces(view: Plain, joined: Regions, parts: Floats, contacts: Plain, touching: int) -> bool:
    """Split the joined regions that are several planes; returns whether there are any.

    ``joined.number``, which region each part went into, and ``joined.moments`` are changed.
    """
    parent, (_, _, _, noise, rules, _) = joined.number, view
    rough, several, ajar = np.empty((3, len(parent)), np.bool_)
    if not find_doubtful(joined.moments, parts, parent, noise, rules, rough, several, ajar):
        return False
    if several.any():
        keep_turned(view, plain(joined), ajar, several)
    chosen = rough | several
    if not chosen.any():
        return False
    again = np.empty_like(parent)
    touching = keep_pairs_inside(contacts, touching, parent, chosen)
    merge(parts, contacts, touching, noise, rules, STRICT, again)
    if several.any():
        keep_faces(view, plain(joined), parts, again, ajar, several)
    chosen = rough | several
    take_parts(parent, again, chosen, joined.moments, parts)
    return bool(chosen.any())
