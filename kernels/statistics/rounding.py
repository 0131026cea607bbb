"""The rounding error that all pixels of a surface have in common.

Rounding to steps Δ is an error of variance Δ²/12, and usually as good as independent from pixel to pixel. For other
noise, of a standard deviation σ, or the slope of the surface carries each pixel over several steps. Where neither does,
as on a wall that faces the camera, all pixels are rounded to the same side. By its Fourier series the mean of the
rounded values is off by (-1)^k·(Δ/πk)·exp(-2π²k²σ²/Δ²)·sin(2πkx/Δ), k = 1, 2, ..., at a true value x. Over a surface
that spans s steps this averages as a sinc, and adds its first moment about the middle to the slope.
"""

import math

from .._jit.kernel import kernel

# Variances of the first term of the series, and of all others, in Δ²: together 1/12 if there is no other noise.
FIRST_TERM, OTHER_TERMS = 0.5 / math.pi**2, 1.0 / 12.0 - 0.5 / math.pi**2
# From this (2πσ/Δ)² on, nothing of it is left.
NOTHING_LEFT = 12.0
# Steps that a surface may span although all its values are equal, so that its fit shows none.
UNSEEN_STEPS = 0.5


@kernel(inline=True)
def is_left(step_square, sigma_square):
    """Whether the common rounding error is worth counting beside the other errors; not if they are NaN."""
    return 4.0 * math.pi**2 * sigma_square < NOTHING_LEFT * step_square


@kernel(inline=True)
def between_codes(step_square, sigma_square, u_steps, v_steps):
    """By how much a pixel's residual variance exceeds σ² + Δ²/12 at most, wherever the codes lie.

    On a surface of hardly a step most where all lie half-way between two codes. A pixel then is (m + 1/2)·Δ off with
    the probability that its error is between m·Δ and (m + 1)·Δ. What ``u_steps`` and ``v_steps``, which the fit spans,
    have of this variance is not in the residual. Over more steps the variance at a true value x has the wave
    -(Δ²/π² + 4σ²)·exp(-2π²σ²/Δ²)·cos(2πx/Δ), of which a number of steps that is not whole leaves a part in the mean.
    """
    root = math.sqrt(0.5 * step_square / sigma_square) if sigma_square > 0.0 else math.inf
    rounded = 0.25 + 2.0 * math.erfc(root) + 4.0 * math.erfc(2.0 * root)
    left = rounded - (1.0 + u_steps * u_steps + v_steps * v_steps) / 12.0
    wave = (step_square / math.pi**2 + 4.0 * sigma_square) * math.exp(-2.0 * math.pi**2 * sigma_square / step_square)
    for steps in (u_steps, v_steps):
        x = math.pi * steps
        wave *= abs(math.sin(x)) / x if x > 1e-3 else 1.0
    return max(left * step_square - sigma_square, wave)


@kernel(inline=True)
def on_mean(steps):
    """Amplitude left of a wave in the mean over ``steps`` wavelengths.

    No less than its root mean square over similar lengths: the number of steps is not known that well.
    """
    x = math.pi * max(steps, UNSEEN_STEPS)
    return max(abs(math.sin(x)), math.sqrt(0.5)) / x if steps > UNSEEN_STEPS else 1.0


@kernel(inline=True)
def on_slope(steps):
    """Amplitude left in the slope, scaled so that independent errors would have the same in slope and mean."""
    x = math.pi * max(steps, UNSEEN_STEPS)
    return math.sqrt(3.0) * max(abs(math.sin(x) / x - math.cos(x)), math.sqrt(0.5)) / x


@kernel(inline=True)
def in_common(step_square, sigma_square, n, u_steps, v_steps):
    """Variances of the rounding error that all n pixels of a part have in common.

    Parameters
    ----------
    step_square : float
        Δ².
    sigma_square : float
        σ², the variance of a pixel's other errors.
    n : float
    u_steps, v_steps : float
        Steps that the surface spans along the two sides of the part.

    Returns
    -------
    tuple of 3 floats
        What they add to the variance of a pixel, in the variances of the two slopes and of the mean.
    """
    exponent = 4.0 * math.pi**2 * sigma_square / step_square
    first = math.exp(-exponent) if is_left(step_square, sigma_square) else 0.0
    variance = n * step_square * (FIRST_TERM * first + OTHER_TERMS * first**4)
    u_mean, v_mean = on_mean(u_steps), on_mean(v_steps)
    u, v, mean = on_slope(u_steps) * v_mean, on_slope(v_steps) * u_mean, u_mean * v_mean
    return variance * u * u, variance * v * v, variance * mean * mean
