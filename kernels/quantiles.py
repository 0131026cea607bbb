"""Quantiles, by selection."""

from ._jit import kernel


@kernel()
def quantile(values, share):
    """As `numpy.quantile`, for two values or more and a ``share`` below 1; ``values`` (N,) is reordered."""
    position = share * (len(values) - 1)
    k = int(position)
    first, last = 0, len(values) - 1
    while first < last:  # Hoare's selection: smaller values to the left, larger ones to the right
        pivot = values[(first + last) // 2]
        i, j = first, last
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if k <= j:
            last = j
        elif k >= i:
            first = i
        else:
            break
    following = values[k + 1]
    for i in range(k + 2, len(values)):
        following = min(following, values[i])
    return values[k] + (position - k) * (following - values[k])
