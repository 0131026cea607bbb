"""Segmentation: what bends within a region and is two planes, side by side."""

import numpy as np
import pytest

from rgbd_planes import Camera, scenes, segment
from rgbd_planes.kernels.segments.breaks import STRIPS, main_bend, two_planes
from rgbd_planes.kernels.segments.quadrics import boxes, step_of
from rgbd_planes.segmentation.result import Reason

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
    own[box[0, 0] : box[0, 1] : step_of(box[0]), box[0, 2] : box[0, 3] : step_of(box[0])] = True
    own &= (region == 0) & (n > 0)
    weight, x, y, z = means[:, own].astype(np.float64)
    t = along[0] * x + along[1] * y
    strip = np.minimum(STRIPS * (t - t.min()) / (t.max() - t.min()), STRIPS - 1).astype(int)

    def left(some):
        terms = np.column_stack([x, y, np.ones(len(x))])[some] * np.sqrt(weight[some])[:, None]
        rest = (z * np.sqrt(weight))[some]
        return np.sum((rest - terms @ np.linalg.lstsq(terms, rest, rcond=None)[0]) ** 2) / deviation**2

    expected = min(left(strip < split) + left(strip >= split) for split in range(1, STRIPS))
    moments = np.zeros(10)
    for i, (a, b) in enumerate([(0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3)]):
        columns = np.column_stack([np.ones(len(x)), x, y, z])
        moments[i] = np.sum(weight * columns[:, a] * columns[:, b])
    assert two_planes(region, means, 0, box, moments, alpha, deviation, along) == pytest.approx(expected, rel=1e-6)


def test_what_does_not_extend_is_not_two_planes():
    region, box = np.zeros((1, 1), np.int32), np.array([[0, 1, 0, 1]])
    means = np.array([16.0, 0.1, 0.2, 0.5], np.float32).reshape(4, 1, 1)
    moments = np.array([16.0, 1.6, 3.2, 8.0, 0.16, 0.32, 0.8, 0.64, 1.6, 4.0])
    assert two_planes(region, means, 0, box, moments, np.array([0.0, 0.0, 0.5]), 1e-3, (1.0, 0.0)) == np.inf
