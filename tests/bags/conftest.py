"""Children and an observer of each test's own."""

import pytest

from tests.graph.processes import Processes


@pytest.fixture
def processes(domain, tmp_path):
    """Starts children on the module's domain; none outlives the test."""
    folder = tmp_path / "logs"
    folder.mkdir()
    started = Processes(domain, folder)
    yield started
    started.end_all()


@pytest.fixture
def observer(domain):
    """The test's own node on the module's domain."""
    pytest.importorskip("rclpy")
    from tests.graph.observer import Observer

    node = Observer(domain)
    yield node
    node.close()


@pytest.fixture
def health(observer):
    """What comes on `/diagnostics` from now on."""
    return observer.follow("/diagnostics")
