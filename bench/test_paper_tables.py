"""The paper's "Integral Image Implementation": building the tables, planes from them, and both together."""

import time
from typing import Any

import pytest

from bench.methods import TABLES, Fit, windows

pytestmark = pytest.mark.benchmark(timer=time.thread_time, max_time=0.3, min_rounds=5)


@pytest.mark.parametrize("method", TABLES)
@pytest.mark.benchmark(group="build the summed-area tables of a frame")
def test_tables(benchmark: Any, method: str) -> None:
    benchmark(Fit(method, windows(1)).build)


@pytest.mark.parametrize("method", TABLES)
@pytest.mark.benchmark(group="1000 planes of 50x50 pixels from built tables")
def test_planes(benchmark: Any, method: str) -> None:
    fit = Fit(method, windows(1000))
    fit.build()
    benchmark(fit.planes)


@pytest.mark.parametrize("side", [10, 100, 400])
@pytest.mark.parametrize("method", TABLES)
def test_integral_times_vs_points(benchmark: Any, method: str, side: int) -> None:
    benchmark.group = f"tables and one plane of {side * side} points"
    benchmark(Fit(method, windows(1, side)).frame)
