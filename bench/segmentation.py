"""How good and how fast the segmentation is: ``python -m bench.segmentation``.

Scores it on every labelled set in the folder that ``RGBD_PLANES_DATA`` names, where there is one, and on rendered
scenes with noise and holes; prints tables, and with ``--out`` writes pictures, truth beside result.

The line "cross-validated": the ABW frames are split into folds; for each fold the setting that does best on the
frames of the other folds, out of ``SETTINGS``, is scored on it. They are moved for that, as below: of sixteen frames
alone chance would choose. For the same reason it is the mean over many ways to split them. The defaults, around which
``SETTINGS`` lie, and the rules themselves were found with these frames in view, so the other sets and the rendered
rooms say more. What tells curved surfaces from planes was tuned on the scenes in ``bench.curved_scenes``; how small and
how little bent they may be, on all sets, moved.

The lines "moved": where blocks of pixels fall decides about a region or two of a set. So each frame is scored twelve
times more, moved by 0 to 3 pixels, as it is, mirrored, and transposed: there changes of the rules show that are real.
"""

import argparse
import contextlib
import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from bench import block_scenes, curved_scenes
from bench.fitting import numpy_fit
from bench.real_data import FOLDER as DATA
from bench.timing import in_turns
from rgbd_planes import Camera
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.evaluation import scenes
from rgbd_planes.evaluation.metrics import compare_labels, plane_errors
from rgbd_planes.kernels.segmentation.model.records import Rules
from rgbd_planes.segmentation import segment as segmentation
from rgbd_planes.segmentation.frame_noise import Given
from rgbd_planes.segmentation.segment import segment, segment_frame
from rgbd_planes.sequences.images import read_depth

LABELLED = {
    "ABW": ("abw_segcomp_cal0", "abw_segcomp_cal1"),
    "ICL-NUIM": ("icl_nuim_evops_gt",),
    "NYU, 8 bits, scale unknown": ("nyu_planes_relative8bit",),
    "mOSD, the tables alone": ("mosd_tabletop_a",),
}

MOVED = ("ABW", "ICL-NUIM")

# mOSD's labels from here on are objects of several faces, not planes: the faces count as noise there.
TABLES = 10

FOLDS = 4
PARTITIONS = 1000  # of the frames into folds

SMALL = 200  # pixels

CHANCE = 11.34  # a chi-square of three degrees of freedom is larger in one case of a hundred

# One at a time around the default, for the cross-validation to choose from.
SETTINGS = (
    Rules(),
    *(Rules(bend_deviations=value) for value in (3.5, 4.0, 5.0, 6.0)),
    *(Rules(jump_deviations=value) for value in (4.0, 8.0)),
    *(Rules(reach_deviations=value) for value in (6.0, 7.0, 9.0, 10.0)),
    *(Rules(fit_deviations=value) for value in (2.5, 2.75, 3.25, 3.5)),
    *(Rules(joint_variances=value) for value in (20.0, 45.0)),
    *(Rules(certain_share=value) for value in (0.05, 0.2)),
    *(Rules(least_width=value) for value in (3.2, 3.8, 6.0)),
    *(Rules(rim_deviations=value) for value in (1.7, 2.2, 2.6, np.inf)),
)


@dataclass(frozen=True)
class Frame:
    """A depth frame and the truth about it."""

    name: str
    depth: NDArray[Any]
    camera: Camera
    truth: NDArray[np.int32]
    planes: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Scores:
    """What one segmentation is worth, or several in the mean; rows of these are averaged."""

    regions: float
    correct_80: float
    correct_90: float
    over: float
    under: float
    missed: float
    noise: float
    f_50: float
    f_75: float
    panoptic: float
    covering: float
    information: float
    matched_iou: float


def score(labels: NDArray[np.int32], frame: Frame) -> Scores:
    """Score labels against the truth."""
    comparison = compare_labels(labels, frame.truth)
    hoover = comparison.hoover(0.8)
    half, strict = comparison.detection(0.5), comparison.detection(0.75)
    return Scores(
        regions=len(comparison.truth_labels),
        correct_80=hoover.correct,
        correct_90=comparison.hoover(0.9).correct,
        over=hoover.over_segmented,
        under=hoover.under_segmented,
        missed=hoover.missed,
        noise=hoover.noise,
        f_50=half.f_score,
        f_75=strict.f_score,
        panoptic=half.panoptic_quality,
        covering=comparison.covering,
        information=comparison.variation_of_information,
        matched_iou=half.matched_iou,
    )


def mean(rows: Sequence[Scores], name: str) -> float:
    """Mean of one score."""
    return float(np.mean([getattr(row, name) for row in rows]))


def summary(name: str, rows: Sequence[Scores]) -> dict[str, Any]:
    """Means of scores, and shares of all regions that are correct."""
    regions = sum(row.regions for row in rows)
    means = {key: mean(rows, key) for key in ("regions", "over", "under", "missed", "noise", "f_75")}
    correct = {key: sum(getattr(row, key) for row in rows) / regions for key in ("correct_80", "correct_90")}
    return {"name": name, "frames": len(rows)} | means | correct


def report(title: str, rows: Sequence[Scores]) -> None:
    """Print one line of the table."""
    regions = sum(row.regions for row in rows)
    counts = "  ".join(f"{mean(rows, name):4.2f}" for name in ("over", "under", "missed", "noise"))
    others = "  ".join(
        f"{mean(rows, name):5.3f}" for name in ("f_50", "f_75", "panoptic", "covering", "information", "matched_iou")
    )
    print(
        f"{title:38s} {len(rows):3d}  {regions / len(rows):6.2f}  "
        f"{sum(row.correct_80 for row in rows) / regions:6.1%}  "
        f"{sum(row.correct_90 for row in rows) / regions:6.1%}  {counts}  {others}"
    )


def report_small(labels: Sequence[NDArray[np.int32]], frames: Sequence[Frame]) -> None:
    """Print how many of the small regions are found."""
    regions, found = 0, 0
    for predicted, frame in zip(labels, frames, strict=True):
        comparison = compare_labels(predicted, frame.truth)
        small = comparison.truth_labels[comparison.truth_sizes < SMALL]
        regions += len(small)
        found += int(np.isin(small, comparison.hoover(0.8).correct_pairs[:, 0]).sum())
    print(f"  correct at 80 % of less than {SMALL} pixels: {found} of {regions} regions")


HEADER = f"{'':38s} frames regions  c 80%   c 90%  over  undr  miss  nois  F .5   F .75  PQ     cover  VI     IoU"


def read_set(folder: Path) -> list[Frame]:
    """The labelled frames of one folder."""
    camera = Camera.load(folder / "camera.json")
    frames = []
    for path in sorted((folder / "labels").glob("*.png")):
        truth = read_depth(path).astype(np.int32)
        if folder.name.startswith("mosd"):
            truth[truth >= TABLES] = 0
        frames.append(Frame(f"{folder.name}/{path.stem}", read_depth(folder / "depth" / path.name), camera, truth))
    return frames


def moved(frames: Sequence[Frame]) -> Iterator[Frame]:
    """Frames of pinhole cameras, each moved by 0 to 3 pixels; as it is, mirrored, and transposed."""
    for frame, pixels in itertools.product(frames, range(4)):
        camera = frame.camera
        depth, truth = frame.depth[pixels:, pixels:], frame.truth[pixels:, pixels:]
        height, width = depth.shape
        cx, cy = camera.cx - pixels, camera.cy - pixels
        as_it_is = replace(camera, width=width, height=height, cx=cx, cy=cy)
        yield Frame(frame.name, depth, as_it_is, truth)
        yield Frame(frame.name, depth[:, ::-1], replace(as_it_is, cx=width - 1 - cx), truth[:, ::-1])
        turned = replace(camera, width=height, height=width, fx=camera.fy, fy=camera.fx, cx=cy, cy=cx)
        yield Frame(frame.name, depth.T, turned, truth.T)


def empty_room() -> scenes.Scene:
    """Floor, ceiling, three walls and a board: six planes."""
    x, y, z = 1.6, 1.2, 3.5
    faces = {
        "floor": [(-x, y, 0.1), (x, y, 0.1), (x, y, z), (-x, y, z)],
        "ceiling": [(-x, -y, 0.1), (x, -y, 0.1), (x, -y, z), (-x, -y, z)],
        "left wall": [(-x, -y, 0.1), (-x, y, 0.1), (-x, y, z), (-x, -y, z)],
        "right wall": [(x, -y, 0.1), (x, y, 0.1), (x, y, z), (x, -y, z)],
        "back wall": [(-x, -y, z), (x, -y, z), (x, y, z), (-x, y, z)],
        "board": [(-0.5, -0.3, 2.0), (0.4, -0.3, 2.2), (0.4, 0.5, 2.2), (-0.5, 0.5, 2.0)],
    }
    return scenes.Scene(tuple(scenes.polygon(*face) for face in faces.items()), np.eye(4))


def rendered(scene: scenes.Scene, name: str, holes: float, seeds: int) -> list[Frame]:
    """A scene seen by a Kinect, several times; the truth of a missing pixel is "none"."""
    camera = Camera(width=640, height=480, fx=525.0, fy=525.0, cx=319.5, cy=239.5, depth_scale=1000.0)
    rendering = scene.render(camera)
    frames = []
    for seed in range(seeds):
        depth = rendering.measure(holes=holes, seed=seed)
        truth = np.where(depth > 0, rendering.labels, 0)
        frames.append(Frame(f"{name}, seed {seed}", depth, camera, truth, rendering.planes))
    return frames


def smoothed(scene: scenes.Scene, name: str, pixels: float, seeds: int) -> list[Frame]:
    """A scene seen by a stereo camera that smooths what it matches: neighbours share their errors."""
    camera = Camera(width=640, height=480, fx=385.0, fy=385.0, cx=319.5, cy=239.5, depth_scale=1000.0)
    rendering = scene.render(camera)
    frames = []
    for seed in range(seeds):
        q = 1.0 / rendering.depth + 2e-3 * curved_scenes.errors(rendering.depth, seed, pixels)
        depth = np.rint(1000.0 / q).astype(np.uint16)
        frames.append(Frame(f"{name}, seed {seed}", depth, camera, rendering.labels, rendering.planes))
    return frames


def curved() -> list[Frame]:
    """Scenes with curved things in them, as each kind of sensor measures them."""
    frames = []
    for make in curved_scenes.SCENES:
        for measure, camera in curved_scenes.SENSORS:
            rendering = make().render(camera)
            raw = measure(rendering.depth, 7)
            truth = np.where(raw > 0, rendering.labels, 0).astype(np.int32)
            frames.append(Frame(f"{make.__name__}, {measure.__name__}", raw, camera, truth))
    return frames


def blocks(sensor: block_scenes.Sensor, seeds: int) -> list[Frame]:
    """Random blocks as a sensor measures them."""
    measured = [block_scenes.measure(sensor, seed) for seed in range(seeds)]
    return [
        Frame(f"blocks {i}, {sensor.name}", depth, sensor.camera, truth) for i, (depth, truth) in enumerate(measured)
    ]


def opencv_planes() -> list[Callable[[Frame], NDArray[np.int32]]]:
    """OpenCV 5's ``findPlanes`` by several settings, where it is installed: with and without its own normals."""
    try:
        import cv2
    except ImportError:
        return []
    if not hasattr(cv2, "findPlanes"):
        return []

    def labels(frame: Frame, with_normals: bool, block_size: int, threshold: float) -> NDArray[np.int32]:
        camera = frame.camera
        matrix = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
        with np.errstate(divide="ignore"):
            depth = 1.0 / as_depth_frame(frame.depth, camera).inverse_depth
        depth = np.where(np.isfinite(depth), depth, 0.0).astype(np.float32)
        points = cv2.depthTo3d(depth, matrix)
        points[depth == 0.0] = np.nan
        normals = None
        if with_normals:
            method = cv2.RgbdNormals_RGBD_NORMALS_METHOD_FALS
            normals = cv2.RgbdNormals_create(*depth.shape, cv2.CV_32F, matrix, 5, 50.0, method).apply(points)
        found = cv2.findPlanes(points, normals, block_size=block_size, threshold=threshold)[0]
        return np.where(found == 255, 0, found.astype(np.int32) + 1)

    settings = itertools.product((True, False), (10, 20, 40), (0.01, 0.03))  # metres; 40 and 0.01 are its defaults
    return [
        partial(labels, with_normals=normals, block_size=size, threshold=threshold)
        for normals, size, threshold in settings
    ]


def best_of(peers: Sequence[Callable[[Frame], NDArray[np.int32]]], frames: Sequence[Frame]) -> list[Scores]:
    """Scores of the setting that finds most regions of these very frames at 80 %."""
    return max(
        ([score(peer(frame), frame) for frame in frames] for peer in peers),
        key=lambda rows: float(summary("", rows)["correct_80"]),
    )


def cross_validate(frames: Sequence[Frame]) -> list[Scores]:
    """Mean scores of every frame with the setting that does best on the frames of the other folds, moved."""
    everything = range(len(frames))
    worth = np.array(
        [[sum(_worth(_by_rules(of, rules)) for of in moved([frame])) for rules in SETTINGS] for frame in frames]
    )
    scores = np.array([[astuple(_by_rules(frame, rules)) for rules in SETTINGS] for frame in frames])
    often = np.zeros(worth.shape)  # each setting is the best for a frame
    shares = []  # of regions that are correct at 80 %
    rng = np.random.default_rng(1)
    for _ in range(PARTITIONS):
        fold = rng.permutation(len(frames)) % FOLDS
        best = np.array([worth[fold != of].sum(axis=0).argmax() for of in fold])
        often[everything, best] += 1.0 / PARTITIONS
        rows = [Scores(*row) for row in scores[everything, best]]
        shares.append(summary("", rows)["correct_80"])
    low, high = np.quantile(shares, (0.05, 0.95))
    print(f"  correct at 80 % in nine of ten ways to split the frames: {low:.1%} to {high:.1%}; with")
    for i in np.argsort(-often.mean(axis=0))[:4]:
        print(f"    {_difference(SETTINGS[i])}: {often[:, i].mean():.0%}")
    return [Scores(*row) for row in np.einsum("fs,fsk->fk", often, scores)]


def _worth(row: Scores) -> float:
    """Correct regions at both tolerances, less the wrong ones."""
    return row.correct_80 + row.correct_90 - row.noise - row.over - row.under


def _difference(rules: Rules) -> str:
    changed = [
        f"{name} {getattr(rules, name)}" for name in Rules._fields if getattr(rules, name) != getattr(Rules(), name)
    ]
    return ", ".join(changed) or "as shipped"


def _by_rules(frame: Frame, rules: Rules) -> Scores:
    found = segment_frame(as_depth_frame(frame.depth, frame.camera), frame.camera, Given(), 60, rules)
    return score(found.labels, frame)


STAGES = {
    "read, blocks": "read_frame", "noise": "noise_of", "regions": "find_regions", "curved": "find_curved",
    "planes and labels": "_find_planes",
}  # fmt: skip


def timing(frames: Sequence[Frame], vga: Frame, rounds: int = 40) -> dict[str, Any]:
    """Times of frames of one size, their mean, and of NumPy's fits of the bench of tiles, in turns.

    Milliseconds at best, and ratios; also the ratio to the fit of a frame of 640 x 480, of which that bench is.
    """
    runs: dict[str | int, Callable[[], object]] = {
        name: numpy_fit(frame.depth, frame.camera, 20, "pca") for name, frame in (("own", frames[0]), ("vga", vga))
    }
    runs |= {i: partial(segment, frame.depth, frame.camera) for i, frame in enumerate(frames)}
    times = in_turns(runs, rounds)
    fastest = float(np.mean([times[i].fastest for i in range(len(frames))]))
    return {
        "frame": frames[0].name,
        "frames": len(frames),
        "size": f"{frames[0].depth.shape[1]} x {frames[0].depth.shape[0]}",
        "segment": 1e3 * fastest,
        "numpy": 1e3 * times["own"].fastest,
        "ratio": fastest / times["own"].fastest,
        "of_medians": float(np.mean([times[i].median for i in range(len(frames))])) / times["own"].median,
        "of_vga": fastest / times["vga"].fastest,
    }


def report_time(frames: Sequence[Frame], vga: Frame, rounds: int = 40) -> None:
    """Print them, and what each stage takes of the first frame."""
    found = timing(frames, vga, rounds)
    print(
        f"{found['frame']}{_and_others(frames)}: {found['size']}: segment {found['segment']:.2f} ms, "
        f"NumPy, PCA of 20x20 tiles {found['numpy']:.2f} ms at best; "
        f"ratio {found['ratio']:.2f}, of the medians {found['of_medians']:.2f}; "
        f"to NumPy's 640 x 480 {found['of_vga']:.2f}"
    )
    spent = stage_times(frames[0], rounds)
    rest = spent.pop("all") - sum(spent.values())
    stages = (f"{stage} {1e3 * seconds:.2f}" for stage, seconds in (spent | {"between": rest}).items())
    print(f"  {frames[0].name}, ms at best: " + ", ".join(stages))


def _and_others(frames: Sequence[Frame]) -> str:
    return f" and {len(frames) - 1} others, mean" if len(frames) > 1 else ""


def stage_times(frame: Frame, rounds: int) -> dict[str, float]:
    """Seconds that each stage takes at best, and "all" of them with what is between."""
    spent = {stage: np.zeros(rounds) for stage in (*STAGES, "all")}

    def timed(function: Callable[..., Any], stage: str) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            start = time.thread_time()
            result = function(*arguments)
            spent[stage][turn] += time.thread_time() - start
            return result

        return call

    with contextlib.ExitStack() as patches:
        for stage, name in STAGES.items():
            patches.enter_context(mock.patch.object(segmentation, name, timed(getattr(segmentation, name), stage)))
        whole = timed(lambda: segment(frame.depth, frame.camera), "all")
        for turn in range(rounds):  # noqa: B007 - `call` reads it
            whole()
    return {stage: float(seconds.min()) for stage, seconds in spent.items()}


def picture(frames: Sequence[Frame], path: Path) -> None:
    """Truth beside result."""
    from matplotlib.figure import Figure

    from rgbd_planes.plotting.colours import NO_PLANE, label_colours

    figure = Figure((8.0, 3.1 * len(frames)), layout="constrained")
    panels = figure.subfigures(len(frames), 2, squeeze=False)
    for (left, right), frame in zip(panels, frames, strict=True):
        found = segment(frame.depth, frame.camera)
        _, truth = np.unique(np.append(0, frame.truth), return_inverse=True)
        colours = np.vstack([[NO_PLANE], label_colours(int(truth.max()))])
        axes = left.add_subplot()
        axes.imshow(colours[truth[1:].reshape(frame.truth.shape)], interpolation="nearest")
        axes.set_title(f"{frame.name}: truth, {truth.max()} planes")
        axes.set_xticks([])
        axes.set_yticks([])
        found.plot(frame.depth, right)
    figure.savefig(path, dpi=90)


def labelled_sets() -> Iterator[tuple[str, list[Frame]]]:
    """Every labelled set that is there."""
    for name, folders in LABELLED.items():
        frames = [frame for folder in folders if (DATA / folder).is_dir() for frame in read_set(DATA / folder)]
        if frames:
            yield name, frames
        else:
            print(f"{name}: not found in {DATA.parent.name}/{DATA.name}, skipped")


def rendered_sets() -> Iterator[tuple[str, list[Frame]]]:
    """Rooms of planes alone, as sensors measure them."""
    yield "room, 6 planes, 5 % holes", rendered(empty_room(), "empty room", 0.05, 5)
    yield "room, 6 planes, no holes", rendered(empty_room(), "empty room, no holes", 0.0, 5)
    yield "furnished room, 24 planes, 5 % holes", rendered(scenes.room(), "room", 0.05, 5)
    for pixels in (2.5, 4.0):
        name = f"furnished room, errors smoothed by {pixels:g}"
        yield name, smoothed(scenes.room(), name, pixels, 5)
    for sensor in block_scenes.SENSORS:
        yield f"random blocks, {sensor.name}", blocks(sensor, 20)


def measure() -> dict[str, Any]:
    """The scores and times of docs/measured.md."""
    peers = opencv_planes()
    rows = []
    labelled = {name: frames for name, frames in labelled_sets() if name in MOVED}
    for name, frames in (labelled | dict(rendered_sets())).items():
        own = [score(segment(frame.depth, frame.camera).labels, frame) for frame in frames]
        rows.append(summary(name, own))
        if name == "ABW":
            rows.append(summary("ABW, cross-validated", cross_validate(frames)))
        if name in MOVED:
            of_moved = [score(segment(frame.depth, frame.camera).labels, frame) for frame in moved(frames)]
            rows.append(summary(f"{name}, moved", of_moved))
        if peers:
            rows.append(summary("OpenCV `findPlanes`", best_of(peers, frames)))
    name, rooms = next(rendered_sets())
    times = [timing(frames, rooms[0]) | {"frame": key} for key, frames in (labelled | {name: rooms}).items()]
    return {"scores": rows, "times": times}


def table(results: dict[str, Any]) -> str:
    """The scores and times as Markdown."""
    lines = ["| frames | regions | correct at 80 % | at 90 % | over | under | missed | noise | F at IoU .75 |"]
    lines.append("|---|---:|---:|---:|---:|---:|---:|---:|---:|")
    for row in results["scores"]:
        counts = " | ".join(f"{row[name]:.2f}" for name in ("over", "under", "missed", "noise"))
        lines.append(
            f"| {row['name']} | {row['frames']} x {row['regions']:.4g} | {row['correct_80']:.1%} "
            f"| {row['correct_90']:.1%} | {counts} | {row['f_75']:.3f} |"
        )
    lines += [
        "",
        "| one core, the fastest of 40, mean of the frames | ms | NumPy's PCA of their 20 x 20 tiles = 1 "
        "| of 640 x 480 = 1 |",
    ]
    lines.append("|---|---:|---:|---:|")
    for row in results["times"]:
        figures = f"{row['segment']:.1f} | {row['ratio']:.2f} | {row['of_vga']:.2f}"
        lines.append(f"| {row['frame']}, {row['frames']} x {row['size']} | {figures} |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run everything."""
    parser = argparse.ArgumentParser(prog="python -m bench.segmentation", description=__doc__)
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="write pictures there")
    parser.add_argument("--no-cross-validation", action="store_true", help="only the rules as shipped")
    options = parser.parse_args(arguments)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)

    sets = [*labelled_sets(), *rendered_sets(), ("curved things, five kinds of sensor", curved())]
    peers = opencv_planes()
    print(HEADER)
    for name, frames in sets:
        labels = [segment(frame.depth, frame.camera).labels for frame in frames]
        report(name, [score(predicted, frame) for predicted, frame in zip(labels, frames, strict=True)])
        if name == "ABW":
            report_small(labels, frames)
        if name == "ABW" and not options.no_cross_validation:
            report("ABW, cross-validated", cross_validate(frames))
        if name in MOVED:
            rows = [score(segment(frame.depth, frame.camera).labels, frame) for frame in moved(frames)]
            report(f"{name}, moved", rows)
        if peers:
            report("  OpenCV findPlanes", best_of(peers, frames))
        if options.out:
            file = "".join(c if c.isalnum() else "_" for c in name.lower())
            picture(frames[:10], options.out / f"{file}.png")
    print()
    for name, frames in sets:
        if frames[0].planes is not None:
            report_planes(name, frames)
    print()
    rooms = next(frames for name, frames in sets if name.startswith("room"))
    for frames in {id(frames): frames for frames in (sets[0][1], rooms)}.values():
        report_time(frames, rooms[0])


def report_planes(name: str, frames: Sequence[Frame]) -> None:
    """Errors of the planes that were found, against the rendered ones, and against what they should be."""
    angles: list[float] = []
    offsets: list[float] = []
    squares: list[float] = []  # of errors of α in their covariance
    for frame in frames:
        assert frame.planes is not None
        found = segment(frame.depth, frame.camera)
        truth, own = compare_labels(found.labels, frame.truth).detection(0.5).pairs.T
        errors = plane_errors(found.planes[own - 1], frame.planes[truth - 1])
        angles += errors.angle_deg.tolist()
        offsets += np.abs(errors.offset).tolist()
        d = frame.planes[truth - 1, 3:]
        alpha = (found.alpha[own - 1] + frame.planes[truth - 1, :3] / d)[..., None]
        covariance = found.alpha_covariance[own - 1]
        squares += (alpha.mT @ np.linalg.solve(covariance, alpha)).ravel().tolist()
    angle, offset = (np.quantile(values, (0.5, 0.9)) for values in (angles, 1e3 * np.array(offsets)))
    print(
        f"{name}: {len(angles)} planes, angle median {angle[0]:.3f}°, 90 % {angle[1]:.3f}°; "
        f"offset median {offset[0]:.2f} mm, 90 % {offset[1]:.2f} mm; squared errors in their covariance: median "
        f"{np.median(squares):.2f} (χ²: 2.37), {np.mean(np.array(squares) > CHANCE):.0%} beyond what 1 % would be"
    )


if __name__ == "__main__":
    main()
