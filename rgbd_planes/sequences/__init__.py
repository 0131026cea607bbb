"""Depth frames of data sets and recordings, one after another, each with its camera and time.

    sequence = rgbd_planes.open_sequence("rgbd_dataset_freiburg1_xyz")
    for frame in sequence:
        tiles = rgbd_planes.fit_tiles(frame.depth, frame.camera)

`open_sequence` recognises the format; each format also has a function of its own here, with arguments for what its
files leave open. A frame is read when it is asked for, and as it is stored.
"""

from rgbd_planes.camera.frame import Frame
from rgbd_planes.sequences.arkitscenes import arkitscenes
from rgbd_planes.sequences.folder import folder, seven_scenes
from rgbd_planes.sequences.formats import FORMATS, open_sequence
from rgbd_planes.sequences.frames import FrameEntry, FrameSequence
from rgbd_planes.sequences.matroska import mkv
from rgbd_planes.sequences.rosbag import rosbag
from rgbd_planes.sequences.scannet import scannet, scannet_sens
from rgbd_planes.sequences.tum import icl_nuim, tum

__all__ = [
    "FORMATS",
    "Frame",
    "FrameEntry",
    "FrameSequence",
    "arkitscenes",
    "folder",
    "icl_nuim",
    "mkv",
    "open_sequence",
    "rosbag",
    "scannet",
    "scannet_sens",
    "seven_scenes",
    "tum",
]
