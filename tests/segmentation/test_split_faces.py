"""Segmentation: joined regions that are several planes are parted, and curved ones are not."""

from dataclasses import replace

import numpy as np
import pytest
from segment_frames import CAMERA

from bench import block_scenes
from rgbd_planes import segment
from rgbd_planes._core.status import Reason
from rgbd_planes.evaluation.metrics import compare_labels
from rgbd_planes.kernels.segmentation.merge import split_faces
from rgbd_planes.kernels.segmentation.model.quadrics import PLANE_TERMS, TERMS
from rgbd_planes.kernels.segmentation.model.records import (
    UNSEEN,
    Noise,
    Owners,
    Pyramid,
    Regions,
    Rules,
    Shares,
    View,
    plain,
)
from rgbd_planes.segmentation.workspace import rays_of

SIGMA = 1e-3
SHAPES = {
    "two faces": (lambda t: np.minimum(t, 0.5), 2),
    "three faces": (lambda t: np.clip(t, 1 / 3, 2 / 3), 3),
    "three faces, two of them nearly one plane": (lambda t: np.minimum(t, 2 / 3) - 0.015 * t * t, 3),
    "a rounded edge": (lambda t: -0.06 * np.logaddexp(0.0, (0.5 - t) / 0.06), 2),
    "a parabola": (lambda t: t * t, 2),
    "a parabola in three": (lambda t: t * t, 3),
    "half a cylinder": (lambda t: np.sqrt(1.01 - (2.0 * t - 1.0) ** 2), 4),
    "waves": (lambda t: np.cos(1.5 * np.pi * t), 4),
}


@pytest.fixture
def noise():
    return Noise(np.array([10.0, SIGMA, SIGMA, SIGMA]), 0.0, 0.0, 0.0, np.zeros((2, 0)), np.ones(3), 1.0)


def parts_of(shape, height, scale=1):
    """Block means of a surface that is ``height`` deviations high, in strips, and the strips' moments."""
    surface, strips = SHAPES[shape]
    rows, columns = 12 * scale, 36 * scale
    t = (np.arange(columns) + 0.5) / columns
    labels = np.broadcast_to((t * strips).astype(np.int32), (rows, columns)).copy()
    u, v = np.meshgrid(0.01 * np.arange(columns), 0.01 * np.arange(rows))
    q = 0.5 + np.broadcast_to(height * SIGMA * surface(t), u.shape)
    means = np.stack([np.full_like(u, 16.0), u, v, q]).astype(np.float32)
    terms = np.stack([np.ones_like(u), u, v, q])
    products = 16.0 * np.array(
        [[(terms[:, labels == k][i] * terms[:, labels == k][j]).sum() for i, j in ORDER] for k in range(strips)]
    )
    return labels, means, products


# Of 1, u, v and q: as the moments of regions are ordered.
ORDER = ((0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3))


def are_faces(shape, height, noise, scale=1, ajar=False):
    labels, means, moments = parts_of(shape, height, scale)
    strips = len(moments)
    joined = np.zeros_like(moments)
    joined[0] = moments.sum(axis=0)
    chosen = np.zeros(strips, np.bool_)
    chosen[0] = True
    parent, again = np.zeros(strips, np.int64), np.arange(strips)
    rows, columns = labels.shape
    owners = Owners(np.full((rows, columns), UNSEEN, np.int32), *np.zeros((3, rows, columns), np.int32))
    shares = Shares(np.empty(0, np.int32), np.empty(0, np.int32), np.empty((0, 10)))
    regions = Regions(labels.astype(np.int32), joined, parent, owners, shares)
    sums = np.zeros((10, labels.size))
    sums[:4] = means.reshape(4, -1) * np.vstack([np.ones(labels.size), *[means[0].ravel()] * 3])
    pyramid = Pyramid(sums, np.empty(0), np.empty(0), np.empty(0, np.int64), np.empty((0, 2), np.int64))
    view = View(np.empty((0, 0), np.float32), rays_of(CAMERA), pyramid, noise, Rules(), np.empty(0))
    split_faces.keep_faces(plain(view), plain(regions), moments, again, np.full(strips, ajar), chosen)
    return bool(chosen[0])


@pytest.mark.parametrize("shape", SHAPES)
def test_faces_are_told_from_what_is_curved(shape, noise):
    assert are_faces(shape, 40.0, noise) == ("face" in shape)


def test_faces_that_noise_might_make_are_none(noise):
    """The height that it takes grows with the errors that neighbours share, and with the frame's waves.

    It falls with the number of blocks, of which not all are looked at.
    """
    least = next(h for h in range(1, 60) if are_faces("two faces", h, noise))
    assert 2 < least < 20
    shared = noise._replace(together=9.0)
    assert next(h for h in range(1, 99) if are_faces("two faces", h, shared)) == pytest.approx(3 * least, abs=3)
    wavy = noise._replace(growth=np.full(3, 3.0))
    assert next(h for h in range(1, 99) if are_faces("two faces", h, wavy)) == pytest.approx(3 * least, abs=3)
    large = next(h / 4 for h in range(1, 99) if are_faces("two faces", h / 4, noise, scale=4))
    assert large == pytest.approx(least / 4, abs=0.3)


def test_planes_and_a_quadric_are_compared_as_least_squares_does(rng):
    """Against NumPy's fits of one plane, of two, and of a quadric."""
    u, v, e = rng.normal(size=(3, 80))
    n, side = rng.integers(1, 17, 80).astype(float), rng.integers(0, 2, 80)
    terms = np.stack([np.ones(80), u, v, u * u, u * v, v * v], axis=1)
    every = np.column_stack([terms, e])

    def left(rows, count):
        a, root = terms[rows, :count], np.sqrt(n[rows])
        b = np.linalg.lstsq(a * root[:, None], e[rows] * root, rcond=None)[0]
        return float(np.sum(n[rows] * (e[rows] - a @ b) ** 2))

    both = np.ones(80, bool)
    planes = left(side == 0, PLANE_TERMS) + left(side == 1, PLANE_TERMS)
    products = np.stack([(every[side == k] * n[side == k, None]).T @ every[side == k] for k in (0, 1)])
    better, bend = split_faces.planes_fit_better(products)
    assert better == pytest.approx(left(both, TERMS) - planes)
    assert bend == pytest.approx(left(both, PLANE_TERMS) - planes)


@pytest.mark.parametrize(("columns", "several"), [(2, False), (20, True)])
def test_small_parts_do_not_make_several_faces_of_one(columns, several, noise):
    """Of a region with a large part and four more, turned by 20 degrees: of small ones noise makes as much."""
    part_of = np.repeat(np.arange(5), [60, *[columns] * 4])
    u, v = np.meshgrid(0.002 * np.arange(len(part_of)), 0.002 * np.arange(60))
    rays = np.stack([u, v, np.ones_like(u)], axis=-1)
    q = 0.5 + 0.5 * np.tan(np.radians(20.0)) * np.select([part_of == 0, part_of % 2 == 0], [0.0, u], -u)
    terms = np.stack([np.ones_like(u), u, v, q])
    parts = np.array([[(terms[i] * terms[j])[:, part_of == k].sum() for i, j in ORDER] for k in range(5)])
    joined = np.zeros((5, 10))
    joined[0] = parts.sum(axis=0)
    left = np.linalg.lstsq(rays.reshape(-1, 3), q.ravel())[1][0]
    noise = noise._replace(sigma=np.append(10.0, np.full(3, 0.5 * np.sqrt(left / q.size))))
    found = np.empty((3, 5), np.bool_)
    assert split_faces.find_doubtful(joined, parts, np.zeros(5, np.int64), noise, Rules(), *found) == several
    assert found[:2].tolist() == [[False] * 5, [several, *[False] * 4]]


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_part_is_ajar_only_if_noise_leaves_it_less(share, noise):
    """It is turned by eight degrees; its residuals about the rest's plane are ``share`` of those that count."""
    u, v = np.meshgrid(0.002 * np.arange(100), 0.002 * np.arange(60))
    of_rest, of_part = np.array([0.0, 0.0, 0.5]), 0.5 * np.array([-np.tan(np.radians(8.0)), 0.0, 1.0])
    is_part = u < u[0, 40]
    rays = np.stack([u, v, np.ones_like(u)], axis=-1)
    q = np.where(is_part, rays @ of_part, rays @ of_rest)
    terms = np.stack([np.ones_like(u), u, v, q])
    part, whole = (
        np.array([(terms[i][some] * terms[j][some]).sum() for i, j in ORDER]) for some in (is_part, is_part | True)
    )
    off = np.sqrt(np.mean((rays[is_part] @ (of_part - of_rest)) ** 2))
    sigma = np.append(10.0, np.full(3, off / (share * Rules().fit_deviations)))
    assert split_faces.is_ajar(part, of_part, whole, noise._replace(sigma=sigma), Rules()) == (share > 1.0)


@pytest.mark.parametrize(("sensor", "seed"), [(0, 50), (1, 13), (1, 17), (2, 13)])
def test_faces_of_small_blocks_are_no_curved_surface(sensor, seed):
    """They differ by little more than a sensor bends a plane: two to seven thousand pixels were left out."""
    sensor = block_scenes.SENSORS[sensor]
    depth, _ = block_scenes.measure(sensor, seed)
    assert np.count_nonzero(segment(depth, sensor.camera).reason == Reason.CURVED) < 100


@pytest.mark.parametrize(("sensor", "seed"), [(0, 74), (1, 28), (1, 65), (1, 73)])
def test_faces_that_meet_at_blunt_angles_are_apart(sensor, seed):
    """They are turned against each other by less than what counts as curved."""
    sensor = block_scenes.SENSORS[sensor]
    depth, truth = block_scenes.measure(sensor, seed)
    assert compare_labels(segment(depth, sensor.camera).labels, truth).hoover(0.8).under_segmented == 0


def test_pieces_along_edges_that_have_parts_of_two_faces_do_not_keep_these_together():
    sensor = replace(block_scenes.SENSORS[1], sigma=5.6e-3)
    depth, truth = block_scenes.measure(sensor, 34)
    assert compare_labels(segment(depth, sensor.camera).labels, truth).hoover(0.8).under_segmented == 0
