"""The result of segmenting a depth frame: which pixel belongs to which plane, or why to none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.status import Reason
from rgbd_planes._core.text import counted, percent
from rgbd_planes.camera.camera import Camera
from rgbd_planes.fitting.saving import Savable, Values, check_alike, check_covariances, check_label_image, check_planes
from rgbd_planes.fitting.tile_grid import common_labels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rgbd_planes.plotting.protocols import NamedSurfaces


@dataclass(frozen=True, eq=False, repr=False)
class Segmentation(Savable):
    """The planes of a frame, and which pixel belongs to which.

    Attributes
    ----------
    camera : Camera
    labels : (H, W) int32
        0 none, 1..N; row i of the arrays below belongs to label i + 1.
    planes : (N, 4) float64
        nx, ny, nz, d of n·X + d = 0, ‖n‖ = 1, d > 0, n towards the camera; metres.
    alpha : (N, 3) float64
        -n / d, in 1/m: q = α·(tanθx, tanθy, 1). It is the least squares fit to the label's interior pixels. All
        eight measured neighbours of these have the label, too: at an edge a pixel may see both sides. Where fewer than
        half are interior, it is the fit to all pixels of the label. Strays that took their neighbours' label in the end
        are in no fit, and neither are the pixels beside them.
    alpha_covariance : (N, 3, 3) float64
        Of α, in 1/m². With a noise model it is the covariance that `fit_labels` gives for the pixels of the fit, or
        more by as much as their residual exceeds the model's. That holds if the model says what errors neighbours
        share, or if the frame shows no such errors. Otherwise, and without a model, it follows from the residual or the
        frame's noise, whichever is larger, and from as many independent pixels as flat squares show.
    sizes : (N,) int32
        Pixels.
    rmse : (N,) float64
        Root mean square residual in inverse depth, 1/m, of the pixels of the fit. Whether a noise model explains it is
        what ``fit_labels(depth, camera, labels).p_value`` says, of all pixels of each label.
    reason : (H, W) uint8
        `Reason`.
    sigma : float
        Typical standard deviation of the frame's inverse depth, 1/m.
    evidence : (N,) float64
        Logarithm of how many times more likely each plane makes its pixels than the best plane without it does; NaN in
        results from files of earlier versions.
    curved_labels : (H, W) int32
        The connected curved surfaces that pixels of ``Reason.CURVED`` make: 1..M in the order of their first pixels, 0
        elsewhere. Depth jumps part them, and those of fewer than ``min_size`` pixels are left out.

    Notes
    -----
    Squares of 16 to 64 pixels within planes show shared errors. A frame has none if they differ as independent errors
    make them differ in 99 frames of a hundred. Nor has it any if they are too few to tell. The frame's noise counts as
    no less than 0.04 % of 1/Z, and chance and edges pass for errors that reach far. So where errors are independent,
    covariances without a model are too large, in single frames many times. Where errors reach farther than the squares
    show, as the errors of most sensors do, they are too small.
    """

    camera: Camera
    labels: NDArray[np.int32]
    planes: Floats
    alpha: Floats
    alpha_covariance: Floats
    sizes: NDArray[np.int32]
    rmse: Floats
    reason: NDArray[np.uint8]
    sigma: float
    evidence: Floats
    curved_labels: NDArray[np.int32]

    _later: ClassVar[frozenset[str]] = frozenset({"evidence", "curved_labels"})

    def __len__(self) -> int:
        """Number of planes."""
        return len(self.planes)

    def __repr__(self) -> str:
        return f"<Segmentation: {self._summary} of {self.camera.width} x {self.camera.height}>"

    @property
    def _summary(self) -> str:
        """How many planes there are, and on how much of what was measured."""
        nothing = bool((self.reason == Reason.MISSING).all())
        share = "nothing measured" if nothing else f"{percent(self.share)} of the measured pixels"
        return f"{counted(len(self), 'plane')}, {share}"

    def _repr_html_(self) -> str:
        """What a notebook shows: the counts and a small picture."""
        from rgbd_planes.plotting.preview import segments_html

        return segments_html(self)

    @property
    def share(self) -> float:
        """Share of the measured pixels that belong to a plane."""
        return int(np.count_nonzero(self.labels)) / max(1, int((self.reason != Reason.MISSING).sum()))

    @property
    def rmse_metric(self) -> Floats:
        """(N,) float64: `rmse` in metres along the normal, d·Z̄·rmse, to first order.

        It holds at the plane's mean inverse depth. For a plane that spans a range of depths, like a long floor, it is
        smaller than the root mean square of the points' distances, which grow with depth.
        """
        return self.planes[:, 3] * self.mean_depth * self.rmse

    @property
    def mean_depth(self) -> Floats:
        """(N,) float64: Z in metres at the mean inverse depth of the plane's pixels; NaN where it has none."""
        labels = self.labels.ravel()
        counts = np.bincount(labels, minlength=len(self) + 1)[1:]
        sums = np.bincount(labels, self.fitted_inverse_depth().ravel(), len(self) + 1)[1:]
        return np.asarray(np.divide(counts, sums, out=np.full(len(self), np.nan), where=counts > 0))

    @property
    def _boxes(self) -> list[tuple[slice, slice]]:
        return boxes_of(self.labels, len(self))

    @property
    def plane_covariance(self) -> Floats:
        """(N, 4, 4) float64: covariance of (n, d), by first-order propagation from α."""
        n, d = self.planes[:, :3], self.planes[:, 3]
        # ∂n/∂α = -d (I - n nᵀ), ∂d/∂α = d² n, from d = 1/‖α‖ and n = -α d.
        jacobian = np.empty((len(self), 4, 3))
        jacobian[:, :3] = -d[:, None, None] * (np.eye(3) - n[:, :, None] * n[:, None, :])
        jacobian[:, 3] = d[:, None] ** 2 * n
        covariance = np.asarray(jacobian @ self.alpha_covariance @ jacobian.transpose(0, 2, 1))
        return np.asarray(0.5 * (covariance + covariance.transpose(0, 2, 1)))  # rounding has no symmetry

    @property
    def angle_std(self) -> Floats:
        """(N,) float64, degrees: root mean square of the angle between the normal and the true one, √tr Σn."""
        return np.asarray(np.degrees(np.sqrt(np.trace(self.plane_covariance[:, :3, :3], axis1=1, axis2=2))))

    @property
    def offset_std(self) -> Floats:
        """(N,) float64, metres: standard deviation of d.

        d is the distance of the camera from the plane extended up to it. The tilt of a small plane moves it far more
        than the surface itself. The uncertainty of the surface at a point is what `uncertainty.point_distance` gives.
        The mean of d is smaller than the true one, by d·θ²/2 - σd²/d where θ is `angle_std` in radians, since normals
        err to all sides. That matters most for small planes that face the camera.
        """
        return np.sqrt(self.plane_covariance[:, 3, 3])

    def fitted_inverse_depth(self) -> Floats:
        """(H, W) float64, 1/m: the inverse depth of each pixel's plane; 0 where there is none."""
        a: Floats
        a, b, c = np.vstack([np.zeros(3), self.alpha]).T.take(self.labels, axis=1)
        return np.asarray(a * self.camera.tan_x + b * self.camera.tan_y + c)

    def fitted_depth(self) -> Floats:
        """(H, W) float64, metres: where each pixel's ray meets its plane; NaN where there is none."""
        q = self.fitted_inverse_depth()
        depth = np.full(q.shape, np.nan)
        np.divide(1.0, q, out=depth, where=q > 0.0)
        return depth

    def tile_labels(self, tile: int | tuple[int, int]) -> NDArray[np.int32]:
        """(R, C) int32: the plane that all measured pixels of each tile of a grid lie on, 0 where they do not.

        ``tile`` is that of `fit_tiles`, and raises the same errors.
        """
        missing = self.reason == Reason.MISSING
        return common_labels(np.where(missing, len(self) + 1, self.labels), self.labels, tile)

    def labels_from_minus_one(self) -> NDArray[np.int32]:
        """(H, W) int32: labels 0..N-1, -1 for none, as deplex and clustering libraries have them."""
        return self.labels - np.int32(1)

    def labels_for_opencv(self) -> NDArray[np.uint8]:
        """(H, W) uint8: labels 0..N-1, 255 for none, as OpenCV's RgbdPlane has them.

        Raises
        ------
        ValueError
            There are more than 255 planes.
        """
        if len(self) > 255:
            raise ValueError(f"expected at most 255 planes, which is all that uint8 labels hold, got {len(self)}")
        return (self.labels - 1).astype(np.uint8)  # -1 becomes 255

    def to_table(self) -> dict[str, NDArray[Any]]:
        """Return one row per plane as a dict of equally long columns, which `pandas.DataFrame` takes.

        Columns: label, size in pixels; nx, ny, nz, d; rmse, rmse_metric; angle_std, offset_std; evidence.
        """
        return {
            "label": np.arange(1, len(self) + 1),
            "size": self.sizes.copy(),
            **dict(zip(("nx", "ny", "nz", "d"), self.planes.T.copy(), strict=True)),
            "rmse": self.rmse.copy(),
            "rmse_metric": self.rmse_metric,
            "angle_std": self.angle_std,
            "offset_std": self.offset_std,
            "evidence": self.evidence.copy(),
        }

    @classmethod
    def _checked(cls, values: Values) -> Values:
        camera, labels, count = values["camera"], values["labels"], len(values["sizes"])
        if labels.shape != camera.shape:  # before memory is asked for: a nonsensical size takes any amount
            raise ValueError("labels of another image size")
        values = {"evidence": np.full(count, np.nan), "curved_labels": np.zeros_like(labels), **values}
        check_alike(values, _allocate(camera, count))
        check_label_image(labels, camera.shape, count)
        check_label_image(values["curved_labels"], camera.shape, labels.size)
        check_planes(values["planes"], values["alpha"])
        check_covariances(values["alpha_covariance"])
        return {**values, "sigma": float(values["sigma"])}

    def plot(
        self, depth: ArrayLike | None = None, figure: Figure | None = None, *, primitives: NamedSurfaces | None = None
    ) -> Figure:
        """Draw the planes in colours over the relief of the depth.

        Parameters
        ----------
        depth : (H, W) array_like, optional
            The frame that was segmented, for its relief.
        figure : matplotlib Figure, optional
            Drawn into; a new one by default.
        primitives : PrimitiveFits, optional
            What `fit_primitives` gave for ``curved_labels``. Spheres and cylinders get colours, too, and on them stands
            the radius ± its standard deviation in millimetres.

        Raises
        ------
        TypeError, ValueError
            The figure is none, or the primitives are no `PrimitiveFits` or of a frame of another size.
        """
        from rgbd_planes.plotting.segments import plot_segments

        return plot_segments(self, depth, figure, primitives=primitives)


def boxes_of(labels: NDArray[np.int32], count: int) -> list[tuple[slice, slice]]:
    """The rows and columns that the pixels of labels 1 to ``count`` lie in; none for a label without pixels."""
    from scipy.ndimage import find_objects

    nowhere = slice(0, 0), slice(0, 0)
    return [nowhere if box is None else (box[0], box[1]) for box in find_objects(labels, max_label=count)]


def no_segmentation(given: Any, expected: str = "a Segmentation") -> TypeError:
    """The error for something else, which says where one is."""
    hint = ": its .segmentation is one" if isinstance(getattr(given, "segmentation", None), Segmentation) else ""
    return TypeError(f"expected {expected}, got {type(given).__name__}{hint}")


def _allocate(camera: Camera, count: int) -> dict[str, NDArray[Any]]:
    """The arrays of a segmentation with ``count`` planes."""
    return {
        "labels": np.empty(camera.shape, np.int32),
        "planes": np.empty((count, 4)),
        "alpha": np.empty((count, 3)),
        "alpha_covariance": np.empty((count, 3, 3)),
        "sizes": np.empty(count, np.int32),
        "rmse": np.empty(count),
        "reason": np.empty(camera.shape, np.uint8),
        "evidence": np.empty(count),
        "curved_labels": np.empty(camera.shape, np.int32),
    }
