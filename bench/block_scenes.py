"""Random blocks on a floor before a wall, seen by four kinds of sensor.

Boxes, wedges, frustums and boxes with a bevelled edge: many faces are small or narrow, and meet at obtuse angles.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from rgbd_planes import Camera
from rgbd_planes._core.arrays import Floats
from rgbd_planes.evaluation import scenes


@dataclass(frozen=True)
class Sensor:
    """What errs, and where it stands.

    ``sigma`` is the standard deviation of 1/Z in 1/m, ``sigma_depth`` that of Z in metres, ``lateral`` that of where in
    the image a pixel looks, in pixels; errors of neighbours are smoothed by a Gaussian of ``shared`` pixels, and so is
    the surface by one of ``blur``. It is ``distance`` (least, most) metres away from blocks of about ``size`` metres.
    """

    name: str
    camera: Camera
    distance: tuple[float, float]
    size: float
    sigma: float
    lateral: float
    shared: float = 0.0
    blur: float = 0.0
    sigma_depth: float = 0.0


SENSORS = (
    Sensor(
        "structured light", Camera(512, 512, 1586.0, 2301.0, 255.0, 255.0, depth_scale=1e4),
        (1.3, 1.5), 0.11, 1.5e-3, 0.5,
    ),
    Sensor(
        "Kinect", Camera(640, 480, 525.0, 525.0, 319.5, 239.5, depth_scale=1e3), (1.2, 3.0), 0.5, 1.4e-3, 0.35, 0.6
    ),
    Sensor(
        "active stereo", Camera(640, 480, 385.0, 385.0, 319.5, 239.5, depth_scale=1e3),
        (1.2, 2.5), 0.5, 2e-3, 0.3, 2.5, 0.8,
    ),
    Sensor(
        "time of flight", Camera(640, 576, 504.0, 504.0, 319.5, 287.5, depth_scale=1e3), (1.2, 3.0), 0.5, 0.0, 0.3,
        sigma_depth=4e-3,
    ),
)  # fmt: skip


def scene(sensor: Sensor, rng: np.random.Generator) -> scenes.Scene:
    """Three to six blocks of any kind, place and turn; the camera looks down on them by 20 to 40 degrees."""
    distance, down, size = rng.uniform(*sensor.distance), np.radians(rng.uniform(20.0, 40.0)), sensor.size
    far, back = 12.0 * size, size * rng.uniform(2.5, 4.0)
    surfaces = [
        scenes.polygon("floor", [(-far, 0.0, -far), (far, 0.0, -far), (far, 0.0, back), (-far, 0.0, back)]),
        scenes.polygon("wall", [(-far, 0.0, back), (far, 0.0, back), (far, -far, back), (-far, -far, back)]),
    ]
    for number in range(rng.integers(3, 7)):
        wide, high, deep = size * rng.uniform(0.3, 1.3, 3)
        corners = _block(int(rng.integers(4)), wide, high, deep, rng.uniform(0.3, 0.8))
        turn = rng.uniform(0.0, np.pi)
        cos, sin = np.cos(turn), np.sin(turn)
        corners = corners @ np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
        corners += [size * rng.uniform(-1.6, 1.6), 0.0, size * rng.uniform(-1.5, 1.5)]
        surfaces += scenes.polyhedron(f"block {number}", corners)
    target = np.array([0.0, -0.5 * size, 0.0])
    eye = target - distance * np.array([0.0, np.sin(down), np.cos(down)])
    return scenes.Scene(tuple(surfaces), scenes.look_at(tuple(eye), tuple(target)))


def measure(sensor: Sensor, seed: int) -> tuple[NDArray[np.uint16], NDArray[np.int32]]:
    """A frame in the camera's units, one pixel in a hundred missing, and its true labels."""
    rng = np.random.default_rng(seed)
    seen, camera = scene(sensor, rng), sensor.camera
    labels = seen.render(camera).labels
    # Every pixel looks a little beside its place, as in a lens of its own.
    beside = sensor.lateral * rng.normal(size=(2, *camera.shape))
    q = _inverse_depth(seen, camera.tan_x + beside[0] / camera.fx, camera.tan_y + beside[1] / camera.fy)
    errors = rng.normal(size=camera.shape)
    if sensor.shared > 0.0:
        errors = gaussian_filter(errors, sensor.shared)
        errors /= errors.std()
    if sensor.blur > 0.0:
        q = gaussian_filter(q, sensor.blur)
    assert camera.depth_scale is not None
    z = 1.0 / np.maximum(q + sensor.sigma * errors, 1e-2)
    if sensor.sigma_depth > 0.0:
        z += sensor.sigma_depth * rng.normal(size=camera.shape)
    depth = np.rint(camera.depth_scale * z)
    depth[(rng.random(camera.shape) < 0.01) | (depth > 65534.0) | (labels == 0)] = 0.0
    return depth.astype(np.uint16), np.where(depth > 0.0, labels, 0).astype(np.int32)


def _block(kind: int, wide: float, high: float, deep: float, top: float) -> Floats:
    """Corners of a block that stands on the floor around the origin; y is down."""
    x, z = 0.5 * wide, 0.5 * deep
    if kind == 0:  # a box
        profile = [(-x, 0.0), (x, 0.0), (x, -high), (-x, -high)]
    elif kind == 1:  # a wedge
        profile = [(-x, 0.0), (x, 0.0), (-x, -high)]
    elif kind == 2:  # a box with a bevelled edge
        bevel = 0.2 * min(wide, high)
        profile = [(-x, 0.0), (x, 0.0), (-x, -high), (x, bevel - high), (x - bevel, -high)]
    else:  # a frustum
        ends = (0.0, 1.0), (-high, top)
        return np.array([(i * x * s, y, j * z * s) for y, s in ends for i in (-1, 1) for j in (-1, 1)])
    return np.array([(*corner, depth) for corner in profile for depth in (-z, z)])


def _inverse_depth(seen: scenes.Scene, tan_x: Floats, tan_y: Floats) -> Floats:
    """Inverse depth where rays meet the scene, 0 where they meet nothing."""
    rays = np.stack([tan_x, tan_y, np.ones_like(tan_x)], axis=-1)
    nearest = np.zeros(tan_x.shape)
    for surface in seen.surfaces:
        assert isinstance(surface, scenes.Surface)
        *normal, offset = seen.camera_to_scene.T @ surface.plane
        q = rays @ (np.array(normal) / -offset)
        inside = q > nearest
        for side in surface.sides @ seen.camera_to_scene:
            inside &= rays @ side[:3] + side[3] * q >= 0.0
        nearest = np.where(inside, q, nearest)
    return nearest
