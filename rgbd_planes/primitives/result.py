"""What a fit of primitives returns: which of plane, sphere and cylinder each label is, where, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.status import Primitive, TileStatus
from rgbd_planes._core.text import counted
from rgbd_planes.camera.camera import Camera
from rgbd_planes.fitting.saving import Savable, Values, check_alike, check_covariances, check_label_image

# Rows of the covariance.
CENTRE, AXIS, RADIUS = slice(0, 3), slice(3, 6), 6
PARAMETERS = 7


@dataclass(frozen=True, eq=False, repr=False)
class PrimitiveFits(Savable):
    """The plane, sphere or cylinder of each of labels 1 to K of a frame, or none.

    All is in the camera's frame (x right, y down, z forward) and in metres.

    Attributes
    ----------
    camera : Camera
    labels : (H, W) int32
        0 for none; row i of the arrays belongs to label i + 1.
    kind : (K,) uint8
        `Primitive`.
    radius : (K,) float64
        Metres; NaN for planes and NONE.
    centre : (K, 3) float64
        Of a sphere its centre; of a cylinder the point of its axis that is nearest to the surface on the label's mean
        ray; of a plane its point on that ray. NaN for NONE.
    axis : (K, 3) float64
        Unit vector. Of a cylinder the direction of its axis, of the two signs the one with x >= 0; of a plane its
        normal, towards the camera. NaN for spheres and NONE.
    convex : (K,) bool
        Whether the camera sees the surface from outside, as a ball; False for the inside of a bowl, planes and NONE.
    covariance : (K, 7, 7) float64
        Of centre, axis and radius, in that order; 0 for what a kind does not have, NaN for NONE. Its rank is 4 for
        spheres, 5 for cylinders, whose centre counts across the axis alone, and 3 for planes. Where little of a surface
        is seen, centre and radius err together: the covariance says how.
    rmse : (K,) float64
        Root mean square residual of the inverse depth, 1/m, weighted by the inverse variances of the pixels. For NONE
        that of the kind which fits best.
    rmse_metric : (K,) float64
        The same in metres along the normal on the mean ray, to first order.
    p_value : (K,) float64
        Probability that the noise alone makes a residual as large; NaN where nothing was fitted. For NONE that of the
        kind which fits best.
    p_flat : (K,) float64
        Probability that the noise alone makes a plane look as curved: small for what is curved.
    valid_count : (K,) int32
        Number of pixels that the fit took.
    status : (K,) uint8
        `TileStatus`. OK: it has a kind. TOO_FEW: fewer than six pixels. DEGENERATE: they determine no plane. ROUGH: no
        kind has a residual that the noise explains.
    """

    camera: Camera
    labels: npt.NDArray[np.int32]
    kind: npt.NDArray[np.uint8]
    radius: Floats
    centre: Floats
    axis: Floats
    convex: npt.NDArray[np.bool_]
    covariance: Floats
    rmse: Floats
    rmse_metric: Floats
    p_value: Floats
    p_flat: Floats
    valid_count: npt.NDArray[np.int32]
    status: npt.NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.kind)

    def __repr__(self) -> str:
        counts = [(int(np.count_nonzero(self.kind == kind)), kind.name.lower()) for kind in Primitive]
        named = [counted(count, name) for count, name in counts[1:] if count]
        if counts[0][0]:
            named.append(f"{counts[0][0]} none of these")
        return f"<PrimitiveFits: {counted(len(self), 'label')}{': ' if named else ''}{', '.join(named)}>"

    @property
    def radius_std(self) -> Floats:
        """(K,) float64, metres: standard deviation of the radius; NaN for planes and NONE.

        To first order. A radius is at least as skewed as its relative deviation is large: from a tenth on, an interval
        of 1/radius, whose deviation is radius_std / radius², holds better.
        """
        return np.where(np.isnan(self.radius), np.nan, np.sqrt(self.covariance[:, RADIUS, RADIUS]))

    @property
    def centre_std(self) -> Floats:
        """(K, 3) float64, metres: standard deviations of the centre's coordinates; NaN for NONE."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)[:, CENTRE])

    @property
    def axis_std(self) -> Floats:
        """(K,) float64, degrees: root mean square angle between the axis and the true one; NaN for spheres and NONE."""
        square = np.trace(self.covariance[:, AXIS, AXIS], axis1=1, axis2=2)
        return np.where(np.isnan(self.axis[:, 0]), np.nan, np.degrees(np.sqrt(square)))

    @property
    def planes(self) -> Floats:
        """(K, 4) float64: nx, ny, nz, d of n·X + d = 0 for planes, d > 0; NaN for all else."""
        is_plane = (self.kind == Primitive.PLANE)[:, None]
        d = -(self.axis * self.centre).sum(axis=1, keepdims=True)
        return np.where(is_plane, np.concatenate([self.axis, d], axis=1), np.nan)

    @property
    def sizes(self) -> npt.NDArray[np.int32]:
        """(K,) int32: pixels of each label, missing ones included."""
        return np.bincount(self.labels.ravel(), minlength=len(self) + 1)[1:].astype(np.int32)

    def surface_depth(self) -> Floats:
        """(H, W) float64: depth in metres of each label's primitive on its pixels' rays.

        NaN without a label, for NONE, and where a ray misses the primitive.
        """
        depth = np.full(self.labels.shape, np.nan)
        rays = np.stack(np.broadcast_arrays(self.camera.tan_x, self.camera.tan_y, 1.0), axis=-1)
        order = np.argsort(self.labels, axis=None, kind="stable")
        first = np.searchsorted(self.labels.ravel()[order], np.arange(1, len(self) + 2))
        for k in np.flatnonzero(self.kind != Primitive.NONE).tolist():
            pixels = order[first[k] : first[k + 1]]
            depth.reshape(-1)[pixels] = self._depth_on(k, rays.reshape(-1, 3)[pixels])
        return depth

    def _depth_on(self, k: int, rays: Floats) -> Floats:
        """(M,) float64: depth of primitive ``k`` on rays (M, 3); NaN where one misses it."""
        centre, axis = self.centre[k], self.axis[k]
        with np.errstate(invalid="ignore", divide="ignore"):
            if self.kind[k] == Primitive.PLANE:
                depth = (axis @ centre) / (rays @ axis)
            else:
                if self.kind[k] == Primitive.CYLINDER:
                    rays, centre = rays - np.outer(rays @ axis, axis), centre - (centre @ axis) * axis
                square, along = (rays * rays).sum(axis=1), rays @ centre
                root = np.sqrt(along**2 - square * (centre @ centre - self.radius[k] ** 2))
                depth = (along - root if self.convex[k] else along + root) / square
        return np.where(depth > 0.0, depth, np.nan)

    def to_table(self) -> dict[str, npt.NDArray[Any]]:
        """Return one row per label as a dict of equally long columns, which `pandas.DataFrame` takes."""
        columns: dict[str, npt.NDArray[Any]] = {
            "label": np.arange(1, len(self) + 1, dtype=np.int32),
            "kind": np.array([Primitive(kind).name for kind in self.kind], dtype=str),
        }
        for name, values in (("centre", self.centre), ("axis", self.axis)):
            columns |= {f"{name}_{letter}": values[:, i] for i, letter in enumerate("xyz")}
        columns |= {name: getattr(self, name) for name in ("radius", "radius_std", "axis_std", "convex")}
        columns |= {name: getattr(self, name) for name in ("rmse", "rmse_metric", "p_value", "p_flat")}
        columns |= {name: getattr(self, name) for name in ("sizes", "valid_count")}
        columns["status"] = np.array([TileStatus(status).name for status in self.status], dtype=str)
        return columns

    @classmethod
    def _checked(cls, values: Values) -> Values:
        count = len(values["kind"])
        check_label_image(values["labels"], values["camera"].shape, count)
        check_alike(values, allocate_primitives(count))
        kind, status = values["kind"], values["status"]
        if kind.max(initial=0) > max(Primitive) or status.max(initial=0) > max(TileStatus):
            raise ValueError("an invalid kind or status")
        has_kind, has_radius = kind != Primitive.NONE, kind >= Primitive.SPHERE
        if not np.array_equal(has_kind, status == TileStatus.OK):
            raise ValueError("a status that does not go with the kind")
        check_covariances(values["covariance"][has_kind])
        has_axis = (kind == Primitive.PLANE) | (kind == Primitive.CYLINDER)
        with np.errstate(all="ignore"):
            lengths = np.linalg.norm(values["axis"][has_axis], axis=1)
        if not (np.isfinite(values["centre"][has_kind]).all() and np.allclose(lengths, 1.0)):
            raise ValueError("primitives without a centre or a unit axis")
        if not ((values["radius"] > 0.0) == has_radius).all():
            raise ValueError("radii that do not go with the kind")
        if ((values["valid_count"] < 0) | (values["valid_count"] > values["labels"].size)).any():
            raise ValueError("an invalid number of pixels")
        return values


def allocate_primitives(count: int) -> dict[str, npt.NDArray[Any]]:
    """The arrays of a result for so many labels, as if nothing was fitted."""
    numbers = {name: np.full(count, np.nan) for name in ("radius", "rmse", "rmse_metric", "p_value", "p_flat")}
    return {
        "kind": np.full(count, Primitive.NONE, np.uint8),
        "centre": np.full((count, 3), np.nan),
        "axis": np.full((count, 3), np.nan),
        "convex": np.zeros(count, np.bool_),
        "covariance": np.full((count, PARAMETERS, PARAMETERS), np.nan),
        "valid_count": np.zeros(count, np.int32),
        "status": np.full(count, TileStatus.TOO_FEW, np.uint8),
        **numbers,
    }
