"""Planes of tiles for other tools: Open3D, PLY, ROS, JSON.

`rp.segmentation_export` is for segments, `rp.recording` for rerun.

All in the camera's frame (x right, y down, z forward) and in metres, which is also ROS's optical frame and
Open3D's. What is no `TilePlanes` raises a TypeError, the tiles of a batch a ValueError, and a path that cannot be
written an OSError.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.status import TileStatus
from rgbd_planes.camera.rays import rays_through
from rgbd_planes.export.json_files import finite_or_none, write_json_file
from rgbd_planes.export.open3d import triangle_mesh
from rgbd_planes.export.ply import write_ply
from rgbd_planes.export.ros import ros_planes, ros_polygons
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
        X, Y, Z in metres, where the rays through the tile's outer pixel corners meet its plane. Corners run
        counter-clockwise about the normal: from the top left one down, where fx and fy have the same sign. Tiles come
        row by row. A tile without a plane is left out, and so is one whose plane some of these rays do not meet.
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
        camera (`Camera.to_dict`), method, tile [height, width], and planes. Each tile that has a plane has its row,
        column, status, plane [nx, ny, nz, d], rmse, rmse_metric, valid_count and polygon, four points. With a noise
        model it has p_value and the covariance of the plane (4 x 4), too. A residual that is not known is None. So is
        a polygon whose plane some ray of its corners does not meet.

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
    write_json_file(path, to_dict(tiles))


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


def to_ros_planes(tiles: TilePlanes, frame_id: str = "", stamp: Any = 0.0) -> dict[str, Any]:
    """Return a frame's planes in the shape of jsk_recognition_msgs/ModelCoefficientsArray.

    Parameters
    ----------
    tiles : TilePlanes
        Of one frame.
    frame_id : str
        Name of the camera's optical frame.
    stamp : float, or a message's stamp
        Seconds; NaN, an unknown time, becomes 0. Kept exactly are objects and mappings with sec and nanosec, or ROS 1's
        secs and nsecs. So are a time of rclpy, which has nanoseconds, and a `numpy.datetime64`.

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
