"""A sensor's noise from ordinary frames: whatever in them is flat shows it.

Flat tiles of several sizes are used, and large planes. How the tiles' mean square residual changes with depth gives σq.
How it changes with the angle off the optical axis gives the falloff, and with the slope of the surface the lateral
error. The correlation length follows from how the residual grows with the size of the tile, and from how much more the
slopes of tiles differ from their surroundings' than independent errors would make them. Under independent errors all
sizes are alike. A bias that bends over 50 pixels shows in large tiles only, and one over hundreds of pixels in how far
large planes are bent. How unequal the tiles are gives the spread.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.checks import check_num_threads
from rgbd_planes._core.files import naming
from rgbd_planes._core.text import counted, two_digits
from rgbd_planes._core.user_warnings import collected_warnings, warn_caller
from rgbd_planes.camera.camera import Camera, check_camera
from rgbd_planes.camera.depth_frame import as_depth_frame, spacing_of
from rgbd_planes.camera.frame import as_numbered_frame, depth_of
from rgbd_planes.camera.frame_warnings import warn_of_distances
from rgbd_planes.fitting.tile_planes import TilePlanes
from rgbd_planes.fitting.tiles import TileFitter
from rgbd_planes.noise import NoiseModel, quantised, table
from rgbd_planes.noise.correlation import ResidualStatistics, ratio_at
from rgbd_planes.noise_estimation.evidence import evidence_of
from rgbd_planes.noise_estimation.large_planes import TILE, LargePlanes, bends_by_side, large_planes
from rgbd_planes.noise_estimation.samples import (
    EXACT,
    FEWEST_WINDOWS,
    MOST_MISSING,
    REFERENCE,
    WINDOW,
    Samples,
    all_samples,
    bins_of,
    flat_windows,
    mean_depth,
    outlying,
    unevenness,
)

if TYPE_CHECKING:
    from rgbd_planes.camera.frame import Frame


SIZES = (6, 8, 12, 24, 48, 96)
"""Sides of the tiles that are compared: they divide a window, or are two or four of them."""
LENGTHS = (1.0, 2.0, 4.0, 8.0)
"""Correlation lengths, in pixels, among which the random error is shared out."""
FLOOR_LENGTHS = (16.0, 24.0, 32.0, 48.0, 64.0, 96.0, 128.0, 192.0)
"""Candidates for the length of the systematic error, up to half of the largest tile or plane."""
LATERALS = np.linspace(0.0, 1.2, 25)
"""Candidates for the lateral error, in pixels."""
SPREADS = np.linspace(0.0, 1.5, 61)
"""Candidates for the spread: no real sensor's was above 1.1."""
_TAIL = 0.95  # quantile at which the spread is matched: above it there are also tiles that are not flat
_INEXACT = 0.01  # what a model of a few correlation lengths is off by in any case
_EVIDENT = 6.6  # by how much a floor must lower the sum of squared deviations: χ²(1), once in a hundred cases
_UNEVEN = 3.0  # most unevenness of windows that are flat: 1.1 to 1.6 with real sensors
_STRAYS = 1.5  # most `outlying` of windows that are flat: 0.9 to 1.02 with real sensors, 8 with outliers
_BENT = 2.0  # times what random errors make of it: a bend of large planes that shows a floor by itself
_WAVES = 0.7  # relative deviation, by chance, of a large plane's bend: it has room for few waves only
_UNSURE = 0.05  # relative deviation of what random errors make of it, as tiles tell
_FILLED, _FEWEST_TILES = 0.6, 60.0  # share of its square that a large plane fills, and the fewest tiles that it has
_PARTS = 5  # of the image along either side: a falloff must show without each of them
_STARTS = 0.0, 0.25, 0.5, 0.75  # where the first part begins, in parts: where it does must not decide
_FRAMES = 4  # with this many or more, it must show without each of them, too
_SURE = 3.0  # standard errors that a falloff must exceed
_RANDOM = 0.01  # σq as a share of all errors, at least: small tiles see it, and hardly any of errors that reach far
_TURNS, _CLOSE = 10, 0.02  # most turns of fitting depth and falloff; a relative change that counts as none
_SMALL, _ROUNDS = 0.1, 10  # deviations of logarithms that count as small, and steps to find their least sum
_NO_NOISE = "expected frames with noise, got flat tiles whose only residual is rounding: rendered without noise?"
_FEWEST_FREE = 40.0  # degrees of freedom that residuals count as having: else tilts alone would tell of long waves
_ENOUGH_LARGE = 48  # windows twice as large that are enough to tell how far errors reach


def estimate_noise(
    frames: Sequence[npt.ArrayLike | Frame] | npt.NDArray[Any], camera: Camera, *, num_threads: int | None = None
) -> NoiseModel:
    """Estimate a sensor's noise from frames of ordinary scenes, without a target or a still camera.

    Parameters
    ----------
    frames : (F, H, W) array or sequence of (H, W), or of Frame by this camera, or one (H, W)
        With surfaces that are flat over 50 pixels or more, at the depths that matter; for the covariances of large
        planes, with such planes. The more frames and the more places, the better; one can be enough.
    camera : Camera
        Its ``noise`` is ignored.
    num_threads : int, optional
        Threads at most. The result is the same for any number.

    Returns
    -------
    NoiseModel
        What the frames show, rounding to integers included, even where these were converted to metres, with
        `NoiseEvidence` as ``evidence``, whose ``plot()`` draws the fit.

    Raises
    ------
    TypeError, ValueError
        Too little in the frames is flat, or what is flat has no noise; or a frame, whose number is given,
        is not this camera's.

    Warns
    -----
    UserWarning
        Something in the frames is most likely not meant as it is, such as their unit. Or windows that count as flat
        differ so much that they may hold edges or outliers: do not rely on the model then. Or surfaces without noise
        are bent as depth, and flat as distances along the ray.

    Notes
    -----
    Surfaces that are not flat but everywhere as smooth as a plane (a curtain, a lawn) count as noise.
    """
    check_camera(camera)
    num_threads = check_num_threads(num_threads)
    opened, rounding = _open(frames, camera.with_noise(None))
    found = _find_flat(opened, camera.with_noise(None), num_threads)
    samples = all_samples(found.tiles, found.flat, found.most_missing)
    for some in samples.values():
        if np.median(some.rss / (some.count * some.q**2)) < EXACT**2:
            raise ValueError(_NO_NOISE)
    # Small windows show all surfaces, large ones, if there are enough of them, how far errors reach.
    reaching = samples
    if 2 * WINDOW in found.tiles:
        large = flat_windows(found.tiles[2 * WINDOW], found.tiles[8], found.most_missing, found.flat)
        if np.count_nonzero(large) >= _ENOUGH_LARGE:
            parts = large.repeat(2, axis=1).repeat(2, axis=2)
            reaching = all_samples(found.tiles, parts, found.most_missing, 2 * WINDOW)
    model = _fit_depth(samples[REFERENCE], rounding)
    model = _fit_falloff(samples[REFERENCE], model)
    for _ in range(3):
        model = _fit_reach(reaching, _fit_spread(samples, model))
        model = _fit_scale(samples[REFERENCE], model)
    # Biases over hundreds of pixels are nearly planar on any tile, and make little residual.
    with collected_warnings([]):  # of the frames: they were given when these were opened
        planes = large_planes(opened, camera.with_noise(model), num_threads)
    model = _fit_reach(reaching, model, planes)
    model = _fit_scale(samples[REFERENCE], model)
    with collected_warnings([]):
        strays = outlying(opened, found.tiles[WINDOW], found.flat)
    uneven = unevenness(found.tiles[WINDOW], found.tiles[8], found.flat)
    if model.spread >= SPREADS[-1] or uneven > _UNEVEN or strays > _STRAYS:
        warn_caller(
            "what is taken for flat differs more than the noise of a sensor does, and may be edges, or outliers: "
            "are surfaces in the frames flat over 50 pixels or more?"
        )
    count = int(np.count_nonzero(found.flat))
    with collected_warnings([]):
        evidence = evidence_of(opened, camera, model, samples, count, num_threads)
    return replace(model, evidence=evidence)


def _open(frames: Any, camera: Camera) -> tuple[list[Any], NoiseModel]:
    """A list of the frames, all of which can be fitted, and a model with their rounding alone."""
    if not hasattr(frames, "__len__") or isinstance(frames, (bytes, bytearray, Mapping)):
        raise TypeError(f"expected a sequence of frames, got {type(frames).__name__}")
    is_one = getattr(frames, "ndim", None) == 0
    opened: list[Any] = []
    for index, given in enumerate(() if is_one else frames):  # each is read once
        with naming(f"frame {index}"):
            opened.append(depth_of(given, camera))
    is_one = is_one or (len(opened) > 0 and np.ndim(opened[0]) == 1)  # those were rows
    if is_one:
        opened = [frames]
    if not opened:
        raise ValueError("expected at least one frame, got none")
    if min(camera.shape) < WINDOW:
        raise ValueError(
            f"expected frames of at least {WINDOW} x {WINDOW} pixels, got {camera.width} x {camera.height}"
        )
    steps = []
    for index, depth in enumerate(opened):
        frame = as_depth_frame(depth, camera) if is_one else as_numbered_frame(index, depth, camera)
        warn_of_distances(frame, camera)
        step = spacing_of(frame)
        steps.append(abs(step * frame.scale if frame.is_disparity else step / frame.scale))
    return opened, _rounding(steps, camera.disparity is not None)


class _Flat(NamedTuple):
    """The tiles of each size, (F, R, C) bool which windows are flat, and the share of pixels that these may miss."""

    tiles: dict[int, TilePlanes]
    flat: npt.NDArray[np.bool_]
    most_missing: float


def _find_flat(opened: list[Any], camera: Camera, num_threads: int | None) -> _Flat:
    """Find the windows that are flat, with the least pixels missing of which there are enough."""
    for most_missing in MOST_MISSING:
        with collected_warnings([]):  # of the frames: they were given when these were opened
            tiles = {
                size: TileFitter(camera, size, max_missing=most_missing, num_threads=num_threads).fit_batch(opened)
                for size in SIZES
                if size <= min(camera.shape)
            }
        flat = flat_windows(tiles[WINDOW], tiles[8], most_missing)
        count = int(np.count_nonzero(flat))
        if count >= FEWEST_WINDOWS:
            return _Flat(tiles, flat, most_missing)
    windows = tiles[WINDOW]
    exact = windows.rmse * mean_depth(windows) < EXACT
    if np.count_nonzero(exact) > 0.5 * np.count_nonzero(windows.fitted):
        raise ValueError(_NO_NOISE)
    whole = windows.valid_count[:, : camera.height // WINDOW, : camera.width // WINDOW]
    missing = np.mean(whole < (1.0 - most_missing) * WINDOW * WINDOW)
    reason = f": of most windows more than {two_digits(100.0 * most_missing)} % of the pixels are missing"
    raise ValueError(
        f"expected frames with at least {FEWEST_WINDOWS} flat windows of {WINDOW} x {WINDOW} pixels, "
        f"found {count} in {counted(len(opened), 'frame')}{reason if missing > 0.5 else ''}"
    )


def _rounding(steps: Sequence[float], is_disparity: bool) -> NoiseModel:
    """A model with the rounding of frames that have these steps, of depth in metres or of q; 0 where none is seen."""
    seen = [step for step in steps if step > 0.0]
    if len(seen) <= 0.5 * len(steps):
        return NoiseModel()
    return NoiseModel(disparity_step=min(seen)) if is_disparity else quantised(NoiseModel(), min(seen))


def _fit_depth(samples: Samples, known: NoiseModel) -> NoiseModel:
    """σq against depth, in bins, and the lateral error with which residuals are nearest to the model.

    The rounding and the falloff are those of ``known``.

    Each bin's σq makes half of its residuals larger than the model's; the median of three neighbours is taken. Beyond
    the depths that were seen it continues as a power of q, from constant (disparity) to q² (rounding); as constant if
    hardly different depths were seen.
    """
    bins = bins_of(samples.q, 60)
    q, first = np.unique([np.median(samples.q[chosen]) for chosen in bins], return_index=True)
    bins = [bins[i] for i in first]  # where all is at one depth, one bin tells as much as several
    seen = samples.seen
    growth = samples.growth(known)
    rounding = samples.independent(replace(known, lateral=0.0))
    least = [0.01 * np.median((seen / growth)[some]) for some in bins]
    best: tuple[float, float, Floats] = (np.inf, 0.0, np.zeros(len(q)))
    for lateral in LATERALS.tolist():
        independent = lateral**2 * samples.slope_square + rounding
        own = np.array([np.median(((seen - independent) / growth)[some]) for some in bins])
        variance = np.maximum(own, least)
        ends = np.concatenate([variance[:1], variance, variance[-1:]])
        variance = np.median([ends[:-2], ends[1:-1], ends[2:]], axis=0)
        error = np.log(seen / (np.interp(samples.q, q, variance) * growth + independent))
        distance = float(np.mean(np.abs(error - np.median(error))))
        if distance < 0.999 * best[0]:
            best = distance, lateral, variance
    _, lateral, variance = best
    sigma = np.sqrt(variance)
    spread = np.log(q) - np.log(q).mean()
    total = max(float(spread @ spread), 1e-12)
    power = float(np.clip(spread @ np.log(sigma) / total, 0.0, 2.0))
    # Of medians of logarithms of variances, which are twice those of deviations.
    bin_errors = [0.5 * 1.25 * np.std(np.log(seen / growth)[some]) / math.sqrt(len(seen[some])) for some in bins]
    if not power > _SURE * float(np.median(bin_errors)) / math.sqrt(total):
        power = 0.0  # where hardly different depths are seen, chance makes any
    farther, nearer = np.array([0.25, 0.35, 0.5, 0.7]), np.array([1.4, 2.0, 2.8, 4.0])
    along = table(
        np.concatenate([q[0] * farther, q, q[-1] * nearer]),
        np.concatenate([sigma[0] * farther**power, sigma, sigma[-1] * nearer**power]),
    )
    return replace(along, lateral=lateral, falloff=known.falloff, step=known.step, disparity_step=known.disparity_step)


def _fit_falloff(samples: Samples, model: NoiseModel) -> NoiseModel:
    """How fast noise grows away from the optical axis, fitted in turns with how it changes with depth in ``model``.

    There is a falloff only if what depth does not explain grows by more than chance would make it, by the jackknife
    over parts of the image and over frames. A few noisy surfaces towards the edge, in however many frames, make none.
    """
    # The part of the angle that goes with depth, as on a floor, says nothing: depth may explain it as well.
    away = np.log(samples.growth(NoiseModel(falloff=1.0)))
    bins = bins_of(samples.q, 60)
    middles, first = np.unique([np.median(samples.q[some]) for some in bins], return_index=True)
    away = away - np.interp(samples.q, middles, [np.mean(away[bins[i]]) for i in first])
    frame, *place = samples.place
    left = samples.left(model)
    slope = _slope(away, left)

    def variance(part: Any) -> float:
        """Variance of the slope by the jackknife: from the slopes without each part."""
        without = [_slope(away[part != i], left[part != i]) for i in np.unique(part)]
        return (len(without) - 1.0) * float(np.var(without))

    variances = [variance(frame)] if len(np.unique(frame)) >= _FRAMES else []
    parts = []
    for start in _STARTS:
        row, column = ((_PARTS * (i - i.min()) / (np.ptp(i) + 1) + start).astype(np.int64) for i in place)
        parts.append(variance((_PARTS + 1) * row + column))
    variances.append(sum(parts) / len(parts))
    if not slope > _SURE * math.sqrt(max(variances)):
        return model
    for _ in range(_TURNS):
        model = _fit_depth(samples, replace(model, falloff=max(model.falloff + slope, 0.0)))
        # Of what is seen only this share grows: the lateral error and rounding do not.
        along = samples.along(model)
        slope = _slope(away * along / (along + samples.independent(model)), samples.left(model))
        if abs(slope) < _CLOSE * model.falloff:
            break
    return model


def _slope(x: Floats, y: Floats) -> float:
    """Slope of logarithms y on x: least absolute deviations, least squares for small ones (Huber 1964)."""
    slope = level = 0.0
    for _ in range(_ROUNDS):
        weight = 1.0 / np.maximum(np.abs(y - level - slope * x), _SMALL)
        weight /= np.sum(weight)
        middle = np.sum(weight * x)
        away = weight * (x - middle)
        slope = float(np.sum(away * y) / max(np.sum(away * x), 1e-12))
        level = float(np.sum(weight * y) - slope * middle)
    return slope


def _alone(part: tuple[float, float]) -> NoiseModel:
    """Noise of this share and length alone; length 0 is independent."""
    return NoiseModel(correlation=(part,) if part[1] else ())


def _square_statistics(part: tuple[float, float], sizes: npt.ArrayLike, filled: Floats | float) -> ResidualStatistics:
    """What such errors do to squares of which this share of the pixels is measured."""
    sides = np.asarray(sizes, np.float64)
    return _alone(part).statistics(filled * sides**2, np.stack([sides, sides], axis=-1))


def _per_pixel(part: tuple[float, float], sizes: npt.ArrayLike, filled: Floats | float = 1.0) -> Floats:
    """Expected mean square residual of tiles of these sizes if all errors had this correlation."""
    return np.asarray(_square_statistics(part, sizes, filled).expected / (filled * np.square(sizes)))


def _tilts(part: tuple[float, float], sizes: npt.NDArray[np.int64], window: int, filled: Floats) -> Floats:
    """Expected variance of slopes about those of the window that the tiles are part of."""
    shared = (sizes / window) ** 4 * _square_statistics(part, np.full(len(sizes), window), filled).tilt_x
    return np.asarray(_square_statistics(part, sizes, filled).tilt_x - shared)


def _fit_reach(samples: dict[int, Samples], model: NoiseModel, large: Sequence[LargePlanes] = ()) -> NoiseModel:
    """How the variance is shared out over correlation lengths, from how residuals and slopes change with size.

    And from how far large planes are bent, if there are any.

    By least squares of errors relative to what is seen and to what chance makes of it, no share below 0. There is a
    floor only if it brings the model nearer by more than chance would. In tiles smaller than its length little of it
    shows, and to explain that little it would have to be large.
    """
    from scipy.optimize import nnls

    sizes = np.array(list(samples))
    window = samples[REFERENCE].window
    small = sizes[sizes <= window // 2]
    typical = [some.typical(model) for some in samples.values()]
    values, seen = np.array([*typical, *(samples[size].typical_tilt(model) for size in small)]).T
    # For medians of residuals, and of squared slopes, which are distributed as χ²(2). The spread is the same for all
    # sizes.
    counts = np.array([len(some.count) for some in samples.values()])
    filled = np.array([np.mean(some.count) / size**2 for size, some in samples.items()])
    freedom = [max(float(np.median(some.expected(model)[1])), _FEWEST_FREE) for some in samples.values()]
    one_error = np.append(1.25 * np.sqrt(2.0 / np.array(freedom)), np.full(len(small), 1.0 / np.log(2.0)))
    chance = one_error / np.sqrt(np.append(counts, counts[: len(small)]))
    scale = seen * np.hypot(chance, _INEXACT)
    sides, bends, planes = bends_by_side(large)
    values = np.append(values, bends)

    def bent(part: tuple[float, float]) -> Floats:
        return _per_pixel(part, sides) - _per_pixel(part, TILE)

    def terms(part: tuple[float, float]) -> Floats:
        tilts = _tilts(part, small, window, filled[: len(small)])
        return np.concatenate([_per_pixel(part, sizes, filled), tilts, bent(part)])

    def shared_out(parts: list[Floats], scale: Floats) -> tuple[float, Floats]:
        """Of the first values, as many as there are of the scale: how far off they are, and the shares."""
        first = slice(len(scale))
        explained = np.stack(parts, axis=1)[first]
        shares, distance = nnls(explained / scale[:, None], values[first] / scale, maxiter=1000)
        return distance**2, np.asarray(shares)

    random_parts = [terms(part) for part in ((0.0, 0.0), *((1.0, length) for length in LENGTHS))]
    _, tile_shares = shared_out(random_parts, scale)
    usual = np.maximum(np.array(random_parts)[:, len(scale) :].T @ tile_shares, 3.0 / TILE**2)
    scale = np.append(scale, _chance_of_bends(bends, usual, sides, planes))
    error, shares = shared_out(random_parts, scale)
    if planes.sum() < 2 or not (bends > _BENT * usual).any():  # one may be a wall with a board before it
        error -= _EVIDENT
    shares, floor_length = np.append(shares, 0.0), FLOOR_LENGTHS[0]
    for length in FLOOR_LENGTHS:
        if 2 * length <= max(*sizes, *sides, 2 * FLOOR_LENGTHS[0]):
            with_floor, candidate = shared_out([*random_parts, terms((1.0, length))], scale)
            if with_floor < error:
                error, shares, floor_length = with_floor, candidate, length
    shares[0] += 1e-9  # where all is lateral error and rounding
    random = float(shares[:-1].sum())
    least = _RANDOM**2 * shares.sum()
    if random < least:  # all of it smooth: without random errors the floor would be infinite
        shares[0] += least
        random = float(shares[:-1].sum())
    # σq is that of the random error.
    return replace(
        model,
        samples=tuple((q, np.sqrt(random) * sigma) for q, sigma in model.samples or ()),
        correlation=tuple(
            (float(share / random), length) for share, length in zip(shares[1:-1], LENGTHS, strict=True) if share > 0.0
        ),
        floor=float(np.sqrt(shares[-1] / random)),
        floor_length=floor_length,
    )


def _chance_of_bends(bends: Floats, usual: Floats, sides: Floats, planes: Floats) -> Floats:
    """Standard deviations of how far large planes are bent, of which ``usual`` is what random errors make of it.

    That, of three coefficients a tile, varies little; what waves add has room for few, and varies by `_WAVES`.
    """
    tiles = np.maximum(_FILLED * (sides / TILE) ** 2, _FEWEST_TILES)
    random_error = 1.25 * np.sqrt(2.0 / (3.0 * tiles)) * usual
    wave_error = _WAVES * np.maximum(bends - usual, 0.0)
    return np.hypot(np.hypot(random_error, wave_error) / np.sqrt(planes), _UNSURE * usual)


def _fit_scale(samples: Samples, model: NoiseModel) -> NoiseModel:
    """Make half of the residuals of tiles larger than the model's."""
    pixels = np.median(samples.count)
    typical = max(samples.typical(model)[0], 0.01)
    scale = np.sqrt(typical * pixels / float(model.statistics(pixels, (samples.size, samples.size)).expected))
    return replace(model, samples=tuple((q, scale * s) for q, s in model.samples or ()))


def _fit_spread(samples: dict[int, Samples], model: NoiseModel) -> NoiseModel:
    """The spread with which residuals reach as far above their median as those of the tiles do."""
    deviate = NormalDist().inv_cdf(_TAIL)
    spreads = []
    for size in (8, 12, 24):
        some = samples[size]
        expected, freedoms = some.expected(model)
        ratio = some.rss / expected
        reach = np.quantile(ratio, _TAIL) / np.median(ratio)
        freedom = float(np.median(freedoms))
        reaches = ratio_at(deviate, freedom, SPREADS) / ratio_at(0.0, freedom, SPREADS)
        spreads.append(float(np.interp(reach, reaches, SPREADS)))
    return replace(model, spread=float(np.median(spreads)))
