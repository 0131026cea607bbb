"""Where depth frames enter: any array from a sensor or a file, turned into what the kernels read.

Every kind of missing pixel folds into one test, ``lowest <= raw <= highest``, and every unit into one formula
for the inverse depth, so that a frame is read once and nothing is converted beforehand.
"""

from __future__ import annotations

import functools
import math
import os
import struct
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes.checks import plain_array, warn_caller
from rgbd_planes.files import naming

if TYPE_CHECKING:
    from rgbd_planes.camera import Camera

# Depths whose inverse, square and products stay finite in every kernel: the normal numbers of float32. Its largest
# stands for no depth in renderers' buffers.
_ENDLESS = float(np.finfo(np.float32).max)
_NEAREST, _FARTHEST = float(np.finfo(np.float32).tiny), float(np.nextafter(np.float32(_ENDLESS), np.float32(0.0)))

_PLAINLY_TOO_NEAR = 1.0  # metres
_PLAINLY_NOT_METRES = 50.0  # beyond the range of the sensors this is for; 50 mm is before it
_NEARER_THAN_ANY = 0.02  # metres; metres that are taken for millimetres do not reach it
_FEW_PIXELS = 800  # too few to say anything
_MANY_TIMES_FARTHER = 3.0  # than all others: of a renderer's far plane, or of a number that stands for missing

# No sensor measures these, some write them for missing pixels.
_LARGEST_NUMBERS = {65535.0: "the largest number of 16 bits", 32767.0: "the largest number of 16 bits and a sign"}
_LARGEST_NUMBERS |= {  # as metres that were made of millimetres
    float(kind(number / 1000.0)): f"as {number:g} mm are, {what}"
    for number, what in _LARGEST_NUMBERS.items()
    for kind in (np.float32, np.float64)
}

# Steps are multiples of these, which are finer than any sensor's. Disparities come in 16ths (OpenCV) to 256ths (KITTI).
_GRAIN, _GRAIN_OF_DISPARITY = 1e-5, 1.0 / 256.0  # metres, raw units
_INDISTINCT = 2.0**53  # grains: all larger numbers are whole
_FEW_VALUES = 50  # too few to say anything: a scene may have been made of whole numbers

# The interval of raw values that are measurements, and those inside it that are none.
Valid = tuple[Any, Any, tuple[Any, ...]]


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
    def values(self) -> tuple[NDArray[Any], Any, Any, float, float, bool]:
        """All but the step, as most kernels take them."""
        return self[:6]

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


def as_depth_frame(depth: ArrayLike, camera: Camera) -> DepthFrame:
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
        As `rgbd_planes.fit_tiles`.

    Notes
    -----
    Depths are missing if they are 0, negative, NaN, infinite, one of `camera.invalid_values` or outside
    `camera.depth_range`; so are pixels of a fisheye without a ray within 85 degrees of the axis, and depths below the
    smallest normal number of float32, 1.2e-38 m, or not below its largest, 3.4e38 m. Raw values of a disparity image
    are missing where 1/Z = scale * raw + offset is not positive, by `invalid_values`, and by `depth_range`: a raw 0 can
    be a measurement there, unless `invalid_values` names it.
    """
    array = plain_array("depth", depth)
    _check_shape(depth, array, camera)
    return _read(array, camera)


def as_numbered_frame(number: int, depth: ArrayLike, camera: Camera) -> DepthFrame:
    """`as_depth_frame` of one of many: an error begins with its number, from 0."""
    with naming(f"frame {number}"):
        return as_depth_frame(depth, camera)


def as_depth_frames(frames: NDArray[Any], camera: Camera) -> DepthFrame:
    """The same for an array of frames (F, H, W), all at once: ``raw`` has its shape."""
    array = plain_array("depth", frames)
    _check_shape(frames[0], array[0], camera)
    return _read(array, camera)


def _read(array: NDArray[Any], camera: Camera) -> DepthFrame:
    """`as_depth_frame` of a frame, or of several, (..., H, W)."""
    kind = array.dtype.kind
    if kind in "ui":
        if camera.depth_scale is None and camera.disparity is None:
            raise ValueError(
                "expected a camera with depth_scale (raw units per metre) or disparity (scale, offset) "
                f"for a frame of {array.dtype}, got a camera with neither"
            )
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
    lowest, highest, holes, missing = _validity(*read_as, camera.depth_range, camera.invalid_values)
    valid = lowest, highest, holes
    if camera.depth_range is not None and camera.depth_range[0] > _PLAINLY_NOT_METRES:
        at_any_depth = _validity(*read_as, None, camera.invalid_values)[:3]
        for sample in samples:
            if len(_measured(sample, at_any_depth)) > 10 and not len(_measured(sample, valid)):
                _warn_of_the_range(*camera.depth_range)
    if disparity is not None:
        for sample in samples:
            _warn_of_disparity(sample, valid, disparity, camera.depth_range, camera.invalid_values)
    else:
        assert depth_scale is not None
        for sample in samples:
            sample = _without_missing(sample, valid, depth_scale, camera.depth_range)
            _warn_of_units(sample, valid, array.dtype, depth_scale, camera.depth_range)
    invalid = [raw == value for value in holes]
    if camera._without_ray is not None:
        invalid.append(camera._without_ray)
        for sample in samples:
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


def _check_shape(depth: ArrayLike, array: NDArray[Any], camera: Camera) -> None:
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
        reason = ": TileFitter.fit_batch takes several frames"
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
    else:
        reason = ""
    raise ValueError(
        f"expected a depth frame of shape (height, width) = {expected}, as the camera's, got {array.shape}{reason}"
    )


def _measured(sample: NDArray[Any], valid: Valid) -> NDArray[Any]:
    """The measurements among some raw values."""
    lowest, highest, holes = valid
    measured: NDArray[Any] = sample[(sample >= lowest) & (sample <= highest)]
    for hole in holes:
        measured = measured[measured != hole]
    return measured


def _without_missing(
    sample: NDArray[Any], valid: Valid, depth_scale: float, depth_range: tuple[float, float] | None
) -> NDArray[Any]:
    """Leave out a number that most likely means missing, and would count as a far plane, and warn of it."""
    farthest = _PLAINLY_NOT_METRES * depth_scale

    def is_doubtful(largest: float) -> bool:
        return largest > farthest or largest in _LARGEST_NUMBERS

    # Mostly an eighth of the pixels shows that there is none, and for so few Python is faster than NumPy. NaN is never
    # the largest after a number.
    if not is_doubtful(max(0.0, *sample[::8].tolist())):
        return sample
    measured = _measured(sample, valid)
    largest = measured.max(initial=0)
    if not is_doubtful(largest.item()):
        return sample
    others = measured[measured < largest]
    if len(measured) - len(others) <= 10:  # a hundredth
        return sample
    what = _LARGEST_NUMBERS.get(largest.item())
    if what is None:
        is_meant = depth_range is not None and depth_range[1] > _PLAINLY_NOT_METRES
        if is_meant or not len(others) or largest <= _MANY_TIMES_FARTHER * others.max():
            return sample
        what = "many times farther than all others"
    number = str(largest).removesuffix(".0")  # with as many digits as it takes
    warn_caller(
        f"many pixels are {number}, {what}: are they missing? A camera with invalid_values=({number},) says so, "
        "or with a depth_range that ends before"
    )
    rest: NDArray[Any] = sample[sample != largest]
    return rest


def _warn_of_units(
    sample: NDArray[Any],
    valid: Valid,
    dtype: np.dtype[Any],
    depth_scale: float,
    depth_range: tuple[float, float] | None,
) -> None:
    """Warn of a frame that is most likely not in the units that it is taken for."""
    _warn_of_the_nearest(sample, dtype, depth_scale, depth_range)
    farthest = _PLAINLY_NOT_METRES * depth_scale
    if dtype == np.uint16 and 2.0 * farthest > 65535:
        return  # the common case takes no time: at 1000 units per metre such a frame hardly reaches beyond
    near = depth_range is not None and depth_range[1] <= _PLAINLY_TOO_NEAR
    if dtype == np.uint8 and _PLAINLY_TOO_NEAR * depth_scale > 255 and not near:
        warn_caller(
            f"a frame of 8 bits with a depth_scale of {depth_scale:g} per metre ends at {255 / depth_scale:.2g} m: "
            "is it a picture of the depth?"
        )
    if depth_range is not None and depth_range[1] > _PLAINLY_NOT_METRES:
        return
    far = np.count_nonzero((sample > farthest) & (sample < _ENDLESS))
    if not (far and 2 * far > np.count_nonzero((sample > 0) & (sample < _ENDLESS))):
        return
    measured = _measured(sample, valid)
    if len(measured) > 10 and 2 * np.count_nonzero(measured > farthest) <= len(measured):
        return  # the camera says that what is far means missing
    if dtype.kind == "f":
        warn_caller(
            f"float depth is in metres, but most of this frame is beyond {_PLAINLY_NOT_METRES:g} m: "
            "millimetres? depth_scale applies to integer frames only; divide the frame by it"
        )
    else:
        warn_caller(
            f"with a depth_scale of {depth_scale:g} per metre most of this frame is beyond "
            f"{_PLAINLY_NOT_METRES:g} m: is it in millimetres, depth_scale=1000?"
        )


def _warn_of_the_nearest(
    sample: NDArray[Any], dtype: np.dtype[Any], depth_scale: float, depth_range: tuple[float, float] | None
) -> None:
    """Warn of a frame that ends nearer than sensors begin."""
    nearest = _NEARER_THAN_ANY * depth_scale
    # Mostly a few pixels show it, and for so few Python is faster than NumPy.
    if sample.size < _FEW_PIXELS or any(nearest <= value < _ENDLESS for value in sample[::64].tolist()):
        return
    measured = sample[(sample > 0) & (sample < _ENDLESS)]
    if not len(measured) or measured.max() >= nearest:
        return
    if depth_range is not None and depth_range[1] <= _NEARER_THAN_ANY:
        return
    said = "float depth is in metres, but" if dtype.kind == "f" else f"with a depth_scale of {depth_scale:g} per metre"
    warn_caller(
        f"{said} all of this frame is nearer than {_NEARER_THAN_ANY:g} m: is it in other units, "
        "or metres that were divided by 1000 or made integers?"
    )


def _warn_of_disparity(
    sample: NDArray[Any],
    valid: Valid,
    disparity: tuple[float, float],
    depth_range: tuple[float, float] | None,
    invalid_values: Sequence[float],
) -> None:
    """Warn of a disparity image whose depths are none of a camera's: most likely it is their scale."""
    scale, offset = disparity
    farthest, nearest = 1.0 / _PLAINLY_NOT_METRES, 1.0 / _NEARER_THAN_ANY
    if abs(scale) == 1.0 or sample.size < _FEW_PIXELS:  # relative disparities have no unit
        return
    # Mostly a few pixels show that nothing is wrong, and for so few Python is faster than NumPy.
    few = sample[::64].tolist()
    if 2 * sum(farthest <= scale * value + offset <= nearest for value in few) > len(few):
        return
    q = scale * sample[~np.isin(sample, invalid_values)].astype(np.float64) + offset
    q = q[(q > 0.0) & (q < np.inf)]
    ends = None if depth_range is None else depth_range[1]
    if len(q) and q.min() > nearest and (ends is None or ends > _NEARER_THAN_ANY):
        where = f"all of this frame is nearer than {_NEARER_THAN_ANY:g} m"
    elif 2 * np.count_nonzero(q < farthest) > len(q) and (ends is None or ends <= _PLAINLY_NOT_METRES):
        measured = _measured(sample, valid)
        if len(measured) > 10 and 2 * np.count_nonzero(scale * measured + offset < farthest) <= len(measured):
            return  # the camera says that what is far means missing
        where = f"most of this frame is beyond {_PLAINLY_NOT_METRES:g} m"
    else:
        return
    warn_caller(
        f"with disparity=({scale:g}, {offset:g}) {where}: the scale is 1 / (focal length in pixels * baseline in "
        "metres), over the raw units of a pixel if these are more than one. A scale of 1 says that it is not known"
    )


def _warn_of_the_range(nearest: float, farthest: float) -> None:
    """Warn of a range that has none of a frame's depths, and begins beyond them."""
    warn_caller(
        f"nothing in this frame is between the {nearest:g} and {farthest:g} m of the camera's depth_range: "
        f"is it in millimetres? In metres that is depth_range=({nearest / 1000:g}, {farthest / 1000:g})"
    )


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
    sample = some_of(frame.raw)[0]
    grains = sample[(sample >= frame.lowest) & (sample <= frame.highest)].astype(np.float64) / grain
    grains = grains[np.abs(grains) < _INDISTINCT]
    whole = np.rint(grains)
    # Single precision changes a number by 1e-7 of it.
    if (np.abs(grains - whole) > np.minimum(0.02 + 1e-7 * np.abs(grains), 0.3)).any():
        return 0.0
    values = np.unique(whole)
    return grain * int(np.gcd.reduce(values.astype(np.int64))) if len(values) >= _FEW_VALUES else 0.0


def _without(
    raw: NDArray[Any], invalid: NDArray[np.bool_], lowest: Any, highest: Any, missing: Any
) -> tuple[NDArray[Any], Any, Any]:
    """The frame with the values of some pixels replaced by one that lies outside the interval."""
    if not invalid.any():
        return raw, lowest, highest
    if missing is None:  # all 65536 codes are measurements
        raw, lowest, highest, missing = raw.astype(np.float64), float(lowest), float(highest), np.nan
    return np.where(invalid, raw.dtype.type(missing), raw), lowest, highest


@functools.lru_cache(maxsize=256)
def _validity(
    dtype: str,
    stored: str,
    depth_scale: float | None,
    disparity: tuple[float, float] | None,
    depth_range: tuple[float, float] | None,
    invalid_values: tuple[float, ...],
) -> tuple[Any, Any, tuple[Any, ...], Any]:
    """The interval of raw values that are measurements; the invalid values inside it; a value outside it.

    For values of type ``dtype`` that were of type ``stored`` and may only have its digits: limits in metres get these
    too.
    """
    nearest, farthest = depth_range or (0.0, math.inf)
    scalar, as_stored = np.dtype(dtype).type, np.dtype(stored).type
    if scalar is not np.uint16 and depth_scale == 1.0:
        with np.errstate(over="ignore"):
            nearest, farthest = float(as_stored(nearest)), float(as_stored(farthest))
    nearest, farthest = max(nearest, _NEAREST), min(farthest, _FARTHEST)

    def depth_of(raw: Any) -> Any:
        if disparity is None:
            return raw / depth_scale
        with np.errstate(all="ignore"):
            q = disparity[0] * np.asarray(raw) + disparity[1]
            return np.where(q > 0, 1.0 / q, np.inf)

    def not_too_near(raw: Any) -> Any:
        return depth_of(raw) >= nearest

    def not_too_far(raw: Any) -> Any:
        return depth_of(raw) <= farthest

    if scalar is np.uint16:
        codes = np.arange(65536.0)
        measured = not_too_near(codes) & not_too_far(codes)
        valid = np.flatnonzero(measured & ~np.isin(codes, invalid_values))
        if not len(valid):
            return np.uint16(1), np.uint16(0), (), None
        low, high = int(valid[0]), int(valid[-1])
        holes = tuple(np.uint16(v) for v in invalid_values if low < v < high and v == int(v))
        missing = low - 1 if low > 0 else high + 1 if high < 65535 else None
        return np.uint16(low), np.uint16(high), holes, missing
    above, below = not_too_near, not_too_far
    if disparity is not None and disparity[0] > 0:  # a larger disparity is nearer
        above, below = below, above
    lowest = _first_float(above, scalar)
    highest = -_first_float(lambda raw: below(-raw), scalar)
    with np.errstate(over="ignore"):  # what float32 does not hold is infinite there: no measurement anyway
        values = {scalar(as_stored(v)) for v in invalid_values}
    return scalar(lowest), scalar(highest), tuple(v for v in values if lowest <= v <= highest), np.nan


def _first_float(holds: Callable[[float], bool], scalar: Any) -> float:
    """The smallest float for which a condition holds that, once true, stays true; inf if there is none.

    Bisection over the floats themselves, in their order: exact where a formula would be rounded.
    """
    size, float_format, int_format = (32, "<f", "<i") if scalar is np.float32 else (64, "<d", "<q")

    def nth(index: int) -> float:
        bits = index if index >= 0 else -index - 2 ** (size - 1)
        return float(struct.unpack(float_format, struct.pack(int_format, bits))[0])

    infinity = struct.unpack(int_format, struct.pack(float_format, math.inf))[0]
    below, first = -infinity, infinity
    while first - below > 1:
        middle = (below + first) // 2
        if holds(nth(middle)):
            first = middle
        else:
            below = middle
    return nth(first)
