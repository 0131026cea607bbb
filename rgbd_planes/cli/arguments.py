"""Shared by the commands: arguments, checks of files to be written, and the summary of tiles."""

import argparse
import io
import math
import os
import sys
from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rgbd_planes._core.text import shown

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rgbd_planes.camera.camera import Camera
    from rgbd_planes.camera.frame import Frame
    from rgbd_planes.fitting.tile_planes import TilePlanes
    from rgbd_planes.noise import NoiseModel
    from rgbd_planes.sequences import FrameSequence

Run = Callable[[argparse.Namespace], int | None]  # returns the exit status, 0 for None


class CommandError(Exception):
    """An error that the user can mend: one line on stderr."""


def add_fit_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a fit of tiles."""
    parser.add_argument("--tile", type=tile_size, default=16, metavar="N or HxW", help="size of a tile in pixels (16)")
    parser.add_argument(
        "--method",
        default="range_explicit",
        metavar="NAME",
        help="range_explicit (default), range_implicit, standard_explicit, standard_implicit, standard_pca",
    )
    add_limits(parser)


def add_limits(parser: argparse.ArgumentParser) -> None:
    """Add what tiles must keep to be OK."""
    add_max_missing(parser, "tile")
    parser.add_argument("--max-error", type=float, metavar="METRES", help="call tiles with a larger residual ROUGH")
    parser.add_argument(
        "--significance",
        type=float,
        metavar="LEVEL",
        help="call tiles ROUGH whose residual the noise explains less often than this (0.01); 0 for none",
    )


def add_max_missing(parser: argparse.ArgumentParser, part: str) -> None:
    """Add the largest share of missing pixels of a tile or a window."""
    parser.add_argument(
        "--max-missing",
        type=float,
        default=0.5,
        metavar="SHARE",
        help=f"largest share of a {part}'s pixels that may be missing (0.5)",
    )


def add_noise(parser: argparse.ArgumentParser, what_for: str, *, number_is_model: bool = True) -> None:
    """Add the sensor's noise: a model, or also a number."""
    parser.add_argument(
        "--noise",
        type=noise_model if number_is_model else model_or_number,
        metavar="NAME or SIGMA",
        help="noise of the sensor, instead of the camera's own: kinect_v1, kinect_v1_nguyen, or the standard deviation "
        f"of 1/Z in 1/m; {what_for}. The models and the number take pixels for independent, which those of sensors "
        "are not: rgbd-planes noise finds a sensor's own",
    )


def noise_model(text: str) -> "NoiseModel":
    """Parse the name of a published model, or a standard deviation at all distances."""
    from rgbd_planes.noise import NoiseModel

    value = model_or_number(text)
    try:
        return NoiseModel((value,)) if isinstance(value, float) else value
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def model_or_number(text: str) -> "NoiseModel | float":
    """Parse the name of a published model, or a standard deviation."""
    from rgbd_planes import noise

    published = {"kinect_v1": noise.kinect_v1, "kinect_v1_nguyen": noise.kinect_v1_nguyen}
    if text in published:
        return published[text]()
    try:
        sigma = float(text)
    except ValueError:
        sigma = 0.0
    if not 0.0 < sigma < math.inf:
        raise argparse.ArgumentTypeError(f"expected {', '.join(published)} or a positive number in 1/m, got {text!r}")
    return sigma


def add_min_size(parser: argparse.ArgumentParser) -> None:
    """Add the least size of a plane."""
    parser.add_argument("--min-size", type=int, default=60, metavar="N", help="fewest pixels of a plane (60)")


def tile_size(text: str) -> tuple[int, int]:
    """Parse "16", or "12x20" for a height of 12."""
    try:
        height, by, width = text.lower().partition("x")
        return int(height), int(width if by else height)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a size such as 16 or 12x20, got {text!r}") from None


def check_outputs(arguments: argparse.Namespace, read: Collection[Path], **suffixes: tuple[str, ...]) -> None:
    """Refuse, before the work, files that cannot be written, or that are read or written already.

    In a folder that is read, no existing file is overwritten, and beside its images none is put.
    """
    from rgbd_planes._core.files import check_writable
    from rgbd_planes.sequences.images import DEPTH_SUFFIXES

    taken = {os.path.realpath(path) for path in read}
    # No format has frames deeper. Not "**", which does not follow links to folders.
    inside = [(place, pattern) for place in read if place.is_dir() for pattern in ("*", "*/*")]
    beside = {os.path.realpath(place / name) for place in read if place.is_dir() for name in (".", "depth")}
    for name, allowed in suffixes.items():
        path: Path | None = getattr(arguments, name)
        if path is None:
            continue
        if path.suffix.lower() not in allowed:
            raise CommandError(f"{shown(path)}: expected a name that ends in {' or '.join(allowed)}")
        if os.path.realpath(path) in taken:
            raise CommandError(f"{shown(path)}: --{name} would write over another file of this command")
        for place, pattern in inside if path.exists() else ():
            if os.path.realpath(path) in map(os.path.realpath, place.glob(pattern)):
                raise CommandError(f"{shown(path)}: --{name} would write over a file in {shown(place)}, which is read")
        if path.suffix.lower() in DEPTH_SUFFIXES and os.path.realpath(path.parent) in beside:
            raise CommandError(
                f"{shown(path)}: --{name} would be taken for a depth image of {shown(path.parent)}, which is read"
            )
        taken.add(os.path.realpath(path))
        check_writable(path)


def add_frame(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that `read_frame` reads."""
    parser.add_argument("depth", type=Path, help="depth image: integers in the camera's units, or metres")
    parser.add_argument(
        "--camera",
        type=Path,
        required=True,
        metavar="FILE or NAME",
        help="file of the camera, of Camera.save or another tool (OpenCV, ROS, Kalibr, ORB-SLAM, COLMAP ...), "
        "or the name of a preset, such as kinect_v1",
    )
    _add_unit_options(parser)


def read_frame(arguments: argparse.Namespace) -> "tuple[NDArray[Any], Camera, int]":
    """The depth image, the camera, and the exit status: 1, with a line on stderr, if nothing is measured."""
    import numpy as np

    from rgbd_planes._core.files import naming
    from rgbd_planes.camera.depth_frame import as_depth_frame
    from rgbd_planes.camera.frame import Frame
    from rgbd_planes.camera.frame_warnings import warn_of_distances, warn_of_reach
    from rgbd_planes.sequences.images import read_depth

    camera = camera_of(arguments)
    depth = after_units(arguments, Frame(read_depth(arguments.depth), camera, math.nan, arguments.depth.name))
    with naming(arguments.depth):
        frame = as_depth_frame(depth, camera)
    if frame.valid.any():
        warn_of_distances(frame, camera)
        warn_of_reach(frame, camera)
        return depth, camera, 0
    known = depth[np.isfinite(depth)]
    reason = f"the values are {known.min():g} to {known.max():g}" if known.size else "all values are NaN or infinite"
    if camera.depth_range is not None:
        nearest, farthest = camera.depth_range
        reason += f", the camera's depth_range is {nearest:g} to {farthest:g} m"
    print(
        f"rgbd-planes {arguments.command}: {shown(arguments.depth)}: no pixel is a measurement: {reason}",
        file=sys.stderr,
    )
    return depth, camera, 1


def add_sequence_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that `read_sequence` takes."""
    parser.add_argument(
        "--camera",
        type=Path,
        metavar="FILE or NAME",
        help="camera to use instead of the sequence's own: a file, or the name of a preset, such as kinect_v1",
    )
    _add_unit_options(parser)
    parser.add_argument(
        "--mask", type=Path, metavar="FOLDER", help="images by the frames' names or numbers: masks, or confidence"
    )
    parser.add_argument(
        "--mask-threshold", type=float, default=1.0, metavar="N", help="what a pixel of --mask needs at least (1)"
    )
    parser.add_argument(
        "--rectified",
        action=argparse.BooleanOptionalAction,
        help="of a ROS bag: take the P of its CameraInfo, or, with --no-rectified, K and D",
    )
    parser.add_argument(
        "--format",
        metavar="NAME",
        help="format of the sequence, if it is not recognised: arkitscenes, folder, icl_nuim, mkv, rosbag, scannet, "
        "scannet_sens, seven_scenes, tum",
    )
    parser.add_argument(
        "--allow-outside", action="store_true", help="read files outside the folder, too, that its depth.txt names"
    )
    parser.add_argument("--topic", help="topic of a ROS bag, if several have depth")


def read_sequence(arguments: argparse.Namespace, path: Path) -> "FrameSequence":
    """The frames of a data set or a recording."""
    from rgbd_planes import open_sequence, sequences

    camera = None if arguments.camera is None else camera_of(arguments)
    given = vars(arguments)  # of which callers may leave out what they have no use for
    topic, rectified = arguments.topic, given.get("rectified")
    if topic is None and rectified is None:
        sequence = open_sequence(path, camera, arguments.format, allow_outside=arguments.allow_outside)
    elif arguments.format not in (None, "rosbag"):
        option = "--rectified" if topic is None else "--topic"
        raise CommandError(f"{option} is for ROS bags, got it with --format {shown(arguments.format)}")
    else:
        sequence = sequences.rosbag(path, camera, topic, rectified)
    if given.get("depth_scale") is not None and camera is None:
        scale = {old: replace(old, depth_scale=arguments.depth_scale, disparity=None) for old in sequence.cameras}
        sequence = sequence.with_cameras(scale)
    if given.get("swap_bytes"):
        sequence = sequence.with_swapped_bytes()
    if given.get("float_scale") is not None:
        sequence = sequence.with_float_scale(arguments.float_scale)
    if given.get("mask") is not None:
        sequence = sequence.masked(arguments.mask, arguments.mask_threshold)
    return sequence


def _add_unit_options(parser: argparse.ArgumentParser) -> None:
    """Add what files leave open about their numbers."""
    parser.add_argument(
        "--depth-scale", type=float, metavar="N", help="units per metre of integers, instead of the camera's own"
    )
    parser.add_argument(
        "--float-scale", type=float, metavar="N", help="units per metre of floats, 1000 for millimetres (1: metres)"
    )
    parser.add_argument("--swap-bytes", action="store_true", help="integers have their bytes in the other order")


def camera_of(arguments: argparse.Namespace) -> "Camera":
    """The camera of --camera: a preset by its name, or a file; with --depth-scale its unit."""
    from rgbd_planes.camera import presets
    from rgbd_planes.camera.camera import Camera

    known = [name for name, make in vars(presets).items() if getattr(make, "__module__", "") == presets.__name__]
    text = str(arguments.camera)
    scale = vars(arguments).get("depth_scale")
    if text in known and not arguments.camera.exists():
        camera: Camera = getattr(presets, text)()
    elif not arguments.camera.suffix and not arguments.camera.exists() and arguments.camera.name == text:
        raise CommandError(f"--camera {shown(text)}: no such file, and no preset; presets are {', '.join(known)}")
    else:
        camera = Camera.load(arguments.camera)
    return camera if scale is None else replace(camera, depth_scale=scale, disparity=None)


def after_units(arguments: argparse.Namespace, frame: "Frame") -> "NDArray[Any]":
    """A frame's depth with its bytes and its unit as the options say."""
    from rgbd_planes.sequences.frame_steps import FloatUnit, swapped_bytes

    if arguments.swap_bytes:
        frame = swapped_bytes(frame)
    if arguments.float_scale is not None:
        frame = FloatUnit(arguments.float_scale)(frame)
    return frame.depth


FIGURES = (".png", ".pdf", ".svg")


def write_figure(figure: Any, path: Path) -> None:
    """Write a Matplotlib figure, all of it or nothing."""
    from rgbd_planes._core.files import write_beside

    content = io.BytesIO()  # of a disk that is full Matplotlib makes errors of its own
    figure.savefig(content, dpi=120, format=path.suffix[1:].lower())
    with write_beside(path) as beside:
        beside.write_bytes(content.getbuffer())


def describe_tiles(tiles: "TilePlanes") -> str:
    """One line: how many tiles have which status, and how well the fitted ones fit."""
    import numpy as np

    from rgbd_planes import TileStatus
    from rgbd_planes._core.text import counted, percent

    height, width = tiles.tile
    counts = {status: np.count_nonzero(tiles.status == status) for status in TileStatus}
    found = ", ".join(f"{count} {status.name}" for status, count in counts.items() if count)
    line = f"{counted(tiles.status.size, 'tile')} of {height} x {width} pixels by {tiles.method}: {found}"
    if tiles.fitted.any():
        line += f"; median residual {1e3 * np.median(tiles.rmse_metric[tiles.fitted]):.1f} mm along the normal"
    else:
        measured = tiles.valid_count.sum() / (tiles.camera.width * tiles.camera.height)
        line += f"; {percent(measured)} of the pixels are measured"
    return line + "."
