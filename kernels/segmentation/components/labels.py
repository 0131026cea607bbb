"""Segmentation: the label of every pixel, or why it has none."""

import numpy as np

from ..._jit.kernel import kernel
from ...common.arrays import copy
from ...common.bit_marks import lowest_bit
from ..model.records import BLOCK, Found, Reasons, Runs
from .runs import WHOLE, in_squares

# Pixels of one label among the 3x3 around one of them that may be there by chance.
COMPANY = 3
# Of eight neighbours, how many of one label give it to a pixel without.
FILLED = 5


@kernel()
def label_runs(runs, number):
    """Give each run the label of its part, from ``number`` (P,) int32."""
    for i in range(runs.first[-1]):
        runs.label[i] = number[runs.part[i]]


@kernel()
def leave_out(planes, min_size, small, runs, found):
    """Take the labels from planes that have too few pixels; returns the number of those that are left.

    Parameters
    ----------
    planes : int
        Their number, with the smaller ones.
    min_size : int
        Pixels that a plane must have.
    small : uint8
        Reason of the parts without.
    runs : Runs
        Their labels are changed.
    found : Found, changed
    """
    runs, found = Runs(*runs), Found(*found)
    number, why, moments, deviation = found.number, found.why, found.moments, found.deviation
    left = np.zeros(planes + 1, np.int32)
    count = 0
    for k in range(planes):
        if moments[k, 0] >= min_size:
            copy(moments[k], moments[count])
            deviation[count] = deviation[k]
            count += 1
            left[k + 1] = count
    if count < planes:
        for part in range(len(number)):
            if number[part] > 0 and left[number[part]] == 0:
                why[part] = small
            number[part] = left[number[part]]
        label_runs(runs, number)
    return count


@kernel()
def write_labels(inverse_depth, runs, found, reasons, loose_count, labels):
    """Write the final labels and the reasons.

    Parameters
    ----------
    inverse_depth : (H, W) float32
    runs : Runs
        With their final labels, 0 for none.
    found : Found
        The pixels of stray parts without a label are added to ``loose``.
    reasons : Reasons
        Of the other pixels.
    loose_count : int
        From `find_parts`.
    labels : Labels, written

    Returns
    -------
    int
        Number of loose pixels.
    """
    runs, found, reasons = Runs(*runs), Found(*found), Reasons(*reasons)
    label, reason = labels
    why, stray, loose = found.why, found.stray, found.loose
    row_runs, run_start, run_stop, run_share = runs.first, runs.start, runs.stop, runs.share
    run_label, part, run_pixels = runs.label, runs.part, runs.pixels
    missing, unclaimed = reasons.missing, reasons.unclaimed
    height, width = label.shape
    line, why_none, q = label.reshape(-1), reason.reshape(-1), inverse_depth.reshape(-1)
    # Labels and reasons of whole blocks in a row of pixels: missing pixels aside, the blocks' other rows have the same.
    line_label = np.empty(-(-width // BLOCK) * BLOCK, np.int32)
    line_reason = np.empty(len(line_label), np.uint8)
    for row in range(len(row_runs) - 1):
        first, stop = row_runs[row], row_runs[row + 1]
        top, bottom = row * BLOCK, min(row * BLOCK + BLOCK, height)
        line_label[:] = 0
        line_reason[:] = unclaimed
        for i in range(first, stop):
            if run_share[i] == WHOLE:
                a, b = run_label[i], why[part[i]]
                left, right = run_start[i] * BLOCK, run_stop[i] * BLOCK
                for x in range(left, right):
                    line_label[x] = a
                for x in range(left, right):
                    line_reason[x] = b
        for y in range(top, bottom):
            begin = y * width
            for x in range(width):
                line[begin + x] = line_label[x] if q[begin + x] > 0.0 else 0
            for x in range(width):
                why_none[begin + x] = line_reason[x] if q[begin + x] > 0.0 else missing
        for i in range(first, stop):
            left = run_start[i] * BLOCK
            if run_share[i] != WHOLE:
                a, b, is_stray, pixels = run_label[i], why[part[i]], stray[part[i]], run_pixels[i]
                corner = top * width + left
                while pixels != 0:
                    p = lowest_bit(pixels)
                    pixels &= pixels - np.int32(1)
                    here = corner + p // BLOCK * width + p % BLOCK
                    line[here] = a
                    why_none[here] = b
                    loose[loose_count] = here
                    loose_count += is_stray
            elif stray[part[i]]:
                for y in range(top, bottom):
                    for here in range(y * width + left, y * width + min(run_stop[i] * BLOCK, width)):
                        loose[loose_count] = here
                        loose_count += q[here] > 0.0
    return loose_count


@kernel()
def is_lone(labels, inverse_depth, here, a):
    """Whether at most COMPANY of the measured 3x3 pixels share label ``a``, and no more than do not.

    ``labels`` is (H·W,).
    """
    height, width = inverse_depth.shape
    same = others = 0
    y, x = here // width, here % width
    for r in range(max(y - 1, 0), min(y + 2, height)):
        for c in range(max(x - 1, 0), min(x + 2, width)):
            if inverse_depth[r, c] > 0.0:
                alike = labels[r * width + c] == a
                same += alike
                others += not alike
    return same <= COMPANY and same <= others


@kernel(inline="compiled")
def label_around(a, b, c, d, e, f, g, h):
    """The label that at least FILLED of eight have, or 0."""
    found = np.int32(0)
    for k in range(4):  # FILLED are more than half of eight: they include one of the first four
        candidate = a if k == 0 else b if k == 1 else c if k == 2 else d
        n = (
            np.int32(a == candidate) + np.int32(b == candidate) + np.int32(c == candidate) + np.int32(d == candidate)
            + np.int32(e == candidate) + np.int32(f == candidate) + np.int32(g == candidate) + np.int32(h == candidate)
        )  # fmt: skip
        found = candidate if n >= FILLED and candidate > 0 else found
    return found


@kernel()
def settle_strays(inverse_depth, runs, found, loose_count, unclaimed, least, label_reason):
    """Take the label from pixels that stand alone, and give loose ones that of FILLED pixels around them.

    Parameters
    ----------
    inverse_depth : (H, W) float32
    runs : Runs
        With their final labels, 0 for none.
    found : Found
        Pixels that lose their label are added to ``loose``, and ``size`` is written, by ``moments``.
    loose_count : int
        From `write_labels`.
    unclaimed : uint8
        Reason of pixels that lose their label.
    least : int
        Pixels that a label keeps at least.
    label_reason : Labels, changed
    """
    runs, found = Runs(*runs), Found(*found)
    label, reason = label_reason
    loose, sizes = found.loose, found.size
    for k in range(len(found.moments)):
        sizes[k + 1] = found.moments[k, 0]
    # By one index: there are many pixels, and dividing for two indices would take most of the time.
    width, labels, reasons = label.shape[1], label.reshape(-1), reason.reshape(-1)
    row_runs, run_start, run_share, run_label = runs.first, runs.start, runs.share, runs.label
    run_pixels = runs.pixels
    labelled = loose_count
    for row in range(len(row_runs) - 1):
        for i in range(row_runs[row], row_runs[row + 1]):
            a = run_label[i]
            if run_share[i] == WHOLE or a == 0 or sizes[a] <= least:
                continue
            pixels = run_pixels[i]
            few = pixels & ~in_squares(pixels)
            corner = row * BLOCK * width + run_start[i] * BLOCK
            while few != 0:
                p = lowest_bit(few)
                few &= few - np.int32(1)
                here = corner + p // BLOCK * width + p % BLOCK
                same = 0
                if width < here < len(labels) - width - 1:
                    # Beyond the left or right end of the image this reads the other end, and so can only find more
                    # company.
                    for y in range(-1, 2):
                        for x in range(-1, 2):
                            same += labels[here + y * width + x] == a
                if (
                    same <= COMPANY
                    and labels[here] == a  # and not let go: see `rim_outliers`
                    and sizes[a] > least
                    and is_lone(labels, inverse_depth, here, a)
                ):
                    loose[loose_count] = here
                    loose_count += 1
                    sizes[a] -= 1
    for i in range(labelled, loose_count):
        labels[loose[i]] = 0
        reasons[loose[i]] = unclaimed
    found = np.empty(loose_count, np.int32)
    for _ in range(2):
        for i in range(loose_count):
            here = loose[i]
            found[i] = labels[here]
            column = np.uint32(here) % np.uint32(width)
            inside = (here > width) & (here < len(labels) - width) & (column > 0) & (column < width - 1)
            if labels[here] == 0 and inside:
                above, below = here - width, here + width
                found[i] = label_around(
                    labels[above - 1], labels[above], labels[above + 1], labels[here - 1], labels[here + 1],
                    labels[below - 1], labels[below], labels[below + 1],
                )  # fmt: skip
        for i in range(loose_count):
            if found[i] > 0:
                if labels[loose[i]] == 0:
                    sizes[found[i]] += 1
                labels[loose[i]] = found[i]
                reasons[loose[i]] = 0
