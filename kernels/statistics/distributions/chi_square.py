"""The upper tail of the chi-square distribution, for blocks of values and any number of degrees of freedom.

With a = half the degrees of freedom, λ = chi-square over the degrees of freedom, and η²/2 = λ - 1 - ln λ with the sign
of λ - 1, the tail is that of a normal deviate z = η·√a + C(η, 1/a)/√a: C is smooth and small, since η·√a is the signed
root of the likelihood ratio (Temme, "The asymptotic expansion of the incomplete gamma functions", SIAM J. Math. Anal.
10, 1979; Barndorff-Nielsen, Biometrika 73, 1986). Plain arithmetic without a branch, so that the loops vectorise.
"""

import math

import numpy as np

from ..._jit.kernel import kernel
from .normal import LN_2, OF_EXPONENT, WHOLE, WHOLE_BITS

# C in powers of η, one per row, and of s = 1/(a + 1/2), for η in this range: made by ``python -m bench.chi_square``.
ETA_LEAST, ETA_MOST = -8.9, 9.9
CORRECTION = np.array([
    (0.333393098820238, 0.0070354301472177, 0.0045077685311466, -0.00938927514763931),
    (-0.0279716613770735, 0.0046406637118724, -0.000619313189987466, 0.00502720744902483),
    (-0.000343553823606533, -0.00309945663793632, 0.0020905546306793, -0.00103299515711966),
    (0.000903058287462143, 0.00105839911843891, -0.00162486719197983, 0.000385754116993469),
    (-0.000220068613464047, -0.000157697161142042, 0.000471051776015664, -0.000159490112091058),
    (2.75431653470581e-05, 2.36895656238374e-07, -4.85293845521442e-05, 2.26939765969434e-05),
    (-1.39698960779751e-06, 1.02078563999427e-06, 1.31815546343229e-06, -9.2518582597256e-07),
])  # fmt: skip

LEAST_FREEDOM = 1.0

# The bits of a double: ln x is computed from its mantissa, between √½ and √2, and its exponent.
ROOT_HALF = np.int64(0x3FE6A09E667F3BCD)
ONE = np.int64(0x3FF0000000000000)
MANTISSA = np.int64(0x000FFFFFFFFFFFFF)
ROOT_2 = math.sqrt(2.0)


@kernel(inline=True)
def split(x, exponent, count):
    """Turn x into its mantissa between √½ and √2, and write its exponent: x = mantissa·2^exponent."""
    bits, exponent_bits = x.view(np.int64), exponent.view(np.int64)
    for i in range(count):
        shifted = bits[i] + (ONE - ROOT_HALF)
        exponent_bits[i] = (shifted >> 52) | WHOLE_BITS
        bits[i] = (shifted & MANTISSA) + ROOT_HALF
    for i in range(count):
        exponent[i] -= WHOLE + OF_EXPONENT


@kernel(reduction=True, inline=True)
def deviates(work, count):
    """Normal deviates exceeded with the probabilities of chi-square over its degrees of freedom at ``work[0]``.

    Where their `normal.tails` are above 1e-12, these have a relative error below 2e-5 for 5 degrees of
    freedom or more, 2e-4 for 2 and 2e-3 for 1.

    Parameters
    ----------
    work : (normal_distribution.WORK, N) float64
        Its second row is 1/√(degrees of freedom), for degrees of freedom of at least `LEAST_FREEDOM`.
    count : int
        Number of values.
    """
    ratio, root, mantissa, exponent, deviate = work[0], work[1], work[2], work[3], work[4]
    for i in range(count):
        mantissa[i] = min(max(ratio[i], 1e-18), 1e6)
    split(mantissa, exponent, count)
    for i in range(count):
        m, v = mantissa[i], root[i] * root[i]
        # One division instead of three.
        inverse = 1.0 / ((m + 1.0) * (1.0 + v) * root[i])
        w = (m - 1.0) * (inverse * (1.0 + v) * root[i])
        square = w * w
        # ln of the mantissa is 2·artanh w. Where values are so far from 1 that the omitted terms matter, no more digits
        # are needed.
        series = square * (1.0 / 3.0 + square * (1.0 / 5.0 + square * (1.0 / 7.0 + square * (1.0 / 9.0))))
        more = min(max(ratio[i], 1e-18), 1e6) - 1.0
        half_square = more - (exponent[i] * LN_2 + 2.0 * w * (1.0 + series))
        eta = math.copysign(math.sqrt(max(2.0 * half_square, 0.0)), more)
        deviate[i] = eta * (inverse * (m + 1.0) * (1.0 + v))
        # In place of mantissa and exponent, η and 1/(a + 1/2) = 2v/(1 + v), with a = 1/(2v).
        mantissa[i] = eta
        exponent[i] = 2.0 * v * (inverse * (m + 1.0) * root[i])
    # In a loop of its own the processor has more of these in flight: in one, all wait for divisions and square roots.
    for i in range(count):
        inside, s = min(max(mantissa[i], ETA_LEAST), ETA_MOST), exponent[i]
        correction = 0.0
        for j in range(CORRECTION.shape[0] - 1, -1, -1):
            s_term = CORRECTION[j, 2] + s * CORRECTION[j, 3]
            correction = correction * inside + (CORRECTION[j, 0] + s * (CORRECTION[j, 1] + s * s_term))
        deviate[i] = deviate[i] * (1.0 / ROOT_2) + correction * root[i] * ROOT_2
