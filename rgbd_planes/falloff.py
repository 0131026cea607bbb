"""How a sensor's noise grows away from the optical axis, over pixels and parts of its image: `NoiseModel.falloff`."""

import functools

import numpy as np
import numpy.typing as npt

from rgbd_planes.camera import Camera
from rgbd_planes.ray_pitch import means_over
from rgbd_planes.tile_grid import tile_footprints

Floats = npt.NDArray[np.float64]


@functools.lru_cache(maxsize=2)
def growth_of_pixels(camera: Camera) -> Floats:
    """(H, W) float64: how many times that on the axis the variance of q before rounding is; (0, 0) without falloff."""
    if camera.noise is None or not camera.noise.falloff:
        return np.empty((0, 0))
    made = camera.noise._growth(camera.tan_x, camera.tan_y)
    made.flags.writeable = False
    return made


def growth_of_parts(camera: Camera, footprint: npt.NDArray[np.int64]) -> Floats:
    """(N,) float64: means of that over parts of the image, as `ray_pitch.pitch_square` takes them; (0,) likewise."""
    if camera.noise is None or not camera.noise.falloff:
        return np.empty(0)
    return _growth_of_parts(camera, np.ascontiguousarray(footprint).tobytes())


@functools.lru_cache(maxsize=8)
def _growth_of_parts(camera: Camera, footprint: bytes) -> Floats:
    made = means_over(growth_of_pixels(camera)[None], np.frombuffer(footprint, np.int64).reshape(-1, 5))
    made.flags.writeable = False
    return np.asarray(made[0])


@functools.lru_cache(maxsize=8)
def growth_of_tiles(camera: Camera, tile: tuple[int, int]) -> Floats:
    """The same of all tiles of a grid."""
    return growth_of_parts(camera, tile_footprints(camera.shape, tile))
