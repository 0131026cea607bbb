"""Checks of arguments shared by the public functions: an error says what was expected and what came."""

import math
import os
import sys
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray


class FixedArguments:
    """A base of classes that prepare their work from their arguments, and would not follow a change of them."""

    if not TYPE_CHECKING:  # which would take it for leave to set anything

        def __setattr__(self, name: str, value: Any) -> None:
            if not name.startswith("_"):
                raise AttributeError(
                    f"expected no change of a {type(self).__name__}, got {name} = {value!r}: make a new one with it"
                )
            object.__setattr__(self, name, value)

        def __delattr__(self, name: str) -> None:
            raise AttributeError(f"expected no change of a {type(self).__name__}, got {name} deleted")


def check_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    """Raise ValueError unless ``value`` is one of ``choices``."""
    if not isinstance(value, str) or value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(choices)}, got {value!r}")


def check_share(name: str, value: float) -> float:
    """Return a number between 0 and 1 as a float."""
    share = number(name, value, finite=False)
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"{name} must be between 0 and 1, got {value!r}")
    return share


def check_bool(name: str, value: Any) -> bool:
    """Return True or False, which may be NumPy's."""
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"expected {name} as True or False, got {value!r}")
    return bool(value)


def check_whole(name: str, value: int, least: int, kind: str = "whole number", bits: int = 63) -> int:
    """Return a whole number of at least ``least`` as an int: NumPy's small integers would overflow."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{name} must be a {kind}, got {value!r}")
    if value < least:
        raise ValueError(f"{name} must be at least {least}, got {value!r}")
    if value >= 2**bits:  # no kernel takes one of 64 bits
        raise ValueError(f"{name} must be below 2**{bits}, got {value!r}")
    return int(value)


def check_window(window: int) -> int:
    """Return the side of the square window around a pixel as an int."""
    side = check_whole("window", window, 3, "whole number of pixels")
    if side > 31 or side % 2 == 0:
        raise ValueError(f"window must be odd, from 3 to 31 pixels, got {window}")
    return side


def check_num_threads(num_threads: int | None) -> int | None:
    """Return a whole number of at least 1 as an int, or None."""
    return None if num_threads is None else check_whole("num_threads", num_threads, 1, "whole number, or None")


def check_max_error(max_error: float | None) -> float:
    """Return the largest permitted residual in metres: infinity for None."""
    if max_error is None:
        return math.inf
    metres = number("max_error", max_error, finite=False)
    if not metres > 0.0:
        raise ValueError(f"max_error must be a positive length in metres, or None, got {max_error!r}")
    return metres


def _is_masked(values: Any) -> bool:
    # Without their module, which takes time to import, there are no masked arrays.
    return "numpy.ma" in sys.modules and isinstance(values, np.ma.MaskedArray)


def plain_array(name: str, values: Any) -> NDArray[Any]:
    """Return anything but a masked array as an array: masked entries would otherwise be used as data."""
    if _is_masked(values):
        raise TypeError(f"expected a plain array, got a masked array: fill it first, {name}.filled(0)")
    if hasattr(values, "__dlpack__") and not isinstance(values, np.ndarray):
        return _from_elsewhere(name, values)
    try:
        return np.asarray(values)
    except ValueError:  # lists of different lengths, say
        kind = type(values).__name__
        raise ValueError(f"expected {name} as an array, got a {kind} of which NumPy makes none") from None


def _from_elsewhere(name: str, values: Any) -> NDArray[Any]:
    """An array of another library, in the same memory if it is the CPU's.

    Raises
    ------
    TypeError
        It is elsewhere, or its library does not give it, with the way on.
    """
    kind = f"{type(values).__module__}.{type(values).__name__}"
    device = values.__dlpack_device__()[0] if hasattr(values, "__dlpack_device__") else _ON_CPU
    if device != _ON_CPU:
        raise TypeError(
            f"expected {name} in the CPU's memory, got a {kind} on another device: copy it first, by .cpu() of torch, "
            ".get() of CuPy or numpy.asarray of JAX"
        )
    try:
        return np.asarray(values) if hasattr(values, "__array__") else np.from_dlpack(values)
    except (BufferError, RuntimeError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise TypeError(f"expected {name} as an array, got a {kind} that gives none: {reason}") from None


_ON_CPU = 1  # as DLPack counts devices


def label_array(name: str, labels: Any) -> NDArray[Any]:
    """Return integers, or a mask, as an array, unless they are in a masked array."""
    if isinstance(labels, (str, os.PathLike)):
        kind = type(labels).__name__
        raise TypeError(f"expected {name} as an array, got {kind}: rgbd_planes.images.read_depth reads a file")
    if hasattr(labels, "labels"):
        raise TypeError(f"expected {name} as an array, got {type(labels).__name__}: its .labels are one")
    array = plain_array(name, labels)
    if array.dtype.kind not in "iub":
        raise TypeError(f"{name} must be integers, or a mask, got dtype {array.dtype}")
    return array


def real_array(name: str, values: Any) -> NDArray[np.float64]:
    """Return numbers as an array of floats, unless they are in a masked array."""
    array = plain_array(name, values)
    if array.dtype.kind not in "biufO":  # NumPy would read text as numbers, and drop imaginary parts
        raise TypeError(f"expected {name} as numbers, got an array of {array.dtype}")
    if array.dtype == object and None in array.ravel().tolist():  # NaN to NumPy
        raise TypeError(f"expected {name} as numbers, got None")
    try:
        return array.astype(np.float64, copy=False)
    except (OverflowError, TypeError, ValueError):
        raise TypeError(f"expected {name} as numbers, got {array.flat[0]!r}") from None


def shaped_array(name: str, values: Any, entries: tuple[int, ...]) -> NDArray[np.float64]:
    """Return numbers as an array of floats whose last axes are as long as ``entries``."""
    array = real_array(name, values)
    if array.shape[-len(entries) :] != entries:
        expected = ", ".join(("...", *map(str, entries)))
        raise ValueError(f"expected {name} of shape ({expected}), got {array.shape}")
    return array


def each_of(frames: Any) -> Iterator[Any]:
    """Return the iterator of something that gives frames one after the other."""
    try:
        return iter(frames)
    except TypeError:
        raise TypeError(f"expected frames, as an iterable, got {type(frames).__name__}") from None


def check_labels(labels: NDArray[Any], most: int) -> None:
    """Raise ValueError unless labels are 0 to ``most``: a result has a row for each, up to the largest."""
    if labels.size and (labels.min() < 0 or labels.max() > most):
        if labels.min() == -1 and labels.max() < most:
            hint = "labels + 1 are, if -1 is none"
        else:  # the smallest becomes 0
            hint = f"np.unique(labels, return_inverse=True)[1]{'' if labels.min() == 0 else ' + 1'} numbers others"
        raise ValueError(f"labels must be 0 for none, and 1 to K, got {labels.min()} to {labels.max()}: {hint}")


_NO_NUMBERS = (bool, str, bytes, bytearray, memoryview)  # most of which float takes


def number(name: str, value: Any, *, finite: bool = True) -> float:
    """Return a number as a float."""
    kind = getattr(getattr(value, "dtype", None), "kind", None)
    if isinstance(value, _NO_NUMBERS) or kind in ("b", "c") or _is_masked(value):
        raise TypeError(f"expected {name} as a number, got {value!r}")
    try:
        converted = float(value)
    except OverflowError:  # a whole number that no float holds
        converted = math.inf if value > 0 else -math.inf
    except (TypeError, ValueError):
        raise TypeError(f"expected {name} as a number, got {value!r}") from None
    if finite and not math.isfinite(converted):
        raise ValueError(f"expected {name} as a finite number, got {value!r}")
    return converted


def numbers(name: str, values: Any, *, finite: bool = True) -> tuple[float, ...]:
    """Return a sequence of numbers as floats."""
    if isinstance(values, np.ndarray):
        values = plain_array(name, values)
    listed = isinstance(values, Sequence) or (isinstance(values, np.ndarray) and values.ndim == 1)
    if not listed or isinstance(values, _NO_NUMBERS) or any(value is None for value in values):
        raise TypeError(f"expected {name} as a sequence of numbers, got {values!r}")
    return tuple(number(name, value, finite=finite) for value in values)
