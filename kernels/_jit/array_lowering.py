"""How Numba translates these kernels: five costs of what Python allows, and kernels do not need.

- An index counts from the end only if it is spelled out, as in ``a[-1]``. Numba would test every other, too, unless the
  compiler can see that it is not negative: 2 to 5 % of the time. ``NUMBA_BOUNDSCHECK=1`` finds those that are.
- References to arrays that Python hands over are not counted: it holds them until the kernel returns, and kernels that
  it calls return numbers.
- Arrays that kernels make begin where lines of the cache do. Numba has them begin at a multiple of 32 bytes, by chance
  half of them in the middle of a line. Then each of their vectors that is as long as a line lies in two, and sums take
  up to a quarter more time.
- Data of an array that a kernel makes lie within what it allocated for it, where nothing else does. Numba looks up
  their place, and the compiler takes them for anybody's: before each loop it would compare all arrays' places, and go
  slowly where there are too many, or the loop is short.
- A function that only kernels call has no wrapper through which Python would call it. Wrappers, which take arrays out
  of tuples one by one, are a ninth of the time to compile.
"""

import contextlib
from collections.abc import Iterator
from typing import Any

CACHE_LINE = 64
"""Bytes of a line of the cache."""
KERNELS = __name__.removesuffix("_jit.array_lowering")
"""How the names of the kernels' modules begin."""


@contextlib.contextmanager
def as_kernels_need(function: Any) -> Iterator[None]:
    """Translate so what is compiled while a function that Python calls is; other libraries' wait for Numba's lock."""
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(ImportError, AttributeError):  # a later Numba may differ inside
            from numba.core.registry import cpu_target

            context = cpu_target.target_context
            stack.enter_context(replaced(context, "get_preferred_array_alignment", lambda _: CACHE_LINE))
        with contextlib.suppress(ImportError, AttributeError):
            from numba.np import arrayobj

            stack.enter_context(replaced(arrayobj, "fix_integer_index", _index_from(arrayobj.fix_integer_index)))
        with contextlib.suppress(ImportError, AttributeError):
            from numba.core.runtime.context import NRTContext

            stack.enter_context(replaced(NRTContext, "meminfo_data", _data_within(NRTContext.meminfo_data)))
        with contextlib.suppress(ImportError, AttributeError):
            from numba.core.cpu import CPUContext

            wrap = _wrap_only(function, CPUContext.create_cpython_wrapper)
            stack.enter_context(replaced(CPUContext, "create_cpython_wrapper", wrap))
        with contextlib.suppress(ImportError, AttributeError):
            from numba.core.pythonapi import PythonAPI

            stack.enter_context(replaced(PythonAPI, "nrt_adapt_ndarray_from_python", _borrow_array))
        yield


def _index_from(counting_from_the_end: Any) -> Any:
    """An index as it is, if it is not spelled out in the source: these may count from the end."""
    from llvmlite import ir
    from numba.core import types

    def index_as_it_is(context: Any, builder: Any, kind: Any, index: Any, size: Any) -> Any:
        if isinstance(index, ir.Constant):
            return counting_from_the_end(context, builder, kind, index, size)
        return context.cast(builder, index, kind, types.intp if kind.signed else types.uintp)

    return index_as_it_is


def _borrow_array(python: Any, array: Any, struct: Any) -> Any:
    """Read where an array of Python lies, and own nothing of it: as Numba does where nothing is counted."""
    from llvmlite import ir

    kind = ir.FunctionType(ir.IntType(32), [python.pyobj, python.voidptr])
    return python.builder.call(python._get_function(kind, name="numba_adapt_ndarray"), (array, struct))


def _wrap_only(function: Any, wrap: Any) -> Any:
    """Wrap one kernel for Python, and none that it calls."""

    def wrap_outermost(context: Any, library: Any, description: Any, *others: Any, **options: Any) -> None:
        is_outermost = (description.modname, description.qualname) == (function.__module__, function.__qualname__)
        if is_outermost or not description.modname.startswith(KERNELS):
            wrap(context, library, description, *others, **options)

    return wrap_outermost


def _data_within(data_of: Any) -> Any:
    """Where the data of a new array lie, as a distance from the beginning of what was allocated for it.

    Of that the compiler knows that it overlaps nothing older.
    """
    from llvmlite import ir
    from numba.core import types

    def data_within(context: Any, builder: Any, allocated: Any) -> Any:
        size = ir.IntType(types.intp.bitwidth)
        data = builder.ptrtoint(data_of(context, builder, allocated), size)
        return builder.gep(allocated, [builder.sub(data, builder.ptrtoint(allocated, size))])

    return data_within


@contextlib.contextmanager
def replaced(owner: Any, name: str, replacement: Any) -> Iterator[None]:
    """Have an attribute be another meanwhile, or, if it does not exist, do nothing: a later Numba may differ inside."""
    if not hasattr(owner, name):
        yield
        return
    is_own, before = name in vars(owner), getattr(owner, name)
    setattr(owner, name, replacement)
    try:
        yield
    finally:
        if is_own:
            setattr(owner, name, before)
        else:
            delattr(owner, name)
