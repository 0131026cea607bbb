"""What an estimated noise model was estimated from, and where in the image the sensor is not flat."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.text import percent
from rgbd_planes.camera.camera import Camera
from rgbd_planes.noise.correlation import deviate_of
from rgbd_planes.noise.model import NoiseModel
from rgbd_planes.noise_estimation.bias_map import flatness
from rgbd_planes.noise_estimation.large_planes import TILE, bends_by_side, large_planes
from rgbd_planes.noise_estimation.samples import REFERENCE, WINDOW, Samples, bins_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class NoiseEvidence:
    """What an estimated noise model was estimated from.

    Attributes
    ----------
    frames, windows : int
        Number of frames, and of flat windows, of 24 x 24 pixels.
    sizes : (S,) int64
        Sides of tiles; then, if there are any, of squares as large as the large planes of a frame.
    residuals, expected : (S,) float64
        Median of the root mean square residual of the flat tiles of each size, or of large planes, as a multiple of the
        model's σq, and what the model expects.
    inverse_depth, sigma, sigma_fit : (K,) float64
        By depth: root mean square residual of the tiles of 12 pixels there, and the model's.
    p_values : (T,) float64
        Of those tiles; uniform if the model is right.
    noise_map : (R, C) float64
        Their residual over the model's, by place in the image, as far as whole windows go; NaN where no frame is flat.
    edge_growth : float
        The model's σq before rounding where they are farthest from the optical axis, as a multiple of that on it.
    flatness : (⌈H / 8⌉, ⌈W / 8⌉) float64
        The sensor's own bias over the image in 1/m, in cells of 8 pixels: what all large planes of all frames
        have in common. NaN where none was seen. A part that is itself planar over the image does not show.
    flatness_count : (⌈H / 8⌉, ⌈W / 8⌉) int64
        Number of pixels behind each cell's mean.
    flatness_std : (⌈H / 8⌉, ⌈W / 8⌉) float64
        Standard deviation in 1/m that random errors alone, with what neighbouring pixels share of them, give each cell.
    """

    TILE: ClassVar[int] = REFERENCE
    frames: int
    windows: int
    sizes: npt.NDArray[np.int64]
    residuals: Floats
    expected: Floats
    inverse_depth: Floats
    sigma: Floats
    sigma_fit: Floats
    p_values: Floats
    noise_map: Floats
    edge_growth: float
    flatness: Floats
    flatness_count: npt.NDArray[np.int64]
    flatness_std: Floats

    def __repr__(self) -> str:
        tiles = f"{len(self.p_values)} flat tiles, {self._rejected()} of p-values below 1 %"
        return f"<NoiseEvidence: {self.windows} flat windows, {tiles}>"

    def _rejected(self) -> str:
        """Share of the tiles whose p-value is below 1 %, which is 1 % if the model is right."""
        return percent(np.mean(self.p_values < 0.01))

    def plot(self, figure: "Figure | None" = None) -> "Figure":
        """Draw the noise by depth, the reach of errors, p-values, and maps of the noise and the bias.

        Parameters
        ----------
        figure : matplotlib Figure, optional
            Drawn into, with texts for 15 x 8.2 inches and ``layout="constrained"``; a new one by default.
        """
        from rgbd_planes.plotting.noise import plot_evidence

        return plot_evidence(self, figure)

    def _figure_html(self) -> str:
        """The figure, as an image in HTML."""
        from rgbd_planes.plotting.preview import DPI, image_html

        buffer = io.BytesIO()
        self.plot().savefig(buffer, dpi=DPI)
        return image_html("the evidence", buffer.getvalue())


def evidence_of(
    frames: Sequence[Any],
    camera: Camera,
    model: NoiseModel,
    samples: dict[int, Samples],
    windows: int,
    num_threads: int | None,
) -> NoiseEvidence:
    """What the flat tiles of frames, by size, say for and against a model."""
    from scipy.special import ndtr

    size = REFERENCE
    chosen = samples[size]
    expected, freedom = chosen.expected(model)
    ratio = chosen.rss / expected
    bins = bins_of(chosen.q, 60)
    sizes = np.array(list(samples))
    wide = camera.with_noise(model)
    large = large_planes(frames, wide, num_threads)  # once more, by the floor that they have shown
    sides, bends, _ = bends_by_side(large)
    residuals = np.append(
        [some.typical(model)[0] for some in samples.values()],
        bends + float(model.statistics(TILE * TILE).expected) / TILE**2,
    )
    sizes = np.append(sizes, np.rint(sides).astype(np.int64))
    inside = camera.height // WINDOW * WINDOW // size, camera.width // WINDOW * WINDOW // size
    sums, numbers = np.zeros(inside), np.zeros(inside)
    np.add.at(sums, chosen.place[1:], np.minimum(ratio, 4.0))
    np.add.at(numbers, chosen.place[1:], 1.0)
    bias, count, deviation = flatness(frames, large, wide)
    return NoiseEvidence(
        frames=len(frames),
        windows=windows,
        sizes=sizes,
        residuals=np.sqrt(np.maximum(residuals, 0.0)),
        expected=np.sqrt(model.statistics(sizes**2).expected) / sizes,
        inverse_depth=np.array([np.median(chosen.q[some]) for some in bins]),
        sigma=np.sqrt([np.median((chosen.rss / chosen.count)[some]) for some in bins]),
        sigma_fit=np.sqrt([np.median((expected / chosen.count)[some]) for some in bins]),
        p_values=ndtr(-deviate_of(ratio, freedom, model.spread)),
        noise_map=np.sqrt(np.divide(sums, numbers, out=np.full(sums.shape, np.nan), where=numbers > 0.0)),
        edge_growth=float(np.sqrt(np.max(chosen.growth(model)))),
        flatness=bias,
        flatness_count=count,
        flatness_std=deviation,
    )
