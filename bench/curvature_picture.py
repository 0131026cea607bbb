"""The picture of the page on curvature: a wall and a floor with a ball, a pipe and a cushion."""

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

import rgbd_planes as rp
from rgbd_planes.noise import KINECT_V1

Floats = npt.NDArray[np.float64]


def near_side(rays: Floats, matrix: Floats, centre: Floats) -> Floats:
    """Inverse depth of the near side of (X - c)ᵀM(X - c) = 1 along rays, 0 where they miss it."""
    square = np.einsum("...i,ij,...j->...", rays, matrix, rays)
    along = rays @ (matrix @ centre)
    k = float(centre @ matrix @ centre) - 1.0
    root = along**2 - k * square
    return np.asarray(np.where(root > 0.0, (along + np.sqrt(np.maximum(root, 0.0))) / k, 0.0))


def curved_room(camera: rp.Camera, seed: int = 0) -> Floats:
    """(H, W) metres: a wall and a floor with a ball, a pipe and a cushion, as a Kinect v1 sees them."""
    rays = np.stack([camera.tan_x, camera.tan_y, np.ones(camera.shape)], axis=-1)
    axis = np.array([0.15, 1.0, 0.1]) / np.linalg.norm([0.15, 1.0, 0.1])
    solids = (
        (np.eye(3) / 0.22**2, np.array([-0.35, 0.1, 1.3])),
        ((np.eye(3) - np.outer(axis, axis)) / 0.12**2, np.array([0.35, 0.0, 1.5])),
        (np.diag(np.array([0.3, 0.16, 0.3]) ** -2.0), np.array([0.02, 0.5, 1.35])),
    )
    q = np.maximum(0.45 + 0.05 * camera.tan_x, 1.4 * camera.tan_y - 0.05)
    for matrix, centre in solids:
        q = np.maximum(q, near_side(rays, matrix, centre))
    rng = np.random.default_rng(seed)
    return np.asarray(1.0 / (q + KINECT_V1 * rng.standard_normal(q.shape)))


def picture() -> Figure:
    """Draw the surfaces of that room's tiles."""
    camera = rp.Camera(640, 480, 525.0, 525.0, 319.5, 239.5, noise=rp.noise.kinect_v1())
    depth = curved_room(camera)
    return rp.fit_surfaces(depth, camera, 20).plot(depth)
