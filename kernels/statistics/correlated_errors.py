"""Errors that neighbours share: what they do to the planes of parts of any shape.

The covariance of a plane fitted to pixels with rays mᵢ is A⁻¹BA⁻¹ with A = Σmᵢmᵢᵀ and B = Σcᵢⱼmᵢmⱼᵀ over all pairs of
pixels, whose errors have the covariances cᵢⱼ. Here pixels are summed up by the cells of a grid over the part. Two cells
share what their pixels share on average, which is a product of factors along x and along y.
"""

import math

import numpy as np

from .._jit.kernel import kernel
from .correlation_cells import (
    add_runs,
    product_of,
    shared_by_cells,
    smooth,
    spread_out,
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
    """Add errors that each pixel has alone, their variance times ``factor``; ``weights`` (number,) are for work.

    ``filled`` is 0; or one over the pixels of a full cell, where such cells have none of them: see `apart_in_cell`.
    """
    of = cells[3]
    for k in range(number):
        n = of[k]
        weights[k] = factor * max(1.0 - n * filled, 0.0) / n if n > 0.0 else 0.0
    for i in range(3):
        for j in range(i, 3):
            made = weighted_product(cells[i], cells[j], weights, number)
            sums[i, j] += made
            if j > i:
                sums[j, i] += made


@kernel(inline=True)
def apart_in_cell(shared, pixels):
    """What a pixel does not share with the others of its cell, if the pairs of all of them share so much on average.

    Where pixels are missing, this is more of the sum than that mean, which is a full cell's, has of it.
    """
    return pixels * (1.0 - shared) / (pixels - 1.0) if pixels > 1.0 else 0.0


@kernel()
def add_correlated(cells, rows, columns, shift, tall, wide, length, factor, room, sums):
    """Add what errors of one correlation length share, Σk·Sᵢ·Sⱼᵀ over all pairs of cells.

    Parameters
    ----------
    cells : (4, rows * columns) float64
        See `correlation_cells.weigh`.
    shift : int
        Cells have sides of 2^shift pixels.
    tall, wide : int
        Pixels of the part from its first to its last row, and column.
    length, factor : float
        In pixels, and by which the result is multiplied.
    room : (8 or more, 2 * MOST_CELLS) float64
        For work.
    sums : (3, 3) float64
    """
    fewer, along_y, along_x, across, smoothed = room[:4], room[4], room[5], room[6], room[7]
    times_y, times_x = times_along(shift, tall, length), times_along(shift, wide, length)
    rows_now, columns_now = ((rows - 1) >> times_y) + 1, ((columns - 1) >> times_x) + 1
    side_y, side_x = 1 << (shift + times_y), 1 << (shift + times_x)
    reach_y = shared_by_cells(length, side_y, rows_now, along_y)
    reach_x = shared_by_cells(length, side_x, columns_now, along_x)
    stride = columns_now + reach_x - 1
    number = rows_now * stride
    spread_out(cells, rows, columns, times_y, times_x, stride, fewer)
    for j in range(3):
        smooth(fewer[j], number, stride, along_y[:reach_y], along_x[:reach_x], False, across, smoothed)
        for i in range(3):
            made = factor * product_of(fewer[i], smoothed, number)
            sums[i, j] += made
            sums[j, i] += made
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
    """tr(AB) of two (3, 3) matrices."""
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += a[i, j] * b[j, i]
    return total


@kernel()
def product(a, b):
    """AB of two (3, 3) matrices."""
    made = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                made[i, j] += a[i, k] * b[k, j]
    return made


@kernel()
def squares_of_pairs(weights, number, stride, side, components, factors, reaches, room):
    """Σcᵢⱼ² over all pairs of pixels, by what cells share.

    A product of two correlations is one, too, of a shorter length. Where both reach over more than a cell, the product
    of their means over cells is taken, as for the errors that a plane explains: of those little may remain.

    ``weights`` are the sums of σ² over cells; for the others see `freedom_of`.
    """
    along_y, along_x, across, smoothed = room[0], room[1], room[2], room[3]
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
            total += share * product_of(weights, smoothed, number)
    return total


@kernel()
def freedom_of(cells, rows, columns, shift, components, factors, room):
    """Degrees of freedom of the sum of squared residuals: its squared mean over half its variance; NaN if unknown.

    With the projection P = I - MA⁻¹Mᵀ on residuals these are tr(PC)² and tr((PC)²) = tr(C²) - 2tr(A⁻¹MᵀC²M) +
    tr((A⁻¹B)²) (Satterthwaite 1946). All of it, also A, from the same cells: little may remain of large numbers.

    Parameters
    ----------
    cells, rows, columns, shift
        See `add_correlated`.
    components : (C, 2) float64
        See `shared_covariances`.
    factors : (C, 2, FEW_CELLS) float64
        For work.
    room : (14 or more, 2 * MOST_CELLS) float64
        For work.
    """
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
    fewer, with_all, across, smoothed = room[:4], room[4:7], room[7], room[8]
    spread_out(cells, rows, columns, times, times, stride, fewer)
    with_all[:, :number] = 0.0
    for a in range(len(components)):
        if components[a, 1] > 0.0:
            along_y, along_x = factors[a, 0, : reaches[a, 0]], factors[a, 1, : reaches[a, 1]]
            for j in range(3):
                smooth(fewer[j], number, stride, along_y, along_x, True, across, smoothed)
                for k in range(number):
                    with_all[j, k] += components[a, 0] * smoothed[k]
    weights, deviations, counts = room[9], fewer[2], fewer[3]
    explained, square, inverse = np.zeros((3, 3)), np.zeros((3, 3)), np.empty((3, 3))  # B and MᵀC²M
    total = half = n = uu = uv = vv = 0.0
    for k in range(number):
        weights[k] = 0.0
        if counts[k] > 0.0:
            missing = max(1.0 - counts[k] / (side * side), 0.0)
            lost = alone + apart * missing
            weights[k] = deviations[k] ** 2 / counts[k]
            total += weights[k]
            squares = alone * (alone + 2.0 * shared) + missing * apart * (2.0 * shared - apart)
            half += squares * weights[k] ** 2 / counts[k]
            n += counts[k]
            u, v = fewer[0, k] / deviations[k], fewer[1, k] / deviations[k]
            uu += counts[k] * u * u
            uv += counts[k] * u * v
            vv += counts[k] * v * v
            for i in range(3):
                with_all[i, k] += lost * fewer[i, k] / counts[k]
            for i in range(3):
                for j in range(3):
                    explained[i, j] += fewer[i, k] * with_all[j, k]
                    square[i, j] += weights[k] * with_all[i, k] * with_all[j, k]
    if not write_inverse(n, uu, uv, vv, inverse):
        return math.nan
    half += squares_of_pairs(weights, number, stride, side, components, factors, reaches, room[10:])
    explained = product(inverse, explained)
    expected = (alone + shared) * total - explained[0, 0] - explained[1, 1] - explained[2, 2]
    half += trace_of_product(explained, explained) - 2.0 * trace_of_product(inverse, square)
    return expected * expected / half if expected > 0.0 and half > 0.0 else math.nan


@kernel()
def rescaled(moments, measured):
    """(3, 3): TCTᵀ has the variances for ``measured`` that C has for ``moments``, both as of `write_covariance`.

    With A = LLᵀ of each of them, T = L'⁻ᵀLᵀ leaves LᵀCL = L⁻¹BL⁻ᵀ as it is: C over that of independent errors.
    """
    made = np.eye(3)
    n, uu, uv, vv = measured
    first, of_first = math.sqrt(uu), math.sqrt(moments[3])
    slant, of_slant = uv / first, moments[4] / of_first
    second, of_second = math.sqrt(vv - slant * slant), math.sqrt(moments[5] - of_slant * of_slant)
    if second > 0.0 and of_second > 0.0 and n > 0.0:
        made[0, 0], made[1, 1], made[2, 2] = of_first / first, of_second / second, math.sqrt(moments[0] / n)
        made[0, 1] = (of_slant - slant * made[1, 1]) / first
    return made


@kernel()
def write_covariance(moments, sums, total, from_u, from_v, measured, made):
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
        From the mean ray to the one at which q is meant.
    measured : tuple of 4 floats
        n and the scatter again, as they are known better: these count, and of the others what C makes of them.
    """
    inverse, there = np.empty((3, 3)), np.eye(3)
    if not write_inverse(moments[0], moments[3], moments[4], moments[5], inverse):
        return
    explained = product(inverse, sums)
    covariance = product(explained, inverse)
    there[2, 0], there[2, 1] = from_u, from_v
    there = product(there, rescaled(moments, measured))
    covariance = product(product(there, covariance), there.T)
    made[SLOPES], made[SLOPES + 1], made[SLOPES + 2] = covariance[0, 0], covariance[0, 1], covariance[1, 1]
    made[WITH_MEAN], made[WITH_MEAN + 1], made[MEAN] = covariance[0, 2], covariance[1, 2], covariance[2, 2]
    made[EXPECTED] = total - (explained[0, 0] + explained[1, 1] + explained[2, 2])


@kernel()
def extent(runs, begin, end):
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
def shared_covariances(runs, tan_x, tan_y, counts, rays, alpha, noise, components, with_freedom, made):
    """Covariances of the planes of N parts by their errors along the ray.

    Parameters
    ----------
    runs : PixelRuns
        Of the parts.
    tan_x, tan_y : (H, W) float64, or (1, W) and (H, 1)
    counts : (N,) float64
        Measured pixels.
    rays : (N, 5) float64
        See `noise_variances.means_over`. Of parts whose runs say which pixels are measured, only the mean ray counts.
    alpha : (N, 3) float64
        The planes, NaN where there is none.
    noise : see `noise_variances.LATERAL_X`
    components : (C, 2) float64
        Shares of its variance, which may add up to more than 1, and how far they are correlated, in pixels: 0 for what
        is independent.
    with_freedom : bool
        Whether the last column of ``made`` is wanted, too.
    made : (N, COLUMNS) float64, written
        Variance of the slope along u, covariance of the slopes, variance of that along v; covariances of the slopes
        with q at the mean ray; its variance; the expected sum of squared residuals, and its degrees of freedom. NaN
        where there is no plane.
    """
    # An image of one row has one of tanθx with a lens, too, but not one column of tanθy.
    has_one_row = tan_x.shape[0] == 1 and tan_y.shape[1] == 1
    before = np.empty((2, tan_x.shape[1] + 1 if has_one_row else 0))  # of the row that all rows have
    shared_u = tan_x[0, tan_x.shape[1] // 2]
    if before.shape[1] > 0:
        sums_before(tan_x[0], shared_u, before)
    cells, room, sums = np.empty((4, MOST_CELLS)), np.empty((14, 2 * MOST_CELLS)), np.empty((3, 3))
    moments = np.empty(6)
    factors = np.empty((len(components), 2, FEW_CELLS))
    first = runs.first
    made[:] = math.nan
    for i in range(len(alpha)):
        begin, end = first[i], first[i + 1]
        if begin == end or math.isnan(alpha[i, 0]):
            continue
        top, left, tall, wide, pixels, is_exact = extent(runs, begin, end)
        shift = 0
        while (pixels >> 2 * shift) > FILLED or (((tall - 1) >> shift) + 1) * (((wide - 1) >> shift) + 1) > MOST_CELLS:
            shift += 1
        lines, columns = ((tall - 1) >> shift) + 1, ((wide - 1) >> shift) + 1
        cells[:, : lines * columns] = 0.0
        moments[:] = 0.0
        u, v = shared_u if before.shape[1] > 0 else rays[i, 0], rays[i, 1]
        add_runs(runs, begin, end, tan_x, tan_y, u, v, before, top, left, shift, columns, cells, moments)
        mean_u, mean_v = moments[1] / moments[0], moments[2] / moments[0]
        moments[3] -= moments[1] * mean_u
        moments[4] -= moments[1] * mean_v
        moments[5] -= moments[2] * mean_v
        weigh(cells, lines * columns, u, v, mean_u, mean_v, alpha[i], noise)
        sums[:] = 0.0
        add_alone(cells, lines * columns, 0.0, 1.0, room[0], sums)
        total = sums[2, 2] * components[:, 0].sum()  # of Σσ²
        sums *= components[components[:, 1] == 0.0, 0].sum()
        for k in range(len(components)):
            factor, length = components[k, 0], components[k, 1]
            if length > 0.0:
                add_correlated(cells, lines, columns, shift, tall, wide, length, factor, room, sums)
        n, uu, uv, vv = counts[i], counts[i] * rays[i, 2], counts[i] * rays[i, 3], counts[i] * rays[i, 4]
        measured = (moments[0], moments[3], moments[4], moments[5]) if is_exact else (n, uu, uv, vv)
        write_covariance(moments, sums, total, rays[i, 0] - u - mean_u, rays[i, 1] - v - mean_v, measured, made[i])
        if with_freedom:
            made[i, FREEDOM] = freedom_of(cells, lines, columns, shift, components, factors, room)
