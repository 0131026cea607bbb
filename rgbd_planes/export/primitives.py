"""Balls, pipes and planes of `fit_primitives` for other tools: JSON, PLY, ROS markers.

All in the camera's frame (x right, y down, z forward) and in metres. What is no `PrimitiveFits` raises a TypeError, and
a path that cannot be written an OSError.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.arrays import Floats, Indices
from rgbd_planes._core.status import Primitive
from rgbd_planes.export.json_files import finite_or_none, write_json_file
from rgbd_planes.export.ply import write_ply
from rgbd_planes.export.ros import ros_header
from rgbd_planes.plotting.colours import label_colours
from rgbd_planes.primitives.result import PrimitiveFits

_MARKERS = {Primitive.SPHERE: 2, Primitive.CYLINDER: 3}
"""Types of visualization_msgs/Marker."""
_NUMBERS = ("radius", "radius_std", "rmse", "rmse_metric", "p_value", "p_flat")


def to_dict(primitives: PrimitiveFits) -> dict[str, Any]:
    """Return the primitives in a form that JSON can hold.

    Parameters
    ----------
    primitives : PrimitiveFits

    Returns
    -------
    dict
        camera (`Camera.to_dict`) and primitives, by label; labels that are NONE are left out. Each has label, kind,
        radius and radius_std, centre, axis, covariance (7 x 7) of centre, axis and radius, convex, size and valid_count
        in pixels, rmse in 1/m, rmse_metric in metres, p_value and p_flat. What a kind does not have is None.

    Raises
    ------
    TypeError
        It is no `PrimitiveFits`.
    ValueError
        The camera's noise model is a function.
    """
    _check(primitives)
    sizes, columns = primitives.sizes, {name: getattr(primitives, name) for name in _NUMBERS}
    rows = [
        {
            "label": k + 1,
            "kind": Primitive(primitives.kind[k]).name,
            **{name: finite_or_none(values[k]) for name, values in columns.items()},
            "centre": primitives.centre[k].tolist(),
            "axis": None if primitives.kind[k] == Primitive.SPHERE else primitives.axis[k].tolist(),
            "covariance": primitives.covariance[k].tolist(),
            "convex": bool(primitives.convex[k]),
            "size": int(sizes[k]),
            "valid_count": int(primitives.valid_count[k]),
        }
        for k in np.flatnonzero(primitives.kind != Primitive.NONE).tolist()
    ]
    return {"camera": primitives.camera.to_dict(), "primitives": rows}


def write_json(path: str | os.PathLike[str], primitives: PrimitiveFits) -> None:
    """Write the primitives as JSON; whole or not at all.

    Parameters
    ----------
    path : path
    primitives : PrimitiveFits
        What `to_dict` gives of it is written.

    Raises
    ------
    TypeError, ValueError
        As `to_dict`, or the path has the suffix of another format.
    OSError
        It cannot be written there.
    """
    write_json_file(path, to_dict(primitives))


def patches(primitives: PrimitiveFits, step: int = 2) -> tuple[Floats, Indices, NDArray[np.intp]]:
    """Triangulate the part of each primitive that its label shows.

    Parameters
    ----------
    primitives : PrimitiveFits
    step : int
        Pixels between the corners of the triangles.

    Returns
    -------
    points : (P, 3) float64
        Corners on the primitives, on the rays of pixels.
    triangles : (T, 3) int64
        Numbers of their corners, counterclockwise seen from the camera.
    labels : (P,) intp
        The label of each corner.
    """
    _check(primitives)
    depth = primitives.surface_depth()[::step, ::step]
    camera, label = primitives.camera, primitives.labels[::step, ::step]
    rays = np.stack(np.broadcast_arrays(camera.tan_x, camera.tan_y, 1.0), axis=-1)[::step, ::step]
    number = np.full(depth.shape, -1)
    there = np.isfinite(depth)
    number[there] = np.arange(np.count_nonzero(there))
    corners = [(0, 0), (1, 0), (1, 1), (0, 1)]
    rows, columns = (max(0, side - 1) for side in depth.shape)
    squares = np.stack([number[y : y + rows, x : x + columns] for y, x in corners], axis=-1)
    own = np.stack([label[y : y + rows, x : x + columns] for y, x in corners], axis=-1)
    alike = (own == own[..., :1]).all(axis=-1) & (squares >= 0).all(axis=-1)
    chosen = squares[alike]
    triangles = np.concatenate([chosen[:, [0, 1, 2]], chosen[:, [0, 2, 3]]])
    return rays[there] * depth[there][:, None], triangles, label[there].astype(np.intp)


def write_mesh_ply(path: str | os.PathLike[str], primitives: PrimitiveFits, step: int = 2) -> None:
    """Write the part of each primitive that its label shows as a PLY mesh, each in its colour, with normals.

    Parameters
    ----------
    path : path
    primitives : PrimitiveFits
    step : int
        Pixels between the corners of the triangles.

    Raises
    ------
    TypeError
        It is no `PrimitiveFits`.
    ValueError
        The path has the suffix of another format.
    OSError
        It cannot be written there.
    """
    points, triangles, labels = patches(primitives, step)
    colours = label_colours(len(primitives))[labels - 1]
    write_ply(path, points, normals=_normals(primitives, points, labels), colours=colours, faces=triangles)


def to_ros_markers(primitives: PrimitiveFits, frame_id: str = "", stamp: Any = 0.0) -> dict[str, Any]:
    """Return the spheres and cylinders in the shape of visualization_msgs/MarkerArray.

    Parameters
    ----------
    primitives : PrimitiveFits
    frame_id : str
        Name of the camera's optical frame.
    stamp : float, or a message's stamp
        Seconds, or a time of ROS: `to_ros_planes` lists the forms.

    Returns
    -------
    dict
        markers, one for each sphere and cylinder, with the label as id. A cylinder is as long as its label shows it.

    Raises
    ------
    TypeError, ValueError
        It is no `PrimitiveFits`, or `frame_id` or `stamp` is none.
    """
    points, _, labels = patches(primitives, 1)
    colours = label_colours(len(primitives))
    markers = []
    for k in np.flatnonzero(primitives.kind >= Primitive.SPHERE).tolist():
        middle, turn = primitives.centre[k], np.array([0.0, 0.0, 0.0, 1.0])
        length = width = 2.0 * primitives.radius[k]
        if primitives.kind[k] == Primitive.CYLINDER:
            axis = primitives.axis[k]
            along = (points[labels == k + 1] - middle) @ axis
            middle, length = middle + 0.5 * (along.min() + along.max()) * axis, np.ptp(along)
            turn = _from_z(axis)
        markers.append(
            {
                "header": ros_header(frame_id, stamp),
                "ns": "primitives",
                "id": k + 1,
                "type": _MARKERS[Primitive(primitives.kind[k])],
                "action": 0,
                "pose": {
                    "position": dict(zip("xyz", middle.tolist(), strict=True)),
                    "orientation": dict(zip("xyzw", turn.tolist(), strict=True)),
                },
                "scale": {"x": float(width), "y": float(width), "z": float(length)},
                "color": {**dict(zip("rgb", colours[k].tolist(), strict=True)), "a": 1.0},
            }
        )
    return {"markers": markers}


def _from_z(axis: Floats) -> Floats:
    """(4,) float64: quaternion x, y, z, w that turns the z axis to a unit vector."""
    if axis[2] < 0.0:
        axis = -axis  # a cylinder's axis has no sign
    turn = np.array([-axis[1], axis[0], 0.0, 1.0 + axis[2]])
    return np.asarray(turn / np.linalg.norm(turn))


def _normals(primitives: PrimitiveFits, points: Floats, labels: NDArray[np.intp]) -> Floats:
    """(P, 3) float64: unit normals at points on primitives, towards the camera."""
    kind, axis = primitives.kind[labels - 1], primitives.axis[labels - 1]
    away = points - primitives.centre[labels - 1]
    is_cylinder = (kind == Primitive.CYLINDER)[:, None]
    along = np.where(is_cylinder, (away * axis).sum(axis=1, keepdims=True), 0.0)
    away = np.where((kind == Primitive.PLANE)[:, None], axis, away - np.where(is_cylinder, along * axis, 0.0))
    towards = -np.sign((away * points).sum(axis=1, keepdims=True))
    return np.asarray(towards * away / np.linalg.norm(away, axis=1, keepdims=True))


def _check(primitives: Any) -> None:
    if not isinstance(primitives, PrimitiveFits):
        made = ": rp.fit_primitives makes them of its curved_labels" if hasattr(primitives, "curved_labels") else ""
        raise TypeError(f"expected PrimitiveFits, got {type(primitives).__name__}{made}")
