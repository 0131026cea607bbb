"""``python -m tests.fuzz --inputs 10000``: counts, and each broken promise with the number that makes it again."""

import argparse
import sys
import time
import traceback
from collections import Counter

from . import calls, formats
from .run import chosen, run


def main(argv=None):
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--inputs", type=int, default=2000, help="how many inputs (2000)")
    parser.add_argument("--seed", type=int, default=0, help="number of the first input (0)")
    parser.add_argument("--kind", choices=["all", *calls.CALLS, *calls.RARE, *formats.FORMATS], default="all")
    arguments = parser.parse_args(argv)
    begin, counts, broken = time.monotonic(), Counter(), 0
    for seed in range(arguments.seed, arguments.seed + arguments.inputs):
        try:
            counts[run(seed, arguments.kind)] += 1
        except Exception as error:
            broken += 1
            name = chosen(seed, arguments.kind)
            counts[name, "broken"] += 1
            print(f"--kind {name} --seed {seed} --inputs 1: {type(error).__name__}: {error}", flush=True)
            if arguments.inputs == 1:
                traceback.print_exc()
    for (name, what), count in sorted(counts.items()):
        print(f"{name:18} {what:10} {count}")
    print(f"{arguments.inputs} inputs in {time.monotonic() - begin:.0f} s, {broken} broken promises")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
