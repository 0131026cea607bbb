"""Figures of curvature: mean curvature in diverging colours, with strokes along which surfaces are curved."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.text import percent, two_digits
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.plotting.colours import diverging_colours, in_image, normal_colours
from rgbd_planes.plotting.preview import LEVEL, shown_curvature
from rgbd_planes.plotting.protocols import PlacedSurfaces
from rgbd_planes.plotting.tiles import (
    draw_fitted_depth,
    draw_legend_of_normals,
    draw_measured_depth,
    panels_with_legends,
)

_SHOWN = 0.9  # share of the curvatures whose colours are not beyond the scale


def plot_surfaces(surfaces: PlacedSurfaces, depth: ArrayLike | None = None, figure: Figure | None = None) -> Figure:
    """Draw a fitted frame: depth, normals as colours, and the mean curvature with principal directions.

    Parameters
    ----------
    surfaces : TileSurfaces
        Of one frame.
    depth : (H, W) array_like, optional
        The frame that was fitted. Without it, the depth of the fitted surfaces is drawn.
    figure : matplotlib Figure or SubFigure, optional
        Drawn into; a new one by default.

    Returns
    -------
    matplotlib Figure or SubFigure

    Raises
    ------
    TypeError, ValueError
        The surfaces are those of a batch, or the frame is not their camera's.
    """
    if len(surfaces.shape) > 2:
        raise ValueError(f"expected the surfaces of one frame, got a batch of shape {surfaces.shape}: plot them[i]")
    camera = surfaces.camera
    metres = None if depth is None else as_depth_frame(depth, camera).metres
    figure, panels, legends = panels_with_legends(3, camera, figure)
    if metres is None:
        draw_fitted_depth(panels[0], legends[0], fitted_depth(surfaces))
        panels[0].set_title("Depth of the fitted surfaces")
    else:
        draw_measured_depth(panels[0], legends[0], metres)
    cells = surfaces._cells(np.arange(camera.height), np.arange(camera.width))
    normals = normal_colours(in_image(surfaces.normals, camera)).reshape(-1, 3)
    panels[1].imshow(normals[cells], interpolation="nearest")
    panels[1].set_title("Normals at the centres of the tiles")
    draw_legend_of_normals(legends[1])

    mean, curved, limit = shown_curvature(surfaces)
    colours = diverging_colours(np.where(curved | ~surfaces.fitted, mean, 0.0) / limit).reshape(-1, 3)
    panels[2].imshow(colours[cells], interpolation="nearest")
    _draw_directions(panels[2], surfaces, curved)
    panels[2].set_title("Mean curvature, strokes along the larger one")
    what = "grey: none"
    if camera.noise is not None:
        share = percent(np.mean(curved[surfaces.fitted])) if surfaces.fitted.any() else "0 %"
        what = f"{share} curved, p < {LEVEL:g}; the others white"
    _draw_scale(legends[2], limit, f"1/m, blue hollow, red bulging towards the camera\n({what})")
    return figure


def plot_principal_curvatures(depth: ArrayLike, camera: Camera, curvatures: NDArray[np.float32]) -> Figure:
    """Draw a frame's depth and its principal curvatures, (H, W, 2), from `rgbd_planes.principal_curvatures`."""
    figure, panels, legends = panels_with_legends(3, camera, None)
    draw_measured_depth(panels[0], legends[0], as_depth_frame(depth, camera).metres)
    known = np.abs(curvatures[np.isfinite(curvatures)])
    limit = float(np.quantile(known, _SHOWN)) if known.size else 1.0
    for k, name in enumerate(("First", "Second")):
        panels[k + 1].imshow(diverging_colours(curvatures[..., k].astype(np.float64) / limit), interpolation="nearest")
        panels[k + 1].set_title(f"{name} principal curvature")
        _draw_scale(legends[k + 1], limit, "1/m, blue hollow, red bulging towards the camera")
    return figure


def _draw_scale(legend: Axes, limit: float, label: str) -> None:
    values = np.linspace(-1.0, 1.0, 255)
    image = ScalarMappable(Normalize(-limit, limit), ListedColormap(diverging_colours(values)))
    place = legend.inset_axes((0.1, 0.72, 0.8, 0.16))
    bar = legend.figure.colorbar(image, cax=place, orientation="horizontal", extend="both")
    ticks = [-limit, -limit / 4.0, 0.0, limit / 4.0, limit]
    bar.set_ticks(ticks, labels=[two_digits(tick) for tick in ticks])
    bar.ax.tick_params(labelsize=9, length=2)
    bar.ax.set_xlabel(label, fontsize=9)


def _draw_directions(panel: Axes, surfaces: PlacedSurfaces, curved: NDArray[np.bool_]) -> None:
    """Strokes at the centres of curved tiles, along the direction of the larger curvature."""
    camera, side = surfaces.camera, min(surfaces.tile)
    if side * 640 / camera.width < 8:  # too small to be seen
        return
    curvatures, directions = surfaces.principal_curvatures[curved], surfaces.principal_directions[curved]
    if not len(curvatures):
        return
    larger = np.argmax(np.abs(curvatures), axis=1)
    along = directions[np.arange(len(larger)), larger]
    u, v = surfaces.central_rays[curved].T
    steps = np.stack([camera.fx * (along[:, 0] - u * along[:, 2]), camera.fy * (along[:, 1] - v * along[:, 2])], axis=1)
    length = np.linalg.norm(steps, axis=1, keepdims=True)
    steps = 0.36 * side * steps / np.maximum(length, 1e-9)
    row, column = np.nonzero(curved)
    centres = np.stack(
        [
            column * surfaces.tile[1] + 0.5 * (surfaces.tile_widths[column] - 1),
            row * surfaces.tile[0] + 0.5 * (surfaces.tile_heights[row] - 1),
        ],
        axis=1,
    )
    lines = np.stack([centres - steps, centres + steps], axis=1)
    panel.add_collection(LineCollection(lines.tolist(), colors="black", linewidths=0.8, alpha=0.75))


def fitted_depth(surfaces: PlacedSurfaces) -> Floats:
    """(H, W) depth in metres where each pixel's ray meets its tile's surface; NaN where it does not."""
    camera = surfaces.camera
    cells = surfaces._cells(np.arange(camera.height), np.arange(camera.width))
    beta = np.where(surfaces.fitted[..., None], surfaces.coefficients, np.nan).reshape(-1, 6)[cells]
    centre = surfaces.central_rays.reshape(-1, 2)[cells]
    du, dv = camera.tan_x - centre[..., 0], camera.tan_y - centre[..., 1]
    q = (
        beta[..., 0] + beta[..., 1] * du + beta[..., 2] * dv + beta[..., 3] * du * du + beta[..., 4] * du * dv
        + beta[..., 5] * dv * dv
    )  # fmt: skip
    return np.asarray(1.0 / np.where(q > 0.0, q, np.nan))
