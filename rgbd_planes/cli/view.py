"""``rgbd-planes view``."""

import argparse
import contextlib
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING

from rgbd_planes._core.text import counted
from rgbd_planes.cli.arguments import (
    CommandError,
    Run,
    add_min_size,
    add_sequence_options,
    camera_of,
    check_outputs,
    read_sequence,
)

if TYPE_CHECKING:
    from rgbd_planes.export.live import LiveView
    from rgbd_planes.sequences import FrameSequence
    from rgbd_planes.sequences.problems import Problem


def view(parser: argparse.ArgumentParser) -> Run:
    """Show depth, planes, outlines, curvature and the camera's path in a browser, for a frame or a sequence.

    example: rgbd-planes view rgbd_dataset_freiburg1_xyz

    The camera's path is the data set's, or else estimated from planes and tiles.
    Needs pip install "rgbd-planes[viewer]". Ctrl-C ends it. On another machine
    than the browser, forward the two ports:
    ssh -L 9090:localhost:9090 -L 9876:localhost:9876 robot
    """
    parser.add_argument(
        "path", type=Path, help="depth image, which needs --camera; or data set, folder of depth images, or recording"
    )
    add_sequence_options(parser)
    add_min_size(parser)
    parser.add_argument("--count", type=int, default=300, metavar="N", help="show N frames at most (300)")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="take every Nth frame (1)")
    parser.add_argument("--no-browser", action="store_true", help="open no browser: print the address, and wait")
    parser.add_argument(
        "--out", type=Path, metavar="RRD", help="write a file instead, which rerun FILE shows: no browser, no waiting"
    )

    def run(arguments: argparse.Namespace) -> int:
        from rgbd_planes import LiveView

        for option in ("count", "every"):
            if getattr(arguments, option) < 1:
                raise CommandError(f"--{option} must be at least 1, got {getattr(arguments, option)}")
        read = [path for path in (arguments.path, arguments.camera) if path is not None]
        check_outputs(arguments, read, out=(".rrd",))
        sequence = _sequence(arguments)[:: arguments.every][: arguments.count]
        if arguments.out is not None:
            from rgbd_planes._core.files import write_beside

            with write_beside(arguments.out, ".rrd") as beside, LiveView(beside) as live:
                problems = _show(live, sequence, arguments.min_size)
            print(f"Wrote {arguments.out}")
        else:
            with LiveView("browser", open_browser=not arguments.no_browser) as live:
                print(f"Open {live.url}", flush=True)
                problems = _show(live, sequence, arguments.min_size)
                print("That is all. Ctrl-C ends it.", flush=True)
                with contextlib.suppress(KeyboardInterrupt):  # the usual end
                    threading.Event().wait()
        return 1 if problems else 0

    return run


def _sequence(arguments: argparse.Namespace) -> "FrameSequence":
    """The one depth image, or the frames of the data set or recording."""
    from rgbd_planes.sequences.frames import image_sequence
    from rgbd_planes.sequences.images import DEPTH_SUFFIXES

    path: Path = arguments.path
    if path.suffix.lower() not in DEPTH_SUFFIXES or path.is_dir():
        return read_sequence(arguments, path)
    for option in ("format", "topic"):
        if getattr(arguments, option) is not None:
            raise CommandError(f"--{option} is for a data set or a recording, got a depth image")
    if arguments.camera is None:
        raise CommandError("a depth image needs --camera")
    return image_sequence([path], camera_of(arguments), Path())


def _show(live: "LiveView", sequence: "FrameSequence", min_size: int) -> "list[Problem]":
    """Segment, follow and show the frames; those that cannot be read are named and left out."""
    import numpy as np

    from rgbd_planes import Odometry, PlaneTracker, curvature, segment
    from rgbd_planes.cli.progress import progress
    from rgbd_planes.sequences.problems import Problem, in_words, reason_to_skip

    tracker, first, problems, newest = PlaneTracker(), None, [], 0
    stated = any(entry.pose is not None for entry in sequence.entries)
    # One frame does not move, and frames of several cameras need not be of one moving camera.
    moves = not stated and len(sequence) > 1 and len(sequence.cameras) == 1
    follower = Odometry(sequence.camera, min_size=min_size) if moves else None
    for number in progress(range(len(sequence)), len(sequence), "frames"):
        name = sequence.names[number]
        try:
            frame = sequence[number]
            if follower is None:
                found, pose = tracker.follow(segment(frame.depth, frame.camera, min_size=min_size)), frame.pose
            else:
                estimate = follower.update(frame)
                found, pose = estimate.segmentation, estimate.T_world_camera
        except Exception as error:
            problems.append(Problem(number, name, reason_to_skip(error, name)))
            continue
        newest = max(newest, int(found.ids.max(initial=0)))
        if pose is not None:  # seen from the first camera, so that down is down on the screen
            first = np.linalg.inv(pose) if first is None else first
            pose = first @ pose
        bent = curvature(frame.depth, frame.camera)
        live.show(frame.depth, frame.camera, found, timestamp=frame.timestamp, curvature=bent, pose=pose)
    if len(problems) == len(sequence):
        raise CommandError(f"expected a frame that can be read, got none: {'; '.join(in_words(problems))}")
    for line in in_words(problems):
        print(f"rgbd-planes view: skipped {line}", file=sys.stderr)
    path = "" if follower is None else " The camera's path is estimated from planes and tiles."
    shown = f"{counted(len(sequence) - len(problems), 'frame')}, {counted(newest, 'plane')}."
    print(shown + path, flush=True)
    return problems
