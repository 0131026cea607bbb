"""Where the lines of the processor's cache begin."""

from ._jit import kernel
from ._lowering import CACHE_LINE


@kernel()
def to_next_line(room):
    """Bytes from the beginning of an array to that of the first whole line."""
    return -room.ctypes.data % CACHE_LINE
