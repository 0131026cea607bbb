"""Segmentation: squares that are surely one plane grow together, before regions are weighed against each other.

`merge` then has to weigh hundreds of regions, best pairs first, instead of thousands of squares. Which of two
planes takes a square that fits both is not decided here: such a square adds more than is sure.
"""

import numpy as np

from ..._jit.kernel import kernel
from ...common.bit_marks import in_words, list_bits
from ...common.union_find import root_of
from ..model.moments import residual_of_two
from ..model.records import Noise, Rules
from .merge import describe


@kernel(inline="compiled")
def differ(a, b):
    """1 if ``a`` and ``b`` are two regions, else 0."""
    return 1 if (a >= 0) & (b >= 0) & (a != b) else 0


@kernel()
def grow_together(region, moments, noise, rules, parent):
    """Join regions that touch, one pair after the other along the rows of blocks.

    Two regions of together at most ``most`` pixels are joined if that raises the sum of squared residuals by no more
    than the share ``sure`` of what `merge.merge` allows in the end.

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
    most, floor, spread = rules.most, rules.sure * rules.region_floor**2, rules.sure * rules.region_spread
    last_a, last_b = np.full(2, -1), np.full(2, -1)  # the last pair refused, in each direction
    # For each block of a row, a byte: bit 0 is for another region to the right, bit 1 for one below.
    touching = np.zeros(in_words(columns), np.uint8)
    words, touches = touching.view(np.uint64), np.empty(2 * columns, np.int32)
    for row in range(rows):
        own, below = region[row], region[min(row + 1, rows - 1)]
        for c in range(columns - 1):
            touching[c] = differ(own[c], own[c + 1]) + 2 * differ(own[c], below[c])
        touching[columns - 1] = 2 * differ(own[columns - 1], below[columns - 1])
        for n in range(list_bits(words, touches)):
            side, c = touches[n] & 1, touches[n] >> 3
            here, there = own[c], below[c] if side == 1 else own[c + 1]
            a, b = root_of(parent, here), root_of(parent, there)
            parent[here], parent[there] = a, b  # so that no way is long
            if a == b or (a == last_a[side] and b == last_b[side]):
                continue
            together, joined = 0.0, False
            if moments[a, 0] + moments[b, 0] <= most:
                together = residual_of_two(moments, a, b)
                calm, smaller = (min(waviness_square[a], waviness_square[b]), min(moments[a, 0], moments[b, 0]))
                allowed = min(variances[a], variances[b]) * (floor * calm * smaller + spread)
                joined = together - rss[a] - rss[b] <= allowed
            if not joined:
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
