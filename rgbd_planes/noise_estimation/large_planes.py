"""The large planes of a frame, on which a sensor's slowly varying errors show."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from rgbd_planes._core.arrays import Floats, Indices
from rgbd_planes._core.status import TileStatus
from rgbd_planes._core.user_warnings import collected_warnings
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.pixel_pitch import slope_square
from rgbd_planes.fitting.merge import merge
from rgbd_planes.fitting.tile_grid import tile_rays
from rgbd_planes.fitting.tile_planes import TilePlanes
from rgbd_planes.fitting.tiles import TileFitter
from rgbd_planes.noise.model import NoiseModel
from rgbd_planes.noise_estimation.samples import bins_of, mean_depth
from rgbd_planes.uncertainty.footprints import like_rectangles
from rgbd_planes.uncertainty.planes import same_plane

TILE = 16
"""Side in pixels of the tiles that large planes consist of."""
_LARGE = 60  # tiles that make a large plane
_ENOUGH = 8  # planes, of which the median is taken
_MEDIAN = 0.455  # of χ²(1)
_STEP = 1e-3  # p-value, by random errors alone, below which neighbours step aside
# How many times what their median says the mean of squares may be, at least and at most: with waves it is 0.6 to 2.
_APART = 2.6, 4.0
_IN_GROUPS = 0.82  # share of variance between two groups; 0.64 of a normal distribution, 0.75 of an even one
_STEEP = 0.3  # from a tile to the next, as a share of the whole range: of bumps 0.2
_BIAS, _BIAS_LENGTH = 1.0, 48.0  # expected bias, in standard deviations of a pixel, and its length in pixels


class LargePlanes(NamedTuple):
    """The K large planes of a frame.

    Attributes
    ----------
    labels : (R, C) int64
        The large plane that each tile is of, from 1; 0 for none.
    alpha : (K, 3) float64
    side : (K,) float64
        Side in pixels of a square as large as the rectangle in which the plane lies.
    bend : (K,) float64
        How far the plane is from flat over more than a tile: the mean square residual about it less that of its tiles
        about theirs, in σq² of the errors without rounding and the lateral error.
    """

    labels: Indices
    alpha: Floats
    side: Floats
    bend: Floats


def large_planes(frames: Sequence[Any], camera: Camera, num_threads: int | None = None) -> list[LargePlanes]:
    """Find the large planes of each frame, and how far they are bent, by the camera's noise."""
    noise = camera.noise
    assert noise is not None
    # With no bias assumed, the most bent planes would be rejected and their bias missed.
    wavy = replace(noise, floor=max(noise.floor, _BIAS), floor_length=max(noise.floor_length, _BIAS_LENGTH))
    fitter = TileFitter(camera.with_noise(wavy), TILE, significance=1e-3, num_threads=num_threads)
    with collected_warnings([]):  # nobody has given this noise, and of the frames others have warned
        return [_frame_planes(fitter.fit(depth), noise) for depth in frames]


def bends_by_side(large: Sequence[LargePlanes]) -> tuple[Floats, Floats, Floats]:
    """Medians of ``side`` and of ``bend`` of planes of similar sides, and the numbers of these planes."""
    side, bend = np.concatenate([np.empty((2, 0)), *((values.side, values.bend) for values in large)], axis=1)
    bins = [some for some in bins_of(side, _ENOUGH) if len(some)]
    sides, bends = ([float(np.median(values[some])) for some in bins] for values in (side, bend))
    return np.array(sides), np.array(bends), np.array([len(some) for some in bins], np.float64)


def _frame_planes(tiles: TilePlanes, noise: NoiseModel) -> LargePlanes:
    """Find the large planes among a frame's tiles."""
    labels = _connected(tiles, replace(noise, floor=0.0))
    merged = merge(tiles, labels)
    # Links from tile to tile can lead around a bend: tiles that are not on the common plane are left out.
    on_plane = labels > 0
    values = labels[on_plane] - 1
    on_plane[on_plane] = (
        same_plane(
            tiles.alpha[on_plane],
            tiles.alpha_covariance[on_plane],
            merged.alpha[values],
            merged.alpha_covariance[values],
        )
        > 1e-3
    )
    labels[~on_plane] = 0
    merged = merge(tiles, labels, significance=1e-3)
    many = np.bincount(labels.ravel(), minlength=len(merged.status) + 1)[1:]
    large = (many >= _LARGE) & (merged.status == TileStatus.OK)

    on_plane, number = labels > 0, labels[labels > 0] - 1
    count = tiles.valid_count[on_plane]
    q = 1.0 / mean_depth(tiles)[on_plane]
    variance = noise._along(q) ** 2 * noise._growth(*tile_rays(tiles.camera, tiles.tile).centre[:, on_plane])
    u, v = tiles._reference[:2, on_plane] + tiles._moments[1:3, on_plane] / count
    a, b, c = merged.alpha[number].T
    off = (q - (a * u + b * v + c)) / np.sqrt(variance)
    for k in np.flatnonzero(large):
        tile_offsets = np.full(labels.shape, np.nan)
        tile_offsets[on_plane] = np.where(number == k, off, np.nan)
        large[k] = not _is_in_two(tile_offsets)
    squares = (count * variance, count * tiles.rmse[on_plane] ** 2, noise._rounding(q))
    along, within, rounding = (np.bincount(number, values, len(many)) for values in squares)
    lateral = noise.lateral**2 * slope_square(merged.alpha, tiles.camera, merged._footprint)
    # Each tile's own three coefficients absorb as much of the independent errors.
    independent = 3.0 * (1.0 - 1.0 / np.maximum(many, 1)) * (rounding + many * lateral)
    bend = (merged.valid_count * merged.rmse**2 - within - independent)[large] / along[large]
    # Of the rest of the independent errors they absorb more where pixels are missing: as if none were.
    many = many[large]
    bend -= 3.0 * noise._white * (many - 1.0) * (1.0 / merged.valid_count[large] - 1.0 / (many * TILE**2))
    numbers = np.concatenate([[0], np.where(large, np.cumsum(large), 0)])
    side = np.sqrt(like_rectangles(merged._footprint).prod(axis=1))
    return LargePlanes(numbers[labels], merged.alpha[large], side[large], bend)


def _is_in_two(off: Floats) -> bool:
    """Whether a part of a plane lies apart from the rest, as a board that leans on a wall does.

    ``off``, (R, C), is how far each of its tiles lies off it, in standard deviations of a pixel; NaN for others. A wave
    of the sensor moves most of them, a board only those on it: then the mean square is far above what the median says.
    Or there are two groups, with little between them: then nearly all of the variance is between the two that leave
    least within (Otsu 1979). But a bump of the sensor is smooth; from a board to what is behind it is a step.
    """
    ordered = np.sort(off[np.isfinite(off)])
    count, squares = len(ordered), ordered**2
    below = np.arange(1, count)
    sums = np.cumsum(ordered)[:-1]
    apart = sums / below - (ordered.sum() - sums) / (count - below)
    between = float(np.max(below * (count - below) * (apart / count) ** 2, initial=0.0))
    ratio = np.mean(squares) * _MEDIAN / max(np.median(squares), 1e-300)
    in_groups = between > _IN_GROUPS * float(np.var(ordered))
    steps = max(np.nanmax(np.abs(np.diff(off, axis=axis)), initial=0.0) for axis in (0, 1))
    is_steep = steps > _STEEP * (ordered[-1] - ordered[0])
    return bool(ratio > _APART[1] or (is_steep and (ratio > _APART[0] or in_groups)))


def _connected(tiles: TilePlanes, random: NoiseModel) -> Indices:
    """Label, from 1, flat tiles that neighbours link to one plane; 0 elsewhere.

    Neighbours may differ as biased tiles do, but hardly more than by their ``random`` errors. A wave of the sensor is
    smooth; where a board begins, its tiles step aside.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    flat = tiles.status == TileStatus.OK
    alpha, covariance = tiles.alpha, tiles.alpha_covariance
    alone = replace(tiles, camera=tiles.camera.with_noise(random)).alpha_covariance
    index = np.arange(flat.size).reshape(flat.shape)
    links = []
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        same = same_plane(alpha[a], covariance[a], alpha[b], covariance[b]) > 0.05
        same &= same_plane(alpha[a], alone[a], alpha[b], alone[b]) > _STEP
        same &= flat[a] & flat[b]
        links.append((index[a][same], index[b][same]))
    first, second = (np.concatenate(ends) for ends in zip(*links, strict=True))
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(flat.size, flat.size))
    component = connected_components(graph, directed=False)[1].reshape(flat.shape)
    labels = np.zeros(flat.shape, np.int64)
    labels[flat] = np.unique(component[flat], return_inverse=True)[1] + 1
    return labels
