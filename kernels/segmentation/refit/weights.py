"""Segmentation: where among its pixels a plane's errors are larger, as far away or at the edges of the image."""

import numpy as np

from ..._jit.kernel import kernel
from ..model.moments import misfit
from ..model.records import BLOCK

SQUARE_SIDE = 2 * BLOCK  # of the squares that are looked at, the pyramid's second level
# Squares that a plane needs: with fewer, chance says more than the noise.
FEWEST_SQUARES = 32
# Smallest share of the equal weights' second moment that the weights may leave in any direction. They are extrapolated
# from squares to all pixels, and where the squares lie elsewhere, as in one side of a picture frame, too far.
LEAST_WEIGHT = 0.1
# Multiple of its plane's mean at which a square's variance is cut off: there may be an edge in it.
MOST = 25.0


@kernel(inline="compiled")
def leave_enough(m, weighted):
    """Whether the weighted mean of (u, v, 1)(u, v, 1)ᵀ is more than LEAST_WEIGHT of the equal one in all directions.

    ``m`` (10,) are moments, ``weighted`` (5,) is a row of `weigh_rays`'.
    """
    share = LEAST_WEIGHT / m[0]
    one = 1.0 - LEAST_WEIGHT
    u, v = weighted[0] - share * m[1], weighted[1] - share * m[2]
    uu = weighted[2] - share * m[4] - u * u / one
    uv = weighted[3] - share * m[5] - u * v / one
    vv = weighted[4] - share * m[7] - v * v / one
    return uu > 0.0 and uu * vv > uv * uv


@kernel()
def weigh_rays(label, pyramid, moments, alpha, rss, weighted):
    """Means of the rays of each plane's pixels, weighted by the variances that the residuals show.

    Parameters
    ----------
    label : (H, W) int32
        0 for none; plane i has label i + 1.
    pyramid : Pyramid
    moments, alpha, rss : (N, 10), (N, 3), (N,) float64
        Of the planes.
    weighted : (N, 5) float64, written
        Means of u, v, u², uv and v², (u, v) = (tanθx, tanθy): that of all pixels, plus Σ more·(sum over the square -
        n times the mean of all pixels) / Σ n·(variance of the square), over squares of SQUARE_SIDE pixels. ``more`` is
        the square's variance above the plane's. Squares stand for all pixels, although they do not reach the edges.
        If the rims are rougher than they, ``more`` is negative, and the means move to the rims; with differences
        from the squares' own mean they would not.
        Where there are fewer than FEWEST_SQUARES, or less than LEAST_WEIGHT would be left, all pixels count equally.
    """
    height, width = label.shape
    first, columns = pyramid.offsets[1], pyramid.shapes[1, 1]
    square_moments = pyramid.moments
    mean, squares, pixels, total = np.zeros((4, len(moments)))
    for k in range(len(moments)):
        mean[k] = max(rss[k], 0.0) / moments[k, 0]
    weighted[:] = 0.0  # at first sums, as those in ``total``, of what a square's variance is above the mean
    for row in range(height // SQUARE_SIDE):
        top, bottom = label[row * SQUARE_SIDE], label[row * SQUARE_SIDE + SQUARE_SIDE - 1]
        for column in range(width // SQUARE_SIDE):
            left, right = column * SQUARE_SIDE, column * SQUARE_SIDE + SQUARE_SIDE - 1
            a = top[left]
            if (a == 0) | (top[right] != a) | (bottom[left] != a) | (bottom[right] != a):
                continue
            k, i = a - 1, first + row * columns + column
            n = square_moments[0, i]
            if n == 0.0:
                continue
            more = min(max(misfit(square_moments, i, alpha, k), 0.0) / n, MOST * mean[k]) - mean[k]
            squares[k] += 1.0
            pixels[k] += n
            total[k] += more * n
            weighted[k, 0] += more * square_moments[1, i]
            weighted[k, 1] += more * square_moments[2, i]
            weighted[k, 2] += more * square_moments[4, i]
            weighted[k, 3] += more * square_moments[5, i]
            weighted[k, 4] += more * square_moments[7, i]
    for k in range(len(moments)):
        m, weight = moments[k], mean[k] * pixels[k] + total[k]
        is_told = squares[k] >= FEWEST_SQUARES and weight > 0.0
        for j, of in enumerate((1, 2, 4, 5, 7)):
            even = m[of] / m[0]
            weighted[k, j] = even + (weighted[k, j] - total[k] * even) / weight if is_told else even
        if is_told and not leave_enough(m, weighted[k]):
            for j, of in enumerate((1, 2, 4, 5, 7)):
                weighted[k, j] = m[of] / m[0]
