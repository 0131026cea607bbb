"""Rendered scenes with curved things in them, seen by several kinds of sensor: what the segmentation is tuned on.

Curved surfaces are no planes: the truth about their pixels is 0, "none", and a plane that is found on them is one
too many. The real frames stay what it is tested on.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter

from rgbd_planes import Camera
from rgbd_planes._core.arrays import Floats
from rgbd_planes.evaluation import scenes
from rgbd_planes.noise import KINECT_V1


@dataclass(frozen=True)
class Body:
    """The points p with |(p - centre)·axis| summed in squares over the rows of ``axes`` at most 1.

    Three axes make an ellipsoid, two a cylinder that ends where |(p - centre)·length| = 1.
    """

    centre: Floats
    axes: Floats
    length: Floats | None = None


def ellipsoid(centre: ArrayLike, radii: ArrayLike, turn: float = 0.0) -> Body:
    """Half axes along x, y and z before it is turned about the vertical by so many degrees."""
    return Body(np.asarray(centre, dtype=float), _turned(turn) / np.asarray(radii, dtype=float)[:, None])


def cylinder(centre: ArrayLike, radius: float, length: float, lying: bool = False, turn: float = 0.0) -> Body:
    """Upright, or lying along the x axis before it is turned."""
    axes = _turned(turn)
    along = 0 if lying else 1
    across = [i for i in range(3) if i != along]
    return Body(np.asarray(centre, dtype=float), axes[across] / radius, axes[along] / (0.5 * length))


def _turned(turn: float) -> Floats:
    cos, sin = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    return np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])


def render(scene: scenes.Scene, bodies: tuple[Body, ...], camera: Camera) -> tuple[Floats, NDArray[np.int32]]:
    """Depth in metres, and labels: 0 on what is curved, new ones on the ends of cylinders."""
    rendering = scene.render(camera)
    depth, labels = rendering.depth.copy(), rendering.labels.copy()
    depth[np.isnan(depth)] = np.inf
    rays = np.stack([camera.tan_x, camera.tan_y, np.ones(camera.shape)], axis=-1)
    rays = rays @ scene.camera_to_scene[:3, :3].T
    for body in bodies:
        start = scene.camera_to_scene[:3, 3] - body.centre
        p, m = (body.axes @ start, rays @ body.axes.T)  # the ray is p + Z m, and the surface where that is 1 long
        a, b, c = (m * m).sum(axis=-1), m @ p, p @ p - 1.0
        root = np.sqrt(np.maximum(b * b - a * c, 0.0))
        z = np.where(b * b > a * c, (-b - root) / a, np.inf)
        if body.length is not None:
            along, slope = body.length @ start, rays @ body.length
            z[np.abs(along + z * slope) > 1.0] = np.inf
            for end in (-1.0, 1.0):
                cap = (end - along) / slope
                on_cap = (((p + cap[..., None] * m) ** 2).sum(axis=-1) <= 1.0) & (cap > 0.0)
                nearer = on_cap & (cap < np.minimum(depth, z))
                depth[nearer], labels[nearer] = cap[nearer], labels.max() + 1
        nearer = (z > 0.0) & (z < depth)
        depth[nearer], labels[nearer] = z[nearer], 0
    return depth, labels


def furnished() -> tuple[scenes.Scene, tuple[Body, ...]]:
    """The furnished room with balls, columns, a roll and cushions."""
    return scenes.room(), (
        cylinder((-0.95, -1.3, 3.2), 0.16, 2.6),
        cylinder((0.3, -0.12, 2.5), 0.12, 0.24),
        cylinder((0.05, -0.09, 1.75), 0.09, 0.7, lying=True, turn=25.0),
        ellipsoid((-0.5, -0.82, 2.3), (0.16, 0.16, 0.16)),
        ellipsoid((0.55, -0.4, 1.95), (0.24, 0.07, 0.16), turn=20.0),
        ellipsoid((1.2, -0.2, 2.2), (0.3, 0.2, 0.12), turn=-20.0),
        ellipsoid((-1.15, -0.25, 1.9), (0.25, 0.25, 0.25)),
    )


def corner(camera_height: float = -1.2) -> tuple[scenes.Scene, tuple[Body, ...]]:
    """A sofa in a corner with cushions and a standing lamp that cuts the wall in two."""
    room = scenes.room().surfaces[:5]
    sofa = (
        *scenes.box("seat", (0.5, 0.0, 2.6), (1.6, 0.42, 0.8)),
        *scenes.box("back", (0.5, 0.0, 3.1), (1.6, 0.85, 0.2)),
        *scenes.box("left arm", (-0.4, 0.0, 2.7), (0.2, 0.6, 1.0)),
        *scenes.box("picture", (0.5, -1.2, 3.68), (0.9, 0.6, 0.03)),
        *scenes.box("shelf", (-1.6, 0.0, 2.9), (0.4, 1.5, 0.5)),
    )
    return scenes.Scene((*room, *sofa), scenes.look_at((0.0, camera_height, 0.2), (-0.1, -0.7, 3.0))), (
        cylinder((-0.75, -0.75, 2.4), 0.02, 1.5),
        cylinder((-0.75, -1.5, 2.4), 0.16, 0.25),
        ellipsoid((-0.75, 0.0, 2.4), (0.18, 0.03, 0.18)),
        ellipsoid((0.2, -0.6, 2.92), (0.22, 0.2, 0.09)),
        ellipsoid((0.75, -0.58, 2.9), (0.24, 0.2, 0.08), turn=15.0),
        cylinder((0.6, -0.5, 2.45), 0.1, 0.9, lying=True, turn=8.0),
        ellipsoid((1.15, -0.62, 2.9), (0.16, 0.18, 0.13), turn=-25.0),
    )


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
