"""Copies of one array in another."""

from ._jit import kernel


@kernel(inline=True)
def copy(values, where):
    """Copy as many values as there is room for, perhaps to another type.

    For an assignment Numba compiles the message of an error, which takes seconds.
    """
    for i in range(len(where)):
        where[i] = values[i]
