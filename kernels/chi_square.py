"""The upper tail of the chi-square distribution, for blocks of values and any number of degrees of freedom.

With a half of the degrees of freedom, λ the chi-square over them, and η²/2 = λ - 1 - ln λ with the sign of λ - 1, the
tail is that of a normal deviate z = η·√a + C(η, 1/a)/√a: C is smooth and small, since η·√a is the signed root of
the likelihood ratio (Temme, "The asymptotic expansion of the incomplete gamma functions", SIAM J. Math. Anal. 10,
1979; Barndorff-Nielsen, Biometrika 73, 1986). Plain arithmetic without a branch, so that the loops vectorise.
"""

import math

import numpy as np

from ._jit import kernel

# C as powers of t = η/√(η² + 49), one a row, and of s = 1/(a + 1/2): made by ``python -m bench.chi_square``.
CORRECTION = np.array([
    (0.333328586620118, 0.00817935163363206, -0.00104923776527189, 0.00188166711554278, -0.010498859346163, 0.00699072412759042, -0.00279313059209815),
    (-0.194326267147486, 0.0194747904934957, 0.0312727897796943, -0.0118094031374624, 0.0338792496367659, -0.0234971754487391, 0.00597458196219029),
    (-0.0317424008847546, -0.0576502211939423, -0.095894690646799, 0.0955115032352965, -0.0663079853612291, 0.0410346311786728, -0.00959534327160816),
    (0.282946348082298, 0.041288807941378, 0.148443890697786, -0.190767078402619, -0.0688974566220869, 0.126592749685179, -0.0381383541386046),
    (-0.726187100869985, 0.192726041063326, -0.468273419895936, 1.17868355864262, -1.07676104487286, 0.503483359135355, -0.0939150034606596),
    (1.01989770841791, -1.18231273286905, 3.53942983569111, -9.27073770415931, 11.2743398478055, -6.59978474031112, 1.48962931487825),
    (-0.657585975363595, 4.09828601619579, -14.0328670577205, 32.6085715652439, -37.3441878696494, 20.308023732774, -4.29523689288742),
    (-0.86637530690408, -9.25723848617329, 24.9083257669739, -39.3039803003416, 34.6444448658848, -13.9966331495817, 1.97498989070772),
    (2.63730749377698, 11.7911164659397, -12.3536517130164, -38.7212100083362, 80.5109003629866, -56.651575632325, 14.1958610332026),
    (-2.81364860649584, 1.44531203365357, -40.6826562020016, 176.50269392247, -249.134245178177, 148.547854777656, -32.7603284093726),
    (0.53100198904062, -29.0741739877097, 112.985271574623, -252.369875397921, 287.088092161526, -152.264529057982, 30.1784210843484),
    (2.16313707901126, 34.8315649606576, -122.870671488322, 200.82782786325, -178.755046538018, 78.9356447515709, -12.8885324525869),
    (-1.85601816919897, -11.7918103800462, 47.3718824482414, -70.4969390124417, 52.8874194144141, -19.0886568596714, 2.28516403462004),
])  # fmt: skip
POWERS_OF_T = CORRECTION.shape[0]
T_SCALE = 49.0
T_MOST = 0.8912

# The upper tail of the normal distribution is exp(-z²/2)·t·P(t) with t = 2/(2 + z): P, lowest power first,
# interpolates SciPy's erfcx at the Chebyshev points of [0, 1]. Its relative error is below 2e-7.
TAIL_0, TAIL_1, TAIL_2 = 0.1994711528305864, 0.19946815321121372, 0.14970880095785122
TAIL_3, TAIL_4, TAIL_5 = 0.04863429921021592, -0.057593120028867975, -0.09997488775586835
TAIL_6, TAIL_7, TAIL_8 = -0.20365999696080236, 0.7432728996205819, -0.7913807918587487
TAIL_9, TAIL_10 = 0.3871027683456883, -0.0750493065385275

LEAST_FREEDOM = 0.5

# The bits of a double: ln x is taken of its mantissa, between √½ and √2, and of its exponent.
ROOT_HALF = np.int64(0x3FE6A09E667F3BCD)
ONE = np.int64(0x3FF0000000000000)
MANTISSA = np.int64(0x000FFFFFFFFFFFFF)
# With these bits above it, a small whole number is that number plus 2⁵².
WHOLE, WHOLE_BITS = 2.0**52, np.int64(0x4330000000000000)
LN_2 = math.log(2.0)

# Rows of room that `tails` needs, of which the first four hold its arguments and the first its result.
WORK = 7


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

    Where it is above 1e-12, its relative error is below 2e-6 for 2 degrees of freedom or more, 1e-5 for 1 and 1e-4
    for 1/2. NaN stays NaN.

    Parameters
    ----------
    work : (WORK, N) float64
        Rows 1 to 3 are √a, 1/√a and 1/(a + 1/2) of half the degrees of freedom.
    count : int
        Number of values.
    """
    ratio, root, inverse_root, s = work[0], work[1], work[2], work[3]
    t, eta, correction = work[4], work[5], work[6]
    for i in range(count):
        t[i] = min(max(ratio[i], 1e-18), 1e6)
    split(t, eta, count)
    for i in range(count):
        w = (t[i] - 1.0) / (t[i] + 1.0)
        square = w * w
        series = 1.0 / 11.0 + square * (1.0 / 13.0 + square * (1.0 / 15.0 + square * (1.0 / 17.0)))
        series = 1.0 / 3.0 + square * (
            1.0 / 5.0 + square * (1.0 / 7.0 + square * (1.0 / 9.0 + square * series))
        )
        logarithm = eta[i] * LN_2 + 2.0 * w * (1.0 + square * series)
        x = min(max(ratio[i], 1e-18), 1e6)
        squared = 2.0 * max(x - 1.0 - logarithm, 0.0)
        eta[i] = math.copysign(math.sqrt(squared), x - 1.0)
        t[i] = min(max(eta[i] / math.sqrt(squared + T_SCALE), -T_MOST), T_MOST)
        correction[i] = 0.0
    for j in range(POWERS_OF_T - 1, -1, -1):
        c_0, c_1, c_2, c_3 = CORRECTION[j, 0], CORRECTION[j, 1], CORRECTION[j, 2], CORRECTION[j, 3]
        c_4, c_5, c_6 = CORRECTION[j, 4], CORRECTION[j, 5], CORRECTION[j, 6]
        for i in range(count):
            v = s[i]
            of_s = c_0 + v * (c_1 + v * (c_2 + v * (c_3 + v * (c_4 + v * (c_5 + v * c_6)))))
            correction[i] = correction[i] * t[i] + of_s
    for i in range(count):
        z = eta[i] * root[i] + correction[i] * inverse_root[i]
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
