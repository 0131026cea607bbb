"""Compile the kernels of a segmentation side by side, in processes, where they are not on disk yet.

Numba compiles in one thread at a time. Each process compiles a share and saves it, and this one loads the rest.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import Any

import numba
import numpy as np
from numba import config

from rgbd_planes._core import compile_notice
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.depth_frame import DepthFrame, as_depth_frame
from rgbd_planes.kernels._jit import kernel as jit
from rgbd_planes.kernels.segmentation.assign.assign_pixels import assign_pixels
from rgbd_planes.kernels.segmentation.assign.spread import move_on, spread_out
from rgbd_planes.kernels.segmentation.blocks.pyramid import read_frame
from rgbd_planes.kernels.segmentation.blocks.quadtree import join_blocks
from rgbd_planes.kernels.segmentation.components.components import judge_parts, measure_parts
from rgbd_planes.kernels.segmentation.components.labels import leave_out, settle_strays, write_labels
from rgbd_planes.kernels.segmentation.components.occlusion_gaps import join_across_gaps
from rgbd_planes.kernels.segmentation.components.rim_outliers import release_rims
from rgbd_planes.kernels.segmentation.components.runs import connect
from rgbd_planes.kernels.segmentation.curved.curved import find_curved
from rgbd_planes.kernels.segmentation.curved.surfaces import number_surfaces
from rgbd_planes.kernels.segmentation.evidence.evidence import renumber_labels, weigh_planes
from rgbd_planes.kernels.segmentation.merge.contacts import keep_pairs_inside, neighbours, rename_pairs
from rgbd_planes.kernels.segmentation.merge.merge import merge, renumber_regions
from rgbd_planes.kernels.segmentation.merge.seed_growing import grow_together
from rgbd_planes.kernels.segmentation.merge.split_faces import find_doubtful, keep_faces, keep_turned, take_parts
from rgbd_planes.kernels.segmentation.model.planes import describe_planes, fit_regions
from rgbd_planes.kernels.segmentation.model.records import (
    Found,
    Labels,
    Modelled,
    Noise,
    Parts,
    Planes,
    Reasons,
    Regions,
    Rules,
    Shares,
    View,
    plain,
)
from rgbd_planes.kernels.segmentation.noise.correlation import shared_by_planes
from rgbd_planes.kernels.segmentation.noise.estimate import nearest_surface
from rgbd_planes.kernels.segmentation.noise.frame_noise import ENTRIES, find_noise
from rgbd_planes.kernels.segmentation.refit.interior import fit_interior
from rgbd_planes.segmentation.frame_noise import correlation_table
from rgbd_planes.segmentation.workspace import Workspace, rays_of

MOST_PROCESSES = 4
START = 1.5
"""Seconds that a process takes to start, on the machine of the `Call`s."""
_ready: set[tuple[Any, ...]] = set()
_lock = threading.Lock()
if hasattr(os, "register_at_fork"):  # a fork waits for a thread that compiles: see `compiler_pauses`
    os.register_at_fork(before=_lock.acquire, after_in_parent=_lock.release, after_in_child=_lock.release)

Call = tuple[float, Any, tuple[Any, ...]]
"""Seconds that it took to compile on one machine, a kernel, and its arguments."""


def compile_for(frame: DepthFrame) -> None:
    """Compile what a frame needs, unless that is done; with one processor it is left to the first calls.

    Without a place on disk, or where Python is part of another program, there are no processes.
    """
    kind = frame.raw.dtype.str, frame.is_disparity
    if kind in _ready:
        return
    with _lock:
        if kind not in _ready:
            _compile(*kind)
            _ready.add(kind)


def _calls(dtype: str, is_disparity: bool) -> list[Call]:
    """The kernels that every frame needs, and arguments like those that `segment` gives them; most work first."""
    camera = Camera(8, 8, 8.0, 8.0, 3.5, 3.5, depth_scale=1.0)
    if is_disparity:
        camera = Camera(8, 8, 8.0, 8.0, 3.5, 3.5, disparity=(1.0, 0.0))
    rays, work = rays_of(camera._lens), Workspace(camera)
    values = as_depth_frame(np.ones(camera.shape, dtype), camera).values
    noise = Noise(np.ones(ENTRIES + 1), 1.0, 1.0, 1.0, rays.lens, np.ones(3), 1.0)
    block, moments, number = work.region, work.region_moments[:1], np.zeros(1, np.int64)
    shares = Shares(np.empty(0, np.int32), np.empty(0, np.int32), np.empty((0, 10)))
    regions = plain(Regions(block, moments, number, work.owners, shares))
    planes = plain(Planes(np.empty((1, 3)), np.empty(1), np.empty(1), np.empty(1), rays.stretch))
    view = plain(View(work.inverse_depth, rays, work.pyramid, noise, Rules(), work.sensor))
    q, noise, rules, contacts, pyramid = work.inverse_depth, view[3], view[4], plain(work.contacts), work.pyramid
    reasons, alpha = plain(Reasons(*np.zeros(7, np.uint8))), np.empty((1, 3))
    flags, sizes, none = np.empty(1, np.bool_), np.empty(1), np.uint8(0)
    runs, parts = plain(work.runs), plain(Parts(moments, sizes, number, number, number, number))
    found = plain(Found(moments, sizes, moments, alpha, sizes, np.empty((1, 5)), np.empty(2, np.int32)))
    labels = plain(Labels(np.empty(camera.shape, np.int32), np.empty(camera.shape, np.uint8)))
    part, why = np.empty(1, np.int32), np.empty(1, np.uint8)
    modelled = plain(Modelled(np.empty((1, 6)), sizes, sizes, False, False))
    return [
        (9.6, assign_pixels, (view, regions, planes, work.last_region, plain(work.contended), regions[4])),
        (6.1, find_noise, (pyramid, 1.0, np.empty(0), False, 1.0, values[3], is_disparity, correlation_table(),
                           np.empty(3), np.empty(ENTRIES + 1))),
        (5.9, find_curved, (view, regions, planes, contacts, 1, False, flags, sizes)),
        (3.4, weigh_planes, (labels[0], q, view[1], alpha, moments, 1.0, sizes)),
        (3.1, read_frame, (*values, rays, q, pyramid)),
        (2.1, join_across_gaps, (view, runs, 1, part, moments, sizes)),
        (1.9, merge, (moments, contacts, 1, noise, rules, 1.0, number)),
        (1.6, fit_interior, (view, labels, none, found, work.edges)),
        (1.6, connect, (regions, 8, runs)),
        (1.6, join_blocks, (view, block, work.owners.block, work.region_moments)),
        (1.3, release_rims, (view, regions[3], regions[4], moments, sizes, 1, none, *labels)),
        (1.0, find_doubtful, (moments, moments, number, noise, rules, flags, flags, flags)),
        (0.9, neighbours, (block, view[1], contacts)),
        (0.9, describe_planes, (found, noise, 1.0, modelled, 1.0, values[3], is_disparity, np.empty((1, 4)), alpha,
                                np.empty((1, 3, 3)), sizes, part)),
        (0.9, spread_out, (view, regions, planes)),
        (0.8, measure_parts, (view, runs, 1, moments, parts)),
        (0.6, write_labels, (q, runs, part, why, reasons, *labels, work.strays)),
        (0.6, settle_strays, (reasons, 1, *labels, part, work.edges, work.strays, 1)),
        (0.6, move_on, (view, block, work.last_region, alpha)),
        (0.4, grow_together, (block, moments, noise, rules, number)),
        (0.3, renumber_regions, (block, number, moments, 1.0, number)),
        (0.3, judge_parts, (parts, flags, sizes, rules, 1, reasons, why, part, number)),
        (0.2, fit_regions, (moments, noise, planes)),
        (0.2, leave_out, (1, none, part, why, moments, sizes)),
        (0.1, nearest_surface, (pyramid, 1.0)),
        (0.1, rename_pairs, (contacts[0], 1, number)),
    ]  # fmt: skip


def _more_calls(dtype: str) -> list[Call]:
    """The kernels that only some frames need: several faces, what is curved, planes left out, shared noise."""
    calls = {kernel: arguments for _, kernel, arguments in _calls(dtype, False)}
    view, regions, _, contacts, *_ = calls[find_curved]
    labels, pyramid = calls[fit_interior][1], calls[nearest_surface][0]
    moments, _, number, _, _, flags, *_ = calls[find_doubtful]
    return [
        (1.0, keep_turned, (view, regions, flags, flags)),
        (1.0, keep_faces, (view, regions, moments, number, flags, flags)),
        (1.0, shared_by_planes, (1.0, pyramid, labels[0], view[0])),
        (0.2, keep_pairs_inside, (contacts, 1, number, flags)),
        (0.2, take_parts, (number, number, flags, moments, moments)),
        (0.2, renumber_labels, (np.empty(1, np.int32), np.uint8(0), labels)),
        (0.5, number_surfaces, (view, labels[1], np.uint8(0), 1, labels[0])),
    ]


def compile_everything(dtype: str, is_disparity: bool) -> None:
    """Compile what some frames need, too."""
    with _lock:
        _compile(dtype, is_disparity, _more_calls(dtype))


def _compile(dtype: str, is_disparity: bool, more: list[Call] | None = None) -> None:
    calls = _calls(dtype, is_disparity) + (more or [])
    signatures = [(kernel, tuple(map(numba.typeof, arguments))) for _, kernel, arguments in calls]
    seconds = [each for each, _, _ in calls]
    missing = [i for i, (kernel, types) in enumerate(signatures) if not _is_compiled(kernel, types)]
    helpers = _processes(len(missing))
    if helpers < 2:
        return
    with compile_notice.counted(sum(seconds[i] for i in missing)) as count:
        shares: list[list[int]] = [[] for _ in range(helpers)]
        loads = [0.0] + [START] * (helpers - 1)
        for i in missing:  # the largest first
            least = loads.index(min(loads))
            shares[least].append(i)
            loads[least] += seconds[i]
        with _helping(dtype, is_disparity, bool(more), shares[1:], lambda i: count(seconds[i])):
            for i in shares[0]:
                kernel, types = signatures[i]
                kernel.compile(types)
                count(seconds[i])


def _is_compiled(kernel: Any, types: tuple[Any, ...]) -> bool:
    """Whether a kernel is there, or can be loaded."""
    return not hasattr(kernel, "overloads") or types in kernel.overloads or kernel._cache.holds(types)


def _processes(missing: int) -> int:
    """How many processes, this one included, are to compile."""
    name = os.path.basename(sys.executable or "").lower()
    is_alone = getattr(sys, "frozen", False) or not name.startswith("python") or not jit.has_cache
    if is_alone or missing < 4 or config.DISABLE_JIT:  # type: ignore[attr-defined]
        return 1
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(processors, MOST_PROCESSES)


@contextlib.contextmanager
def _helping(
    dtype: str, is_disparity: bool, everything: bool, shares: list[list[int]], compiled: Any
) -> Iterator[None]:
    """Let other processes compile their shares meanwhile, and wait for them in the end; each call is ``compiled``.

    What they can't compile, or if they don't even start, is compiled when it is called.
    """
    path = os.pathsep.join(place for place in sys.path if place)
    environment = os.environ | {"PYTHONPATH": path}
    if config.CACHE_DIR:  # type: ignore[attr-defined]
        environment["NUMBA_CACHE_DIR"] = config.CACHE_DIR  # type: ignore[attr-defined]
    code = f"from {__name__} import compile_share; compile_share({dtype!r}, {is_disparity!r}, {everything!r}, "
    started: list[subprocess.Popen[bytes]] = []
    try:
        with contextlib.suppress(OSError):
            for share in shares:
                command = [sys.executable, "-c", f"{code}{share!r})"]
                nothing = subprocess.DEVNULL
                process = subprocess.Popen(
                    command, env=environment, stdin=nothing, stdout=subprocess.PIPE, stderr=nothing
                )
                started.append(process)
        yield
        for process in started:
            for line in process.stdout or ():
                compiled(int(line))
            process.wait()
    finally:
        for process in started:
            if process.poll() is None:
                process.kill()
                process.wait()
            if process.stdout is not None:
                process.stdout.close()


def compile_share(dtype: str, is_disparity: bool, everything: bool, share: list[int]) -> None:
    """Compile some of the kernels, and print a line for each: what a helping process does."""
    calls = _calls(dtype, is_disparity) + (_more_calls(dtype) if everything else [])
    for i in share:
        _, kernel, arguments = calls[i]
        kernel.compile(tuple(map(numba.typeof, arguments)))
        print(i, flush=True)
