"""Segmentation, last stage: every pixel goes to the plane it fits.

A block whose whole neighbourhood is one region hands its pixels to it. In the other blocks the regions of
the neighbourhood contend for each pixel. Where two planes are far apart, the residual averaged over the pixel
and its neighbours decides; where both fit within the noise, which is along the line in which they meet, the
side of that line decides: it is the one thing there that is free of noise.
"""

import math

import numpy as np

from ._jit import kernel
from .segment_blocks import fit, residual, sensor_variance, variance, waviness

NEIGHBOURS = 9
# Missing pixels in a row that still are holes in a surface.
GAP = 3


@kernel()
def planes(moments, sigma, lateral_x, lateral_y, growth, alpha, slope_variance, spread):
    """Plane of each region, and the part of a pixel's variance that its slope makes.

    A region without a plane gets an α of infinities, which no pixel fits.
    """
    for i in range(len(moments)):
        if not fit(moments[i], alpha[i]):
            alpha[i, :] = math.inf
            slope_variance[i] = 1.0
            spread[i] = 1.0
            continue
        spread[i] = waviness(moments[i, 0], growth) ** 2
        slope_variance[i] = variance(moments[i], alpha[i], sigma, lateral_x, lateral_y) - sensor_variance(
            moments[i, 3] / moments[i, 0], sigma
        )


@kernel()
def contenders(region, row, column, block, tan_x, tan_y, candidate, centre):
    """The regions in the 3x3 blocks around one, and where their blocks lie: mean (u, v) of the centres.

    Returns how many.
    """
    rows, columns = region.shape
    height, width = tan_x.shape
    count = 0
    for r in range(max(row - 1, 0), min(row + 2, rows)):
        for c in range(max(column - 1, 0), min(column + 2, columns)):
            a = region[r, c]
            if a < 0:
                continue
            i = 0
            while i < count and candidate[i] != a:
                i += 1
            if i == count:
                candidate[i] = a
                centre[i, :] = 0.0
                count += 1
            y = min(r * block + block // 2, height - 1)
            x = min(c * block + block // 2, width - 1)
            centre[i, 0] += tan_x[y, x]
            centre[i, 1] += tan_y[y, x]
            centre[i, 2] += 1.0
    for i in range(count):
        centre[i, 0] /= centre[i, 2]
        centre[i, 1] /= centre[i, 2]
    return count


@kernel()
def misfit(m, alpha):
    """Sum of squared residuals of the pixels in some moments about a given plane."""
    a, b, c = alpha[0], alpha[1], alpha[2]
    return (
        m[9] - 2.0 * (a * m[6] + b * m[8] + c * m[3])
        + a * (a * m[4] + 2.0 * (b * m[5] + c * m[1]))
        + b * (b * m[7] + 2.0 * c * m[2])
        + c * c * m[0]
    )  # fmt: skip


@kernel()
def misfits(q, u, v, n, side, alpha, deviation, limit, square, sums, mean):
    """Squared residuals of a block and its rim against one plane, in variances, and their 3x3 means.

    Parameters
    ----------
    q, u, v : (side²,) float64
        Pixels of the block and the one-pixel rim around it; q is 0 where nothing was measured.
    n : (side²,) float64
        Measured pixels in the 3x3 around each.
    square : (side²,) float64, written
        Cut off at ``limit``, so that pixels beyond a depth jump do not outweigh the others; 0 where nothing
        was measured.
    sums : (side²,) float64
        Room to work in.
    mean : (side²,) float64, written
        Over the measured pixels of the 3x3 around a pixel of the block.
    """
    scale = 1.0 / deviation
    a, b, c = alpha[0] * scale, alpha[1] * scale, alpha[2] * scale
    for i in range(side * side):
        e = q[i] * scale - (a * u[i] + b * v[i] + c)
        square[i] = min(e * e, limit) if q[i] > 0.0 else 0.0
    for i in range(side, side * (side - 1)):
        sums[i] = square[i - side] + square[i] + square[i + side]
    for i in range(side + 1, side * (side - 1) - 1):
        mean[i] = (sums[i - 1] + sums[i] + sums[i + 1]) / n[i]


@kernel()
def gather(inverse_depth, tan_x, tan_y, top, left, side, q, u, v, sums, n):
    """Copy a block and its rim; what is outside the image counts as not measured."""
    height, width = inverse_depth.shape
    if top >= 0 and left >= 0 and top + side <= height and left + side <= width:
        for i in range(side):
            for j in range(side):
                q[i * side + j] = inverse_depth[top + i, left + j]
                u[i * side + j] = tan_x[top + i, left + j]
                v[i * side + j] = tan_y[top + i, left + j]
    else:
        for i in range(side):
            for j in range(side):
                inside = 0 <= top + i < height and 0 <= left + j < width
                q[i * side + j] = inverse_depth[top + i, left + j] if inside else 0.0
                u[i * side + j] = tan_x[top + i, left + j] if inside else 0.0
                v[i * side + j] = tan_y[top + i, left + j] if inside else 0.0
    for i in range(side, side * (side - 1)):
        sums[i] = 0.0
        for k in (i - side, i, i + side):
            sums[i] += 1.0 if q[k] > 0.0 else 0.0
    for i in range(side + 1, side * (side - 1) - 1):
        n[i] = max(sums[i - 1] + sums[i] + sums[i + 1], 1.0)


@kernel()
def find_lines(count, candidate, centre, alpha, line):
    """Where the planes of two contending regions meet between the regions.

    ``line`` (K, K, 4) is written for each pair i < j: the line's coefficients, positive on j's side, and 1;
    or zeros where the planes do not meet between the two.
    """
    for j in range(1, count):
        b = alpha[candidate[j]]
        for i in range(j):
            a = alpha[candidate[i]]
            d_u, d_v, d_1 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
            side_i = d_u * centre[i, 0] + d_v * centre[i, 1] + d_1
            side_j = d_u * centre[j, 0] + d_v * centre[j, 1] + d_1
            sign = 0.0
            if side_i * side_j < 0.0:
                sign = 1.0 if side_j > 0.0 else -1.0
            line[i, j, 0] = sign * d_u
            line[i, j, 1] = sign * d_v
            line[i, j, 2] = sign * d_1
            line[i, j, 3] = abs(sign)


@kernel()
def find_alone(region, alone):
    """Mark the blocks whose eight neighbours are of their own region, inside the image."""
    rows, columns = region.shape
    alone[:] = False
    for row in range(1, rows - 1):
        above, own, below = region[row - 1], region[row], region[row + 1]
        for column in range(1, columns - 1):
            a = own[column]
            alone[row, column] = (
                (own[column - 1] == a) & (own[column + 1] == a)
                & (above[column - 1] == a) & (above[column] == a) & (above[column + 1] == a)
                & (below[column - 1] == a) & (below[column] == a) & (below[column + 1] == a)
            )  # fmt: skip


@kernel()
def write_block(label, inverse_depth, top, left, block, a):
    """Label a block's measured pixels."""
    for y in range(top, min(top + block, label.shape[0])):
        for x in range(left, min(left + block, label.shape[1])):
            label[y, x] = a if inverse_depth[y, x] > 0.0 else -1


@kernel()
def is_far_from_others(a, count, candidate, alpha, tan_x, tan_y, top, left, block, distance):
    """Whether region a's plane is farther than ``distance`` from all other contenders' all over a block.

    Planes are, so it is enough to look at the corners.
    """
    bottom = min(top + block, tan_x.shape[0]) - 1
    right = min(left + block, tan_x.shape[1]) - 1
    for i in range(count):
        b = candidate[i]
        if b == a:
            continue
        d_u, d_v, d_1 = alpha[b, 0] - alpha[a, 0], alpha[b, 1] - alpha[a, 1], alpha[b, 2] - alpha[a, 2]
        nearer = d_u * tan_x[top, left] + d_v * tan_y[top, left] + d_1 > 0.0
        for y in (top, bottom):
            for x in (left, right):
                d = d_u * tan_x[y, x] + d_v * tan_y[y, x] + d_1
                if not (d if nearer else -d) > distance:
                    return False
    return True


@kernel()
def own_pixels(
    inverse_depth, tan_x, tan_y, block, region, alpha, slope_variance, spread, sigma, reach, close, settled,
    cut, block_moments, is_last, label, moments, squares,
):  # fmt: skip
    """Give each pixel to a region, or to none, and sum the moments of what each region owns.

    Parameters
    ----------
    inverse_depth : (H, W) float64
        0 where there is no measurement.
    region : (R, C) int64
        Region of each block, or -1; a block becomes, on return, the region that owns most of its pixels.
    alpha, slope_variance, spread : (N, 3), (N,), (N,) float64
        Of `planes`.
    sigma : see `segment_blocks.sensor_variance`
    reach : float
        A region contends for a pixel within so many standard deviations of its plane.
    close : float
        Two planes meet where both fit a pixel's neighbourhood within so many standard deviations.
    settled : float
        A block without rivals goes whole to a region that fits it within so many standard deviations.
    cut : float
        Squared residuals count in ``squares`` as so many variances at most.
    block_moments : (R, C, 10) float64
    is_last : bool
        Whether to write ``label``.
    label : (H, W) int32, written
        Region of each pixel, or -1.
    moments : (N, 10) float64, written
    squares : (N,) float64, written
        Sum of each region's squared residuals, in variances.
    """
    height, width = inverse_depth.shape
    rows, columns = region.shape
    limit = reach * reach
    close_square = close * close
    side = block + 2
    candidate = np.empty(NEIGHBOURS, np.int64)
    centre = np.empty((NEIGHBOURS, 3))
    square = np.empty((NEIGHBOURS, side * side))
    mean = np.empty((NEIGHBOURS, side * side))
    penalty = np.empty(NEIGHBOURS)
    owned = np.empty(NEIGHBOURS, np.int64)
    line = np.empty((NEIGHBOURS, NEIGHBOURS, 4))
    q, u, v = np.empty(side * side), np.empty(side * side), np.empty(side * side)
    n, sums = np.empty(side * side), np.empty(side * side)
    before = region.copy()
    alone = np.empty((rows, columns), np.bool_)
    find_alone(before, alone)
    moments[:] = 0.0
    squares[:] = 0.0
    for row in range(rows):
        top = row * block
        for column in range(columns):
            left = column * block
            a = before[row, column]
            pixels = block_moments[row, column, 0]
            if alone[row, column] and (a < 0 or pixels == 0.0):
                if is_last:
                    write_block(label, inverse_depth, top, left, block, -1)
                continue
            if pixels == 0.0:
                if is_last:
                    write_block(label, inverse_depth, top, left, block, -1)
                region[row, column] = -1
                continue
            m = block_moments[row, column]
            sensor = sensor_variance(m[3] / pixels, sigma)
            count = 1
            candidate[0] = a
            if not alone[row, column]:
                count = contenders(before, row, column, block, tan_x, tan_y, candidate, centre)
                if count == 1:
                    a = candidate[0]
            if a >= 0:
                total = (sensor + slope_variance[a]) * spread[a]
                error = misfit(m, alpha[a]) / total
                if error <= settled * settled * pixels and is_far_from_others(
                    a, count, candidate, alpha, tan_x, tan_y, top, left, block, reach * math.sqrt(total)
                ):
                    if is_last:
                        write_block(label, inverse_depth, top, left, block, a)
                    for k in range(10):
                        moments[a, k] += m[k]
                    squares[a] += max(error, 0.0)
                    region[row, column] = a
                    continue

            bottom, right = min(top + block, height), min(left + block, width)
            gather(inverse_depth, tan_x, tan_y, top - 1, left - 1, side, q, u, v, sums, n)
            find_lines(count, candidate, centre, alpha, line)
            for i in range(count):
                a = candidate[i]
                total = (sensor + slope_variance[a]) * spread[a]
                penalty[i] = math.log(total)
                owned[i] = 0
                misfits(q, u, v, n, side, alpha[a], math.sqrt(total), limit, square[i], sums, mean[i])
            for y in range(top, bottom):
                for x in range(left, right):
                    p = (y - top + 1) * side + x - left + 1
                    winner = choose(p, u[p], v[p], count, line, square, mean, penalty, limit, close_square)
                    if q[p] == 0.0 or winner < 0:
                        if is_last:
                            label[y, x] = -1
                        continue
                    a = candidate[winner]
                    if is_last:
                        label[y, x] = a
                    owned[winner] += 1
                    squares[a] += min(square[winner, p], cut * cut)
                    add(moments[a], u[p], v[p], q[p])
            # A thin region may own most of no block: a block stays with a region that owns a quarter of it.
            most = 0
            for i in range(1, count):
                if owned[i] > owned[most]:
                    most = i
            for i in range(count):
                if candidate[i] == before[row, column] and 4 * owned[i] >= pixels:
                    most = i
            region[row, column] = candidate[most] if owned[most] > 2 else -1


@kernel()
def choose(p, u, v, count, line, square, mean, penalty, limit, close):
    """Which of the contending regions gets pixel ``p``, or -1."""
    winner = -1
    for i in range(count):
        if not square[i, p] < limit:
            continue
        if winner < 0:
            winner = i
        elif line[winner, i, 3] > 0.0 and mean[i, p] < close and mean[winner, p] < close:
            if line[winner, i, 0] * u + line[winner, i, 1] * v + line[winner, i, 2] > 0.0:
                winner = i
        elif mean[i, p] + penalty[i] < mean[winner, p] + penalty[winner]:
            winner = i
    return winner


@kernel()
def add(m, u, v, q):
    """Add a pixel to moments."""
    m[0] += 1.0
    m[1] += u
    m[2] += v
    m[3] += q
    m[4] += u * u
    m[5] += u * v
    m[6] += u * q
    m[7] += v * v
    m[8] += v * q
    m[9] += q * q


@kernel()
def root_of(parent, i):
    """The oldest ancestor."""
    while parent[i] != i:
        i = parent[i]
    return i


@kernel()
def unite(parent, i, j):
    """Make two sets one; the older root stays."""
    i, j = root_of(parent, i), root_of(parent, j)
    if i < j:
        parent[j] = i
    elif j < i:
        parent[i] = j


@kernel()
def find_runs(label, number, inverse_depth, run_row, run_start, run_stop, run_label, vertical, parent, loose):
    """Runs of equal labels along the rows, united into connected parts.

    Runs touch corner to corner or side by side, also across up to GAP pixels that no region owns.

    Parameters
    ----------
    label : (H, W) int32
        Below 0 is none; renumbered on return.
    number : (N,) int64
        New number of each label, below 0 for none.
    run_row, run_start, run_stop, run_label : (K,) int32, written
        Row, first column, last column + 1 and label of each run.
    vertical : (K,) int32, written
        How many of a run's pixels have no pixel of the same label above, missing pixels between them aside.
    parent : (K,) int32, written
        Roots stand for parts.
    loose : (L,) int32, written
        Measured pixels without a label: row · W + column.

    Returns
    -------
    tuple of int
        Number of runs, and of loose pixels.
    """
    height, width = label.shape
    runs = 0
    loose_count = 0
    row_first = 0  # first run of the row above
    two_first = 0  # and of the one above that
    above_label = np.full(width, -1, np.int32)
    above_row = np.full(width, -GAP - 2, np.int32)
    for y in range(height):
        for x in range(width):
            if label[y, x] >= 0:
                label[y, x] = number[label[y, x]]
        this_first = runs
        x = 0
        while x < width:
            a = label[y, x]
            if a < 0:
                if inverse_depth[y, x] > 0.0:
                    loose[loose_count] = y * width + x
                    loose_count += 1
                    above_label[x] = -1
                x += 1
                continue
            start = x
            starts = 0
            while x < width and label[y, x] == a:
                if above_label[x] != a or y - above_row[x] > GAP + 1:
                    starts += 1
                above_label[x] = a
                above_row[x] = y
                x += 1
            run_row[runs] = y
            run_start[runs] = start
            run_stop[runs] = x
            run_label[runs] = a
            vertical[runs] = starts
            parent[runs] = runs
            if runs > this_first and run_label[runs - 1] == a and start - run_stop[runs - 1] <= GAP:
                unite(parent, runs, runs - 1)
            runs += 1
        for lines in range(1, 3):
            first, stop = (row_first, this_first) if lines == 1 else (two_first, row_first)
            if first < stop and run_row[first] < y - lines:
                continue
            j = first
            for i in range(this_first, runs):
                while j < stop and run_stop[j] < run_start[i]:
                    j += 1
                k = j
                while k < stop and run_start[k] <= run_stop[i]:
                    if run_label[k] == run_label[i] and (
                        lines == 1 or label[y - 1, max(run_start[i], run_start[k]) % width] < 0
                    ):
                        unite(parent, i, k)
                    k += 1
        two_first = row_first
        row_first = this_first
    return runs, loose_count


@kernel()
def measure_parts(
    run_row, run_start, run_stop, run_label, vertical, parent, runs, part, inverse_depth, tan_x, tan_y,
    alpha, deviation, cut, region_moments, region_squares, moments, squares, size, across, down, owner,
):  # fmt: skip
    """Number the parts in the order of their first pixels, and share out what the regions own.

    The largest part of a region gets its moments less those of the other parts, whose pixels are counted.

    Parameters
    ----------
    part : (K,) int32, written
        Part of each run.
    region_moments, region_squares : (N, 10), (N,) float64
        Of `own_pixels`; changed.
    moments, squares : (P, 10), (P,) float64, written
    size, across, down : (P,) int64, written
        Pixels of each part, runs along its rows and runs along its columns.
    owner : (P,) int64, written
        Region that each part is of.

    Returns
    -------
    int
        Number of parts.
    """
    count = 0
    for i in range(runs):
        root = root_of(parent, i)
        if root == i:
            part[i] = count
            size[count] = 0
            across[count] = 0
            down[count] = 0
            squares[count] = 0.0
            moments[count, :] = 0.0
            owner[count] = run_label[i]
            count += 1
        else:
            part[i] = part[root]
        k = part[i]
        size[k] += run_stop[i] - run_start[i]
        down[k] += vertical[i]
        # A run that goes on after a short gap is one run.
        goes_on = (
            i > 0
            and run_row[i - 1] == run_row[i]
            and run_label[i - 1] == run_label[i]
            and run_start[i] - run_stop[i - 1] <= GAP
        )
        across[k] += 0 if goes_on else 1
    largest = np.full(len(region_moments), -1, np.int64)
    for k in range(count):
        a = owner[k]
        if largest[a] < 0 or size[k] > size[largest[a]]:
            largest[a] = k
    for i in range(runs):
        k = part[i]
        a = owner[k]
        if largest[a] == k:
            continue
        y = run_row[i]
        for x in range(run_start[i], run_stop[i]):
            q = inverse_depth[y, x]
            u, v = tan_x[y, x], tan_y[y, x]
            e = (q - (alpha[a, 0] * u + alpha[a, 1] * v + alpha[a, 2])) / deviation[a]
            squares[k] += min(e * e, cut * cut)
            add(moments[k], u, v, q)
    for k in range(count):
        a = owner[k]
        if largest[a] != k:
            region_squares[a] -= squares[k]
            for j in range(10):
                region_moments[a, j] -= moments[k, j]
    for k in range(count):
        a = owner[k]
        if largest[a] == k:
            squares[k] = region_squares[a]
            moments[k] = region_moments[a]
    return count


@kernel()
def write_labels(
    run_row, run_start, run_stop, runs, part, number, why, missing, unclaimed, inverse_depth,
    loose, loose_count, needed, label, reason, sizes,
):  # fmt: skip
    """Write the final labels and the reasons, and let stray pixels go with their neighbours.

    Parameters
    ----------
    number : (P,) int32
        Final label of each part, 0 for none.
    why : (P,) uint8
        Reason of each part; ``missing`` and ``unclaimed`` are those of the other pixels.
    loose, loose_count
        Of `find_runs`. One goes with a label that ``needed`` or more of its eight neighbours have.
    label, reason : (H, W) int32 and uint8, written
    sizes : (N + 1,) int32, written
        Pixels of each label.
    """
    height, width = label.shape
    sizes[:] = 0
    i = 0
    for y in range(height):
        x = 0
        while x < width:
            is_run = i < runs and run_row[i] == y
            stop = run_start[i] if is_run else width
            for gap in range(x, stop):
                label[y, gap] = 0
                reason[y, gap] = unclaimed if inverse_depth[y, gap] > 0.0 else missing
            x = stop
            if is_run:
                k = part[i]
                label[y, x : run_stop[i]] = number[k]
                reason[y, x : run_stop[i]] = why[k]
                sizes[number[k]] += run_stop[i] - x
                x = run_stop[i]
                i += 1
    found = np.empty(loose_count, np.int32)
    for _ in range(2):
        for i in range(loose_count):
            y, x = loose[i] // width, loose[i] % width
            found[i] = label[y, x]
            if label[y, x] > 0 or y == 0 or x == 0 or y == height - 1 or x == width - 1:
                continue
            for k in range(4):  # more than half of eight must hold one of the first four
                a = label[y - 1, x - 1 + k] if k < 3 else label[y, x - 1]
                if a <= 0:
                    continue
                n = 0
                for r in range(y - 1, y + 2):
                    for c in range(x - 1, x + 2):
                        n += label[r, c] == a
                if n >= needed:
                    found[i] = a
                    break
        for i in range(loose_count):
            if found[i] > 0:
                if label[loose[i] // width, loose[i] % width] == 0:
                    sizes[found[i]] += 1
                label[loose[i] // width, loose[i] % width] = found[i]
                reason[loose[i] // width, loose[i] % width] = 0


@kernel()
def final_planes(moments, alpha, rss):
    """α and the sum of squared residuals of each plane from the moments of its pixels."""
    for i in range(len(moments)):
        fit(moments[i], alpha[i])
        rss[i] = residual(moments[i])
