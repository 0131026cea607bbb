"""Is the uncertainty right? Simulation, real frames, and what it costs.

    python -m bench.uncertainty                    # everything, a few minutes
    python -m bench.uncertainty simulate --runs 2500
    python -m bench.uncertainty real cost

Tables are printed and written to ``report/uncertainty.md``, the simulation's cells to
``report/uncertainty.csv``, the figures of the estimated noise beside them. Real frames are those of
the folder that ``RGBD_PLANES_DATA`` names, where there are any.
"""

import argparse
import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import rgbd_planes as rp
from bench.fitting import case, ratio, take_turns
from bench.real_data import FOLDER, needed
from bench.uncertainty_real import SETS, real_report
from bench.uncertainty_simulation import simulate, simulation_report

EVERYTHING = ("p_value", "alpha_covariance", "plane_covariance", "angle_std", "offset_std")


def cost_report(repeats: int = 300) -> list[str]:
    """Time of the fit with statistics over that of the fit alone, in turns."""
    frame = case()
    # As a sensor's estimated noise: a table by depth, correlation, a lateral part, a falloff.
    seen = rp.noise.table([0.1, 0.3, 0.5, 0.8, 1.2], [1.2e-3, 1.4e-3, 1.4e-3, 1.5e-3, 1.8e-3])
    estimated = replace(seen, correlation=((0.3, 2.0),), floor=0.5, spread=0.3, lateral=0.4, falloff=1.0)
    # Of this one the variance differs within tiles.
    of_flight = rp.noise.time_of_flight(1e-3, 1e-3)
    lines = [
        "## Cost",
        "",
        "640x480, 5 % missing, one thread: a fit and all that a user can ask of it (p-values, covariances of α and of "
        "(n, d), standard deviations of angle and d), over the fit of a camera without noise model; median of the "
        "ratios of times taken in turns, and their quartiles. ROUGH is what the test of significance adds to a fit. "
        "Arrays are used again, but for the last columns.",
        "",
        "| tile | fit, ms | constant noise: ROUGH | everything | estimated noise: ROUGH | everything "
        "| time of flight: everything | new arrays, constant | estimated |",
        "|---|---|---|---|---|---|---|---|---|",
    ]

    def fit(noise: rp.noise.NoiseModel | None, tile: int, names: tuple[str, ...], again: bool) -> Any:
        fitter = rp.TileFitter(replace(frame.camera, noise=noise), tile, num_threads=1)
        out = fitter.fit(frame.depth) if again else None

        def run() -> None:
            fits = fitter.fit(frame.depth, out=out)
            for name in names:
                getattr(fits, name)

        return run

    for tile in (10, 16, 20):
        functions = {
            "plain": fit(None, tile, (), True),
            "rough": fit(rp.noise.kinect_v1(), tile, (), True),
            "all": fit(rp.noise.kinect_v1(), tile, EVERYTHING, True),
            "rough, estimated": fit(estimated, tile, (), True),
            "all, estimated": fit(estimated, tile, EVERYTHING, True),
            "all, time of flight": fit(of_flight, tile, EVERYTHING, True),
            "plain, new": fit(None, tile, (), False),
            "all, new": fit(rp.noise.kinect_v1(), tile, EVERYTHING, False),
            "all, estimated, new": fit(estimated, tile, EVERYTHING, False),
        }
        times = take_turns(functions, repeats)
        cells = [f"{tile} | {1e3 * float(np.median(times['plain'])):.3f}"]
        for name in functions:
            if not name.startswith("plain"):
                of = "plain, new" if name.endswith("new") else "plain"
                low, middle, high = (100.0 * (value - 1.0) for value in ratio(times[name], times[of]))
                cells.append(f"{middle:.1f} % ({low:.1f}–{high:.1f})")
        lines.append(f"| {' | '.join(cells)} |")
    return [*lines, ""]


def main() -> None:
    """Run the parts asked for and write the report."""
    parser = argparse.ArgumentParser(description="Is the uncertainty right, and what does it cost?")
    parser.add_argument("parts", nargs="*", metavar="simulate | real | cost", help="all that can be, if none is named")
    parser.add_argument("--runs", type=int, default=10000, help="measurements of each plane (10000)")
    parser.add_argument("--out", type=Path, default=Path("report"), help="folder of the report")
    arguments = parser.parse_args()
    parts = arguments.parts or ["simulate", *(["real"] if FOLDER.is_dir() else []), "cost"]
    if unknown := set(parts) - {"simulate", "real", "cost"}:
        parser.error(f"unknown: {', '.join(sorted(unknown))}")
    if "real" in parts:
        needed(SETS)  # now, not after the simulation
    arguments.out.mkdir(parents=True, exist_ok=True)
    lines = ["# Uncertainty", ""]
    if "simulate" in parts:
        cells = simulate(arguments.runs)
        with open(arguments.out / "uncertainty.csv", "w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(cells[0].__dict__)
            writer.writerows(cell.__dict__.values() for cell in cells)
        lines += simulation_report(cells)
    if "real" in parts:
        lines += real_report(arguments.out)
    if "cost" in parts:
        lines += cost_report()
    text = "\n".join(lines)
    print(text)
    (arguments.out / "uncertainty.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
