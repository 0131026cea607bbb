"""From moments to planes: what tiles, windows, labels and unions share."""

import operator
from typing import Any

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Arrays
from rgbd_planes.kernels.solvers import methods as solve

# How `kernels.solvers.methods` knows the methods: by ``implicit`` in range space, by a number in (X, Y, Z).
SOLVES = {
    "range_explicit": (None, None),
    "range_implicit": (True, None),
    "standard_explicit": (None, solve.STANDARD_EXPLICIT),
    "standard_implicit": (None, solve.STANDARD_IMPLICIT),
    "standard_pca": (None, solve.STANDARD_PCA),
}
METHODS = tuple(SOLVES)

# What the kernels write, in the order of their arguments.
RESULTS = ("planes", "alpha", "rmse", "rmse_metric", "valid_count", "status")
ARRAYS = ("_moments", "_reference", *RESULTS)
in_order = operator.itemgetter(*ARRAYS)


def valid_needed(pixels: npt.NDArray[Any], max_missing: float) -> npt.NDArray[np.float64]:
    """Return how many valid pixels tiles of ``pixels`` need: at least three."""
    # The small term keeps the rounding of a share such as 0.3 of 10 pixels from changing the whole number.
    needed: npt.NDArray[np.float64] = np.maximum(3.0, pixels - np.floor(pixels * max_missing + 1e-9))
    return needed


def solve_planes(
    method: str,
    arrays: Arrays,
    needed: npt.NDArray[np.float64],
    max_error: float,
    start: int,
    stop: int,
    total: float = 0.0,
) -> None:
    """Fill in the planes of tiles ``start`` to ``stop`` of one frame from their moments.

    ``arrays`` are those of `plane_fits.allocate`, ``total`` that of the moments' `window_moments.Source`.
    """
    # In one dimension, which Numba compiles fastest.
    moments, reference, *results = (array.ravel() for array in in_order(arrays))
    sums = moments.reshape(10, -1), reference.reshape(3, -1)
    solve.fit_moments(*SOLVES[method], sums, total, needed, max_error, (start, stop), tuple(results))
