"""How a depth sensor errs: the standard deviation of the inverse depth, and how pixels err together.

Noise lives in q = 1/Z. A disparity sensor's is constant there, σq = σ_disparity / (f·baseline); published
axial noise converts by σq = σZ / Z².

Examples
--------
>>> import rgbd_planes as rp
>>> camera = rp.Camera(640, 480, 525.0, 525.0, 319.5, 239.5, depth_scale=1000.0, noise=rp.noise.kinect_v1())
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.checks import number, real_array
from rgbd_planes._core.user_warnings import warn_caller
from rgbd_planes.noise.model import KINECT_V1 as KINECT_V1
from rgbd_planes.noise.model import NoiseModel as NoiseModel

_LONGEST_BASELINE = 5.0  # metres, of a stereo camera
_SHORTEST_FOCAL_LENGTH = 20.0  # pixels; most likely millimetres
_COARSEST_STEP = 0.1  # metres


@runtime_checkable
class HasUnits(Protocol):
    """A camera, as far as it says what the numbers of its frames mean."""

    @property
    def depth_scale(self) -> float | None: ...
    @property
    def disparity(self) -> tuple[float, float] | None: ...


def kinect_v1() -> NoiseModel:
    """Kinect v1, independent pixels: σZ = 1.425e-3·Z², constant in 1/Z.

    Source: Khoshelham and Oude Elberink, "Accuracy and resolution of Kinect depth data for indoor mapping
    applications", Sensors 12, 2012, as in the paper's eq. 2. Real frames are correlated: for them,
    `rgbd_planes.estimate_noise`.
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

    Raises
    ------
    TypeError, ValueError
        One of them is not a positive number.

    Warns
    -----
    UserWarning
        The baseline is longer, or the focal length shorter, than any sensor's: most likely in other units.
    """
    baseline = _positive("baseline", baseline)
    if baseline > _LONGEST_BASELINE:
        warn_caller(f"the baseline is in metres, but {baseline:g} m is longer than any sensor's: millimetres?")
    focal_length = _positive("focal_length", focal_length)
    if focal_length < _SHORTEST_FOCAL_LENGTH:
        warn_caller(f"the focal length is in pixels, but {focal_length:g} is shorter than any sensor's: millimetres?")
    return NoiseModel((_positive("disparity_noise", disparity_noise) / (focal_length * baseline),))


def _positive(name: str, value: float) -> float:
    """A positive number as a float."""
    positive = number(name, value)
    if not positive > 0.0:
        raise ValueError(f"expected a positive {name}, got {value!r}")
    return positive


def axial(constant: float = 0.0, linear: float = 0.0, quadratic: float = 0.0) -> NoiseModel:
    """Noise published for the depth: σZ = constant + linear·Z + quadratic·Z², metres.

    In 1/Z it is σq = constant·q² + linear·q + quadratic.

    Parameters
    ----------
    constant, linear, quadratic : float
        Metres, metres per metre and metres per square metre.

    Raises
    ------
    TypeError, ValueError
        All are 0, one is not a finite number, or σZ is negative at some depth.
    """
    constant, linear, quadratic = number("constant", constant), number("linear", linear), number("quadratic", quadratic)
    if not (constant or linear or quadratic):
        raise ValueError("expected at least one coefficient of the noise that is not 0, got none")
    return NoiseModel((quadratic, linear, constant))


def time_of_flight(constant: float = 0.0, linear: float = 0.0) -> NoiseModel:
    """Time of flight: σZ = constant + linear·Z, metres.

    The light that comes back falls off with Z², so that shot noise grows with Z.

    Parameters
    ----------
    constant : float
        Metres.
    linear : float
        Metres per metre.

    Raises
    ------
    TypeError, ValueError
        A coefficient is not a finite number, or the noise is 0 everywhere or negative somewhere.
    """
    return axial(constant, linear)


def table(inverse_depth: ArrayLike, sigma: ArrayLike) -> NoiseModel:
    """Noise measured at some inverse depths: linear between them, constant beyond.

    Parameters
    ----------
    inverse_depth, sigma : (K,) array_like
        1/m, the inverse depths increasing, the standard deviations above 0.

    Raises
    ------
    TypeError, ValueError
        Inverse depths do not increase, a standard deviation is not positive, the lengths differ, or something is not a
        number.
    """
    q, s = np.atleast_1d(real_array("inverse_depth", inverse_depth)), np.atleast_1d(real_array("sigma", sigma))
    if q.shape != s.shape or q.ndim != 1:
        raise ValueError(f"expected inverse_depth and sigma of one length, got {q.shape} and {s.shape}")
    return NoiseModel(samples=tuple((float(a), float(b)) for a, b in zip(q, s, strict=True)))


def function(sigma: Callable[[Floats], ArrayLike]) -> NoiseModel:
    """Noise by a function of your own. It cannot be saved.

    Parameters
    ----------
    sigma : callable
        Takes an array of inverse depths above 0, in 1/m, and returns the standard deviation of each, in 1/m. That must
        be finite and not negative everywhere from 1.2e-3 to 20 1/m. It must always return the same: what is made of it
        is kept for cameras with an equal function, as methods of one object are.

    Raises
    ------
    TypeError, ValueError
        It is not a function, or it returns something else.
    """
    if not callable(sigma):
        raise TypeError(f"expected a function of the inverse depth, got {type(sigma).__name__}")
    return NoiseModel(formula=sigma)


def quantised(model: NoiseModel, step: float | HasUnits) -> NoiseModel:
    """Add the rounding of integer depth to a model.

    Parameters
    ----------
    model : NoiseModel
    step : float or Camera
        Quantum of the depth in metres, or a camera, for that of its ``depth_scale`` or ``disparity``.

    Raises
    ------
    TypeError, ValueError
        The model is not a `NoiseModel`, the step is not a positive number, or the camera has neither of the two.

    Warns
    -----
    UserWarning
        The step is larger than any sensor's: most likely in other units, or the ``depth_scale``.

    Notes
    -----
    Rounding by Δ in depth is a variance of Δ²/12, in inverse depth Δ²q⁴/12. Where the other noise is less than half a
    step, the rounding errors of a surface that faces the camera are not independent, but alike. Covariances account for
    that. P-values are then too large, or too small where the surface climbs by a whole step or a half from pixel to
    pixel.
    """
    if not isinstance(model, NoiseModel):
        raise TypeError(f"expected a NoiseModel, got {type(model).__name__}")
    if not isinstance(step, HasUnits):
        if not number("step", step) > 0.0:
            raise ValueError(f"expected a positive step in metres, got {step!r}")
        if step > _COARSEST_STEP:
            warn_caller(
                f"the step is in metres, but {step:g} m is larger than any sensor's: is it in other units, or the "
                "depth_scale, whose step is 1 / depth_scale?"
            )
        return replace(model, step=math.hypot(model.step, step))
    if step.disparity is not None:
        return replace(model, disparity_step=math.hypot(model.disparity_step, step.disparity[0]))
    if step.depth_scale is None:
        raise ValueError("expected a camera with depth_scale or disparity, got one with neither")
    return replace(model, step=math.hypot(model.step, 1.0 / step.depth_scale))
