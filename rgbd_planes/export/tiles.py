"""Planes of tiles, and points, for other tools: Open3D, PLY, ROS, JSON.

`rp.segmentation_export` is for segments, `rp.recording` for rerun.

All in the camera's frame (x right, y down, z forward) and in metres, which is also ROS's optical frame and
Open3D's. What is no `TilePlanes` raises a TypeError, the tiles of a batch a ValueError, and a path that cannot be
written an OSError.
"""

from __future__ import annotations

import json
import math
import os
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.checks import plain_array, real_array
from rgbd_planes._core.files import write_beside
from rgbd_planes._core.optional_imports import needs
from rgbd_planes._core.status import TileStatus
from rgbd_planes.camera.camera import Camera, check_camera
from rgbd_planes.camera.rays import rays_through
from rgbd_planes.export.open3d import triangle_mesh
from rgbd_planes.export.ros import ros_header, ros_planes, ros_polygons
from rgbd_planes.fitting.tile_planes import TilePlanes
from rgbd_planes.plotting.colours import in_image, normal_colours

if TYPE_CHECKING:
    import open3d


def tile_polygons(tiles: TilePlanes) -> Floats:
    """Return the corners of each fitted tile on its plane.

    Parameters
    ----------
    tiles : TilePlanes
        Of one frame.

    Returns
    -------
    (N, 4, 3) float64
        X, Y, Z in metres where the rays through the corners of the tile's corner pixels meet its plane,
        counter-clockwise about its normal: from the top left corner down, where the camera's fx and fy have the same
        sign. One for each tile that is fitted and that these rays all meet, row by row; see `exported`.
    """
    return polygons_of(tiles)[0]


def exported(tiles: TilePlanes) -> NDArray[np.bool_]:
    """(R, C) bool: which tiles `tile_polygons` has: fitted, and met by the rays through their corners."""
    return np.asarray(np.isfinite(_corners(tiles)).all(axis=(2, 3)))


def polygons_of(tiles: TilePlanes) -> tuple[Floats, Floats]:
    """`tile_polygons`, (N, 4, 3), and the planes that they lie on, (N, 4)."""
    corners = _corners(tiles)
    whole = np.isfinite(corners).all(axis=(2, 3))
    return corners[whole], tiles.planes[whole]


def _corners(tiles: TilePlanes) -> Floats:
    """(R, C, 4, 3); NaN where there is no plane or the ray does not meet it."""
    _check_one_frame(tiles)
    top = np.concatenate([[0], np.cumsum(tiles.tile_heights)])
    left = np.concatenate([[0], np.cumsum(tiles.tile_widths)])
    # Pixels reach half a pixel beyond their centres: so neighbouring tiles of one plane leave no gap.
    rows = np.stack([top[:-1], top[1:], top[1:], top[:-1]], axis=1)[:, None] - 0.5
    columns = np.stack([left[:-1], left[:-1], left[1:], left[1:]], axis=1)[None] - 0.5
    if tiles.camera.fx * tiles.camera.fy < 0:  # a mirror image, in which clockwise is the other way round
        rows, columns = rows[..., ::-1], columns[..., ::-1]
    rays = rays_through(tiles.camera, np.stack(np.broadcast_arrays(columns, rows), axis=-1))
    alpha = np.where(tiles.fitted[..., None], tiles.alpha, np.nan)
    inverse_depth = np.einsum("rci,rcki->rck", alpha, rays)
    depth = 1.0 / np.where(inverse_depth > 0.0, inverse_depth, np.nan)
    return np.asarray(rays * depth[..., None])


def to_dict(tiles: TilePlanes) -> dict[str, Any]:
    """Return a frame's planes in a form that JSON can hold.

    Parameters
    ----------
    tiles : TilePlanes
        Of one frame.

    Returns
    -------
    dict
        camera (`Camera.to_dict`), method, tile [height, width], and planes: for each tile that has one, its row,
        column, status, plane [nx, ny, nz, d], rmse, rmse_metric, valid_count and polygon, four points; if the camera
        has a noise model, also p_value and the covariance of the plane (4 x 4). None for a residual that is not known,
        and for a polygon whose plane some ray of its corners does not meet.

    Raises
    ------
    TypeError
        They are no `TilePlanes`.
    ValueError
        They are those of a batch, or the camera's noise model is a function.
    """
    _check_one_frame(tiles)
    corners = _corners(tiles)
    has_noise = tiles.camera.noise is not None
    planes = []
    for row, column in np.argwhere(tiles.fitted).tolist():
        at = (row, column)
        polygon = corners[at]
        uncertainty = (
            {"p_value": finite_or_none(tiles.p_value[at]), "covariance": tiles.plane_covariance[at].tolist()}
            if has_noise
            else {}
        )
        planes.append(
            {
                "row": row,
                "column": column,
                "status": TileStatus(tiles.status[at]).name,
                "plane": tiles.planes[at].tolist(),
                "rmse": finite_or_none(tiles.rmse[at]),
                "rmse_metric": finite_or_none(tiles.rmse_metric[at]),
                "valid_count": int(tiles.valid_count[at]),
                **uncertainty,
                "polygon": polygon.tolist() if np.isfinite(polygon).all() else None,
            }
        )
    return {"camera": tiles.camera.to_dict(), "method": tiles.method, "tile": list(tiles.tile), "planes": planes}


def write_json(path: str | os.PathLike[str], tiles: TilePlanes) -> None:
    """Write a frame's planes as JSON; whole or not at all.

    Parameters
    ----------
    path : path
    tiles : TilePlanes
        Of one frame; what is written is their `to_dict`.

    Raises
    ------
    TypeError
        They are not `TilePlanes`.
    ValueError
        They are those of a batch, or the camera's noise model is a function, or the path has the suffix of another
        format.
    OSError
        It cannot be written there.
    """
    with write_beside(path, ".json") as beside:
        beside.write_text(json.dumps(to_dict(tiles), allow_nan=False) + "\n", encoding="utf-8")


def write_ply(
    path: str | os.PathLike[str],
    points: ArrayLike,
    *,
    normals: ArrayLike | None = None,
    colours: ArrayLike | None = None,
    faces: ArrayLike | None = None,
) -> None:
    """Write points, or a mesh, as a binary PLY file; whole or not at all.

    Parameters
    ----------
    path : path
    points : (..., 3) array_like
        Metres. Points that are not finite, in single precision, are left out, if there are no faces.
    normals : (..., 3) array_like, optional
        Those that are not finite are written as zeros.
    colours : (..., 3) array_like, optional
        RGB in 0..1.
    faces : (F, K) array_like of int, optional
        Polygons of K points each, by the numbers of the points.

    Raises
    ------
    TypeError
        The arrays are masked, or not of numbers.
    ValueError
        Arrays of other shapes, colours outside 0..1, a face with a point that does not exist, or a path with the suffix
        of another format.
    """
    xyz = _single(_triples("points", points))
    written = np.isfinite(xyz).all(axis=1) if faces is None else np.ones(len(xyz), bool)
    columns = [("xyz"[i], "<f4", xyz[written, i]) for i in range(3)]
    if normals is not None:
        n = _single(_triples("normals", normals, len(xyz)))
        n[~np.isfinite(n).all(axis=1)] = 0.0  # viewers show a point without a normal, but not one with NaN
        columns += [("n" + "xyz"[i], "<f4", n[written, i]) for i in range(3)]
    if colours is not None:
        shares = _triples("colours", colours, len(xyz))[written]
        rgb = np.rint(255.0 * shares)
        if not ((rgb >= 0) & (rgb <= 255)).all():  # as 0 to 255 nearly all would be white
            raise ValueError(f"colours must be RGB in 0..1, got {shares.min():g} to {shares.max():g}")
        columns += [(("red", "green", "blue")[i], "u1", rgb[:, i]) for i in range(3)]
    vertices = np.empty(np.count_nonzero(written), [(name, dtype) for name, dtype, _ in columns])
    for name, _, values in columns:
        vertices[name] = values
    names = {"<f4": "float", "u1": "uchar"}
    header = ["ply", "format binary_little_endian 1.0", "comment metres, x right, y down, z forward"]
    header.append(f"element vertex {len(vertices)}")
    header += [f"property {names[dtype]} {name}" for name, dtype, _ in columns]
    body = vertices.tobytes()
    if faces is not None:
        corners = plain_array("faces", faces)
        if corners.ndim != 2 or not 3 <= corners.shape[1] < 256 or corners.dtype.kind not in "iu":
            raise ValueError(f"faces must be (F, K) integers, K from 3 to 255, got {corners.shape} of {corners.dtype}")
        if corners.size and not 0 <= corners.min() <= corners.max() < len(xyz):
            raise ValueError(
                f"faces must be numbers of points, 0 to {len(xyz) - 1}, got {corners.min()} to {corners.max()}"
            )
        polygons = np.empty(len(corners), [("count", "u1"), ("corners", "<i4", corners.shape[1])])
        polygons["count"], polygons["corners"] = corners.shape[1], corners
        header += [f"element face {len(corners)}", "property list uchar int vertex_indices"]
        body += polygons.tobytes()
    with write_beside(path, ".ply") as beside:
        beside.write_bytes("\n".join([*header, "end_header\n"]).encode("ascii") + body)


def _triples(name: str, values: ArrayLike, count: int | None = None) -> Floats:
    """(N, 3) float64 from (..., 3) numbers; N must be ``count``, if that is given."""
    array = real_array(name, values)
    if array.shape[-1:] != (3,) or count not in (None, array.size // 3):
        expected = "(..., 3)" if count is None else f"(..., 3), {count} in all, as many as points"
        raise ValueError(f"expected {name} of shape {expected}, got {array.shape}")
    return array.reshape(-1, 3)


def _single(values: Floats) -> NDArray[np.float32]:
    """Numbers in single precision: infinite where they are too large for it."""
    with np.errstate(over="ignore"):
        return values.astype(np.float32)


def write_tiles_ply(path: str | os.PathLike[str], tiles: TilePlanes) -> None:
    """Write the fitted tiles of a frame as a PLY mesh of quadrilaterals, coloured by their normals.

    Parameters
    ----------
    path : path
    tiles : TilePlanes
        Of one frame; the quadrilaterals are their `tile_polygons`.
    """
    points, normals, colours = _tile_mesh(tiles)
    faces = np.arange(len(points)).reshape(-1, 4)
    write_ply(path, points, normals=normals, colours=colours, faces=faces)


def to_open3d(tiles: TilePlanes) -> open3d.geometry.TriangleMesh:
    """Return the fitted tiles of a frame as an Open3D mesh, two triangles per tile, coloured by their normals.

    Parameters
    ----------
    tiles : TilePlanes
        Of one frame.

    Raises
    ------
    ModuleNotFoundError
        open3d is not installed.
    """
    points, normals, colours = _tile_mesh(tiles)
    quads = np.arange(len(points)).reshape(-1, 4)
    return triangle_mesh(points, quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3), normals, colours)


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


def to_ros_planes(tiles: TilePlanes, frame_id: str = "", stamp: Any = 0.0) -> dict[str, Any]:
    """Return a frame's planes in the shape of jsk_recognition_msgs/ModelCoefficientsArray.

    Parameters
    ----------
    tiles : TilePlanes
        Of one frame.
    frame_id : str
        Name of the camera's optical frame.
    stamp : float, or a message's stamp
        Seconds, an unknown time, NaN, as 0; or, kept exactly, an object or mapping with sec and nanosec, or ROS 1's
        secs and nsecs, a time of rclpy, which has nanoseconds, or a `numpy.datetime64`.

    Returns
    -------
    dict
        header and coefficients: for each polygon of `to_ros_polygons` its header and values [nx, ny, nz, d]. The fields
        of ROS 2; ROS 1's header has a ``seq``, too, and its time secs and nsecs.

    Raises
    ------
    TypeError, ValueError
        The name is no str, or the stamp is no time that ROS can hold; and for tiles as all functions here.
    """
    return ros_planes(polygons_of(tiles)[1], frame_id, stamp)


def to_ros_polygons(tiles: TilePlanes, frame_id: str = "", stamp: Any = 0.0) -> dict[str, Any]:
    """Return the fitted tiles of a frame in the shape of jsk_recognition_msgs/PolygonArray.

    Parameters
    ----------
    tiles : TilePlanes
        Of one frame.
    frame_id : str
        Name of the camera's optical frame.
    stamp : float, or a message's stamp
        Seconds, or a time of ROS: `to_ros_planes` lists the forms.

    Returns
    -------
    dict
        header; polygons, each a geometry_msgs/PolygonStamped; labels, 1..N; likelihood, empty.
    """
    polygons = tile_polygons(tiles)
    return ros_polygons(list(polygons), list(range(1, len(polygons) + 1)), frame_id, stamp)


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
    points = _single(camera.points(depth)).astype("<f4")
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


def _tile_mesh(tiles: TilePlanes) -> tuple[Floats, Floats, Floats]:
    """Four points for each polygon, with their normals and colours."""
    polygons, planes = polygons_of(tiles)
    normals = planes[:, :3]
    colours = normal_colours(in_image(normals, tiles.camera))
    return polygons.reshape(-1, 3), normals.repeat(4, axis=0), colours.repeat(4, axis=0)


def _check_one_frame(tiles: TilePlanes) -> None:
    if not isinstance(tiles, TilePlanes):
        kind = type(tiles).__name__
        where = "; rp.segmentation_export is for segments" if kind == "Segmentation" else ""
        raise TypeError(f"expected TilePlanes, got {kind}{where}")
    if len(tiles.shape) != 2:
        raise ValueError(f"expected the tiles of one frame, got a batch of shape {tiles.shape}: take tiles[i]")


def finite_or_none(value: float) -> float | None:
    """A number as JSON has it, which has no infinity and no NaN."""
    return float(value) if math.isfinite(value) else None
