"""The TUM RGB-D benchmark, and ICL-NUIM in its form."""

import math
import os
import re
from pathlib import Path, PureWindowsPath

from rgbd_planes._core.checks import check_bool
from rgbd_planes._core.files import text_of
from rgbd_planes._core.text import shown
from rgbd_planes.camera import presets
from rgbd_planes.camera.camera import Camera
from rgbd_planes.sequences.contents.calibration import calibration_beside, calibration_files
from rgbd_planes.sequences.frames import FrameSequence, existing_folder, image_sequence, numbered, some
from rgbd_planes.sequences.poses import poses_of_trajectory, quaternion_line

_MOST_LISTED = 2**20  # 9 hours; each takes half a kilobyte of memory
_NUMBER = re.compile(r"freiburg([123])|(?:^|[^a-z])fr([123])(?![0-9])")
_LATEST = 2e10  # seconds since 1970, after the year 2600; milliseconds of today are more
_CAMERAS = {"1": presets.tum_freiburg1, "2": presets.tum_freiburg2, "3": presets.tum_freiburg3}


def tum(path: str | os.PathLike[str], camera: Camera | None = None, *, allow_outside: bool = False) -> FrameSequence:
    """Open a sequence of the TUM RGB-D benchmark (Sturm et al. 2012).

    Parameters
    ----------
    path : folder
        With ``depth.txt``: lines "seconds file", and comments.
    camera : Camera, optional
        If not given, that of a calibration in the folder, or else that of freiburg1, 2 or 3 (`presets`), whichever is
        in the folder's name.
    allow_outside : bool
        Whether ``depth.txt`` may name files outside the folder, by ``..`` or a path from the root.

    Returns
    -------
    FrameSequence
        Seconds since 1970. With the poses of ``groundtruth.txt``, between its two nearest lines.

    Raises
    ------
    NotADirectoryError, FileNotFoundError, ValueError
        It is not such a folder, its ``depth.txt`` is damaged, or its name does not tell the camera.
    """
    root = existing_folder(path)
    said = ""
    if camera is None and calibration_files(root):
        camera = calibration_beside(root, read_index(root / "depth.txt", allow_outside)[1], presets.tum_freiburg1())
    if camera is None:
        # The folder may be a link to one of another name.
        found = _NUMBER.findall(root.name) or _NUMBER.findall(root.resolve().name)
        if not found:
            raise ValueError(
                f"{shown(root)}: expected freiburg1, freiburg2 or freiburg3 in the folder's name, by which the "
                "calibration is known; or give the camera"
            )
        number = found[-1][0] or found[-1][1]
        camera, said = _CAMERAS[number](), f"calibration of presets.tum_freiburg{number}"
    times, files = read_index(root / "depth.txt", allow_outside)
    truth = root / "groundtruth.txt"
    poses = poses_of_trajectory(truth, times, quaternion_line) if truth.is_file() else None
    return image_sequence(files, camera, root, times, poses, calibration=said)


def icl_nuim(path: str | os.PathLike[str], camera: Camera | None = None) -> FrameSequence:
    """Open a trajectory of ICL-NUIM (Handa et al. 2014) in its "TUM RGB-D compatible PNGs" form.

    Parameters
    ----------
    path : folder
        With ``depth/0.png``, ``depth/1.png``, ...
    camera : Camera, optional
        If not given, that of a calibration in the folder, or else `presets.icl_nuim`, whose fy is negative.

    Returns
    -------
    FrameSequence
        Without times: the data set numbers its frames.

    Raises
    ------
    NotADirectoryError, ValueError
        It is not such a folder.
    """
    root = existing_folder(path)
    files = some(numbered((root / "depth").glob("*.png")), "depth/*.png", root)
    preset, said = presets.icl_nuim(), ""
    if camera is None:
        camera = calibration_beside(root, files, preset)
    if camera is None:
        camera, said = preset, "calibration of presets.icl_nuim"
    return image_sequence(files, camera, root, calibration=said)


def read_index(path: Path, allow_outside: bool = False) -> tuple[list[float], list[Path]]:
    """Times and files of the lines "seconds file" of an index; a # at the start of a word begins a comment.

    Files outside the index's folder are refused unless allowed: a list from elsewhere would read what it likes.
    """
    check_bool("allow_outside", allow_outside)
    if not path.is_file():
        raise FileNotFoundError(f'{shown(path.parent)}: expected {path.name}, lines "seconds file", found none')
    times: list[float] = []
    files: list[Path] = []
    for number, line in enumerate(text_of(path, errors="replace").splitlines(), start=1):
        words = re.split(r"(?:^|\s)#", line, maxsplit=1)[0].split(maxsplit=1)
        if not words:
            continue
        try:
            time, name = float(words[0]), words[1].strip()
        except (IndexError, ValueError):
            time, name = math.nan, ""
        if time > _LATEST:
            raise ValueError(
                f"{shown(path)}, line {number}: expected seconds, got {words[0]}: is it in "
                f"{'nanoseconds' if time > 1e17 else 'microseconds' if time > 1e14 else 'milliseconds'}?"
            )
        if not math.isfinite(time):
            raise ValueError(f'{shown(path)}, line {number}: expected "seconds file", got {line.strip()!r}')
        if not allow_outside and _is_outside(name):
            raise ValueError(
                f"{shown(path)}, line {number}: expected a file in the folder of the list, got {name!r}: "
                "allow_outside=True takes it"
            )
        if len(files) == _MOST_LISTED:
            raise ValueError(f"{shown(path)}: expected a list of at most {_MOST_LISTED} files")
        times.append(time)
        files.append(path.parent / name)
    some(files, 'lines "seconds file"', path)
    return times, files


def _is_outside(name: str) -> bool:
    """Whether a path leads out of the folder that it begins in, taken as the path of any system."""
    parts = re.split(r"[/\\]", name)
    return ".." in parts or parts[0] == "" or PureWindowsPath(name).drive != ""
