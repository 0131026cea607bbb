"""What segmentations of one camera's frames share: the grid of blocks, and arrays to work in."""

import functools
import threading
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rgbd_planes.camera import Camera
from rgbd_planes.kernels.segment_blocks import BLOCK

Floats = NDArray[np.float64]

LEVELS = 4  # blocks, and squares of 2, 4 and 8 blocks


@dataclass(frozen=True, eq=False)
class Grid:
    """What the blocks of a camera's frames have in common."""

    shapes: NDArray[np.int64]  # (LEVELS, 2): rows and columns of each level of the pyramid
    offsets: NDArray[np.int64]  # (LEVELS + 1,): where each begins
    tan_x: Floats  # (1, W) and (H, 1), or (H, W) both
    tan_y: Floats
    pitch: tuple[float, float]  # change of tanθx and tanθy from pixel to pixel
    centre_u: Floats  # (R, C): tanθx, tanθy in the middle of each block
    centre_v: Floats


@functools.lru_cache(maxsize=8)
def grid_of(camera: Camera) -> Grid:
    """The grid of a camera; the sizes of a level are twice those of the next."""
    height, width = camera.shape
    largest = BLOCK << (LEVELS - 1)
    rows, columns = -(-height // largest), -(-width // largest)
    shapes = [(rows << level, columns << level) for level in reversed(range(LEVELS))]
    rows, columns = shapes[0]
    middle = np.ix_(
        np.minimum(np.arange(rows) * BLOCK + BLOCK // 2, height - 1),
        np.minimum(np.arange(columns) * BLOCK + BLOCK // 2, width - 1),
    )
    sizes = np.array(shapes).prod(axis=1)
    return Grid(
        shapes=np.array(shapes),
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        tan_x=camera.tan_x_columns[None, :] if camera.is_separable else camera.tan_x,
        tan_y=camera.tan_y_rows[:, None] if camera.is_separable else camera.tan_y,
        pitch=(1.0 / camera.fx, 1.0 / camera.fy),
        centre_u=camera.tan_x[middle],
        centre_v=camera.tan_y[middle],
    )


class Workspace:
    """Arrays to work in. New ones for every frame would cost a millisecond: the system clears them."""

    def __init__(self, camera: Camera) -> None:
        self.shape = camera.shape
        pixels = camera.height * camera.width
        grid = grid_of(camera)
        blocks = int(grid.shapes[0].prod())
        self.inverse_depth = np.empty(camera.shape, np.float32)
        self.owner = np.empty(tuple(grid.shapes[0]), np.int32)
        self.pixel_owner = np.empty((blocks, BLOCK**2), np.int32)
        self.pyramid = np.empty((10, grid.offsets[-1]))
        self.rss, self.slope = np.empty(grid.offsets[-1]), np.empty(grid.offsets[-1])
        self.moments = np.empty((blocks, 10))
        self.squares = np.empty(blocks)
        self.pairs = np.empty((4 * blocks + 1, 3), np.int32)
        self.contact = np.empty((4 * blocks, 3))
        self.table = np.zeros(1 << (4 * blocks).bit_length(), np.int32)
        self.runs = np.empty((7, pixels), np.int32)


class Workspaces(threading.local):
    """One for each thread."""

    work: Workspace | None = None

    def of(self, camera: Camera) -> Workspace:
        if self.work is None or self.work.shape != camera.shape:
            self.work = Workspace(camera)
        return self.work


workspaces = Workspaces()
