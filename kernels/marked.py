"""Where marks are, of which most are none."""

from ._jit import kernel

# Marks that are tested together.
WORD = 8


@kernel(inline="compiled")
def in_words(count):
    """``count``, or as many more as fill whole words."""
    return -(-count // WORD) * WORD


@kernel(inline="compiled")
def list_marked(marks, words, mark, where):
    """Write where ``marks``, (K,) of one byte that fill whole words, are ``mark``, not 0; returns how many are.

    ``words`` are the same marks as uint64: a view costs counted references. ``where`` has room for K + 1: the place
    after the last is written to, too.
    """
    count = 0
    for w in range(len(words)):
        if words[w] == 0:
            continue
        for k in range(w * WORD, (w + 1) * WORD):  # without branches, which no processor could predict
            where[count] = k
            count += marks[k] == mark
    return count


@kernel(inline="compiled")
def list_both(marks, words, mark, where, other, elsewhere):
    """As `list_marked`, in one pass, for ``mark`` and an ``other``, which goes ``elsewhere``; returns both counts."""
    count = other_count = 0
    for w in range(len(words)):
        if words[w] == 0:
            continue
        for k in range(w * WORD, (w + 1) * WORD):
            where[count] = elsewhere[other_count] = k
            count += marks[k] == mark
            other_count += marks[k] == other
    return count, other_count
