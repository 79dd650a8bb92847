"""A running rig with its estimators to share."""

import time
from dataclasses import dataclass, field

import pytest

from squeal_rig.configuration.files import config_directory
from tests.graph.domains import private_domain
from tests.graph.processes import Processes


@pytest.fixture(scope="session")
def config_file():
    """The rig.yaml that ships with the package."""
    return config_directory() / "rig.yaml"


#: Operating point, law and slew of a bench at rest; slew so fast that a set point is in force one block later.
AT_REST = {
    "preload": 50.0,
    "belt_speed": 1.0,
    "k1": 4.0e7,
    "k2": 4.0e7,
    "mu0": 0.25010,
    "mu_speed": 9.1366e-3,
    "mu_preload": 2.3202e-3,
    "mu_speed_preload": -5.1639e-4,
    "preload_slew_rate": 1e9,
    "belt_acceleration": 1e6,
    "stiffness_slew_rate": 1e15,
    "impact_impulse": 0.05,
}


@dataclass
class Bench:
    """A running rig with its estimators, and the observer that follows them."""

    observer: object
    processes: object
    nodes: dict
    # What has come, by name; not shown when a test fails, it is long.
    daq: object = field(repr=False)
    truth: object = field(repr=False)
    windows: object = field(repr=False)
    summaries: object = field(repr=False)
    eigenvalues: object = field(repr=False)
    health: object = field(repr=False)

    def in_force(self):
        """(preload [N], belt speed [m/s]) at the end of the newest block."""
        last = self.daq[-1].samples[-1]
        return float(last["preload"]), float(last["belt_speed"])

    def rest(self, **changes):
        """The pad at rest at an operating point in force."""
        wanted = {**AT_REST, **changes}
        assert self.observer.set(wanted, atomically=True) == [(True, "")]
        point = wanted["preload"], wanted["belt_speed"]
        self.next_block()
        self.observer.wait_for(lambda: self.in_force() == point, f"{point} in force")
        assert self.observer.trigger("reset")[0]
        self.next_block()

    def next_block(self, blocks=None):
        """The newest block of `daq/samples`, or of others, once it was begun after now: changes made before are in it.

        By its stamp, since blocks made before a change may arrive after the answer to it.
        """
        blocks, now = self.daq if blocks is None else blocks, time.time_ns()
        self.observer.wait_for(lambda: blocks[-1].stamp_ns >= now, "the next block")
        return blocks[-1]


@pytest.fixture(scope="session")
def running(compiled, tmp_path_factory, config_file):
    """A rig, an estimator, stability and the squeal detector, all on the parameters that ship, sampling."""
    from tests.graph.observer import Observer

    files = ["--params-file", str(config_file)]
    names = ("friction_estimator", "stability", "squeal_detector", "simulator")
    with private_domain() as domain:
        processes = Processes(domain, tmp_path_factory.mktemp("bench"))
        observer = Observer(domain)
        bench = Bench(
            observer,
            processes,
            nodes={name: processes.node(name, *files) for name in names},
            daq=observer.follow_samples("daq/samples"),
            truth=observer.follow_samples("truth/samples"),
            windows=observer.follow_samples("friction/windows"),
            summaries=observer.follow("stability/summary"),
            eigenvalues=observer.follow("stability/eigenvalues"),
            health=observer.follow("/diagnostics"),
        )
        for what in ("daq", "truth", "windows", "summaries", "eigenvalues", "health"):
            observer.wait_for(lambda what=what: getattr(bench, what), what)
        yield bench
        observer.close()
        processes.end_all()


@pytest.fixture
def bench(running):
    """The running rig, at rest at its stable operating point; paused while no test uses it."""
    running.observer.pause(False)
    running.rest()
    with running.observer.following_for_a_while():
        yield running
    dead = [name for name, node in running.nodes.items() if not node.running]
    assert not dead, f"ended during the test: {dead}"
    running.observer.pause(True)
