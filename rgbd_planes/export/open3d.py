"""Meshes of Open3D, shared by the exports of tiles and of segments."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.optional_imports import needs

if TYPE_CHECKING:
    import open3d


def triangle_mesh(
    points: Floats, triangles: NDArray[np.int_], normals: Floats, colours: Floats
) -> "open3d.geometry.TriangleMesh":
    """Return an Open3D mesh of (P, 3) points, with their normals and colours, and (T, 3) triangles of them."""
    with needs("open3d", None):
        import open3d
    vector = open3d.utility.Vector3dVector
    mesh = open3d.geometry.TriangleMesh(vector(points), open3d.utility.Vector3iVector(triangles.astype(np.int32)))
    mesh.vertex_normals, mesh.vertex_colors = vector(normals), vector(colours)
    return mesh
