"""Importing, first calls, threads and forks, each in a process of its own where it must be."""

import inspect
import os
import re
import subprocess
import sys
import threading
import time
import warnings

import numpy as np
import pytest
from frames import make_camera, make_depth
from processes import printed_by

import rgbd_planes as rp
import rgbd_planes.kernels
from rgbd_planes._core import compile_notice
from rgbd_planes.kernels._jit import compiler_pauses


def test_import_is_light():
    code = (
        "import sys, rgbd_planes as rp; rp.fit_tiles; "
        "print([m for m in ('matplotlib', 'PIL', 'pandas', 'tqdm', 'shapely') if m in sys.modules])"
    )
    assert printed_by(code).strip() == "[]"


def test_public_names_are_there():
    for name in dir(rp):
        assert getattr(rp, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = rp.nonsense


def test_a_name_with_an_error_is_told_which_is_meant():
    ran = subprocess.run(
        [sys.executable, "-c", "import rgbd_planes as rp; rp.segmnt"], capture_output=True, text=True, check=False
    )
    assert ran.stderr.endswith("has no attribute 'segmnt'. Did you mean: 'segment'?\n")


def test_help_is_legible():
    """An ArrayLike that is evaluated shows all that NumPy makes of it: eight lines before the first word."""
    modules = (rp.export, rp.images, rp.metrics, rp.noise, rp.scenes, rp.segmentation_export, rp.uncertainty)
    shown = [getattr(rp, name) for name in dir(rp)]
    shown += [value for module in modules for value in vars(module).values()]
    shown += [value for kind in shown if inspect.isclass(kind) for value in vars(kind).values()]
    for value in filter(inspect.isfunction, shown):
        assert "_SupportsArray" not in str(inspect.signature(value)), value


def test_kernels_from_the_cache_leave_compilation_alone():
    """What only a compilation needs takes half a second to import; whoever needs it after that gets it."""
    camera = rp.Camera(64, 48, 50.0, 50.0, 31.5, 23.5)
    for call in (rp.fit_tiles, rp.normals, rp.curvature, rp.segment):
        call(np.full((48, 64), 2.0, np.float32), camera)  # into the cache
    code = (
        "import sys, numpy as np, rgbd_planes as rp\n"
        "camera = rp.Camera(64, 48, 50.0, 50.0, 31.5, 23.5)\n"
        "depth = np.full((48, 64), 2.0, np.float32)\n"
        "tiles = rp.fit_tiles(depth, camera)\n"
        "rp.normals(depth, camera), rp.curvature(depth, camera), rp.segment(depth, camera)\n"
        "print(np.round(tiles.planes[0, 0] + 0.0, 9).tolist(), 'numba.np.linalg' in sys.modules)\n"
        "import numba\n"
        "@numba.njit\n"
        "def norms(planes): return [np.linalg.norm(plane) for plane in planes.reshape(-1, 4)]\n"
        "print(norms(tiles.planes)[0] ** 2)\n"
    )
    plane, norm = printed_by(code).splitlines()
    assert plane == "[0.0, 0.0, -1.0, 2.0] False"
    assert float(norm) == pytest.approx(5.0)


def test_cache_loads_whatever_numba_calls_its_own_way():
    """The quick way uses names of Numba that are not public; without them kernels load as Numba loads its own."""
    code = (
        "from numba.core import caching\n"
        "load = caching.Cache._load_overload\n"
        "del caching.Cache._load_overload\n"
        "def load_overload(self, signature, context):\n"
        "    context.refresh()\n"
        "    return load(self, signature, context)\n"
        "caching.Cache.load_overload = load_overload\n"
        "import sys, numpy as np, rgbd_planes as rp\n"
        "from rgbd_planes.kernels.fits.tiles import fit_tiles\n"
        "rp.fit_tiles(np.full((48, 64), 2.0, np.float32), rp.Camera(64, 48, 50.0, 50.0, 31.5, 23.5))\n"
        "print(sum(fit_tiles.stats.cache_hits.values()), sum(fit_tiles.stats.cache_misses.values()))\n"
    )
    printed_by(code)
    assert printed_by(code).strip() == "1 0"


def test_kernels_run_as_plain_python():
    """With NUMBA_DISABLE_JIT, by which one steps through a kernel: the same results, and no warnings."""
    code = (
        "import warnings, numpy as np, rgbd_planes as rp\n"
        "warnings.simplefilter('error')\n"
        "noise = rp.noise.kinect_v1()\n"
        "camera = rp.Camera(64, 48, 52.0, 52.0, 31.5, 23.5, depth_scale=1000.0, noise=noise)\n"
        "depth = rp.scenes.room().render(camera).measure(holes=0.05, patches=0.1, seed=1)\n"
        "tiles = rp.fit_tiles(depth, camera, 8)\n"
        "print(tiles.status.tolist(), np.round(tiles.planes, 6).tolist(), np.round(tiles.p_value, 6).tolist())\n"
        "print(rp.normals(depth, camera).round(4).tolist(), rp.segment(depth, camera).labels.tolist())\n"
    )
    assert printed_by(code, NUMBA_DISABLE_JIT="1") == printed_by(code)


def wait_for(messages, caplog):
    """However busy the machine is."""
    until = time.monotonic() + 60.0
    while len(caplog.messages) < messages and time.monotonic() < until:
        time.sleep(0.01)


def test_slow_first_call_is_announced_once(caplog, monkeypatch):
    monkeypatch.setattr(compile_notice, "SECONDS_BEFORE_NOTICE", 0.01)
    monkeypatch.setattr(compile_notice, "_announced", {})
    monkeypatch.setattr(compile_notice, "_compiled", set())
    with compile_notice.announced("loaded"):  # however long it takes
        time.sleep(0.1)
    monkeypatch.setattr(compiler_pauses, "is_compiling", True)
    with monkeypatch.context() as patch:
        patch.setattr(compile_notice, "SECONDS_BEFORE_NOTICE", 60.0)
        with compile_notice.announced("quick"):
            pass
    assert caplog.messages == []
    with compile_notice.announced("slow"):
        wait_for(1, caplog)
    with compile_notice.announced("slow too"):
        time.sleep(0.1)
    assert len(caplog.messages) == 1
    # Of threads that wait for the same kernels, too: their timers have been started already.
    compile_notice._announced.clear()
    with compile_notice.announced("one"), compile_notice.announced("other"):
        wait_for(2, caplog)
    assert len(caplog.messages) == 2
    assert caplog.messages[0].startswith("compiling kernels: up to half a minute")
    # What takes far longer is said all the same.
    with compile_notice.announced("segment", "about a minute"):
        wait_for(3, caplog)
    assert caplog.messages[2].startswith("compiling kernels: about a minute")


def test_a_notice_waits_until_something_is_compiled(caplog, monkeypatch):
    """Of several kernels the first ones may come from the disk."""
    monkeypatch.setattr(compile_notice, "SECONDS_BEFORE_NOTICE", 0.01)
    monkeypatch.setattr(compile_notice, "_announced", {})
    monkeypatch.setattr(compile_notice, "_compiled", set())
    with compile_notice.announced("one is not there"):
        time.sleep(0.1)
        assert caplog.messages == []
        monkeypatch.setattr(compiler_pauses, "is_compiling", True)
        wait_for(1, caplog)
    assert len(caplog.messages) == 1


def test_what_compiles_for_long_says_how_far_it_is(caplog, monkeypatch):
    """And says no more once everything is compiled, however long the call goes on."""
    monkeypatch.setattr(compile_notice, "SECONDS_BEFORE_NOTICE", 0.01)
    monkeypatch.setattr(compile_notice, "SECONDS_BETWEEN_NOTICES", 0.01)
    monkeypatch.setattr(compile_notice, "_announced", {})
    monkeypatch.setattr(compile_notice, "_compiled", set())
    monkeypatch.setattr(compiler_pauses, "is_compiling", True)
    with compile_notice.announced("segment"):
        wait_for(2, caplog)
        monkeypatch.setattr(compiler_pauses, "compiled", 41)
        wait_for(len(caplog.messages) + 2, caplog)
        monkeypatch.setattr(compiler_pauses, "is_compiling", False)
        time.sleep(0.1)
        said = caplog.messages.copy()
        time.sleep(0.2)
        assert caplog.messages == said
    assert said[0].startswith("compiling kernels: up to half a minute")
    assert re.fullmatch(r"still compiling kernels after \d s: 41 are done", said[-1])


def test_what_is_left_to_compile_is_told_once_something_is_done(caplog, monkeypatch):
    monkeypatch.setattr(compile_notice, "SECONDS_BEFORE_NOTICE", 0.01)
    monkeypatch.setattr(compile_notice, "SECONDS_BETWEEN_NOTICES", 0.01)
    monkeypatch.setattr(compile_notice, "_announced", {})
    monkeypatch.setattr(compile_notice, "_compiled", set())
    with compile_notice.announced("segment"), compile_notice.counted(10.0) as count:
        wait_for(2, caplog)
        assert caplog.messages[1] == "still compiling kernels after 0 s: the largest come first"
        count(8.0)
        wait_for(len(caplog.messages) + 2, caplog)
    assert re.fullmatch(r"still compiling kernels after \d s: 80% are done, about \d s are left", caplog.messages[-1])


def test_a_notice_that_gets_no_thread_is_not_given(monkeypatch):
    def limited(self):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", limited)
    monkeypatch.setattr(compile_notice, "_announced", {})
    monkeypatch.setattr(compile_notice, "_compiled", set())
    camera = make_camera()
    assert rp.fit_tiles(np.full(camera.shape, 2.0), camera).fitted.all()


def test_warmup_for_segments_leaves_nothing_to_compile():
    """Whatever the scene: what a frame needs was run or listed by the warmup, even where all is on disk already."""
    code = """
import sys, numba, numpy as np, rgbd_planes as rp
from numba.core.dispatcher import Dispatcher
from rgbd_planes import scenes
from rgbd_planes.segmentation import compilation
distorted = rp.Camera(200, 150, 170.0, 170.0, 99.5, 74.5, (0.1, -0.2, 0.0, 0.0, 0.0), depth_scale=5000.0)
known = distorted.with_noise(rp.noise.NoiseModel((1e-3,), correlation=((0.5, 2.0),), floor=0.5))
dtypes = ["uint16", "float32"]
rp.warmup(distorted, dtypes=dtypes, segment=True)

def ready():
    modules = [module for name, module in sys.modules.items() if name.startswith("rgbd_planes.kernels.")]
    kernels = {value for module in modules for value in vars(module).values() if isinstance(value, Dispatcher)}
    return {(kernel.py_func.__qualname__, types) for kernel in kernels for types in kernel.overloads}

provided = ready()
for dtype in (np.dtype(name).str for name in dtypes):
    for _, kernel, arguments in compilation._calls(dtype, False) + compilation._more_calls(dtype):
        provided.add((kernel.py_func.__qualname__, tuple(map(numba.typeof, arguments))))
for scene in (scenes.room(), scenes.room((0.1, -1.5, 0.0)), scenes.plane((0.0, 0.0, -1.0), 2.0)):
    depth = scene.render(distorted).measure(holes=0.05, patches=0.1)
    rp.segment(depth, distorted)
    rp.segment(depth, known)
    rp.segment((depth / 5000).astype(np.float32), distorted, noise=rp.noise.kinect_v1())
needed = ready()
print(len(needed) > 30, sorted(name for name, _ in needed - provided))
"""
    assert printed_by(code).strip() == "True []"


def test_warmup_does_not_doubt_a_camera():
    """Whatever the noise would be at the depth that its frames happen to have."""
    disparity = (1.0 / (16.0 * 500.0 * 0.1), 0.0)
    camera = make_camera(depth_scale=None, disparity=disparity, noise=rp.noise.stereo(0.1, 500.0, 0.25))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rp.warmup(camera)


@pytest.mark.parametrize("many", ["fit", "fit_batch", "fit_stream"])
def test_what_is_compiled_is_announced(many, monkeypatch):
    """However frames are fitted, and by the type that kernels are compiled for."""
    monkeypatch.setattr(compile_notice, "_announced", {})
    monkeypatch.setattr(compile_notice, "_compiled", set())
    fitter = rp.TileFitter(make_camera(), 8, num_threads=2)
    frame = np.full((48, 64), 1000, np.int32)
    fitter.fit(frame) if many == "fit" else list(getattr(fitter, many)([frame] * 3))
    assert compile_notice._compiled == {("range_explicit", "direct", False, False, np.dtype(np.float64))}


def test_works_without_a_place_for_a_cache():
    """Numba finds nothing where home and installation are read-only; nobody has compiled for this processor."""
    code = (
        "import os; os.environ['NUMBA_CPU_NAME'] = 'generic'\n"
        "import numba.core.caching as caching; caching.CacheImpl._locator_classes = []\n"
        "import logging, sys, numpy as np, rgbd_planes as rp\n"
        "from rgbd_planes._core import compile_notice\n"
        "logging.basicConfig(stream=sys.stdout)\n"
        "compile_notice.SECONDS_BEFORE_NOTICE = 0.01\n"
        "camera = rp.Camera(16, 16, 9.0, 9.0, 8.0, 8.0)\n"
        "print(rp.fit_tiles(np.full((16, 16), 2.0), camera).planes.round(9).tolist())"
    )
    notice, *_, planes = printed_by(code).splitlines()  # where compiling takes long, it says so again
    assert "again in each process: set NUMBA_CACHE_DIR to a folder" in notice
    assert planes.endswith("-1.0, 2.0]]]")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_child_fits_with_threads():
    code = (
        "import os, numpy as np, rgbd_planes as rp\n"
        "camera = rp.Camera(64, 64, 50.0, 50.0, 32.0, 32.0)\n"
        "fitter = rp.TileFitter(camera, 8, num_threads=3)\n"
        "depth = np.full((64, 64), 2.0)\n"
        "fitter.fit(depth)\n"
        "child = os.fork()\n"
        "if child == 0:\n"
        "    os._exit(0 if np.allclose(fitter.fit(depth).planes[..., 3], 2.0) else 1)\n"
        "print(os.waitpid(child, 0)[1])\n"
    )
    # Python warns that forking a process with threads may deadlock: that is what is tested.
    assert printed_by(code, PYTHONWARNINGS="ignore").strip() == "0"


def test_eight_threads_at_once(rng):
    """Python threads that share a fitter get what one alone gets."""
    camera = make_camera()
    fitter = rp.TileFitter(camera, 8, num_threads=2)
    frames = [make_depth(camera, rng) for _ in range(8)]
    wanted = [fitter.fit(frame).planes for frame in frames]
    failures = []

    def fit_often(i):
        for _ in range(20):
            if not np.array_equal(fitter.fit(frames[i]).planes, wanted[i]):
                failures.append(i)

    threads = [threading.Thread(target=fit_often, args=(i,)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
