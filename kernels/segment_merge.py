"""Segmentation, second stage: neighbouring regions that are one plane become one region.

Joining regions a and b raises the sum of squared residuals by Δ = RSS(a ∪ b) - RSS(a) - RSS(b), which the
moments give exactly. Were the noise independent, Δ/σ² would follow χ²(3); real noise is correlated and has a
systematic part, so Δ is measured against the pixels of the smaller region: a bend of so many standard
deviations is still one plane. Pairs that are each other's best join in every round, best first in effect,
and small regions join the large one that they fit best.
"""

import numpy as np

from ._jit import kernel
from .segment_blocks import fit, joint_residual, residual, variance, waviness

# A region this many times larger than its neighbour takes in several such at a time.
MUCH_LARGER = 4.0


@kernel()
def neighbours(region, centre_u, centre_v, pairs, contact):
    """Write the pairs of different regions that blocks side by side or corner to corner have.

    Parameters
    ----------
    region : (R, C) int64
        -1 is none.
    centre_u, centre_v : (R, C) float64
        tanθx, tanθy of the centre of each block.
    pairs : (K, 2) int64, written
        Smaller first; with repetitions. At most 4·R·C.
    contact : (K, 3) float64, written
        1 and the (u, v) in the middle between the two blocks: what sums to the place where regions touch.

    Returns
    -------
    int
        Number of pairs.
    """
    rows, columns = region.shape
    count = 0
    for row in range(rows):
        for column in range(columns):
            a = region[row, column]
            if a < 0:
                continue
            for k in range(4):
                down = int(k > 0)
                right = int(k == 0) + int(k == 2) - int(k == 3)
                r, c = row + down, column + right
                if r >= rows or c < 0 or c >= columns:
                    continue
                if region[r, c] < 0:  # a gap of one block: look across it
                    r, c = r + down, c + right
                    if r >= rows or c < 0 or c >= columns:
                        continue
                b = region[r, c]
                if b >= 0 and b != a:
                    pairs[count, 0] = min(a, b)
                    pairs[count, 1] = max(a, b)
                    contact[count, 0] = 1.0
                    contact[count, 1] = 0.5 * (centre_u[row, column] + centre_u[r, c])
                    contact[count, 2] = 0.5 * (centre_v[row, column] + centre_v[r, c])
                    count += 1
    return count


@kernel()
def scrambled(x):
    """A fixed pseudo-random order of the integers, so that ties do not make long chains."""
    y = np.uint64(x) * np.uint64(0x9E3779B97F4A7C15)
    y ^= y >> np.uint64(29)
    y *= np.uint64(0xBF58476D1CE4E5B9)
    return y ^ (y >> np.uint64(32))


@kernel()
def distinct(pairs, contact, cost, count, regions):
    """Sort pairs by their first region and add up the contacts of equal ones; returns how many remain."""
    start = np.zeros(regions + 1, np.int64)
    for i in range(count):
        start[pairs[i, 0] + 1] += 1
    for a in range(regions):
        start[a + 1] += start[a]
    order = np.empty(count, np.int64)
    for i in range(count):
        order[start[pairs[i, 0]]] = i
        start[pairs[i, 0]] += 1
    old_pairs, old_contact, old_cost = pairs[:count].copy(), contact[:count].copy(), cost[:count].copy()
    seen = np.full(regions, -1, np.int64)  # where a pair with this second region was written last
    kept = 0
    for j in range(count):
        i = order[j]
        a, b = old_pairs[i, 0], old_pairs[i, 1]
        k = seen[b]
        if k >= 0 and pairs[k, 0] == a:
            contact[k] += old_contact[i]
            continue
        seen[b] = kept
        pairs[kept] = old_pairs[i]
        contact[kept] = old_contact[i]
        cost[kept] = old_cost[i]
        kept += 1
    return kept


@kernel()
def disagreement(m_a, m_b, rss, alpha_a, alpha_b, contact, noise, waves, floor, jump, spread):
    """How far two regions are from being one plane: they are at 1 or less.

    Two things speak against it: the rise Δ of the sum of squared residuals, per pixel of the smaller region,
    and a jump from one plane to the other where the regions touch. A sensor's bias bends a plane, which
    makes Δ and no jump; two parallel planes make a jump before they make much Δ.
    """
    smaller = min(m_a[0], m_b[0])
    rise = max(joint_residual(m_a, m_b) - rss, 0.0)
    bend = rise / (noise * (floor * floor * waves * smaller + spread))
    step = (
        (alpha_a[0] - alpha_b[0]) * contact[1] / contact[0]
        + (alpha_a[1] - alpha_b[1]) * contact[2] / contact[0]
        + (alpha_a[2] - alpha_b[2])
    )
    return max(bend, step * step / (noise * (jump * jump * waves + 8.0 * spread / smaller)))


@kernel()
def merge(
    moments, pairs, contact, count, sigma, lateral_x, lateral_y, growth, floor, jump, spread, parent
):  # fmt: skip
    """Join neighbouring regions until no pair agrees.

    Parameters
    ----------
    moments : (N, 10) float64
        Of each region; the moments of a joined region are written to the row that ``parent`` names.
    pairs, contact, count
        Of `neighbours`; they are overwritten.
    sigma, lateral_x, lateral_y
        Noise: see `segment_blocks.variance`.
    growth : (S,) float64
        See `segment_blocks.waviness`.
    floor, jump, spread : float
        A pair agrees if Δ is at most σ² (floor² · waviness² · n + spread), and the jump at most about
        ``jump`` · waviness · σ; n is the smaller region's pixels and σ² the smaller of the two variances.
    parent : (N,) int64, written
        The region that each one went into.
    """
    regions = moments.shape[0]
    cost = np.full(count, -1.0)
    count = distinct(pairs, contact, cost, count, regions)
    rss = np.empty(regions)
    noise = np.empty(regions)
    waves = np.empty(regions)
    alpha = np.empty((regions, 3))
    changed = np.ones(regions, np.bool_)
    best = np.empty(regions, np.int64)
    for a in range(regions):
        parent[a] = a
        rss[a] = residual(moments[a])
        noise[a] = 0.0
        waves[a] = waviness(moments[a, 0], growth) ** 2
        if fit(moments[a], alpha[a]):
            noise[a] = variance(moments[a], alpha[a], sigma, lateral_x, lateral_y)
    while count > 0:
        best[:] = -1
        for i in range(count):
            a, b = pairs[i, 0], pairs[i, 1]
            if changed[a] or changed[b] or cost[i] < 0.0:
                cost[i] = disagreement(
                    moments[a], moments[b], rss[a] + rss[b], alpha[a], alpha[b], contact[i],
                    min(noise[a], noise[b]), min(waves[a], waves[b]), floor, jump, spread,
                )  # fmt: skip
            if not cost[i] <= 1.0:
                continue
            for c in (a, b):
                j = best[c]
                if j < 0 or cost[i] < cost[j] or (cost[i] == cost[j] and scrambled(i) < scrambled(j)):
                    best[c] = i
        changed[:] = False
        joined = 0
        for i in range(count):
            a, b = pairs[i, 0], pairs[i, 1]
            if moments[a, 0] < moments[b, 0]:
                a, b = b, a
            # Each other's best; or the best of a region too small to change the larger one much.
            chosen = best[b] == i and (best[a] == i or moments[a, 0] >= MUCH_LARGER * moments[b, 0])
            if not chosen or changed[b] or parent[a] != a:
                continue
            parent[b] = a
            for k in range(10):
                moments[a, k] += moments[b, k]
            changed[a] = True
            joined += 1
        if joined == 0:
            break
        for a in range(regions):
            if changed[a]:
                rss[a] = residual(moments[a])
                waves[a] = waviness(moments[a, 0], growth) ** 2
                fit(moments[a], alpha[a])
                noise[a] = variance(moments[a], alpha[a], sigma, lateral_x, lateral_y)
        kept = 0
        for i in range(count):
            a, b = parent[pairs[i, 0]], parent[pairs[i, 1]]
            # Pairs that disagree stay: one of the two may change yet.
            if a != b:
                pairs[kept, 0] = min(a, b)
                pairs[kept, 1] = max(a, b)
                contact[kept] = contact[i]
                cost[kept] = cost[i]
                kept += 1
        count = distinct(pairs, contact, cost, kept, regions)
    for a in range(regions):
        root = a
        while parent[root] != root:
            root = parent[root]
        parent[a] = root


@kernel()
def keep_pairs_inside(pairs, contact, count, parent, chosen):
    """Keep the pairs whose two lie in one chosen region; returns how many.

    ``parent`` (N,) is the region of each, ``chosen`` (N,) bool is read at the regions.
    """
    kept = 0
    for i in range(count):
        root = parent[pairs[i, 0]]
        if root == parent[pairs[i, 1]] and chosen[root]:
            pairs[kept] = pairs[i]
            contact[kept] = contact[i]
            kept += 1
    return kept


@kernel()
def find_rough(moments, parent, sigma, lateral_x, lateral_y, growth, rough, chosen):
    """Mark the regions whose residual is above ``rough`` standard deviations: they are several planes.

    ``chosen`` is (N,) bool, written; returns whether there are any.
    """
    alpha = np.empty(3)
    found = False
    for a in range(len(parent)):
        chosen[a] = False
        if parent[a] == a and fit(moments[a], alpha):
            noise = variance(moments[a], alpha, sigma, lateral_x, lateral_y)
            noise *= waviness(moments[a, 0], growth) ** 2
            chosen[a] = residual(moments[a]) > rough * rough * noise * moments[a, 0]
            found |= chosen[a]
    return found


@kernel()
def number_regions(parent, moments, least, number, region_moments):
    """Number the regions that are left 0, 1, ... in their order.

    Parameters
    ----------
    parent : (N,) int64
        The region that each one went into.
    moments : (N, 10) float64
    least : float
        Regions of fewer pixels are given up.
    number : (N,) int64, written
        New number of each old region, or -1.
    region_moments : (N, 10) float64, written

    Returns
    -------
    int
        How many there are.
    """
    count = 0
    for i in range(len(parent)):
        number[i] = -1
        if parent[i] == i and moments[i, 0] >= least:
            number[i] = count
            region_moments[count] = moments[i]
            count += 1
    for i in range(len(parent)):
        number[i] = number[parent[i]]
    return count
