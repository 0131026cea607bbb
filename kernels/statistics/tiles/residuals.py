"""What the squared residuals of a block of tiles may be, and how many degrees of freedom they have."""

import numpy as np

from ..._jit.kernel import kernel
from ..distributions import chi_square
from .block import (
    BETWEEN,
    BY_COUNT,
    ERROR,
    FOUND,
    INDEPENDENT,
    MEAN_Q,
    PER_FREEDOM,
    RATIO,
    ROUNDING,
    SHARED,
    TABLE_COLUMNS,
    TILES_AT_ONCE,
    UNEVENNESS,
    D,
)


@kernel(inline=True)
def by_count(counts, tables, block):
    """Copy each tile's row of ``tables`` into the block; without rows, errors are independent."""
    if tables.shape[0] == 0:
        for i in range(TILES_AT_ONCE):
            freedom = block[0, i] - 3.0
            freedom = freedom if freedom > 0.0 else 0.0
            block[BY_COUNT, i] = freedom
            block[BY_COUNT + 1, i] = freedom
            for k in range(2, TABLE_COLUMNS):
                block[BY_COUNT + k, i] = 1.0
    else:
        found = block[FOUND : FOUND + TABLE_COLUMNS].reshape(TABLE_COLUMNS * TILES_AT_ONCE)
        for i in range(counts.shape[0]):
            row = tables[np.int64(counts[i])]
            a, b, c, d, e, f = row[0], row[1], row[2], row[3], row[4], row[5]
            found[TABLE_COLUMNS * i] = a
            found[TABLE_COLUMNS * i + 1] = b
            found[TABLE_COLUMNS * i + 2] = c
            found[TABLE_COLUMNS * i + 3] = d
            found[TABLE_COLUMNS * i + 4] = e
            found[TABLE_COLUMNS * i + 5] = f
        for i in range(TILES_AT_ONCE):
            for k in range(TABLE_COLUMNS):
                block[BY_COUNT + k, i] = found[TABLE_COLUMNS * i + k]


@kernel(inline=True)
def residual_ratio(block):
    """Sum of squared residuals over its expected value, and one over its degrees of freedom, into the block.

    With C and P as in `assess` and the variance a of errors that are independent, half the variance of the sum is
    tr((PC + a·P)²) = tr((PC)²) + 2a·tr(PC) + a²·tr(P).
    """
    for i in range(TILES_AT_ONCE):
        n = block[0, i]
        shared, independent = block[SHARED, i], block[INDEPENDENT, i] + block[BETWEEN, i]
        freedom = n - 3.0
        independent_part = independent * (freedom if freedom > 0.0 else 0.0)
        shared_part = shared * block[BY_COUNT, i]
        expected = shared_part + independent_part
        expected = expected if expected > 1e-150 else 1e-150
        half_variance = shared * shared * block[BY_COUNT + 1, i] + independent * (2.0 * shared_part + independent_part)
        # rmse_metric is d·Z̄·rmse, as `methods.range_planes` has it. Three pixels fit exactly. One division instead of
        # two.
        square = block[D, i] * block[D, i]
        inverse = 1.0 / (expected * square)
        error = block[ERROR, i] * block[MEAN_Q, i]
        block[RATIO, i] = (n if n > 3.0 else 0.0) * error * error * inverse
        share = inverse * square
        inverse = half_variance * share * share
        block[PER_FREEDOM, i] = min(max(inverse, 1e-9), 1.0 / chi_square.LEAST_FREEDOM)


@kernel(inline=True)
def uneven_freedom(block):
    """Fewer degrees of freedom where variances differ: by their mean square over the square of their mean."""
    for i in range(TILES_AT_ONCE):
        if not block[UNEVENNESS, i] > 0.0:
            continue
        share = (block[SHARED, i] + block[ROUNDING, i]) / max(block[SHARED, i] + block[INDEPENDENT, i], 1e-150)
        more = max(block[UNEVENNESS, i] * block[UNEVENNESS, i] - 1.0, 0.0) * share * share
        block[PER_FREEDOM, i] = min(block[PER_FREEDOM, i] * (1.0 + more), 1.0 / chi_square.LEAST_FREEDOM)
