"""Rotations."""

import numpy as np

from rgbd_planes.array_types import Floats


def nearest_rotation(matrix: Floats) -> Floats:
    """(..., 3, 3): the rotation that is nearest to a matrix (Kabsch 1976).

    Of Σbaᵀ over vectors a and what became of them, b, it is the rotation that takes them there, by least squares.
    """
    left, _, right = np.linalg.svd(matrix)
    left[..., -1] *= np.sign(np.linalg.det(left @ right))[..., None]
    return np.asarray(left @ right)
