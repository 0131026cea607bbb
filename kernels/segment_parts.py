"""Segmentation, last stage but one: what each region owns in connected parts, and the labels of the parts.

Parts are found from runs of pixels along the rows. A block that one region owns is a run of its own width,
missing pixels and all, and neighbouring ones are one run: so pixels are looked at only where regions meet.
"""

import numpy as np

from ._jit import kernel
from .segment_blocks import BLOCK, MIXED
from .segment_pixels import MISSING, add

# Missing pixels in a row that still are holes in a surface.
GAP = 3
# Pixels of one label among the 3x3 around one of them that may be there by chance.
COMPANY = 3


@kernel(inline=True)
def root_of(parent, i):
    """The oldest ancestor."""
    while parent[i] != i:
        i = parent[i]
    return i


@kernel(inline=True)
def unite(parent, i, j):
    """Make two sets one; the older root stays."""
    i, j = root_of(parent, i), root_of(parent, j)
    if i < j:
        parent[j] = i
    elif j < i:
        parent[i] = j


@kernel(inline=True)
def put_run(start, stop, a, starts, first, runs, run_start, run_stop, run_label, vertical, parent):
    """Add pixels to the last run of a row, whose runs begin with ``first``, or as a new one; how many there are."""
    i = runs - 1
    if i >= first and run_label[i] == a and run_stop[i] == start:
        run_stop[i] = stop
        vertical[i] += starts
        return runs
    vertical[runs] = starts
    run_start[runs] = start
    run_stop[runs] = stop
    run_label[runs] = a
    parent[runs] = runs
    if i >= first and run_label[i] == a and start - run_stop[i] <= GAP:
        unite(parent, runs, i)
    return runs + 1


@kernel(inline=True)
def put_below(a, y, last, above_label, above_row):
    """How many pixels of a run have no label ``a`` above them; below them, up to row ``last``, they have one."""
    starts = 0
    for x in range(len(above_label)):
        starts += (above_label[x] != a) | (y - above_row[x] > GAP + 1)
    for x in range(len(above_label)):
        above_label[x] = a
    for x in range(len(above_row)):
        above_row[x] = last
    return starts


@kernel(inline=True)
def label_of(owner, pixel_owner, number, y, x):
    """Label of a pixel; below 0 is none."""
    row, column = y // BLOCK, x // BLOCK
    a = owner[row, column]
    if a == MIXED:
        a = pixel_owner[row * owner.shape[1] + column, y % BLOCK * BLOCK + x % BLOCK]
    return number[a] if a >= 0 else -1


@kernel()
def find_runs(
    owner,
    pixel_owner,
    number,
    width,
    height,
    row_runs,
    run_start,
    run_stop,
    run_label,
    vertical,
    parent,
    loose,
):
    """Runs of equal labels along the rows, united into connected parts.

    Runs touch corner to corner or side by side, also across up to GAP pixels that no region owns.

    Parameters
    ----------
    owner, pixel_owner
        Of `segment_pixels.own_pixels`.
    number : (N,) int64
        Label of each region, below 0 for none.
    width, height : int
        Of the image.
    row_runs : (H + 1,) int32, written
        First run of each row.
    run_start, run_stop, run_label : (K,) int32, written
        First column, last column + 1 and label of each run.
    vertical : (K,) int32, written
        How many of a run's pixels have no pixel of the same label above, missing pixels between them aside.
    parent : (K,) int32, written
        Roots stand for parts.
    loose : (L,) int32, written
        Measured pixels without a label: row · W + column.

    Returns
    -------
    tuple of int
        Number of runs, and of loose pixels.
    """
    rows, columns = owner.shape
    runs = 0
    loose_count = 0
    this_first = row_first = two_first = 0  # first run of this row, of the row above, and the one above that
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
            two_first, row_first, this_first = row_first, this_first, runs
            row_runs[y] = runs
            for i in range(count):
                left = starts[i] * BLOCK
                right = min((starts[i + 1] if i + 1 < count else columns) * BLOCK, width)
                a = kind[i]
                if a >= 0:
                    new = 0
                    if y == top:
                        new = put_below(a, y, y + BLOCK - 1, above_label[left:right], above_row[left:right])
                    runs = put_run(
                        left, right, a, new, this_first, runs,
                        run_start, run_stop, run_label, vertical, parent,
                    )  # fmt: skip
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
                            new += (above_label[x] != a) | (y - above_row[x] > GAP + 1)
                            if a >= 0:
                                above_label[x] = a
                                above_row[x] = y
                            elif b != MISSING:
                                loose[loose_count] = y * width + x
                                loose_count += 1
                                above_label[x] = -1
                            x += 1
                        if a >= 0:
                            runs = put_run(
                                start, x, a, new, this_first, runs,
                                run_start, run_stop, run_label, vertical, parent,
                            )  # fmt: skip
            for lines in range(1, 3):
                j, stop = (row_first, this_first) if lines == 1 else (two_first, row_first)
                for i in range(this_first, runs):
                    while j < stop and run_stop[j] < run_start[i]:
                        j += 1
                    k = j
                    while k < stop and run_start[k] <= run_stop[i]:
                        if run_label[k] == run_label[i] and parent[k] != parent[i]:
                            x = max(run_start[i], run_start[k])
                            if lines == 1 or label_of(owner, pixel_owner, number, y - 1, x) < 0:
                                unite(parent, i, k)
                        k += 1
    row_runs[height] = runs
    return runs, loose_count


@kernel()
def measure_parts(
    row_runs, run_start, run_stop, run_label, vertical, parent, part, inverse_depth, tan_x, tan_y,
    alpha, deviation, cut, region_moments, region_squares, moments, squares, size, across, down, owner,
):  # fmt: skip
    """Number the parts in the order of their first pixels, and share out what the regions own.

    The largest part of a region gets its moments less those of the other parts, whose pixels are counted.

    Parameters
    ----------
    part : (K,) int32, written
        Part of each run.
    region_moments, region_squares : (N, 10), (N,) float64
        Of `own_pixels`; changed.
    moments, squares : (P, 10), (P,) float64, written
    size, across, down : (P,) float64, written
        Pixels of each part, runs along its rows and runs along its columns.
    owner : (P,) int64, written
        Region that each part is of.

    Returns
    -------
    int
        Number of parts.
    """
    step_y, step_x = int(tan_x.shape[0] > 1), int(tan_y.shape[1] > 1)
    count = 0
    for y in range(len(row_runs) - 1):
        for i in range(row_runs[y], row_runs[y + 1]):
            root = root_of(parent, i)
            if root == i:
                part[i] = count
                size[count] = 0.0
                across[count] = 0
                down[count] = 0
                squares[count] = 0.0
                moments[count, :] = 0.0
                owner[count] = run_label[i]
                count += 1
            else:
                part[i] = part[root]
            k = part[i]
            size[k] += run_stop[i] - run_start[i]  # holes and all, until the moments say
            down[k] += vertical[i]
            # A run that goes on after a short gap is one run.
            goes_on = (
                i > row_runs[y] and run_label[i - 1] == run_label[i] and run_start[i] - run_stop[i - 1] <= GAP
            )
            across[k] += 0 if goes_on else 1
    largest = np.full(len(region_moments), -1, np.int64)
    for k in range(count):
        a = owner[k]
        if largest[a] < 0 or size[k] > size[largest[a]]:
            largest[a] = k
    for y in range(len(row_runs) - 1):
        for i in range(row_runs[y], row_runs[y + 1]):
            k = part[i]
            a = owner[k]
            if largest[a] == k:
                continue
            for x in range(run_start[i], run_stop[i]):
                q = inverse_depth[y, x]
                if q == 0.0:
                    continue
                u, v = tan_x[y * step_y, x], tan_y[y, x * step_x]
                e = (q - (alpha[a, 0] * u + alpha[a, 1] * v + alpha[a, 2])) / deviation[a]
                squares[k] += min(e * e, cut * cut)
                add(moments[k], u, v, q, 1.0)
    for k in range(count):
        a = owner[k]
        if largest[a] != k:
            region_squares[a] -= squares[k]
            for j in range(10):
                region_moments[a, j] -= moments[k, j]
    for k in range(count):
        a = owner[k]
        if largest[a] == k:
            squares[k] = region_squares[a]
            moments[k] = region_moments[a]
        size[k] = moments[k, 0]
    return count


@kernel()
def judge_parts(
    size, across, down, squares, owner, curved, narrow, rough, least, reasons, why, stray, number, kept
):  # fmt: skip
    """Say of each part whether it is a plane, and why not.

    Parameters
    ----------
    size, across, down, squares, owner : (P,)
        Of `measure_parts`.
    curved : (N,) bool
        Of each region.
    narrow, rough, least : float
        Pixels per run, deviations, and pixels that a plane has.
    reasons : tuple of uint8
        For a plane, and for what is small, rough, curved or narrow.
    why : (P,) uint8, written
    stray : (P,) bool, written
        Whether a part is so small or narrow that its pixels may be specks in another.
    number : (P,) int32, written
        1, 2, ... for planes, 0 for the others.
    kept : (P,) int64, written
        The parts that are planes.

    Returns
    -------
    int
        How many planes there are.
    """
    plane, small, uneven, bent, thin = reasons
    count = 0
    for k in range(len(size)):
        why[k] = plane
        if size[k] < narrow * max(across[k], down[k]):
            why[k] = thin
        if curved[owner[k]]:
            why[k] = bent
        if squares[k] > rough * rough * size[k]:
            why[k] = uneven
        if size[k] < least:
            why[k] = small
        stray[k] = why[k] == small or why[k] == thin
        number[k] = 0
        if why[k] == plane:
            kept[count] = k
            count += 1
            number[k] = count
    return count


@kernel()
def label_runs(part, number, row_runs, run_label):
    """Give each run the label that ``number`` (P,) int32 says its part has."""
    for i in range(row_runs[-1]):
        run_label[i] = number[part[i]]


@kernel()
def write_labels(
    row_runs, run_start, run_stop, run_label, part, why, stray, missing, unclaimed, inverse_depth,
    loose, loose_count, label, reason,
):  # fmt: skip
    """Write the final labels and the reasons.

    Parameters
    ----------
    run_label : (K,) int32
        Final label of each run, 0 for none.
    why : (P,) uint8
        Reason of each part, 0 if it has a label; ``missing`` and ``unclaimed`` are those of the other pixels.
    stray : (P,) bool
        Parts without a label whose pixels are loose.
    loose, loose_count
        Of `find_runs`; those pixels are added.
    label, reason : (H, W) int32 and uint8, written

    Returns
    -------
    int
        How many loose pixels there are.
    """
    height, width = label.shape
    for y in range(height):
        label[y] = 0
        q, reason_row = inverse_depth[y], reason[y]
        for x in range(width):
            reason_row[x] = unclaimed if q[x] > 0.0 else missing
        for i in range(row_runs[y], row_runs[y + 1]):
            a, b = run_label[i], why[part[i]]
            start, stop = run_start[i], run_stop[i]
            q, label_run, reason_run = (
                inverse_depth[y, start:stop],
                label[y, start:stop],
                reason[y, start:stop],
            )
            for x in range(stop - start):
                label_run[x] = a if q[x] > 0.0 else 0
            for x in range(stop - start):
                reason_run[x] = b if q[x] > 0.0 else missing
            if stray[part[i]]:
                for x in range(stop - start):
                    if q[x] > 0.0:
                        loose[loose_count] = y * width + start + x
                        loose_count += 1
    return loose_count


@kernel()
def is_lone(label, inverse_depth, y, x):
    """Whether hardly a pixel around one has its label, and most have not."""
    height, width = label.shape
    same = others = 0
    for r in range(max(y - 1, 0), min(y + 2, height)):
        for c in range(max(x - 1, 0), min(x + 2, width)):
            if inverse_depth[r, c] > 0.0:
                alike = label[r, c] == label[y, x]
                same += alike
                others += not alike
    return same <= COMPANY and same <= others


@kernel()
def settle_strays(
    row_runs, run_start, run_stop, inverse_depth, unclaimed, least, needed, loose, loose_count,
    label, reason, sizes,
):  # fmt: skip
    """Take the label from pixels that stand alone, and let loose ones go with those around them.

    Parameters
    ----------
    least : int
        Pixels that a label keeps.
    needed : int
        A loose pixel goes with a label that so many or more of its eight neighbours have.
    loose, loose_count
        Of `write_labels`; those that lose their label are added.
    label, reason : (H, W) int32 and uint8, changed
    sizes : (N + 1,) int32, changed
        Pixels of each label.
    """
    height, width = label.shape
    labelled = loose_count
    for y in range(height):
        for i in range(row_runs[y], row_runs[y + 1]):
            if run_stop[i] - run_start[i] > COMPANY:
                continue
            for x in range(run_start[i], run_stop[i]):
                a = label[y, x]
                if a > 0 and sizes[a] > least and is_lone(label, inverse_depth, y, x):
                    loose[loose_count] = y * width + x
                    loose_count += 1
                    sizes[a] -= 1
    for i in range(labelled, loose_count):
        label[loose[i] // width, loose[i] % width] = 0
        reason[loose[i] // width, loose[i] % width] = unclaimed
    found = np.empty(loose_count, np.int32)
    for _ in range(2):
        for i in range(loose_count):
            y, x = loose[i] // width, loose[i] % width
            found[i] = label[y, x]
            if label[y, x] > 0 or y == 0 or x == 0 or y == height - 1 or x == width - 1:
                continue
            for k in range(4):  # more than half of eight must hold one of the first four
                a = label[y - 1, x - 1 + k] if k < 3 else label[y, x - 1]
                if a <= 0:
                    continue
                n = 0
                for r in range(y - 1, y + 2):
                    for c in range(x - 1, x + 2):
                        n += label[r, c] == a
                if n >= needed:
                    found[i] = a
                    break
        for i in range(loose_count):
            if found[i] > 0:
                if label[loose[i] // width, loose[i] % width] == 0:
                    sizes[found[i]] += 1
                label[loose[i] // width, loose[i] % width] = found[i]
                reason[loose[i] // width, loose[i] % width] = 0
