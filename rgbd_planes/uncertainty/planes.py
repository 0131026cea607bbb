"""What follows from a plane's covariance: comparisons, distances, angles, other frames.

Planes are (..., 4), n·X + d = 0 with ‖n‖ = 1, and their covariances (..., 4, 4), as ``planes`` and ``plane_covariance``
of a fit. Everything is to first order in the errors. Leading shapes broadcast. Arrays of other shapes, and planes whose
normals are not of length 1, raise a ValueError that names them. Masked arrays, and arrays of anything but numbers,
raise a TypeError.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.checks import plain_array, shaped_array
from rgbd_planes._core.rotations import as_motion, nearest_rotation
from rgbd_planes.kernels.statistics.plane_pairs import same_planes
from rgbd_planes.uncertainty.far_planes import about, covariance_about, covariance_from, is_far

# Share of the squared variances of a normal that rounding leaves of their determinant. For a strip of pixels it is
# larger: the square of its width over its length.
_RANK = 1e-12
_LEAST_TURN = 1e-9  # weight of no turn, against that of one plane
# Information of a direction, in 1/rad² for each plane, that errors of the normals may feign where there is none: a half
# in the mean.
_FEIGNED = 10.0
_ROUNDS = 20  # at most, in which a motion is improved: 5 do for normals that err by milliradians, 8 where by degrees
_SAME_SIDES = "expected the same planes in both frames, row by row, with normals to the same side"
_ROUNDED = 1e-3  # how far a normal's length is from 1, at most, where its numbers have three digits or more


def same_plane(
    alpha: npt.ArrayLike, covariance: npt.ArrayLike, other_alpha: npt.ArrayLike, other_covariance: npt.ArrayLike
) -> Floats:
    """Test whether planes fitted to different pixels are one plane.

    Parameters
    ----------
    alpha, other_alpha : (..., 3) or (..., 4) array_like
        α = -n / d in 1/m, or planes (n, d), both in one frame. For planes that one camera saw, α is better: errors of
        (n, d) are known to first order only. That is not enough where normals are uncertain by ten degrees or more, as
        in tiles of a few pixels.
    covariance, other_covariance : (..., 3, 3) or (..., 4, 4) array_like
        Of α in 1/m², a fit's ``alpha_covariance``; or of (n, d), its ``plane_covariance``.

    Returns
    -------
    (...) float64
        P-value of δᵀ(Σ + Σ')⁻¹δ, chi-square with 3 degrees of freedom: small for two planes, NaN where one is
        missing. For (n, d), δ is the difference of d and of the normals, across their mean; normals that point to
        opposite sides have 0. A systematic error that neighbours share counts as if each had its own: then neighbours
        on one plane have larger p-values than others. The `spread` of a noise model does not count.

    Raises
    ------
    ValueError
        The sum of two covariances is not of rank 3, as where both are zero.

    Examples
    --------
    Tiles and their neighbours to the right:

    >>> a, c = tiles.alpha, tiles.alpha_covariance
    >>> p = rp.uncertainty.same_plane(a[:, :-1], c[:, :-1], a[:, 1:], c[:, 1:])
    """
    entries = 4 if plain_array("alpha", alpha).shape[-1:] == (4,) else 3
    read = _planes if entries == 4 else partial(shaped_array, entries=(3,))
    first, second = read("alpha", alpha), read("other_alpha", other_alpha)
    first_covariance = shaped_array("covariance", covariance, (entries, entries))
    second_covariance = shaped_array("other_covariance", other_covariance, (entries, entries))
    shape = _leading(
        alpha=first.shape[:-1],
        covariance=first_covariance.shape[:-2],
        other_alpha=second.shape[:-1],
        other_covariance=second_covariance.shape[:-2],
    )
    opposite = np.zeros(shape, bool)
    if entries == 4:
        opposite |= np.sum(first[..., :3] * second[..., :3], axis=-1) < 0.0
        # About a point of the plane: far from it, an error of second order changes d by more than d's own error.
        point = _surest(first, first_covariance)
        across = _axes_across(first[..., :3] + second[..., :3])
        turned = np.swapaxes(across, -1, -2)
        first_covariance, second_covariance = (
            across @ covariance_about(plane, of_plane, point, _surest(plane, of_plane)) @ turned
            for plane, of_plane in ((first, first_covariance), (second, second_covariance))
        )
        axes = across @ about(point)
        first, second = (np.sum(axes * plane[..., None, :], axis=-1) for plane in (first, second))

    def flat(array: Floats, entries: tuple[int, ...]) -> Floats:
        # Always copied: the kernel would be compiled both for writable and for read-only arrays.
        return np.array(np.broadcast_to(array, (*shape, *entries)), order="C").reshape(-1, *entries)

    pairs = (
        flat(first, (3,)), flat(first_covariance, (3, 3)), flat(second, (3,)), flat(second_covariance, (3, 3))
    )  # fmt: skip
    p_value = np.empty(shape)
    same_planes(*pairs, p_value.reshape(-1))
    p_value = np.where(opposite, 0.0, p_value)
    unknown = np.isnan(p_value).reshape(-1)
    known = [np.isfinite(part[unknown]).all(axis=tuple(range(1, part.ndim))) for part in pairs]
    if np.logical_and.reduce(known).any():  # neither is missing
        raise ValueError("expected covariances whose sums are of rank 3, as those of planes that were fitted")
    return p_value


def point_distance(
    points: npt.ArrayLike,
    planes: npt.ArrayLike,
    plane_covariance: npt.ArrayLike | None,
    point_covariance: npt.ArrayLike | None = None,
) -> tuple[Floats, Floats]:
    """Signed distance of points to planes, positive on the camera's side, and its standard deviation.

    Parameters
    ----------
    points : (..., 3) array_like
        Metres.
    planes : (..., 4) array_like
    plane_covariance : (..., 4, 4) array_like, or None
        None if it is not known: then the standard deviations are NaN.
    point_covariance : (..., 3, 3) array_like, optional
        For points that are measured independently of the planes.

    Returns
    -------
    distance, std : (...) float64
        Metres.
    """
    point, plane = shaped_array("points", points, (3,)), _planes("planes", planes)
    covariance = _covariance("plane_covariance", plane_covariance)
    spread = None if point_covariance is None else shaped_array("point_covariance", point_covariance, (3, 3))
    _leading(
        points=point.shape[:-1],
        planes=plane.shape[:-1],
        plane_covariance=covariance.shape[:-2],
        point_covariance=() if spread is None else spread.shape[:-2],
    )
    distance = np.sum(point * plane[..., :3], axis=-1) + plane[..., 3]
    lever = np.concatenate([point, np.ones((*point.shape[:-1], 1))], axis=-1)
    variance = _form(lever, covariance)
    if is_far(covariance, variance).any():
        variance = covariance_about(plane, covariance, point, _surest(plane, covariance))[..., 3, 3]
    if spread is not None:
        variance = variance + _form(plane[..., :3], spread)
    distance, variance = np.broadcast_arrays(distance, variance)
    return distance.copy(), np.sqrt(np.maximum(variance, 0.0))


def angle_between(
    planes: npt.ArrayLike,
    plane_covariance: npt.ArrayLike | None,
    other_planes: npt.ArrayLike,
    other_covariance: npt.ArrayLike | None,
) -> tuple[Floats, Floats]:
    """Angle between the normals of planes fitted to different pixels, and its standard deviation.

    Parameters
    ----------
    planes, other_planes : (..., 4) array_like
    plane_covariance, other_covariance : (..., 4, 4) array_like, or None
        None if it is not known: then the standard deviations are NaN.

    Returns
    -------
    angle, std : (...) float64
        Degrees, 0 to 180. Between planes that are parallel to within their errors the angle is the length of an error,
        never negative. Its standard deviation is then taken along the line between the normals, or along the most
        uncertain direction where they coincide.
    """
    first, second = _planes("planes", planes)[..., :3], _planes("other_planes", other_planes)[..., :3]
    first_covariance = _covariance("plane_covariance", plane_covariance)[..., :3, :3]
    second_covariance = _covariance("other_covariance", other_covariance)[..., :3, :3]
    leading = _leading(
        planes=first.shape[:-1],
        plane_covariance=first_covariance.shape[:-2],
        other_planes=second.shape[:-1],
        other_covariance=second_covariance.shape[:-2],
    )
    cosine = np.sum(first * second, axis=-1)
    sine = np.linalg.norm(np.cross(first, second), axis=-1)
    angle = np.arctan2(sine, cosine)
    apart = sine > 1e-12
    scale = 1.0 / np.where(apart, sine, 1.0)[..., None]
    # From each normal towards the other, along the great circle between them.
    variance = _form((second - cosine[..., None] * first) * scale, first_covariance)
    variance = variance + _form((first - cosine[..., None] * second) * scale, second_covariance)
    alike = np.asarray(~apart & ~np.isnan(variance))
    if alike.any():
        both = first_covariance + second_covariance
        both = np.broadcast_to(np.where(np.isfinite(both), both, 0.0), (*alike.shape, 3, 3))
        variance = np.array(variance)
        variance[alike] = np.linalg.eigvalsh(both[alike])[:, -1]
    std = np.sqrt(np.maximum(variance, 0.0))
    return np.broadcast_to(np.degrees(angle), leading).copy(), np.broadcast_to(np.degrees(std), leading).copy()


def angle_and_offset(first: Floats, second: Floats) -> tuple[Floats, Floats]:
    """Angles in degrees between the normals of (..., 4) planes with unit normals, and differences of their d."""
    # The arctangent keeps its digits near 0 and 180 degrees, where the arccosine loses them.
    sine = np.linalg.norm(np.cross(first[..., :3], second[..., :3]), axis=-1)
    cosine = (first[..., :3] * second[..., :3]).sum(axis=-1)
    return np.degrees(np.arctan2(sine, cosine)), first[..., 3] - second[..., 3]


def transform_planes(
    planes: npt.ArrayLike,
    plane_covariance: npt.ArrayLike | None,
    transform: npt.ArrayLike,
    transform_covariance: npt.ArrayLike | None = None,
) -> tuple[Floats, Floats]:
    """Take planes and their covariances to another frame.

    Parameters
    ----------
    planes : (..., 4) array_like
    plane_covariance : (..., 4, 4) array_like, or None
        None if it is not known: then that in the new frame is NaN.
    transform : (..., 4, 4) array_like
        Rigid motion: X in the new frame is R·X + t. The planes' covariances must not depend on it. Of an R that has
        three digits or more, as in files, the nearest rotation is taken.
    transform_covariance : (..., 6, 6) array_like, optional
        Of (ω, τ), radians and metres, where the true motion is exp([ω]×)·R and t + τ: rotation vector and
        translation in the new frame's axes. Planes moved by one motion have its errors in common: compare them, by
        `same_plane` or `angle_between`, without it.

    Returns
    -------
    planes : (..., 4) float64
        n still points to the side of the camera that saw the plane, so d may be negative.
    plane_covariance : (..., 4, 4) float64

    Raises
    ------
    ValueError
        The transform is not a rigid motion.
    """
    plane = _planes("planes", planes)
    covariance = _covariance("plane_covariance", plane_covariance)
    motion = as_motion("transform", shaped_array("transform", transform, (4, 4)))
    rotation, translation = motion[..., :3, :3], motion[..., :3, 3]
    pose = None if transform_covariance is None else shaped_array("transform_covariance", transform_covariance, (6, 6))
    leading = _leading(
        planes=plane.shape[:-1],
        plane_covariance=covariance.shape[:-2],
        transform=motion.shape[:-2],
        transform_covariance=() if pose is None else pose.shape[:-2],
    )
    # n' = R·n and d' = d - n'·t, linear in (n, d).
    linear = np.zeros(motion.shape)
    linear[..., :3, :3] = rotation
    linear[..., 3, :3] = -np.sum(translation[..., :, None] * rotation, axis=-2)
    linear[..., 3, 3] = 1.0
    moved = np.sum(linear * plane[..., None, :], axis=-1)
    moved_covariance = linear @ covariance @ np.swapaxes(linear, -1, -2)
    if pose is not None:
        slope = _slope_of_motion(moved[..., :3], translation)
        moved_covariance = moved_covariance + slope @ pose @ np.swapaxes(slope, -1, -2)
    variance = _variance_across(plane, covariance)
    if (is_far(covariance, variance) | is_far(moved_covariance, variance)).any():
        moved_covariance = _moved_far(plane, covariance, moved, rotation, translation, pose)
    return np.broadcast_to(moved, (*leading, 4)).copy(), np.broadcast_to(moved_covariance, (*leading, 4, 4)).copy()


def _moved_far(
    plane: Floats, covariance: Floats, moved: Floats, rotation: Floats, translation: Floats, pose: Floats | None
) -> Floats:
    """(..., 4, 4): covariances of moved planes, by way of axes whose origin is on the plane."""
    surest = _surest(plane, covariance)
    local = covariance_about(plane, covariance, surest, surest)
    turn = np.zeros((*rotation.shape[:-2], 4, 4))
    turn[..., :3, :3], turn[..., 3, 3] = rotation, 1.0
    local = turn @ local @ np.swapaxes(turn, -1, -2)
    turned = np.sum(rotation * surest[..., None, :], axis=-1)
    point = turned + translation
    if pose is not None:
        # About the point, by which the plane was moved there, the lever of a turn is no longer than before.
        slope = _slope_of_motion(moved[..., :3], -turned)
        local = local + slope @ pose @ np.swapaxes(slope, -1, -2)
    at_point = np.concatenate([moved[..., :3], np.zeros_like(moved[..., 3:])], axis=-1)
    off = _surest(at_point, local)
    variance = _variance_across(at_point, local)
    return covariance_from(moved, local, point, variance, point + off)


def _variance_across(plane: Floats, covariance: Floats) -> Floats:
    """(...): s², the variance of the distance of a plane's surest point, as far as its digits tell."""
    surest = _surest(plane, covariance)
    return _form(np.concatenate([surest, np.ones((*surest.shape[:-1], 1))], axis=-1), covariance)


def _slope_of_motion(normal: Floats, translation: Floats) -> Floats:
    """(..., 4, 6): derivative of moved planes (n', d') by the error (ω, τ) of their motion."""
    shape = np.broadcast_shapes(normal.shape[:-1], translation.shape[:-1])
    slope = np.zeros((*shape, 4, 6))
    # dn' = ω × n', dd' = -dn'·t - n'·τ
    x, y, z = np.moveaxis(normal, -1, 0)
    slope[..., 0, 1], slope[..., 0, 2] = z, -y
    slope[..., 1, 0], slope[..., 1, 2] = -z, x
    slope[..., 2, 0], slope[..., 2, 1] = y, -x
    slope[..., 3, :3] = -np.sum(slope[..., :3, :3] * translation[..., :, None], axis=-2)
    slope[..., 3, 3:] = -normal
    return slope


@dataclass(frozen=True, eq=False)
class PlaneAlignment:
    """The motion between two frames, by planes that both show; unpacks as (transform, covariance).

    The true motion is exp([ω]×)·R and t + τ. ω is in radians, τ in metres, both in the other frame's axes.

    Attributes
    ----------
    transform : (4, 4) float64
        R and t, in metres: X in the other frame is R·X + t.
    covariance : (6, 6) float64
        Of (ω, τ); NaN where some direction is open.
    information : (6, 6) float64
        Of (ω, τ): the inverse of the covariance; of rank 5 or 3 where the planes face two directions, or one.
    unobservable : (k, 6) float64
        Orthonormal directions of (ω, τ) that the planes leave open; k is 0 where they face three directions.
    """

    transform: Floats
    covariance: Floats
    information: Floats
    unobservable: Floats

    def __iter__(self) -> Iterator[Floats]:
        return iter((self.transform, self.covariance))


def align_planes(
    planes: npt.ArrayLike, plane_covariance: npt.ArrayLike, other_planes: npt.ArrayLike, other_covariance: npt.ArrayLike
) -> PlaneAlignment:
    """Find the rigid motion that takes planes to what they are in another frame, as of a camera between two frames.

    Parameters
    ----------
    planes, other_planes : (K, 4) array_like
        The same planes in both frames, row by row, with normals to the same side; NaN for missing ones.
    plane_covariance, other_covariance : (K, 4, 4) array_like
        Of independent errors: each plane counts by how certain it is.

    Returns
    -------
    PlaneAlignment
        ``transform, covariance = align_planes(...)`` takes two of its fields; it also has the information, and the
        directions that the planes leave open.

    Raises
    ------
    ValueError
        No motion takes the normals to the same sides. Or a covariance is not of rank 3.

    Notes
    -----
    Maximum likelihood, by Gauss and Newton's method from the motion of the normals alone (Kabsch 1976). One pair of
    different planes spoils it: `same_plane`, of the planes after the motion, tells which.

    Planes that face one direction leave two translations and a turn open, as a wall does; two directions leave one
    translation open, as in a corridor. The transform has no part along what is open. A direction counts as open where
    its information is no more than errors of the normals alone would feign. Its deviation is then above a fifth of a
    radian, or of the planes' median distance.
    """
    from scipy.spatial.transform import Rotation

    first, second = _planes("planes", planes), _planes("other_planes", other_planes)
    first_covariance = shaped_array("plane_covariance", plane_covariance, (4, 4))
    second_covariance = shaped_array("other_covariance", other_covariance, (4, 4))
    leading = {first.shape[:-1], second.shape[:-1], first_covariance.shape[:-2], second_covariance.shape[:-2]}
    if first.ndim != 2 or len(leading) > 1:
        came = ", ".join(str(array.shape) for array in (first, first_covariance, second, second_covariance))
        raise ValueError(f"expected (K, 4) planes and (K, 4, 4) covariances of as many in both frames, got {came}")
    given = first, second, first_covariance, second_covariance
    there = np.logical_and.reduce([np.isfinite(array).all(axis=tuple(range(1, array.ndim))) for array in given])
    first, second, first_covariance, second_covariance = (
        first[there],
        second[there],
        first_covariance[there],
        second_covariance[there],
    )
    if not len(first):
        return PlaneAlignment(np.eye(4), np.full((6, 6), np.nan), np.zeros((6, 6)), np.eye(6))
    _check_rank(first, first_covariance)
    _check_rank(second, second_covariance)
    motion, products = np.eye(4), second[:, :3].T @ first[:, :3]
    # Around a direction that all normals are along, the least turn.
    motion[:3, :3] = nearest_rotation(products + _LEAST_TURN * np.eye(3))
    # Of normals to the other side this is a rotation and a reflection, unless they hardly face three directions.
    scatter = np.sqrt(np.trace(first_covariance[:, :3, :3] + second_covariance[:, :3, :3], axis1=1, axis2=2).sum())
    if np.linalg.det(products) < 0.0 and np.linalg.svd(products, compute_uv=False)[-1] > 5.0 * scatter:
        raise ValueError(f"{_SAME_SIDES}, got some that only a reflection brings together")
    axes = _axes_across(second[:, :3]) @ about(_surest(second, second_covariance))
    units = np.repeat([1.0, max(float(np.median(np.abs(second[:, 3]))), 1e-9)], 3)
    for _ in range(_ROUNDS):
        moved, moved_covariance = transform_planes(first, first_covariance, motion)
        errors = np.sum(axes * (second - moved)[:, None, :], axis=-1)
        slope = axes @ _slope_of_motion(moved[:, :3], motion[:3, 3])
        weighted = np.swapaxes(slope, 1, 2) @ np.linalg.inv(
            axes @ (moved_covariance + second_covariance) @ np.swapaxes(axes, 1, 2)
        )
        information = (weighted @ slope).sum(axis=0)
        observed, null = _observed(information, units, _FEIGNED * len(first))
        covariance = observed.T @ np.linalg.inv(observed @ information @ observed.T) @ observed
        step = covariance @ (weighted @ errors[..., None]).sum(axis=(0, 2))
        motion[:3, :3] = Rotation.from_rotvec(step[:3]).as_matrix() @ motion[:3, :3]
        motion[:3, 3] += step[3:]
        if (np.abs(step) <= 1e-6 * np.sqrt(np.diagonal(covariance))).all():
            break
    opposite = np.sum((first[:, :3] @ motion[:3, :3].T) * second[:, :3], axis=1) < 0.0
    if opposite.any():
        rows = ", ".join(map(str, np.flatnonzero(there)[opposite]))
        raise ValueError(
            f"{_SAME_SIDES}, got some that no motion brings together: by the nearest one normals of rows {rows} are "
            "opposite"
        )
    if len(null):
        information = observed.T @ (observed @ information @ observed.T) @ observed
        covariance = np.full((6, 6), np.nan)
    return PlaneAlignment(motion, covariance, information, null)


def _observed(information: Floats, units: Floats, least: float) -> tuple[Floats, Floats]:
    """Orthonormal directions, rows, of more information than the least, in some units, and the others."""
    values, vectors = np.linalg.eigh(information * np.outer(units, units))
    basis = np.linalg.qr((vectors.T * units).T)[0].T  # those of little information first
    open_count = int(np.count_nonzero(values <= least))
    return basis[open_count:], basis[:open_count]


def fuse_planes(planes: npt.ArrayLike, plane_covariance: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Combine several measurements of one plane, each weighted by how certain it is.

    Parameters
    ----------
    planes : (..., K, 4) array_like
        In one frame, as from `transform_planes`, with independent errors; NaN for missing ones.
    plane_covariance : (..., K, 4, 4) array_like

    Returns
    -------
    plane : (..., 4) float64
        NaN where all K are missing.
    plane_covariance : (..., 4, 4) float64

    Raises
    ------
    ValueError
        There are none, their normals point to opposite sides, or a covariance is not of rank 3. Rounding may hide the
        rank of planes some 100 km from the origin.

    Notes
    -----
    Inverse covariances add: for tiles' planes with independent noise this is, to first order, the plane of all their
    pixels. `same_plane` tells whether they are one plane; if not, the result means nothing.

    Errors that a sensor repeats from frame to frame, by its lens and its calibration (a noise model's ``floor``), are
    not independent. In K frames from one place they stay as they are, while the result's deviation is divided by √K. So
    fuse frames from places that are far from each other, or keep one frame's covariance.
    """
    plane, covariance = _planes("planes", planes), shaped_array("plane_covariance", plane_covariance, (4, 4))
    shape = _leading(planes=plane.shape[:-1], plane_covariance=covariance.shape[:-2])
    if not shape or shape[-1] == 0:
        raise ValueError(f"expected planes of shape (..., K, 4), K at least 1, got {plane.shape}")
    plane, covariance = np.broadcast_to(plane, (*shape, 4)), np.broadcast_to(covariance, (*shape, 4, 4))
    there = np.asarray(np.isfinite(plane).all(axis=-1) & np.isfinite(covariance).all(axis=(-2, -1)))
    some = np.asarray(there.any(axis=-1))
    first = np.argmax(there, axis=-1)[..., None]
    fused = np.take_along_axis(plane, first[..., None], axis=-2)[..., 0, :]
    fused_covariance = np.take_along_axis(covariance, first[..., None, None], axis=-3)[..., 0, :, :]
    if (np.sum(plane[..., :3] * fused[..., None, :3], axis=-1) < 0.0).any():
        raise ValueError("expected planes whose normals point to one side")
    _check_rank(plane[there], covariance[there])
    for _ in range(2):  # from the first plane, and then from the result
        point = _surest(fused, fused_covariance)
        origin = about(point)
        axes = _axes_across(fused[..., :3]) @ origin
        errors = np.sum(axes[..., None, :, :] * plane[..., None, :], axis=-1)
        across = _axes_across(fused[..., :3])[..., None, :, :]
        local = covariance_about(plane, covariance, point[..., None, :], _surest(plane, covariance))
        error_covariance = across @ local @ np.swapaxes(across, -1, -2)
        error_covariance = np.where(there[..., None, None], error_covariance, np.eye(3))
        information = np.where(there[..., None, None], np.linalg.inv(error_covariance), 0.0)
        inverse_sum = np.linalg.inv(np.where(some[..., None, None], information.sum(axis=-3), np.eye(3)))
        weighted = np.sum(information * np.where(there[..., None], errors, 0.0)[..., None, :], axis=(-3, -1))
        found = np.sum(inverse_sum * weighted[..., None, :], axis=-1)
        across = axes[..., :2, :3]
        normal = fused[..., :3] + np.sum(found[..., :2, None] * across, axis=-2)
        length = np.linalg.norm(normal, axis=-1, keepdims=True)
        normal /= length
        # Of (n, d) about the point: dn lies across the fused plane's own normal.
        slope = np.zeros((*normal.shape[:-1], 4, 3))
        along = np.sum(across * normal[..., None, :], axis=-1)
        slope[..., :3, :2] = np.swapaxes(across, -1, -2) - normal[..., :, None] * along[..., None, :]
        slope[..., :3, :2] /= length[..., None]
        slope[..., 3, 2] = 1.0
        back = np.linalg.inv(origin)
        at_point = np.concatenate([normal, found[..., 2:]], axis=-1)
        fused = np.sum(back * at_point[..., None, :], axis=-1)
        fused_local = slope @ inverse_sum @ np.swapaxes(slope, -1, -2)
        variance, off = _variance_across(at_point, fused_local), _surest(at_point, fused_local)
        fused_covariance = covariance_from(fused, fused_local, point, variance, point + off)
    fused[~some], fused_covariance[~some] = np.nan, np.nan
    return fused, fused_covariance


def _covariance(name: str, covariance: npt.ArrayLike | None) -> Floats:
    """(..., 4, 4) covariances: NaN if they are not known."""
    return np.full((4, 4), np.nan) if covariance is None else shaped_array(name, covariance, (4, 4))


def _planes(name: str, values: npt.ArrayLike) -> Floats:
    """(..., 4) planes with normals of length 1, or NaN: with others distances would be in other units than metres."""
    planes = shaped_array(name, values, (4,))
    with np.errstate(over="ignore"):
        length = np.linalg.norm(planes[..., :3], axis=-1)
    off = np.abs(length - 1.0) > _ROUNDED
    if off.any():
        raise ValueError(
            f"expected {name} with normals of length 1, got {length[off].flat[0]:.6g}: "
            f"scale = np.linalg.norm({name}[..., :3], axis=-1, keepdims=True) makes them by {name} / scale, "
            "with the covariance / scale[..., None] ** 2"
        )
    return planes


def _axes_across(normal: Floats) -> Floats:
    """(..., 3, 4): takes (n, d) to its components along two directions across a normal, and d."""
    with np.errstate(invalid="ignore"):  # for opposite normals
        unit = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    least = np.eye(3)[np.argmin(np.abs(np.nan_to_num(unit)), axis=-1)]
    across = np.cross(unit, least)
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    axes = np.zeros((*normal.shape[:-1], 3, 4))
    axes[..., 0, :3], axes[..., 1, :3], axes[..., 2, 3] = across, np.cross(unit, across), 1.0
    return axes


def _along_axes(plane: Floats, covariance: Floats) -> tuple[Floats, ...]:
    """`_axes_across` the normal, and the covariance along them: aa, ab, bb of the normal, ad, bd with d, dd of d."""
    axes = _axes_across(plane[..., :3])
    along = axes @ covariance @ np.swapaxes(axes, -1, -2)
    return axes, *(along[..., i, j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)))


def _check_rank(plane: Floats, covariance: Floats) -> None:
    """Refuse covariances unless the errors in two directions, and of d, do not follow from one another."""
    if is_far(covariance, _variance_across(plane, covariance)).any():
        surest = _surest(plane, covariance)
        covariance = covariance_about(plane, covariance, surest, surest)
    _, aa, ab, bb, ad, bd, dd = _along_axes(plane, covariance)
    determinant = aa * bb - ab * ab
    offset_minor = dd * determinant - (bb * ad * ad - 2.0 * ab * ad * bd + aa * bd * bd)
    if not ((aa + bb > 0.0) & (determinant > _RANK * (aa + bb) ** 2) & (offset_minor > 0.0)).all():
        raise ValueError("expected covariances of rank 3, as those of planes that were fitted")


def _surest(plane: Floats, covariance: Floats) -> Floats:
    """(..., 3): the most certain point of a plane: about it the errors of d and of the normal are uncorrelated."""
    axes, aa, ab, bb, ad, bd, _ = _along_axes(plane, covariance)
    determinant = aa * bb - ab * ab
    inverse = np.divide(-1.0, determinant, out=np.zeros_like(determinant), where=determinant != 0.0)
    a, b = (bb * ad - ab * bd) * inverse, (aa * bd - ab * ad) * inverse
    return np.asarray(
        a[..., None] * axes[..., 0, :3] + b[..., None] * axes[..., 1, :3] - plane[..., 3:] * plane[..., :3]
    )


def _leading(**shapes: tuple[int, ...]) -> tuple[int, ...]:
    """The shape that leading shapes broadcast to."""
    try:
        return np.broadcast_shapes(*shapes.values())
    except ValueError:
        came = ", ".join(f"{name} {shape}" for name, shape in shapes.items() if shape)
        raise ValueError(f"expected leading shapes that broadcast, got {came}") from None


def _form(vector: Floats, matrix: Floats) -> Floats:
    """vᵀMv."""
    return np.asarray(np.einsum("...i,...ij,...j->...", vector, matrix, vector))
