"""What an estimated noise model was estimated from, and where in the image the sensor is not flat."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from rgbd_planes.camera import Camera
from rgbd_planes.depth import as_depth_frame
from rgbd_planes.merging import merge
from rgbd_planes.noise import NoiseModel
from rgbd_planes.noise_samples import REFERENCE, Samples, bins_of
from rgbd_planes.plane_fits import TileStatus
from rgbd_planes.tile_planes import TilePlanes
from rgbd_planes.tiles import TileFitter
from rgbd_planes.uncertainty import same_plane

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Float = npt.NDArray[np.float64]

CELL = 8
"""Side in pixels of the cells of the flatness map."""
_TILE = 16  # of the planes of the flatness map, and how many tiles make a large one
_LARGE = 60


@dataclass(frozen=True, eq=False)
class NoiseEvidence:
    """What an estimated noise model was estimated from.

    Attributes
    ----------
    windows : int
        Number of flat windows, of 24 x 24 pixels.
    sizes : (S,) int64
        Sides of tiles.
    residuals, expected : (S,) float64
        Median of the root mean square residual of the flat tiles of each size, as a multiple of the model's
        σq, and the same by the model.
    inverse_depth, sigma, sigma_fit : (K,) float64
        By depth: root mean square residual of the tiles of 12 pixels there, and the model's.
    p_values : (T,) float64
        Of those tiles; uniform if the model is right.
    noise_map : (R, C) float64
        Their residual over the model's, by place in the image; NaN where no frame is flat.
    flatness : (H / 8, W / 8) float64
        The sensor's own bias over the image in 1/m: mean residual of large planes in cells of `CELL` pixels.
        NaN where no large plane was seen. A part that is itself planar over the whole of every surface does
        not show.
    flatness_count : (H / 8, W / 8) int64
        How many pixels each cell's mean is of.
    """

    windows: int
    sizes: npt.NDArray[np.int64]
    residuals: Float
    expected: Float
    inverse_depth: Float
    sigma: Float
    sigma_fit: Float
    p_values: Float
    noise_map: Float
    flatness: Float
    flatness_count: npt.NDArray[np.int64]

    def plot(self, figure: "Figure | None" = None) -> "Figure":
        """Draw the fit and the maps; see `noise_plotting.plot_evidence`."""
        from rgbd_planes.noise_plotting import plot_evidence

        return plot_evidence(self, figure)


def evidence_of(
    frames: Sequence[Any],
    camera: Camera,
    model: NoiseModel,
    samples: dict[int, Samples],
    tiles: dict[int, TilePlanes],
    windows: int,
) -> NoiseEvidence:
    """What the samples of these tiles of frames say for and against a model."""
    from scipy.special import chdtrc

    size = REFERENCE
    chosen = samples[size]
    expected, freedom = chosen.expected(model)
    ratio = chosen.rss / expected
    bins = bins_of(chosen.q, 60)
    sizes = np.array(list(samples))
    sums, numbers = np.zeros(tiles[size].shape[1:]), np.zeros(tiles[size].shape[1:])
    np.add.at(sums, chosen.place[1:], np.minimum(ratio, 4.0))
    np.add.at(numbers, chosen.place[1:], 1.0)
    flatness, flatness_count = _flatness(frames, replace(camera, noise=model))
    return NoiseEvidence(
        windows=windows,
        sizes=sizes,
        residuals=np.sqrt([max(some.typical(model)[0], 0.0) for some in samples.values()]),
        expected=np.sqrt(model.statistics(sizes**2).expected) / sizes,
        inverse_depth=np.array([np.median(chosen.q[some]) for some in bins]),
        sigma=np.sqrt([np.median((chosen.rss / chosen.count)[some]) for some in bins]),
        sigma_fit=np.sqrt([np.median((expected / chosen.count)[some]) for some in bins]),
        p_values=chdtrc(freedom, ratio * freedom),
        noise_map=np.sqrt(np.divide(sums, numbers, out=np.full(sums.shape, np.nan), where=numbers > 0.0)),
        flatness=flatness,
        flatness_count=flatness_count,
    )


def _flatness(frames: Sequence[Any], camera: Camera) -> tuple[Float, npt.NDArray[np.int64]]:
    """Mean residual over the image of the planes that are seen large: see `NoiseEvidence`."""
    shape = -(-camera.height // CELL), -(-camera.width // CELL)
    sums, numbers = np.zeros(shape), np.zeros(shape, np.int64)
    cell_rows = np.arange(camera.height) // CELL
    cell_columns = np.arange(camera.width) // CELL
    fitter = TileFitter(camera, _TILE, significance=1e-3)
    for depth in frames:
        tiles = fitter.fit(depth)
        labels = _connected(tiles)
        merged = merge(tiles, labels)
        # Links from tile to tile can lead around a bend: what is not on the common plane is left out.
        on_plane = labels > 0
        of = labels[on_plane] - 1
        on_plane[on_plane] = (
            same_plane(
                tiles.alpha[on_plane],
                tiles.alpha_covariance[on_plane],
                merged.alpha[of],
                merged.alpha_covariance[of],
            )
            > 1e-3
        )
        labels[~on_plane] = 0
        merged = merge(tiles, labels, significance=1e-3)
        large = np.bincount(labels.ravel(), minlength=len(merged.status) + 1)[1:] >= _LARGE
        large &= merged.status == TileStatus.OK
        alpha = np.where(large[:, None], merged.alpha, np.nan)
        pixels = labels.repeat(_TILE, axis=0).repeat(_TILE, axis=1)[: camera.height, : camera.width]
        alpha = np.vstack([np.full((1, 3), np.nan), alpha])[pixels]
        fitted = alpha[..., 0] * camera.tan_x + alpha[..., 1] * camera.tan_y + alpha[..., 2]
        residual = as_depth_frame(depth, camera).inverse_depth - fitted
        assert camera.noise is not None
        usual = np.hypot(1.0, camera.noise.floor) * camera.noise.sigma(fitted)
        seen = np.abs(residual) < 6.0 * usual  # also False where missing
        index = (cell_rows[:, None] * shape[1] + cell_columns)[seen]
        sums += np.bincount(index, residual[seen], shape[0] * shape[1]).reshape(shape)
        numbers += np.bincount(index, minlength=shape[0] * shape[1]).reshape(shape)
    return np.divide(sums, numbers, out=np.full(shape, np.nan), where=numbers > 0), numbers


def _connected(tiles: TilePlanes) -> npt.NDArray[np.int64]:
    """Label, from 1, flat tiles that neighbours link to one plane; 0 elsewhere."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    flat = tiles.status == TileStatus.OK
    alpha, covariance = tiles.alpha, tiles.alpha_covariance
    index = np.arange(flat.size).reshape(flat.shape)
    links = []
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        same = same_plane(alpha[a], covariance[a], alpha[b], covariance[b]) > 0.05
        same &= flat[a] & flat[b]
        links.append((index[a][same], index[b][same]))
    first, second = (np.concatenate(ends) for ends in zip(*links, strict=True))
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(flat.size, flat.size))
    component = connected_components(graph, directed=False)[1].reshape(flat.shape)
    labels = np.zeros(flat.shape, np.int64)
    labels[flat] = np.unique(component[flat], return_inverse=True)[1] + 1
    return labels
