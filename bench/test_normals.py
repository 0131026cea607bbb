"""Normals of a frame: speed and accuracy beside OpenCV's RgbdNormals, one thread each.

    pytest bench/test_normals.py            times by pytest-benchmark, accuracy in extra_info
    python -m bench.peers                   one table: speed ratios of interleaved runs, and accuracy

OpenCV 5 is used when it is installed (opencv-python-headless). Its methods get the point cloud, ready made; their
results are turned towards the camera before they are compared with the truth, and written to arrays that are there
already.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

import rgbd_planes as rp
from rgbd_planes.evaluation import scenes

try:
    import cv2
except ImportError:
    cv2 = None
OPENCV = ("FALS", "LINEMOD", "SRI", "CROSS_PRODUCT") if cv2 is not None and hasattr(cv2, "RgbdNormals") else ()
WINDOWS = (7, 3, 15, 31)
OURS = tuple(f"{name} {w}" for w in WINDOWS for name in ("normals", "avoid_edges"))
METHODS = (*OURS, *(f"OpenCV {name}" for name in OPENCV))
HOLES = (0.0, 0.05)


class Case(NamedTuple):
    """A frame, what is true of it, and where the truth changes within three pixels."""

    camera: rp.Camera
    depth: Any
    truth: Any
    near_edge: Any


@cache
def case(holes: float, width: int = 640, height: int = 480, noise: float = rp.noise.KINECT_V1) -> Case:
    """The rendered room with independent noise of a Kinect's size."""
    focal = 525.0 * width / 640
    camera = rp.Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, depth_scale=1000.0)
    rendering = scenes.room().render(camera)
    labels = rendering.labels
    around = sliding_window_view(np.pad(labels, 3, mode="edge"), (7, 7))
    near_edge = (around != labels[..., None, None]).any(axis=(2, 3))
    depth = rendering.measure(holes=holes, noise=noise, seed=1)
    return Case(camera, depth, rendering.planes[labels - 1, :3], near_edge)


def prepare(method: str, frame: Case) -> Callable[[], Any]:
    """A function of no arguments that computes the normals once, caches filled."""
    camera = frame.camera
    name, _, option = method.partition(" ")
    if name != "OpenCV":
        avoid = name == "avoid_edges"
        return lambda: rp.normals(frame.depth, camera, int(option), avoid_edges=avoid, num_threads=1)
    cv2.setNumThreads(1)
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], np.float32)
    kind = getattr(cv2, f"RgbdNormals_RGBD_NORMALS_METHOD_{option}")
    computer = cv2.RgbdNormals.create(camera.height, camera.width, cv2.CV_32F, matrix, 7, 50.0, kind)
    computer.cache()
    source = cv2.depthTo3d(frame.depth, matrix)
    result = computer.apply(source)
    return lambda: computer.apply(source, result)


def towards_camera(normals: Any, camera: rp.Camera) -> Any:
    """The same normals with n·m < 0: not every method of OpenCV's sees to it."""
    rays = np.dstack([camera.tan_x, camera.tan_y, np.ones(camera.shape)])
    normals = normals[..., :3]
    return np.where((normals * rays).sum(axis=-1, keepdims=True) > 0.0, -normals, normals)


def accuracy(normals: Any, frame: Case) -> dict[str, float]:
    """Median angle in degrees to the truth over valid pixels: all, away from edges, near them; and shares."""
    chord = np.linalg.norm(towards_camera(normals, frame.camera) - frame.truth, axis=-1)
    angle = np.degrees(2.0 * np.arcsin(np.clip(0.5 * chord, 0.0, 1.0)))
    valid = frame.depth > 0
    there = valid & np.isfinite(angle)
    near = there & frame.near_edge
    return {
        "median_deg": float(np.median(angle[there])),
        "inside_deg": float(np.median(angle[there & ~frame.near_edge])),
        "near_edge_deg": float(np.median(angle[near])),
        "p90_deg": float(np.percentile(angle[there], 90)),
        "share_of_valid": float(there.sum() / valid.sum()),
        "share_of_missing": float(np.isfinite(angle[~valid]).mean()) if (~valid).any() else 0.0,
    }


@pytest.mark.parametrize("holes", HOLES)
@pytest.mark.parametrize("method", METHODS)
def test_normals(benchmark: Any, method: str, holes: float) -> None:
    """Time of one frame of 640 x 480, uint16."""
    frame = case(holes)
    compute = prepare(method, frame)
    benchmark.group = f"normals 640 x 480, {holes:.0%} missing"
    benchmark.extra_info.update(accuracy(compute(), frame))
    benchmark(compute)
