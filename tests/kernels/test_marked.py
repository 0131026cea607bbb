"""Where marks are, or bits, against plain NumPy."""

import numpy as np
import pytest

from rgbd_planes.kernels.common.bit_marks import (
    WORD,
    in_words,
    list_bits,
    list_both,
    list_marked,
    lowest_bit,
    room_for_marks,
)


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 1.0])
@pytest.mark.parametrize("count", [0, 1, 8, 500, 512, 513, 1100])
def test_marked_places_are_listed_in_order(count, share, rng):
    marks, words, where = room_for_marks(count)
    marks[:count] = rng.random(count) < share
    found = list_marked(marks, words, True, where)
    np.testing.assert_array_equal(where[:found], np.flatnonzero(marks))

    both = np.zeros(in_words(count), np.int8)
    both[:count] = np.where(rng.random(count) < share, rng.integers(1, 4, count), 0)
    of_two, of_three = np.empty((2, len(both) + 1), np.int32)
    counts = list_both(both, both.view(np.uint64), 2, of_two, 3, of_three)
    np.testing.assert_array_equal(of_two[: counts[0]], np.flatnonzero(both == 2))
    np.testing.assert_array_equal(of_three[: counts[1]], np.flatnonzero(both == 3))


@pytest.mark.parametrize("words", [0, 1, 3, 65])
def test_bits_are_listed_in_order(words, rng):
    bits = rng.random((words, 8 * WORD)) < 0.1
    packed = np.packbits(bits, axis=1, bitorder="little").view(np.uint64).ravel()
    where = np.empty(bits.size, np.int32)
    found = list_bits(packed, where)
    np.testing.assert_array_equal(where[:found], np.flatnonzero(bits))


@pytest.mark.parametrize("kind", [np.int32, np.uint64])
def test_the_lowest_bit_is_found(kind):
    for k in range(np.dtype(kind).itemsize * 8 - 1):
        assert lowest_bit(kind((1 << k) | (1 << (k // 2 + 15)))) == min(k, k // 2 + 15)
