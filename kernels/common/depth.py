"""From a frame's raw values to depth, Z of the paper's eq. 1, and inverse depth.

For raw values that are not measurements the result means nothing.
"""

from .._jit.kernel import kernel


@kernel(inline=True)
def inverse_depth(value, scale, offset, is_disparity):
    """Inverse depth q of a raw value, in 1/m."""
    return scale * value + offset if is_disparity else scale / value


@kernel(inline=True)
def depth(value, scale, offset, is_disparity):
    """Depth Z of a raw value, in metres."""
    return 1.0 / (scale * value + offset) if is_disparity else value / scale
