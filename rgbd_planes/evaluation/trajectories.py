"""How far an estimated trajectory is from the true one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.checks import check_whole, numbers, real_array, shaped_array
from rgbd_planes._core.rotations import as_motion, nearest_rotation
from rgbd_planes._core.text import counted


@dataclass(frozen=True, eq=False, repr=False)
class RelativeErrors:
    """Errors of the motions over a number of frames, or over a time.

    Attributes
    ----------
    step : int
        Frames from the beginning of a motion to its end; 0 where a time is what they have in common.
    translation : (M,) float64
        Metres: length of the translation of truth⁻¹ · estimate, for each pair of frames whose poses are known.
    angle_deg : (M,) float64
        Degrees: angle of its rotation.
    seconds : float
        The time from the beginning of a motion to its end; NaN where frames are counted.
    """

    step: int
    translation: Floats
    angle_deg: Floats
    seconds: float = float("nan")

    def __repr__(self) -> str:
        if not len(self.translation):
            return f"<RelativeErrors: over {self.over}, no pairs>"
        return (
            f"<RelativeErrors: over {self.over}, median {1e3 * np.median(self.translation):.2f} mm, "
            f"{np.median(self.angle_deg):.3f} degrees>"
        )

    @property
    def over(self) -> str:
        """In words, how long the motions are: "1 frame", "30 frames", "1 s"."""
        return counted(self.step, "frame") if self.step else f"{self.seconds:g} s"

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
        One for each step, and one for each time.
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


def trajectory_errors(
    estimated: ArrayLike,
    truth: ArrayLike,
    *,
    steps: Sequence[int] = (1, 30),
    timestamps: ArrayLike | None = None,
    seconds: Sequence[float] = (1.0,),
) -> TrajectoryErrors:
    """Absolute and relative errors of a trajectory.

    Parameters
    ----------
    estimated, truth : (N, 4, 4) array_like
        Poses, camera to world, in metres: of the same frames, row by row. The worlds may differ. Poses that are not
        known are NaN or infinite.
    steps : sequence of int
        Frames over which relative errors are taken: 1 is from frame to frame, 30 is a second of most sensors.
    timestamps : (N,) array_like, optional
        Seconds, not falling; NaN for none. With them relative errors are taken over times as well.
    seconds : sequence of float
        These times. A motion ends at the frame whose timestamp is nearest, if that is off by half the median time
        between frames at most.

    Returns
    -------
    TrajectoryErrors

    Raises
    ------
    TypeError, ValueError
        The shapes differ, a pose is no rigid motion, no frame has both poses, a step is no whole number above 0, a time
        not above 0, or the timestamps fall.

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
    relative = [RelativeErrors(step, *_relative(poses, true, *_pairs_of(known, step))) for step in each]
    if timestamps is not None:
        times = _times(timestamps, len(poses))
        for time in numbers("seconds", seconds):
            if time <= 0.0:
                raise ValueError(f"expected seconds above 0, got {time:g}")
            relative.append(RelativeErrors(0, *_relative(poses, true, *_pairs_over(times, known, time)), time))
    return TrajectoryErrors(motion, absolute, path, tuple(relative))


def _times(timestamps: ArrayLike, count: int) -> Floats:
    """(N,): the timestamps of as many frames."""
    times = real_array("timestamps", timestamps)
    if times.shape != (count,):
        raise ValueError(f"expected {count} timestamps, one a frame, got shape {times.shape}")
    if (np.diff(times[np.isfinite(times)]) < 0.0).any():
        raise ValueError("expected timestamps that do not fall")
    return times


def _pairs_of(known: NDArray[np.bool_], step: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First and last frames of motions over so many frames."""
    first = np.flatnonzero(known[:-step] & known[step:])
    return first, first + step


def _pairs_over(times: Floats, known: NDArray[np.bool_], seconds: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First and last frames of motions over a time, as near to it as frames are."""
    frames = np.flatnonzero(known & np.isfinite(times))
    stamps = times[frames]
    if len(stamps) < 2:
        return frames[:0], frames[:0]
    after = np.clip(np.searchsorted(stamps, stamps + seconds), 1, len(stamps) - 1)
    nearest = after - (stamps + seconds - stamps[after - 1] <= stamps[after] - (stamps + seconds))
    off = np.abs(stamps[nearest] - stamps - seconds)
    # A little more than half: timestamps are rounded.
    near = (off <= 0.51 * np.median(np.diff(stamps))) & (frames[nearest] > frames)
    return frames[near], frames[nearest[near]]


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


def _relative(
    poses: Floats, true: Floats, first: NDArray[np.intp], last: NDArray[np.intp]
) -> tuple[Floats, NDArray[np.float64]]:
    """Metres and degrees by which motions between frames are off."""
    estimated = np.linalg.solve(poses[first], poses[last])
    error = np.linalg.solve(np.linalg.solve(true[first], true[last]), estimated)
    rotation = error[:, :3, :3]
    # The arctangent keeps its digits near 0 and 180 degrees, where the arccosine loses them.
    axis = np.stack([rotation[:, j, i] - rotation[:, i, j] for i, j in ((1, 2), (2, 0), (0, 1))], axis=1)
    angle = np.arctan2(np.linalg.norm(axis, axis=1), np.trace(rotation, axis1=1, axis2=2) - 1.0)
    return np.linalg.norm(error[:, :3, 3], axis=1), np.degrees(angle)


def _root_mean_square(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
