"""Operations counted: the kernels' own source, run by the interpreter on numbers that tally what is done.

A `Number` adds, multiplies and divides as a float does and tallies each operation. It is contagious: what is
computed from one is one. So what starts as a `Number` decides what is counted: the depth alone gives the
operations that a frame costs when the camera terms are known beforehand; depth and rays give all of them.
"""

import types
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from bench import prior_kernels
from rgbd_planes.kernels.common.depth import RawFrame
from rgbd_planes.kernels.moments import summed_area
from rgbd_planes.kernels.moments import windows as window_pixels

PAPER_OPERATIONS_PER_TABLE = 4
"""Operations that a table costs per pixel, whatever its argument (the paper's section on integral images)."""


class Number:
    """A float that tallies the operations done on it."""

    __slots__ = ("tally", "value")

    def __init__(self, value: float, tally: Counter[str]) -> None:
        self.value = float(value)
        self.tally = tally

    def _done(self, operation: str, value: float) -> "Number":
        self.tally[operation] += 1
        return Number(value, self.tally)

    def __add__(self, other: "Number | float") -> "Number":
        return self._done("additions", self.value + float(other))

    __radd__ = __add__

    def __sub__(self, other: "Number | float") -> "Number":
        return self._done("additions", self.value - float(other))

    def __rsub__(self, other: float) -> "Number":
        return self._done("additions", float(other) - self.value)

    def __mul__(self, other: "Number | float") -> "Number":
        return self._done("multiplications", self.value * float(other))

    __rmul__ = __mul__

    def __truediv__(self, other: "Number | float") -> "Number":
        # The depth is divided by the raw units in a metre: what makes a depth of a sensor's integers.
        conversion = isinstance(other, Unit)
        return self._done("conversions" if conversion else "divisions", self.value / float(other))

    def __rtruediv__(self, other: float) -> "Number":
        return self._done("divisions", float(other) / self.value)

    def __lt__(self, other: "Number | float") -> bool:
        return self.value < float(other)

    def __le__(self, other: "Number | float") -> bool:
        return self.value <= float(other)

    def __gt__(self, other: "Number | float") -> bool:
        return self.value > float(other)

    def __ge__(self, other: "Number | float") -> bool:
        return self.value >= float(other)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, (Number, float, int)) and self.value == float(other)

    def __ne__(self, other: object) -> bool:
        return not self == other

    __hash__ = None  # type: ignore[assignment]

    def __float__(self) -> float:
        return self.value


class Unit(float):
    """Raw units per metre: dividing by it converts a unit, and is tallied as that."""


@dataclass(frozen=True)
class Count:
    """Operations per pixel.

    Attributes
    ----------
    tables : int
        Sums per pixel: summed-area tables, or sums over a window.
    additions, multiplications, divisions, conversions : float
        What the algorithm really executes. A conversion is the division that turns a raw value into metres.
    arguments : float
        Multiplications and divisions that the depth enters, conversions aside: the paper's C, summed over all
        tables. It takes Z as measured and the camera terms as known.
    """

    tables: int
    additions: float
    multiplications: float
    divisions: float
    conversions: float
    arguments: float

    @property
    def paper_convention(self) -> float:
        """N(C + 4) of the paper, summed over the tables, per pixel."""
        return self.arguments + PAPER_OPERATIONS_PER_TABLE * self.tables

    @property
    def executed(self) -> float:
        """All operations that are executed, per pixel."""
        return self.additions + self.multiplications + self.divisions + self.conversions

    def to_dict(self) -> dict[str, float]:
        """The fields and the two sums."""
        return asdict(self) | {"paper_convention": self.paper_convention, "executed": self.executed}


def plain(kernel: Any) -> Callable[..., Any]:
    """The plain Python function of a kernel, in which all kernels that it calls are plain too."""
    function = kernel.py_func
    used = {name: function.__globals__[name] for name in function.__code__.co_names if name in function.__globals__}
    scope = {name: plain(value) if hasattr(value, "py_func") else value for name, value in used.items()}
    # Scratch rows must hold numbers that count.
    scope["np"] = types.SimpleNamespace(empty=lambda shape: np.empty(shape, object))
    return types.FunctionType(function.__code__, scope, function.__name__)


def numbers(values: np.ndarray[Any, Any], tally: Counter[str]) -> np.ndarray[Any, Any]:
    """An array of `Number` with these values."""
    return np.array([Number(value, tally) for value in values.ravel()], object).reshape(values.shape)


# A frame so small that a pure Python loop takes no time. The counts per pixel do not depend on its size.
HEIGHT, WIDTH = 6, 8


def _run(kernel: Any, standard: bool | None, tables: int, rays_count: bool, window: bool) -> Counter[str]:
    """Tally one run of a kernel on a frame without missing pixels."""
    tally: Counter[str] = Counter()
    rng = np.random.default_rng(0)
    depth = rng.uniform(1000.0, 3000.0, (HEIGHT, WIDTH))
    x, y = (rng.uniform(-0.5, 0.5, (HEIGHT, WIDTH)) for _ in range(2))
    rays = tuple(numbers(table, tally) if rays_count else table for table in (x, y))
    frame = RawFrame(numbers(depth, tally), 0.0, np.inf, Unit(1000.0), 0.0, False)
    if window:
        moments = np.empty((10, 1), object)
        plain(kernel)(frame, rays, standard, np.array([[0, 0, HEIGHT, WIDTH]]), np.empty((6, 1)), 0, 1, moments)
        results = moments
    else:
        results = np.empty((HEIGHT + 1, WIDTH + 1, tables), object)
        plain(kernel)(frame, rays, standard, results)
        compiled = np.empty(results.shape)
        kernel(RawFrame(depth, 0.0, np.inf, 1000.0, 0.0, False), (x, y), standard, compiled)
        # What is counted is what is computed.
        np.testing.assert_allclose(results.astype(float), compiled, rtol=1e-12, atol=1e-12)
    return tally


def count(kernel: Any, standard: bool | None, tables: int, *, window: bool = False) -> Count:
    """Count the operations of a kernel that builds tables, or sums over a window, per pixel.

    ``standard`` is None for sums in range space, True for sums of (X, Y, Z).
    """
    pixels = HEIGHT * WIDTH
    everything = _run(kernel, standard, tables, True, window)
    by_depth = _run(kernel, standard, tables, False, window)
    return Count(
        tables=tables,
        arguments=(by_depth["multiplications"] + by_depth["divisions"]) / pixels,
        **{name: everything[name] / pixels for name in ("additions", "multiplications", "divisions", "conversions")},
    )


def count_all() -> dict[str, dict[str, Count]]:
    """Counts of the standard form, or of prior work, and of range space: from tables, and of naive windows."""
    tables, naive = summed_area.frame_tables, window_pixels.window_moments
    return {
        "implicit": {"standard": count(tables, True, 9), "range": count(tables, None, 4)},
        "explicit": {"standard": count(tables, True, 8), "range": count(tables, None, 3)},
        "naive": {"standard": count(naive, True, 10, window=True), "range": count(naive, None, 10, window=True)},
        # Forms that the paper cites, both explicit, against range space.
        "tang": {"standard": count(prior_kernels.tang_tables, None, 8), "range": count(tables, None, 3)},
        "erdogan": {"standard": count(prior_kernels.erdogan_tables, None, 3), "range": count(tables, None, 3)},
    }
