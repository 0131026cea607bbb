"""Follow planes through a sequence of frames."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes.camera import Camera
from rgbd_planes.metrics import compare_labels, plane_errors
from rgbd_planes.segmentation import SMALLEST, Segmentation, segment

SHARED = 0.25  # of the smaller one's pixels that a plane and its earlier self must share
TURNED = 20.0  # degrees between them, at most
MOVED = 0.15  # difference of their distances from the camera, as a share of it, at most


@dataclass(frozen=True, eq=False, repr=False)
class TrackedSegmentation:
    """The planes of one frame of a sequence.

    Attributes
    ----------
    segmentation : Segmentation
    ids : (N,) int32
        Of each plane: 1, 2, ... in the order in which planes are first seen, the same from frame to frame.
    """

    segmentation: Segmentation
    ids: NDArray[np.int32]

    def __repr__(self) -> str:
        return f"<TrackedSegmentation: {len(self.ids)} planes, newest id {self.ids.max(initial=0)}>"

    @property
    def labels(self) -> NDArray[np.int32]:
        """(H, W) int32: the id of each pixel's plane, 0 for none."""
        return np.append(np.int32(0), self.ids)[self.segmentation.labels]


def segment_sequence(
    frames: Iterable[ArrayLike],
    camera: Camera,
    *,
    noise: Any = None,
    min_size: int = SMALLEST,
    memory: int = 5,
) -> Iterator[TrackedSegmentation]:
    """Segment frame after frame, with ids that stay with their planes.

    A plane is the one seen before that it shares most pixels with, if the two are nearly the same plane: so
    the camera may move by a small part of a plane's size from frame to frame.

    Parameters
    ----------
    frames : iterable of (H, W) array_like
        Read one at a time; see `segment`.
    camera : Camera
    noise, min_size
        See `segment`.
    memory : int
        For how many frames an id is kept at pixels where no plane is found any more.

    Returns
    -------
    iterator of TrackedSegmentation
        One for each frame, made when it is asked for.
    """
    if memory < 0:
        raise ValueError(f"memory must be a number of frames, 0 or more, got {memory}")
    tracker = Tracker(camera, memory)
    return (tracker.follow(segment(frame, camera, noise=noise, min_size=min_size)) for frame in frames)


class Tracker:
    """What was last seen at each pixel, and the planes that it belongs to."""

    def __init__(self, camera: Camera, memory: int) -> None:
        self.shape = camera.shape
        self._memory = memory
        self._seen = np.zeros(camera.shape, np.int32)
        self._age = np.zeros(camera.shape, np.int32)
        self._planes = np.zeros((1, 4))  # by id; 0 is none

    def follow(self, found: Segmentation) -> TrackedSegmentation:
        """Give the planes of the next frame their ids."""
        ids = self._known(found)
        new = ids == 0
        first = len(self._planes)
        ids[new] = np.arange(first, first + np.count_nonzero(new))
        self._planes = np.vstack([self._planes, found.planes[new]])
        self._planes[ids] = found.planes
        tracked = TrackedSegmentation(found, ids)

        labels = tracked.labels
        owned = labels > 0
        self._age += 1
        self._age[owned] = 0
        self._seen[owned] = labels[owned]
        # An id that is in sight elsewhere has left this place.
        self._seen[~owned & ((self._age > self._memory) | np.isin(self._seen, ids))] = 0
        return tracked

    def _known(self, found: Segmentation) -> NDArray[np.int32]:
        """(N,) int32: the id of the plane that each one was, 0 for those not seen before."""
        from scipy.optimize import linear_sum_assignment

        ids = np.zeros(len(found), np.int32)
        before = compare_labels(found.labels, self._seen)
        shared = before.table[1:, 1:]
        if shared.size == 0:
            return ids
        rows, columns = np.nonzero(shared)
        old = self._planes[before.truth_labels[rows]]
        errors = plane_errors(found.planes[before.predicted_labels[columns] - 1], old)
        smaller = np.minimum(before.truth_sizes[rows], before.predicted_sizes[columns])
        same = (
            (shared[rows, columns] >= SHARED * smaller)
            & (errors.angle_deg <= TURNED)
            & (np.abs(errors.offset) <= MOVED * old[:, 3])
        )
        weight = np.zeros(shared.shape)
        weight[rows[same], columns[same]] = shared[rows[same], columns[same]]
        for i, j in zip(*linear_sum_assignment(weight, maximize=True), strict=True):
            if weight[i, j] > 0.0:
                ids[before.predicted_labels[j] - 1] = before.truth_labels[i]
        return ids
