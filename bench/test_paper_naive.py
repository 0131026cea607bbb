"""The paper's naive implementation, and planes of one frame by both implementations."""

import time
from typing import Any

import pytest

from bench.methods import TABLES, Fit, windows

pytestmark = pytest.mark.benchmark(timer=time.thread_time, max_time=0.3, min_rounds=5)


@pytest.mark.parametrize("disparity", [False, True], ids=["depth", "disparity"])
@pytest.mark.parametrize("side", [10, 50, 100])
@pytest.mark.parametrize("method", TABLES)
def test_naive_times_vs_points(benchmark: Any, method: str, side: int, disparity: bool) -> None:
    benchmark.group = f"20 planes of {side * side} points, naive"
    benchmark(Fit(method, windows(20, side), "naive", disparity).planes)


@pytest.mark.parametrize("implementation", ["integral", "naive"])
@pytest.mark.parametrize("count", [1, 200, 1000])
@pytest.mark.parametrize("method", TABLES)
def test_runtime_comparison(benchmark: Any, method: str, count: int, implementation: str) -> None:
    benchmark.group = f"{count} planes of 50x50 pixels of one frame"
    benchmark(Fit(method, windows(count), implementation).frame)
