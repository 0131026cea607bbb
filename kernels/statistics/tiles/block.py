"""Where a block of tiles is worked on: what each row of its room holds, and where results come from."""

import numpy as np

from ..._jit.kernel import kernel

# Tiles of a block, and the rows of its room: moments, reference points, planes and residuals; 1/n and the mean inverse
# depth; variances; what follows from the number of pixels.
TILES_AT_ONCE = 64
U_0, V_0, W_0 = 10, 11, 12
N_X, N_Y, N_Z, D, ERROR = 13, 14, 15, 16, 17
PER_PIXEL, MEAN_Q, SHARED, INDEPENDENT = 18, 19, 20, 21
OF_COUNT, TABLE_COLUMNS = 22, 6
# What is written in the end; until then the covariances' rows are used for other things.
P, ALPHA, PLANE, ANGLE, OFFSET = 28, 29, 35, 45, 46
RATIO, PER_FREEDOM = P, P + 1
ROOT = PER_FREEDOM  # of it, in its place
POSITION, FOUND, STEP, BEND = P, P + 1, P + 2, P + 3
LIMIT, DEVIATE = P + 2, P + 4
LATERAL, SPREAD = PLANE, PLANE + 3
ROUNDING, UNEVENNESS, WEIGHTED = 47, 48, 49
BETWEEN, COMMON = 54, 55
POWER, SLOPE_U, SLOPE_V = 58, 59, 60
ROWS = 61
# Rows of what may be known of each tile's pixels beyond their moments, as means over them. Where a lens makes rays
# differ over the image: variance of tanθx, covariance of tanθx and tanθy and variance of tanθy across the ray, in place
# of those in ``noise``. And for a part of many depths: variances of q along the ray, and of rounding, to which those
# across the ray are added if it is known for each pixel what a lens makes of them; how uneven their sum is, its root
# mean square over its mean; and means, weighted by that sum, of u, v, u², uv and v². For a part of any shape, the
# covariances that errors along the ray have in all: see `correlated_errors.shared_covariances`.
OF_LENS, OF_DEPTHS, OF_SHAPE = 3, 11, 17

# Columns of what `correlated_errors.shared_covariances` writes: here, since that takes longer to import.
SLOPES, WITH_MEAN, MEAN, EXPECTED, FREEDOM, COLUMNS = 0, 3, 5, 6, 7, 8

# Rows of the results.
P_VALUE, ALPHA_COVARIANCE, PLANE_COVARIANCE, ANGLE_STD, OFFSET_STD = 0, 1, 10, 26, 27
RESULTS = 28
# Where in the room each of them is: a matrix's entries are kept row by row.
OF_RESULTS = np.array(
    [P]
    + [ALPHA + k for k in (0, 1, 2, 1, 3, 4, 2, 4, 5)]
    + [PLANE + k for k in (0, 1, 2, 3, 1, 4, 5, 6, 2, 5, 7, 8, 3, 6, 8, 9)]
    + [ANGLE, OFFSET]
)


@kernel(inline=True)
def load(rows, first, last, room, target):
    """Copy a block of tiles of each of ``rows`` into the room, from row ``target``."""
    for entry in range(rows.shape[0]):
        row, to = rows[entry, first:last], room[target + entry]
        for i in range(last - first):
            to[i] = row[i]


@kernel(inline=True)
def store(room, results, first, last):
    """Copy the block's results to where they are kept."""
    for entry in range(RESULTS):
        row, to = room[OF_RESULTS[entry]], results[entry, first:last]
        for i in range(last - first):
            to[i] = row[i]
