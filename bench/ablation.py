"""What each rule and each constant of the segmentation is worth: ``python -m bench.ablation``.

Each stage is switched off, and each constant moved down and up, by itself. Then all labelled and rendered sets are
scored, and the frames are timed in turns with the rules as they are. A rule that changes no set by half a point, or an
optimisation that saves less than 5 % of the time, is not worth its lines.

The labelled frames are moved by some pixels, mirrored and transposed, as for the cross-validation of
``bench.segmentation``: of sixteen frames alone, chance would choose.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, NamedTuple
from unittest import mock

import numpy as np

from bench import segmentation as bench
from bench.segmentation import Frame
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.kernels.segmentation.curved.curved import find_curved
from rgbd_planes.kernels.segmentation.model.records import Rules
from rgbd_planes.segmentation import regions
from rgbd_planes.segmentation import segment as segment
from rgbd_planes.segmentation.frame_noise import Given

MIN_SIZE = 60
STEP = 1.4
"""Factor by which a constant is moved."""
ROUNDS = 5
"""Runs of each frame that is timed, in turns."""


class Case(NamedTuple):
    """A segmentation with something changed."""

    name: str
    rules: Rules = Rules()
    patch: Callable[[], AbstractContextManager[Any]] = contextlib.nullcontext


def _without(module: Any, name: str, replacement: Callable[..., Any]) -> Callable[[], AbstractContextManager[Any]]:
    return lambda: mock.patch.object(module, name, replacement)


def _grow_nothing(region: Any, moments: Any, noise: Any, rules: Any, parent: Any) -> None:
    parent[:] = np.arange(len(parent))


def _find_nothing_curved(*arguments: Any) -> None:
    find_curved(*arguments)
    arguments[6][:] = False


def _join_nothing(view: Any, runs: Any, count: int, number: Any, moments: Any, deviation: Any) -> int:
    return len(moments)


def stages() -> Iterator[Case]:
    """Every stage that can be left out."""
    yield Case("no seed growing", patch=_without(regions, "grow_together", _grow_nothing))
    yield Case("no splitting of faces", patch=_without(regions, "_split_faces", lambda *_: False))
    yield Case("blocks do not spread", patch=_without(regions, "spread_out", lambda *_: None))
    yield Case("borders do not move on", patch=_without(regions, "move_on", lambda *_: None))
    yield Case("nothing is curved", patch=_without(segment, "find_curved", _find_nothing_curved))
    yield Case("gaps stay open", patch=_without(segment, "join_across_gaps", _join_nothing))
    yield Case("rims stay", patch=_without(segment, "release_rims", lambda *_: None))
    yield Case("strays stay", patch=_without(segment, "settle_strays", lambda *_: None))


def constants() -> Iterator[Case]:
    """Every constant, moved down and up."""
    default = Rules()
    for name, value in default._replace(tolerance=1.0)._asdict().items():
        for moved in (value - 1, value + 1) if isinstance(value, int) else (value / STEP, value * STEP):
            yield Case(f"{name} {moved:.4g} ({value:g})", default._replace(**{name: moved}))


def sets(seeds: int, every: int) -> dict[str, list[Frame]]:
    """Labelled and rendered frames, by what they show."""
    frames: dict[str, list[Frame]] = {}
    for name, labelled in bench.labelled_sets():
        if name in bench.MOVED:
            frames[name] = list(bench.moved(labelled))[::every]
    for name, rendered in bench.rendered_sets():
        frames.setdefault("blocks" if "blocks" in name else "rooms", []).extend(rendered[:seeds])
    frames["curved"] = bench.curved()
    return frames


class Result(NamedTuple):
    """Means over a set."""

    correct_80: float  # percent of the regions
    correct_90: float
    wrong: float  # over- and under-segmented regions and noise, per frame


def run(case: Case, frames: Sequence[Frame]) -> Result:
    """Segment and score frames."""
    with case.patch():
        rows = [bench.score(segmented(frame, case.rules).labels, frame) for frame in frames]
    scores = bench.summary("", rows)
    wrong = scores["over"] + scores["under"] + scores["noise"]
    return Result(100.0 * scores["correct_80"], 100.0 * scores["correct_90"], wrong)


def segmented(frame: Frame, rules: Rules) -> Any:
    """Segment one frame by some rules, with noise as it shows."""
    depth = as_depth_frame(frame.depth, frame.camera)
    return segment.segment_frame(depth, frame.camera, Given(), MIN_SIZE, rules)


def time_ratio(case: Case, frames: Sequence[Frame]) -> float:
    """Time with something changed over that as it is, in turns, of the fastest runs."""
    spent = np.full((2, len(frames)), np.inf)
    for (k, frame), _ in itertools.product(enumerate(frames), range(ROUNDS)):
        for which, each in enumerate((Case("as it is"), case)):
            with each.patch():
                start = time.thread_time()
                segmented(frame, each.rules)
                spent[which, k] = min(spent[which, k], time.thread_time() - start)
    return float(spent[1].sum() / spent[0].sum())


def table(cases: Sequence[Case], frames: Mapping[str, Sequence[Frame]]) -> Iterator[str]:
    """Lines of a Markdown table: what each case changes, in points, wrong regions a frame, and time."""
    default = {name: run(Case("as it is"), those) for name, those in frames.items()}
    timed = [frame for those in frames.values() for frame in those[:: max(1, len(those) // 4)]]
    yield "| | " + " | ".join(frames) + " | time |"
    yield "|---|" + "---:|" * (len(frames) + 1)
    yield "| as it is | " + " | ".join(
        f"{of.correct_80:.1f} / {of.correct_90:.1f} %, {of.wrong:.2f}" for of in default.values()
    ) + " | 1 |"  # fmt: skip
    for case in cases:
        cells = []
        for name, those in frames.items():
            of, before = run(case, those), default[name]
            cells.append(
                f"{of.correct_80 - before.correct_80:+.1f} / {of.correct_90 - before.correct_90:+.1f}, "
                f"{of.wrong - before.wrong:+.2f}"
            )
        yield f"| {case.name} | " + " | ".join(cells) + f" | {time_ratio(case, timed):.2f} |"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("stages", "constants"), help="one of the two tables")
    parser.add_argument("--seeds", type=int, default=5, help="frames of each rendered scene, by default 5")
    parser.add_argument("--every", type=int, default=1, help="only each so manyth of the moved labelled frames")
    arguments = parser.parse_args()
    frames = sets(arguments.seeds, arguments.every)
    for name, cases in (("stages", stages), ("constants", constants)):
        if arguments.only in (None, name):
            for line in table(list(cases()), frames):
                print(line, flush=True)
            print()


if __name__ == "__main__":
    main()
