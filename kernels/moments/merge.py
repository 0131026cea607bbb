"""From the moments of tiles to those of the larger tiles, or other regions, that they make up."""

from .._jit.kernel import kernel


@kernel()
def add_moments(moments, reference, row, column, wide_moments, wide_reference, wide_row, wide_column):
    """Add a tile's moments to a wider tile's, shifted to the wider tile's reference point.

    With δ the difference of the references, Σ(u + δ_u)(v + δ_v) = Σuv + δ_u Σv + δ_v Σu + n δ_u δ_v.
    """
    n = moments[0, row, column]
    s_u = moments[1, row, column]
    s_v = moments[2, row, column]
    s_w = moments[3, row, column]
    d_u = reference[0, row, column] - wide_reference[0, wide_row, wide_column]
    d_v = reference[1, row, column] - wide_reference[1, wide_row, wide_column]
    d_w = reference[2, row, column] - wide_reference[2, wide_row, wide_column]
    total = wide_moments[:, wide_row, wide_column]
    total[0] += n
    total[1] += s_u + n * d_u
    total[2] += s_v + n * d_v
    total[3] += s_w + n * d_w
    total[4] += moments[4, row, column] + d_u * (2.0 * s_u + n * d_u)
    total[5] += moments[5, row, column] + d_u * s_v + d_v * (s_u + n * d_u)
    total[6] += moments[6, row, column] + d_u * s_w + d_w * (s_u + n * d_u)
    total[7] += moments[7, row, column] + d_v * (2.0 * s_v + n * d_v)
    total[8] += moments[8, row, column] + d_v * s_w + d_w * (s_v + n * d_v)
    total[9] += moments[9, row, column] + d_w * (2.0 * s_w + n * d_w)


@kernel()
def merge_by_four(moments, reference, wide_moments, wide_reference):
    """Moments of a grid of tiles of twice the height and width.

    Parameters
    ----------
    moments, reference : (10, R, C) and (3, R, C) float64
    wide_moments, wide_reference : (10, ⌈R/2⌉, ⌈C/2⌉) and (3, ⌈R/2⌉, ⌈C/2⌉) float64, written
        The reference point is the mean of the four tiles', weighted by their valid pixels.
    """
    rows, columns = moments.shape[1:]
    for wide_row in range(wide_moments.shape[1]):
        for wide_column in range(wide_moments.shape[2]):
            row_stop = min(2 * wide_row + 2, rows)
            column_stop = min(2 * wide_column + 2, columns)
            n = u = v = w = 0.0
            for row in range(2 * wide_row, row_stop):
                for column in range(2 * wide_column, column_stop):
                    n_tile = moments[0, row, column]
                    if n_tile > 0.0:
                        n += n_tile
                        u += n_tile * reference[0, row, column]
                        v += n_tile * reference[1, row, column]
                        w += n_tile * reference[2, row, column]
            wide_moments[:, wide_row, wide_column] = 0.0
            wide_reference[0, wide_row, wide_column] = u / n if n > 0.0 else 0.0
            wide_reference[1, wide_row, wide_column] = v / n if n > 0.0 else 0.0
            wide_reference[2, wide_row, wide_column] = w / n if n > 0.0 else 0.0
            for row in range(2 * wide_row, row_stop):
                for column in range(2 * wide_column, column_stop):
                    if moments[0, row, column] > 0.0:
                        add_moments(
                            moments, reference, row, column,
                            wide_moments, wide_reference, wide_row, wide_column,
                        )  # fmt: skip


@kernel()
def merge_by_label(moments, reference, labels, wide_moments, wide_reference):
    """Moments of all tiles that share a label, label i + 1 in column i; label 0 is left out.

    Parameters
    ----------
    moments, reference : (10, 1, K) and (3, 1, K) float64
    labels : (K,) int32
    wide_moments : (10, 1, N) float64, written
    wide_reference : (3, 1, N) float64
        The reference points to sum about.
    """
    wide_moments[:] = 0.0
    for i in range(labels.shape[0]):
        if labels[i] > 0 and moments[0, 0, i] > 0.0:
            add_moments(moments, reference, 0, i, wide_moments, wide_reference, 0, labels[i] - 1)
