"""What the noise does to surfaces: covariances of their parameters, and the residual that is to be expected."""

import math

import numpy as np

from .._jit.kernel import kernel
from ..solvers.cholesky import factorise, invert
from ..statistics.correlated_errors import (
    FEW_CELLS,
    FILLED,
    MOST_CELLS,
    add_alone,
    add_correlated,
    degrees_of_freedom,
    product,
    trace_of_product,
)
from ..statistics.correlation_cells import sum_of_products
from .quadric import BLOCK, CYLINDER, PARAMETERS, evaluate, parameters_of

# Rows of cells: σ's share times the derivatives, σ's share, and the number of pixels.
SHARE, COUNT = PARAMETERS, PARAMETERS + 1
CELLS = PARAMETERS + 2
SCRATCH = CELLS + PARAMETERS + 7


@kernel()
def grid_of(places):
    """First row and column of pixels, how many of each, and the logarithm of the side of the cells they are put in."""
    rows, columns = places
    top, left, bottom, right = rows[0], columns[0], rows[0], columns[0]
    for i in range(len(rows)):
        top, bottom = min(top, rows[i]), max(bottom, rows[i])
        left, right = min(left, columns[i]), max(right, columns[i])
    tall, wide, shift = bottom + 1 - top, right + 1 - left, 0
    while (len(rows) >> 2 * shift) > FILLED or (((tall - 1) >> shift) + 1) * (((wide - 1) >> shift) + 1) > MOST_CELLS:
        shift += 1
    return top, left, tall, wide, shift


@kernel()
def add_derivatives(label, surface, kind, is_shared, grid, work, normal, alone, cells):
    """Add Σ J Jᵀ over the pixels of a label, that of their independent errors, and the sums over cells.

    Parameters
    ----------
    label : pixels, weights, shares, places
        See `write_errors`.
    surface : (SURFACE,) float64
    kind : int
    is_shared : bool
        Whether sums over cells are wanted.
    grid : (top, left, columns, shift)
    work : (PARAMETERS + 1, BLOCK) float64
    normal, alone : (P, P) float64, added to
        The second is weighted with 1 - share², the share of the variance that no neighbour has a part in.
    cells : (CELLS, MOST_CELLS) float64, added to

    Returns
    -------
    independent : float
        The sum of these shares.
    """
    (us, vs, qs), weights, shares, (rows, columns) = label
    top, left, across, shift = grid
    number, f, independent = parameters_of(kind), 0.0 if kind == CYLINDER else 1.0, 0.0
    weighted = np.empty(BLOCK)
    for begin in range(0, len(us), BLOCK):
        end = min(begin + BLOCK, len(us))
        count = end - begin
        evaluate(us, vs, qs, weights, begin, end, surface, f, work)
        if is_shared:
            for i in range(begin, end):
                if weights[i] == 0.0:
                    continue
                cell = ((rows[i] - top) >> shift) * across + ((columns[i] - left) >> shift)
                share = shares[i]
                for j in range(number):
                    cells[j, cell] += share * work[j, i - begin]
                cells[SHARE, cell] += share
                cells[COUNT, cell] += 1.0
        for i in range(begin, end):
            independent += 1.0 - shares[i] * shares[i] if weights[i] > 0.0 else 0.0
        for j in range(number):
            for i in range(count):
                weighted[i] = (1.0 - shares[begin + i] ** 2) * work[j, i]
            for k in range(j + 1):
                normal[j, k] += sum_of_products(work[j], work[k], count)
                alone[j, k] += sum_of_products(weighted, work[k], count)
    for j in range(number):
        for k in range(j):
            normal[k, j], alone[k, j] = normal[j, k], alone[j, k]
    return independent


@kernel()
def write_errors(label, surface, kind, components, room, covariance):
    """Write the covariance of a surface's parameters, A⁻¹BA⁻¹; returns the residual's expected value and freedom.

    Parameters
    ----------
    label : pixels, weights, shares, places
        Of one label: us, vs and qs (M,) float64 each; 1/σ, 0 for outliers, and what neighbours may share, (M,) float64;
        rows and columns, (M,) int32 each.
    surface : (SURFACE,) float64
    kind : int
    components : (C, 2) float64
        Shares of the variance along the ray, which may add up to more than 1, and how far they are correlated, in
        pixels: 0 for what is independent.
    room : work, cells, scratch, factors
        (PARAMETERS + 1, BLOCK), (CELLS, MOST_CELLS), (SCRATCH, 2 * MOST_CELLS) and (C, 2, FEW_CELLS) float64.
    covariance : (PARAMETERS, PARAMETERS) float64, written
        Zeros beyond the parameters that the kind has.

    Returns
    -------
    expected, freedom : float
        Of the sum of squared residuals over their variances: its mean, and how many degrees of freedom a chi-square of
        the same mean and variance has (Satterthwaite 1946). NaN where the pixels determine no surface.
    """
    work, cells, scratch, factors = room
    places, number, count = label[3], parameters_of(kind), 0.0
    for weight in label[1]:
        count += weight > 0.0
    top, left, tall, wide, shift = grid_of(places)
    lines, columns = ((tall - 1) >> shift) + 1, ((wide - 1) >> shift) + 1
    is_shared = False
    for k in range(len(components)):
        is_shared |= components[k, 1] > 0.0
    if is_shared:
        cells[:, : lines * columns] = 0.0
    normal, alone, sums, lower, inverse = np.zeros((5, number, number))
    grid = top, left, columns, shift
    independent = add_derivatives(label, surface, kind, is_shared, grid, work, normal, alone, cells)
    covariance[:] = 0.0
    if not factorise(normal, number, 0.0, lower):
        return math.nan, math.nan
    invert(lower, number, scratch[0], inverse)
    whole, part = components[:, 0].sum(), independent / count
    expected, freedom = (whole + (1.0 - whole) * part) * (count - number), count - number
    if is_shared:
        add_alone(cells, lines * columns, 0.0, 1.0, scratch[0], sums)
        sums *= components[components[:, 1] == 0.0, 0].sum()
        grid_size = lines, columns, shift
        for k in range(len(components)):
            share, length = components[k, 0], components[k, 1]
            if length > 0.0:
                add_correlated(cells, grid_size, (tall, wide), length, share, scratch, sums)
        correlated = whole * (count - independent) - trace_of_product(inverse, sums)
        found = degrees_of_freedom(cells, grid_size, number, components, factors, scratch)
        if found > 0.0 and correlated > 0.0:
            # Half the variance of a quadratic form is tr((RC)²); with an independent part, C is C₁ + part·I.
            alone_left = part * (count - number)
            expected = correlated + alone_left
            freedom = expected * expected / (correlated * correlated / found + part * (2.0 * correlated + alone_left))
        else:  # errors are alike all over the label: nothing is known of their size
            freedom = 1.0
    else:
        sums[:] = whole * (normal - alone)
    sums += alone
    covariance[:number, :number] = product(product(inverse, sums), inverse)
    return expected, freedom


@kernel()
def write_errors_of_labels(pixels, places, first, weighing, surfaces, components, covariances, chances):
    """`write_errors` of each of K labels and kind.

    Parameters
    ----------
    pixels, places, first
        As `fit.fit_labels` takes them, and the rows and columns (2, M) int32.
    weighing : weights, shares, (M,) float64
    surfaces : (K, 3, SURFACE) float64
    components : (C, 2) float64
    covariances : (K, 3, PARAMETERS, PARAMETERS) float64, written
    chances : (K, 3, 2) float64, written
        Expected sum of squares, and its degrees of freedom.
    """
    weights, shares = weighing
    room = (
        np.empty((PARAMETERS + 1, BLOCK)),
        np.empty((CELLS, MOST_CELLS)),
        np.empty((SCRATCH, 2 * MOST_CELLS)),
        np.empty((len(components), 2, FEW_CELLS)),
    )
    covariances[:] = math.nan
    chances[:] = math.nan
    for k in range(len(first) - 1):
        part = slice(first[k], first[k + 1])
        label = (
            (pixels[0, part], pixels[1, part], pixels[2, part]),
            weights[part],
            shares[part],
            (places[0, part], places[1, part]),
        )
        for kind in range(3):
            if surfaces[k, kind, 0] == surfaces[k, kind, 0]:
                chances[k, kind] = write_errors(label, surfaces[k, kind], kind, components, room, covariances[k, kind])
