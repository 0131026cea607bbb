"""Uncertainties of planes in map coordinates are those near the origin."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rgbd_planes as rp
from rgbd_planes import uncertainty as un

PLACES = [(448252.0, 5411944.0, 113.0), (5e6, 4e6, 0.0), (3e6, -4e6, 1e5), (50e3, 0.0, 20.0)]


def motion(place, seed=1):
    made = np.eye(4)
    made[:3, :3] = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    made[:3, 3] = place
    return made


def back_again(transform):
    inverse = np.eye(4)
    inverse[:3, :3] = transform[:3, :3].T
    inverse[:3, 3] = -transform[:3, :3].T @ transform[:3, 3]
    return inverse


@pytest.fixture(scope="module")
def tiles():
    camera = rp.Camera(160, 120, 131.0, 131.0, 79.5, 59.5, depth_scale=1000.0, noise=rp.noise.kinect_v1())
    fits = rp.fit_tiles(rp.scenes.room().render(camera).measure(seed=1), camera, 20)
    planes, covariance = fits.planes[fits.fitted], fits.plane_covariance[fits.fitted]
    centres = -planes[:, 3:] * planes[:, :3]
    return planes, covariance, centres + 0.1


def moved(points, transform):
    return points @ transform[:3, :3].T + transform[:3, 3]


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("pose", [False, True])
def test_distances_far_from_the_origin(tiles, place, pose):
    planes, covariance, points = tiles
    spread = 1e-8 * np.diag([1.0, 2.0, 3.0, 100.0, 200.0, 300.0]) if pose else None
    near = motion((0.0, 0.0, 0.0))
    of_near = un.transform_planes(planes, covariance, near, spread)
    distance, std = un.point_distance(moved(points, near), *of_near)
    transform = motion(place)
    if pose:  # the error of the turn is about where the planes come from, in both
        shift = np.eye(4)
        shift[:3, 3] = place
        of_far = un.transform_planes(*of_near, shift)
    else:
        of_far = un.transform_planes(planes, covariance, transform)
    far_distance, far_std = un.point_distance(moved(points, transform), *of_far)
    np.testing.assert_allclose(far_distance, distance, atol=1e-7)
    np.testing.assert_allclose(far_std, std, rtol=1e-3)


@pytest.mark.parametrize("place", PLACES)
def test_comparisons_and_fusion_far_from_the_origin(tiles, place):
    planes, covariance, points = tiles
    transform = motion(place)
    far, far_covariance = un.transform_planes(planes, covariance, transform)
    beside = slice(None, -1), slice(1, None)
    near_p = un.same_plane(*(array[part] for part in beside for array in (planes, covariance)))
    far_p = un.same_plane(*(array[part] for part in beside for array in (far, far_covariance)))
    np.testing.assert_allclose(far_p, near_p, rtol=0.01, atol=1e-6)
    angle = un.angle_between(planes[:-1], covariance[:-1], planes[1:], covariance[1:])
    np.testing.assert_allclose(
        un.angle_between(far[:-1], far_covariance[:-1], far[1:], far_covariance[1:]), angle, rtol=1e-3, atol=1e-6
    )
    pairs = np.stack([planes[:1], planes[:1]], axis=1), np.stack([covariance[:1], covariance[:1]], axis=1)
    far_pairs = np.stack([far[:1], far[:1]], axis=1), np.stack([far_covariance[:1], far_covariance[:1]], axis=1)
    _, std = un.point_distance(points[:1], *un.fuse_planes(*pairs))
    _, far_std = un.point_distance(moved(points[:1], transform), *un.fuse_planes(*far_pairs))
    np.testing.assert_allclose(far_std, std, rtol=1e-3)


def test_there_and_back(tiles):
    planes, covariance, points = tiles
    transform = motion(PLACES[1])
    again = un.transform_planes(*un.transform_planes(planes, covariance, transform), back_again(transform))
    np.testing.assert_allclose(again[0], planes, atol=1e-8)
    _, std = un.point_distance(points, planes, covariance)
    np.testing.assert_allclose(un.point_distance(points, *again)[1], std, rtol=1e-3)


def test_covariances_that_have_lost_it_are_refused(tiles):
    planes, covariance, points = tiles
    transform = motion(PLACES[1])
    far, _ = un.transform_planes(planes, covariance, transform)
    linear = np.eye(4)
    linear[:3, :3] = transform[:3, :3]
    linear[3, :3] = -transform[:3, 3] @ transform[:3, :3]
    by_hand = linear @ covariance @ linear.T
    with pytest.raises(ValueError, match=r"expected planes near the origin, .* m from it"):
        un.point_distance(moved(points, transform), far, by_hand)


def test_near_the_origin_nothing_changes(tiles):
    planes, covariance, _ = tiles
    transform = motion((1.0, -2.0, 0.5))
    linear = np.eye(4)
    linear[:3, :3] = transform[:3, :3]
    linear[3, :3] = -transform[:3, 3] @ transform[:3, :3]
    found = un.transform_planes(planes, covariance, transform)[1]
    np.testing.assert_allclose(found, linear @ covariance @ linear.T, rtol=1e-9, atol=1e-16)
