"""The noise of a depth frame, as a segmentation needs it, from the frame itself."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rgbd_planes.depth import DepthFrame
from rgbd_planes.kernels import segment_noise
from rgbd_planes.kernels.segment_blocks import BLOCK

Floats = NDArray[np.float64]

FLATNESS = 4e-4
"""No surface of a room is flatter than this share of its distance, and hardly a sensor is better."""

FORMLESS = 0.03
"""A frame whose noise is a larger share of the inverse depth shows no form: the residuals are not all noise."""

PIXEL = 0.5
"""Standard deviation, in pixels, of where within its pixel a measurement lies: at most."""

_ENTRIES = 33
_FULL = 0.5  # share of a square's pixels that must be measured
_FEWEST_SQUARES = 10


@dataclass(frozen=True, eq=False)
class FrameNoise:
    """Standard deviation of inverse depth, and how it grows with slope and with size.

    Attributes
    ----------
    sigma : (K + 1,) float64
        The step of the table, then σ at q = 0, step, 2 step, ... in 1/m.
    lateral : float
        Pixels: the slope of a surface from pixel to pixel times this is noise, too.
    growth : (3,) float64
        Residual of squares of 8, 16 and 32 pixels as a multiple of the first: 1 for independent pixels.
    together : float
        Pixels that have one error between them, so that n of them tell as much as n / together: 1 for
        independent ones. At most 64, those of the squares of 8 pixels from whose means it is estimated.
    """

    sigma: Floats
    lateral: float
    growth: Floats
    together: float


def estimate(
    frame: DepthFrame,
    moments: Floats,
    rss: Floats,
    slope: Floats,
    offsets: NDArray[np.int64],
    shapes: NDArray[np.int64],
    farthest: float,
    sigma: Callable[[Floats], Floats] | None,
    lateral: float,
) -> FrameNoise:
    """Estimate the noise of a frame from the residuals of its own squares of 8, 16 and 32 pixels.

    Most squares of most frames hold one surface, so a low quantile of their residuals is noise. Where a
    frame has too few squares to say, the noise is taken to be independent, and half a pixel across.

    Parameters
    ----------
    moments, rss, slope, offsets, shapes
        Of the squares, see `segment_blocks.sum_by_fours`.
    farthest : float
        Largest inverse depth of the frame, 1/m.
    sigma : callable, optional
        The sensor's standard deviation of inverse depth; estimated where not given.
    lateral : float
        See `FrameNoise`; estimated where it is 0.
    """
    mean_square, slope_square = np.empty((2, offsets[2] - offsets[1]))
    growth = np.ones(3)
    own_lateral = PIXEL
    typical = 0.0
    smallest = 0.0
    for level in range(1, 4):
        own = slice(offsets[level], offsets[level + 1])
        count = segment_noise.square_residuals(
            moments[:, own], rss[own], slope[own], _FULL * (BLOCK << level) ** 2, mean_square, slope_square
        )
        if count < _FEWEST_SQUARES:
            growth[level - 1 :] = growth[max(level - 2, 0)]
            break
        square = mean_square[:count]
        if level == 1:
            smallest, typical = _quantile(square, 0.2), _quantile(square, 0.35)
            steep = slope_square[:count] > 4.0 * typical
            if np.count_nonzero(steep) > 5 * _FEWEST_SQUARES:
                excess = np.maximum(square[steep] - typical, 0.0) / slope_square[:count][steep]
                own_lateral = min(max(_quantile(excess, 0.2) ** 0.5, 0.05), PIXEL)
        elif smallest > 0.0:
            growth[level - 1] = min(max((_quantile(square, 0.2) / smallest) ** 0.5, growth[level - 2]), 3.0)

    q = np.linspace(0.0, farthest if farthest > 0.0 else 1.0, _ENTRIES)
    if sigma is None:
        table = np.maximum(np.minimum(typical**0.5, FORMLESS * q), _rounding(frame, q))
    else:
        table = np.broadcast_to(np.asarray(sigma(q), dtype=np.float64), q.shape)
        if not (table[1:] >= 0.0).all():  # where q = 0 no function need be defined
            raise ValueError(f"expected noise of 0 or more at all inverse depths, got {table.tolist()}")
    return FrameNoise(
        np.concatenate([q[1:2], np.maximum(table, FLATNESS * q)]),
        lateral or own_lateral,
        growth,
        _together(moments, rss, offsets, shapes, typical),
    )


def _together(
    moments: Floats, rss: Floats, offsets: NDArray[np.int64], shapes: NDArray[np.int64], typical: float
) -> float:
    """`FrameNoise.together` from the flat ones of the squares of 32 pixels."""
    ratio = np.empty(offsets[4] - offsets[3])
    least, most = _FULL * (BLOCK << 3) ** 2, 4.0 * typical
    count = segment_noise.together(moments, offsets, shapes, rss, 3, 1, least, most, ratio)
    return max(_quantile(ratio[:count], 0.5), 1.0) if count >= _FEWEST_SQUARES else 1.0


def _quantile(values: Floats, share: float) -> float:
    """As `numpy.quantile`, which takes five times as long."""
    position = share * (len(values) - 1)
    i = int(position)
    low, high = np.partition(values, (i, i + 1))[i : i + 2]
    return float(low + (position - i) * (high - low))


def _rounding(frame: DepthFrame, q: Floats) -> Floats:
    """Standard deviation of inverse depth that rounding to the raw values' steps makes."""
    if frame.raw.dtype.kind != "u":
        return np.zeros_like(q)
    step = np.full_like(q, abs(frame.scale)) if frame.is_disparity else q * q / frame.scale
    return np.asarray(step / 12.0**0.5)
