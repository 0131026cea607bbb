"""The figure of dense normals: depth, normals as colours, surface variation."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from rgbd_planes.camera import Camera
from rgbd_planes.colours import MISSING, in_image, normal_colours
from rgbd_planes.depth import as_depth_frame
from rgbd_planes.plotting import PANEL_INCHES, NotebookFigure, depth_limits, depth_note, panel_height


def plot_surfaces(
    depth: npt.ArrayLike,
    camera: Camera,
    normals: npt.NDArray[np.float32],
    curvature: npt.NDArray[np.float32],
) -> Figure:
    """Draw a frame's depth, its normals as colours and its surface variation.

    Parameters
    ----------
    depth : (H, W) array_like
    camera : Camera
    normals : (H, W, 3) float32
        Of `rgbd_planes.normals`.
    curvature : (H, W) float32
        Of `rgbd_planes.curvature`; drawn on a logarithmic scale.

    Returns
    -------
    matplotlib Figure
    """
    metres = as_depth_frame(depth, camera).metres
    size = 3 * PANEL_INCHES, panel_height(PANEL_INCHES, camera) + 1.0
    figure = NotebookFigure(size, layout="constrained")
    left, middle, right = figure.subplots(1, 3)

    viridis = colormaps["viridis_r"].with_extremes(bad=MISSING)
    near, far = depth_limits(metres)
    image = left.imshow(metres, cmap=viridis, vmin=near, vmax=far, interpolation="nearest")
    left.set_title("Measured depth")
    _bar(figure, left, image, depth_note(metres)).ax.ticklabel_format(useOffset=False)

    middle.imshow(normal_colours(in_image(normals, camera)), interpolation="nearest")
    middle.set_title("Normals")
    # In the place of a colour bar, so that the images keep their size beside each other.
    angle = np.linspace(-1.0, 1.0, 255) * np.pi / 2
    sideways = np.stack([np.sin(angle), 0.0 * angle, -np.cos(angle)], axis=-1)
    upwards = np.stack([0.0 * angle, -np.sin(angle), -np.cos(angle)], axis=-1)
    legend = figure.colorbar(image, ax=middle, orientation="horizontal", shrink=0.8, aspect=20)
    legend.ax.clear()
    legend.ax.imshow(normal_colours(np.stack([sideways, upwards])), aspect="auto", extent=(-90, 90, 2, 0))
    legend.ax.tick_params(labelsize=9, length=2)
    legend.ax.set_yticks([0.5, 1.5], ["right", "up"], fontsize=7)
    legend.ax.set_xlabel(
        "degrees that the surface faces to the right, or up, from facing the camera", fontsize=9
    )

    magma = colormaps["magma"].with_extremes(bad=MISSING)
    low, high = _curvature_limits(curvature[curvature > 0.0])
    image = right.imshow(curvature, cmap=magma, norm=LogNorm(low, high, clip=True), interpolation="nearest")
    right.set_title("Curvature (surface variation)")
    bar = _bar(figure, right, image, "share of the points' variance across the plane")
    # Few enough to be legible, whatever the range: matplotlib's own overlap, or are none.
    ticks = np.geomspace(low, high, 6).tolist()
    bar.set_ticks(ticks, labels=[f"{tick:.2g}" for tick in ticks])
    bar.minorticks_off()
    for axes in (left, middle, right):
        axes.set_xticks([])
        axes.set_yticks([])
        for side in axes.spines.values():
            side.set_visible(False)
    return figure


def _curvature_limits(known: npt.NDArray[np.float32]) -> tuple[float, float]:
    """Bounds that a few stray values do not move."""
    low, high = np.percentile(known, (1.0, 99.5)) if known.size else (1e-3, 1.0)
    return float(low), float(max(high, low * (1.0 + 1e-6) + 1e-12))


def _bar(figure: Figure, axes: Axes, image: object, label: str) -> Colorbar:
    bar = figure.colorbar(image, ax=axes, orientation="horizontal", shrink=0.8, aspect=30)  # type: ignore[arg-type]
    bar.ax.tick_params(labelsize=9, length=2)
    bar.set_label(label, fontsize=9)
    return bar
