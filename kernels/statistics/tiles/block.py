"""Row layout of the scratch buffer in which a block of tiles is worked on: 61 rows of 64 tiles."""

import numpy as np

from ..._jit.kernel import kernel

# Tiles of a block, and its rows: moments, reference points, planes and residuals; 1/n and the mean inverse depth;
# variances; what follows from the number of pixels.
TILES_AT_ONCE = 64
U_0, V_0, W_0 = 10, 11, 12
N_X, N_Y, N_Z, D, ERROR = 13, 14, 15, 16, 17
PER_PIXEL, MEAN_Q, SHARED, INDEPENDENT = 18, 19, 20, 21
BY_COUNT, TABLE_COLUMNS = 22, 6
# The results; until they are written the covariances' rows hold other things.
P, ALPHA, PLANE, ANGLE, OFFSET = 28, 29, 35, 45, 46
RATIO, PER_FREEDOM = P, P + 1
ROOT = PER_FREEDOM  # its square root, in its place
POSITION, FOUND, STEP, BEND = P, P + 1, P + 2, P + 3
LIMIT, DEVIATE = P + 2, P + 4
LATERAL, SPREAD = PLANE, PLANE + 3
ROUNDING, UNEVENNESS, WEIGHTED = 47, 48, 49
BETWEEN, COMMON = 54, 55
POWER, SLOPE_U, SLOPE_V = 58, 59, 60
ROWS = 61
# Rows of ``pixel_terms``: what may be known of each tile's pixels beyond their moments, as means over them.
# Up to LENS_ROWS, where a lens makes rays differ over the image: variance of tanθx, covariance of tanθx and tanθy and
# variance of tanθy across the ray, in place of the variances in ``noise``.
# Up to DEPTH_ROWS, for a part of many depths: variance of q along the ray; variance of rounding, to which the variance
# across the ray is added if it is known for each pixel what a lens makes of it; how uneven their sum is, its root mean
# square over its mean; and means, weighted by that sum, of u, v, u², uv and v².
# Up to SHAPE_ROWS, for a part of any shape: the covariances of the plane by errors along the ray, in the order of
# SLOPES, WITH_MEAN and MEAN.
LENS_ROWS, DEPTH_ROWS, SHAPE_ROWS = 3, 11, 17

# Columns that `correlated_errors.shared_covariances` writes. Here, since that file takes longer to import.
SLOPES, WITH_MEAN, MEAN, EXPECTED, FREEDOM, COLUMNS = 0, 3, 5, 6, 7, 8

# Rows of the results.
P_VALUE, ALPHA_COVARIANCE, PLANE_COVARIANCE, ANGLE_STD, OFFSET_STD = 0, 1, 10, 26, 27
RESULTS = 28
# The block's row of each of them: a matrix's entries follow one another row by row.
RESULT_ROWS = np.array(
    [P]
    + [ALPHA + k for k in (0, 1, 2, 1, 3, 4, 2, 4, 5)]
    + [PLANE + k for k in (0, 1, 2, 3, 1, 4, 5, 6, 2, 5, 7, 8, 3, 6, 8, 9)]
    + [ANGLE, OFFSET]
)


@kernel(inline=True)
def load(rows, first, last, block, target):
    """Copy a block of tiles of each of ``rows`` into the buffer, from row ``target``."""
    for entry in range(rows.shape[0]):
        row, to = rows[entry, first:last], block[target + entry]
        for i in range(last - first):
            to[i] = row[i]


@kernel(inline=True)
def store(block, results, first, last):
    """Copy the block's results into ``results``, (RESULTS, N)."""
    for entry in range(RESULTS):
        row, to = block[RESULT_ROWS[entry]], results[entry, first:last]
        for i in range(last - first):
            to[i] = row[i]
