"""Which raw values of a depth frame are measurements: an interval, and those inside it that are none."""

from __future__ import annotations

import functools
import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Depths whose inverse, square and products stay finite in every kernel: the normal numbers of float32. Its largest
# stands for no depth in renderers' buffers.
ENDLESS = float(np.finfo(np.float32).max)
_NEAREST, _FARTHEST = float(np.finfo(np.float32).tiny), float(np.nextafter(np.float32(ENDLESS), np.float32(0.0)))

# The interval of raw values that are measurements, and those inside it that are none.
Valid = tuple[Any, Any, tuple[Any, ...]]


def measurements_of(sample: NDArray[Any], valid: Valid) -> NDArray[Any]:
    """The measurements among some raw values."""
    lowest, highest, holes = valid
    chosen: NDArray[Any] = sample[(sample >= lowest) & (sample <= highest)]
    for hole in holes:
        chosen = chosen[chosen != hole]
    return chosen


@functools.lru_cache(maxsize=256)
def validity(
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
