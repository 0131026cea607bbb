"""Segmentation: how well a plane's pixels are explained without it, by the planes and the surface around it."""

import math

import numpy as np

from ..._jit.kernel import kernel
from ...common.bit_marks import list_marked, room_for_marks
from ..model.moments import add, pixel_ray, residual, solve

REACH = 4  # pixels around a plane that are its rim
LINES = 2  # every how many rows and columns it is looked at


@kernel(inline="compiled")
def misfit_of(m, a, b, c):
    """Sum of squared residuals of the pixels of moments ``m`` (10,) about the plane q = a·u + b·v + c."""
    return (
        m[9] - 2.0 * (a * m[6] + b * m[8] + c * m[3])
        + a * (a * m[4] + 2.0 * (b * m[5] + c * m[1]))
        + b * (b * m[7] + 2.0 * c * m[2])
        + c * c * m[0]
    )  # fmt: skip


@kernel(arrays=False)
def look_outside(label, inverse_depth, rays, y, x, down, across, alpha, moments, last, rim, least):
    """Look from a pixel out of its plane, by REACH pixels: add to its ``rim``, and try the planes that are there."""
    height, width = label.shape
    a = label[y, x] - 1
    for _ in range(REACH):
        y, x = y + down, x + across
        if y < 0 or y >= height or x < 0 or x >= width:
            return
        b = label[y, x] - 1
        if b == a or not inverse_depth[y, x] > 0.0:
            continue
        u, v = pixel_ray(rays, y, x)
        add(rim[a], u, v, inverse_depth[y, x])
        if b >= 0 and b != last[a]:
            last[a] = b
            least[a] = min(least[a], misfit_of(moments[a], alpha[b, 0], alpha[b, 1], alpha[b, 2]))


@kernel()
def best_alternatives(label, inverse_depth, rays, alpha, moments, least):
    """Sum of squared residuals of each plane's pixels about the best other plane.

    That is one of its neighbours' planes, continued over it, or the plane through the measured pixels within REACH of
    it along every LINES-th row and column; infinite where nothing is measured around it.

    Parameters
    ----------
    label : (H, W) int32
        0 for none, 1..N.
    inverse_depth : (H, W) float32
    rays : Rays
    alpha, moments : (N, 3) and (N, 10) float64
    least : (N,) float64, written
    """
    height, width = label.shape
    rim, last = np.zeros((len(alpha), 10)), np.full(len(alpha), -1)
    least[:] = math.inf
    changes, words, columns = room_for_marks(width)
    for y in range(height):
        is_line, line, below_line = y % LINES == 0, label[y], label[min(y + 1, height - 1)]
        for x in range(width - 1):
            changes[x] = (is_line & (line[x] != line[x + 1])) | ((x % LINES == 0) & (line[x] != below_line[x]))
        changes[width - 1] = ((width - 1) % LINES == 0) & (line[width - 1] != below_line[width - 1])
        for i in range(list_marked(changes, words, True, columns)):
            x = np.int64(columns[i])
            a, right, below = line[x], line[min(x + 1, width - 1)], below_line[x]
            if is_line and a != right:
                if a > 0:
                    look_outside(label, inverse_depth, rays, y, x, 0, 1, alpha, moments, last, rim, least)
                if right > 0:
                    look_outside(label, inverse_depth, rays, y, x + 1, 0, -1, alpha, moments, last, rim, least)
            if x % LINES == 0 and a != below:
                if a > 0:
                    look_outside(label, inverse_depth, rays, y, x, 1, 0, alpha, moments, last, rim, least)
                if below > 0:
                    look_outside(label, inverse_depth, rays, y + 1, x, -1, 0, alpha, moments, last, rim, least)
    for k in range(len(alpha)):
        if residual(rim[k]) >= 0.0:
            m = rim[k]
            _, u, v, one = solve(m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9])
            least[k] = min(least[k], misfit_of(moments[k], u, v, one))
