"""How well is the camera's motion known? ``python -m bench.odometry``

Real frames of a Kinect v1 with poses, and the rendered motions of `bench.tracking`; one more of these with depths that
are bent, as a sensor's lens bends them. Constants were chosen on rendered scenes, and with figures of all 300 real
frames in view: the 200 after the first 100 are no clean hold-out. They were looked at again with the first 100 and bent
depths alone, and stayed. The normalised error squared (NEES) of a pose is δᵀΣ⁻¹δ of its error relative to its keyframe.
With six degrees of freedom its median is 5.3 if covariances are right, and 95 % of single ones are between 1.24 and
14.4.
"""

import sys
import time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from bench import real_data, tracking
from bench.paper import processor
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
        "processor": processor(),
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


def carried() -> list[tracking.View]:
    """A camera that is carried about the room for five seconds."""
    s = np.linspace(0.0, 2.0 * np.pi, 150)
    eyes = tracking.EYE + 0.4 * np.column_stack([np.sin(s), 0.2 * np.sin(2.0 * s), 1.0 - np.cos(s)])
    yaws, pitches = -5.0 + 15.0 * np.sin(1.5 * s), -15.0 + 5.0 * np.sin(2.0 * s)
    return [tracking.View(eye, tracking.ahead(eye, *turn)) for eye, *turn in zip(eyes, yaws, pitches, strict=True)]


def bent(depth: NDArray[Any], share: float) -> NDArray[Any]:
    """Depths that grow by a share from the middle of the image to its left and right edges."""
    x = np.linspace(-1.0, 1.0, depth.shape[1])
    return np.asarray(np.rint(depth * (1.0 + share * x * x)), depth.dtype)


def rendered(views: list[tracking.View], share: float = 0.0) -> Run:
    """A rendered motion, with depths that are bent by a share."""
    follower, poses, truth = Odometry(tracking.CAMERA), [], []
    for view, (depth, _) in zip(views, tracking.rendered(views), strict=True):
        poses.append(follower.update(bent(depth, share)))
        known = scenes.room(view.eye.tolist(), view.target.tolist()).camera_to_scene
        truth.append(known if view.counts else np.full((4, 4), np.nan))
    return Run(poses, np.array(truth), None)


def measure() -> list[dict[str, Any]]:
    """A row for each sequence."""
    rows = []
    if (real_data.FOLDER / REAL / "camera.json").is_file():
        parts = {"first 100 frames": (0, FIRST), "the other 200": (FIRST, 300), "all": (0, 300)}
        rows += [row(f"Kinect v1, {name}", real(*part)) for name, part in parts.items()]
    rows += [row(name, rendered(views)) for name, views in tracking.motions().items()]
    names = {0.0: "carried about", 0.01: "the same, depths bent by 1 %", 0.02: "the same, by 2 %"}
    return rows + [row(name, rendered(carried(), share)) for share, name in names.items()]


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
    timed = [r for r in rows if r["seconds"] is not None]
    if timed:
        took = 1e3 * np.median([r["seconds"] for r in timed])
        lines.append(
            f"\nA real frame takes {took:.1f} ms of one thread beyond `segment`, in the median. Measured on "
            f"{timed[0]['processor']}."
        )
    return "\n".join(lines)


def main() -> int:
    """Print the table."""
    print(table(measure()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
