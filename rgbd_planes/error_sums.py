"""Sums of a noise model's variances over the pixels of parts of a frame, which may span many depths."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from rgbd_planes.camera import Camera
from rgbd_planes.depth import DepthFrame
from rgbd_planes.fit_statistics import settings_of
from rgbd_planes.kernels.statistics.label_variances import label_variances
from rgbd_planes.kernels.statistics.pixel_runs import PixelRuns
from rgbd_planes.kernels.statistics.variances import part_variances
from rgbd_planes.noise.falloff import growth_of_pixels
from rgbd_planes.noise.model import NoiseModel
from rgbd_planes.shared_errors import shares_errors

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
        By that noise, over the valid ones: see `kernels.label_variances`. None where all pixels have one variance and
        share no errors.
    shared : (N, COLUMNS) float64
        By that noise: see `shared_errors.covariances_by_shape`.
    runs : PixelRuns, optional
        The valid pixels, if neighbours share errors.
    """

    footprint: npt.NDArray[np.int64]
    noise: NoiseModel | None
    error_sums: Floats | None
    shared: Floats
    runs: PixelRuns | None


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

    @property
    def _shared(self) -> Floats:
        return self._pixels.shared if self._pixels.noise == self.camera.noise else self._pixels.shared[:, :0]

    @property
    def _runs(self) -> PixelRuns | None:
        return self._pixels.runs


def _differs(noise: NoiseModel | None) -> bool:
    """Whether moments do not tell the errors: pixels differ in the variance of q, or share some of their errors."""
    if noise is None:
        return False
    return len(noise._variances) > 2 or noise.step > 0.0 or noise.falloff > 0.0 or shares_errors(noise)


def sums_of_labels(frame: DepthFrame, camera: Camera, labels: npt.NDArray[np.int32], alpha: Floats) -> Floats | None:
    """(K, 8) float64: see `kernels.label_variances`; None where moments tell the errors."""
    if not _differs(camera.noise):
        return None
    sums = np.empty((len(alpha), 8))
    label_variances(*frame.values, *camera._rays, labels, alpha, settings_of(camera), growth_of_pixels(camera), sums)
    return sums


def sums_of_fits(fits: "PlaneFits", alpha: Floats) -> Floats | None:
    """`sums_of_labels` for the parts of one frame: those that were kept, or from each part's moments.

    ``alpha`` (N, 3) are the planes at whose depths the parts' pixels are; where it is NaN, at their mean depth.
    """
    if not _differs(fits.camera.noise):
        return None
    if fits._error_sums is not None:
        return fits._error_sums
    count, rays, q = mean_rays(fits.method, fits._moments.reshape(10, -1), fits._reference.reshape(3, -1))
    alpha = np.where(np.isnan(alpha), np.stack([0.0 * q, 0.0 * q, q], axis=1), alpha)
    means = np.empty((len(alpha), 8))
    part_variances(alpha, rays, settings_of(fits.camera), means)
    means[count == 0.0] = 0.0  # there may be no ray, as at the rim of a fisheye
    return np.asarray(count[:, None] * means)


def mean_rays(method: str, moments: Floats, reference: Floats) -> tuple[Floats, Floats, Floats]:
    """Numbers of pixels; (N, 5) their rays, as `statistics.variances.means_over` takes them; and mean inverse depths.

    From points (X, Y, Z) to first order. ``moments`` are (10, N), and ``reference`` (3, N).
    """
    n = np.maximum(moments[0], 1.0)
    first = moments[1:4] / n
    uu, uv, uw, vv, vw, ww = moments[4:] / n - first[[0, 0, 0, 1, 1, 2]] * first[[0, 1, 2, 1, 2, 2]]
    u, v, w = reference + first
    if not method.startswith("range"):  # as `kernels.statistics.covariances.ray_scatter`
        w = 1.0 / np.where(w > 0.0, w, np.inf)
        u, v = u * w, v * w
        uu = (uu - 2.0 * u * uw + u * u * ww) * w**2
        uv = (uv - u * vw - v * uw + u * v * ww) * w**2
        vv = (vv - 2.0 * v * vw + v * v * ww) * w**2
    return moments[0], np.stack([u, v, uu, uv, vv], axis=1), w
