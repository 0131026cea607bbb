"""Warnings that a frame itself gives reason for: distances along the ray, inverse depths, other units."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.user_warnings import warn_caller
from rgbd_planes.camera import presets
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.depth_frame import DepthFrame, some_of
from rgbd_planes.noise.sigma import warn_of_large_noise

if TYPE_CHECKING:
    from rgbd_planes.noise.model import NoiseModel

_NOT_ROUGH = "nothing is ROUGH, and standard deviations are far too large"

_SAMPLES, _SIDE = 100, 10  # along the longer side of the image, and of a window
# How much flatter in one reading than in another, in how many windows, and how many times more than the other way.
_CLEARLY, _FEWEST, _MANY_MORE = 2.0, 5, 10
_ROUNDING = {8: 1e-9, 4: 3e-7}  # residuals below this share of a value tell nothing, by the bytes of a number
# Of what is left of a flat window, neighbours differ by rounding or noise; a ball leaves what changes slowly.
_UNLIKE = 0.2
# No window is flat whose residual is a larger share: one pixel in a hundred that is less than half as far leaves 5 %
# or more as a number, and more than twice that as inverse depth.
_FLAT = 0.04
_OF_FLOAT16 = 5e-4  # the same of floats of 16 bits, whose steps alone may be flatter as numbers
_STEPS = 9  # between the different values of a window: an upright wall has one value in each column
# Metres: the drivers of a Kinect v1 and its kin give no more. What is more than so many units means missing.
_REACH, _LARGEST = 10.0, 32766


def warn_of_reach(frame: DepthFrame, camera: Camera) -> None:
    """Warn of integers a tenth of which are beyond what a preset's sensor gives: most likely in another unit."""
    if frame.is_disparity or frame.step == 0.0:
        return
    sample = some_of(frame.raw)
    measured = sample[(sample >= frame.lowest) & (sample <= frame.highest) & (sample <= _LARGEST)]
    too_far = np.count_nonzero(measured > _REACH * frame.scale)
    if 10 * too_far > len(measured) and camera._lens in _lenses_that_end():
        warn_caller(
            f"with a depth_scale of {frame.scale:g} per metre {too_far / len(measured):.0%} of this frame are beyond "
            f"{_REACH:g} m, where a Kinect v1 measures nothing: files of TUM RGB-D and ICL-NUIM have depth_scale=5000, "
            "on the command line --depth-scale 5000"
        )


@functools.cache
def _lenses_that_end() -> frozenset[Camera]:
    """The presets whose sensor gives nothing beyond a distance, without their units."""
    return frozenset(make()._lens for make in (presets.kinect_v1, presets.kinect_v1_infrared, presets.seven_scenes))


def warn_of_distances(frame: DepthFrame, camera: Camera) -> None:
    """Warn of a frame that most likely holds distances along the ray, or inverse depths, instead of depth."""
    reading = _reading(frame, camera)
    if reading == "distance":
        warn_caller(
            "this frame's surfaces are bent as depth along the optical axis, and flat as distances along the ray: if "
            "it holds distances, divide it by np.sqrt(1 + camera.tan_x**2 + camera.tan_y**2)"
        )
    elif reading == "inverse":
        warn_caller(
            "this frame's surfaces are bent as depth, and flat as the numbers are: if it holds inverse depths, as "
            "networks give, a camera with disparity=(scale, offset) reads them; of a renderer's z-buffer of 0 to 1 "
            "between near and far that is disparity=(-(1 / near - 1 / far), 1 / near)"
        )


def _reading(frame: DepthFrame, camera: Camera) -> str:
    """As what surfaces of a frame are flat that are bent as depth: "distance", "inverse", or ""."""
    if frame.is_disparity:
        return ""
    step = max(1, max(camera.shape) // _SAMPLES)
    basis, ray = _bases(camera._lens, step)
    q = _windows(frame._replace(raw=frame.raw[::step, ::step]).inverse_depth)
    # A sky has the same number everywhere, and few steps of rounding are flat in many ways.
    telling = np.isfinite(q).all(axis=1) & (np.count_nonzero(np.diff(np.sort(q, axis=1), axis=1), axis=1) >= _STEPS)
    if np.count_nonzero(telling) < _FEWEST:
        return ""
    q, basis, ray = q[telling], basis[telling], ray[telling]
    least = _ROUNDING[4 if frame.raw.dtype.itemsize <= 4 else 8]
    with np.errstate(over="ignore"):
        halved = np.float16(1.0 / q[0]).astype(np.float64)
    is_half = frame.step == 0.0 and bool((np.abs(halved * q[0] - 1.0) < least).all())
    of_inverse = _OF_FLOAT16 if is_half else least
    as_depth = _residual(basis, q)
    for reading, values in (("distance", q * ray), ("inverse", 1.0 / q)):
        other = _residual(basis, values)
        for_it = (as_depth.share > (of_inverse if reading == "inverse" else least)) & (
            other.share * _CLEARLY < as_depth.share
        )
        for_it &= (other.share < least) | ((other.share < _FLAT) & (other.unlike > _UNLIKE))
        for_depth = (other.share > least) & (as_depth.share * _CLEARLY < other.share)
        if int(np.count_nonzero(for_it)) >= max(_FEWEST, _MANY_MORE * int(np.count_nonzero(for_depth))):
            return reading
    return ""


@functools.lru_cache(maxsize=4)
def _bases(camera: Camera, step: int) -> tuple[Floats, Floats]:
    """(K, P, 3) orthonormal bases of the planes of each window, and (K, P) lengths of its rays."""
    x, y = (_windows(tangents[::step, ::step]) for tangents in (camera.tan_x, camera.tan_y))
    return np.linalg.qr(np.stack([x, y, np.ones_like(x)], axis=-1))[0], np.sqrt(1.0 + x * x + y * y)


def _windows(image: Floats) -> Floats:
    """(K, P): the values of each window."""
    rows, columns = image.shape[0] // _SIDE, image.shape[1] // _SIDE
    whole = image[: rows * _SIDE, : columns * _SIDE].reshape(rows, _SIDE, columns, _SIDE)
    return whole.swapaxes(1, 2).reshape(rows * columns, _SIDE * _SIDE)


class _Left(NamedTuple):
    """What planes fitted to the values of windows leave: (K,) each.

    Attributes
    ----------
    share : root mean square, as a share of the values' mean.
    unlike : how much neighbours differ, 1 for noise that they do not share, 0 for what is smooth.
    """

    share: Floats
    unlike: Floats


def _residual(basis: Floats, values: Floats) -> _Left:
    left = values - (basis @ (basis.swapaxes(1, 2) @ values[:, :, None]))[:, :, 0]
    square = np.mean(left * left, axis=1)
    field = left.reshape(-1, _SIDE, _SIDE)
    differences = [np.mean(np.diff(field, axis=axis) ** 2, axis=(1, 2)) for axis in (1, 2)]
    with np.errstate(divide="ignore", invalid="ignore"):
        unlike = np.minimum(*differences) / (2.0 * square)
    return _Left(np.sqrt(square) / np.mean(np.abs(values), axis=1), unlike)


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
