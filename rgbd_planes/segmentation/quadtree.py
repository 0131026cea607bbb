"""The paper's planar segmentation: a grid of squares, split in four where they are not flat, then k-means."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Arrays, Indices
from rgbd_planes._core.checks import FixedArguments, check_choice, check_max_error, check_share, check_whole
from rgbd_planes._core.compile_notice import announced
from rgbd_planes._core.status import TileStatus
from rgbd_planes._core.text import counted
from rgbd_planes.camera.camera import Camera, check_camera
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.camera.frame_warnings import warn_of_noise
from rgbd_planes.fitting.merge import merge
from rgbd_planes.fitting.methods import METHODS, solve_planes, valid_needed
from rgbd_planes.fitting.results import allocate
from rgbd_planes.fitting.saving import Values, check_alike
from rgbd_planes.fitting.tile_grid import check_tile, grid_shape, tile_windows
from rgbd_planes.fitting.tiles import TileFitter
from rgbd_planes.fitting.window_moments import WindowMoments
from rgbd_planes.fitting.windows import WindowPlanes
from rgbd_planes.kernels.moments.merge import merge_by_four

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Writes the moments of the elements of one level, at some rows and columns of its grid, into arrays.
WriteMoments = Callable[[int, Indices, Indices, Indices, Arrays], None]


@dataclass(frozen=True, eq=False, repr=False)
class QuadtreePlanes(WindowPlanes):
    """The elements of a quadtree and their planes: arrays of shape (K, ...), one row per element.

    Elements that were split are not among them. An element is OK (its plane fits), TOO_FEW (too many missing
    pixels), or could not be split any further: DEGENERATE, or ROUGH (its residual is too large).

    Attributes
    ----------
    level : (K,) int64
        How many times the grid was split to get the element.
    """

    level: Indices

    def _places(self) -> dict[str, npt.NDArray[Any]]:
        return super()._places() | {"level": self.level}

    @classmethod
    def _kind(cls) -> str:
        return WindowPlanes._kind()  # whose `load` reads these, too

    @classmethod
    def _checked(cls, values: Values) -> Values:
        values = super()._checked(values)
        check_alike(values, {"level": np.empty(len(values["windows"]), np.int64)})
        return values


@dataclass(frozen=True, eq=False, repr=False)
class QuadtreeSegmentation:
    """A frame segmented as in the paper.

    Attributes
    ----------
    elements : QuadtreePlanes
    element_labels : (K,) int32
        The cluster of each element: 0 none, 1..N.
    planes : (N, 4) float64
        nx, ny, nz, d of the plane through all pixels of a cluster, ‖n‖ = 1, d > 0; row i is label i + 1.
        Cluster 1 has the most pixels. NaN where the cluster's pixels determine none (`TileStatus` DEGENERATE).
    """

    elements: QuadtreePlanes
    element_labels: npt.NDArray[np.int32]
    planes: npt.NDArray[np.float64]

    @property
    def labels(self) -> npt.NDArray[np.int32]:
        """(H, W) int32: the cluster of each pixel's element, 0 none."""
        labels = np.zeros(self.elements.camera.shape, np.int32)
        for (row, column, height, width), label in zip(self.elements.windows, self.element_labels, strict=True):
            labels[row : row + height, column : column + width] = label
        return labels

    def __repr__(self) -> str:
        elements = f"{counted(len(self.elements.windows), 'element')}, {self.elements._summary()}"
        return f"<QuadtreeSegmentation: {counted(len(self.planes), 'plane')} of {elements}>"

    def _repr_html_(self) -> str:
        """What a notebook shows: the counts and a small picture."""
        from rgbd_planes.plotting.preview import quadtree_html

        return quadtree_html(self)

    def plot(self, depth: npt.ArrayLike | None = None, figure: Figure | None = None) -> Figure:
        """Draw the depth, and the elements as the paper does.

        Parameters
        ----------
        depth : (H, W) array_like, optional
            The frame that was segmented; without it the fitted planes' own depth is drawn.
        figure : matplotlib Figure, optional
            Drawn into; a new one by default.
        """
        from rgbd_planes.plotting.quadtree import plot_quadtree

        metres = None if depth is None else as_depth_frame(depth, self.elements.camera).metres
        return plot_quadtree(self, metres, figure)


class QuadtreeFitter(FixedArguments):
    """Fits quadtrees to one camera's frames; what depends on the camera alone is computed once, here.

    Parameters
    ----------
    camera : Camera
    tile : int
        Width and height of the grid's squares in pixels.
    method : str
        A method of `fit_tiles`.
    max_subdivisions : int
        How often a square may be split.
    max_error : float
        Residual in metres along the normal above which a square is split.
    max_missing : float
        Share of missing pixels above which a square is dropped.
    implementation : {"direct", "integral"}
        Where an element's moments come from: those of the finest tiles, added up, or summed-area tables.
    """

    camera: Camera
    method: str
    implementation: str

    def __init__(
        self,
        camera: Camera,
        tile: int = 32,
        method: str = "range_explicit",
        *,
        max_subdivisions: int = 2,
        max_error: float = 0.03,
        max_missing: float = 0.5,
        implementation: str = "direct",
    ) -> None:
        check_camera(camera)
        check_choice("method", method, METHODS)
        check_choice("implementation", implementation, ("direct", "integral"))
        tile = check_whole("tile", tile, 2, "whole number of pixels")
        max_subdivisions = check_whole("max_subdivisions", max_subdivisions, 0)
        finest = tile >> max_subdivisions
        if finest < 2 or finest << max_subdivisions != tile:
            raise ValueError(
                f"tile must be 2**max_subdivisions times a whole number of at least 2 pixels, got {tile} "
                f"for max_subdivisions {max_subdivisions}"
            )
        check_tile(tile, camera.shape)
        vars(self).update(camera=camera, method=method, implementation=implementation)
        # Of all squares of each level, (R, C, 4).
        self._windows = [_squares(camera, tile >> level) for level in range(max_subdivisions + 1)]
        self._max_error = check_max_error(max_error)
        self._max_missing = check_share("max_missing", max_missing)
        if implementation == "direct":
            self._finest = TileFitter(camera, finest, method, num_threads=1)
        else:
            self._tables = WindowMoments(camera, method, "integral")
            self._full = [self._full_level(windows) for windows in self._windows]

    def fit(self, depth: npt.ArrayLike) -> QuadtreePlanes:
        """Fit the elements of a frame, splitting where the residual is too large."""
        with announced(("quadtree", self.method, self.implementation)):
            prepare = self._direct if self.implementation == "direct" else self._integral
            write_moments, total = prepare(depth)
            row, column = (index.ravel() for index in np.indices(self._windows[0].shape[:2]))
            leaves: list[dict[str, npt.NDArray[np.generic]]] = []
            for level, squares in enumerate(self._windows):
                windows = squares[row, column]
                arrays = allocate((), (len(windows),))
                write_moments(level, row, column, windows, arrays)
                needed = valid_needed(windows[:, 2] * windows[:, 3], self._max_missing)
                solve_planes(self.method, arrays, needed, self._max_error, 0, len(windows), total)
                status = arrays["status"]
                split = (status == TileStatus.ROUGH) | (status == TileStatus.DEGENERATE)
                split &= level + 1 < len(self._windows)
                arrays |= {"windows": windows, "level": np.full(len(windows), level)}
                leaves.append(
                    {
                        name: np.compress(~split, array, axis=1 if name.startswith("_") else 0)
                        for name, array in arrays.items()
                    }
                )
                row, column = self._children(level, row[split], column[split])
        return QuadtreePlanes(
            camera=self.camera,
            method=self.method,
            _frame_total=total,
            **{
                name: np.concatenate([part[name] for part in leaves], axis=1 if name.startswith("_") else 0)
                for name in leaves[0]
            },
        )

    def _full_level(self, windows: Indices) -> npt.NDArray[np.float64]:
        """(6, R, C) camera terms of all squares of a level."""
        rows, columns, _ = windows.shape
        full = np.empty((6, rows * columns))
        self._tables.camera_moments(windows.reshape(-1, 4), 0, rows * columns, full)
        return full.reshape(6, rows, columns)

    def _children(self, level: int, row: Indices, column: Indices) -> tuple[Indices, Indices]:
        """The four squares that each square of a level splits into, where the frame has them."""
        if level + 1 == len(self._windows):
            return row, column
        row = (2 * row[:, None] + np.array([0, 0, 1, 1])).ravel()
        column = (2 * column[:, None] + np.array([0, 1, 0, 1])).ravel()
        rows, columns, _ = self._windows[level + 1].shape
        inside = (row < rows) & (column < columns)
        return row[inside], column[inside]

    def _integral(self, depth: npt.ArrayLike) -> tuple[WriteMoments, float]:
        frame = as_depth_frame(depth, self.camera)
        warn_of_noise(frame, self.camera.noise)
        source = self._tables.prepare(frame)

        def write(level: int, row: Indices, column: Indices, windows: Indices, arrays: Arrays) -> None:
            source(windows, self._full[level][:, row, column], 0, len(windows), arrays["_moments"])

        return write, source.total

    def _direct(self, depth: npt.ArrayLike) -> tuple[WriteMoments, float]:
        finest = self._finest.fit(depth)
        levels = [(finest._moments, finest._reference)]
        for windows in self._windows[-2::-1]:
            wider = np.empty((10, *windows.shape[:2])), np.empty((3, *windows.shape[:2]))
            merge_by_four(*levels[-1], *wider)
            levels.append(wider)
        levels.reverse()

        def write(level: int, row: Indices, column: Indices, windows: Indices, arrays: Arrays) -> None:
            moments, reference = levels[level]
            arrays["_moments"][:] = moments[:, row, column]
            arrays["_reference"][:] = reference[:, row, column]

        return write, 0.0


def _squares(camera: Camera, size: int) -> Indices:
    """(R, C, 4): row, column, height, width in pixels of squares of a grid, cut at the frame's border."""
    return tile_windows(camera.shape, (size, size)).reshape(*grid_shape(camera, (size, size)), 4)


def segment_quadtree(
    depth: npt.ArrayLike,
    camera: Camera,
    tile: int = 32,
    method: str = "range_explicit",
    *,
    max_subdivisions: int = 2,
    max_error: float = 0.03,
    max_missing: float = 0.5,
    clusters: int = 8,
    seed: int = 0,
) -> QuadtreeSegmentation:
    """Segment a frame as the paper does: a grid of squares, split where not flat, then k-means.

    Each square is fitted. Where the residual is too large, or the pixels determine no plane, the square is split into
    four. Their moments are sums of the moments of finer tiles, so that no pixel is read twice. Squares with too many
    missing pixels are dropped. K-means on the plane coefficients then labels similar planes.

    Parameters
    ----------
    depth : (H, W) array_like
        Integers in the camera's ``depth_scale`` or ``disparity``, or floats: metres, or, where the camera has
        ``disparity``, disparities.
    camera : Camera
    tile : int
        Width and height of the grid's squares in pixels.
    method : str
        ``range_explicit``, ``range_implicit``, ``standard_explicit``, ``standard_implicit`` or ``standard_pca``:
        `fit_tiles` explains them.
    max_subdivisions : int
        How often a square may be split; ``tile`` must be 2**max_subdivisions times a whole number of at least
        2 pixels.
    max_error : float
        Residual in metres along the normal (``rmse_metric``) above which a square is split. It must be larger than the
        sensor's noise at the farthest surface, which is 30 mm for a Kinect v1 at 4.6 m. The camera's noise model plays
        no part.
    max_missing : float
        Share of missing pixels above which a square is dropped.
    clusters : int
        Number of clusters of k-means. Fewer come back where the frame has fewer different planes, or k-means
        leaves some empty.
    seed : int
        Of k-means' starting points. The same seed gives the same segmentation.

    Returns
    -------
    QuadtreeSegmentation

    Raises
    ------
    TypeError, ValueError
        An argument cannot be used: the message says what was expected and what came.

    Warns
    -----
    UserWarning
        Something in the frame is most likely not meant as it is, such as its unit: `fit_tiles` lists what.

    Notes
    -----
    K-means works on (nx, ny, nz, d / D), with D the median depth of the fitted squares. So turning a plane by a small
    angle counts as much as moving it by that angle times the typical depth. Each square counts by its area; a square
    that is cut at the frame's border counts as a whole one.

    Papadakis and Willis 2017, section "Planar Segmentation Application".
    """
    clusters, seed = check_whole("clusters", clusters, 1), check_whole("seed", seed, 0)
    elements = QuadtreeFitter(
        camera, tile, method, max_subdivisions=max_subdivisions, max_error=max_error, max_missing=max_missing
    ).fit(depth)
    element_labels = _cluster(elements, clusters, seed)
    return QuadtreeSegmentation(elements, element_labels, merge(elements, element_labels).planes)


def _cluster(elements: QuadtreePlanes, clusters: int, seed: int) -> npt.NDArray[np.int32]:
    """Return the label of each element, from 1 for the cluster with the most pixels; 0 where none."""
    from scipy.cluster.vq import kmeans, vq

    labels = np.zeros(len(elements.status), np.int32)
    fitted = elements.status == TileStatus.OK
    if not fitted.any():
        return labels
    planes = elements.planes[fitted]
    pixels = np.prod(elements.windows[fitted, 2:], axis=1)
    typical_depth = np.median(_centre_depth(elements)[fitted])
    coefficients = planes / [1.0, 1.0, 1.0, typical_depth]
    different = len(np.unique(coefficients, axis=0))
    # K-means takes no weights: each element is repeated once for each of the smallest ones that it is as large as.
    repeats = 4 ** (elements.level.max() - elements.level[fitted])
    centres, _ = kmeans(
        coefficients.repeat(repeats, axis=0), min(clusters, different), seed=np.random.default_rng(seed)
    )
    cluster, _ = vq(coefficients, centres)
    sizes = np.bincount(cluster, pixels, len(centres))
    rank = np.empty(len(centres), np.int32)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(1, len(centres) + 1)
    labels[fitted] = rank[cluster]
    return labels


def _centre_depth(elements: QuadtreePlanes) -> npt.NDArray[np.float64]:
    """(K,) depth in metres of each element's plane at the element's middle."""
    row, column, height, width = elements.windows.T
    middle = row + height // 2, column + width // 2
    rays = np.stack([elements.camera.tan_x[middle], elements.camera.tan_y[middle], np.ones(len(row))])
    with np.errstate(divide="ignore"):  # a plane may be farther away than any number says
        return np.asarray(1.0 / np.einsum("ki,ik->k", elements.alpha, rays))
