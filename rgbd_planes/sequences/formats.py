"""Recognise a data set or a recording by what is in it."""

import os
from collections.abc import Callable
from pathlib import Path

from rgbd_planes.camera import Camera
from rgbd_planes.sequences.arkitscenes import arkitscenes
from rgbd_planes.sequences.bag import rosbag
from rgbd_planes.sequences.folder import folder
from rgbd_planes.sequences.frames import FrameSequence
from rgbd_planes.sequences.mkv import mkv
from rgbd_planes.sequences.scannet import scannet, scannet_sens
from rgbd_planes.sequences.seven_scenes import seven_scenes
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


def open_sequence(
    path: str | os.PathLike[str], camera: Camera | None = None, format: str | None = None
) -> FrameSequence:
    """Open a data set or a recording, whichever of the formats it has.

    Parameters
    ----------
    path : folder or file
    camera : Camera, optional
        Instead of the one that the data set states or has by its name.
    format : str, optional
        One of `FORMATS`, where the contents could be taken for another. A folder with a ``camera.json`` is
        taken for a plain ``folder``.

    Returns
    -------
    FrameSequence

    Raises
    ------
    FileNotFoundError, NotADirectoryError
        There is nothing at `path`.
    ValueError
        It is of no known format, or damaged.
    """
    place = Path(path)
    if not place.exists():
        raise FileNotFoundError(f"{path}: there is no such file or folder")
    if format is None:
        format = _recognise(place, camera is not None)
    elif format not in FORMATS:
        raise ValueError(f"format must be one of {', '.join(FORMATS)}, got {format!r}")
    return FORMATS[format](place, camera)


def _recognise(path: Path, has_camera: bool) -> str:
    if path.is_file():
        if path.suffix == ".sens":
            return "scannet_sens"
        if path.suffix in (".bag", ".mcap", ".db3"):
            return "rosbag"
        if path.suffix == ".mkv":
            return "mkv"
        raise ValueError(f"{path}: expected a folder, or a .sens, .bag, .mcap, .db3 or .mkv file")
    if (path / "metadata.yaml").is_file():
        return "rosbag"
    if (path / "camera.json").is_file():
        return "folder"
    if (path / "lowres_depth").is_dir():
        return "arkitscenes"
    if (path / "intrinsic" / "intrinsic_depth.txt").is_file() or (path / "_info.txt").is_file():
        return "scannet"
    if any(path.glob("frame-*.depth.png")):
        return "seven_scenes"
    if any(path.glob("*.gt.freiburg")) and (path / "depth").is_dir():
        return "icl_nuim"
    if has_camera:
        return "folder"
    if (path / "depth.txt").is_file():
        return "tum"
    raise ValueError(
        f"{path}: of no known format ({', '.join(FORMATS)}); for a folder of depth images give the camera, "
        "or put its camera.json there"
    )
