"""Files appear whole or not at all, and errors about them name them."""

import errno
import json
import os
import shutil
import sys
import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from rgbd_planes._core.text import reason_of, shown

_OF_FILES = frozenset(
    (
        ".csv",
        ".tsv",
        ".txt",
        ".json",
        ".npz",
        ".npy",
        ".png",
        ".jpg",
        ".pdf",
        ".svg",
        ".ply",
        ".obj",
        ".rrd",
        ".yaml",
        ".yml",
        ".xlsx",
        ".feather",
        ".h5",
    )
)
_LONGEST_TEXT = 2**26  # bytes
_MOST_ITEMS, _SHORTEST = 5 * 10**6, 16  # of JSON; of a long text more if they have that many characters on average
_MOST_LISTS = 10**6  # in JSON: empty ones take thirty times their size
MOST_PIXELS = 2**25
"""Pixels of an image in a file, at most: 8K video has a few less."""
_LONGEST_SUFFIX = 20  # characters; what is longer names no format
# Bytes. Nonsense in a file may ask for any number of them: if this many are free, memory was not short of a frame.
_MORE_THAN_A_FRAME = 2**28


@contextmanager
def write_beside(path: str | os.PathLike[str], its_suffix: str | None = None) -> Iterator[Path]:
    """A path beside `path` to write to; it takes the place of `path` once the block has ended without an error.

    It has the suffix of `path`, by which many writers know the format, and the permissions of a file that was there
    before. After an error that file is unchanged, and nothing is left behind. What is written is on the disk before it
    takes that place: a power cut leaves the old file or the new one, and whole.

    Raises
    ------
    ValueError
        `path` has the suffix of another format than ``its_suffix``, if that is given.
    OSError
        The folder does not exist, `path` is a folder, or it cannot be written there.
    """
    given = Path(path).suffix.lower()
    if its_suffix is not None and given in _OF_FILES and given != its_suffix:
        raise ValueError(
            f"{shown(path)}: expected a path that ends in {its_suffix}, which is what is written, got {given}"
        )
    check_writable(path)
    target, replaceable = _target(path)
    # Not the whole name, which may already be as long as names can be.
    name = f"{target.stem[:40]}-{zlib.crc32(os.fsencode(target.name)):x}"
    suffix = target.suffix if len(target.suffix) <= _LONGEST_SUFFIX else ""
    beside = target.with_name(f".{name}.{os.getpid()}-{threading.get_ident()}{suffix}")
    written = beside if replaceable else target
    try:
        yield written
        if replaceable:
            if target.exists():
                shutil.copymode(target, beside)
            _to_disk(beside)
            beside.replace(target)
            _to_disk(target.parent)
    except OSError as error:
        if type(error) is OSError and error.errno is None:  # a library's error, in its words
            raise OSError(f"cannot write {shown(path)}: {error}") from error
        # A full disk, say, or a name that is too long.
        if error.errno is not None and error.filename in (None, os.fspath(written)):
            error.filename = os.fspath(path)
        raise
    finally:
        beside.unlink(missing_ok=True)


def _to_disk(path: Path) -> None:
    """Wait until the content of a file, or the names in a folder, are where a power cut does not reach them."""
    if path.is_dir() and sys.platform == "win32":  # which opens no folders
        return
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS):  # a file system that has no such thing
            raise
    finally:
        os.close(handle)


def check_folder_name(path: str | os.PathLike[str], what: str) -> None:
    """Raise where a new folder, for ``what``, would have the name of a file of another format.

    Raises
    ------
    ValueError, NotADirectoryError
        Saying what was expected.
    """
    folder = Path(path)
    if folder.is_dir():
        return
    if folder.exists():
        raise NotADirectoryError(f"{shown(folder)}: expected a folder for {what}, got a file; choose another name")
    if folder.suffix.lower() in _OF_FILES:
        raise ValueError(
            f"{shown(folder)}: expected the name of a folder for {what}, got one that ends in {folder.suffix}"
        )


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Keep out of a folder all others that enter it by this; made if need be. On Windows nobody is kept out.

    Raises
    ------
    BlockingIOError
        Another process, or thread, is in it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if sys.platform == "win32":
        yield
        return
    import fcntl

    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BlockingIOError(f"{shown(folder)}: another call is writing there") from None
        except OSError:  # a file system without locks
            pass
        yield
    finally:
        with suppress(OSError):  # if only closed, a child that was forked meanwhile would keep it locked
            fcntl.flock(handle, fcntl.LOCK_UN)
        os.close(handle)


@contextmanager
def naming(path: str | os.PathLike[str]) -> Iterator[None]:
    """Begin a TypeError or ValueError of the block, about the content of a file, with the file's path."""
    try:
        yield
    except TypeError as error:
        raise TypeError(shown(f"{path}: {error}")) from None
    except ValueError as error:
        raise ValueError(shown(f"{path}: {error}")) from None


@contextmanager
def readable(path: str | os.PathLike[str], expected: str, remedy: str = "") -> Iterator[None]:
    """Turn whatever the block's library raises, for files that end early or hold nonsense, into a ValueError.

    In one line, with the remedy at its end.
    """
    try:
        yield
    except TooLargeError as error:
        raise ValueError(f"{shown(path)}: {error}") from None
    except Exception as error:
        raise damage(f"{shown(path)}: not {expected}, or damaged", error, remedy) from error


def damage(said: str, error: Exception, remedy: str = "") -> ValueError:
    """The error for a file that ends early or holds nonsense, with the reason that its reader gave.

    Where memory is short, and the file does not ask for too much, the reader's own error is raised.
    """
    if isinstance(error, MemoryError) and not _is_free(_MORE_THAN_A_FRAME):
        raise error
    return ValueError(f"{said} ({getattr(error, 'strerror', None) or reason_of(error)}){remedy}")


def _is_free(size: int) -> bool:
    """Whether so many bytes of memory can be had."""
    import numpy as np

    try:
        np.empty(size, np.uint8)
    except MemoryError:
        return False
    return True


class MissingFolderError(FileNotFoundError):
    """Not only a file is missing, but the folder that it was in, as where a disk has been taken away."""


def existing_file(path: str | os.PathLike[str]) -> Path:
    """The path, if it is a file: the door of all that are read.

    Opening a pipe would wait for what may never come, and a device may have no end.

    Raises
    ------
    OSError, ValueError
        There is no such file, it may not be read, or it is a folder, a device or a pipe.
    """
    file = Path(path)
    if not file.exists():
        kind = FileNotFoundError if file.parent.exists() else MissingFolderError
        raise kind(f"{shown(path)}: there is no such file")
    if file.is_dir():
        raise ValueError(f"{shown(path)}: expected a file, got a folder")
    if not file.is_file():
        raise ValueError(f"{shown(path)}: expected a file, got a device or a pipe")
    with file.open("rb"):  # a file without permission is not a damaged one
        return file


def text_of(path: str | os.PathLike[str], errors: str = "strict", most: int = _LONGEST_TEXT) -> str:
    """The text of a small file, without the byte order mark that some editors write.

    Raises
    ------
    OSError, ValueError
        There is no such file, it is no text, or it is larger than any of its kind: its content would take memory.
    """
    with existing_file(path).open("rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise ValueError(f"{shown(path)}: expected a text of at most {most >> 20} MiB, got a longer one")
    return content.decode("utf-8-sig", errors)


def json_of(text: str) -> Any:
    """What a JSON text holds.

    Raises
    ------
    ValueError
        It is none, or holds so many things, or within each other, that they would take memory.
    """
    items, lists = text.count(","), text.count("[") + text.count("{")
    if items > max(_MOST_ITEMS, len(text) // _SHORTEST) or lists > _MOST_LISTS:
        raise ValueError(f"{items} items in {lists} lists are more than of any file of its kind")
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError(str(error)) from None


class TooLargeError(ValueError):
    """A file may be whole, but asks for more memory than any of its kind."""


def check_pixels(width: int, height: int) -> None:
    """Raise a TooLargeError if an image in a file has too many pixels, as its header says."""
    if width * height > MOST_PIXELS:
        raise TooLargeError(
            f"expected at most {MOST_PIXELS} pixels in a file, got {width} x {height}: "
            "for such frames read it with another library, and give the array"
        )


def identity(path: Path) -> tuple[tuple[int, ...], ...]:
    """What distinguishes a file, or those of a folder, from others that have taken its place."""
    stats = [file.stat() for file in (sorted(path.iterdir()) if path.is_dir() else [path])]
    return tuple((stat.st_dev, stat.st_ino, stat.st_mtime_ns, stat.st_size) for stat in stats)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Raise now the OSError that writing `path` would raise after the work is done."""
    target, replaceable = _target(path)
    if target.is_dir():
        raise IsADirectoryError(f"cannot write {shown(path)}: it is a folder")
    if replaceable and not target.parent.is_dir():
        raise FileNotFoundError(f"cannot write {shown(path)}: there is no folder {shown(target.parent)}")
    if not os.access(target.parent if replaceable else target, os.W_OK):
        raise PermissionError(f"cannot write {shown(path)}: permission denied")


def _target(path: str | os.PathLike[str]) -> tuple[Path, bool]:
    """The file that is written, and whether another may take its place, as of no device and no pipe."""
    target = Path(path)
    if target.exists() and not target.is_file():
        return target, False
    return Path(os.path.realpath(path)), True  # a link stays a link
