"""Where marks are, or bits, of which most are none."""

import numpy as np

from .._jit.kernel import kernel

# Marks that are tested together.
WORD = 8
# Words that are looked at together, each of which becomes a bit.
WORDS = 64


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
def how_many(bits):
    """Number of bits that are set."""
    # Steps that the compiler knows: in 64 bits, it makes them one instruction of the processor.
    bits = np.uint64(bits)
    bits -= (bits >> np.uint64(1)) & np.uint64(0x5555555555555555)
    bits = (bits & np.uint64(0x3333333333333333)) + ((bits >> np.uint64(2)) & np.uint64(0x3333333333333333))
    bits = (bits + (bits >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int32(bits * np.uint64(0x0101010101010101) >> np.uint64(56))


@kernel(inline="compiled")
def lowest_bit(bits):
    """Which is the lowest bit that is set; clear it, by ``bits &= bits - 1``, and call again to visit all."""
    bits = np.uint64(bits)
    return how_many(~bits & (bits - np.uint64(1)))


@kernel(inline="compiled")
def some_of(words, start):
    """Of the WORDS words from ``start`` on, or as many as there are, a bit for each that is not 0."""
    bits = np.uint64(0)
    for k in range(min(WORDS, len(words) - start)):
        bits |= np.uint64(words[start + k] != 0) << np.uint64(k)
    return bits


@kernel(inline="compiled")
def list_marked(marks, words, mark, where):
    """Write where ``marks``, (K,) of one byte that fill whole words, are ``mark``, not 0; returns how many are.

    ``words`` are the same marks as uint64: a view costs counted references. ``where`` has room for K + 1: the place
    after the last is written to, too.
    """
    count = 0
    for start in range(0, len(words), WORDS):
        some = some_of(words, start)
        while some != 0:
            w = start + lowest_bit(some)
            some &= some - np.uint64(1)
            for k in range(w * WORD, (w + 1) * WORD):  # without branches, which no processor could predict
                where[count] = k
                count += marks[k] == mark
    return count
