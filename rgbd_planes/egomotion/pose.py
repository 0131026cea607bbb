"""Where a camera was when it took a frame, and how well that is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rgbd_planes._core.arrays import Floats
from rgbd_planes.segmentation.tracking import TrackedSegmentation


@dataclass(frozen=True, eq=False, repr=False)
class CameraPose:
    """Where the camera was at one frame of a sequence.

    A motion T takes points from the frame named last to the frame named first: X_world = T_world_camera · X_camera. An
    error δ is a rotation vector in radians and a translation in metres, (6,), in the camera's own axes: the true motion
    is T_reference_camera · Exp(δ).

    Attributes
    ----------
    index : int
        Number of the frame, from 0.
    timestamp : float
        Seconds, as the frame states it; NaN where it states none.
    T_world_camera : (4, 4) float64
        Camera to world, in metres. World is the camera of the first frame.
    reference : int
        Index of the keyframe that the covariance is relative to.
    T_reference_camera : (4, 4) float64
        Camera to that keyframe's camera.
    covariance : (6, 6) float64
        Of δ. In directions that nothing observes it is the prior's: the camera does not move along them. Its motion
        changes by 1 cm and 1 degree from each frame to the next, since the reference.
    information : (6, 6) float64
        Of δ from what was seen alone, without the prior: its rank is 6 less the number of unobservable directions.
    unobservable : (k, 6) float64
        Orthonormal directions of δ that nothing in the frame observes; k is 0 where all is seen.
    is_keyframe : bool
        Whether later frames are aligned to this one.
    is_lost : bool
        Nothing matched: the pose is the prior's.
    segmentation : TrackedSegmentation
        The planes of the frame, with ids that stay with them.
    """

    index: int
    timestamp: float
    T_world_camera: Floats
    reference: int
    T_reference_camera: Floats
    covariance: Floats
    information: Floats
    unobservable: Floats
    is_keyframe: bool
    is_lost: bool
    segmentation: TrackedSegmentation

    def __repr__(self) -> str:
        x, y, z = self.T_world_camera[:3, 3]
        state = "lost" if self.is_lost else f"{6 - len(self.unobservable)} of 6 directions observed"
        return f"<CameraPose: frame {self.index}, at {x:.3f}, {y:.3f}, {z:.3f} m, {state}>"

    @property
    def quaternion(self) -> Floats:
        """(4,) float64: the rotation from camera to world as qx, qy, qz, qw."""
        from scipy.spatial.transform import Rotation

        turned = Rotation.from_matrix(self.T_world_camera[:3, :3]).as_quat()
        return np.asarray(turned if turned[3] >= 0.0 else -turned, np.float64)

    @property
    def rotation_std(self) -> float:
        """Degrees: root of the sum of the variances of the three rotations, relative to the reference."""
        return float(np.degrees(np.sqrt(np.trace(self.covariance[:3, :3]))))

    @property
    def translation_std(self) -> float:
        """Metres: root of the sum of the variances of the three translations, relative to the reference."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))
