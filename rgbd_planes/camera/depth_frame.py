"""Where depth frames enter: any array from a sensor or a file, turned into what the kernels read.

Every kind of missing pixel folds into one test, ``lowest <= raw <= highest``, and every unit into one formula
for the inverse depth, so that a frame is read once and nothing is converted beforehand.
"""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.checks import plain_array
from rgbd_planes._core.user_warnings import warn_caller
from rgbd_planes.camera.depth_validity import measurements_of, validity
from rgbd_planes.camera.depth_warnings import (
    PLAINLY_NOT_METRES,
    warn_of_disparity,
    warn_of_swapped_bytes,
    warn_of_the_range,
    warn_of_units,
)
from rgbd_planes.kernels.common.depth import RawFrame

# Steps are multiples of these, which are finer than any sensor's. Disparities come in 16ths (OpenCV) to 256ths (KITTI).
_GRAIN, _GRAIN_OF_DISPARITY = 1e-5, 1.0 / 256.0  # metres, raw units
_INDISTINCT = 2.0**53  # grains: all larger numbers are whole
_FEW_VALUES = 50  # too few to say anything: a scene may have been made of whole numbers


class Units(Protocol):
    """A camera, as far as it says what its frames hold."""

    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def depth_scale(self) -> float | None: ...
    @property
    def disparity(self) -> tuple[float, float] | None: ...
    @property
    def depth_range(self) -> tuple[float, float] | None: ...
    @property
    def invalid_values(self) -> Sequence[float]: ...
    @property
    def distortion_model(self) -> str: ...
    @property
    def _without_ray(self) -> NDArray[np.bool_] | None: ...


class DepthFrame(NamedTuple):
    """A depth frame as the kernels read it.

    Attributes
    ----------
    raw : (H, W) ndarray of uint16, float32 or float64
        C-contiguous, native, read-only.
    lowest, highest : scalar of the dtype of `raw`
        A pixel is valid if and only if ``lowest <= raw <= highest``; where no value is valid, ``lowest >
        highest``.
    scale, offset : float
        The inverse depth q in 1/m of a valid pixel: ``scale / raw`` for depth, ``scale * raw + offset`` for disparity.
    is_disparity : bool
    step : float
        Step between neighbouring values of `raw` as they came: 1 for integers, 0 for floats.
    """

    raw: NDArray[Any]
    lowest: Any
    highest: Any
    scale: float
    offset: float
    is_disparity: bool
    step: float

    @property
    def values(self) -> RawFrame:
        """All but the step, as most kernels take them."""
        return RawFrame(*self[:6])

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(H, W) bool: where the frame has a measurement."""
        return np.asarray((self.raw >= self.lowest) & (self.raw <= self.highest))

    @property
    def inverse_depth(self) -> NDArray[np.float64]:
        """(H, W) float64, 1/m: q, NaN where missing."""
        q = np.where(self.valid, self.raw, np.nan).astype(np.float64, copy=False)
        return self.scale * q + self.offset if self.is_disparity else self.scale / q

    @property
    def metres(self) -> NDArray[np.float64]:
        """(H, W) float64, m: Z, NaN where missing."""
        if self.is_disparity:
            return 1.0 / self.inverse_depth
        return np.where(self.valid, self.raw, np.nan).astype(np.float64, copy=False) / self.scale


def as_depth_frame(depth: ArrayLike, camera: Units) -> DepthFrame:
    """Check a depth frame against its camera and give it to the kernels without touching its pixels.

    Parameters
    ----------
    depth : (H, W) array_like
        Integers in the camera's raw units (`depth_scale` or `disparity`), or floats: metres, or, where the
        camera has `disparity`, disparities. Any byte order and strides. uint16, float32 and float64 frames
        are used as they are; uint8 is widened to uint16, float16 to float32, all else to float64.
    camera : Camera

    Returns
    -------
    DepthFrame

    Raises
    ------
    TypeError
        It is not an array, or masked, or the dtype is neither integer nor floating point.
    ValueError
        The shape is not (camera.height, camera.width), or an integer frame came with a camera that has
        neither `depth_scale` nor `disparity`.

    Warns
    -----
    UserWarning
        Something in the frame is most likely not meant as it is, such as its unit: `rgbd_planes.fit_tiles` lists what.

    Notes
    -----
    Depths are missing if they are 0, negative, NaN, infinite, one of `camera.invalid_values` or outside
    `camera.depth_range`; so are pixels without a ray, as of a fisheye beyond 85 degrees from the axis, and depths below
    the smallest normal number of float32, 1.2e-38 m, or not below its largest, 3.4e38 m. Raw values of a disparity
    image are missing where 1/Z = scale * raw + offset is not positive, by `invalid_values`, and by `depth_range`: a raw
    0 can be a measurement there, unless `invalid_values` names it.
    """
    array = plain_array("depth", depth)
    check_shape(depth, array, camera)
    with np.errstate(all="ignore"):  # depths of any size are compared with what is likely
        return _read(array, camera)


def as_depth_frames(frames: NDArray[Any], camera: Units) -> DepthFrame:
    """The same for an array of frames (F, H, W), all at once: ``raw`` has its shape."""
    array = plain_array("depth", frames)
    check_shape(frames[0], array[0], camera)
    with np.errstate(all="ignore"):  # depths of any size are compared with what is likely
        return _read(array, camera)


def check_unit(dtype: np.dtype[Any], camera: Units) -> None:
    """Refuse a frame of integers where the camera does not say what they are."""
    if dtype.kind in "ui" and camera.depth_scale is None and camera.disparity is None:
        raise ValueError(
            "expected a camera with depth_scale (raw units per metre) or disparity (scale, offset) "
            f"for a frame of {dtype}, got a camera with neither"
        )


def _read(array: NDArray[Any], camera: Units) -> DepthFrame:
    """`as_depth_frame` of a frame, or of several, (..., H, W)."""
    kind = array.dtype.kind
    if kind in "ui":
        check_unit(array.dtype, camera)
        dtype = np.dtype(np.uint16 if kind == "u" and array.dtype.itemsize <= 2 else np.float64)
    elif kind == "f":
        dtype = np.dtype(np.float32 if array.dtype.itemsize <= 4 else np.float64)
    else:
        raise TypeError(f"expected a depth frame of integers or floats, got dtype {array.dtype}")

    raw, flags = array, array.flags
    if array.dtype != dtype or not (flags.c_contiguous and flags.aligned):
        raw = np.require(array, dtype, ["C", "A"])
    depth_scale = camera.depth_scale if kind in "ui" else 1.0
    disparity = camera.disparity
    samples = some_of(raw)
    stored = array.dtype.char if kind == "f" else dtype.char
    read_as = dtype.char, stored, depth_scale if disparity is None else None, disparity
    lowest, highest, holes, missing = validity(*read_as, camera.depth_range, camera.invalid_values)
    valid = lowest, highest, holes
    if camera.depth_range is not None and camera.depth_range[0] > PLAINLY_NOT_METRES:
        nearest, farthest = camera.depth_range
        in_millimetres = validity(*read_as, (nearest / 1000.0, farthest / 1000.0), camera.invalid_values)[:3]
        for sample in samples:
            if len(measurements_of(sample, in_millimetres)) > 10 and not len(measurements_of(sample, valid)):
                warn_of_the_range(nearest, farthest)
    if kind in "ui" and array.dtype.itemsize == 2:
        warn_of_swapped_bytes(array if array.ndim == 2 else array[0])
    if disparity is not None:
        for sample in samples:
            warn_of_disparity(sample, valid, disparity, camera.depth_range, camera.invalid_values)
    else:
        assert depth_scale is not None
        for sample in samples:
            warn_of_units(sample, valid, array.dtype, depth_scale, camera.depth_range)
    invalid = [raw == value for value in holes]
    if camera._without_ray is not None:
        invalid.append(camera._without_ray)
        for sample in samples if camera.distortion_model == "fisheye" else ():
            _warn_of_lost_pixels((sample >= lowest) & (sample <= highest) & some_of(camera._without_ray)[0])
    if invalid:
        raw, lowest, highest = _without(raw, functools.reduce(np.logical_or, invalid), lowest, highest, missing)
    raw = raw.view()
    step = 0.0 if kind == "f" else 1.0
    raw.setflags(write=False)  # one type for the kernels, and the caller's frame is safe
    if disparity is not None:
        return DepthFrame(raw, lowest, highest, disparity[0], disparity[1], True, step)
    assert depth_scale is not None
    return DepthFrame(raw, lowest, highest, depth_scale, 0.0, False, step)


def check_shape(depth: ArrayLike, array: NDArray[Any], camera: Units) -> None:
    """Refuse what is no frame of the camera's size; ``array`` is ``depth`` as an array."""
    expected = (camera.height, camera.width)
    if array.shape == expected:
        return
    if depth is None or isinstance(depth, (str, os.PathLike)):
        reason = "has the file been read?" if depth is None else "rgbd_planes.images.read_depth reads a file"
        raise TypeError(f"expected a depth frame as an array, got {type(depth).__name__}: {reason}")
    if array.dtype == object and array.size and hasattr(array.flat[0], "depth"):
        reason = f"the array is the depth of a {type(array.flat[0]).__name__}"
        raise TypeError(f"expected a depth frame as an array, got {type(depth).__name__}: {reason}")
    if array.ndim == 0 and array.dtype.kind not in "iuf":  # a message, say, or the bytes of an image
        several = ": TileFitter.fit_stream and segment_sequence take several frames"
        reason = several if isinstance(depth, Iterator) else ""
        raise TypeError(f"expected a depth frame as an array, got {type(depth).__name__}{reason}")
    if array.ndim == 3 and array.shape[2] == 3 and array.dtype.kind == "f":
        reason = ": is it a colour image, or points, whose depth is [..., 2]?"
    elif array.ndim == 3 and array.shape[2] in (3, 4):
        reason = ": is it a colour image? cv2.imread makes one of depth, too, without IMREAD_UNCHANGED"
    elif array.ndim == 3 and 1 in array.shape:
        reason = ": squeeze it"
    elif array.ndim == 3 and array.shape[1:] == expected:
        reason = ": TileFitter.fit_batch and segment_sequence take several frames"
    elif array.shape == expected[1:]:
        reason = ": is it a row of a frame, in the place of several? TileFitter.fit and rp.segment take one frame"
    elif array.shape == expected[::-1]:
        reason = ": is it transposed, or are the camera's width and height swapped?"
    elif array.ndim == 2 and array.size and array.shape[0] * expected[1] == array.shape[1] * expected[0]:
        height, width = array.shape
        reason = (
            ": is the calibration that of another resolution? "
            f"camera.resized({width}, {height}) is that of frames that were resized"
        )
    elif array.ndim == 2 and _is_part(array.shape, expected):
        height, width = array.shape
        reason = (
            ": was it cropped, or cropped and resized? camera.cropped(left, top, width, height) is that of a part, and "
            f".resized({width}, {height}) after it that of a part that was resized"
        )
    else:
        reason = ""
    raise ValueError(
        f"expected a depth frame of shape (height, width) = {expected}, as the camera's, got {array.shape}{reason}"
    )


def _is_part(shape: tuple[int, ...], whole: tuple[int, int]) -> bool:
    """Whether an image may have been cropped: it is smaller, by more than a pixel or two of rounding."""
    smaller = [b - a for a, b in zip(shape, whole, strict=True)]
    return min(shape) > 1 and min(smaller) >= 0 and max(smaller) > 2


def _warn_of_lost_pixels(lost: NDArray[np.bool_]) -> None:
    """Warn of measurements where a fisheye sees nothing: another lens's coefficients may be the reason."""
    if np.count_nonzero(lost) > 10:  # a hundredth
        warn_caller(
            f"about {np.count_nonzero(lost) / lost.size:.0%} of this frame are measured where the fisheye lens has "
            "no ray within 85 degrees of its axis: they are left out; are the distortion's coefficients right?"
        )


def some_of(raw: NDArray[Any]) -> NDArray[Any]:
    """(F, K): about a thousand pixels of each frame (..., H, W), which often tell as much as all of them."""
    # A step without a common divisor with the width meets every column, whatever pattern the holes have.
    pixels = raw.shape[-2] * raw.shape[-1]
    step = max(1, pixels // 1024)
    while math.gcd(step, raw.shape[-1]) > 1:
        step += 1
    return raw.reshape(-1, pixels)[:, ::step]


def step_of(frame: DepthFrame) -> float:
    """Step between neighbouring raw values, of integers or of floats made from integers; 0 if there is none."""
    if frame.step > 0.0:
        return frame.step
    grain = _GRAIN_OF_DISPARITY if frame.is_disparity else _GRAIN
    grains = _measured(frame).astype(np.float64) / grain
    grains = grains[np.abs(grains) < _INDISTINCT]
    whole = np.rint(grains)
    # Single precision changes a number by 1e-7 of it.
    if (np.abs(grains - whole) > np.minimum(0.02 + 1e-7 * np.abs(grains), 0.3)).any():
        return 0.0
    return grain * _common_step(whole)


def spacing_of(frame: DepthFrame) -> float:
    """As `step_of`, or of integers all of which are multiples of a larger one, as millimetres in fifths, that one."""
    found = _common_step(_measured(frame)) if frame.step > 0.0 else 0
    return float(found) or step_of(frame)


def _measured(frame: DepthFrame) -> NDArray[Any]:
    """Some of the frame's valid raw values."""
    sample = some_of(frame.raw)[0]
    return np.asarray(sample[(sample >= frame.lowest) & (sample <= frame.highest)])


def _common_step(whole: NDArray[Any]) -> int:
    """The largest number of which all these whole ones are multiples; 0 if they are too few values to tell."""
    values = np.unique(whole)
    return int(np.gcd.reduce(values.astype(np.int64))) if len(values) >= _FEW_VALUES else 0


def _without(
    raw: NDArray[Any], invalid: NDArray[np.bool_], lowest: Any, highest: Any, missing: Any
) -> tuple[NDArray[Any], Any, Any]:
    """The frame with the values of some pixels replaced by one that lies outside the interval."""
    if not invalid.any():
        return raw, lowest, highest
    if missing is None:  # all 65536 codes are measurements
        raw, lowest, highest, missing = raw.astype(np.float64), float(lowest), float(highest), np.nan
    return np.where(invalid, raw.dtype.type(missing), raw), lowest, highest
