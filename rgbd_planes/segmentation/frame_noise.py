"""The noise of a depth frame, as a segmentation needs it."""

import functools
import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.status import Reason
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.depth_frame import DepthFrame
from rgbd_planes.kernels.segmentation.model.records import BLOCK, Found, Labels, Modelled, Noise, Pyramid, Rays
from rgbd_planes.kernels.segmentation.noise.correlation import SIZES, SMALLEST
from rgbd_planes.kernels.segmentation.noise.frame_noise import ENTRIES, FLATNESS, MIDDLE, find_noise
from rgbd_planes.kernels.segmentation.refit.interior import runs_inside
from rgbd_planes.kernels.statistics.tiles.block import COLUMNS, EXPECTED
from rgbd_planes.noise.model import SMALLEST_INVERSE_DEPTH, NoiseModel
from rgbd_planes.noise.sigma import LARGEST_NOISE, check_noise, warn_of_large_noise
from rgbd_planes.uncertainty.correlated_errors import covariances_by_shape
from rgbd_planes.uncertainty.pixel_errors import mean_rays
from rgbd_planes.uncertainty.pixel_runs import runs_found

_UNKNOWN = np.empty(0)


class Given(NamedTuple):
    """What the caller says about the noise.

    Attributes
    ----------
    sigma : callable, optional
        The sensor's standard deviation of inverse depth.
    lateral : float
        Standard deviation, in pixels, of where within its pixel a measurement lies; 0 if it is not known.
    is_sensors : bool
        ``sigma`` is a sensor's: some of it may be errors that neighbours share.
    model : NoiseModel, optional
        The same sensor's, if it says how neighbours share errors.
    """

    sigma: Callable[[Floats], Floats] | None = None
    lateral: float = 0.0
    is_sensors: bool = False
    model: NoiseModel | None = None

    def of_planes(self, found: Found, labels: Labels, camera: Camera, together: float) -> Modelled:
        """What a noise model says of the planes that were found, whose pixels are labelled.

        ``together`` is that of `FrameNoise`. A model of independent errors says nothing of a frame whose pixels share
        them: how large the errors are, such a frame tells better.
        """
        moments, alpha, count = found.inside, found.alpha, len(found.moments)
        shared, alone = np.zeros((count, COLUMNS)), np.zeros(count)
        pixels = moments[:, 0]
        if self.model is not None:
            labelled = *labels, np.uint8(Reason.MISSING), found.moments, moments
            runs = runs_found(lambda inside: runs_inside(*labelled, inside), labels.label.size, count)
            counts, rays, q = mean_rays("range_explicit", moments.T.copy(), np.zeros((3, count)))
            shared = covariances_by_shape(runs, camera.with_noise(self.model), counts, rays, alpha, with_freedom=False)
            shared[np.isnan(shared[:, EXPECTED])] = 0.0  # without a plane of these pixels: then the frame tells
            alone = self.model._rounding(q)
            return Modelled(
                shared, alone, alone + shared[:, EXPECTED] / np.maximum(pixels - 3.0, 1.0), self.lateral > 0.0, True
            )
        if self.is_sensors and together == 1.0 and self.sigma is not None:
            alone = self.sigma(moments[:, 3] / pixels) ** 2
            return Modelled(shared, alone, alone, self.lateral > 0.0, True)
        return Modelled(shared, alone, alone, False, False)


class FrameNoise(NamedTuple):
    """What `find_noise` returns."""

    lateral: float
    together: float
    tolerance: float
    typical_sigma: float
    is_exact: bool
    is_rougher: bool


def noise_of(
    frame: DepthFrame, step_of_raw: float, rays: Rays, pyramid: Pyramid, nearest: float, given: Given
) -> tuple[Noise, FrameNoise]:
    """Noise of a frame; what is not given is estimated from it.

    Parameters
    ----------
    frame
    step_of_raw : float
        See `depth_frame.step_of`.
    rays, pyramid
    nearest : float
        Largest inverse depth of a surface of the frame, 1/m.
    given : Given
    """
    nearest = nearest or 1.0
    growth, sigma = np.empty(3), np.empty(ENTRIES + 1)
    told = find_noise(
        pyramid, nearest, _table(given, nearest), given.is_sensors, step_of_raw, frame.scale, frame.is_disparity,
        correlation_table(), growth, sigma,
    )  # fmt: skip
    found = FrameNoise(*told)
    lateral = given.lateral or found.lateral
    noise = Noise(
        sigma=sigma,
        lateral_variance=lateral**2,
        lateral_variance_x=(lateral * rays.pitch_x) ** 2,
        lateral_variance_y=(lateral * rays.pitch_y) ** 2,
        lens=rays.lens,
        growth=growth,
        together=found.together,
    )
    return noise, found


def _table(given: Given, nearest: float) -> Floats:
    """The standard deviations that are given, as `find_noise` takes them."""
    if given.sigma is None:
        return _UNKNOWN
    q = np.linspace(0.0, nearest, ENTRIES)
    flattest = FLATNESS * q
    # No function need know 0.
    q = np.maximum(q, max(0.5 * q[1], min(SMALLEST_INVERSE_DEPTH, nearest) if given.is_sensors else 0.0))
    table = np.clip(check_noise(given.sigma(q.copy()), q, finite=False), flattest, LARGEST_NOISE)
    result = "standard deviations are far too large" if given.is_sensors else "nearly all things are one plane, or none"
    warn_of_large_noise(table[MIDDLE], q[MIDDLE], result)
    return table


_SHORT = 1.7


_LENGTHS = np.concatenate([[_SHORT], np.geomspace(0.7, 24.0, 30)])
"""Lengths in pixels of the correlation exp(-r²/(2·length²)) of errors; the first is `_SHORT`."""


_ALONG = 4  # parts along the side of a square


@functools.cache
def correlation_table() -> Floats:
    """(2·SIZES + 1, K) float64: see `kernels.segmentation.correlation.mixture`."""
    scatter = [row for size in range(SIZES) for row in _scatter(BLOCK << (SMALLEST + size))]
    table = np.stack([*scatter, 2.0 * np.pi * _LENGTHS**2])
    table.flags.writeable = False
    return table


@np.errstate(under="ignore")  # of errors far apart
def _scatter(side: int) -> tuple[Floats, Floats]:
    """(K,) each: scatter of the means of a square's 4 x 4 parts about its plane, and its residual.

    Both over those of independent pixels: tr(ARCRAᵀ) and tr(RC) for the covariance C, the parts A and the projection
    R = I - PPᵀ on residuals. All are products of factors along x and along y: the parts, and in P the plane's mean and
    its two slopes.
    """
    x = np.arange(side) - 0.5 * (side - 1)
    basis = np.zeros((side, _ALONG + 2))
    basis[np.arange(side), np.arange(side) * _ALONG // side] = 1.0
    basis[:, _MEAN], basis[:, _SLOPE] = 1.0, x
    basis /= np.linalg.norm(basis, axis=0)
    covariance = np.exp(-0.5 * ((x[:, None] - x) / _LENGTHS[:, None, None]) ** 2)
    along = basis.T @ covariance @ basis  # (K, 6, 6)
    share = (basis.T @ basis)[:_ALONG]
    plane = ((_MEAN, _MEAN), (_MEAN, _SLOPE), (_SLOPE, _MEAN))  # along y and along x
    parts = along[:, range(_ALONG), range(_ALONG)]
    scatter = np.einsum("ki,kj->k", parts, parts)
    residual = np.full(len(_LENGTHS), float(side * side))
    for a, b in plane:
        in_part = share[:, a], share[:, b]
        scatter -= 2.0 * np.einsum("i,j,ki,kj->k", *in_part, along[:, :_ALONG, a], along[:, :_ALONG, b])
        residual -= along[:, a, a] * along[:, b, b]
    for (a, b), (c, d) in itertools.product(plane, repeat=2):
        overlap = (share[:, a] @ share[:, c]) * (share[:, b] @ share[:, d])
        scatter += overlap * along[:, a, c] * along[:, b, d]
    return scatter / (_ALONG**2 - 3), residual / (side * side - 3)


_MEAN, _SLOPE = _ALONG, _ALONG + 1  # columns after those of the parts
