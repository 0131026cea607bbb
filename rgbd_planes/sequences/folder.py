"""A plain folder of depth images with a camera file, and 7-Scenes, whose folders look like many others."""

import os

from rgbd_planes.camera import presets
from rgbd_planes.camera.camera import Camera
from rgbd_planes.sequences.contents.calibration import calibration_beside, calibration_files, found_calibration
from rgbd_planes.sequences.contents.depth_images import depth_images
from rgbd_planes.sequences.frames import FrameSequence, existing_folder, image_sequence, numbered, some
from rgbd_planes.sequences.poses import beside, poses_of_files, poses_of_trajectory, quaternion_line
from rgbd_planes.sequences.tum import read_index


def folder(path: str | os.PathLike[str], camera: Camera | None = None, *, allow_outside: bool = False) -> FrameSequence:
    """Open a folder of depth images.

    Parameters
    ----------
    path : folder
        Images are in it, in ``depth/``, or in its only subfolder with "depth" in its name. They are ordered by the
        numbers in their names, or by the lines "seconds file" of a ``depth.txt``. Where some names contain "depth", as
        beside images of colour, only those count. Images of confidence, masks, normals, colour and labels are left
        out, by their names. Of one frame in several files all but one are left out.
    camera : Camera, optional
        Read from ``camera.json`` in the folder, if not given, or from another calibration there that `Camera.load`
        reads, or a matrix.
    allow_outside : bool
        Whether ``depth.txt`` may name files outside the folder, by ``..`` or a path from the root.

    Returns
    -------
    FrameSequence
        With the times of ``depth.txt``, if there is one, and with poses, if files have them. Those are
        ``NAME.pose.txt`` beside ``NAME.depth.png``, or ``pose/NAME.txt`` or ``poses/NAME.txt`` for ``depth/NAME.png``.
        ``groundtruth.txt``, as the TUM benchmark writes it, is read, too.

    Raises
    ------
    NotADirectoryError, OSError, TypeError, ValueError
        It is not a folder with depth images, has no camera, or its ``camera.json`` or ``depth.txt`` is damaged.

    Warns
    -----
    UserWarning
        Images were left out, with their number and some of their names.
    """
    root = existing_folder(path)
    stated = "" if camera is not None else "camera.json"
    if camera is None and (root / "camera.json").is_file():
        camera = Camera.load(root / "camera.json")
    index = root / "depth.txt"
    if index.is_file():
        times, files = read_index(index, allow_outside)
        camera = camera or found_calibration(root, files)
        truth = root / "groundtruth.txt"
        track = poses_of_trajectory(truth, times, quaternion_line) if truth.is_file() else poses_of_files(beside(files))
        return image_sequence(files, camera, root, times, track)
    if camera is None and not calibration_files(root):
        raise ValueError(f"{root}: expected a camera, or its file {stated} in the folder (Camera.save writes one)")
    files = depth_images(root)
    return image_sequence(files, camera or found_calibration(root, files), root, poses=poses_of_files(beside(files)))


def seven_scenes(path: str | os.PathLike[str], camera: Camera | None = None) -> FrameSequence:
    """Open a sequence of 7-Scenes (Shotton et al. 2013), or another in its form, as of BundleFusion or 3DMatch.

    Parameters
    ----------
    path : folder
        A ``seq-NN`` with ``frame-NNNNNN.depth.png``.
    camera : Camera, optional
        If not given, that of a calibration in the folder, or in the one above a ``seq-NN``: ``info.txt``,
        ``camera-intrinsics.txt`` or another. Without one `presets.seven_scenes`, for which 0 and 65535 are missing.

    Returns
    -------
    FrameSequence
        Without times: the data set numbers its frames. With the poses of ``frame-NNNNNN.pose.txt``.

    Raises
    ------
    NotADirectoryError, ValueError
        It is not such a folder, or its calibration cannot be read.
    """
    root = existing_folder(path)
    files = some(numbered(root.glob("frame-*.depth.png")), "frame-*.depth.png", root)
    preset, said = presets.seven_scenes(), ""
    if camera is None:
        camera = calibration_beside(root, files, preset)
    if camera is None:
        camera, said = preset, "calibration of presets.seven_scenes"
    return image_sequence(files, camera, root, poses=poses_of_files(beside(files)), calibration=said)
