"""Where marks are, or bits, against plain NumPy."""

import numpy as np
import pytest

from rgbd_planes.kernels.common.bit_marks import list_marked, lowest_bit, room_for_marks


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 1.0])
@pytest.mark.parametrize("count", [0, 1, 8, 500, 512, 513, 1100])
def test_marked_places_are_listed_in_order(count, share, rng):
    marks, words, where = room_for_marks(count)
    marks[:count] = rng.random(count) < share
    found = list_marked(marks, words, True, where)
    np.testing.assert_array_equal(where[:found], np.flatnonzero(marks))


@pytest.mark.parametrize("kind", [np.int32, np.uint64])
def test_the_lowest_bit_is_found(kind):
    for k in range(np.dtype(kind).itemsize * 8 - 1):
        assert lowest_bit(kind((1 << k) | (1 << (k // 2 + 15)))) == min(k, k // 2 + 15)
