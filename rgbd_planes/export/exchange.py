"""Formats that most tools open: PCD and CSV, normals as PNG or TIFF, and messages that JSON can hold."""

from __future__ import annotations

import base64
import csv
import math
import os
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rgbd_planes._core.checks import real_array
from rgbd_planes._core.files import write_beside


def json_ready(message: Any) -> Any:
    """A dictionary of ROS, or anything made of such, as `json.dumps` takes it, and rosbridge sends it.

    Parameters
    ----------
    message : dict
        A ROS message as nested dicts and lists, from any ``to_ros_`` function.

    Returns
    -------
    dict
        Bytes as base64, as rosbridge has uint8[]; arrays as lists; NaN and infinite numbers as None.
    """
    if isinstance(message, Mapping):
        return {str(key): json_ready(value) for key, value in message.items()}
    if isinstance(message, (bytes, bytearray, memoryview)):
        return base64.b64encode(bytes(message)).decode("ascii")
    if isinstance(message, np.ndarray):
        return json_ready(message.tolist())
    if isinstance(message, np.generic):
        return json_ready(message.item())
    if isinstance(message, Sequence) and not isinstance(message, str):
        return [json_ready(value) for value in message]
    return None if isinstance(message, float) and not math.isfinite(message) else message


def write_pcd(path: str | os.PathLike[str], points: ArrayLike, *, normals: ArrayLike | None = None) -> None:
    """Write points as a binary PCD file, as PCL, Open3D and CloudCompare read it; whole or not at all.

    Parameters
    ----------
    path : path
    points : (H, W, 3) or (N, 3) array_like
        Metres. Those of an image, (H, W, 3), stay organised, with NaN where nothing is; of others those that are not
        finite are left out.
    normals : array_like of the same shape, optional

    Raises
    ------
    TypeError, ValueError
        Arrays that are masked, no numbers or of other shapes, or a path with the suffix of another format.
    """
    xyz = real_array("points", points)
    if xyz.ndim not in (2, 3) or xyz.shape[-1] != 3:
        raise ValueError(f"expected points of shape (H, W, 3) or (N, 3), got {xyz.shape}")
    columns, names = [xyz], ["x", "y", "z"]
    if normals is not None:
        n = real_array("normals", normals)
        if n.shape != xyz.shape:
            raise ValueError(f"expected normals of the shape of points, {xyz.shape}, got {n.shape}")
        columns, names = [*columns, n], [*names, "normal_x", "normal_y", "normal_z"]
    with np.errstate(over="ignore"):
        values = np.concatenate(columns, axis=-1).astype("<f4")
    height, width = xyz.shape[:2] if xyz.ndim == 3 else (1, 0)
    rows = values.reshape(-1, len(names))
    if xyz.ndim == 2:
        rows = rows[np.isfinite(rows[:, :3]).all(axis=1)]
        width = len(rows)
    ones = " ".join(["1"] * len(names))
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        f"FIELDS {' '.join(names)}",
        f"SIZE {' '.join(['4'] * len(names))}",
        f"TYPE {' '.join(['F'] * len(names))}",
        f"COUNT {ones}",
        f"WIDTH {width}",
        f"HEIGHT {height}",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(rows)}",
        "DATA binary\n",
    ]
    with write_beside(path, ".pcd") as beside:
        beside.write_bytes("\n".join(header).encode("ascii") + rows.tobytes())


def write_csv(path: str | os.PathLike[str], table: Mapping[str, ArrayLike]) -> None:
    """Write a table, as ``to_table`` of results returns it, as CSV, one line a row; whole or not at all.

    Parameters
    ----------
    path : path
    table : mapping of str to (N,) array_like
        Numbers are written with all their digits, NaN as an empty field.

    Raises
    ------
    ValueError
        The columns are not of one length, or the path has the suffix of another format.
    """
    columns = {name: np.asarray(values).tolist() for name, values in table.items()}
    lengths = {len(values) for values in columns.values()}
    if len(lengths) > 1:
        raise ValueError(f"expected columns of one length, got {', '.join(map(str, sorted(lengths)))}")
    with write_beside(path, ".csv") as beside, beside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            writer.writerow(["" if isinstance(value, float) and math.isnan(value) else value for value in row])


def write_normals(path: str | os.PathLike[str], normals: ArrayLike) -> None:
    """Write normals as an image: PNG of 8 bits, TIFF of float32, or NPY; whole or not at all.

    Parameters
    ----------
    path : path
        Ends in .png, .tif, .tiff or .npy.
    normals : (H, W, 3) array_like
        In PNG -1..1 becomes 0..255, and none becomes black, as most networks and data sets have it. In TIFF there are
        three channels of float32, NaN where there is none.

    Raises
    ------
    TypeError, ValueError
        The normals are no such array, or the path has another suffix.
    """
    array = real_array("normals", normals)
    if array.ndim != 3 or array.shape[2] != 3 or not array.size:
        raise ValueError(f"expected normals of shape (H, W, 3), got {array.shape}")
    kind = Path(path).suffix.lower()
    if kind not in (".png", ".tif", ".tiff", ".npy"):
        raise ValueError(f"{os.fspath(path)}: expected a path that ends in .png, .tif, .tiff or .npy")
    single = np.ascontiguousarray(array, "<f4")
    with write_beside(path) as beside:
        if kind == ".npy":
            with beside.open("wb") as file:
                np.save(file, single)
        elif kind == ".png":
            from PIL import Image

            missing = ~np.isfinite(single).all(axis=2)
            shown = np.rint(127.5 * (np.where(missing[..., None], -1.0, single) + 1.0)).clip(0, 255).astype(np.uint8)
            Image.fromarray(shown).save(beside, format="PNG")
        else:
            beside.write_bytes(_float_tiff(single))


def _float_tiff(image: np.ndarray[Any, np.dtype[np.float32]]) -> bytes:
    """An uncompressed TIFF of three channels of float32, which Pillow does not write."""
    height, width, channels = image.shape
    content = image.tobytes()
    # Tag, type (3: 16 bits, 4: 32 bits), count, value; three numbers of 16 bits stand after the directory.
    entries = [
        (256, 4, 1, width),
        (257, 4, 1, height),
        (258, 3, channels, None),  # bits: 32, 32, 32
        (259, 3, 1, 1),  # not compressed
        (262, 3, 1, 2),  # RGB
        (273, 4, 1, None),  # where the pixels begin
        (277, 3, 1, channels),
        (278, 4, 1, height),
        (279, 4, 1, len(content)),
        (284, 3, 1, 1),  # channels side by side
        (339, 3, channels, None),  # floats: 3, 3, 3
    ]
    after = 8 + 2 + 12 * len(entries) + 4
    places = {258: after, 339: after + 6, 273: after + 12}
    directory = struct.pack("<H", len(entries))
    for tag, kind, count, value in entries:
        directory += struct.pack("<HHII", tag, kind, count, places[tag] if value is None else value)
    return b"II*\0" + struct.pack("<I", 8) + directory + struct.pack("<I6H", 0, 32, 32, 32, 3, 3, 3) + content
