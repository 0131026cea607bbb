"""Align the tiles of a frame to the planes of other frames whose poses are known.

The sum of squares is that of inverse depths, in which a disparity sensor's noise is constant: over tiles, each the mean
of its pixels, so that no pixel is read twice. Weights are robust (Geman and McClure 1987). Tiles of one plane share
errors, those of the sensor's lens and of the plane's own fit: so a plane's tiles count less the more there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.rotations import nearest_rotation
from rgbd_planes.egomotion.frame_tiles import FrameTiles, TileRays
from rgbd_planes.kernels.common.quantiles import quantile
from rgbd_planes.kernels.motion.match_tiles import COLUMNS, match_tiles
from rgbd_planes.kernels.motion.normal_equations import (
    SUMS,
    feigned_systems,
    normal_equations,
    spread_of_right,
    sum_crosses,
)

ROUNDS = 5  # of Gauss-Newton, at most
GATE = 0.1  # largest residual of a match, as a share of the inverse depth
LEAST_COSINE = 0.9  # between the normals of a match
ROBUST = 2.5  # residual, in standard deviations, at which a weight is a quarter
LEAST_SCALE = 1e-5  # 1/m: residuals of perfect data
# Of the variance of a tile's residual, the share that all tiles of a plane have in common, for the weights.
COMMON = 0.03
# Variance of the error that all tiles of a plane share, in that of a residual, where neighbours have the same one; it
# is less where they correlate less. A sensor's lens bends planes differently where they are elsewhere in the image.
# Chosen on rendered scenes, and with figures of all 300 real frames of `bench.odometry` in view: none is held out.
SHARED = 5.5
LEAST_CORRELATION = 0.02
FEWEST = 12  # tiles
CONVERGED = 1e-4  # radians, or shares of the median depth
# A direction counts as observed if it has so many times the information that errors of the planes' α would feign: those
# of the fit, at least such a share of a residual's standard deviation, and a normal that is off by so many radians.
FEIGNED = 2.0
LEAST_SHARED = 0.3
LEAST_ANGLE = 0.005


@dataclass(frozen=True, eq=False)
class Reference:
    """A frame that others are aligned to: α of its tiles, (T, 3), and its pose, camera to world."""

    model: Floats
    pose: Floats


@dataclass(frozen=True, eq=False)
class Alignment:
    """Where a frame is, by what it shares with the references.

    Attributes
    ----------
    pose : (4, 4) float64
        Camera to world.
    shares : (K,) float64
        Share of the frame's tiles that each reference has matches of, within the noise.
    scale : float
        Robust standard deviation of a residual, 1/m.
    information : (6, 6) float64
        Of δ in T·Exp(δ), δ = (rotation, translation), in the observed directions alone; as if references had no errors.
    unobservable : (k, 6) float64
        Orthonormal directions of δ.
    """

    pose: Floats
    shares: Floats
    scale: float
    information: Floats
    unobservable: Floats

    @property
    def share(self) -> float:
        """The largest of the shares."""
        return float(self.shares.max(initial=0.0))


def exponential(delta: Floats) -> Floats:
    """(4, 4): the motion of a step, a rotation vector and a translation."""
    from scipy.spatial.transform import Rotation

    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = Rotation.from_rotvec(delta[:3]).as_matrix(), delta[3:]
    return motion


def inverse(pose: Floats) -> Floats:
    """(..., 4, 4): the inverse of rigid motions."""
    result = np.zeros(pose.shape)
    rotation = np.swapaxes(pose[..., :3, :3], -1, -2)
    result[..., :3, :3] = rotation
    result[..., :3, 3] = -(rotation @ pose[..., :3, 3:])[..., 0]
    result[..., 3, 3] = 1.0
    return result


class Aligner:
    """Aligns frames of one camera.

    Parameters
    ----------
    rays : TileRays
    """

    def __init__(self, rays: TileRays) -> None:
        self._rays = rays
        self._matches = np.empty((0, COLUMNS))  # kept: to get so much memory anew takes as long as to fill it

    def shares(self, frame: FrameTiles, references: Sequence[Reference], pose: Floats) -> Floats:
        """(K,): share of the frame's tiles that each reference has matches of, at a pose."""
        if not references or not len(frame.tiles):
            return np.zeros(len(references))
        return _shares(frame, *self._match(frame, *_stacked(references), pose))

    def align(
        self, frame: FrameTiles, references: Sequence[Reference], pose: Floats, counted: int | None = None
    ) -> Alignment | None:
        """Find the pose at which a frame agrees best with the references; None if too little is the same.

        Parameters
        ----------
        frame : FrameTiles
        references : sequence of Reference
        pose : (4, 4) float64
            Where the search begins. In directions that nothing observes the result stays there.
        counted : int, optional
            The information is relative to so many of the references, the first ones; to all by default.
        """
        if not references or len(frame.tiles) < FEWEST:
            return None
        to_references, models = _stacked(references)
        units = np.repeat([1.0, frame.depth], 3)
        sums = np.empty((len(frame.counts), SUMS))
        systems, feigned, right = np.empty((2, 6, 6)), np.empty((2, 6, 6)), np.empty(6)
        arrays = frame.tiles, frame.groups, frame.counts, frame.plane_count
        turned = (LEAST_ANGLE / frame.depth) ** 2
        for _ in range(ROUNDS):
            matches, counts = self._match(frame, to_references, models, pose)
            if len(matches) < FEWEST:
                return None
            scale = max(1.4826 * quantile(np.abs(matches[:, 6]), 0.5), LEAST_SCALE)
            weights = np.empty(len(matches))
            normal_equations(matches, arrays, scale, (ROBUST, COMMON), weights, sums, systems, right)
            errors = scale**2 * len(references), (scale * LEAST_SHARED) ** 2, turned
            feigned_systems(sums, frame.plane_count, errors, self._rays.width, feigned)
            system = systems[0] + systems[1]
            held, noise = np.array([system, systems[0]]), np.array([feigned[0] + feigned[1], feigned[0]])
            observed, others = _directions(system, held, noise)
            if not len(observed):
                return None
            step = -observed.T @ np.linalg.solve(observed @ system @ observed.T, observed @ right)
            pose = pose @ exponential(units * step)
            if np.abs(step).max() < CONVERGED:
                break
        # A transpose stands for an inverse: errors of rounding would double from frame to frame.
        pose[:3, :3] = nearest_rotation(pose[:3, :3])
        shares = _shares(frame, matches, counts)
        some = counts[: len(references) if counted is None else counted].sum()
        information = np.zeros((6, 6))
        if some >= FEWEST:
            matches, weights = matches[:some], weights[:some]
            crosses, spread = np.empty((len(sums), 6, 3)), np.empty((6, 6))
            sum_crosses(matches, arrays, weights, sums, crosses)
            shared = SHARED * _correlation(frame, matches, scale)
            spread_of_right(sums, crosses, scale**2, shared * scale**2, self._rays.width, spread)
            weighted = matches[:, :6] * weights[:, None]
            reduced = np.linalg.solve(observed @ (weighted.T @ matches[:, :6]) @ observed.T, observed)
            # Of δ in radians and metres: a direction w of the system is δ = units·w.
            back = observed / units
            information = back.T @ np.linalg.inv(reduced @ spread @ reduced.T) @ back
        null = np.linalg.qr((others * units).T)[0].T if len(others) else np.empty((0, 6))
        return Alignment(pose, shares, scale, information, null)

    def _match(
        self, frame: FrameTiles, to_references: Floats, models: Floats, pose: Floats
    ) -> tuple[Floats, NDArray[np.int64]]:
        """Matches of a frame at a pose, (M, COLUMNS), steps in units of its depth; and how many of each reference.

        They last until the next call.
        """
        motions = np.ascontiguousarray((to_references @ pose)[:, :3])
        if len(self._matches) < len(models) * len(frame.tiles):
            self._matches = np.empty((len(models) * len(frame.tiles), COLUMNS))
        counts = np.zeros(len(models), np.int64)
        rays, limits = self._rays, (GATE, LEAST_COSINE, frame.depth)
        total = match_tiles(frame.tiles, motions, models, rays.table, rays.bounds, limits, self._matches, counts)
        return self._matches[:total], counts


def _stacked(references: Sequence[Reference]) -> tuple[Floats, Floats]:
    """World to each reference, (K, 4, 4), and their models, (K, T, 3)."""
    poses = np.array([reference.pose for reference in references])
    return inverse(poses), np.array([reference.model for reference in references])


def _shares(frame: FrameTiles, matches: Floats, counts: NDArray[np.int64]) -> Floats:
    """(K,): share of the frame's tiles that each reference has matches of, within 5 deviations or a hundredth."""
    q = frame.tiles[matches[:, 7].astype(np.intp), 2]
    near = np.abs(matches[:, 6]) <= np.maximum(5.0 * frame.sigma, 0.01 * q)
    which = np.repeat(np.arange(len(counts)), counts)
    return np.asarray(np.bincount(which[near], minlength=len(counts)) / len(frame.tiles))


def _correlation(frame: FrameTiles, matches: Floats, scale: float) -> float:
    """Correlation of the residuals of tiles that follow one another on a plane."""
    residuals, tile = matches[:, 6], matches[:, 7].astype(np.intp)
    good = np.abs(residuals) < ROBUST * scale
    pair = (tile[1:] == tile[:-1] + 1) & (frame.groups[tile[1:]] == frame.groups[tile[:-1]]) & good[1:] & good[:-1]
    first, second = residuals[1:][pair], residuals[:-1][pair]
    squares = 0.5 * float(first @ first + second @ second)
    return float(np.clip(first @ second / squares, LEAST_CORRELATION, 1.0)) if squares > 0.0 else LEAST_CORRELATION


def _directions(system: Floats, held: Floats, feigned: Floats) -> tuple[Floats, Floats]:
    """Orthonormal directions, rows, in which some of (E, 6, 6) hold more than errors feign in it, and the others."""
    values, vectors = np.linalg.eigh(system)
    held, feigned = ((vectors * (matrices @ vectors)).sum(axis=1) for matrices in (held, feigned))
    seen = (held > FEIGNED * feigned + 1e-12 * values[-1]).any(axis=0)
    return vectors.T[seen], vectors.T[~seen]
