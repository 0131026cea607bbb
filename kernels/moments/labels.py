"""Moments of the pixels of each label of an image, wherever they lie: one pass over the frame."""

import numpy as np

from .._jit.kernel import kernel
from ..common.depth import depth, inverse_depth


@kernel(inline=True)
def labelled_runs(line, starts, stops):
    """Find the runs of equal labels of an image row; returns their number.

    Parameters
    ----------
    line : (W,) int32
        The row's labels, 0 for none.
    starts, stops : (W,) int64, written
        First column of each run that has a label, and the column after its last.
    """
    largest = np.int32(0)
    for column in range(len(line)):  # by itself, since it vectorises: of a mask most rows have none
        largest = max(largest, line[column])
    count, column = 0, 0 if largest > 0 else len(line)
    while column < len(line):
        start, label = column, line[column]
        while column < len(line) and line[column] == label:
            column += 1
        if label > 0:
            starts[count], stops[count] = start, column
            count += 1
    return count


@kernel(inline=True)
def scale_rays(rays, factor, begin, end, along):
    """Write a row's tanθx or tanθy, one for all columns or for each, times ``factor``, from ``begin`` to ``end``."""
    if len(rays) > 1:
        for column in range(begin, end):
            along[column] = rays[column] * factor[column]
    else:
        ray = rays[0]
        for column in range(begin, end):
            along[column] = ray * factor[column]


@kernel(inline=True)
def write_points(frame, rays, standard, row, first, stop, points):
    """Write the points of a row's columns ``first`` to ``stop``, ``points`` (4, W): u, v, w, and 1, or 0 if missing.

    (u, v, w) is (tanθx, tanθy, q), or (X, Y, Z) if ``standard``; all are 0 for a missing pixel.
    """
    raw, lowest, highest, scale, offset, is_disparity = frame
    tan_x, tan_y = rays
    values = raw[row]
    xs, ys = tan_x[row if tan_x.shape[0] > 1 else 0], tan_y[row]
    u, v, w, there = points[0], points[1], points[2], points[3]
    # Each loop writes one array, which takes less time than one loop for all.
    for column in range(first, stop):
        value = values[column]
        there[column] = 1.0 if (lowest <= value) & (value <= highest) else 0.0
    if standard:
        for column in range(first, stop):
            z = depth(values[column], scale, offset, is_disparity)
            w[column] = z if there[column] > 0.0 else 0.0
        scale_rays(xs, w, first, stop, u)
        scale_rays(ys, w, first, stop, v)
    else:
        for column in range(first, stop):
            q = inverse_depth(values[column], scale, offset, is_disparity)
            w[column] = q if there[column] > 0.0 else 0.0
        scale_rays(xs, there, first, stop, u)
        scale_rays(ys, there, first, stop, v)


@kernel(inline=True)
def add_footprint(row, start, stop, footprint, i):
    """Add the positions of a run's pixels to row ``i``: their number, Σx, Σy, Σx² and Σy²."""
    n, last = stop - start, stop - 1
    footprint[i, 0] += n
    footprint[i, 1] += n * (start + last) // 2
    footprint[i, 2] += n * row
    # The sum of squares up to k is k(k + 1)(2k + 1) / 6.
    footprint[i, 3] += (last * (last + 1) * (2 * last + 1) - (start - 1) * start * (2 * start - 1)) // 6
    footprint[i, 4] += n * row * row


@kernel(reduction=True, arrays=False)
def add_run(points, start, stop, reference, sums, i):
    """Add the ten sums of a run's points, relative to row ``i`` of ``reference``, to row ``i`` of ``sums``.

    These sums make up the matrix of the paper's eq. 14, or of its eq. 6.
    """
    n = s_u = s_v = s_w = s_uu = s_uv = s_uw = s_vv = s_vw = s_ww = 0.0
    r_u, r_v, r_w = reference[i, 0], reference[i, 1], reference[i, 2]
    us, vs, ws, theres = points[0], points[1], points[2], points[3]
    for k in range(start, stop):
        there = theres[k]
        u = us[k] - there * r_u
        v = vs[k] - there * r_v
        w = ws[k] - there * r_w
        n += there
        s_u += u
        s_v += v
        s_w += w
        s_uu += u * u
        s_uv += u * v
        s_uw += u * w
        s_vv += v * v
        s_vw += v * w
        s_ww += w * w
    sums[i, 0] += n
    sums[i, 1] += s_u
    sums[i, 2] += s_v
    sums[i, 3] += s_w
    sums[i, 4] += s_uu
    sums[i, 5] += s_uv
    sums[i, 6] += s_uw
    sums[i, 7] += s_vv
    sums[i, 8] += s_vw
    sums[i, 9] += s_ww


@kernel()
def label_moments(frame, rays, standard, labels, footprint, moments, reference):
    """Moments of labels 1 to K.

    Parameters
    ----------
    frame : RawFrame
    rays : tan_x and tan_y, (H, W) float64, or (1, W) and (H, 1)
    standard : bool
        Moments of (X, Y, Z) instead of (tanθx, tanθy, q).
    labels : (H, W) int32
        0 for none.
    footprint : (K, 5) int64, written
        For each label's pixels, missing ones included: their number, Σx, Σy, Σx² and Σy².
    moments, reference : (K, 10) and (K, 3) float64, written
        The ten sums, and the point they are taken about: the label's first valid one, so that little cancels.
    """
    height, width = labels.shape
    points = np.empty((4, width))
    starts, stops = np.empty(width, np.int64), np.empty(width, np.int64)
    begun = np.zeros(len(moments), np.bool_)
    footprint[:] = 0
    moments[:] = 0.0
    reference[:] = 0.0
    for row in range(height):
        line = labels[row]
        count = labelled_runs(line, starts, stops)
        if count == 0:
            continue
        write_points(frame, rays, standard, row, starts[0], stops[count - 1], points)
        for run in range(count):
            start, stop = starts[run], stops[run]
            i = line[start] - 1
            add_footprint(row, start, stop, footprint, i)
            first = start
            while not begun[i] and first < stop:  # the first valid point is the reference
                begun[i] = points[3, first] > 0.0
                for k in range(3):
                    reference[i, k] = points[k, first] if begun[i] else 0.0
                first += 1
            add_run(points, start, stop, reference, moments, i)
