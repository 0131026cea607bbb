"""With pytest-xdist a kernel is compiled by one process, and the others wait for its file instead of doing the same."""

import contextlib
import hashlib
import os
import tempfile
import threading
import time
from pathlib import Path

from numba.core.dispatcher import Dispatcher

try:
    import fcntl
except ModuleNotFoundError:  # on Windows each process compiles
    fcntl = None

_PATIENCE = 300.0  # seconds
_inside = threading.local()


def share(run: str) -> None:
    """Have a process of a test run wait, before it compiles a kernel, while another one compiles the same."""
    if fcntl is None:
        return
    folder = Path(tempfile.gettempdir()) / f"rgbd_planes_compiles_{run}"
    folder.mkdir(exist_ok=True)
    compile_or_load = Dispatcher.compile

    def compile_in_turn(self, sig):
        if getattr(_inside, "compiling", False):  # what a kernel calls is compiled with it
            return compile_or_load(self, sig)
        name = hashlib.sha256(f"{self.py_func.__module__} {self.py_func.__qualname__} {sig}".encode()).hexdigest()
        _inside.compiling = True
        try:
            with _lock(folder / name[:16]):
                return compile_or_load(self, sig)  # looks for the file first
        finally:
            _inside.compiling = False

    Dispatcher.compile = compile_in_turn


@contextlib.contextmanager
def _lock(path):
    file = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    try:
        end = time.monotonic() + _PATIENCE
        while time.monotonic() < end:  # then it compiles, too: nothing depends on the lock
            with contextlib.suppress(BlockingIOError):
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            time.sleep(0.02)
        yield
    finally:
        os.close(file)
