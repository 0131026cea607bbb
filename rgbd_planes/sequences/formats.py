"""Recognise a data set or a recording by its contents."""

import os
from collections.abc import Callable
from pathlib import Path

from rgbd_planes._core.checks import check_bool, check_choice
from rgbd_planes._core.text import shown
from rgbd_planes.camera.camera import Camera, check_camera
from rgbd_planes.sequences.arkitscenes import arkitscenes
from rgbd_planes.sequences.folder import folder, seven_scenes
from rgbd_planes.sequences.frames import FrameSequence, existing_folder, numbered
from rgbd_planes.sequences.images import RECORDINGS
from rgbd_planes.sequences.matroska import mkv
from rgbd_planes.sequences.rosbag import rosbag
from rgbd_planes.sequences.scannet import scannet, scannet_sens
from rgbd_planes.sequences.tum import icl_nuim, tum

FORMATS: dict[str, Callable[..., FrameSequence]] = {
    "arkitscenes": arkitscenes,
    "folder": folder,
    "icl_nuim": icl_nuim,
    "mkv": mkv,
    "rosbag": rosbag,
    "scannet": scannet,
    "scannet_sens": scannet_sens,
    "seven_scenes": seven_scenes,
    "tum": tum,
}

_WITH_LISTS = ("folder", "tum")
_NAMED = 5  # files that are named of a folder of no known format
# What a folder of each format contains, in the order in which it is looked for.
_SIGNS = {
    "metadata.yaml": "rosbag",
    "camera.json": "folder",
    "lowres_depth": "arkitscenes",
    "intrinsic/intrinsic_depth.txt": "scannet",
    "_info.txt": "scannet",
    "frame-*.depth.png": "seven_scenes",
    "*.gt.freiburg": "icl_nuim",
}


def open_sequence(
    path: str | os.PathLike[str],
    camera: Camera | None = None,
    format: str | None = None,
    *,
    allow_outside: bool = False,
) -> FrameSequence:
    """Open a data set or a recording of any of the formats.

    Parameters
    ----------
    path : folder or file
    camera : Camera, optional
        Instead of the one that the data set states, or that its name implies.
    format : str, optional
        One of `FORMATS`, where the contents could be taken for another. A folder with a ``camera.json`` is
        taken for a plain ``folder``.
    allow_outside : bool
        Whether the ``depth.txt`` of a folder may name files outside it, by ``..`` or a path from the root. A list from
        elsewhere could have any file read.

    Returns
    -------
    FrameSequence

    Raises
    ------
    FileNotFoundError, NotADirectoryError
        There is nothing at `path`, or a file although the format is a folder.
    ModuleNotFoundError
        rosbags, for a bag, or PyAV, for a Matroska recording, is not installed.
    TypeError
        `camera` is not a `Camera`.
    ValueError
        It is of no known format, or damaged.
    """
    if camera is not None:
        check_camera(camera)
    place = Path(path)
    if not place.exists():
        raise FileNotFoundError(f"{shown(path)}: there is no such file or folder")
    if format is None:
        format = _recognise(place, camera is not None)
    check_choice("format", format, tuple(FORMATS))
    if check_bool("allow_outside", allow_outside) and format in _WITH_LISTS:
        return FORMATS[format](place, camera, allow_outside=True)
    return FORMATS[format](place, camera)


def _recognise(path: Path, has_camera: bool) -> str:
    if path.is_file():
        suffix = ".bag" if path.name.endswith(".bag.active") else path.suffix.lower()
        if suffix in RECORDINGS:
            return RECORDINGS[suffix]
        *others, last = RECORDINGS
        raise ValueError(f"{shown(path)}: expected a folder, or a {', '.join(others)} or {last} file")
    existing_folder(path)
    for sign, format in _SIGNS.items():
        if any(path.glob(sign)):
            return format
    if has_camera:
        return "folder"
    if (path / "depth.txt").is_file():
        return "tum"
    if any(file.suffix in (".mcap", ".db3") for file in path.iterdir()):  # its metadata.yaml is missing
        return "rosbag"
    signs = ", ".join(f"{sign} ({format})" for sign, format in _SIGNS.items())
    names = [shown(file.name) for file in numbered(path.iterdir())]
    found = ", ".join(names[:_NAMED]) + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")
    raise ValueError(
        f"{shown(path)}: of no known format: expected {signs} or depth.txt (tum) in it, found {found or 'nothing'}; "
        "for a plain folder of depth images give the camera, or put its camera.json there"
    )
