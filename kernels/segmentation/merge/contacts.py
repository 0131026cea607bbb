"""Contacts: which regions touch, and where."""

import numpy as np

from ..._jit.kernel import kernel
from ...common.arrays import copy
from ...common.union_find import root_of
from ..model.records import Rays

FEW_SLOTS = 1 << 12


# Odd numbers, whose multiples look random.
ODD, OTHER_ODD = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9)


# Neighbours of a block, each pair of blocks once: right, below, below to the right and to the left; and after each the
# one behind it, which is a neighbour if the block in between has no region.
DOWN, RIGHT = np.array([0, 0, 1, 2, 1, 2, 1, 2]), np.array([1, 2, 0, 0, 1, 2, -1, -2])


SIDES = len(DOWN) // 2


@kernel(inline="compiled")
def scrambled(x):
    """A fixed pseudo-random order of the integers, so that ties do not make long chains."""
    y = np.uint64(x) * ODD
    y ^= y >> np.uint64(29)
    y *= OTHER_ODD
    return y ^ (y >> np.uint64(32))


@kernel(inline="compiled")
def pair_row(a, b, pairs, count, table, size):
    """The row of a pair of regions among the first ``count``, or ``count`` if it is none of them.

    ``pairs[row]`` is a, b and the slot of ``table`` int32 that says ``row``; for a new pair that slot is written to
    ``pairs[count]``. Of the table the first ``size``, a power of two, are in use: no more than the pairs need, so that
    a small one stays in the cache. Slots that earlier lists of pairs left in it do no harm: no row names them.
    """
    mixed = np.uint64(a) * ODD + np.uint64(b) * OTHER_ODD
    slot = np.int64(mixed >> np.uint64(40)) & (size - 1)  # upper bits depend on all lower ones
    while True:
        row = table[slot]
        if row >= count or pairs[row, 2] != slot:
            table[slot] = count
            pairs[count, 2] = slot
            return count
        if pairs[row, 0] == a and pairs[row, 1] == b:
            return np.int64(row)
        slot = (slot + 1) & (size - 1)


@kernel(inline="compiled")
def touch(a, near, behind):
    """1 if region ``a`` touches another that is ``near``, 2 if none is near, but another ``behind``, else 0."""
    far = 2 if (behind >= 0) & (behind != a) else 0
    return np.uint8((1 if near != a else 0) if near >= 0 else far)


@kernel(inline="compiled")
def touch_at_corner(a, near, behind, beside, below):
    """The same across a corner: regions touch there only if neither has one of the other two blocks at that corner.

    These are ``beside`` and ``below``; what is ``behind`` touches all the same.
    """
    is_apart = (beside != a) & (beside != near) & (below != a) & (below != near)
    return touch(a, near, behind) & np.uint8(3 if is_apart else 2)


@kernel()
def neighbours(region, rays, contacts):
    """Write the pairs of different regions whose blocks lie side by side, or else corner to corner.

    Parameters
    ----------
    region : (R, C) int32
        -1 is none.
    rays : Rays
    contacts : Contacts, written
        With room for 4·R·C pairs.

    Returns
    -------
    int
        Number of pairs.
    """
    rays = Rays(*rays)
    centre_u, centre_v = rays.centre_u, rays.centre_v
    pairs, where, table = contacts
    rows, columns = region.shape
    # With a rim of no regions: a block's neighbours, and theirs, can be read without asking where the frame ends.
    width = columns + 4
    around = np.full((rows + 2, width), np.int32(-1))
    for row in range(rows):
        copy(region[row], around[row, 2 : columns + 2])
    # By one index, and what to add to it in each direction; where (u, v) are the same for all rows or columns, nothing.
    flat, flat_u, flat_v = around.reshape(-1), centre_u.reshape(-1), centre_v.reshape(-1)
    down_u, down_v = columns if len(centre_u) > 1 else 0, centre_v.shape[1]
    right_v = 1 if down_v > 1 else 0
    steps, steps_u, steps_v = DOWN * width + RIGHT, DOWN * down_u + RIGHT, DOWN * down_v + RIGHT * right_v
    # For each block of a row, a byte: bit k is whether there is another region in direction k.
    touching = np.empty(columns, np.uint8)
    size = min(FEW_SLOTS, len(table))
    count = 0
    for row in range(rows):
        line, below, beyond = around[row], around[row + 1], around[row + 2]
        for c in range(columns):
            a = line[c + 2]
            sides = touch(a, line[c + 3], line[c + 4])
            sides |= touch(a, below[c + 2], beyond[c + 2]) << 2
            sides |= touch_at_corner(a, below[c + 3], beyond[c + 4], line[c + 3], below[c + 2]) << 4
            sides |= touch_at_corner(a, below[c + 1], beyond[c], line[c + 1], below[c + 2]) << 6
            touching[c] = sides if a >= 0 else 0
        needed = min(2 * (count + SIDES * columns), len(table))
        if size < needed:
            while size < needed:
                size = min(4 * size, len(table))
            for i in range(count):
                pair_row(pairs[i, 0], pairs[i, 1], pairs, i, table, size)
        for c in range(columns):
            if touching[c] == 0:
                continue
            here, here_u, here_v = row * width + c + 2, row * down_u + c, row * down_v + c * right_v
            for k in range(2 * SIDES):
                if not touching[c] >> k & 1:
                    continue
                line, b = flat[here], flat[here + steps[k]]
                a, b = min(line, b), max(line, b)
                i = pair_row(a, b, pairs, count, table, size)
                if i == count:
                    pairs[i, 0] = a
                    pairs[i, 1] = b
                    where[i, 0] = where[i, 1] = where[i, 2] = 0.0
                    count += 1
                where[i, 0] += 1.0
                where[i, 1] += 0.5 * (flat_u[here_u] + flat_u[here_u + steps_u[k]])
                where[i, 2] += 0.5 * (flat_v[here_v] + flat_v[here_v + steps_v[k]])
    return count


@kernel()
def contract(contacts, count, parent, changed):
    """Replace the regions of all pairs by what they have become; returns how many pairs are left.

    Parameters
    ----------
    contacts, count
        As in `merge`.
    parent : (N,) int64
        The region that each one went into.
    changed : (N,) bool
        Whether another one went into it since the pairs were last contracted.
    """
    pairs, where, table = contacts
    size = len(table)
    while size >= 4 * count and size > 2:
        size //= 2
    left = 0
    for i in range(count):
        a, b = root_of(parent, pairs[i, 0]), root_of(parent, pairs[i, 1])
        if a == b:
            continue
        # Pairs that disagree stay: one of the two may still change.
        pairs[left, 2] = -1
        if changed[a] or changed[b]:
            a, b = min(a, b), max(a, b)
            row = pair_row(a, b, pairs, left, table, size)
            if row < left:
                for k in range(3):
                    where[row, k] += where[i, k]
                continue
        pairs[left, 0] = a
        pairs[left, 1] = b
        for k in range(3):
            where[left, k] = where[i, k]
        left += 1
    return left


@kernel()
def keep_pairs_inside(contacts, count, parent, chosen):
    """Keep those of the first ``count`` pairs of which both lie in the same chosen region; returns how many.

    ``parent`` (N,) is the region that each lies in, ``chosen`` (N,) bool is that of these regions.
    """
    pairs, where, _ = contacts
    left = 0
    for i in range(count):
        root = parent[pairs[i, 0]]
        if root == parent[pairs[i, 1]] and chosen[root]:
            for k in range(3):
                pairs[left, k] = pairs[i, k]
                where[left, k] = where[i, k]
            left += 1
    return left


@kernel()
def rename_pairs(pairs, count, number):
    """Give the regions of the first ``count`` pairs their new ``number`` (N,); returns whether all have one.

    If a region is dropped, contacts change, since `neighbours` looks across its blocks. Else they are the same regions
    that touch; only at corners, contacts of parts that have become one count, too.
    """
    left = True
    for a in range(len(number)):
        left &= number[a] >= 0
    for i in range(count):
        for k in range(2):
            pairs[i, k] = number[pairs[i, k]]
    return left
