"""Definitions and messages for the tests of bags."""

import numpy as np
import pytest

from tests.messages import TYPES, schema_of

CLOUD = "sensor_msgs/msg/PointCloud2"
STRING = "std_msgs/msg/String"


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
