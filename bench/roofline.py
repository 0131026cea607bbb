"""What the machine can do, and how near to it the fits are: ``python -m bench.roofline --out DIR``.

Every piece of work needs so many bytes, divisions and other operations for a pixel, and one core moves and computes so
many a second. The longest of the three times is the least that the work can take. Writes roofline.md and
roofline.png, one thread, 640 x 480, uint16, 5 % missing. `python -m bench.measured roofline` puts both into the
documentation.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.fitting import case, fit, floor_of, take_turns
from bench.paper import processor
from rgbd_planes.kernels._jit.kernel import kernel

STEPS = 16
PICTURE = Path(__file__).resolve().parents[1] / "docs/images/roofline.png"
FLOOR, EXPLICIT = "floor, a division a pixel", "range_explicit, tiles of {}"


@kernel(reduction=True)
def divide(values: NDArray[np.float64]) -> float:
    """Sum of reciprocals."""
    total = 0.0
    for i in range(len(values)):
        total += 1.0 / values[i]
    return total


@kernel(reduction=True)
def multiply_and_add(values: NDArray[np.float64], factor: float) -> float:
    """`STEPS` multiplications and additions of every value."""
    total = 0.0
    for i in range(len(values)):
        x = values[i]
        for _ in range(STEPS):
            x = x * factor + values[i]
        total += x
    return total


@kernel(reduction=True)
def read(values: NDArray[np.uint64]) -> np.uint64:
    """Sum of whole numbers."""
    total = np.uint64(0)
    for i in range(len(values)):
        total += values[i]
    return total


class Work(NamedTuple):
    """What the pixels of a kernel need at least."""

    run: Callable[[], Any]
    divisions: float
    operations: float
    """Additions and multiplications; those of columns, tiles and missing pixels do not count."""


def works() -> dict[str, Work]:
    """The kernels to measure."""
    frame = case()
    listed = {
        FLOOR: Work(floor_of(frame, 20, False), 1.0, 5.0),
        "floor, a division for two": Work(floor_of(frame, 20, True), 0.5, 6.5),
    }
    # Per pixel: 1.5 products for the shared division, q - q0, and Σq, Σqv, Σqq; z = m·raw - z0, zv, and six sums.
    for tile in (20, 10):
        for method in ("range_explicit", "range_implicit"):
            listed[f"{method}, tiles of {tile}"] = Work(fit(frame, tile, method), 0.5, 7.5)
        for method in ("standard_explicit", "standard_pca", "standard_implicit"):
            listed[f"{method}, tiles of {tile}"] = Work(fit(frame, tile, method), 0.0, 13.0)
    return listed


def machine() -> dict[str, tuple[Callable[[], Any], float]]:
    """What finds out the machine's limits, and how many operations or bytes it takes."""
    near = np.linspace(1.0, 2.0, 16384)  # in the second-level cache
    frame = np.ones(640 * 480 * 2 // 8, np.uint64)  # as large as the frame
    memory = np.ones(32_000_000, np.uint64)  # larger than any cache
    return {
        "divisions": (lambda: [divide(near) for _ in range(8)], 8.0 * len(near)),
        "additions and multiplications": (
            lambda: [multiply_and_add(near, 0.5) for _ in range(8)],
            16.0 * STEPS * len(near),
        ),
        "bytes from the caches": (lambda: [read(frame) for _ in range(8)], 8.0 * frame.nbytes),
        "bytes from memory": (lambda: read(memory), 1.0 * memory.nbytes),
    }


def measure(repeats: int = 500) -> dict[str, Any]:
    """Nanoseconds of each of the machine's limits, and of a pixel of each kernel beside what these allow."""
    probes, listed = machine(), works()
    functions = {name: run for name, (run, _) in probes.items()} | {n: work.run for n, work in listed.items()}
    # What disturbs a run only ever adds to its time, and limits are what is not disturbed: the fastest of each.
    fastest = {name: 1e9 * float(times.min()) for name, times in take_turns(functions, repeats).items()}
    cost = {name: fastest[name] / count for name, (_, count) in probes.items()}
    pixels = case().depth.size
    rows = []
    for name, work in listed.items():
        limits = {
            "reading": 2.0 * cost["bytes from the caches"],
            "dividing": work.divisions * cost["divisions"],
            "adding and multiplying": work.operations * cost["additions and multiplications"],
        }
        rows.append({"kernel": name, "ns": fastest[name] / pixels, "limits": limits})
    return {"processor": processor(), "cost": cost, "rows": rows}


def text(result: dict[str, Any]) -> str:
    """All of the result as a table in Markdown."""
    lines = [
        f"10⁹ a second on one core of {result['processor']}: "
        + ", ".join(f"{1.0 / value:.3g} {name}" for name, value in result["cost"].items())
        + ".",
        "",
        "| kernel | ns a pixel | reading | dividing | adding and multiplying | of the nearest limit |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for row in result["rows"]:
        limits = " | ".join(f"{value:.3f}" for value in row["limits"].values())
        lines.append(f"| {row['kernel']} | {row['ns']:.3f} | {limits} | {_reached(row)} |")
    return "\n".join(lines)


def _reached(row: dict[str, Any]) -> str:
    return f"{max(row['limits'].values()) / row['ns']:.0%}".replace("%", " %")


def table(result: dict[str, Any]) -> str:
    """What the page says beside the figure."""
    can = {name: 1.0 / value for name, value in result["cost"].items()}
    rows = {row["kernel"]: row for row in result["rows"]}
    large, small = (rows[EXPLICIT.format(tile)] for tile in (20, 10))
    return (
        f"Measured on one core of this processor: {result['processor']}. It divides {can['divisions']:.1f}·10⁹ "
        f"numbers a second, adds or multiplies {can['additions and multiplications']:.0f}·10⁹, and reads "
        f"{can['bytes from the caches']:.0f} GB from its caches. The floor, at {_reached(rows[FLOOR])} of the speed "
        f"that the nearest limit allows, takes {rows[FLOOR]['ns']:.2f} ns a pixel. `range_explicit` takes "
        f"{large['ns']:.2f} ns with tiles of 20, at {_reached(large)}, and {small['ns']:.2f} ns with tiles of 10, at "
        f"{_reached(small)}."
    )


def figure(result: dict[str, Any], path: Path = PICTURE) -> None:
    """Draw the time of a pixel of every kernel, and what the machine allows."""
    from matplotlib.figure import Figure

    rows = result["rows"]
    drawing = Figure(figsize=(8.2, 4.6), layout="constrained")
    axis = drawing.subplots()
    places = np.arange(len(rows))[::-1]
    axis.barh(places, [row["ns"] for row in rows], 0.62, color="#d5dde5", label="measured")
    marks = (("reading", "#2a9d4a", "o"), ("dividing", "#c1440e", "s"), ("adding and multiplying", "#1769aa", "D"))
    for name, colour, marker in marks:
        drawn = [(row["limits"][name], place) for row, place in zip(rows, places, strict=True)]
        drawn = [(value, place) for value, place in drawn if value > 0.0]
        axis.plot(*zip(*drawn, strict=True), marker, color=colour, markersize=5, label=f"limit: {name}")
    for row, place in zip(rows, places, strict=True):
        axis.text(row["ns"], place, f" {row['ns']:.2f}", va="center", fontsize=8)
    axis.set_yticks(places, [row["kernel"] for row in rows], fontsize=8)
    axis.set_xlabel(f"ns a pixel of 640 x 480 with 5 % missing, one core of {result['processor']}")
    axis.set_xlim(0.0, 1.12 * max(row["ns"] for row in rows))
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(frameon=False, fontsize=8, loc="upper right")
    drawing.savefig(path, dpi=130)


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(prog="python -m bench.roofline", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("roofline"), help="folder for table and figure")
    parser.add_argument("--rounds", type=int, default=500)
    arguments = parser.parse_args()
    result = measure(arguments.rounds)
    print(text(result))
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "roofline.md").write_text(text(result) + "\n", encoding="utf-8")
    figure(result, arguments.out / "roofline.png")


if __name__ == "__main__":
    main()
