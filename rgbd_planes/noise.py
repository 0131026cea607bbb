"""How a depth sensor errs: the standard deviation of the inverse depth, and how pixels err together.

Noise lives in q = 1/Z. A disparity sensor's is constant there, σq = σ_disparity / (f·baseline); published
axial noise converts by σq = σZ / Z².

>>> import rgbd_planes as rp
>>> camera = rp.Camera(640, 480, 525.0, 525.0, 319.5, 239.5, depth_scale=1000.0, noise=rp.noise.kinect_v1())
"""

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from rgbd_planes.camera import Camera

Floats = NDArray[np.float64]

# Of tables of the noise by inverse depth: how many entries, up to where in 1/m.
_ENTRIES, _LARGEST = 2048, 100.0

KINECT_V1 = 1.425e-3
"""Standard deviation of a Kinect v1's inverse depth in 1/m (eq. noise_models)."""


@dataclass(frozen=True)
class NoiseModel:
    """The noise of a sensor's inverse depth.

    Make one with `kinect_v1`, `stereo`, `time_of_flight`, `axial`, `table`, `function` or `quantised`, or
    from your own frames with `rgbd_planes.estimate_noise`; `dataclasses.replace` changes one.

    Attributes
    ----------
    coefficients : (c0, c1, c2)
        σq = c0 + c1·q + c2·q² of the random error of one pixel, in 1/m.
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
        exp(-r²/(2·length²)), length in pixels. What is left of 1 is independent.
    floor : float
        Systematic error (lens, calibration, the sensor's own filters), which does not average out: its
        standard deviation as a multiple of σq.
    floor_length : float
        Distance in pixels over which the systematic error changes, in the same sense.
    spread : float
        Relative standard deviation of the noise's variance from place to place, over what depth explains:
        texture, reflectance.
    lateral : float
        Standard deviation, in pixels, of where across its ray a measurement lies: times the change of q from pixel
        to pixel it is noise, too, that of steep surfaces. `sigma` is without it.
    evidence : NoiseEvidence, optional
        What `rgbd_planes.estimate_noise` saw; no part of a file.
    """

    coefficients: tuple[float, ...] = (KINECT_V1,)
    samples: tuple[tuple[float, float], ...] | None = None
    formula: Callable[[Floats], ArrayLike] | None = None
    step: float = 0.0
    disparity_step: float = 0.0
    correlation: tuple[tuple[float, float], ...] = ()
    floor: float = 0.0
    floor_length: float = 60.0
    spread: float = 0.0
    lateral: float = 0.0
    evidence: Any = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        coefficients = tuple(float(c) for c in self.coefficients)
        if not 1 <= len(coefficients) <= 3 or not np.isfinite(coefficients).all():
            raise ValueError(f"expected 1 to 3 finite coefficients, got {self.coefficients!r}")
        if max(coefficients) < 0.0:
            raise ValueError(f"expected a standard deviation that is not negative, got {self.coefficients!r}")
        object.__setattr__(self, "coefficients", coefficients)
        if self.samples is not None:
            samples = np.array(self.samples, np.float64)
            if samples.ndim != 2 or samples.shape[1] != 2 or not np.isfinite(samples).all():
                raise ValueError(f"expected samples as pairs (inverse depth, sigma), got {self.samples!r}")
            if not (np.diff(samples[:, 0]) > 0.0).all() or not (samples[:, 1] > 0.0).all():
                raise ValueError(
                    f"expected samples of growing inverse depth and positive sigma, got {self.samples!r}"
                )
            object.__setattr__(self, "samples", tuple((float(q), float(s)) for q, s in samples))
        for name in ("step", "disparity_step", "floor", "spread", "lateral"):
            value = float(getattr(self, name))
            if not 0.0 <= value < math.inf:
                raise ValueError(f"expected {name} of 0 or more, got {value!r}")
            object.__setattr__(self, name, value)
        correlation = tuple((float(share), float(length)) for share, length in self.correlation)
        shares = [share for share, _ in correlation]
        if any(share < 0.0 for share in shares) or sum(shares) > 1.0 + 1e-9:
            raise ValueError(f"expected shares of correlation that add up to at most 1, got {shares}")
        if any(not 0.0 < length < math.inf for length in [self.floor_length, *(c[1] for c in correlation)]):
            raise ValueError(
                "expected positive correlation lengths in pixels, got "
                f"{correlation!r} and {self.floor_length!r}"
            )
        object.__setattr__(self, "correlation", correlation)

    def sigma(self, inverse_depth: ArrayLike) -> Floats:
        """Standard deviation of one pixel's inverse depth, quantisation included, in 1/m.

        Parameters
        ----------
        inverse_depth : array_like
            1/m.
        """
        q = np.asarray(inverse_depth, np.float64)
        return np.asarray(np.sqrt(self._along(q) ** 2 + self._rounding(q)))

    def _along(self, q: Floats) -> Floats:
        """Standard deviation of q before rounding."""
        if self.formula is not None:
            sigma = np.broadcast_to(np.asarray(self.formula(q), np.float64), q.shape)
        elif self.samples is not None:
            sigma = np.interp(q, *np.array(self.samples).T)
        else:
            c0, c1, c2 = (*self.coefficients, 0.0, 0.0)[:3]
            sigma = (c2 * q + c1) * q + c0 if len(self.coefficients) > 1 else np.full(q.shape, c0)
        return np.asarray(sigma)

    def _rounding(self, q: Floats) -> Floats:
        """Variance of q from rounding, which is independent from pixel to pixel."""
        return np.asarray(((self.step * q * q) ** 2 + self.disparity_step**2) / 12.0)

    def sigma_depth(self, depth: ArrayLike) -> Floats:
        """Standard deviation of one pixel's depth in metres at depths in metres: σZ = σq·Z²."""
        z = np.asarray(depth, np.float64)
        return np.asarray(self.sigma(1.0 / z) * z * z)

    @functools.cached_property
    def _variances(self) -> Floats:
        """σq² before rounding as `kernels.statistics.pixel_variance` takes it."""
        if self.formula is None and self.samples is None and len(self.coefficients) == 1:
            return np.array([1.0, self.coefficients[0] ** 2])
        scale = _ENTRIES / math.sqrt(_LARGEST)
        roots = np.maximum(np.arange(_ENTRIES + 1), 0.5) / scale  # no function need be defined at 0
        return np.concatenate([[scale], self._along(roots**2) ** 2])

    @property
    def is_independent(self) -> bool:
        """Whether pixels err independently of each other, all of them alike."""
        return not (any(share for share, _ in self.correlation) or self.floor or self.spread)

    def sample_share(self, count: ArrayLike) -> Floats:
        """Effective number of independent pixels, as a share of ``count`` neighbouring ones.

        The variance of the mean of ``count`` pixels is σq² / (count · sample_share).
        """
        return np.asarray(1.0 / self.statistics(count).offset)

    def statistics(self, count: ArrayLike) -> "ResidualStatistics":
        """What this noise does to a plane fitted to so many neighbouring pixels.

        Parameters
        ----------
        count : array_like of int
            Numbers of valid pixels. Correlated noise is worked out for full squares of as many pixels.
        """
        n = np.asarray(count, np.float64)
        if self.is_independent:
            freedom = np.maximum(n - 3.0, 0.0)
            one = np.ones(n.shape)
            return ResidualStatistics(freedom, np.maximum(freedom, 1e-3), one, one)
        side = np.sqrt(np.maximum(n, 4.0))
        largest = int(2 ** np.ceil(np.log2(max(float(side.max(initial=4.0)), 8.0))))
        sides, *curves = _square_statistics(self._components, largest)
        expected, log_freedom, tilt, offset = (
            np.interp(np.log(side), np.log(sides), curve) for curve in curves
        )
        more = n > 3.0
        # Where the variance itself varies, that of the sum of squares grows by (spread · expected)².
        freedom = 1.0 / (np.exp(-log_freedom) + 0.5 * self.spread**2)
        return ResidualStatistics(
            np.where(more, n * expected, 0.0), np.where(more, freedom, 1e-3), tilt, offset, self.spread
        )

    @property
    def _components(self) -> tuple[tuple[float, float], ...]:
        """(variance, length) of each part of the error in units of σq²; length 0 is independent."""
        white = max(1.0 - sum(share for share, _ in self.correlation), 0.0)
        parts = ((white, 0.0), *self.correlation, (self.floor**2, self.floor_length))
        return tuple(part for part in parts if part[0] > 0.0)

    def to_dict(self) -> dict[str, Any]:
        """The model as a dict that JSON takes.

        Raises
        ------
        ValueError
            It is a user's function.
        """
        if self.formula is not None:
            raise ValueError("expected a noise model of numbers, got one of a function: make a table of it")
        return {
            f.name: getattr(self, f.name)
            for f in fields(self)
            if f.name not in ("formula", "evidence") and getattr(self, f.name) != f.default
        } | {"coefficients": self.coefficients}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Make a model from what `to_dict` returned."""
        known = {f.name for f in fields(cls)} - {"formula", "evidence"}
        if not isinstance(values, Mapping) or not set(values) <= known:
            raise ValueError(
                f"expected a noise model with the keys {', '.join(sorted(known))}, got {values!r}"
            )
        made = dict(values)
        for name in ("correlation", "samples"):
            if made.get(name) is not None:
                made[name] = tuple(tuple(pair) for pair in made[name])
        return cls(**made)


@dataclass(frozen=True)
class ResidualStatistics:
    """What noise does to plane fits, by number of pixels; for independent pixels N - 3, N - 3, 1 and 1.

    Attributes
    ----------
    expected : float64
        Expected sum of squared residuals in units of σq².
    freedom : float64
        The sum of squared residuals is distributed as expected · χ²(freedom) / freedom, by its first two
        moments (Satterthwaite 1946).
    tilt, offset : float64
        Factors on the variances of the slopes and of the mean inverse depth, over those of independent
        pixels.
    """

    expected: Floats
    freedom: Floats
    tilt: Floats
    offset: Floats
    spread: float = 0.0

    def with_independent(
        self, along: Floats, independent: Floats, count: NDArray[Any]
    ) -> tuple[Floats, Floats]:
        """Expected sum of squared residuals and degrees of freedom, with an independent part of the variance.

        ``along`` is this model's σq², ``independent`` the other; ``count`` the pixels, three or more.
        """
        number = np.maximum(count - 3.0, 1e-9)
        expected = along * self.expected + independent * number
        # Half the variance of a quadratic form is tr((PC)²), C = C₁ + independent·I.
        inverse = np.maximum(1.0 / self.freedom - 0.5 * self.spread**2, 0.0)
        half = (along * self.expected) ** 2 * inverse
        half = half + independent * (2.0 * along * self.expected + independent * number)
        return expected, 1.0 / (half / expected**2 + 0.5 * self.spread**2)


@functools.lru_cache(maxsize=64)
def _square_statistics(
    components: tuple[tuple[float, float], ...], largest: int
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Sides of squares, and the four statistics for each: expected per pixel, log freedom, tilt, offset.

    The covariance of the pixels is C = Σ w T⊗T with T the Toeplitz matrix of exp(-h²/(2 length²)). The fit
    removes the constant and the two slopes, H = Σ φφᵀ with φ = p0⊗p0, p1⊗p0, p0⊗p1 for the unit constant p0
    and the unit slope p1. So tr((I - H)C) and tr(((I - H)C)²) are products of one-dimensional sums.
    """
    sides = np.unique(np.round(np.geomspace(2, largest, 8 * int(np.log2(largest)))).astype(int))
    rows = []
    for n in sides:
        lags = np.arange(n)
        weights = np.where(lags == 0, n, 2.0 * (n - lags))  # how often a lag occurs in a T
        p0 = np.full(n, n**-0.5)
        p1 = lags - 0.5 * (n - 1)
        p1 = p1 / np.linalg.norm(p1)
        shares, correlations, smooth0, smooth1 = [], [], [], []
        for share, length in components:
            rho = np.exp(-0.5 * (lags / length) ** 2) if length else (lags == 0).astype(float)
            both_sides = np.concatenate([rho[:0:-1], rho])
            shares.append(share)
            correlations.append(rho)
            smooth0.append(np.convolve(both_sides, p0, "valid") if n > 1 else p0)
            smooth1.append(np.convolve(both_sides, p1, "valid") if n > 1 else p1)
        w = np.array(shares)
        rho, t0, t1 = np.array(correlations), np.array(smooth0), np.array(smooth1)
        t00, t11 = t0 @ p0, t1 @ p1
        offset, tilt = w @ t00**2, w @ (t11 * t00)
        expected = n * n * w.sum() - offset - 2.0 * tilt
        s00, s11 = t0 @ t0.T, t1 @ t1.T
        squares = ((rho * weights) @ rho.T) ** 2 - 2.0 * (s00**2 + 2.0 * s00 * s11)
        half_variance = w @ squares @ w + offset**2 + 2.0 * tilt**2
        freedom = expected**2 / half_variance
        rows.append((expected / n**2, np.log(max(freedom, 1e-3)), tilt, offset))
    expected_per_pixel, log_freedom, tilts, offsets = np.array(rows).T
    return sides.astype(np.float64), expected_per_pixel, log_freedom, tilts, offsets


def kinect_v1() -> NoiseModel:
    """Kinect v1, independent pixels: σZ = 1.425e-3·Z², constant in 1/Z.

    Source: Khoshelham and Oude Elberink, "Accuracy and resolution of Kinect depth data for indoor mapping
    applications", Sensors 12, 2012, as in the paper's eq. noise_models. Real frames are correlated: for
    them, `rgbd_planes.estimate_noise`.
    """
    return NoiseModel()


def kinect_v1_nguyen() -> NoiseModel:
    """Kinect v1 as measured by Nguyen et al.: σZ = 0.0012 + 0.0019·(Z - 0.4)² metres up to 60° incidence.

    Source: Nguyen, Izadi and Lovell, "Modeling Kinect sensor noise for improved 3D reconstruction and
    tracking", 3DIMPVT 2012.
    """
    return axial(0.0012 + 0.0019 * 0.4**2, -2.0 * 0.0019 * 0.4, 0.0019)


def stereo(baseline: float, focal_length: float, disparity_noise: float = 0.1) -> NoiseModel:
    """Stereo, active stereo and structured light: σq = disparity_noise / (focal_length · baseline).

    Parameters
    ----------
    baseline : float
        Metres.
    focal_length : float
        Pixels.
    disparity_noise : float
        Standard deviation of the disparity in pixels.
    """
    for name, value in (
        ("baseline", baseline), ("focal_length", focal_length), ("disparity_noise", disparity_noise)
    ):  # fmt: skip
        if not 0.0 < value < math.inf:
            raise ValueError(f"expected a positive {name}, got {value!r}")
    return NoiseModel((disparity_noise / (focal_length * baseline),))


def axial(constant: float = 0.0, linear: float = 0.0, quadratic: float = 0.0) -> NoiseModel:
    """Noise published as that of the depth: σZ = constant + linear·Z + quadratic·Z², metres.

    In 1/Z it is σq = constant·q² + linear·q + quadratic.
    """
    if not (constant or linear or quadratic):
        raise ValueError("expected at least one coefficient of the noise that is not 0, got none")
    return NoiseModel((quadratic, linear, constant))


def time_of_flight(constant: float = 0.0, linear: float = 0.0) -> NoiseModel:
    """Time of flight: σZ = constant + linear·Z, metres.

    The light that comes back falls with Z², so that shot noise grows with Z.

    Parameters
    ----------
    constant : float
        Metres.
    linear : float
        Metres per metre.
    """
    return axial(constant, linear)


def table(inverse_depth: ArrayLike, sigma: ArrayLike) -> NoiseModel:
    """Noise measured at some inverse depths: linear between them, constant beyond.

    Parameters
    ----------
    inverse_depth, sigma : (K,) array_like
        1/m, the inverse depths growing.
    """
    q, s = np.atleast_1d(inverse_depth), np.atleast_1d(sigma)
    if q.shape != s.shape or q.ndim != 1:
        raise ValueError(f"expected inverse_depth and sigma of one length, got {q.shape} and {s.shape}")
    return NoiseModel(samples=tuple((float(a), float(b)) for a, b in zip(q, s, strict=True)))


def function(sigma: Callable[[Floats], ArrayLike]) -> NoiseModel:
    """Noise by a function of your own: σq of an array of inverse depths, 1/m. It cannot be saved."""
    if not callable(sigma):
        raise TypeError(f"expected a function of the inverse depth, got {type(sigma).__name__}")
    return NoiseModel(formula=sigma)


def quantised(model: NoiseModel, step: "float | Camera") -> NoiseModel:
    """Add the rounding of integer depth to a model.

    Parameters
    ----------
    model : NoiseModel
    step : float or Camera
        Quantum of the depth in metres, or a camera: of its ``depth_scale`` or ``disparity``.

    Notes
    -----
    Rounding by Δ in depth is a variance of Δ²/12, in inverse depth Δ²q⁴/12. Where the noise is much smaller
    than the step, the rounding errors of a surface that faces the camera are all alike, not independent.
    """
    from rgbd_planes.camera import Camera

    if not isinstance(model, NoiseModel):
        raise TypeError(f"expected a NoiseModel, got {type(model).__name__}")
    if not isinstance(step, Camera):
        if not step > 0.0:
            raise ValueError(f"expected a positive step in metres, got {step!r}")
        return replace(model, step=math.hypot(model.step, step))
    if step.disparity is not None:
        return replace(model, disparity_step=math.hypot(model.disparity_step, step.disparity[0]))
    if step.depth_scale is None:
        raise ValueError("expected a camera with depth_scale or disparity, got one with neither")
    return replace(model, step=math.hypot(model.step, 1.0 / step.depth_scale))
