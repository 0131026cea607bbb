"""Say so when a first call takes seconds because kernels are being compiled."""

import logging
import threading
from collections.abc import Hashable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

SECONDS_BEFORE_NOTICE = 1.0

_logger = logging.getLogger("rgbd_planes")
_compiled: set[Hashable] = set()
_announced: dict[str, object] = {}
_NOTHING = nullcontext()


def announced(key: Hashable, takes: str = "some seconds") -> AbstractContextManager[None]:
    """Log one line if the first call for ``key`` takes long; later calls cost nothing.

    Once in a process for all that ``takes`` the same time. A kernel that Numba's cache on disk holds loads in
    less than the time waited for.
    """
    return _NOTHING if key in _compiled or takes in _announced else _first_call(key, takes)


@contextmanager
def _first_call(key: Hashable, takes: str) -> Iterator[None]:
    timer = threading.Timer(SECONDS_BEFORE_NOTICE, _announce, [takes])
    timer.daemon = True
    timer.start()
    try:
        yield
        _compiled.add(key)
    finally:
        timer.cancel()


def _announce(takes: str) -> None:
    # Threads that begin together wait for the same kernels: the first says so. No lock, which a fork might copy held.
    token = object()
    if _announced.setdefault(takes, token) is not token:
        return
    _logger.warning(f"compiling kernels: {takes}, once for this installation and each kind of frame")
