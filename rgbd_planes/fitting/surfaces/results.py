"""What a fit of surfaces returns: quadratics in inverse depth, and the geometry that follows from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Arrays, Floats
from rgbd_planes._core.status import TileStatus, summary_of
from rgbd_planes.camera.camera import Camera
from rgbd_planes.kernels.moments.surface_tiles import SURFACE_SUMS
from rgbd_planes.kernels.solvers.curvatures import surface_geometry
from rgbd_planes.kernels.statistics.surfaces import (
    COVARIANCE,
    DIRECTION_STD,
    FIRST_STD,
    GAUSSIAN_STD,
    MEAN_STD,
    P_FLAT,
    P_VALUE,
)

if TYPE_CHECKING:
    from rgbd_planes.fitting.surfaces.statistics import SurfaceAssessment

SURFACE_RESULTS = ("coefficients", "rmse", "rmse_metric", "valid_count", "status")
SURFACE_ARRAYS = ("_moments", "_reference", *SURFACE_RESULTS)

Value = TypeVar("Value")


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceFits:
    """Quadratics q = β·(1, du, dv, du², du·dv, dv²) fitted to parts of a frame; the base of each result of such a fit.

    The arrays' leading shape S is (R, C) for the tiles of a frame, (F, R, C) for a batch and (K,) for windows and
    unions. All are in the camera's frame (x right, y down, z forward) and in metres. Here q is the inverse depth 1/Z,
    and (du, dv) a pixel's (tanθx, tanθy) less those of the part's central ray. Curvatures are in 1/m, and positive
    where the surface is convex towards the camera, as a ball is.

    Attributes
    ----------
    camera : Camera
    coefficients : S + (6,) float64
        β in 1/m. NaN where ``status`` is TOO_FEW or DEGENERATE.
    rmse : S float64
        Root mean square residual of the inverse depth over the valid pixels, in 1/m.
    rmse_metric : S float64
        The same in metres along the normal at the central ray, to first order.
    valid_count : S int32
        Number of valid pixels.
    status : S uint8
        `TileStatus`. TOO_FEW: fewer than six valid pixels, or more missing than ``max_missing``. DEGENERATE: the valid
        pixels lie on a conic, as those of two rows do, or the surface passes the camera's centre at the central ray.
    """

    camera: Camera
    coefficients: Floats
    rmse: Floats
    rmse_metric: Floats
    valid_count: npt.NDArray[np.int32]
    status: npt.NDArray[np.uint8]
    # The sums of `kernels.moments.surface_tiles`, and the inverse depth that those of q are relative to:
    # (..., SURFACE_SUMS) + S' and S with S' = (R, C) or (K,).
    _moments: Floats
    _reference: Floats
    # How often a fit has written into these arrays, shared with views of them.
    _writes: list[int] = field(metadata={"saved": None})

    def __getstate__(self) -> dict[str, Any]:
        # Without what was worked out: in a copy it would no longer follow what a fit writes.
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def _worked_out(self, name: str, compute: Callable[[], Value]) -> Value:
        """A value that follows from the arrays: computed when first asked for after a fit has written into them."""
        writes = self._writes[0]
        found = self.__dict__.get(name)
        if found is None or found[0] != writes:
            found = writes, compute()
            self.__dict__[name] = found
        value: Value = found[1]
        return value

    @property
    def shape(self) -> tuple[int, ...]:
        """Leading shape of the arrays."""
        return self.status.shape

    @property
    def fitted(self) -> npt.NDArray[np.bool_]:
        """True where there is a surface: status OK or ROUGH."""
        return np.isin(self.status, (TileStatus.OK, TileStatus.ROUGH))

    @property
    def _centre(self) -> Floats:
        """(2, T) float64: tanθx and tanθy of the central rays of one frame's parts."""
        raise NotImplementedError

    @property
    def _assessment(self) -> SurfaceAssessment:
        """What works out the statistics of one frame's parts; it tests nothing."""
        raise NotImplementedError

    @property
    def _footprint(self) -> npt.NDArray[np.int64]:
        """(T, 5) int64: number of pixels of each part of one frame, missing ones included, Σx, Σy, Σx² and Σy²."""
        raise NotImplementedError

    @property
    def central_rays(self) -> Floats:
        """S + (2,) float64: tanθx and tanθy of each part's central ray."""
        parts = self._centre.shape[1]
        frames = self.status.size // max(parts, 1)
        return np.tile(self._centre.T, (frames, 1)).reshape(*self.shape, 2)

    def _geometry(self) -> dict[str, Floats]:
        def compute() -> dict[str, Floats]:
            n = self.status.size
            made = {
                "points": np.empty((n, 3)),
                "normals": np.empty((n, 3)),
                "curvatures": np.empty((n, 2)),
                "directions": np.empty((n, 2, 3)),
                "means": np.empty((n, 2)),
            }
            beta = np.ascontiguousarray(self.coefficients).reshape(-1, 6)
            centre = np.array(self._centre)
            surface_geometry(beta, centre, max(centre.shape[1], 1), *made.values())
            for name, array in made.items():
                array = array.reshape(*self.shape, *array.shape[1:])
                array.flags.writeable = False
                made[name] = array
            return made

        return self._worked_out("_of_geometry", compute)

    @property
    def points(self) -> Floats:
        """S + (3,) float64: the surface's point on the central ray, in metres."""
        return self._geometry()["points"]

    @property
    def normals(self) -> Floats:
        """S + (3,) float64: the unit normal there, towards the camera."""
        return self._geometry()["normals"]

    @property
    def principal_curvatures(self) -> Floats:
        """S + (2,) float64, 1/m: κ₁ >= κ₂ there.

        Noise drives the two apart, since they are sorted: on a ball κ₁ comes out too large and κ₂ too small.
        `mean_curvature` has no such bias.
        """
        return self._geometry()["curvatures"]

    @property
    def principal_directions(self) -> Floats:
        """S + (2, 3) float64: unit vectors in the tangent plane along which the curvature is κ₁ and κ₂.

        Of the two signs the one with x >= 0. Where both curvatures are the same, any direction is principal.
        """
        return self._geometry()["directions"]

    @property
    def mean_curvature(self) -> Floats:
        """S float64, 1/m: H = (κ₁ + κ₂) / 2."""
        return np.asarray(self._geometry()["means"][..., 0])

    @property
    def gaussian_curvature(self) -> Floats:
        """S float64, 1/m²: K = κ₁·κ₂."""
        return np.asarray(self._geometry()["means"][..., 1])

    def _frames(self) -> list[dict[str, npt.NDArray[Any]]]:
        """The arrays of each frame, in one dimension each, the moments in two; contiguous and writable copies."""
        parts = self._centre.shape[1]
        frames = self.status.size // max(parts, 1)
        moments = self._moments.reshape(frames, SURFACE_SUMS, parts)
        flat = {name: getattr(self, name).reshape(frames, -1) for name in SURFACE_RESULTS}
        return [
            {"_moments": np.array(moments[i])} | {name: np.array(array[i]) for name, array in flat.items()}
            for i in range(frames)
        ]

    def _statistics(self, first: int, last: int) -> Floats:
        """S + (last - first,) float64: some rows of `kernels.statistics.surfaces`."""
        if self.camera.noise is None:
            raise ValueError(
                "expected a camera with a noise model for uncertainties, got one without: "
                "Camera(..., noise=rp.noise.kinect_v1()), or rp.estimate_noise(frames, camera)"
            )

        def compute() -> Floats:
            assessment = self._assessment
            made = np.array([assessment.statistics(arrays).T for arrays in self._frames()])
            made = made.reshape(*self.shape, -1)
            made.flags.writeable = False
            return made

        rows = self._worked_out("_of_noise", compute)
        return rows[..., first:last]

    @property
    def p_value(self) -> Floats:
        """S float64: probability that the noise alone makes a residual as large; NaN where no surface is.

        Raises
        ------
        ValueError
            The camera has no noise model; the same for all that follows from one.
        """
        return np.asarray(self._statistics(P_VALUE, P_VALUE + 1)[..., 0])

    @property
    def p_flat(self) -> Floats:
        """S float64: probability that on a plane the noise alone makes terms of second order as large.

        Small for curved surfaces, and between 0 and 1 with equal chances for flat ones. The three terms
        of second order explain a part of the squared residuals of a plane. A scaled chi-square tests that part. Its
        mean and variance are those of the noise model, with errors that neighbours share (Satterthwaite 1946).
        """
        return np.asarray(self._statistics(P_FLAT, P_FLAT + 1)[..., 0])

    @property
    def coefficient_covariance(self) -> Floats:
        """S + (6, 6) float64, 1/m²: covariance of `coefficients`; NaN where there is no surface.

        A⁻¹BA⁻¹ with A the matrix of the normal equations and B the covariance of their right-hand side: σq²A⁻¹ where
        the noise is independent from pixel to pixel. The variance of a pixel is its mean over the part. Errors that
        neighbours share count as if the valid pixels filled a rectangle, or were spread evenly over the part.
        """
        rows = self._statistics(COVARIANCE, COVARIANCE + 36)
        return rows.reshape(*rows.shape[:-1], 6, 6)

    @property
    def mean_curvature_std(self) -> Floats:
        """S float64, 1/m: standard deviation of H, from `coefficient_covariance` to first order."""
        return np.asarray(self._statistics(MEAN_STD, MEAN_STD + 1)[..., 0])

    @property
    def gaussian_curvature_std(self) -> Floats:
        """S float64, 1/m²: standard deviation of K, to second order of the terms that it is a product of."""
        return np.asarray(self._statistics(GAUSSIAN_STD, GAUSSIAN_STD + 1)[..., 0])

    @property
    def principal_curvature_std(self) -> Floats:
        """S + (2,) float64, 1/m: standard deviations of κ₁ and κ₂, to first order: where they are well apart."""
        return self._statistics(FIRST_STD, FIRST_STD + 2)

    @property
    def principal_direction_std(self) -> Floats:
        """S float64, degrees: standard deviation of the principal directions within the tangent plane.

        To first order, by the errors of the terms of second order; 52 degrees, that of a direction of which nothing is
        known, is the most.
        """
        return np.asarray(self._statistics(DIRECTION_STD, DIRECTION_STD + 1)[..., 0])

    def to_table(self) -> dict[str, npt.NDArray[Any]]:
        """Return one row per surface as a dict of equally long columns, which `pandas.DataFrame` takes.

        The first columns say where it is:

        - tile: row, column, top, left, height, width, the last four in pixels; of a batch frame before them
        - window: top, left, height, width
        - union: label

        Then come status (its name), valid_count, x, y, z in metres, and the normal nx, ny, nz. Then kappa_1, kappa_2,
        mean_curvature, gaussian_curvature, rmse and rmse_metric. A camera with a noise model adds p_value, p_flat,
        mean_curvature_std and gaussian_curvature_std.
        """
        names = np.array([status.name for status in TileStatus])
        columns: dict[str, npt.NDArray[Any]] = self._places()
        columns |= {"status": names[self.status.ravel()], "valid_count": self.valid_count.ravel()}
        for array, parts in (
            (self.points, ("x", "y", "z")),
            (self.normals, ("nx", "ny", "nz")),
            (self.principal_curvatures, ("kappa_1", "kappa_2")),
        ):
            rows = array.reshape(self.status.size, -1)
            columns |= {name: rows[:, i] for i, name in enumerate(parts)}
        uncertain = () if self.camera.noise is None else ("p_value", "p_flat", "mean_curvature_std",
                                                          "gaussian_curvature_std")  # fmt: skip
        for name in ("mean_curvature", "gaussian_curvature", "rmse", "rmse_metric", *uncertain):
            columns[name] = getattr(self, name).ravel()
        return {name: np.array(column) for name, column in columns.items()}

    def _places(self) -> dict[str, npt.NDArray[Any]]:
        """The columns of a table that say which part of the frame a row is."""
        return {"label": np.arange(1, len(self.status) + 1)}

    def _summary(self) -> str:
        return f"quadratic: {summary_of(self.status, self.rmse_metric[self.fitted])}"

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.shape}, {self._summary()}>"


def allocate_surfaces(leading: tuple[int, ...], cells: tuple[int, ...]) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of a `SurfaceFits` for ``cells`` tiles or windows in each of ``leading`` frames."""
    shape = leading + cells
    return {
        "coefficients": np.empty((*shape, 6)),
        "rmse": np.empty(shape),
        "rmse_metric": np.empty(shape),
        "valid_count": np.empty(shape, np.int32),
        "status": np.empty(shape, np.uint8),
        "_moments": np.empty((*leading, SURFACE_SUMS, *cells)),
        "_reference": np.empty(shape),
    }


def flat_frame(arrays: Arrays, frames: int, frame: int) -> dict[str, npt.NDArray[Any]]:
    """Views of one of ``frames`` frames' arrays, in one dimension each, the moments in two."""
    made = {name: arrays[name].reshape(frames, -1)[frame] for name in SURFACE_RESULTS}
    made["_moments"] = arrays["_moments"].reshape(frames, SURFACE_SUMS, -1)[frame]
    return made
