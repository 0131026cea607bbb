"""ROS bags made for tests."""

import sqlite3
from contextlib import closing
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np


class Cut(NamedTuple):
    """A message of which only the beginning is written."""

    message: Any


def messages(store, frames, encoding="16UC1", padding=0, big_endian=False):
    """Images as ROS messages of a type store."""
    types = store.types
    ros1 = "seq" in types["std_msgs/msg/Header"].__annotations__

    def header(i, stamped=True):
        time = types["builtin_interfaces/msg/Time"](100 + i if stamped else 0, 500_000_000 if stamped else 0)
        fields = {"stamp": time, "frame_id": "depth"} | ({"seq": i} if ros1 else {})
        return types["std_msgs/msg/Header"](**fields)

    made = []
    for i, frame in enumerate(frames):
        rows = frame.astype(frame.dtype.newbyteorder(">" if big_endian else "<")).view(np.uint8)
        rows = np.pad(rows.reshape(len(frame), -1), ((0, 0), (0, padding)))
        made.append(
            types["sensor_msgs/msg/Image"](
                header=header(i, stamped=i != 2), height=len(frame), width=frame.shape[1], encoding=encoding,
                is_bigendian=int(big_endian), step=rows.shape[1], data=rows.ravel(),
            )
        )  # fmt: skip
    info = SimpleNamespace(k=[7.0, 0, 3.5, 0, 7.5, 2.5, 0, 0, 1], p=[7.1, 0, 3.5, 0, 0, 7.6, 2.5, 0, 0, 0, 1, 0])
    letters = str.upper if ros1 else str
    arrays = {
        letters("d"): np.array([0.01, 0.0, 0.0, 0.0, 0.0]), letters("k"): np.array(info.k),
        letters("r"): np.eye(3).ravel(), letters("p"): np.array(info.p, np.float64),
    }  # fmt: skip
    camera_info = types["sensor_msgs/msg/CameraInfo"](
        header=header(0), height=6, width=8, distortion_model="plumb_bob", binning_x=0, binning_y=0,
        roi=types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False), **arrays,
    )  # fmt: skip
    return made, camera_info


def write_bag(path, topics):
    """A bag of {topic: [(nanoseconds, message), ...]}: ROS 1 where the name ends in .bag, ROS 2 elsewhere.

    As ROS 2 Humble wrote them, without the definitions of messages, where "humble" is in the name.
    """
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    store, ros1 = type_store(path)
    if ros1:
        writer = Writer1(path)
        writer.set_compression(Writer1.CompressionFormat.BZ2)
    else:
        plugin = StoragePlugin.MCAP if "mcap" in path.name else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=plugin)
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    with writer:
        for topic, timed in topics.items():
            first = timed[0][1]
            kind = (first.message if isinstance(first, Cut) else first).__msgtype__
            connection = writer.add_connection(topic, kind, typestore=store)
            for time, message in timed:
                whole = not isinstance(message, Cut)
                content = serialize(message if whole else message.message, kind)
                writer.write(connection, time, content if whole else content[:40])
    if "humble" in path.name:
        with closing(sqlite3.connect(next(path.glob("*.db3")))) as database:
            database.execute("DROP TABLE message_definitions")
            database.execute("ALTER TABLE topics DROP COLUMN type_description_hash")
            database.execute("UPDATE schema SET schema_version = 3")
            database.commit()


def type_store(path):
    from rosbags.typesys import Stores, get_typestore

    ros1 = path.suffix == ".bag"
    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE), ros1
