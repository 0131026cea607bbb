"""The planes of keyframes in the world, merged where they are one."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.optional_imports import needs
from rgbd_planes._core.text import counted
from rgbd_planes.egomotion.pose import CameraPose
from rgbd_planes.segmentation.polygons import PlanePolygon, plane_polygons
from rgbd_planes.uncertainty.planes import same_plane, transform_planes

if TYPE_CHECKING:
    from shapely import MultiPolygon

LEAST_SIZE = 500  # pixels of a plane
LEAST_P = 1e-3  # of `same_plane`
NEAR = 0.2  # metres between the outlines of what is one plane
# Errors that poses and sensors add to planes seen from different places: standard deviations of n, in rad, and d, in m.
ADDED = np.array([np.radians(1.0)] * 3 + [0.01])


class PlaneMap:
    """Outlines of planes in the world, from the keyframes of an odometry.

    Needs shapely: ``pip install rgbd-planes[polygons]``.

    Raises
    ------
    ModuleNotFoundError
        shapely is not installed.
    """

    def __init__(self) -> None:
        with needs("shapely", "polygons"):
            import shapely  # noqa: F401 (now, not after the work)
        self._polygons: list[PlanePolygon] = []
        self._covariances: list[Floats] = []

    def __len__(self) -> int:
        """Number of planes."""
        return len(self._polygons)

    def __repr__(self) -> str:
        return f"<PlaneMap: {counted(len(self), 'plane')}>"

    @property
    def polygons(self) -> list[PlanePolygon]:
        """The planes in world coordinates, as `segmentation_export` takes them; labels 1, 2, ... as they came."""
        return list(self._polygons)

    def add(self, pose: CameraPose) -> None:
        """Add the planes of a frame at its pose; usually of keyframes alone.

        Parameters
        ----------
        pose : CameraPose
            What `Odometry` gives for a frame. Planes of fewer than 500 pixels are left out.

        Raises
        ------
        TypeError
            It is no `CameraPose`.
        """
        if not isinstance(pose, CameraPose):
            raise TypeError(f"expected a CameraPose, which Odometry gives, got {type(pose).__name__}")
        found = pose.segmentation.segmentation
        large = found.sizes >= LEAST_SIZE
        added = np.diag(ADDED**2)
        for polygon in plane_polygons(found):
            i = polygon.label - 1
            if large[i] and not polygon.metric.is_empty:
                plane, covariance = transform_planes(
                    found.planes[i], found.plane_covariance[i] + added, pose.T_world_camera
                )
                self._add(_moved(polygon, plane, pose.T_world_camera), covariance)

    def _add(self, polygon: PlanePolygon, covariance: Floats) -> None:
        """Merge a plane with the first that is the same, or add it."""
        if self._polygons:
            planes = np.array([known.plane for known in self._polygons])
            p = same_plane(planes, np.array(self._covariances), polygon.plane, covariance)
            for k in np.flatnonzero(p >= LEAST_P):
                known = self._polygons[k]
                outline = _in_plane(polygon, known)
                if known.metric.distance(outline) <= NEAR:
                    self._polygons[k] = replace(known, metric=_union(known.metric, outline))
                    return
        self._polygons.append(replace(polygon, label=len(self) + 1))
        self._covariances.append(covariance)


def _moved(polygon: PlanePolygon, plane: Floats, motion: Floats) -> PlanePolygon:
    """An outline in world coordinates; its coordinates in the plane stay."""
    rotation, translation = motion[:3, :3], motion[:3, 3]
    return replace(
        polygon, plane=plane, origin=rotation @ polygon.origin + translation, axes=polygon.axes @ rotation.T
    )  # fmt: skip


def _in_plane(polygon: PlanePolygon, other: PlanePolygon) -> MultiPolygon:
    """The outline in the coordinates of another plane."""
    import shapely

    moved = shapely.transform(polygon.metric, lambda points: other.to_plane(polygon.to_space(points)))
    return _polygons_of(shapely.make_valid(moved))


def _union(first: MultiPolygon, second: MultiPolygon) -> MultiPolygon:
    import shapely

    return _polygons_of(shapely.union(shapely.make_valid(first), second, grid_size=1e-4))


def _polygons_of(geometry: object) -> MultiPolygon:
    """The polygons of any geometry."""
    import shapely

    parts = shapely.get_parts(geometry)
    parts = np.concatenate([shapely.get_parts(part) for part in parts]) if len(parts) else parts
    return shapely.MultiPolygon([part for part in parts if isinstance(part, shapely.Polygon) and part.area > 0.0])
