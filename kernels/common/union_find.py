"""Disjoint sets: trees in which each node names its parent, and a root itself."""

from .._jit.kernel import kernel


@kernel(inline="compiled")
def root_of(parent, i):
    """Root of the tree that ``i`` is in."""
    i = parent[i]  # most are the root or name it: the processor predicts this loop's end, not whether there is a step
    while parent[i] != i:
        i = parent[i]
    return i


@kernel(inline="compiled")
def unite(parent, i, j):
    """Make two sets one; the smaller root stays."""
    i, j = root_of(parent, i), root_of(parent, j)
    if i < j:
        parent[j] = i
    elif j < i:
        parent[i] = j
