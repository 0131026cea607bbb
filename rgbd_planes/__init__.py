"""Fit planes to depth images.

    import rgbd_planes as rp

    camera = rp.Camera(width=640, height=480, fx=525.0, fy=525.0, cx=319.5, cy=239.5, depth_scale=1000.0)
    tiles = rp.fit_tiles(depth, camera, tile=16)
    tiles.planes  # (R, C, 4): nx, ny, nz, d

Implements Papadakis and Willis, "Real-Time Surface Fitting to RGBD Sensor Data", IEEE SoutheastCon 2017,
and goes on from there. Names load on first use, so that importing the package takes no time.
"""

import importlib
import sys
from typing import TYPE_CHECKING, Any

from rgbd_planes._core.version import __version__

# Where each public name comes from.
_NAMES = {
    "Camera": "camera.camera",
    "CameraPose": "egomotion.pose",
    "FitSettings": "batch.worker",
    "LabelPlanes": "fitting.labels",
    "LiveView": "export.live",
    "MergedPlanes": "fitting.merge",
    "MergedSurfaces": "fitting.surfaces.windows",
    "Odometry": "egomotion.odometry",
    "PlaneMap": "egomotion.plane_map",
    "PlanePolygon": "segmentation.polygons",
    "PlaneTracker": "segmentation.tracking",
    "Primitive": "_core.status",
    "PrimitiveFits": "primitives.result",
    "PrimitiveTracker": "primitives.tracking",
    "Reason": "segmentation.result",
    "Segmentation": "segmentation.result",
    "SurfaceFitter": "fitting.surfaces.tiles",
    "TileFitter": "fitting.tiles",
    "TilePlanes": "fitting.tile_planes",
    "TileStatus": "fitting.results",
    "TileSurfaces": "fitting.surfaces.tile_surfaces",
    "TrackedPrimitives": "primitives.tracking",
    "TrackedSegmentation": "segmentation.tracking",
    "WindowPlanes": "fitting.windows",
    "WindowSurfaces": "fitting.surfaces.windows",
    "curvature": "fitting.normals",
    "estimate_noise": "noise_estimation.estimation",
    "fit_labels": "fitting.labels",
    "fit_primitives": "primitives.fit",
    "fit_sequence": "batch.fit_sequence",
    "fit_surface_windows": "fitting.surfaces.windows",
    "fit_surfaces": "fitting.surfaces.tiles",
    "fit_tiles": "fitting.tiles",
    "fit_windows": "fitting.windows",
    "measurement_noise": "uncertainty.points",
    "merge": "fitting.merge",
    "normals": "fitting.normals",
    "odometry": "egomotion.odometry",
    "open_sequence": "sequences",
    "plot_trajectory": "plotting.trajectory",
    "plane_polygons": "segmentation.polygons",
    "principal_curvatures": "fitting.surfaces.dense",
    "segment": "segmentation.segment",
    "segment_quadtree": "segmentation.quadtree",
    "segment_sequence": "segmentation.tracking",
    "warmup": "_warmup",
}
# Public modules, and where they are.
_MODULES = {
    "export": "export",
    "images": "sequences.images",
    "metrics": "evaluation.metrics",
    "noise": "noise",
    "presets": "camera.presets",
    "primitive_export": "export.primitives",
    "recording": "export.rerun",
    "scenes": "evaluation.scenes",
    "segmentation_export": "export.segments",
    "sequences": "sequences",
    "uncertainty": "uncertainty",
}

__all__ = ["__version__", *_NAMES, *_MODULES]

if TYPE_CHECKING:
    from rgbd_planes import export as export
    from rgbd_planes import noise as noise
    from rgbd_planes import sequences as sequences
    from rgbd_planes import uncertainty as uncertainty
    from rgbd_planes._core.status import Primitive as Primitive
    from rgbd_planes._core.status import Reason as Reason
    from rgbd_planes._core.status import TileStatus as TileStatus
    from rgbd_planes._warmup import warmup as warmup
    from rgbd_planes.batch.fit_sequence import fit_sequence as fit_sequence
    from rgbd_planes.batch.worker import FitSettings as FitSettings
    from rgbd_planes.camera import presets as presets
    from rgbd_planes.camera.camera import Camera as Camera
    from rgbd_planes.egomotion.odometry import Odometry as Odometry
    from rgbd_planes.egomotion.odometry import odometry as odometry
    from rgbd_planes.egomotion.plane_map import PlaneMap as PlaneMap
    from rgbd_planes.egomotion.pose import CameraPose as CameraPose
    from rgbd_planes.evaluation import metrics as metrics
    from rgbd_planes.evaluation import scenes as scenes
    from rgbd_planes.export import primitives as _primitives
    from rgbd_planes.export import rerun as _recording
    from rgbd_planes.export import segments as _segments
    from rgbd_planes.export.live import LiveView as LiveView
    from rgbd_planes.fitting.labels import LabelPlanes as LabelPlanes
    from rgbd_planes.fitting.labels import fit_labels as fit_labels
    from rgbd_planes.fitting.merge import MergedPlanes as MergedPlanes
    from rgbd_planes.fitting.merge import merge as merge
    from rgbd_planes.fitting.normals import curvature as curvature
    from rgbd_planes.fitting.normals import normals as normals
    from rgbd_planes.fitting.surfaces.dense import principal_curvatures as principal_curvatures
    from rgbd_planes.fitting.surfaces.tile_surfaces import TileSurfaces as TileSurfaces
    from rgbd_planes.fitting.surfaces.tiles import SurfaceFitter as SurfaceFitter
    from rgbd_planes.fitting.surfaces.tiles import fit_surfaces as fit_surfaces
    from rgbd_planes.fitting.surfaces.windows import MergedSurfaces as MergedSurfaces
    from rgbd_planes.fitting.surfaces.windows import WindowSurfaces as WindowSurfaces
    from rgbd_planes.fitting.surfaces.windows import fit_surface_windows as fit_surface_windows
    from rgbd_planes.fitting.tile_planes import TilePlanes as TilePlanes
    from rgbd_planes.fitting.tiles import TileFitter as TileFitter
    from rgbd_planes.fitting.tiles import fit_tiles as fit_tiles
    from rgbd_planes.fitting.windows import WindowPlanes as WindowPlanes
    from rgbd_planes.fitting.windows import fit_windows as fit_windows
    from rgbd_planes.noise_estimation.estimation import estimate_noise as estimate_noise
    from rgbd_planes.plotting.trajectory import plot_trajectory as plot_trajectory
    from rgbd_planes.primitives.fit import fit_primitives as fit_primitives
    from rgbd_planes.primitives.result import PrimitiveFits as PrimitiveFits
    from rgbd_planes.primitives.tracking import PrimitiveTracker as PrimitiveTracker
    from rgbd_planes.primitives.tracking import TrackedPrimitives as TrackedPrimitives
    from rgbd_planes.segmentation.polygons import PlanePolygon as PlanePolygon
    from rgbd_planes.segmentation.polygons import plane_polygons as plane_polygons
    from rgbd_planes.segmentation.quadtree import segment_quadtree as segment_quadtree
    from rgbd_planes.segmentation.result import Segmentation as Segmentation
    from rgbd_planes.segmentation.segment import segment as segment
    from rgbd_planes.segmentation.tracking import PlaneTracker as PlaneTracker
    from rgbd_planes.segmentation.tracking import TrackedSegmentation as TrackedSegmentation
    from rgbd_planes.segmentation.tracking import segment_sequence as segment_sequence
    from rgbd_planes.sequences import images as images
    from rgbd_planes.sequences import open_sequence as open_sequence
    from rgbd_planes.uncertainty.points import measurement_noise as measurement_noise

    primitive_export, recording, segmentation_export = _primitives, _recording, _segments


def __getattr__(name: str) -> Any:
    if name in _NAMES:
        value = getattr(importlib.import_module(f"{__name__}.{_NAMES[name]}"), name)
    elif name in _MODULES:
        value = importlib.import_module(f"{__name__}.{_MODULES[name]}")
    else:
        # With these Python says which name is meant.
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}", name=name, obj=sys.modules[__name__])
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
