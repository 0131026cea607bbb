"""What the first frame costs, in fresh processes: ``python -m bench.first_call``.

Each process imports NumPy and makes a frame, imports the library and calls it once; another imports NumPy and Numba and
nothing else. They take turns, with kernels that an earlier process has compiled. For each call two processes compile,
each in an installation of its own.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from shutil import copytree, ignore_patterns
from typing import Any

import numpy as np

import rgbd_planes

# The processes print the seconds that each step takes.
STEPS = """
import json, time

seconds, last = {{}}, time.perf_counter()

def done(step):
    global last
    now = time.perf_counter()
    seconds[step], last = now - last, now

import numpy as np
done("numpy")
{code}
print(json.dumps(seconds))
"""
NUMBA = """
import numba
done("numba")
"""
CALL = """
depth = np.full((480, 640), 1500, np.uint16)
depth[::20, ::15] = 0
done("frame")
import rgbd_planes as rp
done("import")
camera = rp.Camera(640, 480, 525.0, 525.0, 319.5, 239.5, depth_scale=1000.0)
rp.{call}
done("first call")
"""
CALLS = {
    "fit_tiles": "fit_tiles(depth, camera, tile=16)",
    "normals": "normals(depth, camera, window=7)",
    "segment": "segment(depth, camera)",
}


def run(code: str, folder: str | None = None) -> dict[str, float]:
    """The seconds of each step of a fresh process, with the installation that is in ``folder``."""
    # As installed packages are, this one is imported from compiled Python.
    inherited = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    done = subprocess.run(
        [sys.executable, "-c", STEPS.format(code=code)],
        capture_output=True, text=True, check=True, env=inherited, cwd=folder,
    )  # fmt: skip
    return dict(json.loads(done.stdout))


def measure(rounds: int = 15, compiling: bool = True) -> dict[str, Any]:
    """Return seconds of each step in each round, and of two first calls of an installation."""
    codes = {"numba": NUMBA} | {name: CALL.format(call=call) for name, call in CALLS.items()}
    for code in codes.values():
        run(code)  # compiles
    steps: dict[str, list[dict[str, float]]] = {name: [] for name in codes}
    for _ in range(rounds):
        for name, code in codes.items():
            steps[name].append(run(code))
    result: dict[str, Any] = {
        name: {step: [seconds[step] for seconds in taken] for step in taken[0]} for name, taken in steps.items()
    }
    if compiling:
        result["compiling"] = {name: [] for name in CALLS}
        for _ in range(2):
            for name, taken in result["compiling"].items():
                with tempfile.TemporaryDirectory() as folder:
                    source = Path(rgbd_planes.__file__).parent
                    copytree(source, Path(folder, source.name), ignore=ignore_patterns("__pycache__"))
                    taken.append(run(codes[name], folder)["first call"])
    return result


def table(result: dict[str, Any]) -> str:
    """The result as Markdown."""
    base = np.add(result["numba"]["numpy"], result["numba"]["numba"])
    lines = [
        "| | `import rgbd_planes` | first call | the slowest "
        "| imports + first call, as a multiple of importing NumPy and Numba |",
        "|---|---:|---:|---:|---:|",
    ]
    for name in CALLS:
        of = {step: np.array(seconds) for step, seconds in result[name].items()}
        total = (of["numpy"] + of["import"] + of["first call"]) / base
        lines.append(
            f"| `{name}` | {np.median(of['import']) * 1e3:.1f} ms | {np.median(of['first call']):.2f} s "
            f"| {of['first call'].max():.2f} s | {np.median(total):.1f} |"
        )
    lines += ["", f"{len(base)} processes each; NumPy and Numba alone take {np.median(base):.2f} s to import."]
    if "compiling" in result:
        times = [
            "`{}` takes {:.1f} s ({:.1f} to {:.1f})".format(name, *np.percentile(seconds, [50, 0, 100]))
            for name, seconds in result["compiling"].items()
        ]
        lines += [f"The first call of an installation compiles: {', '.join(times)}."]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.first_call", description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    print(table(measure(**vars(parser.parse_args()))))


if __name__ == "__main__":
    main()
