"""Segmentation: the label of every pixel, and why it has none."""

import numpy as np

from ._jit import kernel
from .segment_blocks import BLOCK
from .segment_runs import WHOLE, how_many

# Pixels of one label among the 3x3 around one of them that may be there by chance.
COMPANY = 3
# Of each pixel of a block the 3x3 around it, as far as they are of the block: see `Shares`.
AROUND = tuple(
    np.int32(
        sum(
            1 << BLOCK * y + x
            for y in range(max(p // BLOCK - 1, 0), min(p // BLOCK + 2, BLOCK))
            for x in range(max(p % BLOCK - 1, 0), min(p % BLOCK + 2, BLOCK))
        )
    )
    for p in range(BLOCK * BLOCK)
)


@kernel()
def label_runs(runs, number):
    """Give each run the label that ``number`` (P,) int32 says its part has."""
    for i in range(runs.first[-1]):
        runs.label[i] = number[runs.part[i]]


@kernel()
def write_labels(
    runs, shares, why, stray, missing, unclaimed, inverse_depth, loose, loose_count, label, reason
):  # fmt: skip
    """Write the final labels and the reasons.

    Parameters
    ----------
    runs : Runs
        With their final labels, 0 for none.
    shares : Shares
    why : (P,) uint8
        Reason of each part, 0 if it has a label; ``missing`` and ``unclaimed`` are those of the other pixels.
    stray : (P,) bool
        Parts without a label whose pixels are loose.
    loose, loose_count
        Of `segment_runs.find_runs`; those pixels are added.
    label, reason : (H, W) int32 and uint8, written

    Returns
    -------
    int
        How many loose pixels there are.
    """
    row_runs, run_start, run_stop, run_share, run_label, part = (
        runs.first, runs.start, runs.stop, runs.share, runs.label, runs.part,
    )  # fmt: skip
    height, width = label.shape
    for y in range(height):
        label[y] = 0
        q, label_row, reason_row = inverse_depth[y], label[y], reason[y]
        for x in range(width):
            reason_row[x] = unclaimed if q[x] > 0.0 else missing
        row = y // BLOCK
        for i in range(row_runs[row], row_runs[row + 1]):
            a, b = run_label[i], why[part[i]]
            start, stop = run_start[i] * BLOCK, min(run_stop[i] * BLOCK, width)
            if run_share[i] != WHOLE:
                pixels = shares.pixels[run_share[i]] >> np.int32(y % BLOCK * BLOCK)
                for x in range(stop - start):
                    if (pixels >> np.int32(x)) & 1:
                        label_row[start + x] = a
                        reason_row[start + x] = b
                        if stray[part[i]]:
                            loose[loose_count] = y * width + start + x
                            loose_count += 1
                continue
            q_run, label_run, reason_run = q[start:stop], label_row[start:stop], reason_row[start:stop]
            for x in range(stop - start):
                label_run[x] = a if q_run[x] > 0.0 else 0
            for x in range(stop - start):
                reason_run[x] = b if q_run[x] > 0.0 else missing
            if stray[part[i]]:
                for x in range(stop - start):
                    if q_run[x] > 0.0:
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
    runs, shares, inverse_depth, unclaimed, least, needed, loose, loose_count, label, reason, sizes
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
    for row in range(len(runs.first) - 1):
        for i in range(runs.first[row], runs.first[row + 1]):
            a = runs.label[i]
            if runs.share[i] == WHOLE or a == 0 or sizes[a] <= least:
                continue
            pixels = shares.pixels[runs.share[i]]
            for p in range(BLOCK * BLOCK):
                if not (pixels >> np.int32(p)) & 1 or how_many(pixels & AROUND[p]) > COMPANY:
                    continue
                y, x = row * BLOCK + p // BLOCK, runs.start[i] * BLOCK + p % BLOCK
                if is_lone(label, inverse_depth, y, x) and sizes[a] > least:
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
