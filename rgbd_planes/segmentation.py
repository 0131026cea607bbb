"""Segment a depth frame into planes."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes.camera import Camera
from rgbd_planes.checks import check_camera, check_whole
from rgbd_planes.compilation import announced
from rgbd_planes.depth import DepthFrame, as_depth_frame
from rgbd_planes.kernels import (
    segment_blocks,
    segment_gaps,
    segment_labels,
    segment_merge,
    segment_parts,
    segment_planes,
    segment_quadtree,
    segment_regions,
    segment_runs,
    segment_shape,
)
from rgbd_planes.segmentation_noise import FrameNoise, estimate
from rgbd_planes.segmentation_result import Reason, Segmentation
from rgbd_planes.segmentation_workspace import Grid, Workspace, grid_of, workspaces

Floats = NDArray[np.float64]

SMALLEST = 60  # pixels of a region, where the caller does not say
CUT = 4.0  # standard deviations: the most that a pixel counts for in a region's residual
FILLED = 5  # neighbours of eight that take a stray pixel with them


@dataclass(frozen=True)
class Rules:
    """The constants of the segmentation.

    Deviations are standard deviations of the frame's own noise, so none of these knows a sensor, a unit or a
    distance. `bench.segmentation` cross-validates them.
    """

    rough_block: float = 3.0  # deviations of a planar block
    steep_block: float = 0.6  # the same for the part that the block's own slope makes
    square_floor: float = 1.0  # when four neighbouring squares are one plane: see `join_blocks`
    square_spread: float = 30.0
    region_floor: float = 4.5  # when two regions are one plane: see `merge`
    region_jump: float = 6.0
    region_spread: float = 30.0
    reach: float = 8.0  # deviations within which a region contends for a pixel
    close: float = 3.0  # deviations within which two planes meet
    settled: float = 3.0  # deviations of a block that is left in peace
    rough: float = 3.0  # deviations of a region that is several planes, or none
    sharp: float = 12.0  # degrees, root mean square, by which the normals of a curved surface turn
    blunt: float = 28.0  # degrees below which planes meet as the facets of something curved do
    narrow: float = 4.5  # pixels: the mean length of runs along rows, and along columns, that a plane has
    trips: int = 3  # from planes to pixels and back


# Of parts and of pixels, as the kernels take them.
_REASONS = tuple(
    np.uint8(r) for r in (Reason.PLANE, Reason.SMALL, Reason.ROUGH, Reason.CURVED, Reason.NARROW)
)
_REASON_OF_PIXELS = np.uint8(Reason.MISSING), np.uint8(Reason.UNCLAIMED)


def segment(depth: ArrayLike, camera: Camera, *, noise: Any = None, min_size: int = SMALLEST) -> Segmentation:
    """Find the planes of a depth frame and the pixels that belong to each.

    Parameters
    ----------
    depth : (H, W) array_like
        Integers in the camera's raw units, or floats in metres; see `as_depth_frame`.
    camera : Camera
    noise : float, callable or noise model, optional
        Standard deviation of inverse depth in 1/m, a function that gives it for an array of inverse depths,
        or what has such a function as ``sigma``; its ``lateral`` error, in pixels, is taken from there, too, if
        it has one. By default ``camera.noise``; what nothing says, the frame's own residuals say.
    min_size : int
        Pixels that a plane must have.

    Returns
    -------
    Segmentation
        Labels 1..N in the order of their first pixels. An empty or a formless frame has none. Parts of a plane
        that something thin in front separates have one label; curved surfaces have none.

    Raises
    ------
    TypeError, ValueError
        As `as_depth_frame`, and for a `noise` or a `min_size` that cannot be.

    Notes
    -----
    Blocks of 4x4 pixels, joined by fours where they are one plane, are merged by what joining adds to the
    sum of squared residuals in inverse depth, which moments give exactly (Papadakis and Willis 2017 split
    squares in the same space, from above). Then each pixel goes to the plane it fits, the planes are fitted
    anew to the pixels they own, and this is done again until it has settled. The same bits come out for
    the same frame, always.
    """
    check_camera(camera)
    check_whole("min_size", min_size, 3, "whole number of pixels")
    frame = as_depth_frame(depth, camera)
    given = camera.noise if noise is None else noise
    sigma, lateral = _as_function(given), float(getattr(given, "lateral", 0.0))
    with announced(("segment", frame.raw.dtype)):
        return segment_frame(frame, camera, sigma, min_size, Rules(), lateral)


def _as_function(noise: Any) -> Callable[[Floats], Floats] | None:
    sigma = getattr(noise, "sigma", noise)  # of a noise model
    if sigma is None or callable(sigma):
        return sigma  # type: ignore[no-any-return]
    if not isinstance(noise, (int, float, np.number)):
        raise TypeError(f"noise must be a number in 1/m, a function of inverse depth or None, got {noise!r}")
    if isinstance(noise, bool) or not 0.0 < noise < np.inf:
        raise ValueError(f"noise must be a positive standard deviation in 1/m, got {noise!r}")
    return lambda q: np.full_like(q, noise)


def segment_frame(
    frame: DepthFrame,
    camera: Camera,
    sigma: Callable[[Floats], Floats] | None,
    min_size: int,
    rules: Rules,
    lateral: float = 0.0,
) -> Segmentation:
    """`segment` by other rules, which is for experiments."""
    grid = grid_of(camera)
    work = workspaces.of(camera)
    squares_of = work.pyramid, grid.offsets, grid.shapes
    nearest = segment_blocks.block_moments(
        frame.raw, frame.lowest, frame.highest, frame.scale, frame.offset, frame.is_disparity,
        grid.tan_x, grid.tan_y, *grid.pitch, grid.shapes[0, 0], grid.shapes[0, 1],
        work.inverse_depth, work.pyramid, work.rss, work.slope,
    )  # fmt: skip
    segment_blocks.sum_by_fours(*squares_of, *grid.pitch, work.rss, work.slope)
    noise = estimate(
        frame, work.pyramid, work.rss, work.slope, grid.offsets, grid.shapes, nearest, sigma, lateral
    )  # fmt: skip
    spread = (noise.sigma, (noise.lateral / camera.fx) ** 2, (noise.lateral / camera.fy) ** 2)

    state = np.empty(grid.offsets[-1], np.int8)
    segment_quadtree.join_blocks(
        *squares_of, work.rss, work.slope, noise.sigma, noise.lateral**2,
        rules.rough_block, rules.steep_block, rules.square_floor, rules.square_spread, state,
    )  # fmt: skip
    region = np.empty(grid.shapes[0], np.int32)
    number, count = segment_regions.find_regions(
        work.inverse_depth, grid.tan_x, grid.tan_y, grid.centre_u, grid.centre_v, *squares_of, state,
        *spread, noise.growth, rules.region_floor, rules.region_jump, rules.region_spread, rules.rough,
        rules.reach, rules.close, rules.settled, CUT, rules.trips, float(min_size),
        region, work.owner, work.pixel_owner, work.pairs, work.contact, work.table, work.moments, work.squares,
    )  # fmt: skip
    moments = work.moments[:count]
    alpha, slope, waves = np.empty((count, 3)), np.empty(count), np.empty(count)
    segment_planes.planes(moments, *spread, noise.growth, alpha, slope, waves)
    curved = _find_curved(region, number, moments, alpha, slope, waves, work, grid, noise, rules)
    described = (moments, work.squares[:count], curved)
    return _result(camera, work, number, alpha, slope, waves, *described, noise, min_size, rules)


def _find_curved(
    region: NDArray[np.int32],
    number: NDArray[np.int64],
    moments: Floats,
    alpha: Floats,
    slope: Floats,
    waves: Floats,
    work: Workspace,
    grid: Grid,
    noise: FrameNoise,
    rules: Rules,
) -> NDArray[np.bool_]:
    """Which regions are parts of curved surfaces."""
    count = segment_merge.neighbours(
        region, grid.centre_u, grid.centre_v, work.pairs, work.contact, work.table
    )
    means = np.empty((*region.shape, 4), np.float32)
    segment_shape.owned_means(
        work.owner, work.pixel_owner, number, work.inverse_depth, grid.tan_x, grid.tan_y, region, work.pyramid,
        means,
    )  # fmt: skip
    curved = np.empty(len(moments), np.bool_)
    segment_shape.find_curved(
        region, means, moments, alpha, slope, waves, noise.sigma, rules.reach, rules.region_spread,
        np.radians(rules.sharp), np.radians(rules.blunt), *grid.pitch,
        work.pairs, work.contact, count, curved,
    )  # fmt: skip
    return curved


def _result(
    camera: Camera,
    work: Workspace,
    number_of: NDArray[np.int64],
    alpha: Floats,
    slope: Floats,
    waves: Floats,
    region_moments: Floats,
    region_squares: NDArray[Any],
    curved: NDArray[np.bool_],
    noise: FrameNoise,
    min_size: int,
    rules: Rules,
) -> Segmentation:
    """Split the regions into connected parts, keep those that are planes, and describe them."""
    grid = grid_of(camera)
    deviation = np.empty(len(alpha))
    segment_planes.deviations(region_moments, noise.sigma, slope, waves, deviation)

    start, stop, of, vertical, parent, part, loose = work.runs
    rows = np.empty(camera.height + 1, np.int32)
    runs, loose_count = segment_runs.find_runs(
        work.owner, work.pixel_owner, number_of, *camera.shape[::-1],
        rows, start, stop, of, vertical, parent, loose,
    )  # fmt: skip
    moments, squares = np.empty((runs, 10)), np.empty(runs)
    (size, across, down), of_part = np.empty((3, runs)), np.empty(runs, np.int64)
    count = segment_parts.measure_parts(
        rows, start, stop, of, vertical, parent, part, work.inverse_depth, grid.tan_x, grid.tan_y,
        alpha, deviation, CUT, region_moments, region_squares, moments, squares, size, across, down, of_part,
    )  # fmt: skip
    why, stray = np.empty(count, np.uint8), np.empty(count, np.bool_)
    number, kept = np.empty(count, np.int32), np.empty(count, np.int64)
    measures = size[:count], across[:count], down[:count], squares[:count], of_part[:count]
    found = segment_parts.judge_parts(
        *measures, curved, rules.narrow, rules.rough, min_size, _REASONS, why, stray, number, kept
    )
    segment_labels.label_runs(part, number, rows, of)

    kept = kept[:found]
    moments, deviation = moments[kept], deviation[of_part[kept]]
    alpha, rss = np.empty((found, 3)), np.empty(found)
    segment_planes.fit_planes(moments, alpha, rss)
    if _join_across_gaps(moments, alpha, rss, deviation, number, rows, work, grid, rules):
        found = int(number.max())
        segment_labels.label_runs(part, number, rows, of)
    moments, alpha, rss = moments[:found], alpha[:found], rss[:found]
    planes, covariance = np.empty((found, 4)), np.empty((found, 3, 3))
    rmse, sizes = np.empty(found), np.empty(found + 1, np.int32)
    segment_planes.describe_planes(
        moments, alpha, rss, deviation, noise.together, planes, covariance, rmse, sizes
    )
    labels, reason = np.empty(camera.shape, np.int32), np.empty(camera.shape, np.uint8)
    missing, unclaimed = _REASON_OF_PIXELS
    loose_count = segment_labels.write_labels(
        rows, start, stop, of, part, why, stray, missing, unclaimed,
        work.inverse_depth, loose, loose_count, labels, reason,
    )  # fmt: skip
    segment_labels.settle_strays(
        rows, start, stop, work.inverse_depth, unclaimed, min_size, FILLED, loose, loose_count,
        labels, reason, sizes,
    )  # fmt: skip
    return Segmentation(
        camera=camera,
        labels=labels,
        planes=planes,
        alpha=alpha,
        alpha_covariance=covariance,
        sizes=sizes[1:],
        rmse=rmse,
        reason=reason,
        sigma=float(np.sort(noise.sigma[1:])[len(noise.sigma) // 2 - 1]),
    )


def _join_across_gaps(
    moments: Floats,
    alpha: Floats,
    rss: Floats,
    deviation: Floats,
    number: NDArray[np.int32],
    rows: NDArray[np.int32],
    work: Workspace,
    grid: Grid,
    rules: Rules,
) -> bool:
    """Make one of the planes that something thin in front separates; whether there are any."""
    pairs = np.empty((4 * len(moments), 2), np.int64)
    count = segment_gaps.find_coplanar(
        moments, alpha, deviation, 0.5 * rules.region_floor, rules.region_spread, pairs
    )
    if count == 0:
        return False
    start, stop, label = work.runs[:3]
    parent = np.arange(len(moments))
    box = np.empty((len(moments) + 1, 4), np.int64)
    segment_gaps.label_boxes(rows, start, stop, label, box)
    segment_gaps.join_across(
        rows, start, stop, label, work.inverse_depth, grid.tan_x, grid.tan_y, alpha, deviation, pairs, count,
        box, parent,
    )  # fmt: skip
    return bool(segment_gaps.join_planes(parent, number, moments, alpha, rss, deviation) < len(moments))
