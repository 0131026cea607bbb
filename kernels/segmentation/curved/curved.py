"""Segmentation: are the regions planes, or parts of something curved?

A curved surface breaks into planes that fit it within the noise. Two such neighbours are told from two real
planes by comparing models with equally many parameters: two planes, with six, and one quadric, with six. Where planes
meet in an edge, two planes leave smaller residuals; on a surface that goes on smoothly, one quadric does.
"""

import math

import numpy as np

from ..._jit.kernel import kernel
from ...common.union_find import root_of, unite
from ..model.boxes import boxes
from ..model.moments import angle_between, jump_at
from ..model.pixel_noise import about_plane, sensor_variance
from ..model.planes import deviations
from ..model.quadrics import (
    MARGIN,
    PLANE_TERMS,
    SURE,
    TERMS,
    add_blocks,
    block_buffer,
    eliminate,
    extent,
    group_turns,
    inner_pixels,
    owned_means,
    region_turn,
    sampling_step,
    second_derivatives,
)
from ..model.records import Planes, as_regions, as_view
from .creases import main_bend, two_planes
from .facets import are_facets, mark_round

# Cut in two anywhere, an arc's parts turn within themselves by 1/√12 of their angles, root mean square, and their
# normals are half of both apart: so the two turns make 1/√3 of the angle between them, and none for faces of an edge.
BENT_SHARE = 0.5 / math.sqrt(3.0)
# Blocks across a region that it takes to tell its own shape, and to tell that it goes on beyond its edge.
FEWEST_ACROSS = 3
FEWEST_BESIDE = 2
# Pixels over which a sensor does not bend planes yet, and what, root mean square, normals of planes turn by there.
SMALL, SLIGHTLY = 1024, math.radians(2.0)


@kernel(inline="compiled")
def breadth(window):
    """Blocks along the shorter side."""
    return min(window[1] - window[0], window[3] - window[2])


@kernel()
def find_turns(region, means, region_moments, planes, sigma, rules, box, turned, bending, bent):
    """How far the normals of each region turn within it, see `region_turn`, and whether sensors bend planes less.

    What two planes, side by side, fit better than one quadric is not bent, if they are not bent themselves.

    ``turned`` and ``bending`` (N,) float64, and ``bent`` (N,) bool, are written.
    """
    alpha, slope_variance, waviness_square, stretch, _ = planes
    buffer, products = block_buffer(), np.empty((TERMS + 1, TERMS + 1))
    for a in range(len(turned)):
        turned[a] = bending[a] = 0.0
        bent[a] = False
        m = region_moments[a]
        if breadth(box[a]) < FEWEST_BESIDE or not alpha[a, 0] < math.inf:
            continue
        variance = sensor_variance(m[3] / m[0], sigma) + slope_variance[a] * stretch[a]
        waves = waviness_square[a]
        by, bending[a], gain, rest = region_turn(
            region, means, a, box, m, alpha[a], variance, waves, rules, buffer, products
        )
        if breadth(box[a]) < FEWEST_ACROSS:
            continue
        turned[a], bent[a] = by, gain > rules.bent_variances * rules.tolerance**2 * waves
        if bent[a] and by > math.radians(rules.curved_degrees) ** 2:
            pixels, step, deviation = products[0, 0], sampling_step(box[a]), math.sqrt(variance)
            across = main_bend(second_derivatives(products, extent(m), deviation))
            two, quadrics = two_planes(region, means, a, box, m, alpha[a], deviation, across)
            two, quadrics = two / pixels, quadrics / pixels
            sure = rules.joint_variances * waves / (pixels * step * step)
            better = rest - two
            is_broken = better > max(MARGIN * (gain + better), sure) and two - quadrics < better
            bent[a] = not is_broken


@kernel()
def find_curled(view, regions, box, planes, curved):
    """Mark the small regions of which a quadric takes away more than half of the squared residuals, beyond chance.

    They have few blocks, and many pixels at their rim, which may be biased: the pixels inside tell. The arguments are
    those of `find_curved`, and ``box`` (N, 4) int64 that of `boxes`; ``curved`` says which are marked already.
    """
    inverse_depth, rays, _, noise, rules, _ = view
    region_moments = regions.moments
    alpha, slope_variance, waviness_square, stretch, _ = planes
    buffer, products = block_buffer(), np.empty((TERMS + 1, TERMS + 1))
    # Pixels as if they were blocks, one beside the other, of one region.
    pixels, region = np.empty((4, 1, SMALL), np.float32), np.zeros((1, SMALL), np.int32)
    row = np.array([[0, 1, 0, 0]])
    for a in range(len(curved)):
        m, waves = region_moments[a], waviness_square[a]
        if curved[a] or m[0] >= SMALL or breadth(box[a]) < 1 or not alpha[a, 0] < math.inf:
            continue
        variance = sensor_variance(m[3] / m[0], noise.sigma) + slope_variance[a] * stretch[a]
        row[0, 3] = inner_pixels(regions, a, box, inverse_depth, rays, pixels[:, 0])
        turned, _, gain, rest = region_turn(
            region, pixels, 0, row, m, alpha[a], variance, waves, rules, buffer, products
        )
        is_sure = gain * m[0] > SURE * noise.together * waves
        curved[a] = is_sure and gain > rest and turned > SLIGHTLY**2


@kernel()
def continues(region, means, a, b, region_moments, planes, sigma, box, buffer):
    """Whether one quadric fits two neighbouring regions better than two planes do.

    ``a`` is the smaller one; ``b`` is looked at only as far from ``a`` as ``a`` is wide. ``room`` is that of
    `quadrics.block_buffer`.

    Returns
    -------
    better, bend : float
        How much better the quadric is than two planes, and two planes than one: sums of squares, in variances. -1 and
        0 where no block of one of the two is looked at.
    covered : float
        The share of ``b``'s pixels that are looked at.
    flat, rest : float
        What two planes leave of the mean squared residual, and what one quadric does: in variances of a pixel.
    """
    alpha, slope_variance, _, stretch, _ = planes
    m = region_moments[a]
    window = np.empty(4, np.int64)
    high, wide = box[a, 1] - box[a, 0], box[a, 3] - box[a, 2]
    window[0], window[1] = max(box[a, 0] - high, 0), min(box[a, 1] + high, region.shape[0])
    window[2], window[3] = max(box[a, 2] - wide, 0), min(box[a, 3] + wide, region.shape[1])
    variance = sensor_variance(m[3] / m[0], sigma) + stretch[a] * min(slope_variance[a], slope_variance[b])
    deviation = math.sqrt(variance)
    centre = m[1] / m[0], m[2] / m[0]
    scale = extent(m)
    step = sampling_step(box[a])
    products = np.zeros((3, TERMS + 1, TERMS + 1))
    products_a, products_b, joint = products[0], products[1], products[2]
    pixels_a = add_blocks(region, means, a, box, alpha[a], deviation, window, step, centre, scale, buffer, products_a)
    pixels_b = add_blocks(region, means, b, box, alpha[a], deviation, window, step, centre, scale, buffer, products_b)
    covered = pixels_b * step * step / region_moments[b, 0]
    if pixels_a == 0.0 or pixels_b == 0.0:
        return -1.0, 0.0, covered, math.inf, math.inf
    for i in range(TERMS + 1):
        for j in range(i, TERMS + 1):
            joint[i, j] = products_a[i, j] + products_b[i, j]
    two = eliminate(products_a, 0, PLANE_TERMS) + eliminate(products_b, 0, PLANE_TERMS)
    bend = (eliminate(joint, 0, PLANE_TERMS) - two) * step * step
    quadric, pixels = eliminate(joint, PLANE_TERMS, TERMS), pixels_a + pixels_b
    return (two - quadric) * step * step, bend, covered, two / pixels, quadric / pixels


@kernel(inline="compiled")
def turns_as_an_arc(bending, a, b, angle):
    """Whether two regions turn within themselves by enough of the angle between them: see BENT_SHARE."""
    return math.sqrt(bending[a]) + math.sqrt(bending[b]) > BENT_SHARE * angle


@kernel()
def find_curved(view, regions, planes, contacts, count, is_exact, curved, deviation):
    """Mark the regions that are part of a curved surface.

    Neighbours within ``reach_deviations`` that one quadric fits better than two planes, by ``joint_variances``,
    and that turn within themselves as parts of an arc do, form groups. A group is curved if its normals turn by more
    than ``curved_degrees``, root mean square: if by less, it is the sensor that bends a plane. Of small regions it is
    not: those with such a neighbour are curved if they turn by more than SLIGHTLY. Also curved are those of
    `find_curled`, the groups of `facets.mark_round`, and smaller neighbours as which a curve goes on.

    Parameters
    ----------
    view : View
    regions : Regions
    planes : Planes
    contacts, count
        From `contacts.neighbours`; overwritten.
    is_exact : bool
        Whether the frame's noise is no larger than deviations of surfaces from planes, as in a rendering.
    curved : (N,) bool, written
    deviation : (N,) float64, written
        Standard deviation of a pixel about the plane of each region.
    """
    view, regions, planes = as_view(view), as_regions(regions), Planes(*planes)
    _, _, pyramid, noise, rules, _ = view
    region, region_moments, alpha, sigma = regions.block, regions.moments, planes.alpha, noise.sigma
    deviations(region_moments, planes, sigma, deviation)
    pairs, where, _ = contacts
    # Errors that neighbours share bend a plane by chance: by their variance over squares of 32 pixels, as a multiple of
    # that over 8, and as many more times as there are fewer independent ones.
    significant, sharp = (
        rules.joint_variances * noise.growth[len(noise.growth) - 1] ** 4,
        math.radians(rules.curved_degrees),
    )
    many = len(alpha)
    box = np.empty((many, 4), np.int64)
    boxes(region, box)
    means = owned_means(regions, pyramid)
    turned, bending = np.empty(many), np.empty(many)
    bent, goes_on = np.empty(many, np.bool_), np.zeros(many, np.bool_)
    find_turns(region, means, region_moments, planes, sigma, rules, box, turned, bending, bent)
    curved[:] = False
    parent, facets, buffer = np.arange(many), np.arange(many), block_buffer()
    smooth = 0
    for i in range(count):
        a, b = np.int64(pairs[i, 0]), np.int64(pairs[i, 1])
        if region_moments[a, 0] > region_moments[b, 0]:
            a, b = b, a
        jump = jump_at(alpha, a, b, where[i])
        q = region_moments[a, 3] / region_moments[a, 0]
        variance = about_plane(sensor_variance(q, sigma), planes, a)
        if not jump * jump < rules.reach_deviations * rules.reach_deviations * variance:
            continue
        better, bend, covered, flat, rest = continues(region, means, a, b, region_moments, planes, sigma, box, buffer)
        if are_facets(better, bend, covered, flat, rest, is_exact):
            unite(facets, a, b)
        if not better > -MARGIN * bend:
            continue
        pairs[smooth, 0], pairs[smooth, 1] = a, b
        smooth += 1
        enough = covered > 0.5 and min(breadth(box[a]), breadth(box[b])) >= FEWEST_BESIDE
        enough &= better > max(MARGIN * bend, significant * planes.waviness_square[a])
        if enough and turns_as_an_arc(bending, a, b, angle_between(alpha[a], alpha[b])):
            unite(parent, a, b)
            bent[root_of(parent, a)] = goes_on[a] = goes_on[b] = True
    turn_square, pixels, members = np.empty(many), np.empty(many), np.empty(many, np.int64)
    group_turns(parent, region_moments[:, 0], alpha, turned, turn_square, pixels, members)
    mark_round(facets, region_moments, alpha, turned, sharp, curved)
    for a in range(many):
        root = root_of(parent, a)
        curved[a] |= bent[root] and turn_square[root] > sharp * sharp
        curved[a] |= goes_on[a] and region_moments[a, 0] < SMALL and turned[a] > SLIGHTLY**2
    find_curled(view, regions, box, planes, curved)
    changed = True
    while changed:
        changed = False
        for i in range(smooth):
            if curved[pairs[i, 1]] and not curved[pairs[i, 0]]:
                curved[pairs[i, 0]] = True
                changed = True
