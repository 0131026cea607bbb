"""``python -m tests.fuzz --inputs 10000``: counts, and each broken promise with the number that makes it again."""

import argparse
import functools
import multiprocessing
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor

from . import calls, formats
from .run import tried

_CHUNK = 50  # inputs that a process takes at a time


def main(argv=None):
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--inputs", type=int, default=2000, help="how many inputs (2000)")
    parser.add_argument("--seed", type=int, default=0, help="number of the first input (0)")
    parser.add_argument("--kind", choices=["all", *calls.CALLS, *calls.RARE, *formats.FORMATS], default="all")
    parser.add_argument("--processes", type=int, default=1, help="how many inputs at a time (1)")
    arguments = parser.parse_args(argv)
    begin, counts = time.monotonic(), Counter()
    seeds = range(arguments.seed, arguments.seed + arguments.inputs)
    each = functools.partial(tried, kind=arguments.kind)
    # Not forked: threads of kernels would be lost.
    with ProcessPoolExecutor(arguments.processes, multiprocessing.get_context("spawn")) as pool:
        found = map(each, seeds) if arguments.processes == 1 else pool.map(each, seeds, chunksize=_CHUNK)
        for seed, (name, what, error) in zip(seeds, found, strict=True):
            counts[name, what] += 1
            if error is not None:
                message, where = error
                print(f"--kind {name} --seed {seed} --inputs 1: {message}", flush=True)
                if arguments.inputs == 1:
                    print(where, file=sys.stderr)
    for (name, what), count in sorted(counts.items()):
        print(f"{name:18} {what:10} {count}")
    broken = sum(count for (_, what), count in counts.items() if what == "broken")
    print(f"{arguments.inputs} inputs in {time.monotonic() - begin:.0f} s, {broken} broken promises")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
