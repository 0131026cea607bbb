"""Frames that cannot be read or fitted, and why."""

import errno
from collections.abc import Iterable
from typing import NamedTuple

from rgbd_planes._core.files import MissingFolderError
from rgbd_planes._core.text import ranges, reason_of, shown

# What the system says where nothing is wrong with a file: files or memory are short, or a disk, near or far, does not
# answer. Not every system knows all of them.
_OF_THE_MACHINE = {
    getattr(errno, name, errno.EIO)
    for name in (
        *("EMFILE", "ENFILE", "ENOMEM", "EIO", "ESTALE", "ETIMEDOUT", "ENODEV", "ENXIO", "EREMOTEIO", "ENOTCONN"),
        *("ECONNREFUSED", "ECONNRESET", "ECONNABORTED", "EHOSTDOWN", "EHOSTUNREACH", "ENETDOWN", "ENETUNREACH"),
    )
}


class Problem(NamedTuple):
    """A frame that was skipped, and why.

    Attributes
    ----------
    frame : int
        Its number in the sequence, from 0.
    name : str
        Its name in the data set.
    reason : str
        What was wrong with it, in one line.
    """

    frame: int
    name: str
    reason: str


def in_words(problems: Iterable[Problem]) -> list[str]:
    """A line for each reason, with the frames that it is about."""
    frames: dict[str, list[Problem]] = {}
    for problem in problems:
        frames.setdefault(problem.reason, []).append(problem)
    return [
        f"frame {some[0].frame}, {shown(some[0].name)}: {reason}"
        if len(some) == 1
        else f"{len(some)} frames, {ranges([problem.frame for problem in some])}: {reason}"
        for reason, some in frames.items()
    ]


def reason_to_skip(error: Exception, name: str) -> str:
    """What is wrong with the frame of a name, in one line, if that is why it could not be read or fitted.

    Where something else is, as where a library is missing, memory is short, or a disk does not answer or is gone, that
    error is raised: the frame would be left out for good.
    """
    if isinstance(error, (ImportError, MemoryError)):
        raise error
    cause: BaseException | None = error
    while cause is not None:  # readers take it for damage to the file
        if isinstance(cause, MissingFolderError):
            raise cause
        if isinstance(cause, TimeoutError) or (isinstance(cause, OSError) and cause.errno in _OF_THE_MACHINE):
            cause.filename = cause.filename or name
            raise cause
        cause = cause.__cause__ or cause.__context__
    text = reason_of(error)
    folder, _, rest = text.partition(f"{shown(name)}: ")  # the name is given beside it
    return rest if rest and folder[-1:] in ("", "/") else text
