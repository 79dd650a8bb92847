"""Drivers of others raise what they like: named at start, on `/diagnostics` and in the answer, and the rig lives on."""

import os

import pytest

from tests.graph.processes import parameters
from tests.graph.statuses import health_of

pytest.importorskip("rclpy")

ERROR = 2
# The virtual rig, failing where a file of that name says so.
CODE = """
from pathlib import Path
from squeal_rig.instruments.virtual import VirtualRig

def fail(where):
    if Path(__file__).with_name(where).exists():
        raise ZeroDivisionError(f"no bridge voltage in {where}")

class Bench(VirtualRig):
    def capabilities(self, settings):
        fail("capabilities")
        return super().capabilities(settings)

    def open(self, parameters, settings):
        fail("open")
        super().open(parameters, settings)

    def read(self, in_force):
        fail("read")
        if Path(__file__).with_name("nothing").exists():
            return None
        return super().read(in_force)

    def reset(self):
        fail("reset")
        super().reset()

    def close(self):
        fail("close")
        super().close()
"""


@pytest.fixture
def bench_driver(tmp_path, monkeypatch):
    """Folder of an installed package that offers the driver `bench`."""
    (tmp_path / "some_lab.py").write_text(CODE)
    metadata = tmp_path / "some_lab-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: some-lab\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[squeal_rig.drivers]\nbench = some_lab:Bench\n")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    return tmp_path


def test_a_driver_that_cannot_open_ends_the_start_with_its_reason(compiled, processes, bench_driver):
    (bench_driver / "open").touch()
    rig = processes.node("rig", *parameters(driver="bench"))
    assert rig.wait() == 2
    assert "rig: ZeroDivisionError: no bridge voltage in open (some_lab.py, line " in rig.errors
    assert "Traceback" not in rig.errors


def test_a_driver_that_fails_later_is_a_fault_that_can_be_mended(compiled, processes, observer, bench_driver):
    rig = processes.node("rig", *parameters(driver="bench", autostart="false"))
    health = observer.follow("/diagnostics")

    def wait_for_fault(where):
        sentence = f"ZeroDivisionError: no bridge voltage in {where}"
        observer.wait_for(
            lambda: (state := health_of(health, "rig")) and state[0] == ERROR and sentence in state[1], sentence
        )

    (bench_driver / "open").touch()
    assert not observer.transition("configure")
    wait_for_fault("open")
    (bench_driver / "open").unlink()
    assert observer.transition("configure")
    assert observer.transition("activate")
    blocks = observer.follow_samples("daq/samples")
    observer.wait_for(lambda: blocks, "samples")
    (bench_driver / "read").touch()
    wait_for_fault("read")
    (bench_driver / "read").unlink()
    (bench_driver / "reset").touch()
    done, message = observer.trigger("reset")
    assert (done, "no bridge voltage in reset" in message) == (False, True)
    (bench_driver / "reset").unlink()
    assert observer.trigger("reset")[0]
    blocks.clear()
    observer.wait_for(lambda: blocks, "samples after the reset")
    assert observer.transition("deactivate")
    (bench_driver / "close").touch()
    assert not observer.transition("cleanup")
    wait_for_fault("close")
    assert rig.end()[0] == 0
    assert "Traceback" not in rig.errors


@pytest.mark.parametrize("where", ["capabilities", "open"])
def test_a_driver_that_fails_before_it_is_opened_is_named_too(compiled, processes, bench_driver, where):
    (bench_driver / where).touch()
    rig = processes.node("rig", *parameters(driver="bench"))
    assert rig.wait() == 2
    assert f"rig: ZeroDivisionError: no bridge voltage in {where} (some_lab.py, line " in rig.errors


def test_settings_for_a_driver_that_has_none_are_refused_at_start(compiled, processes, bench_driver):
    file = bench_driver / "bench.yaml"
    file.write_text("driver: bench\nvoltage: 5.0\n")
    rig = processes.node("rig", *parameters(driver="bench", driver_config=file))
    assert rig.wait() == 2
    assert "unknown key 'voltage': the driver 'bench' has no settings of its own" in rig.errors


@pytest.mark.slow
def test_a_driver_without_a_block_is_told_with_its_time_and_the_rig_goes_on(
    compiled, processes, observer, bench_driver
):
    rig = processes.node("rig", *parameters(driver="bench"))
    blocks, health = observer.follow_samples("daq/samples"), observer.follow("/diagnostics")
    observer.wait_for(lambda: blocks, "samples")
    (bench_driver / "nothing").touch()

    def silent():
        state = health_of(health, "rig")
        return state and state[0] == ERROR and state[1].startswith("no samples from the driver for ")

    observer.wait_for(silent, "a silent driver")
    (bench_driver / "nothing").unlink()
    blocks.clear()
    observer.wait_for(lambda: blocks, "samples again")
    assert rig.end()[0] == 0
