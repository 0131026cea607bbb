"""A sensor's noise from ordinary frames: whatever in them is flat shows it.

Flat tiles of several sizes are all that is used. How their mean square residual changes with depth gives σq, how it
changes with the slope of the surface the lateral error. How it grows with the size of the tile, and how much more
the slopes of tiles differ from their surroundings' than independent errors would make them, says how far errors
reach: independent errors leave all sizes alike, a bias that bends over 50 pixels shows in large tiles only. How
unequal the tiles are gives the spread.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from rgbd_planes.camera import Camera
from rgbd_planes.checks import check_camera
from rgbd_planes.depth import as_depth_frame
from rgbd_planes.merging import merge
from rgbd_planes.noise import NoiseModel, quantised, table
from rgbd_planes.plane_fits import TileStatus
from rgbd_planes.tile_planes import TilePlanes
from rgbd_planes.tiles import TileFitter
from rgbd_planes.uncertainty import same_plane

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Float = npt.NDArray[np.float64]

WINDOW = 24
"""Side in pixels of the windows that are judged flat or not."""
SIZES = (6, 8, 12, 24, 48, 96)
"""Sides of the tiles that are compared: they divide a window, or are two or four of them."""
LENGTHS = (1.0, 2.0, 4.0, 8.0)
"""Correlation lengths, in pixels, among which the random error is shared out."""
FLOOR_LENGTHS = (16.0, 24.0, 32.0, 48.0)
"""Candidates for the length of the systematic error, up to half of the largest tile."""
LATERALS = np.linspace(0.0, 1.2, 25)
"""Candidates for the lateral error, in pixels."""
CELL = 8
"""Side in pixels of the cells of the flatness map."""
_MOST_MISSING = 0.1
_BENT = 1.6  # how many times the usual a window's residual may be, over those of its parts
_CLUTTERED = 4.0  # and over those of other windows
_TAIL = 0.95  # quantile at which the spread is matched: above are also tiles that are not flat
_REFERENCE = 12  # side of the tiles that σq and the lateral error are taken from
_FEWEST_WINDOWS = 16
_ENOUGH_LARGE = 48  # windows twice as large, to take from them how far errors reach
_TILE = 16  # of the planes of the flatness map, and how many tiles make a large one
_LARGE = 60


@dataclass(frozen=True, eq=False)
class NoiseEvidence:
    """What an estimated noise model was estimated from.

    Attributes
    ----------
    windows : int
        Number of flat windows, of `WINDOW` x `WINDOW` pixels.
    sizes : (S,) int64
        Sides of tiles.
    residuals, expected : (S,) float64
        Median of the root mean square residual of the flat tiles of each size, as a multiple of the model's
        σq, and the same by the model.
    inverse_depth, sigma, sigma_fit : (K,) float64
        By depth: root mean square residual of the tiles of 12 pixels there, and the model's.
    p_values : (T,) float64
        Of those tiles; uniform if the model is right.
    noise_map : (R, C) float64
        Their residual over the model's, by place in the image; NaN where no frame is flat.
    flatness : (H / 8, W / 8) float64
        The sensor's own bias over the image in 1/m: mean residual of large planes in cells of `CELL` pixels.
        NaN where no large plane was seen. A part that is itself planar over the whole of every surface does
        not show.
    flatness_count : (H / 8, W / 8) int64
        How many pixels each cell's mean is of.
    """

    windows: int
    sizes: npt.NDArray[np.int64]
    residuals: Float
    expected: Float
    inverse_depth: Float
    sigma: Float
    sigma_fit: Float
    p_values: Float
    noise_map: Float
    flatness: Float
    flatness_count: npt.NDArray[np.int64]

    def plot(self, figure: "Figure | None" = None) -> "Figure":
        """Draw the fit and the maps; see `noise_plotting.plot_evidence`."""
        from rgbd_planes.noise_plotting import plot_evidence

        return plot_evidence(self, figure)


def estimate_noise(frames: Sequence[npt.ArrayLike] | npt.NDArray[Any], camera: Camera) -> NoiseModel:
    """Estimate a sensor's noise from frames of ordinary scenes: no target, no still camera.

    Parameters
    ----------
    frames : (F, H, W) array or sequence of (H, W), or one (H, W)
        With surfaces that are flat over 50 pixels or more, at the depths that matter. The more frames and the
        more places, the better; one can be enough.
    camera : Camera
        Its ``noise`` is not looked at.

    Returns
    -------
    NoiseModel
        What the frames show, rounding to integers included, with `NoiseEvidence` as ``evidence``, whose
        ``plot()`` draws the fit.

    Raises
    ------
    ValueError
        Too little in the frames is flat.

    Notes
    -----
    Surfaces that are not flat but everywhere as smooth as a plane (a curtain, a lawn) count as noise.
    """
    check_camera(camera)
    if not hasattr(frames, "__len__"):
        raise TypeError(f"expected a sequence of frames, got {type(frames).__name__}")
    opened: list[Any] = [frames] if len(frames) and np.ndim(frames[0]) == 1 else list(frames)
    if not opened:
        raise ValueError("expected at least one frame, got none")
    bare = replace(camera, noise=None)
    tiles = {
        size: TileFitter(bare, size, max_missing=_MOST_MISSING).fit_batch(opened)
        for size in SIZES
        if size <= min(camera.shape)
    }
    if WINDOW not in tiles:
        raise ValueError(
            f"expected frames of at least {WINDOW} x {WINDOW} pixels, got {camera.height} x {camera.width}"
        )
    flat = _flat_windows(tiles[WINDOW], tiles[8])
    count = int(np.count_nonzero(flat))
    if count < _FEWEST_WINDOWS:
        raise ValueError(
            f"expected frames with at least {_FEWEST_WINDOWS} flat windows of {WINDOW} x {WINDOW} pixels, "
            f"found {count} in {len(opened)} frames"
        )
    samples = _all_samples(tiles, flat)
    # Small windows show all surfaces, large ones, if there are enough of them, how far errors reach.
    reaching = samples
    if 2 * WINDOW in tiles:
        large = _flat_windows(tiles[2 * WINDOW], tiles[8])
        if np.count_nonzero(large) >= _ENOUGH_LARGE:
            reaching = _all_samples(tiles, large.repeat(2, axis=1).repeat(2, axis=2), 2 * WINDOW)
    exact = np.asarray(opened[0]).dtype.kind == "f"
    model = _fit_depth(samples[_REFERENCE], NoiseModel() if exact else quantised(NoiseModel(), camera))
    for _ in range(3):
        model = _fit_reach(reaching, _fit_spread(samples, model))
        model = _fit_scale(samples[_REFERENCE], model)
    return replace(model, evidence=_evidence(opened, camera, model, samples, tiles, count))


def _all_samples(
    tiles: dict[int, TilePlanes], flat: npt.NDArray[np.bool_], window: int = WINDOW
) -> "dict[int, _Samples]":
    """The tiles in flat windows, by size, of which there are some."""
    samples = {size: _Samples.of(planes, flat, tiles[window]) for size, planes in tiles.items()}
    return {size: some for size, some in samples.items() if len(some.count) >= _FEWEST_WINDOWS // 3}


@dataclass(frozen=True, eq=False)
class _Samples:
    """Flat tiles of one size.

    Mean of q, squared slope of q a pixel and how the tile's own differs from it, side of the window of which it is,
    sum of squared residuals, pixels, place.
    """

    q: Float
    slope_square: Float
    tilt_square: Float
    window: int
    rss: Float
    count: npt.NDArray[np.int32]
    place: tuple[npt.NDArray[np.intp], ...]

    @classmethod
    def of(cls, planes: TilePlanes, flat: npt.NDArray[np.bool_], windows: TilePlanes) -> "_Samples":
        """The tiles of ``planes`` that lie in flat windows, and the slopes of ``windows``."""
        _, rows, columns = planes.shape
        size = planes.tile[0]
        if size <= WINDOW:
            inside = flat.repeat(WINDOW // size, axis=1).repeat(WINDOW // size, axis=2)[:, :rows, :columns]
            chosen = np.zeros(planes.shape, bool)
            chosen[:, : inside.shape[1], : inside.shape[2]] = inside
        else:
            # All its windows flat; together they must be as well.
            many = size // WINDOW
            padded = np.zeros((len(flat), many * rows, many * columns), bool)
            inside = flat[:, : many * rows, : many * columns]
            padded[:, : inside.shape[1], : inside.shape[2]] = inside
            chosen = np.asarray(padded.reshape(len(flat), rows, many, columns, many).all(axis=(2, 4)))
        chosen &= planes.fitted & (planes.valid_count >= (1.0 - _MOST_MISSING) * size * size)
        if size > WINDOW and chosen.any():
            residual = planes.rmse[chosen]
            chosen[chosen] = residual < _CLUTTERED * np.median(residual)
        q = 1.0 / _depth(planes)
        rss = planes.valid_count * planes.rmse**2
        # Slopes of small tiles are noise themselves, and larger where the residual is: those of windows are taken.
        place = frame, row, column = np.nonzero(chosen)
        alpha = planes.alpha[place]
        of_window = alpha
        if size < windows.tile[0]:
            side = windows.tile[0]
            of_window = windows.alpha[frame, row * size // side, column * size // side]
        pitch = np.array([1.0 / planes.camera.fx, 1.0 / planes.camera.fy])
        slope_square = np.sum((of_window[:, :2] * pitch) ** 2, axis=1)
        # Independent errors of variance 1 make it 1 on average, but for what the window shares.
        n, s_u, s_v, _, s_uu, s_uv, _, s_vv, *_ = planes._moments[frame, :, row, column].T
        tilt_x, tilt_y = (alpha - of_window)[:, :2].T
        tilt_square = 0.5 * (
            (s_uu - s_u * s_u / n) * tilt_x**2
            + 2.0 * (s_uv - s_u * s_v / n) * tilt_x * tilt_y
            + (s_vv - s_v * s_v / n) * tilt_y**2
        )
        return cls(
            q[chosen],
            slope_square,
            tilt_square,
            windows.tile[0],
            rss[chosen],
            planes.valid_count[chosen],
            place,
        )

    def independent(self, model: NoiseModel) -> Float:
        """Variance of q from the lateral error and from rounding."""
        return np.asarray(model.lateral**2 * self.slope_square + model._rounding(self.q))

    def expected(self, model: NoiseModel) -> tuple[Float, Float]:
        """The sum of squared residuals that the model expects, and its degrees of freedom."""
        made = model.statistics(self.count)
        return made.with_independent(model._along(self.q) ** 2, self.independent(model), self.count)


def _depth(planes: TilePlanes) -> Float:
    """Mean depth of tiles: rmse_metric is d·Z̄·rmse."""
    mean = planes._reference[:, 2] + planes._moments[:, 3] / np.maximum(planes._moments[:, 0], 1.0)
    return np.asarray(1.0 / np.where(mean > 0.0, mean, np.nan))


def _flat_windows(planes: TilePlanes, small: TilePlanes) -> npt.NDArray[np.bool_]:
    """Windows that are rough as a whole only as far as they are in their parts.

    The residual of the window is compared with the median of those of the small tiles in it: their usual
    ratio, that of the sensor's errors, is the commonest. So neither a surface that makes more noise than
    others is missed, nor is a bent one taken for flat. What is far rougher than usual, clutter, is left out.
    """
    frames, rows, columns = planes.shape
    window = planes.tile[0]
    parts = window // small.tile[0]
    inside = np.full((frames, rows * parts, columns * parts), np.nan)
    inside[:, : small.shape[1], : small.shape[2]] = small.rmse
    inside = np.moveaxis(inside.reshape(frames, rows, parts, columns, parts), 3, 2)
    good = planes.fitted & (planes.valid_count >= (1.0 - _MOST_MISSING) * window * window)
    good &= (planes.tile_heights == window)[:, None] & (planes.tile_widths == window)
    good &= planes.rmse > 0.0
    flat = np.zeros(planes.shape, bool)
    local = np.median(inside[good].reshape(-1, parts * parts), axis=1)
    residual = planes.rmse[good]
    usable = local > 0.0  # NaN where a part has no plane
    if np.count_nonzero(usable) < _FEWEST_WINDOWS:
        return flat
    ratio = np.log(residual[usable] / local[usable])
    level = np.log(residual[usable])
    usable[usable] = (ratio < _mode(ratio) + np.log(_BENT)) & (level < _mode(level) + np.log(_CLUTTERED))
    flat[good] = usable
    return flat


def _bins(q: Float, smallest: int) -> list[npt.NDArray[np.intp]]:
    """Indices of equally many values, by size."""
    return np.array_split(np.argsort(q, kind="stable"), int(np.clip(len(q) // smallest, 1, 12)))


def _mode(values: Float) -> float:
    """Half-sample mode: the middle of the densest half of the densest half ... (Robertson and Cryer 1974)."""
    values = np.sort(values)
    while len(values) > 3:
        half = (len(values) + 1) // 2
        start = int(np.argmin(values[half - 1 :] - values[: len(values) - half + 1]))
        values = values[start : start + half]
    return float(np.mean(values))


def _fit_depth(samples: _Samples, rounding: NoiseModel) -> NoiseModel:
    """σq against depth, in bins, and the lateral error with which residuals are nearest to the model.

    That of ``rounding`` is known.

    Each bin's σq is that which makes half of its residuals larger than the model's; of three neighbours the middle
    one is taken. Beyond the depths that were seen a power of q goes on, from constant (disparity) to q² (rounding).
    """
    bins = _bins(samples.q, 60)
    q = np.array([np.median(samples.q[chosen]) for chosen in bins])
    seen = samples.rss / samples.count
    seen = np.maximum(seen, 1e-3 * np.median(seen))
    best = np.inf, 0.0, np.zeros(len(q))
    for lateral in LATERALS:
        known = samples.independent(replace(rounding, lateral=lateral))
        variance = np.array(
            [max(np.median((seen - known)[some]), 0.01 * np.median(seen[some])) for some in bins]
        )
        ends = np.concatenate([variance[:1], variance, variance[-1:]])
        variance = np.median([ends[:-2], ends[1:-1], ends[2:]], axis=0)
        error = np.log(seen / (np.interp(samples.q, q, variance) + known))
        distance = float(np.mean(np.abs(error - np.median(error))))
        if distance < 0.999 * best[0]:
            best = distance, lateral, variance
    _, lateral, variance = best
    sigma = np.sqrt(variance)
    spread = np.log(q) - np.log(q).mean()
    power = float(np.clip(spread @ np.log(sigma) / max(spread @ spread, 1e-9), 0.0, 2.0))
    farther, nearer = np.array([0.25, 0.35, 0.5, 0.7]), np.array([1.4, 2.0, 2.8, 4.0])
    along = table(
        np.concatenate([q[0] * farther, q, q[-1] * nearer]),
        np.concatenate([sigma[0] * farther**power, sigma, sigma[-1] * nearer**power]),
    )
    return replace(along, lateral=lateral, step=rounding.step, disparity_step=rounding.disparity_step)


def _typical(samples: _Samples, model: NoiseModel) -> tuple[float, float]:
    """Mean square residual in units of σq², from the median of the tiles: without independent parts, and all."""
    v = 2.0 / (9.0 * np.maximum(samples.expected(model)[1], 1.0))
    median_over_mean = (1.0 - v) ** 3  # of a chi-square (Wilson and Hilferty 1931)
    return _middle(samples, model, samples.rss / samples.count / median_over_mean)


def _typical_tilt(samples: _Samples, model: NoiseModel) -> tuple[float, float]:
    """Variance of slopes, as a multiple of that of independent errors of variance σq², in the same way."""
    return _middle(samples, model, samples.tilt_square / np.log(2.0))


def _middle(samples: _Samples, model: NoiseModel, seen: Float) -> tuple[float, float]:
    square = model._along(samples.q) ** 2
    return float(np.median((seen - samples.independent(model)) / square)), float(np.median(seen / square))


def _alone(part: tuple[float, float]) -> NoiseModel:
    """Noise of this share and length alone; length 0 is independent."""
    return NoiseModel(correlation=(part,) if part[1] else ())


def _per_pixel(part: tuple[float, float], sizes: npt.NDArray[np.int64]) -> Float:
    """Expected mean square residual of tiles of these sizes if all errors had this correlation."""
    return np.asarray(_alone(part).statistics(sizes**2).expected / sizes**2)


def _tilts(part: tuple[float, float], sizes: npt.NDArray[np.int64], window: int) -> Float:
    """Expected variance of slopes about those of the window that the tiles are part of."""
    shared = (sizes / window) ** 4 * float(_alone(part).statistics(window**2).tilt)
    return np.asarray(_alone(part).statistics(sizes**2).tilt - shared)


def _fit_reach(samples: dict[int, _Samples], model: NoiseModel) -> NoiseModel:
    """How the variance is shared out over correlation lengths, from how residuals and slopes change with size.

    By least squares of errors relative to what is seen, no share below 0.
    """
    from scipy.optimize import nnls

    sizes = np.array(list(samples))
    window = samples[_REFERENCE].window
    small = sizes[sizes <= window // 2]
    typical = [_typical(some, model) for some in samples.values()]
    values, seen = np.array([*typical, *(_typical_tilt(samples[size], model) for size in small)]).T
    best = None
    for floor_length in FLOOR_LENGTHS:
        if 2 * floor_length > sizes.max() and best is not None:
            continue
        parts = [(0.0, 0.0), *((1.0, length) for length in (*LENGTHS, floor_length))]
        terms = [np.append(_per_pixel(part, sizes), _tilts(part, small, window)) for part in parts]
        relative = np.stack(terms, axis=1) / seen[:, None]
        shares = np.asarray(nnls(relative, values / seen, maxiter=1000)[0])
        error = float(np.sum((relative @ shares - values / seen) ** 2))
        if best is None or error < 0.999 * best[0]:
            best = error, floor_length, shares
    assert best is not None
    _, floor_length, shares = best
    shares[0] += 1e-9  # where all is lateral error and rounding
    random = float(shares[:-1].sum())
    if random < 0.02 * shares.sum():  # all of it smooth: keep the model one of random errors
        shares[0] += 0.02 * shares.sum()
        random = float(shares[:-1].sum())
    # σq is that of the random error.
    scale = np.sqrt(random)
    return replace(
        model,
        samples=tuple((q, scale * sigma) for q, sigma in model.samples or ()),
        correlation=tuple(
            (float(share / random), length)
            for share, length in zip(shares[1:-1], LENGTHS, strict=True)
            if share > 0.0
        ),
        floor=float(np.sqrt(shares[-1] / random)),
        floor_length=floor_length,
    )


def _fit_scale(samples: _Samples, model: NoiseModel) -> NoiseModel:
    """Make half of the residuals of tiles larger than the model's."""
    pixels = np.median(samples.count)
    typical = max(_typical(samples, model)[0], 0.01)
    scale = np.sqrt(typical * pixels / float(model.statistics(pixels).expected))
    return replace(model, samples=tuple((q, scale * s) for q, s in model.samples or ()))


def _fit_spread(samples: dict[int, _Samples], model: NoiseModel) -> NoiseModel:
    """The spread with which residuals reach as far above their median as those of the tiles do."""
    from scipy.special import chdtri

    candidates = np.linspace(0.0, 1.5, 61)
    even = replace(model, spread=0.0)
    spreads = []
    for size in (8, 12, 24):
        some = samples[size]
        expected, freedoms = some.expected(even)
        ratio = some.rss / expected
        reach = np.quantile(ratio, _TAIL) / np.median(ratio)
        freedom = 1.0 / (1.0 / np.median(freedoms) + 0.5 * candidates**2)
        reaches = chdtri(freedom, 1.0 - _TAIL) / chdtri(freedom, 0.5)
        spreads.append(float(np.interp(reach, reaches, candidates)))
    return replace(model, spread=float(np.median(spreads)))


def _evidence(
    frames: Sequence[Any],
    camera: Camera,
    model: NoiseModel,
    samples: dict[int, _Samples],
    tiles: dict[int, TilePlanes],
    windows: int,
) -> NoiseEvidence:
    from scipy.special import chdtrc

    size = _REFERENCE
    chosen = samples[size]
    expected, freedom = chosen.expected(model)
    ratio = chosen.rss / expected
    bins = _bins(chosen.q, 60)
    sizes = np.array(list(samples))
    sums, numbers = np.zeros(tiles[size].shape[1:]), np.zeros(tiles[size].shape[1:])
    np.add.at(sums, chosen.place[1:], np.minimum(ratio, 4.0))
    np.add.at(numbers, chosen.place[1:], 1.0)
    flatness, flatness_count = _flatness(frames, replace(camera, noise=model))
    return NoiseEvidence(
        windows=windows,
        sizes=sizes,
        residuals=np.sqrt([max(_typical(some, model)[0], 0.0) for some in samples.values()]),
        expected=np.sqrt(model.statistics(sizes**2).expected) / sizes,
        inverse_depth=np.array([np.median(chosen.q[some]) for some in bins]),
        sigma=np.sqrt([np.median((chosen.rss / chosen.count)[some]) for some in bins]),
        sigma_fit=np.sqrt([np.median((expected / chosen.count)[some]) for some in bins]),
        p_values=chdtrc(freedom, ratio * freedom),
        noise_map=np.sqrt(np.divide(sums, numbers, out=np.full(sums.shape, np.nan), where=numbers > 0.0)),
        flatness=flatness,
        flatness_count=flatness_count,
    )


def _flatness(frames: Sequence[Any], camera: Camera) -> tuple[Float, npt.NDArray[np.int64]]:
    """Mean residual over the image of the planes that are seen large: see `NoiseEvidence`."""
    shape = -(-camera.height // CELL), -(-camera.width // CELL)
    sums, numbers = np.zeros(shape), np.zeros(shape, np.int64)
    cell_rows = np.arange(camera.height) // CELL
    cell_columns = np.arange(camera.width) // CELL
    fitter = TileFitter(camera, _TILE, significance=1e-3)
    for depth in frames:
        tiles = fitter.fit(depth)
        labels = _connected(tiles)
        merged = merge(tiles, labels)
        # Links from tile to tile can lead around a bend: what is not on the common plane is left out.
        on_plane = labels > 0
        of = labels[on_plane] - 1
        on_plane[on_plane] = (
            same_plane(
                tiles.alpha[on_plane],
                tiles.alpha_covariance[on_plane],
                merged.alpha[of],
                merged.alpha_covariance[of],
            )
            > 1e-3
        )
        labels[~on_plane] = 0
        merged = merge(tiles, labels, significance=1e-3)
        large = np.bincount(labels.ravel(), minlength=len(merged.status) + 1)[1:] >= _LARGE
        large &= merged.status == TileStatus.OK
        alpha = np.where(large[:, None], merged.alpha, np.nan)
        pixels = labels.repeat(_TILE, axis=0).repeat(_TILE, axis=1)[: camera.height, : camera.width]
        alpha = np.vstack([np.full((1, 3), np.nan), alpha])[pixels]
        fitted = alpha[..., 0] * camera.tan_x + alpha[..., 1] * camera.tan_y + alpha[..., 2]
        residual = as_depth_frame(depth, camera).inverse_depth - fitted
        assert camera.noise is not None
        usual = np.hypot(1.0, camera.noise.floor) * camera.noise.sigma(fitted)
        seen = np.abs(residual) < 6.0 * usual  # also False where missing
        index = (cell_rows[:, None] * shape[1] + cell_columns)[seen]
        sums += np.bincount(index, residual[seen], shape[0] * shape[1]).reshape(shape)
        numbers += np.bincount(index, minlength=shape[0] * shape[1]).reshape(shape)
    return np.divide(sums, numbers, out=np.full(shape, np.nan), where=numbers > 0), numbers


def _connected(tiles: TilePlanes) -> npt.NDArray[np.int64]:
    """Label, from 1, flat tiles that neighbours link to one plane; 0 elsewhere."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    flat = tiles.status == TileStatus.OK
    alpha, covariance = tiles.alpha, tiles.alpha_covariance
    index = np.arange(flat.size).reshape(flat.shape)
    links = []
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        same = same_plane(alpha[a], covariance[a], alpha[b], covariance[b]) > 0.05
        same &= flat[a] & flat[b]
        links.append((index[a][same], index[b][same]))
    first, second = (np.concatenate(ends) for ends in zip(*links, strict=True))
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(flat.size, flat.size))
    component = connected_components(graph, directed=False)[1].reshape(flat.shape)
    labels = np.zeros(flat.shape, np.int64)
    labels[flat] = np.unique(component[flat], return_inverse=True)[1] + 1
    return labels
