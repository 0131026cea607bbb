"""How far apart the rays of neighbouring pixels are, which turns an error across the ray into one of inverse depth."""

import functools
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Floats
from rgbd_planes.camera.camera import Camera
from rgbd_planes.kernels.statistics.noise_variances import PLACES, WEIGHTS

_NONE: Floats = np.empty((0, 3, 0))
_NONE.flags.writeable = False  # as all that `lateral_of_pixels` gives: the kernels are compiled for either kind
WEIGHTS_OF_PLACES = np.outer(WEIGHTS, WEIGHTS).ravel()
"""Of Gauss's quadrature, for the nine places that two sides make."""
_ANGLES = 129  # angles off the axis in a table


def uneven_lateral(camera: Camera) -> float:
    """The lateral error, in pixels, if a lens makes what it does to q differ over a plane; 0 otherwise."""
    return camera.noise.lateral if camera.is_distorted and camera.noise is not None else 0.0


def lateral_of_pixels(camera: Camera) -> Floats:
    """(H, 3, W) float64: of each pixel λ²JJᵀ, as of `pitch_square`, with `uneven_lateral` λ; (0, 3, 0) without one."""
    lateral = uneven_lateral(camera)
    return _lateral_of_pixels(camera._lens, lateral) if lateral > 0.0 else _NONE


@functools.lru_cache(maxsize=2)
def _lateral_of_pixels(camera: Camera, lateral: float) -> Floats:
    made = np.ascontiguousarray(lateral**2 * np.moveaxis(_of_pixels(camera), 0, 1))
    made.flags.writeable = False
    return made


def pitch_square(camera: Camera, footprint: npt.NDArray[np.int64]) -> Floats:
    """(3, N) float64: means of JJᵀ over parts of the image: its entries uu, uv and vv.

    J is the change of (tanθx, tanθy) from pixel to pixel, which varies over the image behind a lens. ``footprint`` is
    (N, 5), for each part's pixels: their number, Σx, Σy, Σx² and Σy². A part counts as a rectangle with these sums.
    """
    if not camera.is_distorted:
        made = np.array([1.0 / camera.fx**2, 0.0, 1.0 / camera.fy**2])
        return np.repeat(made[:, None], len(footprint), axis=1)
    return _pitch_square(camera._lens, np.ascontiguousarray(footprint).tobytes())


@functools.lru_cache(maxsize=8)
def _pitch_square(camera: Camera, footprint: bytes) -> Floats:
    # Cached: for the tiles of a camera it is needed with each frame, and takes ten times as long as p-values.
    made = means_over(_of_pixels(camera), np.frombuffer(footprint, np.int64).reshape(-1, 5))
    made.flags.writeable = False
    return made


def means_over(tables: Floats, footprint: npt.NDArray[np.int64]) -> Floats:
    """(K, N) float64: means of tables (K, H, W), which change slowly over the image, over parts of it.

    ``footprint`` is as in `pitch_square`, and a part counts as a rectangle.
    """
    return np.asarray(np.einsum("i,kin->kn", WEIGHTS_OF_PLACES, _at_places(tables, footprint)))


def rays_in(camera: Camera, footprint: npt.NDArray[np.int64]) -> Floats:
    """(2, 9, N) float64: tanθx and tanθy at Gauss's quadrature places in parts of the image, as in `means_over`."""
    return _at_places((camera.tan_x, camera.tan_y), footprint)


def _at_places(tables: Sequence[Floats] | Floats, footprint: npt.NDArray[np.int64]) -> Floats:
    """(K, 9, N) float64: K tables (H, W) at Gauss's quadrature places in parts of the image."""
    from scipy.ndimage import map_coordinates

    n, x, y, xx, yy = footprint.T.astype(np.float64)
    number = np.maximum(n, 1.0)
    columns, rows = (
        sum_ / number + PLACES[:, None] * np.sqrt(np.maximum(square / number - (sum_ / number) ** 2, 0.0))
        for sum_, square in ((x, xx), (y, yy))
    )
    places = np.stack(np.broadcast_arrays(rows[:, None], columns))  # (2, 3, 3, N)
    there = [map_coordinates(table, places, order=1, mode="nearest") for table in tables]
    return np.reshape(there, (len(tables), len(WEIGHTS_OF_PLACES), -1))


def slope_square(alpha: Floats, camera: Camera, footprint: npt.NDArray[np.int64]) -> Floats:
    """(N,) float64: squared slopes of q per pixel, ‖Jᵀ(α0, α1)‖², of planes (N, 3) over these parts of the image."""
    uu, uv, vv = pitch_square(camera, footprint)
    a, b = alpha[:, 0], alpha[:, 1]
    return np.asarray(a * a * uu + 2.0 * a * b * uv + b * b * vv)


def lens_by_angle(camera: Camera) -> Floats:
    """(2, K) float64: how a lens changes the pitch, by the angle off the axis: see `pixel_noise.at_angle`.

    A lens is taken to be round here: the little that is tangential is ignored. (2, 0) without distortion.
    """
    if not camera.is_distorted:
        return np.empty((2, 0))
    seen = np.ones(camera.shape, bool) if camera._without_ray is None else ~camera._without_ray
    u, v = camera.tan_x[seen], camera.tan_y[seen]
    uu, uv, vv = abs(camera.fx * camera.fy) * _of_pixels(camera._lens)[:, seen]
    off = (u != 0.0) | (v != 0.0)  # on the axis itself no direction is radial
    u, v, uu, uv, vv = u[off], v[off], uu[off], uv[off], vv[off]
    square = u * u + v * v
    along = (u * u * uu + 2.0 * u * v * uv + v * v * vv) / square
    across = uu + vv - along
    radius = np.sqrt(square)
    places = np.rint(radius / (1.0 + radius) * (_ANGLES - 1)).astype(np.intp)
    number, sums, differences, squares = (
        np.bincount(places, values, _ANGLES) for values in (None, across, along - across, square)
    )
    there = np.flatnonzero(number)
    if not len(there):  # one pixel, and it is on the axis
        return np.repeat([[1.0], [0.0]], _ANGLES, axis=1)
    means = sums[there] / number[there], differences[there] / squares[there]
    return np.stack([np.interp(np.arange(_ANGLES), there, mean) for mean in means])


@functools.lru_cache(maxsize=2)
def _of_pixels(camera: Camera) -> Floats:
    """(3, H, W) float64: JJᵀ at each pixel of a camera with distortion."""
    (u_x, u_y), (v_x, v_y) = ray_changes(camera)
    return np.stack([u_x * u_x + u_y * u_y, u_x * v_x + u_y * v_y, v_x * v_x + v_y * v_y])


def ray_changes(camera: Camera) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
    """(H, W) each: the changes of tanθx from pixel to pixel along a row and down a column, and those of tanθy."""
    u, v = camera.tan_x, camera.tan_y
    u_changes = _change(u, 1, 1.0 / camera.fx), _change(u, 0, 0.0)
    return u_changes, (_change(v, 1, 0.0), _change(v, 0, 1.0 / camera.fy))


def _change(table: Floats, axis: int, alone: float) -> Floats:
    """Change of a table from pixel to pixel along an axis; ``alone`` where there is only one."""
    if table.shape[axis] == 1:
        return np.full(table.shape, alone)
    return np.asarray(np.gradient(table, axis=axis))
