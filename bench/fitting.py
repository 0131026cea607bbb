"""What the benchmarks of tile fitting share: the frame, the ways to fit it, and how times are compared."""

import time
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import rgbd_planes as rp
from bench.floor import floor
from rgbd_planes.evaluation import scenes


class Case(NamedTuple):
    """A frame, its camera, and the plane of each pixel."""

    camera: rp.Camera
    depth: Any
    labels: Any
    planes: Any


@cache
def case(width: int = 640, height: int = 480, holes: float = 0.05, distortion: tuple[float, ...] = ()) -> Case:
    """The rendered room: uint16 millimetres, independent noise of a Kinect's size, missing pixels."""
    focal = 525.0 * width / 640
    camera = rp.Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, distortion, depth_scale=1000.0)
    rendering = scenes.room().render(camera)
    return Case(camera, rendering.measure(holes=holes, seed=1), rendering.labels, rendering.planes)


def fit(frame: Case, tile: int, method: str = "range_explicit", num_threads: int = 1) -> Callable[[], Any]:
    """Our fit from raw depth to planes, residuals and statuses, into arrays that are there."""
    fitter = rp.TileFitter(frame.camera, tile, method, num_threads=num_threads)
    out = fitter.fit(frame.depth)
    return lambda: fitter.fit(frame.depth, out=out)


def floor_of(frame: Case, tile: int, sharing: bool) -> Callable[[], Any]:
    """The floor kernel on the same frame."""
    height, width = frame.depth.shape
    tan_x, tan_y = frame.camera.tan_x_columns, frame.camera.tan_y_rows
    sums, tiles = np.empty((3, width)), np.empty((4, height // tile, width // tile))
    return lambda: floor(frame.depth, tan_x, tan_y, tile, sharing, sums, tiles)


def numpy_fit(image: NDArray[Any], camera: rp.Camera, tile: int, form: str) -> Callable[[], Any]:
    """Vectorised NumPy, large arrays allocated beforehand: einsum for the moments, one batched solve.

    Of the whole tiles of a depth image of integers. ``form`` is "pca" (orthogonal regression in X, Y, Z), "z"
    (Z = aX + bY + c) or "1/z" (1/Z on the ray). Returns planes (R * C, 4), n towards the camera.
    """
    assert camera.depth_scale is not None
    rows, columns = (length // tile for length in image.shape)
    size, unit = tile * tile, 1.0 / camera.depth_scale

    def by_tile(values: NDArray[Any]) -> NDArray[Any]:
        whole = values[: rows * tile, : columns * tile]
        return whole.reshape(rows, tile, columns, tile).swapaxes(1, 2)

    tan_x, tan_y = (np.ascontiguousarray(by_tile(t)).reshape(-1, size) for t in (camera.tan_x, camera.tan_y))
    depth = np.empty((rows, columns, tile, tile))
    z = depth.reshape(-1, size)
    valid = np.empty(z.shape)
    points = np.empty((3, *z.shape))
    ordered = by_tile(image)

    second = np.empty((rows * columns, 3, 3))

    def scatter() -> Any:
        """Mean of the three rows of ``points``; ``second`` becomes their centred scatter matrices."""
        n = np.maximum(valid.sum(axis=1), 1.0)
        totals = points.sum(axis=2)
        mean = totals / n
        for i in range(3):
            for j in range(i + 1):
                second[:, i, j] = np.einsum("tk,tk->t", points[i], points[j]) - totals[i] * mean[j]
                second[:, j, i] = second[:, i, j]
        return mean

    def solve() -> Any:
        np.multiply(ordered, unit, out=depth)
        np.not_equal(z, 0.0, out=valid, casting="unsafe")
        if form == "1/z":
            np.divide(valid, z, out=points[2], where=z > 0)
            points[2][z == 0] = 0.0
            np.multiply(tan_x, valid, out=points[0])
            np.multiply(tan_y, valid, out=points[1])
        else:
            np.multiply(tan_x, z, out=points[0])
            np.multiply(tan_y, z, out=points[1])
            points[2] = z
        mean = scatter()
        if form == "pca":
            normal = np.linalg.eigh(second)[1][:, :, 0]
            d = -np.einsum("ti,it->t", normal, mean)
            return np.column_stack([normal, d]) * np.copysign(1.0, d)[:, None]
        slope = np.linalg.solve(second[:, :2, :2], second[:, :2, 2:])[:, :, 0]
        offset = mean[2] - slope[:, 0] * mean[0] - slope[:, 1] * mean[1]
        if form == "z":
            plane = np.column_stack([slope, np.full(len(slope), -1.0), offset])
        else:
            plane = np.column_stack([-slope, -offset, np.ones(len(slope))])
        plane /= np.linalg.norm(plane[:, :3], axis=1, keepdims=True)
        return plane * np.copysign(1.0, plane[:, 3:])

    return solve


def median_angle(planes: Any, frame: Case, tile: int) -> float:
    """Median angle in degrees between fitted and true normals, over tiles that see one plane."""
    height, width = frame.depth.shape
    labels = frame.labels.reshape(height // tile, tile, width // tile, tile).swapaxes(1, 2).reshape(-1, tile * tile)
    pure = (labels == labels[:, :1]).all(axis=1) & (labels[:, 0] > 0)
    normals = planes.reshape(-1, 4)[pure, :3]
    truth = frame.planes[labels[pure, 0] - 1, :3]
    chord = np.linalg.norm(normals - truth, axis=1)
    return float(np.nanmedian(np.degrees(2.0 * np.arcsin(np.clip(0.5 * chord, 0.0, 1.0)))))


def take_turns(functions: dict[str, Callable[[], Any]], repeats: int, limit: float = 60.0) -> dict[str, Any]:
    """Times in seconds of each function, called in turns so that all see the same machine.

    Each is called twice and timed once: what the one before left in the caches is not its fault.
    """
    times: dict[str, list[float]] = {name: [] for name in functions}
    for function in functions.values():
        function()
    stop = time.perf_counter() + limit
    for _ in range(repeats):
        for name, function in functions.items():
            function()
            start = time.perf_counter()
            function()
            times[name].append(time.perf_counter() - start)
        if time.perf_counter() > stop:
            break
    return {name: np.array(values) for name, values in times.items()}


def ratio(times: Any, reference: Any) -> tuple[float, float, float]:
    """Lower quartile, median and upper quartile of the ratios of times taken in the same turn."""
    low, middle, high = np.percentile(times / reference, [25, 50, 75])
    return float(low), float(middle), float(high)
