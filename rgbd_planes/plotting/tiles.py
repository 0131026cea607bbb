"""The figure of a fit: depth, normals as colours, and the tiles or windows by status.

Figures are made without pyplot: nothing here touches a display, a backend or global state. Imported only
when something is drawn, since matplotlib takes a while.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Patch, Rectangle
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.status import TileStatus
from rgbd_planes._core.text import percent
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.plotting.colours import MISSING, STATUS_COLOURS, in_image, normal_colours, status_colours
from rgbd_planes.plotting.figures import NotebookFigure, check_figure, panel_height
from rgbd_planes.plotting.protocols import PlacedPlanes

STATUS_MEANINGS = {
    TileStatus.OK: "plane fitted",
    TileStatus.TOO_FEW: "too many pixels missing",
    TileStatus.DEGENERATE: "pixels determine no plane",
    TileStatus.ROUGH: "residual too large",
}
_LIGHT = np.array([-0.35, -0.65, -0.67])  # from above, over the camera's left shoulder
PANEL_INCHES = 4.5  # wide
_LEGEND_INCHES = 0.85


def plot_fits(fits: PlacedPlanes, depth: ArrayLike | None = None, figure: Figure | None = None) -> Figure:
    """Draw a fitted frame: depth, normals as colours, and the tiles or windows by status.

    Parameters
    ----------
    fits : TilePlanes, WindowPlanes or LabelPlanes
        Of one frame. Of overlapping windows the smallest is on top.
    depth : (H, W) array_like, optional
        The frame that was fitted. Without it, the depth of the fitted planes is drawn.
    figure : matplotlib Figure or SubFigure, optional
        Drawn into; a new one by default, which `savefig` writes and a notebook shows.

    Returns
    -------
    matplotlib Figure or SubFigure

    Raises
    ------
    TypeError, ValueError
        The planes are those of a batch, or the frame is not their camera's.
    """
    if len(fits.shape) > 2:
        raise ValueError(f"expected the tiles of one frame, got a batch of shape {fits.shape}: plot tiles[i]")
    metres = None if depth is None else as_depth_frame(depth, fits.camera).metres
    figure, panels, legends = panels_with_legends(3, fits.camera, figure)
    if metres is None:
        draw_fitted_depth(panels[0], legends[0], fitted_depth(fits))
    else:
        draw_measured_depth(panels[0], legends[0], metres)
    panels[1].imshow(
        _to_pixels(normal_colours(in_image(fits.planes[..., :3], fits.camera)), fits, MISSING), interpolation="nearest"
    )
    panels[1].set_title("Normals of the planes")
    draw_legend_of_normals(legends[1])
    _draw_status(panels[2], legends[2], fits)
    return figure


def panels_with_legends(count: int, camera: Camera, figure: Figure | None) -> tuple[Figure, list[Axes], list[Axes]]:
    """A figure, a new one for None, with ``count`` panels for images, and places for legends below them."""
    check_figure(figure)
    if figure is None:
        height = panel_height(PANEL_INCHES, camera) + _LEGEND_INCHES + 0.35
        figure = NotebookFigure((count * PANEL_INCHES, height), layout="constrained")
    shares = [panel_height(PANEL_INCHES, camera), _LEGEND_INCHES]
    rows = figure.subplots(
        2, count, squeeze=False, gridspec_kw={"height_ratios": shares, "hspace": 0.0, "wspace": 0.03}
    )
    for panel in rows.flat:
        panel.set_xticks([])
        panel.set_yticks([])
        panel.set_anchor("N")
        for side in panel.spines.values():
            side.set_visible(False)
    return figure, list(rows[0]), list(rows[1])


def depth_limits(depth: Floats) -> tuple[float, float]:
    """Nearest and farthest depth of a colour scale, at least a millimetre apart."""
    known = depth[np.isfinite(depth)]
    # A few stray far pixels must not take the whole scale.
    nearest, farthest = np.percentile(known, [0.5, 99.5]) if known.size else (0.0, 1.0)
    return float(nearest), float(max(farthest, nearest + 1e-3))


def draw_measured_depth(panel: Axes, legend: Axes, metres: Floats) -> None:
    """Draw a frame's depth in colours, grey where it is missing, and the scale of the colours."""
    shown = np.where(metres > 0.0, metres, np.nan)
    missing = percent(np.mean(~np.isfinite(shown)))
    _draw_depth(panel, legend, shown, f"metres     (grey: missing, {missing} of the pixels)")
    panel.set_title("Measured depth")


def draw_fitted_depth(panel: Axes, legend: Axes, metres: Floats) -> None:
    """Draw the depth of `fitted_depth`, as `draw_measured_depth` does."""
    _draw_depth(panel, legend, metres, "metres")
    panel.set_title("Depth of the fitted planes")


def _draw_depth(panel: Axes, legend: Axes, shown: Floats, label: str) -> None:
    nearest, farthest = depth_limits(shown)
    colours = colormaps["viridis_r"].with_extremes(bad=MISSING)
    image = panel.imshow(shown, cmap=colours, vmin=nearest, vmax=farthest)
    draw_scale(legend, image, label).ax.ticklabel_format(useOffset=False)


def beyond(image: Any) -> str:
    """Where an image's values are beyond its colours, which arrows at their scale tell."""
    (low, high), values = image.get_clim(), image.get_array()
    below, above = bool((values < low).any()), bool((values > high).any())
    return "both" if below and above else "min" if below else "max" if above else "neither"


def draw_scale(legend: Axes, image: AxesImage, label: str) -> Colorbar:
    """Draw the scale of an image's colours into the place for a legend."""
    place = legend.inset_axes((0.1, 0.72, 0.8, 0.16))
    bar = legend.figure.colorbar(image, cax=place, orientation="horizontal", extend=beyond(image))
    bar.ax.tick_params(labelsize=9, length=2)
    bar.ax.set_xlabel(label, fontsize=9)
    return bar


def draw_legend_of_normals(legend: Axes) -> None:
    """Draw the half ball of normals that face the camera, as the camera sees it."""
    x, y = np.meshgrid(np.linspace(-1, 1, 201), np.linspace(-1, 1, 201))
    squared = x**2 + y**2
    z = -np.sqrt(np.maximum(1.0 - squared, 0.0))
    ball = np.dstack([normal_colours(np.dstack([x, y, z])), squared <= 1.0])
    axes = legend.inset_axes((0.0, 0.0, 1.0, 1.0))
    axes.imshow(ball, extent=(-1, 1, 1, -1))
    axes.set_xlim(-10.0, 10.0)
    axes.set_ylim(1.75, -1.75)
    axes.set_axis_off()
    style: dict[str, Any] = {"fontsize": 9, "ha": "center", "va": "center"}
    axes.text(0.0, -1.4, "up", **style)
    axes.text(0.0, 1.4, "down", **style)
    axes.text(-1.3, 0.0, "facing left", **(style | {"ha": "right"}))
    axes.text(1.3, 0.0, "facing right", **(style | {"ha": "left"}))


def _draw_status(panel: Axes, legend: Axes, fits: PlacedPlanes) -> None:
    # Lit like a relief: a plane that is wrong catches the eye as a facet that is lit wrongly.
    normals = in_image(fits.planes[..., :3], fits.camera)
    light = np.clip(normals @ (_LIGHT / np.linalg.norm(_LIGHT)), 0.0, 1.0)
    shade = np.where(fits.fitted, 0.6 + 0.55 * light, 1.0)[..., None]
    panel.imshow(
        _to_pixels(np.minimum(status_colours(fits.status) * shade, 1.0), fits, MISSING), interpolation="nearest"
    )
    _draw_outlines(panel, fits)
    panel.set_title(f"{fits._title}, {fits.method}")

    styles = {status: {"color": colour} for status, colour in STATUS_COLOURS.items()}
    draw_legend_of_statuses(legend, fits.status, styles, "light and dark: shaded by the normal")


def draw_legend_of_statuses(
    legend: Axes, statuses: NDArray[np.uint8], styles: Mapping[TileStatus, dict[str, Any]], title: str
) -> None:
    """Draw how many parts have each status, with its name and meaning, beside patches of these styles."""
    handles = [
        Patch(label=f"{np.count_nonzero(statuses == status)}  {status.name}: {meaning}", **styles[status])
        for status, meaning in STATUS_MEANINGS.items()
        if (statuses == status).any()
    ]
    legend.legend(
        handles=handles, loc="upper center", fontsize=9, title=title, title_fontsize=9, alignment="left",
        frameon=False, borderaxespad=0.0, borderpad=0.2, labelspacing=0.2,
    )  # fmt: skip


def _draw_outlines(panel: Axes, fits: PlacedPlanes) -> None:
    outlines = fits._outlines
    smallest = 0.0 if outlines is None else outlines.side * 640 / fits.camera.width
    if outlines is None or smallest < 5:  # lines would hide what they divide
        return
    style: dict[str, Any] = {"edgecolor": "white", "linewidth": 0.5 if smallest >= 12 else 0.3, "alpha": 0.6}
    if len(outlines.windows):
        boxes = [Rectangle((x - 0.5, y - 0.5), width, height) for y, x, height, width in outlines.windows]
        panel.add_collection(PatchCollection(boxes, facecolor="none", **style))
    else:
        panel.vlines(outlines.columns - 0.5, -0.5, fits.camera.height - 0.5, **style)
        panel.hlines(outlines.rows - 0.5, -0.5, fits.camera.width - 0.5, **style)


def _to_pixels(values: Floats, fits: PlacedPlanes, nothing: tuple[float, ...]) -> Floats:
    """(H, W, 3): the values (S, 3) of each tile or window on each of its pixels, and `nothing` on others."""
    cells = fits._cells(np.arange(fits.camera.height), np.arange(fits.camera.width))
    return np.asarray(np.vstack([values.reshape(-1, 3), nothing])[cells])  # -1, no window, is the last


def fitted_depth(fits: PlacedPlanes) -> Floats:
    """(H, W) depth in metres where each pixel's ray meets its tile's or window's plane; NaN where it does not."""
    alpha = _to_pixels(np.where(fits.fitted[..., None], fits.alpha, np.nan), fits, (np.nan,) * 3)
    camera = fits.camera
    inverse_depth = alpha[..., 0] * camera.tan_x + alpha[..., 1] * camera.tan_y + alpha[..., 2]
    return 1.0 / np.where(inverse_depth > 0.0, inverse_depth, np.nan)
