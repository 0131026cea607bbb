"""Frames of curved surfaces whose curvature is known exactly, for tests of surfaces."""

import numpy as np


def rays_of(camera):
    return np.stack([camera.tan_x, camera.tan_y, np.ones(camera.shape)], axis=-1)


def inverse_depth_of_quadric(rays, matrix, centre):
    """q of the near side of (X - c)ᵀM(X - c) = 1 along rays (..., 3), NaN where they miss it."""
    mm = np.einsum("...i,ij,...j->...", rays, matrix, rays)
    mc = rays @ (matrix @ centre)
    k = centre @ matrix @ centre - 1.0
    with np.errstate(invalid="ignore"):
        return (mc + np.sqrt(mc**2 - k * mm)) / k


def curvatures_of_quadric(points, matrix, centre):
    """(N, 3) outward normals and (N, 2) principal curvatures, κ₁ >= κ₂, at points of the surface."""
    gradient = 2.0 * (points - centre) @ matrix
    length = np.linalg.norm(gradient, axis=1)
    normals = gradient / length[:, None]
    found = []
    for normal, size in zip(normals, length, strict=True):
        # The shape operator: the Hessian over the gradient's length, within the tangent plane.
        tangent = np.linalg.svd(normal[None])[2][1:]
        found.append(np.linalg.eigvalsh(tangent @ (2.0 * matrix / size) @ tangent.T)[::-1])
    return normals, np.array(found)


def ball(centre, radius):
    """Matrix and centre of a sphere."""
    return np.eye(3) / radius**2, np.asarray(centre, float)


def pipe(centre, axis, radius):
    """Matrix and a point of the axis of a cylinder."""
    axis = np.asarray(axis, float) / np.linalg.norm(axis)
    return (np.eye(3) - np.outer(axis, axis)) / radius**2, np.asarray(centre, float)
