"""A recording for the rerun viewer: frames, points, planes and their polygons over time."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from rgbd_planes._core.checks import check_bool, shaped_array
from rgbd_planes._core.files import write_beside
from rgbd_planes._core.rotations import as_motion
from rgbd_planes._core.user_warnings import warn_caller
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.frame import Frame
from rgbd_planes.export.rerun_scene import (
    CameraPath,
    PlaneColours,
    log_camera,
    log_depth,
    log_labels,
    log_outlines,
    log_primitives,
    rerun,
    set_time,
)
from rgbd_planes.export.tiles import polygons_of
from rgbd_planes.fitting.tiles import TileFitter
from rgbd_planes.plotting.colours import in_image, normal_colours
from rgbd_planes.primitives.fit import fit_primitives
from rgbd_planes.primitives.result import PrimitiveFits
from rgbd_planes.primitives.tracking import PrimitiveTracker
from rgbd_planes.segmentation.result import Segmentation
from rgbd_planes.segmentation.segment import MIN_SIZE, check_min_size, segment
from rgbd_planes.segmentation.tracking import PlaneTracker
from rgbd_planes.sequences.frames import FrameSequence, check_sequence
from rgbd_planes.sequences.problems import Problem, in_words, reason_to_skip

Fit = TypeVar("Fit")


def record(
    sequence: FrameSequence,
    path: str | os.PathLike[str],
    tile: int | tuple[int, int] = 16,
    method: str = "range_explicit",
    *,
    max_missing: float = 0.5,
    max_error: float | None = None,
    poses: ArrayLike | None = None,
) -> None:
    """Fit the tiles of a sequence and write a recording that rerun shows; whole or not at all.

    Parameters
    ----------
    sequence : FrameSequence
    path : .rrd file
    tile : int or (height, width)
        Size of a tile in pixels.
    method : str
        A method of `rgbd_planes.fit_tiles`.
    max_missing : float
        Share of missing pixels above which a tile gets TOO_FEW.
    max_error : float, optional
        Tiles with a larger ``rmse_metric``, in metres, get ROUGH.
    poses : (N, 4, 4) array_like, optional
        Camera to world of each frame, such as ``T_world_camera`` of `Odometry`; NaN where it is not known. By default
        those that the frames state.

    Raises
    ------
    ModuleNotFoundError
        rerun-sdk is not installed.
    OSError
        It cannot be written there, or a frame cannot be read for a reason that would concern all frames.
    TypeError, ValueError
        An argument cannot be used, or no frame can be read and fitted.

    Warns
    -----
    UserWarning
        Frames that cannot be read or fitted are skipped. And as `rgbd_planes.fit_tiles`.

    Notes
    -----
    Entities:

    - ``camera``: pinhole and depth image, in metres. An ordinary lens is shown without its distortion. A fisheye has
      ``points`` in place of the pinhole. x is to the right of the image and y down, even where fx or fy is negative.
    - ``planes/outlines``: each tile's polygon.
    - ``planes/normals``: from its middle its normal, as long as the tile. Red is right, green up, blue to the camera.
    - ``fitted``: the number of fitted tiles.

    Timelines: ``frame``, and ``time`` where the sequence has times.
    """

    @lru_cache(maxsize=1)
    def fitter(camera: Camera) -> TileFitter:
        return TileFitter(camera, tile, method, max_missing=max_missing, max_error=max_error)

    with _recording(path) as (rr, stream):
        check_sequence(sequence)
        places = _Places(sequence, poses)
        fitter(sequence.camera)  # what is wrong with the settings is wrong with no frame
        for index, frame, tiles in _each(sequence, lambda frame: fitter(frame.camera).fit(frame.depth)):
            camera = frame.camera
            _log_frame(rr, stream, index, frame, places)
            # In the axes of the image, the only ones that rerun's pinhole has.
            corners, planes = polygons_of(tiles)
            polygons, normals = in_image(corners, camera), in_image(planes[:, :3], camera)
            colours = normal_colours(normals)
            outlines = np.concatenate([polygons, polygons[:, :1]], axis=1)
            size = np.linalg.norm(polygons[:, 0] - polygons[:, 2], axis=1, keepdims=True)
            stream.log("planes/outlines", rr.LineStrips3D(outlines, colors=colours))
            arrows = rr.Arrows3D(origins=polygons.mean(axis=1), vectors=normals * size, colors=colours)
            stream.log("planes/normals", arrows)
            stream.log("fitted", rr.Scalars(float(np.count_nonzero(tiles.fitted))))


def record_segments(
    sequence: FrameSequence,
    path: str | os.PathLike[str],
    *,
    min_size: int = MIN_SIZE,
    poses: ArrayLike | None = None,
    primitives: bool = False,
) -> None:
    """Segment a sequence and write a recording that rerun shows; whole or not at all.

    Parameters
    ----------
    sequence : FrameSequence
    path : .rrd file
    min_size : int
        Pixels that a plane must have.
    poses : (N, 4, 4) array_like, optional
        Camera to world of each frame, as in `record`.
    primitives : bool
        Whether spheres and cylinders are fitted to curved surfaces, too.

    Raises
    ------
    ModuleNotFoundError
        rerun-sdk or shapely is not installed.
    OSError
        It cannot be written there, or a frame cannot be read for a reason that would concern all frames.
    TypeError, ValueError
        `min_size` or `primitives` cannot be used, or no frame can be read and segmented.

    Warns
    -----
    UserWarning
        Frames that cannot be read or segmented are skipped. And as `rgbd_planes.segment`.

    Notes
    -----
    Entities:

    - ``camera``: pinhole and depth image, in metres.
    - ``camera/planes``: the id of each pixel's plane, 0 for none. A frame of another size has new ids.
    - ``planes/outlines``: outlines and holes, in the colour of the plane's id.
    - ``planes/primitives``: with `primitives`, the parts of spheres and cylinders that are seen, by their ids.
    - ``found``: the number of planes.

    Timelines: ``frame``, and ``time`` where the sequence has times.
    """
    tracker, round_ones = PlaneTracker(), PrimitiveTracker()
    colours = PlaneColours()
    with _recording(path) as (rr, stream):
        check_sequence(sequence)
        check_min_size(min_size)
        places = _Places(sequence, poses)
        with_primitives = check_bool("primitives", primitives)

        def fit(frame: Frame) -> tuple[Segmentation, PrimitiveFits | None]:
            found = segment(frame.depth, frame.camera, min_size=min_size)
            return found, fit_primitives(frame.depth, frame.camera, found.curved_labels) if with_primitives else None

        for index, frame, (found, fits) in _each(sequence, fit):
            motion = None if fits is None else tracker.estimate_motion(found)
            tracked = tracker.follow(found)
            _log_frame(rr, stream, index, frame, places)
            log_labels(rr, stream, tracked.labels, colours)
            log_outlines(rr, stream, found, tracked.ids, colours)
            if fits is not None:
                log_primitives(rr, stream, round_ones.follow(fits, motion))
        colours.log(rr, stream)


@contextmanager
def _recording(path: str | os.PathLike[str]) -> Iterator[tuple[Any, Any]]:
    """The module rerun and a stream into a file."""
    rr = rerun()
    in_block = False
    with write_beside(path, ".rrd") as beside:
        try:
            with rr.RecordingStream("rgbd_planes") as stream:
                stream.save(beside)
                stream.log("/", rr.ViewCoordinates.RDF, static=True)
                in_block = True
                yield rr, stream
                in_block = False
                stream.flush()
        except RuntimeError as error:  # rerun's, for a full disk
            if in_block:
                raise
            raise OSError(str(error)) from error


def _each(sequence: FrameSequence, fit: Callable[[Frame], Fit]) -> Iterator[tuple[int, Frame, Fit]]:
    """Number, frame and fit of those that can be read and fitted; in the end a warning names the others."""
    problems = []
    for index, name in enumerate(sequence.names):
        try:
            frame = sequence[index]
            fitted = fit(frame)
        except Exception as error:
            problems.append(Problem(index, name, reason_to_skip(error, name)))
            continue
        yield index, frame, fitted
    lines = in_words(problems)
    if len(problems) == len(sequence):
        raise ValueError(f"expected a frame that can be read and fitted, got none: {'; '.join(lines)}")
    for line in lines:
        warn_caller(f"skipped {line}")


class _Places:
    """Where the camera is at each frame: as given, or as the frames state."""

    def __init__(self, sequence: FrameSequence, poses: ArrayLike | None) -> None:
        self._given = None if poses is None else shaped_array("poses", poses, (4, 4))
        if self._given is not None and self._given.shape[:-2] != (len(sequence),):
            raise ValueError(f"expected {len(sequence)} poses of shape (4, 4), one a frame, got {self._given.shape}")
        self._path = CameraPath()

    def log(self, rr: Any, stream: Any, index: int, frame: Frame) -> None:
        """Log where a frame was seen from, if that is known."""
        pose = frame.pose if self._given is None else self._given[index]
        if pose is not None and np.isfinite(pose).all():
            self._path.log(rr, stream, as_motion("pose", pose), frame.camera)


def _log_frame(rr: Any, stream: Any, index: int, frame: Frame, places: _Places) -> None:
    """Set the time, and log where the camera is, the camera and its depth."""
    camera = frame.camera
    set_time(stream, index, frame.timestamp)
    places.log(rr, stream, index, frame)
    points = camera.points(frame.depth)
    if camera.distortion_model == "fisheye":  # rerun has no such camera
        measured = np.isfinite(points[..., 2])
        stream.log("points", rr.Points3D(in_image(points[measured], camera)))
    log_camera(rr, stream, camera)
    log_depth(rr, stream, points[..., 2])
