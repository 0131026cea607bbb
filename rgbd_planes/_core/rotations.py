"""Rotations and rigid motions."""

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.arrays import Floats

_ROUNDED = 2e-3  # how far R·Rᵀ is off, at most, where the entries of R have three digits or more


def nearest_rotation(matrix: Floats) -> Floats:
    """(..., 3, 3): the rotation that is nearest to a matrix (Kabsch 1976).

    Of Σbaᵀ over vectors a and what became of them, b, it is the rotation that takes them there, by least squares.
    """
    left, _, right = np.linalg.svd(matrix)
    left[..., -1] *= np.sign(np.linalg.det(left @ right))[..., None]
    return np.asarray(left @ right)


def as_motion(name: str, motion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (..., 4, 4) rigid motions; those of a few digits with the nearest rotation: normals keep their length."""
    rotation = motion[..., :3, :3]
    off = np.abs(rotation @ np.swapaxes(rotation, -1, -2) - np.eye(3)).max(initial=0.0)
    if not (
        off < _ROUNDED
        and bool(np.isfinite(motion).all())
        and np.allclose(motion[..., 3, :], [0.0, 0.0, 0.0, 1.0])
        and bool((np.linalg.det(rotation) > 0.0).all())
    ):
        nearly = f": R·Rᵀ is off by {off:.1g}" if _ROUNDED <= off < 0.1 else ""
        raise ValueError(f"expected {name} as a rigid motion [[R, t], [0, 1]], got {motion.tolist()}{nearly}")
    if off < 1e-12:
        return motion
    exact = motion.copy()
    exact[..., :3, :3] = nearest_rotation(rotation)
    return exact
