"""openDAQ's own reference device in a process beside: transport, rate, times, gaps. Its sine is nobody's rig."""

import time

import numpy as np
import pytest

from squeal_rig.drivers.hardware import HardwareRig
from squeal_rig.errors import DriverError
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.model import RigParameters

from .conftest import Served, needs_extra

RATE = 10_000
MAP = """
driver: opendaq
connection: "daq.ns://127.0.0.1:{port}"
stale_after: 20.0
queue: 60.0
clock_tolerance: 600.0
channels:
  x: {{signal: AI0, unit: m, scale: 1.0e-6}}
  y: {{signal: AI1, unit: m, scale: 1.0e-6, sign: -1, offset: 1.0}}
"""
NOT_MEASURED = ("arm_left", "arm_right", "clip_left", "clip_right", "motor_torque", "belt_speed", "preload")


@pytest.fixture(scope="module")
def device(tmp_path_factory):
    needs_extra()
    from squeal_rig.testing.daq_server import free_port

    folder = tmp_path_factory.mktemp("reference")
    port = free_port()
    served = Served(
        "squeal_rig.testing.reference_device",
        folder / "device.log",
        *("--port", port, "--sample-rate", RATE),
        word="reference device: ",
    )
    config = folder / "driver.yaml"
    config.write_text(MAP.format(port=port) + "".join(f"  {name}: {{fixed: 0.25}}\n" for name in NOT_MEASURED))
    yield str(config)
    served.kill()


def test_its_samples_arrive_whole_at_its_rate_with_its_times(device):
    rig = HardwareRig()
    settings = RigSettings(driver="opendaq", driver_config=device, sample_rate=RATE)
    can = rig.capabilities(settings)
    assert can.set_points == frozenset()
    assert can.not_measured == frozenset(NOT_MEASURED)
    rig.open(RigParameters(), settings)
    readings = []
    while len(readings) < 200:
        reading = rig.read(RigParameters())
        time.sleep(0.001)
        if reading is not None:
            readings.append(reading)
    rig.close()
    assert all(reading.lost == 0 and reading.warnings == () for reading in readings)
    steps = np.diff([reading.stamp for reading in readings])
    assert set(steps) == {10_000_000}  # its clock ticks in microseconds, 100 a sample
    assert abs(time.time() - readings[-1].stamp * 1e-9) < 600.0  # [s] of this machine's clock, however slow it is
    x = np.concatenate([reading.daq["x"] for reading in readings])
    y = np.concatenate([reading.daq["y"] for reading in readings])
    assert np.std(x) > 0.0
    assert abs(np.mean(y) - 1.0) < 1e-3  # -1 times what it has in micrometres, and the offset
    assert set(readings[0].daq["preload"]) == {0.25}
    # A sine without a gap: no step between two samples is larger across blocks than within.
    within = max(float(np.max(np.abs(np.diff(reading.daq["x"])))) for reading in readings)
    assert float(np.max(np.abs(np.diff(x)))) <= 1.5 * within


def test_its_rate_has_to_be_the_rigs(device):
    with pytest.raises(DriverError, match=r"has 10000 samples per second, and the rig's sample_rate is 51200 Hz"):
        HardwareRig().open(RigParameters(), RigSettings(driver="opendaq", driver_config=device))
