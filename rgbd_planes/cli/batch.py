"""``rgbd-planes batch``."""

import argparse
import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from rgbd_planes._core.text import counted, percent, shown
from rgbd_planes.cli.arguments import (
    CommandError,
    Run,
    add_fit_options,
    add_min_size,
    add_noise,
    add_sequence_options,
    read_sequence,
)

if TYPE_CHECKING:
    from rgbd_planes.sequences import FrameSequence

_TRIED = 10  # frames, until one can be read
_OTHER_UNITS = "of this frame is beyond", "of this frame is nearer", "of this frame is positive", "multiples of 256"


def batch(parser: argparse.ArgumentParser) -> Run:
    """Fit every frame of a data set or a recording into a Parquet table, one row per tile or segment.

    example: rgbd-planes batch rgbd_dataset_freiburg1_xyz --out planes.parquet

    After an interruption the same command does the rest. A frame that cannot be
    read or fitted is reported and skipped, and makes the exit status 1. The same
    command tries it again if its file has changed, or with --retry.
    """
    parser.add_argument("sequence", type=Path, help="data set, folder of depth images, or recording")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="FOLDER", help="folder of the table, which is many files"
    )
    add_sequence_options(parser)
    parser.add_argument(
        "--segments",
        action="store_true",
        help="one row for each plane of the scene, not for each tile; takes no options of tiles, but --min-size",
    )
    add_min_size(parser)
    parser.add_argument(
        "--primitives", action="store_true", help="with --segments, add a row for each sphere, cylinder or other curve"
    )
    parser.add_argument("--curvature", action="store_true", help="add how each tile is curved to the table")
    add_fit_options(parser)
    add_noise(parser, "adds covariances and p-values to the table, and calls tiles ROUGH that it does not explain")
    parser.add_argument(
        "--threads", type=int, metavar="N", help="number of threads (one for each core, up to 8, or 16 for segments)"
    )
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="address of a Dask scheduler, to use its workers: tcp://host:port"
    )
    parser.add_argument(
        "--despite-warnings", action="store_true", help="go on although the first frame is most likely in other units"
    )
    parser.add_argument("--retry", action="store_true", help="try the frames again that were skipped before")

    def run(arguments: argparse.Namespace) -> int:
        from rgbd_planes import FitSettings, fit_sequence
        from rgbd_planes._core.optional_imports import needs
        from rgbd_planes.batch.fit_sequence import Progress
        from rgbd_planes.sequences.problems import in_words

        with needs("tqdm", "batch" if arguments.scheduler is None else "dask"):
            from tqdm import tqdm
        sequence = read_sequence(arguments, arguments.sequence)
        if arguments.noise is not None:
            sequence = sequence.with_noise(arguments.noise)
        if not arguments.despite_warnings:
            _check_units(sequence)
        settings = FitSettings(
            segments=arguments.segments,
            tile=arguments.tile,
            method=arguments.method,
            max_missing=arguments.max_missing,
            max_error=arguments.max_error,
            significance=arguments.significance,
            min_size=arguments.min_size,
            curvature=arguments.curvature,
            primitives=arguments.primitives,
        )
        bar = tqdm(total=len(sequence), unit="frame", disable=None)  # None: only on a terminal
        skipped: Counter[str] = Counter()  # by reason: each is printed once, and that of several frames at the end

        def progress(done: Progress) -> None:
            for frame, name, reason in done.problems:
                if reason not in skipped:
                    line = f"rgbd-planes batch: skipped frame {frame}, {shown(name)}: {reason}"
                    bar.write(line, file=sys.stderr)
                skipped[reason] += 1
            bar.update(done.frames)

        try:
            with bar:
                report = fit_sequence(
                    sequence,
                    arguments.out,
                    settings,
                    num_threads=arguments.threads,
                    scheduler=arguments.scheduler,
                    retry=arguments.retry,
                    progress=progress,
                )
        except KeyboardInterrupt:
            print("rgbd-planes batch: stopped; the same command does the rest", file=sys.stderr)
            raise
        rows = ", ".join(f"{count} {status}" for status, count in report.status.items())
        done = f"{report.frames - len(report.problems)} of {counted(report.frames, 'frame')}"
        print(f"{done}, {counted(report.rows, 'row')}" + (f": {rows}." if rows else "."))
        if report.resumed:
            done_or_not = "tried" if report.problems else "done"
            print(f"{counted(report.resumed, 'frame')} had been {done_or_not} before.")
        total = sum(report.seconds.values())
        if total > 0.0:
            shares = ", ".join(f"{work} {percent(seconds / total)}" for work, seconds in report.seconds.items())
            print(f"Of the work: {shares}.")
        print(f"Wrote {shown(report.out)}, a folder that pandas.read_parquet reads as one table.")
        for line in in_words(problem for problem in report.problems if skipped[problem.reason] > 1):
            print(line, file=sys.stderr)
        if report.problems:
            print(f"Skipped {len(report.problems)} of {counted(report.frames, 'frame')}.", file=sys.stderr)
            if report.resumed and not arguments.retry:
                print("What was skipped before is tried again with --retry.", file=sys.stderr)
        if len(report.problems) < report.frames and not report.status["OK"] + report.status["ROUGH"]:
            print(
                f"{parser.prog}: no plane in any frame: are the camera's unit, depth_range and invalid_values right?",
                file=sys.stderr,
            )
            return 1
        return 1 if report.problems else 0

    return run


def _check_units(sequence: "FrameSequence") -> None:
    """Refuse a sequence whose first frame that can be read is most likely in other units than its camera says."""
    from rgbd_planes._core.user_warnings import collected_warnings
    from rgbd_planes.camera.depth_frame import as_depth_frame

    for index in range(min(len(sequence), _TRIED)):
        said: list[str] = []
        try:
            frame = sequence[index]
            with collected_warnings(said):
                as_depth_frame(frame.depth, frame.camera)
        except Exception:  # which the batch itself reports
            continue
        doubts = [text for text in said if any(words in text for words in _OTHER_UNITS)]
        if doubts:
            raise CommandError(
                f"frame {index}, {sequence.names[index]}: {doubts[0]}; --float-scale and --depth-scale say the unit, "
                "--despite-warnings goes on"
            )
        return
