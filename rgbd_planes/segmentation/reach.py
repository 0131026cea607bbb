"""How errors of different reach show in squares of pixels, for `kernels.segmentation.reach`."""

import functools
import itertools

import numpy as np

from rgbd_planes.array_types import Floats
from rgbd_planes.kernels.segmentation.model.records import BLOCK
from rgbd_planes.kernels.segmentation.noise.correlation import SIZES, SMALLEST

_SHORT = 1.7
_LENGTHS = np.concatenate([[_SHORT], np.geomspace(0.7, 24.0, 30)])
"""Lengths in pixels of the correlation exp(-r²/(2·length²)) of errors; the first is `_SHORT`."""
_ALONG = 4  # parts along the side of a square
_MEAN, _SLOPE = _ALONG, _ALONG + 1  # columns after those of the parts


@functools.cache
def reach_table() -> Floats:
    """(2·SIZES + 1, K) float64: see `kernels.segmentation.correlation.mixture`."""
    of_sizes = [row for size in range(SIZES) for row in _scatter(BLOCK << (SMALLEST + size))]
    made = np.stack([*of_sizes, 2.0 * np.pi * _LENGTHS**2])
    made.flags.writeable = False
    return made


@np.errstate(under="ignore")  # of errors far apart
def _scatter(side: int) -> tuple[Floats, Floats]:
    """(K,) each: scatter of the means of a square's 4 x 4 parts about its plane, and its residual.

    Both over those of independent pixels: tr(ARCRAᵀ) and tr(RC) for the covariance C, the parts A and the projection
    R = I - PPᵀ on residuals. All are products of factors along x and along y: the parts, and in P the plane's mean and
    its two slopes.
    """
    x = np.arange(side) - 0.5 * (side - 1)
    basis = np.zeros((side, _ALONG + 2))
    basis[np.arange(side), np.arange(side) * _ALONG // side] = 1.0
    basis[:, _MEAN], basis[:, _SLOPE] = 1.0, x
    basis /= np.linalg.norm(basis, axis=0)
    covariance = np.exp(-0.5 * ((x[:, None] - x) / _LENGTHS[:, None, None]) ** 2)
    along = basis.T @ covariance @ basis  # (K, 6, 6)
    share = (basis.T @ basis)[:_ALONG]
    plane = ((_MEAN, _MEAN), (_MEAN, _SLOPE), (_SLOPE, _MEAN))  # along y and along x
    parts = along[:, range(_ALONG), range(_ALONG)]
    scatter = np.einsum("ki,kj->k", parts, parts)
    residual = np.full(len(_LENGTHS), float(side * side))
    for a, b in plane:
        in_part = share[:, a], share[:, b]
        scatter -= 2.0 * np.einsum("i,j,ki,kj->k", *in_part, along[:, :_ALONG, a], along[:, :_ALONG, b])
        residual -= along[:, a, a] * along[:, b, b]
    for (a, b), (c, d) in itertools.product(plane, repeat=2):
        overlap = (share[:, a] @ share[:, c]) * (share[:, b] @ share[:, d])
        scatter += overlap * along[:, a, c] * along[:, b, d]
    return scatter / (_ALONG**2 - 3), residual / (side * side - 3)
