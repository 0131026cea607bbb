"""A plain folder of depth images with a camera file."""

import os

from rgbd_planes._core.text import shown
from rgbd_planes.camera import presets
from rgbd_planes.camera.camera import Camera
from rgbd_planes.sequences.frames import FrameSequence, existing_folder, image_sequence, numbered, some
from rgbd_planes.sequences.images import DEPTH_SUFFIXES
from rgbd_planes.sequences.poses import beside, poses_of_files, poses_of_trajectory, quaternion_line
from rgbd_planes.sequences.tum import read_index


def folder(path: str | os.PathLike[str], camera: Camera | None = None, *, allow_outside: bool = False) -> FrameSequence:
    """Open a folder of depth images.

    Parameters
    ----------
    path : folder
        With the images in it or in ``depth/``, in the order of the numbers in their names, or in that of the lines
        "seconds file" of a ``depth.txt``. Where some names contain "depth", as beside images of colour, those images.
    camera : Camera, optional
        Read from ``camera.json`` in the folder, if not given.
    allow_outside : bool
        Whether ``depth.txt`` may name files outside the folder, by ``..`` or a path from the root.

    Returns
    -------
    FrameSequence
        With the times of ``depth.txt``, if there is one, and poses, where files have them: ``NAME.pose.txt`` beside
        ``NAME.depth.png``, ``pose/NAME.txt`` or ``poses/NAME.txt`` for ``depth/NAME.png``, or ``groundtruth.txt``, as
        the TUM benchmark writes it.

    Raises
    ------
    NotADirectoryError, OSError, TypeError, ValueError
        It is not a folder with depth images, has no camera, or its ``camera.json`` or ``depth.txt`` is damaged.
    """
    root = existing_folder(path)
    if camera is None:
        if not (root / "camera.json").is_file():
            raise ValueError(
                f"{shown(root)}: expected a camera, or its file camera.json in the folder (Camera.save writes one)"
            )
        camera = Camera.load(root / "camera.json")
    index = root / "depth.txt"
    if index.is_file():
        times, files = read_index(index, allow_outside)
        truth = root / "groundtruth.txt"
        track = poses_of_trajectory(truth, times, quaternion_line) if truth.is_file() else poses_of_files(beside(files))
        return image_sequence(files, camera, root, times, track)
    place = root / "depth" if (root / "depth").is_dir() else root
    # A broken link stays, so that reading it is an error, and the frames after it keep their numbers.
    files = [file for file in place.iterdir() if file.suffix.lower() in DEPTH_SUFFIXES and not file.is_dir()]
    files = [file for file in files if "depth" in file.stem.lower()] or files
    files = some(numbered(files), f"depth images ({', '.join(DEPTH_SUFFIXES)})", place)
    return image_sequence(files, camera, root, poses=poses_of_files(beside(files)))


def seven_scenes(path: str | os.PathLike[str], camera: Camera | None = None) -> FrameSequence:
    """Open a sequence of 7-Scenes (Shotton et al. 2013).

    Parameters
    ----------
    path : folder
        A ``seq-NN`` with ``frame-NNNNNN.depth.png``.
    camera : Camera, optional
        `presets.seven_scenes`, for which 0 and 65535 are missing, if not given.

    Returns
    -------
    FrameSequence
        Without times: the data set numbers its frames. With the poses of ``frame-NNNNNN.pose.txt``.

    Raises
    ------
    NotADirectoryError, ValueError
        It is not such a folder.
    """
    root = existing_folder(path)
    files = some(numbered(root.glob("frame-*.depth.png")), "frame-*.depth.png", root)
    poses = poses_of_files(beside(files))
    return image_sequence(files, camera or presets.seven_scenes(), root, poses=poses)
