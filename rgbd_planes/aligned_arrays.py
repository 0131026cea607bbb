"""Arrays that begin where a line of the processor's cache does."""

import math
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from rgbd_planes.kernels._jit.array_lowering import CACHE_LINE
from rgbd_planes.kernels.common.arrays import to_next_line


def aligned(shape: tuple[int, ...], dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """An empty array that begins where a line of the processor's cache does, as NumPy's large ones do not.

    Otherwise each of its vectors would lie in two lines, and take twice the time.
    """
    room = np.empty(math.prod(shape) * np.dtype(dtype).itemsize + CACHE_LINE, np.uint8)
    return np.ndarray(shape, dtype, room, to_next_line(room))
