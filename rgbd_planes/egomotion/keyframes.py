"""Frames that others are aligned to, and which of them a frame should see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rgbd_planes._core.arrays import Floats
from rgbd_planes.egomotion.alignment import Aligner, Reference
from rgbd_planes.egomotion.frame_tiles import FrameTiles

NEW = 0.75  # a frame becomes a keyframe if no other one has matches of this share of its tiles
SEEN = 0.15  # keyframes with matches of this share are aligned to
MOST = 4  # keyframes at once: the oldest of them, from which errors have grown least, and the best
NEAREST = 8  # keyframes whose matches are counted
WIDEST = 60.0  # degrees between viewing directions


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A frame that others are aligned to, with its number."""

    index: int
    reference: Reference


class Keyframes:
    """All keyframes of a sequence, and those in use.

    Attributes
    ----------
    in_use : list of Keyframe
        The oldest first.
    """

    def __init__(self) -> None:
        self._all: list[Keyframe] = []
        self.in_use: list[Keyframe] = []

    def add(self, keyframe: Keyframe) -> None:
        """Add one, and use it."""
        self._all.append(keyframe)
        self.in_use = [*self.in_use[: MOST - 1], keyframe]

    def choose(self, aligner: Aligner, frame: FrameTiles, pose: Floats) -> Floats:
        """Use the keyframes that a frame at a pose has most in common with; return their shares of its tiles."""
        near = self.near(pose, frame.depth)
        shares = aligner.shares(frame, [keyframe.reference for keyframe in near], pose)
        if not len(shares):
            return shares
        best = int(np.argmax(shares))
        seen = [i for i in range(len(near)) if shares[i] >= SEEN and i != best]
        chosen = sorted([best, *sorted(seen, key=lambda i: near[i].index)[: MOST - 1]], key=lambda i: near[i].index)
        self.in_use = [near[i] for i in chosen]
        return np.asarray(shares[chosen])

    def near(self, pose: Floats, depth: float) -> list[Keyframe]:
        """The keyframes that look the same way from nearby, the nearest first."""
        if not self._all:
            return []
        poses = np.array([keyframe.reference.pose for keyframe in self._all])
        angle = np.arccos(np.clip(poses[:, :3, 2] @ pose[:3, 2], -1.0, 1.0))
        distance = np.linalg.norm(poses[:, :3, 3] - pose[:3, 3], axis=1) / depth
        order = np.argsort(distance + angle, kind="stable")
        return [self._all[i] for i in order[angle[order] <= np.radians(WIDEST)][:NEAREST]]
