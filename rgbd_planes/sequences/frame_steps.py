"""What is done to each frame of a sequence after it is read: units of floats, order of bytes, masks.

Each step can be pickled, for the workers of a batch.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.checks import number
from rgbd_planes._core.files import naming
from rgbd_planes.camera.frame import Frame
from rgbd_planes.sequences.images import DEPTH_SUFFIXES, read_depth

Step = Callable[[Frame], Any]


def after(step: Step, frame: Frame) -> Frame:
    """The frame that a step makes of a frame: its result, or the frame with its result as depth."""
    made = step(frame)
    if isinstance(made, Frame):
        return made
    depth = np.asarray(made)
    if depth.ndim != 2:
        raise TypeError(f"expected a Frame or a depth (H, W) from the function of map, got {type(made).__name__}")
    return replace(frame, depth=depth)


@dataclass(frozen=True)
class FloatUnit:
    """Frames of floats hold so many units per metre."""

    units_per_metre: float

    def __post_init__(self) -> None:
        if not number("float_scale", self.units_per_metre) > 0.0:
            raise ValueError(f"expected float_scale > 0 (units per metre of floats), got {self.units_per_metre!r}")

    def __call__(self, frame: Frame) -> Frame:
        if frame.depth.dtype.kind != "f" or frame.camera.disparity is not None:
            return frame
        return replace(frame, depth=frame.depth / frame.depth.dtype.type(self.units_per_metre))


def swapped_bytes(frame: Frame) -> Frame:
    """A frame of integers whose bytes are in the other order."""
    return replace(frame, depth=frame.depth.byteswap()) if frame.depth.dtype.kind in "ui" else frame


@dataclass(frozen=True)
class Masked:
    """Pixels are missing where an image of the same name is below a threshold."""

    files: Mapping[str, Path]
    threshold: float

    def __call__(self, frame: Frame) -> Frame:
        file = self.files[frame.name]
        mask = read_depth(file)
        if mask.shape != frame.depth.shape:
            with naming(file):
                raise ValueError(f"expected a mask of the frame's shape {frame.depth.shape}, got {mask.shape}")
        return replace(frame, depth=without(frame.depth, mask < self.threshold, frame.camera.disparity is not None))


def without(depth: NDArray[Any], missing: NDArray[np.bool_], is_disparity: bool) -> NDArray[Any]:
    """The depth without some pixels: 0 of integers, NaN of floats and of disparities, of which 0 may be one."""
    if depth.dtype.kind == "f" or is_disparity:
        kept = depth if depth.dtype.kind == "f" else depth.astype(np.float64)
        return np.where(missing, kept.dtype.type(np.nan), kept)
    return np.where(missing, depth.dtype.type(0), depth)


def masks_of(names: Iterable[str], folder: Path) -> dict[str, Path]:
    """For each frame the image in a folder whose name, or the numbers in it, are the frame's.

    Raises
    ------
    ValueError
        A frame has no such image, or several, naming the first.
    """
    images = [file for file in folder.iterdir() if file.suffix.lower() in DEPTH_SUFFIXES and file.name[0] != "."]
    by_stem = {file.stem: file for file in images}
    by_numbers: dict[tuple[int, ...], list[Path]] = {}
    for file in images:
        by_numbers.setdefault(_numbers(file.stem), []).append(file)
    found = {}
    for name in names:
        stem = Path(name).stem
        same = [by_stem[stem]] if stem in by_stem else by_numbers.get(_numbers(stem), [])
        if len(same) != 1:
            what = "none" if not same else ", ".join(sorted(file.name for file in same))
            raise ValueError(
                f"{folder}: expected an image for the frame {name}, of its name or its numbers, got {what}"
            )
        found[name] = same[0]
    return found


def _numbers(stem: str) -> tuple[int, ...]:
    return tuple(int(digits) for digits in re.findall(r"\d+", stem))
