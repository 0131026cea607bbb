"""Dictionaries in the shape of ROS messages, to messages and back."""

import functools

import numpy as np


def as_message(store, kind, values):
    """A ROS message made from a dict of its shape: every field, and no other."""
    about = store.types[kind]
    fields = {name: t for name, (_, t) in zip(about.__annotations__, store.fielddefs[kind][1], strict=False)}
    assert set(values) == set(fields)
    return about(**{name: as_field(store, *fields[name], values[name]) for name in fields})


def as_field(store, node, detail, value):
    from rosbags.interfaces import Nodetype

    if node == Nodetype.NAME:
        return as_message(store, detail, value)
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        inner, of = detail[0]
        if inner == Nodetype.NAME:
            return [as_message(store, of, item) for item in value]
        array = np.frombuffer(value, np.uint8) if isinstance(value, bytes) else np.array(value)
        return array.astype({"octet": np.uint8}.get(of[0], of[0]))
    return value


@functools.cache
def type_store():
    """ROS 2's messages and those of jsk_recognition."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in {  # as in the packages' own .msg files
        "pcl_msgs/msg/ModelCoefficients": "std_msgs/Header header\nfloat32[] values",
        "jsk_recognition_msgs/msg/ModelCoefficientsArray": (
            "std_msgs/Header header\npcl_msgs/ModelCoefficients[] coefficients"
        ),
        "jsk_recognition_msgs/msg/PolygonArray": (
            "std_msgs/Header header\ngeometry_msgs/PolygonStamped[] polygons\nuint32[] labels\nfloat32[] likelihood"
        ),
    }.items():
        store.register(get_types_from_msg(text, name))
    return store


def round_trip(kind, values):
    """What a reader of the message gets."""
    store = type_store()
    message = as_message(store, kind, values)
    return store.deserialize_cdr(store.serialize_cdr(message, kind), kind)
