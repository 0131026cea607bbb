"""Compiled kernels on disk, for processes that begin, and end, at any time."""

import contextlib
import hashlib
import os
import pickle
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import FunctionCache
from numba.core.runtime import rtsys
from numba.core.serialize import dumps


class CacheFiles:
    """A file for each combination of types that a kernel is compiled for.

    Numba's own files are numbered, and an index says which is for which types: of two processes that compile a kernel
    at the same time, for different types, either may find the other's code under its number, and run it. And a
    file that was cut short is an error there, for good. Here a file is named by what it is for, appears whole or
    not at all, and is compiled anew if it is damaged.

    Parameters
    ----------
    folder : path
    base : str
        What the names of a kernel's files begin with.
    """

    def __init__(self, folder: Any, base: str) -> None:
        self._folder, self._base = Path(folder), base

    def _path(self, key: Any) -> Path:
        name = hashlib.sha256(repr((numba.__version__, key)).encode()).hexdigest()[:16]
        return self._folder / f"{self._base}.{name}.nbc"

    def load(self, key: Any) -> Any:
        """What was saved, or None."""
        try:
            content = self._path(key).read_bytes()
        except OSError:
            return None
        size = hashlib.sha256().digest_size
        digest, data = content[:size], content[size:]
        return pickle.loads(data) if hashlib.sha256(data).digest() == digest else None

    def save(self, key: Any, compiled: Any) -> None:
        """Save, or replace, what a kernel was compiled to."""
        path, data = self._path(key), dumps(compiled)
        beside = path.with_name(f"{path.name}.{uuid.uuid4().hex[:16]}")
        try:
            beside.write_bytes(hashlib.sha256(data).digest() + data)
            os.replace(beside, path)
        finally:
            beside.unlink(missing_ok=True)

    def flush(self) -> None:
        """Forget all that was saved."""
        for path in self._folder.glob(f"{self._base}.*.nbc"):
            path.unlink(missing_ok=True)


class Cache(FunctionCache):
    """Numba's cache on disk, from which a kernel loads in a sixth of the time.

    Before it loads anything, Numba's own puts together all that a compilation may need, among it SciPy's linear
    algebra. A compiled kernel needs only the functions that allocate arrays, and the modules of what it calls: a
    NumPy function like sum or max would bring SciPy again. A compilation fetches the rest itself.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        with contextlib.suppress(AttributeError):  # a later Numba's inside is another: its own files then
            self._cache_file = CacheFiles(self._cache_path, self._impl.filename_base)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled kernel for these types, or None."""
        try:
            guard, load = self._guard_against_spurious_io_errors, self._load_overload
        except AttributeError:  # a later Numba's inside is another: its own way then
            return super().load_overload(sig, target_context)
        rtsys.initialize(target_context)
        with guard():
            return load(sig, target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save a compiled kernel, if that can be done: on a full disk it is compiled again by the next process."""
        with contextlib.suppress(OSError):
            super().save_overload(sig, data)
