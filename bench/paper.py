"""Every claim of the paper, measured. `measure` returns what paper.json holds."""

import itertools
import os
import platform
import time
from collections.abc import Callable
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.methods import TABLES, Fit, sensor, windows
from bench.operations import count_all
from bench.prior_work import PriorFit
from bench.sequence import KINECTS, real_frames, rendered_frames, sequence
from bench.timing import Times, change, flush_caches, in_turns
from rgbd_planes import Camera, TileStatus, fit_tiles
from rgbd_planes.noise import KINECT_V1
from rgbd_planes.segmentation.quadtree import QuadtreeFitter

Result = dict[str, Any]

FLIGHT_FRAMES = 5 * 60 * 30
"""Frames of the paper's five-minute flight, at 30 per second."""


def measure(quick: bool, say: Callable[[str], None] = lambda text: None) -> Result:
    """Measure everything; ``quick`` takes fewer repeats and fewer points, for a first look and for CI.

    Returns
    -------
    dict
        ``op_count``, ``time``, ``series``, ``segmentation``, ``noise``, ``machine``: what paper.json holds.
        Times are in seconds, changes in percent of the old side's time: negative is faster.
    """
    rounds = 5 if quick else 41
    steps: list[tuple[str, Callable[[], Result]]] = [
        ("operations", _operations),
        ("summed-area tables", lambda: _tables(5 * rounds)),
        ("planes from built tables", lambda: _planes(5 * rounds)),
        ("naive fits", lambda: _naive(rounds, quick)),
        ("integral fits against the number of points", lambda: _integral_points(rounds, quick)),
        ("up to 1000 planes of a frame", lambda: _plane_counts(rounds, quick)),
        ("segmentation", lambda: _segmentation(3 if quick else 30, 2 if quick else 5)),
        ("noise", lambda: _noise(2 if quick else 1000)),
    ]
    result: Result = {"time": {}, "series": {}}
    for name, step in steps:
        say(name)
        for key, value in step().items():
            if key in ("time", "series"):
                result[key] |= value
            else:
                result[key] = value
    result["machine"] = _machine(quick, rounds)
    return result


def _claim(paper: float | None, measured: float, **more: Any) -> Result:
    return {"paper": paper, "measured": measured, **more}


def _pair(paper: float | None, new: Times, old: Times) -> Result:
    """A claim about how much faster one time is than another."""
    return _claim(
        paper,
        change(new.fastest, old.fastest),
        ratio=old.fastest / new.fastest,
        seconds=[new.fastest, old.fastest],
        measured_median=change(new.median, old.median),
    )


def _fastest(times: dict[str, list[Times]]) -> dict[str, list[float]]:
    return {name: [time_.fastest for time_ in row] for name, row in times.items()}


def _operations() -> Result:
    counts = count_all()
    paper = {"implicit": 2.2, "explicit": 2.6, "naive": 2.0}
    result = {}
    for name, pair in counts.items():
        standard, in_range = pair["standard"], pair["range"]
        # The naive cost is NM² times the arguments: there are no tables to add to.
        cost = attrgetter("arguments" if name == "naive" else "paper_convention")
        result[name] = {
            "paper": paper.get(name),
            "counted": cost(standard) / cost(in_range),
            "executed": standard.executed / in_range.executed,
            "per_pixel": {key: count.to_dict() | {"paper": cost(count)} for key, count in pair.items()},
        }
    return {"op_count": result}


def _tables(rounds: int) -> Result:
    fits = {method: Fit(method, windows(1)) for method in TABLES}
    build = {method: fit.build for method, fit in fits.items()}
    stream = in_turns(build, rounds)
    cold = in_turns(build, rounds, before=flush_caches)
    result = {}
    for form, paper in (("implicit", -45.0), ("explicit", -52.0)):
        new, old = f"range_{form}", f"standard_{form}"
        result[f"sat_{form}"] = _pair(paper, stream[new], stream[old])
        result[f"sat_{form}_cold"] = _pair(None, cold[new], cold[old])
    return {"time": result}


def _planes(rounds: int) -> Result:
    fits = {method: Fit(method, windows(1000)) for method in TABLES}
    for fit in fits.values():
        fit.build()
    new = {f"{method}_new": fit.planes_of_new_windows for method, fit in fits.items()}
    times = in_turns({method: fit.planes for method, fit in fits.items()} | new, rounds)
    seconds = {method: time_.shared_by(1000) for method, time_ in times.items()}
    return {
        "time": {
            "plane_implicit": _pair(-15.0, seconds["range_implicit"], seconds["standard_implicit"]),
            "plane_explicit": _pair(-70.0, seconds["range_explicit"], seconds["standard_explicit"]),
            "plane_implicit_new": _pair(None, seconds["range_implicit_new"], seconds["standard_implicit_new"]),
            "plane_explicit_new": _pair(None, seconds["range_explicit_new"], seconds["standard_explicit_new"]),
            "plane_implicit_vs_explicit": _pair(None, seconds["range_implicit"], seconds["range_explicit"]),
        }
    }


def _naive(rounds: int, quick: bool) -> Result:
    sides = [5, 20, 50] if quick else [5, 10, 20, 30, 40, 50, 60, 70, 80, 90, 100]
    names = [*TABLES, "range_implicit_disparity", "range_explicit_disparity"]
    seconds: dict[str, list[Times]] = {name: [] for name in (*names, "tang", "erdogan")}
    for side in sides:
        fits: dict[str, Fit] = {
            name: Fit(name.removesuffix("_disparity"), windows(20, side), "naive", name.endswith("disparity"))
            for name in names
        } | {form: PriorFit(windows(20, side), form == "tang") for form in ("tang", "erdogan")}
        for name, time_ in in_turns({name: fit.planes for name, fit in fits.items()}, rounds).items():
            seconds[name].append(time_.shared_by(20))
    points = [side * side for side in sides]
    chosen = sides.index(50)
    result = {}
    for form, paper in (("implicit", 15.0), ("explicit", 10.0)):
        old = seconds[f"standard_{form}"][chosen]
        result[f"naive_{form}"] = _pair(paper, seconds[f"range_{form}"][chosen], old)
        result[f"naive_{form}_disparity"] = _pair(None, seconds[f"range_{form}_disparity"][chosen], old)
    for form, new in (("tang", "range_explicit"), ("erdogan", "range_explicit_disparity")):
        result[f"prior_{form}"] = _pair(None, seconds[new][chosen], seconds[form][chosen])
    return {"time": result, "series": {"naive_times_vs_points": {"points": points, "seconds": _fastest(seconds)}}}


def _integral_points(rounds: int, quick: bool) -> Result:
    sides = [10, 100, 400] if quick else [5, 10, 20, 40, 60, 80, 100, 150, 200, 300, 400]
    seconds: dict[str, list[Times]] = {method: [] for method in TABLES}
    for side in sides:
        fits = {method: Fit(method, windows(1, side)) for method in TABLES}
        for method, time_ in in_turns({m: f.frame for m, f in fits.items()}, max(rounds // 2, 5)).items():
            seconds[method].append(time_)
    points = [side * side for side in sides]
    return {"series": {"integral_times_vs_points": {"points": points, "seconds": _fastest(seconds)}}}


def _plane_counts(rounds: int, quick: bool) -> Result:
    counts = [1, 200, 1000] if quick else [1, 2, 5, 10, 20, 50, 100, 200, 350, 500, 700, 1000]
    implementations = ("integral", "naive")
    seconds: dict[str, list[Times]] = {f"{m}_{i}": [] for m in TABLES for i in implementations}
    for count in counts:
        fits = {f"{m}_{i}": Fit(m, windows(count), i) for m in TABLES for i in implementations}
        times = in_turns({name: fit.frame for name, fit in fits.items()}, max(rounds // 2, 3))
        for name, time_ in times.items():
            seconds[name].append(time_)
    at_200 = {name: times[counts.index(200)] for name, times in seconds.items()}
    new, new_explicit = at_200["range_implicit_integral"], at_200["range_explicit_integral"]
    return {
        "time": {
            "windows200_implicit_vs_integral": _pair(-37.0, new, at_200["standard_implicit_integral"]),
            "windows200_implicit_vs_naive": _pair(-28.0, new, at_200["standard_implicit_naive"]),
            "windows200_explicit_vs_integral": _pair(-62.0, new_explicit, at_200["standard_explicit_integral"]),
            "windows200_explicit_vs_implicit": _pair(-50.0, new_explicit, new),
        },
        "series": {"runtime_comparison": {"planes": counts, "seconds": _fastest(seconds)}},
    }


def _segmentation(count: int, rounds: int) -> Result:
    frames, camera, source = sequence(count)
    fitters: dict[str, QuadtreeFitter] = {
        method: QuadtreeFitter(camera, method=method, max_error=0.02, implementation="integral") for method in TABLES
    }
    fitters["range_explicit_direct"] = QuadtreeFitter(camera, max_error=0.02)
    total = dict.fromkeys(fitters, Times(0.0, 0.0))
    for frame in frames:
        work = {name: (lambda f=fitter, d=frame: f.fit(d)) for name, fitter in fitters.items()}
        for name, time_ in in_turns(work, rounds).items():
            total[name] = total[name].plus(time_)
    elements = {
        name: sum(int(np.count_nonzero(fitter.fit(frame).status == TileStatus.OK)) for frame in frames)
        for name, fitter in fitters.items()
    }
    saved = {
        form: (total[f"standard_{form}"].fastest - total[f"range_{form}"].fastest) / len(frames) * FLIGHT_FRAMES
        for form in ("implicit", "explicit")
    }
    direct = _pair(None, total["range_explicit_direct"], total["standard_implicit"])
    return {
        "time": {
            "segmentation_implicit": _pair(-22.0, total["range_implicit"], total["standard_implicit"]),
            "segmentation_explicit": _pair(-32.0, total["range_explicit"], total["standard_explicit"]),
            "segmentation_explicit_vs_implicit": _pair(-66.0, total["range_explicit"], total["range_implicit"]),
            "segmentation_direct_vs_standard": direct,
            "flight_seconds_saved_implicit": _claim(30.0, saved["implicit"]),
            "flight_seconds_saved_explicit": _claim(None, saved["explicit"]),
        },
        "segmentation": {
            "frames": len(frames),
            "source": source,
            "seconds": {name: time_.fastest for name, time_ in total.items()},
            "elements_fitted": elements,
        },
    }


NOISE_BINS = np.arange(0.5, 6.5, 0.5)


def _noise(most: int) -> Result:
    """Residual in 1/Z of flat tiles against depth, on real Kinect frames and on rendered ones."""
    sets: dict[str, tuple[list[Any], Camera]] = {}
    for name in KINECTS:
        real = real_frames(name)
        if real is not None:
            sets[name] = real[0][:most], real[1]
    sets["rendered"] = rendered_frames(1)
    result = {}
    for name, (frames, camera) in sets.items():
        depth, sigma = np.concatenate([_flat_tiles(frame, camera) for frame in frames], axis=1)
        rows = []
        for low, high in itertools.pairwise(NOISE_BINS):
            inside = sigma[(depth >= low) & (depth < high)]
            if len(inside) >= 20:
                low_, median, high_ = np.percentile(inside, [10, 50, 90])
                rows.append(
                    {
                        "depth": [float(low), float(high)],
                        "tiles": len(inside),
                        "sigma": [float(low_), float(median), float(high_)],
                    }
                )
        result[name] = rows
    return {"noise": {"paper": KINECT_V1, "sets": result}}


def _flat_tiles(frame: npt.NDArray[Any], camera: Camera, tile: int = 16) -> npt.NDArray[np.float64]:
    """(2, K) depth in metres and residual in 1/m of a frame's flat tiles.

    Flat is a tile with few missing pixels whose middle the planes of all four neighbours predict to 4e-3 /m:
    the residual itself has no say in it.
    """
    fits = fit_tiles(frame, camera, tile, max_missing=0.1)
    rows, columns = camera.height // tile, camera.width // tile
    middle = tile // 2
    rays = np.stack(
        [
            camera.tan_x[middle::tile, middle::tile][:rows, :columns],
            camera.tan_y[middle::tile, middle::tile][:rows, :columns],
            np.ones((rows, columns)),
        ],
        axis=-1,
    )
    alpha = fits.alpha[:rows, :columns]
    here = (slice(1, -1), slice(1, -1))
    inverse_depth = (alpha * rays).sum(axis=-1)[here]
    flat = inverse_depth > 0.0
    for down, right in ((0, 1), (2, 1), (1, 0), (1, 2)):
        neighbour = alpha[down : down + rows - 2, right : right + columns - 2]
        flat &= np.abs((neighbour * rays[here]).sum(axis=-1) - inverse_depth) < 4e-3
    count = fits.valid_count[:rows, :columns][here][flat]
    sigma = fits.rmse[:rows, :columns][here][flat] * np.sqrt(count / (count - 3.0))
    return np.stack([1.0 / inverse_depth[flat], sigma])


def _machine(quick: bool, rounds: int) -> Result:
    import numba
    import scipy

    import rgbd_planes

    frame, _ = sensor()
    return {
        "processor": processor(),
        "logical_processors": os.cpu_count(),
        "threads_used": 1,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "numba": numba.__version__,
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "rgbd_planes": rgbd_planes.__version__,
        "frame": f"{frame.raw.shape[1]}x{frame.raw.shape[0]} {frame.raw.dtype}, sums in float64",
        "clock": "processor time of the thread, the fastest of interleaved rounds",
        "rounds": rounds,
        "quick": quick,
        "date": time.strftime("%Y-%m-%d"),
    }


def processor() -> str:
    """What the system calls the processor, and which one it is: virtual machines call very different ones the same."""
    try:
        lines = Path("/proc/cpuinfo").read_text().split("\n\n")[0].splitlines()
    except OSError:
        lines = []
    about = {name.strip(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
    if "model name" not in about:
        return platform.processor() or "unknown"
    numbers = [f"{name} {about[key]}" for name, key in (("family", "cpu family"), ("model", "model")) if key in about]
    return about["model name"] + (f" ({', '.join(numbers)})" if numbers else "")
