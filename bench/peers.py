"""Tile fitting beside its peers: ``python -m bench.peers --out DIR``.

Every system that is installed fits the same frame, one thread each, in turns, and is compared with the truth of
the rendering: speed and accuracy in one table. Ratios of times taken in the same turn, with their quartiles, say
more than times do. Writes peers.md, peers.json and scaling.png.

Peers: vectorised NumPy; OpenCV 5 (``depthTo3d``, and ``findPlanes`` with a least size that no plane reaches,
so that it fits its blocks and merges none); Open3D's normals and planar patches. Extra: ``pip install .[peers]``.
"""

# ruff: noqa: E402
import os

# Before NumPy loads its linear algebra: one thread each.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import argparse
import json
import platform
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import rgbd_planes as rp
from bench.fitting import Case, case, fit, floor_of, median_angle, numpy_fit, ratio, take_turns
from rgbd_planes.fitting import METHODS

BASE = "NumPy, PCA in XYZ"
FLOOR, FLOOR_SHARED = "floor: a division a pixel", "floor: a division for two pixels"
FORMS = {BASE: "pca", "NumPy, Z = aX + bY + c": "z", "NumPy, 1/Z on the ray": "1/z"}
NO_PLANE = 10**9


def systems(frame: Case, tile: int) -> tuple[dict[str, Callable[[], Any]], dict[str, float]]:
    """What to time, and the median angle in degrees of those whose planes can be seen."""
    functions: dict[str, Callable[[], Any]] = {
        FLOOR: floor_of(frame, tile, False),
        FLOOR_SHARED: floor_of(frame, tile, True),
    }
    angles = {}
    for method in METHODS:
        functions[method] = fit(frame, tile, method)
        angles[method] = median_angle(functions[method]().planes, frame, tile)
    functions["fit_tiles, no fitter kept"] = lambda: rp.fit_tiles(
        frame.depth, frame.camera, tile, num_threads=1
    )
    for name, form in FORMS.items():
        functions[name] = numpy_fit(frame, tile, form)
        angles[name] = median_angle(functions[name](), frame, tile)
    return functions | opencv(frame, tile), angles


def opencv(frame: Case, tile: int) -> dict[str, Callable[[], Any]]:
    """OpenCV 5, or nothing where it is not installed. Its blocks' planes are not exposed."""
    try:
        import cv2
    except ImportError:
        return {}
    if not hasattr(cv2, "findPlanes"):
        return {}
    cv2.setNumThreads(1)
    camera = frame.camera
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], np.float32)
    points = cv2.depthTo3d(frame.depth, matrix)
    return {
        "OpenCV depthTo3d alone": lambda: cv2.depthTo3d(frame.depth, matrix, points),
        "OpenCV findPlanes, points given": lambda: cv2.findPlanes(
            points, None, block_size=tile, min_size=NO_PLANE
        ),
    }


def open3d(frame: Case) -> dict[str, Callable[[], Any]]:
    """Open3D, or nothing where it is not installed: it takes clouds, and sees no tiles."""
    try:
        import open3d
    except ImportError:
        return {}
    cloud = open3d.geometry.PointCloud(
        open3d.utility.Vector3dVector(frame.camera.points(frame.depth)[frame.depth > 0])
    )
    search = open3d.geometry.KDTreeSearchParamKNN(30)
    return {
        "Open3D estimate_normals, 30 neighbours": lambda: cloud.estimate_normals(search),
        "Open3D detect_planar_patches, normals given": cloud.detect_planar_patches,
    }


def compare(frame: Case, tile: int, repeats: int) -> list[dict[str, Any]]:
    """One row a system: times, ratios to the baseline and to the floors, accuracy."""
    functions, angles = systems(frame, tile)
    times = take_turns(functions, repeats)
    slow = open3d(frame) if tile == 20 else {}
    if slow:
        times |= {name: np.resize(values, len(times[BASE])) for name, values in take_turns(slow, 3).items()}
    return [
        {
            "tile": tile,
            "system": name,
            "median_ms": float(np.median(values) * 1e3),
            "fastest_ms": float(values.min() * 1e3),
            "of_baseline": ratio(values, times[BASE]),
            "faster_than_baseline": ratio(times[BASE], values),
            "of_floor": ratio(values, times[FLOOR]),
            "of_shared_floor": ratio(values, times[FLOOR_SHARED]),
            "median_deg": angles.get(name),
        }
        for name, values in times.items()
    ]


def scaling(quick: bool) -> dict[str, list[tuple[Any, float]]]:
    """Nanoseconds a pixel: by size of frame, by size of tile; frames a second by threads."""
    sizes = [(320, 240), (640, 480), (1280, 720), (1920, 1080), (3840, 2160)]
    frames = {size: case(*size) for size in (sizes[:3] if quick else sizes)}
    repeats = 10 if quick else 60
    by_size = take_turns({f"{w}x{h}": fit(frame, 20) for (w, h), frame in frames.items()}, repeats)
    by_tile = take_turns(
        {str(tile): fit(case(), tile) for tile in (4, 5, 8, 10, 16, 20, 32, 40, 64)}, repeats
    )
    many = np.repeat(case().depth[None], 20 if quick else 100, axis=0)
    batches = {}
    for threads in range(1, (os.cpu_count() or 1) + 1):
        fitter = rp.TileFitter(case().camera, 20, num_threads=threads)
        out = fitter.fit_batch(many)
        batches[threads] = lambda fitter=fitter, out=out: fitter.fit_batch(many, out=out)
    by_threads = take_turns(batches, max(5, repeats // 4))
    pixels = {f"{w}x{h}": w * h for w, h in frames}
    return {
        "size": [(name, float(np.median(t)) / pixels[name] * 1e9) for name, t in by_size.items()],
        "tile": [(int(name), float(np.median(t)) / case().depth.size * 1e9) for name, t in by_tile.items()],
        "threads": [(n, ratio(by_threads[1], t)[1]) for n, t in by_threads.items()],
    }


def figure(points: dict[str, list[tuple[Any, float]]], path: Path) -> None:
    """Draw the three scalings side by side."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(11, 3.4), layout="constrained")
    FigureCanvasAgg(drawing)
    axes = drawing.subplots(1, 3)
    titles = (
        "size of the frame, tiles of 20",
        "side of a tile in pixels, 640 x 480",
        "threads, batch of 640 x 480",
    )
    for axis, (name, values), title in zip(axes, points.items(), titles, strict=True):
        labels, heights = zip(*values, strict=True)
        if name == "tile":
            axis.plot(labels, heights, "o-")
            axis.set_xscale("log", base=2)
            axis.set_xticks(labels, [str(label) for label in labels], fontsize=8)
            axis.minorticks_off()
        else:
            axis.plot(range(len(labels)), heights, "o-")
            axis.set_xticks(range(len(labels)), [str(label) for label in labels], fontsize=8)
        if name == "threads":
            axis.plot(range(len(labels)), labels, ":", color="grey", label="ideal")
            axis.legend()
        axis.set_ylim(0.0)
        axis.set_xlabel(title)
        axis.set_ylabel("times as fast as one thread" if name == "threads" else "ns a pixel")
        axis.grid(alpha=0.3)
    drawing.savefig(path, dpi=150)


def text(rows: list[dict[str, Any]]) -> str:
    """The table in Markdown."""

    def spread(values: tuple[float, float, float]) -> str:
        low, middle, high = (f"{value:.3g}" for value in values)
        return f"{middle} ({low}–{high})"

    lines = [
        "| tile | system | ms | x baseline | baseline / it | x floor | x shared floor | median angle |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        angle = "" if row["median_deg"] is None else f"{row['median_deg']:.2f}°"
        lines.append(
            f"| {row['tile']} | {row['system']} | {row['median_ms']:.3f} | {spread(row['of_baseline'])} "
            f"| {spread(row['faster_than_baseline'])} | {spread(row['of_floor'])} "
            f"| {spread(row['of_shared_floor'])} | {angle} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(prog="python -m bench.peers", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("peers"), help="folder for the report")
    parser.add_argument("--quick", action="store_true", help="fewer repeats, smaller frames")
    arguments = parser.parse_args()
    frame, repeats = case(), 20 if arguments.quick else 150
    rows = compare(frame, 20, repeats) + compare(frame, 10, repeats)
    points = scaling(arguments.quick)
    table = text(rows)
    print(table)
    print()
    for name, values in points.items():
        print(f"{name}: " + ", ".join(f"{label} {value:.3g}" for label, value in values))
    arguments.out.mkdir(parents=True, exist_ok=True)
    about = {"python": platform.python_version(), "numpy": np.__version__, "machine": platform.machine()}
    (arguments.out / "peers.json").write_text(
        json.dumps({"about": about, "rows": rows, "scaling": points}, indent=1)
    )
    heading = (
        "640 x 480, uint16, 5 % missing, one thread; ratios: median (quartiles) of times taken in turns."
    )
    (arguments.out / "peers.md").write_text(f"{heading}\n\n{table}\n")
    figure(points, arguments.out / "scaling.png")


if __name__ == "__main__":
    main()
