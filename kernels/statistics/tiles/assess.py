"""How good a plane is: the chi-square of its residual and the covariance of its coefficients.

Everything follows from a tile's moments and the noise of the inverse depth. Tiles come in blocks that stay in the
nearest cache, one quantity per row of a small buffer. All loops but those that read and write go over whole blocks,
whatever these hold, and so vectorise without a remainder.
"""

import math

import numpy as np

from ..._jit.kernel import kernel
from ...solvers.methods import ROUGH
from ..distributions import chi_square, f_ratio, normal
from ..noise_variances import DEPTH_STEP, DISPARITY_STEP, FALLOFF, INVERSE_FREEDOM, VARIANCES
from .block import (
    BETWEEN,
    COMMON,
    DEPTH_ROWS,
    DEVIATE,
    ERROR,
    LATERAL,
    LENS_ROWS,
    LIMIT,
    N_X,
    N_Y,
    N_Z,
    PER_FREEDOM,
    RATIO,
    ROOT,
    ROUNDING,
    ROWS,
    SHAPE_ROWS,
    SHARED,
    SLOPE_U,
    SLOPE_V,
    TILES_AT_ONCE,
    U_0,
    UNEVENNESS,
    W_0,
    D,
    load,
    store,
)
from .covariances import covariances, ray_scatter, sigma_slopes, uneven_covariances
from .residuals import by_count, residual_ratio, uneven_freedom
from .rounding import find_rounded, rounded_alike, rounded_apart
from .variances import find_uneven, independent_variance, mean_inverse_depth, pixel_variance, uneven_variance

# Terms of the polynomial for the largest permitted residual.
LIMITS = 11


@kernel(reduction=True)
def assess(fits, in_range_space, tables, noise, places, limits, part, results):
    """Give status ROUGH to tiles whose residual is larger than noise explains; write how uncertain the planes are.

    Parameters
    ----------
    fits : moments, reference, planes, rmse_metric, counts, status
        Of N tiles in each of F frames: (F, 10, N), (F, 3, N), (F, 4 * N) and (F, N) float64. ``counts`` are (F, N)
        integers: which row of ``tables`` belongs to a tile. ``status`` is (F, N) uint8, changed.
    in_range_space : bool
        Whether the moments are of (tanθx, tanθy, q), not of (X, Y, Z).
    tables : (K, TABLE_COLUMNS) float64
        By number of pixels, or one for each tile. With the covariance C of errors that neighbours share, of variance 1,
        and the projection P on residuals: tr(PC) and tr((PC)²). Then the factors by which C multiplies the variance of
        the slope along x, the covariance of the slopes, the variance of the slope along y and the variance of the mean
        inverse depth. Without rows, pixels are independent.
    noise : (8 or more,) float64
        Variances of the noise model: `noise_variances` says which entry is which.
    places : growth and pixel_terms
        ``growth`` is (2, N) float64, or (2, 0): factors on the variances of q along the ray in ``noise``, at each
        tile's place in the image, and the variances of their logarithms within the tiles. ``pixel_terms`` is
        (LENS_ROWS, DEPTH_ROWS or SHAPE_ROWS, N) float64, or without rows: what is known of the pixels beyond their
        moments. `block` says which row is which.
    limits : (LIMITS,) float64
        The largest permitted sum of squared residuals over its expected value, as a polynomial in 1/√(degrees of
        freedom). With a spread of the variance, the normal deviate of the level. Empty for no test.
    part : (start, stop)
        The tiles to assess, counted through all frames.
    results : (F, RESULTS, N) float64, written
        P-values of the residuals, covariances of α and of (n, d), and deviations, from row P_VALUE, ALPHA_COVARIANCE,
        PLANE_COVARIANCE, ANGLE_STD (degrees) and OFFSET_STD (metres). NaN where there is no plane. Without rows, only
        the test is made.
    """
    moments, reference, planes, rmse_metric, counts, status = fits
    growth, pixel_terms = places
    start, stop = part
    # Allocated before all else: later deallocations would hide its shape from the compiler.
    block = np.empty((ROWS, TILES_AT_ONCE))
    tails = block[RATIO : RATIO + normal.WORK]
    tiles = status.shape[1]
    everything = results.shape[1] > 0
    block[BETWEEN] = 0.0
    block[SLOPE_U : SLOPE_V + 1] = 0.0
    # Where all pixels' variances are known, slopes of σ would add nothing.
    is_graded = pixel_terms.shape[0] < DEPTH_ROWS and (noise.shape[0] > VARIANCES + 1 or growth.shape[1] > 0)
    begin = start
    while begin < stop:
        frame, first = begin // tiles, begin % tiles
        last = min(first + TILES_AT_ONCE, first + stop - begin, tiles)
        begin += last - first
        if everything:
            load(moments[frame], first, last, block, 0)
            load(reference[frame], first, last, block, U_0)
        else:  # as much as even variances need
            load(moments[frame, :1], first, last, block, 0)
            load(moments[frame, 3:4], first, last, block, 3)
            load(moments[frame, 9:], first, last, block, 9)
            load(reference[frame, 2:], first, last, block, W_0)
        load(rmse_metric[frame : frame + 1], first, last, block, ERROR)
        plane = planes[frame, 4 * first : 4 * last]
        for i in range(last - first):
            block[N_X, i] = plane[4 * i]
            block[N_Y, i] = plane[4 * i + 1]
            block[N_Z, i] = plane[4 * i + 2]
            block[D, i] = plane[4 * i + 3]
        mean_inverse_depth(in_range_space, block)
        if everything:
            ray_scatter(in_range_space, block)
        uneven = pixel_terms.shape[0] >= DEPTH_ROWS
        if uneven:
            load(pixel_terms[LENS_ROWS : LENS_ROWS + 1], first, last, block, SHARED)
            load(pixel_terms[LENS_ROWS + 1 : DEPTH_ROWS], first, last, block, ROUNDING)
        else:
            pixel_variance(noise, last - first, block)
            if growth.shape[1] > 0:
                factor, log_variance = growth[0, first:last], growth[1, first:last]
                for i in range(last - first):
                    block[SHARED, i] *= factor[i]
                    block[UNEVENNESS, i] += log_variance[i]
        if pixel_terms.shape[0] >= LENS_ROWS:
            load(pixel_terms[:LENS_ROWS], first, last, block, LATERAL)
        independent_variance(pixel_terms, noise, block)
        must_integrate = not uneven and find_uneven(block)
        has_rounding = noise[DEPTH_STEP] + noise[DISPARITY_STEP] > 0.0
        may_be_between = has_rounding and find_rounded(noise, block)
        if (must_integrate or may_be_between) and not everything:
            load(moments[frame], first, last, block, 0)
            load(reference[frame], first, last, block, U_0)
            ray_scatter(in_range_space, block)
        if must_integrate:
            uneven = True
            uneven_variance(noise, last - first, block)
            independent_variance(pixel_terms, noise, block)
        if may_be_between:
            rounded_apart(noise, last - first, block)
        elif has_rounding:
            block[BETWEEN] = 0.0
        by_count(counts[frame, first:last], tables, block)
        residual_ratio(block)
        if uneven and pixel_terms.shape[0] < SHAPE_ROWS:  # otherwise ``tables`` have it
            uneven_freedom(block)
        has_spread = noise[INVERSE_FREEDOM] > 0.0
        if has_spread:
            f_ratio.deviates(noise[INVERSE_FREEDOM], tails, TILES_AT_ONCE)
        else:
            for i in range(TILES_AT_ONCE):
                block[ROOT, i] = math.sqrt(block[PER_FREEDOM, i])
        if limits.shape[0] > 0:
            mark = status[frame, first:last]
            if has_spread:
                for i in range(last - first):
                    if block[DEVIATE, i] > limits[0]:
                        mark[i] = ROUGH
            else:
                for i in range(TILES_AT_ONCE):
                    limit = 0.0
                    for k in range(LIMITS - 1, -1, -1):
                        limit = limit * block[ROOT, i] + limits[k]
                    block[LIMIT, i] = limit
                for i in range(last - first):
                    if block[RATIO, i] > block[LIMIT, i]:
                        mark[i] = ROUGH
        if everything:
            if not has_spread:
                chi_square.deviates(tails, TILES_AT_ONCE)
            normal.tails(tails, TILES_AT_ONCE)
            if pixel_terms.shape[0] >= SHAPE_ROWS:
                block[COMMON : COMMON + 3] = 0.0
            if has_rounding:
                rounded_alike(noise, last - first, block)
            if is_graded:
                sigma_slopes(noise[FALLOFF], block)
            covariances(block)
            if uneven:
                uneven_covariances(block, pixel_terms[DEPTH_ROWS:, first:last])
            store(block, results[frame], first, last)
