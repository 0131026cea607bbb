"""Segmentation: does a small region bend?

It has few blocks, and many pixels at its rim, which may be biased: the pixels inside tell.
"""

import numpy as np

from ..._jit.kernel import kernel
from ..model.moments import pixel_ray
from ..model.quadrics import TERMS, add_blocks, residuals, turn
from ..model.records import BLOCK, MIXED

# Pixels over which a sensor does not bend planes yet.
SMALL = 1024
# Variances that three more terms must gain, times the pixels that share an error: of χ²(3) one in fifty is 10.
SURE = 10.0


@kernel(arrays=False)
def owned_bits(regions, a, row, column):
    """Which pixels of a block region ``a`` owns: bit BLOCK·y + x; -1 for all that are measured."""
    region, _, number, owners, shares = regions
    if region[row, column] != a:
        return np.int32(0)
    if owners.block[row, column] != MIXED:
        return np.int32(-1)
    first = owners.first[row, column]
    for s in range(first, first + owners.count[row, column]):
        if number[shares.region[s]] == a:
            return shares.pixels[s]
    return np.int32(0)


@kernel()
def inner_pixels(regions, a, window, inverse_depth, rays, pixels):
    """Write 1, u, v and q of the pixels inside region ``a`` to ``pixels`` (K, 4) float32; returns how many.

    Those that are beside what is not the region's are left out, if they are less than half: a sensor's pixel may see
    both. ``window`` (4,) int64 has the rows and columns of its blocks; ``inverse_depth`` is (H, W) float32.
    """
    height, width = inverse_depth.shape
    top, left = BLOCK * window[0] - 1, BLOCK * window[2] - 1  # with a rim
    owned = np.zeros((BLOCK * window[1] - top + 1, BLOCK * window[3] - left + 1), np.bool_)
    place = np.empty((len(pixels), 2), np.int64)
    count = 0
    for row in range(window[0], window[1]):
        for column in range(window[2], window[3]):
            bits = owned_bits(regions, a, row, column)
            for p in range(BLOCK * BLOCK if bits != 0 else 0):
                y, x = BLOCK * row + p // BLOCK, BLOCK * column + p % BLOCK
                is_own = bits >> np.int32(p) & 1 and y < height and x < width and inverse_depth[y, x] > 0.0
                if is_own and count < len(pixels):
                    owned[y - top, x - left] = True
                    place[count, 0], place[count, 1] = y, x
                    count += 1
    inside, inner = np.empty(count, np.bool_), 0
    for i in range(count):
        y, x = place[i, 0] - top, place[i, 1] - left
        inside[i] = owned[y - 1, x] & owned[y + 1, x] & owned[y, x - 1] & owned[y, x + 1]
        inner += inside[i]
    everything = 2 * inner < count
    chosen = 0
    for i in range(count):
        if inside[i] or everything:
            y, x = place[i]
            u, v = pixel_ray(rays, y, x)
            pixels[chosen, 0], pixels[chosen, 1], pixels[chosen, 2], pixels[chosen, 3] = 1.0, u, v, inverse_depth[y, x]
            chosen += 1
    return chosen


@kernel()
def turn_inside(view, regions, a, window, m, alpha, variance):
    """How far the normals of a small region turn, by its pixels.

    A quadric must take away more than half of their squared residuals, and more than chance, where errors are shared.

    Parameters
    ----------
    view : View
    regions : Regions
    a : int
        The region.
    window : (4,) int64
        Rows and columns of its blocks.
    m, alpha : (10,) and (3,) float64
        Its moments and its plane.
    variance : float
        Of a pixel about the plane.

    Returns
    -------
    float
        Mean squared angle; 0 if that may be chance.
    """
    # Pixels as if they were blocks, one beside the other, of one region.
    pixels, products = np.empty((1, SMALL, 4), np.float32), np.zeros((TERMS + 1, TERMS + 1))
    row = np.array([0, 1, 0, inner_pixels(regions, a, window, view.inverse_depth, view.rays, pixels[0])])
    add_blocks(np.zeros((1, SMALL), np.int32), pixels, 0, row, 1, m, alpha, products)
    flat, rest = residuals(products)
    gain, share = flat - rest, row[3] / m[0]
    if not (gain > rest and gain > SURE * view.noise.together * share * variance):
        return 0.0
    return turn(products, m, alpha)
