"""What a part of a frame is, and why it is none."""

import enum

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.text import two_digits


class TileStatus(enum.IntEnum):
    """Whether a tile has a plane, or why not."""

    OK = 0
    """Fitted."""
    TOO_FEW = 1
    """Fewer than three valid pixels, or a larger share missing than ``max_missing``."""
    DEGENERATE = 2
    """The valid pixels do not determine a plane: collinear, or the plane passes through the camera centre. (A row of
    pixels that a lens bends counts as determining one, however badly.)"""
    ROUGH = 3
    """Fitted, and it keeps its plane, but its residual is above ``max_error`` or what the noise explains."""


class Reason(enum.IntEnum):
    """Why a pixel belongs to a plane, or to none."""

    PLANE = 0
    """It belongs to one."""
    MISSING = 1
    """Nothing was measured."""
    UNCLAIMED = 2
    """No plane nearby fits it."""
    SMALL = 3
    """Its region has too few pixels."""
    ROUGH = 4
    """Its region is not a plane: the residual is too large."""
    NARROW = 5
    """Its region is a strip of a few pixels, as depth edges make."""
    CURVED = 6
    """Its region is part of a curved surface."""
    NOISE = 7
    """Its region is no more of a plane than noise makes by itself."""


class Primitive(enum.IntEnum):
    """What a label's surface is."""

    NONE = 0
    """None of these: the noise explains no fit, or the pixels determine none."""
    PLANE = 1
    SPHERE = 2
    CYLINDER = 3


def summary_of(status: NDArray[np.uint8], residuals: Floats) -> str:
    """Counts of each `TileStatus` that occurs, and the median of the residuals of what was fitted, in metres."""
    counts = {kind.name: np.count_nonzero(status == kind) for kind in TileStatus}
    parts = [f"{count} {name}" for name, count in counts.items() if count]
    if residuals.size:
        parts.append(f"median rmse {two_digits(1e3 * np.median(residuals))} mm")
    return ", ".join(parts) or "nothing to fit"
