"""How the camera has moved, frame by frame."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.checks import FixedArguments, each_of
from rgbd_planes.camera.camera import Camera, check_camera
from rgbd_planes.camera.frame import Frame, as_numbered_frame
from rgbd_planes.egomotion.alignment import FEWEST, Aligner, Alignment, Reference, exponential, inverse
from rgbd_planes.egomotion.frame_tiles import FrameTiles, rays_of_tiles, tiles_of_frame
from rgbd_planes.egomotion.keyframes import NEW, Keyframe, Keyframes
from rgbd_planes.egomotion.pose import CameraPose
from rgbd_planes.fitting.tiles import TileFitter
from rgbd_planes.segmentation.camera_motion import Motion
from rgbd_planes.segmentation.result import Segmentation
from rgbd_planes.segmentation.segment import MIN_SIZE, check_settings, segment_frame
from rgbd_planes.segmentation.tracking import PlaneTracker, TrackedSegmentation

LEAST_SHARE = 0.25  # of a frame's tiles that must be seen again: it is lost otherwise
FAIR_SHARE = 0.8  # with less, other motions than the prior's are tried as well
ROUGHEST_MATCH = 8.0  # largest scale of residuals, in typical standard deviations of the frame's inverse depth
GIVEN_UP = 10  # frames that are lost one after another: then a new keyframe is where the prior says
# Prior: motions change from one frame to the next by such standard deviations, in rad and m.
PRIOR = np.array([np.radians(1.0)] * 3 + [0.01] * 3)


class Odometry(FixedArguments):
    """Tells where the camera is, one call a frame.

    Each frame is segmented, and its tiles are aligned to the planes of the frame before and of up to four keyframes. A
    frame becomes a keyframe where none of these shows three quarters of it. Where too little is the same, the pose is
    lost for that frame: the search goes on from where the camera was last, and keyframes find it again.

    Parameters
    ----------
    camera : Camera
        Of all frames.
    min_size : int
        Pixels that a plane must have.

    Raises
    ------
    TypeError, ValueError
        It is no camera, or no such size.
    """

    def __init__(self, camera: Camera, *, min_size: int = MIN_SIZE) -> None:
        check_camera(camera)
        self._camera = camera
        self._rays = rays_of_tiles(camera)
        self._fitter = TileFitter(camera, self._rays.tile)
        self._aligner = Aligner(self._rays)
        self._given = check_settings(camera, None, min_size)
        self._tracker = PlaneTracker()
        self._keyframes = Keyframes()
        self._count = self._lost = 0
        self._pose, self._step = np.eye(4), np.eye(4)
        self._tracked_pose = self._pose  # where the tracker's planes were seen from
        self._last: Reference | None = None  # the frame before, unless that is lost

    def update(self, depth: ArrayLike | Frame) -> CameraPose:
        """Take the next frame.

        Parameters
        ----------
        depth : (H, W) array_like, or Frame
            The frame: floats in metres, or integers in the camera's ``depth_scale``; disparities of a camera that has
            ``disparity``.

        Returns
        -------
        CameraPose
            Of the first frame, the identity, with a covariance of zero.

        Raises
        ------
        TypeError, ValueError
            The frame cannot be segmented. It then counts as if it had not been given.

        Warns
        -----
        UserWarning
            Something in the frame is most likely not meant as it is, such as its unit: `fit_tiles` lists what.
        """
        frame = as_numbered_frame(self._count, depth, self._camera)
        found = segment_frame(frame, self._camera, *self._given)
        tiles = tiles_of_frame(self._fitter._fit(frame), found, self._rays)
        return self._place(tiles, found, depth.timestamp if isinstance(depth, Frame) else float("nan"))

    def _place(self, tiles: FrameTiles, found: Segmentation, timestamp: float) -> CameraPose:
        """Take the next frame, whose tiles and planes are known."""
        index, self._count = self._count, self._count + 1
        if not self._keyframes.in_use:
            is_lost = len(tiles.tiles) < FEWEST
            is_keyframe = not is_lost
            if is_keyframe:
                self._keyframes.add(Keyframe(index, Reference(tiles.model, self._pose)))
            known = _Relative(index, np.eye(4), np.zeros((6, 6)), np.zeros((6, 6)), np.empty((0, 6)))
        else:
            alignment = self._locate(tiles, found)
            is_lost = alignment is None
            known = self._astray(index) if alignment is None else self._found(index, alignment)
            is_keyframe = self._keep(index, tiles, is_lost)
        self._last = None if is_lost else Reference(tiles.model, self._pose)
        tracked = self._track(found, is_lost)
        return CameraPose(
            index, timestamp, self._pose.copy(), *known, is_keyframe=is_keyframe, is_lost=is_lost, segmentation=tracked
        )

    def _track(self, found: Segmentation, is_lost: bool) -> TrackedSegmentation:
        """Give planes their ids, by the motion that was found; what is lost counts as seen from the last place."""
        motion = Motion()
        if not is_lost:
            moved = inverse(self._pose) @ self._tracked_pose
            motion = Motion(moved[:3, :3], moved[:3, 3])
            self._tracked_pose = self._pose
        return self._tracker._follow(found, motion)

    def _locate(self, tiles: FrameTiles, found: Segmentation) -> Alignment | None:
        """Align a frame, from where the prior says, and from elsewhere if that shows little of it."""
        references = [keyframe.reference for keyframe in self._keyframes.in_use]
        counted = len(references)
        if self._last is not None and self._last.pose is not references[-1].pose:
            references.append(self._last)

        def align(pose: Floats, to: list[Reference]) -> Alignment | None:
            aligned = self._aligner.align(tiles, to, pose, counted)
            return aligned if aligned is not None and aligned.scale <= ROUGHEST_MATCH * tiles.sigma else None

        best = align(self._pose @ self._step, references)
        if best is None or best.share < FAIR_SHARE:
            # Where the camera was, and where planes say, which need no pixel in common.
            said = self._tracked_pose @ inverse(self._tracker.estimate_motion(found))
            for pose in (self._pose, said):
                best = _better(best, align(pose, references))
        if best is None or best.share < LEAST_SHARE:
            for keyframe in self._keyframes.near(self._pose, tiles.depth):
                best = _better(best, align(keyframe.reference.pose, references[:counted]))
        return best if best is not None and best.share >= LEAST_SHARE else None

    def _found(self, index: int, alignment: Alignment) -> _Relative:
        """Take the pose of an alignment."""
        null = alignment.unobservable
        self._step = _without(null, inverse(self._pose) @ alignment.pose) if not self._lost else np.eye(4)
        self._pose, self._lost = alignment.pose, 0
        used = self._keyframes.in_use
        keyframe = used[int(np.argmax(alignment.shares[: len(used)]))]
        observed = np.linalg.svd(null)[2][len(null) :] if len(null) else np.eye(6)
        covariance = observed.T @ np.linalg.inv(observed @ alignment.information @ observed.T) @ observed
        covariance += null.T @ (null * _prior(index - keyframe.index) @ null.T) @ null
        motion = inverse(keyframe.reference.pose) @ self._pose
        return _Relative(keyframe.index, motion, covariance, alignment.information, null)

    def _astray(self, index: int) -> _Relative:
        """Go on as the prior says: with the motion of the frame before, or, after two frames, without any."""
        self._pose = self._pose @ self._step
        self._step = np.eye(4)
        self._lost += 1
        keyframe = self._keyframes.in_use[-1]
        motion = inverse(keyframe.reference.pose) @ self._pose
        covariance = np.diag(_prior(index - keyframe.index))
        return _Relative(keyframe.index, motion, covariance, np.zeros((6, 6)), np.eye(6))

    def _keep(self, index: int, tiles: FrameTiles, is_lost: bool) -> bool:
        """Make a keyframe of a frame that shows much that the others do not; say whether it is one."""
        if len(tiles.tiles) < FEWEST:
            return False
        if is_lost:
            is_new = self._lost >= GIVEN_UP
            if is_new:
                self._keyframes.in_use.clear()
        else:
            shares = self._keyframes.choose(self._aligner, tiles, self._pose)
            is_new = float(shares.max(initial=0.0)) < NEW
        if is_new:
            self._lost = 0
            self._keyframes.add(Keyframe(index, Reference(tiles.model, self._pose)))
        return is_new


class _Relative(NamedTuple):
    """What is known of a pose relative to a keyframe: fields of `CameraPose`."""

    reference: int
    T_reference_camera: Floats
    covariance: Floats
    information: Floats
    unobservable: Floats


def _prior(frames: int) -> Floats:
    """(6,): variances of δ by the prior after so many frames, each of whose steps differs from the one before."""
    n = max(frames, 1)
    return np.asarray(PRIOR**2 * n * (n + 1) * (2 * n + 1) / 6.0)


def _without(null: Floats, motion: Floats) -> Floats:
    """A motion without its part along some directions."""
    if not len(null):
        return motion
    from scipy.spatial.transform import Rotation

    delta = np.append(Rotation.from_matrix(motion[:3, :3]).as_rotvec(), motion[:3, 3])
    return exponential(delta - null.T @ (null @ delta))


def _better(first: Alignment | None, second: Alignment | None) -> Alignment | None:
    if first is None or second is None:
        return first or second
    return second if second.share > first.share else first


def odometry(frames: Iterable[ArrayLike | Frame], camera: Camera | None = None) -> Iterator[CameraPose]:
    """Tell where the camera was at each frame of a sequence; `Odometry` for frames that come one by one.

    Parameters
    ----------
    frames : iterable of (H, W) array_like, or of Frame
        Read one at a time. A sequence of `open_sequence` gives frames with their cameras.
    camera : Camera, optional
        Of all frames. Without it, the first frame must bring its own.

    Returns
    -------
    iterator of CameraPose
        One for each frame, made when it is asked for.

    Raises
    ------
    TypeError, ValueError
        The camera cannot be used: at once. Or a frame cannot be used: when it is that frame's turn.
    """
    given = None if camera is None else Odometry(camera)
    return _follow(each_of(frames), given)


def _follow(frames: Iterator[Any], follower: Odometry | None) -> Iterator[CameraPose]:
    for frame in frames:
        if follower is None:
            if not isinstance(frame, Frame):
                raise TypeError(f"odometry needs a camera, or frames of a sequence, got {type(frame).__name__}")
            follower = Odometry(frame.camera)
        yield follower.update(frame)
