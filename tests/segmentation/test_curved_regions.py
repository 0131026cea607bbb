"""Segmentation: small regions that bend are curved, and those that a sensor only seems to bend are planes."""

import numpy as np
import pytest
from scipy import ndimage

from bench.real_data import FOLDER
from bench.real_data import REASON as NO_FRAMES
from rgbd_planes import Camera, segment
from rgbd_planes._core.status import Reason
from rgbd_planes.kernels.segmentation.curved.curved import BENT_SHARE, find_curled, find_turns
from rgbd_planes.kernels.segmentation.model.boxes import boxes
from rgbd_planes.kernels.segmentation.model.moments import angle_between
from rgbd_planes.kernels.segmentation.model.planes import fit_regions
from rgbd_planes.kernels.segmentation.model.quadrics import (
    PLANE_TERMS,
    TERMS,
    eliminate,
    inner_pixels,
    second_derivatives,
    turn,
)
from rgbd_planes.kernels.segmentation.model.records import (
    BLOCK,
    EMPTY,
    MIXED,
    UNSEEN,
    Noise,
    Owners,
    Planes,
    Pyramid,
    Regions,
    Rules,
    Shares,
    View,
)
from rgbd_planes.segmentation.workspace import rays_of
from rgbd_planes.sequences import images

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
    owned = owned_of(labels, measured, rng)
    of_block = np.kron(owned.block, np.ones((BLOCK, BLOCK), int))[: CAMERA.height, : CAMERA.width]
    box = np.empty((3, 4), np.int64)
    boxes(owned.block, box)
    u, v = np.broadcast_arrays(CAMERA.tan_x, CAMERA.tan_y)
    for a in range(3):
        own = (labels == a) & (of_block == a) & measured
        inside = ndimage.binary_erosion(own)
        chosen = own if 2 * inside.sum() < own.sum() else inside
        pixels = np.full((4, own.sum() + 5), -1.0, np.float32)
        count = inner_pixels(owned, a, box, q, rays_of(CAMERA), pixels)
        assert count == chosen.sum() > 0
        expected = np.stack([np.ones_like(u), u, v, q], axis=-1)[chosen]
        expected = sorted(expected.astype(np.float32).tolist())
        assert sorted(pixels[:, :count].T.tolist()) == expected
        assert (pixels[:, count:] == -1.0).all()
        few = np.full((4, 11), -1.0, np.float32)  # more than there is room for are not written
        assert inner_pixels(owned, a, box, q, rays_of(CAMERA), few[:, :10]) <= 10
        assert (few[:, 10] == -1.0).all()


def is_curled(q, shape, sigma=SIGMA, together=1.0, has_blocks=True):
    """Whether a rectangle in the middle of the image, (rows, columns) large, is."""
    rows, columns = shape
    top, left = (CAMERA.height - rows) // 2, (CAMERA.width - columns) // 2
    labels = np.full(CAMERA.shape, -1)
    here = np.s_[top : top + rows, left : left + columns]
    labels[here] = 0
    depth = np.full(CAMERA.shape, 0.3)
    depth[here] = q
    owned = owned_of(labels, depth > 0.0, np.random.default_rng(0))
    if not has_blocks:
        owned.block[:] = -1
    box = np.empty((1, 4), np.int64)
    boxes(owned.block, box)
    u, v = (a[here].ravel() for a in np.broadcast_arrays(CAMERA.tan_x, CAMERA.tan_y))
    terms = np.stack([np.ones_like(u), u, v, q.ravel()])
    products = terms @ terms.T
    moments = products[np.triu_indices(4)][None].copy()
    noise = Noise(np.array([10.0, sigma, sigma, sigma]), 0.0, 0.0, 0.0, np.zeros((2, 0)), np.ones(3), together)
    planes = Planes(np.empty((1, 3)), np.empty(1), np.empty(1), np.empty(1), np.ones(1))
    fit_regions(moments, noise, planes)
    curved = np.zeros(1, np.bool_)
    pyramid = Pyramid(np.empty((10, 0)), np.empty(0), np.empty(0), np.empty(0, np.int64), np.empty((0, 2), np.int64))
    view = View(depth.astype(np.float32), rays_of(CAMERA), pyramid, noise, Rules(), np.empty(0))
    find_curled(view, owned._replace(moments=moments), box, planes, curved)
    return curved[0]


def parabola(shape, height, rng, sigma=SIGMA):
    """A part of a cylinder that is as high as ``height`` standard deviations, and its noise."""
    x = np.linspace(-1.0, 1.0, shape[1])
    return 1.0 + sigma * (height * x * x + rng.standard_normal(shape))


def test_small_regions_that_bend_are_curved(rng):
    shape = 40, 12
    for _ in range(20):
        assert not is_curled(parabola(shape, 0.0, rng), shape)
        assert not is_curled(parabola(shape, 3.0, rng), shape)  # a quadric takes a third
        assert is_curled(parabola(shape, 7.0, rng), shape)
        # Noise that was overestimated is no reason to keep it.
        assert is_curled(parabola(shape, 7.0, rng), shape, sigma=2.0 * SIGMA)


def test_what_may_be_the_sensors_is_no_curve(rng):
    shape = 24, 28
    bent = parabola(shape, 6.0, rng)
    assert is_curled(bent, shape)
    assert not is_curled(bent, shape, together=250.0)  # errors of 16 pixels each way are one
    fine = parabola(shape, 6.0, rng, sigma=1e-4)
    assert not is_curled(fine, shape, sigma=1e-4)  # by less than two degrees
    large = 34, 34
    assert not is_curled(parabola(large, 6.0, rng), large)


@pytest.mark.parametrize("off", [-6.0, 6.0])
def test_a_biased_rim_is_no_curve(off, rng):
    """Sensors smooth over edges, or see what is behind."""
    shape = 10, 10
    seen = parabola(shape, 0.0, rng)
    rim = ~ndimage.binary_erosion(np.ones(shape, bool))
    seen[rim] += off * SIGMA
    assert not is_curled(seen, shape)


def test_narrow_regions_are_judged_by_all_their_pixels(rng):
    shape = 3, 60
    assert is_curled(parabola(shape, 12.0, rng), shape)
    assert not is_curled(parabola(shape, 0.0, rng), shape)


def test_a_region_that_has_only_parts_of_others_blocks(rng):
    """Nothing is said of it."""
    shape = 24, 28
    assert not is_curled(parabola(shape, 6.0, rng), shape, has_blocks=False)


def test_the_normals_of_a_bent_region_turn_as_its_tangent_planes_do(rng):
    """Mean squared angle between those at its pixels, which lie along any diagonal, and its plane."""
    for _ in range(20):
        alpha, h = np.append(rng.uniform(-0.5, 0.5, 2), rng.uniform(0.4, 1.0)), rng.normal(size=3)
        middle, away = rng.uniform(-0.5, 0.5, 2), 0.01 * rng.normal(size=(500, 2)) @ rng.normal(size=(2, 2))
        away -= away.mean(axis=0)
        gradient = away @ h[[[0, 1], [1, 2]]]  # of q = α·(u, v, 1) + the quadratic form of half of h
        at_origin = -gradient @ middle - 0.5 * (gradient * away).sum(axis=1)
        tangents = alpha + np.column_stack([gradient, at_origin])
        expected = np.mean([angle_between(tangent, alpha) ** 2 for tangent in tangents])
        terms = np.column_stack([np.ones(500), middle + away, np.zeros(500)])
        moments = (terms.T @ terms)[np.triu_indices(4)]
        assert turn(moments, alpha, tuple(h)) == pytest.approx(expected, rel=0.1)


def test_second_derivatives_are_those_of_the_quadric_that_fits_best(rng):
    """Against NumPy's fit to points along a diagonal, of which the squares go with the product."""
    u, v = rng.normal(size=(2, 2)) @ rng.normal(size=(2, 80))
    q, scale, deviation = rng.normal(size=80), 0.5, 3.0
    *_, uu, uv, vv = np.linalg.lstsq(np.stack([np.ones(80), u, v, u * u, u * v, v * v], axis=1), q)[0]
    x, y = u / scale, v / scale
    every = np.stack([np.ones(80), x, y, x * x, x * y, y * y, q / deviation])
    products = every @ every.T
    eliminate(products, 0, PLANE_TERMS)
    eliminate(products, PLANE_TERMS, TERMS)
    assert second_derivatives(products, scale, deviation) == pytest.approx((2.0 * uu, uv, 2.0 * vv))


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
    means = np.stack([np.full_like(u, 16.0), u, v, q]).astype(np.float32)
    region = np.full(q.shape, 0, np.int32)
    region[:, cut:] = 1
    terms = [np.stack([np.ones(here.sum()), u[here], v[here], q[here]]) for here in (region == 0, region == 1)]
    moments = 16.0 * np.stack([(of @ of.T)[np.triu_indices(4)] for of in terms])
    noise = Noise(np.array([10.0, SIGMA, SIGMA, SIGMA]), 0.0, 0.0, 0.0, np.zeros((2, 0)), np.ones(3), 1.0)
    planes = Planes(np.empty((2, 3)), np.empty(2), np.empty(2), np.empty(2), np.ones(1))
    fit_regions(moments, noise, planes)
    box = np.empty((2, 4), np.int64)
    boxes(region, box)
    turned, bending, bent = np.empty(2), np.empty(2), np.empty(2, np.bool_)
    find_turns(region, means, moments, planes, noise.sigma, Rules(), box, turned, bending, bent)
    return np.sqrt(bending).sum(), angle_between(*planes.alpha)


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
