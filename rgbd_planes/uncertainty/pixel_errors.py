"""Sums of a noise model's variances over the pixels of parts of a frame, which may span many depths."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Arrays, Floats
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.depth_frame import DepthFrame
from rgbd_planes.camera.pixel_pitch import lateral_of_pixels, slope_square, uneven_lateral
from rgbd_planes.kernels.statistics.label_variances import label_variances
from rgbd_planes.kernels.statistics.noise_variances import part_variances
from rgbd_planes.kernels.statistics.pixel_runs import PixelRuns
from rgbd_planes.noise.model import NoiseModel
from rgbd_planes.uncertainty.correlated_errors import covariances_by_shape, shares_errors
from rgbd_planes.uncertainty.falloff import growth_of_pixels
from rgbd_planes.uncertainty.pixel_runs import runs_of_labels
from rgbd_planes.uncertainty.statistics import settings_of

if TYPE_CHECKING:
    from rgbd_planes.uncertainty.protocols import Fits


class Pixels(NamedTuple):
    """What a fit keeps of the pixels of its N parts.

    Attributes
    ----------
    footprint : (N, 5) int64
        Their number, missing ones included, Σx, Σy, Σx² and Σy².
    noise : NoiseModel, optional
    error_sums : (N, 8) float64, optional
        By that noise, over the valid ones: see `kernels.statistics.label_variances`. None where all pixels have one
        variance and share no errors.
    shared : (N, COLUMNS) float64, optional
        By that noise, if neighbours share errors: see `shared_errors.covariances_by_shape`.
    runs : PixelRuns, optional
        The valid pixels, if neighbours share errors.
    """

    footprint: npt.NDArray[np.int64]
    noise: NoiseModel | None
    error_sums: Floats | None
    shared: Floats | None
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
    def _shared(self) -> Floats | None:
        return self._pixels.shared if self._pixels.noise == self.camera.noise else None

    @property
    def _runs(self) -> PixelRuns | None:
        return self._pixels.runs


def _varies(camera: Camera) -> bool:
    """Whether pixels of one plane at different depths, or places in the image, have different variances of q."""
    noise = camera.noise
    if noise is None:
        return False
    return len(noise._variances) > 2 or noise.step > 0.0 or noise.falloff > 0.0 or uneven_lateral(camera) > 0.0


def pixels_of_labels(
    frame: DepthFrame,
    camera: Camera,
    labels: npt.NDArray[np.int32],
    method: str,
    footprint: npt.NDArray[np.int64],
    arrays: "Arrays",
) -> Pixels:
    """What a fit to labels keeps of their pixels; ``arrays`` are those of `plane_fits.allocate`."""
    noise, alpha = camera.noise, arrays["alpha"]
    runs = shared = sums = None
    if shares_errors(noise):
        runs = runs_of_labels(labels, frame, len(alpha))
        counts, rays, q = mean_rays(method, arrays["_moments"], arrays["_reference"])
        shared = covariances_by_shape(runs, camera, counts, rays, alpha)
        sums = _sums_of_rays(camera, counts, rays, q, alpha)
    if _varies(camera):
        sums = np.empty((len(alpha), 8))
        settings = settings_of(camera), growth_of_pixels(camera), lateral_of_pixels(camera)
        label_variances(frame.values, camera._rays, labels, alpha, *settings, sums)
    return Pixels(footprint, noise, sums, shared, runs)


def sums_of_fits(fits: "Fits", alpha: Floats) -> Floats | None:
    """`kernels.statistics.label_variances` for the parts of one frame: what was kept, or from each part's moments.

    ``alpha`` (N, 3) are the planes at whose depths the parts' pixels are; where it is NaN, at their mean depth. None
    where moments tell the errors: all pixels have one variance, and share none.
    """
    camera = fits.camera
    if not (_varies(camera) or shares_errors(camera.noise)):
        return None
    if fits._error_sums is not None:
        return fits._error_sums
    count, rays, q = mean_rays(fits.method, fits._moments, fits._reference)
    sums = _sums_of_rays(camera, count, rays, q, alpha)
    error = uneven_lateral(camera)
    if error > 0.0:
        lateral = error**2 * np.nan_to_num(slope_square(alpha, camera, fits._footprint))
        u, v, uu, uv, vv = rays.T
        sums[:, 2] += lateral * (2.0 * (sums[:, 0] + sums[:, 1]) + count * lateral)
        sums[:, 1] += count * lateral
        sums[:, 3:] += (count * lateral * np.stack([u, v, uu + u * u, uv + u * v, vv + v * v])).T
    return sums


def _sums_of_rays(camera: Camera, count: Floats, rays: Floats, q: Floats, alpha: Floats) -> Floats:
    """(N, 8) float64: see `sums_of_fits`; the others are from `mean_rays`."""
    alpha = np.where(np.isnan(alpha), np.stack([0.0 * q, 0.0 * q, q], axis=1), alpha)
    means = np.empty((len(alpha), 8))
    part_variances(alpha, rays, settings_of(camera), means)
    means[count == 0.0] = 0.0  # there may be no ray, as at the rim of a fisheye
    return np.asarray(count[:, None] * means)


def mean_rays(method: str, moments: Floats, reference: Floats) -> tuple[Floats, Floats, Floats]:
    """Numbers of pixels; (N, 5) their rays, as `noise_variances.means_over` takes them; and mean inverse depths.

    From points (X, Y, Z) to first order. ``moments`` and ``reference`` are a fit's, of one frame.
    """
    moments, reference = moments.reshape(10, -1), reference.reshape(3, -1)
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
