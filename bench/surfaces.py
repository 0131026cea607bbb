"""``python -m bench.surfaces``: the paper's report one order up.

Operations of summed-area tables, counted by numbers that count; tables and direct sums timed; curvature against Z(X, Y)
and against a quadratic in the frame of the principal components. With real frames also how many flat tiles count as
curved: the environment variable RGBD_PLANES_DATA names their folder.
"""

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

import rgbd_planes as rp
from bench.operations import PAPER_OPERATIONS_PER_TABLE, Number
from bench.real_data import FOLDER
from bench.uncertainty_real import SETS, flat_regions, real_sets
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.camera.rays import ray_tables
from rgbd_planes.fitting.tile_grid import common_labels
from rgbd_planes.kernels.moments import summed_area, surface_tables
from rgbd_planes.noise import KINECT_V1

Floats = npt.NDArray[np.float64]
Exponents = tuple[int, int, int]


def monomials(form: str, is_implicit: bool, order: int) -> list[Exponents]:
    """Exponents of the tables of a frame: of (X, Y, Z) in the standard form, of (u, v, q) in range space."""
    most = 2 * order
    everything = [(i, j, k) for k in range(most + 1) for j in range(most + 1) for i in range(most + 1)]
    if is_implicit:
        return [e for e in everything if sum(e) <= most and (e[2] >= 1 or (form == "standard" and sum(e) >= 1))]
    fitted = [(i, j, 1) for i, j, k in everything if k == 0 and i + j <= order]
    if form == "range":
        return fitted
    return fitted + [e for e in everything if e[2] == 0 and 1 <= e[0] + e[1] <= most]


def count(form: str, is_implicit: bool, order: int) -> dict[str, int]:
    """Tables and operations per pixel by the paper's convention: 4 for each table, and those on what depends on Z.

    Each sum's argument is computed from another by one multiplication, on numbers that tally what is done to them.
    """
    tally: Counter[str] = Counter()
    z = Number(2.0, tally)
    u, v = 0.3, -0.2
    known: dict[Exponents, Any] = {}
    if form == "standard":
        bases: tuple[Any, ...] = (z * u, z * v, z)
        known = {(1, 0, 0): bases[0], (0, 1, 0): bases[1], (0, 0, 1): z}
    else:
        bases = (u, v, 1.0 / z)
        known = {(0, 0, 1): bases[2]}
    wanted = sorted(monomials(form, is_implicit, order), key=sum)
    for exponents in wanted:
        if exponents in known:
            continue
        for axis in range(3):
            lower = tuple(e - (k == axis) for k, e in enumerate(exponents))
            if lower in known:
                known[exponents] = known[lower] * bases[axis]
                break
        else:
            raise AssertionError(exponents)
    for exponents in wanted:  # what is counted is what is wanted
        exact = np.prod([float(base) ** e for base, e in zip(bases, exponents, strict=True)])
        assert np.isclose(float(known[exponents]), exact)
    arguments = tally["multiplications"] + tally["divisions"]
    return {"tables": len(wanted), "operations": arguments + PAPER_OPERATIONS_PER_TABLE * len(wanted)}


def count_all() -> dict[int, dict[str, dict[str, int]]]:
    """Counts by order, 1 to 4, and by form."""
    return {
        order: {
            f"{form} {kind}": count(form, kind == "implicit", order)
            for kind in ("explicit", "implicit")
            for form in ("standard", "range")
        }
        for order in range(1, 5)
    }


def seconds(work: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Fastest processor time of each, taken in turns."""
    fastest = dict.fromkeys(work, np.inf)
    for run in work.values():
        run()
    for _ in range(rounds):
        for name, run in work.items():
            start = time.thread_time()
            run()
            fastest[name] = min(fastest[name], time.thread_time() - start)
    return fastest


def time_all(rounds: int) -> dict[str, float]:
    """Milliseconds of tables and of direct sums on a VGA frame, one thread."""
    camera = rp.Camera(640, 480, 525.0, 525.0, 319.5, 239.5, depth_scale=1000.0)
    found: dict[str, float] = {}
    for name, holes in (("", 0.0), (" with 5 % holes", 0.05)):
        depth = rp.scenes.room().render(camera).measure(holes=holes, seed=1)
        planes, surfaces = rp.TileFitter(camera, 20, num_threads=1), rp.SurfaceFitter(camera, 20, num_threads=1)
        work: dict[str, Callable[[], object]] = {
            f"fit_tiles, 20 x 20{name}": partial(planes.fit, depth, out=planes.fit(depth)),
            f"fit_surfaces, 20 x 20{name}": partial(surfaces.fit, depth, out=surfaces.fit(depth)),
        }
        dense: dict[str, Callable[[], object]] = {
            f"principal_curvatures, 15{name}": partial(rp.principal_curvatures, depth, camera, num_threads=1)
        }
        for some, times in ((work, 5 * rounds), (dense, rounds)):  # apart: large arrays leave the caches cold
            found |= {key: 1e3 * value for key, value in seconds(some, times).items()}
    depth = rp.scenes.room().render(camera).measure(seed=1)
    frame, rays = as_depth_frame(depth, camera).values, ray_tables(camera)
    tables = {n: np.empty((481, 641, n)) for n in (3, 6, 8, 20)}
    built: dict[str, Callable[[], object]] = {
        "tables, order 1, range": partial(summed_area.frame_tables, frame, rays, None, tables[3]),
        "tables, order 1, standard": partial(summed_area.frame_tables, frame, rays, True, tables[8]),
        "tables, order 2, range": partial(surface_tables.range_surface_tables, frame, rays, 0.0, tables[6]),
        "tables, order 2, standard": partial(surface_tables.standard_surface_tables, frame, rays, tables[20]),
    }
    return found | {key: 1e3 * value for key, value in seconds(built, rounds).items()}


def z_of_xy(points: Floats, ray: Floats) -> float:
    """H by least squares of Z on a quadratic in (X, Y), about the point on a ray."""
    x0, y0 = points[len(points) // 2, :2]
    x, y, z = points[:, 0] - x0, points[:, 1] - y0, points[:, 2]
    terms = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    beta = np.linalg.lstsq(terms, z)[0]
    return graph_curvature(beta[1], beta[2], 2.0 * beta[3], beta[4], 2.0 * beta[5])


def in_principal_frame(points: Floats, ray: Floats) -> float:
    """H by least squares of a quadratic in the frame of the points' principal components."""
    mean = points.mean(axis=0)
    axes = np.linalg.svd(points - mean, full_matrices=False)[2]
    axes[2] *= np.sign(axes[2] @ ray)
    x, y, z = ((points - mean) @ axes.T).T
    terms = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    beta = np.linalg.lstsq(terms, z)[0]
    return graph_curvature(beta[1], beta[2], 2.0 * beta[3], beta[4], 2.0 * beta[5])


def graph_curvature(a: float, b: float, r: float, s: float, t: float) -> float:
    """H of a graph, positive where it bulges towards smaller heights, from its derivatives."""
    return float(0.5 * ((1.0 + b * b) * r - 2.0 * a * b * s + (1.0 + a * a) * t) / (1.0 + a * a + b * b) ** 1.5)


SETTINGS = (
    ("sphere 0.3 m at 1.5 m, tile 20", 20, 1.5, 0.3, 1.0, 1.0 / 0.3),
    ("sphere 0.3 m at 1.5 m, tile 40", 40, 1.5, 0.3, 1.0, 1.0 / 0.3),
    ("sphere 0.3 m at 3 m, tile 20", 20, 3.0, 0.3, 1.0, 1.0 / 0.3),
    ("cylinder 0.1 m at 1.5 m, tile 20", 20, 1.5, 0.1, 0.0, 5.0),
)
"""Name, tile, distance of the centre, radius, 1 for a sphere or 0 for a cylinder along x, and the true H."""


def accuracy(runs: int) -> dict[str, dict[str, list[float]]]:
    """Bias and standard deviation of H in 1/m, by setting and method; and the standard deviation that we predict."""
    rng = np.random.default_rng(0)
    found: dict[str, dict[str, list[float]]] = {}
    for name, tile, distance, radius, along, true in SETTINGS:
        middle = 0.5 * (tile - 1)
        camera = rp.Camera(tile, tile, 525.0, 525.0, middle, middle, noise=rp.noise.kinect_v1())
        rays = np.stack([camera.tan_x, camera.tan_y, np.ones(camera.shape)], axis=-1)
        squares = (rays**2 * [along, 1.0, 1.0]).sum(axis=-1)
        k = distance**2 - radius**2
        q = (distance + np.sqrt(distance**2 - k * squares)) / k
        fitter = rp.SurfaceFitter(camera, tile, num_threads=1)
        values: dict[str, list[float]] = {"range, q(u, v)": [], "Z(X, Y)": [], "in principal components": []}
        predicted = []
        for _ in range(runs):
            noisy = q + KINECT_V1 * rng.standard_normal(q.shape)
            one = fitter.fit(1.0 / noisy)
            values["range, q(u, v)"].append(float(one.mean_curvature[0, 0]))
            predicted.append(float(one.mean_curvature_std[0, 0]))
            points = (rays / noisy[..., None]).reshape(-1, 3)
            ray = np.array([0.0, 0.0, 1.0])
            values["Z(X, Y)"].append(z_of_xy(points, ray))
            values["in principal components"].append(in_principal_frame(points, ray))
        found[name] = {key: [float(np.mean(v) - true), float(np.std(v))] for key, v in values.items()}
        found[name]["predicted over observed"] = [float(np.mean(predicted) / np.std(values["range, q(u, v)"]))]
    return found


def found_radii(level: float = 0.01, power: float = 0.9) -> dict[int, list[float]]:
    """By tile: standard deviation of q_uu in 1/m, and the largest ball in front that passes for flat in 1 - ``power``.

    The test is T ~ χ²(3) of independent pixels; of a ball it is the noncentral one.
    """
    needed = brentq(lambda x: ncx2.sf(chi2.isf(level, 3), 3, x) - power, 1.0, 100.0)
    found = {}
    for tile in (16, 20, 30, 40):
        u = (np.arange(tile) - 0.5 * (tile - 1)) / 525.0
        u, v = (grid.ravel() for grid in np.meshgrid(u, u))
        terms = np.column_stack([np.ones_like(u), u, v, u * u, u * v, v * v])
        covariance = KINECT_V1**2 * np.linalg.inv(terms.T @ terms)[3:, 3:]
        bend = np.array([0.5, 0.0, 0.5])  # β of a ball of 1 m radius
        found[tile] = [
            2.0 * float(np.sqrt(covariance[0, 0])),
            float(np.sqrt(bend @ np.linalg.inv(covariance) @ bend / needed)),
        ]
    return found


def flat_called_curved(tile: int = 24) -> dict[str, list[float]]:
    """By real data set: flat tiles, and the shares of them with p_flat below 0.01.

    First by the noise that is estimated from the other half of the frames, then by a Kinect v1's independent noise. The
    flat parts are labelled planes, or windows that a person would call flat. A tile counts that is wholly in one.
    """
    found: dict[str, list[float]] = {}
    for data in real_sets():
        models = rp.estimate_noise(data.first, data.camera), rp.noise.kinect_v1()
        cameras = [data.camera.with_noise(model) for model in models]
        counts = np.zeros(3)
        for depth, labels in zip(data.second, data.labels, strict=True):
            regions = flat_regions(depth, data.camera, labels).astype(np.int32)
            is_flat = common_labels(regions, regions, tile) > 0
            for i, camera in enumerate(cameras):
                surfaces = rp.fit_surfaces(depth, camera, tile)
                counted = is_flat & surfaces.fitted
                counts[i + 1] += np.count_nonzero(surfaces.p_flat[counted] < 0.01)
            counts[0] += np.count_nonzero(counted)
        total = found.setdefault(data.name, [0.0, 0.0, 0.0])
        found[data.name] = [a + b for a, b in zip(total, counts.tolist(), strict=True)]
    return {SETS[name]: [n, a / max(n, 1.0), b / max(n, 1.0)] for name, (n, a, b) in found.items()}


def to_markdown(result: dict[str, Any]) -> str:
    """The report."""
    lines = ["## Operations counted", ""]
    lines += ["| order | explicit: standard / range | ratio | implicit: standard / range | ratio |"]
    lines += ["|---|---|---:|---|---:|"]
    for order, row in result["operations"].items():
        cells = [str(order)]
        for kind in ("explicit", "implicit"):
            a, b = row[f"standard {kind}"], row[f"range {kind}"]
            counted = f"{a['operations']}N / {b['operations']}N ({a['tables']} / {b['tables']} tables)"
            cells += [counted, f"{a['operations'] / b['operations']:.2f}"]
        lines.append(f"| {' | '.join(cells)} |")
    ms = result["ms"]
    lines += ["", "## Time", "", "| work | ms |", "|---|---:|"]
    lines += [f"| {name} | {value:.3f} |" for name, value in ms.items()]
    for order in (1, 2):
        ratio = ms[f"tables, order {order}, standard"] / ms[f"tables, order {order}, range"]
        lines += ["", f"Tables of order {order}: standard over range {ratio:.2f}."]
    lines += ["", "## Mean curvature: bias / standard deviation, 1/m", ""]
    lines += [f"| setting | {' | '.join(METHODS)} |", "|---|" + "---|" * len(METHODS)]
    for name, row in result["accuracy"].items():
        cells = [" / ".join(f"{value:.3f}" for value in row[method]) for method in METHODS]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    lines += ["", "## Balls that are found at 1 % with 90 % power", ""]
    lines += ["| tile | standard deviation of q_uu, 1/m | radius below, m |", "|---:|---:|---:|"]
    lines += [f"| {tile} | {std:.2g} | {radius:.2g} |" for tile, (std, radius) in result["found"].items()]
    if "flat tiles" in result:
        lines += ["", "## Flat tiles that count as curved at 1 %", ""]
        lines += ["| frames | tiles | by the estimated noise | by independent noise |", "|---|---:|---:|---:|"]
        for name, (tiles, estimated, independent) in result["flat tiles"].items():
            lines.append(f"| {name} | {tiles:.0f} | {100.0 * estimated:.1f} % | {100.0 * independent:.1f} % |")
    return "\n".join(lines) + "\n"


METHODS = ("range, q(u, v)", "Z(X, Y)", "in principal components", "predicted over observed")


def main(arguments: list[str] | None = None) -> int:
    """Measure, print the report, and write it."""
    parser = argparse.ArgumentParser(prog="python -m bench.surfaces", description="Surfaces of second order, measured.")
    parser.add_argument("--out", type=Path, metavar="JSON", help="also write the numbers")
    parser.add_argument("--quick", action="store_true", help="few repeats")
    options = parser.parse_args(arguments)
    result = {
        "operations": count_all(),
        "ms": time_all(3 if options.quick else 40),
        "accuracy": accuracy(20 if options.quick else 3000),
        "found": found_radii(),
    }
    if FOLDER.is_dir() and not options.quick:
        result["flat tiles"] = flat_called_curved()
    print(to_markdown(result))
    if options.out is not None:
        options.out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
