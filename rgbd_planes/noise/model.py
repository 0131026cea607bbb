"""A model of a sensor's noise, made by `rgbd_planes.noise` and kept by a `Camera`."""

from __future__ import annotations

import html
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.checks import number, numbers, real_array, shaped_array
from rgbd_planes._core.lazy_property import kept
from rgbd_planes._core.text import counted, two_digits
from rgbd_planes.noise.correlation import Components, ResidualStatistics, correlated_statistics
from rgbd_planes.noise.sigma import LARGEST_NOISE, check_noise, for_each

# Tables of the noise by inverse depth: number of entries, and the largest inverse depth in 1/m.
_ENTRIES, _LARGEST = 8192, 20.0
_SCALE = _ENTRIES / _LARGEST
SMALLEST_INVERSE_DEPTH = 0.5 / _SCALE  # 1/m: no function of inverse depth need be defined below
_APART = 0.05  # of q: over so much of it, to either side, a table's bend is taken
_MOST_BENT = 56.0  # that of a power of 8: a table that is bent more jumps
_MOST_PIXELS = 1e8
_LARGEST_FALLOFF = 50.0  # that of sensors is up to 5
_AT_30_DEGREES = 3.0**-0.5  # tangent

KINECT_V1 = 1.425e-3
"""Standard deviation of a Kinect v1's inverse depth in 1/m (the paper's eq. 2)."""


@dataclass(frozen=True, repr=False)
class NoiseModel:
    """The noise of a sensor's inverse depth.

    Make one with `kinect_v1`, `stereo`, `time_of_flight`, `axial`, `table`, `function` or `quantised`, or
    from your own frames with `rgbd_planes.estimate_noise`; `dataclasses.replace` changes one.

    Attributes
    ----------
    coefficients : (c0, c1, c2)
        σq = c0 + c1·q + c2·q² is the standard deviation of the random error of one pixel on the optical axis, in 1/m.
        It is not below 0 at any q from 1.2e-3 to 20 1/m.
    samples : tuple of (q, σq), optional
        Instead of `coefficients`: σq at inverse depths, linear between them, constant beyond.
    formula : function, optional
        Instead of `coefficients`: σq of an array of q.
    step : float
        Quantum of integer depth in metres: rounding adds (step·q²)²/12 to the variance.
    disparity_step : float
        Quantum of integer disparity in 1/m: adds disparity_step²/12.
    correlation : tuple of (share, length)
        Shares of the random variance that are correlated between pixels at distance r as
        exp(-r²/(2·length²)), length in pixels. The rest, up to 1, is independent.
    floor : float
        Systematic error (lens, calibration, the sensor's own filters), which does not average out: its
        standard deviation as a multiple of σq.
    floor_length : float
        Distance in pixels over which the systematic error changes, in the sense of ``correlation``.
    spread : float
        Relative standard deviation of the noise's variance from place to place, beyond what depth explains: that of
        texture and reflectance. The variance is taken to be inverse gamma distributed.
    lateral : float
        Standard deviation, in pixels, of how far beside its ray a measurement lies. Times the change of q from pixel
        to pixel it is another error, which is large on steep surfaces. `sigma` does not contain it.
    falloff : float
        How fast noise grows away from the optical axis, as where a sensor's light falls off. At a pixel whose ray is
        (tanθx, tanθy, 1), at an angle θ from the axis, σq before rounding is 1 / cos^falloff(θ) times its value on the
        axis: (1 + tan²θx + tan²θy)^(falloff / 2) times. The lateral error and rounding do not grow.
        `rgbd_planes.segment` uses it in covariances only, and there if neighbours share errors: each frame tells it how
        much noise there is.
    evidence : NoiseEvidence, optional
        What `rgbd_planes.estimate_noise` saw; it is not kept in files.

    Notes
    -----
    Fits of tiles and windows look σq up in a table, unless it is a single coefficient. Made from coefficients, the
    table is right to 0.2 % from 0.05 to 20 m, and to 5 % up to 100 m. Nearer and farther it may be far off. For
    ``time_of_flight(0.02)`` it gives 0.56 times σq at 0.025 m, 1.3 times at 273 m and 4 times at 1000 m.
    """

    coefficients: tuple[float, ...] = (KINECT_V1,)
    samples: tuple[tuple[float, float], ...] | None = None
    formula: Callable[[Floats], ArrayLike] | None = field(default=None, hash=False)  # some have no hash
    step: float = 0.0
    disparity_step: float = 0.0
    correlation: tuple[tuple[float, float], ...] = ()
    floor: float = 0.0
    floor_length: float = 60.0
    spread: float = 0.0
    lateral: float = 0.0
    falloff: float = 0.0
    evidence: Any = field(default=None, compare=False)

    def __post_init__(self) -> None:
        coefficients = numbers("coefficients", self.coefficients)
        if not 1 <= len(coefficients) <= 3:
            raise ValueError(f"expected 1 to 3 coefficients, got {self.coefficients!r}")
        if self.formula is not None and not callable(self.formula):
            raise TypeError(f"expected formula as a function of inverse depth, got {self.formula!r}")
        if self.samples is not None:
            if self.formula is not None:
                raise ValueError("expected samples or a formula, got both")
            coefficients = (KINECT_V1,)  # neither used nor saved
            samples = _pairs("samples", self.samples, "inverse depth, sigma")
            if not (samples.size and (np.diff(samples[:, 0]) > 0.0).all() and (samples[:, 1] > 0.0).all()):
                raise ValueError(f"expected samples of growing inverse depth and positive sigma, got {self.samples!r}")
            object.__setattr__(self, "samples", tuple((float(q), float(s)) for q, s in samples))
        object.__setattr__(self, "coefficients", coefficients)
        for name in ("step", "disparity_step", "floor", "floor_length", "spread", "lateral", "falloff"):
            value = number(name, getattr(self, name))
            if value < 0.0:
                raise ValueError(f"expected {name} of 0 or more, got {value!r}")
            if value > LARGEST_NOISE:
                raise ValueError(f"expected {name} of at most {LARGEST_NOISE:g}, got {value!r}")
            object.__setattr__(self, name, value)
        if self.falloff > _LARGEST_FALLOFF:
            raise ValueError(f"expected a falloff of at most {_LARGEST_FALLOFF:g}, got {self.falloff!r}")
        correlation = _pairs("correlation", self.correlation, "share, length")
        shares, lengths = correlation.T.tolist()
        if min(shares, default=0.0) < 0.0 or sum(shares) > 1.0 + 1e-9:
            raise ValueError(f"expected shares of correlation that add up to at most 1, got {shares}")
        if min([self.floor_length, *lengths]) <= 0.0:
            raise ValueError(
                f"expected positive correlation lengths in pixels, got {lengths} and {self.floor_length!r}"
            )
        if max(lengths, default=0.0) > LARGEST_NOISE:
            raise ValueError(f"expected correlation lengths of at most {LARGEST_NOISE:g} pixels, got {lengths}")
        object.__setattr__(self, "correlation", tuple(zip(shares, lengths, strict=True)))
        if not (self._table().any() or self.step or self.disparity_step):
            raise ValueError("expected noise above 0, or a step of rounding, got 0 at all inverse depths")

    def __getstate__(self) -> dict[str, Any]:
        # Without its table, of 64 KiB: cameras are pickled for each task of a worker.
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def __repr__(self) -> str:
        return f"<NoiseModel: {self._summary()}>"

    def _repr_html_(self) -> str:
        """What a notebook shows: the noise at some depths and, if it was estimated, from what."""
        text = f"<div>{html.escape(repr(self).strip('<>'))}</div>"
        return text if self.evidence is None else f"<div>{text}{self.evidence._figure_html()}</div>"

    def _summary(self) -> str:
        # No Greek: printing letters that stdout's encoding lacks is an error, as into a file on Windows.
        parts = ["sigma by a function"]
        if self.formula is None:
            depths = ["0.5", "1", "2"]
            if self.evidence is not None:  # the nearest, the middle and the farthest that was seen
                seen = 1.0 / np.quantile(self.evidence.inverse_depth, [1.0, 0.5, 0.0])
                depths = list(dict.fromkeys(two_digits(depth) for depth in seen))
            sigmas = zip(1e3 * self.sigma_depth([float(depth) for depth in depths]), depths, strict=True)
            parts = ["sigma " + ", ".join(f"{two_digits(sigma)} mm at {depth} m" for sigma, depth in sigmas)]
        if self.falloff:
            times = float(self._growth(_AT_30_DEGREES, 0.0)) ** 0.5
            parts.append(f"{times:.3g} times as much 30 degrees off the axis")
        if self.lateral:
            parts.append(f"lateral {self.lateral:.2g} pixels")
        for share, length in self.correlation:
            if share >= 1e-3:
                parts.append(f"{two_digits(100.0 * share)} % correlated over {counted(length, 'pixel')}")
        if self.floor:
            parts.append(f"floor {self.floor:.2g} sigma over {counted(self.floor_length, 'pixel')}")
        if self.spread:
            parts.append(f"spread {self.spread:.2g}")
        return "; ".join(parts)

    def sigma(self, inverse_depth: ArrayLike, tan_x: ArrayLike = 0.0, tan_y: ArrayLike = 0.0) -> Floats:
        """Standard deviation of one pixel's inverse depth, quantisation included, in 1/m.

        Parameters
        ----------
        inverse_depth : array_like
            1/m.
        tan_x, tan_y : array_like, optional
            tanθx and tanθy of the pixel's ray, for a model with `falloff`; without them the ray is the optical axis.
            Shapes broadcast.

        Raises
        ------
        TypeError
            One of them is masked, or not numbers.
        """
        growth = self._growth(real_array("tan_x", tan_x), real_array("tan_y", tan_y))
        return self._sigma(real_array("inverse_depth", inverse_depth), growth)

    def _sigma(self, q: Floats, growth: Floats | float) -> Floats:
        return np.asarray(np.sqrt(self._along(q) ** 2 * growth + self._rounding(q)))

    def _growth(self, tan_x: ArrayLike, tan_y: ArrayLike) -> Floats:
        """The variance of q before rounding on a ray, as a multiple of that on the optical axis."""
        return np.asarray((1.0 + np.square(tan_x) + np.square(tan_y)) ** self.falloff)

    def _along(self, q: Floats) -> Floats:
        """Standard deviation of q before rounding, on the optical axis."""
        if self.formula is not None:
            sigma = for_each(self.formula(q.copy()), q)  # which may work in place
        elif self.samples is not None:
            sigma = np.interp(q, *np.array(self.samples).T)
        else:
            c0, c1, c2 = (*self.coefficients, 0.0, 0.0)[:3]
            sigma = (c2 * q + c1) * q + c0 if len(self.coefficients) > 1 else np.full(q.shape, c0)
        return np.asarray(sigma)

    def _rounding(self, q: Floats) -> Floats:
        """Variance of q from rounding, which is independent from pixel to pixel."""
        variance = np.full(np.shape(q), self.disparity_step**2)
        if self.step:  # otherwise 0 times infinity, at a depth of 0, would be NaN
            variance += (self.step * q * q) ** 2
        return np.asarray(variance / 12.0)

    def sigma_depth(self, depth: ArrayLike, tan_x: ArrayLike = 0.0, tan_y: ArrayLike = 0.0) -> Floats:
        """Standard deviation of one pixel's depth in metres at depths in metres: σZ = σq·Z².

        NaN where a depth is not positive, as where nothing is measured.
        """
        z = real_array("depth", depth)
        z = np.where(z > 0.0, z, np.nan)
        with np.errstate(over="ignore", invalid="ignore"):  # next to 0
            return np.asarray(self.sigma(1.0 / z, tan_x, tan_y) * z * z)

    @property
    @kept
    def _variances(self) -> Floats:
        """σq² before rounding, on the axis, as `kernels.statistics.variances` has it: a scale, and a table."""
        if self.formula is None and self.samples is None and len(self.coefficients) == 1:
            return np.array([1.0, self.coefficients[0] ** 2])
        table = self._table() ** 2
        table[-1] = max(table[-2:])  # beyond, it goes on by its last step: not down to less than nothing
        return np.concatenate([[_SCALE], table, _bends_of(table)])

    def _table(self) -> Floats:
        """σq before rounding, on the axis, at all inverse depths, 1.2e-3 to 20 1/m."""
        q = np.maximum(np.arange(_ENTRIES + 1) / _SCALE, SMALLEST_INVERSE_DEPTH)
        return check_noise(self._along(q), q)

    @property
    def is_independent(self) -> bool:
        """Whether pixels err independently, and equally at the same depth and angle off the axis."""
        return not (any(share for share, _ in self.correlation) or self.floor or self.spread)

    def statistics(self, count: ArrayLike, size: ArrayLike | None = None) -> ResidualStatistics:
        """What this noise does to a plane fitted to ``count`` neighbouring pixels.

        Parameters
        ----------
        count : array_like of int
            Numbers of valid pixels.
        size : (..., 2) array_like, optional
            Height and width of the rectangles among whose pixels these lie. Pixels may be missing in one piece, which
            leaves a rectangle of these proportions, or here and there. The case with larger errors counts. Without it
            the pixels are full squares.

        Returns
        -------
        ResidualStatistics
            Of arrays of the shape of `count`, to which that of `size`, but for its last axis, is broadcast.

        Raises
        ------
        TypeError, ValueError
            One of them is no array of numbers, or of numbers that no image has.
        """
        n = _image_sized("count", real_array("count", count), 0.0)
        if self.is_independent:
            freedom = np.maximum(n - 3.0, 0.0)
            one = np.ones(n.shape)
            return ResidualStatistics(freedom, np.maximum(freedom, 1e-3), one, one, one)
        if size is None:
            return correlated_statistics(self._components, n, np.ones(n.shape))
        sides = _image_sized("size", shaped_array("size", size, (2,)), 1.0)
        n, height, width = np.broadcast_arrays(n, *np.moveaxis(sides, -1, 0))
        whole, proportions = height * width, width / height
        in_one_piece = correlated_statistics(self._components, n, proportions)
        if not (n < whole - 0.5).any():
            return in_one_piece
        full = correlated_statistics(self._components, whole, proportions)
        return in_one_piece.or_larger(full.scaled_to(n, whole))

    @property
    def _white(self) -> float:
        """The share of σq² that is independent from pixel to pixel."""
        return max(1.0 - sum(share for share, _ in self.correlation), 0.0)

    @property
    def _components(self) -> Components:
        """(variance, length) of each part of the error in units of σq²; length 0 is independent."""
        parts = ((self._white, 0.0), *self.correlation, (self.floor**2, self.floor_length))
        return tuple(part for part in parts if part[0] > 0.0)

    def to_dict(self) -> dict[str, Any]:
        """The model as a dict that JSON can hold.

        Raises
        ------
        ValueError
            It is a user's function.
        """
        if self.formula is not None:
            raise ValueError("expected a noise model of numbers, got one of a function: make a table of it")
        values = {
            f.name: getattr(self, f.name)
            for f in fields(self)
            if f.name not in ("formula", "evidence") and getattr(self, f.name) != f.default
        }
        return values if self.samples is not None else values | {"coefficients": self.coefficients}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Make a model from what `to_dict` returned.

        Raises
        ------
        TypeError, ValueError
            There are unknown keys, neither ``coefficients`` nor ``samples``, or an invalid value.
        """
        known = {f.name for f in fields(cls)} - {"formula", "evidence"}
        if not isinstance(values, Mapping) or not set(values) <= known:
            raise ValueError(f"expected a noise model with the keys {', '.join(sorted(known))}, got {values!r}")
        model = cls(**values)
        if values.get("coefficients") is None and values.get("samples") is None:
            raise ValueError(f"expected a noise model with coefficients or samples, got {dict(values)!r}")
        return model


def _bends_of(table: Floats) -> Floats:
    """By entry, the second derivative of a table of variances by q, times q² over the variance.

    From values a twentieth of q to either side, as far as a tile may reach: what is linear in between has no derivative
    at its knots.
    """
    k = np.arange(len(table), dtype=np.float64)
    apart = np.maximum(_APART * k, 1.0)
    beyond = np.append(table, table[-1] + (table[-1] - table[-2]) * np.ceil(apart[-1]))
    places = np.append(k, k[-1] + np.ceil(apart[-1]))
    before, behind = np.interp(k - apart, k, table), np.interp(k + apart, places, beyond)
    bends = np.divide(before - 2.0 * table + behind, table, out=np.zeros(len(k)), where=table > 0.0) * (k / apart) ** 2
    return np.asarray(np.clip(bends, -_MOST_BENT, _MOST_BENT))


def _image_sized(name: str, values: Floats, least: float) -> Floats:
    """Return numbers of pixels, each of at least ``least``, and of no more than images have."""
    if not ((values >= least) & (values <= _MOST_PIXELS)).all():
        raise ValueError(f"expected {name} of {least:g} to {_MOST_PIXELS:g} pixels, got {values.tolist()}")
    return values


def _pairs(name: str, values: Any, entries: str) -> Floats:
    """(N, 2) finite numbers."""
    try:
        pairs = real_array(name, [tuple(pair) for pair in values]).reshape(len(values), 2)
    except (OverflowError, TypeError, ValueError):
        pairs = np.full((1, 2), np.nan)
    if not np.isfinite(pairs).all():
        raise ValueError(f"expected {name} as pairs ({entries}), got {values!r}")
    return pairs


def check_not_a_maker(noise: Any) -> None:
    """Raise a TypeError for a function of `rgbd_planes.noise` given in place of the model that it makes."""
    if getattr(noise, "__module__", "") == "rgbd_planes.noise" and hasattr(noise, "__name__"):
        name = noise.__name__
        raise TypeError(f"expected noise as a NoiseModel, got the function {name}: {name}(...) makes one")
