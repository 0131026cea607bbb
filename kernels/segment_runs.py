"""Segmentation: what each region owns, as runs of pixels along the rows, united into connected parts.

A block that one region owns is a run of its own width, missing pixels and all, and neighbouring ones are one
run: so pixels are looked at only where regions meet.
"""

import numpy as np

from ._jit import kernel
from .disjoint_sets import unite
from .segment_blocks import BLOCK, MISSING, MIXED

# Missing pixels in a row that still are holes in a surface; and rows, or columns, from one side of them to the other.
GAP = 3
REACH = np.int32(GAP + 1)


@kernel(inline=True)
def put_run(start, stop, a, starts, first, count, runs):
    """Add pixels to the last run of a row, whose runs begin with ``first``, or as a new one; how many there are."""
    _, run_start, run_stop, run_label, vertical, parent, _ = runs
    i = count - 1
    if i >= first and run_label[i] == a and run_stop[i] == start:
        run_stop[i] = stop
        vertical[i] += starts
        return count
    vertical[count] = starts
    run_start[count] = start
    run_stop[count] = stop
    run_label[count] = a
    parent[count] = count
    if i >= first and run_label[i] == a and start - run_stop[i] <= GAP:
        unite(parent, count, i)
    return count + 1


@kernel(inline=True)
def rows_up(a, y, above_label, above_row):
    """How many rows above a pixel the one lies from which its label ``a`` goes on; 0 where it does not."""
    up = y - above_row
    return up if (above_label == a) & (up <= REACH) else np.int32(0)


@kernel(inline=True)
def put_below(a, y, last, above_label, above_row):
    """How many pixels of a run have no label ``a`` above them; below them, up to row ``last``, they have one.

    And how many rows above is the farthest from which one goes on: see `rows_up`.
    """
    starts = farthest = np.int32(0)  # no wider than what they count: more fit into the processor's vectors
    for x in range(len(above_label)):
        up = rows_up(a, y, above_label[x], above_row[x])
        starts += np.int32(up == 0)
        farthest = max(farthest, up)
    for x in range(len(above_label)):
        above_label[x] = a
    for x in range(len(above_row)):
        above_row[x] = last
    return starts, farthest


@kernel(inline=True)
def label_of(owner, pixel_owner, number, y, x):
    """Label of a pixel; below 0 is none."""
    row, column = y // BLOCK, x // BLOCK
    a = owner[row, column]
    if a == MIXED:
        a = pixel_owner[row * owner.shape[1] + column, y % BLOCK * BLOCK + x % BLOCK]
    return number[a] if a >= 0 else -1


@kernel(inline=True)
def unite_with_rows_above(owners, number, y, this_first, count, reach, runs):
    """Unite the runs of row ``y``, from ``this_first`` to ``count``, with those of their label above.

    Up to ``reach`` rows above, where there is nothing between them but pixels without a label.
    """
    owner, pixel_owner = owners
    first, run_start, run_stop, run_label, _, parent, _ = runs
    for lines in range(1, min(y, reach) + 1):
        j, stop = first[y - lines], first[y - lines + 1]
        for i in range(this_first, count):
            while j < stop and run_stop[j] < run_start[i]:
                j += 1
            k = j
            while k < stop and run_start[k] <= run_stop[i]:
                if run_label[k] == run_label[i] and parent[k] != parent[i]:
                    x = max(run_start[i], run_start[k])
                    above = y - 1
                    while above > y - lines and label_of(owner, pixel_owner, number, above, x) < 0:
                        above -= 1
                    if above == y - lines:
                        unite(parent, i, k)
                k += 1


@kernel()
def find_runs(owners, number, width, height, runs, loose):
    """Runs of equal labels along the rows, united into connected parts.

    Runs touch corner to corner or side by side, also across up to GAP pixels that no region owns.

    Parameters
    ----------
    owners : Owners
    number : (N,) int64
        Label of each region, below 0 for none.
    width, height : int
        Of the image.
    runs : Runs, written
        But for ``part``.
    loose : (L,) int32, written
        Measured pixels without a label: row · W + column.

    Returns
    -------
    tuple of int
        Number of runs, and of loose pixels.
    """
    owner, pixel_owner = owners
    first = runs.first
    rows, columns = owner.shape
    run_count = loose_count = 0
    above_label = np.full(width, -1, np.int32)
    above_row = np.full(width, -GAP - 2, np.int32)
    starts = np.empty(columns, np.int64)  # stretches of blocks of one label in a row, and of no label
    kind = np.empty(columns, np.int64)
    for row in range(rows):
        count = 0
        for column in range(columns):
            a = owner[row, column]
            if a >= 0:
                a = number[a]
            if a == MIXED or count == 0 or kind[count - 1] != a:
                starts[count] = column
                kind[count] = a
                count += 1
        top = row * BLOCK
        for y in range(top, min(top + BLOCK, height)):
            first[y] = this_first = run_count
            reach = 2  # rows up to those that this row's runs may go on from
            for i in range(count):
                left = starts[i] * BLOCK
                right = min((starts[i + 1] if i + 1 < count else columns) * BLOCK, width)
                a = kind[i]
                if a >= 0:
                    new = 0
                    if y == top:
                        new, up = put_below(
                            np.int32(a), np.int32(y), y + BLOCK - 1, above_label[left:right], above_row[left:right]
                        )  # fmt: skip
                        reach = max(reach, up)
                    run_count = put_run(left, right, a, new, this_first, run_count, runs)
                elif a == MIXED:
                    block = row * columns + starts[i]
                    k = (y - top) * BLOCK - left
                    x = left
                    while x < right:
                        start = x
                        b = pixel_owner[block, k + x]
                        a = number[b] if b >= 0 else -1
                        new = 0
                        while x < right and pixel_owner[block, k + x] == b:
                            up = rows_up(np.int32(a), np.int32(y), above_label[x], above_row[x])
                            new += up == 0
                            if a >= 0:
                                reach = max(reach, up)
                                above_label[x] = a
                                above_row[x] = y
                            elif b != MISSING:
                                loose[loose_count] = y * width + x
                                loose_count += 1
                                above_label[x] = -1
                            x += 1
                        if a >= 0:
                            run_count = put_run(start, x, a, new, this_first, run_count, runs)
            unite_with_rows_above(owners, number, y, this_first, run_count, reach, runs)
    first[height] = run_count
    return run_count, loose_count
