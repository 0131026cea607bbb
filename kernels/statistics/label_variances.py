"""Variances by a noise model of the pixels of each label of an image, whatever their depths."""

import math

import numpy as np

from .._jit.kernel import kernel
from ..common.arrays import copy
from ..common.depth import inverse_depth
from ..moments.labels import labelled_columns
from .noise_variances import rounding_at, variance_at


@kernel(inline=True)
def variances_of_run(
    values, lowest, highest, scale, offset, is_disparity, us, vs, plane, noise, growth, lateral, start, stop, along,
    independent,
):  # fmt: skip
    """Write the variances of pixels ``start`` to ``stop`` of a row: 0 where nothing is measured."""
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
        of_uu, of_uv, of_vv = lateral[0], lateral[1], lateral[2]
        for column in range(start, stop):
            across = a * a * of_uu[column] + 2.0 * a * b * of_uv[column] + b * b * of_vv[column]
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
def label_variances(
    raw, lowest, highest, scale, offset, is_disparity, tan_x, tan_y, labels, alpha, noise, growth, lateral,
    sums,
):  # fmt: skip
    """Sums over the valid pixels of labels 1 to K of the variances of their errors, at the depths of their planes.

    Parameters
    ----------
    tan_x, tan_y : (H, W) float64, or (1, W) and (H, 1)
    labels : (H, W) int32
        0 for none.
    alpha : (K, 3) float64
        Where it is NaN, each pixel's own depth is used.
    noise : see `noise_variances.LATERAL_X`
    growth : (H, W) float64, or empty
        Factors on the variances of q along the ray that ``noise`` gives.
    lateral : (H, 3, W) float64, or empty
        Variance of tanθx, covariance of tanθx and tanθy and variance of tanθy across the ray, where a lens makes them
        differ.
    sums : (K, 8) float64, written
        Sums of the variances of q along the ray, of those of rounding and, with ``lateral``, of errors across the ray,
        of the squares of their total, and of their total times u, v, u², uv and v², with (u, v) = (tanθx, tanθy).
    """
    height, width = raw.shape
    vs, along, independent = np.empty(width), np.empty(width), np.empty(width)
    grown, uneven = np.empty(0), np.empty((3, 0))
    sums[:] = 0.0
    for row in range(height):
        line = labels[row]
        stop, end = labelled_columns(line)
        if stop == end:
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
        while stop < end:
            start, label = stop, line[stop]
            while stop < end and line[stop] == label:
                stop += 1
            i = label - 1
            if i < 0:
                continue
            variances_of_run(
                raw[row], lowest, highest, scale, offset, is_disparity, us, vs, alpha[i], noise, grown, uneven, start,
                stop, along, independent,
            )  # fmt: skip
            add_variances(us, vs, along, independent, start, stop, sums, i)
