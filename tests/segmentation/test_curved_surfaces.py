"""Segmentation: the pixels that are curved, as connected surfaces."""

from dataclasses import replace

import numpy as np
import pytest
from curved_frames import ball, inverse_depth_of_quadric, pipe, rays_of
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from rgbd_planes import Camera, Reason, Segmentation, segment
from rgbd_planes.kernels.segmentation.curved.surfaces import DEVIATIONS, STEEPEST, number_surfaces
from rgbd_planes.kernels.segmentation.model.records import Noise, Pyramid, Rules, View, plain
from rgbd_planes.segmentation.workspace import rays_of as kernel_rays

CAMERA = Camera(320, 240, 262.5, 262.5, 159.5, 119.5)
LENS = replace(CAMERA, width=60, height=50, cx=29.5, cy=24.5, fx=40.0, fy=40.0, distortion=(0.1, -0.05, 0.0, 0.0, 0.0))
SIGMA = 2e-3


def expected_surfaces(q, is_curved, camera, least):
    """The same by SciPy: a graph of pixels."""
    ray, height, width = rays_of(camera), *q.shape
    number, pairs = np.arange(q.size).reshape(q.shape), []
    for y, x in zip(*np.nonzero(is_curved), strict=True):
        pitch = np.linalg.norm(ray[y, x] - ray[max(y - 1, 0), max(x - 1, 0)])
        most = STEEPEST * q[y, x] * pitch + DEVIATIONS * SIGMA
        for other in ((y, x - 1), (y - 1, x - 1), (y - 1, x), (y - 1, x + 1)):
            inside = other[0] >= 0 and 0 <= other[1] < width
            if inside and is_curved[other] and abs(q[other] - q[y, x]) <= most:
                pairs.append((number[y, x], number[other]))
    rows, columns = np.array(pairs).T
    graph = coo_array((np.ones(len(pairs)), (rows, columns)), shape=(q.size, q.size))
    part = connected_components(graph, directed=False)[1].reshape(height, width)
    labels, count = np.zeros(q.shape, np.int32), 0
    for y, x in zip(*np.nonzero(is_curved), strict=True):
        here = is_curved & (part == part[y, x])
        if labels[y, x] == 0 and here.sum() >= least:
            count += 1
            labels[here] = count
    return labels


@pytest.mark.parametrize("camera", [LENS, replace(LENS, distortion=())], ids=["lens", "pinhole"])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_surfaces_are_the_connected_parts_of_a_graph(camera, share, rng):
    is_curved = rng.random(camera.shape) < share
    q = rng.uniform(0.5, 2.5, camera.shape).astype(np.float32)
    noise = Noise(np.array([10.0, SIGMA, SIGMA, SIGMA]), 0.0, 0.0, 0.0, np.zeros((2, 0)), np.ones(3), 1.0)
    pyramid = Pyramid(np.empty((10, 0)), np.empty(0), np.empty(0), np.empty(0, np.int64), np.empty((0, 2), np.int64))
    view = plain(View(q, kernel_rays(camera._lens), pyramid, noise, Rules(), np.empty(0)))
    surface = np.full(camera.shape, -1, np.int32)
    for least in (1, 4):
        number_surfaces(view, np.where(is_curved, 6, 2).astype(np.uint8), np.uint8(6), least, surface)
        expected = expected_surfaces(q, is_curved, camera, least)
        assert expected.max() > 2
        np.testing.assert_array_equal(surface, expected)


def bodies(*quadrics, camera=CAMERA, far=0.4):
    """Depth of a wall with curved things before it, and which pixel sees which."""
    q, label = np.full(camera.shape, far), np.zeros(camera.shape, int)
    for i, (matrix, centre) in enumerate(quadrics, 1):
        its = inverse_depth_of_quadric(rays_of(camera), matrix, centre)
        nearer = its > q
        q[nearer], label[nearer] = its[nearer], i
    q = q + 1e-3 * np.random.default_rng(0).standard_normal(camera.shape)
    return 1.0 / q, label


def test_a_ball_before_another_is_a_surface_of_its_own():
    depth, truth = bodies(
        ball((0.1, 0.0, 1.6), 0.3), ball((-0.1, 0.05, 1.1), 0.15), pipe((0.65, 0.0, 1.8), (0, 1, 0), 0.2)
    )
    found = segment(depth, CAMERA)
    assert found.curved_labels.dtype == np.int32
    assert found.curved_labels.max() == 3
    firsts = [np.flatnonzero(found.curved_labels == label)[0] for label in (1, 2, 3)]
    assert firsts == sorted(firsts)
    for label in (1, 2, 3):
        pixels = truth[found.curved_labels == label]
        most = np.bincount(pixels).argmax()
        assert most > 0
        assert np.mean(pixels == most) > 0.98
        assert len(pixels) > 0.7 * np.count_nonzero(truth == most)
    assert (found.reason[found.curved_labels > 0] == Reason.CURVED).all()


def test_specks_are_left_out():
    depth, _ = bodies(ball((0.1, 0.0, 1.6), 0.3), ball((-0.45, 0.05, 1.6), 0.12))
    sizes = np.bincount(segment(depth, CAMERA).curved_labels.ravel())[1:]
    assert len(sizes) == 2
    larger = segment(depth, CAMERA, min_size=int(sizes.min()) + 1)
    assert larger.curved_labels.max() == 1
    assert np.count_nonzero(larger.curved_labels) == sizes.max()


def test_a_frame_of_planes_has_none():
    depth, _ = bodies()
    found = segment(depth, CAMERA)
    assert found.curved_labels.shape == CAMERA.shape
    assert not found.curved_labels.any()


def test_files_hold_them_and_those_of_earlier_versions_none(tmp_path):
    depth, _ = bodies(ball((0.1, 0.0, 1.6), 0.3))
    found = segment(depth, CAMERA)
    assert found.curved_labels.any()
    found.save(tmp_path / "found.npz")
    np.testing.assert_array_equal(Segmentation.load(tmp_path / "found.npz").curved_labels, found.curved_labels)
    with np.load(tmp_path / "found.npz") as saved:
        arrays = dict(saved)
    np.savez(tmp_path / "wrong.npz", **arrays | {"curved_labels": found.curved_labels - np.int32(1)})
    with pytest.raises(ValueError, match=r"not a file that Segmentation\.save wrote"):
        Segmentation.load(tmp_path / "wrong.npz")
    del arrays["curved_labels"]
    np.savez(tmp_path / "earlier.npz", **arrays)
    assert not Segmentation.load(tmp_path / "earlier.npz").curved_labels.any()
