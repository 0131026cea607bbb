"""Variances by a noise model of the pixels of each label of an image, whatever their depths."""

import math

import numpy as np

from .._jit.kernel import kernel
from ..common.arrays import copy
from ..common.depth import inverse_depth
from ..moments.labels import labelled_runs
from .noise_variances import rounding_at, variance_at


@kernel(inline=True)
def run_variances(values, frame, rays, plane, noise, factors, run, variances):
    """Write the variances of the pixels of a run of a row, 0 where nothing is measured.

    Parameters
    ----------
    values, rays
        The row's raw values, and its tanθx and tanθy.
    factors
        The row of ``growth`` and of ``lateral``, as `label_variances` takes them.
    run : (start, stop)
    variances : along, independent, (W,) float64 each, written
        Variances along the ray, and those of rounding and across the ray.
    """
    _, lowest, highest, scale, offset, is_disparity = frame
    us, vs = rays
    growth, lateral = factors
    along, independent = variances
    start, stop = run
    a, b, c = plane[0], plane[1], plane[2]
    fitted = not math.isnan(a)
    for column in range(start, stop):
        value = values[column]
        q = a * us[column] + b * vs[column] + c if fitted else inverse_depth(value, scale, offset, is_disparity)
        there = (lowest <= value) & (value <= highest)
        variance = variance_at(q if there else 0.0, noise)
        along[column] = variance if there else 0.0
        independent[column] = rounding_at(q, noise) if there else 0.0
    if len(growth) > 0:
        for column in range(start, stop):
            along[column] *= growth[column]
    if lateral.shape[1] > 0 and fitted:
        uu, uv, vv = lateral[0], lateral[1], lateral[2]
        for column in range(start, stop):
            across = a * a * uu[column] + 2.0 * a * b * uv[column] + b * b * vv[column]
            there = (lowest <= values[column]) & (values[column] <= highest)
            independent[column] += across if there else 0.0


@kernel(reduction=True)
def add_variances(us, vs, along, independent, start, stop, sums, i):
    """Add the variances of a run to row ``i`` of ``sums``."""
    s_along = s_independent = squares = s_u = s_v = s_uu = s_uv = s_vv = 0.0
    for k in range(start, stop):
        u, v, total = us[k], vs[k], along[k] + independent[k]
        s_along += along[k]
        s_independent += independent[k]
        squares += total * total
        s_u += total * u
        s_v += total * v
        s_uu += total * u * u
        s_uv += total * u * v
        s_vv += total * v * v
    sums[i, 0] += s_along
    sums[i, 1] += s_independent
    sums[i, 2] += squares
    sums[i, 3] += s_u
    sums[i, 4] += s_v
    sums[i, 5] += s_uu
    sums[i, 6] += s_uv
    sums[i, 7] += s_vv


@kernel()
def label_variances(frame, rays, labels, alpha, noise, growth, lateral, sums):
    """Sums over the valid pixels of labels 1 to K of the variances of their errors, at the depths of their planes.

    Parameters
    ----------
    frame : RawFrame
    rays : tan_x and tan_y, (H, W) float64, or (1, W) and (H, 1)
    labels : (H, W) int32
        0 for none.
    alpha : (K, 3) float64
        Where it is NaN, each pixel's measured depth is used.
    noise : (8 or more,) float64
        Variances of the noise model: `noise_variances` says which entry is which.
    growth : (H, W) float64, or empty
        Factors on the variances of q along the ray that ``noise`` gives.
    lateral : (H, 3, W) float64, or empty
        Variance of tanθx, covariance of tanθx and tanθy and variance of tanθy across the ray, where a lens makes them
        differ.
    sums : (K, 8) float64, written
        Sums of the variances of q along the ray; of the variances of rounding and, with ``lateral``, of errors across
        the ray; of the squares of their total. Then sums of their total times u, v, u², uv and v², with (u, v) =
        (tanθx, tanθy).
    """
    height, width = labels.shape
    tan_x, tan_y = rays
    vs, along, independent = np.empty(width), np.empty(width), np.empty(width)
    starts, stops = np.empty(width, np.int64), np.empty(width, np.int64)
    grown, uneven = np.empty(0), np.empty((3, 0))
    sums[:] = 0.0
    for row in range(height):
        line = labels[row]
        count = labelled_runs(line, starts, stops)
        if count == 0:
            continue
        us = tan_x[row if tan_x.shape[0] > 1 else 0]
        if tan_y.shape[1] > 1:
            copy(tan_y[row], vs)
        else:
            vs[:] = tan_y[row, 0]
        if growth.shape[0] > 0:
            grown = growth[row]
        if lateral.shape[0] > 0:
            uneven = lateral[row]
        values = frame.raw[row]
        for run in range(count):
            start, stop = starts[run], stops[run]
            i = line[start] - 1
            run_variances(
                values, frame, (us, vs), alpha[i], noise, (grown, uneven), (start, stop), (along, independent)
            )
            add_variances(us, vs, along, independent, start, stop, sums, i)
