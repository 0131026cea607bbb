"""Compile in a third less time, by avoiding two costs of CPython.

Numba makes millions of small objects that stay until it is done, and Python searches them again and again for garbage,
by default whenever there are 700 new ones (2000 in later versions).

And its calls nest hundreds deep. Python keeps their frames in chunks of 16 KB, and gives a chunk back to the system
when its last frame is done: if a chunk ends just below a function that is called a million times, every call takes a
chunk and gives it back. A frame that needs more than that gets a larger chunk, with room for those above it.

And a process may be forked meanwhile, or interrupted: while LLVM works, Python drops a KeyboardInterrupt, or crashes.
"""

import contextlib
import functools
import gc
import os
import signal
import threading
from collections.abc import Callable, Iterator
from typing import Any

from .array_lowering import as_kernels_need

PATIENCE = 20_000
"""New objects before garbage is collected; takes 40 MB more while the largest kernels compile."""
ROOM = 70_000
"""Slots of eight bytes in a frame: more than half of a chunk of 1 MB, the rest of which is for the frames above it."""

is_compiling = False
"""Whether a kernel is being compiled, not only loaded from the disk."""
compiled = 0
"""Kernels that were compiled in this process, for each kind of arguments."""

if hasattr(os, "register_at_fork"):
    # A fork waits for a thread that compiles: its child, without that thread, would wait for Numba's lock for ever.
    with contextlib.suppress(ImportError):  # a later Numba may differ inside
        from numba.core.compiler_lock import global_compiler_lock as _lock

        os.register_at_fork(before=_lock.acquire, after_in_parent=_lock.release, after_in_child=_lock.release)


_is_interrupted = False


def _heed_interrupts() -> None:
    """Raise the KeyboardInterrupt that was held back, if there was one."""
    global _is_interrupted
    if _is_interrupted:
        _is_interrupted = False
        raise KeyboardInterrupt


@contextlib.contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back until a kernel, or one that it calls, is done: where Python would have raised it at once."""
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return

    def note(*_: object) -> None:
        global _is_interrupted
        _is_interrupted = True

    signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _heed_interrupts()


def _with_room(compiler: Callable[..., Any], *args: Any) -> Any:
    """Call a compiler from a frame that takes up a chunk."""
    return compiler(*args)


with contextlib.suppress(ValueError, OverflowError):  # a later Python may limit it
    _with_room.__code__ = _with_room.__code__.replace(co_stacksize=ROOM)


def without_haste(compiler: Callable[..., Any], function: Any) -> Callable[..., Any]:
    """Make garbage collection wait for a compiler, its frames have room, and arrays be translated as kernels need.

    Numba lets one thread at a time compile, and what a kernel calls is compiled while the kernel, ``function``, is.
    """

    def compile_counted(*args: Any) -> Any:
        global compiled
        _heed_interrupts()
        result = compiler(*args)
        compiled += 1
        return result

    @functools.wraps(compiler)
    def compile_alone(*args: Any) -> Any:
        global is_compiling
        if is_compiling:
            return compile_counted(*args)
        before, *others = gc.get_threshold()
        is_compiling = True
        if 0 < before < PATIENCE:  # neither off nor already as patient
            gc.set_threshold(PATIENCE, *others)
        try:
            with _interrupts_held(), as_kernels_need(function):
                return _with_room(compile_counted, *args)
        finally:
            is_compiling = False
            now, *others = gc.get_threshold()
            if now == PATIENCE:  # nobody has set it meanwhile
                gc.set_threshold(before, *others)

    return compile_alone
