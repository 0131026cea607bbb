"""The planes of a frame's tiles as columns of a table."""

from .._jit.kernel import kernel
from ..common.arrays import copy


@kernel()
def add_tiles(results, statistics, which, start, columns):
    """Write the results of a frame's T tiles into rows ``start`` to ``start + T``, floats in single precision.

    Parameters
    ----------
    results : planes, rmse, rmse_metric, valid_count, status; (R, C, 4) and (R, C)...
    statistics : (K, R, C) float64
        P-values, covariances and deviations, in the rows that `statistics.tiles.block` names.
    which : (U,) int64
        The rows of it that the table has.
    columns : floats, valid_counts, statuses; (6 + U, N) float32, (N,) int32 and (N,) int8, written
        The floats are nx, ny, nz, d, rmse, rmse_metric, and the statistics.
    """
    planes, rmse, rmse_metric, valid_count, status = results
    floats, valid_counts, statuses = columns
    count = status.size
    stop = start + count
    flat = planes.ravel()
    n_x, n_y, n_z, d = (floats[0, start:stop], floats[1, start:stop], floats[2, start:stop], floats[3, start:stop])
    for i in range(count):
        n_x[i] = flat[4 * i]
        n_y[i] = flat[4 * i + 1]
        n_z[i] = flat[4 * i + 2]
        d[i] = flat[4 * i + 3]
    copy(rmse.ravel(), floats[4, start:stop])
    copy(rmse_metric.ravel(), floats[5, start:stop])
    for k in range(len(which)):
        copy(statistics[which[k]].ravel(), floats[6 + k, start:stop])
    copy(valid_count.ravel(), valid_counts[start:stop])
    copy(status.ravel(), statuses[start:stop])
