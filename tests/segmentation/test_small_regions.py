"""Segmentation: small regions that bend are curved, and those that a sensor only seems to bend are planes."""

import numpy as np
import pytest
from scipy import ndimage

from rgbd_planes import Camera
from rgbd_planes.kernels.segmentation.curved.small_regions import inner_pixels, turn_inside
from rgbd_planes.kernels.segmentation.model.boxes import boxes
from rgbd_planes.kernels.segmentation.model.planes import fit_planes
from rgbd_planes.kernels.segmentation.model.records import (
    BLOCK,
    EMPTY,
    MIXED,
    UNSEEN,
    Noise,
    Owners,
    Pyramid,
    Regions,
    Rules,
    Shares,
    View,
)
from rgbd_planes.segmentation.workspace import rays_of

CAMERA = Camera(90, 70, 131.0, 131.0, 44.5, 34.5)
SIGMA = 1e-3


def owned_of(labels, measured, rng):
    """What says that the measured pixels of label i are region i's, whose number was another at first."""
    regions = labels.max() + 1
    was = rng.permutation(regions + 3)[:regions]
    number = np.full(regions + 3, -1)
    number[was] = np.arange(regions)
    rows, columns = -(-labels.shape[0] // BLOCK), -(-labels.shape[1] // BLOCK)
    region, block = np.full((rows, columns), -1, np.int32), np.full((rows, columns), EMPTY, np.int32)
    first, count = np.zeros((rows, columns), np.int32), np.zeros((rows, columns), np.int32)
    shares = []
    for row, column in np.ndindex(rows, columns):
        here = np.s_[BLOCK * row : BLOCK * (row + 1), BLOCK * column : BLOCK * (column + 1)]
        its, seen = labels[here], measured[here]
        found = np.unique(its[seen])
        if not len(found):
            continue
        region[row, column] = rng.choice(found[found >= 0]) if (found >= 0).any() else -1
        if len(found) == 1 and found[0] >= 0:
            block[row, column] = rng.choice([was[found[0]], UNSEEN])
            continue
        block[row, column], first[row, column] = MIXED, len(shares)
        for a in found[found >= 0]:
            y, x = np.nonzero((its == a) & seen)
            shares.append((was[a], (1 << (BLOCK * y + x)).sum()))
        count[row, column] = len(shares) - first[row, column]
    its, pixels = np.array(shares, np.int32).reshape(-1, 2).T.copy()
    owners = Owners(block, first, count, np.zeros_like(first))
    return Regions(region, np.zeros((3, 10)), number, owners, Shares(its, pixels, np.zeros((len(its), 10))))


@pytest.mark.parametrize("holes", [0.0, 0.1, 0.5])
@pytest.mark.parametrize("grain", [2.0, 5.0])
def test_pixels_inside_a_region_are_those_of_numpy(grain, holes, rng):
    noise = ndimage.gaussian_filter(rng.standard_normal(CAMERA.shape), grain)
    labels = np.digitize(noise, np.quantile(noise, [0.2, 0.5, 0.8])) - 1
    measured = rng.random(CAMERA.shape) >= holes
    q = np.where(measured, rng.uniform(0.3, 2.0, CAMERA.shape), 0.0).astype(np.float32)
    regions = owned_of(labels, measured, rng)
    of_block = np.kron(regions.block, np.ones((BLOCK, BLOCK), int))[: CAMERA.height, : CAMERA.width]
    box = np.empty((3, 4), np.int64)
    boxes(regions.block, box)
    u, v = np.broadcast_arrays(CAMERA.tan_x, CAMERA.tan_y)
    for a in range(3):
        own = (labels == a) & (of_block == a) & measured
        inside = ndimage.binary_erosion(own)
        chosen = own if 2 * inside.sum() < own.sum() else inside
        pixels = np.full((own.sum() + 5, 4), -1.0, np.float32)
        count = inner_pixels(regions, a, box[a], q, rays_of(CAMERA), pixels)
        assert count == chosen.sum() > 0
        expected = np.stack([np.ones_like(u), u, v, q], axis=-1)[chosen].astype(np.float32)
        assert sorted(pixels[:count].tolist()) == sorted(expected.tolist())
        assert (pixels[count:] == -1.0).all()
        few = np.full((11, 4), -1.0, np.float32)  # more than there is room for are not written
        assert inner_pixels(regions, a, box[a], q, rays_of(CAMERA), few[:10]) <= 10
        assert (few[10] == -1.0).all()


def degrees_inside(q, shape, sigma=SIGMA, together=1.0):
    """By how much a rectangle in the middle of the image, (rows, columns) large, turns beyond chance."""
    rows, columns = shape
    top, left = (CAMERA.height - rows) // 2, (CAMERA.width - columns) // 2
    here = np.s_[top : top + rows, left : left + columns]
    labels, inverse_depth = np.full(CAMERA.shape, -1), np.full(CAMERA.shape, 0.3, np.float32)
    labels[here], inverse_depth[here] = 0, q
    regions = owned_of(labels, inverse_depth > 0.0, np.random.default_rng(0))
    box = np.empty((1, 4), np.int64)
    boxes(regions.block, box)
    u, v = (a[here].ravel() for a in np.broadcast_arrays(CAMERA.tan_x, CAMERA.tan_y))
    terms = np.stack([np.ones_like(u), u, v, q.ravel()])
    moments, alpha = (terms @ terms.T)[np.triu_indices(4)][None], np.empty((1, 3))
    fit_planes(moments, alpha, np.empty(1))
    noise = Noise(np.array([10.0, sigma, sigma, sigma]), 0.0, 0.0, 0.0, np.zeros((2, 0)), np.ones(3), together)
    pyramid = Pyramid(np.empty((10, 0)), np.empty(0), np.empty(0), np.empty(0, np.int64), np.empty((0, 2), np.int64))
    view = View(inverse_depth, rays_of(CAMERA), pyramid, noise, Rules(), np.empty(0))
    return np.degrees(np.sqrt(turn_inside(view, regions, 0, box[0], moments[0], alpha[0], sigma**2)))


def parabola(shape, height, rng, sigma=SIGMA):
    """A part of a cylinder that is as high as ``height`` standard deviations, and its noise."""
    x = np.linspace(-1.0, 1.0, shape[1])
    return 1.0 + sigma * (height * x * x + rng.standard_normal(shape))


def test_small_regions_that_bend_turn(rng):
    shape = 40, 12
    for _ in range(20):
        assert degrees_inside(parabola(shape, 0.0, rng), shape) == 0.0
        assert degrees_inside(parabola(shape, 3.0, rng), shape) == 0.0  # a quadric takes a third
        assert degrees_inside(parabola(shape, 7.0, rng), shape) > 2.0
        # Noise that was overestimated is no reason to keep it.
        assert degrees_inside(parabola(shape, 7.0, rng), shape, sigma=2.0 * SIGMA) > 2.0


def test_a_cylinder_turns_by_its_angle():
    """From -10 to 10 degrees, seen along its radius: 20 / √12, root mean square."""
    shape, sine = (30, 30), np.linspace(-np.sin(np.radians(10.0)), np.sin(np.radians(10.0)), 30)
    radius = 30 / 131.0 / np.ptp(sine)  # as wide as the rectangle at a distance of 1
    q = np.tile(1.0 / (1.0 + radius * (1.0 - np.sqrt(1.0 - sine**2))), (30, 1))
    assert degrees_inside(q, shape, sigma=1e-5) == pytest.approx(20.0 / np.sqrt(12.0), rel=0.1)


def test_what_may_be_the_sensors_does_not_turn(rng):
    shape = 24, 28
    bent = parabola(shape, 6.0, rng)
    assert degrees_inside(bent, shape) > 2.0
    assert degrees_inside(bent, shape, together=250.0) == 0.0  # errors of 16 pixels each way are one
    assert degrees_inside(parabola(shape, 6.0, rng, sigma=1e-4), shape, sigma=1e-4) < 2.0


@pytest.mark.parametrize("off", [-6.0, 6.0])
def test_a_biased_rim_does_not_turn(off, rng):
    """Sensors smooth over edges, or see what is behind."""
    shape = 10, 10
    seen = parabola(shape, 0.0, rng)
    seen[~ndimage.binary_erosion(np.ones(shape, bool))] += off * SIGMA
    assert degrees_inside(seen, shape) == 0.0


def test_narrow_regions_are_judged_by_all_their_pixels(rng):
    shape = 3, 60
    assert degrees_inside(parabola(shape, 12.0, rng), shape) > 2.0
    assert degrees_inside(parabola(shape, 0.0, rng), shape) == 0.0
