"""Times that can be compared: taken in turns, so that what disturbs the machine disturbs all alike."""

import time
from collections.abc import Callable, Mapping
from typing import TypeVar

import numpy as np

Name = TypeVar("Name")


def in_turns(
    work: Mapping[Name, Callable[[], object]], rounds: int, before: Callable[[], object] | None = None
) -> dict[Name, float]:
    """Return the median time in seconds of each piece of work.

    Each round runs every piece twice and times the second run: the first leaves the caches as a stream of
    frames would. The clock is the processor time of this thread, which does not run while others do.

    Parameters
    ----------
    before : callable, optional
        Run before each timed run instead of the work itself.
    """
    for function in work.values():
        function()  # compiles
    seconds: dict[Name, list[float]] = {name: [] for name in work}
    for _ in range(rounds):
        for name, function in work.items():
            (before or function)()
            start = time.thread_time()
            function()
            seconds[name].append(time.thread_time() - start)
    return {name: float(np.median(times)) for name, times in seconds.items()}


def flush_caches() -> None:
    """Write more memory than any cache holds."""
    _ELSEWHERE[:] += 1.0


_ELSEWHERE = np.zeros(16_000_000)


def change(new: float, old: float) -> float:
    """How much more time than ``old`` is ``new``, in percent: negative is faster."""
    return 100.0 * (new / old - 1.0)
