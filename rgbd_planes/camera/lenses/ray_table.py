"""Rays that are given pixel by pixel, for cameras that no lens model describes."""

from __future__ import annotations

import base64
import functools
import hashlib
import math
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.checks import real_array
from rgbd_planes._core.lazy_property import kept
from rgbd_planes.camera.lenses.fisheye import FARTHEST

_CODING = "float64, little-endian, zlib, base64"
_LEAST_SEEN = 0.01  # share of the pixels that have a ray; a table with fewer is most likely in another unit
_MAX_ITERATIONS = 30
_TOLERANCE = 1e-12  # squared residual of a projection, in tangents


class RayTable:
    """The rays (tanθx, tanθy, 1) of all pixels of an image; never changed, compared by their values.

    Parameters
    ----------
    tan_x, tan_y : (H, W) array_like of float
        NaN where a pixel has no ray. Rays of 85 degrees from the axis or more count as none.

    Attributes
    ----------
    tan_x, tan_y : (H, W) ndarray of float64
        Read-only; NaN in the same pixels.

    Raises
    ------
    TypeError, ValueError
        They are no tables of one shape, of at least 2 x 2 pixels, or hardly any pixel has a ray.
    """

    def __init__(self, tan_x: ArrayLike, tan_y: ArrayLike) -> None:
        x, y = real_array("tan_x", tan_x), real_array("tan_y", tan_y)
        if x.ndim != 2 or x.shape != y.shape or min(x.shape) < 2:
            raise ValueError(
                f"expected tan_x and tan_y as (H, W) tables of one shape, at least 2 x 2, got {x.shape} and {y.shape}"
            )
        with np.errstate(invalid="ignore", over="ignore"):
            seen = np.hypot(x, y) < math.tan(FARTHEST)
        if seen.mean() < _LEAST_SEEN:
            raise ValueError(
                "expected rays (tan_x, tan_y, 1) within 85 degrees of the axis, got "
                f"{np.count_nonzero(seen)} of {seen.size} pixels with one: tangents, X/Z and Y/Z, not angles, are meant"
            )
        self.tan_x, self.tan_y = (_read_only(np.where(seen, table, np.nan)) for table in (x, y))
        self._digest = hashlib.sha256(self.tan_x.tobytes() + self.tan_y.tobytes()).digest()

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of the image."""
        height, width = self.tan_x.shape
        return height, width

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RayTable) and self.shape == other.shape and self._digest == other._digest

    def __hash__(self) -> int:
        return hash((self.shape, self._digest))

    def __repr__(self) -> str:
        height, width = self.shape
        return f"<RayTable: {width} x {height} rays>"

    def __reduce__(self) -> tuple[Any, ...]:
        return RayTable, (self.tan_x, self.tan_y)

    def to_dict(self) -> dict[str, Any]:
        """The tables as a dict that JSON can hold, to the last bit."""
        height, width = self.shape
        made: dict[str, Any] = {"coding": _CODING, "height": height, "width": width}
        for name, table in (("tan_x", self.tan_x), ("tan_y", self.tan_y)):
            made[name] = base64.b64encode(zlib.compress(table.astype("<f8").tobytes(), 6)).decode()
        return made

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> RayTable:
        """The inverse of `to_dict`.

        Raises
        ------
        ValueError
            The values are damaged.
        """
        try:
            if values["coding"] != _CODING:
                raise ValueError(f"got the coding {values['coding']!r}")
            shape = int(values["height"]), int(values["width"])
            size = 8 * shape[0] * shape[1]
            tables = []
            for name in ("tan_x", "tan_y"):
                unpacked = zlib.decompressobj().decompress(base64.b64decode(values[name], validate=True), size + 1)
                tables.append(np.frombuffer(unpacked, "<f8").reshape(shape))
        except (KeyError, TypeError, ValueError, zlib.error) as error:
            raise ValueError(f"expected rays as Camera.save writes them ({_CODING}): {error}") from None
        return cls(*tables)

    def turned(self, quarters: int) -> RayTable:
        """The rays of an image turned counter-clockwise by so many quarters, in axes that turn with it."""
        x, y = self.tan_x, self.tan_y
        for _ in range(quarters):
            x, y = np.rot90(y), np.rot90(-x)
        return RayTable(x, y)

    def mirrored(self, axis: int) -> RayTable:
        """The same rays in an image whose rows (0) or columns (1) are in reverse order."""
        return RayTable(np.flip(self.tan_x, axis), np.flip(self.tan_y, axis))

    def part(self, rows: slice, columns: slice) -> RayTable:
        """The rays of a part of the image."""
        return RayTable(self.tan_x[rows, columns], self.tan_y[rows, columns])

    def resized(self, height: int, width: int) -> RayTable:
        """The rays of a resized image, through the middle of what its pixels stand for: interpolated linearly."""
        rows = (np.arange(height) + 0.5) * (self.shape[0] / height) - 0.5
        columns = (np.arange(width) + 0.5) * (self.shape[1] / width) - 0.5
        return RayTable(*self._at(*np.broadcast_arrays(columns[None], rows[:, None]))[:2])

    @property
    @kept
    def pinhole(self) -> tuple[float, float, float, float]:
        """fx, fy, cx, cy of a pinhole whose pixels are about as far apart, from medians over the image."""
        (u_x, u_y), (v_x, v_y) = ((np.gradient(t, axis=1), np.gradient(t, axis=0)) for t in (self.tan_x, self.tan_y))
        # About the middle of what is seen, where a lens bends least.
        radius = np.hypot(self.tan_x, self.tan_y)
        seen = np.isfinite(u_x) & np.isfinite(u_y)
        share = max(0.01, min(1.0, 16.0 / max(int(np.count_nonzero(seen)), 1)))
        near = seen & (radius <= np.quantile(radius[seen], share)) if seen.any() else seen
        if not near.any():
            height, width = self.shape
            return float(width), float(width), 0.5 * (width - 1), 0.5 * (height - 1)
        turn = np.sign(np.median(u_x[near] * v_y[near] - u_y[near] * v_x[near])) or 1.0
        across = np.sign(np.median(u_x[near])) or 1.0
        fx = across / max(float(np.median(np.hypot(u_x[near], v_x[near]))), 1e-8)
        fy = across * turn / max(float(np.median(np.hypot(u_y[near], v_y[near]))), 1e-8)
        row, column = np.nonzero(near)
        cx, cy = np.median(column - fx * self.tan_x[near]), np.median(row - fy * self.tan_y[near])
        return float(fx), float(fy), float(np.clip(cx, -1e8, 1e8)), float(np.clip(cy, -1e8, 1e8))

    def image_of(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Columns and rows where rays (x, y, 1) meet the image, between the pixels' own rays interpolated linearly.

        NaN farther than half a pixel outside the image, or beside pixels without a ray.
        """
        columns, rows = np.full(x.shape, np.nan), np.full(x.shape, np.nan)
        wanted = np.isfinite(x) & np.isfinite(y)
        if not wanted.any():
            return columns, rows
        to_x, to_y = x[wanted], y[wanted]
        tree, pixels = self._nearest
        _, index = tree.query(_directions(to_x, to_y))
        row, column = (pixels[index] // self.shape[1]).astype(float), (pixels[index] % self.shape[1]).astype(float)
        # Gauss and Newton's method from the pixel that looks nearest; cells are small, so it takes a few steps.
        for _ in range(_MAX_ITERATIONS):
            at_x, at_y, ((u_x, u_y), (v_x, v_y)) = self._at(column, row)
            off_x, off_y = to_x - at_x, to_y - at_y
            det = u_x * v_y - u_y * v_x
            with np.errstate(divide="ignore", invalid="ignore"):
                step_x = np.nan_to_num((v_y * off_x - u_y * off_y) / det, nan=0.0, posinf=0.0, neginf=0.0)
                step_y = np.nan_to_num((u_x * off_y - v_x * off_x) / det, nan=0.0, posinf=0.0, neginf=0.0)
            column = np.clip(column + np.clip(step_x, -2.0, 2.0), -1.0, float(self.shape[1]))
            row = np.clip(row + np.clip(step_y, -2.0, 2.0), -1.0, float(self.shape[0]))
            if max(np.abs(step_x).max(initial=0.0), np.abs(step_y).max(initial=0.0)) < 1e-10:
                break
        at_x, at_y, _ = self._at(column, row)
        scale = 1.0 + to_x * to_x + to_y * to_y
        with np.errstate(invalid="ignore"):
            met = (at_x - to_x) ** 2 + (at_y - to_y) ** 2 <= _TOLERANCE * scale * scale
        met &= (column >= -0.5) & (column <= self.shape[1] - 0.5) & (row >= -0.5) & (row <= self.shape[0] - 0.5)
        columns[wanted], rows[wanted] = np.where(met, column, np.nan), np.where(met, row, np.nan)
        return columns, rows

    @property
    @kept
    def _nearest(self) -> tuple[Any, NDArray[np.intp]]:
        """A tree of the rays' directions, and the pixels that they are of."""
        from scipy.spatial import cKDTree

        pixels = np.flatnonzero(np.isfinite(self.tan_x))
        return cKDTree(_directions(self.tan_x.ravel()[pixels], self.tan_y.ravel()[pixels])), pixels

    def _at(self, x: Floats, y: Floats) -> tuple[Floats, Floats, tuple[tuple[Floats, Floats], tuple[Floats, Floats]]]:
        """Both tables at columns x and rows y, and their derivatives by x and y; continued linearly outside."""
        height, width = self.shape
        column = np.clip(np.floor(x).astype(int), 0, width - 2)
        row = np.clip(np.floor(y).astype(int), 0, height - 2)
        s, t = x - column, y - row
        found = [_bilinear(table, row, column, s, t) for table in (self.tan_x, self.tan_y)]
        return found[0][0], found[1][0], (found[0][1], found[1][1])


def _bilinear(
    table: Floats, row: NDArray[np.intp], column: NDArray[np.intp], s: Floats, t: Floats
) -> tuple[Floats, tuple[Floats, Floats]]:
    a, b = table[row, column], table[row, column + 1]
    c, d = table[row + 1, column], table[row + 1, column + 1]
    value = (1.0 - t) * ((1.0 - s) * a + s * b) + t * ((1.0 - s) * c + s * d)
    # At a pixel its own ray counts, not the missing ones beside it.
    for at, corner in (((s == 0) & (t == 0), a), ((s == 1) & (t == 0), b), ((s == 0) & (t == 1), c)):
        value = np.where(at, corner, value)
    value = np.where((s == 1) & (t == 1), d, value)
    return value, ((1.0 - t) * (b - a) + t * (d - c), (1.0 - s) * (c - a) + s * (d - b))


def _directions(x: Floats, y: Floats) -> Floats:
    ray = np.stack([x, y, np.ones_like(x)], axis=-1)
    return np.asarray(ray / np.linalg.norm(ray, axis=-1, keepdims=True))


def _read_only(table: Floats) -> Floats:
    made = np.ascontiguousarray(table)
    made.flags.writeable = False
    return made


def filled(x: Floats, y: Floats, without_ray: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Tables of rays in which pixels without a ray have that of the nearest pixel with one."""
    from scipy.ndimage import distance_transform_edt

    rows, columns = distance_transform_edt(without_ray, return_distances=False, return_indices=True)
    return np.ascontiguousarray(x[rows, columns]), np.ascontiguousarray(y[rows, columns])


# Of one camera, mostly: its tables are asked for by each camera object of the same rays.
@functools.lru_cache(maxsize=2)
def tables_of(rays: RayTable) -> tuple[Floats, Floats, NDArray[np.bool_] | None]:
    """(H, W) tables without NaN, and the pixels that have no ray, None where all have."""
    without_ray = np.isnan(rays.tan_x)
    if not without_ray.any():
        return rays.tan_x, rays.tan_y, None
    x, y = filled(rays.tan_x, rays.tan_y, without_ray)
    return _read_only(x), _read_only(y), without_ray
