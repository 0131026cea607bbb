"""Spheres and cylinders keep their ids from frame to frame."""

import numpy as np
import pytest

import rgbd_planes as rp
from rgbd_planes import Primitive, scenes

CAMERA = rp.Camera(160, 120, 131.0, 131.0, 79.5, 59.5, noise=rp.noise.NoiseModel((1e-3,)))


def fits_of(*rows, std=0.001):
    """Fits of (kind, radius, centre, axis), without pixels."""
    kind = np.array([row[0] for row in rows], np.uint8)
    count, nothing = len(rows), np.full(len(rows), np.nan)
    covariance = np.zeros((count, 7, 7))
    covariance[:, 6, 6] = std**2
    return rp.PrimitiveFits(
        CAMERA, np.zeros(CAMERA.shape, np.int32), kind, np.array([row[1] for row in rows], float),
        *(np.array([row[i] for row in rows], float).reshape(-1, 3) for i in (2, 3)),
        np.ones(count, bool), covariance, nothing, nothing, nothing, nothing, np.full(count, 100, np.int32),
        np.where(kind == Primitive.NONE, 3, 0).astype(np.uint8),
    )  # fmt: skip


NOWHERE = (np.nan,) * 3
BALL = (Primitive.SPHERE, 0.1, (0.0, 0.0, 1.0), NOWHERE)
OTHER = (Primitive.SPHERE, 0.1, (0.5, 0.0, 1.0), NOWHERE)
PIPE = (Primitive.CYLINDER, 0.05, (-0.5, 0.0, 1.0), (0.0, 1.0, 0.0))
WALL = (Primitive.PLANE, np.nan, (0.0, 0.0, 2.0), (0.0, 0.0, -1.0))
FORM = (Primitive.NONE, np.nan, NOWHERE, NOWHERE)


def ids(tracker, *rows, motion=None, std=0.001):
    return tracker.follow(fits_of(*rows, std=std), motion).ids.tolist()


def test_ids_go_with_what_is_where_it_was():
    tracker = rp.PrimitiveTracker()
    assert ids(tracker, WALL, BALL, PIPE, FORM) == [0, 1, 2, 0]
    assert ids(tracker, PIPE, OTHER, WALL, BALL) == [2, 3, 0, 1]
    assert tracker.newest == 3
    assert ids(tracker) == []
    assert ids(tracker, OTHER, BALL) == [3, 1]


@pytest.mark.parametrize(
    ("now", "same"),
    [
        ((Primitive.SPHERE, 0.1, (0.04, 0.0, 1.0), NOWHERE), True),
        ((Primitive.SPHERE, 0.1, (0.06, 0.0, 1.0), NOWHERE), False),
        ((Primitive.SPHERE, 0.108, (0.0, 0.0, 1.0), NOWHERE), True),
        ((Primitive.SPHERE, 0.13, (0.0, 0.0, 1.0), NOWHERE), False),
        ((Primitive.CYLINDER, 0.1, (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)), False),
    ],
)
def test_another_place_radius_or_kind_is_another_thing(now, same):
    tracker = rp.PrimitiveTracker()
    assert ids(tracker, BALL) == [1]
    assert ids(tracker, now) == [1 if same else 2]


def test_a_radius_that_is_badly_known_may_differ_more():
    tracker = rp.PrimitiveTracker()
    assert ids(tracker, BALL, std=0.01) == [1]
    assert ids(tracker, (Primitive.SPHERE, 0.13, *BALL[2:]), std=0.01) == [1]


@pytest.mark.parametrize(
    ("centre", "axis", "same"),
    [
        ((-0.5, 0.6, 1.0), (0.0, -1.0, 0.0), True),  # along it, and its axis has no sign
        ((-0.46, 0.0, 1.0), (0.0, 1.0, 0.0), False),
        ((-0.5, 0.0, 1.0), (0.0, np.cos(0.2), np.sin(0.2)), True),
        ((-0.5, 0.0, 1.0), (0.0, np.cos(0.4), np.sin(0.4)), False),
    ],
)
def test_a_pipe_is_where_its_axis_is(centre, axis, same):
    tracker = rp.PrimitiveTracker()
    assert ids(tracker, PIPE) == [1]
    assert ids(tracker, (Primitive.CYLINDER, 0.05, centre, axis)) == [1 if same else 2]


def test_of_two_pipes_in_a_line_the_nearer_one_is_the_same():
    above, below = ((Primitive.CYLINDER, 0.05, (0.0, y, 1.0), (0.0, 1.0, 0.0)) for y in (-0.3, 0.3))
    tracker = rp.PrimitiveTracker()
    assert ids(tracker, above, below) == [1, 2]
    assert ids(tracker, below, above) == [2, 1]


def test_what_the_camera_leaves_behind_moves_with_it():
    turn = np.eye(4)
    turn[:3, :3] = [[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]]
    turn[:3, 3] = 0.3, 0.1, -0.2
    lying = (Primitive.CYLINDER, 0.05, (0.1, 0.2, 1.5), (1.0, 0.0, 0.0))

    def moved(row):
        kind, radius, centre, axis = row
        return kind, radius, turn[:3, :3] @ centre + turn[:3, 3], turn[:3, :3] @ axis

    tracker = rp.PrimitiveTracker()
    assert ids(tracker, BALL, lying) == [1, 2]
    assert ids(tracker, motion=turn) == []  # out of sight meanwhile
    assert ids(tracker, moved(moved(BALL)), moved(moved(lying)), motion=turn) == [1, 2]
    assert ids(rp.PrimitiveTracker(), BALL) == [1]


def test_it_forgets_after_a_while():
    for frames, expected in ((2, 1), (3, 2)):
        tracker = rp.PrimitiveTracker(memory=2)
        assert ids(tracker, BALL) == [1]
        for _ in range(frames):
            assert ids(tracker) == []
        assert ids(tracker, BALL) == [expected]


def test_a_moving_camera_sees_the_same_things():
    wall = scenes.polygon("wall", [(-9, -9, 2), (9, -9, 2), (9, 9, 2), (-9, 9, 2)])
    floor = scenes.polygon("floor", [(-9, 0.5, -9), (9, 0.5, -9), (9, 0.5, 9), (-9, 0.5, 9)])
    side = scenes.polygon("side", [(1.2, -9, -9), (1.2, 9, -9), (1.2, 9, 9), (1.2, -9, 9)])
    ball = scenes.ellipsoid("ball", (-0.3, 0.1, 1.4), (0.2, 0.2, 0.2))
    pipe = scenes.cylinder("pipe", (0.4, 0.0, 1.5), 0.12, 1.0)
    camera = rp.Camera(320, 240, 262.0, 262.0, 159.5, 119.5, depth_scale=5000.0, noise=CAMERA.noise)
    planes, primitives = rp.PlaneTracker(), rp.PrimitiveTracker()
    newest = 0
    for i in range(4):
        eye = (0.06 * i, -0.3, 0.1 * i)
        seen = scenes.Scene((wall, floor, side, ball, *pipe), scenes.look_at(eye, (0.1, 0.2, 1.6)))
        depth = seen.render(camera).measure(noise=1e-3, seed=i)
        found = rp.segment(depth, camera)
        motion = planes.estimate_motion(found)
        planes.follow(found)
        tracked = primitives.follow(rp.fit_primitives(depth, camera, found.curved_labels), motion)
        kinds = {int(one): int(kind) for one, kind in zip(tracked.ids, tracked.fits.kind, strict=True) if one}
        if i == 0:
            first = kinds
            assert sorted(first.values()) == [Primitive.SPHERE, Primitive.CYLINDER]
        assert kinds == first
        newest = primitives.newest
        assert set(np.unique(tracked.labels)) == {0, *first}
        assert tracked.to_table()["id"].tolist() == tracked.ids.tolist()
        assert repr(tracked) == "<TrackedPrimitives: 2 primitives, newest id 2>"
    assert newest == 2


def test_what_it_cannot_follow_is_refused():
    tracker = rp.PrimitiveTracker()
    with pytest.raises(TypeError, match="expected PrimitiveFits, got list"):
        tracker.follow([])
    with pytest.raises(ValueError, match="motion as a rigid motion"):
        tracker.follow(fits_of(BALL), 2.0 * np.eye(4))
    with pytest.raises(ValueError, match="memory"):
        rp.PrimitiveTracker(memory=-1)
