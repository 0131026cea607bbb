"""What goes to rerun of a frame, and under which names: shared by recordings and by the live view."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.optional_imports import needs
from rgbd_planes.camera.camera import Camera
from rgbd_planes.export.primitives import patches
from rgbd_planes.plotting.colours import MISSING, NO_PLANE, in_image, label_colours
from rgbd_planes.primitives.tracking import TrackedPrimitives
from rgbd_planes.segmentation.polygons import plane_polygons
from rgbd_planes.segmentation.result import Segmentation

_MOST_CLASSES = 65535  # the most that rerun has: after that many planes the numbers begin again
_MOST_POINTS = 80_000


def rerun() -> Any:
    """The module rerun; an error says how to install it."""
    with needs("rerun-sdk", "viewer"):
        import rerun
    return rerun


def set_time(stream: Any, index: int, timestamp: float) -> None:
    """Set the number of the frame, and its time where it has one."""
    stream.set_time("frame", sequence=index)
    if math.isfinite(timestamp):
        stream.set_time("time", timestamp=timestamp)
    else:
        stream.disable_timeline("time")  # which would stay at the frame before


def log_camera(rr: Any, stream: Any, camera: Camera) -> None:
    """Log ``camera``, a pinhole; a fisheye has none in rerun."""
    if camera.distortion_model != "fisheye":
        pinhole = rr.Pinhole(
            focal_length=(abs(camera.fx), abs(camera.fy)),
            principal_point=(camera.cx, camera.cy),
            width=camera.width,
            height=camera.height,
        )
        stream.log("camera", pinhole)


def log_depth(rr: Any, stream: Any, metres: NDArray[np.float64]) -> None:
    """Log ``camera/depth``, in metres."""
    stream.log("camera/depth", rr.DepthImage(np.nan_to_num(metres).astype(np.float32), meter=1.0))


class CameraPath:
    """Where the camera is: moves what it sees to its place in the world, and leaves its path behind."""

    def __init__(self) -> None:
        self._places = np.zeros((0, 3))

    def log(self, rr: Any, stream: Any, pose: NDArray[np.float64], camera: Camera) -> None:
        """Log the transforms of ``camera``, ``points`` and ``planes``, and ``path``; the pose is camera to world."""
        signs = np.diag(np.sign([camera.fx, camera.fy, 1.0]))  # axes of the image, as all else
        turn, place = signs @ pose[:3, :3] @ signs, in_image(pose[:3, 3], camera)
        for entity in ("camera", "points", "planes"):
            stream.log(entity, rr.Transform3D(translation=place, mat3x3=turn))
        self._places = np.vstack([self._places, place])
        stream.log("path", rr.LineStrips3D([self._places], colors=[255, 160, 0]))


class PlaneColours:
    """One colour for each id, which a plane keeps from frame to frame, and the list of them that the viewer needs."""

    def __init__(self) -> None:
        self.most = 0
        self._colours = np.zeros((0, 3))

    def classes(self, ids: NDArray[np.int32]) -> NDArray[np.int32]:
        """(...) int32: the class of each id, 1 to 65535; 0 where there is none."""
        classes = np.where(ids > 0, (ids - 1) % _MOST_CLASSES + 1, 0)
        self.most = max(self.most, int(classes.max(initial=0)))
        if self.most > len(self._colours):
            self._colours = label_colours(2 * self.most)
        return np.asarray(classes)

    def class_colours(self, classes: NDArray[np.int32]) -> NDArray[np.float64]:
        """(..., 3) float64: RGB of classes; dark grey for 0."""
        return np.vstack([NO_PLANE, self._colours])[classes]

    def log(self, rr: Any, stream: Any) -> None:
        """Log the names and colours of all classes so far."""
        colours = self.class_colours(np.arange(self.most + 1, dtype=np.int32)).tolist()
        classes = [(i, str(i) if i else "none", colour) for i, colour in enumerate(colours)]
        stream.log("/", rr.AnnotationContext(classes), static=True)


def log_labels(rr: Any, stream: Any, labels: NDArray[np.int32], colours: PlaneColours) -> None:
    """Log ``camera/planes``: the class of each pixel's plane, from its id."""
    stream.log("camera/planes", rr.SegmentationImage(colours.classes(labels).astype(np.uint16)))


def log_outlines(rr: Any, stream: Any, found: Segmentation, ids: NDArray[np.int32], colours: PlaneColours) -> None:
    """Log ``planes/outlines``, in the colours of the ids, and ``found`` (how many planes)."""
    classes = colours.classes(ids)
    outlines, own = [], []
    for plane in plane_polygons(found):
        rings = [np.vstack([ring, ring[:1]]) for part in plane.rings() for ring in part]
        outlines += [in_image(ring, found.camera) for ring in rings]
        own += [classes[plane.label - 1]] * len(rings)
    strips = rr.LineStrips3D(outlines, colors=colours.class_colours(np.array(own, np.int32)))
    stream.log("planes/outlines", strips)
    stream.log("found", rr.Scalars(float(len(ids))))


def log_primitives(rr: Any, stream: Any, tracked: TrackedPrimitives) -> None:
    """Log ``planes/primitives``: what is seen of spheres and cylinders as triangles, in the colours of their ids."""
    points, triangles, labels = patches(tracked.fits)
    ids = tracked.ids[labels - 1]
    colours = label_colours(int(ids.max(initial=0)))[ids - 1]
    mesh = rr.Mesh3D(
        vertex_positions=in_image(points, tracked.fits.camera),
        triangle_indices=triangles[ids[triangles[:, 0]] > 0],
        vertex_colors=np.rint(255.0 * colours).astype(np.uint8),
    )
    stream.log("planes/primitives", mesh)


def coloured(labels: NDArray[np.int32], missing: NDArray[np.bool_], colours: PlaneColours) -> NDArray[np.uint8]:
    """(H, W, 3) uint8: pixels in the colours of their ids; dark where there is none, light where depth is missing."""
    rgb = colours.class_colours(colours.classes(labels))
    rgb[missing & (labels == 0)] = MISSING
    return np.asarray(np.rint(255.0 * rgb), np.uint8)


def log_points(rr: Any, stream: Any, points: NDArray[np.float64], rgb: NDArray[np.uint8], camera: Camera) -> None:
    """Log ``points``: some of those measured, in the colours of an image."""
    step = max(1, math.ceil(math.sqrt(points.shape[0] * points.shape[1] / _MOST_POINTS)))
    some = points[::step, ::step]
    measured = np.isfinite(some[..., 2])
    stream.log("points", rr.Points3D(in_image(some[measured], camera), colors=rgb[::step, ::step][measured]))
