"""The frames that are segmented: a real sequence, where ``RGBD_PLANES_DATA`` names real frames, or rendered ones."""

import numpy as np
import numpy.typing as npt

from bench.real_data import FOLDER as REAL_DATA
from rgbd_planes import Camera
from rgbd_planes.evaluation import scenes
from rgbd_planes.sequences.images import read_depth

SEQUENCE = "kinect1_7scenes_seq"
KINECTS = (SEQUENCE, "primesense_open3d_rgbd", "tum_fr2_distorted")
"""Real frames of Kinect v1 class sensors: structured light, disparity in eighths of a pixel."""

Frames = list[npt.NDArray[np.uint16]]


def real_frames(name: str) -> tuple[Frames, Camera] | None:
    """The frames and the camera of a set of real data, or None where it is not there."""
    folder = REAL_DATA / name
    if not (folder / "camera.json").is_file():
        return None
    frames = [read_depth(path) for path in sorted((folder / "depth").glob("*.png"))]
    return frames, Camera.load(folder / "camera.json")


def rendered_frames(count: int) -> tuple[Frames, Camera]:
    """A camera that moves through a furnished room, with noise, holes and shadows."""
    camera = Camera(width=640, height=480, fx=525.0, fy=525.0, cx=319.5, cy=239.5, depth_scale=1000.0)
    frames = []
    for i in range(count):
        room = scenes.room(eye=(0.35 - 0.01 * i, -1.5, -0.2 + 0.01 * i))
        frame = room.render(camera).measure(holes=0.02, patches=0.05, baseline=scenes.KINECT_BASELINE, seed=i)
        frames.append(frame.astype(np.uint16))
    return frames, camera


def sequence(count: int) -> tuple[Frames, Camera, str]:
    """The frames to segment, their camera, and what they are."""
    real = real_frames(SEQUENCE)
    if real is not None:
        return real[0][:count], real[1], "real Kinect v1 frames (7-Scenes)"
    return *rendered_frames(count), "rendered frames of a furnished room"
