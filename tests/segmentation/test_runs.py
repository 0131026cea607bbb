"""Segmentation: runs of pixels and their connected parts, against SciPy and plain NumPy."""

import numpy as np
import pytest
from scipy import ndimage

from rgbd_planes.kernels.segmentation.components.runs import GAP, connect, find_runs
from rgbd_planes.kernels.segmentation.model.records import BLOCK, MIXED, Owners, Regions, Runs, Shares, plain


def runs_of(image):
    """Runs of an image of regions, and the numbers of runs and of parts."""
    runs = Runs(np.empty(len(image) + 1, np.int32), *np.empty((7, image.size), np.int32))
    return runs, *find_runs(image, runs)


def parts_of(image):
    """Part of each pixel of an image of regions, from 0 on, -1 for none."""
    runs, count, _ = runs_of(image)
    parts = np.full(image.shape, -1)
    for k in range(count):
        parts[runs.row[k], runs.start[k] : runs.stop[k]] = runs.part[k]
    return parts


@pytest.mark.parametrize("regions", [1, 2, 5])
def test_parts_are_connected_components_of_regions(regions, rng):
    # Every second pixel of rows and columns is on a wall of a region of its own, so that nothing meets over a gap.
    image = rng.integers(1, regions + 1, (40, 50)).astype(np.int32)
    parts = parts_of(image)
    for a in range(1, regions + 1):
        labels, count = ndimage.label(image == a, np.ones((3, 3)))
        pairs = {(int(one), int(other)) for one, other in zip(labels[image == a], parts[image == a], strict=True)}
        assert len(pairs) == count == len({one for one, _ in pairs}) == len({other for _, other in pairs})
    assert len(np.unique(parts)) == parts.max() + 1


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("gap", range(1, GAP + 3))
def test_parts_meet_over_gaps_of_no_region_of_so_many_pixels(gap, turned):
    image = np.ones((6, 20), np.int32)
    image[:, 8 : 8 + gap] = 0
    for between, parts in ((0, 1 if gap <= GAP else 2), (2, 3)):
        image[:, 8] = between
        seen = np.ascontiguousarray(image.T) if turned else image
        assert len(np.unique(parts_of(seen)[seen > 0])) == parts


def test_runs_are_counted_along_rows_and_columns(rng):
    image = ndimage.zoom(rng.integers(0, 3, (12, 15)), 3, order=0).astype(np.int32)
    runs, count, parts = runs_of(image)
    part = parts_of(image)
    for p in range(parts):
        across = np.diff(part == p, axis=1, prepend=False)[part == p].sum()
        down = np.diff(part == p, axis=0, prepend=False)[part == p].sum()
        of_part = runs.part[:count] == p
        assert of_part.sum() == across
        # A column's pixel begins a run if the one above is another part, perhaps of the same region.
        assert runs.starts_down[:count][of_part].sum() == down
    np.testing.assert_array_equal(runs.first, np.searchsorted(runs.row[:count], np.arange(len(image) + 1)))


@pytest.mark.parametrize(("number", "parts"), [((0, 0), 1), ((0, 1), 2), ((-1, 0), 1)])
def test_shares_of_a_block_are_of_what_their_regions_have_become(number, parts):
    """Of three blocks in a row each outer one's region has half of the middle one."""
    owners = Owners(*np.array([[[0, MIXED, 1]], [[0, 0, 0]], [[0, 2, 0]], [[0, 0xFFFF, 0]]], np.int32))
    shares = Shares(np.array([0, 1], np.int32), np.array([0x3333, 0xCCCC], np.int32), np.empty((2, 10)))
    regions = Regions(owners.block, np.empty((2, 10)), np.array(number), owners, shares)
    image = np.empty((BLOCK, 3 * BLOCK), np.int32)
    runs = Runs(np.empty(BLOCK + 1, np.int32), *np.empty((7, image.size), np.int32))
    assert connect(plain(regions), image, plain(runs)) == (len(set(number) - {-1}) * BLOCK, parts)
    np.testing.assert_array_equal(image, np.repeat([np.repeat(number, 6) + 1], BLOCK, axis=0))
