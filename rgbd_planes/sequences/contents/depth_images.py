"""The depth images among the files of a folder."""

import re
from pathlib import Path

from rgbd_planes._core.text import counted
from rgbd_planes._core.user_warnings import warn_caller
from rgbd_planes.sequences.frames import numbered, some
from rgbd_planes.sequences.images import DEPTH_SUFFIXES

_NO_DEPTH = frozenset(
    (
        *("confidence", "conf", "mask", "masks", "normal", "normals", "color", "colour", "rgb", "infrared", "ir"),
        *("amplitude", "label", "labels", "semantic", "segmentation", "albedo", "intensity"),
    )
)
# Of one frame in several files the first of these is read: what keeps most, before pictures.
_PREFERRED = (".npy", ".npz", ".tif", ".tiff", ".pfm", ".png", ".pgm")
_NAMED = 3  # files


def depth_images(root: Path) -> list[Path]:
    """The depth images of a folder, one for each frame, in the order of their numbers.

    Raises
    ------
    ValueError
        There is none.
    """
    place = _place(root)
    # A broken link stays, so that reading it is an error, and the frames after it keep their numbers.
    found = [file for file in place.iterdir() if file.suffix.lower() in DEPTH_SUFFIXES and not file.is_dir()]
    found = [file for file in found if not file.name.startswith(".")]
    named = [file for file in found if "depth" in file.stem.lower()] or found
    images = [file for file in named if not _NO_DEPTH & set(re.findall("[a-z]+", file.stem.lower()))] or named
    of_frames: dict[str, Path] = {}
    for file in sorted(images, key=lambda file: _PREFERRED.index(file.suffix.lower())):
        of_frames.setdefault(file.stem, file)
    chosen = set(of_frames.values())
    others = numbered(file for file in images if file not in chosen)
    unlike = numbered(file for file in named if file not in set(images))
    if others or unlike:
        parts = []
        if unlike:
            parts.append(f"{counted(len(unlike), 'image')} that by name hold no depth ({_some_names(unlike)})")
        if others:
            parts.append(f"{counted(len(others), 'file')} of frames that are there twice ({_some_names(others)})")
        warn_caller(f"{place}: left out {' and '.join(parts)}")
    return some(numbered(chosen), f"depth images ({', '.join(DEPTH_SUFFIXES)})", place)


def _some_names(files: list[Path]) -> str:
    return ", ".join(file.name for file in files[:_NAMED]) + (", ..." if len(files) > _NAMED else "")


def _place(root: Path) -> Path:
    """The folder of the images: ``depth/``, or the folder itself, or its only subfolder with depth in its name."""
    if (root / "depth").is_dir():
        return root / "depth"
    here = any(file.suffix.lower() in DEPTH_SUFFIXES and not file.name.startswith(".") for file in root.iterdir())
    others = sorted(entry for entry in root.iterdir() if entry.is_dir() and "depth" in entry.name.lower())
    others = [entry for entry in others if not _NO_DEPTH & set(re.findall("[a-z]+", entry.name.lower()))] or others
    if here or not others:
        return root
    if len(others) > 1:
        names = ", ".join(entry.name for entry in others)
        raise ValueError(
            f"{root}: expected depth images in it or in depth/, found the folders {names}: give one of them"
        )
    return others[0]
