"""Segmentation: what each region owns, as runs of blocks along their rows and shares of MIXED ones, united into parts.

No pixel is read: the pixels of a share are one bit each, which also tells where it goes on in the next block.
"""

import numpy as np

from ..._jit.kernel import kernel
from ...common.bit_marks import how_many, lowest_bit
from ...common.union_find import unite
from ..model.records import BLOCK, MIXED

# Share of a run of whole blocks, which has none.
WHOLE = np.int32(-1)
# Pixels of a block, of its upper row, and of its left column: bit BLOCK·y + x is pixel (y, x).
ALL = np.int32((1 << BLOCK * BLOCK) - 1)
TOP = np.int32((1 << BLOCK) - 1)
LEFT = np.int32(sum(1 << BLOCK * y for y in range(BLOCK)))
# Bits from a pixel to the one on its right, to the one below, and from one side of a block to the other.
RIGHT_BY, DOWN_BY = np.int32(1), np.int32(BLOCK)
BLOCK_ACROSS, BLOCK_DOWN = np.int32(BLOCK - 1), np.int32(BLOCK * (BLOCK - 1))
# Pixels in a row, missing or without a label, that are still a hole in a surface.
GAP = 3
# Pieces that a share has at most: of any four pixels in a square only one can be alone.
PIECES = (BLOCK // 2) ** 2


@kernel(inline="compiled")
def in_squares(pixels):
    """The pixels of a share that belong to a square of 2x2 of it, and so are not alone."""
    corner = pixels & (pixels & ~LEFT) >> RIGHT_BY
    corner &= corner >> DOWN_BY
    across = corner | corner << RIGHT_BY
    return across | across << DOWN_BY


@kernel(inline="compiled")
def spread_across(pixels, through):
    """Pixels of a block, and those of the same row that can be reached from them through pixels of ``through``."""
    right = left = pixels
    for _ in range(BLOCK - 1):
        right |= (right << RIGHT_BY) & ~LEFT & through
        left |= ((left & ~LEFT) >> RIGHT_BY) & through
    return right | left


@kernel(inline="compiled")
def spread_down(pixels, through):
    """Pixels of a block, and those of the same column that can be reached from them through pixels of ``through``."""
    lower = upper = pixels
    for _ in range(BLOCK - 1):
        lower |= (lower << DOWN_BY) & through
        upper |= (upper >> DOWN_BY) & through
    return lower | upper


@kernel(inline="compiled")
def beside(pixels):
    """Pixels of a block, and those that touch them, if only at a corner."""
    across = pixels | ((pixels << RIGHT_BY) & ~LEFT & ALL) | ((pixels & ~LEFT) >> RIGHT_BY)
    return (across | (across << DOWN_BY) | (across >> DOWN_BY)) & ALL


@kernel()
def first_piece(pixels, free):
    """The connected piece with the share's first pixel; along a row or column, ``free`` pixels may lie between."""
    piece = pixels & -pixels
    grown = np.int32(0)
    while grown != piece:
        grown = piece
        reached = beside(piece) | spread_across(piece, free | pixels) | spread_down(piece, free | pixels)
        piece = reached & pixels
    return piece


@kernel(inline="compiled")
def starts_across(pixels):
    """Number of runs along a share's rows."""
    return how_many(pixels & ~((pixels << RIGHT_BY) & ~LEFT))


@kernel(inline="compiled")
def starts_down(pixels):
    """Number of runs along a share's columns."""
    return how_many(pixels & ~(pixels << DOWN_BY))


@kernel(inline="compiled")
def is_one_piece(pixels, free):
    """Whether a share has one run in each of its rows and columns, over ``free`` pixels: as good as connected."""
    rows = (pixels | pixels >> np.int32(1) | pixels >> np.int32(2) | pixels >> np.int32(3)) & LEFT
    columns = (pixels | pixels >> np.int32(4) | pixels >> np.int32(8) | pixels >> np.int32(12)) & TOP
    return (starts_across(spread_across(pixels, free)) == how_many(rows)) & (
        starts_down(spread_down(pixels, free)) == how_many(columns)
    )


@kernel(inline="compiled")
def meet_across(left, right):
    """The pixels of a block's left column that touch one of the block to the left, if only at a corner."""
    a = (left >> BLOCK_ACROSS) & LEFT
    return right & (a | (a << DOWN_BY) | (a >> DOWN_BY))


@kernel(inline="compiled")
def meet_down(above, below):
    """The pixels of a block's upper row that touch one of the block above, if only at a corner."""
    a = above >> BLOCK_DOWN
    return below & (a | (a << RIGHT_BY) | (a >> RIGHT_BY)) & TOP


@kernel(inline="compiled")
def meet_at_corner(above, below, side):
    """Whether blocks corner to corner touch; ``side`` is -1 if the one above is to the left, 1 to the right."""
    if side < 0:
        return (above >> (BLOCK_DOWN + BLOCK_ACROSS)) & below & np.int32(1)
    return (above >> BLOCK_DOWN) & (below >> BLOCK_ACROSS) & np.int32(1)


@kernel()
def meet_over_gap(one, free_one, other, free_other, across):
    """Whether pixels of two blocks meet over at most GAP free ones.

    The blocks are side by side if ``across``, else one above the other.
    """
    for step in range(GAP + 1):
        a, b = one, other
        for _ in range(step):
            a |= ((a << RIGHT_BY) & ~LEFT if across else a << DOWN_BY) & free_one
        for _ in range(GAP - step):
            b |= ((b & ~LEFT) >> RIGHT_BY if across else b >> DOWN_BY) & free_other
        if (meet_across(a, b) if across else meet_down(a, b)) != 0:
            return True
    return False


@kernel()
def list_runs(
    owner, first_share, shares_of, measured, share_region, share_pixels, number, top, height, width, count, start, stop,
    share, pixels, label, filled_x, filled_y, across, down, parent, at, many, taken, loose, loose_count,
):  # fmt: skip
    """Write the runs of a row of blocks after the first ``count``, and its loose pixels; returns the numbers of both.

    ``at``, ``many`` and ``taken`` (C,) int32 are written: the first run of each block, or the next one if it has none,
    how many it has, and the pixels that these have. ``top`` is the first row of pixels; the other arguments are fields
    of `Owners`, of that row, `Shares` and `Runs`.
    """
    columns = len(owner)
    # The pixels within the image of whole blocks that reach beyond it.
    rows = min(height - top, BLOCK)
    inside = ALL >> np.int32(BLOCK * (BLOCK - rows))
    column = 0
    while column < columns:
        left = column
        column += 1
        b = owner[left]
        at[left], many[left], taken[left] = count, 0, 0
        if b >= 0:
            a = number[b]
            if a < 0:
                continue
            at[left], many[left], taken[left] = count, 1, ALL
            while column < columns:
                b = owner[column]
                if b < 0 or number[b] != a:
                    break
                at[column], many[column], taken[column] = count, 1, ALL
                column += 1
            start[count], stop[count], share[count], pixels[count], label[count] = left, column, WHOLE, ALL, a
            filled_x[count], filled_y[count], parent[count] = inside, inside, count
            across[count], down[count] = rows, min(column * BLOCK, width) - left * BLOCK
            count += 1
        elif b == MIXED:
            first = count
            begin, end = first_share[left], first_share[left] + shares_of[left]
            for s in range(begin, end):
                taken[left] |= share_pixels[s] if number[share_region[s]] >= 0 else 0
            for s in range(begin, end):
                a = number[share_region[s]]
                left_over = share_pixels[s] if a >= 0 else np.int32(0)
                while left_over != 0:  # something thin in front may cut it in two
                    free = ALL & ~taken[left]
                    piece = left_over
                    if left_over != taken[left] and not is_one_piece(left_over, free):
                        piece = first_piece(left_over, free)
                    left_over &= ~piece
                    i = count
                    start[i], stop[i], share[i], pixels[i], label[i] = (left, column, s, piece, a)
                    filled_x[i] = spread_across(piece, ALL & ~measured[left])
                    filled_y[i] = spread_down(piece, ALL & ~measured[left])
                    across[i], down[i] = starts_across(filled_x[i]), starts_down(filled_y[i])
                    parent[i] = count
                    for k in range(first, count):
                        if label[k] != a or share[k] == s:
                            continue
                        # Regions that have become one: together they have fewer runs than apart.
                        both = piece | pixels[k]
                        if first_piece(both, free) == both:
                            unite(parent, i, k)
                            x, y = filled_x[i] | filled_x[k], filled_y[i] | filled_y[k]
                            across[i] += starts_across(x) - starts_across(filled_x[k]) - starts_across(filled_x[i])
                            down[i] += starts_down(y) - starts_down(filled_y[k]) - starts_down(filled_y[i])
                    count += 1
            others = measured[left] & ~taken[left]
            many[left] = count - first
            while others != 0:
                p = lowest_bit(others)
                others &= others - np.int32(1)
                loose[loose_count] = (top + p // BLOCK) * width + left * BLOCK + p % BLOCK
                loose_count += 1
    return count, loose_count


@kernel()
def find_runs(owners, shares, number, height, width, runs, loose):
    """Runs of equal labels along the rows of blocks, united into connected parts.

    Runs are connected where their pixels touch, or meet over at most GAP pixels that no label has.

    Parameters
    ----------
    owners : Owners
    shares : Shares
    number : (N,) int64
        Label of each region, below 0 for none.
    height, width : int
        Of the image.
    runs : Runs, written
        Except ``part``. With room for one for each block, and PIECES for each share.
    loose : (L,) int32, written
        Measured pixels without a label in blocks that are not whole: row · W + column.

    Returns
    -------
    tuple of int
        Number of runs, and of loose pixels.
    """
    # Names for fields of tuples: see `kernels`.
    owner, first_share, shares_of, measured = owners
    share_region, share_pixels, _ = shares
    first, start, stop, share, pixels, label, filled_x, filled_y, across, down, parent, _ = runs
    rows, columns = owner.shape
    # Of the blocks of this row, and of the one above: see `list_runs`; with a rim.
    here, above = np.zeros(columns + 2, np.int32), np.zeros(columns + 2, np.int32)
    many_here, many_above = np.zeros(columns + 2, np.int32), np.zeros(columns + 2, np.int32)
    taken_here, taken_above = np.zeros(columns + 2, np.int32), np.zeros(columns + 2, np.int32)
    count = loose_count = 0
    for row in range(rows):
        first[row] = count
        here, above = above, here
        here[0] = count
        many_here, many_above = many_above, many_here
        taken_here, taken_above = taken_above, taken_here
        count, loose_count = list_runs(
            owner[row], first_share[row], shares_of[row], measured[row], share_region, share_pixels, number,
            row * BLOCK, height, width, count, start, stop, share, pixels, label, filled_x, filled_y, across, down,
            parent, here[1:-1], many_here[1:-1], taken_here[1:-1], loose, loose_count,
        )  # fmt: skip
        here[columns + 1] = count
        # Where a block's runs and those above are the same as at the block before, there is nothing new.
        for c in range(columns):
            is_new = (many_here[c + 1] > 0) & (
                (here[c] != here[c + 1]) | (many_here[c] != 1) | (many_here[c + 1] > 1)
                | (above[c] != above[c + 1]) | (many_above[c] != many_above[c + 1])
                | (above[c + 1] != above[c + 2]) | (many_above[c + 1] != many_above[c + 2]) | (many_above[c + 1] > 1)
            )  # fmt: skip
            if not is_new:
                continue
            free = ALL & ~taken_here[c + 1]
            for k in range(here[c + 1], here[c + 1] + many_here[c + 1]):
                a, pixels_here = label[k], pixels[k]
                if here[c] != here[c + 1]:
                    for j in range(here[c], here[c] + many_here[c]):
                        if label[j] != a:
                            continue
                        if meet_across(pixels[j], pixels_here) != 0 or meet_over_gap(
                            pixels[j], ALL & ~taken_here[c], pixels_here, free, True
                        ):
                            unite(parent, j, k)
                            across[k] -= how_many((filled_x[j] >> BLOCK_ACROSS) & filled_x[k] & LEFT)
                # The runs above, from the block on the left to that on the right, follow one another.
                for j in range(above[c], above[c + 2] + many_above[c + 2]):
                    if label[j] != a:
                        continue
                    if stop[j] <= c or start[j] > c:
                        side = -1 if stop[j] <= c else 1
                        if parent[j] != parent[k] and meet_at_corner(pixels[j], pixels_here, side) != 0:
                            unite(parent, j, k)
                    elif meet_down(pixels[j], pixels_here) != 0 or meet_over_gap(
                        pixels[j], ALL & ~taken_above[c + 1], pixels_here, free, False
                    ):
                        unite(parent, j, k)
                        if share[k] != WHOLE or share[j] != WHOLE:
                            down[k] -= how_many((filled_y[j] >> BLOCK_DOWN) & filled_y[k] & TOP)
                        elif c == max(start[j], start[k]):
                            down[k] -= min(min(stop[j], stop[k]) * BLOCK, width) - c * BLOCK
    first[rows] = count
    return count, loose_count
