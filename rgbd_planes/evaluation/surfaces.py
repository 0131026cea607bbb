"""What rendered scenes are made of: parts of planes and of quadrics, and solids that have such faces.

`rgbd_planes.scenes` has all of these names. Scene coordinates are metres, y points down.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.checks import check_bool, check_whole, number, real_array, shaped_array

_CORNERS = 64
"""Of the polygon that stands for the disc at the end of a cylinder: a thousandth of the radius is missing."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A part of a plane, seen from both sides.

    Attributes
    ----------
    name : str
        What it is: "floor", "table top".
    plane : (4,) float64
        n·X + d = 0 in scene coordinates, metres.
    sides : (K, 4) float64
        The surface is where ``sides[k]·(X, 1) >= 0`` for every k; without rows it is the whole plane.

    Raises
    ------
    TypeError, ValueError
        One of the arrays has another shape, or is not of finite numbers.
    """

    name: str
    plane: Floats
    sides: Floats

    def __post_init__(self) -> None:
        _check_rows(self, "plane", "(4,)")
        _check_rows(self, "sides", "(K, 4)")


@dataclass(frozen=True, eq=False)
class Quadric:
    """A part of a surface of second order, seen from both sides: of a ball, a pipe, a lampshade.

    Attributes
    ----------
    name : str
        What it is: "ball", "cup".
    matrix : (4, 4) float64
        The surface is where (X, 1)ᵀ matrix (X, 1) = 0, in scene coordinates, metres. It is symmetric.
    sides : (K, 4) float64
        The part is where ``sides[k]·(X, 1) >= 0`` for every k; without rows it is the whole quadric.

    Raises
    ------
    TypeError, ValueError
        One of the arrays has another shape, or is not of finite numbers, or the matrix is not symmetric.
    """

    name: str
    matrix: Floats
    sides: Floats

    def __post_init__(self) -> None:
        _check_rows(self, "matrix", "(4, 4)")
        _check_rows(self, "sides", "(K, 4)")
        if np.abs(self.matrix - self.matrix.T).max() > 1e-9 * np.abs(self.matrix).max():
            raise ValueError(f"expected matrix as a symmetric one, got {self.matrix.tolist()}")


def _check_rows(surface: Surface | Quadric, name: str, shape: str) -> None:
    """Make a field an array of finite numbers with rows of four."""
    rows = shaped_array(name, getattr(surface, name), (4,))
    right = {"(4,)": rows.ndim == 1, "(K, 4)": rows.ndim == 2, "(4, 4)": rows.shape == (4, 4)}
    if not right[shape] or not np.isfinite(rows).all():
        raise ValueError(f"expected {name} as {shape} finite numbers, got {rows.tolist()}")
    object.__setattr__(surface, name, rows)


def polygon(name: str, vertices: ArrayLike) -> Surface:
    """A convex polygon.

    Parameters
    ----------
    name : str
    vertices : (K, 3) float
        Corners in order around the polygon, in metres, scene coordinates.

    Raises
    ------
    TypeError, ValueError
        There are fewer than three corners, or they are not those of a flat, convex polygon, or not numbers.
    """
    points = real_array("vertices", vertices)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 3:
        raise ValueError(f"vertices must be (K, 3) with K >= 3, got shape {points.shape}")
    edges = np.roll(points, -1, axis=0) - points
    normal = np.cross(points - points[0], np.roll(points, -1, axis=0) - points[0]).sum(axis=0)
    size = np.linalg.norm(edges, axis=1).max()
    area = np.linalg.norm(normal)
    if not area > 1e-9 * size**2:
        raise ValueError(f"the corners of {name!r} enclose no area: {points.tolist()}")
    normal /= area
    inward = np.cross(normal, edges)
    sides = np.column_stack([inward, -(inward * points).sum(axis=1)])
    heights = (points - points[0]) @ normal
    inside = points @ inward.T + sides[:, 3]
    if np.abs(heights).max() > 1e-9 * size or inside.min() < -1e-9 * size**2:
        raise ValueError(f"the corners of {name!r} are not those of a flat, convex polygon: {points.tolist()}")
    return Surface(name, np.append(normal, -normal @ points[0]), sides)


def box(name: str, foot: ArrayLike, size: ArrayLike, turn: float = 0.0) -> tuple[Surface, ...]:
    """Six faces of a box that stands upright (y points down).

    Parameters
    ----------
    name : str
        Of the box; its faces are called "<name> top", "<name> front" and so on.
    foot : (3,) float
        Centre of its bottom face, in metres, scene coordinates.
    size : (3,) float
        Width (x), height (y) and depth (z) in metres, before it is turned.
    turn : float
        Rotation about the vertical axis in degrees.

    Raises
    ------
    TypeError, ValueError
        A side is not a positive length, or there are not three finite numbers.
    """
    width, height, depth = sides = three_numbers("size", size)
    if not (sides > 0.0).all():
        raise ValueError(f"expected size as three positive lengths in metres, got {size!r}")
    turn = number("turn", turn)
    cos, sin = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    across = 0.5 * width * np.array([cos, 0.0, -sin])
    along = 0.5 * depth * np.array([sin, 0.0, cos])
    up = 0.5 * height * np.array([0.0, -1.0, 0.0])
    centre = three_numbers("foot", foot) + up

    def face(side: str, outward: Floats, u: Floats, v: Floats) -> Surface:
        middle = centre + outward
        return polygon(f"{name} {side}", [middle - u - v, middle + u - v, middle + u + v, middle - u + v])

    return (
        face("top", up, across, along),
        face("bottom", -up, across, along),
        face("front", -along, across, up),
        face("back", along, across, up),
        face("left side", -across, along, up),
        face("right side", across, along, up),
    )


def polyhedron(name: str, vertices: ArrayLike) -> tuple[Surface, ...]:
    """The faces of a convex solid.

    Parameters
    ----------
    name : str
        Of the solid; its faces are called "<name> face 1" and so on.
    vertices : (K, 3) float
        Its corners in any order, in metres, scene coordinates. Points within it are no corners.

    Raises
    ------
    TypeError, ValueError
        The vertices enclose no volume, or are not numbers.
    """
    from scipy.spatial import ConvexHull, QhullError

    points = real_array("vertices", vertices)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4:
        raise ValueError(f"vertices must be (K, 3) with K >= 4, got shape {points.shape}")
    try:
        hull = ConvexHull(points)
    except QhullError:
        raise ValueError(f"the corners of {name!r} enclose no volume: {points.tolist()}") from None
    triangles: dict[tuple[float, ...], set[int]] = {}  # corners of the triangles in each plane
    for equation, triangle in zip(hull.equations, hull.simplices, strict=True):
        triangles.setdefault(tuple(np.round(equation, 6) + 0.0), set()).update(triangle.tolist())
    faces = (_in_order(points[sorted(face)], np.array(plane[:3])) for plane, face in triangles.items())
    return tuple(polygon(f"{name} face {i}", face) for i, face in enumerate(faces, 1))


def _in_order(corners: Floats, normal: Floats) -> Floats:
    """The corners of a convex face, around it."""
    middle = corners.mean(axis=0)
    across = corners[0] - middle
    angle = np.arctan2((corners - middle) @ np.cross(normal, across), (corners - middle) @ across)
    return corners[np.argsort(angle)]


def icosahedron(name: str, centre: ArrayLike, radius: float, turn: float = 0.0) -> tuple[Surface, ...]:
    """Twenty triangles with their corners on a sphere; faces meet at 42 degrees.

    ``centre`` and ``radius`` are in metres, ``turn`` about the vertical in degrees. Errors are those of `ellipsoid`.
    """
    golden = 0.5 * (1.0 + 5.0**0.5)
    corners = [(0.0, y, z * golden) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]
    return _regular(name, np.array(corners), centre, radius, turn)


def dodecahedron(name: str, centre: ArrayLike, radius: float, turn: float = 0.0) -> tuple[Surface, ...]:
    """Twelve pentagons with their corners on a sphere; faces meet at 63 degrees.

    ``centre`` and ``radius`` are in metres, ``turn`` about the vertical in degrees. Errors are those of `ellipsoid`.
    """
    golden = 0.5 * (1.0 + 5.0**0.5)
    corners = [(0.0, y / golden, z * golden) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]
    cube = [(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]
    return _regular(name, np.array(corners), centre, radius, turn, np.array(cube))


def _regular(
    name: str, corners: Floats, centre: ArrayLike, radius: float, turn: float, more: Floats | None = None
) -> tuple[Surface, ...]:
    """A solid with these corners, those of which the coordinates are rotated, and more; scaled and moved."""
    radius = _length("radius", radius)
    points = np.concatenate([np.roll(corners, k, axis=1) for k in range(3)] + ([] if more is None else [more]))
    points *= radius / np.linalg.norm(points[0])
    return polyhedron(name, points @ _turned(turn) + three_numbers("centre", centre))


def prism(
    name: str, foot: ArrayLike, radius: float, height: float, count: int, turn: float = 0.0, top: float = 1.0
) -> tuple[Surface, ...]:
    """An upright prism, frustum or pyramid over a regular polygon: a column with ``count`` sides.

    Parameters
    ----------
    name : str
    foot : (3,) float
        Centre of its bottom face, in metres, scene coordinates.
    radius, height : float
        Metres; ``radius`` is from the centre to the corners of the bottom.
    count : int
        Sides, at least 3.
    turn : float
        Rotation about the vertical axis in degrees.
    top : float
        Radius of the top as a share of that of the bottom; 0 makes a pyramid.

    Raises
    ------
    TypeError, ValueError
        A length is not positive, ``top`` is negative, there are fewer sides, or something is not a number.
    """
    radius, height, count = _length("radius", radius), _length("height", height), check_whole("count", count, 3)
    top = number("top", top)
    if top < 0.0:
        raise ValueError(f"expected top as a share of 0 or more, got {top}")
    angle = 2.0 * np.pi * np.arange(count) / count
    bottom = radius * np.column_stack([np.cos(angle), np.zeros(count), np.sin(angle)])
    lid = top * bottom if top > 0.0 else np.zeros((1, 3))
    corners = np.concatenate([bottom, lid - [0.0, height, 0.0]])
    return polyhedron(name, corners @ _turned(turn) + three_numbers("foot", foot))


def ellipsoid(name: str, centre: ArrayLike, radii: ArrayLike, turn: float = 0.0) -> Quadric:
    """A ball or a cushion.

    Parameters
    ----------
    name : str
    centre : (3,) float
        Metres, scene coordinates.
    radii : (3,) float
        Half axes along x, y and z in metres, before it is turned. A ball has three that are the same.
    turn : float
        Rotation about the vertical axis in degrees.

    Raises
    ------
    TypeError, ValueError
        A length is not positive, or something is not a finite number.
    """
    lengths = three_numbers("radii", radii)
    if not (lengths > 0.0).all():
        raise ValueError(f"expected radii as three positive lengths in metres, got {radii!r}")
    axes = _turned(turn) / lengths[:, None]
    return Quadric(name, _about(axes.T @ axes, three_numbers("centre", centre)), np.empty((0, 4)))


def cylinder(
    name: str,
    centre: ArrayLike,
    radius: float,
    length: float,
    lying: bool = False,
    turn: float = 0.0,
    top: float = 1.0,
    ends: bool = True,
) -> tuple[Surface | Quadric, ...]:
    """A column, a pipe, a cup without a lid, or, if it narrows, a lampshade.

    Parameters
    ----------
    name : str
        Of the round side; the ends are called "<name> end 1" and "<name> end 2".
    centre : (3,) float
        The middle of its axis, in metres, scene coordinates.
    radius, length : float
        Metres.
    lying : bool
        Along the x axis before it is turned; otherwise upright.
    turn : float
        Rotation about the vertical axis in degrees.
    top : float
        Radius of the upper end, or of the one with less x, as a share of ``radius``. Other than 1 makes a cone.
    ends : bool
        Whether there are ends. Without, one looks into it.

    Raises
    ------
    TypeError, ValueError
        A length or ``top`` is not positive, or something is not a number.
    """
    radius, length, top = _length("radius", radius), _length("length", length), _length("top", top)
    lying, ends = check_bool("lying", lying), check_bool("ends", ends)
    middle, turned = three_numbers("centre", centre), _turned(turn)
    axis, across = (turned[0], turned[[1, 2]]) if lying else (turned[1], turned[[0, 2]])
    # |across·X|² = r(t)² with t = axis·X, r = a + b t.
    a, b = 0.5 * radius * (1.0 + top), radius * (1.0 - top) / length
    shape = across.T @ across - b * b * np.outer(axis, axis)
    matrix = np.block([[shape, -a * b * axis[:, None]], [-a * b * axis[None], np.array([[-a * a]])]])
    moved = np.eye(4)
    moved[:3, 3] = -middle
    along = [np.append(sign * axis, 0.5 * length - sign * axis @ middle) for sign in (-1.0, 1.0)]
    side = Quadric(name, moved.T @ matrix @ moved, np.array(along))
    if not ends:
        return (side,)
    angle = 2.0 * np.pi * np.arange(_CORNERS) / _CORNERS
    circle = np.column_stack([np.cos(angle), np.sin(angle)]) @ across
    lower, upper = middle + 0.5 * length * axis, middle - 0.5 * length * axis
    return (
        side,
        polygon(f"{name} end 1", lower + radius * circle),
        polygon(f"{name} end 2", upper + top * radius * circle),
    )


def _length(name: str, value: float) -> float:
    length = number(name, value)
    if not length > 0.0:
        raise ValueError(f"expected {name} as a positive length in metres, got {value!r}")
    return length


def _turned(turn: float) -> Floats:
    """(3, 3): the axes x, y, z of a body that is turned about the vertical by so many degrees, as rows."""
    angle = np.radians(number("turn", turn))
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])


def _about(shape: Floats, centre: Floats) -> Floats:
    """(4, 4): the matrix of (X - c)ᵀ shape (X - c) = 1."""
    away = shape @ centre
    return np.block([[shape, -away[:, None]], [-away[None], np.array([[centre @ away - 1.0]])]])


def three_numbers(name: str, values: ArrayLike) -> Floats:
    """(3,) float64: three finite numbers."""
    vector = real_array(name, values)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"expected {name} as three finite numbers, got {values!r}")
    return vector
