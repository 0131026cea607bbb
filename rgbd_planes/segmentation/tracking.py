"""Follow planes through a sequence of frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes.camera import Camera
from rgbd_planes.checks import check_whole, each_of
from rgbd_planes.metrics import plane_errors
from rgbd_planes.segmentation.result import Segmentation
from rgbd_planes.segmentation.segment import SMALLEST, check_settings, segment
from rgbd_planes.wording import counted

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rgbd_planes.noise.model import NoiseModel

SHARED = 0.25  # share of the smaller one's pixels that a plane and its earlier self must have in common
TURNED = 20.0  # degrees between them, at most
MOVED = 0.15  # at most, difference of their distances from the camera, or of 1/Z where they were seen, as a share of it

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
        from rgbd_planes.preview import segments_html

        return segments_html(self.segmentation, repr(self), self.ids)

    @property
    def labels(self) -> NDArray[np.int32]:
        """(H, W) int32: the id of each pixel's plane, 0 for none."""
        return np.append(np.int32(0), self.ids)[self.segmentation.labels]

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
    frames: Iterable[ArrayLike],
    camera: Camera,
    *,
    noise: NoiseModel | float | Callable[[NDArray[np.float64]], ArrayLike] | None = None,
    min_size: int = SMALLEST,
    memory: int = MEMORY,
) -> Iterator[TrackedSegmentation]:
    """Segment frame after frame, with ids that stay with their planes.

    A plane is identified with the earlier one that it shares most pixels with, if the two are nearly the same plane: so
    the camera may move by a small part of a plane's size from frame to frame, and a plane that was covered or lost for
    a while comes back under its old id.

    Parameters
    ----------
    frames : iterable of (H, W) array_like
        Read one at a time; see `segment`.
    camera : Camera
    noise, min_size
        See `segment`.
    memory : int
        For how many frames a plane that is out of sight is remembered at its last place.

    Returns
    -------
    iterator of TrackedSegmentation
        One for each frame, made when it is asked for.

    Raises
    ------
    TypeError, ValueError
        As `segment`: at once for an invalid argument, and for a frame when it is that frame's turn; no more come then.
    """
    check_settings(camera, noise, min_size)
    tracker = Tracker(check_whole("memory", memory, 0, "whole number of frames"))
    return (tracker.follow(segment(frame, camera, noise=noise, min_size=min_size)) for frame in each_of(frames))


class Tracker:
    """The planes that are remembered, and where each of them was last seen, in frames of one size."""

    def __init__(self, memory: int) -> None:
        self._memory = memory
        self._newest = 0
        self._forget((0, 0))

    def _forget(self, shape: tuple[int, int]) -> None:
        self._shape = shape
        # For each remembered plane, in the order of the ids.
        self._ids = np.zeros(0, np.int32)
        self._planes = np.zeros((0, 4))
        self._missed = np.zeros(0, np.int64)  # frames since it was seen
        self._places: list[NDArray[np.intp]] = []  # indices of squares of 2x2 pixels

    def follow(self, found: Segmentation) -> TrackedSegmentation:
        """Give the planes of the next frame their ids: new ones if its size differs from the one before."""
        if found.labels.shape != self._shape:
            self._forget(found.camera.shape)
        labels = _of_fours(found.labels).ravel()
        ids = self._known(found, labels)
        new = np.flatnonzero(ids == 0)
        ids[new] = self._newest + 1 + np.arange(len(new))
        self._newest += len(new)
        # NumPy sorts integers of up to 16 bits by their digits, which takes a fifth of the time.
        by_label = np.argsort(labels.astype(np.min_scalar_type(len(found))), kind="stable")
        ends = np.searchsorted(labels[by_label], np.arange(len(found) + 1), side="right")
        seen = [by_label[ends[i] : ends[i + 1]] for i in range(len(found))]
        # Those in sight, with any pixels at all, and those that have not been out of sight for too long.
        there = [i for i, place in enumerate(seen) if len(place)]
        lost = np.flatnonzero(~np.isin(self._ids, ids) & (self._missed < self._memory))
        places = [seen[i] for i in there] + [self._places[i] for i in lost]
        every = np.concatenate([ids[there], self._ids[lost]])
        order = np.argsort(every)
        self._ids = every[order]
        self._planes = np.concatenate([found.planes[there], self._planes[lost]])[order]
        self._missed = np.concatenate([np.zeros(len(there), np.int64), self._missed[lost] + 1])[order]
        self._places = [places[i] for i in order]
        return TrackedSegmentation(found, ids)

    def _known(self, found: Segmentation, labels: NDArray[np.int32]) -> NDArray[np.int32]:
        """(N,) int32: the id of the plane that each one was, 0 for those not seen before."""
        from scipy.optimize import linear_sum_assignment

        ids = np.zeros(len(found), np.int32)
        if not len(self._ids) or not len(found):
            return ids
        count = len(found) + 1
        lengths = np.array([len(place) for place in self._places])
        places = np.concatenate(self._places)
        pairs = np.repeat(np.arange(len(lengths)) * count, lengths) + labels[places]

        def sums(weights: NDArray[np.float64] | None = None) -> NDArray[Any]:
            return np.bincount(pairs, weights, len(lengths) * count).reshape(-1, count)[:, 1:]

        shared = sums()
        rows, columns = np.nonzero(shared)
        old, pixels = self._planes[rows], shared[rows, columns]
        errors = plane_errors(found.planes[columns], old)
        # For a plane seen at a slant, a small turn changes the distance a lot, and 1/Z where it is hardly; for one that
        # the camera turns away from it is the other way round.
        x, y = (
            sums(table[::2, ::2].ravel()[places])[rows, columns] / pixels
            for table in (found.camera.tan_x, found.camera.tan_y)
        )
        before, now = (a[:, 0] * x + a[:, 1] * y + a[:, 2] for a in (-old[:, :3] / old[:, 3:], found.alpha[columns]))
        near = (np.abs(errors.offset) <= MOVED * old[:, 3]) | (np.abs(now - before) <= MOVED * before)
        smaller = np.minimum(lengths[rows], np.bincount(labels, minlength=count)[1:][columns])
        same = (pixels >= SHARED * smaller) & (errors.angle_deg <= TURNED) & near
        # Planes in sight take precedence over those that were covered.
        weight = np.where(same, pixels / (1.0 + self._missed[rows]), 0.0)
        table = np.zeros(shared.shape)
        table[rows, columns] = weight
        for i, j in zip(*linear_sum_assignment(table, maximize=True), strict=True):
            if table[i, j] > 0.0:
                ids[j] = self._ids[i]
        return ids


def _of_fours(labels: NDArray[np.int32]) -> NDArray[np.int32]:
    """The label of each square of 2x2 pixels: that of its first pixel that has one, since others may be missing."""
    of_fours = labels[::2, ::2].copy()
    for row, column in ((0, 1), (1, 0), (1, 1)):
        other = labels[row::2, column::2]
        own = of_fours[: other.shape[0], : other.shape[1]]
        np.copyto(own, other, where=own == 0)
    return of_fours
