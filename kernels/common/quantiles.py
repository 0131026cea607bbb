"""Quantiles, by selection."""

import math

import numpy as np

from .._jit.kernel import kernel
from .arrays import copy


@kernel()
def quantile(values, share):
    """As `numpy.quantile`, for two values or more and a ``share`` below 1."""
    position = share * (len(values) - 1)
    k = int(position)
    weight = position - k
    # Of the values, those among which the k-th is, and the smallest above them. NaN counts as equal to any.
    part, count, following = np.empty(len(values) + 1), len(values), math.inf
    copy(values, part[:count])
    while True:
        pivot = part[count // 2]
        below = above = 0
        for i in range(count):
            below += part[i] < pivot
            above += part[i] > pivot
        kept = 0
        if k < below:
            for i in range(count):  # without branches, which no processor could predict
                value = part[i]
                part[kept] = value
                kept += value < pivot
            following = pivot
        elif k >= count - above:
            for i in range(count):
                value = part[i]
                part[kept] = value
                kept += value > pivot
            k -= count - above
        else:
            break
        count = kept
    if k + 1 < count - above:
        following = pivot
    else:
        for i in range(count):
            following = min(following, part[i] if part[i] > pivot else math.inf)
    return pivot + weight * (following - pivot)
