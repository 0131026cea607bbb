"""Segment a depth frame into planes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.arrays import Floats, aligned
from rgbd_planes._core.checks import check_whole, number
from rgbd_planes._core.compile_notice import announced
from rgbd_planes._core.status import Reason
from rgbd_planes._core.user_warnings import warn_caller
from rgbd_planes.camera.camera import Camera, check_camera
from rgbd_planes.camera.depth_frame import DepthFrame, as_depth_frame, step_of
from rgbd_planes.camera.frame_warnings import warn_of_distances, warn_of_reach
from rgbd_planes.kernels.segmentation.blocks.pyramid import read_frame
from rgbd_planes.kernels.segmentation.components.components import judge_parts, measure_parts
from rgbd_planes.kernels.segmentation.components.labels import leave_out, settle_strays, write_labels
from rgbd_planes.kernels.segmentation.components.occlusion_gaps import join_across_gaps
from rgbd_planes.kernels.segmentation.components.rim_outliers import release_rims
from rgbd_planes.kernels.segmentation.components.runs import connect
from rgbd_planes.kernels.segmentation.curved.curved import find_curved
from rgbd_planes.kernels.segmentation.curved.surfaces import number_surfaces
from rgbd_planes.kernels.segmentation.evidence.evidence import renumber_labels, weigh_planes
from rgbd_planes.kernels.segmentation.model.planes import describe_planes
from rgbd_planes.kernels.segmentation.model.records import (
    Found,
    Labels,
    Parts,
    Rays,
    Reasons,
    Regions,
    Rules,
    View,
    plain,
)
from rgbd_planes.kernels.segmentation.noise.correlation import shared_by_planes
from rgbd_planes.kernels.segmentation.noise.estimate import nearest_surface
from rgbd_planes.kernels.segmentation.noise.frame_noise import FLATNESS
from rgbd_planes.kernels.segmentation.refit.interior import fit_interior
from rgbd_planes.noise.model import NoiseModel, check_not_a_maker
from rgbd_planes.noise.sigma import LARGEST_NOISE
from rgbd_planes.segmentation.compilation import compile_for
from rgbd_planes.segmentation.frame_noise import Given, noise_of
from rgbd_planes.segmentation.regions import find_regions, fitted
from rgbd_planes.segmentation.result import Segmentation
from rgbd_planes.segmentation.workspace import Workspace, rays_of, workspaces
from rgbd_planes.uncertainty.correlated_errors import shares_errors

MIN_SIZE = 60  # pixels of a region, unless the caller says otherwise
_RULES = Rules()
_REASONS = Reasons(*(np.uint8(Reason[name.upper()]) for name in Reasons._fields))


def segment(
    depth: ArrayLike,
    camera: Camera,
    *,
    noise: NoiseModel | float | Callable[[Floats], ArrayLike] | None = None,
    min_size: int = MIN_SIZE,
) -> Segmentation:
    """Find the planes of a depth frame and the pixels that belong to each.

    Parameters
    ----------
    depth : (H, W) array_like
        Integers in the camera's ``depth_scale``, floats in metres, or disparities of a camera with ``disparity``.
    camera : Camera
    noise : float, callable or noise model, optional
        Standard deviation of inverse depth in 1/m, a function of inverse depths that gives it, or a noise model. By
        default it is ``camera.noise``. Without either it is estimated from the frame: the same in 1/Z at all depths,
        or in Z where the frame shows that plainly. It counts as no less than 0.04 % of the inverse depth. The lateral
        error, in pixels, is the model's own, or what the frame shows. Where neighbours share errors, squares of 8
        pixels may show less noise than a model says: then that counts.
    min_size : int
        Pixels that a plane must have, at least 3. Planes of fewer are left out. From 60 on that changes no other fit,
        and less than one in fifty of the others' pixels.

    Returns
    -------
    Segmentation
        Labels 1..N in the order of their first pixels, strays aside. An empty or a shapeless frame has none. Parts of a
        plane that something thin in front separates have one label. Curved surfaces have none: they are in
        ``curved_labels``.

    Raises
    ------
    TypeError, ValueError
        An argument cannot be used: the message says what was expected and what came.

    Warns
    -----
    UserWarning
        Something in the frame is most likely not meant as it is, such as its unit: `fit_tiles` lists what. Or the frame
        is several times as rough as `noise`, and less than half of it is on planes: another sensor's noise, most
        likely. Or `noise` is more than a fifth of 1/Z: in other units, most likely. Or surfaces without noise are bent
        as depth, and flat as distances along the ray. Or a tenth of an integer frame by the preset of a Kinect v1 is
        beyond 10 m, where that sensor measures nothing.

    Notes
    -----
    Blocks of 4x4 pixels are joined by fours where they are one plane, then with their neighbours. What a merge adds to
    the sum of squared residuals in inverse depth decides; moments give it exactly. Papadakis and Willis 2017 split
    squares in the same space, from above. Then each pixel goes to the plane it fits, and the planes are fitted anew to
    the pixels they own. After three such rounds hardly a pixel changes.

    The same frame gives the same bits, whatever came before it and in any thread. Kernels that were compiled for
    another processor may round the last bit differently.
    """
    check_camera(camera)
    given, min_size = check_settings(camera, noise, min_size)
    return segment_frame(as_depth_frame(depth, camera), camera, given, min_size)


def check_settings(camera: Camera | None, noise: Any, min_size: int) -> tuple[Given, int]:
    """Return the noise, and the least size of a plane, for a segmentation; without a camera, each frame has its own."""
    if camera is not None:
        check_camera(camera)
        noise = camera.noise if noise is None else noise
    return _given(noise), check_min_size(min_size)


def check_min_size(min_size: int) -> int:
    """Return the least size of a plane as an int."""
    return check_whole("min_size", min_size, 3, "whole number of pixels")


def _given(noise: Any) -> Given:
    if noise is None:
        return Given()
    if callable(getattr(noise, "sigma", None)):  # a noise model
        model = noise if isinstance(noise, NoiseModel) and shares_errors(noise) else None
        lateral = number("noise.lateral", getattr(noise, "lateral", 0.0))
        if lateral < 0.0:
            raise ValueError(f"expected noise.lateral of 0 pixels or more, got {lateral!r}")
        return Given(noise.sigma, lateral, is_sensors=True, model=model)
    check_not_a_maker(noise)
    if callable(noise):
        return Given(noise)
    try:
        sigma = number("noise", noise, finite=False)
    except TypeError:
        raise TypeError(
            f"noise must be a number in 1/m, a function of inverse depth, a NoiseModel or None, got {noise!r}"
        ) from None
    if not 0.0 < sigma <= LARGEST_NOISE:
        raise ValueError(f"noise must be a positive standard deviation in 1/m, up to {LARGEST_NOISE:g}, got {noise!r}")
    return Given(lambda q: np.full_like(q, sigma))


def segment_frame(
    frame: DepthFrame, camera: Camera, given: Given, min_size: int, rules: Rules = _RULES
) -> Segmentation:
    """`segment` of a frame that is checked, by rules that may be others."""
    with announced(("segment", frame.raw.dtype), "half a minute to two minutes"), workspaces.lent(camera) as work:
        compile_for(frame)
        return _segment(frame, camera, given, min_size, rules, rays_of(camera._lens), work)


def _segment(
    frame: DepthFrame, camera: Camera, given: Given, min_size: int, rules: Rules, rays: Rays, work: Workspace
) -> Segmentation:
    """Find the planes and their pixels, and describe them."""
    inverse_depth, pyramid = work.inverse_depth, work.pyramid
    nearest = nearest_surface(pyramid, read_frame(*frame.values, rays, inverse_depth, pyramid))
    step_of_raw = step_of(frame)
    noise, about_noise = noise_of(frame, step_of_raw, rays, pyramid, nearest, given)
    view = View(inverse_depth, rays, pyramid, noise, rules._replace(tolerance=about_noise.tolerance), work.sensor)
    regions, touching = find_regions(view, work, min(min_size, MIN_SIZE))
    curved, deviation = np.empty(len(regions.moments), np.bool_), np.empty(len(regions.moments))
    seen, contacts, planes_of_regions = plain(view), plain(work.contacts), plain(fitted(regions, view))
    find_curved(
        seen, plain(regions), planes_of_regions, contacts, touching, about_noise.is_exact, curved, deviation
    )  # fmt: skip
    labels = Labels(aligned(camera.shape, np.int32), aligned(camera.shape, np.uint8))
    found = _find_planes(view, regions, curved, deviation, min_size, labels, work)
    found, evidence = _keep_evident(view, labels, found)
    curved_labels = np.zeros(camera.shape, np.int32)
    if curved.any():
        number_surfaces(seen, labels.reason, _REASONS.curved, min_size, curved_labels)
    together = noise.together
    if given.is_sensors and together > 1.0:
        together = shared_by_planes(together, pyramid, labels.label, inverse_depth)
    count = len(found.moments)
    planes, alpha, covariance = np.empty((count, 4)), np.empty((count, 3)), np.empty((count, 3, 3))
    rmse, sizes = np.empty(count), np.empty(count, np.int32)
    modelled = given.of_planes(found, labels, camera, together)
    describe_planes(
        plain(found), plain(noise), together, plain(modelled), step_of_raw, frame.scale, frame.is_disparity, planes,
        alpha, covariance, rmse, sizes,
    )  # fmt: skip
    if about_noise.is_rougher and sizes.sum() < 0.5 * np.count_nonzero(inverse_depth):
        warn_caller(
            "the frame is several times as rough as the noise that is given, and less than half of it is on planes: "
            "either hardly anything in it is flat over 8 pixels, or that noise is another sensor's, or not in 1/m. "
            "Without it the frame tells its own, and rp.estimate_noise finds that of a sensor"
        )
    warn_of_reach(frame, camera)
    if about_noise.is_exact:
        warn_of_distances(frame, camera)
    return Segmentation(
        camera=camera,
        labels=labels.label,
        planes=planes,
        alpha=alpha,
        alpha_covariance=covariance,
        sizes=sizes,
        rmse=rmse,
        reason=labels.reason,
        sigma=about_noise.typical_sigma,
        evidence=evidence,
        curved_labels=curved_labels,
    )


def _find_planes(
    view: View,
    regions: Regions,
    curved: NDArray[np.bool_],
    deviation: Floats,
    min_size: int,
    labels: Labels,
    work: Workspace,
) -> Found:
    """Find the connected parts of regions that are planes, fit these, and write their labels."""
    seen, runs, least = plain(view), plain(work.runs), min(min_size, MIN_SIZE)
    runs_found, count = connect(plain(regions), labels.label.shape[1], runs)
    parts = Parts(np.empty((count, 10)), np.empty(count), *np.empty((4, count), np.int64))
    measure_parts(seen, runs, runs_found, regions.moments, plain(parts))
    why, number, chosen = np.empty(count, np.uint8), np.empty(count, np.int32), np.empty(count, np.int64)
    planes = judge_parts(
        plain(parts), curved, deviation, seen[4], least, plain(_REASONS), why, number, chosen
    )  # fmt: skip
    chosen = chosen[:planes]
    moments, deviation = parts.moments[chosen], deviation[parts.region[chosen]]
    planes = join_across_gaps(seen, runs, runs_found, number, moments, deviation)
    planes = leave_out(min_size, _REASONS.small, number, why, moments[:planes], deviation[:planes])
    moments, deviation = moments[:planes], deviation[:planes]
    strays = write_labels(view.inverse_depth, runs, number, why, plain(_REASONS), *labels, work.strays)
    owners, shares = plain(regions.owners), plain(regions.shares)
    release_rims(seen, owners, shares, moments, deviation, min_size, _REASONS.unclaimed, *labels)
    found = Found(
        moments, deviation, np.empty((planes, 10)), np.empty((planes, 3)), np.empty(planes), np.empty((planes, 5)),
        np.append(0, moments[:, 0]).astype(np.int32),
    )  # fmt: skip
    edges = work.edges[: fit_interior(seen, plain(labels), _REASONS.missing, plain(found), work.edges)]
    settle_strays(plain(_REASONS), min_size, *labels, found.size, edges, work.strays, strays)
    return found


def _keep_evident(view: View, labels: Labels, found: Found) -> tuple[Found, Floats]:
    """Leave out the planes that are no more than noise makes; returns the others, and the evidence for each."""
    evidence = np.empty(len(found.moments))
    weigh_planes(labels.label, view.inverse_depth, plain(view.rays), found.alpha, found.moments, FLATNESS, evidence)
    is_kept = evidence >= view.rules.evidence
    if is_kept.all():
        return found, evidence
    number = np.append(np.int32(0), np.where(is_kept, np.cumsum(is_kept, dtype=np.int32), np.int32(0)))
    renumber_labels(number, np.uint8(Reason.NOISE), plain(labels))
    return found.of_planes(is_kept), evidence[is_kept]
