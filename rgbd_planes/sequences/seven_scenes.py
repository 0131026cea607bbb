"""Microsoft's 7-Scenes."""

import os

from rgbd_planes import presets
from rgbd_planes.camera import Camera
from rgbd_planes.sequences.frames import FrameSequence, existing_folder, image_sequence, numbered, some


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
        Without times: the data set numbers its frames.

    Raises
    ------
    NotADirectoryError, ValueError
        It is not such a folder.
    """
    root = existing_folder(path)
    files = some(numbered(root.glob("frame-*.depth.png")), "frame-*.depth.png", root)
    return image_sequence(files, camera or presets.seven_scenes(), root)
