"""Run a kernel over ranges on several threads.

Kernels release the GIL and write disjoint ranges, so ordinary Python threads run them in parallel. The bits are the
same for any number of threads, and there is no threading layer of Numba's to choose, to lock or to lose in a fork.
"""

import os
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import lru_cache
from queue import SimpleQueue
from threading import Lock, Thread
from typing import Any, TypeVar

from rgbd_planes._core.user_warnings import collected_warnings, warn_caller

# Handing a range to a waiting thread and collecting it costs about 60 µs, a fifth of the time of this many pixels.
PIXELS_PER_THREAD = 1_000_000

Work = Callable[[int, int], object]
Result = TypeVar("Result")
_Queue = SimpleQueue[Callable[[], None] | None]


class _Pool:
    """Threads that do what is put into a queue, until the pool is forgotten.

    Not those of `concurrent.futures`: of an interrupt inside of their locks, which are Python code, these stay locked,
    and all later work would wait for ever.
    """

    def __init__(self, workers: int) -> None:
        self._queue: _Queue = SimpleQueue()
        self._not_started = [None] * workers  # popped, which two threads cannot do at once

    def put(self, work: Callable[[], None]) -> None:
        if self._not_started:
            self._start()
        self._queue.put(work)

    def _start(self) -> None:
        try:
            self._not_started.pop()
        except IndexError:  # another thread has just started the last one
            return
        try:
            Thread(target=_work_off, args=(self._queue,), name="rgbd_planes", daemon=True).start()
        except BaseException:
            self._not_started.append(None)
            raise

    def __del__(self) -> None:
        self._queue.put(None)


def _work_off(queue: _Queue) -> None:
    while (work := queue.get()) is not None:
        work()
        del work  # with the arrays that it refers to
    queue.put(None)  # for the next thread


@lru_cache(maxsize=4)  # whose threads end, once nothing is left for them to do, when they are forgotten here
def _pool(workers: int) -> _Pool:
    return _Pool(workers)


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
    # The first who writes into it does the work. A lock would not tell an interrupted caller who has it.
    taken: dict[str, str] = {}
    results: list[Result] = []
    wrong: list[BaseException] = []
    ended = Lock()
    ended.acquire()

    def work_elsewhere() -> None:
        if taken.setdefault("by", "thread") != "thread":
            return
        try:
            with collected_warnings(messages):
                results.append(work(*arguments))
        except BaseException as error:
            wrong.append(error)
        ended.release()

    def wait() -> None:
        if taken.setdefault("by", "caller") == "thread":
            with ended:
                pass

    with suppress(RuntimeError):
        _pool(num_threads).put(work_elsewhere)

    def result() -> Result:
        try:
            wait()
        except BaseException:  # an interrupt: the arrays that the thread writes to are the caller's again
            wait()
            raise
        if taken["by"] == "caller":
            return work(*arguments)
        try:
            if wrong:
                raise wrong.pop()
            return results.pop()
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
