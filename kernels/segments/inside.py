"""Segmentation: the pixels that are surely their plane's own.

Along an edge each pixel went to the plane that it fits. So a plane gains some of its neighbour's pixels there and loses
some of its own, and a sensor's pixel may see both: that shifts planes by more than noise does. In the end planes are
fitted to the pixels whose neighbours are also theirs.
"""

import numpy as np

from .._jit import kernel
from ..copying import copy
from ..marked import in_words, list_marked
from ..statistics.pixel_runs import add_row
from .moments import add, ray_of, residual
from .planes import fit_planes
from .unevenness import weigh_rays

# In place of a label: beyond the frame, and where nothing is measured.
BELOW, ABOVE = np.int32(-1), np.int32(np.iinfo(np.int32).max)
# Smallest share of its pixels that a plane is fitted to.
LEAST_INSIDE = 0.5


@kernel()
def find_edges(label, inverse_depth, y, most, least, edge):
    """Mark the labelled pixels of row ``y`` that have a measured neighbour with another label, or none.

    ``most`` and ``least`` (W + 2,) int32 are room, whose first and last entries are BELOW and ABOVE; ``edge`` (W,) bool
    is written.
    """
    height, width = label.shape
    above, below = max(y - 1, 0), min(y + 1, height - 1)
    a, b, c = label[above], label[y], label[below]
    q_a, q_b, q_c = inverse_depth[above], inverse_depth[y], inverse_depth[below]
    for x in range(width):
        high = max(a[x] if q_a[x] > 0.0 else BELOW, b[x] if q_b[x] > 0.0 else BELOW)
        low = min(a[x] if q_a[x] > 0.0 else ABOVE, b[x] if q_b[x] > 0.0 else ABOVE)
        most[x + 1] = max(high, c[x] if q_c[x] > 0.0 else BELOW)
        least[x + 1] = min(low, c[x] if q_c[x] > 0.0 else ABOVE)
    for x in range(width):
        high = max(most[x], most[x + 1], most[x + 2])
        low = min(least[x], least[x + 1], least[x + 2])
        edge[x] = (b[x] > 0) & ((high != b[x]) | (low != b[x]))


@kernel(inline=True)
def inside_moments(label, inverse_depth, rays, moments, inside):
    """Moments of the pixels of each label whose eight neighbours, as far as they are measured, have it too.

    Parameters
    ----------
    label : (H, W) int32
        0 for none.
    inverse_depth : (H, W) float32
    rays : Rays
    moments : (N, 10) float64
        Of all pixels of labels 1..N.
    inside : (N, 10) float64, written
        ``moments`` again, where too few pixels would be left, or they would determine no plane.
    """
    height, width = label.shape
    most, least = np.empty(width + 2, np.int32), np.empty(width + 2, np.int32)
    most[0] = most[-1] = BELOW
    least[0] = least[-1] = ABOVE
    edge = np.zeros(in_words(width), np.bool_)
    of_row = edge[:width]
    words, columns = edge.view(np.uint64), np.empty(len(edge) + 1, np.uint32)  # those of a row's edges
    inside[:] = 0.0  # at first the sums over the edges
    for y in range(height):
        find_edges(label, inverse_depth, y, most, least, of_row)
        for i in range(list_marked(edge, words, True, columns)):
            x = columns[i]
            u, v = ray_of(rays, y, x)
            add(inside[np.uint32(label[y, x] - 1)], u, v, inverse_depth[y, x])
    for k in range(len(moments)):
        for j in range(10):
            inside[k, j] = moments[k, j] - inside[k, j]
        if inside[k, 0] < LEAST_INSIDE * moments[k, 0] or residual(inside[k]) < 0.0:
            copy(moments[k], inside[k])


@kernel()
def runs_inside(label, inverse_depth, moments, inside, found):
    """Write the runs of the pixels that planes are fitted to, see `inside_moments`, to ``found``; returns how many.

    ``found`` is that of `statistics.pixel_runs.add_row`, with room for as many runs as there are pixels.
    """
    height, width = label.shape
    most, least = np.full(width + 2, BELOW), np.full(width + 2, ABOVE)
    edge, line, change = np.empty(width, np.bool_), np.empty(width, np.int32), np.zeros(in_words(width), np.bool_)
    words, columns = change.view(np.uint64), np.empty(len(change) + 1, np.uint32)
    whole = np.empty(len(moments) + 1, np.bool_)
    for k in range(len(moments)):
        whole[k + 1] = inside[k, 0] == moments[k, 0]
    number = 0
    for y in range(height):
        find_edges(label, inverse_depth, y, most, least, edge)
        of, q = label[y], inverse_depth[y]
        for x in range(width):
            line[x] = of[x] if (q[x] > 0.0) & (not edge[x]) else 0
        for x in range(width):
            if edge[x] and whole[of[x]]:
                line[x] = of[x] if q[x] > 0.0 else 0
        number = add_row(line, y, change, words, columns, found, number)
    return number


@kernel()
def fit_inside(label, inverse_depth, rays, pyramid, moments, inside, alpha, rss, weighted):
    """Fit the planes to the pixels that are surely theirs.

    Parameters
    ----------
    label, inverse_depth, rays, moments
        See `inside_moments`.
    pyramid : Pyramid
    inside, alpha, rss : (N, 10), (N, 3) and (N,) float64, written
        Moments of these pixels, and the planes.
    weighted : (N, 5) float64, written
        See `unevenness.weigh_rays`.
    """
    inside_moments(label, inverse_depth, rays, moments, inside)
    fit_planes(inside, alpha, rss)
    weigh_rays(label, pyramid, inside, alpha, rss, weighted)
