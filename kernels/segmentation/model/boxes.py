"""Boxes of regions: the rows and columns of blocks that each spans."""

from ..._jit.kernel import kernel
from ...common.bit_marks import list_marked, room_for_marks


@kernel(inline=True)
def overlap(box, a, b, down):
    """Rows of blocks, or columns if ``down`` is 1, that boxes a and b share; below 0 if apart."""
    return min(box[a, 2 * down + 1], box[b, 2 * down + 1]) - max(box[a, 2 * down], box[b, 2 * down])


@kernel()
def boxes(region, box):
    """First row, row after the last, first column, column after the last of each region's blocks.

    ``region`` is (R, C) int32, below 0 none; ``box`` (N, 4) int64 is written.
    """
    box[:, 0], box[:, 2] = region.shape[0], region.shape[1]
    box[:, 1], box[:, 3] = 0, 0
    rows, columns = region.shape
    ends, words, last = room_for_marks(columns)  # where blocks side by side end that one region has
    ends[columns - 1] = True
    for row in range(rows):
        own = region[row]
        for c in range(columns - 1):
            ends[c] = own[c] != own[c + 1]
        start = 0
        for i in range(list_marked(ends, words, True, last)):
            a, stop = own[start], last[i] + 1
            if a >= 0:
                box[a, 0] = min(box[a, 0], row)
                box[a, 1] = row + 1
                box[a, 2] = min(box[a, 2], start)
                box[a, 3] = max(box[a, 3], stop)
            start = stop
