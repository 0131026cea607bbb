"""How every kernel is compiled: the one place that holds Numba's options.

Kernels are serial and release the GIL; they work on a range of tiles or rows, and
``rgbd_planes.threads`` gives the ranges to threads. So nothing here depends on a Numba threading layer:
not its launch cost, not its behaviour after a fork, not its thread safety.
"""

import contextlib
import functools
import hashlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

from ._cache import Cache
from ._compiling import without_haste

Function = TypeVar("Function", bound=Callable[..., Any])

has_cache = True
"""Whether compiled kernels have a place on disk: not where neither the installation nor the home can be written."""


@functools.cache
def _sources_digest() -> str:
    """Digest of all kernel sources.

    Numba's cache looks only at the file of the function itself: a kernel that calls another file's
    kernel would stay stale when that file changes. The digest in the function's qualified name, which is
    part of the cache's file name, makes every change of any kernel a new cache entry.
    """
    digest = hashlib.sha256()
    paths = sorted(Path(__file__).parent.glob("*.py"))
    for path in paths:
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    if not paths:  # they are in a zip, or in a program that has no sources: another one may take its place
        stat = os.stat(getattr(__loader__, "archive", sys.executable))
        digest.update(repr((stat.st_mtime_ns, stat.st_size)).encode())
    return digest.hexdigest()[:12]


def kernel(*, reduction: bool = False, inline: bool = False) -> Callable[[Function], Function]:
    """Compile a function with Numba, lazily, cached on disk where a cache can be written.

    Parameters
    ----------
    reduction : bool
        Let the compiler reorder sums so that they vectorise. NaN and infinity keep their meaning. Never
        for the solves, whose order of operations is their accuracy. What such a kernel calls is a reduction
        or inline: anything else would get the same leave, for all its callers, if it is compiled for this one first.
    inline : bool
        Make the function part of every kernel that calls it, so that the compiler sees the sizes of the
        arrays that it gets. Its source goes there, which compiles it once instead of twice; that of a reduction
        only after it was compiled, since leave to reorder is given to whole functions. Where it is called in
        several places, that is also what compiles fastest.
    """
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
    if reduction:
        options["fastmath"] = {"contract", "reassoc"}
    if inline:
        options |= {"forceinline": True} if reduction else {"inline": "always"}

    def compile_lazily(function: Function) -> Function:
        function.__qualname__ = f"{function.__qualname__}_{_sources_digest()}"
        global has_cache
        dispatcher = numba.njit(**options)(function)
        with contextlib.suppress(AttributeError):  # a later Numba's inside is another: its own way then
            dispatcher._compiler.compile = without_haste(dispatcher._compiler.compile)
        try:
            dispatcher._cache = Cache(function)
            has_cache &= dispatcher._cache.saves
        except RuntimeError:  # nor a place to read from
            has_cache = False
        return cast(Function, dispatcher)

    return compile_lazily
