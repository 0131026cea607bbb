"""Run a kernel over ranges on several threads.

Kernels release the GIL and write disjoint ranges, so ordinary Python threads run them in parallel: the same
bits for any number of threads, and no threading layer of Numba's to choose, to lock or to lose in a fork.
"""

import os
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack, suppress
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeVar

from rgbd_planes.caller_warnings import collected_warnings, warn_caller

if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor

# Handing a range to a waiting thread and collecting it costs about 50 µs: the time of this many pixels.
PIXELS_PER_THREAD = 1_000_000

Work = Callable[[int, int], object]
Result = TypeVar("Result")


@lru_cache(maxsize=4)  # whose threads end, once nothing is left for them to do, when they are forgotten here
def _pool(workers: int) -> "ThreadPoolExecutor":
    # Imported here: once the main thread has ended this is an error, which `submit` expects.
    from concurrent.futures import ThreadPoolExecutor

    return ThreadPoolExecutor(workers, thread_name_prefix="rgbd_planes")


# Threads do not survive a fork: a child makes its own.
os.register_at_fork(after_in_child=_pool.cache_clear) if hasattr(os, "register_at_fork") else None


def num_cores() -> int:
    """Return the number of cores that this process may use, which may be fewer than the machine has."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def choose_num_threads(num_threads: int | None, pixels: int) -> int:
    """Return the number of threads to use: as asked for, or as many as ``pixels`` of work pay for."""
    if num_threads is not None:
        return num_threads
    paid_for = pixels // PIXELS_PER_THREAD
    # Asking for the number of cores may take a twentieth of the time of a frame.
    return min(num_cores(), paid_for) if paid_for > 1 else 1


def submit(work: Callable[..., Result], num_threads: int, *arguments: Any) -> Callable[[], Result]:
    """Have ``work(*arguments)`` done by one of ``num_threads`` threads; call the returned function for the result.

    If the result is asked for before a thread has started, the caller does the work: nested work could otherwise wait
    for ever. The same where there are no more threads, by a limit or since the main thread has ended. Warnings of the
    work are issued when the result is asked for.
    """
    messages: list[str] = []
    # Not the pool's own: it keeps work for which it could not start a thread, and would do it later.
    future: Future[Result] = Future()

    def work_elsewhere() -> None:
        if not future.set_running_or_notify_cancel():
            return
        try:
            with collected_warnings(messages):
                made = work(*arguments)
            future.set_result(made)
        except BaseException as error:
            future.set_exception(error)

    with suppress(RuntimeError):
        _pool(num_threads).submit(work_elsewhere)

    def result() -> Result:
        if future.cancel():
            return work(*arguments)
        try:
            return future.result()
        except BaseException:
            future.exception()  # also after an interrupt: the arrays that the thread writes to are the caller's again
            raise
        finally:
            for message in messages:
                warn_caller(message)

    return result


def run_in_ranges(work: Work, count: int, num_threads: int) -> None:
    """Call ``work(start, stop)`` for ranges that cover ``range(count)``, one per thread; all have ended on return."""
    num_threads = min(num_threads, count)
    if num_threads <= 1:
        work(0, count)
        return
    bounds = [count * i // num_threads for i in range(num_threads + 1)]
    # ExitStack calls the last one first, which threads start last, and all of them even if one fails.
    with ExitStack() as waiting:
        for i in range(num_threads - 1):
            waiting.callback(submit(work, num_threads - 1, bounds[i], bounds[i + 1]))
        # This thread takes the last range itself, so that as many threads as asked for are at work.
        work(bounds[-2], bounds[-1])
