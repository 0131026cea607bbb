"""The paper's figure of a segmented frame: depth, depth in colours, and the elements outlined by status."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib import colormaps
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from rgbd_planes.plane_fits import TileStatus
from rgbd_planes.plotting import PANEL_INCHES, NotebookFigure, panel_height

if TYPE_CHECKING:
    from rgbd_planes.quadtree import QuadtreeSegmentation

# The colours of the paper's figure; it has none for pixels that determine no plane.
OUTLINES = {
    TileStatus.OK: ("#00a03c", "plane fitted, shaded by cluster"),
    TileStatus.TOO_FEW: ("#e01b24", "too many missing pixels"),
    TileStatus.DEGENERATE: ("#f5a623", "pixels determine no plane"),
    TileStatus.ROUGH: ("#1c4fd8", "residual too large"),
}
_SHADE = 0.55


def plot_quadtree(
    segmentation: "QuadtreeSegmentation", depth_metres: NDArray[np.float64], figure: Figure | None = None
) -> Figure:
    """Draw a segmented frame: depth in grey, depth in colours, and the elements over the depth.

    Parameters
    ----------
    segmentation : QuadtreeSegmentation
    depth_metres : (H, W) float64
        The measured depth in metres, NaN where missing.
    figure : matplotlib Figure, optional
        Drawn into; a new one by default.

    Returns
    -------
    matplotlib Figure
    """
    elements = segmentation.elements
    if figure is None:
        size = 3 * PANEL_INCHES, panel_height(PANEL_INCHES, elements.camera) + 0.8
        figure = NotebookFigure(size, layout="constrained")
    known = depth_metres[np.isfinite(depth_metres)]
    nearest, farthest = np.percentile(known, [1.0, 99.0]) if known.size else (0.0, 1.0)
    panels = figure.subplots(1, 3)
    grey = colormaps["gray_r"].with_extremes(bad="black")
    limits = {"vmin": nearest, "vmax": max(farthest, nearest + 1e-9)}
    panels[0].imshow(depth_metres, cmap=grey, **limits)
    panels[0].set_title("Depth")
    panels[1].imshow(depth_metres, cmap=colormaps["turbo"].with_extremes(bad="black"), **limits)
    panels[1].set_title(f"Depth, {nearest:.1f} m to {farthest:.1f} m")

    base = np.nan_to_num(grey(np.clip((depth_metres - nearest) / (limits["vmax"] - nearest), 0.0, 1.0)))
    palette = np.vstack([np.zeros(4), colormaps["tab20"](_palette_order(len(segmentation.planes)))])
    labels = segmentation.labels
    share = np.where(labels > 0, _SHADE, 0.0)[..., None]
    panels[2].imshow((1.0 - share) * base[..., :3] + share * palette[labels][..., :3])
    counts = {status: int(np.count_nonzero(elements.status == status)) for status in OUTLINES}
    for status, (colour, _) in OUTLINES.items():
        panels[2].add_collection(
            PatchCollection(
                # Inset by a pixel, so that neighbours' outlines do not cover each other.
                [
                    Rectangle((left + 0.5, top + 0.5), across - 2.0, down - 2.0)
                    for top, left, down, across in elements.windows[elements.status == status]
                ],
                facecolor="none",
                edgecolor=colour,
                linewidth=0.9,
            )
        )
    panels[2].set_title(f"{counts[TileStatus.OK]} squares fitted, {len(segmentation.planes)} clusters")
    for panel in panels:
        panel.set_xticks([])
        panel.set_yticks([])
    handles = [
        Patch(facecolor="none", edgecolor=colour, linewidth=2.0, label=f"{counts[status]}  {meaning}")
        for status, (colour, meaning) in OUTLINES.items()
        if counts[status]
    ]
    figure.legend(handles=handles, loc="outside lower right", ncols=len(handles), frameon=False)
    return figure


def _palette_order(count: int) -> NDArray[np.int64]:
    """Indices into tab20: its strong colours, then the pale ones, then again; no green, the outlines' own."""
    return np.concatenate([[0, 2, 8, 6, 12, 18, 16, 10, 14], [1, 3, 9, 7, 13, 19, 17, 11, 15]])[
        np.arange(count) % 18
    ]
