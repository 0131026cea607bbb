"""Points and meshes in PLY files, shared by the exports of tiles and of segments."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.checks import plain_array, real_array
from rgbd_planes._core.files import write_beside


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
    xyz = single_precision(_triples("points", points))
    written = np.isfinite(xyz).all(axis=1) if faces is None else np.ones(len(xyz), bool)
    columns = [("xyz"[i], "<f4", xyz[written, i]) for i in range(3)]
    if normals is not None:
        n = single_precision(_triples("normals", normals, len(xyz)))
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


def single_precision(values: Floats) -> NDArray[np.float32]:
    """Numbers in single precision: infinite where they are too large for it."""
    with np.errstate(over="ignore"):
        return values.astype(np.float32)
