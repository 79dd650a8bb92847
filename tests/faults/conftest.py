"""The parameter file that ships."""

import pytest

from squeal_rig.configuration.files import config_directory


@pytest.fixture(scope="session")
def config_file():
    """The rig.yaml that ships with the package."""
    return config_directory() / "rig.yaml"
