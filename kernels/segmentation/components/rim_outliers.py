"""Segmentation: groups of pixels at the rim of a large plane that lie off it, as those of a small face beside it do.

A region takes each pixel that its plane is near to, and so it takes faces that are too small for a region of their own.
None of their pixels is far off, but all are, on the same side.
"""

import numpy as np

from ..._jit.kernel import kernel
from ...common.bit_marks import lowest_bit
from ..model.moments import add, pixel_ray
from ..model.pixel_noise import waviness
from ..model.planes import fit_planes
from ..model.records import BLOCK, MIXED, Owners, Shares, as_view, place

# Pixels of such a group, and the largest share of its plane's: what is larger has been looked at before, as a region.
LEAST, MOST, SHARE = 16, 128, 0.01
# In place of a reason, of pixels that lie off: seen; of a group that is too large; to go.
SEEN, LARGE, GOES = np.uint8(253), np.uint8(254), np.uint8(255)


@kernel(inline="compiled")
def is_off(inverse_depth, rays, y, x, alpha, k, far):
    """Whether a pixel's residual about plane ``k`` is more than ``far``, or less if that is negative."""
    u, v = pixel_ray(rays, y, x)
    residual = inverse_depth[y, x] - (alpha[k, 0] * u + alpha[k, 1] * v + alpha[k, 2])
    return residual > far if far > 0.0 else residual < far


@kernel()
def gather_group(labels, reasons, inverse_depth, rays, alpha, far, most, group, begin):
    """List the pixels around the last one listed, at ``begin``, that lie off their plane, too.

    Parameters
    ----------
    labels, reasons : (H·W,) int32 and uint8
        What becomes of the group is written to the latter.
    inverse_depth : (H, W) float32
    rays : Rays
    alpha : (N, 3) float64
    far : float
        The least residual, or the largest if it is negative.
    most : int
        The pixels that the group may have.
    group : (K,) int32
        Written after ``begin``.

    Returns
    -------
    int
        Where ``group`` ends then.
    """
    height, width = inverse_depth.shape
    touches = too_large = False
    i, count = begin, begin + 1
    label = labels[group[begin]]
    while i < count and not too_large:
        y, x = place(group[i], width)
        i += 1
        for k in range(4):
            r = y - 1 if k == 0 else y + 1 if k == 3 else y
            c = x - 1 if k == 1 else x + 1 if k == 2 else x
            if r < 0 or r >= height or c < 0 or c >= width:
                continue
            here = r * width + c
            if labels[here] != label:
                touches |= inverse_depth[r, c] > 0.0
                continue
            too_large |= reasons[here] == LARGE
            if reasons[here] == 0 and is_off(inverse_depth, rays, r, c, alpha, label - 1, far):
                group[count] = here
                reasons[here] = SEEN
                count += 1
        too_large |= count - begin > most
    if too_large or (touches and count - begin >= LEAST):
        for j in range(begin, count):
            reasons[group[j]] = LARGE if too_large else GOES
    return count


@kernel()
def release_rims(view, owners, shares, moments, deviation, least, unclaimed, label, reason):
    """Take the label from groups of pixels at the rims of planes that lie off them.

    They touch what is not the plane's: so one of their pixels at least is in a share. A sensor's own errors may bend
    the rim of a plane by its waviness.

    Parameters
    ----------
    view : View
        Pixels are off by ``rim_deviations``, times the plane's waviness.
    owners : Owners
    shares : Shares
    moments, deviation : (N, 10) and (N,) float64
        Of the planes' pixels, changed, and of a pixel about them.
    least : int
        Pixels that a plane keeps at least.
    unclaimed : uint8
        Reason of pixels that lose their label.
    label, reason : (H, W) int32 and uint8, changed
    """
    view, owners, shares = as_view(view), Owners(*owners), Shares(*shares)
    inverse_depth, rays, noise, rules = view.inverse_depth, view.rays, view.noise, view.rules
    width, labels, reasons = label.shape[1], label.reshape(-1), reason.reshape(-1)
    alpha, rss, gone = np.empty((len(moments), 3)), np.empty(len(moments)), np.zeros((len(moments), 10))
    fit_planes(moments, alpha, rss)
    limit = np.empty(len(moments))
    for k in range(len(moments)):
        limit[k] = rules.rim_deviations * waviness(moments[k, 0], noise.growth) * deviation[k]
    group, count = np.empty(label.size, np.int32), 0
    for row in range(len(owners.block)):
        for column in range(owners.block.shape[1]):
            first = owners.first[row, column]
            for s in range(first, first + (owners.count[row, column] if owners.block[row, column] == MIXED else 0)):
                pixels, m = shares.pixels[s], shares.moments[s]
                p = lowest_bit(pixels)
                k = label[row * BLOCK + p // BLOCK, column * BLOCK + p % BLOCK] - 1
                if k < 0 or SHARE * moments[k, 0] < LEAST:
                    continue
                total = m[3] - (alpha[k, 0] * m[1] + alpha[k, 1] * m[2] + alpha[k, 2] * m[0])
                if abs(total) <= limit[k] * m[0]:
                    continue
                far = limit[k] if total > 0.0 else -limit[k]
                most = np.int64(min(SHARE * moments[k, 0], MOST))
                while pixels != 0:
                    p = lowest_bit(pixels)
                    pixels &= pixels - np.int32(1)
                    y, x = row * BLOCK + p // BLOCK, column * BLOCK + p % BLOCK
                    here = y * width + x
                    if reasons[here] == 0 and labels[here] == k + 1 and is_off(
                        inverse_depth, rays, y, x, alpha, k, far
                    ):  # fmt: skip
                        group[count], reasons[here] = here, SEEN
                        count = gather_group(labels, reasons, inverse_depth, rays, alpha, far, most, group, count)
    for i in range(count):
        here = group[i]
        k = labels[here] - 1
        if reasons[here] == GOES and moments[k, 0] - gone[k, 0] > least:
            y, x = place(here, width)
            u, v = pixel_ray(rays, y, x)
            add(gone[k], u, v, inverse_depth[y, x])
            labels[here], reasons[here] = 0, unclaimed
        else:
            reasons[here] = 0
    for k in range(len(moments)):
        for j in range(10):
            moments[k, j] -= gone[k, j]
