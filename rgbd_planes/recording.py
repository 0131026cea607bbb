"""A recording for the rerun viewer: frames, points, planes and their polygons over time."""

import math
import os

import numpy as np

from rgbd_planes.colours import normal_colours
from rgbd_planes.export import exported, tile_polygons
from rgbd_planes.extras import needs
from rgbd_planes.files import write_beside
from rgbd_planes.sequences.frames import FrameSequence
from rgbd_planes.tiles import TileFitter


def record(
    sequence: FrameSequence,
    path: str | os.PathLike[str],
    tile: int | tuple[int, int] = 16,
    method: str = "range_explicit",
    *,
    max_missing: float = 0.5,
    max_error: float | None = None,
) -> None:
    """Fit the tiles of a sequence and write a recording that rerun shows; whole or not at all.

    Parameters
    ----------
    sequence : FrameSequence
    path : .rrd file
    tile, method, max_missing, max_error
        As in `rgbd_planes.fit_tiles`.

    Raises
    ------
    ModuleNotFoundError
        rerun-sdk is not installed.

    Notes
    -----
    Entities: ``camera`` (pinhole and depth image, in metres; a lens distortion is not shown),
    ``planes/outlines`` and ``planes/normals`` (a tile's polygon and, from its middle, its normal, of the
    length of the tile; red right, green up, blue towards the camera), ``fitted`` (number of fitted tiles).
    Timelines: ``frame``, and ``time`` where the sequence has times.
    """
    with needs("rerun-sdk", "viewer"):
        import rerun as rr
    fitters: dict[object, TileFitter] = {}
    with write_beside(path) as beside, rr.RecordingStream("rgbd_planes") as stream:
        stream.save(beside)
        stream.log("/", rr.ViewCoordinates.RDF, static=True)
        for index, frame in enumerate(sequence):
            camera = frame.camera
            if camera not in fitters:
                fitters = {
                    camera: TileFitter(camera, tile, method, max_missing=max_missing, max_error=max_error)
                }
            tiles = fitters[camera].fit(frame.depth)
            stream.set_time("frame", sequence=index)
            if math.isfinite(frame.timestamp):
                stream.set_time("time", timestamp=frame.timestamp)
            focal_length, centre = (abs(camera.fx), abs(camera.fy)), (camera.cx, camera.cy)
            pinhole = rr.Pinhole(
                focal_length=focal_length, principal_point=centre, width=camera.width, height=camera.height
            )
            stream.log("camera", pinhole)
            metres = np.nan_to_num(camera.points(frame.depth)[..., 2]).astype(np.float32)
            stream.log("camera/depth", rr.DepthImage(metres, meter=1.0))
            polygons = tile_polygons(tiles)
            normals = tiles.planes[exported(tiles)][:, :3]
            colours = normal_colours(normals)
            outlines = np.concatenate([polygons, polygons[:, :1]], axis=1)
            size = np.linalg.norm(polygons[:, 0] - polygons[:, 2], axis=1, keepdims=True)
            stream.log("planes/outlines", rr.LineStrips3D(outlines, colors=colours))
            arrows = rr.Arrows3D(origins=polygons.mean(axis=1), vectors=normals * size, colors=colours)
            stream.log("planes/normals", arrows)
            stream.log("fitted", rr.Scalars(float(np.count_nonzero(tiles.fitted))))
        stream.flush()
