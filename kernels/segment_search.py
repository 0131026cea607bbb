"""Segmentation: from the blocks of a frame to its planes."""

from ._jit import kernel
from .segment_gaps import join_across_gaps
from .segment_parts import find_parts
from .segment_regions import find_regions
from .segment_runs import PIECES


@kernel()
def find_planes(
    inverse_depth, rays, pyramid, noise, rules, least, reasons, owners, contended, contacts, sums, runs, loose, found
):  # fmt: skip
    """Find the regions of a frame, and those of their parts that are planes, and label the runs of their pixels.

    Parameters
    ----------
    inverse_depth : (H, W) float32
        0 where there is no measurement.
    rays : Rays
    pyramid : Pyramid
    noise : Noise
    rules : Rules
    least : int
        Pixels that a plane must have.
    reasons : tuple of uint8
        See `segment_parts.judge_parts`.
    owners, contended, contacts, sums
        Room: see `segment_regions.find_regions`.
    runs : Runs, written
    loose : (H·W,) int32, written
        See `segment_runs.find_runs`.
    found : Found, written
        With room for as many parts and planes as there is for runs.

    Returns
    -------
    needed : int
        Runs that there may be. If there is no room for so many, nothing else is found.
    planes, parts, loose_count : int
        Their numbers, and that of the loose pixels.
    """
    shares, region_number, curved, deviation = find_regions(
        inverse_depth, rays, pyramid, noise, rules, float(least), owners, contended, contacts, sums
    )
    needed = owners.block.size + PIECES * len(shares.region)
    if needed > len(runs.start):
        return needed, 0, 0, 0
    planes, parts, loose_count = find_parts(
        inverse_depth, rays, pyramid, owners, shares, region_number, curved, deviation, rules, least, reasons, sums,
        runs, loose, found,
    )  # fmt: skip
    left = join_across_gaps(
        inverse_depth, rays, 0.5 * rules.region_floor, rules.region_spread, found.number[:parts], runs,
        found.moments[:planes], found.deviation[:planes],
    )  # fmt: skip
    return needed, left, parts, loose_count
