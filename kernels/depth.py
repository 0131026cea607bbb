"""From a frame's raw values to depth, Z of the paper's eq. RGBD_reconstruction, and inverse depth."""

from ._jit import kernel


@kernel()
def inverse_depth(value, scale, offset, is_disparity):
    """Inverse depth q of a raw value, in 1/m; 0 for the raw value 0 of a depth image."""
    if is_disparity:
        return scale * value + offset
    return scale / value if value != 0 else 0.0


@kernel()
def depth(value, scale, offset, is_disparity):
    """Depth Z of a raw value, in metres; 0 where the inverse depth is 0."""
    if is_disparity:
        inverse = scale * value + offset
        return 1.0 / inverse if inverse != 0.0 else 0.0
    return value / scale
