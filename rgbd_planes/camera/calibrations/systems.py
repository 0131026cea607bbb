"""The objects and mappings of OpenCV, ROS, Open3D and RealSense, turned into the arguments of `Camera`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.checks import check_choice, check_whole, number, plain_array, real_array

_REALSENSE_MODELS = (  # in the order of librealsense's enum rs2_distortion
    "none",
    "modified_brown_conrady",
    "inverse_brown_conrady",
    "ftheta",
    "brown_conrady",
    "kannala_brandt4",
)
_ROS_COEFFICIENTS = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12, 14), "equidistant": (4,), "fisheye": (4,)}
_ROS_FISHEYES = ("equidistant", "fisheye")
_REALSENSE_COEFFICIENTS = {  # `Camera`'s name for the model, and how many of the five numbers it uses
    "brown_conrady": ("brown_conrady", 5),
    "inverse_brown_conrady": ("inverse_brown_conrady", 5),
    "kannala_brandt4": ("fisheye", 4),
}
_ROS_FILE = {  # a ROS calibration file's names for the matrices of the message
    "camera_matrix": "K",
    "distortion_coefficients": "D",
    "projection_matrix": "P",
}


def from_opencv(
    camera_matrix: ArrayLike, distortion: ArrayLike | None, size: tuple[int, int], model: str, pixel_center: float
) -> dict[str, Any]:
    """Arguments of `Camera`; see `Camera.from_opencv`."""
    check_choice("distortion_model", model, ("brown_conrady", "fisheye"))
    matrix = _matrix("camera_matrix", camera_matrix)
    if plain_array("size", size).shape != (2,):
        raise ValueError(f"expected size as (width, height), got {size!r}")
    pixel_center = number("pixel_center", pixel_center)
    coefficients = [] if distortion is None else real_array("distortion", distortion).ravel().tolist()
    return {
        "width": size[0],
        "height": size[1],
        **_pinhole(matrix),
        "cx": matrix[0, 2] - pixel_center,
        "cy": matrix[1, 2] - pixel_center,
        "distortion": coefficients if model == "fisheye" else _without_thin_prism(coefficients),
        "distortion_model": model,
    }


def from_ros(info: Any, rectified: bool | None) -> tuple[dict[str, Any], dict[str, Any]]:
    """Arguments of `Camera` for the whole image, and those of the part that is sent; see `Camera.from_ros`."""
    if info is None:  # as before the first message
        raise TypeError("expected a CameraInfo, got None")
    if isinstance(info, Mapping) and "image_width" in info:
        info = _camera_info(info)
    width, height = _whole(info, "width"), _whole(info, "height")
    if rectified is None:  # the matrix that is there: some drivers fill only one
        rectified = not _is_filled(info, "K") and _is_filled(info, "P")
    name, columns = ("P", 4) if rectified else ("K", 3)
    matrix = _real_array_of_yaml(name, _get(info, name, name.lower()))
    if matrix.size != 3 * columns:
        raise ValueError(f"expected {3 * columns} numbers in {name}, got {matrix.size}")
    if not matrix.any():
        other = "K" if rectified else "P"
        hint = f"; its {other} is there: rectified={not rectified} takes that" if _is_filled(info, other) else ""
        raise ValueError(f"expected a camera that is calibrated: ROS writes {name} = 0 for one that is not{hint}")
    pinhole = _pinhole(_matrix(name, matrix.reshape(3, columns)[:, :3]))

    whole = {"width": width, "height": height, **pinhole, **({} if rectified else _ros_distortion(info))}
    x_offset = y_offset = 0
    roi = _get(info, "roi", default=None)
    if roi is not None:
        x_offset, width = _region(roi, "x_offset", "width", width)
        y_offset, height = _region(roi, "y_offset", "height", height)
    binning_x = _whole(info, "binning_x", default=0) or 1
    binning_y = _whole(info, "binning_y", default=0) or 1
    part = {
        "width": width // binning_x,
        "height": height // binning_y,
        "fx": pinhole["fx"] / binning_x,
        "fy": pinhole["fy"] / binning_y,
        "cx": (pinhole["cx"] - x_offset) / binning_x,
        "cy": (pinhole["cy"] - y_offset) / binning_y,
    }
    return whole, part


def _is_filled(info: Any, name: str) -> bool:
    """Whether a message has a matrix, and not zeros for a camera that is not calibrated."""
    values = _get(info, name, name.lower(), default=())
    return bool(_real_array_of_yaml(name, values).any())


def _region(roi: Any, first: str, size: str, whole: int) -> tuple[int, int]:
    """Where a region of interest begins in an image of ``whole`` pixels, and how many it has: 0 means all of them."""
    offset, pixels = _whole(roi, first, default=0), _whole(roi, size, default=0) or whole
    if offset + pixels > whole:
        raise ValueError(
            f"expected a roi inside the image, of {size} {whole}, got {first} {offset} and {size} {pixels}"
        )
    return offset, pixels


def _camera_info(file: Mapping[str, Any]) -> dict[str, Any]:
    """The message that a calibration file, as camera_calibration writes it, corresponds to."""
    info = {
        "width": file["image_width"],
        "height": _get(file, "image_height"),
        "distortion_model": _get(file, "distortion_model", default=""),
    }
    return info | {name: _get(file[key], "data") for key, name in _ROS_FILE.items() if key in file}


def _ros_distortion(info: Any) -> dict[str, Any]:
    coefficients = _real_array_of_yaml("D, empty without distortion,", _get(info, "D", "d")).ravel().tolist()
    model = str(_get(info, "distortion_model", default="")) or "plumb_bob"
    # A fisheye bends rays even where all its coefficients are zero.
    if model in _ROS_FISHEYES and len(coefficients) == 0:
        coefficients = [0.0] * 4
    if not any(coefficients) and model not in _ROS_FISHEYES:
        return {}
    check_choice("distortion_model", model, tuple(_ROS_COEFFICIENTS))
    if len(coefficients) not in _ROS_COEFFICIENTS[model]:
        raise ValueError(
            f"expected {' or '.join(map(str, _ROS_COEFFICIENTS[model]))} coefficients in D for {model}, "
            f"got {len(coefficients)}"
        )
    if model in _ROS_FISHEYES:
        return {"distortion": coefficients, "distortion_model": "fisheye"}
    return {"distortion": _without_thin_prism(coefficients)}


def from_open3d(values: Any) -> dict[str, Any]:
    """Arguments of `Camera`; see `Camera.from_open3d`."""
    intrinsic = _get(values, "intrinsic", default=values)
    numbers = real_array("intrinsic_matrix", _get(intrinsic, "intrinsic_matrix"))
    if not isinstance(intrinsic, Mapping):  # Open3D's own object has a matrix
        matrix = _matrix("intrinsic_matrix", numbers)
    elif numbers.shape == (9,):
        matrix = _matrix("intrinsic_matrix, column-major,", numbers.reshape(3, 3).T)
    else:
        raise ValueError(f"expected intrinsic_matrix as nine numbers, column-major, got shape {numbers.shape}")
    return {"width": _get(intrinsic, "width"), "height": _get(intrinsic, "height"), **_pinhole(matrix)}


def from_realsense(intrinsics: Any, depth_units: float | None) -> dict[str, Any]:
    """Arguments of `Camera`; see `Camera.from_realsense`."""
    coefficients = real_array("coeffs", _get(intrinsics, "coeffs")).ravel().tolist()
    made: dict[str, Any] = {
        "width": _get(intrinsics, "width"),
        "height": _get(intrinsics, "height"),
        "fx": _get(intrinsics, "fx"),
        "fy": _get(intrinsics, "fy"),
        "cx": _get(intrinsics, "ppx"),
        "cy": _get(intrinsics, "ppy"),
    }
    model = _realsense_model(_get(intrinsics, "model"))
    if model == "kannala_brandt4" or (any(coefficients) and model != "none"):
        if model not in _REALSENSE_COEFFICIENTS:
            raise ValueError(
                f"expected a RealSense model of none, {', '.join(_REALSENSE_COEFFICIENTS)}, got {model} "
                f"with coefficients {coefficients}"
            )
        name, count = _REALSENSE_COEFFICIENTS[model]
        made |= {"distortion": coefficients[:count], "distortion_model": name}
    if depth_units is not None:
        made["depth_scale"] = depth_scale_of(depth_units)
    return made


def depth_scale_of(depth_units: float) -> float:
    """Raw units per metre, from metres per raw unit."""
    units = number("depth_units", depth_units)
    if not units > 0:
        raise ValueError(f"expected depth_units > 0 (metres per raw unit), got {depth_units!r}")
    if units > 1:
        raise ValueError(
            "expected depth_units in metres per raw unit, 0.001 for millimetres, "
            f"got {depth_units!r}: that is depth_scale"
        )
    # The device states its unit in float32; 0.001 must not come out as 999.99995 units per metre.
    if float(np.float32(units)) == units:
        units = float(str(np.float32(units)))
    return 1.0 / units


def _realsense_model(model: Any) -> str:
    """The model's name, from librealsense's enum, its number, or one of the ways in which tools print it."""
    if isinstance(model, (int, np.integer)) and not isinstance(model, bool) and 0 <= model < len(_REALSENSE_MODELS):
        return _REALSENSE_MODELS[model]
    name = str(getattr(model, "name", model)).lower().split(".")[-1].replace(" ", "_").replace("-", "_")
    name = name.removeprefix("rs2_distortion_")
    if model is None or name not in _REALSENSE_MODELS:  # JSON's null is not the model called none
        raise ValueError(f"expected a RealSense model, one of {', '.join(_REALSENSE_MODELS)}, got {model!r}")
    return name


def _get(source: Any, *names: str, **default: Any) -> Any:
    """The first of the names that a mapping or an object has."""
    for name in names:
        if isinstance(source, Mapping):
            if name in source:
                return source[name]
        elif hasattr(source, name):
            return getattr(source, name)
    if "default" in default:
        return default["default"]
    if isinstance(source, str | os.PathLike):
        raise TypeError(
            f"expected a mapping, or an object, got the path {os.fspath(source)!r}: read it first, or Camera.load "
            "reads files"
        )
    raise ValueError(f"expected {' or '.join(names)} in the {type(source).__name__}, got none")


def _whole(source: Any, name: str, **default: int) -> int:
    """A whole number, not negative, that a mapping or an object has."""
    return check_whole(name, _get(source, name, **default), 0)


def _real_array_of_yaml(name: str, values: Any) -> Floats:
    """`real_array`; PyYAML, which follows YAML 1.1, reads the number 1e-05 as text."""
    if isinstance(values, list):
        try:
            values = [float(value) if isinstance(value, str) else value for value in values]
        except ValueError as error:
            raise TypeError(f"expected {name} as numbers: {error}") from None
    return real_array(name, values)


def _matrix(name: str, values: Any) -> Floats:
    """A camera matrix without skew."""
    matrix = real_array(name, values)
    if matrix.shape != (3, 3):
        raise ValueError(f"expected {name} of shape (3, 3), got {matrix.shape}")
    empty = matrix.copy()
    empty[[0, 1, 0, 1], [0, 1, 2, 2]] = 0
    if matrix[0, 0] == 0 or matrix[1, 1] == 0 or not np.array_equal(empty, np.diag([0.0, 0.0, 1.0])):
        raise ValueError(
            f"expected {name} as [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], fx and fy not 0, got {matrix.tolist()}"
        )
    return matrix


def _pinhole(matrix: Floats) -> dict[str, float]:
    return {"fx": matrix[0, 0], "fy": matrix[1, 1], "cx": matrix[0, 2], "cy": matrix[1, 2]}


def _without_thin_prism(coefficients: list[float]) -> list[float]:
    """The coefficients as far as k6; the ones after it, of thin prisms and a tilted sensor, must be zero."""
    if any(coefficients[8:]):
        raise ValueError(
            f"expected at most 8 distortion coefficients, k1 k2 p1 p2 k3 k4 k5 k6, got {len(coefficients)}: "
            f"{coefficients}"
        )
    return coefficients[:8]
