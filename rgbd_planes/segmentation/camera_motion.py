"""How the camera has moved, as planes that it saw before and sees again tell."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.checks import shaped_array
from rgbd_planes._core.rotations import as_motion, nearest_rotation

# Weights of what holds without planes, no turn and no step, against 1 for all planes together: it decides what they
# leave open, as a wall does about steps along it.
STILL_TURN, STILL_STEP = 0.003, 0.02
# Planes further off than so many times what the others are, in the median, move by themselves, or are other planes; not
# if that is less than these degrees, or share of their distance.
OUTLYING, LEAST_ANGLE, LEAST_SHARE = 2.5, 3.0, 0.03
ROUNDS = 4


class Motion(NamedTuple):
    """From the frame of the camera as it was to that of the camera as it is: X' = R·X + t.

    Attributes
    ----------
    rotation : (3, 3) float64
    step : (3,) float64, metres
    """

    rotation: Floats = np.eye(3)
    step: Floats = np.zeros(3)

    @classmethod
    def of(cls, name: str, motion: ArrayLike) -> Motion:
        """Return the motion of a (4, 4) array of that name."""
        array = as_motion(name, shaped_array(name, motion, (4, 4)))
        if array.ndim != 2:
            raise ValueError(f"expected {name} of shape (4, 4), got {array.shape}")
        return cls(array[:3, :3], array[:3, 3])

    @property
    def matrix(self) -> Floats:
        """(4, 4): the motion of homogeneous points."""
        return np.vstack([np.column_stack([self.rotation, self.step]), [0.0, 0.0, 0.0, 1.0]])

    def move_points(self, points: Floats) -> Floats:
        """Return points, (P, 3)."""
        return points @ self.rotation.T + self.step

    def move_planes(self, planes: Floats) -> Floats:
        """Return planes, (K, 4)."""
        normals = planes[:, :3] @ self.rotation.T
        return np.column_stack([normals, planes[:, 3] - normals @ self.step])

    def is_near(self, other: Motion) -> bool:
        """Whether they differ by less than a third of a degree and a centimetre."""
        cosine = 0.5 * (np.trace(self.rotation @ other.rotation.T) - 1.0)
        return bool(cosine > np.cos(np.radians(0.3)) and np.linalg.norm(self.step - other.step) < 0.01)


def camera_motion(before: Floats, now: Floats, weights: Floats) -> Motion:
    """Return the motion that carries planes to what they are now, those aside that move by themselves.

    Parameters
    ----------
    before, now : (K, 4) float64
        The same planes.
    weights : (K,) float64
        Above 0.
    """
    inliers = np.ones(len(weights), np.bool_)
    weights = weights / weights.sum()
    motion = Motion()
    for _ in range(ROUNDS):
        motion = _motion_of(before, now, weights * inliers)
        moved = motion.move_planes(before)
        angle = np.degrees(np.arccos(np.clip(np.sum(moved[:, :3] * now[:, :3], axis=1), -1.0, 1.0)))
        share = np.abs(moved[:, 3] / now[:, 3] - 1.0)
        inlying = angle <= max(LEAST_ANGLE, OUTLYING * np.median(angle))
        inlying &= share <= max(LEAST_SHARE, OUTLYING * np.median(share))
        if not inlying.any() or (inlying == inliers).all():
            break
        inliers = inlying
    return motion


def _motion_of(before: Floats, now: Floats, weights: Floats) -> Motion:
    """Return the best motion: of the normals (Kabsch 1976), then the step of the distances, by least squares."""
    rotation = nearest_rotation((now[:, :3] * weights[:, None]).T @ before[:, :3] + STILL_TURN * np.eye(3))
    normals = before[:, :3] @ rotation.T
    weighted = normals.T * weights
    step = np.linalg.solve(weighted @ normals + STILL_STEP * np.eye(3), weighted @ (before[:, 3] - now[:, 3]))
    return Motion(rotation, np.asarray(step, np.float64))
