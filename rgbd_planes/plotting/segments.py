"""The figure of a segmentation: planes in colours over the relief of the depth."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.status import Primitive, Reason
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.camera.pixel_pitch import ray_changes
from rgbd_planes.plotting.colours import NO_PLANE, label_colours
from rgbd_planes.plotting.figures import check_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from rgbd_planes.camera.camera import Camera
    from rgbd_planes.plotting.protocols import NamedSurfaces, SegmentedFrame


_NOT_MEASURED = (1.0, 1.0, 1.0)
_NUMBERED = 400  # pixels that a plane must have for its number to be written on it, at 640 x 480
_FONT = 7  # points


def label_image(
    segmentation: SegmentedFrame,
    depth: ArrayLike | None = None,
    ids: NDArray[np.int32] | None = None,
    primitives: NamedSurfaces | None = None,
) -> Floats:
    """(H, W, 3) float64: each pixel in the colour of its plane, light and dark following the surface.

    Dark grey is measured but on no plane, white is missing. Without ``depth`` there is no relief; with ``ids`` a plane
    has the colour of its id instead of its label. Spheres and cylinders of ``primitives`` have colours after those.
    """
    count = len(segmentation) if ids is None else int(ids.max(initial=0))
    several = 0 if primitives is None else len(primitives)
    colours = label_colours(count + several)
    planes = colours[:count] if ids is None else colours[ids - 1]
    palette = np.vstack([[NO_PLANE], planes, colours[count:]])
    image = palette[_shown(segmentation, primitives)]
    if depth is not None:
        frame = as_depth_frame(depth, segmentation.camera)
        image = image * _relief(frame.inverse_depth, segmentation.camera, segmentation.sigma)[..., None]
    image[segmentation.reason == Reason.MISSING] = _NOT_MEASURED
    return np.asarray(np.clip(image, 0.0, 1.0))


def _shown(segmentation: SegmentedFrame, primitives: NamedSurfaces | None) -> NDArray[np.int32]:
    """(H, W) int32: labels of planes, 1..N, and after them of spheres and cylinders, where there is no plane."""
    if primitives is None:
        return segmentation.labels
    number = np.where(primitives.kind >= Primitive.SPHERE, np.arange(len(primitives)) + len(segmentation) + 1, 0)
    others = np.append(0, number)[primitives.labels]
    return np.where(segmentation.labels > 0, segmentation.labels, others).astype(np.int32)


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
    primitives: NamedSurfaces | None = None,
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
    primitives : PrimitiveFits, optional
        Of labels of the same frame. Spheres and cylinders get colours, too, and their radii are written on them.

    Returns
    -------
    matplotlib Figure or SubFigure
    """
    from rgbd_planes.plotting.figures import NotebookFigure, panel_height

    check_figure(figure)
    if primitives is not None:
        check_primitives(primitives, segmentation)
    if figure is None:
        height = max(panel_height(8.0, segmentation.camera) + 0.4, 1.1)  # room for the text, however low the frame
        figure = NotebookFigure((8.0, height), layout="constrained")
    axes = figure.add_subplot()
    axes.imshow(label_image(segmentation, depth, ids, primitives), interpolation="nearest")
    texts = [str(number) for number in (range(1, len(segmentation) + 1) if ids is None else ids)]
    if primitives is not None:
        texts += map(_name, primitives.kind, primitives.radius, primitives.radius_std)
    _write_texts(_shown(segmentation, primitives), texts, axes)
    axes.set_title(segmentation._summary)
    axes.set_xlabel("dark grey: on no plane     white: not measured", fontsize=9)
    axes.set_xticks([])
    axes.set_yticks([])
    return figure


def check_primitives(primitives: NamedSurfaces, segmentation: SegmentedFrame) -> None:
    """Raise an error unless these are primitives of a frame of the same size."""
    if not hasattr(primitives, "radius_std"):
        raise TypeError(f"expected primitives as PrimitiveFits, got {type(primitives).__name__}")
    if primitives.labels.shape != segmentation.labels.shape:
        raise ValueError(
            f"expected primitives of a frame of shape {segmentation.labels.shape}, got {primitives.labels.shape}"
        )


def _name(kind: int, radius: float, std: float) -> str:
    """What is written on a sphere or a cylinder: its radius and how far noise may have moved it."""
    digits = max(0, 1 - math.floor(math.log10(1e3 * std))) if std > 0.0 else 1
    return f"{Primitive(kind).name.lower()}\n{1e3 * radius:.{digits}f} ± {1e3 * std:.{digits}f} mm"


def _write_texts(labels: NDArray[np.int32], texts: list[str], axes: Axes) -> None:
    """Write each large label's text where most of it is around, if no larger one's is there."""
    from scipy.ndimage import find_objects

    least = _NUMBERED * labels.size / (640 * 480)
    points = 72.0 / axes.figure.dpi * np.array(axes.figure.bbox.size)
    high = _FONT * float(np.max(labels.shape[::-1] / points))  # height of the font in pixels of the frame
    boxes = find_objects(labels, max_label=len(texts))
    sizes = np.bincount(labels.ravel(), minlength=len(texts) + 1)[1:]  # of what is shown
    written: list[tuple[float, float, float, float]] = []
    for i in np.argsort(-sizes, kind="stable"):
        if sizes[i] < least:
            break
        box, lines = boxes[i], texts[i].split("\n")
        row, column = _middle(labels[box] == i + 1)
        x, y = float(box[1].start + column), float(box[0].start + row)
        half, tall = (0.32 * max(map(len, lines)) + 0.3) * high, 0.7 * len(lines) * high
        if any(abs(x - at) < half + wide and abs(y - down) < tall + above for at, down, wide, above in written):
            continue
        written.append((x, y, half, tall))
        axes.text(
            x, y, texts[i], ha="center", va="center", fontsize=_FONT, color="black",
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
