"""The figure of a segmentation: planes in colours over the relief of the depth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.camera.pixel_pitch import ray_changes
from rgbd_planes.plotting.colours import NO_PLANE, label_colours
from rgbd_planes.plotting.figures import check_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from rgbd_planes.camera.camera import Camera
    from rgbd_planes.plotting.protocols import SegmentedFrame


_NOT_MEASURED = (1.0, 1.0, 1.0)
_NUMBERED = 400  # pixels that a plane must have for its number to be written on it, at 640 x 480
_FONT = 7  # points


def label_image(
    segmentation: SegmentedFrame, depth: ArrayLike | None = None, ids: NDArray[np.int32] | None = None
) -> Floats:
    """(H, W, 3) float64: each pixel in the colour of its plane, light and dark following the surface.

    Dark grey is measured but on no plane, white is missing. Without ``depth`` there is no relief; with ``ids`` a plane
    has the colour of its id instead of its label.
    """
    from rgbd_planes._core.status import Reason

    colours = label_colours(len(segmentation)) if ids is None else label_colours(int(ids.max(initial=0)))[ids - 1]
    palette = np.vstack([[NO_PLANE], colours])
    image = palette[segmentation.labels]
    if depth is not None:
        frame = as_depth_frame(depth, segmentation.camera)
        image = image * _relief(frame.inverse_depth, segmentation.camera, segmentation.sigma)[..., None]
    image[segmentation.reason == Reason.MISSING] = _NOT_MEASURED
    return np.asarray(np.clip(image, 0.0, 1.0))


def _relief(inverse_depth: Floats, camera: Camera, sigma: float) -> Floats:
    """(H, W) brightness of a surface lit from the upper left; smoothed, so as not to show the noise.

    A plane has one brightness, even where a lens bends it.
    """
    # In inverse depth, where noise is the same near and far, from pixel to pixel.
    x, y = (_smooth_difference(inverse_depth, axis) for axis in (1, 0))
    if camera.is_distorted:
        (ux, uy), (vx, vy) = ray_changes(camera)
        with np.errstate(invalid="ignore", divide="ignore"):
            determinant = (ux * vy - uy * vx) * np.array([[camera.fx], [camera.fy]])[:, :, None]
            x, y = np.stack([x * vy - y * vx, y * ux - x * uy]) / determinant
    return np.asarray(np.clip(1.0 + 0.12 * np.nan_to_num(x + y) / sigma, 0.7, 1.12))


def _smooth_difference(image: Floats, axis: int) -> Floats:
    """Mean over 5x5 of the differences between neighbours that are both known; 0 where there are none.

    The difference of means would jump beside a missing pixel.
    """
    from scipy.ndimage import uniform_filter

    difference = np.diff(image, axis=axis, prepend=np.nan)
    known = np.isfinite(difference).astype(np.float64)
    mean = uniform_filter(np.nan_to_num(difference), 5) / np.maximum(uniform_filter(known, 5), 0.04)
    return np.asarray(mean)


def plot_segments(
    segmentation: SegmentedFrame,
    depth: ArrayLike | None = None,
    figure: Figure | None = None,
    ids: NDArray[np.int32] | None = None,
) -> Figure:
    """Draw a segmentation.

    Parameters
    ----------
    segmentation : Segmentation
    depth : (H, W) array_like, optional
        The frame that was segmented, for its relief.
    figure : matplotlib Figure or SubFigure, optional
        Drawn into; a new one by default, which `savefig` writes and a notebook shows.
    ids : (N,) int32, optional
        Numbers from 1 by which planes are coloured and called, instead of their labels.

    Returns
    -------
    matplotlib Figure or SubFigure
    """
    from rgbd_planes.plotting.figures import NotebookFigure, panel_height

    check_figure(figure)
    if figure is None:
        height = max(panel_height(8.0, segmentation.camera) + 0.4, 1.1)  # room for the text, however low the frame
        figure = NotebookFigure((8.0, height), layout="constrained")
    axes = figure.add_subplot()
    axes.imshow(label_image(segmentation, depth, ids), interpolation="nearest")
    _write_numbers(segmentation, axes, np.arange(len(segmentation)) + 1 if ids is None else ids)
    axes.set_title(segmentation._summary)
    axes.set_xlabel("dark grey: on no plane     white: not measured", fontsize=9)
    axes.set_xticks([])
    axes.set_yticks([])
    return figure


def _write_numbers(segmentation: SegmentedFrame, axes: Axes, numbers: NDArray[np.integer]) -> None:
    """Write each large plane's number where most of the plane is around it, if no larger plane's is there."""
    labels = segmentation.labels
    least = _NUMBERED * labels.size / (640 * 480)
    points = 72.0 / axes.figure.dpi * np.array(axes.figure.bbox.size)
    high = _FONT * float(np.max(labels.shape[::-1] / points))  # height of the font in pixels of the frame
    boxes = segmentation._boxes
    sizes = np.bincount(labels.ravel(), minlength=len(segmentation) + 1)[1:]  # of what is shown
    written: list[tuple[float, float, float]] = []
    for i in np.argsort(-sizes, kind="stable"):
        if sizes[i] < least:
            break
        box = boxes[i]
        row, column = _middle(labels[box] == i + 1)
        x, y, text = float(box[1].start + column), float(box[0].start + row), str(numbers[i])
        half = (0.32 * len(text) + 0.3) * high
        if any(abs(x - at) < half + wide and abs(y - down) < 1.4 * high for at, down, wide in written):
            continue
        written.append((x, y, half))
        axes.text(
            x, y, text, ha="center", va="center", fontsize=_FONT, color="black",
            bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "alpha": 0.6, "linewidth": 0},
        )  # fmt: skip


def _middle(mask: NDArray[np.bool_]) -> tuple[int, int]:
    """Row and column of the pixel of a mask around which most of it is; its small holes do not matter."""
    from scipy.ndimage import gaussian_filter

    step = max(1, int(np.count_nonzero(mask) ** 0.5 / 16))  # leaves some 256 pixels, which is fine enough
    step = step if mask[::step, ::step].any() else 1
    thin = mask[::step, ::step]
    around = np.where(thin, gaussian_filter(thin.astype(np.float64), 4.0, mode="constant"), 0.0)
    row, column = np.unravel_index(np.argmax(around), around.shape)
    return int(row) * step, int(column) * step
