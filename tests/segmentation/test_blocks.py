"""Segmentation: moments of blocks of pixels, of squares and of labels, against plain NumPy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from segment_frames import CAMERA, blocks_and_squares, inside

from rgbd_planes import Camera, segment
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.evaluation import scenes
from rgbd_planes.kernels.segmentation.blocks.pyramid import read_frame
from rgbd_planes.kernels.segmentation.blocks.quadtree import find_planar
from rgbd_planes.kernels.segmentation.components.labels import leave_out, settle_strays
from rgbd_planes.kernels.segmentation.merge.merge import number_regions
from rgbd_planes.kernels.segmentation.model.records import BLOCK, Rays, Reasons, Rules, plain
from rgbd_planes.kernels.segmentation.refit.interior import interior_moments
from rgbd_planes.segmentation.frame_noise import noise_of
from rgbd_planes.segmentation.segment import _given
from rgbd_planes.segmentation.workspace import Workspace, rays_of


@pytest.mark.parametrize("holes", [0.05, 0.6])
def test_four_squares_are_one_plane_if_joining_them_adds_little(holes):
    rays, work, rules = rays_of(CAMERA), Workspace(CAMERA), Rules()
    frame = as_depth_frame(scenes.room().render(CAMERA).measure(holes=holes, seed=3), CAMERA)
    nearest = read_frame(*frame.values, rays, work.inverse_depth, work.pyramid)
    noise, _ = noise_of(frame, 1.0, rays, work.pyramid, nearest, _given(None))
    moments, rss, slope_square, offsets, shapes = work.pyramid
    sensor, state = np.empty(offsets[1]), np.empty(len(rss), np.int8)
    find_planar(work.pyramid, noise, rules, sensor, state)

    n, entries = moments[0], noise.sigma[1:]
    q = moments[3] / np.maximum(n, 1.0)
    variance = np.interp(q, noise.sigma[0] * np.arange(len(entries)), entries) ** 2
    lateral = noise.lateral_variance * slope_square
    allowed = (n - 3.0) * (rules.fit_deviations**2 * variance + rules.steep_share**2 * lateral)
    expected = np.where((n < 6.0) | (rss < 0.0), 2, rss <= allowed)
    of_square = variance + lateral
    for level in range(1, len(shapes)):
        rows, columns = shapes[level]
        for i in range(rows * columns):
            row, column = divmod(i, columns)
            first, below = offsets[level - 1] + 4 * row * columns + 2 * column, 2 * columns
            parts = np.array([first, first + 1, first + below, first + below + 1])
            planar, k = parts[expected[parts] == 1], offsets[level] + i
            if (expected[parts] == 0).any():
                expected[k] = 0
            elif len(planar) == 0:
                expected[k] = 2
            else:
                most = of_square[planar].min() * (n[k] + rules.joint_variances)
                expected[k] = rss[k] >= 0.0 and rss[k] - rss[planar].sum() <= most
    assert sensor == pytest.approx(variance[: offsets[1]])
    assert (state == expected).all()
    assert {*state} == {0, 1, 2}


@pytest.mark.parametrize("distortion", [(), (0.1, -0.05, 0.001, -0.001, 0.01)])
def test_moments_of_blocks_and_squares(distortion):
    # 83 blocks in a row: the second stretch that is worked on together ends beyond the frame.
    camera = Camera(330, 37, 300.0, 310.0, 160.0, 20.0, distortion, depth_scale=1000.0)
    rng = np.random.default_rng(2)
    depth = np.where(rng.random(camera.shape) < 0.2, 0, rng.integers(500, 4000, camera.shape)).astype(np.uint16)
    q, pyramid, nearest = blocks_and_squares(depth, camera)
    expected = np.divide(1000.0, depth, out=np.zeros(camera.shape), where=depth > 0)
    np.testing.assert_allclose(q, expected, rtol=1e-6)
    assert nearest == q.max()

    valid = depth > 0
    u, v = camera.tan_x, camera.tan_y
    q64 = q.astype(np.float64)
    pixels = np.stack([valid, u, v, q64, u * u, u * v, u * q64, v * v, v * q64, q64 * q64]) * valid
    moments, rss, _, offsets, shapes = pyramid
    for level, (rows, columns) in enumerate(shapes):
        side = BLOCK << level
        padded = np.zeros((10, rows * side, columns * side))
        padded[:, :37, :330] = pixels
        sums = padded.reshape(10, rows, side, columns, side).sum(axis=(2, 4)).reshape(10, -1)
        own = slice(offsets[level], offsets[level + 1])
        np.testing.assert_allclose(moments[:, own], sums, rtol=1e-12, atol=1e-12)
    first = pixels[:, :4, :4].reshape(10, -1)
    rays = np.stack([first[1], first[2], first[0]], axis=1)
    residual = first[3] - rays @ np.linalg.lstsq(rays, first[3], rcond=None)[0]
    np.testing.assert_allclose(rss[0], residual @ residual, rtol=1e-6)


@pytest.mark.parametrize(("width", "height"), [(5, 7), (7, 5), (9, 6), (50, 2), (2, 50)])
def test_blocks_end_where_the_image_does(width, height):
    camera = Camera(width, height, 10.0, 10.0, width / 2, height / 2)
    depth = np.full(camera.shape, 2.0)
    found = segment(depth, camera, min_size=20)
    assert len(found) == (min(width, height) > 4)
    assert segment(depth, camera, min_size=20).sigma == found.sigma


def test_planes_of_a_room_are_the_fit_of_their_pixels(room):
    # What the last round gives to each plane adds up to its pixels.
    depth = room[1]
    found = segment(depth, CAMERA)
    assert found.sizes.tolist() == np.bincount(found.labels.ravel())[1:].tolist()
    q = np.divide(1000.0, depth, out=np.zeros(depth.shape), where=depth > 0)
    surely = inside(found.labels, depth > 0)
    for i in np.flatnonzero(found.sizes > 500):
        own = surely & (found.labels == i + 1)
        rays = np.stack([CAMERA.tan_x[own], CAMERA.tan_y[own], np.ones(own.sum())], axis=1)
        alpha = np.linalg.lstsq(rays, q[own], rcond=None)[0]
        deviation = np.sqrt(np.diag(found.alpha_covariance[i]))
        assert np.all(np.abs(found.alpha[i] - alpha) < deviation)  # strays are in no fit


@settings(max_examples=60)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 2**32 - 1), st.booleans(), st.floats(0.0, 0.5))
def test_pixels_inside_are_those_whose_neighbours_are_alike(height, width, seed, distorted, holes):
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 4, (height // 7 + 1, width // 9 + 1)).astype(np.int32)
    labels = np.kron(coarse, np.ones((7, 9), np.int32))[:height, :width]
    q = np.where(rng.random(labels.shape) < holes, 0.0, rng.uniform(0.2, 1.0, labels.shape)).astype(np.float32)
    labels[q == 0.0] = 0
    u, v = rng.normal(size=(1, width)), rng.normal(size=(height, 1))
    if distorted:
        u, v = u + rng.normal(size=labels.shape), v + rng.normal(size=labels.shape)
    q64, (all_u, all_v) = q.astype(np.float64), np.broadcast_arrays(u, v)
    ones = np.ones(labels.shape)
    terms = [ones, all_u, all_v, q64, all_u**2, all_u * all_v, all_u * q64, all_v**2, all_v * q64, q64**2]

    def moments(pixels):
        return np.array([term[pixels].sum() for term in terms])

    everything = np.array([moments(labels == label) for label in (1, 2, 3)])
    found = np.empty_like(everything)
    missing, unclaimed = np.uint8(1), np.uint8(2)
    reason = np.where(q > 0.0, np.where(labels > 0, 0, unclaimed), missing).astype(np.uint8)
    rays = Rays(u, v, u, v, 0.0, 0.0, np.empty((2, 0)), np.ones(1))
    edges = np.empty(labels.size, np.int32)
    count = interior_moments(labels, reason, missing, q, rays, everything, found, edges)
    surely = inside(labels, q > 0.0)
    np.testing.assert_array_equal(edges[:count], np.flatnonzero((labels > 0) & ~surely))
    for label, all_of_it, row in zip((1, 2, 3), everything, found, strict=True):
        own = surely & (labels == label)
        if own.sum() < max(3, 0.5 * all_of_it[0]):
            np.testing.assert_array_equal(row, all_of_it)
            continue
        spread = np.cov(all_u[own], all_v[own])
        if np.linalg.det(spread) > 1e-4 * spread[0, 0] * spread[1, 1] > 1e-12:  # else they may determine no plane
            np.testing.assert_allclose(row, moments(own), rtol=1e-9, atol=1e-9)


REASONS = plain(Reasons(*np.arange(7, dtype=np.uint8)))
UNCLAIMED, MISSING = Reasons._fields.index("unclaimed"), Reasons._fields.index("missing")


def settled(label, reason, least=1000):
    """Settle the strays, and what is alone in labels of more than ``least`` pixels; returns the sizes of the labels."""
    sizes = np.bincount(label.ravel()).astype(np.int32)
    edges = np.flatnonzero((label > 0) & ~inside(label, reason != REASONS[MISSING])).astype(np.int32)
    is_stray = np.isin(reason, [Reasons._fields.index(why) for why in ("unclaimed", "small", "narrow")])
    is_stray[[0, -1]] = is_stray[:, [0, -1]] = False
    places, strays = np.empty(label.size, np.int32), np.flatnonzero(is_stray)
    places[: len(strays)] = strays
    settle_strays(REASONS, least, label, reason, sizes, edges, places, len(strays))
    return sizes


def test_pixels_at_the_rim_of_the_image_get_no_label_from_its_other_side():
    """Of five without a label the one that has eight neighbours gets theirs."""
    label, reason = np.ones((8, 12), np.int32), np.zeros((8, 12), np.uint8)
    loose = [0, 7, 3, 3, 3], [5, 5, 0, 11, 5]
    label[loose], reason[loose] = 0, UNCLAIMED
    sizes = settled(label, reason)
    assert label[loose].tolist() == [0, 0, 0, 0, 1]
    assert (reason[loose] == UNCLAIMED).tolist() == [True] * 4 + [False]
    assert sizes[1] == 92


@pytest.mark.parametrize("why", ["unclaimed", "small", "narrow", "curved", "missing"])
def test_a_pixel_gets_the_label_that_five_of_the_eight_around_it_have(why):
    """One after the other, but no more than two in a row; what is curved or missing gets none."""
    label = np.zeros((12, 16), np.int32)
    label[1, 1:4] = label[2, 1] = label[3, 1] = 1  # five around (2, 2)
    label[1, 7:10] = label[2, 7] = 1  # four around (2, 8)
    label[7, 3:8] = label[8, 3] = label[9, 5] = 2  # five around (8, 4), and four around the two pixels beside it
    is_stray = why not in ("curved", "missing")
    reason = np.where(label > 0, 0, Reasons._fields.index("curved")).astype(np.uint8)
    loose = [2, 2, 8, 8, 8], [2, 8, 4, 5, 6]
    reason[loose] = Reasons._fields.index(why)
    sizes = settled(label, reason)
    assert label[loose].tolist() == ([1, 0, 2, 2, 0] if is_stray else [0] * 5)
    assert (reason[loose] == 0).tolist() == (label[loose] > 0).tolist()
    assert sizes[1:].tolist() == ([10, 9] if is_stray else [9, 7])


@pytest.mark.parametrize(
    ("around", "alone"),
    [
        ("bab bab bbb", True),
        ("aab aab bbb", False),
        ("--a -a- -ab", False),  # of one label there are more than of others
        ("--a -ab -ab", False),
        ("-ba -ab -bb", True),
    ],
)
@pytest.mark.parametrize("least", [3, 1000])
def test_pixels_are_alone_among_few_of_their_label_and_more_others(around, alone, least):
    seen = np.array([list(line) for line in around.split()])
    label, reason = np.full((9, 10), 3, np.int32), np.zeros((9, 10), np.uint8)
    label[1:6, 2:7] = 1
    label[2:5, 3:6] = np.choose((seen == "a") + 2 * (seen == "-"), [1, 3, 0])
    reason[2:5, 3:6] = np.where(seen == "-", Reasons._fields.index("missing"), 0)
    settled(label, reason, least)
    assert (label[3, 4] == 3) == (not alone or least == 1000)


def test_planes_that_are_left_keep_what_is_theirs():
    """When smaller ones before them are left out, of which some have several parts."""
    moments, deviation = np.arange(40.0).reshape(4, 10), np.array([0.1, 0.2, 0.3, 0.4])
    moments[:, 0] = 50.0, 10.0, 30.0, 29.0
    before = moments.copy()
    number, why = np.array([2, 1, 3, 0, 2, 4], np.int32), np.array([0, 0, 0, 5, 0, 0], np.uint8)
    assert leave_out(30, np.uint8(7), number, why, moments, deviation) == 2
    assert number.tolist() == [0, 1, 2, 0, 0, 0]
    assert why.tolist() == [7, 0, 0, 5, 7, 7]
    np.testing.assert_array_equal(moments[:2], before[[0, 2]])
    assert deviation[:2].tolist() == [0.1, 0.3]


def test_regions_are_numbered_by_the_one_that_they_went_into():
    """Without those of too few pixels, and whatever those have become."""
    parent, number, moments = np.array([0, 0, 2, 3, 3, 5]), np.empty(6, np.int64), np.arange(60.0).reshape(6, 10)
    moments[:, 0] = 20.0, 99.0, 9.0, 10.0, 99.0, 30.0
    before = moments.copy()
    assert number_regions(parent, moments, 10.0, number) == 3
    assert number.tolist() == [0, 0, -1, 1, 1, 2]
    np.testing.assert_array_equal(moments[:3], before[[0, 3, 5]])
