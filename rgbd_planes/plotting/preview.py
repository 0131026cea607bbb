"""Small pictures of a fit, made fast enough to follow a slider; `plotting` makes the figures."""

import base64
import html
import io
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.status import TileStatus
from rgbd_planes._core.text import two_digits
from rgbd_planes.plotting.colours import (
    CONCAVE,
    CONVEX,
    MISSING,
    NO_PLANE,
    STATUS_COLOURS,
    diverging_colours,
    in_image,
    label_colours,
    normal_colours,
    status_colours,
)
from rgbd_planes.plotting.protocols import PlacedPlanes, PlacedSurfaces, SegmentedElements, SegmentedFrame
from rgbd_planes.plotting.segments import label_image

_WIDEST = 320  # pixels of a panel
_GAP = 8
_LISTED = 4  # planes
DPI = 65  # of a figure: its texts can just be read
LEVEL = 0.01
"""Below this p-value a tile counts as curved."""
_SHOWN = 0.9  # share of the curved tiles whose colours are not beyond the scale


def fits_picture(fits: PlacedPlanes) -> NDArray[np.uint8]:
    """Return the normals as colours and, to the right, the tiles or windows by status.

    Parameters
    ----------
    fits : TilePlanes, WindowPlanes or LabelPlanes
        Of one frame. Of overlapping windows the smallest is on top.

    Returns
    -------
    (H', W', 4) uint8
        RGB and opacity. Each panel as large as the frame, but at most 320 pixels wide. Colours as in `TilePlanes.plot`.
    """
    if len(fits.shape) > 2:
        raise ValueError(f"expected the tiles of one frame, got a batch of shape {fits.shape}: take fits[i]")
    cells = fits._cells(*_sampled(fits.camera.shape))
    normals = normal_colours(in_image(fits.planes[..., :3], fits.camera))
    return _beside(_shown(normals, cells), _shown(status_colours(fits.status), cells))


def _sampled(shape: tuple[int, int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of a frame that a panel shows."""
    step = max(1.0, shape[1] / _WIDEST)
    # Rounding may add one beyond the end.
    rows, columns = (np.minimum(np.arange(0.0, size, step).astype(np.int64), size - 1) for size in shape)
    return rows, columns


def _shown(colours: NDArray[np.float64], cells: NDArray[np.int64]) -> NDArray[np.float64]:
    """The colour of each pixel's tile or window; where there is none, its index is -1."""
    return np.vstack([colours.reshape(-1, 3), MISSING])[cells]


def _beside(left: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.uint8]:
    gap = np.zeros((len(left), _GAP, 4))  # transparent: a page may be light or dark
    opaque = [np.dstack([panel, np.ones(panel.shape[:2])]) for panel in (left, right)]
    return np.rint(255.0 * np.concatenate([opaque[0], gap, opaque[1]], axis=1)).astype(np.uint8)


def fits_html(fits: PlacedPlanes) -> str:
    """Return a few lines of HTML: what was found, a picture, and what its colours mean."""
    batch = len(fits.shape) == 3
    if batch and len(fits.planes) == 0:
        return f"<div>{html.escape(repr(fits).strip('<>'))}</div>"
    first = fits[0] if batch else fits  # type: ignore[index]
    which = " of the first frame" if batch else ""
    return (
        f"<div><div>{html.escape(repr(fits).strip('<>'))}</div>"
        f"{image_html('normals and status', _png(fits_picture(first)))}"
        f"<div><small>Left: normals{which}, red to the right, green up, blue towards the camera, "
        f"{_square(MISSING)}&nbsp;none. Right: {_status_names(first)}.</small></div></div>"
    )


def shown_curvature(surfaces: PlacedSurfaces) -> tuple[Floats, NDArray[np.bool_], float]:
    """S float64 the mean curvature; whether each part is curved, as far as is known; and the limit of the colours."""
    mean = np.where(surfaces.fitted, surfaces.mean_curvature, np.nan)
    curved = surfaces.fitted.copy()
    if surfaces.camera.noise is not None:
        curved &= surfaces.p_flat < LEVEL
    known = np.abs(mean[curved])
    limit = float(np.quantile(known, _SHOWN)) if known.size else 1.0
    return mean, curved, max(limit, 1e-3)


def surfaces_html(surfaces: PlacedSurfaces) -> str:
    """Return a few lines of HTML: what was found, normals and mean curvature as a picture, and what colours mean."""
    batch = len(surfaces.shape) == 3
    if batch and surfaces.shape[0] == 0:
        return f"<div>{html.escape(repr(surfaces).strip('<>'))}</div>"
    first = surfaces[0] if batch else surfaces  # type: ignore[index]
    which = " of the first frame" if batch else ""
    mean, curved, limit = shown_curvature(first)
    cells = first._cells(*_sampled(first.camera.shape))
    normals = normal_colours(in_image(first.normals, first.camera))
    bent = diverging_colours(np.where(curved | ~first.fitted, mean, 0.0) / limit)
    flat = ", white flat as far as the noise tells" if first.camera.noise is not None else ""
    return (
        f"<div><div>{html.escape(repr(surfaces).strip('<>'))}</div>"
        f"{image_html('normals and mean curvature', _png(_beside(_shown(normals, cells), _shown(bent, cells))))}"
        f"<div><small>Left: normals{which}, red to the right, green up, blue towards the camera, "
        f"{_square(MISSING)}&nbsp;none. Right: mean curvature, {_square(CONVEX)}&nbsp;bulging towards the camera, "
        f"{two_digits(limit)}/m and more, {_square(CONCAVE)}&nbsp;hollow{flat}.</small></div></div>"
    )


def segments_html(segments: SegmentedFrame, title: str | None = None, ids: NDArray[np.int32] | None = None) -> str:
    """Return a few lines of HTML: what was found, a picture of the planes, and the largest of them.

    With ``ids`` planes have the numbers and colours of these.
    """
    rows, columns = _sampled(segments.camera.shape)
    picture = np.rint(255.0 * label_image(segments, ids=ids)[rows[:, None], columns]).astype(np.uint8)
    numbers = np.arange(1, len(segments) + 1) if ids is None else ids
    colours = label_colours(int(numbers.max(initial=0)))
    largest = " ".join(
        f"{_square(colours[numbers[i] - 1])}&nbsp;{numbers[i]}:&nbsp;"
        f"{segments.sizes[i]}&nbsp;pixels,&nbsp;d&nbsp;=&nbsp;{segments.planes[i, 3]:.3f}&nbsp;m;"
        for i in np.argsort(-segments.sizes, kind="stable")[:_LISTED]
    )
    return (
        f"<div><div>{html.escape((title or repr(segments)).strip('<>'))}</div>"
        f"{image_html('the planes in colours', _png(picture))}"
        f"<div><small>{f'The largest: {largest} ' if largest else ''}"
        f"{_square(NO_PLANE)}&nbsp;on no plane, white not measured.</small></div></div>"
    )


def quadtree_html(segmentation: SegmentedElements) -> str:
    """Return a few lines of HTML: what was found, the clusters in colours and the elements by status."""
    elements = segmentation.elements
    cells = elements._cells(*_sampled(elements.camera.shape))
    clusters = np.vstack([NO_PLANE, label_colours(len(segmentation.planes))])[segmentation.element_labels]
    picture = _beside(_shown(clusters, cells), _shown(status_colours(elements.status), cells))
    return (
        f"<div><div>{html.escape(repr(segmentation).strip('<>'))}</div>"
        f"{image_html('clusters and status', _png(picture))}"
        f"<div><small>Left: planes, {_square(NO_PLANE)}&nbsp;none. "
        f"Right: {_status_names(elements)}.</small></div></div>"
    )


def _status_names(fits: PlacedPlanes) -> str:
    """The statuses that occur, with their colours."""
    return " ".join(
        f"{_square(STATUS_COLOURS[status])}&nbsp;{status.name}"
        for status in TileStatus
        if (fits.status == status).any()
    )


def _square(colour: Sequence[float] | NDArray[np.float64]) -> str:
    css = ",".join(str(round(255 * value)) for value in colour)
    return f'<span style="color:rgb({css})">&#9632;</span>'


def image_html(description: str, png: bytes) -> str:
    return f'<img alt="{description}" src="data:image/png;base64,{base64.b64encode(png).decode("ascii")}">'


def _png(picture: NDArray[np.uint8]) -> bytes:
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "PNG")
    return buffer.getvalue()
