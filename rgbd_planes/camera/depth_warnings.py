"""Warn of depth frames that are most likely in other units than they are taken for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.user_warnings import warn_caller
from rgbd_planes.camera.depth_validity import ENDLESS, Valid, measurements_of

_PLAINLY_TOO_NEAR = 1.0  # metres
PLAINLY_NOT_METRES = 50.0  # beyond the range of the sensors this is for; 50 mm is before it
_NEARER_THAN_ANY = 0.02  # metres; metres that are taken for millimetres do not reach it
_FEW_PIXELS = 800  # too few to say anything
_FEWEST_DISPARITIES = 5  # different ones; fewer are numbers that stand for missing
_ROWS_LOOKED_AT, _FEW_STEPS = 8, 50  # for swapped bytes
_SWAPPED_REACH = 4096  # of which a frame of swapped bytes has larger values, as long as some lower byte is above 15
_MANY_TIMES_FARTHER = 3.0  # than all others: of a renderer's far plane, or of a number that stands for missing

# No sensor measures these, some write them for missing pixels.
_LARGEST_NUMBERS = {65535.0: "the largest number of 16 bits", 32767.0: "the largest number of 16 bits and a sign"}
_LARGEST_NUMBERS |= {  # as metres that were made of millimetres
    float(kind(number / 1000.0)): f"as {number:g} mm are, {what}"
    for number, what in _LARGEST_NUMBERS.items()
    for kind in (np.float32, np.float64)
}
_LEAST_DOUBTFUL = min(_LARGEST_NUMBERS)
_LEAST_DOUBTFUL_WHOLE = min(filter(float.is_integer, _LARGEST_NUMBERS))


def warn_of_units(
    sample: NDArray[Any],
    valid: Valid,
    dtype: np.dtype[Any],
    depth_scale: float,
    depth_range: tuple[float, float] | None,
) -> None:
    """Warn of a frame that is most likely not in the units that it is taken for, or has a number that means missing."""
    if _is_ordinary(sample, dtype, depth_scale):
        return
    if _points_backwards(sample):
        warn_caller(
            "all depths of this frame are negative, which means missing: does its z axis point backwards, as OpenGL's? "
            "Then -depth is in front of the camera"
        )
        return
    sample = _without_missing(sample, valid, depth_scale, depth_range)
    _warn_of_the_nearest(sample, dtype, depth_scale, depth_range)
    farthest = PLAINLY_NOT_METRES * depth_scale
    if _ends_before(farthest, dtype):
        return
    near = depth_range is not None and depth_range[1] <= _PLAINLY_TOO_NEAR
    if dtype == np.uint8 and _PLAINLY_TOO_NEAR * depth_scale > 255 and not near:
        warn_caller(
            f"a frame of 8 bits with a depth_scale of {depth_scale:g} per metre ends at {255 / depth_scale:.2g} m: "
            "is it a picture of the depth?"
        )
    if depth_range is not None and depth_range[1] > PLAINLY_NOT_METRES:
        return
    far = np.count_nonzero((sample > farthest) & (sample < ENDLESS))
    if not (far and 2 * far > np.count_nonzero((sample > 0) & (sample < ENDLESS))):
        return
    measured = measurements_of(sample, valid)
    if len(measured) > 10 and 2 * np.count_nonzero(measured > farthest) <= len(measured):
        return  # the camera says that what is far means missing
    if dtype.kind == "f":
        warn_caller(
            f"float depth is in metres, but most of this frame is beyond {PLAINLY_NOT_METRES:g} m: "
            "millimetres? depth_scale applies to integer frames only; divide the frame by it"
        )
    else:
        warn_caller(
            f"with a depth_scale of {depth_scale:g} per metre most of this frame is beyond "
            f"{PLAINLY_NOT_METRES:g} m: is it in millimetres, depth_scale=1000?"
        )


def _is_ordinary(sample: NDArray[Any], dtype: np.dtype[Any], depth_scale: float) -> bool:
    """Whether the largest number alone shows that there is nothing to warn of; mostly it does."""
    farthest = PLAINLY_NOT_METRES * depth_scale
    some = sample[::8] if _ends_before(farthest, dtype) else sample
    largest = float(np.fmax.reduce(some))  # NaN, which compares as False, only where there is no number
    doubtful = _LEAST_DOUBTFUL if dtype.kind == "f" else _LEAST_DOUBTFUL_WHOLE
    return _NEARER_THAN_ANY * depth_scale <= largest < doubtful and largest <= farthest and dtype.itemsize > 1


def _points_backwards(sample: NDArray[Any]) -> bool:
    """Whether depths are negative, and not by a number that stands for missing."""
    negative = sample[sample < 0]
    return len(negative) > 10 and bool(negative.min() < negative.max()) and not (sample > 0).any()


def _ends_before(farthest: float, dtype: np.dtype[Any]) -> bool:
    """Whether most of a frame cannot be plainly too far: at 1000 units per metre those of 16 bits hardly reach it."""
    return dtype == np.uint16 and 2.0 * farthest > 65535


def _without_missing(
    sample: NDArray[Any], valid: Valid, depth_scale: float, depth_range: tuple[float, float] | None
) -> NDArray[Any]:
    """Leave out a number that most likely means missing, and would count as a far plane, and warn of it."""
    farthest = PLAINLY_NOT_METRES * depth_scale

    def is_doubtful(largest: float) -> bool:
        return largest > farthest or largest in _LARGEST_NUMBERS

    # Mostly an eighth of the pixels shows that there is none, and for so few Python is faster than NumPy. NaN is never
    # the largest after a number.
    if not is_doubtful(max(0.0, *sample[::8].tolist())):
        return sample
    measured = measurements_of(sample, valid)
    largest = measured.max(initial=0)
    if not is_doubtful(largest.item()):
        return sample
    others = measured[measured < largest]
    if len(measured) - len(others) <= 10:  # a hundredth
        return sample
    what = _LARGEST_NUMBERS.get(largest.item())
    if what is None:
        is_meant = depth_range is not None and depth_range[1] > PLAINLY_NOT_METRES
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


def _warn_of_the_nearest(
    sample: NDArray[Any], dtype: np.dtype[Any], depth_scale: float, depth_range: tuple[float, float] | None
) -> None:
    """Warn of a frame that ends nearer than sensors begin."""
    nearest = _NEARER_THAN_ANY * depth_scale
    # Mostly a few pixels show it, and for so few Python is faster than NumPy.
    if sample.size < _FEW_PIXELS or any(nearest <= value < ENDLESS for value in sample[::64].tolist()):
        return
    measured = sample[(sample > 0) & (sample < ENDLESS)]
    if not len(measured) or measured.max() >= nearest:
        return
    if depth_range is not None and depth_range[1] <= _NEARER_THAN_ANY:
        return
    said = "float depth is in metres, but" if dtype.kind == "f" else f"with a depth_scale of {depth_scale:g} per metre"
    warn_caller(
        f"{said} all of this frame is nearer than {_NEARER_THAN_ANY:g} m: is it in other units, "
        "or metres that were divided by 1000 or made integers?"
    )


def warn_of_disparity(
    sample: NDArray[Any],
    valid: Valid,
    disparity: tuple[float, float],
    depth_range: tuple[float, float] | None,
    invalid_values: Sequence[float],
) -> None:
    """Warn of a disparity image whose depths are none of a camera's: most likely it is their scale."""
    scale, offset = disparity
    if _are_all_behind(sample, disparity, invalid_values):
        warn_caller(
            f"with disparity=({scale:g}, {offset:g}) no 1/Z = scale * raw + offset of this frame is positive, and all "
            f"of it is missing: its values are {np.nanmin(sample):g} to {np.nanmax(sample):g}. If they have the other "
            f"sign, as some stereo matchers give it, disparity=({-scale:g}, {offset:g}) reads them"
        )
        return
    if abs(scale) == 1.0 or sample.size < _FEW_PIXELS:  # relative disparities have no unit
        return
    if valid[0] <= 0:
        _warn_of_the_lowest(measurements_of(sample, valid))
    farthest, nearest = 1.0 / PLAINLY_NOT_METRES, 1.0 / _NEARER_THAN_ANY
    # Mostly a few pixels show that nothing is wrong, and for so few Python is faster than NumPy.
    few = sample[::64].tolist()
    if 2 * sum(farthest <= scale * value + offset <= nearest for value in few) > len(few):
        return
    q = scale * sample[~np.isin(sample, invalid_values)].astype(np.float64) + offset
    q = q[(q > 0.0) & (q < np.inf)]
    ends = None if depth_range is None else depth_range[1]
    if len(q) and q.min() > nearest and (ends is None or ends > _NEARER_THAN_ANY):
        where = f"all of this frame is nearer than {_NEARER_THAN_ANY:g} m"
    elif 2 * np.count_nonzero(q < farthest) > len(q) and (ends is None or ends <= PLAINLY_NOT_METRES):
        measured = measurements_of(sample, valid)
        if len(measured) > 10 and 2 * np.count_nonzero(scale * measured + offset < farthest) <= len(measured):
            return  # the camera says that what is far means missing
        where = f"most of this frame is beyond {PLAINLY_NOT_METRES:g} m"
    else:
        return
    warn_caller(
        f"with disparity=({scale:g}, {offset:g}) {where}: the scale is 1 / (focal length in pixels * baseline in "
        "metres), over the raw units of a pixel if these are more than one. A scale of 1 says that it is not known"
    )


def _are_all_behind(sample: NDArray[Any], disparity: tuple[float, float], invalid_values: Sequence[float]) -> bool:
    """Whether a frame has many disparities, and all of them mean missing by their sign."""
    scale, offset = disparity
    # Mostly a few pixels show that some are measurements.
    if sample.size < _FEW_PIXELS or any(scale * value + offset > 0.0 for value in sample[::64].tolist()):
        return False
    values = sample[np.isfinite(sample) & ~np.isin(sample, invalid_values)].astype(np.float64)
    if len(values) <= 10 or not bool((scale * values + offset <= 0.0).all()):
        return False
    return len(np.unique(values)) > _FEWEST_DISPARITIES


def warn_of_swapped_bytes(raw: NDArray[Any]) -> None:
    """Warn of a frame of integers whose two bytes are in the other order.

    Neighbouring pixels differ by a little, which then is in the upper byte: their difference is a multiple of 256, but
    their values are not.
    """
    # Mostly one row shows at once that neighbours differ by other numbers, too.
    row = raw[len(raw) // 2]
    is_measured = row > 0
    differing = (row[1:] ^ row[:-1])[is_measured[1:] & is_measured[:-1]]
    if 2 * np.count_nonzero(differing & 255) > max(int(np.count_nonzero(differing)), _FEW_STEPS):
        return
    rows = raw[:: max(1, raw.shape[0] // _ROWS_LOOKED_AT)]
    if not rows.size or rows.max() < _SWAPPED_REACH:
        return
    left, right = rows[:, :-1].astype(np.int64), rows[:, 1:].astype(np.int64)
    step = np.abs(right - left)[(left > 0) & (right > 0)]
    step = step[step > 0]
    values = left[left > 0]
    if len(step) < _FEW_STEPS or np.mean(step % 256 == 0) < 0.5 or np.mean(values % 256 == 0) > 0.5:
        return
    warn_caller(
        "neighbouring pixels of this frame differ by multiples of 256: are its bytes in the other order? "
        "frame.byteswap() swaps them, and sequence.with_swapped_bytes() those of a sequence"
    )


def _warn_of_the_lowest(measured: NDArray[Any]) -> None:
    """Warn of a disparity of 0, or less, that many pixels have: mostly it stands for missing."""
    lowest = measured.min(initial=1)
    if lowest > 0 or np.count_nonzero(measured == lowest) <= 10:  # a hundredth
        return
    number = str(lowest).removesuffix(".0")
    warn_caller(
        f"many pixels have a disparity of {number}, which is a depth, too, with the camera's offset: are they missing? "
        f"A camera with invalid_values=({number},) says so"
    )


def warn_of_the_range(nearest: float, farthest: float) -> None:
    """Warn of a range that has none of a frame's depths, and begins beyond them."""
    warn_caller(
        f"nothing in this frame is between the {nearest:g} and {farthest:g} m of the camera's depth_range: "
        f"is it in millimetres? In metres that is depth_range=({nearest / 1000:g}, {farthest / 1000:g})"
    )
