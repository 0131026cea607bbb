"""How far a long work is: on a terminal, and nowhere else."""

import io
import time
from types import SimpleNamespace

import pytest

from rgbd_planes.cli import progress as module
from rgbd_planes.cli.progress import progress, working


class Terminal(io.StringIO):
    """What a terminal is sent."""

    def isatty(self):
        return True


@pytest.fixture(params=[Terminal, io.StringIO])
def stderr(request, monkeypatch):
    """A terminal, or a file."""
    stream = request.param()
    monkeypatch.setattr(module, "sys", SimpleNamespace(stderr=stream))
    return stream


@pytest.fixture
def now(monkeypatch):
    """A clock that only goes when it is told to."""
    seconds = [100.0]
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: seconds[0]))
    return seconds


def test_the_terminal_is_told_after_two_seconds_and_left_empty(stderr, now):
    seen = []
    for item in progress("abcdefgh", 8, "letters"):
        seen.append(item)
        now[0] += 0.8
    assert seen == list("abcdefgh")
    told = stderr.getvalue()
    if not stderr.isatty():
        assert told == ""
        return
    lines = [line.strip() for line in told.split("\r") if line.strip()]
    assert lines[0] == "3 of 8 letters, 4 s to go"
    assert lines[-1] == "7 of 8 letters, 1 s to go"
    assert len(lines) == 5
    assert told.endswith(" \r")


def test_what_is_done_within_two_seconds_says_nothing(stderr, now):
    assert list(progress(range(1000), 1000, "frames")) == list(range(1000))
    with working("nothing much"):
        pass
    assert stderr.getvalue() == ""


def test_an_error_leaves_the_line_empty_too(stderr, now):
    items = progress("abc", 3, "letters")
    for _ in range(2):
        next(items)
        now[0] += 3.0
    items.close()  # as where the loop ends early
    assert stderr.getvalue().endswith(" \r" if stderr.isatty() else "")


def test_a_long_work_says_what_it_does(stderr, monkeypatch):
    monkeypatch.setattr(module, "SECONDS_BEFORE", 0.01)
    monkeypatch.setattr(module, "_SECONDS_BETWEEN", 0.01)
    with working("counting"):
        time.sleep(0.2)
    if stderr.isatty():
        assert "\rcounting, 0 s" in stderr.getvalue()
        assert stderr.getvalue().endswith(" \r")
    else:
        assert stderr.getvalue() == ""
