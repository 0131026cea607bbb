"""Times that can be compared: taken in turns, so that what disturbs the machine disturbs all alike."""

import time
from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeVar

import numpy as np

Name = TypeVar("Name")


class Times(NamedTuple):
    """Seconds that a piece of work took."""

    fastest: float
    """What disturbs a run only ever adds to its time, so this is the work's own."""
    median: float
    """What it came to on this machine, with all else that it did meanwhile."""

    def shared_by(self, count: int) -> "Times":
        """The time of one of so many equal parts of the work."""
        return Times(self.fastest / count, self.median / count)

    def plus(self, other: "Times") -> "Times":
        """The time of both pieces of work."""
        return Times(self.fastest + other.fastest, self.median + other.median)


def in_turns(
    work: Mapping[Name, Callable[[], object]], rounds: int, before: Callable[[], object] | None = None
) -> dict[Name, Times]:
    """Time each piece of work as often as there are rounds.

    Each round runs every piece three times and times the last run: the others leave the caches as a stream of
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
            if before is None:
                function()
                function()
            else:
                before()
            start = time.thread_time()
            function()
            seconds[name].append(time.thread_time() - start)
    return {name: Times(min(times), float(np.median(times))) for name, times in seconds.items()}


def flush_caches() -> None:
    """Read more memory than any cache holds."""
    _ELSEWHERE.sum()


_ELSEWHERE = np.ones(16_000_000)


def change(new: float, old: float) -> float:
    """How much more time than ``old`` is ``new``, in percent: negative is faster."""
    return 100.0 * (new / old - 1.0)
