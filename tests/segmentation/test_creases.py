"""Segmentation: what bends within a region and is two planes, side by side."""

import numpy as np
import pytest

from rgbd_planes import Camera, segment
from rgbd_planes._core.status import Reason
from rgbd_planes.evaluation import scenes
from rgbd_planes.kernels.segmentation.curved.creases import STRIPS, main_bend, two_planes
from rgbd_planes.kernels.segmentation.curved.curved import find_turns
from rgbd_planes.kernels.segmentation.model.boxes import boxes
from rgbd_planes.kernels.segmentation.model.planes import fit_regions
from rgbd_planes.kernels.segmentation.model.quadrics import sampling_step
from rgbd_planes.kernels.segmentation.model.records import Noise, Planes, Rules

CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5, depth_scale=5000.0)


def flight(steps=8):
    """Stairs, whose treads have a nosing: 3 cm high, and 3 cm in front of the riser below."""
    surfaces = [scenes.polygon("floor", [(-3, 0, -1), (3, 0, -1), (3, 0, 6), (-3, 0, 6)])]
    for i in range(steps):
        height, front = 0.17 * i, 1.6 + 0.28 * i
        surfaces += scenes.box(f"step {i}", (0.0, -height, front + 2.0), (1.4, 0.17, 4.0))
        surfaces += scenes.box(f"nosing {i}", (0.0, -height - 0.17, front + 0.125), (1.4, 0.03, 0.31))
    return surfaces


@pytest.mark.parametrize(("eye", "seed"), [((0.3, -1.5, 0.0), 0), ((-0.4, -1.2, -0.3), 1), ((0.3, -1.5, 0.0), 3)])
def test_stairs_with_nosings_are_not_curved(eye, seed):
    """Riser and nosing make one region, whose step a quadric takes away in part: they were left out, 17000 pixels."""
    rendering = scenes.Scene(flight(), scenes.look_at(eye, (0.0, -0.9, 2.6))).render(CAMERA)
    found = segment(rendering.measure(seed=seed), CAMERA)
    assert not (found.reason == Reason.CURVED).any()
    assert found.share > 0.98


def test_the_main_bend_is_along_the_larger_curvature(rng):
    for h in rng.normal(size=(200, 3)):
        values, vectors = np.linalg.eigh([[h[0], h[1]], [h[1], h[2]]])
        along = vectors[:, np.argmax(np.abs(values))]
        assert abs(np.dot(main_bend(tuple(h)), along)) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("shape", [(6, 9), (40, 60)])
def test_two_planes_are_those_that_fit_best_on_both_sides_of_a_line(shape, rng):
    region = (rng.random(shape) < 0.1).astype(np.int32)  # number 0, with holes that are region 1
    box = np.empty((2, 4), np.int64)
    boxes(region, box)
    v, u = np.mgrid[: shape[0], : shape[1]] / 100.0
    q = np.where(u + 0.3 * v > 0.3 * shape[1] / 100.0, 0.52, 0.5) + 0.1 * u - 0.2 * v + rng.normal(0.0, 1e-3, shape)
    n = rng.integers(0, 17, shape)  # of some blocks no pixel is measured
    means = np.stack([n, u, v, q]).astype(np.float32)
    angle, deviation, alpha = 0.3, 2e-3, np.array([0.1, -0.2, 0.5])
    along = np.cos(angle), np.sin(angle)

    own = np.zeros(shape, bool)
    own[box[0, 0] : box[0, 1] : sampling_step(box[0]), box[0, 2] : box[0, 3] : sampling_step(box[0])] = True
    own &= (region == 0) & (n > 0)
    weight, x, y, z = means[:, own].astype(np.float64)
    t = along[0] * x + along[1] * y
    strip = np.minimum(STRIPS * (t - t.min()) / (t.max() - t.min()), STRIPS - 1).astype(int)

    def left(some, terms):
        terms = terms[some] * np.sqrt(weight[some])[:, None]
        rest = (z * np.sqrt(weight))[some]
        return np.sum((rest - terms @ np.linalg.lstsq(terms, rest, rcond=None)[0]) ** 2) / deviation**2

    plane = np.column_stack([x, y, np.ones(len(x))])
    planes, split = min((left(strip < i, plane) + left(strip >= i, plane), i) for i in range(1, STRIPS))
    quadric = np.column_stack([plane, x * x, x * y, y * y])
    quadrics = left(strip < split, quadric) + left(strip >= split, quadric)
    moments = np.zeros(10)
    for i, (a, b) in enumerate([(0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3)]):
        columns = np.column_stack([np.ones(len(x)), x, y, z])
        moments[i] = np.sum(weight * columns[:, a] * columns[:, b])
    found = two_planes(region, means, 0, box, moments, alpha, deviation, along)
    assert found == pytest.approx((planes, quadrics), rel=1e-6)


def test_what_does_not_extend_is_not_two_planes():
    region, box = np.zeros((1, 1), np.int32), np.array([[0, 1, 0, 1]])
    means = np.array([16.0, 0.1, 0.2, 0.5], np.float32).reshape(4, 1, 1)
    moments = np.array([16.0, 1.6, 3.2, 8.0, 0.16, 0.32, 0.8, 0.64, 1.6, 4.0])
    assert two_planes(region, means, 0, box, moments, np.array([0.0, 0.0, 0.5]), 1e-3, (1.0, 0.0)) == (np.inf, np.inf)


@pytest.mark.parametrize(("curvature", "is_bent"), [(0.0, False), (-1.0, False), (-5.0, True), (1.0, True)])
def test_two_halves_are_planes_if_they_are_flat(curvature, is_bent, rng):
    """A fold of two flat sides, of two sides that bend less than it folds, or more; and a valley, without a fold."""
    v, u = 0.25 * np.mgrid[-1:1:24j, -1:1:24j]
    x = u / 0.25
    q = 0.5 + 0.05 * v + 0.07 * ((1.0 - curvature) * np.abs(x) + curvature * x * x)
    q += rng.normal(0.0, 2.5e-4, q.shape)  # of blocks of 16 pixels
    region, rows = np.zeros(q.shape, np.int32), np.stack([np.ones_like(q), u, v, q])
    means = np.stack([np.full_like(q, 16.0), u, v, q]).astype(np.float32)
    sums = 16.0 * np.einsum("ayx,byx->ab", rows, rows)
    moments = sums[np.triu_indices(4)][None]
    planes = Planes(np.empty((1, 3)), np.empty(1), np.empty(1), np.empty(1), np.ones(1))
    noise = Noise(np.full(2, 1e-6), 0.0, 0.0, 0.0, np.empty((2, 0)), np.zeros(3), 1.0)
    fit_regions(moments, noise, planes)
    turned, bending, bent = np.empty(1), np.empty(1), np.empty(1, np.bool_)
    find_turns(region, means, moments, planes, noise.sigma, Rules(), np.array([[0, 24, 0, 24]]), turned, bending, bent)
    assert np.degrees(np.sqrt(turned[0])) > Rules().curved_degrees
    assert bent[0] == is_bent
