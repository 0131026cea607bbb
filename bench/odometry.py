"""How well is the camera's motion known? ``python -m bench.odometry``

Real frames of a Kinect v1 with poses, and the rendered motions of `bench.tracking`. Constants were chosen on rendered
scenes, and with figures of all 300 real frames in view: the 200 after the first 100 are no clean hold-out. The
normalised error squared (NEES) of a pose is δᵀΣ⁻¹δ of its error relative to its keyframe. With six degrees
of freedom its median is 5.3 if covariances are right, and 95 % of single ones are between 1.24 and 14.4.
"""

import sys
import time
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from bench import real_data, tracking
from rgbd_planes import CameraPose, Odometry, open_sequence, segment
from rgbd_planes._core.arrays import Floats
from rgbd_planes.evaluation import scenes
from rgbd_planes.evaluation.metrics import trajectory_errors

REAL, FIRST = "kinect1_7scenes_posed", 100


class Run(NamedTuple):
    """Poses of frames, the true ones, and seconds of this thread for each, beside those of `segment`."""

    poses: list[CameraPose]
    truth: Floats
    seconds: float | None


def nees(poses: list[CameraPose], truth: Floats) -> Floats:
    """Normalised errors squared of those that are not lost; their keyframe's own is known."""
    values = []
    for pose in poses:
        if pose.is_lost or pose.reference == pose.index:
            continue
        true = np.linalg.solve(truth[pose.reference], truth[pose.index])
        off = np.linalg.solve(pose.T_reference_camera, true)
        delta = np.append(Rotation.from_matrix(off[:3, :3]).as_rotvec(), off[:3, 3])
        values.append(float(delta @ np.linalg.solve(pose.covariance, delta)))
    return np.array(values)


def row(name: str, run: Run) -> dict[str, Any]:
    """What is said of a sequence."""
    errors = trajectory_errors([pose.T_world_camera for pose in run.poses], run.truth)
    first = errors.relative[0]
    squares = nees(run.poses, run.truth)
    return {
        "sequence": name,
        "frames": len(run.poses),
        "path": errors.path_length,
        "absolute": errors.absolute_rmse,
        "step": float(np.median(first.translation)),
        "angle": float(np.median(first.angle_deg)),
        "lost": sum(pose.is_lost for pose in run.poses),
        "nees": float(np.median(squares)),
        "seconds": run.seconds,
    }


def real(start: int, stop: int) -> Run:
    """Some of the real frames."""
    sequence = open_sequence(real_data.FOLDER / REAL)[start:stop]
    follower, poses, truth, seconds = Odometry(sequence.camera), [], [], []
    for frame in sequence:
        begin = time.thread_time()
        poses.append(follower.update(frame))
        middle = time.thread_time()
        segment(frame.depth, frame.camera)
        seconds.append(2.0 * middle - begin - time.thread_time())
        assert frame.pose is not None
        truth.append(frame.pose)
    return Run(poses, np.array(truth), float(np.median(seconds)))


def rendered(views: list[tracking.View]) -> Run:
    """A rendered motion."""
    follower, poses, truth = Odometry(tracking.CAMERA), [], []
    for view, (depth, _) in zip(views, tracking.rendered(views), strict=True):
        poses.append(follower.update(depth))
        known = scenes.room(view.eye.tolist(), view.target.tolist()).camera_to_scene
        truth.append(known if view.counts else np.full((4, 4), np.nan))
    return Run(poses, np.array(truth), None)


def measure() -> list[dict[str, Any]]:
    """A row for each sequence."""
    rows = []
    if (real_data.FOLDER / REAL / "camera.json").is_file():
        parts = {"first 100 frames": (0, FIRST), "the other 200": (FIRST, 300), "all": (0, 300)}
        rows += [row(f"Kinect v1, {name}", real(*part)) for name, part in parts.items()]
    return rows + [row(name, rendered(views)) for name, views in tracking.motions().items()]


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as Markdown."""
    lines = ["| the camera | frames | path, m | absolute error, mm | a frame, median | lost | NEES, median |"]
    lines.append("|---|---:|---:|---:|---:|---:|---:|")
    for r in rows:
        step = f"{1e3 * r['step']:.1f} mm, {r['angle']:.2f}°"
        lines.append(
            f"| {r['sequence']} | {r['frames']} | {r['path']:.2f} | {1e3 * r['absolute']:.1f} | {step} | {r['lost']} | "
            f"{r['nees']:.1f} |"
        )
    took = [r["seconds"] for r in rows if r["seconds"] is not None]
    if took:
        lines.append(
            f"\nA real frame takes {1e3 * np.median(took):.1f} ms of one thread beyond `segment`, in the median."
        )
    return "\n".join(lines)


def main() -> int:
    """Print the table."""
    print(table(measure()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
