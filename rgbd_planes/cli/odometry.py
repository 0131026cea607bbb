"""``rgbd-planes odometry``."""

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from rgbd_planes.cli.arguments import FIGURES, Run, add_sequence_options, check_outputs, read_sequence, write_figure
from rgbd_planes.cli.progress import progress

if TYPE_CHECKING:
    from rgbd_planes.evaluation.metrics import TrajectoryErrors


def odometry(parser: argparse.ArgumentParser) -> Run:
    """Tell how the camera moves through a data set or a recording.

    example: rgbd-planes odometry rgbd_dataset_freiburg1_xyz --out path.txt
    """
    parser.add_argument("sequence", type=Path, help="data set, folder of depth images, or recording")
    add_sequence_options(parser)
    parser.add_argument("--out", type=Path, metavar="TXT", help="write the poses in TUM's format, which evo reads")
    parser.add_argument(
        "--figure", type=Path, metavar="PNG/PDF/SVG", help="draw the path from above, and how well it is known"
    )
    parser.add_argument(
        "--map", type=Path, metavar="PLY", help="write the outlines of the keyframes' planes as a mesh; needs shapely"
    )

    def run(arguments: argparse.Namespace) -> int:
        import numpy as np

        from rgbd_planes import Odometry
        from rgbd_planes._core.text import counted, percent
        from rgbd_planes.egomotion.plane_map import PlaneMap
        from rgbd_planes.evaluation.metrics import trajectory_errors
        from rgbd_planes.export.segments import write_polygons_ply
        from rgbd_planes.export.trajectories import write_trajectory
        from rgbd_planes.plotting.trajectory import plot_trajectory
        from rgbd_planes.sequences.problems import Problem, in_words, reason_to_skip

        read = [arguments.sequence] + ([arguments.camera] if arguments.camera is not None else [])
        check_outputs(arguments, read, out=(".txt", ".tum"), figure=FIGURES, map=(".ply",))
        plane_map = PlaneMap() if arguments.map is not None else None
        sequence = read_sequence(arguments, arguments.sequence)
        follower = Odometry(sequence.camera)
        poses, truth, problems = [], [], []
        for index in progress(range(len(sequence)), len(sequence), "frames"):
            try:
                frame = sequence[index]
                pose = follower.update(frame)
            except Exception as error:
                problems.append(Problem(index, sequence.names[index], reason_to_skip(error, sequence.names[index])))
                continue
            truth.append(np.full((4, 4), np.nan) if frame.pose is None else frame.pose)
            if plane_map is not None and pose.is_keyframe:
                plane_map.add(pose)
            poses.append(replace(pose, segmentation=cast(Any, None)))  # whose labels would fill the memory
        for line in in_words(problems):
            print(f"rgbd-planes odometry: skipped {line}", file=sys.stderr)
        if not poses:
            raise ValueError("expected a frame that can be read and segmented, got none")
        estimated = np.array([pose.T_world_camera for pose in poses])
        path = np.linalg.norm(np.diff(estimated[:, :3, 3], axis=0), axis=1).sum()
        lost = sum(pose.is_lost for pose in poses)
        keyframes = counted(sum(pose.is_keyframe for pose in poses), "keyframe")
        print(f"{counted(len(poses), 'frame')}, a path of {path:.2f} m, {keyframes}; lost in {lost}.")
        partly = sum(0 < len(pose.unobservable) < 6 for pose in poses)
        if partly:
            print(f"Some direction of the motion is not observed in {percent(partly / len(poses))} of the frames.")
        known = np.isfinite(np.array(truth)).all(axis=(1, 2))
        shown = None
        if np.count_nonzero(known) > 2:
            errors = trajectory_errors(estimated, truth, timestamps=[pose.timestamp for pose in poses])
            print(_in_words(errors))
            shown = np.linalg.inv(errors.T_truth_estimated) @ np.array(truth)
        if arguments.out is not None:
            write_trajectory(arguments.out, poses)
        if plane_map is not None:
            write_polygons_ply(arguments.map, plane_map.polygons)
        if arguments.figure is not None:
            write_figure(plot_trajectory(poses, shown), arguments.figure)
        for written in (arguments.out, arguments.map, arguments.figure):
            if written is not None:
                print(f"Wrote {written}")
        return 1 if problems or lost == len(poses) else 0

    return run


def _in_words(errors: "TrajectoryErrors") -> str:
    """Errors against the poses of the data set."""
    import numpy as np

    lines = [
        f"Against the data set's poses, over {errors.path_length:.2f} m: absolute error "
        f"{1e3 * errors.absolute_rmse:.1f} mm, after alignment."
    ]
    for each in errors.relative:
        if len(each.translation):
            lines.append(
                f"Over {each.over}: median {1e3 * np.median(each.translation):.1f} mm and "
                f"{np.median(each.angle_deg):.2f} degrees, rmse {1e3 * each.translation_rmse:.1f} mm and "
                f"{each.angle_rmse:.2f} degrees."
            )
    return "\n".join(lines)
