"""Segmentation: what each region owns, as runs of blocks along their rows and shares of MIXED ones, united into parts.

No pixel is looked at: which ones a share has is one bit for each, and so is where it goes on in the next block.
"""

import numpy as np

from ._jit import kernel
from .disjoint_sets import unite
from .segment_blocks import BLOCK, MIXED

# Share of a run of whole blocks: none.
WHOLE = np.int32(-1)
# Pixels of a block, of its upper row, and of its left column: bit BLOCK·y + x is pixel (y, x).
ALL = np.int32((1 << BLOCK * BLOCK) - 1)
TOP = np.int32((1 << BLOCK) - 1)
LEFT = np.int32(sum(1 << BLOCK * y for y in range(BLOCK)))
# By how many bits a pixel is from the one on its right, from the one below, and from one side of a block to the other.
RIGHT_BY, DOWN_BY = np.int32(1), np.int32(BLOCK)
ACROSS, DOWN = np.int32(BLOCK - 1), np.int32(BLOCK * (BLOCK - 1))
# Missing pixels in a row that still are holes in a surface.
GAP = 3
# From either side of them so many, at least.
BESIDE = (GAP + 1) // 2
# First run of a block that has none.
NONE = np.int32(-1)


@kernel(inline=True)
def how_many(pixels):
    """Number of pixels of a block."""
    pairs = pixels - ((pixels >> np.int32(1)) & np.int32(0x5555))
    fours = (pairs & np.int32(0x3333)) + ((pairs >> np.int32(2)) & np.int32(0x3333))
    eights = (fours + (fours >> np.int32(4))) & np.int32(0x0F0F)
    return (eights + (eights >> np.int32(8))) & np.int32(0x1F)


@kernel(inline=True)
def in_squares(pixels):
    """Those pixels of a share that are one of four in a square of 2x2: they are not alone."""
    corner = pixels & (pixels & ~LEFT) >> RIGHT_BY
    corner &= corner >> DOWN_BY
    across = corner | corner << RIGHT_BY
    return across | across << DOWN_BY


@kernel(inline=True)
def filled_across(pixels, measured):
    """Pixels of a share, and missing ones beside them in a row; or, if nobody else has any, all of a row with one."""
    if pixels == measured:
        return ((pixels | pixels >> np.int32(1) | pixels >> np.int32(2) | pixels >> np.int32(3)) & LEFT) * TOP
    for _ in range(BESIDE):
        pixels |= (((pixels & ~LEFT) >> RIGHT_BY) | ((pixels << RIGHT_BY) & ~LEFT)) & ALL & ~measured
    return pixels


@kernel(inline=True)
def filled_down(pixels, measured):
    """The same of columns."""
    if pixels == measured:
        return (
            (pixels | pixels >> np.int32(4) | pixels >> np.int32(8) | pixels >> np.int32(12)) & TOP
        ) * LEFT
    for _ in range(BESIDE):
        pixels |= ((pixels >> DOWN_BY) | (pixels << DOWN_BY)) & ALL & ~measured
    return pixels


@kernel(inline=True)
def starts_across(pixels):
    """How many runs along its rows a share has."""
    return how_many(pixels & ~((pixels << RIGHT_BY) & ~LEFT))


@kernel(inline=True)
def starts_down(pixels):
    """How many runs along its columns it has."""
    return how_many(pixels & ~(pixels << DOWN_BY))


@kernel(inline=True)
def meet_across(left, right):
    """The pixels of a block's left column that have one of the block to the left beside them, or corner to corner."""
    a = (left >> ACROSS) & LEFT
    return right & (a | (a << DOWN_BY) | (a >> DOWN_BY))


@kernel(inline=True)
def meet_down(above, below):
    """The same of a block's upper row and the block above."""
    a = above >> DOWN
    return below & (a | (a << RIGHT_BY) | (a >> RIGHT_BY)) & TOP


@kernel(inline=True)
def meet_at_corner(above, below, side):
    """The same of blocks corner to corner; ``side`` is -1 if the one above is to the left, 1 to the right."""
    if side < 0:
        return (above >> (DOWN + ACROSS)) & below & np.int32(1)
    return (above >> DOWN) & (below >> ACROSS) & np.int32(1)


@kernel()
def meet_over_gap(one, missing_one, other, missing_other, side):
    """Whether pixels of two blocks meet over at most GAP missing pixels: side by side if ``side``, or down."""
    for step in range(GAP + 1):
        a, b = one, other
        for _ in range(step):
            a |= ((a << RIGHT_BY) & ~LEFT if side else a << DOWN_BY) & missing_one
        for _ in range(GAP - step):
            b |= ((b & ~LEFT) >> RIGHT_BY if side else b >> DOWN_BY) & missing_other
        if (meet_across(a, b) if side else meet_down(a, b)) != 0:
            return True
    return False


@kernel(inline=True)
def list_runs(
    owner, first_share, shares_of, measured, share_region, share_pixels, number, top, width, count, start, stop, share,
    label, filled_x, filled_y, across, down, parent, at, many, loose, loose_count,
):  # fmt: skip
    """Write the runs of a row of blocks after the first ``count``, and its loose pixels; how many there are of each.

    ``at`` (C,) and ``many`` (C,) int32 are written: the first run of each block, and how many it has. ``top`` is the
    first row of pixels; the other arguments are fields of `Owners`, of that row, `Shares` and `Runs`.
    """
    columns = len(owner)
    column = 0
    while column < columns:
        left = column
        column += 1
        b = owner[left]
        at[left], many[left] = NONE, 0
        if b >= 0:
            a = number[b]
            if a < 0:
                continue
            at[left], many[left] = count, 1
            while column < columns and owner[column] >= 0 and number[owner[column]] == a:
                at[column], many[column] = count, 1
                column += 1
            start[count], stop[count], share[count], label[count] = left, column, WHOLE, a
            filled_x[count], filled_y[count], parent[count] = ALL, ALL, count
            across[count], down[count] = BLOCK, BLOCK * (column - left)
            count += 1
        elif b == MIXED:
            first = count
            taken = np.int32(0)
            for s in range(first_share[left], first_share[left] + shares_of[left]):
                taken |= share_pixels[s] if number[share_region[s]] >= 0 else np.int32(0)
            for s in range(first_share[left], first_share[left] + shares_of[left]):
                a = number[share_region[s]]
                if a < 0:
                    continue
                start[count], stop[count], share[count], label[count] = left, column, s, a
                filled_x[count] = filled_across(share_pixels[s], measured[left])
                filled_y[count] = filled_down(share_pixels[s], measured[left])
                across[count], down[count] = starts_across(filled_x[count]), starts_down(filled_y[count])
                parent[count] = count
                for k in range(first, count):  # regions that have become one
                    if label[k] == a:
                        unite(parent, count, k)
                count += 1
            others = measured[left] & ~taken
            many[left] = count - first
            if count > first:
                at[left] = first
            for p in range(BLOCK * BLOCK if others != 0 else 0):
                if (others >> np.int32(p)) & 1:
                    loose[loose_count] = (top + p // BLOCK) * width + left * BLOCK + p % BLOCK
                    loose_count += 1
    return count, loose_count


@kernel()
def find_runs(owners, shares, number, width, runs, loose):
    """Runs of equal labels along the rows of blocks, united into connected parts.

    Parameters
    ----------
    owners : Owners
    shares : Shares
    number : (N,) int64
        Label of each region, below 0 for none.
    width : int
        Of the image.
    runs : Runs, written
        But for ``part``.
    loose : (L,) int32, written
        Measured pixels without a label: row · W + column.

    Returns
    -------
    tuple of int
        Number of runs, and of loose pixels.
    """
    # All by names of their own: to look into a tuple within a loop costs more than most of what is done there.
    owner, _, first_share, shares_of, measured = owners
    share_region, share_pixels, _ = shares
    first, start, stop, share, label, filled_x, filled_y, across, down, parent, _ = runs
    rows, columns = owner.shape
    # Of the blocks of this row, and of the one above: see `list_runs`; with a rim.
    here, above = np.full(columns + 2, NONE), np.full(columns + 2, NONE)
    many_here, many_above = np.zeros(columns + 2, np.int32), np.zeros(columns + 2, np.int32)
    changes = np.zeros(columns, np.bool_)
    count = loose_count = 0
    for row in range(rows):
        first[row] = count
        here, above = above, here
        many_here, many_above = many_above, many_here
        count, loose_count = list_runs(
            owner[row], first_share[row], shares_of[row], measured[row], share_region, share_pixels, number,
            row * BLOCK, width, count, start, stop, share, label, filled_x, filled_y, across, down, parent,
            here[1:-1], many_here[1:-1], loose, loose_count,
        )  # fmt: skip
        # Where a block's runs and those above are those of the block before, there is nothing new.
        for c in range(columns):
            changes[c] = (
                (here[c] != here[c + 1]) | (many_here[c + 1] > 1) | (above[c] != above[c + 1])
                | (above[c + 1] != above[c + 2]) | (many_above[c + 1] > 1)
            )  # fmt: skip
        for c in range(columns):
            if not changes[c] or many_here[c + 1] == 0:
                continue
            missing = ALL & ~measured[row, c]
            for k in range(here[c + 1], here[c + 1] + many_here[c + 1]):
                a = label[k]
                own = ALL if share[k] == WHOLE else share_pixels[share[k]]
                if here[c] != here[c + 1]:
                    for j in range(here[c], here[c] + many_here[c]):
                        if label[j] != a:
                            continue
                        other = ALL if share[j] == WHOLE else share_pixels[share[j]]
                        across[k] -= how_many((filled_x[j] >> ACROSS) & filled_x[k] & LEFT)
                        if meet_across(other, own) != 0 or meet_over_gap(
                            other, ALL & ~measured[row, c - 1], own, missing, True
                        ):
                            unite(parent, j, k)
                for side in range(-1, 2):
                    d = c + 1 + side
                    for j in range(above[d], above[d] + many_above[d]):
                        if label[j] != a:
                            continue
                        other = ALL if share[j] == WHOLE else share_pixels[share[j]]
                        if side == 0:
                            if share[k] != WHOLE or share[j] != WHOLE:
                                down[k] -= how_many((filled_y[j] >> DOWN) & filled_y[k] & TOP)
                            elif c == max(start[j], start[k]):
                                down[k] -= BLOCK * (min(stop[j], stop[k]) - c)
                        if parent[j] == parent[k]:
                            continue
                        if side != 0:
                            meet = meet_at_corner(other, own, side) != 0
                        else:
                            meet = meet_down(other, own) != 0 or meet_over_gap(
                                other, ALL & ~measured[row - 1, c], own, missing, False
                            )
                        if meet:
                            unite(parent, j, k)
    first[rows] = count
    return count, loose_count
