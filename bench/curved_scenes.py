"""Rendered scenes with curved things in them, seen by several kinds of sensor: what the segmentation is tuned on.

Curved surfaces are no planes: the truth about their pixels is 0, "none", and a plane that is found on them is one
too many. The real frames stay what it is tested on.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from rgbd_planes import Camera
from rgbd_planes._core.arrays import Floats
from rgbd_planes.evaluation import scenes
from rgbd_planes.noise import KINECT_V1


def furnished() -> scenes.Scene:
    """The furnished room with balls, columns, a roll and cushions."""
    room = scenes.room()
    bodies = (
        *scenes.cylinder("column", (-0.95, -1.3, 3.2), 0.16, 2.6),
        *scenes.cylinder("drum", (0.3, -0.12, 2.5), 0.12, 0.24),
        *scenes.cylinder("roll", (0.05, -0.09, 1.75), 0.09, 0.7, lying=True, turn=25.0),
        scenes.ellipsoid("ball", (-0.5, -0.82, 2.3), (0.16, 0.16, 0.16)),
        scenes.ellipsoid("cushion", (0.55, -0.4, 1.95), (0.24, 0.07, 0.16), turn=20.0),
        scenes.ellipsoid("bag", (1.2, -0.2, 2.2), (0.3, 0.2, 0.12), turn=-20.0),
        scenes.ellipsoid("large ball", (-1.15, -0.25, 1.9), (0.25, 0.25, 0.25)),
    )
    return scenes.Scene((*room.surfaces, *bodies), room.camera_to_scene)


def corner(camera_height: float = -1.2) -> scenes.Scene:
    """A sofa in a corner with cushions and a standing lamp that cuts the wall in two."""
    room = scenes.room().surfaces[:5]
    sofa = (
        *scenes.box("seat", (0.5, 0.0, 2.6), (1.6, 0.42, 0.8)),
        *scenes.box("back", (0.5, 0.0, 3.1), (1.6, 0.85, 0.2)),
        *scenes.box("left arm", (-0.4, 0.0, 2.7), (0.2, 0.6, 1.0)),
        *scenes.box("picture", (0.5, -1.2, 3.68), (0.9, 0.6, 0.03)),
        *scenes.box("shelf", (-1.6, 0.0, 2.9), (0.4, 1.5, 0.5)),
    )
    bodies = (
        *scenes.cylinder("pole", (-0.75, -0.75, 2.4), 0.02, 1.5),
        *scenes.cylinder("lampshade", (-0.75, -1.5, 2.4), 0.16, 0.25),
        scenes.ellipsoid("foot", (-0.75, 0.0, 2.4), (0.18, 0.03, 0.18)),
        scenes.ellipsoid("cushion", (0.2, -0.6, 2.92), (0.22, 0.2, 0.09)),
        scenes.ellipsoid("second cushion", (0.75, -0.58, 2.9), (0.24, 0.2, 0.08), turn=15.0),
        *scenes.cylinder("bolster", (0.6, -0.5, 2.45), 0.1, 0.9, lying=True, turn=8.0),
        scenes.ellipsoid("third cushion", (1.15, -0.62, 2.9), (0.16, 0.18, 0.13), turn=-25.0),
    )
    return scenes.Scene((*room, *sofa, *bodies), scenes.look_at((0.0, camera_height, 0.2), (-0.1, -0.7, 3.0)))


MESH = "mesh"
"""What the name of a polyhedron begins with that stands for something round: its facets are no planes."""


def solids(distance: float, size: float, turn: float = 10.0) -> scenes.Scene:
    """Polyhedra and round things side by side before a wall, ``size`` metres large and ``distance`` away."""
    r, pitch = 0.5 * size, 0.28 * distance
    x, y = pitch * np.array([-1.5, -0.5, 0.5, 1.5]), pitch * np.array([-1.0, 0.0, 1.0])

    def at(column: int, row: int, down: float = 0.0) -> tuple[float, float, float]:
        return float(x[column]), float(y[row]) + down, distance

    shapes = (
        *scenes.icosahedron("icosahedron", at(0, 0), r, turn),
        *scenes.dodecahedron("dodecahedron", at(1, 0), r, turn),
        *scenes.prism("hexagonal prism", at(2, 0, r), r, size, 6, turn),
        *scenes.prism("pyramid", at(3, 0, r), r, size, 4, turn),
        *scenes.prism("octagonal prism", at(0, 1, r), r, size, 8, turn),
        *scenes.prism("column of twelve sides", at(1, 1, r), r, size, 12, turn),
        *scenes.prism("column of sixteen sides", at(2, 1, r), r, size, 16, turn),
        *scenes.polyhedron(f"{MESH} of a ball", at(3, 1) + r * _sphere(400)),
        scenes.ellipsoid("ball", at(0, 2), (r, r, r)),
        scenes.ellipsoid("cushion", at(1, 2), (r, 0.7 * r, 0.4 * r), turn),
        *scenes.cylinder("lampshade", at(2, 2), r, size, top=0.5, ends=False),
        *scenes.cylinder("pipe", at(3, 2), 0.5 * r, 2.0 * r, lying=True, turn=turn),
    )
    wall = scenes.polygon("wall", 3.0 * distance * np.array([(-1, -1, 0.5), (1, -1, 0.5), (1, 1, 0.5), (-1, 1, 0.5)]))
    return scenes.Scene((wall, *shapes), scenes.look_at((0.0, -0.5 * distance, 0.0), (0.0, 0.0, distance)))


def _sphere(count: int) -> Floats:
    """(K, 3): points on a unit sphere, about equally far apart: a Fibonacci lattice."""
    k = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + 5.0**0.5) * k
    return np.column_stack([np.sqrt(1.0 - z * z) * np.cos(angle), np.sqrt(1.0 - z * z) * np.sin(angle), z])


def flat_labels(rendering: scenes.Rendering) -> NDArray[np.int32]:
    """The labels of a rendering, without those of facets that stand for something round."""
    is_flat = np.array([False, *(not name.startswith(MESH) for name in rendering.names)])
    return np.where(is_flat[rendering.labels], rendering.labels, 0).astype(np.int32)


Measure = Callable[[Floats, int], NDArray[np.uint16]]


def _camera(depth_scale: float) -> Camera:
    return Camera(width=640, height=480, fx=525.0, fy=525.0, cx=319.5, cy=239.5, depth_scale=depth_scale)


def errors(depth: Floats, seed: int, smooth: float) -> Floats:
    """Of standard deviation 1, correlated over ``smooth`` pixels."""
    noise = np.random.default_rng(seed).standard_normal(depth.shape)
    if smooth:
        noise = gaussian_filter(noise, smooth)
    return np.asarray(noise / noise.std())


def _raw(depth: Floats, scale: float, holes: float, seed: int) -> NDArray[np.uint16]:
    depth = np.where(np.random.default_rng(seed + 1).random(depth.shape) < holes, 0.0, depth)
    return np.asarray(np.rint(depth * scale), dtype=np.uint16)


def kinect(depth: Floats, seed: int) -> NDArray[np.uint16]:
    """Independent noise of a Kinect v1, millimetres."""
    return _raw(depth + KINECT_V1 * depth**2 * errors(depth, seed, 0.0), 1000.0, 0.03, seed)


def stereo(depth: Floats, seed: int) -> NDArray[np.uint16]:
    """Noise that a matching window correlates, and a slow wave of a quarter of a percent."""
    y, x = np.indices(depth.shape)
    wave = 2.5e-3 * np.sin(x / 97.0) * np.cos(y / 83.0)
    noise = 1.2e-3 * depth**2 * errors(depth, seed, 1.5)
    return _raw(depth * (1.0 + wave) + noise, 1000.0, 0.03, seed)


def time_of_flight(depth: Floats, seed: int) -> NDArray[np.uint16]:
    """A few millimetres everywhere, a wiggle with distance, pixels that mix what is near and far."""
    mixed = gaussian_filter(depth, 0.4)
    wiggle = 3e-3 * np.sin(2.0 * np.pi * mixed / 0.8)
    return _raw(mixed + wiggle + 4e-3 * errors(depth, seed, 0.6), 1000.0, 0.01, seed)


def scanner(depth: Floats, seed: int) -> NDArray[np.uint16]:
    """A precise scanner in coarse steps of its own."""
    noisy = depth + 3e-4 * depth**2 * errors(depth, seed, 0.8)
    return _raw(np.rint(noisy / 0.002) * 0.002, 1000.0, 0.0, seed)


def perfect(depth: Floats, seed: int) -> NDArray[np.uint16]:
    """No noise but rounding, fifths of a millimetre."""
    return _raw(depth, 5000.0, 0.0, seed)


SENSORS: tuple[tuple[Measure, Camera], ...] = (
    (kinect, _camera(1000.0)),
    (stereo, _camera(1000.0)),
    (time_of_flight, _camera(1000.0)),
    (scanner, _camera(1000.0)),
    (perfect, _camera(5000.0)),
)
SCENES = (furnished, corner)
