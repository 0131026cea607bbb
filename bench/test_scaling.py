"""How the cost of a fit grows with the frame, the tile and the threads: ``pytest bench/test_scaling.py``."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import rgbd_planes as rp
from bench.fitting import case, fit
from rgbd_planes._core.threads import num_cores

SIZES = ((320, 240), (640, 480), (1280, 720), (1920, 1080), (3840, 2160))
TILES = (4, 8, 16, 20, 32, 64)
THREADS = [2**k for k in range(num_cores().bit_length())]


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
def test_frame_size(benchmark: Any, size: tuple[int, int]) -> None:
    benchmark.group = "tiles of 20, range_explicit"
    benchmark.extra_info["pixels"] = size[0] * size[1]
    benchmark(fit(case(*size), 20))


@pytest.mark.parametrize("tile", TILES)
def test_tile_size(benchmark: Any, tile: int) -> None:
    benchmark.group = "640 x 480, range_explicit"
    benchmark(fit(case(), tile))


@pytest.mark.parametrize("threads", THREADS)
@pytest.mark.parametrize("container", [np.stack, list], ids=["array", "list"])
def test_batch(benchmark: Any, container: Callable[[Any], Any], threads: int) -> None:
    frames = container([case().depth] * 32 * THREADS[-1])
    benchmark.group = f"{len(frames)} frames of 640 x 480, tiles of 20, range_explicit"
    fitter = rp.TileFitter(case().camera, 20, num_threads=threads)
    out = fitter.fit_batch(frames)
    benchmark(fitter.fit_batch, frames, out=out)
