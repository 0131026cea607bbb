"""Segmentation: what the squares of a frame tell about its noise.

Most squares of most frames hold one surface, so a low quantile of their residuals is noise.
"""

import math

import numpy as np

from ..._jit.kernel import kernel
from ...common.arrays import copy
from ...common.quantiles import quantile
from ..model.pixel_noise import expected_variance
from ..model.records import BLOCK, Pyramid
from .correlation import FEWEST, FLAT, FULL, shared_pixels

# Numbers of blocks of 4 pixels that are enough where larger squares are too few: the smallest plane has as many as the
# first. With more than MOST_BLOCKS the frame is not small but sparse.
FEWEST_BLOCKS, MOST_BLOCKS = 4, 160
MIXTURE = 0.5  # residual, as a share of the mean inverse depth, of a square of near and far things
SOLID = 2  # level of the squares that are too large to be a speck
LOW, TYPICAL = 0.2, 0.35  # quantiles that are noise
# If the TYPICAL quantile exceeds LEAP times the LOW one (sensors: 1.2 to 2.1), edges or outliers fill the squares, and
# lower quantiles are used, down to LOWEST, unless these show no noise at all: NO_NOISE times less.
LEAP, NO_NOISE, LOWEST = 4.0, 1e6, 0.05
STEEP = 4.0  # where a squared slope is this many variances, its part of the residual shows
# Standard deviation, in pixels, of where within its pixel a measurement lies.
LEAST_LATERAL, MOST_LATERAL = 0.05, 0.5
MOST_GROWTH = 8.0
# However long a wave is, squares of 16 pixels show no more than about four times as much of it as those of 8: its bend
# grows with the square of the side. Sensors: up to 2.2. More is of steps from one square of 8 pixels to the next.
MOST_OF_WAVES = 5.0
# Where things are small, or the frame is, hardly any large square holds one surface, and edges would pass for noise
# that grows. Fewer squares of 16 pixels than this say nothing about growth.
FEWEST_GROWN = 40
# Squares of 32 pixels may add to the variance of those of 8 up to this many times what those of 16 add: sensors'
# errors add up to 8.5 times as much, and most of them up to 3.8, which sets the limit where there are few squares.
MOST_STEEPENING = 9.0
FEW, MOST_OF_FEW = 100, 4.0
# If a smaller share of the squares of a size is clean, the low quantile of all is that of edges and outliers.
FEW_CLEAN = 0.25
# Variance, as a share of the squared mean, up to which measurements are all the same, apart from the rounding of sums.
CONSTANT = 1e-12
# If a smaller share of the squares that are not constant varies in each of their quarters, of which a straight edge
# crosses at most three, these have corners in them.
FEWEST_VARIED = 0.1
# Far, middle and near squares, of at most MANY, tell how noise depends on depth, if the nearest are so many times as
# near as the farthest, but for a share of OUTER at each end. Of squares of edges, which lie between what is far and
# near, there are fewer than LEAST_PART. Noise is one of depth if that of 1/Z grows by no less and no more than these
# powers of 1/Z, and from each part to the next by no less than the last: what lies near may be rougher.
MANY, APART, OUTER, LEAST_PART = 1024, 1.5, 0.02, 0.05
LEAST_POWER, MOST_POWER, LEAST_OF_STEP = 1.5, 2.5, 1.0


@kernel()
def nearest_surface(pyramid, nearest):
    """The largest inverse depth of a surface, with a margin; ``nearest`` is that of any pixel.

    Some sensors have near pixels where there is nothing: a single one at a millimetre is a thousand times as near as
    the rest.
    """
    moments, rss, offsets = pyramid.moments, pyramid.rss, pyramid.offsets
    for level in range(SOLID, -1, -1):  # smaller ones where no such square holds a surface
        least = FULL * (BLOCK << level) ** 2
        largest = 0.0
        for i in range(offsets[level], offsets[level + 1]):
            n, sum_q = moments[0, i], moments[3, i]
            # The mean of a square with such a pixel in it says nothing.
            if n >= least and n * rss[i] < (MIXTURE * sum_q) ** 2:
                largest = max(largest, sum_q / n)
        if largest > 0.0:
            return min(2.0 * largest, nearest)
    return nearest


@kernel(inline="compiled")
def is_constant(moments, i):
    """Whether all measurements of square ``i`` are the same; it needs at least three, as fewer say nothing."""
    n, sum_q = moments[0, i], moments[3, i]
    return (n >= 3.0) & (n * moments[9, i] <= (1.0 + CONSTANT) * sum_q * sum_q)


@kernel()
def varied_squares(pyramid):
    """The pyramid, without squares that show no noise if its low quantile of residuals would be theirs.

    Where a sensor gives one value for everything beyond its range, or its steps are larger than its noise, there is
    none to see: a square of up to 32 pixels with a constant quarter then counts as without a plane. If hardly any of
    the others are left, they are only the edges of things that show no noise, and all squares stay.
    """
    moments, rss, slope_square, offsets, shapes = pyramid
    count = constant = varied = 0
    for i in range(offsets[1], offsets[2]):
        if moments[0, i] >= FULL * (BLOCK << 1) ** 2:
            count += 1
            constant += is_constant(moments, i)
    if constant <= LOW * count:
        return pyramid
    rss = rss.copy()
    for level in range(1, min(len(shapes), 4)):
        for row in range(shapes[level, 0]):
            for column in range(shapes[level, 1]):
                i = offsets[level] + row * shapes[level, 1] + column
                k = offsets[level - 1] + 2 * (row * shapes[level - 1, 1] + column)
                below = k + shapes[level - 1, 1]
                if (
                    is_constant(moments, k)
                    | is_constant(moments, k + 1)
                    | is_constant(moments, below)
                    | is_constant(moments, below + 1)
                ):
                    rss[i] = -1.0
                elif level == 1:
                    varied += moments[0, i] >= FULL * (BLOCK << 1) ** 2
    if varied <= FEWEST_VARIED * (count - constant):
        return pyramid
    return Pyramid(moments, rss, slope_square, offsets, shapes)


@kernel(inline="compiled")
def is_measured(moments, rss, level, i):
    """Whether square ``i`` of a level has enough pixels, and a plane."""
    return (moments[0, i] >= FULL * (BLOCK << level) ** 2) & (rss[i] >= 0.0)


@kernel()
def square_residuals(pyramid, level, sigma, mean_square, slope_square):
    """Mean squared residual and squared slope of the squares of a level that have a plane; returns their number.

    Both in variances, where ``sigma`` says what these are.
    """
    moments, rss, slopes = pyramid.moments, pyramid.rss, pyramid.slope_square
    count = 0
    for i in range(pyramid.offsets[level], pyramid.offsets[level + 1]):
        if not is_measured(moments, rss, level, i):
            continue
        expected = expected_variance(moments[3, i] / moments[0, i], sigma)
        mean_square[count] = rss[i] / (moments[0, i] - 3.0) / expected
        slope_square[count] = slopes[i] / expected
        count += 1
    return count


@kernel()
def grows_with_depth(pyramid):
    """Whether the noise is the same at all depths Z: that of 1/Z then grows with the square of 1/Z.

    So it is with lasers and, within a factor, with time of flight, while that of triangulation is the same in 1/Z.
    """
    moments, rss, offsets = pyramid.moments, pyramid.rss, pyramid.offsets
    step = max((offsets[2] - offsets[1]) // MANY, 1)
    q, mean_square = np.empty((2, (offsets[2] - offsets[1]) // step + 1))
    count = 0
    for i in range(offsets[1], offsets[2], step):
        if is_measured(moments, rss, 1, i):
            q[count], mean_square[count] = moments[3, i] / moments[0, i], rss[i] / (moments[0, i] - 3.0)
            count += 1
    if count < 3 * FEWEST:
        return False
    far, near = quantile(q[:count], OUTER), quantile(q[:count], 1.0 - OUTER)
    if not near >= APART * far > 0.0:
        return False
    third = (near / far) ** (1.0 / 3.0)
    edges = np.array([-math.inf, far * third, near / third, math.inf])
    depths, noises = np.empty(3), np.empty(3)  # inverse ones, and variances
    some_q, some = np.empty(count), np.empty(count)
    parts = 0
    for k in range(3):
        chosen = 0
        for i in range(count):
            some_q[chosen], some[chosen] = q[i], mean_square[i]
            chosen += edges[k] <= q[i] <= edges[k + 1]
        if chosen >= max(FEWEST, LEAST_PART * count):
            depths[parts], noises[parts] = quantile(some_q[:chosen], 0.5), quantile(some[:chosen], TYPICAL)
            parts += 1
    if parts < 2 or not noises[0] > 0.0:
        return False
    ratio, grown = depths[parts - 1] / depths[0], math.sqrt(noises[parts - 1] / noises[0])
    follows = ratio >= APART and ratio**LEAST_POWER <= grown <= ratio**MOST_POWER
    for k in range(parts - 1):
        follows &= noises[k + 1] >= noises[k] * (depths[k + 1] / depths[k]) ** (2.0 * LEAST_OF_STEP)
    return follows


@kernel()
def typical_in_blocks(pyramid, sigma):
    """Variance within blocks of 4 pixels, where hardly any square of 8 is measured; 0 if they do not tell."""
    capacity = pyramid.offsets[1]
    values, slope_square = np.empty(capacity), np.empty(capacity)
    count = square_residuals(pyramid, 0, sigma, values, slope_square)
    return quantile(values[:count], TYPICAL) if FEWEST_BLOCKS <= count <= MOST_BLOCKS else 0.0


@kernel()
def clean_squares(pyramid, sigma, most):
    """Which squares of 8 pixels, (R, C) of them, have a residual of no more than ``most``, or hardly any pixels."""
    first, stop = pyramid.offsets[1], pyramid.offsets[2]
    pixels, sum_q, rss = pyramid.moments[0, first:stop], pyramid.moments[3, first:stop], pyramid.rss[first:stop]
    clean = np.empty(stop - first, np.bool_)
    for i in range(len(clean)):
        n = pixels[i]
        allowed = most * (n - 3.0) * expected_variance(sum_q[i] / max(n, 1.0), sigma)
        clean[i] = not ((n > 3.0) & (rss[i] > allowed))
    return clean.reshape(pyramid.shapes[1, 0], pyramid.shapes[1, 1])


@kernel()
def keep_clean_squares(pyramid, level, clean, mean_square):
    """Keep those of a level's squares in which all of the level before are clean.

    Parameters
    ----------
    pyramid, level
        Squares of `square_residuals`.
    clean : (R, C) bool
        Of the level before, from `clean_squares`.
    mean_square : (K,) float64, changed
        From `square_residuals`: the first entries become those of the squares kept.

    Returns
    -------
    count : int
        Squares kept.
    clean : (R / 2, C / 2) bool
        Of this level.
    """
    moments, rss, offsets = pyramid.moments, pyramid.rss, pyramid.offsets
    rows, columns = clean.shape[0] // 2, clean.shape[1] // 2
    larger = np.empty((rows, columns), np.bool_)
    seen = count = 0
    for row in range(rows):
        upper, lower, row_clean = clean[2 * row], clean[2 * row + 1], larger[row]
        for c in range(columns):
            row_clean[c] = upper[2 * c] & upper[2 * c + 1] & lower[2 * c] & lower[2 * c + 1]
        for c in range(columns):  # without branches, which no processor could predict
            measured = is_measured(moments, rss, level, offsets[level] + row * columns + c)
            mean_square[count] = mean_square[seen]
            count += measured & row_clean[c]
            seen += measured
    return count, larger


@kernel()
def lateral_error(mean_square, slope_square, typical):
    """Standard deviation, in pixels, of where a measurement lies, from the residuals of steep squares."""
    excess = np.empty(len(mean_square))
    count = 0
    for i in range(len(mean_square)):
        if slope_square[i] > STEEP * typical:
            excess[count] = max(mean_square[i] - typical, 0.0) / slope_square[i]
            count += 1
    if count <= min(5 * FEWEST, max(FEWEST, len(mean_square) // 6)):  # a small frame has no more
        return MOST_LATERAL
    return min(max(math.sqrt(quantile(excess[:count], LOW)), LEAST_LATERAL), MOST_LATERAL)


@kernel()
def estimate_noise(pyramid, sigma, growth, reach):
    """Estimate the noise of a frame from the residuals of its own squares of 8 to 64 pixels.

    Where a frame has too few squares to tell, blocks of 4 pixels tell how large the noise is, which is taken to be
    independent, and half a pixel laterally.

    Parameters
    ----------
    pyramid : Pyramid
    sigma : (K + 1,) float64
        What is known of the noise: a step, and standard deviations of inverse depths 0, step, 2 step, ... Empty if
        nothing is.
    growth : (3,) float64, written
        Residual of squares of 8, 16 and 32 pixels as a multiple of the first: 1 for independent pixels.
    reach : (2·SIZES + 1, K) float64
        Of K kinds of errors of different reach, `correlation.mixture`.

    Returns
    -------
    typical : float
        Variance of inverse depth within squares of 8 pixels, or of 4, in 1/m² or as a multiple of what ``sigma`` says;
        0 if unknown.
    lateral : float
        Standard deviation, in pixels, of where a measurement lies.
    by_32, together : float
        Pixels that have one error between them, as far as squares of 32 pixels show it, and on the whole; 0 if unknown.
    """
    pyramid = varied_squares(pyramid)
    capacity = pyramid.offsets[2] - pyramid.offsets[1]
    mean_square, slope_square, values = np.empty(capacity), np.empty(capacity), np.empty(capacity)
    growth[:] = 1.0
    lateral = MOST_LATERAL
    typical = smallest = 0.0
    for level in range(1, len(growth) + 1):
        count = square_residuals(pyramid, level, sigma, mean_square, slope_square)
        if count < (FEWEST_GROWN if level == 2 else FEWEST):
            growth[level - 1 :] = growth[max(level - 2, 0)]
            if level == 1:
                typical = typical_in_blocks(pyramid, sigma)
            break
        copy(mean_square, values[:count])
        if level == 1:
            typical = quantile(values[:count], TYPICAL)
            smallest = quantile(values[:count], LOW)
            share = LOW
            while share > LOWEST and LEAP * smallest < typical < NO_NOISE * smallest:
                share *= 0.5
                typical, smallest = smallest, quantile(values[:count], share)
            lateral = lateral_error(mean_square[:count], slope_square[:count], typical)
            clean = clean_squares(pyramid, sigma, FLAT * typical)
        elif smallest > 0.0:
            count_clean, clean = keep_clean_squares(pyramid, level, clean, mean_square)
            if count_clean < FEW_CLEAN * count:  # most have an edge in them, or a stray pixel
                if count_clean < FEWEST:
                    growth[level - 1 :] = growth[level - 2]
                    break
                count = count_clean
                copy(mean_square, values[:count])
            grown = math.sqrt(quantile(values[:count], LOW) / smallest)
            if level == 2 and grown > MOST_OF_WAVES:
                growth[level - 1 :] = growth[level - 2]
                break
            if level == 3:
                most = MOST_OF_FEW if count < FEW else MOST_STEEPENING
                grown = min(grown, math.sqrt(1.0 + most * (growth[1] ** 2 - 1.0)))
            growth[level - 1] = min(max(grown, growth[level - 2]), MOST_GROWTH)
    by_32, together = shared_pixels(pyramid, sigma, typical, growth, reach)
    return typical, lateral, by_32, together
