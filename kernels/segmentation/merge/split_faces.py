"""Segmentation: regions that were joined and are several planes.

Some are too rough to be one plane. Others are faces that meet in an edge: the faces of something small differ by so
little that a sensor might bend a plane as much, but a sensor makes no edges. Of what is bent, by a sensor or because it
is curved, one quadric fits better than planes do; faces fit better as they are.
"""

import math

import numpy as np

from ..._jit.kernel import kernel
from ...common.arrays import copy
from ..model.boxes import boxes
from ..model.moments import angle_between, fit
from ..model.pixel_noise import variance, waviness
from ..model.quadrics import MARGIN, TERMS, add_blocks, group_turns, owned_means, residuals, sampling_step, turn
from ..model.records import Noise, Regions, Rules, as_regions, as_view

# Share of the tolerances with which parts are joined anew.
STRICT = 0.5
# Pixels of a part that is a face, and the least share of the region: along edges there are parts of both faces.
FACE, FACE_SHARE = 100, 0.025
# Root mean square angle by which the normals of faces turn, and those of the quadric that fits them best.
TURNED = math.radians(4.0)
# Variances that three more terms must gain, times the pixels that share an error: of χ²(3) one in fifty is 10.
SURE = 10.0
# A face that is ajar, as a door is to its wall, turns the normals of both together by less. How far it is turned
# against the rest, the pixels of either, since rims are tilted, too, and what a quadric leaves at least of the bend of
# the two: 1/16 if they are of one size, more than AJAR_MARGIN if one has less than a quarter of both.
AJAR, AJAR_FACE, AJAR_MARGIN = math.radians(6.0), 2048, 0.25


@kernel()
def find_doubtful(moments, first_moments, parent, noise, rules, rough, several, ajar):
    """Mark the joined regions that are several planes, and those that may be.

    Parameters
    ----------
    moments, first_moments : (N, 10) float64
        Of the regions that are left, and of all before they were joined.
    parent : (N,) int64
        The region that each one went into.
    noise : Noise
    rules : Rules
    rough : (N,) bool, written
        Those with a residual above ``fit_deviations``.
    several : (N,) bool, written
        The others with two or more parts that may be faces, turned against each other, and a residual larger than
        that of a plane.
    ajar : (N,) bool, written
        Those with a part that is turned against the rest.

    Returns
    -------
    bool
        Whether there are any.
    """
    noise, rules = Noise(*noise), Rules(*rules)
    alpha = np.empty(3)
    faces = np.zeros(len(parent), np.int64)
    for a in range(len(parent)):
        faces[parent[a]] += first_moments[a, 0] >= FACE
    found = uneven = False
    for a in range(len(parent)):
        rough[a] = several[a] = False
        rss = fit(moments[a], alpha) if parent[a] == a else -1.0
        if rss >= 0.0:
            n = moments[a, 0]
            allowed = n * variance(moments[a], alpha, noise) * waviness(n, noise.growth) ** 2
            rough[a] = rss > rules.fit_deviations**2 * allowed
            several[a] = faces[a] > 1 and not rough[a] and rss > allowed
            found |= rough[a]
            uneven |= several[a]
    ajar[:] = False
    if not uneven:
        return found
    alphas, weight = np.full((len(parent), 3), np.inf), np.empty(len(parent))
    for a in range(len(parent)):
        weight[a] = first_moments[a, 0] ** 2  # noise turns normals by 1/n
        if several[parent[a]] and first_moments[a, 0] >= FACE and fit(first_moments[a], alpha) >= 0.0:
            copy(alpha, alphas[a])
    turn_square = np.empty(len(parent))
    group_turns(parent, weight, alphas, np.zeros(len(parent)), turn_square)
    for a in range(len(parent)):
        root = parent[a]
        if several[root] and not ajar[root] and first_moments[a, 0] >= AJAR_FACE and alphas[a, 0] < math.inf:
            ajar[root] = is_ajar(first_moments[a], alphas[a], moments[root], noise, rules)
    for a in range(len(parent)):
        several[a] &= turn_square[a] > TURNED**2 or ajar[a]
        found |= several[a]
    return found


@kernel()
def is_ajar(part, alpha, whole, noise, rules):
    """Whether a part, with plane ``alpha``, is turned against the rest of a region, and rough about its plane."""
    rest, rest_alpha = whole - part, np.empty(3)
    if rest[0] < AJAR_FACE or fit(rest, rest_alpha) < 0.0:
        return False
    if angle_between(alpha, rest_alpha) < AJAR:
        return False
    a, b, c = alpha[0] - rest_alpha[0], alpha[1] - rest_alpha[1], alpha[2] - rest_alpha[2]
    # What the rest's plane adds to the squared residuals of the part.
    more = (
        a * (a * part[4] + 2.0 * (b * part[5] + c * part[1])) + b * (b * part[7] + 2.0 * c * part[2]) + c * c * part[0]
    )
    allowed = part[0] * variance(part, alpha, noise) * waviness(whole[0], noise.growth) ** 2
    return more > rules.fit_deviations**2 * allowed


@kernel()
def label_blocks(region, numbers, parent, chosen, labels):
    """Write ``numbers`` of the blocks' regions to ``labels``, (R, C) int32; -1 outside what went into chosen ones."""
    for row in range(region.shape[0]):
        for column in range(region.shape[1]):
            a = region[row, column]
            labels[row, column] = numbers[a] if a >= 0 and chosen[parent[a]] else -1


@kernel()
def keep_turned(view, regions, ajar, chosen):
    """Of the chosen regions, keep those chosen whose normals turn: those of the quadric that fits them best.

    And those that are ajar; ``ajar`` (N,) bool says afterwards which are chosen for that alone.

    Parameters
    ----------
    view : View
    regions : Regions
        Those before they were joined; ``number`` is the region that each one went into, and ``moments`` are those of
        the joined regions.
    chosen : (N,) bool, changed
    """
    view, regions = as_view(view), as_regions(regions)
    pyramid, noise, rules = view.pyramid, view.noise, view.rules
    moments, parent = regions.moments, regions.number
    labels = np.empty_like(regions.block)
    label_blocks(regions.block, parent, parent, chosen, labels)
    means = owned_means(Regions(labels, moments, parent, regions.owners, regions.shares), pyramid)
    alpha, box = np.empty(3), np.empty((len(chosen), 4), np.int64)
    boxes(labels, box)
    for a in range(len(chosen)):
        if chosen[a]:
            m = moments[a]
            fit(m, alpha)
            step, products = sampling_step(box[a]), np.zeros((TERMS + 1, TERMS + 1))
            add_blocks(labels, means, a, box[a], step, m, alpha, products)
            flat, rest = residuals(products)
            sure = rules.joint_variances * waviness(m[0], noise.growth) ** 2 * variance(m, alpha, noise)
            is_turned = (flat - rest) * step * step > sure and turn(products, m, alpha) > TURNED**2
            ajar[a] &= not is_turned
            chosen[a] = is_turned or ajar[a]


@kernel()
def planes_fit_better(products):
    """By how much planes fit parts better than one quadric does, and than one plane: differences of sums of squares.

    ``products`` (K, 7, 7) are sums over the blocks of each part.
    """
    joint = np.zeros((TERMS + 1, TERMS + 1))
    planes = 0.0
    for k in range(len(products)):
        joint += products[k]
        planes += residuals(products[k].copy())[0]
    flat, rest = residuals(joint)
    return rest - planes, flat - planes


@kernel()
def keep_faces(view, regions, first_moments, again, ajar, chosen):
    """Of the chosen regions, keep those chosen whose parts are faces: planes that meet in edges.

    Every two of them, and all together, are fitted better by planes than by one quadric.

    Parameters
    ----------
    view, regions, ajar
        As in `keep_turned`.
    first_moments : (N, 10) float64
        Of the parts.
    again : (N,) int64
        The part that each of the regions before went into.
    chosen : (N,) bool, changed
    """
    view, regions = as_view(view), as_regions(regions)
    pyramid, noise = view.pyramid, view.noise
    moments, parent = regions.moments, regions.number
    labels = np.empty_like(regions.block)
    label_blocks(regions.block, again, parent, chosen, labels)
    means = owned_means(Regions(labels, moments, again, regions.owners, regions.shares), pyramid)
    alpha = np.empty(3)
    box, window = np.empty((len(chosen), 4), np.int64), np.empty(4, np.int64)
    boxes(labels, box)
    for root in range(len(chosen)):
        if not chosen[root]:
            continue
        least = max(AJAR_FACE if ajar[root] else FACE, FACE_SHARE * moments[root, 0])
        margin = AJAR_MARGIN if ajar[root] else MARGIN
        faces = [a for a in range(len(parent)) if parent[a] == root and again[a] == a and first_moments[a, 0] >= least]
        window[0], window[1], window[2], window[3] = labels.shape[0], 0, labels.shape[1], 0
        for a in faces:
            window[0], window[1] = min(window[0], box[a, 0]), max(window[1], box[a, 1])
            window[2], window[3] = min(window[2], box[a, 2]), max(window[3], box[a, 3])
        m = moments[root]
        fit(m, alpha)
        step = sampling_step(window)
        products = np.zeros((len(faces), TERMS + 1, TERMS + 1))
        for k, a in enumerate(faces):
            add_blocks(labels, means, a, window, step, m, alpha, products[k])
        better, bend = planes_fit_better(products)
        waves = waviness(m[0], noise.growth) ** 2
        sure = SURE * noise.together * waves * variance(m, alpha, noise) / (step * step)
        are_faces = better > max(margin * bend, sure * (len(faces) - 1))
        for k in range(len(faces)):
            for i in range(k if len(faces) > 2 else 0):
                better, bend = planes_fit_better(products[i : k + 1 : k - i])
                are_faces &= better > MARGIN * bend or bend < sure
        chosen[root] = are_faces


@kernel()
def take_parts(parent, again, chosen, moments, first_moments):
    """Let the chosen regions be their parts again.

    Parameters
    ----------
    parent, again : (N,) int64
        The region, changed, and the part that each of the regions before went into.
    chosen : (N,) bool
    moments, first_moments : (N, 10) float64
        Of the regions, changed, and of the parts.
    """
    for a in range(len(parent)):
        if chosen[parent[a]]:
            copy(first_moments[a], moments[a])
        else:
            again[a] = parent[a]
    copy(again, parent)
