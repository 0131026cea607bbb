"""What errors that neighbours share do to the planes of parts of any shape."""

import numpy as np

from rgbd_planes._core.arrays import Floats
from rgbd_planes.camera.camera import Camera
from rgbd_planes.kernels.statistics.pixel_runs import PixelRuns
from rgbd_planes.kernels.statistics.tiles.block import COLUMNS
from rgbd_planes.noise.model import NoiseModel
from rgbd_planes.uncertainty.statistics import settings_of


def shares_errors(noise: NoiseModel | None) -> bool:
    """Whether a noise model has errors that neighbours share."""
    return noise is not None and any(length for _, length in noise._components)


def covariances_by_shape(
    runs: PixelRuns, camera: Camera, counts: Floats, rays: Floats, alpha: Floats, with_freedom: bool = True
) -> Floats:
    """(N, COLUMNS) float64: covariances of the planes of N parts by the camera's errors along the ray.

    The columns are those of `kernels.statistics.tiles.block`, from SLOPES on.

    Parameters
    ----------
    runs : PixelRuns
        The parts' pixels.
    camera : Camera
    counts, rays, alpha : (N,), (N, 5) and (N, 3) float64
        Numbers of measured pixels; means, variances and covariance of their rays; planes, NaN where there is none.
    with_freedom : bool
        Whether to write the degrees of freedom, too.
    """
    # Its many kernels take 10 ms to import, of which fits and segments without such errors have no use.
    from rgbd_planes.kernels.statistics.correlated_errors import shared_covariances

    assert camera.noise is not None
    components = np.array(camera.noise._components)
    covariances, parts = np.empty((len(alpha), COLUMNS)), (counts, rays, alpha)
    shared_covariances(runs, camera._rays, parts, settings_of(camera), components, with_freedom, covariances)
    return covariances
