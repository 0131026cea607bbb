"""Segment a depth frame into planes."""

import enum
import functools
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes.camera import Camera
from rgbd_planes.compilation import announced
from rgbd_planes.depth import DepthFrame, as_depth_frame
from rgbd_planes.kernels import (
    segment_blocks,
    segment_gaps,
    segment_merge,
    segment_parts,
    segment_pixels,
    segment_planes,
    segment_regions,
    segment_shape,
)
from rgbd_planes.kernels.segment_blocks import BLOCK
from rgbd_planes.segmentation_noise import FrameNoise, estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

LEVELS = 4  # blocks, and squares of 2, 4 and 8 blocks
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


class Reason(enum.IntEnum):
    """Why a pixel belongs to a plane, or to none."""

    PLANE = 0
    """It belongs to one."""
    MISSING = 1
    """Nothing was measured."""
    UNCLAIMED = 2
    """No plane nearby fits it."""
    SMALL = 3
    """Its region has too few pixels."""
    ROUGH = 4
    """Its region is no plane: the residual is too large."""
    NARROW = 5
    """Its region is a strip of a pixel or two, as depth edges make."""
    CURVED = 6
    """Its region is part of a curved surface."""


# Of parts and of pixels, as the kernels take them.
_REASONS = tuple(
    np.uint8(r) for r in (Reason.PLANE, Reason.SMALL, Reason.ROUGH, Reason.CURVED, Reason.NARROW)
)
_REASON_OF_PIXELS = np.uint8(Reason.MISSING), np.uint8(Reason.UNCLAIMED)


@dataclass(frozen=True, eq=False, repr=False)
class Segmentation:
    """The planes of a frame, and which pixel belongs to which.

    Attributes
    ----------
    camera : Camera
    labels : (H, W) int32
        0 none, 1..N; row i of the arrays below belongs to label i + 1.
    planes : (N, 4) float64
        nx, ny, nz, d of n·X + d = 0, ‖n‖ = 1, d > 0, n towards the camera; metres.
    alpha : (N, 3) float64
        -n / d, in 1/m: q = α·(tanθx, tanθy, 1), the least squares fit to the pixels of the label, but for
        strays that go with their neighbours.
    alpha_covariance : (N, 3, 3) float64
        Of α, 1/m². From the residual or the sensor's noise, whichever is larger, and as many independent
        pixels as the frame's correlated noise leaves.
    sizes : (N,) int32
        Pixels.
    rmse : (N,) float64
        Root mean square residual in inverse depth, 1/m.
    reason : (H, W) uint8
        `Reason`.
    sigma : float
        Typical standard deviation of the frame's inverse depth, 1/m.
    """

    camera: Camera
    labels: NDArray[np.int32]
    planes: Floats
    alpha: Floats
    alpha_covariance: Floats
    sizes: NDArray[np.int32]
    rmse: Floats
    reason: NDArray[np.uint8]
    sigma: float

    def __len__(self) -> int:
        """Number of planes."""
        return len(self.planes)

    def __repr__(self) -> str:
        height, width = self.labels.shape
        share = f"{self.share:.0%} of the measured pixels"
        return f"<Segmentation: {len(self)} planes, {share} of {height} x {width}>"

    def _repr_html_(self) -> str:
        """What a notebook shows: the counts and a small picture."""
        from rgbd_planes.preview import segments_html

        return segments_html(self)

    @property
    def share(self) -> float:
        """Share of the measured pixels that belong to a plane."""
        return int(np.count_nonzero(self.labels)) / max(1, int((self.reason != Reason.MISSING).sum()))

    @property
    def rmse_metric(self) -> Floats:
        """(N,) float64: `rmse` in metres along the normal, d·Z̄·rmse, to first order."""
        return self.planes[:, 3] * self.mean_depth * self.rmse

    @property
    def mean_depth(self) -> Floats:
        """(N,) float64: Z in metres where the mean inverse depth of the plane's pixels is."""
        sums = np.bincount(self.labels.ravel(), weights=self.fitted_inverse_depth().ravel())[1:]
        return np.asarray(self.sizes / sums)

    @property
    def plane_covariance(self) -> Floats:
        """(N, 4, 4) float64: covariance of (n, d), by first-order propagation from α."""
        n, d = self.planes[:, :3], self.planes[:, 3]
        # ∂n/∂α = -d (I - n nᵀ), ∂d/∂α = d² n, from d = 1/‖α‖ and n = -α d.
        jacobian = np.empty((len(self), 4, 3))
        jacobian[:, :3] = -d[:, None, None] * (np.eye(3) - n[:, :, None] * n[:, None, :])
        jacobian[:, 3] = d[:, None] ** 2 * n
        return np.asarray(jacobian @ self.alpha_covariance @ jacobian.transpose(0, 2, 1))

    def fitted_inverse_depth(self) -> Floats:
        """(H, W) float64, 1/m: the inverse depth of each pixel's plane; 0 where there is none."""
        a: Floats
        a, b, c = np.vstack([np.zeros(3), self.alpha])[self.labels].transpose(2, 0, 1)
        return np.asarray(a * self.camera.tan_x + b * self.camera.tan_y + c)

    def fitted_depth(self) -> Floats:
        """(H, W) float64, metres: where each pixel's ray meets its plane; NaN where there is none."""
        q = self.fitted_inverse_depth()
        depth = np.full(q.shape, np.nan)
        np.divide(1.0, q, out=depth, where=q > 0.0)
        return depth

    def tile_labels(self, tile: tuple[int, int]) -> NDArray[np.int32]:
        """(R, C) int32: the plane that all measured pixels of each tile of a grid lie on, 0 where they do not.

        ``tile`` is (height, width) in pixels; the tiles are those of `fit_tiles`.
        """
        edges = [np.arange(0, length, step) for length, step in zip(self.labels.shape, tile, strict=True)]
        missing = self.reason == Reason.MISSING
        lowest, highest = np.where(missing, len(self) + 1, self.labels), self.labels
        for axis, edge in enumerate(edges):
            lowest = np.minimum.reduceat(lowest, edge, axis=axis)
            highest = np.maximum.reduceat(highest, edge, axis=axis)
        return np.where(lowest == highest, highest, 0).astype(np.int32)

    def labels_from_minus_one(self) -> NDArray[np.int32]:
        """(H, W) int32: labels 0..N-1, -1 for none, as deplex and clustering libraries have them."""
        return self.labels - np.int32(1)

    def labels_for_opencv(self) -> NDArray[np.uint8]:
        """(H, W) uint8: labels 0..N-1, 255 for none, as OpenCV's RgbdPlane has them.

        Raises
        ------
        ValueError
            There are more than 255 planes.
        """
        if len(self) > 255:
            raise ValueError(
                f"expected at most 255 planes, which is all that uint8 labels hold, got {len(self)}"
            )
        return (self.labels - 1).astype(np.uint8)  # -1 becomes 255

    def plot(self, depth: ArrayLike | None = None, axes: "Axes | None" = None) -> "Axes":
        """Draw the planes in colours over the relief of the depth; see `plotting_segments.plot_segments`."""
        from rgbd_planes.plotting_segments import plot_segments

        return plot_segments(self, depth, axes)


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
    if min_size < 3:
        raise ValueError(f"min_size must be at least 3 pixels, got {min_size}")
    frame = as_depth_frame(depth, camera)
    given = camera.noise if noise is None else noise
    sigma, lateral = _as_function(given), float(getattr(given, "lateral", 0.0))
    with announced(("segment", frame.raw.dtype)):
        return segment_frame(frame, camera, sigma, min_size, Rules(), lateral)


def _as_function(noise: Any) -> Callable[[Floats], Floats] | None:
    sigma = getattr(noise, "sigma", noise)  # of a noise model
    if sigma is None or callable(sigma):
        return sigma  # type: ignore[no-any-return]
    if isinstance(noise, int | float):
        if not 0.0 < noise < np.inf:
            raise ValueError(f"noise must be a positive standard deviation in 1/m, got {noise!r}")
        return lambda q: np.full_like(q, noise)
    raise TypeError(f"noise must be a number in 1/m, a function of inverse depth or None, got {noise!r}")


def segment_frame(
    frame: DepthFrame,
    camera: Camera,
    sigma: Callable[[Floats], Floats] | None,
    min_size: int,
    rules: Rules,
    lateral: float = 0.0,
) -> Segmentation:
    """`segment` by other rules, which is for experiments."""
    grid = _grid(camera)
    room = _rooms.of(camera)
    squares_of = room.pyramid, grid.offsets, grid.shapes
    nearest = segment_blocks.block_moments(
        frame.raw, frame.lowest, frame.highest, frame.scale, frame.offset, frame.is_disparity,
        grid.tan_x, grid.tan_y, *grid.pitch, grid.shapes[0, 0], grid.shapes[0, 1],
        room.inverse_depth, room.pyramid, room.rss, room.slope,
    )  # fmt: skip
    segment_blocks.sum_by_fours(*squares_of, *grid.pitch, room.rss, room.slope)
    noise = estimate(
        frame, room.pyramid, room.rss, room.slope, grid.offsets, grid.shapes, nearest, sigma, lateral
    )  # fmt: skip
    spread = (noise.sigma, (noise.lateral / camera.fx) ** 2, (noise.lateral / camera.fy) ** 2)

    state = np.empty(grid.offsets[-1], np.int8)
    segment_blocks.join_blocks(
        *squares_of, room.rss, room.slope, noise.sigma, noise.lateral**2,
        rules.rough_block, rules.steep_block, rules.square_floor, rules.square_spread, state,
    )  # fmt: skip
    region = np.empty(grid.shapes[0], np.int32)
    number, count = segment_regions.find_regions(
        room.inverse_depth, grid.tan_x, grid.tan_y, grid.centre_u, grid.centre_v, *squares_of, state,
        *spread, noise.growth, rules.region_floor, rules.region_jump, rules.region_spread, rules.rough,
        rules.reach, rules.close, rules.settled, CUT, rules.trips, float(min_size),
        region, room.owner, room.pixel_owner, room.pairs, room.contact, room.table, room.moments, room.squares,
    )  # fmt: skip
    moments = room.moments[:count]
    alpha, slope, waves = np.empty((count, 3)), np.empty(count), np.empty(count)
    segment_pixels.planes(moments, *spread, noise.growth, alpha, slope, waves)
    curved = _find_curved(region, number, moments, alpha, slope, waves, room, grid, noise, rules)
    described = (moments, room.squares[:count], curved)
    return _result(camera, room, number, alpha, slope, waves, *described, noise, min_size, rules)


def _find_curved(
    region: NDArray[np.int32],
    number: NDArray[np.int64],
    moments: Floats,
    alpha: Floats,
    slope: Floats,
    waves: Floats,
    room: "_Room",
    grid: "_Grid",
    noise: FrameNoise,
    rules: Rules,
) -> NDArray[np.bool_]:
    """Which regions are parts of curved surfaces."""
    count = segment_merge.neighbours(
        region, grid.centre_u, grid.centre_v, room.pairs, room.contact, room.table
    )
    means = np.empty((*region.shape, 4), np.float32)
    segment_shape.owned_means(
        room.owner, room.pixel_owner, number, room.inverse_depth, grid.tan_x, grid.tan_y, region, room.pyramid,
        means,
    )  # fmt: skip
    curved = np.empty(len(moments), np.bool_)
    segment_shape.find_curved(
        region, means, moments, alpha, slope, waves, noise.sigma, rules.reach, rules.region_spread,
        np.radians(rules.sharp), np.radians(rules.blunt), *grid.pitch,
        room.pairs, room.contact, count, curved,
    )  # fmt: skip
    return curved


@dataclass(frozen=True, eq=False)
class _Grid:
    """What the blocks of a camera's frames have in common."""

    shapes: NDArray[np.int64]  # (LEVELS, 2): rows and columns of each level of the pyramid
    offsets: NDArray[np.int64]  # (LEVELS + 1,): where each begins
    tan_x: Floats  # (1, W) and (H, 1), or (H, W) both
    tan_y: Floats
    pitch: tuple[float, float]  # change of tanθx and tanθy from pixel to pixel
    centre_u: Floats  # (R, C): tanθx, tanθy in the middle of each block
    centre_v: Floats


@functools.lru_cache(maxsize=8)
def _grid(camera: Camera) -> _Grid:
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
    return _Grid(
        shapes=np.array(shapes),
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        tan_x=camera.tan_x_columns[None, :] if camera.is_separable else camera.tan_x,
        tan_y=camera.tan_y_rows[:, None] if camera.is_separable else camera.tan_y,
        pitch=(1.0 / camera.fx, 1.0 / camera.fy),
        centre_u=camera.tan_x[middle],
        centre_v=camera.tan_y[middle],
    )


class _Room:
    """Arrays to work in. New ones for every frame would cost a millisecond: the system clears them."""

    def __init__(self, camera: Camera) -> None:
        self.shape = camera.shape
        pixels = camera.height * camera.width
        grid = _grid(camera)
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


class _Rooms(threading.local):
    """One for each thread."""

    room: _Room | None = None

    def of(self, camera: Camera) -> _Room:
        if self.room is None or self.room.shape != camera.shape:
            self.room = _Room(camera)
        return self.room


_rooms = _Rooms()


def _result(
    camera: Camera,
    room: _Room,
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
    grid = _grid(camera)
    deviation = np.empty(len(alpha))
    segment_planes.deviations(region_moments, noise.sigma, slope, waves, deviation)

    start, stop, of, vertical, parent, part, loose = room.runs
    rows = np.empty(camera.height + 1, np.int32)
    runs, loose_count = segment_parts.find_runs(
        room.owner, room.pixel_owner, number_of, *camera.shape[::-1],
        rows, start, stop, of, vertical, parent, loose,
    )  # fmt: skip
    moments, squares = np.empty((runs, 10)), np.empty(runs)
    (size, across, down), of_part = np.empty((3, runs)), np.empty(runs, np.int64)
    count = segment_parts.measure_parts(
        rows, start, stop, of, vertical, parent, part, room.inverse_depth, grid.tan_x, grid.tan_y,
        alpha, deviation, CUT, region_moments, region_squares, moments, squares, size, across, down, of_part,
    )  # fmt: skip
    why, stray = np.empty(count, np.uint8), np.empty(count, np.bool_)
    number, kept = np.empty(count, np.int32), np.empty(count, np.int64)
    measures = size[:count], across[:count], down[:count], squares[:count], of_part[:count]
    found = segment_parts.judge_parts(
        *measures, curved, rules.narrow, rules.rough, min_size, _REASONS, why, stray, number, kept
    )
    segment_parts.label_runs(part, number, rows, of)

    kept = kept[:found]
    moments, deviation = moments[kept], deviation[of_part[kept]]
    alpha, rss = np.empty((found, 3)), np.empty(found)
    segment_planes.fit_planes(moments, alpha, rss)
    if _join_across_gaps(moments, alpha, rss, deviation, number, rows, room, grid, rules):
        found = int(number.max())
        segment_parts.label_runs(part, number, rows, of)
    moments, alpha, rss = moments[:found], alpha[:found], rss[:found]
    planes, covariance = np.empty((found, 4)), np.empty((found, 3, 3))
    rmse, sizes = np.empty(found), np.empty(found + 1, np.int32)
    segment_planes.describe_planes(
        moments, alpha, rss, deviation, noise.together, planes, covariance, rmse, sizes
    )
    labels, reason = np.empty(camera.shape, np.int32), np.empty(camera.shape, np.uint8)
    missing, unclaimed = _REASON_OF_PIXELS
    loose_count = segment_parts.write_labels(
        rows, start, stop, of, part, why, stray, missing, unclaimed,
        room.inverse_depth, loose, loose_count, labels, reason,
    )  # fmt: skip
    segment_parts.settle_strays(
        rows, start, stop, room.inverse_depth, unclaimed, min_size, FILLED, loose, loose_count,
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
    room: _Room,
    grid: _Grid,
    rules: Rules,
) -> bool:
    """Make one of the planes that something thin in front separates; whether there are any."""
    pairs = np.empty((4 * len(moments), 2), np.int64)
    count = segment_gaps.find_coplanar(
        moments, alpha, deviation, 0.5 * rules.region_floor, rules.region_spread, pairs
    )
    if count == 0:
        return False
    start, stop, label = room.runs[:3]
    parent = np.arange(len(moments))
    box = np.empty((len(moments) + 1, 4), np.int64)
    segment_gaps.label_boxes(rows, start, stop, label, box)
    segment_gaps.join_across(
        rows, start, stop, label, room.inverse_depth, grid.tan_x, grid.tan_y, alpha, deviation, pairs, count,
        box, parent,
    )  # fmt: skip
    return bool(segment_gaps.join_planes(parent, number, moments, alpha, rss, deviation) < len(moments))
