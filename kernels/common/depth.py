"""From a frame's raw values to depth, Z of the paper's eq. 1, and inverse depth.

For raw values that are not measurements the result means nothing.
"""

from typing import Any, NamedTuple

from numpy.typing import NDArray

from .._jit.kernel import kernel


class RawFrame(NamedTuple):
    """A frame as most kernels take it: raw values, which of them are valid, and what they mean."""

    raw: NDArray[Any]  # (H, W) uint16, float32 or float64
    lowest: Any  # of the dtype of raw: a pixel is valid if lowest <= raw <= highest
    highest: Any
    scale: float  # inverse depth q = scale / raw, or scale * raw + offset if is_disparity
    offset: float
    is_disparity: bool


@kernel(inline=True)
def inverse_depth(value, scale, offset, is_disparity):
    """Inverse depth q of a raw value, in 1/m."""
    return scale * value + offset if is_disparity else scale / value


@kernel(inline=True)
def depth(value, scale, offset, is_disparity):
    """Depth Z of a raw value, in metres."""
    return 1.0 / (scale * value + offset) if is_disparity else value / scale
