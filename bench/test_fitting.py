"""Times of tile fitting, one thread: ``pytest bench/test_fitting.py``. Accuracy is in extra_info."""

from typing import Any

import numpy as np
import pytest

import rgbd_planes as rp
from bench.fitting import case, fit, floor_of, median_angle, numpy_fit
from rgbd_planes.fitting.methods import METHODS

LENS = (0.26, -0.95, -0.005, 0.003, 1.16)
TILES = (10, 20)


@pytest.mark.parametrize("tile", TILES)
@pytest.mark.parametrize("sharing", [False, True], ids=["division", "shared"])
def test_floor(benchmark: Any, tile: int, sharing: bool) -> None:
    benchmark.group = f"640 x 480, tiles of {tile}"
    benchmark(floor_of(case(), tile, sharing))


@pytest.mark.parametrize("tile", TILES)
@pytest.mark.parametrize("method", METHODS)
def test_fit(benchmark: Any, method: str, tile: int) -> None:
    benchmark.group = f"640 x 480, tiles of {tile}"
    run = fit(case(), tile, method)
    benchmark.extra_info["median_deg"] = median_angle(run().planes, case(), tile)
    benchmark(run)


@pytest.mark.parametrize("tile", TILES)
@pytest.mark.parametrize("form", ["pca", "z", "1/z"])
def test_numpy(benchmark: Any, form: str, tile: int) -> None:
    benchmark.group = f"640 x 480, tiles of {tile}"
    frame = case()
    run = numpy_fit(frame.depth, frame.camera, tile, form)
    benchmark.extra_info["median_deg"] = median_angle(run(), frame, tile)
    benchmark(run)


@pytest.mark.parametrize("method", METHODS)
def test_fit_with_lens_distortion(benchmark: Any, method: str) -> None:
    benchmark.group = "640 x 480, tiles of 20, distorted"
    benchmark(fit(case(distortion=LENS), 20, method))


@pytest.mark.parametrize("holes", [0.0, 0.05, 0.5])
@pytest.mark.parametrize("dtype", ["uint16", "float32", "float64"])
def test_fit_of_any_dtype(benchmark: Any, dtype: str, holes: float) -> None:
    benchmark.group = "640 x 480, tiles of 20, range_explicit"
    frame = case(holes=holes)
    depth = frame.depth if dtype == "uint16" else frame.depth.astype(dtype) / np.dtype(dtype).type(1000)
    benchmark(fit(frame._replace(depth=depth), 20))


def test_fit_tiles_without_a_fitter(benchmark: Any) -> None:
    benchmark.group = "640 x 480, tiles of 20"
    frame = case()
    benchmark(lambda: rp.fit_tiles(frame.depth, frame.camera, 20, num_threads=1))
