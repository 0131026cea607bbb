"""Segmentation: regions that go on behind something thin in front of them.

A pole in front of a curved wall parts it, and each part may be no more bent than a sensor bends planes. Together they
are an arc: see `curved.find_curved`.
"""

from ..._jit.kernel import kernel
from ..model.boxes import overlap


@kernel()
def is_in_front(pyramid, i, alpha, beyond):
    """Whether a block lies before a plane, by more than ``beyond`` in inverse depth, or nothing of it is measured."""
    m = pyramid.moments
    plane_sum = alpha[0] * m[1, i] + alpha[1] * m[2, i] + alpha[2] * m[0, i]
    return m[0, i] == 0.0 or m[3, i] - plane_sum > beyond * m[0, i]


@kernel(inline="compiled")
def may_cross(box, a, b, down):
    """Whether half of the rows of the shorter region, or columns if ``down`` is 1, may cross a gap between two."""
    along, common = 2 * down, overlap(box, a, b, down)
    shorter = min(box[a, along + 1] - box[a, along], box[b, along + 1] - box[b, along])
    return 2 * common >= shorter and -overlap(box, a, b, 1 - down) <= common


@kernel()
def gap_between(region, rays, pyramid, alpha, a, b, box, down, beyond, where):
    """Whether regions a and b lie on both sides of a gap that something in front fills, longer than wide.

    Looked at are the rows of blocks, or columns if ``down`` is 1, that both regions have: half of the shorter one must
    cross the gap, which is no wider than either region.

    Parameters
    ----------
    region : (R, C) int32
    rays : Rays
    pyramid : Pyramid
    alpha : (N, 3) float64
    box : (N, 4) int64
        See `boxes.boxes`.
    beyond : float
        See `is_in_front`.
    where : (3,) float64, written
        As in `Contacts`, of the middle of the gap.
    """
    if not may_cross(box, a, b, down):
        return False
    columns = region.shape[1]
    along, across = 2 * down, 2 - 2 * down
    shorter = min(box[a, along + 1] - box[a, along], box[b, along + 1] - box[b, along])
    narrower = min(box[a, across + 1] - box[a, across], box[b, across + 1] - box[b, across])
    first, last = min(box[a, across], box[b, across]), max(box[a, across + 1], box[b, across + 1])
    lines, wide = 0, 0
    where[:] = 0.0
    for line in range(max(box[a, along], box[b, along]), min(box[a, along + 1], box[b, along + 1])):
        before, at, is_hidden = -1, 0, True
        for k in range(first, last):
            row, column = (k, line) if down else (line, k)
            here = region[row, column]
            if here != a and here != b:
                i = row * columns + column
                is_hidden &= is_in_front(pyramid, i, alpha[a], beyond) and is_in_front(pyramid, i, alpha[b], beyond)
                continue
            if before >= 0 and here != before and is_hidden and k > at + 1:
                lines += 1
                wide += k - at - 1
                y, x = ((at + k) // 2, line) if down else (line, (at + k) // 2)
                where[0] += 1.0
                where[1] += rays.centre_u[y if rays.centre_u.shape[0] > 1 else 0, x]
                where[2] += rays.centre_v[y, x if rays.centre_v.shape[1] > 1 else 0]
            before, at, is_hidden = here, k, True
    return 2 * lines >= shorter and wide <= lines * min(narrower, lines)
