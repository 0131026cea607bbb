"""Footprints: how many pixels a part of a frame has, and how they are spread over the image."""

from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from rgbd_planes._core.arrays import Floats


def like_rectangles(footprint: NDArray[Any]) -> Floats:
    """(N, 2) float64: height and width of full rectangles with as much scatter along x and along y.

    Where the pixels lie closer together than in any rectangle, as in a disc, it has as many pixels as there are.
    ``footprint`` is (N, 5), for each part's pixels: their number, Σx, Σy, Σx² and Σy².
    """
    n, x, y, xx, yy = footprint.T.astype(np.float64)
    number = np.maximum(n, 1.0)
    # The variance of n pixels in a row is (n² - 1) / 12.
    squares = [12.0 * (square / number - (sum_ / number) ** 2) + 1.0 for sum_, square in ((y, yy), (x, xx))]
    sizes = np.sqrt(np.maximum(np.stack(squares, axis=1), 1.0))
    return np.asarray(sizes * np.sqrt(np.maximum(number / sizes.prod(axis=1), 1.0))[:, None])


def footprints(windows: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """(K, 5) int64: for the pixels of each window, (K, 4): their number, Σx, Σy, Σx² and Σy²."""
    top, left, height, width = windows.T
    number = height * width

    def sums(first: npt.NDArray[np.int64], size: npt.NDArray[np.int64]) -> list[npt.NDArray[np.int64]]:
        """Sums of ``size`` integers from ``first`` on, and of their squares, times the pixels of the other side."""
        others, more = number // size, size * (size - 1) // 2
        squares = size * first * first + 2 * first * more + more * (2 * size - 1) // 3
        return [others * (size * first + more), others * squares]

    (x, xx), (y, yy) = sums(left, width), sums(top, height)
    return np.stack([number, x, y, xx, yy], axis=1)
