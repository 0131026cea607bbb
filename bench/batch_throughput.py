"""How fast a batch is beside `fit_batch`, and where its time goes: ``python bench/batch_throughput.py``.

Frames are a rendered room with a Kinect's noise and holes. All are measured in turns in one process, so that what
else the machine does meets all of them; the median of the rounds is printed.
"""

import argparse
import os
import statistics
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

import rgbd_planes as rp
from rgbd_planes.images import read_depth, write_png
from rgbd_planes.sequences import FrameEntry, FrameSequence

KINDS = 16  # different frames


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=480)
    parser.add_argument("--rounds", type=int, default=7)
    arguments = parser.parse_args()
    camera = rp.presets.kinect_v1()
    rendering = rp.scenes.room().render(camera)
    stored = [rendering.measure(holes=0.05, patches=0.03, seed=seed) for seed in range(KINDS)]
    threads = os.cpu_count() or 1
    fitter = rp.TileFitter(camera, 16, num_threads=threads)

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for i, frame in enumerate(stored):
            write_png(folder / f"{i}.png", frame)

        def sequence(where, read):
            entries = (
                FrameEntry(str(i), float(i), camera, where(i % KINDS)) for i in range(arguments.frames)
            )
            return FrameSequence(entries, read)

        in_memory = sequence(lambda i: i, lambda i: stored[i])
        in_files = sequence(lambda i: folder / f"{i}.png", read_depth)
        part = [stored[i % KINDS] for i in range(arguments.frames // 8)]
        seconds: dict[str, list[float]] = {"fit_batch": [], "from memory": [], "from PNG files": []}
        shares: dict[str, Counter[str]] = {"from memory": Counter(), "from PNG files": Counter()}
        for turn in range(arguments.rounds + 1):
            start = time.perf_counter()
            for _ in range(8):
                fitter.fit_batch(part)
            took = {"fit_batch": time.perf_counter() - start}
            for which, frames in (("from memory", in_memory), ("from PNG files", in_files)):
                start = time.perf_counter()
                report = rp.fit_sequence(frames, folder / f"{which} {turn}", num_threads=threads)
                took[which] = time.perf_counter() - start
                shares[which].update(report.seconds)
            if turn:  # the first compiles and imports
                for which, value in took.items():
                    seconds[which].append(value)

    print(
        f"{arguments.frames} frames of 640 x 480, tiles of 16 x 16, {threads} threads, NumPy {np.__version__}"
    )
    for which, values in seconds.items():
        ratio = statistics.median(b / s for b, s in zip(seconds["fit_batch"], values, strict=True))
        line = f"{which:15} {1e3 * statistics.median(values) / arguments.frames:6.2f} ms a frame, "
        line += f"{ratio:4.0%} of fit_batch's throughput"
        if which in shares:
            total = shares[which].total()
            line += "; work: " + ", ".join(
                f"{name} {value / total:.0%}" for name, value in shares[which].items()
            )
        print(line)
    work = shares["from memory"]
    fit_alone = statistics.median(seconds["fit_batch"]) * threads / (work["fit"] / (arguments.rounds + 1))
    print(f"the fits of a batch alone, without writing: {fit_alone:4.0%} of fit_batch's throughput")


if __name__ == "__main__":
    main()
