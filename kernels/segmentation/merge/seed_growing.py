"""Segmentation: squares that are surely one plane grow together, before regions are weighed against each other.

`merge` then has to weigh hundreds of regions, best pairs first, instead of thousands of squares. Which of two
planes takes a square that fits both is not decided here: such a square adds more than is sure.
"""

import numpy as np

from ..._jit.kernel import kernel
from ...common.union_find import root_of
from ..model.moments import joint_residual
from ..model.records import Noise, Rules
from .merge import describe


@kernel()
def grow_together(region, moments, noise, rules, parent):
    """Join regions that touch, one pair after the other along the rows of blocks.

    Two regions are joined if that raises the sum of squared residuals by no more than the share ``certain_share`` of
    what `merge.merge` allows in the end.

    Parameters
    ----------
    region : (R, C) int32
        Region of each block, or -1.
    moments : (N, 10) float64
        Of each region; those of a joined region are written to the row that ``parent`` names.
    noise : Noise
    rules : Rules
    parent : (N,) int64, written
        The region that each one went into.
    """
    noise, rules = Noise(*noise), Rules(*rules)
    regions = len(moments)
    rows, columns = region.shape
    rss, variances, waviness_square = np.empty(regions), np.empty(regions), np.empty(regions)
    described = np.empty((regions, 3)), rss, variances, waviness_square
    describe(moments, np.ones(regions, np.bool_), noise, described)
    for a in range(regions):
        parent[a] = a
    floor = rules.certain_share * (rules.tolerance * rules.bend_deviations) ** 2
    spread = rules.certain_share * rules.joint_variances
    last_a, last_b = np.full(2, -1), np.full(2, -1)  # the last pair refused, in each direction
    for row in range(rows):
        line, below = region[row], region[min(row + 1, rows - 1)]
        for n in range(2 * columns):
            side, c = n & 1, n >> 1  # the block to the right, and the one below
            here, there = line[c], below[c] if side == 1 else line[min(c + 1, columns - 1)]
            if here < 0 or there < 0 or here == there:
                continue
            a, b = root_of(parent, here), root_of(parent, there)
            parent[here], parent[there] = a, b  # so that no way is long
            if a == b or (a == last_a[side] and b == last_b[side]):
                continue
            together = joint_residual(moments, a, b)
            waves, smaller = min(waviness_square[a], waviness_square[b]), min(moments[a, 0], moments[b, 0])
            if together - rss[a] - rss[b] > min(variances[a], variances[b]) * (floor * waves * smaller + spread):
                last_a[side], last_b[side] = a, b
                continue
            a, b = min(a, b), max(a, b)
            parent[b] = a
            for j in range(10):
                moments[a, j] += moments[b, j]
            rss[a] = together
            variances[a] = min(variances[a], variances[b])
            waviness_square[a] = max(waviness_square[a], waviness_square[b])
    for a in range(regions):
        parent[a] = root_of(parent, a)
