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

__version__ = "0.2.0.dev0"

# Where each public name comes from.
_NAMES = {
    "Camera": "camera",
    "FitSettings": "batch.parts",
    "LabelPlanes": "labels",
    "MergedPlanes": "merging",
    "PlanePolygon": "polygons",
    "PlaneTracker": "segmentation.tracking",
    "Reason": "segmentation.result",
    "Segmentation": "segmentation.result",
    "TileFitter": "tiles",
    "TilePlanes": "tile_planes",
    "TileStatus": "plane_fits",
    "TrackedSegmentation": "segmentation.tracking",
    "WindowPlanes": "windows",
    "curvature": "surfaces",
    "estimate_noise": "noise.estimation",
    "fit_labels": "labels",
    "fit_sequence": "batch.sequence",
    "fit_tiles": "tiles",
    "fit_windows": "windows",
    "measurement_noise": "noise.points",
    "merge": "merging",
    "normals": "surfaces",
    "open_sequence": "sequences",
    "plane_polygons": "polygons",
    "segment": "segmentation.segment",
    "segment_quadtree": "quadtree",
    "segment_sequence": "segmentation.tracking",
    "warmup": "warm",
}
_MODULES = (
    "export",
    "images",
    "metrics",
    "noise",
    "presets",
    "recording",
    "scenes",
    "segmentation_export",
    "sequences",
    "uncertainty",
)

__all__ = ["__version__", *_NAMES, *_MODULES]

if TYPE_CHECKING:
    from rgbd_planes import export as export
    from rgbd_planes import images as images
    from rgbd_planes import metrics as metrics
    from rgbd_planes import noise as noise
    from rgbd_planes import presets as presets
    from rgbd_planes import recording as recording
    from rgbd_planes import scenes as scenes
    from rgbd_planes import segmentation_export as segmentation_export
    from rgbd_planes import sequences as sequences
    from rgbd_planes import uncertainty as uncertainty
    from rgbd_planes.batch.parts import FitSettings as FitSettings
    from rgbd_planes.batch.sequence import fit_sequence as fit_sequence
    from rgbd_planes.camera import Camera as Camera
    from rgbd_planes.labels import LabelPlanes as LabelPlanes
    from rgbd_planes.labels import fit_labels as fit_labels
    from rgbd_planes.merging import MergedPlanes as MergedPlanes
    from rgbd_planes.merging import merge as merge
    from rgbd_planes.noise.estimation import estimate_noise as estimate_noise
    from rgbd_planes.noise.points import measurement_noise as measurement_noise
    from rgbd_planes.plane_fits import TileStatus as TileStatus
    from rgbd_planes.polygons import PlanePolygon as PlanePolygon
    from rgbd_planes.polygons import plane_polygons as plane_polygons
    from rgbd_planes.quadtree import segment_quadtree as segment_quadtree
    from rgbd_planes.segmentation.result import Reason as Reason
    from rgbd_planes.segmentation.result import Segmentation as Segmentation
    from rgbd_planes.segmentation.segment import segment as segment
    from rgbd_planes.segmentation.tracking import PlaneTracker as PlaneTracker
    from rgbd_planes.segmentation.tracking import TrackedSegmentation as TrackedSegmentation
    from rgbd_planes.segmentation.tracking import segment_sequence as segment_sequence
    from rgbd_planes.sequences import open_sequence as open_sequence
    from rgbd_planes.surfaces import curvature as curvature
    from rgbd_planes.surfaces import normals as normals
    from rgbd_planes.tile_planes import TilePlanes as TilePlanes
    from rgbd_planes.tiles import TileFitter as TileFitter
    from rgbd_planes.tiles import fit_tiles as fit_tiles
    from rgbd_planes.warm import warmup as warmup
    from rgbd_planes.windows import WindowPlanes as WindowPlanes
    from rgbd_planes.windows import fit_windows as fit_windows


def __getattr__(name: str) -> Any:
    if name in _NAMES:
        value = getattr(importlib.import_module(f"{__name__}.{_NAMES[name]}"), name)
    elif name in _MODULES:
        value = importlib.import_module(f"{__name__}.{name}")
    else:
        # With these Python says which name is meant.
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}", name=name, obj=sys.modules[__name__])
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
