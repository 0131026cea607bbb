"""Planes by the fits in inverse depth that the paper cites: what the paper's own form saves beside them."""

import numpy as np
import numpy.typing as npt

from bench.methods import Fit, sensor
from bench.prior_kernels import prior_moments
from rgbd_planes.fitting.methods import solve_planes


class PriorFit(Fit):
    """Planes of windows from their pixels, in the form of Tang, Lui and Li, or of Erdogan, Paluri and Dellaert."""

    def __init__(self, windows: npt.NDArray[np.int64], is_tang: bool) -> None:
        super().__init__("range_explicit", windows, "naive", disparity=not is_tang)
        self._is_tang = is_tang
        if not is_tang:
            _, camera = sensor(disparity=True)
            row, column = np.indices(camera.shape).astype(np.float64)
            self._frame = self._frame[0], (column - camera.cx, row - camera.cy), None

    def planes(self) -> None:
        """Fit all windows: the arrays' α are of the form's own coordinates and units."""
        values, coordinates, _ = self._frame
        prior_moments(values, coordinates, self._is_tang, self.windows, self.arrays["_moments"])
        solve_planes(self.method, self.arrays, self._needed, np.inf, 0, len(self.windows))

    def alpha(self) -> npt.NDArray[np.float64]:
        """(K, 3): α in 1/m over (tanθx, tanθy, 1)."""
        found = self.arrays["alpha"]
        if self._is_tang:
            return found
        _, camera = sensor(disparity=True)
        scale, offset = camera.disparity or (1.0, 0.0)
        return np.asarray(scale * found * [camera.fx, camera.fy, 1.0] + [0.0, 0.0, offset])
