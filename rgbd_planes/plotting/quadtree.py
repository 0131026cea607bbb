"""The paper's figure of a segmented frame: depth, and the elements outlined by status."""

import numpy as np
from matplotlib import colormaps
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from rgbd_planes._core.status import TileStatus
from rgbd_planes.plotting.colours import MISSING
from rgbd_planes.plotting.protocols import SegmentedElements
from rgbd_planes.plotting.tiles import (
    PANEL_INCHES,
    depth_limits,
    draw_fitted_depth,
    draw_legend_of_statuses,
    draw_measured_depth,
    fitted_depth,
    panels_with_legends,
)

# The colours of the paper's figure, which has none for pixels that determine no plane; as in `STATUS_COLOURS` the
# green is bluish. They are brighter than the grey image, so that thin lines show on it.
OUTLINES = {
    TileStatus.OK: "#00c272",
    TileStatus.TOO_FEW: "#f02a10",
    TileStatus.DEGENERATE: "#ffc93c",
    TileStatus.ROUGH: "#3d7bff",
}
_SHADE = 0.55
_PANEL_POINTS = 72.0 * PANEL_INCHES


def plot_quadtree(
    segmentation: SegmentedElements, depth_metres: NDArray[np.float64] | None = None, figure: Figure | None = None
) -> Figure:
    """Draw a segmented frame: its depth in colours, and the elements over its depth in grey.

    Parameters
    ----------
    segmentation : QuadtreeSegmentation
    depth_metres : (H, W) float64, optional
        The measured depth in metres, NaN where missing. Without it, the depth of the fitted planes.
    figure : matplotlib Figure, optional
        Drawn into; a new one by default.

    Returns
    -------
    matplotlib Figure
    """
    elements = segmentation.elements
    figure, panels, legends = panels_with_legends(2, elements.camera, figure)
    if depth_metres is None:
        depth_metres = fitted_depth(elements)
        draw_fitted_depth(panels[0], legends[0], depth_metres)
    else:
        draw_measured_depth(panels[0], legends[0], depth_metres)

    nearest, farthest = depth_limits(depth_metres)
    far = np.clip((depth_metres - nearest) / (farthest - nearest), 0.0, 1.0)
    base = (0.75 - 0.55 * far)[..., None]  # grey, darker than what is missing
    palette = np.vstack([np.zeros(4), colormaps["tab20"](_palette_order(len(segmentation.planes)))])
    labels = segmentation.labels
    share = np.where(labels > 0, _SHADE, 0.0)[..., None]
    picture = (1.0 - share) * base + share * palette[labels][..., :3]
    panels[1].imshow(np.where(np.isnan(picture), MISSING, picture), interpolation="nearest")
    counts = {status: int(np.count_nonzero(elements.status == status)) for status in OUTLINES}
    points = _PANEL_POINTS / elements.camera.width  # of a pixel on paper
    for status, colour in OUTLINES.items():
        windows = elements.windows[elements.status == status]
        widest = 0.9 if status == TileStatus.OK else 1.4
        # Thinner around small squares, which lines would hide, and inset by half a line and as much between neighbours.
        lines = np.minimum(widest, 0.06 * points * windows[:, 3])
        inset = lines / points
        panels[1].add_collection(
            PatchCollection(
                [
                    Rectangle((left - 0.5 + by, top - 0.5 + by), across - 2.0 * by, down - 2.0 * by)
                    for (top, left, down, across), by in zip(windows, inset, strict=True)
                ],
                facecolor="none",
                edgecolor=colour,
                linewidth=lines,
            )
        )
    panels[1].set_title(f"{counts[TileStatus.OK]} squares fitted, {len(segmentation.planes)} clusters")
    styles = {
        status: {"facecolor": "none", "edgecolor": colour, "linewidth": 2.0} for status, colour in OUTLINES.items()
    }
    draw_legend_of_statuses(
        legends[1], elements.status, styles, "outlined by status, filled by cluster; light grey: missing"
    )
    return figure


def _palette_order(count: int) -> NDArray[np.int64]:
    """Indices into tab20: its strong colours, then the pale ones, then again; no green, the outlines' own."""
    return np.concatenate([[0, 2, 8, 6, 12, 18, 16, 10, 14], [1, 3, 9, 7, 13, 19, 17, 11, 15]])[np.arange(count) % 18]
