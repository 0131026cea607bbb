"""The pixels of parts of an image as runs along its rows, part after part."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._jit.kernel import kernel
from ..common.bit_marks import list_marked, room_for_marks


class PixelRuns(NamedTuple):
    """Runs of pixels side by side, those of part i in rows ``first[i]`` to ``first[i + 1]``."""

    first: NDArray[np.int64]  # (N + 1,)
    row: NDArray[np.int32]  # (M,)
    start: NDArray[np.int32]  # first column
    stop: NDArray[np.int32]  # last column + 1
    share: NDArray[Any]  # float64: of these pixels, how many are measured


@kernel()
def add_row(line, row, change, words, columns, found, number):
    """Write the runs of labels of a row, (W,) int32, 0 for none, behind the ``number`` of them that were found before.

    Parameters
    ----------
    change : (in_words(W),) bool
        False from column W on; for work.
    words : (len(change) / 8,) uint64
        The same: see `bit_marks.list_marked`.
    columns : (len(change) + 1,) int32
        For work.
    found : (4, M) int32
        Row, first column, last column + 1, and label.

    Returns
    -------
    number : int
        With those of this row.
    """
    change[0] = True
    for x in range(1, len(line)):
        change[x] = line[x] != line[x - 1]
    count = list_marked(change, words, True, columns)
    columns[count] = len(line)
    for i in range(count):
        start, stop = columns[i], columns[i + 1]
        if line[start] > 0:
            found[0, number], found[1, number], found[2, number], found[3, number] = row, start, stop, line[start]
            number += 1
    return number


@kernel()
def by_label(found, number, first, row, start, stop):
    """Write the first ``number`` runs that `add_row` found to fields of `PixelRuns`: label by label, from 1 on."""
    first[:] = 0
    for k in range(number):
        first[found[3, k]] += 1
    for i in range(len(first) - 1):
        first[i + 1] += first[i]
    position = first.copy()
    for k in range(number):
        to = position[found[3, k] - 1]
        row[to], start[to], stop[to] = found[0, k], found[1, k], found[2, k]
        position[found[3, k] - 1] = to + 1


@kernel()
def runs_of_labels(labels, raw, lowest, highest, found):
    """Write the runs of the measured pixels of each label to ``found``, as `add_row` does; returns how many.

    ``labels`` is (H, W) int32, 0 for none; pixels of ``raw`` from ``lowest`` to ``highest`` are measured. ``found`` has
    room for as many runs as there are pixels.
    """
    width = labels.shape[1]
    line = np.empty(width, np.int32)
    change, words, columns = room_for_marks(width)
    number = 0
    for row in range(len(labels)):
        label, values = labels[row], raw[row]
        for x in range(width):
            line[x] = label[x] if (lowest <= values[x]) & (values[x] <= highest) else 0
        number = add_row(line, row, change, words, columns, found, number)
    return number
