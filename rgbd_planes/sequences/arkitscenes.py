"""Apple's ARKitScenes."""

import bisect
import math
import os
from pathlib import Path

from rgbd_planes._core.files import text_of
from rgbd_planes._core.text import shown
from rgbd_planes.camera.camera import Camera
from rgbd_planes.sequences.frames import FrameEntry, FrameSequence, existing_folder, numbered, some
from rgbd_planes.sequences.images import read_depth
from rgbd_planes.sequences.poses import poses_of_trajectory, rotation_vector_line

# Images and calibrations of one moment may be named a few milliseconds apart; frames are 16 ms apart.
_SAME_MOMENT = 0.0085


def arkitscenes(path: str | os.PathLike[str], camera: Camera | None = None) -> FrameSequence:
    """Open a scan of ARKitScenes (Baruch et al. 2021): LiDAR depth, 256x192, millimetres.

    Parameters
    ----------
    path : folder
        With ``lowres_depth/VIDEO_SECONDS.png`` and ``lowres_wide_intrinsics/VIDEO_SECONDS.pincam``, files of
        one line: width height fx fy cx cy.
    camera : Camera, optional
        If not given, each frame has its own, since the phone refocuses.

    Returns
    -------
    FrameSequence
        Seconds on the phone's clock. With the poses of ``lowres_wide.traj``, between its two nearest lines.

    Raises
    ------
    NotADirectoryError, OSError, ValueError
        It is not such a folder, or a frame has no calibration, or a damaged one.
    """
    root = existing_folder(path)
    files = some(numbered((root / "lowres_depth").glob("*.png")), "lowres_depth/*.png", root)
    times = [_seconds(file) for file in files]
    order = sorted(range(len(files)), key=times.__getitem__)
    cameras = _Calibrations(root / "lowres_wide_intrinsics") if camera is None else None
    track = root / "lowres_wide.traj"
    poses = poses_of_trajectory(track, times, rotation_vector_line) if track.is_file() else [None] * len(files)
    return FrameSequence(
        (
            FrameEntry(
                files[i].relative_to(root).as_posix(),
                times[i],
                camera if cameras is None else cameras.at(times[i], files[i]),  # type: ignore[arg-type]
                files[i],
                poses[i],
            )
            for i in order
        ),
        read_depth,
    )


class _Calibrations:
    """The .pincam files of a folder by time; equal ones share a `Camera`."""

    def __init__(self, folder: Path) -> None:
        self._files = sorted(numbered(folder.glob("*.pincam")), key=_seconds)
        some(self._files, "*.pincam files, or a camera", folder)
        self._times = [_seconds(file) for file in self._files]
        self._made: dict[Camera, Camera] = {}

    def at(self, time: float, wanted_by: Path) -> Camera:
        near = bisect.bisect(self._times, time)
        best = min(range(max(0, near - 1), min(near + 1, len(self._times))), key=lambda i: abs(self._times[i] - time))
        if abs(self._times[best] - time) > _SAME_MOMENT:
            raise ValueError(
                f"{shown(wanted_by)}: expected a calibration of its moment, "
                f"the nearest is {shown(self._files[best].name)}"
            )
        camera = _read_pincam(self._files[best])
        return self._made.setdefault(camera, camera)


def _read_pincam(file: Path) -> Camera:
    try:
        width, height, fx, fy, cx, cy = map(float, text_of(file).split())
        if not (width.is_integer() and height.is_integer()):
            raise ValueError(f"got {width:g} x {height:g} pixels")
        return Camera(int(width), int(height), fx, fy, cx, cy, depth_scale=1000.0)
    except ValueError as error:
        raise ValueError(f"{shown(file)}: expected one line, width height fx fy cx cy: {error}") from None


def _seconds(file: Path) -> float:
    try:
        seconds = float(file.stem.rpartition("_")[2])
    except ValueError:
        seconds = math.nan
    if not math.isfinite(seconds):
        raise ValueError(f"{shown(file)}: expected a name such as 41048190_3414.453{file.suffix}")
    return seconds
