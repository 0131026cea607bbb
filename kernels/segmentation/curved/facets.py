"""Segmentation: planes that are the facets of something round.

The mesh of a cushion or the strips of a lamp's shade are planes to the last digit, but nobody would call them planes.
Unlike the faces of a box, they meet at small angles, one after the other, bending the same way.
"""

import numpy as np

from ..._jit.kernel import kernel
from ...common.union_find import root_of, unite
from ..model.moments import angle_between, difference, jump_at
from ..model.quadrics import group_turns
from ..model.records import BLOCK

STRAIGHT, AWAY, TOWARDS = 0, 1, 2
FACETS = 4  # planes that something round has at least: a ceiling between two slopes has three


@kernel(arrays=False)
def bend_between(a, b, m_a, m_b, where, alpha, rays, blunt):
    """How two regions that touch are bent against each other, if by less than ``blunt`` radians.

    AWAY from the camera, as facets of a ball are, or TOWARDS it; STRAIGHT if their planes do not meet within a block of
    where the regions touch, or meet at a larger angle.
    """
    d_u, d_v, _ = difference(alpha, a, b)
    jump = jump_at(alpha, a, b, where)
    if not jump * jump <= BLOCK * BLOCK * ((d_u * rays.pitch_x) ** 2 + (d_v * rays.pitch_y) ** 2):
        return STRAIGHT
    if not angle_between(alpha[a], alpha[b]) < blunt:
        return STRAIGHT
    # From a's middle to b's, the plane of a comes nearer than that of b, or falls behind.
    nearer = d_u * (m_b[1] / m_b[0] - m_a[1] / m_a[0]) + d_v * (m_b[2] / m_b[0] - m_a[2] / m_a[0])
    return AWAY if nearer > 0.0 else TOWARDS


@kernel()
def find_faceted(region_moments, alpha, turned, sharp, blunt, rays, contacts, count, curved):
    """Mark the facets of what is meant to be round, such as a rendered ball or a lampshade of strips.

    Planes that meet at less than ``blunt`` radians and bend the same way form groups. A group is round if it has FACETS
    or more, none of which is half of it, and turns by more than ``sharp`` radians, root mean square.
    ``turned`` is that of `group_turns`, and the other arguments are those of `curved.find_curved`.
    """
    pairs, where, _ = contacts
    regions = len(alpha)
    turn_square, pixels = np.empty(regions), np.empty(regions)
    members = np.empty(regions, np.int64)
    largest = np.empty(regions)
    curved[:] = False
    for way in (AWAY, TOWARDS):
        parent = np.arange(regions)
        for i in range(count):
            a, b = pairs[i, 0], pairs[i, 1]
            if way == bend_between(a, b, region_moments[a], region_moments[b], where[i], alpha, rays, blunt):
                unite(parent, a, b)
        group_turns(parent, region_moments[:, 0], alpha, turned, turn_square, pixels, members)
        largest[:] = 0.0
        for a in range(regions):
            root = root_of(parent, a)
            largest[root] = max(largest[root], region_moments[a, 0])
        for a in range(regions):
            root = root_of(parent, a)
            many = members[root] >= FACETS and largest[root] < 0.5 * pixels[root]
            curved[a] |= many and turn_square[root] > sharp * sharp
