"""MCAP bags that rosbag2, `rosbags` and `mcap` read, written and read without ROS."""

from .clouds import SampleBlock, cdr_from_samples, samples_from_cdr
from .messages import as_mapping, decoder_of
from .provenance import provenance
from .qos_yaml import INFINITE_NS, QosProfile, qos_from_yaml, qos_to_yaml
from .reader import Bag, MetadataRecord, RawMessage, TopicInfo
from .schemas import MessageSchema, installed_schema
from .writer import BagWriter, ChannelHandle

__all__ = [
    "INFINITE_NS",
    "Bag",
    "BagWriter",
    "ChannelHandle",
    "MessageSchema",
    "MetadataRecord",
    "QosProfile",
    "RawMessage",
    "SampleBlock",
    "TopicInfo",
    "as_mapping",
    "cdr_from_samples",
    "decoder_of",
    "installed_schema",
    "provenance",
    "qos_from_yaml",
    "qos_to_yaml",
    "samples_from_cdr",
]
