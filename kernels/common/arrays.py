"""Copying an array into another."""

from .._jit.array_lowering import CACHE_LINE
from .._jit.kernel import kernel


@kernel(inline=True)
def copy(values, where):
    """Copy as many values as ``where`` has room for, perhaps to another type.

    A slice assignment makes Numba compile its error message, which takes seconds.
    """
    for i in range(len(where)):
        where[i] = values[i]


@kernel(inline=True)
def copy_columns(values, first, last, where):
    """Copy columns ``first`` to ``last`` of all rows to the first columns of ``where``."""
    for row in range(len(values)):
        # One-dimensional, so that the compiler knows their strides.
        source, target = values[row][first:last], where[row]
        for i in range(last - first):
            target[i] = source[i]


@kernel(inline=True)
def copy_columns_back(where, first, last, values):
    """The reverse of `copy_columns`, to rows that lie one after the other in one dimension."""
    columns = len(values) // len(where)
    for row in range(len(where)):
        source, target = where[row], values[row * columns + first : row * columns + last]
        for i in range(last - first):
            target[i] = source[i]


@kernel()
def to_next_line(room):
    """Bytes from the beginning of an array to that of the first whole line."""
    return -room.ctypes.data % CACHE_LINE
