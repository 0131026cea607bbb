"""How the camera has moved: rendered motions, what walls do not show, frames of other places, lenses."""

import os
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rgbd_planes as rp
from rgbd_planes import Camera
from rgbd_planes.evaluation import scenes

CAMERA = Camera(width=160, height=120, fx=131.0, fy=131.0, cx=79.5, cy=59.5, depth_scale=5000.0)
WIDE = Camera(
    width=160, height=120, fx=120.0, fy=121.0, cx=80.0, cy=60.0, distortion=(-0.2, 0.05, 0.001, -0.001, 0.0),
    depth_scale=5000.0,
)  # fmt: skip


def whole(name: str, normal: list[float], offset: float) -> scenes.Surface:
    return scenes.Surface(name, np.array([*normal, offset]), np.empty((0, 4)))


FLOOR, CEILING = whole("floor", [0.0, -1.0, 0.0], 0.0), whole("ceiling", [0.0, 1.0, 0.0], 2.4)
LEFT, RIGHT = whole("left", [1.0, 0.0, 0.0], 1.0), whole("right", [-1.0, 0.0, 0.0], 1.2)
BACK = whole("back", [0.0, 0.0, -1.0], 2.5)
PLACES = {
    "a wall": ([BACK], 3), "a corridor": ([LEFT, RIGHT, FLOOR, CEILING], 1), "a corner": ([LEFT, BACK, FLOOR], 0),
}  # fmt: skip


def poses_of(count: int, step: float = 0.012) -> list[np.ndarray]:
    """Camera to scene: a walk that turns a little."""
    eyes = np.array([0.35, -1.5, -0.2]) + step * np.outer(np.arange(count), [-1.0, 0.1, 0.8])
    return [scenes.look_at(eye, [-0.12 + 0.01 * i, -0.8, 2.6]) for i, eye in enumerate(eyes.tolist())]


def seen(surfaces: list[scenes.Surface], poses: list[np.ndarray], camera: Camera = CAMERA) -> list[np.ndarray]:
    return [
        scenes.Scene(tuple(surfaces), pose).render(camera).measure(noise=5e-4, holes=0.02, seed=i)
        for i, pose in enumerate(poses)
    ]


def room(poses: list[np.ndarray], camera: Camera = CAMERA) -> list[np.ndarray]:
    return seen(list(scenes.room().surfaces), poses, camera)


def error_of(pose: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Metres and degrees."""
    off = np.linalg.inv(true) @ pose
    return float(np.linalg.norm(off[:3, 3])), float(np.degrees(Rotation.from_matrix(off[:3, :3]).magnitude()))


def relative(poses: list[np.ndarray]) -> np.ndarray:
    return np.linalg.inv(poses[0]) @ np.array(poses)


with_and_without_a_lens = pytest.mark.parametrize("camera", [CAMERA, WIDE], ids=["no lens", "a lens"])


@with_and_without_a_lens
def test_a_walk_through_the_room(camera: Camera) -> None:
    truth = poses_of(20)
    found = list(rp.odometry(room(truth, camera), camera))
    errors = rp.metrics.trajectory_errors([pose.T_world_camera for pose in found], relative(truth))
    assert errors.absolute_rmse < 0.01 * errors.path_length
    assert not any(pose.is_lost for pose in found)
    assert [pose.index for pose in found] == list(range(20))
    first = found[0]
    np.testing.assert_array_equal(first.T_world_camera, np.eye(4))
    assert (first.is_keyframe, first.reference, first.covariance.any()) == (True, 0, False)
    by_index = {pose.index: pose for pose in found}
    for pose in found[1:]:
        keyframe = by_index[pose.reference]
        assert keyframe.is_keyframe
        assert pose.reference < pose.index
        np.testing.assert_allclose(
            keyframe.T_world_camera @ pose.T_reference_camera, pose.T_world_camera, atol=1e-12
        )  # fmt: skip
        np.testing.assert_allclose(pose.T_world_camera[:3, :3] @ pose.T_world_camera[:3, :3].T, np.eye(3), atol=1e-12)
        assert pose.unobservable.shape == (0, 6)
        assert np.linalg.eigvalsh(pose.covariance)[0] > 0.0
        np.testing.assert_allclose(pose.covariance @ pose.information, np.eye(6), atol=1e-6)
    ids = [set(pose.segmentation.ids.tolist()) for pose in found]
    assert all(before & after for before, after in pairwise(ids))


def test_errors_are_those_of_the_covariance() -> None:
    truth = poses_of(40)
    squares = []
    for pose in rp.odometry(room(truth), CAMERA):
        if pose.index:
            off = np.linalg.inv(pose.T_reference_camera) @ np.linalg.inv(truth[pose.reference]) @ truth[pose.index]
            delta = np.append(Rotation.from_matrix(off[:3, :3]).as_rotvec(), off[:3, 3])
            squares.append(delta @ np.linalg.solve(pose.covariance, delta))
    assert 1.24 < np.median(squares) < 14.4  # 95 % of chi-square with 6 degrees of freedom


@pytest.mark.parametrize("place", list(PLACES))
def test_what_nothing_observes(place: str) -> None:
    surfaces, free = PLACES[place]
    poses = [scenes.look_at([0.002 * i, -1.2, 0.004 * i], [-0.15, -0.9, 2.0]) for i in range(5)]
    pose = list(rp.odometry(seen(surfaces, poses), CAMERA))[-1]
    assert not pose.is_lost
    assert pose.unobservable.shape == (free, 6)
    assert np.linalg.matrix_rank(pose.information, 1e-9 * np.linalg.norm(pose.information)) == 6 - free
    assert np.linalg.eigvalsh(pose.covariance)[0] > 0.0
    # A plane shows turns that change its normal, and steps that change its distance.
    normals = np.array([surface.plane[:3] for surface in surfaces]) @ poses[-1][:3, :3]
    turns = [np.hstack([np.cross(np.eye(3), normal), np.zeros((3, 3))]) for normal in normals]
    shown = np.vstack([*turns, np.hstack([np.zeros_like(normals), normals])])
    null = np.linalg.svd(shown)[2][6 - free :]
    if free:
        np.testing.assert_allclose(pose.unobservable @ pose.unobservable.T, np.eye(free), atol=1e-9)
        cosines = np.linalg.svd(null @ pose.unobservable.T, compute_uv=False)
        assert np.degrees(np.arccos(np.clip(cosines.min(), -1.0, 1.0))) < 2.0
        for direction in pose.unobservable:
            assert direction @ pose.covariance @ direction > 1e-4  # the prior's, not what was seen


@with_and_without_a_lens
def test_somebody_walks_through(camera: Camera) -> None:
    truth = poses_of(24, 0.006)
    frames = []
    for i, pose in enumerate(truth):
        person = scenes.box("person", (0.12 * i - 1.6, -0.2, 1.3), (0.45, 1.5, 0.3))
        frames += seen([*scenes.room().surfaces, *person], [pose], camera)
    found = list(rp.odometry(frames, camera))
    assert not any(pose.is_lost for pose in found)
    errors = rp.metrics.trajectory_errors([pose.T_world_camera for pose in found], relative(truth))
    assert errors.absolute_rmse < 0.02


@with_and_without_a_lens
def test_frames_without_anything_and_of_another_place(camera: Camera) -> None:
    truth = poses_of(24)
    frames = room(truth, camera)
    elsewhere = room([scenes.look_at([0.0, -1.2, 3.0], [-0.2, -1.5, 0.0])], camera)[0]
    frames[8], frames[9], frames[15] = np.zeros_like(frames[0]), np.zeros_like(frames[0]), elsewhere
    found = list(rp.odometry(frames, camera))
    assert [pose.index for pose in found if pose.is_lost] == [8, 9, 15]
    for i in (8, 15):
        assert not found[i].information.any()
        assert found[i].unobservable.shape == (6, 6)
        assert not found[i].is_keyframe
        assert found[i].translation_std > 3.0 * found[7].translation_std
    kept = [i for i in range(24) if i not in (8, 9, 15)]
    errors = rp.metrics.trajectory_errors(np.array([found[i].T_world_camera for i in kept]), relative(truth)[kept])
    assert errors.absolute_rmse < 0.01


@with_and_without_a_lens
def test_every_tenth_frame_is_missing(camera: Camera) -> None:
    kept = [i for i in range(30) if i % 10]
    truth = poses_of(30)
    frames = room(truth, camera)
    found = list(rp.odometry((frames[i] for i in kept), camera))
    errors = rp.metrics.trajectory_errors([pose.T_world_camera for pose in found], relative([truth[i] for i in kept]))
    assert not any(pose.is_lost for pose in found)
    assert errors.absolute_rmse < 0.01 * errors.path_length


def test_a_sequence_that_begins_with_nothing() -> None:
    truth = poses_of(3)
    found = list(rp.odometry([np.zeros(CAMERA.shape, np.uint16), *room(truth)], CAMERA))
    assert [pose.is_lost for pose in found] == [True, False, False, False]
    assert [pose.is_keyframe for pose in found] == [False, True, False, False]
    assert found[3].reference == 1


def test_ids_follow_the_motion_that_was_found() -> None:
    """Through a frame of another place, too: what is lost moves nothing."""
    truth = poses_of(12)
    frames = room(truth)
    frames[6] = room([scenes.look_at([0.0, -1.2, 3.0], [-0.2, -1.5, 0.0])])[0]
    found = list(rp.odometry(frames, CAMERA))
    assert found[6].is_lost
    large = [set(p.segmentation.ids[p.segmentation.segmentation.sizes > 500].tolist()) for p in found]
    assert len(large[0] & large[11]) >= 0.8 * len(large[0])
    assert len(large[5] & large[7]) >= 0.8 * len(large[5])
    assert len(large[5] & large[6]) <= 1


def test_the_same_bits_again() -> None:
    frames = room(poses_of(6))
    first, second = (np.array([p.T_world_camera for p in rp.odometry(frames, CAMERA)]) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_what_is_no_frame() -> None:
    with pytest.raises(TypeError):
        rp.Odometry("camera")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="odometry needs a camera"):
        next(iter(rp.odometry([np.zeros(CAMERA.shape)])))
    odometry = rp.Odometry(CAMERA)
    frames = room(poses_of(2))
    odometry.update(frames[0])
    with pytest.raises(ValueError, match="frame 1"):
        odometry.update(frames[1][:50])
    pose = odometry.update(frames[1])  # as if the other had not been given
    assert (pose.index, pose.is_lost) == (1, False)


def real_sequence() -> Path:
    data = os.environ.get("RGBD_PLANES_DATA")
    if not data or not (Path(data) / "kinect1_7scenes_posed").is_dir():
        pytest.skip("RGBD_PLANES_DATA has no kinect1_7scenes_posed")
    return Path(data) / "kinect1_7scenes_posed"


def test_real_frames() -> None:
    sequence = rp.open_sequence(real_sequence())[:60]
    found = list(rp.odometry(sequence))
    truth = [np.loadtxt(real_sequence() / frame.replace("depth.png", "pose.txt")) for frame in sequence.names]
    errors = rp.metrics.trajectory_errors([pose.T_world_camera for pose in found], truth)
    assert not any(pose.is_lost for pose in found)
    assert errors.absolute_rmse < 0.015
    assert np.median(errors.relative[0].translation) < 0.0025
    assert np.median(errors.relative[0].angle_deg) < 0.1
