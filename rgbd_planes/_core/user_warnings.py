"""Warnings of what can be used, but is most likely a mistake, at the line that called this library."""

import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from rgbd_planes._core.text import shown

# ExitStack waits for threads; `dataclasses.replace` makes cameras anew.
_INSIDE = "rgbd_planes", "contextlib", "dataclasses"


class _Collected(threading.local):
    """For each thread: the list that its warnings go to instead of being issued."""

    messages: list[str] | None = None


_collected = _Collected()


def warn_caller(message: str) -> None:
    """Warn at the line that called this library; a message of one line, whose names may be anything."""
    message = shown(message)
    if _collected.messages is None:
        warnings.warn(message, UserWarning, stacklevel=_first_level_outside())
    else:
        _collected.messages.append(message)


@contextmanager
def collected_warnings(messages: list[str]) -> Iterator[None]:
    """Collect warnings in a list, in a thread that was not called by the line that they are for."""
    before, _collected.messages = _collected.messages, messages
    try:
        yield
    finally:
        _collected.messages = before


def _first_level_outside() -> int:
    """The stack level of the code that called this library, as `warnings.warn` counts for its caller."""
    level = 1
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in _INSIDE:
        frame = frame.f_back
        level += 1
    return level
