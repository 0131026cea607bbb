"""Segmentation: bits that stand for the pixels of a block, against plain arrays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.lib.stride_tricks import sliding_window_view

from rgbd_planes.kernels.common.union_find import root_of
from rgbd_planes.kernels.segmentation.components.runs import (
    ALL,
    GAP,
    PIECES,
    beside,
    find_runs,
    first_piece,
    how_many,
    in_squares,
    is_one_piece,
    meet_across,
    meet_at_corner,
    meet_down,
    meet_over_gap,
    spread_across,
    spread_down,
    starts_across,
    starts_down,
)
from rgbd_planes.kernels.segmentation.model.records import BLOCK, MIXED, Owners, Runs, Shares

EVERY = np.arange(1 << BLOCK * BLOCK, dtype=np.int32)
MASKS = st.integers(0, int(ALL)).map(np.int32)


def pixels_of(masks: np.ndarray) -> np.ndarray:
    """(..., BLOCK, BLOCK) bool of masks (...)."""
    bits = np.asarray(masks)[..., None] >> np.arange(BLOCK * BLOCK) & 1
    return bits.reshape(*bits.shape[:-1], BLOCK, BLOCK) == 1


def of_every_mask(function) -> np.ndarray:
    return np.array([function(mask) for mask in EVERY])


@st.composite
def shares(draw) -> tuple[np.int32, np.int32]:
    """The pixels of a share, and those of its block that are not free."""
    taken = draw(MASKS)
    return taken & draw(st.one_of(MASKS, st.just(ALL))), taken


def starts(pixels: np.ndarray) -> np.ndarray:
    """How many runs there are along the rows of blocks (..., BLOCK, BLOCK)."""
    return np.diff(pixels.astype(int), axis=-1, prepend=0).clip(0).sum(axis=(-2, -1))


def spread(pixels: np.ndarray, through: np.ndarray) -> np.ndarray:
    """What one comes to along the rows, (BLOCK, BLOCK) bool each."""
    reached = pixels.copy()
    for y, x in np.argwhere(pixels):
        for step in (-1, 1):
            c = x + step
            while 0 <= c < BLOCK and through[y, c]:
                reached[y, c] = True
                c += step
    return reached


def pieces(pixels: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Numbers of the connected pieces of a share, from 1 on, (BLOCK, BLOCK) int."""
    own = [tuple(place) for place in np.argwhere(pixels)]
    number = {place: i for i, place in enumerate(own)}
    for a in own:
        for b in own:
            (y, x), (r, c) = min(a, b), max(a, b)
            touch = max(abs(y - r), abs(x - c)) <= 1
            row = y == r and (free | pixels)[y, min(x, c) : max(x, c) + 1].all()
            column = x == c and (free | pixels)[y : r + 1, x].all()
            if touch or row or column:
                one, other = number[a], number[b]
                number = {place: min(one, other) if i in (one, other) else i for place, i in number.items()}
    found = np.zeros(pixels.shape, int)
    for place, i in number.items():
        found[place] = i + 1
    return found


def meet(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Pixels of the left column of ``other`` that touch ``one``, which is on its left, (BLOCK, BLOCK) bool each."""
    beside = np.pad(one[:, -1], 1)
    touching = np.zeros_like(other)
    touching[:, 0] = other[:, 0] & (beside[:-2] | beside[1:-1] | beside[2:])
    return touching


def meets_over_gap(one: np.ndarray, taken_one: np.ndarray, other: np.ndarray, taken_other: np.ndarray) -> bool:
    """Whether a pixel of ``one`` and one of ``other``, on its right, have a few free pixels between them at most.

    They are in one row, or in two where the blocks meet.
    """
    for y in range(BLOCK):
        for x in np.flatnonzero(one[y]):
            for r in range(max(y - 1, 0), min(y + 2, BLOCK)):
                for c in np.flatnonzero(other[r]):
                    between = np.concatenate([taken_one[y, x + 1 :], taken_other[r, :c]])
                    if len(between) <= GAP and not between.any():
                        return True
    return False


def test_pixels_of_a_share_are_counted():
    np.testing.assert_array_equal(of_every_mask(how_many), pixels_of(EVERY).sum(axis=(1, 2)))


def test_pixels_in_squares_are_not_alone():
    pixels = pixels_of(EVERY)
    corner = pixels[:, :-1, :-1] & pixels[:, :-1, 1:] & pixels[:, 1:, :-1] & pixels[:, 1:, 1:]
    expected = np.zeros_like(pixels)
    for y in range(2):
        for x in range(2):
            expected[:, y : y + BLOCK - 1, x : x + BLOCK - 1] |= corner
    np.testing.assert_array_equal(pixels_of(of_every_mask(in_squares)), expected)


def test_runs_begin_where_no_pixel_is_before():
    pixels = pixels_of(EVERY)
    np.testing.assert_array_equal(of_every_mask(starts_across), starts(pixels))
    np.testing.assert_array_equal(of_every_mask(starts_down), starts(pixels.swapaxes(1, 2)))


def test_pixels_touch_their_eight_neighbours():
    around = np.pad(pixels_of(EVERY), ((0, 0), (1, 1), (1, 1)))
    expected = sliding_window_view(around, (3, 3), axis=(1, 2)).any(axis=(3, 4))
    np.testing.assert_array_equal(pixels_of(of_every_mask(beside)), expected)


@given(pixels=MASKS, through=MASKS)
def test_pixels_spread_along_rows_and_columns(pixels, through):
    a, b = pixels_of(pixels), pixels_of(through)
    np.testing.assert_array_equal(pixels_of(spread_across(pixels, through)), spread(a, b))
    np.testing.assert_array_equal(pixels_of(spread_down(pixels, through)), spread(a.T, b.T).T)


@given(pixels=MASKS.filter(bool), others=MASKS)
def test_shares_fall_into_pieces(pixels, others):
    others &= ~pixels
    free = ALL & ~(pixels | others)
    expected = pieces(pixels_of(pixels), pixels_of(free))
    numbers = np.unique(expected[expected > 0])
    assert len(numbers) <= PIECES
    left = pixels
    for _ in numbers:
        piece = pixels_of(first_piece(left, free))
        number = expected[pixels_of(left)][0]
        # What another piece is reached over is not free for this one, so pieces that were taken do not matter.
        np.testing.assert_array_equal(piece, expected == number)
        left &= ~first_piece(left, free)
    assert left == 0


@given(pixels=MASKS.filter(bool), others=MASKS)
def test_what_has_one_run_in_each_row_and_column_is_one_piece(pixels, others):
    others &= ~pixels
    free = ALL & ~(pixels | others)
    a, b = pixels_of(pixels), pixels_of(free)
    across, down = spread(a, b), spread(a.T, b.T).T
    expected = starts(across) == a.any(axis=1).sum() and starts(down.T) == a.any(axis=0).sum()
    assert is_one_piece(pixels, free) == expected


@given(one=MASKS, other=MASKS)
def test_blocks_meet_at_sides_and_corners(one, other):
    a, b = pixels_of(one), pixels_of(other)
    np.testing.assert_array_equal(pixels_of(meet_across(one, other)), meet(a, b))
    np.testing.assert_array_equal(pixels_of(meet_down(one, other)), meet(a.T, b.T).T)
    assert bool(meet_at_corner(one, other, -1)) == (a[-1, -1] and b[0, 0])
    assert bool(meet_at_corner(one, other, 1)) == (a[-1, 0] and b[0, -1])


@given(one=shares(), other=shares())
def test_blocks_meet_over_gaps(one, other):
    (a, taken_a), (b, taken_b) = one, other
    free = ALL & ~taken_a, ALL & ~taken_b
    images = [pixels_of(mask) for mask in (a, taken_a, b, taken_b)]
    assert meet_over_gap(a, free[0], b, free[1], True) == meets_over_gap(*images)
    assert meet_over_gap(a, free[0], b, free[1], False) == meets_over_gap(*(image.T for image in images))


@pytest.mark.parametrize("gap", range(2 * BLOCK - 1))
def test_no_gap_is_wider_than_so_many_pixels(gap):
    for left in range(max(gap - BLOCK + 1, 0), min(gap, BLOCK - 1) + 1):  # free pixels in the first block
        row = np.int32(1) << np.int32(BLOCK - 1 - left), np.int32(1) << np.int32(gap - left)
        column = (np.int32(1) << np.int32(BLOCK * (BLOCK - 1 - left)), np.int32(1) << np.int32(BLOCK * (gap - left)))
        for (one, other), side in ((row, True), (column, False)):
            assert meet_over_gap(one, ALL & ~one, other, ALL & ~other, side) == (gap <= GAP)


@pytest.mark.parametrize(("number", "parts"), [((0, 0), 1), ((0, 1), 2)])
def test_shares_of_one_block_are_connected_if_their_regions_have_become_one(number, parts):
    """Of three blocks in a row each outer one's region has half of the middle one, and nothing else connects them."""
    left, right = np.int32(0x3333), np.int32(0xCCCC)
    owners = Owners(*np.array([[[0, MIXED, 1]], [[0, 0, 0]], [[0, 2, 0]], [[0, ALL, 0]]], np.int32))
    shares = Shares(np.array([0, 1], np.int32), np.array([left, right]), np.empty((2, 10)))
    runs = Runs(np.empty(2, np.int32), *(np.empty(3 + 2 * PIECES, np.int32) for _ in Runs._fields[1:]))
    count, loose = find_runs(owners, shares, np.array(number), BLOCK, 3 * BLOCK, runs, np.empty(48, np.int32))
    assert (count, loose) == (4, 0)
    assert len({root_of(runs.parent, i) for i in range(count)}) == parts
    assert runs.across[:count].sum() == parts * BLOCK
    assert runs.down[:count].sum() == 3 * BLOCK
