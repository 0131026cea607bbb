"""The upper tail of the normal distribution, for blocks of values: plain arithmetic without a branch."""

import math

import numpy as np

from ..._jit.kernel import kernel

# The upper tail of the normal distribution is exp(-z²/2)·t·P(t) with t = 2/(2 + z): P, lowest power first,
# interpolates SciPy's erfcx at the Chebyshev points of [0, 1]. Its relative error is below 2e-6.
TAIL_0, TAIL_1, TAIL_2 = 0.1994715460615227, 0.19940475726989348, 0.15145836597894818
TAIL_3, TAIL_4, TAIL_5 = 0.029282237616144374, 0.05416858389853427, -0.47931690750756856
TAIL_6, TAIL_7, TAIL_8 = 0.5950355620527407, -0.3134674436265108, 0.06396343432391081

# A small integer with these bits above it is, read as a double, that integer plus 2⁵².
WHOLE, WHOLE_BITS = 2.0**52, np.int64(0x4330000000000000)
LN_2 = math.log(2.0)
OF_EXPONENT = 1023.0

# Rows of room that the tails of distributions need: in the end the first is the probability, the last the deviate. At
# first the first holds the value that the deviate stands for: where that is NaN, so is the probability.
WORK = 5


@kernel(reduction=True, inline=True)
def tails(work, count):
    """Probabilities that a normal deviate exceeds ``work[4]``, written to ``work[0]``."""
    probability, power, exponent, deviate = work[0], work[2], work[3], work[4]
    for i in range(count):
        size = min(abs(deviate[i]), 37.0)
        # exp(-z²/2) = 2^(r - k)
        square = size * size * (0.5 / LN_2)
        k = np.floor(square + 0.5)  # not math.floor, which in plain Python refuses NaN
        power[i] = k - square
        exponent[i] = (WHOLE + OF_EXPONENT) - k
    bits = exponent.view(np.int64)
    for i in range(count):
        bits[i] = bits[i] << 52
    for i in range(count):
        r = power[i] * LN_2
        e = 1.0 + r * (
            1.0 + r * (1.0 / 2.0 + r * (1.0 / 6.0 + r * (1.0 / 24.0 + r * (1.0 / 120.0 + r * (1.0 / 720.0)))))
        )
        z = deviate[i]
        x = 2.0 / (2.0 + min(abs(z), 37.0))
        p = TAIL_5 + x * (TAIL_6 + x * (TAIL_7 + x * TAIL_8))
        p = TAIL_0 + x * (TAIL_1 + x * (TAIL_2 + x * (TAIL_3 + x * (TAIL_4 + x * p))))
        tail = x * (e * exponent[i]) * p
        probability[i] = (tail if z > 0.0 else 1.0 - tail) + 0.0 * probability[i]
