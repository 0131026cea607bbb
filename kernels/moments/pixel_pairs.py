"""Two pixels of a column at a time: which are valid, and their inverse depths or depths, with one division for both.

``standard`` is None for range space, where a pixel is (tanθx, tanθy, 1/Z), and anything else for the standard form,
where it is the point (X, Y, Z) of the paper's eq. 11. Numba compiles the branch that is asked for.
"""

import numpy as np

from .._jit.kernel import kernel

# Of the type of a comparison: for the literal True Numba would compile once more.
BOTH = np.bool_(True)


@kernel(inline=True)
def clip(value, lowest, highest):
    """The nearest valid raw value, for NaN the lowest: a value is valid exactly if clipping leaves it unchanged."""
    above = value if value > lowest else lowest
    return above if above < highest else highest


@kernel(inline=True)
def inverse_depths(a, b, scale, offset):
    """Inverse depths of two raw values, with one division."""
    if offset is None:
        inverse = scale / (a * b)
        return b * inverse, a * inverse
    return scale * a + offset, scale * b + offset


@kernel(inline=True)
def depths(a, b, scale, offset):
    """Depths of two raw values, with one division at most."""
    if offset is None:
        metres = 1.0 / scale
        return metres * a, metres * b
    qa = scale * a + offset
    qb = scale * b + offset
    inverse = 1.0 / (qa * qb)
    return qb * inverse, qa * inverse


@kernel(inline=True)
def read_pair(pixels, is_pair, limits, scale, offset, standard):
    """Whether each of two raw values is valid, the second only if ``is_pair``, and their (inverse) depths."""
    a, b = pixels
    lowest, highest = limits
    clipped_a, clipped_b = clip(a, lowest, highest), clip(b, lowest, highest)
    valid_a, valid_b = clipped_a == a, (clipped_b == b) & is_pair
    if standard is None:
        wa, wb = inverse_depths(np.float64(clipped_a), np.float64(clipped_b), scale, offset)
    else:
        wa, wb = depths(np.float64(clipped_a), np.float64(clipped_b), scale, offset)
    return valid_a, valid_b, wa, wb


@kernel(inline=True)
def sums_of_pair(valid_a, valid_b, xa, xb, ya, yb, za, zb):
    """Σ1, Σx, Σy, Σz, Σxx, Σxy, Σxz, Σyy, Σyz, Σzz of the valid ones among two points."""
    one_a, one_b = 1.0 if valid_a else 0.0, 1.0 if valid_b else 0.0
    xa, xb = xa if valid_a else 0.0, xb if valid_b else 0.0
    ya, yb = ya if valid_a else 0.0, yb if valid_b else 0.0
    za, zb = za if valid_a else 0.0, zb if valid_b else 0.0
    return (
        one_a + one_b,
        xa + xb,
        ya + yb,
        za + zb,
        xa * xa + xb * xb,
        xa * ya + xb * yb,
        xa * za + xb * zb,
        ya * ya + yb * yb,
        ya * za + yb * zb,
        za * za + zb * zb,
    )


@kernel(reduction=True, inline=True)
def pair_of_rays(pixels, is_pair, limits, scale, offset, standard, rays, reference):
    """The ten sums of the valid ones among two pixels of a column, or of the first alone.

    ``rays`` are tanθx of the two and tanθy of the two; the sums are relative to ``reference``.
    """
    valid_a, valid_b, wa, wb = read_pair(pixels, is_pair, limits, scale, offset, standard)
    ua, ub, va, vb = rays
    u0, v0, w0 = reference
    if standard is None:
        return sums_of_pair(valid_a, valid_b, ua - u0, ub - u0, va - v0, vb - v0, wa - w0, wb - w0)
    return sums_of_pair(valid_a, valid_b, wa * ua - u0, wb * ub - u0, wa * va - v0, wb * vb - v0, wa - w0, wb - w0)
