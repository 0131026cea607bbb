"""Cameras in the words of other tools: Kalibr, ORB-SLAM, OpenCV, COLMAP, nerfstudio, Record3D, Polycam and others."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from rgbd_planes._core.checks import check_whole, number, numbers
from rgbd_planes.camera.calibrations import systems

Values = Mapping[str, Any]

KNOWN = (
    "known are files of Camera.save, cv2.FileStorage, ROS, Open3D, RealSense, Kalibr, ORB-SLAM, VINS, COLMAP "
    "(cameras.txt), nerfstudio (transforms.json), Record3D and Polycam"
)
_PINHOLE = ("width", "height", "fx", "fy", "cx", "cy")
# What other tools call the same; the first that is there counts.
_NAMES = {
    "width": ("width", "w", "W", "image_width", "imageWidth", "image_Width", "img_width", "Camera.width"),
    "height": ("height", "h", "H", "image_height", "imageHeight", "image_Height", "img_height", "Camera.height"),
    "fx": ("fx", "fl_x", "focal_x", "focal_length_x"),
    "fy": ("fy", "fl_y", "focal_y", "focal_length_y"),
    "cx": ("cx", "ppx", "principal_x", "center_x"),
    "cy": ("cy", "ppy", "principal_y", "center_y"),
    "depth_scale": ("depth_scale", "png_depth_scale", "depth_factor", "DepthMapFactor", "depth_map_factor"),
}
_MATRICES = (
    "camera_matrix", "cameraMatrix", "CameraMatrix", "Camera_Matrix", "camera_intrinsics", "intrinsic_matrix",
    "intrinsics", "intrinsic", "K", "k", "M", "M1", "mtx",
)  # fmt: skip
_LENSES = (
    "distortion_coefficients", "distortionCoefficients", "distCoeffs", "dist_coeffs", "dist_coeff", "DistCoeffs",
    "Distortion_Coefficients", "distortion", "D", "D1", "dist",
)  # fmt: skip
_FISHEYES = ("fisheye", "equidistant", "kannala_brandt", "opencv_fisheye")
_PARTS = ("camera", "Camera", "cam", "camera_params", "intrinsics", "depth")  # of files about more than a camera
_FISHEYES = ("fisheye", "equidistant", "kannala_brandt", "opencv_fisheye")
_PARTS = ("camera", "Camera", "cam", "camera_params", "intrinsics", "depth")  # of files about more than a camera
_SIZES = ("image_size", "imageSize", "ImageSize", "resolution", "size", "img_size")
_WAYS = {  # a key of other systems, and the method that takes their camera
    "intrinsic_matrix": "from_open3d", "K": "from_ros", "k": "from_ros", "ppx": "from_realsense",
    "camera_matrix": "from_opencv", "mtx": "from_opencv",
}  # fmt: skip
_NATIVE = frozenset(
    (
        *(*_PINHOLE, "distortion", "distortion_model", "depth_scale", "disparity", "depth_range", "invalid_values"),
        *("noise", "rays", "is_part"),
    )
)


def from_mapping(values: Values, name: str | None = None) -> dict[str, Any]:
    """Arguments of `Camera` from the content of a JSON, YAML or XML file.

    Raises
    ------
    TypeError, ValueError
        It is of no known format, or something in it is missing or invalid.
    """
    kalibr = [key for key, value in values.items() if isinstance(value, Mapping) and "camera_model" in value]
    if kalibr:
        return _from_kalibr(values[_one_of(kalibr, name)])
    if name is not None and isinstance(values.get(name), Mapping):
        return from_mapping(values[name])
    if name is not None:
        cameras = [key for key, value in values.items() if isinstance(value, Mapping)]
        raise ValueError(f"expected the name of a camera, one of {', '.join(cameras) or 'none'}, got {name!r}")
    for is_it, read in _FORMATS:
        if is_it(values):
            return read(values)
    inner = [key for key in _PARTS if _has_pinhole(values, key)]
    if inner:
        nested = {**values[inner[0]]}
        return _plain({**{key: values[key] for key in values if key not in inner}, **nested})
    return dict(values)  # whose keys `Camera.from_dict` knows, or names


def hint(values: Values) -> str:
    """The end of a message about unknown keys that says what reads them; empty if nothing is known to."""
    if "K" in values and "w" in values:
        return ": Camera.load reads Record3D's JSON"
    for key, way in _WAYS.items():
        if key in values:
            return f": Camera.{way} takes that, Camera.save writes it as here"
    if "fl_x" in values or "t_00" in values:
        return ": Camera.load reads such files"
    return ""


def _has_pinhole(values: Values, key: str) -> bool:
    return isinstance(values.get(key), Mapping) and _find(values[key], "fx") is not None


def _one_of(names: Sequence[str], name: str | None) -> str:
    if name is not None and name not in names:
        raise ValueError(f"expected the name of a camera, one of {', '.join(names)}, got {name!r}")
    if name is None and len(names) > 1:
        raise ValueError(
            f"expected one camera, got {', '.join(names)}: Camera.load(path, name={names[0]!r}) takes one of them"
        )
    return name or names[0]


def _find(values: Values, *keys: str) -> Any:
    """The value of the first name under which another tool has something; None if there is none."""
    for key in keys:
        for known in _NAMES.get(key, (key,)):
            if values.get(known) is not None:
                return values[known]
    return None


def _need(values: Values, key: str, of: str) -> Any:
    found = _find(values, key)
    if found is None:
        raise ValueError(f"expected {key} in a calibration of {of}, got none ({', '.join(map(str, values))})")
    return found


def _float(name: str, value: Any) -> float:
    return number(name, float(value) if isinstance(value, str) and _is_number(value) else value)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _pixels(name: str, value: Any) -> int:
    """A whole number of pixels, which some tools write as 640.0."""
    return check_whole(name, int(value) if isinstance(value, float) and value.is_integer() else value, 1)


def _size(values: Values, of: str) -> tuple[int, int]:
    pair = _find(values, *_SIZES)
    if isinstance(pair, Sequence) and not isinstance(pair, str) and len(pair) == 2:
        return _pixels("width", pair[0]), _pixels("height", pair[1])
    width, height = _find(values, "width"), _find(values, "height")
    if width is None or height is None:
        raise ValueError(
            f"expected the size of the images in a calibration of {of}, got none: read the matrix, and "
            "Camera.from_opencv(matrix, distortion, (width, height)) takes it with the size"
        )
    return _pixels("width", width), _pixels("height", height)


def _scale(values: Values) -> dict[str, float]:
    """The unit of depth, if there is one; 1 is that of floats in metres."""
    found = _find(values, "depth_scale")
    if found is None:
        found = values.get("RGBD.DepthMapFactor")
    scale = 0.0 if found is None else _float("depth_scale", found)
    return {"depth_scale": scale} if scale > 1.0 else {}


def _is_native(values: Values) -> bool:
    return all(key in values for key in _PINHOLE) and set(values) <= _NATIVE


def _plain(values: Values) -> dict[str, Any]:
    """fx, fy, cx, cy and a size under names that several tools share."""
    width, height = _size(values, "this kind")
    made: dict[str, Any] = {"width": width, "height": height}
    for key in ("fx", "fy", "cx", "cy"):
        made[key] = _float(key, _need(values, key, "this kind"))
    lens = _find(values, *_LENSES)
    if isinstance(lens, Sequence) and not isinstance(lens, str):
        made["distortion"] = numbers("distortion", lens)
    elif any(key in values for key in ("k1", "k2", "p1", "p2", "k3")):
        made["distortion"] = _named(values, "k1", "k2", "p1", "p2", "k3")
    return made | _scale(values)


def _named(values: Values, *names: str) -> tuple[float, ...]:
    return tuple(_float(name, values.get(name) or 0.0) for name in names)


def _from_kalibr(values: Values) -> dict[str, Any]:
    """A camera of Kalibr's camchain."""
    model = values.get("camera_model")
    if model != "pinhole":
        raise ValueError(f"expected a camera of Kalibr with the camera_model pinhole, got {model!r}")
    fx, fy, cx, cy = _exactly(values, "intrinsics", 4)
    width, height = _exactly(values, "resolution", 2)
    lens = values.get("distortion_model", "none")
    coefficients = numbers("distortion_coeffs", values.get("distortion_coeffs") or ())
    made = {"width": int(width), "height": int(height), "fx": fx, "fy": fy, "cx": cx, "cy": cy}
    if lens in ("radtan", "none", "plumb_bob"):
        return {**made, "distortion": coefficients if lens != "none" else ()}
    if lens == "equidistant":
        return {**made, "distortion": coefficients, "distortion_model": "fisheye"}
    raise ValueError(f"expected a distortion_model of Kalibr of radtan, equidistant or none, got {lens!r}")


def _exactly(values: Values, key: str, count: int) -> tuple[float, ...]:
    found = numbers(key, values.get(key) or ())
    if len(found) != count:
        raise ValueError(f"expected {count} numbers in {key}, got {list(found)}")
    return found


def _orb_prefix(values: Values) -> str:
    return next((prefix for prefix in ("Camera.", "Camera1.") if f"{prefix}fx" in values), "")


def _from_orb_slam(values: Values) -> dict[str, Any]:
    """A YAML file of ORB-SLAM2 or 3, whose keys have points in them."""
    prefix = _orb_prefix(values)
    inner = {key.removeprefix(prefix): value for key, value in values.items() if key.startswith(prefix)}
    size = {key: inner.get(key, values.get(f"Camera.{key}")) for key in ("width", "height")}
    model = str(values.get("Camera.type", "PinHole"))
    made: dict[str, Any] = dict(zip(("width", "height"), _size(size, "ORB-SLAM"), strict=True))
    made |= {key: _float(key, _need(inner, key, "ORB-SLAM")) for key in ("fx", "fy", "cx", "cy")}
    if model == "KannalaBrandt8":
        made |= {"distortion": _named(inner, "k1", "k2", "k3", "k4"), "distortion_model": "fisheye"}
    elif model.lower() in ("pinhole", ""):
        made["distortion"] = _named(inner, "k1", "k2", "p1", "p2", "k3")
    elif model != "Rectified":
        raise ValueError(f"expected a Camera.type of PinHole, KannalaBrandt8 or Rectified, got {model!r}")
    return made | _scale(values)


def _from_vins(values: Values) -> dict[str, Any]:
    """A YAML file of camodocal, which VINS-Mono and VINS-Fusion use."""
    model = values.get("model_type")
    width, height = _size(values, "VINS")
    lens = values.get("distortion_parameters") or {}
    pinhole = values.get("projection_parameters") or {}
    if model == "PINHOLE":
        made = {key: _float(key, _need(pinhole, key, "VINS")) for key in ("fx", "fy", "cx", "cy")}
        return {"width": width, "height": height, **made, "distortion": _named(lens, "k1", "k2", "p1", "p2")}
    if model == "KANNALA_BRANDT":
        keys = {"fx": "mu", "fy": "mv", "cx": "u0", "cy": "v0"}
        made = {key: _float(key, _need(pinhole, other, "VINS")) for key, other in keys.items()}
        coefficients = _named(pinhole, "k2", "k3", "k4", "k5")
        lens_model = {"distortion": coefficients, "distortion_model": "fisheye"}
        return {"width": width, "height": height, **made, **lens_model}
    raise ValueError(f"expected a model_type of PINHOLE or KANNALA_BRANDT, got {model!r}")


def _is_nerfstudio(values: Values) -> bool:
    return "fl_x" in values or "camera_angle_x" in values or _frames_with(values, "fl_x") is not None


def _frames_with(values: Values, key: str) -> list[Values] | None:
    frames = values.get("frames")
    if not isinstance(frames, Sequence) or not frames or not all(isinstance(frame, Mapping) for frame in frames):
        return None
    return list(frames) if all(key in frame for frame in frames) else None


def _from_nerfstudio(values: Values) -> dict[str, Any]:
    """A transforms.json of nerfstudio or instant-ngp, in which the first pixel's centre is at 0.5."""
    frames = _frames_with(values, "fl_x")
    keys = ("w", "h", "fl_x", "fl_y", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2", "camera_model")
    if "fl_x" not in values and frames is not None:
        cameras = [{key: {**values, **frame}.get(key) for key in keys} for frame in frames]
        if any(camera != cameras[0] for camera in cameras):
            raise ValueError(
                f"expected one camera for all frames, got {len(cameras)} frames with cameras of their own: read the "
                "JSON, and make a Camera of each frame's fl_x, fl_y, cx - 0.5 and cy - 0.5"
            )
        values = {**values, **cameras[0]}
    width, height = _size(values, "nerfstudio")
    if "fl_x" in values:
        fx = _float("fl_x", values["fl_x"])
    else:
        fx = 0.5 * width / math.tan(0.5 * _float("camera_angle_x", values["camera_angle_x"]))
    fy = fx if values.get("fl_y") is None else _float("fl_y", values["fl_y"])
    cx = 0.5 * width if values.get("cx") is None else _float("cx", values["cx"])
    cy = 0.5 * height if values.get("cy") is None else _float("cy", values["cy"])
    made = {"width": width, "height": height, "fx": fx, "fy": fy, "cx": cx - 0.5, "cy": cy - 0.5}
    model = str(values.get("camera_model") or "OPENCV")
    if model == "OPENCV_FISHEYE" or values.get("is_fisheye"):
        return {**made, "distortion": _named(values, "k1", "k2", "k3", "k4"), "distortion_model": "fisheye"}
    if model not in ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"):
        raise ValueError(f"expected a camera_model of OPENCV, PINHOLE or OPENCV_FISHEYE, got {model!r}")
    return {**made, "distortion": _named(values, "k1", "k2", "p1", "p2", "k3")}


def _from_record3d(values: Values) -> dict[str, Any]:
    """The metadata of Record3D: K column by column for w x h, and dw x dh of the depth, in metres."""
    width, height = _size(values, "Record3D")
    flat = _exactly(values, "K", 9)
    matrix = np.reshape(flat, (3, 3)).T
    if matrix[2, :2].any():  # row by row
        matrix = matrix.T
    x = _pixels("dw", values.get("dw") or width) / width
    y = _pixels("dh", values.get("dh") or height) / height
    return {
        "width": round(x * width),
        "height": round(y * height),
        "fx": float(x * matrix[0, 0]),
        "fy": float(y * matrix[1, 1]),
        "cx": float(x * (matrix[0, 2] + 0.5) - 0.5),
        "cy": float(y * (matrix[1, 2] + 0.5) - 0.5),
    }


def _from_polycam(values: Values) -> dict[str, Any]:
    """A camera of Polycam's raw data: the pinhole of one photograph; its depth is in millimetres."""
    return {**_plain({key: values[key] for key in _PINHOLE}), "depth_scale": 1000.0}


def _matrix_of(values: Values) -> Any:
    """The camera matrix of a mapping, nested, flat or as cv2.FileStorage writes it; None if there is none."""
    for key in _MATRICES:
        found = values.get(key)
        if isinstance(found, Mapping) and "data" in found:
            found = found["data"]
        if isinstance(found, Sequence) and not isinstance(found, str) and np.size(found) in (9, 16):
            side = round(np.size(found) ** 0.5)
            return np.asarray(found, np.float64).reshape(side, side)[:3, :3]
    return None


def _from_matrix(values: Values) -> dict[str, Any]:
    """A file of cv2.FileStorage, or another with a camera matrix, row by row, and the size of the images."""
    lens = _find(values, *_LENSES)
    if isinstance(lens, Mapping):
        lens = lens.get("data")
    model = str(values.get("distortion_model") or values.get("camera_model") or values.get("model") or "")
    fisheye = model.lower() in _FISHEYES or values.get("fisheye_model") == 1
    made = systems.from_opencv(
        _matrix_of(values),
        np.ravel(np.asarray(lens if lens is not None else [], np.float64)),
        _size(values, "OpenCV"),
        "fisheye" if fisheye else "brown_conrady",
        0.0,
    )
    return made | _scale(values)


_FORMATS: tuple[tuple[Callable[[Values], bool], Callable[[Values], dict[str, Any]]], ...] = (
    (_is_native, dict),
    (lambda v: bool(_orb_prefix(v)), _from_orb_slam),
    (lambda v: "model_type" in v and "projection_parameters" in v, _from_vins),
    (_is_nerfstudio, _from_nerfstudio),
    (lambda v: "ppx" in v and "model" in v, lambda v: systems.from_realsense(v, None)),
    (lambda v: "K" in v and "w" in v and "h" in v, _from_record3d),
    (lambda v: "t_00" in v and "fx" in v, _from_polycam),
    (lambda v: "intrinsic" in v and "extrinsic" in v, systems.from_open3d),
    (lambda v: "intrinsic_matrix" in v and np.size(v["intrinsic_matrix"]) == 9 and np.ndim(v["intrinsic_matrix"]) == 1,
     systems.from_open3d),
    (lambda v: "image_width" in v and "distortion_model" in v and "camera_matrix" in v, lambda v: _from_ros(v)),
    (lambda v: ("K" in v or "k" in v) and ("D" in v or "d" in v) and "width" in v, lambda v: _from_ros(v)),
    (lambda v: _matrix_of(v) is not None, _from_matrix),
    (lambda v: _find(v, "fx") is not None and not set(v) <= _NATIVE and _is_tool(v), _plain),
)  # fmt: skip


def _is_tool(values: Values) -> bool:
    """Whether all of the pinhole is there under names that some tool has, and not this library's with a wrong key."""
    return all(_find(values, key) is not None for key in _PINHOLE) and not all(key in values for key in _PINHOLE)


def _from_ros(values: Values) -> dict[str, Any]:
    whole, part = systems.from_ros(values, None)
    is_part = any(part[key] != whole[key] for key in ("width", "height", "cx", "cy"))
    return {**whole, **part, **({"is_part": True} if is_part else {})}


_COLMAP: dict[str, tuple[str, ...]] = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "OPENCV_FISHEYE": ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
    "SIMPLE_RADIAL_FISHEYE": ("f", "cx", "cy", "k1"),
    "RADIAL_FISHEYE": ("f", "cx", "cy", "k1", "k2"),
}


def from_colmap(lines: Sequence[str], name: str | None = None) -> dict[str, Any]:
    """Arguments of `Camera` from the lines of COLMAP's cameras.txt, in which the first pixel's centre is at 0.5."""
    cameras = {words[0]: words for words in (line.split() for line in lines)}
    _, model, width, height, *parameters = cameras[_one_of(list(cameras), name)]
    if model not in _COLMAP:
        raise ValueError(f"expected a model of COLMAP of {', '.join(_COLMAP)}, got {model}")
    if len(parameters) != len(_COLMAP[model]):
        raise ValueError(f"expected {len(_COLMAP[model])} parameters of {model}, got {len(parameters)}")
    values = dict(zip(_COLMAP[model], map(float, parameters), strict=True))
    focal = values.get("f", 0.0)
    made: dict[str, Any] = {
        "width": int(width),
        "height": int(height),
        "fx": values.get("fx", focal),
        "fy": values.get("fy", focal),
        "cx": values["cx"] - 0.5,
        "cy": values["cy"] - 0.5,
    }
    if model.endswith("FISHEYE"):
        made |= {"distortion": _named(values, "k1", "k2", "k3", "k4"), "distortion_model": "fisheye"}
    elif model == "FULL_OPENCV":
        made["distortion"] = _named(values, "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    elif "k1" in values:
        made["distortion"] = _named(values, "k1", "k2", "p1", "p2", "k3")
    return made


def from_sensor_info(text: str) -> dict[str, Any]:
    """Arguments of `Camera` from the info.txt of BundleFusion, or the _info.txt of ScanNet."""
    pairs = (line.partition("=") for line in text.splitlines())
    values = {name.strip(): value.split() for name, _, value in pairs}
    try:
        matrix = np.array(values["m_calibrationDepthIntrinsic"], np.float64).reshape(4, 4)
        width, height = int(values["m_depthWidth"][0]), int(values["m_depthHeight"][0])
        scale = float(values["m_depthShift"][0])
    except (KeyError, IndexError, ValueError) as error:
        raise ValueError(
            "expected m_depthWidth, m_depthHeight, m_depthShift and m_calibrationDepthIntrinsic (16 numbers), "
            f"failed at {error}"
        ) from None
    made = systems.from_opencv(matrix[:3, :3], None, (width, height), "brown_conrady", 0.0)
    return made | {"depth_scale": scale}
