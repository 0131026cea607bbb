"""Checks of standard deviations of the inverse depth, as users and their functions give them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.checks import real_array
from rgbd_planes._core.user_warnings import warn_caller

# Share of 1/Z that no sensor's noise reaches, between what is nearest in a frame and twice as far away.
TOO_LARGE = 0.2
LARGEST_NOISE = 1e60  # 1/m: the square of its square is finite, and so are sums of these over a frame


def check_noise(sigma: Any, inverse_depth: NDArray[np.float64], *, finite: bool = True) -> NDArray[np.float64]:
    """Return standard deviations at inverse depths, one for each, as floats: 0 or more."""
    values = for_each(sigma, inverse_depth)
    bad = ~(values >= 0.0) | (finite & (values > LARGEST_NOISE))
    if bad.any():
        first = bad.argmax()
        raise ValueError(
            f"expected noise of 0 to {LARGEST_NOISE:g} 1/m at all inverse depths, "
            f"got {values[first]:g} at {inverse_depth[first]:g} 1/m"
        )
    return values


def for_each(sigma: Any, inverse_depth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what a function gave for inverse depths as floats, one for each; a single number counts for all."""
    values = real_array("noise", sigma)
    try:
        return np.broadcast_to(values, inverse_depth.shape)
    except ValueError:
        raise ValueError(
            f"expected noise for each inverse depth, of shape {inverse_depth.shape}, got shape {values.shape}"
        ) from None


def warn_of_large_noise(sigma: float, inverse_depth: float, result: str) -> None:
    """Warn of a noise that most likely is in other units."""
    if sigma > TOO_LARGE * inverse_depth:
        warn_caller(
            f"the noise that is given is {sigma:.2g} 1/m where 1/Z is {inverse_depth:.2g} 1/m: most likely it "
            f"is not in 1/m, or made of lengths that are not in metres. With it {result}"
        )
