"""Colours with a meaning: those of normals, of a tile's status, and of labels."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.status import TileStatus
from rgbd_planes.camera.camera import Camera

# Green, red and blue are the paper's (its figure of a segmented room corner); the green is bluish and the red is not,
# so that they differ for those who cannot tell green from red.
STATUS_COLOURS = {
    TileStatus.OK: (0.14, 0.63, 0.49),
    TileStatus.TOO_FEW: (0.90, 0.16, 0.06),
    TileStatus.DEGENERATE: (0.98, 0.75, 0.18),
    TileStatus.ROUGH: (0.20, 0.33, 0.85),
}
MISSING = (0.86, 0.86, 0.86)
NO_PLANE = (0.22, 0.22, 0.22)  # darker than any label, so that nobody takes it for one
_GOLDEN = 0.618033988749895


def in_image(vectors: NDArray[Any], camera: Camera) -> Floats:
    """(..., 3) float64: vectors with x to the right of the image and y down it, even where fx or fy is negative."""
    return np.asarray(vectors * np.sign([camera.fx, camera.fy, 1.0]))


def normal_colours(normals: Floats) -> Floats:
    """Colours of unit normals: red grows to the right, green upwards, blue towards the camera.

    Parameters
    ----------
    normals : (..., 3) float64
        x to the right of the image, y down, z away from the camera. NaN where there is none.

    Returns
    -------
    (..., 3) float64
        RGB in 0..1; light grey where there is no normal.
    """
    colours = 0.5 + 0.5 * normals * np.array([1.0, -1.0, -1.0])
    return np.where(np.isfinite(colours), colours, MISSING)


def status_colours(status: NDArray[np.uint8]) -> Floats:
    """(..., 3) float64: RGB of each `TileStatus`."""
    return np.array([STATUS_COLOURS[one] for one in TileStatus])[status]


def label_colours(count: int) -> Floats:
    """(count, 3) float64: RGB of labels 1..count, neighbouring labels far apart in hue."""
    i = np.arange(count)
    hue = (0.08 + i * _GOLDEN) % 1.0
    saturation = 0.45 + 0.3 * ((i // 3) % 3) / 2.0
    value = 0.95 - 0.25 * ((i // 2) % 3) / 2.0
    sector = (hue[:, None] * 6.0 + np.array([5.0, 3.0, 1.0])) % 6.0
    return np.asarray(
        value[:, None] * (1.0 - saturation[:, None] * np.clip(np.minimum(sector, 4.0 - sector), 0.0, 1.0))
    )


CONVEX, FLAT, CONCAVE = (0.70, 0.09, 0.17), (0.97, 0.97, 0.97), (0.13, 0.40, 0.67)


def diverging_colours(values: Floats) -> Floats:
    """(..., 3) float64: RGB of values from -1 (blue) over 0 (white) to 1 (red); light grey for NaN."""
    share = np.clip(np.abs(values), 0.0, 1.0)[..., None]
    ends = np.where(values[..., None] >= 0.0, CONVEX, CONCAVE)
    # The root of the share: small values can be told from none.
    colours = np.array(FLAT) + np.sqrt(share) * (ends - np.array(FLAT))
    return np.where(np.isfinite(colours), colours, MISSING)
