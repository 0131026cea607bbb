"""Segmentation: from a frame to its planes and labels."""

import numpy as np

from .._jit.kernel import kernel
from .blocks.pyramid import block_moments
from .components.components import find_parts
from .components.labels import leave_out, settle_strays, write_labels
from .components.occlusion_gaps import join_across_gaps
from .components.rim_outliers import let_go
from .components.runs import PIECES
from .noise.correlation import as_planes_show
from .noise.estimate import nearest_surface
from .refit.interior import fit_inside
from .rounds import find_regions


@kernel()
def read_frame(raw, lowest, highest, scale, offset, is_disparity, rays, inverse_depth, pyramid):
    """Write inverse depths, and moments and planes of squares: see `pyramid.block_moments`.

    Returns the largest inverse depth of a surface: see `estimate.nearest_surface`.
    """
    nearest = block_moments(raw, lowest, highest, scale, offset, is_disparity, rays, inverse_depth, pyramid)
    return nearest_surface(pyramid, np.float64(nearest))


@kernel()
def find_planes(
    inverse_depth, rays, pyramid, noise, is_sensors, rules, least, min_size, reasons, owners, contended, contacts,
    region_moments, runs, loose, found, label, reason,
):  # fmt: skip
    """Find the regions of a frame, and those of their parts that are planes; fit these, and label their pixels.

    Parameters
    ----------
    inverse_depth : (H, W) float32
        0 where there is no measurement.
    rays : Rays
    pyramid : Pyramid
    noise : Noise
    is_sensors : bool
        See `correlation.as_planes_show`.
    rules : Rules
    least, min_size : int
        Pixels that a plane must have while they are found, and in the end.
    reasons : Reasons
    owners, contended, contacts, region_moments
        Room: see `rounds.find_regions`.
    runs : Runs, written
    loose : (H·W,) int32, written
        See `runs.find_runs`.
    found : Found, written
        With room for as many parts and planes as there is for runs.
    label, reason : (H, W) int32 and uint8, written

    Returns
    -------
    needed : int
        Runs that there may be. If there is no room for so many, nothing else is found.
    planes : int
        Their number.
    together : float
        See `correlation.as_planes_show`.
    """
    shares, region_number, curved, deviation = find_regions(
        inverse_depth, rays, pyramid, noise, rules, float(least), owners, contended, contacts, region_moments
    )
    needed = owners.block.size + PIECES * len(shares.region)
    if needed > len(runs.start):
        return needed, 0, 1.0
    planes, parts, loose_count = find_parts(
        inverse_depth, rays, pyramid, owners, shares, region_number, curved, deviation, rules, least, reasons,
        region_moments, runs, loose, found,
    )  # fmt: skip
    number, why, stray = found.number[:parts], found.why[:parts], found.stray[:parts]
    planes = join_across_gaps(
        inverse_depth, rays, 0.5 * rules.region_floor, rules.region_spread, number, runs, found.moments[:planes],
        found.deviation[:planes],
    )  # fmt: skip
    planes = leave_out(planes, min_size, reasons.small, runs, number, why, found.moments, found.deviation)
    moments = found.moments[:planes]
    loose_count = write_labels(runs, why, stray, reasons, inverse_depth, loose, loose_count, label, reason)
    let_go(
        inverse_depth, rays, noise.growth, rules.off, min_size, reasons.unclaimed, shares, runs, moments,
        found.deviation[:planes], loose[loose_count:], label, reason,
    )  # fmt: skip
    fit_inside(
        label, reason, reasons.missing, inverse_depth, rays, pyramid, moments, found.inside[:planes],
        found.alpha[:planes], found.rss[:planes], found.weighted[:planes],
    )  # fmt: skip
    together = as_planes_show(noise.together, is_sensors, pyramid, label, inverse_depth)
    for k in range(planes):
        found.size[k + 1] = moments[k, 0]
    settle_strays(runs, inverse_depth, reasons.unclaimed, min_size, loose, loose_count, label, reason, found.size)
    return needed, planes, together
