"""Say so when a first call takes seconds because kernels are being compiled."""

import logging
import threading
import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress

from rgbd_planes.kernels._jit import compiler_pauses, kernel

SECONDS_BEFORE_NOTICE = 1.0
SECONDS_BETWEEN_NOTICES = 20.0

_logger = logging.getLogger("rgbd_planes")
_compiled: set[Hashable] = set()
_announced: dict[str, object] = {}
_progress: list[list[float]] = []
_NOTHING = nullcontext()


def announced(key: Hashable, takes: str = "up to half a minute") -> AbstractContextManager[None]:
    """Log a line if the first call for ``key`` takes long, and now and then how far it is; later calls cost nothing.

    It is said once in a process for all calls of the same ``takes``, and only while kernels are compiled. Kernels that
    Numba's cache on disk holds are loaded; where processes start together, that takes more than a second, too.
    """
    return _NOTHING if key in _compiled or takes in _announced else _first_call(key, takes)


@contextmanager
def _first_call(key: Hashable, takes: str) -> Iterator[None]:
    done = threading.Event()
    with suppress(RuntimeError):  # no more threads, by a limit or as Python ends: then nothing is logged
        threading.Thread(target=_watch, args=(done, takes), daemon=True).start()
    try:
        yield
        _compiled.add(key)
    finally:
        done.set()


def _watch(done: threading.Event, takes: str) -> None:
    while not done.wait(SECONDS_BEFORE_NOTICE):
        if compiler_pauses.is_compiling or _progress:
            if _announce(takes):
                _report_until(done)
            return


@contextmanager
def counted(work: float) -> Iterator[Callable[[float], None]]:
    """Say how much of the work is done: call what this gives for each piece of it."""
    progress = [0.0, work]
    _progress.append(progress)

    def count(piece: float) -> None:
        progress[0] += piece

    try:
        yield count
    finally:
        _progress.remove(progress)


def _report_until(done: threading.Event) -> None:
    begin = time.monotonic()
    while not done.wait(SECONDS_BETWEEN_NOTICES):
        seconds = time.monotonic() - begin
        finished, work = _progress[-1] if _progress else (0.0, 0.0)
        if finished:
            left = seconds * (work - finished) / finished
            how_far = f"{finished / work:.0%} are done, about {left:.0f} s are left"
        elif work:
            how_far = "the largest come first"
        elif compiler_pauses.is_compiling:
            how_far = f"{compiler_pauses.compiled} are done"
        else:
            continue
        _logger.warning(f"still compiling kernels after {seconds:.0f} s: {how_far}")


def _announce(takes: str) -> bool:
    """Say it, unless another thread has; returns whether this one did."""
    # Threads that begin together wait for the same kernels: the first says so. No lock, which a fork might copy held.
    token = object()
    if _announced.setdefault(takes, token) is not token:
        return False
    often = "once for this installation and each kind of frame and camera"
    if not kernel.has_cache:
        often = "again in each process: set NUMBA_CACHE_DIR to a folder that can be written to keep them"
    _logger.warning(f"compiling kernels: {takes}, {often}")
    return True
