"""How a sensor's noise grows away from the optical axis, over pixels and parts of its image: `NoiseModel.falloff`."""

import functools

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Floats
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.pixel_pitch import means_over
from rgbd_planes.uncertainty.footprints import footprints

# Read-only, like every array here: Numba would compile the kernels again for a writable one.
EVEN: Floats = np.empty((2, 0))
"""`growth_of_parts` where nothing grows."""
EVEN.flags.writeable = False

_LEAST_SHARE = 1e-8  # of what is summed up to a window, the window's own: more is right to 1e-7


def growth_of_pixels(camera: Camera) -> Floats:
    """(H, W) float64: the variance of q before rounding, as a multiple of that on the axis; (0, 1) without falloff."""
    return _pixel_growth(camera) if _grows(camera) else EVEN[0, :, None]


def growth_of_parts(camera: Camera, footprint: npt.NDArray[np.int64]) -> Floats:
    """(2, N) float64: means of `growth_of_pixels` over parts of the image, and variances of its logarithm.

    ``footprint`` is that of `ray_pitch.pitch_square`. Over pixels that the lens has a ray for; 1 and 0 where there are
    none. (2, 0) without falloff.
    """
    return _part_growth(camera, np.ascontiguousarray(footprint).tobytes()) if _grows(camera) else EVEN


def growth_of_windows(camera: Camera, windows: npt.NDArray[np.int64]) -> Floats:
    """`growth_of_parts` for windows, as `fit_windows` takes them, over each of their pixels."""
    if not _grows(camera):
        return EVEN
    top, left, height, width = windows.T
    table, bottom, right = _summed(camera), top + height, left + width
    sums = table[:, bottom, right] - table[:, top, right] - table[:, bottom, left] + table[:, top, left]
    # Beside what a steep falloff makes of the rim, the sums of small windows have no digits left.
    lost = sums[0] < _LEAST_SHARE * table[0, bottom, right]
    found = _mean_and_spread(*sums)
    if lost.any():
        found = found.copy()
        found[:, lost] = growth_of_parts(camera, footprints(windows[lost]))
        found.flags.writeable = False
    return found


def growth_of_tiles(camera: Camera, tile: tuple[int, int]) -> Floats:
    """`growth_of_windows` for all tiles of a grid."""
    return _tile_growth(camera, tile) if _grows(camera) else EVEN


def _grows(camera: Camera) -> bool:
    return camera.noise is not None and camera.noise.falloff > 0.0


@functools.lru_cache(maxsize=2)
def _pixel_growth(camera: Camera) -> Floats:
    assert camera.noise is not None
    growth = camera.noise._growth(camera.tan_x, camera.tan_y)
    growth.flags.writeable = False
    return growth


@functools.lru_cache(maxsize=8)
def _part_growth(camera: Camera, footprint: bytes) -> Floats:
    parts = np.frombuffer(footprint, np.int64).reshape(-1, 5)
    return _mean_and_spread(*means_over(_seen_growth(camera), parts))


@functools.lru_cache(maxsize=8)
def _tile_growth(camera: Camera, tile: tuple[int, int]) -> Floats:
    rows, columns = (np.arange(0, length, side) for length, side in zip(camera.shape, tile, strict=True))
    sums = np.add.reduceat(np.add.reduceat(_seen_growth(camera), rows, axis=1), columns, axis=2)
    return _mean_and_spread(*sums.reshape(len(sums), -1))


@functools.lru_cache(maxsize=2)
def _summed(camera: Camera) -> Floats:
    """(4, H + 1, W + 1): summed-area tables of `_seen_growth`."""
    return np.pad(_seen_growth(camera).cumsum(axis=1).cumsum(axis=2), ((0, 0), (1, 0), (1, 0)))


def _seen_growth(camera: Camera) -> Floats:
    """(4, H, W): growth, its logarithm and the square of that, and 1; 0 where a fisheye lens has no ray."""
    growth, without_ray = growth_of_pixels(camera), camera._without_ray
    seen = np.ones(growth.shape) if without_ray is None else (~without_ray).astype(np.float64)
    logarithm = np.log(growth)
    return np.stack([growth * seen, logarithm * seen, logarithm * logarithm * seen, seen])


def _mean_and_spread(*sums: Floats) -> Floats:
    mean, logarithm, square = np.divide(sums[:3], sums[3], out=np.zeros((3, *sums[0].shape)), where=sums[3] > 0.0)
    result: Floats = np.stack([np.where(sums[3] > 0.0, mean, 1.0), square - logarithm**2])
    result.flags.writeable = False
    return result
