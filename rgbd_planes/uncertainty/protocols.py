"""What the statistics of a fit need of it."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.arrays import Arrays, Floats, Indices
from rgbd_planes.camera.camera import Camera


class Assesses(Protocol):
    """What writes the statistics of the parts of a frame."""

    def of(self, arrays: Arrays, error_sums: Floats | None = None, shared: Floats | None = None) -> Work: ...


class Work(Protocol):
    """Writes the statistics of parts ``start`` to ``stop``."""

    def __call__(self, start: int, stop: int) -> object: ...


class Fits(Protocol):
    """A fit that keeps its moments."""

    @property
    def camera(self) -> Camera: ...
    @property
    def method(self) -> str: ...
    @property
    def shape(self) -> tuple[int, ...]: ...
    @property
    def valid_count(self) -> NDArray[np.int32]: ...
    @property
    def _moments(self) -> Floats: ...
    @property
    def _reference(self) -> Floats: ...
    @property
    def _cell_dimensions(self) -> int: ...
    @property
    def _assessment(self) -> Assesses: ...
    @property
    def _footprint(self) -> Indices: ...
    @property
    def _error_sums(self) -> Floats | None: ...
    @property
    def _shared(self) -> Floats | None: ...
