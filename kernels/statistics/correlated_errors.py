"""Errors that neighbours share: what they do to the planes of parts of any shape.

The covariance of a plane fitted to pixels with rays mᵢ is A⁻¹BA⁻¹ with A = Σmᵢmᵢᵀ and B = Σcᵢⱼmᵢmⱼᵀ over all pairs of
pixels, whose errors have the covariances cᵢⱼ. Here pixels are summed up by the cells of a grid over the part. Two cells
share what their pixels share on average, which is a product of factors along x and along y.
"""

import math

import numpy as np

from .._jit.kernel import kernel
from ..solvers.cholesky import factorise, invert
from .correlation_cells import (
    add_runs,
    shared_by_cells,
    smooth,
    spread_out,
    sum_of_products,
    sums_before,
    weigh,
    weighted_product,
)
from .tiles.block import EXPECTED, FREEDOM, MEAN, SLOPES, WITH_MEAN

# A part has at most MOST_CELLS cells, and not many more than FILLED have pixels. They are wider where errors reach as
# far as that, but divide each of the part's sides by ALONG or more. FEW_CELLS are enough for the degrees of freedom.
MOST_CELLS, FILLED, FEW_CELLS, ALONG = 4096, 512, 128, 16


@kernel(inline=True)
def times_along(shift, pixels, length):
    """How many times cells may be doubled along a side of a part, where errors reach so far."""
    times = 0
    while 2 << (shift + times) <= length and (2 << (shift + times)) * ALONG <= pixels:
        times += 1
    return times


@kernel()
def add_alone(cells, number, filled, factor, weights, sums):
    """Add errors that each pixel has alone, their variance times ``factor``.

    ``filled`` is 0; or one over the pixels of a full cell, if full cells are to add nothing, as what `apart_in_cell`
    gives does. ``weights`` (number,) are scratch memory.
    """
    counts = cells[len(cells) - 1]
    for k in range(number):
        n = counts[k]
        weights[k] = factor * max(1.0 - n * filled, 0.0) / n if n > 0.0 else 0.0
    for i in range(len(sums)):
        for j in range(i, len(sums)):
            total = weighted_product(cells[i], cells[j], weights, number)
            sums[i, j] += total
            if j > i:
                sums[j, i] += total


@kernel(inline=True)
def apart_in_cell(shared, pixels):
    """What a pixel does not share with the others of its cell, if the pairs of all of them share so much on average.

    Where pixels are missing, this is more of the sum than that mean, which is a full cell's, has of it.
    """
    return pixels * (1.0 - shared) / (pixels - 1.0) if pixels > 1.0 else 0.0


@kernel()
def add_correlated(cells, grid, extent, length, factor, scratch, sums):
    """Add what errors of one correlation length share, Σk·Sᵢ·Sⱼᵀ over all pairs of cells.

    Parameters
    ----------
    cells : (C, rows * columns) float64
        Sums over the pixels of each cell: of σ times the derivatives of the fit in the first P rows, of σ in the row
        before the last, which may be one of these, and last the number of pixels. Of a plane C is 4 and P is 3: the
        derivatives are u - ū, v - v̄ and 1.
    grid : (rows, columns, shift)
        Of the cells, which have sides of 2^shift pixels.
    extent : (tall, wide)
        Pixels of the part from its first to its last row, and column.
    length : float
        Correlation length in pixels.
    factor : float
        By which the result is multiplied.
    scratch : (C + 4 or more, 2 * MOST_CELLS) float64
    sums : (P, P) float64, added to
    """
    rows, columns, shift = grid
    tall, wide = extent
    height, fewer = len(cells), scratch[: len(cells)]
    along_y, along_x, across, smoothed = scratch[height], scratch[height + 1], scratch[height + 2], scratch[height + 3]
    times_y, times_x = times_along(shift, tall, length), times_along(shift, wide, length)
    rows_now, columns_now = ((rows - 1) >> times_y) + 1, ((columns - 1) >> times_x) + 1
    side_y, side_x = 1 << (shift + times_y), 1 << (shift + times_x)
    reach_y = shared_by_cells(length, side_y, rows_now, along_y)
    reach_x = shared_by_cells(length, side_x, columns_now, along_x)
    stride = columns_now + reach_x - 1
    number = rows_now * stride
    spread_out(cells, rows, columns, times_y, times_x, stride, fewer)
    for j in range(len(sums)):
        smooth(fewer[j], number, stride, along_y[:reach_y], along_x[:reach_x], False, across, smoothed)
        for i in range(len(sums)):
            total = factor * sum_of_products(fewer[i], smoothed, number)
            sums[i, j] += total
            sums[j, i] += total
    pixels = float(side_y * side_x)
    if pixels > 1.0:
        add_alone(fewer, number, 1.0 / pixels, factor * apart_in_cell(along_y[0] * along_x[0], pixels), across, sums)


@kernel()
def write_inverse(n, uu, uv, vv, inverse):
    """Write A⁻¹ (3, 3) about the mean of n rays with this scatter; return whether there is one."""
    determinant = uu * vv - uv * uv
    inverse[:] = 0.0
    inverse[0, 0], inverse[1, 1], inverse[2, 2] = vv / determinant, uu / determinant, 1.0 / n
    inverse[0, 1] = inverse[1, 0] = -uv / determinant
    return determinant > 0.0


@kernel()
def trace_of_product(a, b):
    """tr(AB) of two (P, P) matrices."""
    total = 0.0
    for i in range(len(a)):
        for j in range(len(a)):
            total += a[i, j] * b[j, i]
    return total


@kernel()
def product(a, b):
    """AB of two (P, P) matrices."""
    number = len(a)
    result = np.zeros((number, number))
    for i in range(number):
        for j in range(number):
            for k in range(number):
                result[i, j] += a[i, k] * b[k, j]
    return result


@kernel()
def squares_of_pairs(weights, number, stride, side, components, factors, reaches, scratch):
    """Σcᵢⱼ² over all pairs of pixels, by what cells share.

    A product of two correlations is one, too, of a shorter length. Where both reach over more than a cell, the product
    of their means over cells is taken, as for the errors that a plane explains: of those little may remain.

    ``weights`` are the sums of σ² over cells; ``factors`` what each of the ``components`` shares along y and x, up to
    the number of cells in ``reaches``.
    """
    along_y, along_x, across, smoothed = scratch[0], scratch[1], scratch[2], scratch[3]
    total = 0.0
    for a in range(len(components)):
        for b in range(a + 1):
            length, other = components[a, 1], components[b, 1]
            if length == 0.0 or other == 0.0:
                continue
            reach_y, reach_x = min(reaches[a, 0], reaches[b, 0]), min(reaches[a, 1], reaches[b, 1])
            if min(length, other) >= 2.0 * side:
                along_y[:reach_y] = factors[a, 0, :reach_y] * factors[b, 0, :reach_y]
                along_x[:reach_x] = factors[a, 1, :reach_x] * factors[b, 1, :reach_x]
            else:
                both = length * other / math.hypot(length, other)
                reach_y = shared_by_cells(both, side, reach_y, along_y)
                reach_x = shared_by_cells(both, side, reach_x, along_x)
            smooth(weights, number, stride, along_y[:reach_y], along_x[:reach_x], True, across, smoothed)
            share = components[a, 0] * components[b, 0] * (1.0 if a == b else 2.0)
            total += share * sum_of_products(weights, smoothed, number)
    return total


@kernel()
def degrees_of_freedom(cells, grid, parameters, components, factors, scratch):
    """Degrees of freedom of the sum of squared residuals: its squared mean over half its variance; NaN if unknown.

    With the projection R = I - MA⁻¹Mᵀ on residuals these are tr(RC)² and tr((RC)²) = tr(C²) - 2tr(A⁻¹MᵀC²M) +
    tr((A⁻¹B)²) (Satterthwaite 1946). All of it, also A, from the same cells: little may remain of large numbers.

    Parameters
    ----------
    cells, grid
        The same as for `add_correlated`.
    parameters : int
        P, of the fit.
    components : (C, 2) float64
        Shares of the variance along the ray, and how far they are correlated, in pixels.
    factors : (C, 2, FEW_CELLS) float64
        Scratch memory.
    scratch : (C + P + 7 or more, 2 * MOST_CELLS) float64
    """
    rows, columns, shift = grid
    times = 0
    while (((rows - 1) >> times) + 1) * (((columns - 1) >> times) + 1) > FEW_CELLS:
        times += 1
    rows_now, columns_now = ((rows - 1) >> times) + 1, ((columns - 1) >> times) + 1
    side, widest, alone, shared, apart = 1 << (shift + times), 1, 0.0, 0.0, 0.0
    reaches = np.empty((len(components), 2), np.int64)
    for a in range(len(components)):
        share, length = components[a, 0], components[a, 1]
        if length > 0.0:
            shared += share
            reaches[a, 0] = shared_by_cells(length, side, rows_now, factors[a, 0])
            reaches[a, 1] = shared_by_cells(length, side, columns_now, factors[a, 1])
            widest = max(widest, reaches[a, 1])
            apart += share * apart_in_cell(factors[a, 0, 0] * factors[a, 1, 0], float(side * side))
        else:
            alone += share
    stride = columns_now + widest - 1
    number = rows_now * stride
    height, top = len(cells), len(cells) + parameters
    fewer, with_all, across, smoothed = scratch[:height], scratch[height:top], scratch[top], scratch[top + 1]
    spread_out(cells, rows, columns, times, times, stride, fewer)
    with_all[:, :number] = 0.0
    for a in range(len(components)):
        if components[a, 1] > 0.0:
            along_y, along_x = factors[a, 0, : reaches[a, 0]], factors[a, 1, : reaches[a, 1]]
            for j in range(parameters):
                smooth(fewer[j], number, stride, along_y, along_x, True, across, smoothed)
                for k in range(number):
                    with_all[j, k] += components[a, 0] * smoothed[k]
    weights, deviations, counts = scratch[top + 2], fewer[height - 2], fewer[height - 1]
    # A, B and MᵀC²M.
    normal, explained, square = np.zeros((3, parameters, parameters))
    lower, inverse = np.zeros((2, parameters, parameters))
    total = half = 0.0
    for k in range(number):
        weights[k] = 0.0
        if counts[k] > 0.0:
            missing = max(1.0 - counts[k] / (side * side), 0.0)
            lost = alone + apart * missing
            weights[k] = deviations[k] ** 2 / counts[k]
            total += weights[k]
            squares = alone * (alone + 2.0 * shared) + missing * apart * (2.0 * shared - apart)
            half += squares * weights[k] ** 2 / counts[k]
            for i in range(parameters):
                with_all[i, k] += lost * fewer[i, k] / counts[k]
            for i in range(parameters):
                for j in range(parameters):
                    normal[i, j] += fewer[i, k] * fewer[j, k] / weights[k]
                    explained[i, j] += fewer[i, k] * with_all[j, k]
                    square[i, j] += weights[k] * with_all[i, k] * with_all[j, k]
    if not factorise(normal, parameters, 0.0, lower):
        return math.nan
    invert(lower, parameters, across, inverse)
    half += squares_of_pairs(weights, number, stride, side, components, factors, reaches, scratch[top + 3 :])
    explained = product(inverse, explained)
    expected = (alone + shared) * total - np.trace(explained)
    half += trace_of_product(explained, explained) - 2.0 * trace_of_product(inverse, square)
    return expected * expected / half if expected > 0.0 and half > 0.0 else math.nan


@kernel()
def rescaled(moments, measured):
    """(3, 3) T: TCTᵀ has the variances for ``measured`` that C has for ``moments``; `write_covariance` has both.

    With A = LLᵀ of each of them, T = L'⁻ᵀLᵀ leaves LᵀCL = L⁻¹BL⁻ᵀ as it is: C over that of independent errors.
    """
    scale = np.eye(3)
    n, uu, uv, vv = measured
    first, cell_first = math.sqrt(uu), math.sqrt(moments[3])
    slant, cell_slant = uv / first, moments[4] / cell_first
    second, cell_second = math.sqrt(vv - slant * slant), math.sqrt(moments[5] - cell_slant * cell_slant)
    if second > 0.0 and cell_second > 0.0 and n > 0.0:
        scale[0, 0], scale[1, 1], scale[2, 2] = cell_first / first, cell_second / second, math.sqrt(moments[0] / n)
        scale[0, 1] = (cell_slant - slant * scale[1, 1]) / first
    return scale


@kernel()
def write_covariance(moments, sums, total, from_u, from_v, measured, covariances):
    """Covariances of a plane's slopes and of q, and the expected sum of squared residuals, tr(C) - tr(A⁻¹B).

    Parameters
    ----------
    moments : (6,) float64
        n, nothing, nothing and the scatter of the rays.
    sums : (3, 3) float64
        B, about the mean ray.
    total : float
        tr(C).
    from_u, from_v : float
        From the mean ray to the ray at which q is wanted.
    measured : tuple of 4 floats
        n and the scatter again, where they are known better: then these count.
    covariances : (COLUMNS,) float64, written
    """
    inverse, there = np.empty((3, 3)), np.eye(3)
    if not write_inverse(moments[0], moments[3], moments[4], moments[5], inverse):
        return
    explained = product(inverse, sums)
    covariance = product(explained, inverse)
    there[2, 0], there[2, 1] = from_u, from_v
    there = product(there, rescaled(moments, measured))
    covariance = product(product(there, covariance), there.T)
    covariances[SLOPES], covariances[SLOPES + 1], covariances[SLOPES + 2] = (
        covariance[0, 0],
        covariance[0, 1],
        covariance[1, 1],
    )
    covariances[WITH_MEAN], covariances[WITH_MEAN + 1], covariances[MEAN] = (
        covariance[0, 2],
        covariance[1, 2],
        covariance[2, 2],
    )
    covariances[EXPECTED] = total - (explained[0, 0] + explained[1, 1] + explained[2, 2])


@kernel()
def extent_of(runs, begin, end):
    """First row and column of some runs; how many rows and columns; pixels; whether all of these are measured."""
    _, rows, starts, stops, shares = runs
    top, bottom, left, right = rows[begin], rows[begin], starts[begin], stops[begin]
    pixels, is_exact = 0, True
    for k in range(begin, end):
        top, bottom = min(top, rows[k]), max(bottom, rows[k])
        left, right = min(left, starts[k]), max(right, stops[k])
        pixels += stops[k] - starts[k]
        is_exact &= shares[k] == 1.0
    return top, left, bottom + 1 - top, right - left, pixels, is_exact


@kernel()
def shared_covariances(runs, image_rays, parts, noise, components, with_freedom, covariances):
    """Covariances of the planes of N parts by their errors along the ray.

    Parameters
    ----------
    runs : PixelRuns
        Of the parts.
    image_rays : tan_x and tan_y, (H, W) float64, or (1, W) and (H, 1)
    parts : counts, rays and alpha, (N,), (N, 5) and (N, 3) float64
        Numbers of measured pixels. Means of u and v over them, and their variances and covariance, uu, uv, vv; of parts
        whose runs say which pixels are measured, only the mean ray counts. The planes, NaN where there is none.
    noise : (8 or more,) float64
        Variances of the noise model: `noise_variances` says which entry is which.
    components : (C, 2) float64
        Shares of its variance, which may add up to more than 1, and how far they are correlated, in pixels: 0 for what
        is independent.
    with_freedom : bool
        Whether the last column of ``covariances`` is wanted, too.
    covariances : (N, COLUMNS) float64, written
        Variance of the slope along u, covariance of the slopes, variance of that along v; covariances of the slopes
        with q at the mean ray; its variance; the expected sum of squared residuals, and its degrees of freedom. NaN
        where there is no plane.
    """
    tan_x, tan_y = image_rays
    counts, rays, alpha = parts
    # An image of one row has one of tanθx with a lens, too, but not one column of tanθy.
    has_one_row = tan_x.shape[0] == 1 and tan_y.shape[1] == 1
    before = np.empty((2, tan_x.shape[1] + 1 if has_one_row else 0))  # of the row of tanθx that all rows have
    shared_u = tan_x[0, tan_x.shape[1] // 2]
    if before.shape[1] > 0:
        sums_before(tan_x[0], shared_u, before)
    cells, scratch, sums = np.empty((4, MOST_CELLS)), np.empty((14, 2 * MOST_CELLS)), np.empty((3, 3))
    moments = np.empty(6)
    factors = np.empty((len(components), 2, FEW_CELLS))
    first = runs.first
    covariances[:] = math.nan
    for i in range(len(alpha)):
        begin, end = first[i], first[i + 1]
        if begin == end or math.isnan(alpha[i, 0]):
            continue
        top, left, tall, wide, pixels, is_exact = extent_of(runs, begin, end)
        shift = 0
        while (pixels >> 2 * shift) > FILLED or (((tall - 1) >> shift) + 1) * (((wide - 1) >> shift) + 1) > MOST_CELLS:
            shift += 1
        lines, columns = ((tall - 1) >> shift) + 1, ((wide - 1) >> shift) + 1
        cells[:, : lines * columns] = 0.0
        moments[:] = 0.0
        u, v = shared_u if before.shape[1] > 0 else rays[i, 0], rays[i, 1]
        grid = lines, columns, shift
        add_runs(runs, (begin, end), image_rays, (u, v), before, (top, left, columns, shift), cells, moments)
        mean_u, mean_v = moments[1] / moments[0], moments[2] / moments[0]
        moments[3] -= moments[1] * mean_u
        moments[4] -= moments[1] * mean_v
        moments[5] -= moments[2] * mean_v
        weigh(cells, lines * columns, (u, v), (mean_u, mean_v), alpha[i], noise)
        sums[:] = 0.0
        add_alone(cells, lines * columns, 0.0, 1.0, scratch[0], sums)
        total = sums[2, 2] * components[:, 0].sum()  # Σσ² times all shares
        sums *= components[components[:, 1] == 0.0, 0].sum()
        for k in range(len(components)):
            factor, length = components[k, 0], components[k, 1]
            if length > 0.0:
                add_correlated(cells, grid, (tall, wide), length, factor, scratch, sums)
        n, uu, uv, vv = counts[i], counts[i] * rays[i, 2], counts[i] * rays[i, 3], counts[i] * rays[i, 4]
        measured = (moments[0], moments[3], moments[4], moments[5]) if is_exact else (n, uu, uv, vv)
        write_covariance(
            moments, sums, total, rays[i, 0] - u - mean_u, rays[i, 1] - v - mean_v, measured, covariances[i]
        )
        if with_freedom:
            covariances[i, FREEDOM] = degrees_of_freedom(cells, grid, 3, components, factors, scratch)
