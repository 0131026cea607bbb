"""The upper tail of the chi-square distribution, for blocks of values and any number of degrees of freedom.

With a half of the degrees of freedom, λ the chi-square over them, and η²/2 = λ - 1 - ln λ with the sign of λ - 1, the
tail is that of a normal deviate z = η·√a + C(η, 1/a)/√a: C is smooth and small, since η·√a is the signed root of
the likelihood ratio (Temme, "The asymptotic expansion of the incomplete gamma functions", SIAM J. Math. Anal. 10,
1979; Barndorff-Nielsen, Biometrika 73, 1986). Plain arithmetic without a branch, so that the loops vectorise.
"""

import math

import numpy as np

from ._jit import kernel

# C as powers of η, one a row, and of s = 1/(a + 1/2), for η in this range: made by ``python -m bench.chi_square``.
ETA_LEAST, ETA_MOST = -8.9, 9.9
CORRECTION = np.array([
    (0.333314334749158, 0.00827458352106109, -0.000965125051555779, -0.000170605445543377, -0.00429880595538356),
    (-0.0277249605010001, 0.00259394478719029, 0.00452465519158861, 0.000192523933189045, 0.000774858809031588),
    (-0.000650761071600231, -0.00117892823940633, -0.00176432629991915, 0.000579152799016436, 0.000307183181949942),
    (0.00105527543890171, 0.000401306608854798, -0.00047341495089071, 0.000399069656722134, -0.000383547667805043),
    (-0.000241212399492736, -0.00020313988467001, 0.000895095914006442, -0.000827542964557735, 0.00029749637000235),
    (1.82017344452775e-05, 6.18790259595932e-05, -0.000373980113704607, 0.00042357938687869, -0.000146365102074835),
    (3.83642895181615e-06, -6.69987147144324e-06, 5.54167049968168e-05, -7.99102632949736e-05, 3.13436194570008e-05),
    (-1.07905559984741e-06, -9.35854856569789e-09, 1.77316774020736e-07, 2.21837992518354e-06, -1.48264139274858e-06),
    (5.47969478354682e-08, 5.16124503104908e-08, -7.58987391939237e-07, 9.73410002467069e-07, -3.4801183679212e-07),
    (9.5549798510696e-09, -1.34320276735221e-08, 6.93516987350471e-08, -1.08956667357613e-07, 4.67955876314162e-08),
    (-8.46288381263558e-10, 9.56395387714305e-10, -1.80298038434626e-09, 3.11695092456817e-09, -1.52965811355053e-09),
])  # fmt: skip

# The upper tail of the normal distribution is exp(-z²/2)·t·P(t) with t = 2/(2 + z): P, lowest power first,
# interpolates SciPy's erfcx at the Chebyshev points of [0, 1]. Its relative error is below 2e-7.
TAIL_0, TAIL_1, TAIL_2 = 0.1994711528305864, 0.19946815321121372, 0.14970880095785122
TAIL_3, TAIL_4, TAIL_5 = 0.04863429921021592, -0.057593120028867975, -0.09997488775586835
TAIL_6, TAIL_7, TAIL_8 = -0.20365999696080236, 0.7432728996205819, -0.7913807918587487
TAIL_9, TAIL_10 = 0.3871027683456883, -0.0750493065385275

LEAST_FREEDOM = 1.0

# The bits of a double: ln x is taken of its mantissa, between √½ and √2, and of its exponent.
ROOT_HALF = np.int64(0x3FE6A09E667F3BCD)
ONE = np.int64(0x3FF0000000000000)
MANTISSA = np.int64(0x000FFFFFFFFFFFFF)
# With these bits above it, a small whole number is that number plus 2⁵².
WHOLE, WHOLE_BITS = 2.0**52, np.int64(0x4330000000000000)
LN_2 = math.log(2.0)

# Rows of room that `tails` needs, of which the first two hold its arguments and the first its result.
WORK = 5


@kernel(inline=True)
def split(x, exponent, count):
    """Turn x into its mantissa between √½ and √2, and write its exponent: x = mantissa·2^exponent."""
    bits, exponent_bits = x.view(np.int64), exponent.view(np.int64)
    for i in range(count):
        shifted = bits[i] + (ONE - ROOT_HALF)
        exponent_bits[i] = (shifted >> 52) | WHOLE_BITS
        bits[i] = (shifted & MANTISSA) + ROOT_HALF
    for i in range(count):
        exponent[i] -= WHOLE + 1023.0


@kernel(reduction=True, inline=True)
def tails(work, count):
    """Probabilities that chi-square over its degrees of freedom exceeds ``work[0]``, written there.

    Where it is above 1e-12, its relative error is below 3e-6 for 10 degrees of freedom or more, 7e-6 for 4, 5e-5 for 2
    and 4e-4 for 1. NaN stays NaN.

    Parameters
    ----------
    work : (WORK, N) float64
        Its second row is 1 over the degrees of freedom, at least `LEAST_FREEDOM`.
    count : int
        Number of values.
    """
    ratio, s, mantissa, eta, correction = work[0], work[1], work[2], work[3], work[4]
    for i in range(count):
        mantissa[i] = min(max(ratio[i], 1e-18), 1e6)
    split(mantissa, eta, count)
    for i in range(count):
        w = (mantissa[i] - 1.0) / (mantissa[i] + 1.0)
        square = w * w
        # ln of the mantissa is 2·artanh w
        series = 1.0 / 9.0 + square * (
            1.0 / 11.0 + square * (1.0 / 13.0 + square * (1.0 / 15.0 + square / 17.0))
        )
        series = square * (1.0 / 3.0 + square * (1.0 / 5.0 + square * (1.0 / 7.0 + square * series)))
        x = min(max(ratio[i], 1e-18), 1e6)
        half_square = x - 1.0 - (eta[i] * LN_2 + 2.0 * w * (1.0 + series))
        eta[i] = math.copysign(math.sqrt(max(2.0 * half_square, 0.0)), x - 1.0)
        # a = 1/(2v), so that 1/(a + 1/2) = 2v/(1 + v); a itself takes the place of the mantissa.
        mantissa[i] = 0.5 / s[i]
        s[i] = 2.0 * s[i] / (1.0 + s[i])
        correction[i] = 0.0
    for j in range(CORRECTION.shape[0] - 1, -1, -1):
        c_0, c_1, c_2, c_3, c_4 = CORRECTION[j]
        for i in range(count):
            of_s = c_0 + s[i] * (c_1 + s[i] * (c_2 + s[i] * (c_3 + s[i] * c_4)))
            correction[i] = correction[i] * min(max(eta[i], ETA_LEAST), ETA_MOST) + of_s
    for i in range(count):
        root = math.sqrt(mantissa[i])
        z = eta[i] * root + correction[i] / root
        size = min(abs(z), 37.0)
        # exp(-z²/2): the exponential series of a 1024th of the exponent, squared ten times.
        e = -size * size * (0.5 / 1024.0)
        e = 1.0 + e * (
            1.0 + e * (1.0 / 2.0 + e * (1.0 / 6.0 + e * (1.0 / 24.0 + e * (1.0 / 120.0 + e * (1.0 / 720.0)))))
        )
        e = e * e
        e = e * e
        e = e * e
        e = e * e
        e = e * e
        e = e * e
        e = e * e
        e = e * e
        e = e * e
        e = e * e
        x = 2.0 / (2.0 + size)
        p = TAIL_6 + x * (TAIL_7 + x * (TAIL_8 + x * (TAIL_9 + x * TAIL_10)))
        p = TAIL_0 + x * (TAIL_1 + x * (TAIL_2 + x * (TAIL_3 + x * (TAIL_4 + x * (TAIL_5 + x * p)))))
        tail = x * e * p
        ratio[i] = (tail if z > 0.0 else 1.0 - tail) + 0.0 * ratio[i]
