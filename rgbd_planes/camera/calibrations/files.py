"""Calibration files of this library and of other tools, recognised by their contents, as arguments of `Camera`."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rgbd_planes._core.files import existing_file, json_of, naming, text_of
from rgbd_planes._core.text import shown
from rgbd_planes.camera.calibrations import formats, yaml_subset

_LARGEST = 2**28  # bytes; a camera with rays of ten megapixels has some 200 MB
_LONGEST_TEXT = 2**22  # characters of what is no JSON: words and elements take up to 100 bytes each
_ELSEWHERE = {  # what is no text, and the way on
    ".npz": "numpy.load reads it, and Camera.from_opencv(values['mtx'], values['dist'], (width, height)) takes that",
    ".npy": "numpy.load reads it, and Camera.from_opencv(matrix, distortion, (width, height)) takes a matrix",
    ".bin": "`colmap model_converter --output_type TXT` makes cameras.txt of it",
    ".mat": "scipy.io.loadmat reads it, and Camera.from_opencv(matrix, distortion, (width, height)) takes a matrix",
    ".pkl": "load it, and Camera.from_opencv(matrix, distortion, (width, height)) takes a matrix",
}
_COLMAP_LINE = re.compile(r"^\s*\d+\s+[A-Z_]+\s+\d+\s+\d+\s+[-+.\deE\s]+$")
_INFO_LINE = re.compile(r"^\s*m_\w+\s*=", re.MULTILINE)


def read_json(path: str | os.PathLike[str]) -> Mapping[str, Any]:
    """The object in a JSON file; ValueError where there is none."""
    if os.fspath(path).lower().endswith((".yaml", ".yml", ".xml", ".txt")):
        raise ValueError(f"expected a JSON file, got {shown(path)}: Camera.load reads other tools' files")
    return _json_object(path, _text(path))


def read_calibration(path: str | os.PathLike[str], name: str | None = None) -> dict[str, Any]:
    """Arguments of `Camera` from a calibration file.

    Parameters
    ----------
    path : path
    name : str, optional
        Which camera, where the file has several: a key such as "cam1", or COLMAP's number.

    Returns
    -------
    dict

    Raises
    ------
    OSError
        It cannot be read.
    TypeError, ValueError
        It is of no known format, or its camera is of no known kind, naming the file and the way on, where there is one.
    """
    text = _text(path)
    stripped = text.lstrip()
    if Path(path).suffix.lower() == ".json" or stripped.startswith("{"):
        values = _json_object(path, text)
        with naming(path):
            return formats.from_mapping(values, name)
    with naming(path):
        if len(text) > _LONGEST_TEXT:
            raise ValueError(f"expected a calibration, got a text of {len(text)} characters")
        return _of_text(text, stripped.startswith("<"), Path(path).suffix.lower(), name)


def _of_text(text: str, is_xml: bool, kind: str, name: str | None) -> dict[str, Any]:
    if is_xml:
        return formats.from_mapping(_opencv_xml(text), name)
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        raise ValueError("expected a calibration, got an empty file")
    if all(_COLMAP_LINE.match(line) for line in lines):
        return formats.from_colmap(lines, name)
    if _INFO_LINE.search(text):
        return formats.from_sensor_info(text)
    numbers = _numbers(text)
    if numbers is not None:
        return _of_numbers(numbers, kind)
    return formats.from_mapping(_yaml(text), name)


def matrix_of_text(text: str) -> np.ndarray[Any, np.dtype[np.float64]] | None:
    """The 3 x 3 camera matrix in a text of 9, 12 or 16 numbers, or of 4, fx fy cx cy; None where it is none."""
    numbers = _numbers(text)
    if numbers is None or len(numbers) not in (4, 9, 12, 16):
        return None
    if len(numbers) == 4:
        return np.array([[numbers[0], 0.0, numbers[2]], [0.0, numbers[1], numbers[3]], [0.0, 0.0, 1.0]])
    matrix = np.array(numbers).reshape({9: (3, 3), 12: (3, 4), 16: (4, 4)}[len(numbers)])[:3, :3]
    return np.asarray(matrix)


def _text(path: str | os.PathLike[str]) -> str:
    kind = existing_file(path).suffix.lower()
    if kind in _ELSEWHERE:
        raise ValueError(f"expected a calibration as text, got {shown(path)}: {_ELSEWHERE[kind]}")
    try:
        return text_of(path, most=_LARGEST)
    except UnicodeDecodeError:
        expected = "a JSON file" if kind == ".json" else "a calibration"
        raise ValueError(f"expected {expected}, got {shown(path)}, which is no text") from None


def _json_object(path: str | os.PathLike[str], text: str) -> Mapping[str, Any]:
    try:
        values = json_of(text)
    except ValueError as error:
        raise ValueError(f"expected a JSON file, got {shown(path)}: {error}") from None
    if not isinstance(values, dict):
        raise ValueError(f"expected a JSON object in {shown(path)}, got {type(values).__name__}")
    return values


def _yaml(text: str) -> Mapping[str, Any]:
    values = yaml_subset.parse(text)
    if not isinstance(values, Mapping):
        raise ValueError(f"expected a calibration, got YAML of a {type(values).__name__}; {formats.KNOWN}")
    return values


def _opencv_xml(text: str) -> Mapping[str, Any]:
    """The entries of an XML file as cv2.FileStorage writes it."""
    from xml.etree import ElementTree

    if "<!ENTITY" in text:
        raise ValueError("expected XML as cv2.FileStorage writes it, got entities")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ValueError(f"expected XML as cv2.FileStorage writes it: {error}") from None
    found: dict[str, Any] = {}
    for entry in root:
        data = entry.find("data")
        if data is not None:
            found[entry.tag] = {
                "rows": int(entry.findtext("rows") or 0),
                "cols": int(entry.findtext("cols") or 0),
                "data": [float(word) for word in (data.text or "").split()],
            }
        else:
            words = (entry.text or "").split()
            values = [yaml_subset.parse(word) for word in words]
            found[entry.tag] = values[0] if len(values) == 1 else values
    return found


def _numbers(text: str) -> list[float] | None:
    """The numbers of a text that has nothing else, in brackets, with commas, or not."""
    try:
        numbers = [float(word) for word in re.sub(r"[\[\],;]|#[^\n]*", " ", text).split()]
    except ValueError:
        return None
    return numbers if numbers and all(map(math.isfinite, numbers)) else None


def _of_numbers(numbers: list[float], kind: str) -> dict[str, Any]:
    if len(numbers) == 6 and all(value.is_integer() and value >= 1 for value in numbers[:2]):  # ARKitScenes' .pincam
        width, height, fx, fy, cx, cy = numbers
        made: dict[str, Any] = {"width": int(width), "height": int(height), "fx": fx, "fy": fy, "cx": cx, "cy": cy}
        return made | ({"depth_scale": 1000.0} if kind == ".pincam" else {})
    raise ValueError(
        f"expected a calibration, got {len(numbers)} numbers, which do not say the size of the images: "
        "Camera.from_opencv(numpy.loadtxt(path)[:3, :3], None, (width, height)) takes a matrix of 3 x 3 or 4 x 4"
    )
