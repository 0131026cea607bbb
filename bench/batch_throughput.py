"""How fast a batch is beside `fit_batch`, and where its time goes: ``python -m bench.batch_throughput``.

Frames are a rendered room with a Kinect's noise and holes. All are measured in turns in one process, so that what
else the machine does meets all of them; ratios are those of a round, their median and quartiles over the rounds.
"""

import argparse
import os
import statistics
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from shutil import rmtree
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rgbd_planes as rp
from rgbd_planes.sequences import FrameEntry, FrameSequence
from rgbd_planes.sequences.images import read_depth, write_png

KINDS = 16  # different frames
AT_ONCE = 64  # frames of a call of fit_batch
LONGER = 4  # how many times as many frames the long sequence has

# The frames in memory. What reads a sequence goes into a table's digest: it is a function, and does not hold them.
_stored: list[NDArray[Any]] = []


def _from_memory(kind: int) -> NDArray[Any]:
    return _stored[kind]


def measure(frames: int = 2048, rounds: int = 40) -> dict[str, Any]:
    """Return times in milliseconds a frame, throughputs and shares of the work."""
    if frames < 1 or frames % AT_ONCE:
        raise ValueError(f"expected frames in multiples of {AT_ONCE}, got {frames}")
    camera = rp.presets.kinect_v1()
    rendering = rp.scenes.room().render(camera)
    _stored[:] = [rendering.measure(holes=0.05, patches=0.03, seed=seed) for seed in range(KINDS)]
    threads = os.cpu_count() or 1
    fitter = rp.TileFitter(camera, 16, num_threads=threads)
    part = [_stored[i % KINDS] for i in range(AT_ONCE)]
    seconds: dict[str, list[float]] = {}
    work: dict[str, Counter[str]] = {"memory": Counter(), "long": Counter(), "png": Counter()}

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for i, frame in enumerate(_stored):
            write_png(folder / f"{i}.png", frame)

        def sequence(count: int, where: Callable[[int], Any], read: Callable[[Any], NDArray[Any]]) -> FrameSequence:
            return FrameSequence((FrameEntry(str(i), float(i), camera, where(i % KINDS)) for i in range(count)), read)

        in_memory = sequence(frames, lambda i: i, _from_memory)
        longer = sequence(LONGER * frames, lambda i: i, _from_memory)
        in_files = sequence(frames // 8, lambda i: folder / f"{i}.png", read_depth)

        def fit_batch(out: rp.TilePlanes | None = None) -> None:
            for _ in range(frames // AT_ONCE):
                fitter.fit_batch(part, out)

        def fit_sequence(which: str, of: FrameSequence) -> None:
            work[which].update(rp.fit_sequence(of, folder / which, num_threads=threads).seconds)

        def write_bare() -> None:  # what any table must do: give its bytes to the system
            for i, content in enumerate(contents):
                (folder / f"bare {i}").write_bytes(content)

        fit_sequence("memory", in_memory)
        contents = [file.read_bytes() for file in sorted((folder / "memory").glob("part-*"))]
        earlier = fitter.fit_batch(part)
        turns: dict[str, tuple[Callable[[], None], int]] = {
            "fit_batch": (fit_batch, frames),
            "out": (lambda: fit_batch(earlier), frames),
            "memory": (lambda: fit_sequence("memory", in_memory), frames),
            "long": (lambda: fit_sequence("long", longer), len(longer)),
            "png": (lambda: fit_sequence("png", in_files), len(in_files)),
            "bare": (write_bare, frames),
        }
        for turn in range(rounds + 1):
            for which, (run, count) in turns.items():
                for left in filter(Path.exists, map(folder.joinpath, work)):
                    rmtree(left)  # or the next batch would resume what is done
                for bare in folder.glob("bare*"):
                    bare.unlink()
                start = time.perf_counter()
                run()
                if turn:  # the first compiles and imports
                    seconds.setdefault(which, []).append((time.perf_counter() - start) / count)
                else:
                    work = {name: Counter() for name in work}
    reference = np.array(seconds["fit_batch"])
    quartiles = {
        which: np.quantile(reference / values, (0.25, 0.5, 0.75)).tolist() for which, values in seconds.items()
    }
    return {
        "frames": frames,
        "threads": threads,
        "tiles": 1200,
        "bytes_per_frame": sum(map(len, contents)) / frames,
        "milliseconds": {which: 1e3 * statistics.median(values) for which, values in seconds.items()},
        "throughput": quartiles,
        "work": {which: {k: v / of.total() for k, v in of.items()} for which, of in work.items()},
        # Writing is one thread's, the fits are of all; it waits for the disk at times.
        "bare_share": min(seconds["bare"]) / min(seconds["fit_batch"]) / threads,
    }


def table(result: dict[str, Any]) -> str:
    """The result as Markdown."""
    names = {
        "fit_batch": "`fit_batch`, frames in memory",
        "out": "`fit_batch(out=...)`, into an earlier result",
        "memory": f"`fit_sequence`, {result['frames']} frames in memory",
        "long": f"`fit_sequence`, {LONGER * result['frames']} frames in memory",
        "png": "`fit_sequence`, frames in PNG files",
    }
    lines = [
        "| | of `fit_batch`'s throughput | quartiles | reading | fitting | writing |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for which, name in names.items():
        shares = [f"{share:.0%}" for share in result["work"].get(which, {}).values()] or [""] * 3
        low, middle, high = result["throughput"][which]
        throughput = f"{middle:.0%} | {low:.0%}–{high:.0%}"
        lines.append(f"| {name} | {throughput} | {' | '.join(shares)} |")
    kilobytes = result["bytes_per_frame"] / 1e3
    lines += [
        "",
        f"Frames of 640 x 480, tiles of 16 x 16, {result['threads']} threads. The table has {result['tiles']} rows and",
        f"{kilobytes:.0f} kB a frame: to write so many bytes to a file, and nothing else, takes",
        f"{result['bare_share']:.0%} of the processor time of fitting.",
    ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=2048)
    parser.add_argument("--rounds", type=int, default=40)
    result = measure(**vars(parser.parse_args()))
    print(table(result))
    for which, milliseconds in result["milliseconds"].items():
        print(
            f"{which:10} {milliseconds:.3f} ms a frame, {result['throughput'][which][1]:.0%} of fit_batch's throughput"
        )


if __name__ == "__main__":
    main()
