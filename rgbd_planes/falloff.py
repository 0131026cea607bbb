"""How a sensor's noise grows away from the optical axis, over pixels and parts of its image: `NoiseModel.falloff`."""

import functools

import numpy as np
import numpy.typing as npt

from rgbd_planes.camera import Camera
from rgbd_planes.ray_pitch import means_over
from rgbd_planes.tile_grid import tile_footprints

Floats = npt.NDArray[np.float64]

# As all arrays here it must not be written: of those that may be, kernels would be compiled once more.
EVEN: Floats = np.empty(0)
"""`growth_of_parts` where nothing grows."""
EVEN.flags.writeable = False


def growth_of_pixels(camera: Camera) -> Floats:
    """(H, W) float64: how many times that on the axis the variance of q before rounding is; (0, 1) without falloff."""
    return _of_pixels(camera) if _grows(camera) else EVEN[:, None]


def growth_of_parts(camera: Camera, footprint: npt.NDArray[np.int64]) -> Floats:
    """(N,) float64: means of that over parts of the image, as `ray_pitch.pitch_square` takes them; (0,) likewise."""
    return _of_parts(camera, np.ascontiguousarray(footprint).tobytes()) if _grows(camera) else EVEN


def growth_of_tiles(camera: Camera, tile: tuple[int, int]) -> Floats:
    """The same of all tiles of a grid."""
    return _of_tiles(camera, tile) if _grows(camera) else EVEN


def _grows(camera: Camera) -> bool:
    return camera.noise is not None and camera.noise.falloff > 0.0


@functools.lru_cache(maxsize=2)
def _of_pixels(camera: Camera) -> Floats:
    assert camera.noise is not None
    made = camera.noise._growth(camera.tan_x, camera.tan_y)
    made.flags.writeable = False
    return made


@functools.lru_cache(maxsize=8)
def _of_parts(camera: Camera, footprint: bytes) -> Floats:
    made = means_over(growth_of_pixels(camera)[None], np.frombuffer(footprint, np.int64).reshape(-1, 5))
    made.flags.writeable = False
    one: Floats = made[0]
    return one


@functools.lru_cache(maxsize=8)
def _of_tiles(camera: Camera, tile: tuple[int, int]) -> Floats:
    # Kept by itself: a fit of a frame takes less time than to tell the footprints of many tiles from others.
    return growth_of_parts(camera, tile_footprints(camera.shape, tile))
