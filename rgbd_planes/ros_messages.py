"""ROS messages as dictionaries, shared by the exports of tiles and of segments."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rgbd_planes.checks import check_whole, number

Floats = NDArray[np.float64]


def ros_header(frame_id: str, stamp: Any) -> dict[str, Any]:
    """std_msgs/Header; an unknown time is 0."""
    if not isinstance(frame_id, str):
        raise TypeError(f"expected frame_id as a str, got {frame_id!r}")
    return {"stamp": _time(stamp), "frame_id": frame_id}


def _time(stamp: Any) -> dict[str, int]:
    """builtin_interfaces/Time of seconds, or of a message's stamp, which no float holds to the nanosecond."""
    for names in (("sec", "nanosec"), ("secs", "nsecs")):  # of ROS 2 and ROS 1
        fields = stamp if isinstance(stamp, Mapping) else {n: getattr(stamp, n) for n in names if hasattr(stamp, n)}
        if all(name in fields for name in names):
            sec, nanosec = (check_whole(f"stamp's {name}", fields[name], 0) for name in names)
            return {"sec": sec, "nanosec": nanosec}
    seconds = number("stamp", stamp, finite=False)
    nanoseconds = round(seconds * 1e9) if math.isfinite(seconds * 1e9) else 0
    return {"sec": nanoseconds // 1_000_000_000, "nanosec": nanoseconds % 1_000_000_000}


def ros_planes(planes: Floats, frame_id: str, stamp: Any) -> dict[str, Any]:
    """(N, 4) planes in the shape of jsk_recognition_msgs/ModelCoefficientsArray."""
    header = ros_header(frame_id, stamp)
    coefficients = [{"header": header, "values": plane} for plane in planes.tolist()]
    return {"header": header, "coefficients": coefficients}


def ros_polygons(rings: list[Floats], labels: list[int], frame_id: str, stamp: Any) -> dict[str, Any]:
    """Polygons of (K, 3) corners each in the shape of jsk_recognition_msgs/PolygonArray."""
    header = ros_header(frame_id, stamp)
    polygons = [
        {"header": header, "polygon": {"points": [{"x": x, "y": y, "z": z} for x, y, z in ring.tolist()]}}
        for ring in rings
    ]
    return {"header": header, "polygons": polygons, "labels": labels, "likelihood": []}
