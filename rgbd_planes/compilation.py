"""Say so when a first call takes seconds because kernels are being compiled."""

import logging
import threading
from collections.abc import Hashable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

SECONDS_BEFORE_NOTICE = 1.0

_logger = logging.getLogger("rgbd_planes")
_compiled: set[Hashable] = set()
_announced = threading.Event()
_announcing = threading.Lock()
_NOTHING = nullcontext()


def announced(key: Hashable) -> AbstractContextManager[None]:
    """Log one line, once in a process, if the first call for ``key`` takes long; later calls cost nothing.

    A kernel that Numba's cache on disk holds loads in less than the time waited for.
    """
    return _NOTHING if key in _compiled or _announced.is_set() else _first_call(key)


@contextmanager
def _first_call(key: Hashable) -> Iterator[None]:
    timer = threading.Timer(SECONDS_BEFORE_NOTICE, _announce)
    timer.daemon = True
    timer.start()
    try:
        yield
        _compiled.add(key)
    finally:
        timer.cancel()


def _announce() -> None:
    with _announcing:  # threads that begin together wait for the same kernels
        if _announced.is_set():
            return
        _announced.set()
    _logger.warning("compiling kernels: once for this installation, a few seconds for each kind of frame")
