"""Colours with a meaning: those of normals, and of a tile's status."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rgbd_planes.camera import Camera
from rgbd_planes.plane_fits import TileStatus

Floats = NDArray[np.float64]

# Green, red and blue are the paper's (its figure of a segmented room corner); the green is bluish and the red is not,
# so that they differ for those who cannot tell green from red.
STATUS_COLOURS = {
    TileStatus.OK: (0.14, 0.63, 0.49),
    TileStatus.TOO_FEW: (0.90, 0.16, 0.06),
    TileStatus.DEGENERATE: (0.98, 0.75, 0.18),
    TileStatus.ROUGH: (0.20, 0.33, 0.85),
}
MISSING = (0.86, 0.86, 0.86)


def in_image(vectors: NDArray[Any], camera: Camera) -> Floats:
    """(..., 3) float64: vectors with x to the right of the image and y down it, even where fx or fy is negative."""
    return np.asarray(vectors * np.sign([camera.fx, camera.fy, 1.0]))


def normal_colours(normals: Floats) -> Floats:
    """Colours of unit normals: red grows to the right, green upwards, blue towards the camera.

    Parameters
    ----------
    normals : (..., 3) float64
        x to the right of the image, y down, z away from the camera: see `in_image`. NaN where there is none.

    Returns
    -------
    (..., 3) float64
        RGB in 0..1; light grey where there is no normal.
    """
    colours = 0.5 + 0.5 * normals * np.array([1.0, -1.0, -1.0])
    return np.where(np.isfinite(colours), colours, MISSING)
