"""Least squares of the motion from matches of tiles, and how far errors of planes could feign what they say."""

from .._jit.kernel import kernel

SUMS = 7  # of a group: Σw, Σw², and Σw·m·mᵀ as xx, xy, xz, yy, yz; zz is Σw


@kernel(inline=True, arrays=False)
def add_to_group(sums, g, w, u, v):
    """Add a match of weight w at a ray (u, v) to the SUMS of its group."""
    sums[g, 0] += w
    sums[g, 1] += w * w
    sums[g, 2] += w * u * u
    sums[g, 3] += w * u * v
    sums[g, 4] += w * u
    sums[g, 5] += w * v * v
    sums[g, 6] += w * v


@kernel(inline=True, arrays=False)
def inverse_of_mean(sums, g, width):
    """The inverse of the mean of m·mᵀ over a group's tiles of a width, as xx, xy, xz, yy, yz, zz."""
    share, within = 1.0 / sums[g, 0], width * width / 12.0  # rays differ within a tile, too
    x, y = sums[g, 4] * share, sums[g, 6] * share
    # What is left of the first two rows once the last, whose entry is 1, is eliminated.
    xx, xy, yy = sums[g, 2] * share + within - x * x, sums[g, 3] * share - x * y, sums[g, 5] * share + within - y * y
    scale = 1.0 / (xx * yy - xy * xy)
    ixx, ixy, iyy = yy * scale, -xy * scale, xx * scale
    ixz, iyz = -(ixx * x + ixy * y), -(ixy * x + iyy * y)
    return ixx, ixy, ixz, iyy, iyz, 1.0 - (ixz * x + iyz * y)


@kernel(inline=True, arrays=False)
def mirror(matrix):
    """Copy what lies below the diagonal above it."""
    for row in range(len(matrix)):
        for column in range(row):
            matrix[column, row] = matrix[row, column]


@kernel(arrays=False)
def normal_equations(matches, frame, scale, rules, weights, sums, systems, right):
    """Sum the matches, robustly weighted (Geman and McClure 1987).

    Parameters
    ----------
    matches : (M, COLUMNS) float64
    frame : (tiles, groups, counts, planes)
        (N, 6) float64; (N,) intp, the group of each tile; (G,) intp, how many tiles each group has; the groups before
        this number are planes, the others tiles by themselves.
    scale : float
        Standard deviation of a residual, 1/m.
    rules : (robust, common)
        Residual in standard deviations at which a weight is a quarter; share of the variance that tiles of a group have
        in common.
    weights : (M,) float64
        Written.
    sums : (G, SUMS) float64
        Written.
    systems : (2, 6, 6) float64
        Written: Σw·J·Jᵀ of tiles on planes, and of the others.
    right : (6,) float64
        Written: Σw·J·r.
    """
    tiles, groups, counts, planes = frame
    robust, common = rules
    sums[:] = 0.0
    systems[:] = 0.0
    right[:] = 0.0
    narrow = 1.0 / (robust * scale)
    for k in range(len(matches)):
        i = int(matches[k, 7])
        g, u, v, r = groups[i], tiles[i, 0], tiles[i, 1], matches[k, 6]
        off = 1.0 + (r * narrow) * (r * narrow)
        w = 1.0 / (off * off * (1.0 + common * counts[g]))
        weights[k] = w
        add_to_group(sums, g, w, u, v)
        part = int(g >= planes)
        for row in range(6):
            derivative = w * matches[k, row]
            right[row] += derivative * r
            for column in range(row + 1):
                systems[part, row, column] += derivative * matches[k, column]
    for part in range(2):
        mirror(systems[part])


@kernel(arrays=False)
def feigned_systems(sums, planes, errors, width, systems):
    """What errors of the groups' α alone are expected to add to the normal equations.

    α counts as off by what a fit of the matches' tiles leaves, and by a common share and a turn of the normal.

    Parameters
    ----------
    sums : (G, SUMS) float64
        Of `normal_equations`.
    planes : int
        The groups before this number are planes.
    errors : (fitted, common, turned)
        Variances, in 1/m²: of a residual, for each of the tiles that a group's matches amount to; what all tiles of a
        group share; of each component of α.
    width : float
        Of a tile, as a tangent.
    systems : (2, 6, 6) float64
        Written: of tiles on planes, and of the others; of steps in units of the depth whose inverse is the mean of m·α.
    """
    fitted, common, turned = errors
    systems[:] = 0.0
    for g in range(len(sums)):
        weight = sums[g, 0]
        if not weight > 0.0:
            continue
        ixx, ixy, ixz, iyy, iyz, izz = inverse_of_mean(sums, g, width)
        share = 1.0 / weight
        x, y = sums[g, 4] * share, sums[g, 6] * share
        variance = weight * (fitted * sums[g, 1] * share * share + common)
        added = weight * turned
        a, b, c = ixx * variance + added, ixy * variance, ixz * variance
        d, e, f = iyy * variance + added, iyz * variance, izz * variance + added
        part = systems[int(g >= planes)]
        # [m]ₓ C, of the mean ray m = (x, y, 1), and from it [m]ₓ C [m]ₓᵀ.
        p00, p01, p02 = y * c - b, y * e - d, y * f - e
        p10, p11, p12 = a - x * c, b - x * e, c - x * f
        p20, p21, p22 = x * b - y * a, x * d - y * b, x * e - y * c
        part[0, 0] += y * p02 - p01
        part[1, 0] += p00 - x * p02
        part[2, 0] += x * p01 - y * p00
        part[1, 1] += p10 - x * p12
        part[2, 1] += x * p11 - y * p10
        part[2, 2] += x * p21 - y * p20
        part[3, 0] += p00
        part[4, 0] += p01
        part[5, 0] += p02
        part[3, 1] += p10
        part[4, 1] += p11
        part[5, 1] += p12
        part[3, 2] += p20
        part[4, 2] += p21
        part[5, 2] += p22
        part[3, 3] += a
        part[4, 3] += b
        part[5, 3] += c
        part[4, 4] += d
        part[5, 4] += e
        part[5, 5] += f
    for part in range(2):
        mirror(systems[part])


@kernel(arrays=False)
def sum_crosses(matches, frame, weights, sums, crosses):
    """Sum matches by groups.

    Parameters
    ----------
    matches : (M, COLUMNS) float64
    frame : (tiles, groups, counts, planes)
    weights : (M,) float64
    sums : (G, SUMS) float64
        Written.
    crosses : (G, 6, 3) float64
        Written: Σw·J·mᵀ.
    """
    tiles, groups, _, _ = frame
    sums[:] = 0.0
    crosses[:] = 0.0
    for k in range(len(matches)):
        i = int(matches[k, 7])
        g, w = groups[i], weights[k]
        u, v = tiles[i, 0], tiles[i, 1]
        add_to_group(sums, g, w, u, v)
        for j in range(6):
            derivative = w * matches[k, j]
            crosses[g, j, 0] += derivative * u
            crosses[g, j, 1] += derivative * v
            crosses[g, j, 2] += derivative


@kernel(arrays=False)
def spread_of_right(sums, crosses, single, shared, width, spread):
    """Covariance of Σw·J·r, with errors of single tiles and of groups.

    Errors of single tiles count as if all of a group had the same squares: Σw²JJᵀ follows from the slopes along it.

    Parameters
    ----------
    sums : (G, SUMS) float64
    crosses : (G, 6, 3) float64
    single, shared : float
        Variances of a residual: of each tile's own errors, and of the errors of all that a group has.
    width : float
        Of a tile, as a tangent.
    spread : (6, 6) float64
        Written.
    """
    spread[:] = 0.0
    for g in range(len(sums)):
        weight = sums[g, 0]
        if not weight > 0.0:
            continue
        xx, xy, xz, yy, yz, zz = inverse_of_mean(sums, g, width)
        variance = (single * sums[g, 1] / weight + shared * weight) / weight
        for row in range(6):
            a, b, c = crosses[g, row, 0], crosses[g, row, 1], crosses[g, row, 2]
            x, y, z = xx * a + xy * b + xz * c, xy * a + yy * b + yz * c, xz * a + yz * b + zz * c
            for column in range(row + 1):
                form = x * crosses[g, column, 0] + y * crosses[g, column, 1] + z * crosses[g, column, 2]
                spread[row, column] += variance * form
    mirror(spread)
