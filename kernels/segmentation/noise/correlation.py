"""Segmentation: how many pixels have one error between them, as squares of several sizes show.

Where pixels err independently, the mean of n of them has an n-th of their variance; where they go together it has more,
by the factor of how many do. The means of a square's 4 x 4 parts scatter about the square's plane, and so show it.
"""

import math

import numpy as np

from ..._jit.kernel import kernel
from ...common.quantiles import quantile
from ..model.moments import solve
from ..model.pixel_noise import expected_variance
from ..model.records import BLOCK

FULL = 0.5  # share of a square's pixels that must be measured
FEWEST = 10  # squares that are needed to tell something
FLAT = 4.0  # variances that a square with one surface has at most
# The same for one of 64 pixels: a little of another surface looks like errors of a long reach there.
FLAT_LARGE = 2.0
# Levels of the squares: of 16, 32 and 64 pixels. The last are made of four of the pyramid's largest.
SIZES = 3
SMALLEST = 2
# Largest share of its pixels that a small square may show to go together, to say how many do beyond it.
MOST_SHOWN = 0.75
# Variance of the logarithm of one square's ratio, whose median over many is more certain by their number.
OF_ONE = 0.24
# The ratio of errors that are independent: the means of 16 parts hold a plane's slopes but for a sixteenth.
OF_INDEPENDENT = (16.0 - 1.0 - 2.0 * 15.0 / 16.0) / (16.0 - 3.0)
# What the sum of as many squared deviations as there are sizes exceeds by chance in one frame of a hundred: chi-square.
OF_CHANCE = (0.0, 6.63, 9.21, 11.34)


@kernel()
def is_in_one(label, inverse_depth, top, left, side):
    """Whether a square lies in one plane: of 5 x 5 of its pixels, all that are measured have the same label."""
    one, step = 0, side // 4
    for y in range(top, top + side + 1, step):
        row_labels, measured = label[min(y, top + side - 1)], inverse_depth[min(y, top + side - 1)]
        for column in range(left, left + side + 1, step):
            x = min(column, left + side - 1)
            if measured[x] > 0.0:
                one = row_labels[x] if one == 0 else one
                if one == 0 or row_labels[x] != one:
                    return False
    return one > 0


@kernel()
def shown(pyramid, level, sigma, most, step, label, inverse_depth):
    """By what factor the means of squares' parts scatter more than those of independent pixels.

    Returns the median over the flat squares of a ``level``, whose residual is at most ``most`` variances, in every
    ``step``-th row and column of them, and their number; 0 and 0 if they are too few. If there is a ``label``, (H, W)
    int32 with any rows, only squares that lie in one plane count.
    """
    moments, _, _, offsets, shapes = pyramid
    pixels, sum_u, sum_v, sum_q = moments[0], moments[1], moments[2], moments[3]
    fine, quarter = level - 2, level - 1  # levels of a square's parts and quarters
    rows, columns = shapes[quarter, 0] // 2, shapes[quarter, 1] // 2
    side = BLOCK << level
    if len(label) > 0:
        rows, columns = min(rows, label.shape[0] // side), min(columns, label.shape[1] // side)
    least = FULL * side**2
    ratio = np.empty((rows // step + 1) * (columns // step + 1))
    m = np.empty(10)
    count = 0
    for row in range(0, rows, step):
        for column in range(0, columns, step):
            i = offsets[quarter] + 2 * (row * shapes[quarter, 1] + column)
            below = i + shapes[quarter, 1]
            n = pixels[i] + pixels[i + 1] + pixels[below] + pixels[below + 1]
            if n < least or (len(label) > 0 and not is_in_one(label, inverse_depth, row * side, column * side, side)):
                continue
            for k in range(10):
                m[k] = moments[k, i] + moments[k, i + 1] + moments[k, below] + moments[k, below + 1]
            rss, a_u, a_v, a_1 = solve(m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9])
            if rss <= 0.0 or rss > most * (n - 3.0) * expected_variance(m[3] / n, sigma):
                continue
            total = 0.0
            parts = -3.0  # degrees of freedom that the plane takes
            for r in range(4 * row, 4 * row + 4):
                for c in range(4 * column, 4 * column + 4):
                    k = offsets[fine] + r * shapes[fine, 1] + c
                    e = sum_q[k] - (a_u * sum_u[k] + a_v * sum_v[k] + a_1 * pixels[k])
                    total += e * e / max(pixels[k], 1.0)
                    parts += 1.0 if pixels[k] > 0.0 else 0.0
            if parts > 0.0:
                ratio[count] = total / parts * (n - 3.0) / rss
                count += 1
    return (quantile(ratio[:count], 0.5), count) if count >= FEWEST else (0.0, 0)


@kernel()
def beyond(ratio, level):
    """How many pixels go together, if the parts of a level's squares, of n pixels, show ``ratio``, at most n.

    1/shown = 1/n + 1/together, for errors of any reach.
    """
    n = (BLOCK << (level - 2)) ** 2
    return max(ratio / (1.0 - min(ratio / n, MOST_SHOWN)), 1.0)


@kernel()
def mixture(ratios, counts, reach):
    """How many pixels go together, for errors partly independent, partly of a short reach and partly of another.

    Of numbers that fit about equally well the smallest is taken: its logarithm counts like a squared error of one
    deviation.

    Parameters
    ----------
    ratios, counts : (SIZES,) float64 and int64
        From `shown`.
    reach : (2·SIZES + 1, K) float64
        For K kinds of errors of different reach: for each size the scatter of the parts and the residual, those of
        independent pixels being 1; then how many pixels go together. The first is the short one.
    """
    most = np.inf
    together = 1.0
    for k in range(1, reach.shape[1]):
        # With shares a of this reach and b of the short one, each ratio gives an equation, a·x + b·y = z.
        xx = xy = yy = xz = yz = zz = 0.0
        for size in range(SIZES):
            if counts[size] > 0:
                r, weight = ratios[size], counts[size] / OF_ONE
                x = (reach[2 * size, k] - 1.0) / r - (reach[2 * size + 1, k] - 1.0)
                y = (reach[2 * size, 0] - 1.0) / r - (reach[2 * size + 1, 0] - 1.0)
                z = (r - 1.0) / r
                xx += weight * x * x
                xy += weight * x * y
                yy += weight * y * y
                xz += weight * x * z
                yz += weight * y * z
                zz += weight * z * z
        for case in range(4):  # both; either alone; both and nothing independent
            a = b = 0.0
            if case == 0:
                determinant = xx * yy - xy * xy
                if determinant <= 1e-12 * xx * yy:
                    continue
                a, b = (yy * xz - xy * yz) / determinant, (xx * yz - xy * xz) / determinant
            elif case == 1:
                a = min(max(xz / xx, 0.0), 1.0)
            elif case == 2:
                b = min(max(yz / yy, 0.0), 1.0)
            else:
                a = min(max((xz - yz - xy + yy) / max(xx - 2.0 * xy + yy, 1e-300), 0.0), 1.0)
                b = 1.0 - a
            if a < 0.0 or b < 0.0 or a + b > 1.0:
                continue
            error = a * a * xx + 2.0 * a * b * xy + b * b * yy - 2.0 * (a * xz + b * yz) + zz
            found = max(1.0 + a * (reach[2 * SIZES, k] - 1.0) + b * (reach[2 * SIZES, 0] - 1.0), 1.0)
            error += math.log(found)
            if error < most:
                most, together = error, found
    return together


@kernel()
def may_be_chance(ratios, counts):
    """Whether errors that are independent may well show these ``ratios`` and ``counts`` of `shown`."""
    square, sizes = 0.0, 0
    for size in range(len(ratios)):
        if counts[size] > 0:
            more = 1.0 - OF_INDEPENDENT / max(ratios[size], OF_INDEPENDENT)
            square += counts[size] / OF_ONE * more * more
            sizes += 1
    return square <= OF_CHANCE[sizes]


@kernel()
def shared_pixels(pyramid, sigma, typical, growth, reach):
    """How many pixels of a frame have one error between them, as squares of 32 pixels show it, and on the whole.

    Both are 0 if unknown. ``sigma``, ``typical`` and ``growth`` are those of `estimate.estimate_noise`,
    ``reach`` that of `mixture`.
    """
    ratios, counts = np.empty(SIZES), np.empty(SIZES, np.int64)
    anywhere = np.empty((0, 0), np.int32), np.empty((0, 0), np.float32)
    for size in range(SIZES):  # where errors reach far, residuals are larger than within squares of 8
        level = SMALLEST + size
        grown = growth[min(level, len(growth)) - 1]
        flat = FLAT if size < SIZES - 1 else FLAT_LARGE
        step = 2 if size == 0 else 1  # a quarter of the smallest is enough, if there are larger ones
        ratios[size], counts[size] = shown(pyramid, level, sigma, flat * typical * grown**2, step, *anywhere)
    if counts[1] > 0:
        return beyond(ratios[1], SMALLEST + 1), mixture(ratios, counts, reach)
    ratios[0], counts[0] = shown(pyramid, SMALLEST, sigma, FLAT * typical * growth[1] ** 2, 1, *anywhere)
    by_16 = beyond(ratios[0], SMALLEST) if counts[0] > 0 else 0.0
    return by_16, by_16


@kernel()
def shared_by_planes(together, pyramid, label, inverse_depth):
    """How many pixels of a sensor's frame go together: ``together``, or 1 if squares in planes may show chance.

    Where there are many edges, a little of another surface is in many flat squares, and looks like shared errors. With
    ``label`` (H, W) int32, 0 for none, these are left out, and no residual is too large.
    """
    ratios, counts = np.empty(SIZES), np.empty(SIZES, np.int64)
    for size in range(SIZES - 1, -1, -1):
        step = 2 if size == 0 and counts[1] > 0 else 1  # as in `shared_pixels`
        ratios[size], counts[size] = shown(pyramid, SMALLEST + size, np.empty(0), np.inf, step, label, inverse_depth)
    return 1.0 if may_be_chance(ratios, counts) else together
