"""A part of an image as the cells of a grid over it, and what errors that neighbours share do to sums over them."""

import math

from .._jit.kernel import kernel
from .noise_variances import FALLOFF, variance_at

# In correlation lengths: errors farther apart share nothing.
REACH = 3.5


@kernel(reduction=True)
def add_to_cell(rays, run, share, middle, cells, cell, moments):
    """Add a share of the pixels of a run of a row to a cell and to the moments."""
    us, vs = rays
    start, stop = run
    middle_u, middle_v = middle
    s_u = s_v = s_uu = s_uv = s_vv = 0.0
    for k in range(start, stop):
        u, v = us[k] - middle_u, vs[k] - middle_v
        s_u += u
        s_v += v
        s_uu += u * u
        s_uv += u * v
        s_vv += v * v
    n = share * (stop - start)
    add_sums((n, share * s_u, share * s_v, share * s_uu, share * s_uv, share * s_vv), cells, cell, moments)


@kernel(inline=True)
def add_sums(sums, cells, cell, moments):
    """Add n, Σu, Σv, Σu², Σuv and Σv² to the moments, and the first three to a cell."""
    for i in range(6):
        moments[i] += sums[i]
    cells[0, cell] += sums[1]
    cells[1, cell] += sums[2]
    cells[3, cell] += sums[0]


@kernel()
def sums_before(values, middle, sums):
    """Write, before each column and behind the last, the sums of the values less their ``middle``, and of squares."""
    sums[:, 0] = 0.0
    for x in range(len(values)):
        value = values[x] - middle
        sums[0, x + 1] = sums[0, x] + value
        sums[1, x + 1] = sums[1, x] + value * value


@kernel()
def add_runs(runs, part, image_rays, middle, before, grid, cells, moments):
    """Add the pixels of a part of the image to its cells, and to moments.

    Parameters
    ----------
    runs : PixelRuns
    part : (begin, end)
        The runs to add.
    image_rays : tan_x and tan_y, (H, W) float64, or (1, W) and (H, 1)
    middle : (u, v)
        A ray, about which all sums are, so that little cancels.
    before : (2, W + 1) float64
        `sums_before` of the only row of ``tan_x``; (2, 0) where there are more.
    grid : (top, left, columns, shift)
        First row and column of the part in the image, columns of cells, and the logarithm of their side: it is
        2^shift pixels.
    cells : (4, K) float64
        Added to: Σu, Σv, nothing, and the number of pixels.
    moments : (6,) float64
        Added to: n, Σu, Σv, Σu², Σuv, Σv².
    """
    _, rows, starts, stops, shares = runs
    begin, end = part
    tan_x, tan_y = image_rays
    top, left, columns, shift = grid
    for k in range(begin, end):
        y, x, stop, share = rows[k], starts[k], stops[k], shares[k]
        first = ((y - top) >> shift) * columns
        while x < stop:
            column = (x - left) >> shift
            cell, until = first + column, min(left + ((column + 1) << shift), stop)
            if before.shape[1] > 0:
                n, v = share * (until - x), tan_y[y, 0] - middle[1]
                s_u, s_uu = share * (before[0, until] - before[0, x]), share * (before[1, until] - before[1, x])
                add_sums((n, s_u, n * v, s_uu, v * s_u, n * v * v), cells, cell, moments)
            else:
                add_to_cell((tan_x[y], tan_y[y]), (x, until), share, middle, cells, cell, moments)
            x = until


@kernel()
def weigh(cells, number, middle, mean, alpha, noise):
    """Sums over the pixels of each cell of σ·(u - ū), σ·(v - v̄) and σ, in place of those of u and v.

    The ``mean`` ray (ū, v̄) is relative to the ``middle`` that `add_runs` took.
    """
    middle_u, middle_v = middle
    mean_u, mean_v = mean
    a, b, c, falloff = alpha[0], alpha[1], alpha[2], noise[FALLOFF]
    for k in range(number):
        n = cells[3, k]
        cells[2, k] = 0.0
        if n > 0.0:
            u, v = cells[0, k] / n, cells[1, k] / n
            ray_u, ray_v = u + middle_u, v + middle_v
            variance = variance_at(a * ray_u + b * ray_v + c, noise)
            if falloff > 0.0:
                variance *= (1.0 + ray_u * ray_u + ray_v * ray_v) ** falloff
            weight = math.sqrt(variance) * n
            cells[0, k], cells[1, k], cells[2, k] = weight * (u - mean_u), weight * (v - mean_v), weight


@kernel()
def spread_out(cells, rows, columns, shift_y, shift_x, stride, wider):
    """Sum up 2^``shift_y`` by 2^``shift_x`` cells into wider ones, with zeros after each row, up to ``stride``."""
    wider[:, : (((rows - 1) >> shift_y) + 1) * stride] = 0.0
    for i in range(len(cells)):
        source, target = cells[i], wider[i]
        for row in range(rows):
            begin, to = row * columns, (row >> shift_y) * stride
            for column in range(columns):
                target[to + (column >> shift_x)] += source[begin + column]


@kernel()
def shared_by_cells(length, side, cells, along):
    """Write what the errors of cells ``side`` pixels wide share, 0, 1, 2, ... cells apart; return how many do."""
    reach = min(math.ceil(min(REACH * length / side, float(cells))) + 1, cells)  # lengths may be beyond whole numbers
    for d in range(reach):
        total = 0.0
        for h in range(1 - side, side):
            lag = (d * side + h) / length
            total += (side - abs(h)) * math.exp(-0.5 * lag * lag)
        along[d] = total / (side * side)
    return reach


@kernel(inline=True)
def add_shifted(values, number, apart, factor, total):
    """Add ``factor`` times the values that come so far after each of a ``number`` of them; before, if it is below 0."""
    source, target = values[max(apart, 0) : number + min(apart, 0)], total[max(-apart, 0) : number - max(apart, 0)]
    for k in range(len(source)):
        target[k] += factor * source[k]


@kernel()
def smooth(values, number, stride, along_y, along_x, both_ways, across, smoothed):
    """Write Σ factor·value over all cells for each cell: factors along y times those along x, by how far these are.

    Rows of cells follow one another in ``values``, ``stride`` apart, with as many zeros between them as ``along_x`` is
    long, less one. So all are shifted at once, and their ends find zeros beside them. If not ``both_ways``, only rows
    below a cell's count, and half of its row: the others follow from these, since factors are symmetric. ``across`` is
    scratch memory.
    """
    across[:number] = 0.0
    add_shifted(values, number, 0, along_x[0], across)
    for d in range(1, len(along_x)):
        add_shifted(values, number, d, along_x[d], across)
        add_shifted(values, number, -d, along_x[d], across)
    smoothed[:number] = 0.0
    add_shifted(across, number, 0, along_y[0] if both_ways else 0.5 * along_y[0], smoothed)
    for d in range(1, len(along_y)):
        add_shifted(across, number, d * stride, along_y[d], smoothed)
        if both_ways:
            add_shifted(across, number, -d * stride, along_y[d], smoothed)


@kernel(reduction=True)
def sum_of_products(a, b, number):
    """Sum of the products of so many pairs."""
    total = 0.0
    for k in range(number):
        total += a[k] * b[k]
    return total


@kernel(reduction=True)
def weighted_product(a, b, weights, number):
    """Sum of the products of so many pairs, each with its weight."""
    total = 0.0
    for k in range(number):
        total += weights[k] * a[k] * b[k]
    return total
