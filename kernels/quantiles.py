"""Quantiles, by selection."""

from ._jit import kernel


@kernel(inline=True)
def bring_forward(values, first, stop, pivot, equal):
    """Move values below the pivot, or also those ``equal`` to it, to a part's front; returns where the rest begins.

    Without branches, which no processor could predict. NaN counts as equal, so that a part is never left as it is.
    """
    front = first
    for i in range(first, stop):
        value = values[i]
        values[i] = values[front]
        values[front] = value
        front += not (value > pivot) if equal else value < pivot
    return front


@kernel()
def quantile(values, share):
    """As `numpy.quantile`, for two values or more and a ``share`` below 1; ``values`` (N,) is reordered."""
    position = share * (len(values) - 1)
    k = int(position)
    first, stop = 0, len(values)
    while stop - first > 1:
        pivot = values[(first + stop) // 2]
        front = bring_forward(values, first, stop, pivot, False)
        if k < front:
            stop = front
            continue
        first = bring_forward(values, front, stop, pivot, True)
        if k < first:  # it is the pivot
            break
    following = values[k + 1]
    for i in range(k + 2, len(values)):
        following = min(following, values[i])
    return values[k] + (position - k) * (following - values[k])
