"""What a figure needs of the result that it draws."""

from __future__ import annotations

from typing import ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.arrays import Floats, Indices
from rgbd_planes.camera.camera import Camera


class Outlines(NamedTuple):
    """Lines between the parts of a frame.

    Attributes
    ----------
    side : float
        Typical shorter side of a part, in pixels.
    windows : (K, 4) int64
        Rectangles: row, column, height, width.
    rows, columns : (R,) and (C,) int64
        Where lines cross the whole frame: the first pixel after each.
    """

    side: float
    windows: Indices = np.empty((0, 4), np.int64)
    rows: Indices = np.empty(0, np.int64)
    columns: Indices = np.empty(0, np.int64)


class PlacedPlanes(Protocol):
    """Planes of parts that have a place in the image: tiles, windows, labels."""

    @property
    def camera(self) -> Camera: ...
    @property
    def method(self) -> str: ...
    @property
    def planes(self) -> Floats: ...
    @property
    def alpha(self) -> Floats: ...
    @property
    def status(self) -> NDArray[np.uint8]: ...
    @property
    def shape(self) -> tuple[int, ...]: ...
    @property
    def fitted(self) -> NDArray[np.bool_]: ...
    @property
    def _title(self) -> str: ...
    @property
    def _outlines(self) -> Outlines | None: ...
    def _cells(self, rows: Indices, columns: Indices) -> Indices: ...


class PlacedWindows(PlacedPlanes, Protocol):
    """Planes of rectangles."""

    @property
    def windows(self) -> Indices: ...


class SegmentedFrame(Protocol):
    """A frame whose pixels have labels, and these labels planes."""

    @property
    def camera(self) -> Camera: ...
    @property
    def labels(self) -> NDArray[np.int32]: ...
    @property
    def planes(self) -> Floats: ...
    @property
    def sizes(self) -> NDArray[np.int32]: ...
    @property
    def reason(self) -> NDArray[np.uint8]: ...
    @property
    def sigma(self) -> float: ...
    @property
    def _summary(self) -> str: ...
    @property
    def _boxes(self) -> list[tuple[slice, slice]]: ...
    def __len__(self) -> int: ...


class SegmentedElements(Protocol):
    """A frame divided into squares, and these grouped by plane."""

    @property
    def elements(self) -> PlacedWindows: ...
    @property
    def element_labels(self) -> NDArray[np.int32]: ...
    @property
    def labels(self) -> NDArray[np.int32]: ...
    @property
    def planes(self) -> Floats: ...


class Evidence(Protocol):
    """What a noise model was estimated from."""

    TILE: ClassVar[int]

    @property
    def frames(self) -> int: ...
    @property
    def sizes(self) -> Indices: ...
    @property
    def residuals(self) -> Floats: ...
    @property
    def expected(self) -> Floats: ...
    @property
    def inverse_depth(self) -> Floats: ...
    @property
    def sigma(self) -> Floats: ...
    @property
    def sigma_fit(self) -> Floats: ...
    @property
    def p_values(self) -> Floats: ...
    @property
    def noise_map(self) -> Floats: ...
    @property
    def edge_growth(self) -> float: ...
    @property
    def flatness(self) -> Floats: ...
    @property
    def flatness_count(self) -> Indices: ...
    @property
    def flatness_std(self) -> Floats: ...
    def _rejected(self) -> str: ...
