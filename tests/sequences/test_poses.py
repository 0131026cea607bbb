"""Camera poses of data sets, on each frame."""

import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_sequences import CAMERA, write_sens, write_tum

import rgbd_planes as rp
from bench import real_data
from rgbd_planes import sequences
from rgbd_planes.sequences import images


@pytest.fixture
def frames(rng):
    return rng.integers(0, 65535, (3, 6, 8)).astype(np.uint16)


@pytest.fixture
def poses(rng):
    """Three camera-to-world matrices."""
    made = np.tile(np.eye(4), (3, 1, 1))
    made[:, :3, :3] = Rotation.random(3, rng=np.random.default_rng(1)).as_matrix()
    made[:, :3, 3] = rng.normal(size=(3, 3))
    return made


def write_images(root, frames, name, pose_name=None, poses=()):
    for i, frame in enumerate(frames):
        path = root / name.format(i)
        path.parent.mkdir(parents=True, exist_ok=True)
        images.write_png(path, frame)
    for i, pose in enumerate(poses):
        path = root / pose_name.format(i)
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savetxt(path, pose)


@pytest.mark.parametrize(
    ("name", "pose_name"),
    [
        ("frame-{:06d}.depth.png", "frame-{:06d}.pose.txt"),
        ("depth/{}.png", "pose/{}.txt"),
        ("depth/{}.png", "poses/{}.txt"),
    ],
)
def test_frames_come_with_the_poses_beside_them(tmp_path, frames, poses, name, pose_name):
    write_images(tmp_path, frames, name, pose_name, poses)
    CAMERA.save(tmp_path / "camera.json")
    sequence = rp.open_sequence(tmp_path)
    for frame, pose in zip(sequence, poses, strict=True):
        assert frame.pose.dtype == np.float64
        np.testing.assert_array_equal(frame.pose, pose)
    np.testing.assert_array_equal(sequence[1:][0].pose, poses[1])
    np.testing.assert_array_equal(sequence.with_noise(None)[2].pose, poses[2])


def test_7_scenes_and_scannet(tmp_path, frames, poses):
    write_images(tmp_path / "seven", frames, "frame-{:06d}.depth.png", "frame-{:06d}.pose.txt", poses)
    np.testing.assert_array_equal(rp.open_sequence(tmp_path / "seven")[2].pose, poses[2])
    lost = poses.copy()
    lost[1] = -np.inf  # as ScanNet writes where the camera lost track
    write_images(tmp_path / "scan", frames, "depth/{}.png", "pose/{}.txt", lost)
    (tmp_path / "scan" / "intrinsic").mkdir()
    np.savetxt(tmp_path / "scan" / "intrinsic" / "intrinsic_depth.txt", np.diag([7.0, 7.0, 1.0, 1.0]) + _centre(4))
    scan = rp.open_sequence(tmp_path / "scan")
    assert scan[1].pose is None
    np.testing.assert_array_equal(scan[2].pose, poses[2])


def _centre(size):
    matrix = np.zeros((size, size))
    matrix[:2, 2] = 3.5, 2.5
    return matrix


def test_sens_recordings(tmp_path, frames, poses):
    write_sens(tmp_path / "a.sens", frames)
    content = (tmp_path / "a.sens").read_bytes()
    identity = np.eye(4, dtype="<f4").tobytes()
    header, *parts = content.split(identity + struct.pack("<QQ", 5, 0))
    moved = header + poses[0].astype("<f4").tobytes() + struct.pack("<QQ", 5, 0) + parts[0]
    (tmp_path / "a.sens").write_bytes(moved)
    sequence = rp.open_sequence(tmp_path / "a.sens")
    np.testing.assert_array_equal(sequence[0].pose, poses[0].astype("<f4"))
    np.testing.assert_array_equal(sequence[1].pose, np.eye(4))


def test_tum_between_two_lines_of_its_trajectory(tmp_path, frames):
    root = tmp_path / "freiburg1_xyz"
    write_tum(root, frames)
    times = rp.open_sequence(root).timestamps
    lines = ["# ground truth", "# timestamp tx ty tz qx qy qz qw"]
    for time, x, degrees in ((times[0] - 0.01, 1.0, 0.0), (times[0] + 0.03, 2.0, 40.0), (times[1] + 9.0, 5.0, 0.0)):
        turn = Rotation.from_euler("y", degrees, degrees=True).as_quat()
        lines.append(f"{time:.4f} {x} 0 -1 " + " ".join(map(str, turn)))
    (root / "groundtruth.txt").write_text("\n".join(lines) + "\n")
    sequence = rp.open_sequence(root)
    np.testing.assert_allclose(sequence[0].pose[:3, 3], [1.25, 0.0, -1.0], atol=0.01)
    turned = Rotation.from_matrix(sequence[0].pose[:3, :3])
    assert turned.magnitude() == pytest.approx(np.radians(10.0), abs=0.01)
    assert sequence[1].pose is None  # within a gap of 9 s
    assert sequence[2].pose is None


def test_a_trajectory_of_one_line(tmp_path, frames):
    root = tmp_path / "freiburg1_xyz"
    write_tum(root, frames)
    time = rp.open_sequence(root).timestamps[1]
    (root / "groundtruth.txt").write_text(f"{time} 1 2 3 0 0 0 1\nnonsense\n")
    with pytest.warns(UserWarning, match=r"^1 line of camera poses cannot be read, .*groundtruth.txt, line 2"):
        sequence = rp.open_sequence(root)
    assert [frame.pose is None for frame in sequence] == [True, False, True]
    np.testing.assert_array_equal(sequence[1].pose[:3, 3], [1, 2, 3])


def test_arkitscenes_take_the_world_to_the_camera(tmp_path, frames, poses):
    for folder in ("lowres_depth", "lowres_wide_intrinsics"):
        (tmp_path / folder).mkdir()
    lines = []
    for i, frame in enumerate(frames):
        images.write_png(tmp_path / "lowres_depth" / f"41048190_{100 + 0.1 * i:.3f}.png", frame)
        calibration = tmp_path / "lowres_wide_intrinsics" / f"41048190_{100 + 0.1 * i:.3f}.pincam"
        calibration.write_text("8 6 7.0 7.5 3.5 2.5")
        inverse = np.linalg.inv(poses[i])
        vector = Rotation.from_matrix(inverse[:3, :3]).as_rotvec()
        lines.append(" ".join(map(repr, map(float, (100 + 0.1 * i, *vector, *inverse[:3, 3])))))
    (tmp_path / "lowres_wide.traj").write_text("\n".join(lines))
    for frame, pose in zip(rp.open_sequence(tmp_path), poses, strict=True):
        np.testing.assert_allclose(frame.pose, pose, atol=1e-6)


def test_damaged_poses_are_named_once_and_frames_stay(tmp_path, frames, poses):
    write_images(tmp_path, frames, "frame-{:06d}.depth.png", "frame-{:06d}.pose.txt", poses)
    (tmp_path / "frame-000000.pose.txt").write_text("1 0 0 0 0 1 0 0")
    np.savetxt(tmp_path / "frame-000001.pose.txt", 2.0 * poses[1])  # a scale is no rigid motion
    with pytest.warns(
        UserWarning, match=r"^2 files of camera poses cannot be read, .*000000.pose.txt: expected"
    ) as told:
        sequence = sequences.seven_scenes(tmp_path)
    assert len(told) == 1
    assert [frame.pose is None for frame in sequence] == [True, True, False]
    (tmp_path / "frame-000000.pose.txt").write_text(" ".join(["-1.#IND000e+000"] * 16))  # lost track, by Windows
    (tmp_path / "frame-000001.pose.txt").unlink()
    assert sequences.seven_scenes(tmp_path)[0].pose is None


@pytest.mark.skipif(not real_data.FOLDER.is_dir(), reason=real_data.REASON)
def test_real_poses_move_smoothly():
    sequence = rp.open_sequence(real_data.FOLDER / "kinect1_7scenes_posed")
    poses = np.array([entry.pose for entry in sequence.entries])
    assert poses.shape == (len(sequence), 4, 4)
    assert np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).max() < 0.1
