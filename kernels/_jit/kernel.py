"""How every kernel is compiled: the one place that holds Numba's options.

Kernels are serial and release the GIL; they work on a range of tiles or rows, and
``rgbd_planes._core.threads`` gives the ranges to threads. So nothing here depends on a Numba threading layer:
not its launch cost, not its behaviour after a fork, not its thread safety.
"""

import contextlib
import functools
import hashlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

import numba
import numpy as np
from numba.core.options import DefaultOptions
from numba.core.types import unliteral

from .compiler_pauses import without_haste
from .disk_cache import Cache

Function = TypeVar("Function", bound=Callable[..., Any])

KERNELS = Path(__file__).parents[1]

has_cache = True
"""Whether compiled kernels have a place on disk: False if neither the installation nor the home folder is writable."""


LAYERS = ("_jit", "common", "moments", "solvers", "fits", "statistics", "segmentation")
"""Folders of kernels, lowest first. A kernel calls those of its own folder and of folders before it."""


@functools.cache
def _sources_digest(folder: str = LAYERS[-1]) -> str:
    """Digest of the kernels' sources in a folder and in all below it.

    Numba's cache looks only at the file of the function itself: a kernel that calls another file's
    kernel would stay stale when that file changes. The digest in the function's qualified name, which is
    part of the cache's file name, gives every change to what a kernel may call a new cache entry.
    """
    digest = hashlib.sha256()
    folders = LAYERS[: LAYERS.index(folder) + 1]
    paths = sorted(path for name in folders for path in (KERNELS / name).glob("**/*.py"))
    for path in paths:
        digest.update(path.relative_to(KERNELS).as_posix().encode())
        digest.update(path.read_bytes())
    if not paths:  # they are in a zip, or in a program without sources, which another may replace
        stat = os.stat(getattr(__loader__, "archive", sys.executable))
        digest.update(repr((stat.st_mtime_ns, stat.st_size)).encode())
    return digest.hexdigest()[:12]


@functools.cache
def _digest(file: str) -> str:
    """Digest of what a kernel in this file may call, and of the file itself if it lies elsewhere, as in the benches."""
    path = Path(file)
    if path.is_relative_to(KERNELS):
        folder = path.relative_to(KERNELS).parts[0]
        return _sources_digest(folder if folder in LAYERS else LAYERS[-1])
    if not path.is_file():
        return _sources_digest()
    return hashlib.sha256(_sources_digest().encode() + path.read_bytes()).hexdigest()[:12]


def _of_any_value(template: Callable[..., Any]) -> Callable[..., Any]:
    """Have a kernel compiled once for all numbers of a type, instead of again for those that its callers spell out."""
    return lambda args, kws: template(tuple(map(unliteral, args)), {name: unliteral(kws[name]) for name in kws})


def kernel(
    *, reduction: bool = False, inline: bool | Literal["compiled"] = False, arrays: bool = True
) -> Callable[[Function], Function]:
    """Compile a function with Numba, lazily, cached on disk where a cache can be written.

    Parameters
    ----------
    reduction : bool
        Let the compiler reorder sums so that they vectorise. NaN and infinity keep their meaning. Never for the solves,
        whose accuracy depends on the order of operations.
    inline : bool or "compiled"
        Make the function part of every kernel that calls it, so that the compiler sees the sizes of the arrays that it
        gets. Its source goes there, and is compiled once instead of twice; or it goes there "compiled", which takes
        less time where several kernels call it: such a function makes no arrays. A reduction goes there compiled,
        since reordering is allowed to whole functions only.
    arrays : bool
        Whether it makes arrays. If not, references to those that it gets, and to slices of them, are not counted: with
        others it would count each at every call, and each slice of a loop.
    """
    # Each option is said: what is not, a function takes from the kernel for which it is compiled first.
    options: dict[str, Any] = {
        "nogil": True,
        "error_model": "numpy",
        "fastmath": {"contract", "reassoc"} if reduction else False,
        "no_cfunc_wrapper": True,  # which C would call, and takes a second of 45 to compile
    }
    if inline is True and not reduction:
        options["inline"] = "always"
    else:
        options["forceinline"] = bool(inline)
    if hasattr(DefaultOptions, "_nrt"):  # without arrays of its own there are no references to count, at each call
        options["_nrt"] = arrays and inline != "compiled"

    def compile_lazily(function: Function) -> Function:
        function.__qualname__ = f"{function.__qualname__}_{_digest(function.__code__.co_filename)}"
        global has_cache
        if numba.config.DISABLE_JIT:  # plain Python: as silent as compiled code of what is divided by 0 or overflows
            return cast(Function, np.errstate(all="ignore")(function))
        dispatcher = numba.njit(**options)(function)
        with contextlib.suppress(AttributeError):  # a later Numba may differ inside: its own way then
            dispatcher._compiler.compile = without_haste(dispatcher._compiler.compile)
            dispatcher.get_call_template = _of_any_value(dispatcher.get_call_template)
        try:
            dispatcher._cache = Cache(function)
            has_cache &= dispatcher._cache.saves
        except RuntimeError:  # not even a place to read from
            has_cache = False
        return cast(Function, dispatcher)

    return compile_lazily
