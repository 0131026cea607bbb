"""Frames and their planes in the rerun viewer while they come."""

from __future__ import annotations

import math
import os
import socket
from types import TracebackType
from typing import Any, Self
from urllib.parse import quote

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.checks import number, real_array
from rgbd_planes.camera.camera import Camera, check_camera
from rgbd_planes.export.rerun_scene import (
    CameraPath,
    PlaneColours,
    coloured,
    log_camera,
    log_depth,
    log_outlines,
    log_points,
    rerun,
    set_time,
)
from rgbd_planes.segmentation.result import Segmentation, no_segmentation
from rgbd_planes.segmentation.tracking import TrackedSegmentation

_WEB_PORT, _DATA_PORT = 9090, 9876  # rerun's usual ones
_MEMORY = "40%"  # of the machine's: what a browser that comes later still gets
_CURVATURE = 1e-3, 1.0  # ends of the colours: flat but for a little noise, and no surface at all


class LiveView:
    """Shows depth, planes, outlines and the camera's path in the rerun viewer, frame by frame.

    Needs ``pip install "rgbd-planes[viewer]"``. Use it as a context manager, or call `close`.

    Parameters
    ----------
    where : str or path
        "window" opens rerun's own viewer. "browser" serves its web viewer, and opens a browser. A path that ends in
        .rrd is written instead, for ``rerun PATH`` to show later.
    open_browser : bool
        With "browser", whether to open one. Without it, open `url` yourself.

    Raises
    ------
    ModuleNotFoundError
        rerun-sdk or shapely is not installed.
    ValueError
        ``where`` is none of the three.

    Notes
    -----
    Entities: ``camera``, ``camera/depth``, ``camera/planes`` (in the colours of their ids), ``camera/curvature``,
    ``points`` (likewise), ``planes/outlines``, ``path`` and ``found`` (how many planes).
    Timelines: ``frame``, and ``time`` for frames that have one.

    The data and the page have a port each, 9876 and 9090, or others if these are taken. On a remote machine, forward
    both: ``ssh -L 9090:localhost:9090 -L 9876:localhost:9876 robot``.
    """

    url: str | None
    """Address of the page, with "browser"; None otherwise."""

    def __init__(self, where: str | os.PathLike[str] = "window", *, open_browser: bool = True) -> None:
        place = os.fspath(where)
        if place not in ("window", "browser") and not place.endswith(".rrd"):
            raise ValueError(f'expected where as "window", "browser" or a path that ends in .rrd, got {place!r}')
        self._rr = rr = rerun()
        self._stream = rr.RecordingStream("rgbd_planes")
        self._frame, self._colours, self._path = 0, PlaneColours(), CameraPath()
        self.url = None
        if place == "window":
            self._stream.spawn(default_blueprint=_blueprint())
        elif place == "browser":
            data = self._stream.serve_grpc(
                grpc_port=_free_port(_DATA_PORT), default_blueprint=_blueprint(), server_memory_limit=_MEMORY
            )
            port = _free_port(_WEB_PORT)
            rr.serve_web_viewer(web_port=port, open_browser=open_browser, connect_to=data)
            self.url = f"http://localhost:{port}/?url={quote(data, safe='')}"
        else:
            self._stream.save(place, default_blueprint=_blueprint())
        self._stream.log("/", rr.ViewCoordinates.RDF, static=True)

    def show(
        self,
        depth: ArrayLike,
        camera: Camera,
        found: Segmentation | TrackedSegmentation,
        *,
        timestamp: float = math.nan,
        curvature: NDArray[np.floating[Any]] | None = None,
        pose: ArrayLike | None = None,
    ) -> None:
        """Show a frame and its planes.

        Parameters
        ----------
        depth : (H, W) array_like
            The frame, as stored.
        camera : Camera
        found : Segmentation or TrackedSegmentation
            Its planes. If tracked, a plane keeps its colour from frame to frame.
        timestamp : float
            Seconds since 1970; NaN for none.
        curvature : (H, W) floating, optional
            From `rgbd_planes.curvature`, as an image of its own.
        pose : (4, 4) array_like, optional
            Camera to world: X of the camera is at R·X + t. With it the camera moves, and leaves its path behind.

        Raises
        ------
        TypeError, ValueError
            An argument is of another kind or shape.
        """
        check_camera(camera)
        segmentation = found.segmentation if isinstance(found, TrackedSegmentation) else found
        if not isinstance(segmentation, Segmentation):
            raise no_segmentation(segmentation)
        ids = (
            found.ids if isinstance(found, TrackedSegmentation) else np.arange(1, len(segmentation) + 1, dtype=np.int32)
        )
        time = number("timestamp", timestamp, finite=False)
        rr, stream = self._rr, self._stream
        points = camera.points(depth)
        if segmentation.labels.shape != points.shape[:2]:
            raise ValueError(
                f"expected the planes of this frame, of {points.shape[1]} x {points.shape[0]} pixels, "
                f"got those of a frame of {segmentation.labels.shape[1]} x {segmentation.labels.shape[0]}"
            )
        set_time(stream, self._frame, time)
        if pose is not None:
            self._log_pose(pose, camera)
        log_camera(rr, stream, camera)
        log_depth(rr, stream, points[..., 2])
        labels = np.append(np.int32(0), ids)[segmentation.labels]
        colours = coloured(labels, ~np.isfinite(points[..., 2]), self._colours)
        stream.log("camera/planes", rr.Image(colours).compress(jpeg_quality=95))
        log_points(rr, stream, points, colours, camera)
        log_outlines(rr, stream, segmentation, ids, self._colours)
        if curvature is not None:
            stream.log("camera/curvature", rr.Image(_curvature_colours(curvature)).compress(jpeg_quality=90))
        self._frame += 1

    def close(self) -> None:
        """Send what is left, and stop serving. A window stays open."""
        self._stream.flush()
        self._stream.disconnect()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _log_pose(self, pose: ArrayLike, camera: Camera) -> None:
        """Move all that the camera sees to its place in the world, and make the path longer."""
        matrix = real_array("pose", pose)
        if matrix.shape != (4, 4):
            raise ValueError(f"expected pose as a (4, 4) matrix, camera to world, got {matrix.shape}")
        self._path.log(self._rr, self._stream, matrix, camera)


def _blueprint() -> Any:
    """The scene in 3D on the left, images on the right."""
    import rerun.blueprint as rrb

    scene = rrb.Spatial3DView(
        name="Planes", contents=["+ /**", "- /camera/depth", "- /camera/planes", "- /camera/curvature"]
    )
    images = rrb.Vertical(
        *(
            rrb.Spatial2DView(origin="camera", name=name.capitalize(), contents=[f"camera/{name}"])
            for name in ("depth", "planes", "curvature")
        )
    )
    return rrb.Blueprint(rrb.Horizontal(scene, images, column_shares=[2, 1]), collapse_panels=True)


def _curvature_colours(curvature: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """(H, W, 3) uint8: dark is flat, on a logarithmic scale that stays the same from frame to frame."""
    from matplotlib import colormaps

    low, high = np.log(_CURVATURE)
    with np.errstate(divide="ignore", invalid="ignore"):
        level = (np.log(curvature) - low) / (high - low)
    colours = colormaps["magma"].with_extremes(bad=(0.86, 0.86, 0.86))(np.ma.masked_invalid(np.clip(level, 0.0, 1.0)))
    return np.asarray(np.rint(255.0 * colours[..., :3]), np.uint8)


def _free_port(wanted: int) -> int:
    """The wanted port, or any other that nobody listens on: rerun only logs that one is taken."""
    for port in (wanted, 0):
        with socket.socket() as probe:
            try:
                probe.bind(("0.0.0.0", port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise OSError("no free port to serve the viewer on")
