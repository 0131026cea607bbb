"""A depth frame of a sequence, with the camera that took it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.files import naming
from rgbd_planes._core.text import shown
from rgbd_planes.camera.camera import Camera, quarter_turns
from rgbd_planes.camera.depth_frame import DepthFrame, as_depth_frame


@dataclass(frozen=True, eq=False, repr=False)
class Frame:
    """A depth frame with all that is needed to fit it.

    Attributes
    ----------
    depth : (H, W) array
        As stored: integers in the camera's ``depth_scale``, floats in metres, or disparities.
    camera : Camera
    timestamp : float
        Seconds on the recording's own clock; NaN where it states none.
    name : str
        The frame's name in its data set.
    pose : (4, 4) array of float64, or None
        Camera to world in metres, as the data set states it: X_world = pose · (X, Y, Z, 1). None where it states none.
    """

    depth: NDArray[Any]
    camera: Camera
    timestamp: float
    name: str
    pose: NDArray[np.float64] | None = None

    def rotated(self, degrees: int) -> Frame:
        """The frame turned counter-clockwise by 0, 90, 180 or 270 degrees, with its camera and its pose.

        Raises
        ------
        TypeError, ValueError
            The angle is none of these.
        """
        quarters = quarter_turns(degrees)
        pose = self.pose
        if pose is not None:
            turn = np.eye(4)
            for _ in range(quarters):
                turn[:2, :2] = [[0.0, 1.0], [-1.0, 0.0]] @ turn[:2, :2]
            pose = pose @ turn.T
        depth = np.rot90(self.depth, quarters)
        return replace(self, depth=depth, camera=self.camera.rotated(degrees), pose=pose)

    def flipped(self, direction: str) -> Frame:
        """The frame mirrored, "horizontal" or "vertical", with its camera; each pixel keeps its ray.

        Raises
        ------
        ValueError
            The direction is neither.
        """
        camera = self.camera.flipped(direction)
        return replace(self, depth=np.flip(self.depth, 1 if direction == "horizontal" else 0), camera=camera)

    def __repr__(self) -> str:
        time = "" if math.isnan(self.timestamp) else f", {self.timestamp:.6f} s"
        return f"<Frame: {shown(self.name)}, {self.camera.width} x {self.camera.height} pixels{time}>"


def depth_of(frame: ArrayLike | Frame, camera: Camera) -> ArrayLike:
    """The depth of a frame of a sequence, taken by this camera; anything else is a depth itself.

    Raises
    ------
    ValueError
        The frame's own camera has other rays or another unit: its depth would be taken for what it is not.
    """
    if not isinstance(frame, Frame):
        return frame
    own = frame.camera
    if own is not camera:
        units = (own.depth_scale, own.disparity)
        if own._lens != camera._lens or units not in ((None, None), (camera.depth_scale, camera.disparity)):
            raise ValueError(
                f"expected frames of the camera that is given, got {shown(frame.name)}, whose own camera has other "
                "intrinsics or another unit; if it is the given one's all the same, give frame.depth"
            )
    return frame.depth


def as_numbered_frame(number: int, frame: ArrayLike | Frame, camera: Camera) -> DepthFrame:
    """`as_depth_frame` of one of many: an error begins with its number, from 0."""
    with naming(f"frame {number}"):
        return as_depth_frame(depth_of(frame, camera), camera)
