"""Follow planes through a sequence of frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.arrays import Indices
from rgbd_planes._core.checks import FixedArguments, check_whole, each_of
from rgbd_planes._core.text import counted
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.frame import Frame, as_numbered_frame
from rgbd_planes.segmentation.camera_motion import Motion
from rgbd_planes.segmentation.known_planes import KnownPlanes, View, motion_since, recognise, remember
from rgbd_planes.segmentation.result import Segmentation, no_segmentation
from rgbd_planes.segmentation.segment import MIN_SIZE, check_settings, segment_frame

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rgbd_planes.noise.model import NoiseModel

MEMORY = 30  # frames: a second


@dataclass(frozen=True, eq=False, repr=False)
class TrackedSegmentation:
    """The planes of one frame of a sequence.

    Attributes
    ----------
    segmentation : Segmentation
    ids : (N,) int32
        Id of each plane: 1, 2, ... in the order in which planes are first seen, the same from frame to frame.
    """

    segmentation: Segmentation
    ids: NDArray[np.int32]

    def __repr__(self) -> str:
        return f"<TrackedSegmentation: {counted(len(self.ids), 'plane')}, newest id {self.ids.max(initial=0)}>"

    def _repr_html_(self) -> str:
        """What a notebook shows: the counts and a small picture, in the colours of the ids."""
        from rgbd_planes.plotting.preview import segments_html

        return segments_html(self.segmentation, repr(self), self.ids)

    @property
    def labels(self) -> NDArray[np.int32]:
        """(H, W) int32: the id of each pixel's plane, 0 for none."""
        return np.append(np.int32(0), self.ids)[self.segmentation.labels]

    def to_table(self) -> dict[str, NDArray[Any]]:
        """Return one row per plane as `Segmentation.to_table` does, with the column id before its others."""
        return {"id": self.ids.copy(), **self.segmentation.to_table()}

    def plot(self, depth: ArrayLike | None = None, figure: Figure | None = None) -> Figure:
        """Draw the planes as `Segmentation.plot` does, coloured and numbered by their ids.

        Parameters
        ----------
        depth : (H, W) array_like, optional
            The frame that was segmented, for its relief.
        figure : matplotlib Figure, optional
            Drawn into; a new one by default.
        """
        from rgbd_planes.plotting.segments import plot_segments

        return plot_segments(self.segmentation, depth, figure, self.ids)


def segment_sequence(
    frames: Iterable[ArrayLike | Frame],
    camera: Camera | None = None,
    *,
    noise: NoiseModel | float | Callable[[NDArray[np.float64]], ArrayLike] | None = None,
    min_size: int = MIN_SIZE,
    memory: int = MEMORY,
) -> Iterator[TrackedSegmentation]:
    """Segment frame after frame, with ids that stay with their planes.

    The largest planes tell how the camera has moved since the last frame, and so where the earlier ones should be. Each
    plane is identified with the one that it shares most pixels with, if the two are nearly the same plane. So the
    camera may move as long as it sees much of the same planes again. A plane that was covered, out of the image or lost
    for a while comes back under its old id. Where hardly any is seen again, as after a cut or in a frame of another
    camera, planes are new unless they are just where one was. The earlier ones are remembered as they were.

    Parameters
    ----------
    frames : iterable of (H, W) array_like, or of Frame
        Depth frames, read one at a time. A sequence of `open_sequence` gives frames with their cameras.
    camera : Camera, optional
        The camera of all frames. A `Frame`'s camera must have the same rays and unit. Without it, each frame must be a
        `Frame`.
    noise : float, function or NoiseModel, optional
        Standard deviation of inverse depth in 1/m. By default the frame tells it, or the camera's noise model.
    min_size : int
        Pixels that a plane must have.
    memory : int
        For how many frames a plane that is out of sight is remembered, and the covered part of a plane in sight.

    Returns
    -------
    iterator of TrackedSegmentation
        One for each frame, made when it is asked for.

    Raises
    ------
    TypeError, ValueError
        An argument cannot be used: at once. Or a frame cannot be used: when it is that frame's turn, and no more come
        then.
    """
    check_settings(camera, noise, min_size)
    tracker = PlaneTracker(memory)

    def follow(number: int, frame: Any) -> TrackedSegmentation:
        its_camera = _camera_of(frame) if camera is None else camera
        given, least = check_settings(its_camera, noise, min_size)
        return tracker.follow(segment_frame(as_numbered_frame(number, frame, its_camera), its_camera, given, least))

    return (follow(number, frame) for number, frame in enumerate(each_of(frames)))


def _camera_of(frame: Any) -> Camera:
    if not isinstance(frame, Frame):
        raise TypeError(f"segment_sequence needs a camera, or frames of a sequence, got {type(frame).__name__}")
    return frame.camera


class Tracker(FixedArguments):
    """What gives ids in the order in which things are first seen.

    Parameters
    ----------
    memory : int
        For how many frames something that is out of sight is remembered.
    """

    def __init__(self, memory: int) -> None:
        self._memory = check_whole("memory", memory, 0, "whole number of frames")
        self._newest = 0

    @property
    def newest(self) -> int:
        """The id that was given last: how many there were so far."""
        return self._newest

    def _number(self, ids: NDArray[np.int32], new: Indices) -> None:
        """Give what is new, by its indices in ``ids``, the next ids."""
        ids[new] = self._newest + 1 + np.arange(len(new))
        self._newest += len(new)


class PlaneTracker(Tracker):
    """Gives planes the ids of `segment_sequence`, where frames come one by one and there is nothing to iterate over.

    Parameters
    ----------
    memory : int
        For how many frames a plane that is out of sight is remembered, and the covered part of a plane in sight.

    Raises
    ------
    TypeError, ValueError
        `memory` is no whole number, or below 0.
    """

    def __init__(self, memory: int = MEMORY) -> None:
        super().__init__(memory)
        self._shape = (0, 0)
        self._known = KnownPlanes()

    def follow(self, found: Segmentation, motion: ArrayLike | None = None) -> TrackedSegmentation:
        """Give the planes of the next frame their ids: new ones if its size differs from the one before.

        Parameters
        ----------
        found : Segmentation
        motion : (4, 4) array_like, optional
            How the camera has moved since the frame before, where that is known: X now is R·X + t of X before. By
            default the largest planes tell.

        Returns
        -------
        TrackedSegmentation

        Raises
        ------
        TypeError, ValueError
            It is no `Segmentation`, or the motion is no rigid one.
        """
        if not isinstance(found, Segmentation):
            raise no_segmentation(found)
        return self._follow(found, None if motion is None else Motion.of("motion", motion))

    def _follow(self, found: Segmentation, moved: Motion | None) -> TrackedSegmentation:
        """Follow planes by a motion that needs no check."""
        if found.labels.shape != self._shape:
            self._shape, self._known = found.camera.shape, KnownPlanes()
        view, ids = View.of(found), np.zeros(len(found), np.int32)
        if len(self._known.ids) and len(found):
            self._known, matches = recognise(self._known, view, moved)
            ids[matches.now] = self._known.ids[matches.before]
        elif moved is not None:
            self._known = self._known.moved(moved)
        self._number(ids, np.flatnonzero(ids == 0))
        self._known = remember(self._known, view, ids, self._memory)
        return TrackedSegmentation(found, ids)

    def estimate_motion(self, found: Segmentation) -> NDArray[np.float64]:
        """Return (4, 4): how the camera has moved since the frame before, as the largest planes tell; coarse."""
        return motion_since(self._known, View.of(found)).matrix
