"""Sums over the window around every pixel of a row, at a cost that hardly depends on the window's size.

Least squares of q on m = (tanθx, tanθy, 1) needs Σq, Σq·x and Σq·y of the inverse depth for each window. Because pixels
are missing and the frame ends, it also needs Σ1, Σx, Σy, Σxx, Σxy and Σyy over the valid pixels. x and y count from the
window's centre.

Along a row a window of w columns is put together from two of k and one of 1 or 3 between them, w = k + c + k. The
windows of k are made in the same way: a few steps for any w. Down the columns the sums move with the window, one row in
and one out. Without lens distortion x and y are whole pixels, and the sums over the valid pixels whole numbers. They
are exact in float32 for windows of up to 31: none reaches 2**24. Sums of the inverse depth are recomputed from the
window's rows at every BAND-th row of the frame, and when a row with a wild value leaves the window. So rounding errors
cannot pile up. Threads share out bands, so every window's sums are added in the same order for any number of threads.

The frame is handled in strips of columns. The channels of a strip's row (q, q·x, ...) lie one after the
other at a fixed PITCH, so that the compiler sees their distance and vectorises every loop. Rows and columns
that a window reaches beyond the frame are missing pixels, zero in every channel.
"""

import numpy as np

from .._jit.kernel import kernel
from ..common.depth import inverse_depth

# Columns of a strip with the margins of its windows: the sums of its rows stay in the nearest caches.
PITCH = 704
# Rows after which sums are recomputed.
BAND = 64
# Inverse depths (1/m) above this, nearer than a millimetre, would leave rounding errors behind when they leave a sum.
WILD = 1000.0


@kernel(arrays=False)
def strip_width(width, window):
    """Number of columns of a strip: as many as possible, and about equally many in each."""
    widest = PITCH - (window - 1)
    strips = -(-width // widest)
    return -(-width // strips)


@kernel(reduction=True, arrays=False)
def read_row(frame, row, column, q, valid):
    """Write the inverse depth and the validity (1 or 0) of a row's pixels from ``column`` on, 0 beyond the frame.

    Returns
    -------
    missing : int
        Number of missing pixels; beyond the frame's first and last row all are.
    wild : int
        Number of wild pixels.
    """
    raw, lowest, highest, scale, offset, is_disparity = frame
    height, width = raw.shape
    first = max(column, 0)
    last = min(column + q.shape[0], width)
    if row < 0 or row >= height:
        q[:] = 0.0
        valid[:] = 0
        return last - first, 0
    q[: first - column] = 0.0
    valid[: first - column] = 0
    q[last - column :] = 0.0
    valid[last - column :] = 0
    values = raw[row, first:last]
    q_inside = q[first - column : last - column]
    valid_inside = valid[first - column : last - column]
    missing = 0
    wild = 0
    for i in range(values.shape[0]):
        is_valid = (values[i] >= lowest) & (values[i] <= highest)
        inverse = inverse_depth(values[i], scale, offset, is_disparity)
        inverse = inverse if is_valid else 0.0
        q_inside[i] = inverse
        valid_inside[i] = np.float32(1.0) if is_valid else np.float32(0.0)
        missing += 0 if is_valid else 1
        wild += 1 if inverse > WILD else 0
    return missing, wild


@kernel()
def plan_steps(window):
    """How a window is put together, w = k + c + k with k odd and c 1 or 3: the c of each step.

    Each step puts c columns between two of the parts that the one before it made; the first between two columns.
    """
    between = np.empty(window, np.int64)
    first = size = window
    while size > 1:
        c = 1 if size == 3 or (size - 1) // 2 % 2 == 1 else 3
        size = (size - c) // 2
        first -= 1
        between[first] = c
    return between[first:]


@kernel(reduction=True, arrays=False)
def three_depth_columns(q, count, sums):
    """Sums of q and q·x over 3 columns, of which the first is i."""
    for i in range(count - 2):
        sums[PITCH + i] = q[i + 2] - q[i]
        sums[i] = q[i] + q[i + 1] + q[i + 2]


@kernel(reduction=True, arrays=False)
def join_depth_columns(shift, left, q, right, count, sums):
    """Sums of q and q·x over k + 1 + k columns, from those over k columns whose centres are ``shift`` away."""
    x = float(shift)
    for i in range(count):
        sums[PITCH + i] = left[PITCH + i] + right[PITCH + i] + x * (right[i] - left[i])
        sums[i] = left[i] + q[i] + right[i]


@kernel(reduction=True, arrays=False)
def join_depth_columns_by_three(shift, left, three, right, count, sums):
    """Sums of q and q·x over k + 3 + k columns, from those over k columns whose centres are ``shift`` away."""
    x = float(shift)
    for i in range(count):
        sums[PITCH + i] = left[PITCH + i] + three[PITCH + i] + right[PITCH + i] + x * (right[i] - left[i])
        sums[i] = left[i] + three[i] + right[i]


@kernel(arrays=False)
def depth_sums_along_row(between, q, count, work, sums):
    """Sums of q and q·x over the window's columns, of which the first is i.

    Parameters
    ----------
    between : (STEPS,) int64
        Columns that each step puts in the middle, from `plan_steps`.
    q : (2 * PITCH,) float64
        q of ``count`` columns, and zeros, which are Σq·x over one column.
    work : (3, 2 * PITCH) float64
    sums : (2 * PITCH,) float64, written
    """
    steps = len(between)
    three = sums if steps == 1 and between[0] == 1 else work[2]
    three_depth_columns(q, count, three)
    part = q
    size = 1
    for step in range(steps):
        c = between[step]
        target = sums if step == steps - 1 else work[step % 2]
        if size == 1 and c == 1:
            part = three
            size = 3
            continue
        shift = (size + c) // 2
        new_size = 2 * size + c
        if c == 1:
            join_depth_columns(shift, part, q[size:], part[size + 1 :], count - new_size + 1, target)
        else:
            join_depth_columns_by_three(shift, part, three[size:], part[size + 3 :], count - new_size + 1, target)
        part = target
        size = new_size


@kernel(reduction=True, arrays=False)
def three_valid_columns(valid, count, sums):
    """Sums of 1, x, xx over the valid pixels of 3 columns, of which the first is i."""
    for i in range(count - 2):
        sums[2 * PITCH + i] = valid[i + 2] + valid[i]
        sums[PITCH + i] = valid[i + 2] - valid[i]
        sums[i] = valid[i] + valid[i + 1] + valid[i + 2]


@kernel(reduction=True, arrays=False)
def join_valid_columns(shift, left, valid, right, count, sums):
    """Sums of 1, x, xx over the valid pixels of k + 1 + k columns, from those over k, ``shift`` away."""
    square = shift * shift
    for i in range(count):
        apart = right[PITCH + i] - left[PITCH + i]
        xx = left[2 * PITCH + i] + right[2 * PITCH + i]
        sums[2 * PITCH + i] = xx + shift * (apart + apart) + square * (left[i] + right[i])
        sums[PITCH + i] = left[PITCH + i] + right[PITCH + i] + shift * (right[i] - left[i])
        sums[i] = left[i] + valid[i] + right[i]


@kernel(reduction=True, arrays=False)
def join_valid_columns_by_three(shift, left, three, right, count, sums):
    """Sums of 1, x, xx over the valid pixels of k + 3 + k columns, from those over k, ``shift`` away."""
    square = shift * shift
    for i in range(count):
        apart = right[PITCH + i] - left[PITCH + i]
        xx = left[2 * PITCH + i] + three[2 * PITCH + i] + right[2 * PITCH + i]
        sums[2 * PITCH + i] = xx + shift * (apart + apart) + square * (left[i] + right[i])
        sums[PITCH + i] = left[PITCH + i] + three[PITCH + i] + right[PITCH + i] + shift * (right[i] - left[i])
        sums[i] = left[i] + three[i] + right[i]


@kernel(arrays=False)
def valid_sums_along_row(between, valid, count, work, sums):
    """Sums of 1, x, xx over the valid pixels of the window's columns, of which the first is i.

    Parameters
    ----------
    between : (STEPS,) int64
        Columns that each step puts in the middle, from `plan_steps`.
    valid : (3 * PITCH,) float32
        1 or 0 for ``count`` columns, and zeros, which are Σx and Σxx over one column.
    work : (3, 3 * PITCH) float32
    sums : (3 * PITCH,) float32, written
    """
    steps = len(between)
    three = sums if steps == 1 and between[0] == 1 else work[2]
    three_valid_columns(valid, count, three)
    part = valid
    size = 1
    for step in range(steps):
        c = between[step]
        target = sums if step == steps - 1 else work[step % 2]
        if size == 1 and c == 1:
            part = three
            size = 3
            continue
        shift = np.float32((size + c) // 2)
        new_size = 2 * size + c
        if c == 1:
            join_valid_columns(shift, part, valid[size:], part[size + 1 :], count - new_size + 1, target)
        else:
            join_valid_columns_by_three(shift, part, three[size:], part[size + 3 :], count - new_size + 1, target)
        part = target
        size = new_size


@kernel(reduction=True, arrays=False)
def join_columns(left, middle, right, length, sums):
    """Plain sums of channels over k + c + k columns, from those over k and over c."""
    for i in range(length):
        sums[i] = left[i] + middle[i] + right[i]


@kernel(arrays=False)
def sums_along_row(between, channels, length, work, sums):
    """Plain sums of channels over the window's columns, of which the first is i.

    Parameters
    ----------
    between : (STEPS,) int64
        Columns that each step puts in the middle, from `plan_steps`.
    channels : (L,) float64
        One channel after the other; a channel's sums that would need columns behind its last are garbage.
    length : int
        Used length of ``channels``.
    work : (3, L) float64
    sums : (L,) float64, written
    """
    steps = len(between)
    three = sums if steps == 1 and between[0] == 1 else work[2]
    join_columns(channels, channels[1:], channels[2:], length - 2, three)
    part = channels
    size = 1
    for step in range(steps):
        c = between[step]
        target = sums if step == steps - 1 else work[step % 2]
        if size == 1 and c == 1:
            part = three
            size = 3
            continue
        middle = channels if c == 1 else three
        new_size = 2 * size + c
        join_columns(part, middle[size:], part[size + c :], length - new_size + 1, target)
        part = target
        size = new_size


@kernel(reduction=True, arrays=False)
def add_depth_row(y, row, count, sums):
    """Add a row at y to the window's sums of q, q·x, q·y."""
    weight = float(y)
    for i in range(count):
        sums[i] += row[i]
        sums[PITCH + i] += row[PITCH + i]
        sums[2 * PITCH + i] += weight * row[i]


@kernel(reduction=True, arrays=False)
def add_valid_row(y, row, count, sums):
    """Add a row at y to the window's sums of 1, x, xx, y, xy, yy over valid pixels."""
    weight = np.float32(y)
    for i in range(count):
        sums[i] += row[i]
        sums[PITCH + i] += row[PITCH + i]
        sums[2 * PITCH + i] += row[2 * PITCH + i]
        sums[3 * PITCH + i] += weight * row[i]
        sums[4 * PITCH + i] += weight * row[PITCH + i]
        sums[5 * PITCH + i] += weight * weight * row[i]


@kernel(reduction=True, arrays=False)
def move_depth_sums(half, old, new, count, sums):
    """Move the window's sums one row down: without the old row at y = -half, with the new one at y = half."""
    weight = float(half)
    for i in range(count):
        rest = sums[i] - old[i]
        sums[i] = rest + new[i]
        sums[PITCH + i] = sums[PITCH + i] - old[PITCH + i] + new[PITCH + i]
        sums[2 * PITCH + i] = sums[2 * PITCH + i] - rest + weight * (old[i] + new[i])


@kernel(reduction=True, arrays=False)
def move_valid_sums(half, old, new, count, sums):
    """Move the window's sums over valid pixels one row down, from ``old`` at y = -half to ``new`` at half; exact."""
    weight = np.float32(half)
    square = np.float32(half * half)
    for i in range(count):
        rest = sums[i] - old[i]
        rest_x = sums[PITCH + i] - old[PITCH + i]
        # y and yy of the rest, still from the old centre; then from the new one.
        rest_y = sums[3 * PITCH + i] + weight * old[i]
        rest_yy = sums[5 * PITCH + i] - square * old[i]
        sums[i] = rest + new[i]
        sums[PITCH + i] = rest_x + new[PITCH + i]
        sums[2 * PITCH + i] = sums[2 * PITCH + i] - old[2 * PITCH + i] + new[2 * PITCH + i]
        sums[3 * PITCH + i] = rest_y - rest + weight * new[i]
        sums[4 * PITCH + i] = sums[4 * PITCH + i] - rest_x + weight * (old[PITCH + i] + new[PITCH + i])
        sums[5 * PITCH + i] = rest_yy - (rest_y + rest_y) + rest + square * new[i]


@kernel(reduction=True, arrays=False)
def add_row(row, length, sums):
    """Add a row to plain sums."""
    for i in range(length):
        sums[i] += row[i]


@kernel(reduction=True, arrays=False)
def move_sums(old, new, length, sums):
    """Move plain sums one row down."""
    for i in range(length):
        sums[i] += new[i] - old[i]
