"""Tile fitting and normals beside their peers: ``python -m bench.peers --out DIR``.

Every system that is installed works on the same frame, in turns, one thread each and then all threads, and is compared
with the truth of the rendering: speed and accuracy in one table. Ratios of times taken in the same turn, with their
quartiles, say more than times do. Writes peers.md, peers.json and scaling.png.

Peers: vectorised NumPy; OpenCV 5 (``depthTo3d``, ``RgbdNormals``, and ``findPlanes`` with a least size that no plane
reaches, so that it fits its blocks and merges none); Open3D's normals and planar patches. Extra:
``pip install .[peers]``. CAPE and PEAC have no packages: their rows are ratios to the same NumPy baseline, measured
once, beside it, on a rendered room of six planes, with both built from their sources.
"""

import os

if __name__ == "__main__":  # Before NumPy loads its linear algebra: one thread each.
    for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(_name, "1")

import argparse
import json
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import rgbd_planes as rp
from bench import test_normals as of_normals
from bench.fitting import Case, case, fit, floor_of, median_angle, numpy_fit, ratio, take_turns
from bench.floor import floor
from bench.paper import processor
from rgbd_planes._core.threads import run_in_ranges
from rgbd_planes.fitting.methods import METHODS

BASE = "NumPy, PCA in XYZ"
FLOOR, FLOOR_SHARED = "floor: a division a pixel", "floor: a division for two pixels"
FORMS = {BASE: "pca", "NumPy, Z = aX + bY + c": "z", "NumPy, 1/Z on the ray": "1/z"}
# The rows of the tables.
SHOWN = {method: f"`{method}`" for method in METHODS} | {
    BASE: BASE,
    "NumPy, 1/Z on the ray": "NumPy, 1/Z on the ray",
    "OpenCV findPlanes, points given": "OpenCV `findPlanes`, blocks only, points given",
    "OpenCV depthTo3d alone": "OpenCV `depthTo3d`, which that needs first",
    "Open3D detect_planar_patches, normals given": "Open3D `detect_planar_patches`, normals given",
}
NORMALS_SHOWN = {"normals 7": "`normals`", "avoid_edges 7": "`normals`, `avoid_edges`"} | {
    f"OpenCV {name}": f"OpenCV {name}" for name in ("FALS", "LINEMOD", "SRI", "CROSS_PRODUCT")
}
NO_PLANE = 10**9
SLOW_TURNS = 3  # of what takes a second
THREADS = os.cpu_count() or 1

# Time over the baseline's, least and most of several runs: by side of the tile.
QUOTED = {
    20: {"CAPE, points given": "0.19–0.28", "CAPE, from the depth": "0.43–0.64", "PEAC, points given": "0.68"},
    10: {"CAPE, points given": "0.21–0.23", "CAPE, from the depth": "0.32–0.37", "PEAC, points given": "0.42"},
}


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
    functions["fit_tiles, no fitter kept"] = lambda: rp.fit_tiles(frame.depth, frame.camera, tile, num_threads=1)
    for name, form in FORMS.items():
        functions[name] = numpy_fit(frame.depth, frame.camera, tile, form)
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
        "OpenCV findPlanes, points given": lambda: cv2.findPlanes(points, None, block_size=tile, min_size=NO_PLANE),
    }


def open3d(frame: Case) -> dict[str, Callable[[], Any]]:
    """Open3D, or nothing where it is not installed: it takes clouds, and sees no tiles."""
    try:
        import open3d
    except ImportError:
        return {}
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(frame.camera.points(frame.depth)[frame.depth > 0]))
    search = open3d.geometry.KDTreeSearchParamKNN(30)
    return {
        "Open3D estimate_normals, 30 neighbours": lambda: cloud.estimate_normals(search),
        "Open3D detect_planar_patches, normals given": cloud.detect_planar_patches,
    }


def compare(frame: Case, tile: int, repeats: int) -> list[dict[str, Any]]:
    """One row a system: times, ratios to the baseline and to the floors, accuracy."""
    functions, angles = systems(frame, tile)
    times = take_turns(functions, repeats)
    measured = [(name, values, times) for name, values in times.items()]
    slow = open3d(frame) if tile == 20 else {}
    if slow:
        times = take_turns({name: functions[name] for name in (BASE, FLOOR)} | slow, SLOW_TURNS)
        measured += [(name, times[name], times) for name in slow]
    return [
        {
            "tile": tile,
            "system": name,
            "median_ms": float(np.median(values) * 1e3),
            "fastest_ms": float(values.min() * 1e3),
            "of_baseline": ratio(values, beside[BASE]),
            "faster_than_baseline": ratio(beside[BASE], values),
            "of_floor": ratio(values, beside[FLOOR]),
            "median_deg": angles.get(name),
        }
        for name, values, beside in measured
    ]


def with_all_threads(frame: Case, tile: int, repeats: int) -> list[dict[str, Any]]:
    """Time of each system with all threads over its own with one."""
    both: dict[str, list[Callable[[], Any]]] = {}
    for method in ("range_explicit", "standard_pca"):
        both[method] = [fit(frame, tile, method, n) for n in (1, THREADS)]
    both["normals 7"] = [partial(rp.normals, frame.depth, frame.camera, 7, num_threads=n) for n in (1, THREADS)]
    if of_normals.OPENCV:
        import cv2

        def of_opencv(count: int, function: Callable[[], Any]) -> None:
            cv2.setNumThreads(count)
            function()

        names = opencv(frame, tile) | {"OpenCV FALS": of_normals.prepare("OpenCV FALS", of_normals.case(0.05))}
        for name, function in names.items():
            both[name] = [partial(of_opencv, n, function) for n in (1, THREADS)]
    times = take_turns({f"{name} {i}": f for name, pair in both.items() for i, f in enumerate(pair)}, repeats)
    if of_normals.OPENCV:
        cv2.setNumThreads(1)
    return [
        {"system": name, "threads": THREADS, "speedup": ratio(times[f"{name} 0"], times[f"{name} 1"])} for name in both
    ]


def compare_normals(holes: float, repeats: int) -> list[dict[str, Any]]:
    """One row a way to compute the normals of all pixels: times, ratios to ours with window 7, accuracy."""
    frame = of_normals.case(holes)
    functions = {method: of_normals.prepare(method, frame) for method in of_normals.METHODS}
    times = take_turns(functions, repeats)
    return [
        {
            "holes": holes,
            "system": name,
            "median_ms": float(np.median(times[name]) * 1e3),
            "of_ours": ratio(times[name], times["normals 7"]),
            **of_normals.accuracy(function(), frame),
        }
        for name, function in functions.items()
    ]


def floor_of_batch(frames: Any, threads: int) -> Callable[[], None]:
    """The floor kernel on many frames, shared by threads as `fit_batch` shares them."""
    camera = case().camera

    def some(start: int, stop: int) -> None:
        sums, tiles = np.empty((3, camera.width)), np.empty((4, camera.height // 20, camera.width // 20))
        for frame in frames[start:stop]:
            floor(frame, camera.tan_x_columns, camera.tan_y_rows, 20, False, sums, tiles)

    return lambda: run_in_ranges(some, len(frames), threads)


def scaling(quick: bool) -> dict[str, list[tuple[Any, float]]]:
    """Nanoseconds a pixel: by size of frame, by size of tile; frames a second by threads."""
    sizes = [(320, 240), (640, 480), (1280, 720), (1920, 1080), (3840, 2160)]
    frames = {size: case(*size) for size in (sizes[:3] if quick else sizes)}
    repeats = 10 if quick else 60
    by_size = take_turns({f"{w}x{h}": fit(frame, 20) for (w, h), frame in frames.items()}, repeats)
    by_tile = take_turns({str(tile): fit(case(), tile) for tile in (4, 5, 8, 10, 16, 20, 32, 40, 64)}, repeats)
    many = np.repeat(case().depth[None], 20 if quick else 100, axis=0)
    batches: dict[str, Callable[[], Any]] = {}
    for threads in range(1, THREADS + 1):
        fitter = rp.TileFitter(case().camera, 20, num_threads=threads)
        out = fitter.fit_batch(many)
        batches[f"fit_batch {threads}"] = partial(fitter.fit_batch, many, out=out)
        batches[f"floor {threads}"] = floor_of_batch(many, threads)
    by_threads = take_turns(batches, repeats)

    one = rp.TileFitter(case().camera, 20, num_threads=1)
    kept = one.fit(case().depth)
    seen = take_turns(
        {
            "again": lambda: [one.fit(many[0], out=kept) for _ in many],
            "new": lambda: [one.fit(frame, out=kept) for frame in many],
        },
        max(5, repeats // 4),
    )

    def faster(name: str, threads: int) -> float:
        return float(by_threads[f"{name} 1"].min() / by_threads[f"{name} {threads}"].min())

    pixels = {f"{w}x{h}": w * h for w, h in frames}
    return {
        "size": [(name, float(np.median(t)) / pixels[name] * 1e9) for name, t in by_size.items()],
        "tile": [(int(name), float(np.median(t)) / case().depth.size * 1e9) for name, t in by_tile.items()],
        # Of the fastest rounds: two threads are disturbed twice as often as one. The floor is the machine's own limit.
        "threads": [(n, faster("fit_batch", n)) for n in range(1, THREADS + 1)],
        "threads, floor": [(n, faster("floor", n)) for n in range(1, THREADS + 1)],
        "new": [("again", ratio(seen["new"], seen["again"])[1])],
    }


def figure(points: dict[str, list[tuple[Any, float]]], path: Path) -> None:
    """Draw the three scalings side by side."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(11, 3.4), layout="constrained")
    FigureCanvasAgg(drawing)
    axes = drawing.subplots(1, 3)
    titles = ("size of the frame, tiles of 20", "side of a tile in pixels, 640 x 480", "threads, batch of 640 x 480")
    for axis, name, title in zip(axes, ("size", "tile", "threads"), titles, strict=True):
        labels, heights = zip(*points[name], strict=True)
        if name == "tile":
            axis.plot(labels, heights, "o-")
            axis.set_xscale("log", base=2)
            axis.set_xticks(labels, [str(label) for label in labels], fontsize=8)
            axis.minorticks_off()
        else:
            axis.plot(range(len(labels)), heights, "o-", label="fit_batch" if name == "threads" else None)
            axis.set_xticks(range(len(labels)), [str(label) for label in labels], fontsize=8)
        if name == "threads":
            axis.plot(range(len(labels)), labels, ":", color="grey", label="ideal")
            axis.plot(range(len(labels)), [value for _, value in points["threads, floor"]], "s--", label="floor")
            axis.legend()
        axis.set_ylim(0.0)
        axis.set_xlabel(title)
        axis.set_ylabel("times as fast as one thread" if name == "threads" else "ns a pixel")
        axis.grid(alpha=0.3)
    drawing.savefig(path, dpi=150)


def spread(values: tuple[float, float, float]) -> str:
    """Median and quartiles."""
    low, middle, high = (f"{value:.0f}" if value >= 100.0 else f"{value:#.3g}" for value in values)
    return f"{middle} ({low}–{high})"


def table(measured: dict[str, Any]) -> str:
    """The tables of tile fitting and of normals in Markdown, and how times scale."""
    rows = {(row["tile"], row["system"]): row for row in measured["rows"]}
    lines = [
        "| | 20 x 20: of the baseline | of the floor | angle | 10 x 10: of the baseline | of the floor | angle |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    for name, shown in SHOWN.items():
        found = [rows.get((tile, name)) for tile in QUOTED]
        if any(found):
            lines.append(_line([shown, *(cell for row in found for cell in _cells(row))]))
    for name in QUOTED[20]:
        lines.append(_line([name, *(cell for quoted in QUOTED.values() for cell in (quoted[name], "", ""))]))
    lines += [
        "",
        "| normals, window 7 | time, ours = 1 | median error | no pixel missing: time | median error |",
        "|---|---:|---:|---:|---:|",
    ]
    normals = {(row["holes"], row["system"]): row for row in measured["normals"]}
    for name, shown in NORMALS_SHOWN.items():
        found = [normals.get((holes, name)) for holes in sorted(of_normals.HOLES, reverse=True)]
        if any(found):
            lines.append(_line([shown, *(cell for row in found for cell in _cells_of_normals(row))]))
    points = measured["scaling"]
    threads, faster = points["threads"][-1]
    lines += [
        "",
        f"Nanoseconds a pixel, tiles of 20: {_series(points['size'])}. By side of the tile, 640x480: "
        f"{_series(points['tile'])}.",
        f"A batch of 100 frames on {threads} threads is {faster:.2f} times as fast as on one, the floor kernel "
        f"{points['threads, floor'][-1][1]:.2f} times. A frame that has yet to come from memory takes "
        f"{points['new'][0][1]:.2f} times as long as one that is fitted again."
        + (f" Measured on {measured['about']['processor']}." if "processor" in measured["about"] else ""),
    ]
    return "\n".join(lines)


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cells(row: dict[str, Any] | None) -> tuple[str, str, str]:
    if row is None:
        return "", "", ""
    angle = "" if row["median_deg"] is None else f"{row['median_deg']:.2f}°"
    return "1" if row["system"] == BASE else spread(row["of_baseline"]), spread(row["of_floor"]), angle


def _cells_of_normals(row: dict[str, Any] | None) -> tuple[str, str]:
    if row is None:
        return "", ""
    share = row["share_of_valid"]
    only = f", on {share:.0%} of the pixels".replace("%", " %") if share < 0.95 else ""
    time = "1" if row["system"] == "normals 7" else spread(row["of_ours"])
    return time, f"{row['median_deg']:.2f}°{only}"


def _series(points: list[tuple[Any, float]]) -> str:
    return ", ".join(f"{value:.2f} with {label}" for label, value in points)


def text_of_threads(rows: list[dict[str, Any]]) -> str:
    """The table of what threads bring in Markdown."""
    lines = [f"| one frame, {THREADS} threads | times as fast as with one |", "|---|---|"]
    return "\n".join(lines + [f"| {row['system']} | {spread(row['speedup'])} |" for row in rows])


def measure() -> dict[str, Any]:
    """What `main` measures, in a process of its own, whose linear algebra has one thread."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "bench.peers", "--out", folder], check=True, stdout=subprocess.DEVNULL)
        return dict(json.loads((Path(folder) / "peers.json").read_text(encoding="utf-8")))


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(prog="python -m bench.peers", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("peers"), help="folder for the report")
    parser.add_argument("--quick", action="store_true", help="fewer repeats, smaller frames")
    arguments = parser.parse_args()
    frame, repeats = case(), 20 if arguments.quick else 150
    rows = compare(frame, 20, repeats) + compare(frame, 10, repeats)
    normals = [row for holes in of_normals.HOLES for row in compare_normals(holes, repeats // 5)]
    threaded = with_all_threads(frame, 20, repeats // 3)
    points = scaling(arguments.quick)
    about = {"python": platform.python_version(), "numpy": np.__version__, "processor": processor()}
    measured = {"about": about, "rows": rows, "normals": normals, "threads": threaded, "scaling": points}
    report = f"{table(measured)}\n\n{text_of_threads(threaded)}"
    print(report)
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "peers.json").write_text(json.dumps(measured, indent=1), encoding="utf-8")
    (arguments.out / "peers.md").write_text(f"{report}\n", encoding="utf-8")
    figure(points, arguments.out / "scaling.png")


if __name__ == "__main__":
    main()
