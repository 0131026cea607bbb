"""The paper's figures, drawn from what `bench.paper.measure` returns."""

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench.sequence import sequence
from rgbd_planes import segment_quadtree

# One hue a space, one line style a form: the same in every figure.
COLOURS = {"standard": "#c1440e", "range": "#1769aa"}
NAMES = {"standard": "standard", "range": "range space"}
STYLES = {"implicit": "-", "explicit": "--"}

Result = dict[str, Any]


def _axes(title: str, x: str, y: str, columns: int = 1) -> tuple[Figure, list[Axes]]:
    figure = Figure((6.6 * columns, 4.2), layout="constrained")
    panels = figure.subplots(1, columns, squeeze=False)[0]
    for panel in panels:
        panel.set_xlabel(x)
        panel.set_ylabel(y)
        panel.grid(color="0.9")
        panel.spines[["top", "right"]].set_visible(False)
    figure.suptitle(title, fontsize=12)
    return figure, list(panels)


def _line(panel: Axes, x: list[float], y: Any, method: str, label: str, **style: Any) -> None:
    space, form = method.split("_")[:2]
    usual: dict[str, Any] = {"color": COLOURS[space], "linestyle": STYLES[form], "marker": "o", "markersize": 3.5}
    panel.plot(x, y, label=label, **usual | style)


def _name(method: str) -> str:
    space, form = method.split("_")[:2]
    return f"{NAMES[space]}, {form}"


def integral_times_vs_points(result: Result) -> Figure:
    """The paper's figure of the same name: tables and one plane, against the points of the plane."""
    series = result["series"]["integral_times_vs_points"]
    figure, (panel,) = _axes("Summed-area tables and one plane: constant with the window's size", "points", "ms")
    for method, seconds in series["seconds"].items():
        _line(panel, series["points"], np.multiply(seconds, 1e3), method, _name(method))
    panel.set_ylim(bottom=0.0)
    panel.set_xscale("log")
    panel.legend(frameon=False, loc="best")
    return figure


def naive_times_vs_points(result: Result) -> Figure:
    """The paper's figure of the same name: one plane from its pixels, against their number."""
    series = result["series"]["naive_times_vs_points"]
    figure, panels = _axes("One plane from its pixels: linear in their number", "points", "µs", 2)
    for panel, form in zip(panels, ("implicit", "explicit"), strict=True):
        for method, seconds in series["seconds"].items():
            if form in method:
                disparity = method.endswith("disparity")
                label = f"{NAMES[method.split('_')[0]]}{', disparity input' if disparity else ''}"
                style = {"color": "#58a6d6", "marker": "^"} if disparity else {}
                _line(panel, series["points"], np.multiply(seconds, 1e6), method, label, **style)
        panel.set_title(form)
        panel.set_ylim(bottom=0.0)
        panel.legend(frameon=False)
    return figure


def integral_percent_faster_vs_iterations(result: Result) -> Figure:
    """The paper's figure of the same name: how much faster range space is, tables included."""
    series = result["series"]["runtime_comparison"]
    figure, (panel,) = _axes(
        "Range space against standard, tables included", "planes fitted in a frame", "less time, %"
    )
    for form in ("implicit", "explicit"):
        new, old = (np.array(series["seconds"][f"{space}_{form}_integral"]) for space in ("range", "standard"))
        _line(panel, series["planes"], 100.0 * (1.0 - new / old), f"range_{form}", form)
    panel.axhline(45.0, color="0.6", linewidth=0.8)
    panel.axhline(52.0, color="0.6", linewidth=0.8, linestyle="--")
    panel.text(1.0, 45.8, "paper's tables, implicit", fontsize=8, color="0.4")
    panel.text(1.0, 52.8, "paper's tables, explicit", fontsize=8, color="0.4")
    panel.set_ylim(0.0, 100.0)
    panel.set_xscale("log")
    panel.legend(frameon=False)
    return figure


def runtime_comparison(result: Result) -> Figure:
    """The paper's figure of the same name, (a) implicit and (b) explicit: planes of 50x50 pixels."""
    series = result["series"]["runtime_comparison"]
    figure, panels = _axes("Planes of 50x50 pixels from one frame", "planes fitted in a frame", "ms", columns=2)
    for panel, form, letter in zip(panels, ("implicit", "explicit"), "ab", strict=True):
        for method, seconds in series["seconds"].items():
            space, form_, implementation = method.split("_")
            if form_ == form:
                style = {} if implementation == "integral" else {"alpha": 0.55, "marker": "s"}
                label = f"{NAMES[space]}, {implementation}"
                style |= {"linestyle": "-" if implementation == "integral" else ":"}
                _line(panel, series["planes"], np.multiply(seconds, 1e3), method, label, **style)
        panel.set_title(f"({letter}) {form}")
        panel.set_ylim(bottom=0.0)
        panel.legend(frameon=False)
    return figure


def planar_segmentation(result: Result) -> Figure:
    """The paper's figure of the same name: a segmented frame."""
    frames, camera, _ = sequence(1)
    return segment_quadtree(frames[0], camera).plot(frames[0])


def measurement_noise(result: Result) -> Figure:
    """Residual in 1/Z of flat tiles against depth, beside the paper's noise model."""
    noise = result["noise"]
    figure, (panel,) = _axes("Residual in 1/Z of flat 16x16 tiles, and the paper's noise model", "depth, m", "1e-3 / m")
    panel.axhline(noise["paper"] * 1e3, color="black", linewidth=1.2, label="paper: σ_Z / Z² = 1.425e-3 /m")
    offset = -0.06
    for (name, rows), colour in zip(noise["sets"].items(), ("#1769aa", "#c1440e", "#2a9d4a", "0.5"), strict=False):
        middle = np.array([np.mean(row["depth"]) for row in rows]) + offset
        sigma = np.array([row["sigma"] for row in rows]).reshape(-1, 3) * 1e3
        panel.errorbar(
            middle, sigma[:, 1], np.abs(sigma[:, [0, 2]] - sigma[:, [1]]).T,
            fmt="o-", markersize=4, capsize=2, linewidth=1, color=colour, label=name,
        )  # fmt: skip
        offset += 0.04
    panel.set_ylim(0.0, 3.0)
    panel.legend(frameon=False, title="median, 10 % and 90 % of the tiles", title_fontsize=8, fontsize=8)
    return figure


FIGURES: dict[str, tuple[str, Callable[[Result], Figure]]] = {
    "Integral_Times_vs_Points": (
        "Time for the tables and one plane against the plane's points.", integral_times_vs_points),
    "Integral_Percent_Faster_vs_Iterations": (
        "How much less time range space takes than the standard form, tables included.",
        integral_percent_faster_vs_iterations),
    "Naive_Times_vs_Points": (
        "Time for one plane from its pixels against their number.", naive_times_vs_points),
    "Runtime_Comparison": (
        "Time for 1 to 1000 planes of 50x50 pixels of one frame.", runtime_comparison),
    "Planar_Segmentation": (
        "A frame segmented as in the paper: fitted squares outlined green and shaded by cluster, too many "
        "missing pixels red, residual too large blue.", planar_segmentation),
    "Measurement_Noise": (
        "The paper's noise model and the residual of flat tiles.", measurement_noise),
}  # fmt: skip
"""Each figure of the report: its name in the paper, its caption, and what draws it."""
