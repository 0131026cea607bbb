"""The flat tiles of frames, by size: what a sensor's noise is estimated from."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.lazy_property import kept
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.camera.pixel_pitch import WEIGHTS_OF_PLACES, rays_in, slope_square
from rgbd_planes.fitting.tile_planes import TilePlanes
from rgbd_planes.noise.correlation import ratio_at
from rgbd_planes.noise.model import NoiseModel

WINDOW = 24
"""Side in pixels of the windows that are judged flat or not."""
REFERENCE = 12
"""Side of the tiles that σq and the lateral error are taken from."""
MOST_MISSING = (0.1, 0.3, 0.5, 0.7)
"""Largest share of a tile's pixels that may be missing: if too few windows are as complete, the next one counts."""
FEWEST_WINDOWS = 16
EXACT = 1e-9
"""Residuals below this share of 1/Z are rounding errors of float64."""
# How many times the usual the ratio of a window's residual to its parts' may be, at least and at most.
_BENT = 1.02, 1.6
_DEVIATIONS = 5.0  # and, in between, how many times as far above the usual as the smaller ones are below
_CLUTTERED = 4.0  # and the ratio to other windows' residuals
_LOOKED_AT = 100  # windows whose pixels are looked at one by one
_OF_HALF = 1.4826  # standard deviations of a normal distribution in the median of its absolute values
_STRETCH = 0.25  # length of a stretch of logarithms of residuals, in which the usual one is looked for


@dataclass(frozen=True, eq=False)
class Samples:
    """T flat tiles of one size.

    Attributes
    ----------
    q : (T,) float64
        Mean inverse depth, 1/m.
    slope_square : (T,) float64
        Squared slope of q per pixel, of the window that the tile is part of.
    tilt_square : (T,) float64
        By how much the tile's own slope differs from the window's, squared: independent errors of variance 1 make it 1.
    window : int
        Side of that window in pixels.
    rss : (T,) float64
        Sum of squared residuals, 1/m².
    count : (T,) int32
        Valid pixels.
    rays : (2, 9, T) float64
        tanθx and tanθy at the places of Gauss's quadrature in the tile; means over them have `WEIGHTS_OF_PLACES`.
    depths : (9, T) float64
        Inverse depth there.
    place : three (T,) arrays of int
        Frame, row and column of the tile.
    size : int
        Side of the tiles in pixels.
    """

    q: Floats
    slope_square: Floats
    tilt_square: Floats
    window: int
    rss: Floats
    count: npt.NDArray[np.int32]
    rays: Floats
    depths: Floats
    place: tuple[npt.NDArray[np.intp], ...]
    size: int

    @classmethod
    def of(cls, planes: TilePlanes, flat: npt.NDArray[np.bool_], windows: TilePlanes, most_missing: float) -> "Samples":
        """The tiles of ``planes`` that lie in flat windows, and the slopes of ``windows``."""
        _, rows, columns = planes.shape
        size = planes.tile[0]
        if size <= WINDOW:
            inside = flat.repeat(WINDOW // size, axis=1).repeat(WINDOW // size, axis=2)[:, :rows, :columns]
            chosen = np.zeros(planes.shape, bool)
            chosen[:, : inside.shape[1], : inside.shape[2]] = inside
        else:
            # All its windows are flat; together they must be, too.
            chosen = _all_flat(flat, size // WINDOW, rows, columns)
        chosen &= planes.fitted & (planes.valid_count >= (1.0 - most_missing) * size * size)
        if size > WINDOW and chosen.any():
            residual = planes.rmse[chosen]
            chosen[chosen] = residual < _CLUTTERED * np.median(residual)
        q = 1.0 / mean_depth(planes)
        rss = planes.valid_count * planes.rmse**2
        # Slopes of small tiles are noisy themselves, and larger where the residual is: those of windows are taken.
        place = frame, row, column = np.nonzero(chosen)
        alpha = planes.alpha[place]
        window_alpha = alpha
        if size < windows.tile[0]:
            side = windows.tile[0]
            window_alpha = windows.alpha[frame, row * size // side, column * size // side]
        # Independent errors of variance 1 make its mean 1, less what the window shares of them.
        n, s_u, s_v, _, s_uu, s_uv, _, s_vv, *_ = planes._moments[frame, :, row, column].T
        tilt_x, tilt_y = (alpha - window_alpha)[:, :2].T
        tilt_square = 0.5 * (
            (s_uu - s_u * s_u / n) * tilt_x**2
            + 2.0 * (s_uv - s_u * s_v / n) * tilt_x * tilt_y
            + (s_vv - s_v * s_v / n) * tilt_y**2
        )
        rays = rays_in(planes.camera, planes._footprint[row * columns + column])
        depths = np.maximum(alpha[:, 0] * rays[0] + alpha[:, 1] * rays[1] + alpha[:, 2], 0.0)
        return cls(
            q[chosen],
            slope_square(window_alpha, planes.camera, planes._footprint[row * columns + column]),
            tilt_square,
            windows.tile[0],
            rss[chosen],
            planes.valid_count[chosen],
            rays,
            depths,
            place,
            size,
        )

    # For large tiles take means: the value at the centre is up to a fifth lower, which would pass for errors that reach
    # far.
    def independent(self, model: NoiseModel) -> Floats:
        """Variance of q from the lateral error and from rounding."""
        return np.asarray(model.lateral**2 * self.slope_square + WEIGHTS_OF_PLACES @ model._rounding(self.depths))

    def growth(self, model: NoiseModel) -> Floats:
        """The variance of q before rounding, as a multiple of that on the optical axis."""
        return np.asarray(WEIGHTS_OF_PLACES @ model._growth(*self.rays))

    def along(self, model: NoiseModel) -> Floats:
        """σq² before rounding."""
        return np.asarray(WEIGHTS_OF_PLACES @ (model._along(self.depths) ** 2 * model._growth(*self.rays)))

    @property
    @kept
    def seen(self) -> Floats:
        """Variance of each tile's errors, if they are independent: as often too large as too small."""
        freedom = np.maximum(self.count - 3.0, 1.0)
        seen = self.rss / freedom / ratio_at(0.0, freedom, 0.0)
        return np.asarray(np.maximum(seen, 1e-3 * np.median(seen)))

    def left(self, model: NoiseModel) -> Floats:
        """Logarithms of what is seen over the variances of independent errors."""
        return np.asarray(np.log(self.seen / (self.along(model) + self.independent(model))))

    def expected(self, model: NoiseModel) -> tuple[Floats, Floats]:
        """The sum of squared residuals that the model expects, and its degrees of freedom."""
        return self._expected(model, self.along(model), self.independent(model))

    def _expected(self, model: NoiseModel, along: Floats, independent: Floats) -> tuple[Floats, Floats]:
        counts, which = self._counts
        statistics = model.statistics(counts, (self.size, self.size))
        return statistics.at(which).with_independent(along, independent, self.count)

    @property
    @kept
    def _counts(self) -> tuple[Floats, npt.NDArray[np.intp]]:
        """The different numbers of valid pixels, and which of them each tile has."""
        return np.unique(self.count, return_inverse=True)

    def typical(self, model: NoiseModel) -> tuple[float, float]:
        """Mean square residual in units of σq², from the median of the tiles: without independent parts, and in all."""
        along, independent = self.along(model), self.independent(model)
        median_over_mean = ratio_at(0.0, np.maximum(self._expected(model, along, independent)[1], 1.0), model.spread)
        return _middle(along, independent, self.rss / self.count / median_over_mean, 3.0 / self.count)

    def typical_tilt(self, model: NoiseModel) -> tuple[float, float]:
        """Variance of slopes, as a multiple of that of independent errors of variance σq²: both as in `typical`."""
        lost = (self.count / self.window**2) ** 2
        return _middle(self.along(model), self.independent(model), self.tilt_square / np.log(2.0), lost)


def _middle(along: Floats, independent: Floats, seen: Floats, lost: Floats) -> tuple[float, float]:
    """Medians in units of σq², ``along``; ``lost`` is the share of independent errors that the fit absorbs."""
    left = seen - (1.0 - lost) * independent
    return float(np.median(left / along)), float(np.median(seen / along))


def all_samples(
    tiles: dict[int, TilePlanes], flat: npt.NDArray[np.bool_], most_missing: float, window: int = WINDOW
) -> dict[int, Samples]:
    """The tiles in flat windows, for each size that has enough of them."""
    samples = {size: Samples.of(planes, flat, tiles[window], most_missing) for size, planes in tiles.items()}
    return {size: some for size, some in samples.items() if len(some.count) >= FEWEST_WINDOWS // 3}


def mean_depth(planes: TilePlanes) -> Floats:
    """Depth of tiles at the mean inverse depth of their pixels; NaN where there is none."""
    count, sum_q = planes._moments[..., 0, :, :], planes._moments[..., 3, :, :]
    mean = planes._reference[..., 2, :, :] + sum_q / np.maximum(count, 1.0)
    return np.asarray(1.0 / np.where(mean > 0.0, mean, np.nan))


def flat_windows(
    planes: TilePlanes, small: TilePlanes, most_missing: float, flat_parts: npt.NDArray[np.bool_] | None = None
) -> npt.NDArray[np.bool_]:
    """Windows that are no rougher as a whole than their parts are.

    The residual of the window is compared with the median residual of the small tiles in it. The commonest ratio is due
    to the sensor's errors. No shape makes a smaller one: these tell how far it varies. So no surface that makes more
    noise than others is missed, and no bent one taken for flat. Windows far rougher than usual, clutter, are left out.
    Most larger windows may hold clutter. ``flat_parts`` says which windows of `WINDOW` pixels are flat, and only
    windows whose parts are all flat are considered.
    """
    _, rows, columns = planes.shape
    window = planes.tile[0]
    inside = _part_residuals(planes, small)
    good = planes.fitted & (planes.valid_count >= (1.0 - most_missing) * window * window)
    good &= (planes.tile_heights == window)[:, None] & (planes.tile_widths == window)
    good &= _varied(planes)
    if flat_parts is not None:
        good &= _all_flat(flat_parts, window // WINDOW, rows, columns)
    flat = np.zeros(planes.shape, bool)
    local = np.median(inside[good], axis=1)
    residual = planes.rmse[good]
    usable = local > 0.0  # NaN where a part has no plane
    if np.count_nonzero(usable) < FEWEST_WINDOWS:
        return flat
    ratio = np.log(residual[usable] / local[usable])
    level = np.log(residual[usable])
    above = ratio - _mode(ratio)
    deviation = np.sqrt(np.mean(above[above <= 0.0] ** 2)) if (above <= 0.0).any() else 0.0
    alike = above < np.clip(_DEVIATIONS * deviation, *np.log(_BENT))
    usable[usable] = alike & (level < np.median(level[alike]) + np.log(_CLUTTERED))
    flat[good] = usable
    return flat


def unevenness(planes: TilePlanes, small: TilePlanes, flat: npt.NDArray[np.bool_]) -> float:
    """Median over flat windows of the median over the smallest residual of their parts."""
    inside = np.sort(_part_residuals(planes, small)[flat], axis=1)
    inside = inside[inside[:, 0] > 0.0]  # without those whose residual rounding leaves at zero
    return float(np.median(inside[:, inside.shape[1] // 2] / inside[:, 0])) if len(inside) else 1.0


def outlying(frames: Sequence[Any], planes: TilePlanes, flat: npt.NDArray[np.bool_]) -> float:
    """Median over some flat windows of the root mean square residual over that of half of their pixels.

    Both as of a normal distribution: for the second the median of the absolute residuals counts.
    """
    side, camera = planes.tile[0], planes.camera
    ratios = []
    places = np.argwhere(flat)
    places = places[:: -(-len(places) // _LOOKED_AT)]
    for number in np.unique(places[:, 0]):
        frame = as_depth_frame(frames[number], camera)
        for row, column in places[places[:, 0] == number, 1:]:
            there = np.s_[side * row : side * (row + 1), side * column : side * (column + 1)]
            window = frame._replace(raw=frame.raw[there])
            a, b, c = planes.alpha[number, row, column]
            off = (window.inverse_depth - (a * camera.tan_x[there] + b * camera.tan_y[there] + c))[window.valid]
            half = _OF_HALF * float(np.median(np.abs(off)))
            if half > 0.0:  # otherwise all are rounded alike
                ratios.append(float(np.sqrt(np.mean(off**2))) / half)
    return float(np.median(ratios)) if ratios else 1.0


def _part_residuals(planes: TilePlanes, small: TilePlanes) -> Floats:
    """(F, R, C, N): the residuals of the N small tiles in each window, NaN where one has no plane."""
    frames, rows, columns = planes.shape
    parts = planes.tile[0] // small.tile[0]
    inside = np.full((frames, rows * parts, columns * parts), np.nan)
    inside[:, : small.shape[1], : small.shape[2]] = small.rmse
    inside = np.moveaxis(inside.reshape(frames, rows, parts, columns, parts), 3, 2)
    return inside.reshape(frames, rows, columns, parts * parts)


def _varied(planes: TilePlanes) -> npt.NDArray[np.bool_]:
    """Tiles whose measurements are not all the same, as they are where everything beyond the range has one depth."""
    n, sum_q, sum_qq = np.moveaxis(planes._moments, 1, 0)[[0, 3, 9]]
    spread = (sum_qq - sum_q**2 / np.maximum(n, 1.0)) / np.maximum(n, 1.0)
    return np.asarray((planes.rmse > 0.0) & (spread * mean_depth(planes) ** 2 > EXACT**2))


def _all_flat(flat: npt.NDArray[np.bool_], many: int, rows: int, columns: int) -> npt.NDArray[np.bool_]:
    """(F, rows, columns) bool: whether all of ``many`` x ``many`` windows are flat."""
    padded = np.zeros((len(flat), many * rows, many * columns), bool)
    inside = flat[:, : many * rows, : many * columns]
    padded[:, : inside.shape[1], : inside.shape[2]] = inside
    return np.asarray(padded.reshape(len(flat), rows, many, columns, many).all(axis=(2, 4)))


def bins_of(q: Floats, smallest: int) -> list[npt.NDArray[np.intp]]:
    """Indices of the values in bins of equally many, by size."""
    return np.array_split(np.argsort(q, kind="stable"), int(np.clip(len(q) // smallest, 1, 12)))


def _mode(values: Floats) -> float:
    """The mean of the first dense stretch: what is flat lies close together, however much clutter is spread beyond it.

    Where there is more clutter than flat, as in small images, clutter has the densest stretch. Flat is then the one
    before it, with at least a third as many, after which there are less than half as many as it has.
    """
    values = np.sort(values)
    first = np.arange(len(values))
    inside = np.searchsorted(values, values + _STRETCH, side="right") - first
    begins = int(np.argmax(3 * inside >= inside.max()))
    most = np.maximum.accumulate(inside[begins:])
    ends = np.append(2 * inside[begins:] < most, True).argmax()
    start = begins + int(np.argmax(inside[begins : begins + ends]))
    return float(np.mean(values[start : start + inside[start]]))
