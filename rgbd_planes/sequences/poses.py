"""Camera poses of data sets: matrices, one file a frame, and trajectories, one line a moment."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.files import text_of
from rgbd_planes._core.rotations import as_motion
from rgbd_planes._core.text import counted, reason_of, shown
from rgbd_planes._core.user_warnings import warn_caller

Pose = NDArray[np.float64]

_LONGEST_GAP = 0.15  # s between neighbours in a trajectory, of which there are 10 a second or more
_SAME_MOMENT = 0.02  # s: before the first line and after the last, as the TUM benchmark's own tools associate
_MOST_LINES = 2**20  # 3 hours at 100 a second; each takes half a kilobyte of memory
_LARGEST_FILE = 2**16  # bytes; a matrix has a few hundred


def poses_of_files(files: Iterable[Path | None]) -> list[Pose | None]:
    """Camera-to-world matrices of some frames, each in a text file of 16 numbers, row by row.

    Parameters
    ----------
    files : iterable of Path or None

    Returns
    -------
    list of (4, 4) ndarray of float64, or None
        None without a file, and where the numbers are infinite or NaN, as data sets write of a camera that lost track.

    Warns
    -----
    UserWarning
        Files do not hold a rigid motion; once, with their number and the first reason.
    """
    return _read_each([None if file is None else (lambda file=file: _matrix(file)) for file in files])  # type: ignore[misc]


def motion_of_numbers(numbers: Sequence[float] | Floats) -> Pose | None:
    """A camera-to-world matrix of 16 numbers, row by row; None where they are no rigid motion."""
    matrix = np.array(numbers, np.float64).reshape(4, 4)
    try:
        return _checked(matrix) if np.isfinite(matrix).all() else None
    except ValueError:
        return None


def poses_of_trajectory(
    file: Path, times: Sequence[float], read_line: Callable[[list[float]], tuple[list[float], list[float], bool]]
) -> list[Pose | None]:
    """Camera-to-world matrices at some times, between the two nearest lines of a trajectory.

    Parameters
    ----------
    file : Path
        Lines of numbers, seconds first; a # begins a comment.
    times : sequence of float
        Seconds.
    read_line : callable
        Takes the numbers after the seconds; returns quaternion x y z w, translation, and whether they take the world
        to the camera.

    Returns
    -------
    list of (4, 4) ndarray of float64, or None
        None outside the trajectory, and in its gaps of more than 0.15 s.

    Warns
    -----
    UserWarning
        Lines cannot be read; once, with their number and the first reason.
    """
    from scipy.spatial.transform import Rotation, Slerp

    moments, rotations, places = _lines(file, read_line)
    if not len(moments):
        return [None] * len(times)
    wanted = np.asarray(times, np.float64)
    after = np.clip(np.searchsorted(moments, wanted), 0, len(moments) - 1)
    before = np.where(moments[after] == wanted, after, np.maximum(after - 1, 0))
    with np.errstate(invalid="ignore"):
        inside = (moments[before] <= wanted) & (wanted <= moments[after])
        known = inside & (moments[after] - moments[before] <= _LONGEST_GAP)
        known |= ~inside & (np.abs(wanted - np.clip(wanted, moments[0], moments[-1])) <= _SAME_MOMENT)
    at = np.clip(wanted[known], moments[0], moments[-1])
    poses: list[Pose | None] = [None] * len(wanted)
    if not len(at):
        return poses
    made = np.tile(np.eye(4), (len(at), 1, 1))
    turned = Rotation.from_quat(rotations)
    made[:, :3, :3] = (Slerp(moments, turned)(at) if len(moments) > 1 else turned[[0] * len(at)]).as_matrix()
    for axis in range(3):
        made[:, axis, 3] = np.interp(at, moments, places[:, axis])
    for index, pose in zip(np.flatnonzero(known).tolist(), made, strict=True):
        poses[index] = pose
    return poses


def quaternion_line(numbers: list[float]) -> tuple[list[float], list[float], bool]:
    """A line of the TUM benchmark's: tx ty tz qx qy qz qw, camera to world."""
    if len(numbers) != 7 or not 0.9 < math.hypot(*numbers[3:]) < 1.1:
        raise ValueError("expected seconds tx ty tz qx qy qz qw")
    return numbers[3:], numbers[:3], False


def rotation_vector_line(numbers: list[float]) -> tuple[list[float], list[float], bool]:
    """A line of ARKitScenes': a rotation vector and a translation, world to camera."""
    from scipy.spatial.transform import Rotation

    if len(numbers) != 6:
        raise ValueError("expected seconds, a rotation vector and a translation")
    return Rotation.from_rotvec(numbers[:3]).as_quat().tolist(), numbers[3:], True


def beside(images: Iterable[Path]) -> list[Path | None]:
    """The files of poses that data sets have for images, where they exist.

    ``frame-000000.pose.txt`` for ``frame-000000.depth.png``; ``pose/0.txt`` or ``poses/0.txt`` for ``depth/0.png``.
    """
    return [next((file for file in _possible(image) if file.is_file()), None) for image in images]


def _possible(image: Path) -> list[Path]:
    stem, has_depth, _ = image.name.partition(".depth.")
    if has_depth:
        return [image.with_name(f"{stem}.pose.txt")]
    return [image.parent.parent / folder / f"{image.stem}.txt" for folder in ("pose", "poses")]


def _lines(
    file: Path, read_line: Callable[[list[float]], tuple[list[float], list[float], bool]]
) -> tuple[Floats, Floats, Floats]:
    """(N,) times in order, (N, 4) quaternions and (N, 3) translations, camera to world, of the lines of a file."""
    from scipy.spatial.transform import Rotation

    found: dict[float, tuple[list[float], list[float]]] = {}
    wrong: list[str] = []
    lines = text_of(file, errors="replace").splitlines()
    if len(lines) > _MOST_LINES:
        raise ValueError(f"{shown(file)}: expected at most {_MOST_LINES} lines, got {len(lines)}")
    for number, line in enumerate(lines, start=1):
        words = re.split(r"[\s,]+", line.partition("#")[0].strip())
        if words == [""]:
            continue
        try:
            time, *numbers = map(float, words)
            rotation, place, to_camera = read_line(numbers)
            if not all(map(math.isfinite, (time, *numbers))):
                continue
        except ValueError:
            wrong.append(f"{file}, line {number}: got {line.strip()[:80]!r}")
            continue
        if to_camera:
            back = Rotation.from_quat(rotation).inv()
            rotation, place = back.as_quat().tolist(), (-back.apply(place)).tolist()
        found[time] = rotation, place
    _warn(wrong, "line")
    times = sorted(found)
    rotations = np.array([found[time][0] for time in times]).reshape(-1, 4)
    return np.array(times), rotations, np.array([found[time][1] for time in times]).reshape(-1, 3)


def _read_each(readers: Sequence[Callable[[], Pose] | None]) -> list[Pose | None]:
    poses: list[Pose | None] = []
    wrong: list[str] = []
    for read in readers:
        pose = None
        try:
            pose = None if read is None else read()
        except (OSError, ValueError) as error:
            wrong.append(reason_of(error))
        poses.append(pose if pose is None or np.isfinite(pose).all() else None)
    _warn(wrong, "file")
    return poses


def _warn(wrong: list[str], what: str) -> None:
    if wrong:
        warn_caller(f"{counted(len(wrong), what)} of camera poses cannot be read, their frames have none: {wrong[0]}")


def _matrix(file: Path) -> Pose:
    with file.open("rb") as stream:
        words = stream.read(_LARGEST_FILE).decode("utf-8-sig", errors="replace").replace(",", " ").split()
    if not words:  # of a frame without a pose some write an empty file
        return np.full((4, 4), np.nan)
    try:
        matrix = np.array(words[:16], np.float64).reshape(4, 4)
    except ValueError:
        # Microsoft's C library writes these where others write nan and inf.
        if any("#" in word for word in words):
            return np.full((4, 4), np.nan)
        raise ValueError(f"{file}: expected a 4 x 4 matrix, 16 numbers") from None
    try:
        return _checked(matrix)
    except ValueError as error:
        raise ValueError(f"{file}: {reason_of(error)}") from None


def _checked(matrix: Pose) -> Pose:
    """The matrix, if it is a rigid motion, or not finite."""
    if np.isfinite(matrix).all():
        as_motion("the pose", matrix)
    return matrix
