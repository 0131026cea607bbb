"""The calibration that stands beside the frames of a folder, in a file of any tool, or as a matrix."""

import re
from collections.abc import Sequence
from pathlib import Path

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.files import naming, text_of
from rgbd_planes.camera.calibrations.files import matrix_of_text
from rgbd_planes.camera.camera import Camera
from rgbd_planes.sequences.images import read_depth

# Names of calibration files that many tools write beside their frames; a file that only may be one is tried.
_SURELY = re.compile(r"^(?!.*(pose|traj|extrin|imu|color|colour|rgb))(.*(intrin|calib|cam_?chain|camera_?info).*|"
                     r"cameras?|transforms|K)\.(json|ya?ml|txt|xml)$", re.IGNORECASE)  # fmt: skip
_PERHAPS = re.compile(r"^(_?info\.txt|metadata(\.json)?)$", re.IGNORECASE)
_OFF_CENTRE = 0.12  # of the image's side, as for warnings of a camera
_TRIED = 10  # images, until one can be read


def calibration_files(root: Path) -> list[Path]:
    """Files in a folder that are, or may be, the calibration of its frames; those of depth, if some say so."""
    files = [root / "intrinsic" / "intrinsic_depth.txt", *sorted(root.iterdir())]
    files = [file for file in files if file.is_file() and (_SURELY.match(file.name) or _PERHAPS.match(file.name))]
    return [file for file in files if "depth" in file.name.lower()] or files


def calibration_beside(root: Path, images: list[Path], like: Camera) -> Camera | None:
    """The camera of a calibration in a folder, or in the one above a ``seq-NN``; None if there is none.

    Parameters
    ----------
    root : folder
    images : list of path
        Whose size is that of the camera, where a file has the matrix alone.
    like : Camera
        What its unit and its missing values are, where the file does not say.

    Raises
    ------
    ValueError
        A file cannot be read, or several differ, or are of another image size.
    """
    places = [root, root.parent] if root.name.lower().startswith("seq") else [root]
    for place in places:
        found: dict[Camera, Path] = {}
        for file in calibration_files(place):
            try:
                found.setdefault(_camera_of_file(file, images, like), file)
            except (OSError, TypeError, ValueError):
                if _SURELY.match(file.name):
                    raise
        if len(found) > 1:
            names = ", ".join(file.name for file in found.values())
            raise ValueError(f"{place}: expected one calibration, got {names}, which differ: give the camera")
        if found:
            return next(iter(found))
    return None


def found_calibration(root: Path, images: list[Path]) -> Camera:
    like = Camera(8, 6, 8.0, 8.0, 3.5, 2.5)  # which states no unit
    camera = calibration_beside(root, images, like)
    if camera is None:
        raise ValueError(f"{root}: expected a camera, or its file camera.json in the folder (Camera.save writes one)")
    return camera


def _camera_of_file(file: Path, images: list[Path], like: Camera) -> Camera:
    scale, invalid = like.depth_scale, like.invalid_values
    matrix = matrix_of_text(text_of(file, errors="replace"))
    if matrix is None:
        camera = Camera.load(file)
        if camera.depth_scale is None and camera.disparity is None:
            return Camera.load(file, depth_scale=scale, invalid_values=invalid)
        return Camera.load(file, invalid_values=camera.invalid_values or invalid)
    return camera_of_matrix(matrix, file, images, depth_scale=scale, invalid_values=invalid)


def camera_of_matrix(
    matrix: Floats,
    file: Path,
    images: list[Path],
    size: tuple[int, int] | None = None,
    *,
    depth_scale: float | None = None,
    invalid_values: Sequence[float] = (),
) -> Camera:
    """The camera of images, of a file with its matrix alone, which is that of images of ``size``, if this is known.

    Raises
    ------
    ValueError
        The matrix is that of images of another size, or no image can be read, or it is no matrix of a camera.
    """
    width, height = _size_of_first(images)
    with naming(file):
        for whole in ((width, height), size):
            if whole is not None and all(
                abs(centre - 0.5 * (pixels - 1)) <= max(_OFF_CENTRE * pixels, 2.0)
                for centre, pixels in zip(matrix[:2, 2], whole, strict=True)
            ):
                camera = Camera.from_opencv(matrix, None, whole, depth_scale=depth_scale, invalid_values=invalid_values)
                if whole == (width, height):
                    return camera
                if width * whole[1] != height * whole[0]:
                    break
                return camera.resized(width, height)
        if min(width, height) < 2.0 * _TRIED:  # made up, or a part: then any point may be the principal one
            size = width, height
            return Camera.from_opencv(matrix, None, size, depth_scale=depth_scale, invalid_values=invalid_values)
        expected = 2.0 * matrix[0, 2] + 1.0, 2.0 * matrix[1, 2] + 1.0
        raise ValueError(
            f"expected the matrix of images of {width} x {height}, got one with its principal point at "
            f"({matrix[0, 2]:g}, {matrix[1, 2]:g}), the middle of {expected[0]:.0f} x {expected[1]:.0f}: give the "
            f"camera: Camera.from_opencv(matrix, None, (width, height)).resized({width}, {height}) with the size that "
            "the matrix is of, and cropped(...) before it if the images are a part"
        )


def _size_of_first(images: list[Path]) -> tuple[int, int]:
    """(width, height) of the first image that can be read."""
    wrong: list[Exception] = []
    for image in images[:_TRIED]:
        try:
            height, width = read_depth(image).shape
            return width, height
        except (OSError, ValueError) as error:
            wrong.append(error)
    raise ValueError(f"{wrong[0]}; the first image that can be read gives the size of the frames")
