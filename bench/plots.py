"""The plots of the documentation, from docs/measured.json: ``python -m bench.measured --page`` draws them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "images"
OURS, OTHERS, GOOD = "#00796b", "#b0bec5", "#c8e6c9"
_NAMES = {"ours": "rgbd_planes", "opencv": "OpenCV", "open3d": "Open3D", "pcl": "PCL"}
_SENSORS = {
    "kinect1_7scenes_seq": "Kinect v1, 7-Scenes",
    "tum_fr2_distorted": "Kinect v1, TUM fr2",
    "primesense_open3d_rgbd": "PrimeSense",
    "realsense_d4xx_aligned_office": "RealSense D4xx",
    "abw_segcomp_cal0": "ABW scanner, 0",
    "abw_segcomp_cal1": "ABW scanner, 1",
    "azure_kinect_nfov": "Azure Kinect, depth",
    "azure_kinect_color_1280x720": "Azure Kinect, colour",
    "lingbot_active_stereo_a": "active stereo",
    "icl_nuim_evops_gt": "ICL-NUIM, rendered",
}


def tasks(results: dict[str, Any]) -> Figure:
    """The times of three tasks, by library, and what came out."""
    titles = {
        "tiles": "A plane for each tile, 16 x 16:\nmedian error of the normal",
        "segments": "The planes of the frame:\nhow many of 19 were found",
        "normals": "A normal for each pixel:\nmedian error",
    }
    figure = Figure((10.5, 3.2), layout="constrained")
    for axes, (task, title) in zip(figure.subplots(1, 3), titles.items(), strict=True):
        rows = [row for row in results["tasks"]["rows"] if row["task"] == task and row["with"] in _NAMES]
        best: dict[str, Any] = {}
        for row in rows:
            best.setdefault(row["with"], row)
        times = [row["milliseconds"] for row in best.values()]
        colours = [OURS if name == "ours" else OTHERS for name in best]
        bars = axes.barh([_NAMES[name] for name in best], times, color=colours)
        for bar, row in zip(bars, best.values(), strict=True):
            text = row["result"].replace(" planes", "").replace("% of the pixels", " %")
            axes.text(bar.get_width() * 1.25, bar.get_y() + 0.4, text, va="center", fontsize=9)
        axes.set_xscale("log")
        axes.set_xlim(min(times) / 3.0, max(times) * 30.0)
        axes.invert_yaxis()
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("milliseconds")
        _plain(axes)
    return figure


def speed(results: dict[str, Any]) -> Figure:
    """Nanoseconds a pixel of tiles, by method and baseline, and by the size of frame and tile."""
    figure = Figure((10.5, 3.4), layout="constrained")
    bars, size, tile = figure.subplots(1, 3, width_ratios=[1.5, 1.0, 1.0])
    shown = {
        "range_explicit": "range_explicit", "standard_pca": "standard_pca", "NumPy, PCA in XYZ": "NumPy, PCA",
    }  # fmt: skip
    rows = [row for row in results["peers"]["rows"] if row["tile"] == 20]
    by_name = {row["system"]: row for row in rows}
    names = [name for name in by_name if name in shown or "findPlanes" in name or "detect_planar" in name]
    names.sort(key=lambda name: by_name[name]["median_ms"])
    values = [by_name[name]["median_ms"] for name in names]
    colours = [OURS if name in ("range_explicit", "standard_pca") else OTHERS for name in names]
    bars.barh([_short(name) for name in names], values, color=colours)
    bars.set_xscale("log")
    bars.invert_yaxis()
    bars.set_title("640 x 480 in tiles of 20 x 20", fontsize=10)
    bars.set_xlabel("milliseconds, one thread")
    for axes, key, title in ((size, "size", "By size of the frame"), (tile, "tile", "By side of the tile")):
        labels, costs = zip(*results["peers"]["scaling"][key], strict=True)
        axes.plot([str(label) for label in labels], costs, color=OURS, marker="o")
        axes.set_ylim(0.0, 1.1 * max(costs))
        axes.set_title(title, fontsize=10)
        axes.set_ylabel("nanoseconds a pixel")
        axes.tick_params(axis="x", rotation=45)
    for axes in (bars, size, tile):
        _plain(axes)
    return figure


def accuracy(results: dict[str, Any]) -> Figure:
    """The angle error of PCA over that of the fit in 1/Z, on real sensors, with intervals."""
    rows = results["sensors"]
    figure = Figure((10.5, 3.6), layout="constrained")
    axes = figure.add_subplot()
    names = list(dict.fromkeys(row["data"] for row in rows))
    for tile, colour, shift in ((10, OURS, -0.13), (20, "#80cbc4", 0.13)):
        chosen = [row for row in rows if row["tile"] == tile]
        middle, low, high = ([row["ratio"][i] for row in chosen] for i in (0, 1, 2))
        errors = [[m - a for m, a in zip(middle, low, strict=True)], [b - m for m, b in zip(middle, high, strict=True)]]
        places = [names.index(row["data"]) + shift for row in chosen]
        axes.errorbar(middle, places, xerr=errors, fmt="o", color=colour, label=f"tiles of {tile} x {tile}", capsize=2)
    axes.axvline(1.0, color="black", linewidth=0.8)
    axes.set_yticks(range(len(names)), [_SENSORS.get(name, name) for name in names])
    axes.invert_yaxis()
    axes.set_xlabel("error of PCA's normals ÷ error of a fit in 1/Z: right of the line, 1/Z is better")
    axes.legend(frameon=False)
    _plain(axes)
    return figure


def uncertainty(results: dict[str, Any]) -> Figure:
    """The share of flat tiles with a p-value below 0.01, by sensor, for each half of the frames."""
    rows = results["uncertainty"]
    figure = Figure((10.5, 3.6), layout="constrained")
    axes = figure.add_subplot()
    names = list(dict.fromkeys(row["data"] for row in rows))
    axes.axvspan(0.3, 3.0, color=GOOD, label="right")
    axes.axvline(1.0, color="black", linewidth=0.8)
    for size, marker in ((8, "o"), (16, "s"), (24, "^")):
        chosen = [row for row in rows if row["size"] == size and row["tiles"] >= 300]
        shares = [max(100.0 * row["rejected"], 0.03) for row in chosen]
        places = [names.index(row["data"]) for row in chosen]
        axes.scatter(shares, places, marker=marker, s=36, color=OURS, alpha=0.75, label=f"tiles of {size} pixels")
    axes.set_xscale("log")
    axes.set_xticks([0.03, 0.1, 0.3, 1.0, 3.0, 10.0], ["0", "0.1", "0.3", "1", "3", "10"])
    axes.minorticks_off()
    axes.set_yticks(range(len(names)), [_SENSORS.get(name, name) for name in names])
    axes.invert_yaxis()
    axes.set_xlabel("% of flat tiles with a p-value below 0.01: 1 % is what they promise")
    axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    _plain(axes)
    return figure


def segment_scores(results: dict[str, Any]) -> Figure:
    """The share of true planes that were found, here and by OpenCV."""
    kept: dict[str, list[float]] = {}  # ours and theirs
    name = ""
    for row in results["segments"]["scores"]:
        share = 100.0 * row["correct_80"]
        if "OpenCV" in row["name"]:
            kept[name].append(share)
        elif not row["name"].endswith(("moved", "cross-validated")):  # the same frames: only the table has them
            name = row["name"]
            kept[name] = [share]
    figure = Figure((10.5, 3.8), layout="constrained")
    axes = figure.add_subplot()
    places = range(len(kept))
    axes.barh([i - 0.2 for i in places], [pair[0] for pair in kept.values()], 0.38, color=OURS, label="rgbd_planes")
    axes.barh([i + 0.2 for i in places], [pair[1] for pair in kept.values()], 0.38, color=OTHERS, label="OpenCV")
    axes.set_yticks(places, list(kept))
    axes.invert_yaxis()
    axes.set_xlim(0.0, 100.0)
    axes.set_xlabel("% of the true planes found, at 80 % overlap (Hoover et al. 1996)")
    axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    _plain(axes)
    return figure


def methods(results: dict[str, Any]) -> Figure:
    """The median error of normals of tiles, by method."""
    names = ("range_explicit", "range_implicit", "standard_explicit", "standard_implicit", "standard_pca")
    figure = Figure((10.5, 2.8), layout="constrained")
    axes = figure.add_subplot()
    for tile, colour, shift in ((20, OURS, -0.2), (10, "#80cbc4", 0.2)):
        errors = {row["system"]: row["median_deg"] for row in results["peers"]["rows"] if row["tile"] == tile}
        places = [i + shift for i in range(len(names))]
        bars = axes.barh(
            places, [errors[name] for name in names], 0.38, color=colour, label=f"tiles of {tile} x {tile}"
        )
        axes.bar_label(bars, fmt="%.1f°", fontsize=9, padding=3)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.set_xlabel("median error of the normal, degrees: a rendered room, independent noise of a Kinect's size")
    axes.legend(frameon=False)
    _plain(axes)
    return figure


def batch(results: dict[str, Any]) -> Figure:
    """Frames a second of a batch."""
    names = {
        "fit_batch": "fit_batch: fits alone",
        "long": "fit_sequence: 8192 frames in memory",
        "memory": "fit_sequence: 2048 frames in memory",
        "png": "fit_sequence: frames in PNG files",
    }
    figure = Figure((10.5, 2.2), layout="constrained")
    axes = figure.add_subplot()
    rates = [1e3 / results["batch"]["milliseconds"][name] for name in names]
    bars = axes.barh(list(names.values()), rates, color=[OTHERS, OURS, OURS, OURS])
    axes.bar_label(bars, fmt="{:,.0f}", fontsize=9, padding=3)
    axes.invert_yaxis()
    axes.set_xlabel("frames of 640 x 480 a second, tiles of 16 x 16, 2 threads")
    _plain(axes)
    return figure


PLOTS: dict[str, Callable[[dict[str, Any]], Figure]] = {
    "tasks": tasks,
    "speed": speed,
    "accuracy": accuracy,
    "uncertainty": uncertainty,
    "segment_scores": segment_scores,
    "methods": methods,
    "batch": batch,
}


def draw(results: dict[str, Any], folder: Path = FOLDER) -> None:
    """Write all plots."""
    for name, plot in PLOTS.items():
        plot(results).savefig(folder / f"{name}.png", dpi=110)


def _short(name: str) -> str:
    return name.partition(",")[0] if "NumPy" not in name else name


def _plain(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)
