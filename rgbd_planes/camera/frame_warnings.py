"""Warnings that a frame itself gives reason for: distances along the ray, and noise in other units."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.user_warnings import warn_caller
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.depth_frame import DepthFrame, some_of
from rgbd_planes.noise.sigma import warn_of_large_noise

if TYPE_CHECKING:
    from rgbd_planes.noise.model import NoiseModel

_NOT_ROUGH = "nothing is ROUGH, and standard deviations are far too large"

_SAMPLES, _SIDE = 100, 10  # along the longer side of the image, and of a window
# How much flatter in one reading than in the other, and in how many windows. A ball whose radius is its distance comes
# out up to 50 times flatter as distances.
_CLEARLY, _FEWEST = 100.0, 5
_ROUNDING = 1e-6  # residuals below this share of 1/Z tell nothing


def warn_of_distances(frame: DepthFrame, camera: Camera) -> None:
    """Warn of a frame that most likely holds distances along the ray."""
    if _are_distances(frame, camera):
        warn_caller(
            "this frame's surfaces are bent as depth along the optical axis, and flat as distances along the ray: if "
            "it holds distances, divide it by np.sqrt(1 + camera.tan_x**2 + camera.tan_y**2)"
        )


def _are_distances(frame: DepthFrame, camera: Camera) -> bool:
    """Whether surfaces are flat if the numbers are distances, and bent if they are depth.

    Only frames of floats without noise tell, as renderers make them; all others pass.
    """
    if frame.is_disparity or frame.step > 0.0:
        return False
    step = max(1, max(camera.shape) // _SAMPLES)
    x, y = (_windows(tangents[::step, ::step]) for tangents in (camera.tan_x, camera.tan_y))
    q = _windows(frame._replace(raw=frame.raw[::step, ::step]).inverse_depth)
    telling = np.isfinite(q).all(axis=1) & (np.ptp(q, axis=1) > 0.0)  # a sky has the same number everywhere
    q, x, y = q[telling], x[telling], y[telling]
    if len(q) < _FEWEST:
        return False
    basis = np.linalg.qr(np.stack([x, y, np.ones_like(x)], axis=-1))[0]
    as_depth = _residual(basis, q)
    as_distance = _residual(basis, q * np.sqrt(1.0 + x * x + y * y))
    bent, flat = as_depth > _ROUNDING, as_distance > _ROUNDING
    for_distance = int(np.count_nonzero(bent & (_CLEARLY * as_distance < as_depth)))
    for_depth = int(np.count_nonzero(flat & (_CLEARLY * as_depth < as_distance)))
    return for_distance >= _FEWEST and for_depth == 0


def _windows(image: Floats) -> Floats:
    """(K, P): the values of each window."""
    rows, columns = image.shape[0] // _SIDE, image.shape[1] // _SIDE
    whole = image[: rows * _SIDE, : columns * _SIDE].reshape(rows, _SIDE, columns, _SIDE)
    return whole.swapaxes(1, 2).reshape(rows * columns, _SIDE * _SIDE)


def _residual(basis: Floats, values: Floats) -> Floats:
    """(K,): root mean square residual of planes fitted to the values, as a share of their mean."""
    planar = (basis @ (basis.swapaxes(1, 2) @ values[:, :, None]))[:, :, 0]
    return np.asarray(np.sqrt(np.mean((values - planar) ** 2, axis=1)) / np.mean(values, axis=1))


def warn_of_noise(frame: DepthFrame, noise: NoiseModel | None, result: str = _NOT_ROUGH) -> bool:
    """Warn of noise that most likely is in other units, which planes do not show; return whether the frame tells."""
    if noise is None:
        return False
    sample = some_of(frame.raw)[:, ::8]  # a hundred tell the middle well enough
    measured = np.sort(sample[(sample >= frame.lowest) & (sample <= frame.highest)])
    if not len(measured):
        return False
    # That of 1/Z, which falls as depth grows, and of an even number of values the larger of the two in the middle.
    grows = frame.is_disparity and frame.scale > 0.0
    value = float(measured[len(measured) // 2 if grows else -1 - len(measured) // 2])
    middle = frame.scale * value + frame.offset if frame.is_disparity else frame.scale / value
    warn_of_large_noise(float(noise._sigma(np.asarray(middle), 1.0)), middle, result)
    return True
