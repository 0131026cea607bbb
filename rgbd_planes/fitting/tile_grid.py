"""The grid of tiles of a frame, and what the camera alone determines of them."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from rgbd_planes.camera.camera import Camera
from rgbd_planes.uncertainty.footprints import footprints


def check_tile(tile: int | tuple[int, int], frame: tuple[int, int]) -> tuple[int, int]:
    """Return a tile's (height, width), for a frame of (height, width)."""
    height, width = tile_sides(tile)
    if height > frame[0] or width > frame[1]:
        raise ValueError(f"tile must fit into the frame of (height, width) = {frame}, got {tile!r}")
    return height, width


def tile_sides(tile: int | tuple[int, int]) -> tuple[int, int]:
    """Return a tile's (height, width), for frames of any size."""
    given: Any = tile.tolist() if isinstance(tile, np.ndarray) else tile
    several = isinstance(given, Sequence) and not isinstance(given, (bytes, bytearray))  # of which ints come out
    sides = tuple(given) if several else (given, given)
    if len(sides) != 2 or not all(isinstance(side, (int, np.integer)) for side in sides):
        raise TypeError(f"tile must be a whole number of pixels or (height, width), got {tile!r}")
    height, width = int(sides[0]), int(sides[1])
    if height < 2 or width < 2:
        raise ValueError(f"tile must be at least 2 x 2 pixels, got {tile!r}")
    return height, width


def common_labels(
    lowest: npt.NDArray[np.int32], highest: npt.NDArray[np.int32], tile: int | tuple[int, int]
) -> npt.NDArray[np.int32]:
    """(R, C) int32: the label of each tile whose smallest and largest labels are the same, 0 for the others.

    ``lowest`` and ``highest`` are (H, W): the label of each pixel that counts for the smallest, and for the largest.
    """
    for axis, (length, size) in enumerate(zip(lowest.shape, check_tile(tile, lowest.shape), strict=True)):
        starts = np.arange(0, length, size)
        lowest = np.minimum.reduceat(lowest, starts, axis=axis)
        highest = np.maximum.reduceat(highest, starts, axis=axis)
    return np.where(lowest == highest, highest, 0).astype(np.int32)


def tile_sizes(length: int, tile: int) -> npt.NDArray[np.int64]:
    """Sizes of the tiles along a side, the last one ragged."""
    starts = np.arange(0, length, tile)
    return np.minimum(starts + tile, length) - starts


def grid_shape(camera: Camera, tile: tuple[int, int]) -> tuple[int, int]:
    """Number of rows and of columns of a frame's tiles."""
    return -(-camera.height // tile[0]), -(-camera.width // tile[1])


def tile_places(
    frame: tuple[int, int], tile: tuple[int, int], shape: tuple[int, ...]
) -> dict[str, npt.NDArray[np.int64]]:
    """The columns of a table that say which tile a row is: in a grid of ``shape`` (R, C), or (F, R, C) of a batch."""
    *number, row, column = np.indices(shape).reshape(len(shape), -1)
    places = {"frame": number[0]} if number else {}
    return places | {
        "row": row,
        "column": column,
        "top": row * tile[0],
        "left": column * tile[1],
        "height": tile_sizes(frame[0], tile[0])[row],
        "width": tile_sizes(frame[1], tile[1])[column],
    }


@lru_cache(maxsize=16)
def tile_windows(frame: tuple[int, int], tile: tuple[int, int]) -> npt.NDArray[np.int64]:
    """(R * C, 4) int64: row, column, height, width of every tile of a frame of (height, width)."""
    heights, widths = tile_sizes(frame[0], tile[0]), tile_sizes(frame[1], tile[1])
    windows = np.empty((len(heights), len(widths), 4), np.int64)
    windows[..., 0] = (np.arange(len(heights)) * tile[0])[:, None]
    windows[..., 1] = np.arange(len(widths)) * tile[1]
    windows[..., 2] = heights[:, None]
    windows[..., 3] = widths
    windows.flags.writeable = False
    return windows.reshape(-1, 4)


@lru_cache(maxsize=16)
def tile_footprints(frame: tuple[int, int], tile: tuple[int, int]) -> npt.NDArray[np.int64]:
    """(R * C, 5) int64: `footprints` of every tile."""
    result = footprints(tile_windows(frame, tile))
    result.flags.writeable = False
    return result


class TileRays(NamedTuple):
    """The rays of a camera's tiles.

    Attributes
    ----------
    centre : (2, R, C) float64
        The mean of tanθx and tanθy over each tile, the reference point of its moments.
    tan_x, tan_y : (H, W) float64
        The camera's rays. For a camera without lens distortion, (C * tile width,) and (H,): tanθx of each column and
        tanθy of each row, relative to the centre of its tile. Columns that the last tile lacks are 0.
    """

    centre: npt.NDArray[np.float64]
    tan_x: npt.NDArray[np.float64]
    tan_y: npt.NDArray[np.float64]


@lru_cache(maxsize=4)
def tile_rays(camera: Camera, tile: tuple[int, int]) -> TileRays:
    """Return the rays of a camera's tiles of (height, width)."""
    heights, widths = tile_sizes(camera.height, tile[0]), tile_sizes(camera.width, tile[1])
    centre = np.empty((2, len(heights), len(widths)))
    if not camera.is_distorted:
        column_tan_x, row_tan_y = camera.tan_x_columns, camera.tan_y_rows
        centre[0], centre[1] = (_means(column_tan_x, widths), _means(row_tan_y, heights)[:, None])
        tan_x, tan_y = np.zeros(len(widths) * tile[1]), row_tan_y - np.repeat(centre[1, :, 0], heights)
        tan_x[: camera.width] = column_tan_x - np.repeat(centre[0, 0], widths)
        tan_x.flags.writeable = tan_y.flags.writeable = False
    else:
        tan_x, tan_y = camera.tan_x, camera.tan_y
        centre[0] = _means(_means(tan_x, widths).T, heights).T
        centre[1] = _means(_means(tan_y, widths).T, heights).T
    centre.flags.writeable = False
    return TileRays(centre, tan_x, tan_y)


def _means(values: npt.NDArray[np.float64], sizes: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """Mean of each run of ``sizes`` values along the last axis."""
    means: npt.NDArray[np.float64] = np.add.reduceat(values, np.cumsum(sizes) - sizes, axis=-1) / sizes
    return means
