"""A sensor's bias over the image, by which it bends what is flat, from all the large planes of frames."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rgbd_planes._core.arrays import Floats, Indices
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.noise_estimation.large_planes import TILE, LargePlanes

CELL = 8
"""Side in pixels of the cells of the flatness map."""
_STEPS = 300


def flatness(frames: Sequence[Any], large: Sequence[LargePlanes], camera: Camera) -> tuple[Floats, Indices, Floats]:
    """The bias over the image, from how many pixels each cell's is, and its deviation by chance.

    A plane that covers a part of the image absorbs the part of the bias that is planar there. So bias and planes are
    found together, as the least squares of q = α·m + bias(cell) over all pixels of all large planes. A bias is expected
    to be of the size of a pixel's noise: otherwise one that only few cells determine could be anything.
    """
    shape = -(-camera.height // CELL), -(-camera.width // CELL)
    cells = shape[0] * shape[1]
    cell_of = (np.arange(camera.height) // CELL * shape[1])[:, None] + np.arange(camera.width) // CELL
    noise = camera.noise
    assert noise is not None
    numbers = np.zeros(cells, np.int64)
    planes, parts = 0, []
    # Random errors that the pixels of a cell share are one error of the cell; the floor is what is to be found.
    together = max(float(replace(noise, floor=0.0).statistics(CELL * CELL).offset), 1.0)
    for depth, (labels, alpha, *_) in zip(frames, large, strict=True):
        inside = _inside(labels.repeat(TILE // CELL, axis=0).repeat(TILE // CELL, axis=1))
        pixels = inside.repeat(CELL, axis=0).repeat(CELL, axis=1)[: camera.height, : camera.width]
        a, b, c = np.vstack([np.full((1, 3), np.nan), alpha]).T.take(pixels, axis=1)
        fitted = a * camera.tan_x + b * camera.tan_y + c
        residual = as_depth_frame(depth, camera).inverse_depth - fitted
        usual = np.hypot(1.0, noise.floor) * noise.sigma(fitted, *camera._rays)
        seen = np.abs(residual) < 6.0 * usual  # also False where missing
        numbers += np.bincount(cell_of[seen], minlength=cells)
        # By plane and cell: weight, and weighted means of the residual and of the ray.
        key = (pixels[seen] - 1) * cells + cell_of[seen]
        weight = 1.0 / (together * usual[seen] ** 2)
        total = np.bincount(key, weight)
        some = np.flatnonzero(total)
        means = [
            np.bincount(key, weight * values[seen])[some] / total[some]
            for values in (residual, camera.tan_x, camera.tan_y)
        ]
        parts.append((planes + some // cells, some % cells, total[some], *means))
        planes += len(alpha)
    plane, cell, weight, residual, x, y = (np.concatenate(part) for part in zip(*parts, strict=True))
    if not len(plane):
        return np.full(shape, np.nan), numbers.reshape(shape), np.full(shape, np.nan)
    different, plane = np.unique(plane, return_inverse=True)  # some may have no pixel near enough
    rays = np.stack([x, y, np.ones(len(x))], axis=1)
    prior = together * weight.sum() / numbers.sum()
    bias = _bias(plane, cell, weight, residual, rays, prior, len(different), cells)
    # The weights include the floor, which is not chance.
    known = np.bincount(cell, weight, cells) * (1.0 + noise.floor**2)
    deviation = np.sqrt(np.divide(1.0, known, out=np.full(cells, np.nan), where=known > 0.0))
    return bias.reshape(shape), numbers.reshape(shape), deviation.reshape(shape)


def _inside(labels: Indices) -> Indices:
    """Labels without the cells at the rims of planes: some pixels there are another surface's, hardly off the plane."""
    from scipy.ndimage import maximum_filter, minimum_filter

    alike = maximum_filter(labels, 3, mode="nearest") == minimum_filter(labels, 3, mode="nearest")
    return np.where(alike, labels, 0)


def _bias(
    plane: Indices, cell: Indices, weight: Floats, residual: Floats, rays: Floats, prior: float, planes: int, cells: int
) -> Floats:
    """Least squares of residual = δα(plane)·ray + bias(cell), with a weight for bias = 0; NaN where no plane is.

    The biases follow from δα, and the system that is left for δα is solved by conjugate gradients. Planes tell nothing
    about a part of the bias that is planar over the image: it is left out.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.linalg import LinearOperator, cg

    total = np.bincount(cell, weight, cells)
    share = 1.0 / (total + prior)
    mean = np.bincount(cell, weight * residual, cells) * share
    # In these coordinates the normal equations of each plane alone are the identity.
    scatter = np.zeros((planes, 3, 3))
    np.add.at(scatter, plane, (weight[:, None] * rays)[:, :, None] * rays[:, None, :])
    scatter += 1e-12 * np.trace(scatter, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    white = np.linalg.solve(np.linalg.cholesky(scatter)[plane], rays[:, :, None])[:, :, 0]
    unknown = 3 * plane[:, None] + np.arange(3)
    where = cell.repeat(3), unknown.ravel()
    shared = csr_array(((weight[:, None] * white).ravel(), where), shape=(cells, 3 * planes))
    wanted = np.zeros(3 * planes)
    np.add.at(wanted, unknown, (weight * (residual - mean[cell]))[:, None] * white)
    system = LinearOperator((3 * planes, 3 * planes), lambda v: v - shared.T @ (share * (shared @ v)), dtype=np.float64)
    bias = mean - share * (shared @ cg(system, wanted, rtol=1e-4, maxiter=_STEPS)[0])
    some = np.flatnonzero(total)
    centre = np.stack([np.bincount(cell, weight * values, cells)[some] / total[some] for values in rays.T], axis=1)
    root = np.sqrt(total[some])
    planar = np.linalg.lstsq(root[:, None] * centre, root * bias[some], rcond=None)[0]
    seen = np.full(cells, np.nan)
    seen[some] = bias[some] - centre @ planar
    return seen
