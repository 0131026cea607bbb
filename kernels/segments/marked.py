"""Segmentation: where marks are, of which most are none."""

import numpy as np

from .._jit import kernel

# Marks that are tested together.
WORD = 8


@kernel(inline="compiled")
def list_marked(marked, where):
    """Write the indices of what is ``marked``, (K,) bool that fill whole words; returns how many there are.

    ``where`` has room for K + 1: the place after the last is written to, too.
    """
    words = marked.view(np.uint64)
    count = 0
    for w in range(len(words)):
        if words[w] == 0:
            continue
        for k in range(w * WORD, (w + 1) * WORD):  # without branches, which no processor could predict
            where[count] = k
            count += marked[k]
    return count
