"""Where marks are, or bits, of which most are none."""

import numpy as np

from ._jit import kernel

# Marks that are tested together.
WORD = 8


@kernel(inline="compiled")
def in_words(count):
    """``count``, or as many more as fill whole words."""
    return -(-count // WORD) * WORD


@kernel(inline=True)
def room_for_marks(count):
    """Marks for ``count`` places or more, none of them set, the same as words, and room to list them: `list_marked`."""
    marks = np.zeros(in_words(count), np.bool_)
    return marks, marks.view(np.uint64), np.empty(len(marks) + 1, np.int32)


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


@kernel(inline="compiled")
def how_many(bits):
    """Number of bits that are set."""
    # Steps that the compiler knows: in 64 bits, it makes them one instruction of the processor.
    bits = np.uint64(bits)
    bits -= (bits >> np.uint64(1)) & np.uint64(0x5555555555555555)
    bits = (bits & np.uint64(0x3333333333333333)) + ((bits >> np.uint64(2)) & np.uint64(0x3333333333333333))
    bits = (bits + (bits >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int32(bits * np.uint64(0x0101010101010101) >> np.uint64(56))


@kernel(inline="compiled")
def list_bits(words, where):
    """Write where ``words`` (K,) uint64 have bits: 64·word + bit, in order; returns how many they have.

    Of bytes that are seen as words, that is 8·byte + bit, and takes less time than `list_marked` if they have several.
    """
    count = 0
    for w in range(len(words)):
        bits = words[w]
        while bits != 0:
            below = ~bits & (bits - np.uint64(1))  # those lower than the lowest
            where[count] = 64 * w + how_many(below)
            count += 1
            bits &= bits - np.uint64(1)
    return count
