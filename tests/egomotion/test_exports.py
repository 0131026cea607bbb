"""Trajectories as files, messages and pictures; the map of planes; the command."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_odometry import CAMERA, poses_of, relative, room

import rgbd_planes as rp
from rgbd_planes.camera.frame import Frame
from rgbd_planes.cli.main import main
from rgbd_planes.plotting.trajectory import plot_trajectory


@pytest.fixture(scope="module")
def walk() -> list[rp.CameraPose]:
    frames = room(poses_of(8, 0.04))
    timed = [Frame(depth, CAMERA, 100.0 + 0.1 * i, str(i)) for i, depth in enumerate(frames)]
    return list(rp.odometry(timed))


def test_a_file_in_the_format_of_tum(walk: list[rp.CameraPose], tmp_path: Path) -> None:
    rp.export.write_trajectory(tmp_path / "path.txt", walk)
    rows = np.loadtxt(tmp_path / "path.txt")
    np.testing.assert_allclose(rows[:, 0], 100.0 + 0.1 * np.arange(8))
    np.testing.assert_allclose(rows[:, 1:4], [pose.T_world_camera[:3, 3] for pose in walk], atol=1e-8)
    turned = Rotation.from_quat(rows[:, 4:]).as_matrix()
    np.testing.assert_allclose(turned, [pose.T_world_camera[:3, :3] for pose in walk], atol=1e-8)
    with pytest.raises(TypeError, match="CameraPose"):
        rp.export.write_trajectory(tmp_path / "none.txt", [np.eye(4)])  # type: ignore[list-item]
    assert not (tmp_path / "none.txt").exists()


def test_a_message_of_ros(walk: list[rp.CameraPose]) -> None:
    pose = walk[-1]
    message = rp.export.to_ros_odometry(pose, "map", "camera")
    assert message["header"] == {"stamp": {"sec": 100, "nanosec": 700000000}, "frame_id": "map"}
    assert message["child_frame_id"] == "camera"
    covariance = np.reshape(message["pose"]["covariance"], (6, 6))
    rotation = pose.T_world_camera[:3, :3]
    np.testing.assert_allclose(covariance[:3, :3], rotation @ pose.covariance[3:, 3:] @ rotation.T)
    np.testing.assert_allclose(covariance[:3, 3:], rotation @ pose.covariance[3:, :3] @ rotation.T)
    assert list(message["pose"]["pose"]["position"].values()) == pose.T_world_camera[:3, 3].tolist()
    with pytest.raises(TypeError, match="child_frame_id"):
        rp.export.to_ros_odometry(pose, "map", 3)  # type: ignore[arg-type]


def test_a_map_of_planes(walk: list[rp.CameraPose]) -> None:
    pytest.importorskip("shapely")
    plane_map = rp.PlaneMap()
    for pose in walk:
        plane_map.add(pose)
    seen = sum(int((pose.segmentation.segmentation.sizes >= 500).sum()) for pose in walk)
    assert 0 < len(plane_map) < 0.4 * seen  # planes of several frames are one
    floor = max(plane_map.polygons, key=lambda polygon: polygon.area)
    assert [polygon.label for polygon in plane_map.polygons] == list(range(1, len(plane_map) + 1))
    # True planes in the world, the camera of the first frame.
    first = poses_of(1)[0]
    truth = np.array([surface.plane for surface in rp.scenes.room().surfaces]) @ first
    truth = np.concatenate([truth, -truth])
    assert np.abs(truth - floor.plane).max(axis=1).min() < 0.02
    points = floor.to_space(np.asarray(floor.metric.geoms[0].exterior.coords))
    assert np.abs(points @ floor.plane[:3] + floor.plane[3]).max() < 0.01
    with pytest.raises(TypeError, match="CameraPose"):
        plane_map.add(walk[0].segmentation)  # type: ignore[arg-type]


def test_a_picture(walk: list[rp.CameraPose]) -> None:
    figure = plot_trajectory(walk, relative(poses_of(8, 0.04)))
    assert len(figure.axes) == 3
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert labels == ["truth", "odometry", "keyframes"]


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from PIL import Image

    folder = tmp_path / "seq-01"
    folder.mkdir()
    CAMERA.save(folder / "camera.json")
    truth = poses_of(5)
    for i, (depth, pose) in enumerate(zip(room(truth), truth, strict=True)):
        Image.fromarray(depth).save(folder / f"frame-{i:06d}.depth.png")
        np.savetxt(folder / f"frame-{i:06d}.pose.txt", pose)
    (folder / "frame-000005.depth.png").write_bytes(b"no image")
    np.savetxt(folder / "frame-000005.pose.txt", np.eye(4))
    out, figure = tmp_path / "path.txt", tmp_path / "path.png"
    arguments = ["odometry", str(folder), "--camera", str(folder / "camera.json"), "--format", "seven_scenes"]
    assert main([*arguments, "--out", str(out), "--figure", str(figure)]) == 1  # a frame was skipped
    said = capsys.readouterr()
    assert "5 frames, a path of 0.0" in said.out
    assert "Against the data set's poses" in said.out
    assert "skipped frame 5" in said.err
    assert np.loadtxt(out).shape == (5, 8)
    assert figure.stat().st_size > 10_000
    assert main([*arguments, "--out", str(tmp_path / "path.csv")]) == 2
    assert "ends in .txt" in capsys.readouterr().err
