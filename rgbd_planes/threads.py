"""Run a kernel over ranges on several threads.

Kernels release the GIL and write disjoint ranges, so ordinary Python threads run them in parallel: the same
bits for any number of threads, no threading layer of Numba's to choose, to lock or to lose in a fork.
"""

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from typing import TypeVar

# Handing a range to a waiting thread and collecting it costs about 50 µs: the time of this many pixels.
PIXELS_PER_THREAD = 1_000_000

Work = Callable[[int, int], object]
Item = TypeVar("Item")
Result = TypeVar("Result")


@cache
def _pool(workers: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(workers, thread_name_prefix="rgbd_planes")


# Threads do not survive a fork: a child makes its own.
os.register_at_fork(after_in_child=_pool.cache_clear) if hasattr(os, "register_at_fork") else None


def choose_num_threads(num_threads: int | None, pixels: int) -> int:
    """Return the number of threads to use: as asked for, or as many as ``pixels`` of work pay for."""
    if num_threads is not None:
        return num_threads
    paid_for = pixels // PIXELS_PER_THREAD
    # To ask for the number of cores takes a twentieth of the time of a frame.
    return min(os.cpu_count() or 1, paid_for) if paid_for > 1 else 1


def submit(work: Callable[[Item], Result], item: Item, num_threads: int) -> Future[Result]:
    """Have ``work(item)`` done by one of ``num_threads`` threads."""
    return _pool(num_threads).submit(work, item)


def run_in_ranges(work: Work, count: int, num_threads: int) -> None:
    """Call ``work(start, stop)`` for ranges that cover ``range(count)``, one a thread."""
    num_threads = min(num_threads, count)
    if num_threads <= 1:
        work(0, count)
        return
    bounds = [count * i // num_threads for i in range(num_threads + 1)]
    # This thread takes the last range itself, so that as many threads as asked for are at work.
    futures = [_pool(num_threads - 1).submit(work, bounds[i], bounds[i + 1]) for i in range(num_threads - 1)]
    try:
        work(bounds[-2], bounds[-1])
    finally:
        for future in futures:
            future.result()
