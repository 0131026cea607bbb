"""Names for the arrays that annotations speak of most."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from rgbd_planes.kernels._jit.array_lowering import CACHE_LINE
from rgbd_planes.kernels.common.arrays import to_next_line

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Arrays = Mapping[str, NDArray[Any]]


def aligned(shape: tuple[int, ...], dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """An empty array that begins where a line of the processor's cache does, as NumPy's large ones do not.

    Otherwise each of its vectors would lie in two lines, and take twice the time.
    """
    memory = np.empty(math.prod(shape) * np.dtype(dtype).itemsize + CACHE_LINE, np.uint8)
    return np.ndarray(shape, dtype, memory, to_next_line(memory))
