"""Blocks that follow their neighbours: those beside a border that moved."""

import numpy as np

from ..._jit.kernel import kernel
from ..model.moments import misfit
from ..model.records import as_view

# The four blocks beside one.
BESIDE_DOWN, BESIDE_RIGHT = (1, -1, 0, 0), (0, 0, 1, -1)


@kernel()
def move_on(view, region, before, alpha):
    """Let borders that moved in this round go on, from block to block, as far as the blocks fit the region better.

    Rounds advance by a block each, and a square that grew over an edge may have many. ``region`` is changed; ``before``
    is as it was before the round.
    """
    moments = as_view(view).pyramid.moments
    rows, columns = region.shape
    moved, left = np.empty(rows * columns, np.int32), np.empty(rows * columns, np.int32)
    count = 0
    for row in range(rows):
        now, was = region[row], before[row]
        for c in range(columns):
            if now[c] != was[c] and now[c] >= 0 and was[c] >= 0:
                moved[count], left[count] = row * columns + c, was[c]
                count += 1
    k = 0
    while k < count:
        here, a = moved[k], left[k]
        row, column = here // columns, here % columns
        b = region[row, column]
        for side in range(4):
            r, c = row + BESIDE_DOWN[side], column + BESIDE_RIGHT[side]
            if r < 0 or c < 0 or r >= rows or c >= columns or region[r, c] != a or before[r, c] != a:
                continue
            i = r * columns + c
            if misfit(moments, i, alpha, b) < misfit(moments, i, alpha, a):
                region[r, c] = b
                moved[count], left[count] = i, a
                count += 1
        k += 1
