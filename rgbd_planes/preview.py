"""Small pictures of a fit, made fast enough to follow a slider; `plotting` makes the figures."""

import base64
import html
import io
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rgbd_planes.colours import MISSING, STATUS_COLOURS, normal_colours
from rgbd_planes.plane_fits import PlacedFits, TileStatus
from rgbd_planes.plotting_segments import NO_PLANE, label_colours, label_image

if TYPE_CHECKING:
    from rgbd_planes.segmentation_result import Segmentation

_WIDEST = 320  # pixels of a panel
_GAP = 8
_LISTED = 4  # planes


def fits_picture(fits: PlacedFits) -> NDArray[np.uint8]:
    """Return the normals as colours and, to the right, the tiles or windows by status.

    Parameters
    ----------
    fits : TilePlanes or WindowPlanes
        Of one frame. Of windows that overlap the smallest is on top.

    Returns
    -------
    (H', W', 3) uint8
        Each panel as large as the frame, but at most 320 pixels wide. Colours as in `TilePlanes.plot`.
    """
    if len(fits.shape) > 2:
        raise ValueError(f"expected the tiles of one frame, got a batch of shape {fits.shape}")
    height, width = fits.camera.shape
    step = max(1.0, width / _WIDEST)
    cells = fits._cells(np.arange(0.0, height, step).astype(int), np.arange(0.0, width, step).astype(int))
    in_image = fits.planes[..., :3] * np.sign([fits.camera.fx, fits.camera.fy, 1.0])
    colours = np.array([STATUS_COLOURS[status] for status in TileStatus])[fits.status]
    # The last is what shows where no window is: its index is -1.
    panels = [np.vstack([c.reshape(-1, 3), MISSING])[cells] for c in (normal_colours(in_image), colours)]
    gap = np.ones((len(cells), _GAP, 3))
    return np.rint(255.0 * np.concatenate([panels[0], gap, panels[1]], axis=1)).astype(np.uint8)


def fits_html(fits: PlacedFits) -> str:
    """Return a few lines of HTML: what was found, a picture, and what its colours mean."""
    batch = len(fits.shape) == 3
    first = fits[0] if batch else fits  # type: ignore[index]
    names = " ".join(
        f'<span style="color:rgb({_css(STATUS_COLOURS[status])})">&#9632;</span>&nbsp;{status.name}'
        for status in TileStatus
        if (first.status == status).any()
    )
    which = " of the first frame" if batch else ""
    return (
        f"<div><div>{html.escape(repr(fits).strip('<>'))}</div>"
        f'<img alt="normals and status" src="data:image/png;base64,{_png(fits_picture(first))}">'
        f"<div><small>Left: normals{which}, red to the right, green up, blue towards the camera, "
        f'<span style="color:rgb({_css(MISSING)})">&#9632;</span>&nbsp;none. Right: {names}.</small></div></div>'
    )


def segments_html(segments: "Segmentation") -> str:
    """Return a few lines of HTML: what was found, a picture of the planes, and the largest of them."""
    step = max(1, -(-segments.camera.width // _WIDEST))
    picture = np.rint(255.0 * label_image(segments)[::step, ::step]).astype(np.uint8)
    colours = label_colours(len(segments))
    largest = " ".join(
        f'<span style="color:rgb({_css(tuple(colours[i]))})">&#9632;</span>&nbsp;{i + 1}:&nbsp;'
        f"{segments.sizes[i]}&nbsp;pixels,&nbsp;d&nbsp;=&nbsp;{segments.planes[i, 3]:.3f}&nbsp;m;"
        for i in np.argsort(-segments.sizes, kind="stable")[:_LISTED]
    )
    return (
        f"<div><div>{html.escape(repr(segments).strip('<>'))}</div>"
        f'<img alt="the planes in colours" src="data:image/png;base64,{_png(picture)}">'
        f"<div><small>The largest: {largest} "
        f'<span style="color:rgb({_css(NO_PLANE)})">&#9632;</span>&nbsp;on no plane, white not measured.'
        f"</small></div></div>"
    )


def _css(colour: tuple[float, ...]) -> str:
    return ",".join(str(round(255 * value)) for value in colour)


def _png(picture: NDArray[np.uint8]) -> str:
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "PNG")
    return base64.b64encode(buffer.getvalue()).decode("ascii")
