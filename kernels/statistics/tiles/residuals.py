"""What the squared residuals of a block of tiles may be, and how many degrees of freedom they have."""

import numpy as np

from ..._jit.kernel import kernel
from ..distributions import chi_square
from .block import (
    BETWEEN,
    ERROR,
    FOUND,
    INDEPENDENT,
    MEAN_Q,
    OF_COUNT,
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
def by_count(counts, tables, room):
    """What follows for each tile from its number of pixels: see ``tables`` of `assess`."""
    if tables.shape[0] == 0:
        for i in range(TILES_AT_ONCE):
            freedom = room[0, i] - 3.0
            freedom = freedom if freedom > 0.0 else 0.0
            room[OF_COUNT, i] = freedom
            room[OF_COUNT + 1, i] = freedom
            for k in range(2, TABLE_COLUMNS):
                room[OF_COUNT + k, i] = 1.0
    else:
        found = room[FOUND : FOUND + TABLE_COLUMNS].reshape(TABLE_COLUMNS * TILES_AT_ONCE)
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
                room[OF_COUNT + k, i] = found[TABLE_COLUMNS * i + k]


@kernel(inline=True)
def residual_ratio(room):
    """Sum of squared residuals over its expected value, and one over its degrees of freedom, into the room.

    With C and P as in `assess` and the variance a of errors that are independent, half the variance of the sum is
    tr((PC + a·P)²) = tr((PC)²) + 2a·tr(PC) + a²·tr(P).
    """
    for i in range(TILES_AT_ONCE):
        n = room[0, i]
        shared, independent = room[SHARED, i], room[INDEPENDENT, i] + room[BETWEEN, i]
        freedom = n - 3.0
        of_independent = independent * (freedom if freedom > 0.0 else 0.0)
        of_shared = shared * room[OF_COUNT, i]
        expected = of_shared + of_independent
        expected = expected if expected > 1e-150 else 1e-150
        half_variance = shared * shared * room[OF_COUNT + 1, i] + independent * (2.0 * of_shared + of_independent)
        # rmse_metric is d·Z̄·rmse: see ``methods.range_planes``. Three pixels fit exactly. One division instead of two.
        square = room[D, i] * room[D, i]
        inverse = 1.0 / (expected * square)
        error = room[ERROR, i] * room[MEAN_Q, i]
        room[RATIO, i] = (n if n > 3.0 else 0.0) * error * error * inverse
        share = inverse * square
        inverse = half_variance * share * share
        room[PER_FREEDOM, i] = min(max(inverse, 1e-9), 1.0 / chi_square.LEAST_FREEDOM)


@kernel(inline=True)
def uneven_freedom(room):
    """Fewer degrees of freedom where variances differ: by their mean square over the square of their mean."""
    for i in range(TILES_AT_ONCE):
        if not room[UNEVENNESS, i] > 0.0:
            continue
        share = (room[SHARED, i] + room[ROUNDING, i]) / max(room[SHARED, i] + room[INDEPENDENT, i], 1e-150)
        more = max(room[UNEVENNESS, i] * room[UNEVENNESS, i] - 1.0, 0.0) * share * share
        room[PER_FREEDOM, i] = min(room[PER_FREEDOM, i] * (1.0 + more), 1.0 / chi_square.LEAST_FREEDOM)
