"""A rig with the driver `faulty`, its supervisor and a node beside, to be broken and mended."""

import os
import shutil
import time
from contextlib import contextmanager
from pathlib import Path

from std_msgs.msg import String

from squeal_rig.graph import qos
from tests.graph.domains import private_domain
from tests.graph.processes import Processes, parameters
from tests.graph.statuses import health_of, status_of

OPERATING_POINT = {"preload": 50.0, "belt_speed": 1.0}
LEVELS = {"ok": 0, "warn": 1, "ramp down": 2, "emergency stop": 3}


def install_driver(folder, faults):
    """A package in `folder` that offers the driver `faulty`; returns what its processes need in their environment."""
    shutil.copy(Path(__file__).with_name("faulty_rig.py"), folder / "faulty_rig.py")
    metadata = folder / "faulty_lab-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: faulty-lab\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[squeal_rig.drivers]\nfaulty = faulty_rig:FaultyRig\n")
    path = os.pathsep.join(filter(None, (str(folder), os.environ.get("PYTHONPATH"))))
    return {"PYTHONPATH": path, "FAULTS": str(faults)}


class FaultBench:
    """Everything that a case of the matrix works with."""

    def __init__(self, domain, processes, observer, faults, config_file):
        self.observer, self.processes, self.faults = observer, processes, faults
        self._files = ["--params-file", str(config_file)]
        self._config_file = config_file
        self.states = observer.follow("supervisor/state")
        self.trips = observer.follow("supervisor/trips")
        self.safe = observer.follow("rig/safe")
        self.health = observer.follow("/diagnostics")
        self.beats = observer.follow("supervisor/heartbeat", depth=5)
        self.daq = observer.follow_samples("daq/samples", depth=20)
        self.asking = observer.node.create_publisher(String, "emergency_stop", qos.EVENTS)
        self.nodes = {}
        for name in ("squeal_detector", "supervisor", "rig"):
            self.start(name)

    def start(self, name):
        """Start a node, or start it again."""
        sheets = self.faults.parent / "sheets.yaml"
        sheets.write_text("arm_force: {range: 9000.0}\n")  # below every limit of force, so that it is what trips
        own = {
            "rig": {
                "driver": "faulty",
                "supervisor_required": True,
                "sample_rate": 12800,
                "instruments": str(sheets),
            },
            "supervisor": {"nodes": ["rig", "squeal_detector"], "node_timeout": 3.0},
        }.get(name, {})
        self.nodes[name] = self.processes.node(name, *self._files, *parameters(**own))

    # --- what is

    def status(self, messages, name):
        return next((s for m in reversed(messages) if (s := status_of(m, name))), None)

    def level(self):
        state = self.status(self.states, "supervisor")
        return state and state[2]["level"]

    def is_safe(self):
        """Whether the rig says that it is stopped and the driver has accepted it."""
        state = self.status(self.safe, "rig safe")
        return state is not None and state[2]["stopped"] == "true" and state[2]["accepted"] == "true"

    def in_force(self):
        if not self.daq:
            return None
        last = self.daq[-1].samples[-1]
        return float(last["preload"]), float(last["belt_speed"])

    def rig_state(self):
        found = health_of(self.health, "rig")
        return found and found[2].get("state")

    # --- what is done

    def put(self, name, content=""):
        """Inject a fault; returns the time [s since the epoch]."""
        part = self.faults.parent / "part"
        part.write_text(str(content))
        begun = time.time()
        part.rename(self.faults / name)  # never half written
        return begun

    def clear(self):
        for path in self.faults.iterdir():
            path.unlink()

    def ask_stop(self, reason):
        begun = time.time()
        self.asking.publish(String(data=reason))
        return begun

    def reset_supervisor(self, reason):
        self.observer.set({"reset_reason": reason}, node="supervisor")
        return self.observer.trigger("reset", rig="supervisor")

    def mend(self):
        """The documented procedure after whatever has happened; everything runs in order afterwards.

        A rig that has just been started on a busy machine may be silent for a second, which is a trip of its own: the
        procedure is gone through again then. Returns the sentences of such trips.
        """
        again = []
        for _ in range(3):
            if self._mended():
                self.trips.clear()
                return again
            again.append(self.status(self.states, "supervisor"))
        raise AssertionError(f"not mended: {again}; {[health_of(self.health, name) for name in self.nodes]}")

    def _mended(self):
        """Go through the procedure; whether the level is ok afterwards, and not latched once more."""
        observer = self.observer
        self.clear()
        started = [name for name, node in self.nodes.items() if not node.running]
        for name in started:
            self.start(name)
        if "supervisor" in started:
            self.states.clear()  # those of the one before
        if started:
            self.health.clear()
        observer.wait_for(lambda: self.health and self.rig_state() not in (None, "ended"), "the rig's health")
        self._until_sampling()

        observer.wait_for(self.level, "the supervisor's word")

        def released():
            if LEVELS[self.level() or "ok"] < LEVELS["ramp down"]:
                return True
            done, told = self.reset_supervisor("mended by the test")
            self.told = told
            return done

        try:
            observer.wait_for(released, "the supervisor's reset")
        except AssertionError:
            raise AssertionError(f"the supervisor is not reset: {self.told}; {self.states[-1]}") from None
        # A supervisor that was started again hears of the rig's stop after its first word, and latches then.
        observer.wait_for(lambda: released() and observer.trigger("reset")[0], "the rig's reset")
        observer.set(OPERATING_POINT, atomically=True)
        observer.wait_for(
            lambda: self.in_force() == (50.0, 1.0) or LEVELS[self.level()] >= LEVELS["ramp down"], "the operating point"
        )
        try:
            observer.wait_for(lambda: self.level() != "warn", "no warning")
        except AssertionError:
            raise AssertionError(f"still warned: {self.status(self.states, 'supervisor')}") from None
        if started:
            # A node is missed only by a supervisor that has heard it well.
            observer.wait_for(lambda: self._watched() >= {"rig", "squeal_detector"}, "the supervisor's watch")
        return self.level() == "ok"

    def _watched(self):
        found = health_of(self.health, "supervisor")
        return set(found[2]["watched"].split()) if found else set()

    def _until_sampling(self):
        observer = self.observer
        observer.spin(0.3)  # what has come already
        self.daq.clear()
        try:
            observer.wait_for(lambda: len(self.daq) > 2, "samples", 3.0)
        except AssertionError:
            # The rig has a fault: the driver is opened anew, and stays safe.
            assert self.nodes["rig"].running
            observer.transition("deactivate")
            observer.transition("activate")
            observer.wait_for(lambda: len(self.daq) > 2, "samples")


@contextmanager
def running_bench(tmp_path, monkeypatch, config_file):
    """A bench on a domain of its own."""
    from tests.graph.observer import Observer

    faults, package, logs = (tmp_path / name for name in ("faults", "package", "logs"))
    for folder in (faults, package, logs):
        folder.mkdir()
    for name, value in install_driver(package, faults).items():
        monkeypatch.setenv(name, value)
    with private_domain() as domain:
        processes, observer = Processes(domain, logs), Observer(domain)
        bench = FaultBench(domain, processes, observer, faults, config_file)
        try:
            observer.wait_for(lambda: len(bench.daq) > 5, "samples", 300.0)
            observer.wait_for(bench.level, "the supervisor's word")
            bench.mend()  # a busy machine may have tripped it already
            yield bench
        finally:
            bench.clear()
            observer.close()
            processes.end_all()
