"""What is arranged for Numba while it compiles."""

import gc
import os
import signal

import numba
import numpy as np
import pytest
from numba import config
from numba.core import event
from numba.core.cpu import CPUContext
from numba.core.registry import cpu_target
from processes import printed_by

from rgbd_planes.kernels._jit import array_lowering, compiler_pauses
from rgbd_planes.kernels._jit import kernel as jit


class Witness(event.Listener):
    """Sees the collector's first threshold whenever a kernel begins to be compiled."""

    def __init__(self):
        self.thresholds = []

    def on_start(self, event):
        self.thresholds.append(gc.get_threshold()[0])

    def on_end(self, event):
        pass


@pytest.fixture(autouse=True)
def compiled_anew(tmp_path, monkeypatch):
    """Not loaded from what an earlier run of these tests saved."""
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))


@pytest.fixture
def witness():
    before, witness = gc.get_threshold(), Witness()
    event.register("numba:compile", witness)
    yield witness
    event.unregister("numba:compile", witness)
    gc.set_threshold(*before)


def double(x):
    return 2 * x


def test_kernels_are_compiled_once_for_all_numbers_of_a_type():
    """Not for 0 as well, with which a caller begins."""
    plus_one = jit.kernel()(lambda x: x + 1)

    def count(n):
        number = 0
        for _ in range(n):
            number = plus_one(number)
        return plus_one(7) + number

    before = compiler_pauses.compiled
    assert jit.kernel()(count)(3) == 11
    assert compiler_pauses.compiled == before + 2


def test_kernels_are_counted_when_they_are_compiled():
    """Those that others call, too, and each once."""
    inner = jit.kernel()(lambda x: x + 1)
    outer = jit.kernel()(lambda x: inner(x) + inner(x + 1))
    before = compiler_pauses.compiled
    assert outer(1) == outer(0) + 2 == 5
    assert compiler_pauses.compiled == before + 2
    assert inner(2.5) == 3.5
    assert compiler_pauses.compiled == before + 3


@pytest.mark.parametrize("interrupted", ["outer", "inner"])
def test_an_interrupt_comes_between_kernels(interrupted):
    """Amid one Python would drop it, or crash."""

    @jit.kernel()
    def inner(x):
        return x + 1

    @jit.kernel()
    def outer(x):
        return inner(x) + 2

    after = []

    class Interrupts(event.Listener):
        def on_start(self, event):
            if f"{interrupted}_" in event.data["qualname"] and not after:
                os.kill(os.getpid(), signal.SIGINT)
                after.append("still compiling")

        def on_end(self, event):
            pass

    listener = Interrupts()
    before = signal.default_int_handler
    ours = signal.signal(signal.SIGINT, before)  # a shell's background has none
    event.register("numba:run_pass", listener)
    try:
        with pytest.raises(KeyboardInterrupt):
            outer(1)
        assert signal.getsignal(signal.SIGINT) is before
    finally:
        event.unregister("numba:run_pass", listener)
        signal.signal(signal.SIGINT, ours)
    assert after == ["still compiling"]
    assert outer(1) == 4


def test_kernels_compile_without_haste():
    assert hasattr(numba.njit(double)._compiler, "compile")  # what is replaced is still what Numba calls
    kernel = jit.kernel()(lambda x: x + 1)
    assert kernel._compiler.compile.__wrapped__.__func__ is type(kernel._compiler).compile
    assert kernel(2) == 3
    assert kernel.signatures == [(numba.int64,)]


@pytest.mark.parametrize("inline", [False, "compiled"])
def test_a_kernel_adds_in_order_even_if_one_that_may_not_is_compiled_first(inline, rng):
    def total(values):
        total = 0.0
        for i in range(len(values)):
            total += values[i]
        return total

    added = jit.kernel(inline=inline)(total)
    reordered = jit.kernel(reduction=True)(lambda values: added(values))
    values = rng.normal(size=1001) * 10.0 ** rng.uniform(-8.0, 8.0, 1001)
    assert reordered(values) == total(values)
    assert added(values) == total(values)


@pytest.mark.parametrize(("given", "during"), [(700, compiler_pauses.PATIENCE), (0, 0), (50_000, 50_000)])
def test_garbage_waits_while_kernels_compile(given, during, witness):
    """By default; not if nobody looks for it, or somebody is as patient already."""
    inner = numba.njit(double)
    outer = numba.njit(lambda x: inner(inner(x)))
    for dispatcher in (inner, outer):
        dispatcher._compiler.compile = compiler_pauses.without_haste(dispatcher._compiler.compile, dispatcher.py_func)
    gc.set_threshold(given, 11)
    as_given, seen = gc.get_threshold(), []
    compile_inner = inner._compiler.compile
    inner._compiler.compile = lambda *args: (seen.append(gc.get_threshold()[0]), compile_inner(*args))[1]
    assert outer(3) == 12
    assert seen == [during]
    assert witness.thresholds == [given, during]  # the outer one's begins before all is arranged for it
    assert gc.get_threshold() == as_given
    assert not compiler_pauses.is_compiling


def test_what_somebody_sets_meanwhile_stays(witness):
    assert compiler_pauses.without_haste(lambda: gc.set_threshold(1234), None)() is None
    assert gc.get_threshold()[0] == 1234


def test_all_is_as_before_if_compiling_fails(witness):
    gc.set_threshold(700)
    with pytest.raises(ZeroDivisionError):
        compiler_pauses.without_haste(lambda: 1 / 0, None)()
    assert gc.get_threshold()[0] == 700
    assert not compiler_pauses.is_compiling


def test_no_call_takes_memory_from_the_system():
    """Wherever the chunks of frames end that Python would take otherwise, every 16 KB."""
    resource = pytest.importorskip("resource", reason="the system does not count pages")

    def faults() -> int:
        return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

    def most_faults(depth: int) -> int:
        """Of 1000 calls, at each of as many depths of calls within calls."""
        before = faults()
        for _ in range(1000):
            double(1)
        here = faults() - before
        return max(here, most_faults(depth - 1)) if depth else here

    assert compiler_pauses.without_haste(most_faults, None)(400) < 500


FORK_WHILE_A_THREAD_COMPILES = """
import os, signal, threading, time
import numba
from rgbd_planes.kernels._jit import kernel as jit

begun = threading.Event()

@numba.extending.overload(len)
def slowly(thing):
    if isinstance(thing, numba.types.Integer):
        begun.set()
        time.sleep(1.0)
        return lambda thing: 5

kernel = jit.kernel()(lambda x: len(x))
thread = threading.Thread(target=kernel, args=(1,))
thread.start()
begun.wait()
child = os.fork()
if child == 0:
    signal.alarm(60)  # which ends it if it waits for a thread that it does not have
    os._exit(0 if kernel(1) == 5 else 1)
status = os.waitpid(child, 0)[1]
thread.join()
print(status)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_fork_while_a_thread_compiles():
    assert printed_by(FORK_WHILE_A_THREAD_COMPILES, PYTHONWARNINGS="ignore").split() == ["0"]


RETURNED_TO_PYTHON = """
import ast, importlib, numba, types
from pathlib import Path
import numpy as np
import rgbd_planes as rp

noise = rp.noise.NoiseModel((1.4e-3,), correlation=((0.5, 3.0),), floor=0.5, lateral=0.3)
camera = rp.Camera(160, 120, 131.0, 131.0, 79.5, 59.5, depth_scale=1000.0, noise=noise)
depth = rp.scenes.room().render(camera).measure(holes=0.05, seed=1)
tiles, segments = rp.fit_tiles(depth, camera, 8), rp.segment(depth, camera)
for fits in (tiles, rp.fit_windows(depth, camera, [[0, 0, 30, 40]]), rp.fit_labels(depth, camera, segments.labels)):
    fits.p_value, fits.plane_covariance, rp.merge(fits, np.ones(fits.shape, np.int32)).angle_std
segments.angle_std, rp.normals(depth, camera), rp.segment_quadtree(depth, camera)
called = {}
for path in Path(rp.__file__).parent.rglob("*.py"):
    if "kernels" in path.relative_to(Path(rp.__file__).parent).parts:
        continue
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("rgbd_planes.kernels"):
            for name in node.names:
                try:
                    found = getattr(importlib.import_module(node.module), name.name)
                except AttributeError:
                    found = importlib.import_module(f"{node.module}.{name.name}")
                of = vars(found) if isinstance(found, types.ModuleType) else {name.name: found}
                used = {n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute)} | {name.name}
                called |= {f"{found.__name__}.{k}": v for k, v in of.items() if k in used and hasattr(v, "signatures")}
print(len(called), sum(bool(kernel.signatures) for kernel in called.values()))
plain = numba.types.Number, numba.types.Boolean, numba.types.NoneType
for name, kernel in called.items():
    for made in kernel.overloads.values():
        result = made.signature.return_type
        parts = result if isinstance(result, (numba.types.Tuple, numba.types.UniTuple)) else [result]
        if not all(isinstance(part, plain) for part in parts):
            print(name, result)
"""


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_kernels_that_python_calls_return_numbers():
    """To make an array, or a named tuple, Numba calls Python; an interrupt there would end the process."""
    first, *others = printed_by(RETURNED_TO_PYTHON, timeout=600.0).splitlines()
    kernels, compiled = map(int, first.split())
    assert kernels > 30
    assert compiled > 15
    assert others == []


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_arrays_of_kernels_begin_where_lines_of_the_cache_do():
    """And those of other kernels than this library's as Numba has them, also where a kernel cannot be compiled."""

    @jit.kernel()
    def beginnings(count):
        beyond = 0
        for size in range(1, count):  # some of all sizes: by chance half would begin elsewhere
            a, b = np.empty(size), np.zeros((size, 3), np.float32)
            beyond += a.ctypes.data % array_lowering.CACHE_LINE + b.ctypes.data % array_lowering.CACHE_LINE
        return beyond

    @jit.kernel()
    def broken(count):
        return count.no_such_thing

    assert beginnings(100) == 0
    with pytest.raises(numba.TypingError):
        broken(1)
    assert "get_preferred_array_alignment" not in vars(cpu_target.target_context)


@pytest.mark.skipif(config.DISABLE_JIT or config.BOUNDSCHECK, reason="nothing is compiled, or every index is tested")
def test_only_indices_that_are_spelled_out_count_from_the_end():
    """The others are taken as they are: here to what lies before the array, of which it is a part."""

    @jit.kernel()
    def at(values, k):
        return values[-1], values[k], values[-1:][0]

    @numba.njit
    def elsewhere(values, k):
        return values[k]

    values = np.arange(5.0)[1:]
    assert at(values, 0) == (4.0, 1.0, 4.0)
    assert at(values, -1) == (4.0, 0.0, 4.0)
    assert elsewhere(values, -1) == 4.0


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_references_to_arrays_of_python_are_not_counted():
    @jit.kernel()
    def total(values):
        return values[:2].sum() + np.ones(3).sum()

    @numba.njit
    def elsewhere(values):
        return values[:2].sum()

    assert total(np.arange(3.0)) == 4.0
    assert elsewhere(np.arange(3.0)) == 1.0
    (code,), (elsewhere_code,) = total.inspect_llvm().values(), elsewhere.inspect_llvm().values()
    assert "NRT_adapt_ndarray_from_python" not in code
    assert "NRT_adapt_ndarray_from_python" in elsewhere_code


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_loops_do_not_compare_where_arrays_of_kernels_lie():
    def last_sum(values):
        a, b = np.empty(len(values)), np.empty(len(values))
        for i in range(len(values)):
            a[i] = 2.0 * i
        for i in range(len(values)):
            b[i] = a[i] + values[i]
        return b[len(values) - 1]

    kernel, elsewhere = jit.kernel()(last_sum), numba.njit(last_sum)
    assert kernel(np.arange(100.0)) == elsewhere(np.arange(100.0)) == 297.0
    (code,), (elsewhere_code,) = kernel.inspect_llvm().values(), elsewhere.inspect_llvm().values()
    assert "memcheck" not in code
    assert config.BOUNDSCHECK or "memcheck" in elsewhere_code


def test_only_the_kernel_that_python_calls_is_wrapped_for_it(monkeypatch):
    """What only kernels call, Python can call later."""
    wrapped, wrap = [], CPUContext.create_cpython_wrapper

    def witnessed(context, library, description, *others, **options):
        wrapped.append(description.qualname.rpartition("_")[0])
        wrap(context, library, description, *others, **options)

    monkeypatch.setattr(array_lowering, "KERNELS", __name__)
    monkeypatch.setattr(CPUContext, "create_cpython_wrapper", witnessed)
    half = jit.kernel()(lambda x: x / 2)
    quarter = jit.kernel()(lambda x: half(half(x)))
    quarter.py_func.__qualname__ = "quarter_0"
    half.py_func.__qualname__ = "half_0"
    assert quarter(1.0) == 0.25
    assert wrapped == ["quarter"]
    assert half(1.0) == 0.5
    assert wrapped == ["quarter", "half"]


def test_what_a_later_numba_may_not_have_is_left_alone():
    class Later:
        pass

    with array_lowering.replaced(Later, "renamed", 1):
        assert not hasattr(Later, "renamed")
