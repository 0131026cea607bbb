"""Follow spheres and cylinders through a sequence of frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.status import Primitive
from rgbd_planes._core.text import counted
from rgbd_planes.primitives.result import PrimitiveFits
from rgbd_planes.segmentation.camera_motion import Motion
from rgbd_planes.segmentation.tracking import MEMORY, Tracker

# One and the same primitive moves by less than this share of its radius from frame to frame, ...
_MOVES = 0.5
# ... turns by less than so much, ...
_TURNS = np.cos(np.radians(15.0))
# ... and has one radius, within this share or so many standard deviations.
_RADIUS, _DEVIATIONS = 0.1, 4.0


@dataclass(frozen=True, eq=False, repr=False)
class TrackedPrimitives:
    """The spheres and cylinders of one frame of a sequence.

    Attributes
    ----------
    fits : PrimitiveFits
    ids : (K,) int32
        Id of each sphere and cylinder: 1, 2, ... in the order in which they are first seen, the same from frame to
        frame. 0 for planes and NONE.
    """

    fits: PrimitiveFits
    ids: NDArray[np.int32]

    def __repr__(self) -> str:
        count = int(np.count_nonzero(self.ids))
        return f"<TrackedPrimitives: {counted(count, 'primitive')}, newest id {self.ids.max(initial=0)}>"

    @property
    def labels(self) -> NDArray[np.int32]:
        """(H, W) int32: the id of each pixel's sphere or cylinder, 0 for none."""
        return np.append(np.int32(0), self.ids)[self.fits.labels]

    def to_table(self) -> dict[str, NDArray[Any]]:
        """Return one row per label as `PrimitiveFits.to_table` does, with the column id before its others."""
        return {"id": self.ids.copy(), **self.fits.to_table()}


class _Known(NamedTuple):
    """Primitives of earlier frames, in the coordinates of the last one's camera."""

    ids: NDArray[Any]
    kind: NDArray[Any]
    centre: NDArray[Any]
    axis: NDArray[Any]
    radius: NDArray[Any]
    radius_std: NDArray[Any]
    unseen: NDArray[Any]  # frames since it was seen

    def moved(self, motion: Floats) -> _Known:
        turn, step = motion[:3, :3], motion[:3, 3]
        return self._replace(centre=self.centre @ turn.T + step, axis=self.axis @ turn.T, unseen=self.unseen + 1)

    def only(self, chosen: NDArray[np.bool_]) -> _Known:
        return _Known(*(values[chosen] for values in self))

    def and_those(self, others: _Known) -> _Known:
        return _Known(*(np.concatenate([own, its]) for own, its in zip(self, others, strict=True)))


def _known_of(fits: PrimitiveFits, ids: NDArray[np.int32]) -> _Known:
    everything = _Known(
        ids, fits.kind, fits.centre, fits.axis, fits.radius, fits.radius_std, np.zeros(len(ids), np.int64)
    )
    return everything.only(fits.kind >= Primitive.SPHERE)


class PrimitiveTracker(Tracker):
    """Gives spheres and cylinders ids that they keep from frame to frame.

    Two are the same if they are of one kind and one radius, and if the later one is where the earlier one was. Given
    how the camera moves, earlier ones move with it.

    Parameters
    ----------
    memory : int
        For how many frames one that is out of sight is remembered.

    Raises
    ------
    TypeError, ValueError
        `memory` is no whole number, or below 0.
    """

    def __init__(self, memory: int = MEMORY) -> None:
        super().__init__(memory)
        nothing = np.empty(0)
        self._known = _Known(
            nothing.astype(np.int32), nothing.astype(np.uint8), np.empty((0, 3)), np.empty((0, 3)), nothing, nothing,
            nothing.astype(np.int64),
        )  # fmt: skip

    def follow(self, fits: PrimitiveFits, motion: ArrayLike | None = None) -> TrackedPrimitives:
        """Give the spheres and cylinders of the next frame their ids.

        Parameters
        ----------
        fits : PrimitiveFits
        motion : (4, 4) array_like, optional
            How the camera has moved since the frame before: X now is R·X + t of X before. `PlaneTracker` estimates it.
            By default it stands still: then nothing may move by more than half of its radius.

        Returns
        -------
        TrackedPrimitives

        Raises
        ------
        TypeError, ValueError
            It is no `PrimitiveFits`, or the motion is no rigid one.
        """
        if not isinstance(fits, PrimitiveFits):
            raise TypeError(f"expected PrimitiveFits, got {type(fits).__name__}")
        moved = np.eye(4) if motion is None else Motion.of("motion", motion).matrix
        before, ids = self._known.moved(moved), np.zeros(len(fits), np.int32)
        rows = np.flatnonzero(fits.kind >= Primitive.SPHERE)
        seen = np.zeros(len(before.ids), np.bool_)
        for i, k in _matches(before, _known_of(fits, ids)):
            ids[rows[k]], seen[i] = before.ids[i], True
        self._number(ids, rows[ids[rows] == 0])
        remembered = before.only(~seen & (before.unseen <= self._memory))
        self._known = remembered.and_those(_known_of(fits, ids))
        return TrackedPrimitives(fits, ids)


def _matches(before: _Known, now: _Known) -> list[tuple[int, int]]:
    """Pairs of those that are the same, the nearest first; each is in one pair at most."""
    offset = now.centre - before.centre[:, None]  # (N, M, 3)
    is_cylinder = now.kind == Primitive.CYLINDER
    along = np.where(is_cylinder, (offset * now.axis).sum(axis=2), 0.0)
    across = np.linalg.norm(offset - np.where(is_cylinder[:, None], along[..., None] * now.axis, 0.0), axis=2)
    turned = np.abs(before.axis @ now.axis.T)  # a cylinder's axis has no sign
    change = np.abs(now.radius - before.radius[:, None])
    deviation = np.hypot(now.radius_std, before.radius_std[:, None])
    alike = (before.kind[:, None] == now.kind) & (across < _MOVES * now.radius)
    alike &= ~is_cylinder | (turned > _TURNS)
    alike &= change < np.maximum(_RADIUS * now.radius, _DEVIATIONS * deviation)
    apart = np.where(alike, np.linalg.norm(offset, axis=2), np.inf)
    pairs = []
    while apart.size and np.isfinite(apart).any():
        i, k = (int(place) for place in np.unravel_index(np.argmin(apart), apart.shape))
        pairs.append((i, k))
        apart[i], apart[:, k] = np.inf, np.inf
    return pairs
