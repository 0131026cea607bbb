"""The measured points of a depth frame for other tools."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from rgbd_planes._core.optional_imports import needs
from rgbd_planes.camera.camera import Camera, check_camera
from rgbd_planes.export.ply import single_precision
from rgbd_planes.export.ros import ros_header

if TYPE_CHECKING:
    import open3d


def points_to_open3d(depth: ArrayLike, camera: Camera) -> open3d.geometry.PointCloud:
    """Return the measured points of a depth frame as an Open3D point cloud, missing ones left out.

    Parameters
    ----------
    depth : (H, W) array_like
        The frame: floats in metres, or integers in the camera's ``depth_scale``; disparities of a camera that has
        ``disparity``.
    camera : Camera

    Raises
    ------
    ModuleNotFoundError
        open3d is not installed.
    """
    with needs("open3d", None):
        import open3d
    check_camera(camera)
    points = camera.points(depth).reshape(-1, 3)
    return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points[np.isfinite(points[:, 2])]))


def to_ros_points(depth: ArrayLike, camera: Camera, frame_id: str = "", stamp: Any = 0.0) -> dict[str, Any]:
    """Return the points of a depth frame in the shape of sensor_msgs/PointCloud2, organised as the frame.

    Parameters
    ----------
    depth : (H, W) array_like
    camera : Camera
    frame_id : str
        Name of the camera's optical frame.
    stamp : float, or a message's stamp
        Seconds, or a time of ROS: `to_ros_planes` lists the forms.

    Returns
    -------
    dict
        Fields x, y, z of float32; NaN where the depth is missing.

    Raises
    ------
    TypeError, ValueError
        The frame is not an array of the camera's size, or holds integers without a unit. Or the name is no str, or the
        stamp is no time that ROS can hold.
    """
    check_camera(camera)
    points = single_precision(camera.points(depth)).astype("<f4")
    height, width, _ = points.shape
    return {
        "header": ros_header(frame_id, stamp),
        "height": height,
        "width": width,
        "fields": [{"name": "xyz"[i], "offset": 4 * i, "datatype": 7, "count": 1} for i in range(3)],
        "is_bigendian": False,
        "point_step": 12,
        "row_step": 12 * width,
        "data": points.tobytes(),
        "is_dense": bool(np.isfinite(points).all()),
    }
