"""Segmentation: regions that bend are curved, and those that a sensor only seems to bend are planes."""

import numpy as np
import pytest

from bench.real_data import FOLDER
from bench.real_data import REASON as NO_FRAMES
from rgbd_planes import Camera, segment
from rgbd_planes._core.status import Reason
from rgbd_planes.kernels.segmentation.curved.curved import BENT_SHARE
from rgbd_planes.kernels.segmentation.model.moments import angle_between
from rgbd_planes.kernels.segmentation.model.planes import fit_planes
from rgbd_planes.kernels.segmentation.model.quadrics import PLANE_TERMS, TERMS, add_blocks, extent, residuals, turn
from rgbd_planes.sequences import images

SIGMA = 1e-3


def test_what_a_plane_and_a_quadric_leave_is_what_numpys_leave(rng):
    """Of points along a diagonal, of which the squares go with the product."""
    u, v = rng.normal(size=(2, 2)) @ rng.normal(size=(2, 80))
    n, e = rng.integers(1, 17, 80).astype(float), rng.normal(size=80)
    every = np.stack([np.ones(80), u, v, u * u, u * v, v * v, e])
    for count, left in zip((PLANE_TERMS, TERMS), residuals((n * every) @ every.T), strict=True):
        weighted = np.sqrt(n) * every
        expected = np.linalg.lstsq(weighted[:count].T, weighted[TERMS])[1][0]
        assert left == pytest.approx(expected)


def test_the_normals_of_a_bent_region_turn_as_its_tangent_planes_do(rng):
    """Mean squared angle between those at its pixels, which lie along any diagonal, and its plane."""
    for _ in range(20):
        alpha, h = np.append(rng.uniform(-0.5, 0.5, 2), rng.uniform(0.4, 1.0)), rng.normal(size=3)
        middle, away = rng.uniform(-0.5, 0.5, 2), 0.01 * rng.normal(size=(500, 2)) @ rng.normal(size=(2, 2))
        away -= away.mean(axis=0)
        gradient = away @ h[[[0, 1], [1, 2]]]  # of q = α·(u, v, 1) + the quadratic form of half of h
        bend = 0.5 * (gradient * away).sum(axis=1)
        tangents = alpha + np.column_stack([gradient, -gradient @ middle - bend])
        expected = np.mean([angle_between(tangent, alpha) ** 2 for tangent in tangents])
        terms = np.column_stack([np.ones(500), middle + away, np.zeros(500)])
        moments = (terms.T @ terms)[np.triu_indices(4)]
        x, y = (away / extent(moments)).T
        every = np.stack([np.ones(500), x, y, x * x, x * y, y * y, bend])
        products = every @ every.T
        residuals(products)
        assert turn(products, moments, alpha) == pytest.approx(expected, rel=0.1)


def on_column(radius, side):
    """How much of a square before a wall, part of a column one metre away, is curved, in eight noisy frames."""
    camera = Camera(160, 120, 131.0, 131.0, 79.5, 59.5)
    rows, columns = (np.s_[(n - side) // 2 : (n + side) // 2] for n in camera.shape)
    x, far = camera.tan_x[0, columns], 1.0 + radius
    q = np.full(camera.shape, 0.5)
    q[rows, columns] = 1.0
    if np.isfinite(radius):
        a, c = x * x + 1.0, far**2 - radius**2
        q[rows, columns] = (far + np.sqrt(far**2 - a * c)) / c
    shares = []
    for seed in range(8):
        noise = SIGMA * np.random.default_rng(seed).standard_normal(camera.shape)
        found = segment(1.0 / (q + noise), camera)
        assert (found.labels[:40] > 0).all()
        shares.append((found.reason[rows, columns] == Reason.CURVED).mean())
    return np.array(shares)


def test_a_small_thing_that_bends_is_no_plane():
    assert np.count_nonzero(on_column(1.15, 28) > 0.9) >= 3
    assert not on_column(np.inf, 28).any()


def test_a_small_part_that_bends_and_goes_on_is_no_plane():
    """By itself neither of the two parts bends by more than noise."""
    assert np.count_nonzero(on_column(0.8, 24) > 0.4) >= 2
    assert not on_column(np.inf, 24).any()


def turns_and_angle(q, cut):
    """By how much the surface turns within its two parts, left and right of a column of blocks, and between them."""
    rows, columns = q.shape
    u, v = np.meshgrid(0.02 * np.arange(columns), 0.02 * np.arange(rows))
    means = np.stack([np.full_like(u, 16.0), u, v, q], axis=-1).astype(np.float32)
    region = np.full(q.shape, 0, np.int32)
    region[:, cut:] = 1
    terms = [np.stack([np.ones(here.sum()), u[here], v[here], q[here]]) for here in (region == 0, region == 1)]
    moments = 16.0 * np.stack([(of @ of.T)[np.triu_indices(4)] for of in terms])
    alpha = np.empty((2, 3))
    fit_planes(moments, alpha, np.empty(2))
    turns = 0.0
    for a in range(2):
        products = np.zeros((TERMS + 1, TERMS + 1))
        add_blocks(region, means, a, np.array([0, rows, 0, columns]), 1, moments[a], alpha[a], products)
        residuals(products)
        turns += np.sqrt(turn(products, moments[a], alpha[a]))
    return turns, angle_between(*alpha)


@pytest.mark.parametrize("cut", [3, 6, 12, 20, 22])
def test_the_parts_of_an_arc_turn_within_themselves_and_faces_do_not(cut):
    q = np.broadcast_to(1.0 + 0.5 * (0.02 * (np.arange(25.0) - 12.0)) ** 2, (10, 25))
    turns, angle = turns_and_angle(q, cut)
    assert turns == pytest.approx(2.0 * BENT_SHARE * angle, rel=0.15)
    turns, angle = turns_and_angle(
        np.broadcast_to(1.0 + 0.5 * np.maximum(0.02 * (np.arange(25.0) - cut), 0.0), q.shape), cut
    )
    assert angle > 0.2
    assert turns < 0.1 * BENT_SHARE * angle


@pytest.mark.skipif(not FOLDER.is_dir(), reason=NO_FRAMES)
def test_the_seat_of_a_chair_and_its_side_are_two_planes():
    folder = FOLDER / "kinect1_7scenes_seq"
    depth = images.read_depth(sorted((folder / "depth").glob("*.png"))[3])
    found = segment(depth, Camera.load(folder / "camera.json"))
    seat, side = found.labels[255, 210], found.labels[290, 200]
    assert seat > 0
    assert side not in (0, seat)


WIDE = Camera(320, 240, 262.0, 262.0, 159.5, 119.5)


def round_wall(radius):
    """Inverse depths of a vertical cylinder, seen from outside if ``radius`` is positive, and where it is seen."""
    u = np.broadcast_to(WIDE.tan_x, WIDE.shape)
    a, b = u * u + 1.0, (2.2 if radius > 0.0 else 4.0) + radius
    root = b * b - a * (b * b - radius**2)
    is_seen = root > 0.0
    z = (b - np.sign(radius) * np.sqrt(np.where(is_seen, root, 0.0))) / a
    return np.where(is_seen, 1.0 / z, 0.0), is_seen


def pole(tilt=0.0, middle=185.0, half_width=11.0):
    """Where an upright pole is seen, or a tilted one."""
    row, column = np.indices(WIDE.shape)
    return np.abs(column - middle - tilt * (row - 119.5)) < half_width


def on_planes(q, is_wall, noise=1.4e-3):
    """The share of the wall that is on planes."""
    noisy = q + noise * np.random.default_rng(1).standard_normal(q.shape)
    found = segment(np.where(q > 0.0, 1.0 / np.where(q > 0.0, noisy, 1.0), 0.0), WIDE)
    return np.mean(found.labels[is_wall] > 0)


@pytest.mark.parametrize("radius", [2.6, -2.6, -4.0])
def test_a_round_wall_is_no_plane(radius):
    assert on_planes(*round_wall(radius)) < 0.02


@pytest.mark.parametrize("degrees", [4.0, 8.0, 20.0])
def test_a_pole_in_front_of_a_corner_leaves_two_walls(degrees):
    edge, slope = (185.0 - 159.5) / 262.0, np.tan(np.radians(degrees))
    q = 0.4 - 0.4 * slope * np.maximum(np.broadcast_to(WIDE.tan_x, WIDE.shape) - edge, 0.0)
    here = pole()
    assert on_planes(np.where(here, 0.7, q), ~here) > 0.98
