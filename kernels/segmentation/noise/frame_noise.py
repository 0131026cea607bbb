"""Segmentation: the noise of a frame, from what is known about the sensor and what the frame itself shows."""

import math

import numpy as np

from ..._jit.kernel import kernel
from ...common.arrays import copy
from ...common.quantiles import quantile
from ..model.pixel_noise import step_at
from .estimate import estimate_noise, grows_with_depth

# Entries of the table of standard deviations: from an inverse depth of 0 to that of the nearest surface, in equal
# steps. MIDDLE is that of a surface twice as far away as the nearest.
ENTRIES, MIDDLE = 33, 16
# No surface of a room is flatter than this share of its distance, and hardly any sensor is better.
FLATNESS = 4e-4
# A frame whose noise is a larger share of the inverse depth shows no shapes: the residuals are not all noise.
FORMLESS = 0.03
# Share of the tolerance for a sensor's bias, where the errors of neighbouring pixels are independent.
INDEPENDENT = 1.0 / 3.0
# How many times the given noise a frame's may be. For other sensors' frames a Kinect's is up to 2.5 times too low.
UNLIKE = 4.0


@kernel()
def tolerance(together, sigma, flattest):
    """Share of the usual tolerance that a frame needs.

    A sensor whose neighbouring pixels share their errors also has errors that reach farther and bend whole planes, up
    to a bias, which the residuals of small squares do not show. Independent errors come without these. And a surface
    may be as bent as it may be rough, whatever sensor measures it.

    Parameters
    ----------
    together : float
        Pixels that have one error between them, as squares of 32 pixels show it: one, up to two or more. 0 if unknown.
    sigma, flattest : float
        Noise of a surface twice as far away as the nearest, and the least that is assumed of surfaces, 1/m.
    """
    shared = min(max(together, 1.0) - 1.0, 1.0) if together > 0.0 else 1.0
    share = INDEPENDENT + (1.0 - INDEPENDENT) * shared
    return max(share * sigma, flattest) / max(sigma, flattest)


@kernel()
def find_noise(pyramid, nearest, given, is_sensors, step, scale, is_disparity, reach, growth, sigma):
    """Noise of a frame, and what is to be tolerated beside it.

    Parameters
    ----------
    pyramid : Pyramid
    nearest : float
        The largest inverse depth of a surface, 1/m.
    given : (ENTRIES,) float64
        Standard deviations that are known; empty if none are.
    is_sensors : bool
        Some are, and they are a sensor's: of errors that neighbours share, which may be part of it, the frame shows
        less.
    step, scale, is_disparity
        Step between raw values, and how these are read.
    reach : (2·SIZES + 1, K) float64
        Of K kinds of errors of different reach, `correlation.mixture`.
    growth : (3,) float64, written
        Residual of squares of 8, 16 and 32 pixels as a multiple of the first.
    sigma : (ENTRIES + 1,) float64, written
        A step, and standard deviations of inverse depths 0, step, 2 step, ...

    Returns
    -------
    lateral, together : float
        Standard deviation, in pixels, of where a measurement lies; and pixels that have one error between them, 1 or
        more.
    share : float
        Of the usual tolerance, which the frame needs.
    typical_sigma : float
        The median of the standard deviations.
    is_exact : bool
        Whether the noise is no larger than the deviations of surfaces from planes, as in most renderings.
    is_rougher : bool
        Whether the frame is far rougher than the noise that is given, even where it is flattest.
    """
    interval = nearest / (ENTRIES - 1)
    sigma[0] = interval
    is_given = len(given) > 0
    known, shape = 0, np.ones(ENTRIES)  # of the noise, by inverse depth
    if is_sensors:
        copy(given, shape)
        known = len(sigma)
    elif not is_given and grows_with_depth(pyramid):
        for i in range(ENTRIES):
            shape[i] = (max(i, 1) / MIDDLE) ** 2
        known = len(sigma)
    copy(shape, sigma[1:])
    typical, lateral, by_32, together = estimate_noise(pyramid, sigma[:known], growth, reach)
    deviation, expected = math.sqrt(typical), 0.0
    shown = deviation * shape[MIDDLE]
    if is_sensors:  # what squares show is a multiple of it
        expected = 1.0
    elif is_given:
        expected = given[MIDDLE]
    shown_or_given = 0.0
    for i in range(ENTRIES):
        q = i * interval
        rounding = step_at(q, step, scale, is_disparity) / math.sqrt(12.0)
        if not is_given:
            # Between the first two entries it must not fall to zero: far surfaces may lie there.
            value = max(min(deviation * shape[i], FORMLESS * max(q, interval)), rounding)
        elif is_sensors and typical > 0.0:
            # An error that neighbours share is not seen within a square: it shows as growth.
            value = min(max(deviation * shape[i], rounding), given[i])
        else:
            value = given[i]
        if i == MIDDLE:
            shown_or_given = value
        sigma[i + 1] = max(value, FLATNESS * q)
    middle_q, middle = MIDDLE * interval, sigma[1 + MIDDLE]
    # Only the noise that the frame shows has the correlation that it shows, not what is assumed beyond it.
    together = 1.0 + (max(together, 1.0) - 1.0) * min(shown / middle, 1.0) ** 2
    # Edges pass for waves where most squares have one, and with waves of any height all things would be planes.
    for i in range(len(growth)):
        growth[i] = min(growth[i], max(FORMLESS * middle_q / middle, 1.0))
    share = tolerance(by_32, shown_or_given, FLATNESS * middle_q)
    values = np.empty(ENTRIES)
    copy(sigma[1:], values)
    is_exact, is_rougher = sigma[ENTRIES] <= FLATNESS * nearest, 0.0 < UNLIKE * expected < deviation
    return lateral, together, share, quantile(values, 0.5), is_exact, is_rougher
