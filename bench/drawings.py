"""Drawings of the documentation that explain rather than show a result."""

import re
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from bench.plots import OTHERS, OURS, _plain
from bench.readme import PAPER

PAGE = PAPER.parents[1] / "robustness.md"


def axes() -> Figure:
    """The camera's axes, a pixel's ray, and a plane with its normal and its distance."""
    figure = Figure((9.0, 3.4), layout="constrained")
    image, space = figure.subplots(1, 2, width_ratios=[1.0, 1.5])
    image.set_title("The image: pixel centres are whole numbers", fontsize=10)
    for column in range(4):
        for row in range(3):
            image.plot(column, row, "o", color=OTHERS)
    image.set(xlim=(-0.5, 3.5), ylim=(2.5, -0.5), aspect="equal", xticks=range(4), yticks=range(3))
    image.set_xlabel("column, to the right")
    image.set_ylabel("row, downwards")
    image.set_xticks(np.arange(-0.5, 4.0), minor=True)
    image.set_yticks(np.arange(-0.5, 3.0), minor=True)
    image.grid(which="minor", color="#dddddd")
    image.tick_params(which="minor", length=0)
    space.set_title("Seen from above: x right, y into the page, z forward", fontsize=10)
    z = np.array([0.35, 3.6])
    x = 0.9 - 0.35 * (z - 1.5)
    space.plot(z, x, color=OURS, linewidth=4)
    space.text(3.62, x[-1], "n·X + d = 0", va="center", color=OURS)
    normal = -np.array([0.35, 1.0]) / np.hypot(0.35, 1.0)  # of (z, x): towards the camera
    foot = -normal * (0.9 + 0.35 * 1.5) / np.hypot(0.35, 1.0)
    arrow = {"arrowstyle": "-|>", "color": "black", "shrinkA": 0, "shrinkB": 0}
    space.plot([0.0, foot[0]], [0.0, foot[1]], ":", color="gray")
    space.text(*(0.42 * foot + [0.06, 0.05]), "d", color="gray")
    middle = np.array([2.2, 0.9 - 0.35 * 0.7])
    space.annotate("", middle + 0.55 * normal, middle, arrowprops=arrow)
    space.text(*(middle + 0.55 * normal + [0.06, -0.02]), "n, towards the camera", va="center")
    ray = np.array([2.9, 0.9 - 0.35 * 1.4])
    space.plot([0.0, ray[0]], [0.0, ray[1]], "--", color="tab:orange")
    space.text(*(0.22 * ray + [0.0, 0.2]), "ray of a pixel", color="tab:orange", va="center", rotation=-8)
    for tip, name in (((0.7, 0.0), "z"), ((0.0, 0.7), "x")):
        space.annotate("", tip, (0.0, 0.0), arrowprops=arrow)
        space.text(*(1.12 * np.array(tip)), name, ha="center", va="center")
    space.set(xlim=(-0.3, 4.6), ylim=(1.7, -0.5), aspect="equal")  # x to the right of who looks along z
    space.set_axis_off()
    return figure


def inverse_depth() -> Figure:
    """A row of a slanted wall in Z and in 1/Z, with a stereo sensor's noise."""
    figure = Figure((9.0, 3.2), layout="constrained")
    generator = np.random.default_rng(3)
    tangent = np.linspace(-0.5, 0.5, 90)
    q = 0.45 + 0.62 * tangent
    noisy = q + generator.normal(0.0, 0.008, q.shape)
    for panel, true, measured, title in (
        (0, 1.0 / q, 1.0 / noisy, "Depth Z: a curve; the noise grows with Z²"),
        (1, q, noisy, "1/Z: a line; the noise is the same everywhere"),
    ):
        plot = figure.add_subplot(1, 2, panel + 1)
        plot.scatter(tangent, measured, s=8, color=OTHERS)
        plot.plot(tangent, true, color=OURS, linewidth=2)
        plot.set_title(title, fontsize=10)
        plot.set_xlabel("tanθx: where a pixel of one row looks")
        plot.set_ylabel("Z, m" if panel == 0 else "1/Z, 1/m")
        _plain(plot)
    return figure


def depth_kinds() -> Figure:
    """A wall that faces the camera: Z, and the distance along the ray, from pixel to pixel."""
    figure = Figure((9.0, 3.0), layout="constrained")
    view, values = figure.subplots(1, 2, width_ratios=[1.2, 1.0])
    view.plot([-1.6, 1.6], [2.0, 2.0], color=OURS, linewidth=4)
    for x in (-1.4, -0.7, 0.0, 0.7, 1.4):
        view.plot([0.0, x], [0.0, 2.0], color="tab:orange", linewidth=1)
        view.plot([x, x], [0.0, 2.0], ":", color="gray", linewidth=1)
    view.plot(0.0, 0.0, "ko")
    view.text(0.75, 0.35, "Z: what this library takes", color="gray")
    view.text(-1.75, 0.35, "distance along the ray", color="tab:orange")
    view.set_title("A wall, seen from above", fontsize=10)
    view.set(xlim=(-2.0, 2.3), ylim=(-0.2, 2.3), aspect="equal")
    view.set_axis_off()
    tangent = np.linspace(-0.7, 0.7, 50)
    values.plot(tangent, np.full(50, 2.0), color="gray", label="Z")
    values.plot(
        tangent, 2.0 * np.hypot(1.0, tangent), color="tab:orange", label="distance: taken for Z, the wall bends"
    )
    values.set_xlabel("tanθx: where a pixel looks")
    values.set_ylabel("metres")
    values.set_ylim(1.9, 2.7)
    values.legend(frameon=False, loc="upper center")
    _plain(values)
    return figure


def paper(page: Path = PAPER) -> Figure:
    """The page's table: changes in time, in the paper and here."""
    rows = re.findall(r"^\| (.*?) \| ([+−]\d+) % \| ([+−]\d+) % \|$", page.read_text(encoding="utf-8"), re.MULTILINE)
    names = [_wrapped(name) for name, *_ in rows]
    theirs, ours = ([float(row[i].replace("−", "-")) for row in rows] for i in (1, 2))
    figure = Figure((10.0, 0.42 * len(rows) + 0.8), layout="constrained")
    plot = figure.add_subplot()
    places = np.arange(len(rows))
    plot.barh(places - 0.2, theirs, 0.38, color=OTHERS, label="paper")
    plot.barh(places + 0.2, ours, 0.38, color=OURS, label="here")
    plot.axvline(0.0, color="black", linewidth=0.8)
    plot.set_yticks(places, names)
    plot.invert_yaxis()
    plot.set_xlabel("change in time, %: left is faster in range space")
    plot.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    _plain(plot)
    return figure


def robustness(page: Path = PAGE) -> Figure:
    """The page's table of damaged files: how many were read all the same, and how many refused."""
    text = page.read_text(encoding="utf-8")
    header = re.search(r"^\| (\| .*) \|\n\|---\|---:", text, re.MULTILINE)
    counts = {
        name: [int(number.replace(",", "")) for number in re.findall(r"[\d,]+", row)]
        for name, row in re.findall(r"^\| (read all the same|refused in words) \|(.*)\|$", text, re.MULTILINE)
    }
    assert header is not None
    formats = [name.strip(" `") for name in header[1].strip("| ").split(" | ")]
    read, refused = counts.values()
    figure = Figure((10.0, 3.2), layout="constrained")
    plot = figure.add_subplot()
    plot.barh(formats, refused, color=OURS, label="refused in words")
    plot.barh(formats, read, left=refused, color=OTHERS, label="read all the same")
    for place, number in enumerate(refused):
        plot.text(number / 2, place, f"{number:,}" if number else "", ha="center", va="center", color="white")
    plot.invert_yaxis()
    plot.set_xlabel("damaged files of each format")
    plot.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    _plain(plot)
    return figure


def _wrapped(name: str) -> str:
    """A long name in two lines."""
    first, _, rest = name.partition(": ")
    if not rest:
        first, _, rest = name.partition(", ")
    return f"{first}\n{rest}" if len(name) > 50 else name
