"""Simulated measurements of planes by all methods: ``python -m bench.uncertainty simulate``."""

import itertools
from dataclasses import dataclass

import numpy as np
from scipy import stats

import rgbd_planes as rp
from bench import monte_carlo
from rgbd_planes._core.arrays import Floats

METHODS = ("range_explicit", "range_implicit", "standard_explicit", "standard_implicit", "standard_pca")
INCIDENCES = (0, 15, 30, 45, 60, 75)
DEPTHS = (0.5, 1.0, 2.0, 4.0, 8.0)
TILES = (5, 10, 20, 40)
HOLES = (0.0, 0.3)
INSIDE = stats.norm.isf(0.005)  # of a 99 % interval, in standard errors


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
    offset_short: float
    """How much too small the mean d is, in its standard deviations: a normal that errs to any side makes it smaller."""
    offset_short_expected: float
    """The same to second order: d·θ²/2 less σd²/d, of the angle's and d's predicted standard deviations."""


def simulate(runs: int) -> list[Cell]:
    """Every cell of the grid, all methods on the same measurements."""
    rng = np.random.default_rng(2017)
    cells = []
    for tile, depth, incidence, holes in itertools.product(TILES, DEPTHS, INCIDENCES, HOLES):
        one = monte_carlo.tile_camera(tile, rp.noise.kinect_v1(), left=150, top=100)
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
                part = {name: getattr(fits, name).reshape(times**2, *getattr(fits, name).shape[2:]) for name in names}
                part["mean_q"] = np.nanmean((1.0 / frame).reshape(times, tile, times, tile), axis=(1, 3)).ravel()
                parts[method].append(part)
        count = tile * tile - int(missing.sum())
        rays = np.stack([one.tan_x, one.tan_y, np.ones(one.shape)], axis=-1)[~missing]
        bound = rp.noise.KINECT_V1**2 * np.linalg.inv(rays.T @ rays)
        for method in METHODS:
            values = {name: np.concatenate([p[name] for p in parts[method]]) for name in parts[method][0]}
            key = (method, incidence, depth, tile, holes)
            cells.append(_cell(key, values, alpha, bound, count))
    return cells


def _cell(
    key: tuple[str, int, float, int, float], fits: dict[str, Floats], alpha: Floats, bound: Floats, count: int
) -> Cell:
    """The cell whose method, incidence, depth, tile and holes are ``key``."""
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
    spread, offset = observed.var(axis=0), fits["planes"][:, 3]
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
        offset_plain=float(offset.std() / np.sqrt(np.mean(fits["offset_std"] ** 2))),
        offset_short=float((d - offset.mean()) / offset.std()),
        offset_short_expected=float((0.5 * d * variance[:2].sum() - variance[2] / d) / offset.std()),
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
        groups += [[c for c in of if low <= c.predicted_degrees < high] for low, high in ((0, 1), (1, 10), (10, 1e9))]
        lines.append(
            f"| {method} | " + " | ".join(f"{np.median([c.efficiency for c in g]):.3f}" for g in groups) + " |"
        )
    lines += [
        "",
        "The angle and d themselves are to first order only. range_explicit, observed over reported "
        "(`angle_std`, `offset_std`), by the angle's predicted error; and how much too small the mean d is, in "
        "standard deviations of d, beside what second order says, d·θ²/2 - σd²/d with θ the angle's error:",
        "",
        "| predicted angle error | cells | angle | d, incidence 30° or more | d, facing the camera "
        "| mean d too small, 30° or more | second order | facing | second order |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    explicit = [c for c in cells if c.method == "range_explicit"]
    for low, high in ((0.0, 0.3), (0.3, 1.0), (1.0, 3.0), (3.0, 10.0), (10.0, 1e9)):
        of = [c for c in explicit if low <= c.predicted_degrees < high]
        steep, facing = [c for c in of if c.incidence >= 30], [c for c in of if c.incidence < 30]
        ratios = [
            [c.angle_plain for c in of],
            [c.offset_plain for c in steep],
            [c.offset_plain for c in facing],
            [c.offset_short for c in steep],
            [c.offset_short_expected for c in steep],
            [c.offset_short for c in facing],
            [c.offset_short_expected for c in facing],
        ]
        ranges = [f"{min(r):.3f}–{max(r):.3f}" if r else "–" for r in ratios]
        name = f"{low:g}–{high:g}°" if high < 1e9 else f"above {low:g}°"
        lines.append(f"| {name} | {len(of)} | {' | '.join(ranges)} |")
    return [*lines, ""]
