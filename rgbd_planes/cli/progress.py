"""How far a long work is, on a terminal; elsewhere nothing."""

import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

Item = TypeVar("Item")

SECONDS_BEFORE = 2.0
_SECONDS_BETWEEN = 0.2


def progress(items: Iterable[Item], total: int, what: str) -> Iterator[Item]:
    """Give the items, and say on stderr how many are done once that takes longer than two seconds.

    Parameters
    ----------
    items : iterable
    total : int
        How many there are.
    what : str
        Their name, in the plural.
    """
    stream = sys.stderr
    if not stream.isatty():
        yield from items
        return
    begin = last = time.monotonic()
    width = 0
    try:
        for done, item in enumerate(items):
            now = time.monotonic()
            if now - begin > SECONDS_BEFORE and now - last > _SECONDS_BETWEEN:
                last = now
                left = f", {(now - begin) / done * (total - done):.0f} s to go" if done else ""
                line = f"{done} of {total} {what}{left}"
                print(f"\r{line:<{width}}", end="", file=stream, flush=True)
                width = max(width, len(line))
            yield item
    finally:
        if width:
            print(f"\r{'':<{width}}\r", end="", file=stream, flush=True)  # what follows begins at an empty line


@contextmanager
def working(what: str) -> Iterator[None]:
    """Say on stderr, once the block takes longer than two seconds, what it does and for how long.

    Parameters
    ----------
    what : str
        What is being done: "estimating the noise".
    """
    stream = sys.stderr
    if not stream.isatty():
        yield
        return
    done = threading.Event()
    begin = time.monotonic()

    def report() -> None:
        width, pause = 0, SECONDS_BEFORE
        while not done.wait(pause):
            line = f"{what}, {time.monotonic() - begin:.0f} s"
            print(f"\r{line}", end="", file=stream, flush=True)
            width, pause = max(width, len(line)), _SECONDS_BETWEEN
        if width:
            print(f"\r{'':<{width}}\r", end="", file=stream, flush=True)

    reporter = threading.Thread(target=report, daemon=True)
    reporter.start()
    try:
        yield
    finally:
        done.set()
        reporter.join()
