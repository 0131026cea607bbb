"""The same bits from many threads, after a fork, and from a stream."""

import gc
import itertools
import os
import signal
import subprocess
import sys
import threading
import time
import weakref

import numpy as np
import pytest
from frames import METHODS, as_dtype, make_camera, make_depth, make_holes
from processes import printed_by

import rgbd_planes as rp
from rgbd_planes._core import threads
from rgbd_planes._core.user_warnings import warn_caller
from rgbd_planes.batch import fit_sequence as batch
from rgbd_planes.fitting import grid_fitter

ARRAYS = ("planes", "alpha", "rmse", "rmse_metric", "valid_count", "status")

EIGHT_AT_ONCE = """
import os, threading
import numpy as np
import rgbd_planes as rp

camera = rp.Camera(64, 48, 52.0, 52.0, 31.5, 23.5, depth_scale=1000.0)
frames = np.random.default_rng(0).integers(1000, 1100, (4, 48, 64)).astype(np.uint16)
fitters = [rp.TileFitter(camera, 8, num_threads=n) for n in (1, 2, 3)]
wanted = fitters[0].fit_batch(frames).planes.tobytes()
wrong, start = [], threading.Barrier(8)

def work(i):
    start.wait()
    for k in range(20):
        fitter = fitters[(i + k) % 3]
        planes = fitter.fit_batch(frames).planes if k % 2 else np.stack([fitter.fit(f).planes for f in frames])
        if planes.tobytes() != wanted:
            wrong.append((i, k))

threads = [threading.Thread(target=work, args=(i,)) for i in range(8)]
for thread in threads: thread.start()
for thread in threads: thread.join()
child = os.fork() if hasattr(os, "fork") else 0
if child == 0 and hasattr(os, "fork"):
    os._exit(0 if fitters[2].fit_batch(frames).planes.tobytes() == wanted else 1)
status = os.waitpid(child, 0)[1] if child else 0
print(len(wrong), status)
"""


def test_eight_threads_at_once_then_a_fork():
    """In a process of its own, which is not this one's to fork."""
    assert printed_by(EIGHT_AT_ONCE, PYTHONWARNINGS="ignore").split() == ["0", "0"]


FORK_WHILE_TABLES_ARE_MADE = """
import os, signal, threading
from dataclasses import replace
import rgbd_planes as rp
from rgbd_planes.camera.lenses import distortion

one = rp.Camera(64, 48, 52.0, 52.0, 31.5, 23.5, (0.01, 0.0, 0.0, 0.0))
other = replace(one, fx=53.0)
rays_of_image = distortion.rays_of_image
begun, go_on = threading.Event(), threading.Event()

def slowly(*arguments):
    begun.set()
    go_on.wait()
    return rays_of_image(*arguments)

distortion.rays_of_image = slowly
thread = threading.Thread(target=lambda: one.tan_x)
thread.start()
begun.wait()
distortion.rays_of_image = rays_of_image
child = os.fork()
if child == 0:
    signal.alarm(60)  # which ends it if it waits for a thread that it does not have
    os._exit(0 if one.tan_x.shape == other.tan_x.shape == (48, 64) else 1)
status = os.waitpid(child, 0)[1]
go_on.set()
thread.join()
print(status, one.tan_x is one.tan_x)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_fork_while_a_thread_makes_the_tables_of_a_camera():
    assert printed_by(FORK_WHILE_TABLES_ARE_MADE, PYTHONWARNINGS="ignore").split() == ["0", "True"]


STATISTICS_WHILE_A_THREAD_WORKS_THEM_OUT = """
import os, signal, threading
import numpy as np
import rgbd_planes as rp
from rgbd_planes.uncertainty import statistics as fit_statistics

camera = rp.Camera(64, 48, 52.0, 52.0, 31.5, 23.5, noise=rp.noise.kinect_v1())
fitter = rp.TileFitter(camera, 8)
one, other = fitter.fit(np.full((48, 64), 1.5)), fitter.fit(np.full((48, 64), 1.6))
settings_of = fit_statistics.settings_of
begun, go_on, seen = threading.Event(), threading.Event(), []

def slowly(camera):
    begun.set()
    go_on.wait()
    return settings_of(camera)

fit_statistics.settings_of = slowly
thread = threading.Thread(target=lambda: seen.append(one.p_value))
thread.start()
begun.wait()
fit_statistics.settings_of = settings_of
signal.alarm(60)  # which ends what waits for a thread that waits, or that it does not have
child = os.fork()
if child == 0:
    signal.alarm(60)
    os._exit(0 if (one.p_value > 0.0).all() and (other.p_value > 0.0).all() else 1)
status = os.waitpid(child, 0)[1]
first = one.p_value, other.p_value
go_on.set()
thread.join()
print(status, first[0] is seen[0] is one.p_value)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_nobody_waits_for_the_statistics_of_another_thread():
    """Neither a forked child nor another thread."""
    assert printed_by(STATISTICS_WHILE_A_THREAD_WORKS_THEM_OUT, PYTHONWARNINGS="ignore").split() == ["0", "True"]


THREADS_IN_THREADS = """
import contextlib, sys, threading
import numpy as np
import rgbd_planes as rp

camera = rp.Camera(64, 48, 52.0, 52.0, 31.5, 23.5, depth_scale=1000.0)
frames = np.random.default_rng(0).integers(1000, 1100, (7, 48, 64)).astype(np.uint16)
alone, two, three = (rp.TileFitter(camera, 8, num_threads=n) for n in (1, 2, 3))
lock = threading.Lock() if sys.argv[2] == "locked" else contextlib.nullcontext()

class Lazy:
    def __len__(self):
        return len(frames)

    def __getitem__(self, i):
        with lock:
            if sys.argv[1] == "fit":
                found = [fitter.fit(frames[i]) for fitter in (two, three)]
            elif sys.argv[1] == "stream":
                found = [tiles for fitter in (two, three) for tiles in fitter.fit_stream([frames[i]] * 4)]
            else:
                found = [fitter.fit_batch(frames[i : i + 1].repeat(3, axis=0))[1] for fitter in (two, three)]
        assert all(np.array_equal(tiles.planes, alone.fit(frames[i]).planes) for tiles in found)
        return frames[i]

wanted = alone.fit_batch(frames).planes
print([np.array_equal(fitter.fit_batch(Lazy()).planes, wanted) for fitter in (two, three)])
"""


@pytest.mark.parametrize("inner", ["fit", "stream", "batch"])
@pytest.mark.parametrize("lock", ["free", "locked"])
def test_frames_that_threads_make_may_be_made_with_threads(inner, lock):
    """In a process of its own, since threads that wait for each other cannot be ended."""
    assert printed_by(THREADS_IN_THREADS, inner, lock).strip() == "[True, True]"


AFTER_THE_MAIN_THREAD = """
import sys, threading
import numpy as np
import rgbd_planes as rp

camera = rp.Camera(64, 48, 52.0, 52.0, 31.5, 23.5, depth_scale=1000.0)
frames = np.random.default_rng(0).integers(1000, 1100, (4, 48, 64)).astype(np.uint16)
wanted = rp.TileFitter(camera, 8).fit_batch(frames).planes
fitter = rp.TileFitter(camera, 8, num_threads=3)
if sys.argv[1] == "used":
    fitter.fit(frames[0])

def go_on():
    threading.main_thread().join()
    found = [np.stack([fitter.fit(frame).planes for frame in frames])]
    found.append(fitter.fit_batch(frames).planes)
    found.append(np.stack([tiles.planes for tiles in fitter.fit_stream(frames)]))
    print([np.array_equal(planes, wanted) for planes in found])

threading.Thread(target=go_on).start()
"""


@pytest.mark.parametrize("threads", ["new", "used"])
def test_threads_go_on_when_the_main_thread_has_ended(threads):
    """As where a program starts its loop in a thread, and that is all that it does."""
    done = subprocess.run(
        [sys.executable, "-c", AFTER_THE_MAIN_THREAD, threads], capture_output=True, text=True, timeout=300
    )
    assert done.stdout == "[True, True, True]\n", done.stderr


@pytest.mark.parametrize("num_threads", [None, 1, 2, 5])
def test_stream_gives_what_fit_gives(num_threads, rng):
    camera = make_camera()
    frames = [as_dtype(make_depth(camera, rng), "uint16") for _ in range(7)]
    fitter = rp.TileFitter(camera, 8, num_threads=num_threads)
    streamed = list(fitter.fit_stream(iter(frames)))
    assert len(streamed) == len(frames)
    for planes, frame in zip(streamed, frames, strict=True):
        for name in ARRAYS:
            np.testing.assert_array_equal(getattr(planes, name), getattr(fitter.fit(frame), name))
    assert list(fitter.fit_stream(())) == []


@pytest.mark.parametrize("num_threads", [None, 3])
def test_stream_without_end_reads_no_further_ahead_than_its_threads(num_threads):
    camera = make_camera()
    read = []

    def endless():
        for i in itertools.count():
            read.append(i)
            yield np.full(camera.shape, 1000 + i % 100, np.uint16)

    stream = rp.TileFitter(camera, 16, num_threads=num_threads).fit_stream(endless())
    for i in range(20):
        next(stream)
        assert len(read) == i + (num_threads or 1)  # no fewer: as many are fitted at a time


def test_stream_of_one_reused_buffer(rng):
    """Without threads of their own the planes of a frame are there before the next is asked for."""
    camera = make_camera()
    frames = [as_dtype(make_depth(camera, rng), "uint16") for _ in range(4)]
    buffer = np.empty(camera.shape, np.uint16)

    def one_buffer():
        for frame in frames:
            buffer[:] = frame
            yield buffer

    fitter = rp.TileFitter(camera)
    for planes, frame in zip(fitter.fit_stream(one_buffer()), frames, strict=True):
        np.testing.assert_array_equal(planes.planes, fitter.fit(frame).planes)


@pytest.mark.parametrize("num_threads", [None, 1, 2, 4, 8])
def test_a_source_that_fails_does_so_after_the_planes_of_its_frames(num_threads, rng):
    camera = make_camera()
    frames = [make_depth(camera, rng) for _ in range(5)]

    def unplugged():
        yield from frames
        raise OSError("unplugged")

    fitter = rp.TileFitter(camera, 16, num_threads=num_threads)
    stream = fitter.fit_stream(unplugged())
    for frame in frames:
        np.testing.assert_array_equal(next(stream).planes, fitter.fit(frame).planes)
    with pytest.raises(OSError, match="unplugged"):
        next(stream)
    assert list(stream) == []


@pytest.mark.parametrize("num_threads", [1, 3])
def test_a_stream_keeps_no_frame_beyond_its_end(num_threads):
    camera = make_camera()
    frame = np.full(camera.shape, 1000, np.uint16)
    kept = weakref.ref(frame)
    gc.disable()
    try:
        assert len(list(rp.TileFitter(camera, num_threads=num_threads).fit_stream([frame] * 4))) == 4
        del frame
        until = time.monotonic() + 10.0
        while kept() is not None and time.monotonic() < until:  # threads are done with it soon
            time.sleep(0.001)
    finally:
        gc.enable()
    assert kept() is None


def test_bad_frame_in_a_stream_or_batch_raises_in_the_caller():
    camera = make_camera()
    good, bad = np.ones(camera.shape), np.ones((3, 3))
    for num_threads in (1, 2):
        fitter = rp.TileFitter(camera, num_threads=num_threads)
        with pytest.raises(ValueError, match=r"^frame 1: expected a depth frame of shape"):
            list(fitter.fit_stream([good, bad]))
        with pytest.raises(ValueError, match=r"^frame 2: expected a depth frame of shape"):
            fitter.fit_batch([good, good, bad])


@pytest.mark.parametrize("fails", [0, 1, 2])
@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_ranges_have_all_ended_when_one_fails(fails, error):
    """Before the caller may read, or give back, what they write to."""
    begun, ended = threading.Barrier(3), []

    def work(start, stop):
        begun.wait()
        if start == fails:
            raise error
        time.sleep(0.1 * (2 - start))
        ended.append(start)

    with pytest.raises(error):
        threads.run_in_ranges(work, 3, 3)
    assert sorted(ended) == sorted({0, 1, 2} - {fails})


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="no signal to a thread on this system")
def test_ranges_have_all_ended_when_waiting_for_them_is_interrupted():
    begun, ended = threading.Barrier(3), []

    def work(start, stop):
        begun.wait()
        if start == 1:
            time.sleep(0.2)  # until the caller waits for this range
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
            time.sleep(0.2)
        ended.append(start)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background of a shell
    try:
        with pytest.raises(KeyboardInterrupt):
            threads.run_in_ranges(work, 3, 3)
    finally:
        signal.signal(signal.SIGINT, before)
    assert sorted(ended) == [0, 1, 2]


@pytest.mark.parametrize("many", ["fit_batch", "fit_stream"])
def test_threads_warn_at_the_line_that_called(many):
    """Of each frame, also of those that other threads have read."""
    fitter = rp.TileFitter(make_camera(), num_threads=3)
    frames = [np.full((48, 64), 60_000.0), np.full((48, 64), 0.001), np.full((48, 64), 1.0)]
    with pytest.warns(UserWarning, match="of this frame is") as caught:
        assert all(tiles.fitted.all() for tiles in getattr(fitter, many)(frames))
    assert {warning.filename for warning in caught} == {__file__}
    assert len({str(warning.message) for warning in caught}) == 2


def test_work_that_fails_in_a_thread_has_warned_before():
    taken = threading.Event()

    def work():
        taken.set()
        warn_caller("this frame is odd")
        raise ValueError("and cannot be fitted")

    result = threads.submit(work, 1)
    assert taken.wait(60)
    with pytest.warns(UserWarning, match="odd") as caught, pytest.raises(ValueError, match="cannot be fitted"):
        result()
    assert [warning.filename for warning in caught] == [__file__]


@pytest.mark.parametrize("num_threads", [1, 2, 3, 5])
def test_a_batch_of_many_frames_reads_each_once(num_threads, rng):
    """A frame may be a file; and what is to be warned of is warned of once."""
    camera = make_camera()
    frames = 8 * [as_dtype(make_depth(camera, rng), "uint16") for _ in range(5)]
    read = []

    class Files:
        def __len__(self):
            return len(frames)

        def __getitem__(self, i):
            read.append(i)
            return frames[i]

    fitter = rp.TileFitter(camera, 8, num_threads=num_threads)
    np.testing.assert_array_equal(fitter.fit_batch(Files()).planes, fitter.fit_batch(frames).planes)
    assert sorted(read) == list(range(40))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("distortion", [(), (0.26, -0.95, -0.005, 0.003, 1.16)], ids=["pinhole", "distorted"])
@pytest.mark.parametrize("tile", [5, (9, 12), (48, 64)])
def test_batch_bits_do_not_depend_on_threads_or_neighbours(method, distortion, tile, rng):
    """Threads end in the middle of frames, and so of the blocks of tiles that are solved side by side."""
    camera = make_camera(distortion)
    frames = [as_dtype(make_holes(make_depth(camera, rng), "tiles", rng), "uint16") for _ in range(3)]
    wanted = rp.TileFitter(camera, tile, method, num_threads=1).fit_batch(frames)
    for num_threads in (2, 7):
        batch = rp.TileFitter(camera, tile, method, num_threads=num_threads).fit_batch(np.stack(frames))
        for name in (*ARRAYS, "_moments", "_reference"):
            np.testing.assert_array_equal(getattr(batch, name), getattr(wanted, name))


STACKS = {
    "uint16": ({}, lambda raw: raw),
    "of the other byte order": ({}, lambda raw: raw.astype(">u2")),
    "of 8 bits": ({"depth_scale": 40.0}, lambda raw: (raw // 25).astype(np.uint8)),
    "int32": ({}, lambda raw: raw.astype(np.int32)),
    "float32": ({}, lambda raw: (raw / 1000).astype(np.float32)),
    "float64": ({}, lambda raw: raw / 1000),
    "strided": ({}, lambda raw: raw.repeat(2, axis=2)[:, :, ::2]),
    "backwards": ({}, lambda raw: raw[::-1]),
    "disparity": ({"depth_scale": None, "disparity": (1e-3, 0.01)}, lambda raw: np.maximum(raw, 1)),
    "invalid values": ({"invalid_values": (1500.0, 65535.0)}, lambda raw: raw),
    "a lens": ({"distortion": (0.05, -0.02, 0.0, 0.0, 0.0)}, lambda raw: raw),
    "a fisheye": ({"distortion": (0.9, 0.1, 0.0, 0.0), "distortion_model": "fisheye"}, lambda raw: raw),
    # Of the last one all codes count but one, which is in some frames only: those need a wider type than the others.
    "codes": (
        {"depth_scale": None, "disparity": (1e-3, 0.01), "invalid_values": (1500.0,)},
        lambda raw: np.maximum(raw, 1),
    ),
}


@pytest.mark.parametrize("num_threads", [1, 3])
@pytest.mark.parametrize("kind", STACKS)
def test_frames_of_one_array_are_fitted_as_one_by_one(kind, num_threads, rng, monkeypatch):
    """Which is done in one call for several, here five: the last ones are fewer."""
    monkeypatch.setattr(grid_fitter, "_PIXELS_AT_ONCE", 5 * 48 * 64 + 100)
    options, convert = STACKS[kind]
    camera = make_camera(noise=rp.noise.time_of_flight(0.005), **options)
    raw = np.stack([as_dtype(make_holes(make_depth(camera, rng), "some", rng), "uint16") for _ in range(37)])
    raw[raw == 1500] = 1501
    raw[7, 20:25, 30:33] = 1500
    frames = convert(raw)
    fitter = rp.TileFitter(camera, (7, 9), num_threads=num_threads)
    found = fitter.fit_batch(frames)
    for i, frame in enumerate(frames):
        wanted = fitter.fit(frame)
        for name in (*ARRAYS, "p_value", "alpha_covariance"):
            np.testing.assert_array_equal(getattr(found, name)[i], getattr(wanted, name), err_msg=name)
    assert found.fitted.mean() > 0.2
    again = fitter.fit_batch(frames[::-1], out=found)
    np.testing.assert_array_equal(again.p_value, fitter.fit_batch(list(frames[::-1])).p_value)


@pytest.mark.parametrize("kind", ["millimetres", "the largest number", "nothing"])
def test_one_frame_of_an_array_is_warned_of(kind, recwarn, rng):
    camera = make_camera(depth_range=None)
    metres = np.stack([make_depth(camera, rng)] * 20)
    if kind == "millimetres":
        metres[18] *= 1000.0
    elif kind == "the largest number":
        metres[18, :, ::4] = 65.535
    rp.TileFitter(camera).fit_batch(metres)
    messages = [str(warning.message) for warning in recwarn]
    wanted = {"millimetres": ["millimetres?"], "the largest number": ["many pixels are 65.535"], "nothing": []}[kind]
    assert len(messages) == len(wanted)
    assert all(part in message for part, message in zip(wanted, messages, strict=True))


def test_an_array_of_frames_is_refused_as_one_frame_is():
    fitter = rp.TileFitter(make_camera())
    with pytest.raises(ValueError, match="expected a depth frame of shape"):
        fitter.fit_batch(np.ones((20, 48, 63)))
    with pytest.raises(TypeError, match="integers or floats, got dtype complex128"):
        fitter.fit_batch(np.ones((20, 48, 64), complex))
    with pytest.raises(TypeError, match="masked"):
        fitter.fit_batch(np.ma.masked_equal(np.ones((20, 48, 64)), 0.0))
    with pytest.raises(ValueError, match="depth_scale"):
        rp.TileFitter(make_camera(depth_scale=None)).fit_batch(np.ones((20, 48, 64), np.uint16))


def test_warmup_leaves_nothing_to_compile(caplog):
    rp.warmup()
    rp.warmup(make_camera((0.01, 0.0, 0.0, 0.0, 0.0)), ["range_explicit", "standard_pca"], "uint16")
    rp.warmup(rp.Camera(8, 8, 8.0, 8.0, 4.0, 4.0, disparity=(-0.01, 3.0)), dtypes="uint16")
    with_noise = make_camera(noise=rp.noise.kinect_v1())
    rp.warmup(make_camera(), dtypes=np.float32)  # its noise may be known later
    with pytest.raises(ValueError, match="method must be one of"):
        rp.warmup(methods="pca")
    from rgbd_planes.kernels.fits import tiles as tile_kernels
    from rgbd_planes.kernels.statistics.tiles.assess import assess

    kernels = tile_kernels.fit_tiles, assess
    compiled = [len(kernel.signatures) for kernel in kernels]
    assert compiled[0] >= 3
    assert compiled[1] >= 1
    rp.fit_tiles(np.ones((48, 64), np.float32), with_noise)
    assert [len(kernel.signatures) for kernel in kernels] == compiled


@pytest.mark.parametrize("cores", [1, 3, 20])
def test_no_more_threads_than_the_process_has_cores(cores, monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(5, 5 + cores)), raising=False)
    assert threads.choose_num_threads(None, 10**9) == cores
    assert threads.choose_num_threads(None, 2 * threads.PIXELS_PER_THREAD) == min(2, cores)
    assert threads.choose_num_threads(7, 1) == 7
    assert batch._Threads(None, rp.FitSettings()).slots == min(cores, 8)
    assert batch._Threads(None, rp.FitSettings(segments=True)).slots == min(cores, 16)
    assert batch._Threads(20, rp.FitSettings()).slots == 20
    monkeypatch.delattr(os, "sched_getaffinity")  # as on a Mac
    assert threads.choose_num_threads(None, 10**9) == 64


@pytest.mark.parametrize("depth_scale", [None, 1.0, 100.0, 5000.0])
def test_warmup_warns_of_nothing(depth_scale, recwarn):
    """What it fits is no frame of the caller's."""
    dtypes = "uint8", "int16", "uint16", "float16", "float32"
    camera = rp.Camera(8, 8, 8.0, 8.0, 4.0, 4.0, depth_scale=depth_scale, noise=rp.noise.kinect_v1())
    rp.warmup(camera, dtypes=dtypes)
    rp.warmup(camera, dtypes="uint8", segment=True)
    assert not recwarn.list


def test_wide_and_tall_tiles_are_counted_in_parts(rng):
    """Tiles wider than a strip of columns and taller than a band of rows, against the same tiles pixel by pixel."""
    camera = rp.Camera(1400, 130, 900.0, 900.0, 700.0, 60.0, depth_scale=1000.0)
    depth = as_dtype(1.0 / (0.4 + 0.1 * camera.tan_x - 0.2 * camera.tan_y), "uint16")
    depth[rng.random(depth.shape) < 0.3] = 0
    for method in METHODS:
        for tile in ((130, 1400), (65, 700), (33, 649)):
            direct = rp.fit_tiles(depth, camera, tile, method)
            naive = rp.fit_tiles(depth, camera, tile, method, implementation="naive")
            np.testing.assert_array_equal(direct.valid_count, naive.valid_count)
            np.testing.assert_allclose(direct.planes, naive.planes, rtol=1e-6, atol=1e-9)


def test_threads_that_call_first_all_at_once():
    """The pool of threads is made once, also by threads that race for it."""
    camera = make_camera()
    depth = np.full(camera.shape, 1.5)
    fitter = rp.TileFitter(camera, num_threads=4)
    results = []
    threads = [threading.Thread(target=lambda: results.append(fitter.fit(depth).planes)) for _ in range(16)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 16
    assert all(np.array_equal(result, results[0]) for result in results)


def test_work_for_which_no_thread_could_be_started_is_not_done_later(monkeypatch):
    """When the arrays that it writes to are the caller's again."""
    threads._pool.cache_clear()
    done = []

    def fail(thread):
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", fail)
        threads.run_in_ranges(lambda start, stop: done.append((start, stop)), 6, 3)
    assert sorted(done) == [(0, 2), (2, 4), (4, 6)]
    threads.run_in_ranges(lambda start, stop: time.sleep(1e-3), 6, 3)
    threads._pool.cache_clear()
    time.sleep(0.05)  # for what a thread would do after that
    assert len(done) == 3


def test_threads_that_could_not_be_started_are_tried_again(monkeypatch):
    threads._pool.cache_clear()

    def fail(thread):
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", fail)
        threads.run_in_ranges(lambda start, stop: None, 3, 3)
    together = threading.Barrier(3, timeout=60)
    threads.run_in_ranges(lambda start, stop: together.wait(), 3, 3)


def test_there_are_no_ranges_of_nothing():
    for count, expected in ((3, [(0, 1), (1, 2), (2, 3)]), (1, [(0, 1)]), (0, [(0, 0)])):
        done = []
        threads.run_in_ranges(lambda start, stop, done=done: done.append((start, stop)), count, 7)
        assert sorted(done) == expected


INTERRUPTED = """
import signal, sys
from rgbd_planes._core import threads

signal.alarm(120)  # which ends it if it hangs

def interrupt_after(events):
    def trace(frame, event, argument):
        nonlocal events
        events -= 1
        if events < 0 and "rgbd_planes" in frame.f_code.co_filename + frame.f_back.f_code.co_filename:
            raise KeyboardInterrupt
        return trace
    sys.settrace(trace)

rounds, is_interrupted = 0, True
while is_interrupted:
    interrupt_after(rounds)
    try:
        threads.run_in_ranges(lambda start, stop: None, 6, 3)
        is_interrupted = False
    except KeyboardInterrupt:
        pass
    sys.settrace(None)
    done = []
    threads.run_in_ranges(lambda start, stop: done.append((start, stop)), 6, 3)
    assert sorted(done) == [(0, 2), (2, 4), (4, 6)], (rounds, done)
    rounds += 1
print(rounds)
"""


@pytest.mark.skipif(not hasattr(signal, "alarm"), reason="no alarm on this system")
def test_an_interrupt_anywhere_leaves_threads_that_work():
    assert int(printed_by(INTERRUPTED)) > 50


def test_threads_of_numbers_that_were_tried_once_end():
    threads._pool.cache_clear()
    gc.collect()
    before = set(threading.enumerate())
    for number in range(2, 14):
        threads.run_in_ranges(lambda start, stop: time.sleep(1e-3), number, number)
    kept = threads._pool.cache_info().maxsize
    for _ in range(500):
        left = [thread for thread in threading.enumerate() if thread not in before]
        if len(left) <= 12 * kept:  # of the last pools; of all there are 78
            break
        time.sleep(0.01)
    assert len(left) <= 12 * kept
