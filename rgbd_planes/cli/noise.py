"""``rgbd-planes noise``."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rgbd_planes._core.files import naming
from rgbd_planes._core.text import counted, shown
from rgbd_planes.cli.arguments import (
    FIGURES,
    CommandError,
    Run,
    add_sequence_options,
    camera_of,
    check_outputs,
    read_sequence,
    write_figure,
)
from rgbd_planes.cli.progress import progress, working

if TYPE_CHECKING:
    from rgbd_planes.camera.frame import Frame
    from rgbd_planes.sequences import FrameSequence


def noise(parser: argparse.ArgumentParser) -> Run:
    """Estimate a sensor's noise from frames of ordinary scenes, for the other commands to go by.

    example: rgbd-planes noise frames --camera camera.json --out with_noise.json

    The frames should show walls, floors or tables at the depths that matter.
    One that cannot be read is reported and skipped, and makes the exit status 1.
    What is printed is in the words of rgbd_planes.noise.NoiseModel.
    """
    parser.add_argument(
        "frames",
        type=Path,
        nargs="+",
        help="depth images, which need --camera; or one data set, folder of depth images, or recording",
    )
    add_sequence_options(parser)
    parser.add_argument(
        "--count", type=int, default=20, metavar="N", help="how many of the frames to take, evenly spread (20)"
    )
    parser.add_argument("--out", type=Path, metavar="JSON", help="write the camera with its noise, for --camera")
    parser.add_argument(
        "--figure", type=Path, metavar="PNG/PDF/SVG", help="draw how the noise fits, and the sensor's bias"
    )

    def run(arguments: argparse.Namespace) -> int:
        import numpy as np

        from rgbd_planes import estimate_noise
        from rgbd_planes.noise_estimation.samples import WINDOW

        if arguments.count < 1:
            raise CommandError(f"--count must be at least 1, got {arguments.count}")
        read = [path for path in [*arguments.frames, arguments.camera] if path is not None]
        check_outputs(arguments, read, out=(".json",), figure=FIGURES)
        sequence = _sequence(arguments)
        spread = np.linspace(0, len(sequence) - 1, min(arguments.count, len(sequence))).astype(int)
        frames = _readable(sequence, spread.tolist())
        camera, *others = {frame.camera for frame in frames}
        if others:
            raise CommandError(
                f"expected frames of one camera, got {1 + len(others)}: give --camera, if one is right for all"
            )
        with working("estimating the noise"):
            found = estimate_noise(frames, camera)
        evidence = found.evidence
        assert evidence is not None
        print(
            f"{len(frames)} of {counted(len(sequence), 'frame')}, "
            f"{evidence.windows} flat windows of {WINDOW} x {WINDOW} pixels."
        )
        print(f"Noise: {found._summary()}.".replace("; ", ";\n  "))
        print(f"By it {evidence._rejected()} of the flat tiles have a p-value below 1 %; 1 % should.")
        if arguments.out is not None:
            camera.with_noise(found).save(arguments.out)
            print(f"Wrote {shown(arguments.out)}")
        if arguments.figure is not None:
            write_figure(evidence.plot(), arguments.figure)
            print(f"Wrote {shown(arguments.figure)}")
        return 1 if len(frames) < len(spread) else 0

    return run


def _readable(sequence: "FrameSequence", chosen: list[int]) -> "list[Frame]":
    """The chosen frames, without those that cannot be read or are not the camera's, which are reported."""
    from rgbd_planes.camera.depth_frame import as_depth_frame
    from rgbd_planes.sequences.problems import reason_to_skip

    frames, skipped = [], []
    for index in progress(chosen, len(chosen), "frames"):
        name = sequence.entries[index].name
        try:
            frame = sequence[index]
            with naming(name):
                as_depth_frame(frame.depth, frame.camera)
            frames.append(frame)
        except Exception as error:
            reason = reason_to_skip(error, name)
            if not frames and index == chosen[-1]:
                raise
            skipped.append(f"frame {index}, {shown(name)}: {reason}")
    for line in skipped:
        print(f"rgbd-planes noise: skipped {line}", file=sys.stderr)
    return frames


def _sequence(arguments: argparse.Namespace) -> "FrameSequence":
    """The depth images that are named, or the frames of the one data set or recording."""
    from rgbd_planes.sequences.frames import image_sequence
    from rgbd_planes.sequences.images import DEPTH_SUFFIXES

    paths: list[Path] = arguments.frames
    if len(paths) == 1 and paths[0].suffix.lower() not in DEPTH_SUFFIXES:
        return read_sequence(arguments, paths[0])
    folder = next((path for path in paths if path.is_dir()), None)
    if folder is not None:
        raise CommandError(
            f"expected depth images, or one folder, got {len(paths)} paths with the folder {shown(folder)}"
        )
    for option in ("format", "topic"):
        if getattr(arguments, option) is not None:
            raise CommandError(f"--{option} is for a data set or a recording, got depth images")
    if arguments.camera is None:
        raise CommandError("depth images need --camera")
    return image_sequence(paths, camera_of(arguments), Path())
