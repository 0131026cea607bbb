"""Segmentation: neighbouring regions that are one plane become one region.

Joining regions a and b raises the sum of squared residuals by Δ = RSS(a ∪ b) - RSS(a) - RSS(b), which the
moments give exactly. Were the noise independent, Δ/σ² would follow χ²(3); real noise is correlated and has a
systematic part, so Δ is measured against the pixels of the smaller region: a bend of up to a few standard deviations is
still one plane. Pairs that are each other's best join in every round, best first in effect, and small regions join the
large one that they fit best; so do pairs that even independent noise would explain.
"""

import numpy as np

from ..._jit.kernel import kernel
from ...common.union_find import root_of
from ..model.moments import difference, rise, solve
from ..model.pixel_noise import sensor_variance, variance, waviness
from ..model.records import Contacts, Noise, Rules
from .contacts import contract, scrambled

# A region this many times larger than its neighbour takes in several of them at a time.
MUCH_LARGER = 4.0
# Pairs that are processed together, by the processor's vectors.
TOGETHER = 64
# Variances by which joining two halves of one plane raises the sum of squared residuals at most, in 95 cases of 100:
# χ²(3).
CHANCE = 7.8


@kernel()
def disagreements(moments, described, contacts, count, rules, tolerance, cost):
    """How far the two regions of each of ``count`` pairs are from being one plane: they are at 1 or less.

    Two things speak against it: the rise Δ of the sum of squared residuals, per pixel of the smaller region,
    and a jump from one plane to the other where the regions touch. A sensor's bias bends a plane, which
    makes Δ and no jump; two parallel planes make a jump before they make much Δ.
    """
    alpha, rss, variances, waviness_square = described
    pairs, where = contacts.pairs, contacts.where
    share = tolerance * rules.tolerance
    floor, jump, spread = share * rules.bend_deviations, share * rules.jump_deviations, rules.joint_variances
    crest, waves = share * rules.fit_deviations, rules.wave_variances
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
            m[15, i] = min(waviness_square[a], waviness_square[b], waves)
            m[16, i] = max(waviness_square[a], waviness_square[b])
        for i in range(number):
            smaller, step, least = m[10, i], m[12, i] / m[11, i], crest * crest * m[16, i]
            jumped = step * step / (max(jump * jump * m[15, i], least) + 8.0 * spread / smaller)
            together, _, _, _ = solve(
                m[0, i], m[1, i], m[2, i], m[3, i], m[4, i], m[5, i], m[6, i], m[7, i], m[8, i], m[9, i]
            )
            risen = max(together - m[13, i], 0.0) / (max(floor * floor * m[15, i], least) * smaller + spread)
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
            error, slope_u, slope_v, offset = solve(
                m[0, i], m[1, i], m[2, i], m[3, i], m[4, i], m[5, i], m[6, i], m[7, i], m[8, i], m[9, i]
            )
            m[10, i], m[11, i], m[12, i], m[13, i] = error, slope_u, slope_v, offset
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
        A pair agrees if Δ is at most σ² (floor² · w² · n + spread), and the jump at most about ``jump_deviations`` ·
        w · σ; n is the smaller region's pixels, w² the smaller of the two squared wavinesses, up to ``wave_variances``,
        floor ``bend_deviations``, spread ``joint_variances``, and σ² the smaller of the two variances. Where
        ``fit_deviations`` times the larger region's waviness is more, it takes the place of w and both deviations: a
        small region may be a crest of the waves that a large one has all over.
    tolerance : float
        Factor on all three deviations.
    parent : (N,) int64, written
        The region that each one went into.

    Returns
    -------
    int
        Number of pairs left in ``contacts``, of the regions that the others went into.
    """
    contacts, noise, rules = Contacts(*contacts), Noise(*noise), Rules(*rules)
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
def renumber_regions(region, parent, moments, least, number):
    """Number the regions that are left, in the blocks, too; returns how many."""
    count = number_regions(parent, moments, least, number)
    renumber(region, number)
    return count


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
