"""Segmentation: are the regions planes, or parts of something curved?

A curved surface breaks into planes that fit it within the noise. Two such neighbours are told from two real
planes by comparing models with equally many parameters: two planes, with six, and one quadric, with six. Where planes
meet in an edge, two planes leave smaller residuals; on a surface that goes on smoothly, one quadric does.

A narrow part of a column does not show that it bends, and the mesh of a ball in a rendering does not bend at all. Three
or more of them are something round if the quadric through neighbours fits as well as their planes do. The faces of a
polyhedron are planes: a quadric leaves more of them than noise explains.
"""

import math

import numpy as np

from ..._jit.kernel import kernel
from ...common.union_find import root_of, unite
from ..model.boxes import boxes
from ..model.moments import angle_between, jump_at
from ..model.pixel_noise import sensor_variance
from ..model.quadrics import MARGIN, TERMS, add_blocks, group_turns, owned_means, residuals, sampling_step, turn
from ..model.records import Planes, as_regions, as_view
from .small_regions import SMALL, turn_inside

# Cut in two anywhere, an arc's parts turn within themselves by 1/√12 of their angles, root mean square, and their
# normals are half of both apart: so the two turns make 1/√3 of the angle between them, and none for faces of an edge.
BENT_SHARE = 0.5 / math.sqrt(3.0)
# Share of a region that a neighbour is compared with.
COVERED = 0.4
# Variances of a pixel by which a quadric may miss flat facets of a rendering, and more by so many times what planes do.
MISSED, MISSED_TIMES = 0.5, 4.0
# Blocks across a region that it takes to tell its own shape, and to tell that it goes on beyond its edge.
FEWEST_ACROSS = 3
FEWEST_BESIDE = 2
# By which, root mean square, normals of small planes turn.
SLIGHTLY = math.radians(2.0)


@kernel()
def fit_two(region, means, a, b, m, alpha, box, step, products):
    """Fit one plane, two planes and one quadric to two neighbouring regions.

    Parameters
    ----------
    region, means : (R, C) int32 and (R, C, 4) float32
        Regions of blocks, and the number and mean of their pixels.
    a, b : int
        The smaller region, and its neighbour, which is looked at only as far from ``a`` as ``a`` is wide.
    m, alpha : (10,) and (3,) float64
        Moments and plane of ``a``.
    box : (N, 4) int64
        Rows and columns of each region's blocks.
    step : int
        Every ``step``-th row and column counts.
    products : (7, 7) float64
        Sums of ``a``'s blocks, as `add_blocks` makes them.

    Returns
    -------
    one, two, quadric : float
        Sums of squared residuals that each leaves.
    pixels : float
        Those of ``b`` that count.
    """
    high, wide = box[a, 1] - box[a, 0], box[a, 3] - box[a, 2]
    window = np.empty(4, np.int64)
    window[0], window[1] = max(box[a, 0] - high, box[b, 0]), min(box[a, 1] + high, box[b, 1])
    window[2], window[3] = max(box[a, 2] - wide, box[b, 2]), min(box[a, 3] + wide, box[b, 3])
    beside = np.zeros((TERMS + 1, TERMS + 1))
    add_blocks(region, means, b, window, step, m, alpha, beside)
    pixels = beside[0, 0]
    one, quadric = residuals(products + beside)
    two = residuals(products.copy())[0] + residuals(beside)[0]
    return one, two, quadric, pixels


@kernel()
def find_curved(view, regions, planes, contacts, count, is_exact, curved, deviation):
    """Mark the regions that are part of a curved surface.

    Neighbours within ``reach_deviations`` that one quadric fits better than two planes, by ``joint_variances``,
    and that turn within themselves as parts of an arc do, form groups. A group is curved if its normals turn by more
    than ``curved_degrees``, root mean square: if by less, it is the sensor that bends a plane. Of small regions it is
    not: those with such a neighbour, or whose pixels show it, are curved if they turn by more than SLIGHTLY.

    Also curved are groups of facets, if they turn as much and none is half of its group. Smaller neighbours as which a
    curve goes on are part of it.

    Parameters
    ----------
    view : View
    regions : Regions
    planes : Planes
    contacts, count
        Regions that touch, and how many pairs of them; overwritten.
    is_exact : bool
        Whether the frame's noise is no larger than deviations of surfaces from planes, as in a rendering.
    curved : (N,) bool, written
    deviation : (N,) float64, written
        Standard deviation of a pixel about the plane of each region.
    """
    view, regions, planes = as_view(view), as_regions(regions), Planes(*planes)
    region, moments, alpha, waves = regions.block, regions.moments, planes.alpha, planes.waviness_square
    noise, rules, (pairs, where, _) = view.noise, view.rules, contacts
    sharp = math.radians(rules.curved_degrees) ** 2
    # Errors that neighbours share bend a plane by chance: by their variance over squares of 32 pixels, as a multiple of
    # that over 8, and as many more times as there are fewer independent ones.
    significant = rules.joint_variances * noise.growth[len(noise.growth) - 1] ** 4
    many = len(alpha)
    box = np.empty((many, 4), np.int64)
    boxes(region, box)
    means = owned_means(regions, view.pyramid)
    products = np.zeros((many, TERMS + 1, TERMS + 1))
    # Of each region: its breadth in blocks, the variance of a pixel without the waves, and mean squared angles by which
    # its normals turn, first also where noise explains it.
    breadth, step = np.empty(many, np.int64), np.empty(many, np.int64)
    variance, bending, turned = np.empty(many), np.zeros(many), np.zeros(many)
    bent, goes_on = np.zeros(many, np.bool_), np.zeros(many, np.bool_)
    for a in range(many):
        m = moments[a]
        sensor = sensor_variance(m[3] / max(m[0], 1.0), noise.sigma)
        variance[a] = sensor + planes.slope_variance[a] * planes.stretch[a]
        deviation[a] = math.sqrt(variance[a] * waves[a])
        breadth[a] = min(box[a, 1] - box[a, 0], box[a, 3] - box[a, 2])
        step[a] = sampling_step(box[a])
        if not alpha[a, 0] < math.inf:
            continue
        add_blocks(region, means, a, box[a], step[a], m, alpha[a], products[a])
        if breadth[a] < FEWEST_BESIDE:
            continue
        fitted = products[a].copy()
        flat, rest = residuals(fitted)
        bending[a] = turn(fitted, m, alpha[a])
        gain, pixels = (flat - rest) / variance[a], products[a, 0, 0]
        if breadth[a] >= FEWEST_ACROSS:
            if gain * step[a] ** 2 > rules.joint_variances * waves[a]:
                turned[a] = bending[a]
            bent[a] = gain > pixels * rules.bent_variances * rules.tolerance**2 * waves[a]
    parent, facets = np.arange(many), np.arange(many)
    smooth = 0
    for i in range(count):
        a, b = np.int64(pairs[i, 0]), np.int64(pairs[i, 1])
        if moments[a, 0] > moments[b, 0]:
            a, b = b, a
        jump = jump_at(alpha, a, b, where[i])
        if not jump * jump < (rules.reach_deviations * deviation[a]) ** 2:
            continue
        one, two, quadric, pixels = fit_two(region, means, a, b, moments[a], alpha[a], box, step[a], products[a])
        if not (products[a, 0, 0] > 0.0 and pixels > 0.0):
            continue
        better, bend, looked_at = two - quadric, one - two, pixels * step[a] ** 2 > COVERED * moments[b, 0]
        # In a rendering planes always win: there the quadric leaves so little that noise would hide it.
        expected = min(variance[a], variance[b])  # a steep plane's is the larger one
        hidden = MISSED * (products[a, 0, 0] + pixels) * expected + MISSED_TIMES * two
        if looked_at and (better > -0.5 * MARGIN * bend or (is_exact and quadric < hidden)):
            unite(facets, a, b)
        if not better > -MARGIN * bend:
            continue
        pairs[smooth, 0], pairs[smooth, 1] = a, b
        smooth += 1
        turns = math.sqrt(bending[a]) + math.sqrt(bending[b])
        if (
            looked_at
            and min(breadth[a], breadth[b]) >= FEWEST_BESIDE
            and better > max(MARGIN * bend, significant * waves[a] * expected / step[a] ** 2)
            and turns > BENT_SHARE * angle_between(alpha[a], alpha[b])
        ):
            unite(parent, a, b)
            bent[root_of(parent, a)] = goes_on[a] = goes_on[b] = True
    turn_square, facets_turn_square = np.empty(many), np.empty(many)
    group_turns(parent, moments[:, 0], alpha, turned, turn_square)
    group_turns(facets, moments[:, 0], alpha, turned, facets_turn_square)
    pixels_of, largest = np.zeros(many), np.zeros(many)
    for a in range(many):
        root = root_of(facets, a)
        pixels_of[root] += moments[a, 0]
        largest[root] = max(largest[root], moments[a, 0])
    for a in range(many):
        root = root_of(parent, a)
        curved[a] = bent[root] and turn_square[root] > sharp
        if moments[a, 0] < SMALL and not curved[a] and breadth[a] > 0 and alpha[a, 0] < math.inf:
            inside = turn_inside(view, regions, a, box[a], moments[a], alpha[a], deviation[a] ** 2)
            curved[a] = max(inside, turned[a] * goes_on[a]) > SLIGHTLY**2
        root = root_of(facets, a)
        curved[a] |= largest[root] < 0.5 * pixels_of[root] and facets_turn_square[root] > sharp
    changed = True
    while changed:
        changed = False
        for i in range(smooth):
            if curved[pairs[i, 1]] and not curved[pairs[i, 0]]:
                curved[pairs[i, 0]] = changed = True
