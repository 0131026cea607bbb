"""Moments of the pixels of each label of an image, wherever they lie: one pass over the frame."""

import numpy as np

from ._jit import kernel
from .copying import copy
from .depth import depth, inverse_depth


@kernel(inline=True)
def points_of_row(
    raw, lowest, highest, scale, offset, is_disparity, tan_x, tan_y, is_standard, row, points
):  # fmt: skip
    """Write the points of a row of pixels, ``points`` (4, W): u, v, w, and 1, or 0 for what is missing.

    (u, v, w) is (tanθx, tanθy, q), or (X, Y, Z) if ``is_standard``.
    """
    values = raw[row]
    xs = tan_x[row if tan_x.shape[0] > 1 else 0]
    u, v, w, there = points[0], points[1], points[2], points[3]
    if tan_y.shape[1] > 1:
        copy(tan_y[row], v)
    else:
        v[:] = tan_y[row, 0]
    for column in range(len(values)):
        value = values[column]
        valid = (lowest <= value) & (value <= highest)
        there[column] = 1.0 if valid else 0.0
        u[column] = xs[column] if valid else 0.0
        v[column] = v[column] if valid else 0.0
    if is_standard:
        for column in range(len(values)):
            z = depth(values[column], scale, offset, is_disparity) if there[column] > 0.0 else 0.0
            u[column] *= z
            v[column] *= z
            w[column] = z
    else:
        for column in range(len(values)):
            q = inverse_depth(values[column], scale, offset, is_disparity) if there[column] > 0.0 else 0.0
            w[column] = q


@kernel(inline=True)
def end_of_run(labels, start):
    """The column after the last of a run of equal labels in a row."""
    stop = start + 1
    while stop < len(labels) and labels[stop] == labels[start]:
        stop += 1
    return stop


@kernel(inline=True)
def add_footprint(row, start, stop, footprint):
    """Add the places of a run's pixels: how many, Σx, Σy, Σx² and Σy²."""
    n, last = stop - start, stop - 1
    footprint[0] += n
    footprint[1] += n * (start + last) // 2
    footprint[2] += n * row
    # The sum of squares up to k is k(k + 1)(2k + 1) / 6.
    footprint[3] += (last * (last + 1) * (2 * last + 1) - (start - 1) * start * (2 * start - 1)) // 6
    footprint[4] += n * row * row


@kernel(inline=True)
def find_first(points, start, stop, reference):
    """Make the first valid point of a run the reference of its label; whether there is one."""
    for i in range(start, stop):
        if points[3, i] > 0.0:
            for k in range(3):
                reference[k] = points[k, i]
            return True
    return False


@kernel(reduction=True)
def add_run(points, start, stop, reference, sums):
    """Add a run's points, less ``reference``, to a label's ten ``sums``.

    Those of eq. tan_theta_scattermatrix, or of eq. XYZ_scattermatrix.
    """
    n = s_u = s_v = s_w = s_uu = s_uv = s_uw = s_vv = s_vw = s_ww = 0.0
    for i in range(start, stop):
        there = points[3, i]
        u = points[0, i] - there * reference[0]
        v = points[1, i] - there * reference[1]
        w = points[2, i] - there * reference[2]
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
    sums[0] += n
    sums[1] += s_u
    sums[2] += s_v
    sums[3] += s_w
    sums[4] += s_uu
    sums[5] += s_uv
    sums[6] += s_uw
    sums[7] += s_vv
    sums[8] += s_vw
    sums[9] += s_ww


@kernel()
def label_moments(
    raw, lowest, highest, scale, offset, is_disparity, tan_x, tan_y, is_standard, labels,
    footprint, moments, reference,
):  # fmt: skip
    """Moments of labels 1 to K.

    Parameters
    ----------
    tan_x, tan_y : (H, W) float64, or (1, W) and (H, 1)
    is_standard : bool
        Moments of (X, Y, Z) and not of (tanθx, tanθy, q).
    labels : (H, W) int32
        0 for none.
    footprint : (K, 5) int64, written
        Of each label's pixels, the missing ones too: how many, Σx, Σy, Σx² and Σy².
    moments, reference : (K, 10) and (K, 3) float64, written
        The ten sums, and the point that they are about: the label's first, so that little cancels.
    """
    height, width = raw.shape
    points = np.empty((4, width))
    begun = np.zeros(len(moments), np.bool_)
    footprint[:] = 0
    moments[:] = 0.0
    reference[:] = 0.0
    for row in range(height):
        points_of_row(
            raw, lowest, highest, scale, offset, is_disparity, tan_x, tan_y, is_standard, row, points
        )
        stop = 0
        while stop < width:
            start, stop = stop, end_of_run(labels[row], stop)
            i = labels[row, start] - 1
            if i >= 0:
                add_footprint(row, start, stop, footprint[i])
                begun[i] = begun[i] or find_first(points, start, stop, reference[i])
                add_run(points, start, stop, reference[i], moments[i])
