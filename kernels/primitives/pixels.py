"""The pixels of labels that primitives are fitted to, label after label."""

import numpy as np

from .._jit.kernel import kernel
from ..common.depth import inverse_depth


@kernel()
def mark_interior(raw, lowest, highest, labels, interior, sizes):
    """Mark the valid labelled pixels of whose eight neighbours each valid one has the same label.

    Parameters
    ----------
    raw, lowest, highest
        A pixel is valid if ``lowest <= raw <= highest``.
    labels : (H, W) int32
        0 for none, 1 to K.
    interior : (H, W) bool, written
    sizes : (K, 2) int64, written
        Valid pixels of each label, and interior ones among them.
    """
    height, width = labels.shape
    sizes[:] = 0
    for y in range(height):
        top, bottom = max(y - 1, 0), min(y + 2, height)
        for x in range(width):
            label = labels[y, x]
            inside = (label > 0) & (lowest <= raw[y, x]) & (raw[y, x] <= highest)
            interior[y, x] = inside
            if not inside:
                continue
            for row in range(top, bottom):
                for column in range(max(x - 1, 0), min(x + 2, width)):
                    value = raw[row, column]
                    inside &= (labels[row, column] == label) | (value < lowest) | (value > highest) | (value != value)
            interior[y, x] = inside
            sizes[label - 1, 0] += 1
            sizes[label - 1, 1] += inside


@kernel()
def gather_pixels(frame, rays, labels, interior, whole, position, pixels, places):
    """Write the pixels of each label one after the other, row by row.

    Parameters
    ----------
    frame : RawFrame
    rays : tan_x and tan_y, (H, W) float64, or (1, W) and (H, 1)
    labels, interior : (H, W) int32 and bool
    whole : (K,) bool
        Labels of which all valid pixels are wanted, and not only the interior ones.
    position : (K,) int64, changed
        Where the pixels of each label begin; on return, where they end.
    pixels : (3, M) float64, written
        tanθx, tanθy and q.
    places : (2, M) int32, written
        Rows and columns.
    """
    raw, lowest, highest, scale, offset, is_disparity = frame
    tan_x, tan_y = rays
    height, width = labels.shape
    us, vs, qs = pixels
    for y in range(height):
        along = tan_x[y if tan_x.shape[0] > 1 else 0]
        for x in range(width):
            k = labels[y, x] - 1
            if k < 0 or not (interior[y, x] or (whole[k] and lowest <= raw[y, x] <= highest)):
                continue
            i = position[k]
            position[k] = i + 1
            us[i], vs[i] = along[x], tan_y[y, x if tan_y.shape[1] > 1 else 0]
            qs[i] = inverse_depth(np.float64(raw[y, x]), scale, offset, is_disparity)
            places[0, i], places[1, i] = y, x
