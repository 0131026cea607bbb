"""The rays through any points of the image, between pixels, too."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Floats
from rgbd_planes.camera.camera import Camera


def rays_through(camera: Camera, pixels: npt.ArrayLike) -> Floats:
    """(..., 3) float64: rays (tanθx, tanθy, 1) through any points (x, y) of the image, (..., 2).

    Between pixel centres the camera's tables are interpolated; up to a pixel outside they are continued.
    """
    x, y = np.moveaxis(np.asarray(pixels, dtype=np.float64), -1, 0)
    column = np.clip(np.floor(x).astype(int), 0, max(camera.width - 2, 0))
    row = np.clip(np.floor(y).astype(int), 0, max(camera.height - 2, 0))
    s, t = x - column, y - row
    next_column, next_row = np.minimum(column + 1, camera.width - 1), np.minimum(row + 1, camera.height - 1)
    tan_x, tan_y = (
        (1 - t) * ((1 - s) * table[row, column] + s * table[row, next_column])
        + t * ((1 - s) * table[next_row, column] + s * table[next_row, next_column])
        for table in (camera.tan_x, camera.tan_y)
    )
    # There is no change from one column, or row, to the next where there is only one: that of the pinhole is taken.
    if camera.width == 1:
        tan_x = tan_x + s / camera.fx
    if camera.height == 1:
        tan_y = tan_y + t / camera.fy
    return np.stack([tan_x, tan_y, np.ones_like(x)], axis=-1)


def ray_tables(camera: Camera) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """(H, W) tanθx and tanθy; views of one row and one column if these hold all rays: less to read."""
    tan_x, tan_y = camera._rays
    return np.broadcast_to(tan_x, camera.shape), np.broadcast_to(tan_y, camera.shape)
