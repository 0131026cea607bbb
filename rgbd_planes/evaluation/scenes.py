"""Rendered scenes of planes and curved surfaces: the paper's synthetic sensor, with its ground truth.

A ray leaves the camera through the centre of every pixel and meets the nearest surface. That gives the noise-free
depth, the surface that each pixel sees, and the planes. ``Rendering.measure`` then turns the depth into what a sensor
would deliver: noise, missing pixels, integer units.

Examples
--------
>>> from rgbd_planes import Camera, scenes
>>> camera = Camera(width=640, height=480, fx=525.0, fy=525.0, cx=319.5, cy=239.5, depth_scale=1000.0)
>>> rendering = scenes.room().render(camera)
>>> frame = rendering.measure(holes=0.05, seed=1)  # (480, 640) uint16, millimetres
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.checks import check_bool, check_share, check_whole, number, real_array
from rgbd_planes._core.rotations import as_motion
from rgbd_planes._core.text import counted
from rgbd_planes.camera.camera import Camera, check_camera
from rgbd_planes.evaluation.surfaces import Quadric as Quadric
from rgbd_planes.evaluation.surfaces import Surface as Surface
from rgbd_planes.evaluation.surfaces import box as box
from rgbd_planes.evaluation.surfaces import cylinder as cylinder
from rgbd_planes.evaluation.surfaces import dodecahedron as dodecahedron
from rgbd_planes.evaluation.surfaces import ellipsoid as ellipsoid
from rgbd_planes.evaluation.surfaces import icosahedron as icosahedron
from rgbd_planes.evaluation.surfaces import polygon as polygon
from rgbd_planes.evaluation.surfaces import polyhedron as polyhedron
from rgbd_planes.evaluation.surfaces import prism as prism
from rgbd_planes.evaluation.surfaces import three_numbers
from rgbd_planes.fitting.tile_grid import common_labels
from rgbd_planes.noise import KINECT_V1

# Rays at a time, so that what is made of them stays in the cache; of more, matrix products would also share the work
# among threads, for ten times as long.
_CHUNK = 3000
_ROUNDED = 1e-12  # as a share: what is no farther apart differs by rounding

KINECT_BASELINE = 0.075
"""Metres from a Kinect v1's infrared camera to its projector (Khoshelham and Oude Elberink 2012)."""


@dataclass(frozen=True, eq=False, repr=False)
class Scene:
    """Surfaces, and where the camera stands among them.

    Attributes
    ----------
    surfaces : tuple of Surface and Quadric
        From `polygon`, `box`, `ellipsoid` and so on, in scene coordinates, metres. Any iterable becomes a tuple.
    camera_to_scene : (4, 4) float64
        Rigid motion that takes camera coordinates (x right, y down, z forward) to scene coordinates, as from `look_at`.

    Raises
    ------
    TypeError, ValueError
        One of the surfaces is none, or the matrix is no rigid motion.

    Examples
    --------
    A pallet on a floor, seen from 1.4 m above:

    >>> floor = scenes.polygon("floor", [(-3, 0, 0), (3, 0, 0), (3, 0, 4), (-3, 0, 4)])
    >>> pallet = scenes.box("pallet", foot=(0.0, 0.0, 2.0), size=(0.8, 0.144, 0.6), turn=20.0)
    >>> scene = scenes.Scene((floor, *pallet), scenes.look_at(eye=(0.3, -1.4, 0.2), target=(0.0, 0.0, 2.0)))
    """

    surfaces: tuple[Surface | Quadric, ...]
    camera_to_scene: Floats

    def __post_init__(self) -> None:
        if not isinstance(self.surfaces, Iterable):
            raise TypeError(f"expected surfaces as an iterable, got {type(self.surfaces).__name__}")
        surfaces = tuple(self.surfaces)
        for surface in surfaces:
            if not isinstance(surface, (Surface, Quadric)):
                several = ": a box is several surfaces, (floor, *box)" if isinstance(surface, Sequence) else ""
                raise TypeError(f"expected each of surfaces as a Surface, got {type(surface).__name__}{several}")
        motion = real_array("camera_to_scene", self.camera_to_scene)
        if motion.shape != (4, 4):
            raise ValueError(f"expected camera_to_scene of shape (4, 4), got {motion.shape}")
        object.__setattr__(self, "surfaces", surfaces)
        object.__setattr__(self, "camera_to_scene", as_motion("camera_to_scene", motion).copy())

    def __repr__(self) -> str:
        return f"<Scene: {counted(len(self.surfaces), 'surface')}>"

    def render(self, camera: Camera) -> Rendering:
        """Meet the ray through each pixel centre with the surfaces and keep the nearest.

        Parameters
        ----------
        camera : Camera
            Lens distortion is honoured: the rays are ``(tan_x, tan_y, 1)``.

        Returns
        -------
        Rendering
            Its labels count the planes that at least one pixel sees, in the order of the scene; its curved labels the
            quadrics. Of surfaces in one plane, where they overlap, the first is seen.

        Raises
        ------
        TypeError
            It is no `Camera`.
        """
        check_camera(camera)
        rays = np.stack([camera.tan_x, camera.tan_y, np.ones_like(camera.tan_x)], axis=-1).reshape(-1, 3)
        nearest = np.zeros(len(rays))  # inverse depth: 0 is infinitely far, so the largest is the nearest
        seen = np.full(len(rays), -1)
        equations = [self._in_camera(surface) for surface in self.surfaces]
        for start in range(0, len(rays), _CHUNK):
            part = slice(start, start + _CHUNK)
            self._meet(rays[part], equations, nearest[part], seen[part])
        if camera._without_ray is not None:
            nearest[camera._without_ray.ravel()] = 0.0
            seen[camera._without_ray.ravel()] = -1

        depth = np.full(len(rays), np.nan)
        np.divide(1.0, nearest, out=depth, where=nearest > 0.0)
        flat = np.array([isinstance(surface, Surface) for surface in self.surfaces], bool)
        shape = (camera.height, camera.width)
        labels, visible = _numbered(seen, flat)
        curved_labels, visible_curved = _numbered(seen, ~flat)
        return Rendering(
            camera=camera,
            depth=depth.reshape(shape),
            labels=labels.reshape(shape),
            planes=np.array([equations[index] for index in visible]).reshape(-1, 4),
            names=tuple(self.surfaces[index].name for index in visible),
            curved_labels=curved_labels.reshape(shape),
            curved_names=tuple(self.surfaces[index].name for index in visible_curved),
        )

    def _in_camera(self, surface: Surface | Quadric) -> Floats:
        """The plane (4,) of a surface in camera coordinates, its normal towards the camera, or a quadric's matrix."""
        if isinstance(surface, Quadric):
            return self.camera_to_scene.T @ surface.matrix @ self.camera_to_scene
        return _facing_camera(self.camera_to_scene.T @ surface.plane)

    def _meet(self, rays: Floats, equations: list[Floats], nearest: Floats, seen: NDArray[np.int64]) -> None:
        """Write the inverse depth and the index of the nearest surface on each ray; ``nearest`` is 0 before."""
        for index, (surface, equation) in enumerate(zip(self.surfaces, equations, strict=True)):
            met: tuple[Floats, ...]
            if isinstance(surface, Quadric):
                met = _on_quadric(rays, equation)
            elif equation[3] <= _ROUNDED * (abs(surface.plane[3]) + np.linalg.norm(self.camera_to_scene[:3, 3])):
                continue  # seen edge-on: no pixel shows it
            else:
                met = (rays @ (equation[:3] / -equation[3]),)
            sides = surface.sides @ self.camera_to_scene
            for inverse_depth in met:
                hit = np.flatnonzero(inverse_depth > nearest * (1.0 + _ROUNDED))
                # sides·(X, 1) >= 0 with X = m / q, multiplied by q > 0: no division
                for side in sides:
                    if not len(hit):
                        break
                    # An index takes several times as long to take rows as `take`.
                    hit = hit[rays.take(hit, axis=0) @ side[:3] + side[3] * inverse_depth[hit] >= 0.0]
                nearest[hit] = inverse_depth[hit]
                seen[hit] = index


def _on_quadric(rays: Floats, matrix: Floats) -> tuple[Floats, Floats]:
    """Inverse depths at which rays meet a quadric in camera coordinates; 0 where they miss it.

    With X = m / q its equation is (m, q)ᵀ matrix (m, q) = 0: c q² + 2 b q + a = 0.
    """
    a = ((rays @ matrix[:3, :3]) * rays).sum(axis=1)
    b, c = rays @ matrix[:3, 3], matrix[3, 3]
    square = b * b - a * c
    # The root that adds two numbers of one sign, and a / c over it: none of the two loses digits, and c may be 0.
    larger = -(b + np.copysign(np.sqrt(np.maximum(square, 0.0)), b))
    first, second = np.zeros_like(b), np.zeros_like(b)
    np.divide(larger, c, out=first, where=(square >= 0.0) & (c != 0.0))
    np.divide(a, larger, out=second, where=(square >= 0.0) & (larger != 0.0))
    return first, second


def _numbered(seen: NDArray[np.int64], chosen: NDArray[np.bool_]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Labels 1, 2, ... of the chosen surfaces that pixels see, 0 for other pixels, and these surfaces."""
    is_visible = (np.bincount(seen + 1, minlength=len(chosen) + 1)[1:] > 0) & chosen
    labels = np.where(is_visible, np.cumsum(is_visible), 0)
    return np.append(0, labels).astype(np.int32)[seen + 1], np.flatnonzero(is_visible)


@dataclass(frozen=True, eq=False, repr=False)
class Rendering:
    """A scene as a perfect sensor sees it, and the truth about it.

    Attributes
    ----------
    camera : Camera
    depth : (H, W) float64
        Noise-free depth along the optical axis in metres; NaN where the ray meets nothing.
    labels : (H, W) int32
        Which plane each pixel sees: 0 none, 1..N.
    planes : (N, 4) float64
        n·X + d = 0 in camera coordinates, ‖n‖ = 1, d > 0; row i belongs to label i + 1.
    names : tuple of str
        What each plane is, in the order of `planes`.
    curved_labels : (H, W) int32
        Which curved surface each pixel sees: 0 none, 1..M.
    curved_names : tuple of str
        What each curved surface is.
    """

    camera: Camera
    depth: Floats
    labels: NDArray[np.int32]
    planes: Floats
    names: tuple[str, ...]
    curved_labels: NDArray[np.int32]
    curved_names: tuple[str, ...]

    def __repr__(self) -> str:
        size = f"{self.camera.width} x {self.camera.height}"
        curved = f", {counted(len(self.curved_names), 'curved surface')}" if self.curved_names else ""
        return f"<Rendering: {counted(len(self.planes), 'plane')}{curved} in {size} pixels>"

    def measure(
        self,
        *,
        noise: float = KINECT_V1,
        holes: float = 0.0,
        patches: float = 0.0,
        baseline: float = 0.0,
        quantise: bool = True,
        seed: int | np.random.Generator = 0,
    ) -> NDArray[np.uint16] | Floats:
        """Measure the scene: what a depth camera would deliver.

        Parameters
        ----------
        noise : float
            Standard deviation of the inverse depth in 1/m. Each pixel's point moves along its ray by
            independent Gaussian noise so that sigma_Z = noise·Z² (the paper's eq. 2). 0 for none.
        holes : float
            Share of the pixels that are missing, each independently of the others.
        patches : float
            Share of the pixels that are missing in connected patches, as on dark or shining surfaces.
        baseline : float
            Distance in metres of the sensor's projector, to the right of its camera (negative: to the
            left). What the projector cannot see lies in shadow and is missing. 0 for no shadows. Only what the camera
            sees, in the same row, casts them, so narrow ones are left out, and they are right only without lens
            distortion.
        quantise : bool
            Round to the camera's integer units (`depth_scale`, or `disparity`).
        seed : int or numpy.random.Generator
            The same seed gives the same frame.

        Returns
        -------
        (H, W) uint16 or float64
            Raw units, with a value for missing that the camera takes as such. Or, not quantised, metres with NaN, for a
            camera without `disparity`, which would take floats for disparities.

        Raises
        ------
        TypeError, ValueError
            A share is outside 0..1, the noise is negative, or something is not a number. Or `quantise` is asked for and
            the camera has no units, or, with disparity, no raw value that means missing.
        """
        noise = number("noise", noise)
        if not noise >= 0.0:
            raise ValueError(f"noise must be 0 or more (1/m), got {noise}")
        holes, patches = check_share("holes", holes), check_share("patches", patches)
        baseline, quantise = number("baseline", baseline), check_bool("quantise", quantise)
        if not isinstance(seed, np.random.Generator):
            check_whole("seed", seed, 0)
        generator = np.random.default_rng(seed)
        shape = self.depth.shape
        # Always drawn, in this order, so that asking for holes does not change the noise of a seed.
        gauss = generator.standard_normal(shape)
        uniform = generator.random(shape)
        depth = self.depth + noise * self.depth**2 * gauss
        missing = (uniform < holes) | ~(depth > 0.0)
        if patches > 0.0:
            missing |= _patches(generator, shape, patches)
        if baseline != 0.0:
            missing |= _shadow(self.camera, self.depth, baseline)
        depth[missing] = np.nan
        return _to_raw(depth, self.camera) if quantise else depth

    def tile_labels(self, tile: int | tuple[int, int]) -> NDArray[np.int32]:
        """(R, C) int32: the plane that all pixels of each tile of a grid see, 0 where they do not.

        ``tile`` is that of `fit_tiles`, and raises the same errors.
        """
        return common_labels(self.labels, self.labels, tile)


def plane(normal: ArrayLike, distance: float) -> Scene:
    """One infinite plane, given in camera coordinates.

    Parameters
    ----------
    normal : (3,) float
        Of any length, towards the camera, so with z below 0 for what the middle of the image sees. The opposite is
        that of a plane behind the camera.
    distance : float
        Of the plane from the camera centre, in metres: n·X + distance = 0.

    Raises
    ------
    TypeError, ValueError
        The normal is zero or not finite, or the distance is not a positive number.
    """
    direction = three_numbers("normal", normal)
    if not direction.any():
        raise ValueError(f"expected normal as a direction, got {normal!r}")
    distance = number("distance", distance)
    if not distance > 0.0:
        raise ValueError(f"distance must be positive, in metres, got {distance}")
    return Scene((_whole_plane("plane", direction / np.linalg.norm(direction), distance),), np.eye(4))


def room(eye: ArrayLike = (0.35, -1.5, -0.2), target: ArrayLike = (-0.12, -0.8, 2.6)) -> Scene:
    """A furnished room: the scene of the demo, the tests and the benchmarks.

    Floor, ceiling, three walls, a desk with a screen, a cabinet, cartons and a leaning board, all within
    a Kinect's range. No two surfaces that can be seen lie in one plane.

    Parameters
    ----------
    eye, target : (3,) float
        Where the camera stands and what it looks at, in metres: x right, y down from the floor (so
        heights are negative), z into the room. Move the eye for a sequence of frames.

    Raises
    ------
    TypeError, ValueError
        They are not three finite numbers each, or the camera would look straight up or down, or nowhere.
    """
    shell = (
        _whole_plane("floor", np.array([0.0, -1.0, 0.0]), 0.0),
        _whole_plane("ceiling", np.array([0.0, 1.0, 0.0]), 2.6),
        _whole_plane("back wall", np.array([0.0, 0.0, -1.0]), 3.7),
        _whole_plane("left wall", np.array([1.0, 0.0, 0.0]), 1.8),
        _whole_plane("right wall", np.array([-1.0, 0.0, 0.0]), 1.9),
    )
    furniture = (
        *box("cabinet", (-1.52, 0.0, 2.65), (0.5, 1.75, 0.95)),
        *box("desk top", (1.05, -0.70, 3.05), (1.5, 0.05, 0.85), turn=-6.0),
        *box("desk drawers", (1.45, 0.0, 3.07), (0.5, 0.70, 0.62), turn=-6.0),
        *box("desk leg", (0.42, 0.0, 3.17), (0.05, 0.70, 0.55), turn=-6.0),
        *box("screen", (0.98, -0.75, 3.2), (0.66, 0.44, 0.04), turn=14.0),
        *box("carton", (-0.48, 0.0, 2.3), (0.6, 0.42, 0.5), turn=33.0),
        *box("parcel", (-0.5, -0.42, 2.32), (0.32, 0.24, 0.28), turn=-18.0),
        *box("crate", (0.55, 0.0, 1.95), (0.42, 0.34, 0.36), turn=-28.0),
        polygon("board", [(-0.62, 0.0, 3.2), (0.02, 0.0, 3.15), (0.02, -1.42, 3.64), (-0.62, -1.42, 3.69)]),
    )
    return Scene(shell + furniture, look_at(eye, target))


def look_at(eye: ArrayLike, target: ArrayLike) -> Floats:
    """The (4, 4) motion from camera to scene coordinates of a camera held level (scene y points down).

    Parameters
    ----------
    eye, target : (3,) float
        Where the camera stands and what it looks at, in metres, scene coordinates.

    Raises
    ------
    TypeError, ValueError
        They are not three finite numbers each, or the camera would look straight up or down, or nowhere.
    """
    position = three_numbers("eye", eye)
    forward = three_numbers("target", target) - position
    right = np.cross((0.0, 1.0, 0.0), forward)
    if not np.linalg.norm(right) > 1e-9 * np.linalg.norm(forward):
        raise ValueError(f"the camera must look somewhere, not straight up or down, got eye {eye!r}, target {target!r}")
    forward /= np.linalg.norm(forward)
    right /= np.linalg.norm(right)
    motion = np.eye(4)
    motion[:3] = np.column_stack([right, np.cross(forward, right), forward, position])
    return motion


def _whole_plane(name: str, normal: Floats, offset: float) -> Surface:
    return Surface(name, np.append(normal, offset), np.empty((0, 4)))


def _facing_camera(coefficients: Floats) -> Floats:
    """A plane's coefficients with ‖n‖ = 1 and d >= 0: its normal towards the camera centre."""
    scale = np.linalg.norm(coefficients[:3])
    return coefficients / (-scale if coefficients[3] < 0.0 else scale)


def _shadow(camera: Camera, depth: Floats, baseline: float) -> NDArray[np.bool_]:
    """The pixels that a projector at X = baseline cannot reach, row by row.

    From there a point is seen at tan_x - baseline / Z. Along a row that grows from left to right in space, unless
    something nearer, on the projector's side, stands in the light.
    """
    side = np.sign(baseline)
    seen_from_projector = side * (camera.tan_x - baseline / depth)
    # With a negative fx, left in the image is right in space.
    from_its_side = np.s_[:, :: -int(side * np.sign(camera.fx))]
    blocking = np.fmin.accumulate(seen_from_projector[from_its_side], axis=1)[from_its_side]
    return np.asarray(seen_from_projector > blocking)


def _patches(generator: np.random.Generator, shape: Iterable[int], share: float) -> NDArray[np.bool_]:
    """A mask that is true on `share` of the pixels, in smooth patches."""
    from scipy.ndimage import gaussian_filter

    field = gaussian_filter(generator.standard_normal(tuple(shape)), sigma=8.0, mode="wrap")
    return np.asarray(field < np.quantile(field, share)) if share < 1.0 else np.ones_like(field, dtype=bool)


def _to_raw(depth: Floats, camera: Camera) -> NDArray[np.uint16]:
    """Metres, NaN missing, to the camera's integer units."""
    candidates = [value for value in camera.invalid_values if value.is_integer() and 0 <= value <= 65535]
    if camera.disparity is not None:
        scale, offset = camera.disparity
        raw = np.rint((1.0 / depth - offset) / scale)
        smallest = 0
        candidates += [value for value in (0, 65535) if scale * value + offset <= 0.0]
        if not candidates:
            raise ValueError("quantise needs a raw value that means missing: give the camera invalid_values")
    elif camera.depth_scale is not None:
        raw = np.rint(depth * camera.depth_scale)
        smallest = 1
        candidates = [0]
    else:
        raise ValueError("quantise needs a camera with depth_scale or disparity; quantise=False gives metres")
    return np.where((raw >= smallest) & (raw <= 65535.0), raw, candidates[0]).astype(np.uint16)
