"""Segmentation: the pixels of curved regions as connected surfaces."""

import math

import numpy as np

from ..._jit.kernel import kernel
from ...common.union_find import unite
from ..model.moments import pixel_ray
from ..model.pixel_noise import sensor_variance
from ..model.records import as_view

# From the line of sight, at which a surface still goes on from pixel to pixel: 10 degrees. Steeper, it is a depth jump.
STEEPEST = math.tan(math.radians(80.0))
# By which two pixels of one surface differ beyond that. Their difference has a standard deviation of √2.
DEVIATIONS = 6.0


@kernel()
def number_surfaces(view, reason, curved, least, surface):
    """Number the connected surfaces that pixels of curved regions make.

    Neighbours, diagonal ones included, are connected unless depth jumps between them.

    Parameters
    ----------
    view : View
    reason : (H, W) uint8
    curved : uint8
        Reason of the pixels that count.
    least : int
        Pixels that a surface must have.
    surface : (H, W) int32, written
        1, 2, ... in the order of their first pixels; 0 elsewhere.
    """
    inverse_depth, rays, _, noise, _, _ = as_view(view)
    height, width = reason.shape
    sigma, pixels = noise.sigma, np.count_nonzero(reason == curved)
    place = np.empty((pixels + 1, 2), np.int32)
    parent = np.empty(pixels + 1, np.int32)  # of each pixel that counts: ``surface`` numbers them from 1 meanwhile
    surface[:] = 0
    count = 0
    for y in range(height):
        for x in range(width):
            if reason[y, x] != curved:
                continue
            count += 1
            surface[y, x] = count
            parent[count] = count
            place[count, 0], place[count, 1] = y, x
            q = inverse_depth[y, x]
            u, v = pixel_ray(rays, y, x)
            other_u, other_v = pixel_ray(rays, max(y - 1, 0), max(x - 1, 0))
            slope = STEEPEST * q * math.sqrt((u - other_u) ** 2 + (v - other_v) ** 2)
            most = slope + DEVIATIONS * math.sqrt(sensor_variance(q, sigma))
            for k in range(-2, 2):  # left, and the three above
                other_y, other_x = (y, x - 1) if k < -1 else (y - 1, x + k)
                if other_y < 0 or other_x < 0 or other_x == width:
                    continue
                other = surface[other_y, other_x]
                if other > 0 and abs(inverse_depth[other_y, other_x] - q) <= most:
                    unite(parent, count, other)
    size, label = np.zeros(pixels + 1, np.int32), np.zeros(pixels + 1, np.int32)
    for i in range(1, pixels + 1):  # a root is the first of its pixels
        parent[i] = parent[parent[i]]
        size[parent[i]] += 1
    surfaces = 0
    for i in range(1, pixels + 1):
        if parent[i] == i and size[i] >= least:
            surfaces += 1
            label[i] = surfaces
        surface[place[i, 0], place[i, 1]] = label[i] = label[parent[i]]
