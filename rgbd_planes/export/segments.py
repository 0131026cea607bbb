"""Segmented planes for other tools: JSON, label images, PLY, Open3D, ROS. `rp.recording` is for rerun.

Segmentations are those of `segment`, or the planes of your own labels, of `fit_labels`. All in the camera's frame (x
right, y down, z forward) and in metres. What is neither, or no `PlanePolygon`, raises a TypeError, and a path that
cannot be written an OSError.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.status import TileStatus
from rgbd_planes._core.text import counted
from rgbd_planes.export.json_files import finite_or_none, write_json_file
from rgbd_planes.export.open3d import triangle_mesh
from rgbd_planes.export.ply import write_ply
from rgbd_planes.export.ros import ros_header, ros_planes, ros_polygons
from rgbd_planes.fitting.labels import LabelPlanes
from rgbd_planes.fitting.tile_planes import TilePlanes
from rgbd_planes.plotting.colours import NO_PLANE, label_colours
from rgbd_planes.segmentation.polygons import PlanePolygon
from rgbd_planes.segmentation.result import Segmentation, no_segmentation
from rgbd_planes.sequences.images import write_png

if TYPE_CHECKING:
    import open3d

Segmented = Segmentation | LabelPlanes


def to_dict(segmentation: Segmented, polygons: Sequence[PlanePolygon] | None = None) -> dict[str, Any]:
    """Return the planes in a form that JSON can hold.

    Parameters
    ----------
    segmentation : Segmentation or LabelPlanes
    polygons : sequence of PlanePolygon, optional
        All that `plane_polygons` gave, in any order; adds each plane's area, outline, hull and rectangle.

    Returns
    -------
    dict
        camera (`Camera.to_dict`), sigma, and planes, by label. Each plane has its label, plane [nx, ny, nz, d],
        covariance of these (4 x 4), size in pixels, rmse in 1/m and rmse_metric in metres. Numbers of a plane without
        pixels are None. Of `LabelPlanes` those with a plane are there, with their status. The method takes the place
        of sigma then, and rmse is in its units. p_value and covariance need a noise model.

    Raises
    ------
    TypeError
        It is neither a `Segmentation` nor a `LabelPlanes`, or the polygons are no `PlanePolygon`.
    ValueError
        The camera's noise model is a function, or the polygons are not those of this segmentation.
    """
    _check(segmentation)
    outlines = None if polygons is None else _by_label(segmentation, polygons)
    made: dict[str, Any] = {"camera": segmentation.camera.to_dict()}
    if isinstance(segmentation, Segmentation):
        made["sigma"] = segmentation.sigma
        columns_of_kind = {"covariance": segmentation.plane_covariance.tolist()}
        sizes = segmentation.sizes
    else:
        made["method"] = segmentation.method
        columns_of_kind = {"status": [TileStatus(status).name for status in segmentation.status]}
        if segmentation.camera.noise is not None:
            columns_of_kind |= {"p_value": list(map(finite_or_none, segmentation.p_value))}
            columns_of_kind |= {"covariance": segmentation.plane_covariance.tolist()}
        sizes = segmentation.valid_count
    columns = {
        "label": list(range(1, len(segmentation.planes) + 1)),
        "plane": segmentation.planes.tolist(),
        **columns_of_kind,
        "size": sizes.tolist(),
        "rmse": list(map(finite_or_none, segmentation.rmse)),
        "rmse_metric": list(map(finite_or_none, segmentation.rmse_metric)),
    }
    rows = (dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True))
    planes = [row for row, there in zip(rows, _fitted(segmentation), strict=True) if there]
    if outlines is not None:
        for plane, polygon in zip(planes, outlines, strict=True):
            plane.update(polygon.to_dict())
    return made | {"planes": planes}


def write_json(
    path: str | os.PathLike[str], segmentation: Segmented, polygons: Sequence[PlanePolygon] | None = None
) -> None:
    """Write the planes as JSON; whole or not at all.

    Parameters
    ----------
    path : path
    segmentation : Segmentation or LabelPlanes
        What `to_dict` gives of it is written.
    polygons : sequence of PlanePolygon, optional
        All that `plane_polygons` gave: adds each plane's area, outline, hull and rectangle.

    Raises
    ------
    TypeError
        It is neither a `Segmentation` nor a `LabelPlanes`, or the polygons are not `PlanePolygon`.
    ValueError
        The camera's noise model is a function, or the polygons are not those of this segmentation, or the path has the
        suffix of another format.
    OSError
        It cannot be written there.
    """
    write_json_file(path, to_dict(segmentation, polygons))


def write_labels(path: str | os.PathLike[str], segmentation: Segmented) -> None:
    """Write the labels as a 16-bit PNG, 0 for none; whole or not at all.

    Parameters
    ----------
    path : path
        Ends in .png.
    segmentation : Segmentation or LabelPlanes
        Of at most 65535 planes.

    Raises
    ------
    TypeError
        It is neither a `Segmentation` nor a `LabelPlanes`.
    ValueError
        There are more than 65535 planes, or the path has another suffix.
    OSError
        It cannot be written there.
    """
    _check(segmentation)
    if len(segmentation.planes) > 65535:
        raise ValueError(f"expected at most 65535 planes, which 16 bits can tell apart, got {len(segmentation.planes)}")
    write_png(path, segmentation.labels.astype(np.uint16))


def write_points_ply(path: str | os.PathLike[str], segmentation: Segmented, depth: ArrayLike) -> None:
    """Write the measured points as a PLY file, each in the colour of its plane and with its normal.

    Points on no plane are dark grey and their normals zero.

    Parameters
    ----------
    path : path
    segmentation : Segmentation or LabelPlanes
    depth : (H, W) array_like
        The frame that was segmented.

    Raises
    ------
    TypeError, ValueError
        It is neither a `Segmentation` nor a `LabelPlanes`, or the frame is not its camera's.
    OSError
        It cannot be written there.
    """
    _check(segmentation)
    measured = segmentation.camera.points(depth).reshape(-1, 3)
    labels = segmentation.labels.ravel()
    seen = np.isfinite(measured).all(axis=1)
    normals = np.vstack([np.zeros(3), segmentation.planes[:, :3]])
    colours = np.vstack([[NO_PLANE], label_colours(len(segmentation.planes))])
    write_ply(path, measured[seen], normals=normals[labels[seen]], colours=colours[labels[seen]])


def write_polygons_ply(path: str | os.PathLike[str], polygons: Sequence[PlanePolygon]) -> None:
    """Write the outlines as a PLY mesh of triangles, each plane in its colour; holes are holes.

    Parameters
    ----------
    path : path
    polygons : sequence of PlanePolygon
        Outlines in camera or world coordinates, in metres, from `plane_polygons`.
    """
    points, normals, colours = _mesh(polygons)
    faces = np.arange(len(points)).reshape(-1, 3)
    write_ply(path, points, normals=normals, colours=colours, faces=faces)


def to_open3d(polygons: Sequence[PlanePolygon]) -> open3d.geometry.TriangleMesh:
    """Return the outlines as an Open3D mesh, each plane in its colour; holes are holes.

    Parameters
    ----------
    polygons : sequence of PlanePolygon
        Outlines in camera or world coordinates, in metres, from `plane_polygons`.

    Raises
    ------
    ModuleNotFoundError
        open3d is not installed.
    """
    points, normals, colours = _mesh(polygons)
    return triangle_mesh(points, np.arange(len(points)).reshape(-1, 3), normals, colours)


def to_ros_planes(segmentation: Segmented, frame_id: str = "", stamp: Any = 0.0) -> dict[str, Any]:
    """Return the planes in the shape of jsk_recognition_msgs/ModelCoefficientsArray.

    Parameters
    ----------
    segmentation : Segmentation or LabelPlanes
    frame_id : str
        Name of the camera's optical frame.
    stamp : float, or a message's stamp
        Seconds; NaN, an unknown time, becomes 0. Kept exactly are objects and mappings with sec and nanosec, or ROS 1's
        secs and nsecs. So are a time of rclpy, which has nanoseconds, and a `numpy.datetime64`.

    Returns
    -------
    dict
        header and coefficients: for each plane its header and values [nx, ny, nz, d], by label; labels that have none
        are left out.

    Raises
    ------
    TypeError, ValueError
        It is neither a `Segmentation` nor a `LabelPlanes`, or `frame_id` or `stamp` is none.
    """
    _check(segmentation)
    return ros_planes(segmentation.planes[_fitted(segmentation)], frame_id, stamp)


def to_ros_polygons(polygons: Sequence[PlanePolygon], frame_id: str = "", stamp: Any = 0.0) -> dict[str, Any]:
    """Return the outlines in the shape of jsk_recognition_msgs/PolygonArray.

    Parameters
    ----------
    polygons : sequence of PlanePolygon
    frame_id : str
        Name of the camera's optical frame.
    stamp : float, or a message's stamp
        Seconds, or a time of ROS: `to_ros_planes` lists the forms.

    Returns
    -------
    dict
        header; polygons, one for each part of a plane, without its holes, which the message has no place for; labels,
        for each part its plane's; likelihood, empty.
    """
    parts = [(polygon.label, part[0]) for polygon in _all_polygons(polygons) for part in polygon.rings()]
    return ros_polygons([ring for _, ring in parts], [label for label, _ in parts], frame_id, stamp)


def to_ros_labels(segmentation: Segmented, frame_id: str = "", stamp: Any = 0.0) -> dict[str, Any]:
    """Return the labels in the shape of sensor_msgs/Image, 32SC1; 0 is none.

    Parameters
    ----------
    segmentation : Segmentation or LabelPlanes
    frame_id : str
        Name of the camera's optical frame.
    stamp : float, or a message's stamp
        Seconds, or a time of ROS: `to_ros_planes` lists the forms.

    Raises
    ------
    TypeError, ValueError
        It is neither a `Segmentation` nor a `LabelPlanes`, or `frame_id` or `stamp` is none.
    """
    _check(segmentation)
    labels = segmentation.labels.astype("<i4")
    height, width = labels.shape
    return {
        "header": ros_header(frame_id, stamp),
        "height": height,
        "width": width,
        "encoding": "32SC1",
        "is_bigendian": 0,
        "step": 4 * width,
        "data": labels.tobytes(),
    }


def _check(segmentation: Segmented) -> None:
    if isinstance(segmentation, TilePlanes):
        raise TypeError("expected a Segmentation or LabelPlanes, got TilePlanes; rp.export is for tiles")
    if not isinstance(segmentation, Segmentation | LabelPlanes):
        raise no_segmentation(segmentation, "a Segmentation or LabelPlanes")


def _fitted(segmentation: Segmented) -> NDArray[np.bool_]:
    """(N,) bool: which labels have a plane."""
    if isinstance(segmentation, LabelPlanes):
        return segmentation.fitted
    return np.ones(len(segmentation), bool)


def _all_polygons(polygons: Iterable[PlanePolygon]) -> list[PlanePolygon]:
    listed = list(polygons) if isinstance(polygons, Iterable) else [polygons]
    for polygon in listed:
        if not isinstance(polygon, PlanePolygon):
            is_segmented = isinstance(polygon, Segmentation | LabelPlanes)
            made = ": rp.plane_polygons makes them of it" if is_segmented else ""
            raise TypeError(f"expected a sequence of PlanePolygon, got {polygons!r}{made}")
    return listed


def _by_label(segmentation: Segmented, polygons: Sequence[PlanePolygon]) -> list[PlanePolygon]:
    """The polygons of a segmentation in the order of its planes."""
    ordered = sorted(_all_polygons(polygons), key=lambda polygon: polygon.label)
    planes = np.array([polygon.plane for polygon in ordered]).reshape(-1, 4)
    own = segmentation.planes[_fitted(segmentation)]
    if not np.array_equal(planes, own):
        others = " of other planes" if len(planes) == len(own) else ""
        raise ValueError(
            f"expected the polygon of each of the {counted(len(own), 'plane')} of this segmentation, "
            f"got {counted(len(planes), 'polygon')}{others}"
        )
    return ordered


def _mesh(polygons: Sequence[PlanePolygon]) -> tuple[Floats, Floats, Floats]:
    """Three points for each triangle of the outlines, with their normals and colours."""
    polygons = _all_polygons(polygons)
    # The colours of their labels, as points have them, even if only some of the planes are here.
    labels = np.array([polygon.label for polygon in polygons], dtype=np.intp)
    colours = label_colours(int(labels.max(initial=0)))[labels - 1]
    triangles = [polygon.triangles() for polygon in polygons]
    corners = [3 * len(own) for own in triangles]
    points = np.concatenate([*triangles, np.empty((0, 3, 3))]).reshape(-1, 3)
    normals = np.array([polygon.plane[:3] for polygon in polygons]).reshape(-1, 3)
    return points, normals.repeat(corners, axis=0), colours.repeat(corners, axis=0)
