"""The distribution of a ratio of two variances, Fisher's F: for a residual where noise differs from place to place.

By Paulson's approximation (Annals of Mathematical Statistics 13, 1942): the cube roots of both variances are nearly
normal (Wilson and Hilferty 1931). Its small p-values err to the safe side: for a spread of up to 0.6 those of 0.01 by
up to 8 %, those of 0.001 by up to 35 %. Only with one degree of freedom are those of 0.01 too small, by 3 %, and none
is above 0.95.
"""

import math

import numpy as np

from ..._jit.kernel import kernel
from .normal import WHOLE, WHOLE_BITS

# The upper half of a double's bits, as a number: a third of it, plus this, is nearly that of the cube root.
OF_ROOT = 1023.0 * 2.0**20 * (2.0 / 3.0) - 37000.0


@kernel(reduction=True, inline=True)
def deviates(inverse_freedom, work, count):
    """Write to ``work[4]`` normal deviates exceeded with the probabilities of a residual over its mean at ``work[0]``.

    Parameters
    ----------
    inverse_freedom : float
        One over ν, where the variance of the noise is distributed as (ν - 2) / χ²(ν).
    work : (normal_distribution.WORK, N) float64
        Its second row is one over the degrees of freedom, which are at least 1.
    count : int
        Number of values.
    """
    ratio, per_freedom, cube_root, guess, deviate = work[0], work[1], work[2], work[3], work[4]
    scale, w = 1.0 / (1.0 - 2.0 * inverse_freedom), (2.0 / 9.0) * inverse_freedom
    for i in range(count):
        cube_root[i] = min(max(ratio[i] * scale, 1e-18), 1e18)
    bits, guess_bits = cube_root.view(np.int64), guess.view(np.int64)
    for i in range(count):
        guess_bits[i] = (bits[i] >> 32) | WHOLE_BITS
    for i in range(count):
        guess[i] = np.floor((guess[i] - WHOLE) * (1.0 / 3.0) + OF_ROOT) + WHOLE
    for i in range(count):
        guess_bits[i] = guess_bits[i] << 32
    for i in range(count):
        x, c = cube_root[i], guess[i]
        # Halley's step twice, each of which turns a relative error ε into 2/3·ε³.
        for _ in range(2):
            cube = c * c * c
            c *= (cube + 2.0 * x) / (2.0 * cube + x)
        v = (2.0 / 9.0) * per_freedom[i]
        deviate[i] = ((1.0 - w) * c - (1.0 - v)) / math.sqrt(w * c * c + v)
