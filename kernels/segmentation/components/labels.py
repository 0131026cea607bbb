"""Segmentation: the label of every pixel, or why it has none."""

import numpy as np

from ..._jit.kernel import kernel
from ...common.arrays import copy
from ...common.bit_marks import list_marked, room_for_marks
from ..model.records import Reasons, Runs, place

# Pixels of one label among the eight around one of them that may be there by chance.
COMPANY = 2
# Of eight neighbours, how many of one label give it to a pixel without.
FILLED = 5


@kernel()
def leave_out(min_size, small, number, why, moments, deviation):
    """Take the numbers from planes that have too few pixels; returns how many planes are left.

    Parameters
    ----------
    min_size : int
        Pixels that a plane must have.
    small : uint8
        Reason of the parts without.
    number, why : (P,) int32 and uint8, changed
        Plane of each part, from 1 on, or 0, and the reason.
    moments, deviation : (N, 10) and (N,) float64, changed
        Of the planes: those that are left come first.
    """
    left = np.zeros(len(moments) + 1, np.int32)
    count = 0
    for k in range(len(moments)):
        if moments[k, 0] >= min_size:
            copy(moments[k], moments[count])
            deviation[count] = deviation[k]
            count += 1
            left[k + 1] = count
    for part in range(len(number)):
        if number[part] > 0 and left[number[part]] == 0:
            why[part] = small
        number[part] = left[number[part]]
    return count


@kernel()
def write_labels(inverse_depth, runs, number, why, reasons, label, reason, strays):
    """Write the labels and the reasons, and list the strays.

    Parameters
    ----------
    inverse_depth : (H, W) float32
    runs : Runs
    number, why : (P,) int32 and uint8
        Label of each part, 0 for none, and the reason for that.
    reasons : Reasons
        Of the other pixels.
    label, reason : (H, W) int32 and uint8, written
    strays : (H·W,) int32, written
        Pixels, y · W + x, that no region has, or only a small or a narrow part, and that are beside a label.

    Returns
    -------
    int
        Number of strays.
    """
    runs, reasons = Runs(*runs), Reasons(*reasons)
    height, width = label.shape
    stray, words, columns = room_for_marks(width)
    count = 0
    for y in range(height):
        write_row(inverse_depth[y], runs, y, number, why, reasons, label[y], reason[y])
        if y < 2:
            continue
        above, line, below, line_reason = label[y - 2], label[y - 1], label[y], reason[y - 1]
        for x in range(1, width - 1):
            is_stray = line_reason[x] == reasons.unclaimed
            is_stray |= (line_reason[x] == reasons.small) | (line_reason[x] == reasons.narrow)
            stray[x] = is_stray & ((above[x] | below[x] | line[x - 1] | line[x + 1]) > 0)
        for i in range(list_marked(stray, words, True, columns)):
            strays[count] = (y - 1) * width + columns[i]
            count += 1
    return count


@kernel(inline="compiled")
def write_row(q, runs, y, number, why, reasons, label, reason):
    """Write a row of `write_labels`."""
    unclaimed, missing = reasons.unclaimed, reasons.missing
    label[:] = 0
    reason[:] = unclaimed
    for k in range(runs.first[y], runs.first[y + 1]):
        a, b = number[runs.part[k]], why[runs.part[k]]
        for x in range(runs.start[k], runs.stop[k]):
            label[x] = a
        for x in range(runs.start[k], runs.stop[k]):
            reason[x] = b
    for x in range(len(q)):
        label[x] = label[x] if q[x] > 0.0 else 0
    for x in range(len(q)):
        reason[x] = reason[x] if q[x] > 0.0 else missing


@kernel()
def list_powder(missing, least, label, reason, size, edges, places, count):
    """List the pixels of labels with at most COMPANY of their label around them, and more others, after ``count``.

    Of 3x3 pixels those that are not ``missing`` count. Returns how many are listed then, and takes the listed ones from
    ``size`` (N + 1,) int32, of which ``least`` stay. Other arguments as in `settle_strays`.
    """
    height, width = label.shape
    for here in edges:
        y, x = place(here, width)
        if not (0 < y < height - 1 and 0 < x < width - 1):
            continue
        a, same, others = label[y, x], -1, 0
        if (label[y - 1, x] == a) + (label[y + 1, x] == a) + (label[y, x - 1] == a) + (label[y, x + 1] == a) > COMPANY:
            continue
        for r in range(y - 1, y + 2):
            for c in range(x - 1, x + 2):
                same += label[r, c] == a
                others += (label[r, c] != a) & (reason[r, c] != missing)
        if same <= COMPANY and same < others and size[a] > least:
            places[count] = here
            count += 1
            size[a] -= 1
    return count


@kernel()
def label_around(label, y, x):
    """The label that at least FILLED of the eight neighbours of a pixel have, or 0."""
    for k in range(4):  # FILLED are more than half of eight: they include one of the first four
        candidate = label[y - 1, x - 1 + k] if k < 3 else label[y, x - 1]
        same = 0
        for r in range(y - 1, y + 2):
            for c in range(x - 1, x + 2):
                same += label[r, c] == candidate
        if candidate > 0 and same >= FILLED:
            return candidate
    return np.int32(0)


@kernel()
def settle_strays(reasons, least, label, reason, size, edges, places, count):
    """Take the label from pixels that stand alone, and give strays that of FILLED pixels around them.

    Parameters
    ----------
    reasons : Reasons
    least : int
        Pixels that a label keeps at least.
    label, reason : (H, W) int32 and uint8, changed
    size : (N + 1,) int32, changed
        Pixels of each label.
    edges : (E,) int32
        Pixels with a label, y · W + x, that have a measured neighbour with another or none.
    places, count : (H·W,) int32 and int
        From `write_labels`; overwritten.
    """
    reasons = Reasons(*reasons)
    width, found = label.shape[1], np.empty(label.size, np.int32)
    strays, count = count, list_powder(reasons.missing, least, label, reason, size, edges, places, count)
    for i in range(strays, count):
        label[places[i] // width, places[i] % width] = 0
        reason[places[i] // width, places[i] % width] = reasons.unclaimed
    for _ in range(2):
        left = 0
        for i in range(count):
            found[i] = label_around(label, places[i] // width, places[i] % width)
        for i in range(count):
            y, x = places[i] // width, places[i] % width
            if found[i] > 0:
                label[y, x], reason[y, x] = found[i], 0
                size[found[i]] += 1
            else:
                places[left] = places[i]
                left += 1
        count = left
