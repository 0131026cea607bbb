"""Solids and round things of rendered scenes, against their equations and what geometry books say of them."""

import numpy as np
import pytest

from rgbd_planes.camera.camera import Camera
from rgbd_planes.evaluation import scenes

CAMERA = Camera(161, 121, 100.0, 100.0, 80.000001, 60.000001)  # no ray across a cylinder
WALL = scenes.polygon("wall", [(-9, -9, 5), (9, -9, 5), (9, 9, 5), (-9, 9, 5)])


def seen(*surfaces):
    """Depth, labels and curved labels of things before a wall."""
    rendering = scenes.Scene((WALL, *surfaces), np.eye(4)).render(CAMERA)
    return rendering.depth, rendering.labels, rendering.curved_labels


def test_an_ellipsoid_is_where_its_equation_says():
    depth, labels, curved = seen(scenes.ellipsoid("ball", (0.0, 0.0, 3.0), (0.5, 0.4, 1.0)))
    assert (depth[60, 80], labels[60, 80], curved[60, 80]) == (pytest.approx(2.0), 0, 1)
    x, y = CAMERA.tan_x * depth, CAMERA.tan_y * depth
    inside = (x / 0.5) ** 2 + (y / 0.4) ** 2 + (depth - 3.0) ** 2
    assert np.abs(inside[curved == 1] - 1.0).max() < 1e-9
    np.testing.assert_array_equal(labels, 1 - curved)
    np.testing.assert_allclose(depth[labels == 1], 5.0)
    assert inside[labels == 1].min() > 1.0


def test_a_body_turns_about_the_vertical():
    turned, _, _ = seen(scenes.ellipsoid("ball", (0.0, 0.0, 3.0), (0.5, 0.4, 1.0), turn=90.0))
    assert turned[60, 80] == pytest.approx(2.5)
    turned, _, _ = seen(scenes.ellipsoid("ball", (0.0, 0.0, 3.0), (1.0, 0.2, 0.2), turn=30.0))
    assert turned[60, 105] < turned[60, 80] < turned[60, 60] < 5.0  # whose right end comes nearer
    cos, sin, x, y, off = 0.75**0.5, 0.5, CAMERA.tan_x * turned, CAMERA.tan_y * turned, turned - 3.0
    square = (cos * x - sin * off) ** 2 + (y / 0.2) ** 2 + ((sin * x + cos * off) / 0.2) ** 2
    np.testing.assert_allclose(square[turned < 4.9], 1.0)


def test_a_cylinder_ends_where_it_is_said_to():
    upright, _, curved = seen(*scenes.cylinder("column", (0.0, 0.0, 3.0), 0.5, 1.0))
    assert upright[60, 80] == pytest.approx(2.5)
    rows = np.flatnonzero(curved[:, 80])
    assert np.abs(2.5 * CAMERA.tan_y[rows, 80]).max() == pytest.approx(0.5, abs=0.03)
    lying, _, _ = seen(*scenes.cylinder("roll", (0.0, 0.0, 3.0), 0.5, 1.0, lying=True))
    assert (lying[60, 80], lying[40, 80] > 2.5, lying[60, 61]) == (pytest.approx(2.5), True, pytest.approx(2.5))
    below, labels, _ = seen(*scenes.cylinder("column", (0.0, 1.0, 3.0), 0.5, 1.0))  # whose upper end is at y = 0.5
    end = labels == 2
    assert np.count_nonzero(end) > 20
    np.testing.assert_allclose((CAMERA.tan_y * below)[end], 0.5)
    assert np.hypot((CAMERA.tan_x * below)[end], below[end] - 3.0).max() <= 0.5


def test_what_narrows_and_has_no_ends_shows_its_inside():
    depth, labels, curved = seen(*scenes.cylinder("lampshade", (0.0, 1.0, 3.0), 0.5, 1.0, top=0.5, ends=False))
    here = curved == 1
    assert set(np.unique(labels)) == {0, 1}
    x, y, z = CAMERA.tan_x[here] * depth[here], CAMERA.tan_y[here] * depth[here], depth[here] - 3.0
    np.testing.assert_allclose(np.hypot(x, z), 0.375 + 0.25 * (y - 1.0))
    assert (z > 0.1).any()  # its far side, through the opening
    assert y.min() >= 0.5


def test_what_is_hidden_or_behind_the_camera_is_not_seen():
    for hidden in (
        (scenes.ellipsoid("ball", (0.0, 0.0, 7.0), (0.5, 0.5, 0.5)),),
        (scenes.ellipsoid("ball", (0.0, 0.0, -3.0), (0.5, 0.5, 0.5)),),
        scenes.cylinder("column", (0.0, 1.0, -3.0), 0.5, 1.0),
    ):
        depth, labels, curved = seen(*hidden)
        np.testing.assert_allclose(depth, 5.0)
        assert (labels == 1).all()
        assert not curved.any()


def test_a_camera_on_a_ball_sees_its_far_side():
    """One root of the equation is at infinity."""
    depth, _, curved = seen(scenes.ellipsoid("ball", (0.0, 0.0, 1.0), (1.0, 1.0, 1.0)))
    assert (curved == 1).all()
    square = 1.0 + CAMERA.tan_x**2 + CAMERA.tan_y**2
    np.testing.assert_allclose(depth, 2.0 / square)


@pytest.mark.parametrize(
    ("make", "faces", "degrees"),
    [
        (lambda: scenes.icosahedron("solid", (0.1, 0.2, 3.0), 0.7, 20.0), 20, 41.81),
        (lambda: scenes.dodecahedron("solid", (0.1, 0.2, 3.0), 0.7, 20.0), 12, 63.43),
        (lambda: scenes.prism("solid", (0.1, 0.2, 3.0), 0.7, 1.0, 8), 10, 45.0),
        (lambda: scenes.prism("solid", (0.1, 0.2, 3.0), 0.7, 1.0, 4, top=0.0), 5, None),
    ],
)
def test_solids_have_the_faces_and_angles_of_their_kind(make, faces, degrees):
    solid = make()
    assert [surface.name for surface in solid] == [f"solid face {i}" for i in range(1, faces + 1)]
    normals = np.array([surface.plane[:3] for surface in solid])
    if degrees is not None:
        angles = np.degrees(np.arccos(np.clip(normals @ normals.T, -1.0, 1.0)))
        assert angles[angles > 1.0].min() == pytest.approx(degrees, abs=0.01)
    if faces in (12, 20):
        distances = [abs(surface.plane @ [0.1, 0.2, 3.0, 1.0]) for surface in solid]
        np.testing.assert_allclose(distances, distances[0])


def test_corners_within_a_solid_are_none():
    cube = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (3, 4)], float)
    faces = scenes.polyhedron("cube", np.concatenate([cube, [[0.5, 0.5, 3.5]]]))
    assert len(faces) == 6
    box, _, _ = seen(*scenes.box("cube", (0.5, 1.0, 3.5), (1.0, 1.0, 1.0)))
    np.testing.assert_allclose(seen(*faces)[0], box)


def test_labels_of_planes_do_not_count_what_is_curved():
    ball = scenes.ellipsoid("ball", (-0.8, 0.0, 3.0), (0.4, 0.4, 0.4))
    column = scenes.cylinder("column", (0.8, 0.0, 3.0), 0.3, 1.0)
    rendering = scenes.Scene((ball, *column, WALL), np.eye(4)).render(CAMERA)
    assert (rendering.names, rendering.curved_names) == (("wall",), ("ball", "column"))
    assert (rendering.labels[60, 10], rendering.curved_labels[60, 107]) == (1, 2)
    assert not ((rendering.labels > 0) & (rendering.curved_labels > 0)).any()
    assert repr(rendering) == "<Rendering: 1 plane, 2 curved surfaces in 161 x 121 pixels>"


@pytest.mark.parametrize(
    ("make", "kind", "message"),
    [
        (lambda: scenes.ellipsoid("ball", (0, 0, 1), (1, 0, 1)), ValueError, r"three positive lengths .* \(1, 0, 1\)"),
        (lambda: scenes.ellipsoid("ball", (0, 0), (1, 1, 1)), ValueError, "centre as three finite numbers"),
        (lambda: scenes.icosahedron("die", (0, 0, 1), -1.0), ValueError, "radius as a positive length in metres"),
        (lambda: scenes.prism("column", (0, 0, 1), 1.0, 1.0, 2), ValueError, "count"),
        (lambda: scenes.prism("column", (0, 0, 1), 1.0, 1.0, 3, top=-1.0), ValueError, "top as a share of 0 or more"),
        (lambda: scenes.cylinder("pipe", (0, 0, 1), 1.0, 0.0), ValueError, "length as a positive length in metres"),
        (lambda: scenes.cylinder("pipe", (0, 0, 1), 1.0, 1.0, lying=1), TypeError, "lying"),
        (lambda: scenes.polyhedron("flat", np.eye(4)[:, :3][:3]), ValueError, r"\(K, 3\) with K >= 4"),
        (lambda: scenes.polyhedron("flat", [(0, 0, 1), (1, 0, 1), (0, 1, 1), (1, 1, 1)]), ValueError, "no volume"),
        (lambda: scenes.Quadric("ball", np.eye(3), np.empty((0, 4))), ValueError, "matrix"),
        (lambda: scenes.Quadric("ball", np.triu(np.ones((4, 4))), np.empty((0, 4))), ValueError, "symmetric"),
    ],
)
def test_what_is_no_solid_is_refused(make, kind, message):
    with pytest.raises(kind, match=message):
        make()
