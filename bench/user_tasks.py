"""Five tasks of a new user, with this library, OpenCV, Open3D and PCL: ``python -m bench.user_tasks``.

A task is a function of a depth frame (or a folder of them) and a camera; PCL's, in C++, are in pcl_tasks.cpp. What is
counted is its lines; what is printed beside them is the time of the second and later calls, in turns, and how good the
answer is. A library that is not installed is left out.
"""

import inspect
import re
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rgbd_planes as rp
from rgbd_planes.sequences.images import write_png

Depth = NDArray[Any]  # as sensors give it: uint16, in millimetres
Floats = NDArray[np.floating]
Labels = NDArray[np.integer]


def matrix(camera: rp.Camera) -> Floats:
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])


# Task 1: the plane of every 16 x 16 tile, with its residual; (30, 40, 4).
def tiles_ours(depth: Depth, camera: rp.Camera) -> tuple[Floats, Floats]:
    tiles = rp.fit_tiles(depth, camera, tile=16)
    return tiles.planes, tiles.rmse_metric


def tiles_opencv(depth: Depth, camera: rp.Camera) -> tuple[Floats, Floats]:
    points = cv2.depthTo3d(depth, matrix(camera))[..., :3]
    tiles = points.reshape(30, 16, 40, 16, 3).swapaxes(1, 2).reshape(30, 40, 256, 3)
    planes, rmse = np.full((30, 40, 4), np.nan), np.full((30, 40), np.nan)
    for index in np.ndindex(30, 40):
        valid = tiles[index][np.isfinite(tiles[index][:, 2]) & (tiles[index][:, 2] > 0)]
        if len(valid) < 128:
            continue
        mean, vectors, values = cv2.PCACompute2(valid.astype(np.float64), mean=None)
        normal = vectors[2] if vectors[2] @ mean[0] < 0 else -vectors[2]
        planes[index] = *normal, -normal @ mean[0]
        rmse[index] = np.sqrt(max(values[2, 0], 0))
    return planes, rmse


def tiles_open3d(depth: Depth, camera: rp.Camera) -> tuple[Floats, Floats]:
    intrinsic = open3d.camera.PinholeCameraIntrinsic(640, 480, camera.fx, camera.fy, camera.cx, camera.cy)
    image = open3d.geometry.Image(depth)
    cloud = open3d.geometry.PointCloud.create_from_depth_image(image, intrinsic, project_valid_depth_only=False)
    points = np.asarray(cloud.points)
    tiles = points.reshape(30, 16, 40, 16, 3).swapaxes(1, 2).reshape(30, 40, 256, 3)
    planes, rmse = np.full((30, 40, 4), np.nan), np.full((30, 40), np.nan)
    for index in np.ndindex(30, 40):
        valid = tiles[index][np.isfinite(tiles[index][:, 2])]
        if len(valid) < 128:
            continue
        tile = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(valid))
        mean, covariance = tile.compute_mean_and_covariance()
        values, vectors = np.linalg.eigh(covariance)
        normal = vectors[:, 0] if vectors[:, 0] @ mean < 0 else -vectors[:, 0]
        planes[index] = *normal, -normal @ mean
        rmse[index] = np.sqrt(max(values[0], 0))
    return planes, rmse


# Task 2: the planes of the frame and the pixels of each; labels (480, 640), 0 for none.
def segments_ours(depth: Depth, camera: rp.Camera) -> Labels:
    segments = rp.segment(depth, camera)
    return segments.labels


def segments_opencv(depth: Depth, camera: rp.Camera) -> Labels:
    points, normals = cv2.depthTo3d(depth, matrix(camera)), None
    if depth.all():  # beside missing pixels they are wrong, and fewer planes are found with them
        method = cv2.RgbdNormals_RGBD_NORMALS_METHOD_FALS
        normals = cv2.RgbdNormals_create(480, 640, cv2.CV_32F, matrix(camera), 5, 50.0, method).apply(points)
    labels, _ = cv2.findPlanes(points, normals, block_size=20, threshold=0.03)
    return np.where(labels == 255, 0, labels + 1)


def segments_open3d(depth: Depth, camera: rp.Camera) -> Labels:
    intrinsic = open3d.camera.PinholeCameraIntrinsic(640, 480, camera.fx, camera.fy, camera.cx, camera.cy)
    cloud = open3d.geometry.PointCloud.create_from_depth_image(open3d.geometry.Image(depth), intrinsic)
    cloud.estimate_normals(open3d.geometry.KDTreeSearchParamKNN(100))
    patches = cloud.detect_planar_patches()
    points, labels = np.asarray(cloud.points), np.zeros((480, 640), int)
    pixel = np.rint(points[:, :2] / points[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]).astype(int)
    for label, patch in enumerate(patches, start=1):
        inside = patch.get_point_indices_within_bounding_box(cloud.points)
        labels[pixel[inside, 1], pixel[inside, 0]] = label
    return labels


# Task 3: a normal for every pixel, towards the camera; (480, 640, 3).
def normals_ours(depth: Depth, camera: rp.Camera) -> Floats:
    return rp.normals(depth, camera, window=7)


def normals_ours_wider(depth: Depth, camera: rp.Camera) -> Floats:
    return rp.normals(depth, camera, window=9)


def normals_opencv(depth: Depth, camera: rp.Camera) -> Any:
    points = cv2.depthTo3d(depth, matrix(camera))
    method = cv2.RgbdNormals_RGBD_NORMALS_METHOD_FALS
    return cv2.RgbdNormals_create(480, 640, cv2.CV_32F, matrix(camera), 7, 50.0, method).apply(points)[..., :3]


def normals_opencv_linemod(depth: Depth, camera: rp.Camera) -> Any:
    points = cv2.depthTo3d(depth, matrix(camera))
    method = cv2.RgbdNormals_RGBD_NORMALS_METHOD_LINEMOD
    return cv2.RgbdNormals_create(480, 640, cv2.CV_32F, matrix(camera), 7, 50.0, method).apply(points)[..., :3]


def normals_open3d(depth: Depth, camera: rp.Camera) -> Floats:
    intrinsic = open3d.camera.PinholeCameraIntrinsic(640, 480, camera.fx, camera.fy, camera.cx, camera.cy)
    image = open3d.geometry.Image(depth)
    cloud = open3d.geometry.PointCloud.create_from_depth_image(image, intrinsic)
    cloud.estimate_normals(open3d.geometry.KDTreeSearchParamKNN(49))
    cloud.orient_normals_towards_camera_location()
    normals = np.full((480, 640, 3), np.nan)
    normals[depth > 0] = np.asarray(cloud.normals)
    return normals


# Task 4: the standard deviation of each tile's distance in metres; (30, 40). The others have none: no function.
def deviations_ours(depth: Depth, camera: rp.Camera) -> Floats:
    camera = rp.Camera(**{**camera.to_dict(), "noise": rp.noise.kinect_v1()})
    return np.sqrt(rp.fit_tiles(depth, camera, tile=16).plane_covariance[..., 3, 3])


# Task 5: a folder in the form of the TUM benchmark, to a table of the planes of all tiles, on disk.
def table_ours(folder: Path, camera: rp.Camera) -> None:
    rp.fit_sequence(rp.open_sequence(folder, camera, "tum"), folder / "planes.parquet")


def table_opencv(folder: Path, camera: rp.Camera) -> None:
    import pandas

    rows = []
    for line in (folder / "depth.txt").read_text().splitlines():
        if line.startswith("#"):
            continue
        time_, name = line.split()
        depth = cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED)
        planes, rmse = tiles_opencv(depth, camera)
        for index in np.ndindex(30, 40):
            rows.append((float(time_), name, *index, *planes[index], rmse[index]))
    pandas.DataFrame(rows, columns=["time", "name", "row", "column", "nx", "ny", "nz", "d", "rmse"]).to_parquet(
        folder / "p.parquet"
    )


class PclTask:
    """A task of pcl_tasks.cpp. Its time is the program's own, without what it takes to hand data over."""

    def __init__(self, program: Path, task: str) -> None:
        self._program, self._task = program, task
        self.seconds = 0.0

    def __call__(self, depth: Depth, camera: rp.Camera) -> Any:
        with tempfile.TemporaryDirectory() as name:
            frame, result = Path(name) / "frame", Path(name) / "result"
            depth.tofile(frame)
            command = [str(v) for v in (self._program, frame, camera.fx, camera.fy, camera.cx, camera.cy)]
            # Twice: the first warms the memory up, as a call does for the one after it in the other libraries.
            asked = f"{self._task} {result}\n" * 2
            ran = subprocess.run(command, input=asked, capture_output=True, text=True, check=True)
            self.seconds = float(ran.stdout.split()[-1])
            if self._task == "segments":
                return np.fromfile(result, np.int32).reshape(480, 640)
            values = np.fromfile(result, np.float32)
            return (values.reshape(30, 40, 4), None) if self._task == "tiles" else values.reshape(480, 640, 3)

    @property
    def lines(self) -> int:
        """Lines of the function's body, and of those of its own file that it calls; braces do not count."""
        return sum(self._lines(name) for name in self._needed(self._task) | {"cloud_of"})

    def _needed(self, name: str) -> set[str]:
        return {name} | ({"normals"} if "normals(cloud" in self._body(name) else set())

    def _body(self, name: str) -> str:
        found = re.search(rf"^[\w:<>]+ {name}\(.*?^{{\n(.*?)^}}", PCL.read_text(), re.MULTILINE | re.DOTALL)
        assert found, f"{PCL.name} has no {name}"
        return found[1]

    def _lines(self, name: str) -> int:
        return sum(line.strip() not in ("", "{", "}") for line in self._body(name).splitlines())


PCL = Path(__file__).with_name("pcl_tasks.cpp")


def build_pcl(folder: Path) -> Path | None:
    """The program of PCL's tasks, where there are a compiler and the library (Debian: libpcl-dev), or None."""
    libraries = ["pcl_segmentation", "pcl_features", "pcl_search", "pcl_kdtree", "pcl_common"]
    program = folder / "pcl_tasks"
    command = ["g++", "-std=c++17", "-O3", "-w", str(PCL), "-o", str(program)]
    try:
        asked = ["pkg-config", "--cflags-only-I", "pcl_segmentation"]
        flags = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.split()
        link = [f"-l{library}" for library in libraries]
        subprocess.run([*command, *flags, *link], capture_output=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return program


def lines(function: Callable[..., Any]) -> int:
    """Lines of a function's body, and of `tiles_opencv` where it calls that."""
    text = inspect.getsource(function)
    own = [line for line in text.splitlines()[1:] if line.strip()]
    return len(own) + (lines(tiles_opencv) if "tiles_opencv(" in "".join(own) else 0)


def angles(planes: Floats, labels: Labels, rendering: rp.scenes.Rendering, what: str) -> str:
    """Median error of the planes, or normals, that there are, and of how many, if there are far fewer than labels."""
    seen = (labels > 0) & np.isfinite(planes[..., 0])
    cosine = np.abs((planes[seen][..., :3] * rendering.planes[labels[seen] - 1][..., :3]).sum(axis=-1))
    share = np.count_nonzero(seen) / np.count_nonzero(labels)
    of = f" of {share:.0%} of the {what}" if share < 0.95 else ""
    return f"{np.median(np.degrees(np.arccos(np.clip(cosine, 0, 1)))):.1f}°{of}"


def found(labels: Labels, rendering: rp.scenes.Rendering) -> str:
    """Planes of more than 1000 pixels, and how many of them have one label that shares 80 % with them."""
    sizes = np.bincount(rendering.labels.ravel())
    wanted = [i for i in range(1, len(sizes)) if sizes[i] > 1000]
    good = 0
    for i in wanted:
        mine = rendering.labels == i
        label, count = np.unique(labels[mine & (labels > 0)], return_counts=True)
        if len(label):
            best = label[count.argmax()]
            good += count.max() >= 0.8 * mine.sum() and count.max() >= 0.8 * (labels == best).sum()
    return f"{good} of {len(wanted)} planes"


def library(which: str) -> str:
    """Of a function of a task: "opencv" of "opencv_linemod"."""
    return which.partition("_")[0]


def available(which: str) -> bool:
    name = library(which)
    return name == "ours" or globals().get({"opencv": "cv2"}.get(name, name)) is not None


def versions(program: Path | None) -> dict[str, str]:
    found = {"OpenCV": cv2 and cv2.__version__, "Open3D": open3d and open3d.__version__}
    if program is not None:
        asked = ["pkg-config", "--modversion", "pcl_segmentation"]
        found["PCL"] = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
    return {name: version for name, version in found.items() if version}


def measure() -> dict[str, Any]:
    """Return a row for each task and library."""
    camera = rp.presets.kinect_v1()
    rendering = rp.scenes.room().render(camera)
    depth = rendering.measure(holes=0.05, patches=0.03, seed=1)
    whole = rendering.measure(seed=1)
    tile_labels = rendering.tile_labels((16, 16))
    distance = rendering.planes[np.maximum(tile_labels, 1) - 1][..., 3]

    def honest(sigma: Floats) -> str:
        off = rp.fit_tiles(depth, camera, 16).planes[..., 3] - distance
        there = (tile_labels > 0) & np.isfinite(off)
        share = np.mean(np.abs(off[there]) < 1.96 * sigma[there])
        return f"{share:.1%} of distances within 1.96 standard deviations (95% is right)"

    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "freiburg1"
        (folder / "depth").mkdir(parents=True)
        for i in range(10):
            write_png(folder / "depth" / f"{i}.png", rendering.measure(holes=0.05, seed=i))
        (folder / "depth.txt").write_text("".join(f"{i}.5 depth/{i}.png\n" for i in range(10)))
        program = build_pcl(Path(name))
        tasks: dict[str, tuple[Depth | Path, Callable[[Any, Depth], str]]] = {
            "tiles": (depth, lambda made, of: angles(made[0], tile_labels, rendering, "tiles")),
            "segments": (depth, lambda made, of: found(made, rendering)),
            "normals": (
                depth,
                lambda made, of: angles(made, np.where(of > 0, rendering.labels, 0), rendering, "pixels"),
            ),
            "deviations": (depth, lambda made, of: honest(made)),
            "table": (folder, lambda made, of: ""),
        }
        for task, (argument, judge) in tasks.items():
            functions = {w: globals().get(f"{task}_{w}") for w in WRITTEN}
            runs: dict[str, Any] = {w: f for w, f in functions.items() if f is not None and available(w)}
            if program is not None and task in ("tiles", "segments", "normals"):
                runs["pcl"] = PclTask(program, task)
            results = {w: f(argument, camera) for w, f in runs.items()}
            times: dict[str, list[float]] = {w: [] for w in runs}
            for _ in range(5):
                for w, f in runs.items():
                    for _ in range(2):  # the first one after another library's finds the caches full of that
                        for left in folder.glob("planes.parquet/*"):
                            left.unlink()
                        start = time.perf_counter()
                        f(argument, camera)
                        took = time.perf_counter() - start
                    times[w].append(f.seconds if isinstance(f, PclTask) else took)
            for w, f in runs.items():
                ratio = statistics.median(t / o for t, o in zip(times[w], times["ours"], strict=True))
                pictured = task in ("tiles", "segments", "normals")
                rows.append(
                    {
                        "task": task,
                        "with": w,
                        "lines": f.lines if isinstance(f, PclTask) else lines(f),
                        "milliseconds": 1e3 * statistics.median(times[w]),
                        "ratio": ratio,
                        "result": judge(results[w], depth),
                        "without_holes": judge(f(whole, camera), whole) if pictured else "",
                    }
                )
    return {"versions": versions(program), "rows": rows}


NAMES = {
    "tiles": "planes of tiles, 16 x 16",
    "segments": "planes of the frame",
    "normals": "normals of pixels, window 7",
    "deviations": "how good a plane is",
    "table": "10 frames of a TUM sequence to a table",
}
WRITTEN = ("ours", "ours_wider", "opencv", "opencv_linemod", "open3d")
WITH = {
    ("normals", "ours_wider"): "**ours**, window 9",
    ("tiles", "opencv"): "OpenCV, a loop of `PCACompute2`",
    ("tiles", "open3d"): "Open3D, a loop of covariances",
    ("tiles", "pcl"): "PCL, a loop of `computePointNormal`",
    ("segments", "opencv"): "OpenCV, `findPlanes`",
    ("segments", "open3d"): "Open3D, `detect_planar_patches`",
    ("segments", "pcl"): "PCL, `OrganizedMultiPlaneSegmentation`",
    ("normals", "opencv"): "OpenCV, FALS",
    ("normals", "opencv_linemod"): "OpenCV, LINEMOD",
    ("normals", "open3d"): "Open3D, 49 neighbours",
    ("normals", "pcl"): "PCL, integral images, gradients",
    ("table", "opencv"): "OpenCV and pandas",
}


def table(result: dict[str, Any]) -> str:
    """The result as Markdown."""
    shown = ["| task | with | lines | time, ours = 1 | result | without holes |", "|---|---|---:|---:|---|---|"]
    for row in result["rows"]:
        ours = row["with"] == "ours"
        task, name = (NAMES[row["task"]], "**ours**") if ours else ("", WITH[row["task"], row["with"]])
        shown.append(
            f"| {task} | {name} | {row['lines']} | {_times(row['ratio'])} | {row['result']} | {row['without_holes']} |"
        )
    shown += ["", ", ".join(f"{name} {version}" for name, version in result["versions"].items()) + "."]
    return "\n".join(shown)


def _times(ratio: float) -> str:
    """Two digits, or all before the point."""
    return f"{ratio:.2g}" if ratio < 99.5 else f"{ratio:.0f}"


def short_table(result: dict[str, Any]) -> str:
    """The tasks that have a picture, a column for each library, as the README has them."""
    versions = {"ours": "**rgbd_planes**"} | {
        name.lower(): f"{name} {version}" for name, version in result["versions"].items()
    }
    shown = [f"| | {' | '.join(versions.values())} |", f"|---|{'---|' * len(versions)}"]
    for task in ("tiles", "segments", "normals"):
        rows = [row for row in result["rows"] if row["task"] == task and row["with"] != "ours_wider"]
        cells = [_short_cell([row for row in rows if library(row["with"]) == name]) for name in versions]
        shown.append(f"| {NAMES[task]} | {' | '.join(cells)} |")
    return "\n".join(shown)


def _short_cell(rows: list[dict[str, Any]]) -> str:
    """Of a library's rows of a task; each with its name, if there are several."""
    cells = []
    for row in rows:
        name = f"{WITH[row['task'], row['with']].partition(', ')[2]} " if len(rows) > 1 else ""
        text = f"{name}{_times(row['ratio'])} x, {row['result']} ({row['without_holes']})"
        cells.append(re.sub(r" of \d+ planes| of the (tiles|pixels)", "", text))
    return "; ".join(cells)


def main() -> None:
    """Print the table, the times, and what is missing."""
    result = measure()
    print(table(result))
    left_out = {"opencv", "open3d", "pcl"} - {library(row["with"]) for row in result["rows"]}
    if left_out:
        print(f"Not installed, so left out: {', '.join(sorted(left_out))}; docs/measured.md says what they need.")
    for row in result["rows"]:
        print(f"{row['task']:10} {row['with']:14} {row['milliseconds']:8.1f} ms")


try:
    import cv2
except ImportError:  # it may lack libraries of the system, too
    cv2 = None
try:
    import open3d
except ImportError:  # it may lack libraries of the system, too
    open3d = None

if __name__ == "__main__":
    main()
