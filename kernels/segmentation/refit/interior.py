"""Segmentation: the pixels that are surely their plane's own.

Along an edge each pixel went to the plane that it fits. So a plane gains some of its neighbour's pixels there and loses
some of its own, and a sensor's pixel may see both: that shifts planes by more than noise does. In the end planes are
fitted to the pixels whose neighbours are also theirs.
"""

import numpy as np

from ..._jit.kernel import kernel
from ...common.arrays import copy
from ...common.bit_marks import list_marked, room_for_marks
from ...statistics.pixel_runs import add_row
from ..model.moments import add, pixel_ray, residual
from ..model.planes import fit_planes
from ..model.records import Found, Labels, as_view
from .weights import weigh_rays

# In place of the label of a pixel that is not measured.
ABOVE = np.int32(np.iinfo(np.int32).max)
# Smallest share of its pixels that a plane is fitted to.
LEAST_INSIDE = 0.5


@kernel(inline="compiled")
def find_edges(label, reason, missing, y, torn, edge):
    """Mark the labelled pixels of row ``y`` that have a measured neighbour with another label, or none.

    A pixel and its neighbours are four squares of 2x2 pixels. It has such a neighbour if one of them is torn, which is
    to say that its measured pixels differ; and each square is looked at once for all its pixels.

    Parameters
    ----------
    label, reason, missing
        Label of each pixel, why it has none, and the reason of pixels that are not measured.
    y : int
        From 0 on, one row after the other.
    torn : (2, W + 1) bool, changed
        False at first: whether the squares of this row and the next are torn, and those of the row before and this.
        Entry x is that of columns x - 1 and x.
    edge : (W,) bool, written
    """
    above, here = torn[(y + 1) % 2], torn[y % 2]
    below = min(y + 1, len(label) - 1)
    a, b, why_a, why_b = label[y], label[below], reason[y], reason[below]
    for x in range(len(edge) - 1):
        high = max(max(a[x], b[x]), max(a[x + 1], b[x + 1]))  # missing pixels have label 0
        left = min(a[x] if why_a[x] != missing else ABOVE, b[x] if why_b[x] != missing else ABOVE)
        right = min(a[x + 1] if why_a[x + 1] != missing else ABOVE, b[x + 1] if why_b[x + 1] != missing else ABOVE)
        here[x + 1] = min(left, right) < high
    last = len(edge) - 1  # the last square has one column, which may be the image's only one
    here[last + 1] = (a[last] != b[last]) & (why_a[last] != missing) & (why_b[last] != missing)
    for x in range(len(edge)):
        edge[x] = (why_a[x] == 0) & (above[x] | above[x + 1] | here[x] | here[x + 1])


@kernel()
def interior_moments(label, reason, missing, inverse_depth, rays, moments, inside, edges):
    """Moments of the pixels of each label whose eight neighbours, as far as they are measured, have it too.

    Parameters
    ----------
    label, reason : (H, W) int32 and uint8
        Label of each pixel, 0 for none, and the reason for that, 0 for none.
    missing : uint8
        Reason of pixels that are not measured.
    inverse_depth : (H, W) float32
    rays : Rays
    moments : (N, 10) float64
        Of all pixels of labels 1..N.
    inside : (N, 10) float64, written
        ``moments`` again, where too few pixels would be left, or they would determine no plane.
    edges : (H·W,) int32, written
        The other pixels, y · W + x.

    Returns
    -------
    int
        Number of the other pixels.
    """
    height, width = label.shape
    torn = np.zeros((2, width + 1), np.bool_)
    edge, words, columns = room_for_marks(width)
    count = 0
    # Of the edges, in two sums each, of even columns and of odd ones: a pixel need not wait for the one beside it.
    sums = np.zeros((2, len(moments), 10))
    for y in range(height):
        find_edges(label, reason, missing, y, torn, edge[:width])
        for i in range(list_marked(edge, words, True, columns)):
            x = np.int64(columns[i])
            u, v = pixel_ray(rays, y, x)
            add(sums[x % 2, label[y, x] - 1], u, v, inverse_depth[y, x])
            edges[count] = y * width + x
            count += 1
    for k in range(len(moments)):
        for j in range(10):
            inside[k, j] = moments[k, j] - (sums[0, k, j] + sums[1, k, j])
        if inside[k, 0] < LEAST_INSIDE * moments[k, 0] or residual(inside[k]) < 0.0:
            copy(moments[k], inside[k])
    return count


@kernel()
def runs_inside(label, reason, missing, moments, inside, found):
    """Write the runs of the pixels that planes are fitted to, to ``found``; returns how many.

    ``found`` is that of `statistics.pixel_runs.add_row`, with room for as many runs as there are pixels.
    """
    height, width = label.shape
    torn, edge = np.zeros((2, width + 1), np.bool_), np.empty(width, np.bool_)
    line = np.empty(width, np.int32)
    change, words, columns = room_for_marks(width)
    whole = np.empty(len(moments) + 1, np.bool_)
    for k in range(len(moments)):
        whole[k + 1] = inside[k, 0] == moments[k, 0]
    number = 0
    for y in range(height):
        find_edges(label, reason, missing, y, torn, edge)
        row_labels = label[y]
        for x in range(width):
            line[x] = 0 if edge[x] else row_labels[x]
        for x in range(width):
            if edge[x] and whole[row_labels[x]]:
                line[x] = row_labels[x]
        number = add_row(line, y, change, words, columns, found, number)
    return number


@kernel()
def fit_interior(view, labels, missing, found, edges):
    """Fit the planes to the pixels that are surely theirs; returns how many others have a label.

    Parameters
    ----------
    view : View
    labels : Labels
    missing : uint8
        Reason of pixels that are not measured.
    found : Found
        ``inside``, ``alpha``, ``rss`` and ``weighted`` are written.
    edges : (H·W,) int32, written
        The others.
    """
    view, found, labels = as_view(view), Found(*found), Labels(*labels)
    count = interior_moments(
        labels.label, labels.reason, missing, view.inverse_depth, view.rays, found.moments, found.inside, edges
    )
    fit_planes(found.inside, found.alpha, found.rss)
    weigh_rays(labels.label, view.pyramid, found.inside, found.alpha, found.rss, found.weighted)
    return count
