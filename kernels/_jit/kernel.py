"""How every kernel is compiled: the one place that holds Numba's options.

Kernels are serial and release the GIL; they work on a range of tiles or rows, and
``rgbd_planes._core.threads`` gives the ranges to threads. So nothing here depends on a Numba threading layer:
not its launch cost, not its behaviour after a fork, not its thread safety.
"""

import contextlib
import functools
import hashlib
import os
import re
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


_IMPORTS = re.compile(r"^from (\.+)([\w.]*) import (\([^)]*\)|[^\n]*)", re.MULTILINE)


@functools.cache
def _digest(file: str) -> str:
    """Digest of a file's source and of the kernels that it imports.

    Numba's cache looks only at the file of the function itself: a kernel that calls another file's kernel would stay
    stale when that file changes. The digest in the function's qualified name, which is part of the cache's file name,
    gives every change to what a kernel may call a new cache entry.
    """
    path = Path(file)
    if not path.is_file():  # in a zip, or in a program without sources, which another may replace
        stat = os.stat(getattr(__loader__, "archive", sys.executable))
        return hashlib.sha256(repr((stat.st_mtime_ns, stat.st_size)).encode()).hexdigest()[:12]
    source = path.read_bytes()
    digest = hashlib.sha256(source)
    if path.is_relative_to(KERNELS):
        for imported in _imported(path, source.decode()):
            digest.update(_digest(str(imported)).encode())
    else:  # it may import any of them, under any name
        for each in sorted(KERNELS.glob("**/*.py")):
            digest.update(_digest(str(each)).encode())
    return digest.hexdigest()[:12]


def _imported(path: Path, source: str) -> list[Path]:
    """The files that a kernel's file imports: all imports between kernels are relative, and at the top."""
    found = []
    for dots, module, names in _IMPORTS.findall(source):
        place = path.parents[len(dots) - 1].joinpath(*module.split("."))
        if place.is_dir():
            found += [place / f"{name.split()[0]}.py" for name in names.strip("()").split(",") if name.strip()]
        else:
            found.append(place.with_suffix(".py"))
    return sorted(set(found))


def _let_kernels_call(dispatcher: Any, part: Callable[[], Any]) -> None:
    """Have other kernels call a function that is compiled for them alone, as a part of them that Python can't call.

    It is compiled once for all numbers of a type, instead of again for those that callers spell out.
    """

    def get_call_template(args: Any, kws: Any) -> Any:
        return part().get_call_template(tuple(map(unliteral, args)), {name: unliteral(kws[name]) for name in kws})

    dispatcher.get_call_template, dispatcher.get_overload = get_call_template, lambda sig: part().get_overload(sig)


def _dispatcher(function: Callable[..., Any], options: dict[str, Any], suffix: str) -> Any:
    """Numba's dispatcher of a function; compiled code is saved under its name and a suffix."""
    global has_cache
    dispatcher = numba.njit(**options)(function)
    with contextlib.suppress(AttributeError):  # a later Numba may differ inside: its own way then
        dispatcher._compiler.compile = without_haste(dispatcher._compiler.compile, function)
    try:
        dispatcher._cache = Cache(function, suffix)
        has_cache &= dispatcher._cache.saves
    except RuntimeError:  # not even a place to read from
        has_cache = False
    return dispatcher


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
        gets. With True its source goes there, and is compiled once instead of twice. With "compiled" its code goes
        there, which takes less time where several kernels call it; such a function makes no arrays. A reduction goes
        there compiled, since reordering is allowed to whole functions only.
    arrays : bool
        Whether it makes arrays. If not, references to the arrays that it gets, and to slices of them, are not counted.
        Otherwise each would be counted at every call, and each slice in a loop.
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
        if numba.config.DISABLE_JIT:  # plain Python: as silent as compiled code of what is divided by 0 or overflows
            return cast(Function, np.errstate(all="ignore")(function))
        dispatcher = _dispatcher(function, options, "")
        _let_kernels_call(dispatcher, functools.cache(lambda: _dispatcher(function, options, "-part")))
        return cast(Function, dispatcher)

    return compile_lazily
