"""Boxes of regions: the rows and columns of blocks that each spans."""

from ..._jit.kernel import kernel


@kernel(inline="compiled")
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
    for row in range(rows):
        line = region[row]
        start = 0
        for column in range(columns):
            if column + 1 < columns and line[column] == line[column + 1]:
                continue
            a = line[start]
            if a >= 0:
                box[a, 0] = min(box[a, 0], row)
                box[a, 1] = row + 1
                box[a, 2] = min(box[a, 2], start)
                box[a, 3] = max(box[a, 3], column + 1)
            start = column + 1
