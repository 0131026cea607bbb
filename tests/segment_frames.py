"""What tests of segmentation share: a camera, frames, and what is read from them."""

import numpy as np
from scipy.ndimage import gaussian_filter

from rgbd_planes import Camera
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.kernels.segmentation.blocks.pyramid import read_frame
from rgbd_planes.segmentation.workspace import Workspace, rays_of

CAMERA = Camera(width=320, height=240, fx=262.5, fy=262.5, cx=159.5, cy=119.5, depth_scale=1000.0)


def two_planes(camera: Camera, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Inverse depth of two parallel walls, the right one ``step`` metres nearer, and the labels."""
    labels = np.where(np.arange(camera.width) < camera.width // 2, 1, 2)
    labels = np.broadcast_to(labels, camera.shape)
    return np.where(labels == 1, 1.0, 1.0 / (1.0 - step)), labels.astype(np.int32)


def smooth_noise(seed, pixels):
    """(H, W) errors of variance 1 that pixels share with neighbours within about ``pixels``."""
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal(CAMERA.shape), pixels)
    return noise / noise.std()


def inside(labels: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Pixels whose eight neighbours have their label, but for those that are not measured."""
    around = np.pad(np.where(measured, labels, -1), 1, constant_values=-1)
    neighbours = np.lib.stride_tricks.sliding_window_view(around, (3, 3))
    alike = (neighbours == labels[..., None, None]) | (neighbours == -1)
    return (labels > 0) & alike.all(axis=(2, 3))


def blocks_and_squares(depth, camera):
    """Inverse depth, moments and planes of blocks and squares, largest inverse depth."""
    frame, rays = as_depth_frame(depth, camera), rays_of(camera)
    work = Workspace(camera)
    nearest = read_frame(*frame.values, rays, work.inverse_depth, work.pyramid)
    return work.inverse_depth, work.pyramid, nearest
