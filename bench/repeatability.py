"""Which planes are there, and which does noise make? ``python -m bench.repeatability``

Of consecutive frames of real sequences, whose truth nobody knows: a plane is seen again if a plane of the next frame
overlaps it with an IoU of half or more, as the frames are and after the common shift of the image by which most are.
Pairs that begin with frame 0, 4, 8, ... are those to tune on, the others are held out. The least evidence of a plane
was chosen with all pairs of the RealSense and of the 35 frames of 7-Scenes in view, and with few of the 300 frames.

Of rendered rooms the truth is known: a stereo camera's errors, smooth over 4, 8 and 16 pixels, with outliers and holes
at edges; a plane that is no true plane's best match, at an IoU of half, is false. And a time-of-flight camera whose
bias bends everything by 20 mm: how much of walls, floor and ceiling is in one label.
"""

import sys
from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, gaussian_filter

from bench.curved_scenes import errors
from bench.real_data import FOLDER, needed
from bench.segmentation import empty_room, labelled_sets, score, summary
from rgbd_planes import Camera, segment
from rgbd_planes.evaluation import scenes
from rgbd_planes.evaluation.metrics import compare_labels
from rgbd_planes.sequences.images import read_depth

Labels = NDArray[np.int32]

HALF = 0.5  # least IoU
FARTHEST, COARSE = 40, 4  # pixels by which images are shifted at most, and in what steps at first
SIZES = (0, 200, 500, 1000, 5000)  # pixels from which on planes are of the next kind


class Sequence(NamedTuple):
    """Pairs of consecutive frames of a data set, each by its first."""

    name: str
    folder: str
    first: tuple[int, ...]


SEQUENCES = (
    Sequence("RealSense raw, robot still", "realsense_d4xx_raw_seq", tuple(range(13))),
    Sequence("RealSense raw, robot moving", "realsense_d4xx_raw_seq", tuple(range(14, 39))),
    Sequence("Kinect v1, 7-Scenes", "kinect1_7scenes_seq", tuple(range(34))),
    Sequence("Kinect v1, 7-Scenes, 300 frames", "kinect1_7scenes_posed", tuple(range(0, 298, 6))),
)


def is_to_tune(first: int) -> bool:
    """Whether the pair that begins with this frame is one to tune on."""
    return first % 4 == 0


def overlaps(one: Labels, other: Labels) -> NDArray[np.float64]:
    """IoU of each label of one image with each of another, without label 0."""
    rows, columns = int(one.max()) + 1, int(other.max()) + 1
    both = np.bincount(one.ravel().astype(np.int64) * columns + other.ravel(), minlength=rows * columns)
    shared = both.reshape(rows, columns)
    either = shared.sum(axis=1)[:, None] + shared.sum(axis=0) - shared
    return np.asarray((shared / np.maximum(either, 1))[1:, 1:])


def shifted(one: Labels, other: Labels, down: int, right: int) -> tuple[Labels, Labels]:
    """What two images have in common if the first is moved up and to the left by so many pixels."""
    height, width = one.shape
    rows = slice(max(down, 0), height + min(down, 0)), slice(max(-down, 0), height + min(-down, 0))
    columns = slice(max(right, 0), width + min(right, 0)), slice(max(-right, 0), width + min(-right, 0))
    return one[rows[0], columns[0]], other[rows[1], columns[1]]


def seen_again(one: Labels, other: Labels, down: int, right: int, step: int = 1) -> NDArray[np.intp]:
    """Which labels of one image another one has again; only every ``step``-th pixel is looked at."""
    a, b = shifted(one, other, down, right)
    return np.flatnonzero((overlaps(a[::step, ::step], b[::step, ::step]) >= HALF).any(axis=1)) + 1


def best_shift(one: Labels, other: Labels) -> tuple[int, int]:
    """The common shift after which most labels are seen again, of several the smallest."""

    def best(shifts: list[tuple[int, int]], step: int) -> tuple[int, int]:
        return max(shifts, key=lambda by: (len(seen_again(one, other, by[0], by[1], step)), -(by[0] ** 2) - by[1] ** 2))

    coarse = range(-FARTHEST, FARTHEST + 1, COARSE)
    down, right = best([(y, x) for y in coarse for x in coarse], COARSE)
    near = range(1 - COARSE, COARSE)
    return best([(down + y, right + x) for y in near for x in near], 2)


@cache
def _segmented(folder: str, number: int) -> tuple[Labels, NDArray[np.int32]]:
    """Labels and sizes of a frame's planes."""
    found = segment(read_depth(_paths(folder)[number]), Camera.load(FOLDER / folder / "camera.json"))
    return found.labels, found.sizes


@cache
def _paths(folder: str) -> list[Any]:
    place = FOLDER / folder
    found = list(place.glob("*.depth.png")) or list((place / "depth").glob("*.png"))
    return sorted(found, key=lambda path: (len(path.stem), path.stem))


def pairs(sequence: Sequence) -> list[dict[str, Any]]:
    """Of each pair: the sizes of the first one's planes, and which are seen again, shifted and as they are."""
    rows = []
    for first in sequence.first:
        (one, sizes), (other, _) = _segmented(sequence.folder, first), _segmented(sequence.folder, first + 1)
        row: dict[str, Any] = {"first": first, "sizes": sizes}
        for name, by in (("shifted", best_shift(one, other)), ("as they are", (0, 0))):
            row[name] = np.isin(np.arange(1, len(sizes) + 1), seen_again(one, other, by[0], by[1]))
        rows.append(row)
    return rows


def repeatability(rows: list[dict[str, Any]], least: int = 0, most: float = np.inf) -> dict[str, float]:
    """Planes a frame of some sizes, how many are seen again, and what share that is."""
    chosen = [(row["sizes"] >= least) & (row["sizes"] < most) for row in rows]
    planes = sum(int(kept.sum()) for kept in chosen)
    again, still = (
        sum(int((row[name] & kept).sum()) for row, kept in zip(rows, chosen, strict=True))
        for name in ("shifted", "as they are")
    )
    count = max(len(rows), 1)
    return {
        "planes": planes / count,
        "again": again / count,
        "share": again / max(planes, 1),
        "share_as_they_are": still / max(planes, 1),
    }


STEREO = Camera(width=640, height=480, fx=385.0, fy=385.0, cx=319.5, cy=239.5, depth_scale=1000.0)
TIME_OF_FLIGHT = Camera(width=512, height=424, fx=365.0, fy=365.0, cx=255.5, cy=211.5, depth_scale=1000.0)


def stereo(depth: NDArray[np.float64], seed: int, smooth: float) -> NDArray[np.uint16]:
    """Depth in millimetres with errors smooth over so many pixels, the same in 1/Z at all depths.

    One spot in a thousand pixels is an outlier of 3 pixels' radius, and of pixels near edges half are missing.
    """
    rng = np.random.default_rng(seed)
    q = 1.0 / depth
    measured = np.maximum(q + 2e-3 * errors(depth, seed, smooth), 0.05)
    spots = gaussian_filter((rng.random(depth.shape) < 1e-4).astype(float), 3.0) > 5e-3
    measured[spots] *= rng.uniform(0.5, 1.5)
    edge = np.abs(np.diff(q, axis=1, append=q[:, -1:])) + np.abs(np.diff(q, axis=0, append=q[-1:])) > 0.02
    missing = binary_dilation(edge, iterations=4) & (gaussian_filter(rng.standard_normal(depth.shape), 2.0) > 0.0)
    return np.asarray(np.where(missing, 0.0, np.rint(1000.0 / measured)), dtype=np.uint16)


def false_planes(smooth: float, frames: int = 5) -> dict[str, float]:
    """True planes a frame that are found, of how many, and false ones, in the furnished room."""
    rendering = scenes.room().render(STEREO)
    count = {"true": 0, "found": 0, "false": 0}
    for seed in range(frames):
        depth = stereo(rendering.depth, seed, smooth)
        truth = np.where(depth > 0, rendering.labels, 0).astype(np.int32)
        found = segment(depth, STEREO)
        comparison = compare_labels(found.labels, truth)
        matched = len(comparison.detection(HALF).pairs)
        count["true"] += len(comparison.truth_labels)
        count["found"] += matched
        count["false"] += len(found) - matched
    return {name: value / frames for name, value in count.items()}


def bent(depth: NDArray[np.float64], seed: int, noise: float) -> NDArray[np.uint16]:
    """Depth in millimetres with a smooth bias of 20 mm over the image, and noise of so many metres at 2 m."""
    rng = np.random.default_rng(seed)
    y, x = np.indices(depth.shape) / np.array(depth.shape)[:, None, None]
    phase = rng.uniform(0.0, 2.0 * np.pi, 2)
    bias = 0.01 * np.sin(1.5 * 2.0 * np.pi * x + phase[0]) * np.cos(1.2 * 2.0 * np.pi * y + phase[1])
    wide = gaussian_filter(depth, 0.4)  # pixels that mix what is near and far
    return np.asarray(
        np.rint(1000.0 * (wide + bias + 0.25 * noise * depth**2 * rng.standard_normal(depth.shape))), np.uint16
    )


def in_one_label(noise: float, frames: int = 4) -> dict[str, float]:
    """Share of the pixels of walls, floor and ceiling that each one's largest label has; and that of the back wall."""
    shares = {"all": [], "back wall": []}  # type: dict[str, list[float]]
    for scene in (empty_room(), scenes.room()):
        rendering = scene.render(TIME_OF_FLIGHT)
        for seed in range(frames):
            labels = segment(bent(rendering.depth, seed, noise), TIME_OF_FLIGHT).labels
            pixels = largest = 0
            for number, name in enumerate(rendering.names):
                if name in ("floor", "ceiling") or name.endswith("wall"):
                    inside = np.bincount(labels[rendering.labels == number + 1], minlength=2)
                    pixels += int(inside.sum())
                    largest += int(inside[1:].max())
                    if name == "back wall":
                        shares["back wall"].append(inside[1:].max() / inside.sum())
            shares["all"].append(largest / pixels)
    return {name: float(np.mean(values)) for name, values in shares.items()}


def measure() -> dict[str, Any]:
    """The rows of the tables."""
    needed(sorted({sequence.folder for sequence in SEQUENCES}))
    again, sizes = [], []
    for sequence in SEQUENCES:
        rows = pairs(sequence)
        for half, name in ((True, "to tune on"), (False, "held out")):
            chosen = [row for row in rows if is_to_tune(row["first"]) == half]
            again.append({"name": sequence.name, "half": name, "pairs": len(chosen), **repeatability(chosen)})
        for least, most in zip(SIZES, (*SIZES[1:], np.inf), strict=True):
            sizes.append({"name": sequence.name, "least": least, **repeatability(rows, least, most)})
    return {
        "again": again,
        "sizes": sizes,
        "rendered": [{"smooth": pixels, **false_planes(pixels)} for pixels in (4.0, 8.0, 16.0)],
        "bent": [{"noise": 1e3 * noise, **in_one_label(noise)} for noise in (1e-3, 2e-3, 4e-3)],
        "labelled": [
            summary(name, [score(segment(frame.depth, frame.camera).labels, frame) for frame in frames])
            for name, frames in labelled_sets()
        ],
    }


def table(results: dict[str, Any]) -> str:
    """The rows as Markdown."""
    return "\n\n".join("\n".join(lines) for lines in _tables(results))


def _tables(results: dict[str, Any]) -> Iterator[list[str]]:
    yield [
        "| sequence | pairs | planes a frame | seen again | how many | without the shift |",
        "|---|---|---:|---:|---:|---:|",
        *(
            f"| {row['name']} | {row['pairs']} {row['half']} | {row['planes']:.0f} | {row['share']:.0%} "
            f"| {row['again']:.1f} | {row['share_as_they_are']:.0%} |"
            for row in results["again"]
        ),
    ]
    names = list(dict.fromkeys(row["name"] for row in results["sizes"]))
    yield [
        "| planes a frame, and the share that is seen again: pixels from | " + " | ".join(names) + " |",
        "|---:|" + "---:|" * len(names),
        *(
            f"| {least} | "
            + " | ".join(f"{r['planes']:.1f}, {r['share']:.0%}" for r in results["sizes"] if r["least"] == least)
            + " |"
            for least in SIZES
        ),
    ]
    yield [
        "| furnished room, stereo's errors smooth over pixels | true planes | found | false |",
        "|---:|---:|---:|---:|",
        *(
            f"| {row['smooth']:g} | {row['true']:.1f} | {row['found']:.1f} | {row['false']:.1f} |"
            for row in results["rendered"]
        ),
    ]
    yield [
        "| rooms bent by 20 mm, noise at 2 m in mm | walls, floor and ceiling in one label each | the back wall |",
        "|---:|---:|---:|",
        *(f"| {row['noise']:g} | {row['all']:.0%} | {row['back wall']:.0%} |" for row in results["bent"]),
    ]
    yield [
        "| labelled frames | correct at 80 % | at 90 % | over | under | noise |",
        "|---|---:|---:|---:|---:|---:|",
        *(
            f"| {row['name']} | {row['correct_80']:.1%} | {row['correct_90']:.1%} | {row['over']:.2f} "
            f"| {row['under']:.2f} | {row['noise']:.2f} |"
            for row in results["labelled"]
        ),
    ]


def main() -> int:
    """Print the tables."""
    print(table(measure()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
