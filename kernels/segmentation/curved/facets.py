"""Segmentation: planes that are parts of something round, each by itself as flat as its noise.

A narrow part of a column does not show that it bends, and the mesh of a ball in a rendering does not bend at all. Three
or more of them are something round if the quadric through neighbours fits as well as their planes do. The faces of a
polyhedron are planes: a quadric leaves more of them than noise explains.
"""

import numpy as np

from ..._jit.kernel import kernel
from ...common.union_find import root_of
from ..model.quadrics import MARGIN, group_turns

LEAST_FACETS = 3
# Share of a region that a neighbour is compared with.
COVERED = 0.4
# Variances of a pixel by which a quadric may miss flat facets of a rendering, and more by so many times what planes do.
MISSED, MISSED_TIMES = 0.5, 4.0


@kernel(inline="compiled")
def are_facets(better, bend, covered, flat, rest, is_exact):
    """Whether two neighbours may be parts of something round; the arguments are what `curved.continues` returns.

    Where there is noise, one quadric is as good as two planes. In a rendering, ``is_exact``, planes always win: there
    the quadric leaves so little that noise would hide it.
    """
    is_better = better > -0.5 * MARGIN * bend
    return covered > COVERED and (is_better or (is_exact and rest < MISSED + MISSED_TIMES * flat))


@kernel()
def mark_round(parent, region_moments, alpha, turned, sharp, curved):
    """Mark the groups of facets that are something round.

    A group has LEAST_FACETS or more, none of which is half of it, and turns by more than ``sharp`` radians, root mean
    square. ``parent`` (N,) leads to the roots of groups, and ``turned`` is that of `group_turns`. ``curved`` (N,) bool
    is changed.
    """
    regions = len(alpha)
    turn_square, pixels, members = np.empty(regions), np.empty(regions), np.empty(regions, np.int64)
    group_turns(parent, region_moments[:, 0], alpha, turned, turn_square, pixels, members)
    largest = np.zeros(regions)
    for a in range(regions):
        root = root_of(parent, a)
        largest[root] = max(largest[root], region_moments[a, 0])
    for a in range(regions):
        root = root_of(parent, a)
        is_round = members[root] >= LEAST_FACETS and largest[root] < 0.5 * pixels[root]
        curved[a] |= is_round and turn_square[root] > sharp * sharp
