"""What a fit returns: planes, their residuals, and the reason where there is none."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.lazy_property import kept
from rgbd_planes._core.status import TileStatus, summary_of
from rgbd_planes.camera.camera import Camera
from rgbd_planes.kernels.statistics.tiles.block import (
    ALPHA_COVARIANCE,
    ANGLE_STD,
    OFFSET_STD,
    P_VALUE,
    PLANE_COVARIANCE,
)
from rgbd_planes.uncertainty.falloff import growth_of_parts
from rgbd_planes.uncertainty.footprints import like_rectangles

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rgbd_planes.kernels.statistics.pixel_runs import PixelRuns
    from rgbd_planes.plotting.protocols import Outlines
    from rgbd_planes.uncertainty.statistics import Assessment, FitStatistics


@dataclass(frozen=True, eq=False, repr=False)
class PlaneFits:
    """Planes n·X + d = 0 fitted to parts of a frame; the base of every result of a fit.

    The arrays' leading shape S is (R, C) for the tiles of a frame, (F, R, C) for a batch and (K,) for
    windows and labels. All are in the camera's frame (x right, y down, z forward) and in metres.

    Attributes
    ----------
    camera : Camera
    method : str
    planes : S + (4,) float64
        nx, ny, nz, d with ‖n‖ = 1, d > 0 and n towards the camera. NaN where ``status`` is TOO_FEW or
        DEGENERATE.
    alpha : S + (3,) float64
        -n / d, in 1/m: the inverse depth of the plane is q = α·(tanθx, tanθy, 1).
    rmse : S float64
        Root mean square residual over the valid pixels, in the method's units: 1/m for ``range_explicit``, metres along
        the optical axis for ``standard_explicit`` and along the normal for ``standard_pca``. For the implicit methods
        it is the algebraic distance for coefficients of norm 1.
    rmse_metric : S float64
        The same in metres along the normal; d·Z̄·rmse, to first order, in range space: at the mean inverse depth, where
        a part spans a range of depths.
    valid_count : S int32
        Number of valid pixels.
    status : S uint8
        `TileStatus`.
    """

    camera: Camera
    method: str
    planes: Floats
    alpha: Floats
    rmse: Floats
    rmse_metric: Floats
    valid_count: npt.NDArray[np.int32]
    status: npt.NDArray[np.uint8]
    # The ten sums of `kernels.moments.tiles` and the point that they are relative to: (..., 10) + S' and (..., 3) + S'
    # with S' = (R, C) or (K,).
    _moments: Floats
    _reference: Floats

    def __getstate__(self) -> dict[str, Any]:
        # Without the statistics: in a copy they would no longer follow what a fit writes.
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def shape(self) -> tuple[int, ...]:
        """Leading shape of the arrays."""
        return self.status.shape

    @property
    @kept
    def p_value(self) -> Floats:
        """S float64: probability that the noise alone makes a residual as large; NaN where no plane is.

        On flat surfaces it is uniform between 0 and 1. Below the significance level a tile is ROUGH. It tests the
        residual in inverse depth under ``camera.noise``, by its chi-square. Where the noise has a spread, it takes the
        ratio to a variance that differs from place to place. The residual of the ``standard_`` methods is in metres.
        For them this holds only where a part spans a small range of depths, and is much larger than the noise. A part
        of exactly three pixels, which fit exactly, has 1. It, the covariances and the standard deviations are computed
        together when one of them is first asked for. From then on each fit that writes into this result computes them,
        too.

        Raises
        ------
        ValueError
            The camera has no noise model. So it is for all of these.
        """
        return self._statistics.row(P_VALUE)

    @property
    @kept
    def alpha_covariance(self) -> Floats:
        """S + (3, 3) float64, 1/m²: covariance of `alpha`, σq²(MᵀM)⁻¹; NaN where there is no plane.

        For labels by ``range_explicit`` it is exact wherever the noise is independent from pixel to pixel. For tiles,
        windows and unions of them it is exact if σq is also constant over each. Where it changes with the depth, or by
        a falloff, their pixels count as if they filled a parallelogram. Errors that neighbours share count by where the
        pixels of labels and unions lie. Tiles and windows count as if their pixels filled rectangles. For the other
        methods it is the covariance of ``range_explicit`` on the same pixels, to first order in the spread of depths.
        Where σq is constant, that is the bound which they reach at best. It leaves out that ``standard_explicit`` and
        ``standard_pca`` are biased.
        """
        return self._statistics.matrix(ALPHA_COVARIANCE, 3)

    @property
    @kept
    def plane_covariance(self) -> Floats:
        """S + (4, 4) float64: covariance of (n, d), from that of α to first order; its rank is 3."""
        return self._statistics.matrix(PLANE_COVARIANCE, 4)

    @property
    @kept
    def angle_std(self) -> Floats:
        """S float64, degrees: root mean square of the angle between the normal and the true one, √tr Σn."""
        return self._statistics.row(ANGLE_STD)

    @property
    @kept
    def offset_std(self) -> Floats:
        """S float64, metres: standard deviation of d.

        d is the distance of the camera from the plane extended up to it. The tilt of a small tile moves it far more
        than the surface itself. The uncertainty of the surface at a point is what `uncertainty.point_distance` gives.
        The mean of d is smaller than the true one, by d·θ²/2 - σd²/d where θ is `angle_std` in radians, since normals
        err to all sides. That matters most for small planes that face the camera.
        """
        return self._statistics.row(OFFSET_STD)

    @property
    @kept
    def _statistics(self) -> FitStatistics:
        """What the camera's noise says about these planes, computed when first asked for."""
        from rgbd_planes.uncertainty.statistics import FitStatistics

        return FitStatistics(self)

    @property
    def _cell_dimensions(self) -> int:
        """Number of dimensions that index the planes of one frame: 2 for tiles, 1 for others."""
        return min(self._moments.ndim - 1, 2)

    @property
    def _assessment(self) -> Assessment:
        """What writes the statistics of the parts of a frame; it tests nothing."""
        from rgbd_planes.uncertainty.statistics import Assessment

        footprint = self._footprint
        growth = growth_of_parts(self.camera, footprint)
        return Assessment(self.camera, self.method, 0.0, like_rectangles(footprint), footprint, growth)

    @property
    def _footprint(self) -> npt.NDArray[np.int64]:
        """(N, 5): for each part of one frame, what `noise.residuals.like_rectangles` takes."""
        raise NotImplementedError

    @property
    def _error_sums(self) -> Floats | None:
        """(N, 8): for each part, what `error_sums.Pixels` keeps; None where the moments are enough."""
        return None

    @property
    def _shared(self) -> Floats | None:
        """(N, COLUMNS): for each part, what `error_sums.Pixels` keeps; None for rectangles."""
        return None

    @property
    def _runs(self) -> PixelRuns | None:
        """Where the valid pixels of each part of one frame lie, if it is known."""
        raise NotImplementedError

    @property
    def _total(self) -> float:
        """For moments that are differences of sums over a frame, `window_moments.Source.total`; 0 for others."""
        return 0.0

    @property
    def fitted(self) -> npt.NDArray[np.bool_]:
        """True where there is a plane: status OK or ROUGH."""
        return np.isin(self.status, (TileStatus.OK, TileStatus.ROUGH))

    def to_table(self) -> dict[str, npt.NDArray[Any]]:
        """Return one row per plane as a dict of equally long columns, which `pandas.DataFrame` takes.

        Columns: a tile has its row and column, in a batch after its frame, and top, left, height and width in pixels. A
        window has the last four, an element of a quadtree its level, too. Others have the label. Then status (its
        name), valid_count; nx, ny, nz, d; rmse, rmse_metric. If the camera has a noise model: p_value; angle_std in
        degrees, offset_std in metres.
        """
        names = np.array([status.name for status in TileStatus])
        planes = self.planes.reshape(-1, 4)
        columns = {"status": names[self.status.ravel()], "valid_count": self.valid_count.ravel()}
        columns |= {name: planes[:, i] for i, name in enumerate(("nx", "ny", "nz", "d"))}
        uncertain = () if self.camera.noise is None else ("p_value", "angle_std", "offset_std")
        columns |= {name: getattr(self, name).ravel() for name in ("rmse", "rmse_metric", *uncertain)}
        return {name: np.array(column) for name, column in (self._places() | columns).items()}

    def _places(self) -> dict[str, npt.NDArray[Any]]:
        """The columns of a table that say which part of the frame a row is."""
        return {"label": np.arange(1, len(self.status) + 1)}

    def _summary(self) -> str:
        return f"{self.method}: {summary_of(self.status, self.rmse_metric[self.fitted])}"

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.shape}, {self._summary()}>"


@dataclass(frozen=True, eq=False, repr=False)
class PlacedFits(PlaneFits):
    """Planes fitted to parts of a frame that have a place in its image; the base of `TilePlanes` and others."""

    def _cells(self, rows: npt.NDArray[np.int64], columns: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """(H', W') int64: the number of the part at these rows and columns of pixels; -1 for none."""
        raise NotImplementedError

    @property
    def _title(self) -> str:
        """The title of a picture: what the parts are."""
        raise NotImplementedError

    @property
    def _outlines(self) -> Outlines | None:
        """Lines between the parts, where they have simple ones."""
        return None

    def _repr_html_(self) -> str:
        """What a notebook shows: the counts and a small picture."""
        from rgbd_planes.plotting.preview import fits_html

        return fits_html(self)

    def plot(self, depth: npt.ArrayLike | None = None, figure: Figure | None = None) -> Figure:
        """Draw the depth, the normals as colours and the parts by status.

        Parameters
        ----------
        depth : (H, W) array_like, optional
            The frame that was fitted; without it the fitted planes' own depth is drawn.
        figure : matplotlib Figure, optional
            Drawn into, with text for a width of 15 inches; a new one of that width by default.
        """
        from rgbd_planes.plotting.tiles import plot_fits

        return plot_fits(self, depth, figure)


def allocate(leading: tuple[int, ...], cells: tuple[int, ...]) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of a `PlaneFits` for ``cells`` tiles or windows in each of ``leading`` frames."""
    shape = leading + cells
    return {
        "planes": np.empty((*shape, 4)),
        "alpha": np.empty((*shape, 3)),
        "rmse": np.empty(shape),
        "rmse_metric": np.empty(shape),
        "valid_count": np.empty(shape, np.int32),
        "status": np.empty(shape, np.uint8),
        "_moments": np.empty((*leading, 10, *cells)),
        "_reference": np.zeros((*leading, 3, *cells)),
    }
