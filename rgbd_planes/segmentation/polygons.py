"""Outlines of segmented planes: in the image, in the plane, and in space.

Needs shapely: ``pip install rgbd-planes[polygons]``.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.checks import number, shaped_array
from rgbd_planes._core.lazy_property import kept
from rgbd_planes._core.optional_imports import needs
from rgbd_planes._core.status import Reason
from rgbd_planes._core.text import counted
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.rays import rays_through
from rgbd_planes.fitting.labels import LabelPlanes
from rgbd_planes.segmentation.result import Segmentation, boxes_of, no_segmentation

if TYPE_CHECKING:
    from shapely import Geometry, MultiPolygon, Polygon


_LARGEST_CHANGE = 0.25  # by simplifying, as a share of the area of a part
_LEAST_TRIANGLE = 1e-12  # as a share of the area of the outline
_SHARE_OF_BENDS = 0.25  # of the tolerance
_ON_EDGE = np.linspace(0.0, 1.0, 5)  # where an edge is checked


@dataclass(frozen=True, eq=False, repr=False)
class PlanePolygon:
    """The outline of one plane.

    Attributes
    ----------
    label : int
        In the segmentation.
    plane : (4,) float64
        nx, ny, nz, d, as in `Segmentation.planes`.
    origin : (3,) float64
        Origin of the plane's own coordinates: the point of the plane that is nearest to the camera, metres.
    axes : (2, 3) float64
        Directions of these coordinates, of unit length: to the right in the image, and down it, or up where the
        camera's fx and fy differ in sign. They are at right angles to each other and to the normal.
    image : shapely MultiPolygon
        The outline, holes included, in pixels (x, y); pixel centres are at integers, edges half-way between.
    metric : shapely MultiPolygon
        The same in the plane's coordinates, metres; with more corners where a lens bends its edges. The depth of a
        corner is at most about twice that of the farthest pixel.
    """

    label: int
    plane: Floats
    origin: Floats
    axes: Floats
    image: MultiPolygon
    metric: MultiPolygon

    def __repr__(self) -> str:
        parts = counted(len(self.metric.geoms), "part")
        holes = counted(sum(len(part.interiors) for part in self.metric.geoms), "hole")
        return f"<PlanePolygon {self.label}: {self.area:.3g} m², {parts}, {holes}>"

    @property
    def area(self) -> float:
        """Square metres, holes left out; missing pixels inside the outline count.

        Where a plane is seen nearly edge-on, close to its horizon, one pixel is many square metres. The area then
        follows from few pixels, and may be far off.
        """
        return float(self.metric.area)

    @property
    @kept
    def hull(self) -> Polygon:
        """Convex hull in the plane's coordinates; empty if the outline has no area."""
        import shapely

        hull = self.metric.convex_hull
        return hull if isinstance(hull, shapely.Polygon) else shapely.Polygon()

    @property
    @kept
    def rectangle(self) -> Polygon:
        """The smallest rectangle around the outline, at any angle, in the plane's coordinates; empty as `hull` is."""
        import shapely

        if self.hull.is_empty:
            return self.hull
        # One of its sides lies along one of the hull's. GEOS's own may have no area where corners of the hull lie on a
        # line up to rounding, as those of pixels do.
        corners = np.asarray(self.hull.exterior.coords)
        sides = np.diff(corners, axis=0)
        along = sides / np.linalg.norm(sides, axis=1, keepdims=True)
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        u, v = corners @ along.T, corners @ across.T  # of each corner, by side
        k = int(np.argmin(np.ptp(u, axis=0) * np.ptp(v, axis=0)))
        (left, right), (low, high) = ((w[:, k].min(), w[:, k].max()) for w in (u, v))
        ends = np.array([(left, low), (left, high), (right, high), (right, low)])
        return shapely.Polygon(ends @ np.stack([along[k], across[k]]))

    @property
    def sides(self) -> Floats:
        """(2,) float64: lengths of the rectangle's sides in metres, the longer first; 0 if the outline has no area.

        They reach to the outer edges of the outermost pixels, and so are too long by a pixel or so. Of a plane that
        goes on beyond the image they are those of what is in sight.
        """
        if self.rectangle.is_empty:
            return np.zeros(2)
        return np.sort(np.linalg.norm(np.diff(np.asarray(self.rectangle.exterior.coords)[:3], axis=0), axis=1))[::-1]

    def to_space(self, coordinates: ArrayLike) -> Floats:
        """(..., 3) float64: points of the plane in the camera's frame, from its own (..., 2) coordinates."""
        return np.asarray(self.origin + shaped_array("coordinates", coordinates, (2,)) @ self.axes)

    def to_plane(self, points: ArrayLike) -> Floats:
        """(..., 2) float64: the feet of points, (..., 3) in the camera's frame, in the plane's own coordinates."""
        return np.asarray((shaped_array("points", points, (3,)) - self.origin) @ self.axes.T)

    def corners(self, geometry: Polygon | None = None) -> Floats:
        """(K, 3) float64: corners in the camera's frame of a polygon in the plane, by default `rectangle`.

        Raises
        ------
        TypeError
            It is no shapely Polygon.
        """
        import shapely

        chosen = self.rectangle if geometry is None else geometry
        if not isinstance(chosen, shapely.Polygon):
            several = ": rings() has those of the whole outline" if isinstance(chosen, shapely.MultiPolygon) else ""
            raise TypeError(f"expected geometry as a shapely Polygon, got {type(chosen).__name__}{several}")
        return self.to_space(np.asarray(chosen.exterior.coords)[:-1])

    def rings(self) -> list[list[Floats]]:
        """Outlines in space: for each part its outer ring and its holes, (K, 3) float64 each, open.

        The outer ring is counter-clockwise about the normal, holes are clockwise.
        """
        return [
            [self.to_space(np.asarray(ring.coords)[:-1]) for ring in (part.exterior, *part.interiors)]
            for part in self.metric.geoms
        ]

    def triangles(self) -> Floats:
        """(T, 3, 3) float64: triangles in space that cover the outline and leave the holes open."""
        import shapely

        pieces = shapely.get_parts(shapely.constrained_delaunay_triangles(self.metric))
        pieces = pieces[shapely.area(pieces) > _LEAST_TRIANGLE * self.area]  # others are of corners on a line
        corners = np.array([np.asarray(piece.exterior.coords)[:3] for piece in pieces]).reshape(-1, 2)
        return self.to_space(corners).reshape(-1, 3, 3)

    def to_dict(self) -> dict[str, Any]:
        """The outline as numbers and lists, for JSON; outlines and rectangle in space."""
        return {
            "label": self.label,
            "plane": self.plane.tolist(),
            "area": self.area,
            "rectangle": self.corners().tolist(),
            "hull": self.corners(self.hull).tolist(),
            "outline": [[ring.tolist() for ring in part] for part in self.rings()],
        }


def plane_polygons(
    segmentation: Segmentation | LabelPlanes, *, tolerance: float = 1.0, min_part: float = 16.0
) -> list[PlanePolygon]:
    """Outline every plane of a segmentation.

    Parameters
    ----------
    segmentation : Segmentation or LabelPlanes
        Of the latter, the result of `fit_labels`, all pixels without a label count as missing.
    tolerance : float
        How far, in pixels, a simplified outline may be from the outline of the pixels. At one corner of a ring it may
        be twice as far, and in the plane a quarter more if a lens distorts. Outlines of neighbours, each simplified by
        itself, may overlap by as much. 0 keeps every corner; where an edge steps aside at every pixel, its line passes
        through the middles of the pixels' sides.
    min_part : float
        Parts and holes of fewer pixels are left out, unless nothing else is left of the plane. A missing pixel counts
        as the plane's if every square of that many pixels around it contains one of the plane's.

    Returns
    -------
    list of PlanePolygon
        One for each label that has a plane, in order; empty for a plane without pixels.

    Raises
    ------
    ModuleNotFoundError
        shapely is not installed.
    TypeError, ValueError
        For an argument that cannot be used: a `tolerance` or a `min_part` that is negative.
    """
    if not isinstance(segmentation, Segmentation | LabelPlanes):
        raise no_segmentation(segmentation, "a Segmentation or LabelPlanes")
    tolerance, min_part = _pixels("tolerance", tolerance), _pixels("min_part", min_part)
    with needs("shapely", "polygons"):
        import shapely  # noqa: F401

    missing = (
        segmentation.reason == Reason.MISSING if isinstance(segmentation, Segmentation) else segmentation.labels == 0
    )
    return [
        _polygon(segmentation, label, missing, box, tolerance, min_part)
        for label, box in enumerate(boxes_of(segmentation.labels, len(segmentation.planes)), start=1)
        if np.isfinite(segmentation.planes[label - 1]).all()
    ]


def _pixels(name: str, value: float) -> float:
    """Pixels as a float."""
    pixels = number(name, value, finite=False)
    if not pixels >= 0.0:
        raise ValueError(f"{name} must not be negative, in pixels, got {value!r}")
    return pixels


def _polygon(
    segmentation: Segmentation | LabelPlanes,
    label: int,
    missing: NDArray[np.bool_],
    box: tuple[slice, slice],
    tolerance: float,
    min_part: float,
) -> PlanePolygon:
    plane = segmentation.planes[label - 1].copy()
    normal, d = plane[:3], plane[3]
    origin = -d * normal
    # To the right in the image, as far as the plane allows; for a plane seen along the rows that is into the image, or
    # out of it.
    right = np.array([np.sign(segmentation.camera.fx), 0.0, 0.0])
    if abs(normal @ right) > 0.99:
        right = np.array([0.0, 0.0, np.sign(normal @ right)])
    first = right - (right @ normal) * normal
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(first, normal)])

    camera, alpha = segmentation.camera, segmentation.alpha[label - 1]
    mask = segmentation.labels[box] == label
    whole = mask | (missing[box] & _without_gaps(mask, min_part))
    image = _outline(whole, box[1].start, box[0].start, tolerance, min_part)
    # Half a pixel beyond the farthest pixel of a plane seen along its surface, rays hardly meet it, or not at all. If
    # that pixel is one or more from the horizon, they do at no more than twice its depth. A label may go on beyond the
    # horizon, where nothing is measured: it ends at a thousand times the depth of its nearest pixel.
    q = (alpha[0] * camera.tan_x[box] + alpha[1] * camera.tan_y[box] + alpha[2])[mask]
    farthest = max(0.5 * float(q.min(initial=np.inf)), 1e-3 * float(q.max(initial=0.0)))
    metric = _in_plane(_bent_by_lens(image, camera, tolerance), camera, alpha, farthest, origin, axes)
    return PlanePolygon(label, plane, origin, axes, image, metric)


def _without_gaps(mask: NDArray[np.bool_], least: float) -> NDArray[np.bool_]:
    """The mask, and each pixel that no square of ``least`` pixels contains without one of the mask."""
    from scipy.ndimage import grey_closing

    side = math.ceil(min(math.sqrt(least), max(mask.shape)))
    if side < 2:
        return mask
    return np.asarray(grey_closing(np.pad(mask, side), size=(side, side))[side:-side, side:-side])


def _outline(mask: NDArray[np.bool_], left: int, top: int, tolerance: float, min_part: float) -> MultiPolygon:
    """The outline of a mask whose first pixel is at (left, top)."""
    import contourpy
    import shapely

    framed = np.pad(mask.astype(np.float64), 1)
    height, width = framed.shape
    generator = contourpy.contour_generator(
        x=np.arange(left - 1, left - 1 + width, dtype=np.float64),
        y=np.arange(top - 1, top - 1 + height, dtype=np.float64),
        z=framed,
        fill_type=contourpy.FillType.OuterOffset,
    )
    least = min_part - 0.5  # its corners, cut off, take half a pixel from an outline

    def polygon(rings: list[Floats]) -> Polygon:
        return shapely.Polygon(rings[0], rings[1:])

    parts = []
    for points, offsets in zip(*generator.filled(0.5, np.inf), strict=True):
        outer, *holes = (points[i:j] for i, j in itertools.pairwise(offsets))
        parts.append([outer, *(hole for hole in holes if polygon([hole]).area >= least)])
    if not parts:
        return shapely.MultiPolygon()
    areas = np.array([polygon(rings).area for rings in parts])
    chosen = np.flatnonzero(areas >= least) if areas.max() >= least else [areas.argmax()]
    outline = shapely.MultiPolygon([polygon([_with_corners(ring) for ring in parts[i]]) for i in chosen])
    return _simplified(outline, tolerance) if tolerance > 0.0 else _multi(outline, outline)


def _simplified(outline: MultiPolygon, tolerance: float) -> MultiPolygon:
    """The outline with fewer corners; parts that hardly anything would be left of stay as they are."""
    import shapely

    parts = shapely.get_parts(outline)
    simple = shapely.simplify(parts, tolerance)
    off = np.abs(shapely.area(simple) - shapely.area(parts))
    joined = shapely.MultiPolygon(list(np.where(off > _LARGEST_CHANGE * shapely.area(parts), parts, simple)))
    # All parts together keep clear of each other, but take far longer.
    return _multi(joined if joined.is_valid else outline.simplify(tolerance), outline)


def _with_corners(ring: Floats) -> Floats:
    """A contour's ring with the right angles that it cuts off, beginning at one of them.

    Simplifying keeps the first corner and moves none: without them it would take half a pixel off straight edges.
    """
    sides = np.diff(ring, axis=0)
    cut = (sides != 0.0).all(axis=1)
    # Between two straight sides; several cuts in a row are a slanted edge.
    alone = np.flatnonzero(cut & ~np.roll(cut, 1) & ~np.roll(cut, -1))
    corners = ring[alone] + 0.5 * sides[alone - 1]
    if not len(alone):
        return ring
    ring, start = np.insert(ring, alone + 1, corners, axis=0), alone[0] + 1
    return np.concatenate([ring[start:-1], ring[: start + 1]])


def _multi(geometry: Geometry, otherwise: MultiPolygon) -> MultiPolygon:
    """Valid polygons and nothing else; ``otherwise`` where nothing is left."""
    import shapely

    parts = [
        part
        for part in shapely.get_parts(shapely.get_parts(shapely.make_valid(geometry)))  # a collection may hold several
        if part.geom_type == "Polygon" and not part.is_empty
    ]
    return shapely.MultiPolygon(parts) if parts else otherwise


def _bent_by_lens(image: MultiPolygon, camera: Camera, tolerance: float) -> MultiPolygon:
    """The outline with corners added along the edges that a lens turns into curves in the plane."""
    import shapely

    if not camera.is_distorted or tolerance == 0.0:  # then there is a corner at every pixel
        return image

    def bent(ring: Any) -> Floats:
        corners = np.asarray(ring.coords)
        return _with_bends(corners, camera, _SHARE_OF_BENDS * tolerance)

    return shapely.MultiPolygon(
        [shapely.Polygon(bent(part.exterior), [bent(hole) for hole in part.interiors]) for part in image.geoms]
    )


def _with_bends(ring: Floats, camera: Camera, tolerance: float) -> Floats:
    """A ring with edges halved until each is straight, seen along its rays, to within ``tolerance`` pixels."""
    while True:
        start, edge = ring[:-1], np.diff(ring, axis=0)
        pixels = np.linalg.norm(edge, axis=-1, keepdims=True)
        places = start + _ON_EDGE[:, None, None] * edge
        beside = places[1:-1] + np.stack([-edge[:, 1], edge[:, 0]], axis=-1) / np.maximum(pixels, 1.0)
        first, *between, last = rays_through(camera, places)[..., :2]
        along = last - first
        off, pitch = (
            np.abs(along[:, 0] * w[..., 1] - along[:, 1] * w[..., 0])
            for w in (between - first, rays_through(camera, beside)[..., :2] - between)
        )
        # Both times the length: how far off the straight line an edge is, and one pixel across it.
        bent = np.flatnonzero((pixels[:, 0] > 1.0) & (off > tolerance * pitch).any(axis=0))
        if not len(bent):
            return ring
        ring = np.insert(ring, bent + 1, start[bent] + 0.5 * edge[bent], axis=0)


def _in_plane(
    image: MultiPolygon, camera: Camera, alpha: Floats, farthest: float, origin: Floats, axes: Floats
) -> MultiPolygon:
    """The outline in the plane's coordinates: where the rays through its corners meet it, 1/Z no less than farthest."""
    import shapely

    def meet(pixels: Floats) -> Floats:
        rays = rays_through(camera, pixels)
        points = rays / np.maximum(rays @ alpha, farthest)[:, None]
        return np.asarray((points - origin) @ axes.T)

    metric = shapely.transform(image, meet)
    # Axes and normal are left-handed: clockwise in the plane's coordinates is counter-clockwise about the normal.
    return shapely.orient_polygons(_multi(metric, metric), exterior_cw=True)
