"""Segmentation: arrays that belong together, as its kernels hand them to one another.

N is the number of regions, R and C those of the rows and columns of blocks.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._jit.kernel import kernel

Array = NDArray[Any]

# Pixels along a block's side.
BLOCK = 4
# Owner of a block: EMPTY where no pixel is measured; MIXED where regions have shares of it, or nobody has any; UNSEEN
# before the first round.
EMPTY, MIXED, UNSEEN = -1, -2, -3


class Rules(NamedTuple):
    """The constants of the segmentation.

    Deviations are standard deviations of the frame's own noise, so none of these depends on a sensor, a unit or a
    distance. `bench.segmentation` cross-validates them, and `bench.ablation` says what each is worth.
    """

    fit_deviations: float = 3.0  # root mean square, within which pixels fit a plane
    steep_share: float = 0.6  # of the noise that a block's slope makes: across a depth jump a block looks steep, too
    reach_deviations: float = 8.0  # within which a region contends for a pixel
    bend_deviations: float = 4.5  # root mean square, by which joining two regions may bend the smaller one
    jump_deviations: float = 6.0  # by which one plane may jump to another where two regions of one plane touch
    wave_variances: float = 2.0  # of a region's squared waviness that may add to bends and jumps
    joint_variances: float = 30.0  # that joining two may add to the sum of squared residuals, however few their pixels
    certain_share: float = 0.1  # of what joining two may add, up to which it is beyond doubt
    curved_degrees: float = 12.0  # root mean square, by which the normals of a curved surface turn
    bent_variances: float = 2.0  # a pixel, that a region's own bend must make to be more than the sensor's
    least_width: float = 4.5  # pixels: mean length of a plane's runs along rows, and along columns
    rim_deviations: float = 1.9  # times the waviness, by which pixels at a plane's rim lie off it together
    evidence: float = 22.0  # the least that a plane must have, of `evidence.weigh_planes`
    rounds: int = 3  # from planes to pixels and back
    tolerance: float = 1.0  # of the frame: share of the deviations of bends and jumps, `frame_noise.tolerance`


class Reasons(NamedTuple):
    """Why pixels have no label."""

    plane: np.uint8  # they have one
    small: np.uint8  # of a part without enough pixels
    rough: np.uint8
    curved: np.uint8
    narrow: np.uint8
    missing: np.uint8  # of pixels that are not measured
    unclaimed: np.uint8  # of those that no region has


class Rays(NamedTuple):
    """Where the pixels of a frame look."""

    tan_x: Array  # (1, W) float64, or (H, W) if tan_y is
    tan_y: Array  # (H, 1) or (H, W)
    centre_u: Array  # (1, C) or (R, C) float64: tanθx in the middle of each block
    centre_v: Array  # (R, 1) or (R, C)
    pitch_x: float  # change of tanθx and tanθy from pixel to pixel, without a lens
    pitch_y: float
    lens: Array  # (2, K) float64: table of how it stretches pixels, by the angle; (2, 0) without a lens
    stretch: Array  # (T,) float64: squared factor by which the lens stretches pixels of each square of a `Pyramid`


class Pyramid(NamedTuple):
    """Blocks, row after row, then squares of 2x2, 4x4, ... blocks: T in all."""

    moments: Array  # (10, T) float64
    rss: Array  # (T,) float64: sum of squared residuals of each one's plane, or -1
    slope_square: Array  # (T,) float64: of its plane, change of q from pixel to pixel
    offsets: Array  # (L + 1,) int64: where each level begins
    shapes: Array  # (L, 2) int64: its rows and columns, twice those of the next


class View(NamedTuple):
    """A depth frame, as all stages read it."""

    inverse_depth: Array  # (H, W) float32, 0 where there is no measurement
    rays: "Rays"
    pyramid: "Pyramid"
    noise: "Noise"
    rules: "Rules"
    sensor: Array  # (R·C,) float64: variance of an inverse depth in each block


class Noise(NamedTuple):
    """What makes the variance of a pixel about its plane, `pixel_noise.variance`."""

    sigma: Array  # (K + 1,) float64: a step, and standard deviations of inverse depths 0, step, 2 step, ...
    lateral_variance: float  # in pixels², of where within its pixel a measurement lies
    lateral_variance_x: float  # the same in units of tanθx, and of tanθy
    lateral_variance_y: float
    lens: Array  # that of `Rays`
    growth: Array  # (S,) float64: residual of squares of 8, 16, 32, ... pixels, as a multiple of the first
    together: float  # pixels that have one error between them: n of them tell as much as n / together


class Modelled(NamedTuple):
    """What a noise model says of N planes."""

    shared: Array  # (N, 6 or more) float64: covariances by errors that neighbours share; 0 for none
    alone: Array  # (N,) float64: variance of a pixel, of the errors that are not in ``shared``
    residual: Array  # (N,) float64: variance of a pixel about its plane by all of them
    has_lateral: bool  # whether the lateral error of `Noise` is the model's, and comes on top
    is_believed: bool  # otherwise the frame alone tells


class Planes(NamedTuple):
    """Planes of regions, and what adds to a pixel's variance about them."""

    alpha: Array  # (N, 3) float64
    slope_variance: Array  # (N,) float64: where ``stretch`` is 1
    waviness_square: Array  # (N,) float64
    stretch: Array  # (N,) float64: squared factor by which the lens stretches its pixels
    square_stretch: Array  # that of `Rays`


class Owners(NamedTuple):
    """Which region has which blocks; of blocks that several have parts of, `Shares` says which."""

    block: Array  # (R, C) int32: region that has all measured pixels of a block; or EMPTY, MIXED or UNSEEN
    first: Array  # (R, C) int32: of a MIXED block its first share
    count: Array  # (R, C) int32: how many shares it has; its other pixels have no owner
    measured: Array  # (R, C) int32: its measured pixels: (y, x) is bit BLOCK·y + x


class Shares(NamedTuple):
    """The pixels of MIXED blocks that regions own, a share for each region in a block."""

    region: Array  # (S,) int32
    pixels: Array  # (S,) int32: pixel (y, x) of the block is bit BLOCK·y + x
    moments: Array  # (S, 10) float64


class Regions(NamedTuple):
    """Regions, and the pixels that they own since the last round."""

    block: Array  # (R, C) int32: region of each block, or below 0
    moments: Array  # (N, 10) float64: of each region's pixels
    number: Array  # (M,) int64: region that each region of the last round has become, or below 0
    owners: Owners  # of the last round: its regions are those that ``number`` translates
    shares: Shares


class Contended(NamedTuple):
    """Blocks that regions contend for; their number is passed separately."""

    block: Array  # (K,) int32: row · C + column
    many: Array  # (K,) int32: how many regions contend for it
    first: Array  # (K,) int32: the first of them among the following
    candidate: Array  # (L,) int32: region
    centre: Array  # (L, 3) float64: sums of (u, v) of its blocks around the block, and their number


class Contacts(NamedTuple):
    """Regions that touch: the first rows are in use, and their number is passed separately."""

    pairs: Array  # (K, 3) int32: two regions, smaller first, and what `contacts.pair_row` needs
    where: Array  # (K, 3) float64: how many of their blocks touch, and the sum of the (u, v) in between
    table: Array  # (2^k,) int32, larger than K: hash table of the pairs' rows


class Runs(NamedTuple):
    """Pixels side by side that one region has, one row after the other; missing pixels may be among them."""

    first: Array  # (H + 1,) int32: first run of each row
    row: Array  # (K,) int32
    start: Array  # (K,) int32: first column
    stop: Array  # (K,) int32: last column + 1
    region: Array  # (K,) int32
    starts: Array  # (K,) int32: 1, or 0 if the one before it is the region's, too, but for a hole in between
    starts_down: Array  # (K,) int32: its pixels that have none of the region above, but for a hole in between
    part: Array  # (K,) int32: connected part


class Parts(NamedTuple):
    """Connected parts of regions."""

    moments: Array  # (P, 10) float64
    size: Array  # (P,) float64: pixels
    across: Array  # (P,) int64: runs of pixels along the rows
    down: Array  # (P,) int64: runs of pixels along the columns
    first: Array  # (P,) int64: its first pixel, row · W + column
    region: Array  # (P,) int64


class Found(NamedTuple):
    """The N planes that are found, with labels 1, 2, ..."""

    moments: Array  # (N, 10) float64: of their pixels
    deviation: Array  # (N,) float64: standard deviation of a pixel about the plane of its region
    inside: Array  # (N, 10) float64: moments of the pixels that it is fitted to, `interior.interior_moments`
    alpha: Array  # (N, 3) float64: so fitted
    rss: Array  # (N,) float64: sum of squared residuals of these pixels
    weighted: Array  # (N, 5) float64: weighted means of u, v, u², uv and v² of its pixels
    size: Array  # (N + 1,) int32: pixels of each label

    def of_planes(self, is_kept: Array) -> "Found":
        """Only some of the planes."""
        planes = [field[is_kept] for field in self[:-1]]
        return Found(*planes, self.size[np.append(True, is_kept)])


class Labels(NamedTuple):
    """The label of each pixel, and why it has none."""

    label: Array  # (H, W) int32, 0 for none
    reason: Array  # (H, W) uint8


@kernel(inline="compiled")
def place(block, columns):
    """Row and column of a block, by unsigned numbers of half the size, which are divided in half the time."""
    return np.int64(np.uint32(block) // np.uint32(columns)), np.int64(np.uint32(block) % np.uint32(columns))


def plain(record: Any) -> Any:
    """A record as a tuple of plain tuples, as kernels take it from Python.

    Numba looks at the fields of plain tuples in C, and of others in Python, which takes five times as long.
    """
    return tuple([plain(field) if isinstance(field, tuple) else field for field in record])


@kernel(inline=True)
def as_view(view):
    """The `View` that Python hands over as plain tuples."""
    inverse_depth, rays, pyramid, noise, rules, sensor = view
    return View(inverse_depth, Rays(*rays), Pyramid(*pyramid), Noise(*noise), Rules(*rules), sensor)


@kernel(inline=True)
def as_regions(regions):
    """The `Regions` that Python hands over as plain tuples."""
    block, moments, number, owners, shares = regions
    return Regions(block, moments, number, Owners(*owners), Shares(*shares))
