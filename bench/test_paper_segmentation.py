"""The paper's "Planar Segmentation Application": one frame, tables and planes, k-means apart."""

import time
from typing import Any

import pytest
from numpy.typing import NDArray

from bench.methods import TABLES
from bench.sequence import sequence
from rgbd_planes import Camera, segment_quadtree
from rgbd_planes.segmentation.quadtree import QuadtreeFitter

pytestmark = pytest.mark.benchmark(timer=time.thread_time, max_time=0.5, min_rounds=5)


@pytest.fixture(scope="module")
def frame_and_camera() -> tuple[NDArray[Any], Camera]:
    frames, camera, _ = sequence(1)
    return frames[0], camera


@pytest.mark.parametrize("implementation", ["integral", "direct"])
@pytest.mark.parametrize("method", TABLES)
@pytest.mark.benchmark(group="segment a frame: tables and planes")
def test_segmentation(
    benchmark: Any, frame_and_camera: tuple[NDArray[Any], Camera], method: str, implementation: str
) -> None:
    frame, camera = frame_and_camera
    fitter = QuadtreeFitter(camera, method=method, max_error=0.02, implementation=implementation)
    benchmark(fitter.fit, frame)


@pytest.mark.benchmark(group="segment a frame: with k-means")
def test_with_clusters(benchmark: Any, frame_and_camera: tuple[NDArray[Any], Camera]) -> None:
    benchmark(segment_quadtree, *frame_and_camera)
