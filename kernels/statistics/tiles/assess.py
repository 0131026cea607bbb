"""How good a plane is: the chi-square of its residual and the covariance of its coefficients.

Everything follows from a tile's moments and the noise of the inverse depth. Tiles come in blocks that stay in the
nearest cache, one quantity per row of a small room. All loops but those that read and write go over whole blocks,
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
    DEVIATE,
    ERROR,
    LATERAL,
    LIMIT,
    N_X,
    N_Y,
    N_Z,
    OF_DEPTHS,
    OF_LENS,
    OF_SHAPE,
    PER_FREEDOM,
    RATIO,
    ROOT,
    ROUNDING,
    ROWS,
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
def assess(
    moments, reference, planes, rmse_metric, counts, tables, in_range_space, noise, growth, of_pixels, limits, start,
    stop, status, results,
):  # fmt: skip
    """Give status ROUGH to tiles whose residual is larger than noise explains; write how uncertain the planes are.

    For tiles ``start`` to ``stop`` of N in each of F frames, counted through all frames.

    Parameters
    ----------
    moments, reference : (F, 10, N) and (F, 3, N) float64
    planes, rmse_metric : (F, 4 * N) and (F, N) float64
    counts : (F, N) integers
        Which row of ``tables`` belongs to a tile.
    tables : (K, TABLE_COLUMNS) float64
        By number of pixels, or one for each tile. With the covariance C of errors that neighbours share, of variance 1,
        and the projection P on residuals: tr(PC), tr((PC)²), and the factors of C on the variance of the slope along x,
        on the covariance of the slopes, on the variance of the slope along y and on that of the mean inverse depth.
        Without rows, pixels are independent.
    noise : (8 or more,) float64
        See `noise_variances.LATERAL_X`.
    growth : (2, N) float64, or (2, 0)
        Factors on the variances of q along the ray in ``noise``, at each tile's place in the image, and the variances
        of their logarithms within the tiles.
    of_pixels : (OF_LENS, OF_DEPTHS or OF_SHAPE, N) float64, or without rows
        See OF_LENS.
    limits : (LIMITS,) float64
        The largest permitted sum of squared residuals over its expected value, as a polynomial in 1/√(degrees of
        freedom); with a spread of the variance, the normal deviate of the level; empty for no test.
    status : (F, N) uint8, changed
    results : (F, RESULTS, N) float64, written
        P-values of the residuals, covariances of α and of (n, d), and deviations, from row P_VALUE, ALPHA_COVARIANCE,
        PLANE_COVARIANCE, ANGLE_STD (degrees) and OFFSET_STD (metres). NaN where there is no plane. Without rows, only
        the test is made.
    """
    # Allocated first: later deallocations would hide its shape from the compiler.
    room = np.empty((ROWS, TILES_AT_ONCE))
    tails = room[RATIO : RATIO + normal.WORK]
    tiles = status.shape[1]
    everything = results.shape[1] > 0
    room[BETWEEN] = 0.0
    room[SLOPE_U : SLOPE_V + 1] = 0.0
    # Where all pixels' variances are known, nothing is left to say.
    is_graded = of_pixels.shape[0] < OF_DEPTHS and (noise.shape[0] > VARIANCES + 1 or growth.shape[1] > 0)
    begin = start
    while begin < stop:
        frame, first = begin // tiles, begin % tiles
        last = min(first + TILES_AT_ONCE, first + stop - begin, tiles)
        begin += last - first
        if everything:
            load(moments[frame], first, last, room, 0)
            load(reference[frame], first, last, room, U_0)
        else:  # as much as even variances need
            load(moments[frame, :1], first, last, room, 0)
            load(moments[frame, 3:4], first, last, room, 3)
            load(moments[frame, 9:], first, last, room, 9)
            load(reference[frame, 2:], first, last, room, W_0)
        load(rmse_metric[frame : frame + 1], first, last, room, ERROR)
        plane = planes[frame, 4 * first : 4 * last]
        for i in range(last - first):
            room[N_X, i] = plane[4 * i]
            room[N_Y, i] = plane[4 * i + 1]
            room[N_Z, i] = plane[4 * i + 2]
            room[D, i] = plane[4 * i + 3]
        mean_inverse_depth(in_range_space, room)
        if everything:
            ray_scatter(in_range_space, room)
        uneven = of_pixels.shape[0] >= OF_DEPTHS
        if uneven:
            load(of_pixels[OF_LENS : OF_LENS + 1], first, last, room, SHARED)
            load(of_pixels[OF_LENS + 1 : OF_DEPTHS], first, last, room, ROUNDING)
        else:
            pixel_variance(noise, last - first, room)
            if growth.shape[1] > 0:
                of_variance, of_logarithm = growth[0, first:last], growth[1, first:last]
                for i in range(last - first):
                    room[SHARED, i] *= of_variance[i]
                    room[UNEVENNESS, i] += of_logarithm[i]
        if of_pixels.shape[0] >= OF_LENS:
            load(of_pixels[:OF_LENS], first, last, room, LATERAL)
        independent_variance(of_pixels, noise, room)
        must_integrate = not uneven and find_uneven(room)
        has_rounding = noise[DEPTH_STEP] + noise[DISPARITY_STEP] > 0.0
        may_be_between = has_rounding and find_rounded(noise, room)
        if (must_integrate or may_be_between) and not everything:
            load(moments[frame], first, last, room, 0)
            load(reference[frame], first, last, room, U_0)
            ray_scatter(in_range_space, room)
        if must_integrate:
            uneven = True
            uneven_variance(noise, last - first, room)
            independent_variance(of_pixels, noise, room)
        if may_be_between:
            rounded_apart(noise, last - first, room)
        elif has_rounding:
            room[BETWEEN] = 0.0
        by_count(counts[frame, first:last], tables, room)
        residual_ratio(room)
        if uneven and of_pixels.shape[0] < OF_SHAPE:  # otherwise ``tables`` have it
            uneven_freedom(room)
        has_spread = noise[INVERSE_FREEDOM] > 0.0
        if has_spread:
            f_ratio.deviates(noise[INVERSE_FREEDOM], tails, TILES_AT_ONCE)
        else:
            for i in range(TILES_AT_ONCE):
                room[ROOT, i] = math.sqrt(room[PER_FREEDOM, i])
        if limits.shape[0] > 0:
            mark = status[frame, first:last]
            if has_spread:
                for i in range(last - first):
                    if room[DEVIATE, i] > limits[0]:
                        mark[i] = ROUGH
            else:
                for i in range(TILES_AT_ONCE):
                    limit = 0.0
                    for k in range(LIMITS - 1, -1, -1):
                        limit = limit * room[ROOT, i] + limits[k]
                    room[LIMIT, i] = limit
                for i in range(last - first):
                    if room[RATIO, i] > room[LIMIT, i]:
                        mark[i] = ROUGH
        if everything:
            if not has_spread:
                chi_square.deviates(tails, TILES_AT_ONCE)
            normal.tails(tails, TILES_AT_ONCE)
            if of_pixels.shape[0] >= OF_SHAPE:
                room[COMMON : COMMON + 3] = 0.0
            if has_rounding:
                rounded_alike(noise, last - first, room)
            if is_graded:
                sigma_slopes(noise[FALLOFF], room)
            covariances(room)
            if uneven:
                uneven_covariances(room, of_pixels[OF_DEPTHS:, first:last])
            store(room, results[frame], first, last)
