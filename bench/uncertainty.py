"""Is the uncertainty right? Simulation, real frames, and what it costs.

    python -m bench.uncertainty                    # everything, a few minutes
    python -m bench.uncertainty simulate --runs 2500
    python -m bench.uncertainty real cost

Tables are printed and written to ``report/uncertainty.md``, the simulation's cells to
``report/uncertainty.csv``, the figures of the estimated noise beside them. Real frames are those of
``../shared/data``, where there are any.
"""

import argparse
import csv
import itertools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

import rgbd_planes as rp
from bench.fitting import case, ratio, take_turns
from rgbd_planes.depth import as_depth_frame
from tests import monte_carlo

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
METHODS = ("range_explicit", "range_implicit", "standard_explicit", "standard_implicit", "standard_pca")
INCIDENCES = (0, 15, 30, 45, 60, 75)
DEPTHS = (0.5, 1.0, 2.0, 4.0, 8.0)
TILES = (5, 10, 20, 40)
HOLES = (0.0, 0.3)
FEWEST_TILES, FEWEST_ANGLES = 300, 50  # to say what share of them is rejected; how large their angles are
INSIDE = stats.norm.isf(0.005)  # of a 99 % interval, in standard errors

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Cell:
    """What one method does to one plane, in many measurements."""

    method: str
    incidence: int
    depth: float
    tile: int
    holes: float
    runs: int
    predicted_degrees: float
    """Standard deviation of the angle: the Cramér-Rao bound, first order."""
    bias: float
    """Largest bias of the two tilts and the offset, in standard errors."""
    angle_ratio: float
    """Observed over predicted spread of the tilts, and of the offset along the true normal."""
    offset_ratio: float
    nees: float
    """Mean of δᵀΣ⁻¹δ over 3, and how many standard errors it is from 1; chi-square of the residual as well."""
    nees_error: float
    chi_square: float
    chi_square_error: float
    efficiency: float
    """Cramér-Rao bound over mean square error, of the tilts and the offset, the smaller."""
    angle_plain: float
    """Observed over reported: the angle itself, and d itself, neither to first order."""
    offset_plain: float


def simulate(runs: int) -> list[Cell]:
    """Every cell of the grid, all methods on the same measurements."""
    rng = np.random.default_rng(2017)
    cells = []
    for tile, depth, incidence, holes in itertools.product(TILES, DEPTHS, INCIDENCES, HOLES):
        one = monte_carlo.tile_camera(tile, rp.noise.kinect_v1(), left=150.0, top=100.0)
        alpha = monte_carlo.plane_through_middle(one, depth, incidence)
        missing = rng.random(one.shape) < holes
        times = min(int(np.sqrt(runs)), 2000 // tile)
        many = monte_carlo.repeat(one, times)
        q = np.tile(alpha[0] * one.tan_x + alpha[1] * one.tan_y + alpha[2], (times, times))
        fitters = {m: rp.TileFitter(many, tile, m, max_missing=1.0, significance=0.0) for m in METHODS}
        parts: dict[str, list[dict[str, Floats]]] = {method: [] for method in METHODS}
        for _ in range(max(1, round(runs / times**2))):
            frame = 1.0 / (q + rp.noise.KINECT_V1 * rng.standard_normal(q.shape))
            frame[np.tile(missing, (times, times))] = np.nan
            for method, fitter in fitters.items():
                fits = fitter.fit(frame)
                names = ("alpha", "alpha_covariance", "planes", "rmse_metric", "angle_std", "offset_std")
                part = {
                    name: getattr(fits, name).reshape(times**2, *getattr(fits, name).shape[2:])
                    for name in names
                }
                part["mean_q"] = np.nanmean(
                    (1.0 / frame).reshape(times, tile, times, tile), axis=(1, 3)
                ).ravel()
                parts[method].append(part)
        count = tile * tile - int(missing.sum())
        rays = np.stack([one.tan_x, one.tan_y, np.ones(one.shape)], axis=-1)[~missing]
        bound = rp.noise.KINECT_V1**2 * np.linalg.inv(rays.T @ rays)
        for method in METHODS:
            values = {name: np.concatenate([p[name] for p in parts[method]]) for name in parts[method][0]}
            key = (method, incidence, depth, tile, holes)
            cells.append(_cell(key, values, alpha, bound, count))
    return cells


def _cell(key: tuple[Any, ...], fits: dict[str, Floats], alpha: Floats, bound: Floats, count: int) -> Cell:
    truth = monte_carlo.plane_of(alpha)
    normal, d = truth[:3], truth[3]
    fitted = np.isfinite(fits["planes"][:, 0])
    fits = {name: values[fitted] for name, values in fits.items()}
    runs = int(fitted.sum())
    error = fits["alpha"] - alpha
    across = np.linalg.svd(normal[None])[2][1:]
    # Two tilts (radians) and the offset along the true normal (metres): linear in α, as the fit is.
    linear = np.vstack([-d * across, d * d * normal])
    observed = error @ linear.T
    predicted = linear @ bound @ linear.T
    variance = np.diag(predicted)
    bias = observed.mean(axis=0) / np.sqrt(observed.var(axis=0) / runs)
    square = (observed**2).mean(axis=0)
    nees = np.einsum("ki,ki->k", error, np.linalg.solve(fits["alpha_covariance"], error[..., None])[..., 0])
    freedom = count - 3
    rmse = fits["rmse_metric"] * fits["mean_q"] / fits["planes"][:, 3]
    chi_square = count * rmse**2 / rp.noise.KINECT_V1**2
    angle = 2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(fits["planes"][:, :3] - normal, axis=1), 0.0, 1.0))
    spread = observed.var(axis=0)
    return Cell(
        *key,
        runs=runs,
        predicted_degrees=float(np.degrees(np.sqrt(variance[:2].sum()))),
        bias=float(np.abs(bias).max()),
        angle_ratio=float(np.sqrt(spread[:2].sum() / variance[:2].sum())),
        offset_ratio=float(np.sqrt(spread[2] / variance[2])),
        nees=float(nees.mean() / 3.0),
        nees_error=float((nees.mean() - 3.0) / np.sqrt(6.0 / runs)),
        chi_square=float(chi_square.mean() / freedom),
        chi_square_error=float((chi_square.mean() - freedom) / np.sqrt(2.0 * freedom / runs)),
        efficiency=float(min(variance[:2].sum() / square[:2].sum(), variance[2] / square[2])),
        angle_plain=float(np.sqrt(np.mean(angle**2)) / np.radians(np.sqrt(np.mean(fits["angle_std"] ** 2)))),
        offset_plain=float(fits["planes"][:, 3].std() / np.sqrt(np.mean(fits["offset_std"] ** 2))),
    )


def simulation_report(cells: list[Cell]) -> list[str]:
    """What must hold, method by method, over all cells and by incidence."""

    def share(values: list[bool]) -> str:
        return f"{100.0 * np.mean(values):.1f} %"

    lines = [
        "## Simulation",
        "",
        f"{len(cells) // len(METHODS)} planes: incidence {', '.join(map(str, INCIDENCES))} degrees, depth "
        f"{', '.join(f'{z:g}' for z in DEPTHS)} m, tiles of {', '.join(map(str, TILES))} pixels, "
        f"{' and '.join(f'{h:.0%}' for h in HOLES)} missing; {min(c.runs for c in cells)} measurements of each or more "
        f"with independent noise of {1e3 * rp.noise.KINECT_V1} 1e-3/m, f = 525 pixels. "
        "Bias, spread and efficiency are of the tilts and of the offset along the true normal, which are linear "
        "in the estimate; a 99 % interval holds 99 % of right values, so about 1 % of these cells are outside.",
        "",
        "| method | bias inside 99 % | observed / predicted, tilt | offset | within 2 % | NEES / 3 | inside 99 % "
        "| chi-square / dof | inside 99 % | efficiency, median (least) |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for method in METHODS:
        of = [c for c in cells if c.method == method]
        tilt, offset = [c.angle_ratio for c in of], [c.offset_ratio for c in of]
        nees, chi_square = [c.nees for c in of], [c.chi_square for c in of]
        close = [abs(c.angle_ratio - 1.0) < 0.02 and abs(c.offset_ratio - 1.0) < 0.02 for c in of]
        lines.append(
            f"| {method} | {share([c.bias < stats.norm.isf(0.005 / 3.0) for c in of])} "
            f"| {min(tilt):.3g}–{max(tilt):.3g} | {min(offset):.3g}–{max(offset):.3g} | {share(close)} "
            f"| {min(nees):.3g}–{max(nees):.3g} | {share([abs(c.nees_error) < INSIDE for c in of])} "
            f"| {min(chi_square):.3g}–{max(chi_square):.3g} | {share([abs(c.chi_square_error) < INSIDE for c in of])} "
            f"| {np.median([c.efficiency for c in of]):.3f} ({min(c.efficiency for c in of):.3g}) |"
        )
    lines += [
        "",
        "Efficiency by incidence (median over depths, tiles and holes), and by the angle's predicted error:",
        "",
    ]
    lines += [
        f"| method | {' | '.join(f'{i}°' for i in INCIDENCES)} | below 1° | 1–10° | above |",
        "|---" * (len(INCIDENCES) + 4) + "|",
    ]
    for method in METHODS:
        of = [c for c in cells if c.method == method]
        groups = [[c for c in of if c.incidence == i] for i in INCIDENCES]
        groups += [
            [c for c in of if low <= c.predicted_degrees < high] for low, high in ((0, 1), (1, 10), (10, 1e9))
        ]
        lines.append(
            f"| {method} | "
            + " | ".join(f"{np.median([c.efficiency for c in g]):.3f}" for g in groups)
            + " |"
        )
    lines += [
        "",
        "The angle and d themselves are to first order only. range_explicit, observed over reported "
        "(`angle_std`, `offset_std`), by the angle's predicted error:",
        "",
        "| predicted angle error | cells | angle | d, incidence 30° or more | d, facing the camera |",
        "|---|---|---|---|---|",
    ]
    explicit = [c for c in cells if c.method == "range_explicit"]
    for low, high in ((0.0, 0.3), (0.3, 1.0), (1.0, 3.0), (3.0, 10.0), (10.0, 1e9)):
        of = [c for c in explicit if low <= c.predicted_degrees < high]
        groups = [
            [c.angle_plain for c in of],
            [c.offset_plain for c in of if c.incidence >= 30],
            [c.offset_plain for c in of if c.incidence < 30],
        ]
        ranges = [f"{min(g):.3f}–{max(g):.3f}" if g else "–" for g in groups]
        name = f"{low:g}–{high:g}°" if high < 1e9 else f"above {low:g}°"
        lines.append(f"| {name} | {len(of)} | {' | '.join(ranges)} |")
    return [*lines, ""]


@dataclass(frozen=True)
class RealSet:
    """Frames of one sensor in two halves, and which pixels of the second are known to be flat."""

    name: str
    camera: rp.Camera
    first: list[NDArray[Any]]
    second: list[NDArray[Any]]
    labels: list[NDArray[Any] | None]


SETS = {
    "kinect1_7scenes_seq": "Kinect v1, 7-Scenes",
    "tum_fr2_distorted": "Kinect v1, TUM fr2",
    "primesense_open3d_rgbd": "PrimeSense",
    "realsense_d4xx_aligned_office": "RealSense D4xx",
    "abw_segcomp_cal0": "ABW, calibration 0, labelled",
    "abw_segcomp_cal1": "ABW, calibration 1, labelled",
    "azure_kinect_nfov": "Azure Kinect, depth camera, one frame",
    "azure_kinect_color_1280x720": "Azure Kinect, in the colour camera, one frame",
    "lingbot_active_stereo_a": "active stereo, two frames, resampled",
}


def real_sets() -> list[RealSet]:
    """The sets of the data folder that are of a real sensor and in metres; each once in either direction."""
    from rgbd_planes.images import read_depth

    sets = []
    for folder in SETS:
        if not (DATA / folder / "camera.json").exists():
            continue
        camera = rp.Camera.load(DATA / folder / "camera.json")
        paths = sorted((DATA / folder / "depth").glob("*.png"))
        frames = [read_depth(path) for path in paths]
        labels: list[NDArray[Any] | None] = [
            read_depth(path.parents[1] / "labels" / path.name)
            if (path.parents[1] / "labels" / path.name).exists()
            else None
            for path in paths
        ]
        if len(frames) == 1:
            # Squares of 192 pixels of the one frame, as on a chessboard.
            row, column = np.indices(camera.shape) // 192
            halves = [
                [np.where((row + column) % 2 == i, frames[0], 0).astype(frames[0].dtype)] for i in (0, 1)
            ]
            of = [[None], [None]]
        else:
            halves, of = [frames[::2], frames[1::2]], [labels[::2], labels[1::2]]
        for i in (0, 1):
            sets.append(RealSet(folder, camera, halves[i], halves[1 - i], of[1 - i]))
    return sets


def flat_regions(depth: NDArray[Any], camera: rp.Camera, labels: NDArray[Any] | None) -> NDArray[np.int64]:
    """(H, W) int64: flat parts of a frame, from 1; 0 elsewhere.

    The labelled planes; or else windows of 64x64 pixels, at least nine tenths valid, in which no block of 8x8
    pixels leaves the window's plane by more than one per cent of its distance: what a person would call flat.
    """
    if labels is not None:
        return labels.astype(np.int64)
    side, block = 64, 8
    tiles = rp.fit_tiles(depth, camera, side, max_missing=0.1)
    q = as_depth_frame(depth, camera).inverse_depth
    regions = np.zeros(camera.shape, np.int64)
    for row, column in np.argwhere(tiles.fitted):
        part = np.s_[row * side : (row + 1) * side, column * side : (column + 1) * side]
        if q[part].shape != (side, side):
            continue
        a, b, c = tiles.alpha[row, column]
        residual = (q[part] / (a * camera.tan_x[part] + b * camera.tan_y[part] + c) - 1.0).reshape(
            side // block, block, side // block, block
        )
        enough = np.isfinite(residual).sum(axis=(1, 3)) >= 16
        mean = np.nansum(residual, axis=(1, 3)) / np.maximum(np.isfinite(residual).sum(axis=(1, 3)), 1)
        if enough.all() and np.abs(mean).max() < 0.01:
            regions[part] = 1 + row * tiles.shape[1] + column
    return regions


@dataclass(frozen=True)
class RealResult:
    """Of the second half's flat tiles of one size, by the noise of the first."""

    tiles: int
    rejected: float
    rejected_independent: float
    predicted: float
    observed: float


def real_result(data: RealSet, noise: rp.noise.NoiseModel, size: int) -> RealResult:
    """Share rejected at 1 %; predicted and observed angle to the plane of the whole flat part (degrees, rms)."""
    camera = replace(data.camera, noise=noise)
    plain = replace(data.camera, noise=rp.noise.kinect_v1())
    p, q, predicted, observed = [], [], [], []
    for depth, labels in zip(data.second, data.labels, strict=True):
        regions = flat_regions(depth, data.camera, labels)
        tiles = rp.fit_tiles(depth, camera, size, max_missing=0.1, significance=0.0)
        rows, columns = np.arange(0, camera.height, size), np.arange(0, camera.width, size)
        low = np.minimum.reduceat(np.minimum.reduceat(regions, rows, axis=0), columns, axis=1)
        high = np.maximum.reduceat(np.maximum.reduceat(regions, rows, axis=0), columns, axis=1)
        whole = (tiles.tile_heights[:, None] == size) & (tiles.tile_widths == size)
        region = np.where((low == high) & tiles.fitted & whole, low, 0)
        inside = region > 0
        p.append(tiles.p_value[inside])
        q.append(replace(tiles, camera=plain).p_value[inside])
        merged = rp.merge(tiles, region, significance=0.0)
        # Regions of few tiles are mostly the tile itself.
        enough = np.bincount(region.ravel(), minlength=len(merged.status) + 1)[1:] >= 9
        chosen = inside & (tiles.p_value >= 0.01)
        chosen[chosen] = enough[region[chosen] - 1]
        cosine = np.sum(tiles.planes[chosen, :3] * merged.planes[region[chosen] - 1, :3], axis=-1)
        observed.append(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
        predicted.append(tiles.angle_std[chosen])
    p_all, seen = np.concatenate(p), np.concatenate(observed)
    return RealResult(
        tiles=len(p_all),
        rejected=float(np.mean(p_all < 0.01)) if len(p_all) else np.nan,
        rejected_independent=float(np.mean(np.concatenate(q) < 0.01)) if len(p_all) else np.nan,
        predicted=float(np.sqrt(np.mean(np.concatenate(predicted) ** 2))) if len(seen) else np.nan,
        observed=float(np.sqrt(np.mean(seen**2))) if len(seen) else np.nan,
    )


SIZES = (8, 16, 24)


def measure(folder: Path | None = None) -> list[dict[str, Any]]:
    """Of each set, direction and size of tile, by the noise of the other half and by its own.

    With a ``folder``, the pictures of the estimates go there.
    """
    rows: list[dict[str, Any]] = []
    for data in real_sets():
        noise = rp.estimate_noise(data.first, data.camera)
        own = rp.estimate_noise(data.second, data.camera)
        if folder is not None and (not rows or rows[-1]["data"] != data.name):
            noise.evidence.plot().savefig(folder / f"noise_{data.name}.png", dpi=70)
        for size in SIZES:
            row: dict[str, Any] = {"data": data.name, "size": size}
            for name, of in (("", noise), ("own_", own)):
                result = real_result(data, of, size)
                ratio = result.predicted / result.observed if result.tiles >= FEWEST_ANGLES else np.nan
                row |= {
                    "tiles": result.tiles,
                    f"{name}rejected": result.rejected if result.tiles >= FEWEST_TILES else None,
                    f"{name}angle": ratio if np.isfinite(ratio) else None,
                    "independent": result.rejected_independent,
                }
            rows.append(row)
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as Markdown: both directions in a cell, what is not right in bold."""
    ends = {"rejected": (0.003, 0.03), "angle": (0.75, 1.25)}

    def right(kind: str, value: float) -> bool:
        return ends[kind][0] <= value <= ends[kind][1]

    def count(kind: str, name: str) -> str:
        values = [row[name] for row in rows if row[name] is not None]
        return f"{sum(right(kind, value) for value in values)} of {len(values)}"

    def cell(data: str, size: int, kind: str) -> str:
        values = [row[kind] for row in rows if (row["data"], row["size"]) == (data, size)]
        if not any(value is not None for value in values):
            return ""
        shown = [
            "–" if value is None else f"{100.0 * value:.1f} %" if kind == "rejected" else f"{value:.2f}"
            for value in values
        ]
        return ", ".join(
            text if value is None or right(kind, value) else f"**{text}**"
            for text, value in zip(shown, values, strict=True)
        )

    kinds = [(kind, size) for kind in ends for size in SIZES]
    lines = [
        "| frames | " + " | ".join(f"{kind}, {size} px" for kind, size in kinds) + " |",
        "|---" + "|---:" * len(kinds) + "|",
    ]
    for data in dict.fromkeys(row["data"] for row in rows):
        lines.append(f"| {SETS[data]} | {' | '.join(cell(data, size, kind) for kind, size in kinds)} |")
    least, most = (100.0 * end(row["independent"] for row in rows) for end in (min, max))
    lines += [
        "",
        f"Bold is what is not between 0.3 and 3 %, or 0.75 and 1.25. Right are {count('rejected', 'rejected')} shares, "
        f"of {FEWEST_TILES} tiles or more, and {count('angle', 'angle')} angles, of {FEWEST_ANGLES} or more. With a "
        f"Kinect v1's noise taken as independent, {least:.0f} to {most:.0f} % are rejected. With the noise of the very "
        f"half that is tested, {count('rejected', 'own_rejected')} and {count('angle', 'own_angle')} are right. The "
        "shares that are not, beside what they are then:",
        "",
        "| frames | tile | tiles | rejected by the other half's noise | by its own |",
        "|---|---:|---:|---:|---:|",
    ]
    lines += [
        f"| {SETS[row['data']]} | {row['size']} | {row['tiles']} | {100.0 * row['rejected']:.1f} % "
        f"| {100.0 * row['own_rejected']:.1f} % |"
        for row in rows
        if row["rejected"] is not None and not right("rejected", row["rejected"])
    ]
    return "\n".join(lines)


def real_report(folder: Path) -> list[str]:
    """The two halves of every real set, by tile size."""
    return [
        "## Real frames",
        "",
        "Noise estimated from one half of the frames, tested on the tiles of the other half that lie in one "
        "labelled plane or, where nothing is labelled, in a part that is flat to the eye. Rejected is the share "
        "below the 1 % level. Angle: predicted over observed rms angle of the accepted tiles to the plane of the "
        "whole flat part.",
        "",
        table(measure(folder)),
        "",
    ]


EVERYTHING = ("p_value", "alpha_covariance", "plane_covariance", "angle_std", "offset_std")


def cost_report(repeats: int = 300) -> list[str]:
    """Time of the fit with statistics over that of the fit alone, in turns."""
    frame = case()
    # As a sensor's estimated noise: a table by depth, correlation, a lateral part.
    seen = rp.noise.table([0.1, 0.3, 0.5, 0.8, 1.2], [1.2e-3, 1.4e-3, 1.4e-3, 1.5e-3, 1.8e-3])
    estimated = replace(seen, correlation=((0.3, 2.0),), floor=0.5, spread=0.3, lateral=0.4)
    lines = [
        "## Cost",
        "",
        "640x480, 5 % missing, one thread: a fit and all that a user can ask of it (p-values, covariances of α and of "
        "(n, d), standard deviations of angle and d), over the fit of a camera without noise model; median of the "
        "ratios of times taken in turns, and their quartiles. ROUGH is what the test of significance adds to a fit. "
        "Arrays are used again, but for the last columns.",
        "",
        "| tile | fit, ms | constant noise: ROUGH | everything | estimated noise: ROUGH | everything "
        "| new arrays, constant | estimated |",
        "|---|---|---|---|---|---|---|---|",
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
    parser.add_argument("parts", nargs="*", metavar="simulate | real | cost", help="all, if none is named")
    parser.add_argument("--runs", type=int, default=10000, help="measurements of each plane (10000)")
    parser.add_argument("--out", type=Path, default=Path("report"), help="folder of the report")
    arguments = parser.parse_args()
    parts = arguments.parts or ["simulate", "real", "cost"]
    if unknown := set(parts) - {"simulate", "real", "cost"}:
        parser.error(f"unknown: {', '.join(sorted(unknown))}")
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
