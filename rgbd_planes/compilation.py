"""Say so when a first call takes seconds because kernels are being compiled."""

import logging
import threading
from collections.abc import Hashable, Iterator
from contextlib import contextmanager

SECONDS_BEFORE_NOTICE = 1.0

_logger = logging.getLogger("rgbd_planes")
_compiled: set[Hashable] = set()


@contextmanager
def announced(key: Hashable) -> Iterator[None]:
    """Log one line if the first call for ``key`` in this process takes long; later calls cost nothing.

    A kernel that Numba's cache on disk holds loads in less than the time waited for.
    """
    if key in _compiled:
        yield
        return
    timer = threading.Timer(
        SECONDS_BEFORE_NOTICE,
        _logger.warning,
        ("compiling kernels: once for this installation, about 10 seconds",),
    )
    timer.daemon = True
    timer.start()
    try:
        yield
        _compiled.add(key)
    finally:
        timer.cancel()
