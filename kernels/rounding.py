"""What rounding does to all pixels of a surface alike.

Rounding to steps Δ is an error of variance Δ²/12, and mostly as good as independent from pixel to pixel: other noise,
of a standard deviation σ, or the slope of the surface carries each pixel over several steps. Where neither does, as on
a wall that faces the camera, all pixels are rounded to the same side. By its Fourier series the mean of the rounded
values is off by (-1)^k·(Δ/πk)·exp(-2π²k²σ²/Δ²)·sin(2πkx/Δ), k = 1, 2, ..., at a true value x. Over a surface that spans
s steps that averages as a sinc, and adds to its slope what is left of it about the middle.
"""

import math

from ._jit import kernel

# Of the first term of the series, and of all others, in Δ²: together 1/12 where there is no other noise.
FIRST, OTHERS = 0.5 / math.pi**2, 1.0 / 12.0 - 0.5 / math.pi**2
# From this (2πσ/Δ)² on nothing is left of it.
NOTHING = 12.0
# Steps that a surface may span though its fit, all of one value, shows none.
UNSEEN = 0.5


@kernel(inline=True)
def is_left(step_square, sigma_square):
    """Whether there is anything of it beside other errors; not if they are NaN."""
    return 4.0 * math.pi**2 * sigma_square < NOTHING * step_square


@kernel(inline=True)
def on_mean(steps):
    """Amplitude that is left of a wave in the mean over so many of its lengths.

    No less than its root mean square over similar ones: how many steps there are is not known so well.
    """
    x = math.pi * max(steps, UNSEEN)
    return max(abs(math.sin(x)), math.sqrt(0.5)) / x if steps > UNSEEN else 1.0


@kernel(inline=True)
def on_slope(steps):
    """The same in the slope, in units of the mean's where errors are independent."""
    x = math.pi * max(steps, UNSEEN)
    return math.sqrt(3.0) * max(abs(math.sin(x) / x - math.cos(x)), math.sqrt(0.5)) / x


@kernel(inline=True)
def in_common(step_square, sigma_square, n, u_spread, v_spread):
    """Variances by rounding that all of a part's n pixels have in common.

    Parameters
    ----------
    step_square : float
        Δ².
    sigma_square : float
        σ², that of the other errors of a pixel.
    n : float
    u_spread, v_spread : float
        Standard deviation of the surface's own values over the part, along its two sides.

    Returns
    -------
    tuple of 3 floats
        What they add to the variance of a pixel, for those of the two slopes and of the mean.
    """
    exponent = 4.0 * math.pi**2 * sigma_square / step_square
    first = math.exp(-exponent) if is_left(step_square, sigma_square) else 0.0
    variance = n * step_square * (FIRST * first + OTHERS * first**4)
    # What lies evenly along a side spans √12 of its standard deviations.
    scale = math.sqrt(12.0 / step_square)
    u_steps, v_steps = scale * u_spread, scale * v_spread
    u_mean, v_mean = on_mean(u_steps), on_mean(v_steps)
    u, v, mean = on_slope(u_steps) * v_mean, on_slope(v_steps) * u_mean, u_mean * v_mean
    return variance * u * u, variance * v * v, variance * mean * mean
