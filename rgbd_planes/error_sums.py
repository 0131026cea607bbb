"""Sums of a noise model's variances over the pixels of parts of a frame, which may span many depths."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from rgbd_planes.camera import Camera
from rgbd_planes.depth import DepthFrame
from rgbd_planes.fit_statistics import settings_of
from rgbd_planes.kernels.label_variances import label_variances
from rgbd_planes.noise.falloff import growth_of_pixels
from rgbd_planes.noise.model import NoiseModel
from rgbd_planes.ray_pitch import GAUSS_PLACES, GAUSS_WEIGHTS

if TYPE_CHECKING:
    from rgbd_planes.plane_fits import PlaneFits

Floats = npt.NDArray[np.float64]


class Pixels(NamedTuple):
    """What a fit keeps of the pixels of its N parts.

    Attributes
    ----------
    footprint : (N, 5) int64
        Their number, missing ones included, Σx, Σy, Σx² and Σy².
    noise : NoiseModel, optional
    error_sums : (N, 8) float64, optional
        By that noise, over the valid ones: see `kernels.label_variances`. None where all pixels have one variance.
    """

    footprint: npt.NDArray[np.int64]
    noise: NoiseModel | None
    error_sums: Floats | None


class KeepsPixels:
    """A base beside `PlaneFits`, for fits that keep their parts' pixels: what it asks of them."""

    camera: Camera
    _pixels: Pixels

    @property
    def _footprint(self) -> npt.NDArray[np.int64]:
        return self._pixels.footprint

    @property
    def _error_sums(self) -> Floats | None:
        # Another noise model, given to the fit later, has other sums.
        return self._pixels.error_sums if self._pixels.noise == self.camera.noise else None


def _differs(noise: NoiseModel | None) -> bool:
    """Whether pixels at different depths, or places in the image, have different variances of q."""
    return noise is not None and (len(noise._variances) > 2 or noise.step > 0.0 or noise.falloff > 0.0)


def sums_of_labels(frame: DepthFrame, camera: Camera, labels: npt.NDArray[np.int32], alpha: Floats) -> Floats | None:
    """(K, 8) float64: see `kernels.label_variances`; None where all pixels have one variance."""
    if not _differs(camera.noise):
        return None
    sums = np.empty((len(alpha), 8))
    label_variances(
        frame.raw, frame.lowest, frame.highest, frame.scale, frame.offset, frame.is_disparity, *camera._rays,
        labels, alpha, settings_of(camera), growth_of_pixels(camera), sums,
    )  # fmt: skip
    return sums


def sums_of_fits(fits: "PlaneFits") -> Floats | None:
    """`sums_of_labels` for the parts of one frame, from the mean and spread of their depths if no sums were kept."""
    noise = fits.camera.noise
    if noise is None or not _differs(noise):
        return None
    if fits._error_sums is not None:
        return fits._error_sums
    moments = fits._moments.reshape(10, -1)
    n, w, ww = moments[0], moments[3], moments[9]
    mean = w / np.maximum(n, 1.0)
    std = np.sqrt(np.maximum(ww / np.maximum(n, 1.0) - mean**2, 0.0))
    mean = mean + fits._reference.reshape(3, -1)[2]
    if not fits.method.startswith("range"):
        mean = 1.0 / np.where(mean > 0.0, mean, np.inf)
        std = std * mean**2
    q = np.maximum(mean + GAUSS_PLACES[:, None] * std, 0.0)
    along, rounding = _variance_at(q, noise), noise._rounding(q)
    if noise.falloff:
        along = along * fits._growth
    total = along + rounding
    along, rounding, squares, total = (GAUSS_WEIGHTS @ of for of in (along, rounding, total**2, total))
    return np.stack([n * along, n * rounding, n * squares, *(total * of for of in _ray_sums(fits))], axis=1)


def _variance_at(q: Floats, noise: NoiseModel) -> Floats:
    """Variance of the errors along the ray, as `kernels.label_variances.variance_at` has it."""
    table = noise._variances[1:]  # a function need not be defined at 0
    if len(table) == 1:
        return np.full(q.shape, table[0])
    position = noise._variances[0] * q  # beyond its end the table goes on by its last step
    k = np.minimum(position, len(table) - 2).astype(np.int64)
    return np.asarray(table[k] + (position - k) * (table[k + 1] - table[k]))


def _ray_sums(fits: "PlaneFits") -> list[Floats]:
    """Σu, Σv, Σu², Σuv and Σv² of the rays of each part's pixels; from points (X, Y, Z) to first order."""
    moments, reference = fits._moments.reshape(10, -1), fits._reference.reshape(3, -1)
    n = np.maximum(moments[0], 1.0)
    first = moments[1:4] / n
    uu, uv, uw, vv, vw, ww = moments[4:] / n - first[[0, 0, 0, 1, 1, 2]] * first[[0, 1, 2, 1, 2, 2]]
    u, v, w = reference + first
    if not fits.method.startswith("range"):  # as `kernels.statistics.ray_scatter`
        nearness = 1.0 / np.where(w > 0.0, w, np.inf)
        u, v = u * nearness, v * nearness
        uu = (uu - 2.0 * u * uw + u * u * ww) * nearness**2
        uv = (uv - u * vw - v * uw + u * v * ww) * nearness**2
        vv = (vv - 2.0 * v * vw + v * v * ww) * nearness**2
    return [moments[0] * of for of in (u, v, uu + u * u, uv + u * v, vv + v * v)]
