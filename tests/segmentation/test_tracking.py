"""Ids stay with their planes while the camera moves."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rgbd_planes import Camera, noise, segment
from rgbd_planes.camera.frame import Frame
from rgbd_planes.evaluation import scenes
from rgbd_planes.evaluation.metrics import compare_labels
from rgbd_planes.segmentation import known_planes
from rgbd_planes.segmentation.camera_motion import Motion, camera_motion
from rgbd_planes.segmentation.known_planes import (
    LARGEST,
    KnownPlanes,
    Points,
    View,
    _is_hidden,
    recognise,
    remember,
    same_planes,
)
from rgbd_planes.segmentation.tracking import PlaneTracker, TrackedSegmentation, segment_sequence

CAMERA = Camera(width=160, height=120, fx=131.0, fy=131.0, cx=79.5, cy=59.5, depth_scale=1000.0)


def steps(count: int) -> list[tuple[np.ndarray, scenes.Rendering]]:
    """A camera that walks through the room, a centimetre or two a frame."""
    frames = []
    for i in range(count):
        scene = scenes.room(eye=(0.35 - 0.015 * i, -1.5, -0.2 + 0.01 * i))
        rendering = scene.render(CAMERA)
        frames.append((rendering.measure(holes=0.02, seed=i), rendering))
    return frames


def test_ids_stay_with_the_planes() -> None:
    frames = steps(8)
    name_of: dict[int, str] = {}
    agreeing = checked = 0
    for (_, rendering), tracked in zip(frames, segment_sequence((f for f, _ in frames), CAMERA), strict=True):
        assert tracked.labels.max() == tracked.ids.max()
        assert len(set(tracked.ids.tolist())) == len(tracked.ids)
        assert list(tracked.to_table())[:2] == ["id", "label"]
        np.testing.assert_array_equal(tracked.to_table()["id"], tracked.ids)
        for truth, own in compare_labels(tracked.labels, rendering.labels).detection(0.6).pairs:
            checked += 1
            agreeing += name_of.setdefault(int(own), rendering.names[truth - 1]) == rendering.names[truth - 1]
    assert checked > 60
    assert agreeing >= 0.97 * checked
    # Few planes got a second id.
    assert len(name_of) <= len(set(name_of.values())) + 4


@pytest.mark.parametrize("degrees", [30.0, 240.0])
def test_ids_outlast_a_frame_of_another_place(degrees: float) -> None:
    """Some of its planes are nearly where one of the others was: the motion that follows moved all that was known."""
    camera = Camera(width=640, height=480, fx=525.0, fy=525.0, cx=319.5, cy=239.5, depth_scale=1000.0)
    eye = np.array([0.3, -1.4, 0.2])
    ahead = np.array([np.sin(np.radians(degrees)), 0.2, np.cos(np.radians(degrees))])
    here = scenes.room().render(camera)
    there = scenes.room(eye=eye, target=eye + ahead).render(camera)
    first, other, last = segment_sequence([v.measure(seed=1) for v in (here, there, here)], camera, min_size=500)
    assert np.mean(first.ids == last.ids) > 0.85
    names = [
        {int(own): view.names[truth - 1] for truth, own in compare_labels(of.labels, view.labels).detection(0.6).pairs}
        for of, view in ((first, here), (other, there))
    ]
    assert {names[1][i] == names[0].get(i, names[1][i]) for i in names[1]} == {True}
    assert len(set(first.ids) & set(other.ids)) <= 1


def test_a_plane_keeps_its_colour_and_number_in_the_figure() -> None:
    colours: dict[int, np.ndarray] = {}
    moved = False
    frames = [depth for depth, _ in steps(4)]
    for depth, tracked in zip(frames, segment_sequence(frames, CAMERA), strict=True):
        found = tracked.segmentation
        (axes,) = tracked.plot().axes
        image = np.asarray(axes.get_images()[0].get_array())
        for i, number in enumerate(tracked.ids):
            seen = np.unique(image[found.labels == i + 1], axis=0)
            assert len(seen) == 1
            np.testing.assert_array_equal(seen[0], colours.setdefault(int(number), seen[0]))
        for text in axes.texts:
            column, row = np.rint(text.get_position()).astype(int)
            assert int(text.get_text()) == tracked.labels[row, column]
        assert tracked.plot(depth)._repr_png_().startswith(b"\x89PNG")
        moved |= bool((tracked.ids != np.arange(len(found)) + 1).any())
    assert moved  # else labels would do
    assert len(np.unique(np.array(list(colours.values())), axis=0)) == len(colours)


def wall_and_board(shown: bool) -> np.ndarray:
    depth = np.full(CAMERA.shape, 2.0)
    if shown:
        depth[30:70, 40:90] = 1.5
    return depth


def test_a_plane_that_was_covered_comes_back_under_its_id() -> None:
    frames = [wall_and_board(True), wall_and_board(False), wall_and_board(False), wall_and_board(True)]
    ids = [tracked.ids.tolist() for tracked in segment_sequence(frames, CAMERA)]
    assert ids == [[1, 2], [1], [1], [1, 2]]
    ids = [tracked.ids.tolist() for tracked in segment_sequence(frames, CAMERA, memory=1)]
    assert ids == [[1, 2], [1], [1], [1, 3]]


def test_what_is_in_sight_goes_before_what_was_covered() -> None:
    """Boards left and right, of which the left one is the larger; then the right one alone; then one over both."""

    def frame(*boards: tuple[int, int]) -> np.ndarray:
        depth = np.full(CAMERA.shape, 2.0)
        for left, right in boards:
            depth[30:70, left:right] = 1.5
        return depth

    frames = [frame((10, 55), (80, 110)), frame((80, 110)), frame((10, 110))]
    _, second, third = (tracked.ids.tolist() for tracked in segment_sequence(frames, CAMERA))
    assert len(second) == len(third) == 2
    assert third == second
    again = segment_sequence([frames[0], frames[2]], CAMERA)
    assert [tracked.ids.tolist() for tracked in again] == [[1, 2, 3], [1, 2]]  # both in sight: the larger one


@pytest.mark.parametrize(("left", "ids"), [(90, [1, 2]), (20, [1, 3])])
def test_a_board_is_not_remembered_where_it_has_left_the_wall_free(left: int, ids: list[int]) -> None:
    """It moves to the right, and is gone for a frame: one that is then where it was at first is another."""

    def frame(*boards: int) -> np.ndarray:
        depth = np.full(CAMERA.shape, 2.0)
        for board in boards:
            depth[30:70, board : board + 30] = 1.5
        return depth

    frames = [*map(frame, range(20, 100, 10)), frame(), frame(left)]
    *moving, gone, last = (tracked.ids.tolist() for tracked in segment_sequence(frames, CAMERA))
    assert moving == [[1, 2]] * 8
    assert gone == [1]
    assert last == ids


def test_noise_and_the_least_size_are_those_of_each_frame() -> None:
    q = np.full(CAMERA.shape, 0.5)
    q[30:70, 40:90] += 0.02
    q[5:15, 5:15] = 1.0
    depth = 1.0 / (q + np.random.default_rng(3).normal(0.0, 1e-3, q.shape))
    for settings in ({}, {"noise": 0.02}, {"min_size": 200}):
        (tracked,) = segment_sequence([depth], CAMERA, **settings)
        expected = segment(depth, CAMERA, **settings)
        np.testing.assert_array_equal(tracked.segmentation.labels, expected.labels)
        assert len(tracked.ids) == len(expected)
        assert (len(expected) == 3) == (not settings)


def test_what_is_forgotten_takes_no_room() -> None:
    tracker = PlaneTracker(memory=2)
    for i in range(12):
        frame = np.full(CAMERA.shape, 1.0 + i % 4)  # a new plane each time
        tracked = tracker.follow(segment(frame, CAMERA))
        assert tracked.ids.tolist() == [i + 1]
        assert len(tracker._known.ids) == min(i + 1, 3)


def test_what_is_covered_of_a_plane_in_sight_is_remembered_for_as_many_frames() -> None:
    tracker, depth = PlaneTracker(memory=2), np.full(CAMERA.shape, 2.0)
    for frames in (0, 1, 2, 0, 0):  # since the last of its points was seen
        tracker.follow(segment(depth, CAMERA))
        assert tracker._known.points.unseen.max() == frames
        depth[:, 80:] = 1.5


def test_a_point_is_hidden_behind_something_or_beyond_the_image() -> None:
    """Of the wall: behind the board, in sight, beyond the image; of the board: where it has left the wall free."""
    view = View.of(segment(wall_and_board(True), CAMERA))
    pixels, depth = np.array([(60, 50), (20, 20), (-50, 50), (120, 50)]), np.array([2.0, 2.0, 2.0, 1.5])
    rays = (pixels - [CAMERA.cx, CAMERA.cy]) / CAMERA.fx
    points = Points(np.column_stack([rays, np.ones(4)]) * depth[:, None])
    assert _is_hidden(points, np.array([1, 1, 1, 2]), view).tolist() == [True, False, True, False]


@pytest.mark.parametrize(("row", "column"), [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_a_square_has_the_label_of_whichever_of_its_pixels_has_one(row: int, column: int) -> None:
    found = segment(wall_and_board(True), CAMERA)
    labels = np.zeros_like(found.labels)
    labels[row::2, column::2] = found.labels[row::2, column::2]
    np.testing.assert_array_equal(View.of(replace(found, labels=labels)).labels, labels[row::2, column::2])


def test_in_how_many_frames_planes_were_seen_and_since_is_counted() -> None:
    tracker = PlaneTracker()
    counts = []
    for shown in (True, True, False, False, True):
        tracker.follow(segment(wall_and_board(shown), CAMERA))
        counts.append((tracker._known.seen.tolist(), tracker._known.missed.tolist()))
    assert counts == [([1, 1], [0, 0]), ([2, 2], [0, 0]), ([3, 2], [0, 1]), ([4, 2], [0, 2]), ([5, 3], [0, 0])]


@pytest.mark.parametrize(("seen", "close", "expected"), [((1, 1), np.inf, 1), ((1, 1), 0.03, 2), ((1, 4), np.inf, 2)])
def test_of_two_planes_one_is_the_larger_or_the_nearer_or_the_longer_known(
    seen: tuple[int, int], close: float, expected: int
) -> None:
    """The left one has more of it, and is 5 % off."""
    tracker, depth = PlaneTracker(), np.full(CAMERA.shape, 2.1)
    depth[:, :90] = 2.0
    tracker.follow(segment(depth, CAMERA))
    known = tracker._known._replace(seen=np.array(seen))
    view = View.of(segment(np.full(CAMERA.shape, 2.1), CAMERA))
    assert known.ids[same_planes(known, view, close=close).before].tolist() == [expected]


def test_the_largest_planes_are_of_those_seen_lately() -> None:
    """All are of one size, but one that is three times as large, not seen for three frames: a quarter counts."""
    count = LARGEST + 1
    missed, squares = np.where(np.arange(count) == 4, 3, 0), np.where(np.arange(count) == 4, 30.0, 10.0)
    points = Points(np.zeros((count, 3)), np.arange(count), squares, np.zeros(count, np.intp))
    ids = np.arange(1, count + 1, dtype=np.int32)
    known = KnownPlanes(ids, np.zeros((count, 4)), np.ones(count, np.intp), missed, points)
    assert known.largest().ids.tolist() == np.delete(ids, 4).tolist()
    assert 5 in known._replace(missed=np.minimum(missed, 1)).largest().ids


def test_work_does_not_grow_with_the_ids() -> None:
    """After days of video; an array with an entry for each id would not fit into memory."""
    tracker = PlaneTracker()
    tracker._newest = 2**31 - 3
    tracked = [tracker.follow(segment(wall_and_board(True), CAMERA)) for _ in range(2)]
    assert [t.ids.tolist() for t in tracked] == [[2**31 - 2, 2**31 - 1]] * 2


@pytest.mark.parametrize("is_known", [False, True])
def test_a_motion_that_is_known_says_which_of_equal_boards_is_seen(is_known: bool) -> None:
    """The camera moves along the wall by as much as the boards are apart, which planes cannot tell."""

    def frame(*boards: int) -> np.ndarray:
        depth = np.full(CAMERA.shape, 2.0)
        for board in boards:
            depth[30:70, board : board + 30] = 1.5
        return depth

    motion = np.eye(4)
    motion[0, 3] = 60.0 * 1.5 / CAMERA.fx  # 60 pixels to the right, at the boards
    tracker = PlaneTracker()
    first = tracker.follow(segment(frame(20, 80), CAMERA)).labels
    second = tracker.follow(segment(frame(80), CAMERA), motion if is_known else None).labels
    assert second[50, 95] == first[50, 35 if is_known else 95]
    third = tracker.follow(segment(frame(20, 80), CAMERA), np.linalg.inv(motion) if is_known else None).labels
    assert third[50, 35] == first[50, 35]


def test_a_motion_is_kept_over_a_frame_without_planes() -> None:
    motion = np.eye(4)
    motion[2, 3] = -0.3  # towards the wall
    tracker = PlaneTracker()
    depths = np.full(CAMERA.shape, 2.0), np.zeros(CAMERA.shape), np.full(CAMERA.shape, 1.4)
    ids = [
        tracker.follow(segment(d, CAMERA), m).ids.tolist() for d, m in zip(depths, (None, motion, motion), strict=True)
    ]
    assert ids == [[1], [], [1]]


@pytest.mark.parametrize("motion", [np.eye(3), 2.0 * np.eye(4), np.zeros((2, 4, 4))])
def test_what_is_no_motion_is_refused(motion: np.ndarray) -> None:
    with pytest.raises(ValueError, match="expected motion"):
        PlaneTracker().follow(segment(wall_and_board(True), CAMERA), motion)


def test_another_plane_in_the_same_place_is_new() -> None:
    nearer = np.where(wall_and_board(True) == 1.5, 1.0, 2.0)
    frames = [wall_and_board(True), wall_and_board(False), nearer]
    ids = [tracked.ids.tolist() for tracked in segment_sequence(frames, CAMERA)]
    assert ids == [[1, 2], [1], [1, 3]]


def test_a_small_turn_of_a_plane_seen_slantwise_keeps_its_id() -> None:
    frames = []
    for i, degrees in enumerate((70.0, 75.0)):  # its distance from the camera: 0.68 m, then 0.52 m
        along = 0.4 * np.array([np.cos(np.radians(degrees)), 0.0, np.sin(np.radians(degrees))])
        up, middle = np.array([0.0, 0.4, 0.0]), np.array([0.0, 0.0, 2.0])
        board = [middle - along - up, middle + along - up, middle + along + up, middle - along + up]
        wall = [(-9, -9, 4.0), (9, -9, 4.0), (9, 9, 4.0), (-9, 9, 4.0)]
        scene = scenes.Scene((scenes.polygon("board", board), scenes.polygon("wall", wall)), np.eye(4))
        frames.append(scene.render(CAMERA).measure(seed=i))
    ids = [sorted(tracked.ids.tolist()) for tracked in segment_sequence(frames, CAMERA)]
    assert ids == [[1, 2], [1, 2]]


def test_a_plane_that_is_mostly_covered_keeps_its_id() -> None:
    covered = wall_and_board(True)
    covered[20:80, 50:100] = 1.0  # leaves a fifth of the board
    first, second = segment_sequence([wall_and_board(True), covered], CAMERA)
    assert second.labels[50, 44] == first.labels[50, 44]
    assert sorted(second.ids.tolist()) == [1, 2, 3]


@pytest.mark.parametrize(("degrees", "ids"), [(15.0, [1]), (30.0, [2])])
def test_a_plane_that_turns_far_about_its_middle_is_another(degrees: float, ids: list[int]) -> None:
    """Its distance from the camera is within a seventh of what it was, and what the middle sees is the same."""
    turned = np.array([np.sin(np.radians(degrees)), 0.0, -np.cos(np.radians(degrees))])
    frames = [scenes.plane(n, -2.0 * n[2]).render(CAMERA).depth for n in (np.array([0.0, 0.0, -1.0]), turned)]
    _, second = segment_sequence(frames, CAMERA)
    assert second.ids.tolist() == ids


def test_a_floor_keeps_its_id_when_the_camera_pitches() -> None:
    """It is as far from the camera as before, but not where it was seen: there by a third."""
    normals = [np.array([0.0, -np.cos(tilt), -np.sin(tilt)]) for tilt in np.radians([20.0, 28.0])]
    ids = [
        tracked.ids.tolist()
        for tracked in segment_sequence([scenes.plane(n, 1.0).render(CAMERA).depth for n in normals], CAMERA)
    ]
    assert ids == [[1], [1]]


def test_missing_frames_do_not_lose_the_ids() -> None:
    frames = [wall_and_board(True), np.zeros(CAMERA.shape), np.zeros(CAMERA.shape), wall_and_board(True)]
    kept = [tracked.ids.tolist() for tracked in segment_sequence(frames, CAMERA, memory=3)]
    assert kept == [[1, 2], [], [], [1, 2]]
    lost = [tracked.ids.tolist() for tracked in segment_sequence(frames, CAMERA, memory=1)]
    assert lost == [[1, 2], [], [], [3, 4]]


@pytest.mark.parametrize("missing", [(1, 0, 2), (0, 1, 2), (1, 1, 2), (3, 1, 4)])
def test_ids_stay_whatever_pixels_are_never_measured(missing: tuple[int, int, int]) -> None:
    depth = wall_and_board(True).copy()
    row, column = np.indices(depth.shape)
    of_row, of_column, period = missing
    depth[(of_row * row + of_column * column) % period == 0] = 0
    kept = [tracked.ids.tolist() for tracked in segment_sequence([depth] * 3, CAMERA)]
    assert kept == [[1, 2]] * 3


def test_ids_go_on_where_the_size_of_the_frames_changes() -> None:
    tracker = PlaneTracker(memory=30)
    half = replace(CAMERA, width=80, height=60, fx=65.5, fy=65.5, cx=39.5, cy=29.5)
    depth = wall_and_board(True)
    frames = [(depth, CAMERA), (depth[::2, ::2], half), (depth[::2, ::2], half), (depth, CAMERA)]
    ids = [tracker.follow(segment(*frame)).ids.tolist() for frame in frames]
    assert ids == [[1, 2], [3, 4], [3, 4], [5, 6]]


def test_frames_are_read_one_at_a_time() -> None:
    read = []

    def frames():
        for i in range(3):
            read.append(i)
            yield wall_and_board(True)

    sequence = segment_sequence(frames(), CAMERA)
    next(sequence)
    assert read == [0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"memory": -1}, "memory must be at least 0, got -1"),
        ({"min_size": 2}, "min_size must be at least 3"),
        ({"noise": -1.0}, "positive standard deviation"),
    ],
)
def test_bad_arguments_are_an_error_before_any_frame(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        segment_sequence([], CAMERA, **arguments)


@pytest.mark.parametrize(("depth", "ids"), [(0.54, [1]), (0.6, [2])])
def test_how_far_a_wall_may_move_goes_with_its_distance(depth: float, ids: list[int]) -> None:
    frames = [np.full(CAMERA.shape, 0.5), np.full(CAMERA.shape, depth)]
    _, second = segment_sequence(frames, CAMERA)
    assert second.ids.tolist() == ids


def test_a_plane_keeps_its_id_when_something_passes_before_it() -> None:
    """First the one end of the board is covered, then all of it, then the other end."""

    def frame(left: int) -> np.ndarray:
        depth = wall_and_board(True)
        depth[:, max(left, 0) : max(left + 60, 0)] = 1.0
        return depth

    frames = [frame(left) for left in range(-70, 160, 5)]
    tracked = list(segment_sequence(frames, CAMERA))
    boards = [t.labels[50, x] for t, f in zip(tracked, frames, strict=True) for x in (42, 87) if f[50, x] == 1.5]
    assert {int(board) for board in boards} - {0} == {2}  # 0: too few pixels for a plane
    assert sum(bool((frame[30:70, 40:90] != 1.5).all()) for frame in frames) > 1
    *_, last = segment_sequence(frames, CAMERA, memory=3)
    assert last.labels[50, 42] != 2  # forgotten


@pytest.mark.parametrize(("step", "mirrored"), [(2, False), (2, True), (4, False), (6, True)])
def test_what_something_hides_of_a_plane_is_remembered_as_large_as_it_is(step: int, mirrored: bool) -> None:
    """Another wall slowly moves before it. Of both only some points are kept, others in each frame."""
    tracker = PlaneTracker(memory=100)
    for edge in range(0, CAMERA.width - 20, step):
        depth = np.where(np.arange(CAMERA.width) < edge, 1.5, 2.0)
        depth = np.broadcast_to(depth[::-1] if mirrored else depth, CAMERA.shape)
        ids = tracker.follow(segment(depth, CAMERA)).ids
        points = tracker._known.points
        assert points.squares[points.of == 0].sum() == pytest.approx(CAMERA.width * CAMERA.height / 4, rel=0.2)
    assert sorted(ids.tolist()) == [1, 2]
    assert len(np.unique(points.xyz[points.of == 0, 0].round(2))) > 30  # not in a few columns


def turning(degrees: np.ndarray, camera: Camera = CAMERA) -> list[tuple[np.ndarray, scenes.Rendering]]:
    """The room from one place, by a camera that turns."""
    eye, down = np.array([0.35, -1.5, -0.2]), np.radians(15.0)
    frames = []
    for i, turn in enumerate(np.radians(degrees)):
        ahead = np.array([np.sin(turn) * np.cos(down), np.sin(down), np.cos(turn) * np.cos(down)])
        rendering = scenes.room(eye, eye + ahead).render(camera)
        frames.append((rendering.measure(holes=0.02, seed=i), rendering))
    return frames


def switches(frames: list[tuple[np.ndarray, scenes.Rendering]], camera: Camera) -> tuple[int, int]:
    """How often a surface has another id than when it was last seen, of how many times."""
    last: dict[str, int] = {}
    switched = matched = 0
    for (_, rendering), tracked in zip(frames, segment_sequence([f for f, _ in frames], camera), strict=True):
        for truth, own in compare_labels(tracked.labels, rendering.labels).detection(0.5).pairs:
            name = rendering.names[truth - 1]
            matched += 1
            switched += last.get(name, int(own)) != own
            last[name] = int(own)
    return switched, matched


@pytest.mark.parametrize(
    "camera",
    [
        CAMERA,
        replace(CAMERA, distortion=(0.1, -0.2, 0.001, -0.001, 0.05)),
        replace(CAMERA, fx=90.0, fy=90.0, distortion_model="fisheye"),
    ],
)
@pytest.mark.parametrize("step", [2.0, 6.0])
def test_ids_stay_when_the_camera_turns_away_and_back(step: float, camera: Camera) -> None:
    """Six degrees are a tenth of the image: what is small is elsewhere in each frame."""
    there = np.arange(-15.0, 15.0, step)
    frames = turning(np.concatenate([there, there[::-1]]), camera)
    switched, matched = switches(frames, camera)
    assert matched > 10 * len(frames)
    assert switched <= 0.01 * matched


def motion_of(degrees: tuple[float, float, float], step: tuple[float, float, float]) -> Motion:
    return Motion(Rotation.from_euler("xyz", degrees, degrees=True).as_matrix(), np.array(step))


def some_planes(rng: np.random.Generator, count: int) -> np.ndarray:
    normals = rng.standard_normal((count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return np.column_stack([normals, rng.uniform(1.0, 4.0, count)])


@pytest.mark.parametrize("moving", [0, 3])
def test_the_motion_of_the_camera_is_that_of_most_planes(moving: int, rng: np.random.Generator) -> None:
    truth = motion_of((3.0, -5.0, 1.0), (0.1, -0.05, 0.15))
    planes = some_planes(rng, 12)
    now = truth.move_planes(planes)
    now[:moving] = motion_of((0.0, 25.0, 0.0), (0.5, 0.0, 0.0)).move_planes(now[:moving])
    found = camera_motion(planes, now, np.ones(12))
    assert np.degrees(np.arccos(0.5 * (np.trace(found.rotation @ truth.rotation.T) - 1.0))) < 0.1
    np.testing.assert_allclose(found.step, truth.step, atol=0.02)
    points = rng.standard_normal((5, 3))
    on_planes = points - (planes[:5, 3] + np.sum(planes[:5, :3] * points, axis=1))[:, None] * planes[:5, :3]
    moved, carried = truth.move_points(on_planes), truth.move_planes(planes)[:5]
    np.testing.assert_allclose(np.sum(carried[:, :3] * moved, axis=1) + carried[:, 3], 0.0, atol=1e-12)


@pytest.mark.parametrize(("degrees", "metres", "near"), [(0.2, 0.008, True), (0.2, 0.012, False), (0.4, 0.008, False)])
def test_motions_are_near_each_other_by_turn_and_step(degrees: float, metres: float, near: bool) -> None:
    first = motion_of((30.0, 20.0, 0.0), (1.0, 2.0, 3.0))
    change = motion_of((0.0, degrees, 0.0), (0.0, metres, 0.0))
    other = Motion(first.rotation @ change.rotation, first.step + change.step)
    assert first.is_near(other) == other.is_near(first) == near


def test_planes_that_are_mirrored_turn_no_camera_inside_out(rng: np.random.Generator) -> None:
    for count in (3, 8):
        planes = some_planes(rng, count)
        rotation = camera_motion(planes, planes * [1.0, 1.0, -1.0, 1.0], np.ones(count)).rotation
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_what_planes_do_not_tell_of_the_motion_is_taken_for_none() -> None:
    """A wall says nothing of steps along it, nor of turns about its normal."""
    wall = np.array([[0.0, 0.0, -1.0, 2.0]])
    motion = camera_motion(wall, np.array([[0.0, 0.0, -1.0, 1.9]]), np.ones(1))
    np.testing.assert_allclose(motion.rotation, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(motion.step, [0.0, 0.0, -0.1], atol=0.003)


def test_frames_of_a_sequence_bring_their_cameras() -> None:
    """Each with another focal length."""
    rendered = [
        (scenes.room().render(replace(CAMERA, fx=f, fy=f)), replace(CAMERA, fx=f, fy=f)) for f in (120.0, 131.0, 145.0)
    ]
    frames = [Frame(r.measure(seed=1), camera, float("nan"), str(i)) for i, (r, camera) in enumerate(rendered)]
    for frame, tracked in zip(frames, segment_sequence(frames), strict=True):
        assert tracked.segmentation.camera is frame.camera
        np.testing.assert_array_equal(tracked.segmentation.planes, segment(frame.depth, frame.camera).planes)
    noisy = frames[0].camera.with_noise(noise.kinect_v1())
    (tracked,) = segment_sequence(frames[:1], noisy)
    assert tracked.segmentation.camera is noisy
    with pytest.raises(TypeError, match="needs a camera, or frames of a sequence, got ndarray"):
        next(segment_sequence([wall_and_board(True)]))
    with pytest.raises(ValueError, match="positive standard deviation"):
        segment_sequence(frames, noise=-1.0)


def test_a_bad_frame_of_a_sequence_is_named_and_the_last() -> None:
    good = wall_and_board(True)
    found = segment_sequence([good, good[1:], good], CAMERA)
    next(found)
    with pytest.raises(ValueError, match=r"^frame 1: expected a depth frame of shape"):
        next(found)
    assert list(found) == []


def test_a_tracker_is_given_one_segmentation_after_the_other() -> None:
    tracker = PlaneTracker()
    depth = wall_and_board(True)
    tracked = [tracker.follow(segment(depth, CAMERA)) for _ in range(2)]
    assert all(isinstance(t, TrackedSegmentation) for t in tracked)
    assert [t.ids.tolist() for t in tracked] == [[1, 2], [1, 2]]
    with pytest.raises(TypeError, match="expected a Segmentation, got ndarray"):
        tracker.follow(depth)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="memory must be at least 0, got -1"):
        PlaneTracker(-1)


@pytest.mark.parametrize("degrees", [2.0, 6.0])
def test_a_camera_that_stands_still_has_not_moved(degrees: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever motion planes tell that noise has bent, or of which few are in sight."""
    found = segment(scenes.room().render(CAMERA).measure(seed=1), CAMERA)
    view, ids = View.of(found), np.arange(1, len(found) + 1, dtype=np.int32)
    known = remember(KnownPlanes(), view, ids, 30)
    wrong = Motion(Rotation.from_euler("y", degrees, degrees=True).as_matrix(), np.array([0.1, 0.0, 0.0]))
    monkeypatch.setattr(known_planes, "motion_since", lambda *whatever: wrong)
    moved, matches = recognise(known, view)
    np.testing.assert_array_equal(moved.planes, known.planes)
    np.testing.assert_array_equal(matches.before, matches.now)
    assert len(matches.now) == len(known.ids)
    assert matches.share > 0.9


@pytest.mark.parametrize(
    "lens",
    [
        {"distortion": (0.2, -0.3, 0.002, -0.001, 0.1)},
        {"distortion": (-0.3, 0.1, 0.0, 0.0, 0.0)},
        {"distortion": (0.1, 0.02, -0.01, 0.0), "distortion_model": "fisheye", "fx": 60.0, "fy": 60.0},
    ],
)
def test_points_are_in_the_squares_that_a_lens_puts_them_in(lens: dict[str, Any], rng: np.random.Generator) -> None:
    """Those that none of the image's rays comes near are not looked for."""
    camera = replace(CAMERA, **lens)
    view = View.of(segment(scenes.plane((0.1, -0.2, -1.0), 1.5).render(camera).depth, camera))
    xyz = rng.normal(size=(20_000, 3)) * [2.0, 2.0, 1.0]
    row, column, inside = view.squares_of(xyz)
    x, y = np.rint(0.5 * camera.project(xyz)).T
    expected = (y >= 0) & (y < view.labels.shape[0]) & (x >= 0) & (x < view.labels.shape[1])
    np.testing.assert_array_equal(inside, expected)
    assert 300 < expected.sum() < 15_000
    np.testing.assert_array_equal(row[inside], y[inside])
    np.testing.assert_array_equal(column[inside], x[inside])
