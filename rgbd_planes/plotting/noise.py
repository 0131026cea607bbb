"""The figure of an estimated noise model: does it fit, and where is the sensor not flat."""

from typing import TYPE_CHECKING, Any, cast

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.text import two_digits
from rgbd_planes.plotting.figures import NotebookFigure, check_figure
from rgbd_planes.plotting.tiles import beyond

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from rgbd_planes.plotting.protocols import Evidence

_PALE = 6.0  # standard deviations of chance that the colours of the bias reach at least
_SEEN, _MODEL, _PLAIN = "#2f6fb0", "#c8442e", "#8a8a8a"


def plot_evidence(evidence: "Evidence", figure: "Figure | None" = None) -> "Figure":
    """Draw what a noise model was estimated from, and the model.

    Parameters
    ----------
    evidence : NoiseEvidence
    figure : matplotlib Figure or SubFigure, optional
        Drawn into, with texts for 15 x 8.2 inches and ``layout="constrained"``; a new one by default.

    Returns
    -------
    matplotlib Figure or SubFigure
        Noise against depth, residual against the size of the tile, p-values; noise and bias over the image.
    """
    check_figure(figure)
    figure = NotebookFigure((15.0, 8.2), layout="constrained") if figure is None else figure
    upper, lower = cast(Any, figure.subfigures(2, 1))
    panels = upper.subplots(1, 3)
    _draw_depth(panels[0], evidence)
    _draw_sizes(panels[1], evidence)
    _draw_p_values(panels[2], evidence)
    maps = lower.subplots(1, 2)
    title = "Noise over the image, as a multiple of the model's"
    _draw_map(maps[0], evidence.noise_map, title, "nothing flat there", cmap="viridis", vmin=0.5, vmax=2.0)
    if evidence.edge_growth > 1.0:
        note = f"     the model's noise grows {two_digits(evidence.edge_growth)}-fold towards the edge"
        maps[0].set_xlabel(maps[0].get_xlabel() + note, fontsize=9)
    bias = 1e3 * np.where(evidence.flatness_count >= 16, evidence.flatness, np.nan)
    some = np.isfinite(bias)
    title = "Bias over the image, of 1/Z: what all large planes have in common, 1e-3 / m"
    if some.any():
        chance = 1e3 * float(np.median(evidence.flatness_std[some]))
        # Wide enough for chance alone to stay pale.
        limit = max(float(np.quantile(np.abs(bias[some]), 0.98)), _PALE * chance)
        _draw_map(maps[1], bias, title, "no large plane", cmap="RdBu_r", vmin=-limit, vmax=limit)
        note = f"     chance alone: ±{two_digits(chance)}e-3 / m (standard deviation)"
        if evidence.frames == 1:
            note += "\nof one frame: what bends in the scene shows, too"
        maps[1].set_xlabel(maps[1].get_xlabel() + note, fontsize=9)
    else:
        _draw_map(maps[1], bias, title, "no large plane", cmap="RdBu_r")
    return figure


def _draw_depth(axes: "Axes", evidence: "Evidence") -> None:
    depth = 1.0 / evidence.inverse_depth
    axes.plot(depth, 1e3 * evidence.sigma, "o", color=_SEEN, label="flat tiles (median)")
    order = np.argsort(depth)
    axes.plot(depth[order], 1e3 * evidence.sigma_fit[order], color=_MODEL, label="model")
    axes.set_ylim(0.0, 1.15e3 * max(evidence.sigma.max(), evidence.sigma_fit.max()))
    title = f"Residual of 1/Z in tiles of {evidence.TILE} x {evidence.TILE} pixels"
    _finish(axes, title, "depth, m", "rms residual, 1e-3 / m")


def _draw_sizes(axes: "Axes", evidence: "Evidence") -> None:
    axes.plot(evidence.sizes, evidence.residuals, "o", color=_SEEN, label="flat tiles and large planes (median)")
    axes.plot(evidence.sizes, evidence.expected, color=_MODEL, label="model")
    independent = np.sqrt(1.0 - 3.0 / evidence.sizes**2)
    reference = int(np.argmin(np.abs(evidence.sizes - evidence.TILE)))
    independent *= evidence.residuals[reference] / independent[reference]
    axes.plot(evidence.sizes, independent, "--", color=_PLAIN, label="if pixels were independent")
    axes.set_xscale("log", base=2)
    ticks = [size for size in (6, 8, 12, 24, 48, 96, 192, 384, 768) if size <= 1.2 * evidence.sizes.max()]
    axes.set_xticks(ticks, [str(size) for size in ticks])
    axes.set_ylim(0.0, 1.25 * max(evidence.residuals.max(), evidence.expected.max()))
    title = "How far errors reach (without what rounding and slant add)"
    _finish(axes, title, "side of the tile or plane, pixels", "rms residual / noise of a pixel")


def _draw_p_values(axes: "Axes", evidence: "Evidence") -> None:
    density = axes.hist(evidence.p_values, bins=20, range=(0.0, 1.0), density=True, color=_SEEN, alpha=0.8)[0]
    axes.set_ylim(0.0, 1.25 * max(1.0, float(np.max(density))))  # the legend above the bars
    axes.axhline(1.0, color=_MODEL, label="if the model were exact")
    title = f"p-values of flat tiles: {evidence._rejected()} below 1 %"
    _finish(axes, title, "p-value", "density")


def _draw_map(axes: "Axes", values: npt.NDArray[np.float64], title: str, grey: str, **style: Any) -> None:
    axes.set_facecolor((0.86, 0.86, 0.86))
    image = axes.imshow(np.ma.masked_invalid(values), interpolation="nearest", **style)
    if np.isfinite(values).any():
        # Beside the map. A colour bar that takes its room from the axes would move the map to the side of its half of
        # the figure, where titles that are wider than a narrow map are cut off.
        wide = 0.05 * max(values.shape[0] / values.shape[1], 1.0)  # of the map's width: beside a narrow one no line
        axes.figure.colorbar(image, cax=axes.inset_axes((1.0 + 0.6 * wide, 0.075, wide, 0.85)), extend=beyond(image))
    axes.set_title(title, fontsize=10)
    axes.set_xlabel(f"grey: {grey}", fontsize=9)
    axes.set_xticks([])
    axes.set_yticks([])


def _finish(axes: "Axes", title: str, x: str, y: str) -> None:
    axes.set_title(title, fontsize=10)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=9)
