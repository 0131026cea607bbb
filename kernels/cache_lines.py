"""Where the lines of the processor's cache begin."""

import numpy as np

from ._jit import kernel

CACHE_LINE = 64  # bytes


@kernel()
def to_next_line(room):
    """Bytes from the beginning of an array to that of the first whole line."""
    return -room.ctypes.data % CACHE_LINE


@kernel(inline=True)
def empty_in_lines(rows, columns, dtype):
    """An empty (rows, columns) array that begins where a line does.

    Others begin in the middle of one half of the time, by chance: then each of their vectors that is as long as a line
    lies in two, and sums take up to a quarter more time.
    """
    room = np.empty(rows * columns + CACHE_LINE, dtype)
    start = to_next_line(room) // room.itemsize
    return room[start : start + rows * columns].reshape((rows, columns))


@kernel(inline=True)
def zeros_in_lines(rows, columns, dtype):
    """`empty_in_lines`, but of zeros."""
    room = empty_in_lines(rows, columns, dtype)
    room[:] = 0
    return room
