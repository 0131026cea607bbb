"""The noise of a depth frame, as a segmentation needs it."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rgbd_planes.camera import Camera
from rgbd_planes.checks import check_noise, warn_of_large_noise
from rgbd_planes.depth import DepthFrame
from rgbd_planes.kernels.segment_noise_estimation import estimate_noise, nearest_surface
from rgbd_planes.kernels.segment_records import Noise, Pyramid, Rays
from rgbd_planes.residual_statistics import ResidualStatistics, like_rectangles
from rgbd_planes.segmentation_reach import reach_table

Floats = NDArray[np.float64]

FLATNESS = 4e-4
"""No surface of a room is flatter than this share of its distance, and hardly any sensor is better."""

FORMLESS = 0.03
"""A frame whose noise is a larger share of the inverse depth shows no shapes: the residuals are not all noise."""

INDEPENDENT = 1.0 / 3.0
"""Share of the tolerance for a sensor's bias, where the errors of neighbouring pixels are independent."""

UNLIKE = 4.0
"""How many times the given noise a frame's may be. For other sensors' frames a Kinect's is up to 2.5 times too low."""

_UNKNOWN = np.empty(0)
_SHARES = np.linspace(0.0, 1.0, 33)  # of the largest inverse depth of a surface: the table's entries


class Given(NamedTuple):
    """What the caller says about the noise.

    Attributes
    ----------
    sigma : callable, optional
        The sensor's standard deviation of inverse depth.
    lateral : float
        Standard deviation, in pixels, of where within its pixel a measurement lies; 0 if it is not known.
    at_large : bool
        ``sigma`` is a sensor's: some of it may be errors that neighbours share.
    statistics : callable, optional
        What such errors do to planes, if known: `NoiseModel.statistics`.
    """

    sigma: Callable[[Floats], Floats] | None = None
    lateral: float = 0.0
    at_large: bool = False
    statistics: Callable[[Floats, Floats], ResidualStatistics] | None = None

    def of_planes(self, moments: Floats, camera: Camera) -> Floats:
        """(3, N) float64: least variances of a pixel, for the uncertainty of slopes, along x and y, and of means.

        From the moments of the planes' pixels, (N, 10). 0 where nothing is known about shared errors.
        """
        if self.statistics is None or self.sigma is None:
            return np.zeros((3, len(moments)))
        pixels = moments[:, 0]
        footprint = moments[:, [0, 1, 2, 4, 7]] * [1.0, camera.fx, camera.fy, camera.fx**2, camera.fy**2]
        made = self.statistics(pixels, like_rectangles(footprint))
        factors = np.stack([made.tilt_x, made.tilt_y, made.offset])
        return np.asarray(self.sigma(moments[:, 3] / pixels) ** 2 * factors)


def noise_of(
    frame: DepthFrame, step_of_raw: float, rays: Rays, pyramid: Pyramid, nearest: float, given: Given
) -> tuple[Noise, float, bool]:
    """Noise of a frame, and what is to be tolerated beside it: see `Rules.tolerating`.

    Also whether the frame is far rougher than the given noise, even where it is flattest. Noise that is not given is
    estimated from the frame: see `segment_noise_estimation.estimate_noise`.

    Parameters
    ----------
    frame
    step_of_raw : float
        See `depth.step_of`.
    rays, pyramid
    nearest : float
        Largest inverse depth of the frame, 1/m.
    given : Given
    """
    growth = np.empty(3)
    q = _SHARES * (nearest_surface(pyramid, nearest) or 1.0)
    step = q[1:2]
    middle = len(q) // 2  # of the nearest surface, or of one up to twice as far away
    known, flattest = _UNKNOWN, FLATNESS * q
    if given.sigma is not None:
        table = np.maximum(check_noise(given.sigma(q), q, finite=False), flattest)
        if not np.isfinite(table[0]):
            table[0] = table[1]
        if not given.at_large:
            warn_of_large_noise(table[middle], q[middle], "nearly all things are one plane, or none")
        if given.at_large:
            known = np.concatenate([step, table])
    typical, own_lateral, by_32, together = estimate_noise(pyramid, known, growth, reach_table())
    expected = 0.0 if given.sigma is None else 1.0 if given.at_large else table.max()
    is_rougher = bool(0.0 < UNLIKE * expected < typical**0.5)
    if given.sigma is None:
        # Between the first two entries it must not fall to zero: far surfaces may lie there.
        table = np.maximum(np.minimum(typical**0.5, FORMLESS * np.maximum(q, step)), _rounding(frame, step_of_raw, q))
    elif given.at_large and typical > 0.0:
        # An error that neighbours share is not seen within a square: it shows as growth.
        table = np.minimum(np.maximum(typical**0.5 * table, _rounding(frame, step_of_raw, q)), table)
    sigma = np.maximum(table, flattest)
    # Only the noise that the frame shows has the correlation that it shows, not what is assumed beyond it.
    shown = typical**0.5 * (known[1 + middle] if len(known) else 1.0)
    together = 1.0 + (max(together, 1.0) - 1.0) * min(shown / sigma[middle], 1.0) ** 2
    # Edges pass for waves where most squares have one, and with waves of any height all things would be planes.
    np.minimum(growth, max(FORMLESS * q[middle] / sigma[middle], 1.0), out=growth)
    lateral = given.lateral or own_lateral
    noise = Noise(
        sigma=np.concatenate([step, sigma]),
        lateral_variance=lateral**2,
        lateral_variance_x=(lateral * rays.pitch_x) ** 2,
        lateral_variance_y=(lateral * rays.pitch_y) ** 2,
        lens=rays.lens,
        growth=growth,
        together=together,
    )
    return noise, tolerance(by_32, float(table[middle]), float(flattest[middle])), is_rougher


def tolerance(together: float, sigma: float, flattest: float) -> float:
    """Share of the usual tolerance that a frame needs.

    A sensor whose neighbouring pixels share their errors also has errors that reach farther and bend whole planes, up
    to a bias, which the residuals of small squares do not show. Independent errors come without these. And a surface
    may be as bent as it may be rough, whatever sensor measures it.

    Parameters
    ----------
    together : float
        Pixels that have one error between them, as squares of 32 pixels show it: one, up to two or more. 0 if unknown.
    sigma, flattest : float
        Noise of the nearest surface, and the least that is assumed of surfaces, 1/m.
    """
    shared = min(max(together, 1.0) - 1.0, 1.0) if together > 0.0 else 1.0
    share = INDEPENDENT + (1.0 - INDEPENDENT) * shared
    return max(share * sigma, flattest) / max(sigma, flattest)


def is_exact(noise: Noise) -> bool:
    """Whether the noise is no larger than the deviations of surfaces from planes, as in most renderings."""
    step, largest = noise.sigma[0], noise.sigma[-1]
    return bool(largest <= FLATNESS * step * (len(_SHARES) - 1))


def steps_at(frame: DepthFrame, step_of_raw: float, q: Floats) -> Floats:
    """Steps between neighbouring raw values, as differences of inverse depth; 0 where there are none."""
    step = np.full_like(q, abs(frame.scale)) if frame.is_disparity else q * q / frame.scale
    return np.asarray(step_of_raw * step)


def _rounding(frame: DepthFrame, step_of_raw: float, q: Floats) -> Floats:
    """Standard deviation of inverse depth that rounding to the raw values' steps makes."""
    return np.asarray(steps_at(frame, step_of_raw, q) / 12.0**0.5)
