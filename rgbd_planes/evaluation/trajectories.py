"""How far an estimated trajectory is from the true one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.checks import check_whole, shaped_array
from rgbd_planes._core.rotations import as_motion, nearest_rotation


@dataclass(frozen=True, eq=False, repr=False)
class RelativeErrors:
    """Errors of the motions over a number of frames.

    Attributes
    ----------
    step : int
        Frames from the beginning of a motion to its end.
    translation : (M,) float64
        Metres: length of the translation of truth⁻¹ · estimate, for each pair of frames whose poses are known.
    angle_deg : (M,) float64
        Degrees: angle of its rotation.
    """

    step: int
    translation: Floats
    angle_deg: Floats

    def __repr__(self) -> str:
        if not len(self.translation):
            return f"<RelativeErrors: over {self.step} frames, no pairs>"
        return (
            f"<RelativeErrors: over {self.step} frames, median {1e3 * np.median(self.translation):.2f} mm, "
            f"{np.median(self.angle_deg):.3f} degrees>"
        )

    @property
    def translation_rmse(self) -> float:
        """Metres; NaN without pairs."""
        return _root_mean_square(self.translation)

    @property
    def angle_rmse(self) -> float:
        """Degrees; NaN without pairs."""
        return _root_mean_square(self.angle_deg)


@dataclass(frozen=True, eq=False, repr=False)
class TrajectoryErrors:
    """Errors of an estimated trajectory; made by `trajectory_errors`.

    Attributes
    ----------
    T_truth_estimated : (4, 4) float64
        The rigid motion that brings the estimated positions nearest to the true ones, by least squares.
    absolute : (N,) float64
        Metres: distance of each position from the true one, after that motion; NaN where a pose is not known.
    path_length : float
        Metres: length of the true path, over the frames whose poses are known.
    relative : tuple of RelativeErrors
        One for each step.
    """

    T_truth_estimated: Floats
    absolute: Floats
    path_length: float
    relative: tuple[RelativeErrors, ...]

    def __repr__(self) -> str:
        return (
            f"<TrajectoryErrors: {1e3 * self.absolute_rmse:.1f} mm over a path of {self.path_length:.2f} m; "
            f"{', '.join(map(repr, self.relative))}>"
        )

    @property
    def absolute_rmse(self) -> float:
        """Metres: root mean square of `absolute`, the absolute trajectory error."""
        return _root_mean_square(self.absolute[np.isfinite(self.absolute)])


def trajectory_errors(estimated: ArrayLike, truth: ArrayLike, *, steps: Sequence[int] = (1, 30)) -> TrajectoryErrors:
    """Absolute and relative errors of a trajectory.

    Parameters
    ----------
    estimated, truth : (N, 4, 4) array_like
        Poses, camera to world, in metres: of the same frames, row by row. The worlds may differ. Poses that are not
        known are NaN or infinite.
    steps : sequence of int
        Frames over which relative errors are taken: 1 is from frame to frame, 30 is a second of most sensors.

    Returns
    -------
    TrajectoryErrors

    Raises
    ------
    TypeError, ValueError
        The shapes differ, a pose is no rigid motion, no frame has both poses, or a step is no whole number above 0.

    Notes
    -----
    Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012: the absolute trajectory error after
    alignment without scale (Horn 1987), and the relative pose error.
    """
    poses, true = shaped_array("estimated", estimated, (4, 4)), shaped_array("truth", truth, (4, 4))
    if poses.ndim != 3 or poses.shape != true.shape:
        raise ValueError(f"expected (N, 4, 4) poses of the same frames, got {poses.shape} and {true.shape}")
    each = [check_whole("steps", step, 1) for step in steps]
    known = np.isfinite(np.concatenate([poses, true], axis=1).reshape(len(poses), -1)).all(axis=1)
    if not known.any():
        raise ValueError(f"expected at least one frame whose two poses are known, got none of {len(poses)}")
    poses, true = _motions("estimated", poses, known), _motions("truth", true, known)
    motion = _nearest_motion(poses[known, :3, 3], true[known, :3, 3])
    moved = poses[:, :3, 3] @ motion[:3, :3].T + motion[:3, 3]
    absolute = np.where(known, np.linalg.norm(moved - true[:, :3, 3], axis=1), np.nan)
    path = float(np.linalg.norm(np.diff(true[known, :3, 3], axis=0), axis=1).sum())
    return TrajectoryErrors(motion, absolute, path, tuple(_relative(poses, true, known, step) for step in each))


def _motions(name: str, poses: Floats, known: NDArray[np.bool_]) -> Floats:
    """The poses, with exact rotations; the identity where they are not known."""
    result = np.tile(np.eye(4), (len(poses), 1, 1))
    result[known] = as_motion(name, poses[known])
    return result


def _nearest_motion(points: Floats, others: Floats) -> Floats:
    """(4, 4): the rigid motion that takes (N, 3) points nearest to others (Kabsch 1976)."""
    middle, other = points.mean(axis=0), others.mean(axis=0)
    motion = np.eye(4)
    motion[:3, :3] = nearest_rotation((others - other).T @ (points - middle))
    motion[:3, 3] = other - motion[:3, :3] @ middle
    return motion


def _relative(poses: Floats, true: Floats, known: NDArray[np.bool_], step: int) -> RelativeErrors:
    both = np.flatnonzero(known[:-step] & known[step:])
    estimated = np.linalg.solve(poses[both], poses[both + step])
    error = np.linalg.solve(np.linalg.solve(true[both], true[both + step]), estimated)
    rotation = error[:, :3, :3]
    # The arctangent keeps its digits near 0 and 180 degrees, where the arccosine loses them.
    axis = np.stack([rotation[:, j, i] - rotation[:, i, j] for i, j in ((1, 2), (2, 0), (0, 1))], axis=1)
    angle = np.arctan2(np.linalg.norm(axis, axis=1), np.trace(rotation, axis1=1, axis2=2) - 1.0)
    return RelativeErrors(step, np.linalg.norm(error[:, :3, 3], axis=1), np.degrees(angle))


def _root_mean_square(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
