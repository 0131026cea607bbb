"""Segmentation: neighbouring regions that are one plane become one region.

Joining regions a and b raises the sum of squared residuals by Δ = RSS(a ∪ b) - RSS(a) - RSS(b), which the
moments give exactly. Were the noise independent, Δ/σ² would follow χ²(3); real noise is correlated and has a
systematic part, so Δ is measured against the pixels of the smaller region: a bend of up to a few standard deviations is
still one plane. Pairs that are each other's best join in every round, best first in effect, and small regions join the
large one that they fit best; so do pairs that even independent noise would explain.
"""

import numpy as np

from .._jit import kernel
from ..copying import copy
from ..disjoint_sets import root_of
from ..marked import in_words, list_bits
from .moments import difference, rise, solve
from .noise import sensor_variance, variance, waviness

# A region this many times larger than its neighbour takes in several of them at a time.
MUCH_LARGER = 4.0
# Pairs that are processed together, by the processor's vectors.
TOGETHER = 64
# Variances by which joining two halves of one plane raises the sum of squared residuals at most, in 95 cases of 100:
# χ²(3).
CHANCE = 7.8
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
def row_of(a, b, pairs, count, table, size):
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
    touching = np.zeros(in_words(columns), np.uint8)
    words, touches = touching.view(np.uint64), np.empty(SIDES * columns, np.int32)
    size = min(FEW_SLOTS, len(table))
    count = 0
    for row in range(rows):
        own, below, beyond = around[row], around[row + 1], around[row + 2]
        for c in range(columns):
            a = own[c + 2]
            sides = touch(a, own[c + 3], own[c + 4])
            sides |= touch(a, below[c + 2], beyond[c + 2]) << 2
            sides |= touch_at_corner(a, below[c + 3], beyond[c + 4], own[c + 3], below[c + 2]) << 4
            sides |= touch_at_corner(a, below[c + 1], beyond[c], own[c + 1], below[c + 2]) << 6
            touching[c] = sides if a >= 0 else 0
        needed = min(2 * (count + len(touches)), len(table))
        if size < needed:
            while size < needed:
                size = min(4 * size, len(table))
            for i in range(count):
                row_of(pairs[i, 0], pairs[i, 1], pairs, i, table, size)
        for n in range(list_bits(words, touches)):
            k, c = touches[n] & 7, touches[n] >> 3
            here, here_u, here_v = row * width + c + 2, row * down_u + c, row * down_v + c * right_v
            own, b = flat[here], flat[here + steps[k]]
            a, b = min(own, b), max(own, b)
            i = row_of(a, b, pairs, count, table, size)
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
def disagreements(moments, described, contacts, count, rules, tolerance, cost):
    """How far the two regions of each of ``count`` pairs are from being one plane: they are at 1 or less.

    Two things speak against it: the rise Δ of the sum of squared residuals, per pixel of the smaller region,
    and a jump from one plane to the other where the regions touch. A sensor's bias bends a plane, which
    makes Δ and no jump; two parallel planes make a jump before they make much Δ. And a small region may be a crest
    of the waves that a large one has all over: where errors reach far, these are much higher than its own noise.
    Waves are hills and dales beside each other: over large regions they cancel, and do not bend one as if it were two.
    """
    alpha, rss, variances, waviness_square = described
    pairs, where = contacts.pairs, contacts.where
    floor, jump, spread = tolerance * rules.region_floor, tolerance * rules.region_jump, rules.region_spread
    crest = tolerance * rules.region_crest
    waves, wave_pixels = rules.region_waves, rules.wave_pixels
    # Joint moments; smaller, touch, step, rss, variance, the smaller and the larger squared waviness; the result.
    m = np.empty((18, TOGETHER))
    for start in range(0, count, TOGETHER):
        number = min(TOGETHER, count - start)
        for i in range(number):
            a, b = pairs[start + i, 0], pairs[start + i, 1]
            k = start + i
            d_u, d_v, d_1 = difference(alpha, a, b)
            for j in range(10):
                m[j, i] = moments[a, j] + moments[b, j]
            m[10, i] = min(moments[a, 0], moments[b, 0])
            m[11, i] = where[k, 0]
            m[12, i] = d_1 * where[k, 0] + d_u * where[k, 1] + d_v * where[k, 2]
            m[13, i] = rss[a] + rss[b]
            m[14, i] = min(variances[a], variances[b])
            w_a, w_b = waviness_square[a], waviness_square[b]
            m[15, i], m[16, i] = min(w_a, w_b), max(w_a, w_b)
        for i in range(number):
            smaller, step, least = m[10, i], m[12, i] / m[11, i], crest * crest * m[16, i]
            calm = min(m[15, i], waves) + max(m[15, i] - waves, 0.0) * min(wave_pixels / smaller, 1.0)
            jumped = step * step / (max(jump * jump * calm, least) + 8.0 * spread / smaller)
            together, _, _, _ = solve(
                m[0, i], m[1, i], m[2, i], m[3, i], m[4, i], m[5, i], m[6, i], m[7, i], m[8, i], m[9, i]
            )
            risen = max(together - m[13, i], 0.0) / (max(floor * floor * calm, least) * smaller + spread)
            m[17, i] = max(jumped, risen) / m[14, i]
        for i in range(number):
            cost[start + i] = m[17, i]


@kernel()
def describe(moments, chosen, noise, described):
    """Write the plane, residual, variance of a pixel and squared waviness of regions to ``described``, in this order.

    For the regions that are ``chosen``, (N,) bool.
    """
    sigma, x, y = noise.sigma, noise.lateral_variance_x, noise.lateral_variance_y
    lens, growth = noise.lens, noise.growth
    alpha, rss, variances, waviness_square = described
    # Moments; the residual, the plane and the mean inverse depth.
    m, regions = np.empty((15, TOGETHER)), np.empty(TOGETHER, np.int64)
    start = 0
    while start < len(chosen):
        number = 0
        while start < len(chosen) and number < TOGETHER:
            regions[number] = start
            number += chosen[start]
            start += 1
        for i in range(number):
            a = regions[i]
            for j in range(10):
                m[j, i] = moments[a, j]
        for i in range(number):
            error, of_u, of_v, of_1 = solve(
                m[0, i], m[1, i], m[2, i], m[3, i], m[4, i], m[5, i], m[6, i], m[7, i], m[8, i], m[9, i]
            )
            m[10, i], m[11, i], m[12, i], m[13, i] = error, of_u, of_v, of_1
            m[14, i] = m[3, i] / max(m[0, i], 1.0)
        for i in range(number):
            a = regions[i]
            rss[a], alpha[a, 0], alpha[a, 1], alpha[a, 2] = m[10, i], m[11, i], m[12, i], m[13, i]
            sensor = sensor_variance(m[14, i], sigma)
            variances[a] = sensor + x * m[11, i] ** 2 + y * m[12, i] ** 2 if m[10, i] >= 0.0 else 0.0
            waviness_square[a] = waviness(m[0, i], growth) ** 2
    for a in range(len(chosen) if lens.shape[1] > 0 else 0):
        if chosen[a] and rss[a] >= 0.0:
            variances[a] = variance(moments[a], alpha[a], noise)


@kernel()
def find_best(pairs, cost, agreeing, best, least):
    """Write to ``best`` (N,) which of the ``agreeing`` pairs costs a region least, or -1; to ``least`` its cost."""
    best[:] = -1
    least[:] = np.inf
    for i in agreeing:
        for side in range(2):
            a = pairs[i, side]
            better = cost[i] < least[a]
            if cost[i] == least[a]:
                better = scrambled(i) < scrambled(best[a])
            best[a] = i if better else best[a]
            least[a] = cost[i] if better else least[a]


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
    kept = 0
    for i in range(count):
        a, b = root_of(parent, pairs[i, 0]), root_of(parent, pairs[i, 1])
        if a == b:
            continue
        # Pairs that disagree stay: one of the two may still change.
        pairs[kept, 2] = -1
        if changed[a] or changed[b]:
            a, b = min(a, b), max(a, b)
            row = row_of(a, b, pairs, kept, table, size)
            if row < kept:
                for k in range(3):
                    where[row, k] += where[i, k]
                continue
        pairs[kept, 0] = a
        pairs[kept, 1] = b
        for k in range(3):
            where[kept, k] = where[i, k]
        kept += 1
    return kept


@kernel()
def merge(moments, contacts, count, noise, rules, tolerance, parent):
    """Join neighbouring regions until no pair agrees.

    Parameters
    ----------
    moments : (N, 10) float64
        Of each region; the moments of a joined region are written to the row that ``parent`` names.
    contacts, count
        From `neighbours`; they are overwritten.
    noise : Noise
    rules : Rules
        A pair agrees if Δ is at most σ² (floor² · waviness² · n + spread), and the jump at most about
        jump · waviness · σ; n is the smaller region's pixels, the waviness is its own, and σ² the smaller of the two
        variances. Of a squared waviness what is above ``region_waves`` counts up to ``wave_pixels``: times that / n in
        larger regions. Where crest times the larger region's waviness is more, it takes the place of floor · waviness
        and jump · waviness.
    tolerance : float
        Factor on ``region_floor``, ``region_jump`` and ``region_crest``.
    parent : (N,) int64, written
        The region that each one went into.

    Returns
    -------
    int
        Number of pairs left in ``contacts``, of the regions that the others went into.
    """
    regions = moments.shape[0]
    cost = np.empty(count)
    described = np.empty((regions, 3)), np.empty(regions), np.empty(regions), np.empty(regions)
    variances = described[2]
    changed = np.empty(regions, np.bool_)
    best = np.empty(regions, np.int64)
    least = np.empty(regions)
    agreeing = np.empty(count, np.int64)
    pairs = contacts.pairs
    for a in range(regions):
        parent[a] = a
    changed[:] = True
    describe(moments, changed, noise, described)
    while count > 0:
        disagreements(moments, described, contacts, count, rules, tolerance, cost)
        agreed = 0
        for i in range(count):
            agreeing[agreed] = i
            agreed += 1 if cost[i] <= 1.0 else 0
        find_best(pairs, cost, agreeing[:agreed], best, least)
        changed[:] = False
        joined = 0
        for k in range(agreed):
            i = agreeing[k]
            a, b = pairs[i, 0], pairs[i, 1]
            if moments[a, 0] < moments[b, 0]:
                a, b = b, a
            if best[b] != i:
                continue
            # Each other's best; or the best of a region too small to change the larger one much.
            mutual = best[a] == i or moments[a, 0] >= MUCH_LARGER * moments[b, 0]
            if not mutual or changed[b] or parent[a] != a:
                # Or they differ only by chance, as they are now: one or both have been joined with others.
                a = root_of(parent, a)
                if a == b or rise(moments, a, b) > CHANCE * min(variances[a], variances[b]):
                    continue
            parent[b] = a
            for j in range(10):
                moments[a, j] += moments[b, j]
            changed[a] = True
            joined += 1
        if joined == 0:
            break
        describe(moments, changed, noise, described)
        count = contract(contacts, count, parent, changed)
    for a in range(regions):
        parent[a] = root_of(parent, a)
    return count


@kernel()
def keep_pairs_inside(contacts, parent, chosen):
    """Keep the pairs of which both lie in the same chosen region; returns how many.

    ``parent`` (N,) is the region that each lies in, ``chosen`` (N,) bool is that of these regions.
    """
    pairs, where, _ = contacts
    kept = 0
    for i in range(len(pairs)):
        root = parent[pairs[i, 0]]
        if root == parent[pairs[i, 1]] and chosen[root]:
            for k in range(3):
                pairs[kept, k] = pairs[i, k]
                where[kept, k] = where[i, k]
            kept += 1
    return kept


@kernel()
def number_regions(parent, moments, least, number):
    """Number the regions that are left 0, 1, ... in their order, and move their moments there.

    Parameters
    ----------
    parent : (N,) int64
        The region that each one went into.
    moments : (N, 10) float64
    least : float
        Regions of fewer pixels are dropped.
    number : (N,) int64, written
        New number of each old region, or -1.

    Returns
    -------
    int
        Number of regions left.
    """
    count = 0
    for i in range(len(parent)):
        number[i] = -1
        if parent[i] == i and moments[i, 0] >= least:
            number[i] = count
            for k in range(10):
                moments[count, k] = moments[i, k]
            count += 1
    for i in range(len(parent)):
        number[i] = number[parent[i]]
    return count


@kernel()
def rename_pairs(pairs, count, number):
    """Give the regions of the first ``count`` pairs their new ``number`` (N,); returns whether all have one.

    If a region is dropped, contacts change, since `neighbours` looks across its blocks. Else they are the same regions
    that touch; only at corners, contacts of parts that have become one count, too.
    """
    kept = True
    for a in range(len(number)):
        kept &= number[a] >= 0
    for i in range(count):
        for k in range(2):
            pairs[i, k] = number[pairs[i, k]]
    return kept


@kernel()
def renumber(region, number):
    """Give the blocks of regions, (R, C) int32, their new ``number`` (N,); -1, no region, stays."""
    same = True
    for a in range(len(number)):
        same &= number[a] == a
    if same:
        return
    none = np.int32(len(number))
    became = np.empty(len(number) + 1, np.int32)
    became[none] = -1
    for a in range(len(number)):
        became[a] = number[a]
    blocks = region.reshape(-1)
    for i in range(len(blocks)):
        blocks[i] = became[blocks[i] if blocks[i] >= 0 else none]
