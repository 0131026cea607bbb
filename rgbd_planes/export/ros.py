"""ROS messages as dictionaries, shared by the exports of tiles and of segments."""

import math
from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import numpy as np

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.checks import check_whole, number

_SECOND = 1_000_000_000  # in nanoseconds
_FAR = 1e12  # seconds, more than a message holds: infinity is no fraction


def ros_header(frame_id: str, stamp: Any) -> dict[str, Any]:
    """std_msgs/Header; an unknown time is 0."""
    if not isinstance(frame_id, str):
        raise TypeError(f"expected frame_id as a str, got {frame_id!r}")
    return {"stamp": _time(stamp), "frame_id": frame_id}


def _time(stamp: Any) -> dict[str, int]:
    """builtin_interfaces/Time of seconds, or of what has nanoseconds, as a message's stamp, which no float holds."""
    for names in (("sec", "nanosec"), ("secs", "nsecs")):  # of ROS 2 and ROS 1
        fields = stamp if isinstance(stamp, Mapping) else {n: getattr(stamp, n) for n in names if hasattr(stamp, n)}
        if all(name in fields for name in names):
            # Before 1970 seconds are negative; nanoseconds always count upwards.
            sec = check_whole(f"stamp's {names[0]}", fields[names[0]], -(2**31), bits=31)
            nanosec = check_whole(f"stamp's {names[1]}", fields[names[1]], 0)
            if nanosec >= _SECOND:
                raise ValueError(f"stamp's {names[1]} must be below {_SECOND}, got {nanosec}")
            return {"sec": sec, "nanosec": nanosec}
    nanoseconds = _nanoseconds(stamp)
    if not -(2**31) <= nanoseconds // _SECOND < 2**31:
        raise ValueError(f"expected stamp in seconds, which a message holds in 32 bits, got {stamp!r}: nanoseconds?")
    return {"sec": nanoseconds // _SECOND, "nanosec": nanoseconds % _SECOND}


def _nanoseconds(stamp: Any) -> int:
    """Since 1970, exactly where it is not in seconds; 0 for an unknown time."""
    if isinstance(stamp, np.datetime64):
        if np.isnat(stamp):
            return 0
        whole = stamp.astype("datetime64[s]")
        return _SECOND * int(whole.astype(np.int64)) + int((stamp - whole) // np.timedelta64(1, "ns"))
    exact = getattr(stamp, "nanoseconds", None)
    if isinstance(exact, (int, np.integer)):
        return int(exact)
    seconds = number("stamp", stamp, finite=False)
    if math.isnan(seconds):
        return 0
    return round(Fraction(min(max(seconds, -_FAR), _FAR)) * _SECOND)


def ros_planes(planes: Floats, frame_id: str, stamp: Any) -> dict[str, Any]:
    """(N, 4) planes in the shape of jsk_recognition_msgs/ModelCoefficientsArray."""
    coefficients = [{"header": ros_header(frame_id, stamp), "values": plane} for plane in planes.tolist()]
    return {"header": ros_header(frame_id, stamp), "coefficients": coefficients}


def ros_polygons(rings: list[Floats], labels: list[int], frame_id: str, stamp: Any) -> dict[str, Any]:
    """Polygons of (K, 3) corners each in the shape of jsk_recognition_msgs/PolygonArray."""
    polygons = [
        {
            "header": ros_header(frame_id, stamp),
            "polygon": {"points": [{"x": x, "y": y, "z": z} for x, y, z in ring.tolist()]},
        }
        for ring in rings
    ]
    return {"header": ros_header(frame_id, stamp), "polygons": polygons, "labels": labels, "likelihood": []}
