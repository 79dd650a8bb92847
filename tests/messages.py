"""Definitions and bytes of stock messages, made by `rosbags`, so that no ROS needs to be installed."""

from rosbags.typesys import Stores, get_typestore

from squeal_rig.recording import MessageSchema

TYPES = get_typestore(Stores.ROS2_JAZZY)


def schema_of(type_name):
    """Definition of a message type."""
    text, _ = TYPES.generate_msgdef(type_name, ros_version=2)
    return MessageSchema(type_name, text, TYPES.hash_rihs01(type_name))


def serialised(type_name, *fields):
    """A message as CDR bytes."""
    return bytes(TYPES.serialize_cdr(TYPES.types[type_name](*fields), type_name))


def string_cdr(text):
    """A std_msgs/String as CDR bytes."""
    return serialised("std_msgs/msg/String", text)
