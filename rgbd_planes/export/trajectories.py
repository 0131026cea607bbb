"""Poses for other tools: TUM's text format, and ROS."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from typing import Any

import numpy as np

from rgbd_planes._core.checks import each_of
from rgbd_planes._core.files import write_beside
from rgbd_planes.egomotion.pose import CameraPose
from rgbd_planes.export.ros import ros_header


def write_trajectory(path: str | os.PathLike[str], poses: Iterable[CameraPose]) -> None:
    """Write poses in TUM's format, which evo reads: a line "timestamp tx ty tz qx qy qz qw" for each frame.

    Parameters
    ----------
    path : path
    poses : iterable of CameraPose
        Frames that are lost have the prior's pose. The timestamp of a frame that states none is its number.

    Raises
    ------
    OSError
        It cannot be written there.
    TypeError
        One is no `CameraPose`.
    """
    lines = ["# timestamp tx ty tz qx qy qz qw, camera to world, world is the camera of the first frame"]
    for pose in each_of(poses):
        _check(pose)
        time = f"{pose.index}" if math.isnan(pose.timestamp) else f"{pose.timestamp:.6f}"
        lines.append(" ".join([time, *(f"{value:.9f}" for value in (*pose.T_world_camera[:3, 3], *pose.quaternion))]))
    with write_beside(path) as beside:
        beside.write_text("\n".join(lines) + "\n", encoding="utf-8")


def to_ros_odometry(
    pose: CameraPose, frame_id: str = "odom", child_frame_id: str = "", stamp: Any = None
) -> dict[str, Any]:
    """Return a pose in the shape of nav_msgs/Odometry.

    Parameters
    ----------
    pose : CameraPose
    frame_id : str
        Name of the world, whose axes are those of the first frame's camera.
    child_frame_id : str
        Name of the camera's optical frame.
    stamp : float, or a message's stamp, optional
        Seconds, or a ROS stamp, which is kept exactly. By default the frame's own time.

    Returns
    -------
    dict
        ``pose.covariance`` is about the world's axes, translation first, relative to the pose's reference keyframe.
        ``twist`` is zero, with a covariance of -1 in its first entry: not known.

    Raises
    ------
    TypeError, ValueError
        It is no `CameraPose`, a name no string, or the stamp no time.
    """
    _check(pose)
    if not isinstance(child_frame_id, str):
        raise TypeError(f"expected child_frame_id as a str, got {child_frame_id!r}")
    rotation = pose.T_world_camera[:3, :3]
    turn = np.zeros((6, 6))
    turn[:3, 3:], turn[3:, :3] = rotation, rotation  # ROS has the translation first
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    return {
        "header": ros_header(frame_id, pose.timestamp if stamp is None else stamp),
        "child_frame_id": child_frame_id,
        "pose": {
            "pose": {
                "position": dict(zip("xyz", pose.T_world_camera[:3, 3].tolist(), strict=True)),
                "orientation": dict(zip("xyzw", pose.quaternion.tolist(), strict=True)),
            },
            "covariance": (turn @ pose.covariance @ turn.T).ravel().tolist(),
        },
        "twist": {"twist": {"linear": zero, "angular": dict(zero)}, "covariance": [-1.0] + [0.0] * 35},
    }


def _check(pose: Any) -> None:
    if not isinstance(pose, CameraPose):
        raise TypeError(f"expected a CameraPose, which Odometry gives, got {type(pose).__name__}")
