"""Segmentation: runs of pixels and their connected parts, against SciPy and plain NumPy."""

import numpy as np
import pytest
from scipy import ndimage

from rgbd_planes.kernels.segmentation.components.labels import write_labels
from rgbd_planes.kernels.segmentation.components.runs import GAP, connect
from rgbd_planes.kernels.segmentation.model.records import BLOCK, MIXED, Owners, Reasons, Regions, Runs, Shares, plain


def regions_of(image):
    """An image of regions, from 1 on, 0 for none and -1 where nothing is measured, in blocks that regions share."""
    height, width = image.shape
    rows, columns = -(-height // BLOCK), -(-width // BLOCK)
    padded = np.full((rows * BLOCK, columns * BLOCK), -1)
    padded[:height, :width] = image
    blocks = padded.reshape(rows, BLOCK, columns, BLOCK).transpose(0, 2, 1, 3).reshape(rows, columns, BLOCK**2)
    bits = 1 << np.arange(BLOCK**2)
    first, count, region, pixels = np.empty((rows, columns)), np.empty((rows, columns)), [], []
    for row, column in np.ndindex(rows, columns):
        block = blocks[row, column]
        own = np.unique(block[block > 0])
        first[row, column], count[row, column] = len(region), len(own)
        region.extend(own - 1)
        pixels.extend(bits[block == a].sum() for a in own)
    measured = np.where(blocks >= 0, bits, 0).sum(axis=2)
    owners = np.array([np.full((rows, columns), MIXED), first, count, measured], np.int32)
    shares = Shares(np.array(region, np.int32), np.array(pixels, np.int32), np.empty((len(region), 10)))
    number = np.arange(image.max())
    return Regions(owners[0], np.empty((len(number), 10)), number, Owners(*owners), shares)


def runs_of(image):
    """Runs of an image of regions, and the numbers of runs and of parts."""
    runs = Runs(np.empty(len(image) + 1, np.int32), *np.empty((7, image.size), np.int32))
    return runs, *connect(plain(regions_of(image)), image.shape[1], plain(runs))


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
    runs = Runs(np.empty(BLOCK + 1, np.int32), *np.empty((7, 3 * BLOCK**2), np.int32))
    count, found = connect(plain(regions), 3 * BLOCK, plain(runs))
    assert (count, found) == (len(set(number) - {-1}) * BLOCK, parts)
    row = np.zeros(3 * BLOCK, int)
    for k in range(count):
        row[runs.start[k] : runs.stop[k]] = runs.region[k] + 1
    np.testing.assert_array_equal(row, np.repeat(number, 6) + 1)


@pytest.mark.parametrize("shape", [(40, 50), (1, 9), (2, 2), (3, 17)])
def test_labels_are_those_of_the_parts_and_strays_are_beside_them(shape, rng):
    """Of pixels that are measured."""
    image = rng.choice([-1, 0, 1, 2, 3], shape, p=[0.1, 0.2, 0.3, 0.2, 0.2]).astype(np.int32)
    runs, _, parts = runs_of(image)
    part, q = parts_of(image), np.where(image >= 0, rng.uniform(0.2, 1.0, shape), 0.0).astype(np.float32)
    reasons = Reasons(*np.arange(7, dtype=np.uint8))
    number = np.where(rng.random(parts) < 0.5, np.arange(1, parts + 1), 0).astype(np.int32)
    why = np.where(number > 0, 0, rng.integers(1, 5, parts)).astype(np.uint8)
    label, reason = np.empty(shape, np.int32), np.empty(shape, np.uint8)
    strays = np.empty(image.size, np.int32)
    count = write_labels(q, plain(runs), number, why, plain(reasons), label, reason, strays)
    np.testing.assert_array_equal(label, np.where((part >= 0) & (q > 0), np.append(number, 0)[part], 0))
    unclaimed_or_why = np.where(part >= 0, np.append(why, 0)[part], reasons.unclaimed)
    np.testing.assert_array_equal(reason, np.where(q > 0, unclaimed_or_why, reasons.missing))
    beside = ndimage.maximum_filter(label, footprint=[[0, 1, 0], [1, 0, 1], [0, 1, 0]], mode="constant") > 0
    beside &= np.isin(reason, [reasons.unclaimed, reasons.small, reasons.narrow])
    beside[[0, -1]] = beside[:, [0, -1]] = False
    np.testing.assert_array_equal(strays[:count], np.flatnonzero(beside))
