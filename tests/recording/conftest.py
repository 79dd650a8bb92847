"""Definitions and messages for the tests of bags, made by `rosbags`, so that no ROS needs to be installed."""

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from squeal_rig.recording import MessageSchema

TYPES = get_typestore(Stores.ROS2_JAZZY)
CLOUD = "sensor_msgs/msg/PointCloud2"
STRING = "std_msgs/msg/String"


def schema_of(type_name):
    text, _ = TYPES.generate_msgdef(type_name, ros_version=2)
    return MessageSchema(type_name, text, TYPES.hash_rihs01(type_name))


@pytest.fixture(scope="session")
def types():
    return TYPES


@pytest.fixture(scope="session")
def cloud_schema():
    return schema_of(CLOUD)


@pytest.fixture(scope="session")
def string_schema():
    return schema_of(STRING)


@pytest.fixture(scope="session")
def schema_for():
    return schema_of


@pytest.fixture(scope="session")
def noisy_payloads():
    """200 different byte strings of 0 to 20 kB that hardly compress."""
    generator = np.random.default_rng(20230517)
    return [generator.bytes(int(size)) for size in generator.integers(0, 20_000, 200)]
