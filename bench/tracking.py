"""Do planes keep their ids through a sequence? ``python -m bench.tracking``

A camera with a Kinect's noise, missing pixels and shadows moves through the rendered room. A surface is seen where it
and a plane share half of all pixels that are either's, and then has the plane's id.
"""

import sys
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rgbd_planes import Camera, segment_sequence
from rgbd_planes._core.arrays import Floats
from rgbd_planes.evaluation import scenes
from rgbd_planes.evaluation.metrics import compare_labels

CAMERA = Camera(width=320, height=240, fx=262.5, fy=262.5, cx=159.5, cy=119.5, depth_scale=1000.0)
EYE, TARGET = np.array([0.35, -1.5, -0.2]), np.array([-0.12, -0.8, 2.6])
LARGE = 1500  # pixels


class View(NamedTuple):
    """Where the camera is, where it looks, and what there is beside the room; whether surfaces count as seen there."""

    eye: Floats
    target: Floats
    passing: tuple[scenes.Surface, ...] = ()
    counts: bool = True


def beside(point: Floats, x: float, y: float, z: float) -> Floats:
    """A point so many metres away from another one."""
    return np.asarray(point + np.array([x, y, z]))


def ahead(eye: Floats, yaw: float, pitch: float = -15.0) -> Floats:
    """A target in a direction, in degrees."""
    y, p = np.radians([yaw, pitch])
    return beside(eye, 2.0 * np.sin(y) * np.cos(p), -2.0 * np.sin(p), 2.0 * np.cos(y) * np.cos(p))


def turning(step: float) -> list[View]:
    """A turn by 60 degrees and back."""
    there = np.arange(-30.0, 30.0, step)
    return [View(EYE, ahead(EYE, yaw)) for yaw in (*there, *-there)]


def shaking(step: float, angle: float) -> list[View]:
    """A camera in the hand: at random about one pose."""
    rng = np.random.default_rng(0)
    steps, angles = step * rng.standard_normal((50, 3)), angle * rng.standard_normal((50, 2))
    eyes = EYE + steps
    return [View(eye, ahead(eye, yaw - 10.0, pitch - 15.0)) for eye, (yaw, pitch) in zip(eyes, angles, strict=True)]


def person(i: int) -> tuple[scenes.Surface, ...]:
    """A box that walks by."""
    return scenes.box("person", (0.06 * i - 1.6, -0.2, 1.3), (0.45, 1.5, 0.3))


def elsewhere(i: int) -> View:
    """From another place in the room, in another direction: at random."""
    rng = np.random.default_rng(i)
    eye = beside(EYE, *rng.uniform([-1.0, -0.2, 0.2], [1.0, 0.5, 2.0]))
    return View(eye, ahead(eye, rng.uniform(0.0, 360.0)), counts=False)


def motions() -> dict[str, list[View]]:
    """The sequences."""
    walk, side, orbit = range(50), np.sin(np.arange(50) / 16.0), np.radians(np.arange(-30.0, 31.0, 2.0))
    swing = np.sin(np.pi * np.arange(50) / 24.0)
    return {
        "a step of 1.4 cm a frame": [View(beside(EYE, -0.01 * i, 0.0, 0.01 * i), TARGET) for i in walk],
        "sideways, to 5 cm a frame": [
            View(beside(EYE, 0.8 * s, 0.0, 0.0), beside(TARGET, 0.8 * s, 0.0, 0.0)) for s in side
        ],
        "about a point, 2° a frame": [
            View(beside(TARGET, 2.6 * np.sin(a), -0.7, -2.6 * np.cos(a)), TARGET) for a in orbit
        ],
        "a turn of 60° and back, 1° a frame": turning(1.0),
        "the same, 3° a frame": turning(3.0),
        "the same, 5° a frame": turning(5.0),
        "the same, 8° a frame": turning(8.0),
        "up by 40° and back, to 5° a frame": [View(EYE, ahead(EYE, -10.0, -15.0 + 40.0 * s)) for s in swing],
        "in the hand, 1.5 cm and 1.5° about a pose": shaking(0.015, 1.5),
        "in the hand, 3 cm and 4°": shaking(0.03, 4.0),
        "still, somebody passes": [View(EYE, TARGET, person(i)) for i in walk],
        "still, every fifth frame of another place": [View(EYE, TARGET) if i % 5 < 4 else elsewhere(i) for i in walk],
        "a turn of 1° a frame, somebody passes": [View(EYE, ahead(EYE, i - 25.0), person(i)) for i in walk],
    }


def rendered(views: list[View]) -> Iterator[tuple[NDArray[Any], scenes.Rendering]]:
    """Depth as measured, and the truth."""
    for i, view in enumerate(views):
        room = scenes.room(view.eye.tolist(), view.target.tolist())
        rendering = scenes.Scene(room.surfaces + view.passing, room.camera_to_scene).render(CAMERA)
        yield rendering.measure(holes=0.03, patches=0.04, baseline=scenes.KINECT_BASELINE, seed=i), rendering


def changes(views: list[View]) -> dict[str, int]:
    """How often surfaces are seen, and how often with another id than before; the same of large ones; and all ids."""
    frames = list(rendered(views))
    last: dict[str, int] = {}
    count = {"seen": 0, "changed": 0, "large": 0, "large_changed": 0}
    tracked = segment_sequence((depth for depth, _ in frames), CAMERA)
    for view, (_, rendering), found in zip(views, frames, tracked, strict=True):
        if not view.counts:
            continue
        sizes = np.bincount(rendering.labels.ravel())
        for truth, own in compare_labels(found.labels, rendering.labels).detection(0.5).pairs.tolist():
            name = rendering.names[truth - 1]
            changed = last.get(name, own) != own
            last[name] = own
            count["seen"] += 1
            count["changed"] += changed
            count["large"] += bool(sizes[truth] >= LARGE)
            count["large_changed"] += bool(changed and sizes[truth] >= LARGE)
    return {"frames": len(frames), "surfaces": len(last), **count}


def measure() -> list[dict[str, Any]]:
    """A row for each motion."""
    return [{"motion": name, **changes(views)} for name, views in motions().items()]


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as Markdown."""
    lines = ["| the camera | frames | surfaces | seen | with another id | large ones seen | with another id |"]
    lines.append("|---|---:|---:|---:|---:|---:|---:|")
    keys = ("frames", "surfaces", "seen", "changed", "large", "large_changed")
    lines += [f"| {row['motion']} | " + " | ".join(str(row[key]) for key in keys) + " |" for row in rows]
    return "\n".join(lines)


def main() -> int:
    """Print the table."""
    print(table(measure()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
