"""Figures: what a notebook shows, and how high a panel is."""

import io
from typing import Any

from matplotlib.figure import Figure, FigureBase

from rgbd_planes.camera.camera import Camera


def check_figure(figure: Any) -> None:
    """Raise TypeError unless it is a Matplotlib figure, or None for a new one."""
    if figure is not None and not isinstance(figure, FigureBase):
        raise TypeError(f"expected a Figure, got {type(figure).__name__}")


class NotebookFigure(Figure):
    """A figure that a notebook shows, even where pyplot, which would see to that, was never imported."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=80)
        return buffer.getvalue()


def panel_height(width: float, camera: Camera) -> float:
    """Height of a panel: that of its image, unless that is very narrow or very low."""
    return width * min(max(camera.height / camera.width, 0.06), 1.6)
