"""Compiled kernels on disk, for processes that start and end at any time."""

import contextlib
import hashlib
import os
import pickle
import re
import stat
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.runtime import rtsys
from numba.core.serialize import dumps

OUTDATED = 7 * 24 * 3600.0
"""Seconds for which compiled kernels of other sources are kept."""
_OF_SOURCES = re.compile(r"_[0-9a-f]{12}-\d+\.")  # in a file's name: a digest of them, and the line of the function


class CacheFiles:
    """A file for each combination of types that a kernel is compiled for.

    Numba's files are numbered, and an index says which is for which types. If two processes compile a kernel for
    different types at the same time, either may find the other's code under its number, and run it. And a file that was
    cut short stays an error for good. Here a file is named by what it is for, appears whole or not at all, and is
    compiled anew if it is damaged.

    Parameters
    ----------
    folder : path
        Where files are saved.
    installed : path
        Where files are also looked for: whoever installed the kernels may have compiled them, and others may only read.
    base : str
        How the names of a kernel's files begin.
    module : str
        The kernel's, which compiled code imports: of a folder that was moved with its files, others are asked for.
    """

    def __init__(self, folder: Any, installed: Any, base: str, module: str) -> None:
        self._folder, self._installed, self._base, self._module = Path(folder), Path(installed), base, module

    def _name(self, key: Any) -> str:
        options = self._module, numba.__version__, int(numba.config.OPT), bool(numba.config.BOUNDSCHECK)
        return f"{self._base}.{hashlib.sha256(repr((options, key)).encode()).hexdigest()[:16]}.nbc"

    def load(self, key: Any) -> Any:
        """Return what was saved, or None."""
        name, size = self._name(key), hashlib.sha256().digest_size
        for folder in (self._folder, self._installed):
            with contextlib.suppress(OSError), open(folder / name, "rb") as file:
                content = file.read() if _is_trusted(os.fstat(file.fileno())) else b""
                digest, data = content[:size], content[size:]
                if _digest(name, data) == digest:
                    return pickle.loads(data)
        return None

    def holds(self, key: Any) -> bool:
        """Whether there is something to load."""
        return any((folder / self._name(key)).is_file() for folder in (self._folder, self._installed))

    def save(self, key: Any, compiled: Any) -> None:
        """Save, or replace, a compiled kernel."""
        path, data = self._folder / self._name(key), dumps(compiled)
        beside = path.with_name(f"{path.name}.{uuid.uuid4().hex[:16]}")
        try:
            handle = os.open(beside, os.O_CREAT | os.O_EXCL | os.O_WRONLY | getattr(os, "O_BINARY", 0), 0o644)
            with open(handle, "wb") as file:
                file.write(_digest(path.name, data) + data)
            os.replace(beside, path)
        finally:
            beside.unlink(missing_ok=True)
        self._remove_outdated()

    def _remove_outdated(self) -> None:
        """Remove what was compiled from other sources of this kernel, before an update: nobody else does."""
        kernel, *python = _OF_SOURCES.split(self._base)
        for path in self._folder.glob(f"{kernel}_*.nbc"):
            base = path.name.rsplit(".", 2)[0]
            if base != self._base and _OF_SOURCES.split(base) == [kernel, *python]:
                with contextlib.suppress(OSError):
                    if time.time() - path.stat().st_mtime > OUTDATED:
                        path.unlink()

    def flush(self) -> None:
        """Forget all that was saved."""
        for path in self._folder.glob(f"{self._base}.*.nbc"):
            path.unlink(missing_ok=True)


def _digest(name: str, data: bytes) -> bytes:
    """Digest of a file's content and name: under another name it is no longer whole."""
    return hashlib.sha256(name.encode() + b"\0" + data).digest()


def _is_trusted(status: os.stat_result) -> bool:
    """Whether nobody can have written a file but this user, the administrator, or whoever can write the sources, too.

    Loading a kernel runs it.
    """
    if os.name == "nt":  # whose permissions these numbers do not tell
        return True
    sources = os.stat(__file__)
    others = status.st_mode & ~sources.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return not others and status.st_uid in (os.geteuid(), 0, sources.st_uid)


class Installed:
    """Numba's interface of a place for compiled kernels, for those beside their sources, which are only read.

    Derived from none of Numba's own places, whose names change from version to version.
    """

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        self._line, self._folder = function.__code__.co_firstlineno, Path(file).with_name("__pycache__")

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> "Installed | None":
        """Return None where there is nothing to read."""
        place = cls(function, file)
        return place if place._folder.is_dir() else None

    def get_cache_path(self) -> str:
        """Return the folder."""
        return str(self._folder)

    def get_source_stamp(self) -> None:
        """Return None: file names already identify their sources."""

    def get_disambiguator(self) -> str:
        """Return what tells functions of the same name in a file apart, as Numba's own places do."""
        return str(self._line)

    def ensure_cache_path(self) -> None:
        """Refuse to save."""
        raise PermissionError(f"{self._folder} cannot be written")


class Compiled(CompileResultCacheImpl):
    """Numba's places for compiled kernels, and one to read from."""

    _locator_classes = (*CompileResultCacheImpl._locator_classes, Installed)


class Cache(FunctionCache):
    """Numba's cache on disk, from which a kernel loads in a sixth of the time.

    Before it loads anything, Numba's own sets up all that a compilation may need, SciPy's linear algebra included. A
    compiled kernel needs only the functions that allocate arrays, and the modules of what it calls: a NumPy function
    like sum or max would bring in SciPy again. A compilation fetches the rest itself.
    """

    _impl_class = Compiled

    def __init__(self, function: Callable[..., Any], suffix: str) -> None:
        super().__init__(function)
        installed = Installed(function, function.__code__.co_filename).get_cache_path()
        with contextlib.suppress(AttributeError):  # a later Numba may differ inside: its own files then
            base, module = self._impl.filename_base + suffix, function.__module__
            self._cache_file = CacheFiles(self._cache_path, installed, base, module)

    @property
    def saves(self) -> bool:
        """Whether there is a place where compiled kernels can be saved."""
        return not isinstance(self._impl.locator, Installed)

    def holds(self, types: Any) -> bool:
        """Whether a kernel that was compiled for these types can be loaded."""
        from numba.core.registry import cpu_target

        with contextlib.suppress(AttributeError, OSError):  # a later Numba may differ inside
            return bool(self._cache_file.holds(self._index_key(types, cpu_target.target_context.codegen())))
        return False

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled kernel for these types, or None."""
        try:
            guard, load = self._guard_against_spurious_io_errors, self._load_overload
        except AttributeError:  # a later Numba may differ inside: its own way then
            return super().load_overload(sig, target_context)
        rtsys.initialize(target_context)
        with guard():
            return load(sig, target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save a compiled kernel, if that can be done: on a full disk it is compiled again by the next process."""
        with contextlib.suppress(OSError):
            super().save_overload(sig, data)
