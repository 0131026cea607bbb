"""The tiles of a frame, as an alignment takes them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.rays import ray_tables
from rgbd_planes.fitting.tile_planes import TilePlanes
from rgbd_planes.segmentation.result import Segmentation

TILES = 1200  # about so many in a frame: 16 pixels wide at 640 x 480
ROUGHEST = 6.0  # residual of a tile, in typical standard deviations of the frame's inverse depth
SAMPLES = 4  # pixels along each side of a tile whose labels are looked at
LABELLED = 0.75  # share of them, at least, that must have the label of a plane
CELLS = 4  # of the grid of rays, along each side of a tile


def tile_size_for(camera: Camera) -> int:
    """Size of a tile in pixels."""
    return int(np.clip(round(np.sqrt(camera.width * camera.height / TILES)), 4, 64))


@dataclass(frozen=True, eq=False)
class TileRays:
    """The rays of a camera's tiles.

    Attributes
    ----------
    tile : int
        Pixels.
    middle : (T, 2) float64
        Mean tanθx and tanθy of each tile's rays; NaN for a tile without rays.
    table : (A, B) int32
        Tile that a ray meets, by the cells of a grid of rays; -1 outside the image.
    bounds : (4,) float64
        Least tanθx and tanθy of the grid, and cells per tangent along both.
    width : float
        Of a tile, as a tangent.
    """

    tile: int
    middle: Floats
    table: NDArray[np.int32]
    bounds: Floats
    width: float


@lru_cache(maxsize=8)
def rays_of_tiles(camera: Camera) -> TileRays:
    """The rays of a camera's tiles, any lens."""
    from scipy.spatial import cKDTree

    tile = tile_size_for(camera)
    tan_x, tan_y = ray_tables(camera)
    rows, columns = (-(-size // tile) for size in camera.shape)
    row, column = np.indices(camera.shape) // tile
    number = row * columns + column
    has_ray = np.isfinite(tan_x) & np.isfinite(tan_y)
    counts = np.bincount(number[has_ray], minlength=rows * columns)
    with np.errstate(invalid="ignore"):
        middle = np.column_stack(
            [np.bincount(number[has_ray], tan[has_ray], rows * columns) / counts for tan in (tan_x, tan_y)]
        )
    step = max(1, tile // (2 * CELLS))
    some = has_ray[::step, ::step]
    rays = np.column_stack([tan_x[::step, ::step][some], tan_y[::step, ::step][some]])
    low, high = rays.min(axis=0), rays.max(axis=0)
    shape = CELLS * columns, CELLS * rows
    scale = np.divide(shape, np.maximum(high - low, 1e-9))
    x, y = (low[i] + (np.arange(shape[i]) + 0.5) / scale[i] for i in (0, 1))
    cells = np.stack(np.broadcast_arrays(x, y[:, None]), axis=-1)
    found = cKDTree(rays * scale).query(cells.reshape(-1, 2) * scale, distance_upper_bound=CELLS)
    inside, nearest = np.isfinite(found[0]), np.asarray(found[1])
    table = np.full(cells.shape[0] * cells.shape[1], -1, np.int32)
    table[inside] = number[::step, ::step][some][nearest[inside]]
    width = float(np.sqrt(np.prod(high - low) / (rows * columns)))
    return TileRays(tile, middle, table.reshape(shape[1], shape[0]), np.concatenate([low, scale]), width)


@dataclass(frozen=True, eq=False)
class FrameTiles:
    """The tiles of a frame that hold one surface.

    Attributes
    ----------
    tiles : (N, 6) float64
        Mean ray (tanθx, tanθy), inverse depth q there, and α: of the plane that the whole tile lies on, or its own.
    groups : (N,) intp
        Plane that the whole tile lies on, 0 to P - 1; other tiles have numbers of their own from P.
    counts : (G,) intp
        Tiles of each group.
    plane_count : int
        P.
    model : (T, 3) float64
        The same α for each tile of the frame; NaN where a tile holds no surface.
    sigma : float
        Typical standard deviation of the frame's inverse depth, 1/m.
    depth : float
        Median depth of the tiles, in metres; 1 where there are none.
    """

    tiles: Floats
    groups: NDArray[np.intp]
    counts: NDArray[np.intp]
    plane_count: int
    model: Floats
    sigma: float
    depth: float


def tiles_of_frame(fits: TilePlanes, found: Segmentation, rays: TileRays) -> FrameTiles:
    """The tiles of a frame, from the fits of its tiles and its planes."""
    alpha = fits.alpha.reshape(-1, 3)
    u, v = rays.middle.T
    with np.errstate(invalid="ignore"):
        q = alpha[:, 0] * u + alpha[:, 1] * v + alpha[:, 2]
        good = (fits.rmse.ravel() <= ROUGHEST * found.sigma) & (q > 0.0)  # both are NaN without a plane
    labels = _labels_of_tiles(found.labels, rays.tile, fits.shape[-1])
    there = np.flatnonzero(good)
    model = np.full((len(q), 3), np.nan)
    model[there] = alpha[there]
    on_plane = there[labels[there] > 0]
    model[on_plane] = found.alpha[labels[on_plane] - 1]
    label = labels[there]
    groups = np.where(label > 0, label - 1, len(found) + np.arange(len(there)))
    counts = np.bincount(groups, minlength=len(found))
    tiles = np.column_stack([u[there], v[there], q[there], model[there]])
    depth = 1.0 / float(np.median(q[there])) if len(there) else 1.0
    return FrameTiles(tiles, groups, counts, len(found), model, found.sigma, depth)


def _labels_of_tiles(labels: NDArray[np.int32], tile: int, columns: int) -> NDArray[np.int32]:
    """(T,): the label that nearly all of some pixels of a tile have, the others none; 0 if there is no such one."""
    places = (np.arange(SAMPLES) * tile + tile // 2) // SAMPLES
    height, width = labels.shape

    def along(size: int) -> NDArray[np.intp]:
        return np.asarray(np.minimum((np.arange(-(-size // tile)) * tile)[:, None] + places, size - 1).ravel(), np.intp)

    some = labels[along(height)[:, None], along(width)]
    each = some.reshape(-1, SAMPLES, columns, SAMPLES).transpose(0, 2, 1, 3).reshape(-1, SAMPLES * SAMPLES)
    most = each.max(axis=1)
    alike = np.count_nonzero(each == most[:, None], axis=1)
    is_alone = alike == np.count_nonzero(each, axis=1)  # nor is any where no pixel has a label
    return np.asarray(np.where(is_alone & (alike >= LABELLED * SAMPLES**2), most, 0), np.int32)
