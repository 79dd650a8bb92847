"""Domains, processes and an observer, for every test that starts something."""

import pytest
from hypothesis import settings

from .graph.domains import private_domain
from .graph.processes import Processes

# Compiling the model for the first time takes tens of seconds, on a busy machine minutes.
_COMPILING = 600.0
# A busy machine takes its time. The same examples each time: `make fuzz` and `make test-long` are what searches.
settings.register_profile("any machine", deadline=None, derandomize=True)
settings.load_profile("any machine")
_MEASURED = pytest.StashKey[list]()


def pytest_terminal_summary(terminalreporter, config):
    """Show what was measured: the tests assert far wider bounds, since machines are noisy."""
    for line in config.stash.get(_MEASURED, []):
        terminalreporter.write_line(f"measured: {line}")


@pytest.fixture
def measured(request):
    """Keeps a sentence with a measured number for the end of the test's output."""
    return request.config.stash.setdefault(_MEASURED, []).append


@pytest.fixture(scope="module")
def domain():
    """A ROS domain of this module alone."""
    with private_domain() as number:
        yield number


@pytest.fixture(scope="module")
def processes(domain, tmp_path_factory):
    """Starts children on the module's domain; all are gone at its end."""
    started = Processes(domain, tmp_path_factory.mktemp("logs"))
    yield started
    started.end_all()


@pytest.fixture(scope="module")
def observer(domain):
    """The test's own node on the module's domain."""
    # Imported here, so that collecting needs no ROS.
    from .graph.observer import Observer

    node = Observer(domain)
    yield node
    node.close()


@pytest.fixture(scope="session")
def compiled_zones():
    """Has on disk what `analyse` compiles: a process that is given a minute has the time it needs."""
    from squeal_rig.model import RigParameters, zone

    zone(RigParameters(damping_x=20.0, damping_y=20.0))


@pytest.fixture(scope="session")
def compiled(tmp_path_factory):
    """Has the compiled model on disk, so that nodes start as they do from the second time on."""
    from .graph.observer import Observer

    with private_domain() as number:
        started = Processes(number, tmp_path_factory.mktemp("compile"))
        node = Observer(number)
        simulator = started.node("simulator")
        blocks = node.follow_samples("daq/samples")
        node.wait_for(lambda: blocks or not simulator.running, "the first block", _COMPILING)
        assert simulator.running, simulator.errors
        node.close()
        started.end_all()
