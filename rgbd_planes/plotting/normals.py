"""The figure of dense normals: depth, normals as colours, surface variation."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from matplotlib import colormaps
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.plotting.colours import MISSING, in_image, normal_colours
from rgbd_planes.plotting.tiles import draw_legend_of_normals, draw_measured_depth, draw_scale, panels_with_legends

_FLAT = 1e-6


def plot_normals(
    depth: npt.ArrayLike,
    camera: Camera,
    normals: npt.NDArray[np.float32],
    curvature: npt.NDArray[np.float32],
    *,
    avoid_edges: bool = False,
) -> Figure:
    """Draw a frame's depth, its normals as colours and its surface variation.

    Parameters
    ----------
    depth : (H, W) array_like
    camera : Camera
    normals : (H, W, 3) float32
        From `rgbd_planes.normals`.
    curvature : (H, W) float32
        From `rgbd_planes.curvature`; drawn on a logarithmic scale.
    avoid_edges : bool
        Whether both were computed so.

    Returns
    -------
    matplotlib Figure
    """
    figure, panels, legends = panels_with_legends(3, camera, None)
    draw_measured_depth(panels[0], legends[0], as_depth_frame(depth, camera).metres)

    panels[1].imshow(normal_colours(in_image(normals, camera)), interpolation="nearest")
    panels[1].set_title("Normals")
    draw_legend_of_normals(legends[1])

    magma = colormaps["magma"].with_extremes(bad=MISSING)
    low, high = _curvature_limits(curvature[curvature > 0.0])
    norm = LogNorm(low, high, clip=True)
    image = panels[2].imshow(curvature, cmap=magma, norm=norm, interpolation="nearest")
    panels[2].set_title("Curvature (surface variation)")
    label = "share of the points' variance across the plane\n(noise looks curved if windows are small"
    # A plane across an edge runs along the rays, on which the points spread far.
    label += ")" if avoid_edges else "; edges look flat)"
    bar = draw_scale(legends[2], image, label)
    # Few enough to be legible, whatever the range: matplotlib's own overlap, or are missing.
    ticks = _round_numbers(low, high)
    bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
    bar.minorticks_off()
    return figure


def _curvature_limits(known: npt.NDArray[np.float32]) -> tuple[float, float]:
    """Bounds that a few stray values do not move; anything below a millionth is rounding, not structure."""
    low, high = np.percentile(known, (1.0, 99.5)) if known.size else (1e-3, 1.0)
    low = max(float(low), _FLAT)
    return low, max(float(high), 10.0 * low)


def _round_numbers(low: float, high: float) -> list[float]:
    """Some round numbers between two bounds, of which one is at least ten times the other, for a logarithmic scale."""
    ticks: list[float] = []
    for first_digits in ((1,), (1, 3), (1, 2, 5)):
        powers = range(math.floor(math.log10(low)), math.floor(math.log10(high)) + 1)
        ticks = [float(f"{digit}e{power}") for power in powers for digit in first_digits]
        ticks = [tick for tick in ticks if low <= tick <= high]
        if len(ticks) >= 4:
            break
    return ticks
