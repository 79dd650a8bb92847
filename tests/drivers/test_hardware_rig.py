"""The driver `opendaq` on the twin: samples and their times, set points by Modbus, the safe state, a pulled cable."""

import dataclasses
import itertools
import socket
import threading
import time
from contextlib import suppress

import numpy as np
import pytest

from squeal_rig.drivers.hardware import HardwareRig
from squeal_rig.errors import DriverError, ParameterError
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.model import RigParameters, equilibrium

from .conftest import needs_extra, serve_twin

PARAMETERS = RigParameters(damping_x=20.0, damping_y=20.0)
PATIENCE = 120.0


def settings_for(config):
    return RigSettings(driver="opendaq", driver_config=str(config))


def until(condition, what):
    deadline = time.monotonic() + PATIENCE
    while not (value := condition()):
        assert time.monotonic() < deadline, what
        time.sleep(0.002)
    return value


def next_reading(driver, p=PARAMETERS):
    return until(lambda: driver.read(p), "a block")


def arrive(driver, p):
    """Read until preload and belt speed are those of p, as measured."""

    def there():
        daq = next_reading(driver, p).daq
        return abs(daq["preload"][-1] - p.preload) < 0.01 and abs(daq["belt_speed"][-1] - p.belt_speed) < 1e-3

    until(there, "set points in force")


def with_counter(twin, folder, *changes):
    """The twin's settings with its counter as a column of its own, and other changes."""
    text = twin.config.read_text().replace("set_points:", '  counter: {signal: counter, unit: ""}\nset_points:')
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    config = folder / "driver.yaml"
    config.write_text(text)
    return settings_for(config)


def first_sample(twin):
    """Time of the twin's sample 0 [ns], as it says."""
    return int(twin.line.split("sample 0 at ")[1].split()[0])


def check_times(twin, readings, rate=51200):
    """Every stamp is that of the twin's own clock for that sample, within a nanosecond or two of rounding."""
    for reading in readings:
        counter = reading.daq["counter"]
        assert np.array_equal(counter, counter[0] + np.arange(len(counter)))
        assert abs(reading.stamp - first_sample(twin) - round(counter[0] * 1e9 / rate)) <= 2


@pytest.fixture
def driver(twin, tmp_path):
    rig = HardwareRig()
    rig.open(PARAMETERS, with_counter(twin, tmp_path))
    yield rig
    rig.close()


def test_samples_come_without_gaps_with_the_devices_own_times(twin, driver):
    readings = [next_reading(driver) for _ in range(60)]
    check_times(twin, readings)
    for before, after in itertools.pairwise(readings):
        assert after.daq["counter"][0] - before.daq["counter"][-1] == 1 + after.lost
    assert driver.faults == {}


def test_set_points_over_modbus_change_the_signals_as_the_physics_has_it(driver):
    # The rig is bistable at both points, and its set points move in steps of a block, which ring: going from 50 to 80 N
    # they started a squeal now and then.
    points = (50.0, 1.0), (62.0, 1.2)
    (x1, y1), (x2, y2) = (equilibrium(PARAMETERS.replace(preload=f, belt_speed=v)) for f, v in points)
    apart = abs(x2 / x1 - 1.0), abs(y2 / y1 - 1.0)
    for preload, speed in points:
        p = PARAMETERS.replace(preload=preload, belt_speed=speed)
        arrive(driver, p)
        x, y = equilibrium(p)

        def rests(p=p, x=x, y=y):
            daq = next_reading(driver, p).daq
            # Far less than the points are apart; what rings still has its mean there.
            return abs(daq["x"].mean() / x - 1.0) < 0.25 * apart[0] and abs(daq["y"].mean() / y - 1.0) < 0.25 * apart[1]

        until(rests, f"the pad at the equilibrium of {preload} N and {speed} m/s")


def test_a_set_point_ramps_by_the_rigs_own_rate(driver):
    arrive(driver, PARAMETERS)
    goal = PARAMETERS.replace(preload=300.0)
    seen = []

    def arrived():
        seen.append(float(next_reading(driver, goal).daq["preload"][-1]))
        return seen[-1] > 299.0

    until(arrived, "300 N")
    # 500 N/s and a write every 50 ms: no step of what is measured is above the longest step of 0.2 s.
    assert max(np.diff(seen)) <= 500.0 * 0.2 + 1.0
    assert len({round(value) for value in seen}) > 3


def test_made_safe_the_hardware_stands_and_obeys_only_after_a_reset(driver):
    arrive(driver, PARAMETERS)
    driver.make_safe()
    arrive_at_rest = PARAMETERS.replace(preload=0.0, belt_speed=0.0)
    until(lambda: abs(next_reading(driver).daq["preload"][-1]) < 0.01, "no preload")
    until(lambda: abs(next_reading(driver).daq["belt_speed"][-1]) < 1e-3, "a belt at rest")
    for _ in range(50):
        daq = next_reading(driver).daq
        assert abs(daq["preload"][-1] - arrive_at_rest.preload) < 0.01
    driver.reset()
    arrive(driver, PARAMETERS)


def test_a_watchdog_outside_makes_it_safe(twin, driver):
    arrive(driver, PARAMETERS)
    stopped = []

    def at_rest():
        daq = next_reading(driver).daq
        stopped.append(abs(daq["preload"][-1]) < 0.01 and abs(daq["belt_speed"][-1]) < 1e-3)
        return stopped[-1]

    HardwareRig.make_safe_from_outside(settings_for(twin.config))
    until(at_rest, "preload and belt at nothing")


def test_nobody_is_commanded_before_the_first_read_and_nobody_after_the_close(twin, tmp_path):
    rig = HardwareRig()
    rig.open(PARAMETERS, with_counter(twin, tmp_path))
    arrive(rig, PARAMETERS)
    rig.close()
    rig.open(PARAMETERS, with_counter(twin, tmp_path))
    rest = PARAMETERS.replace(preload=0.0, belt_speed=0.0)
    arrive(rig, rest)
    rig.close()
    with pytest.raises(DriverError, match="not open"):
        rig.read(PARAMETERS)


def test_another_rate_is_refused_with_both(twin, tmp_path):
    settings = with_counter(twin, tmp_path)
    other = RigSettings(driver="opendaq", driver_config=settings.driver_config, sample_rate=25600)
    with pytest.raises(DriverError, match=r"has 51200 samples per second, and the rig's sample_rate is 25600 Hz"):
        HardwareRig().open(PARAMETERS, other)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("{signal: y,", "{signal: yy,", r"the device has no signal 'yy': there are arm_left, .*, x, y$"),
        ("{signal: y,", "{signal: openDAQDevice/Sig/yy,", "the device has no signal"),
        ("daq.ns://127.0.0.1:", "daq.ns://127.0.0.1:1", "no openDAQ device answers at daq.ns://127.0.0.1:1"),
        ("device_id: 2", "device_id: 9", "preload_unit"),
        ("control:      {address: 0", "control:      {address: 400", "refuses"),
    ],
)
def test_what_is_not_there_is_said_by_name(twin, tmp_path, old, new, sentence):
    # A port of one digit more cannot be, so that nobody answers there.
    settings = with_counter(twin, tmp_path, (old, new), ("stale_after: 20.0", "stale_after: 0.3"))
    rig = HardwareRig()

    def open_and_read():
        rig.open(PARAMETERS, settings)
        until(lambda: rig.read(PARAMETERS) and False, "the fault")

    with pytest.raises(DriverError, match=sentence):
        open_and_read()
    with suppress(DriverError):  # where a unit does not accept the safe command, it says so
        rig.close()


def test_a_whole_id_finds_a_signal_as_well(twin, tmp_path):
    rig = HardwareRig()
    rig.open(PARAMETERS, with_counter(twin, tmp_path, ("{signal: y,", "{signal: /openDAQDevice/Sig/y,")))
    next_reading(rig)
    rig.close()


@pytest.mark.slow
def test_a_pulled_cable_is_told_with_its_age_and_a_reset_mends_it(tmp_path):
    needs_extra()
    twin = serve_twin(tmp_path)
    try:
        rig = HardwareRig()
        rig.open(PARAMETERS, with_counter(twin, tmp_path, ("stale_after: 20.0", "stale_after: 2.0")))
        arrive(rig, PARAMETERS)
        twin.kill()
        with pytest.raises(DriverError) as caught:
            until(lambda: rig.read(PARAMETERS) and False, "the fault")
        sentence = str(caught.value)
        # Acquisition or Modbus, whichever is noticed first; nobody is there to accept the safe command.
        assert "stale: no samples" in sentence or "without success for " in sentence
        assert "the safe command was not accepted" in sentence
        with pytest.raises(DriverError):
            rig.read(PARAMETERS)  # it stays
        with pytest.raises(DriverError, match="answers at"):
            rig.reset()
        twin.start()
        rig.reset()
        arrive(rig, PARAMETERS)
        rig.close()
    finally:
        twin.kill()


@pytest.mark.parametrize(
    "fault", ["stuck", *(pytest.param(fault, marks=pytest.mark.slow) for fault in ("back", "ahead", "lost"))]
)
def test_times_that_cannot_be_are_told_and_not_believed(fault, tmp_path):
    needs_extra()
    twin = serve_twin(tmp_path, "--fault", fault)
    try:
        rig = HardwareRig()
        rig.open(PARAMETERS, with_counter(twin, tmp_path))
        readings = []

        def told():
            readings.append(next_reading(rig))
            return sum(bool(reading.warnings or reading.lost) for reading in readings) > 1

        until(told, "two faults")
        readings += [next_reading(rig) for _ in range(20)]
        check_times(twin, readings)  # whatever the device said of them
        for before, after in itertools.pairwise(readings):
            assert after.daq["counter"][0] - before.daq["counter"][-1] == 1 + after.lost
        if fault == "lost":
            assert {reading.lost for reading in readings} == {0, 3 * 512}
        else:
            assert any("not believed" in sentence for reading in readings for sentence in reading.warnings)
            assert rig.faults
        rig.close()
    finally:
        twin.kill()


class Proxy:
    """A line to a Modbus server that can be cut, or left open while nothing passes."""

    def __init__(self, port):
        self._target = port
        self.hung = threading.Event()
        self._cut = False
        self._sockets = []
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        with suppress(OSError):
            while not self._cut:
                near, _ = self._server.accept()
                far = socket.create_connection(("127.0.0.1", self._target))
                self._sockets += [near, far]
                for pair in ((near, far), (far, near)):
                    threading.Thread(target=self._pass, args=pair, daemon=True).start()

    def _pass(self, source, sink):
        with suppress(OSError):
            while data := source.recv(4096):
                if not self.hung.is_set():
                    sink.sendall(data)

    def cut(self):
        self._cut = True
        for each in (self._server, *self._sockets):
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()


@pytest.fixture
def line(twin, tmp_path):
    """The driver with its inverter on a line of its own: (driver, line)."""
    text = twin.config.read_text()
    port = int(text.split("port: ")[1].split()[0])
    proxy = Proxy(port)
    rig = HardwareRig()
    changes = (
        (f"port: {port}\n    device_id: 1", f"port: {proxy.port}\n    timeout: 0.5\n    device_id: 1"),
        ("stale_after: 20.0", "stale_after: 3.0"),
        ("safe_timeout: 5.0", "safe_timeout: 3.0"),
    )
    rig.open(PARAMETERS, with_counter(twin, tmp_path, *changes))
    arrive(rig, PARAMETERS)
    yield rig, proxy
    proxy.cut()
    with suppress(DriverError):
        rig.close()


@pytest.mark.parametrize("how", ["cut", pytest.param("hung", marks=pytest.mark.slow)])
def test_a_unit_that_does_not_answer_is_told_by_name_and_the_other_is_stopped(line, how):
    rig, proxy = line
    if how == "cut":
        proxy.cut()
    else:
        proxy.hung.set()
    preload = []

    def fault():
        reading = rig.read(PARAMETERS)
        if reading is not None:
            preload.append(float(reading.daq["preload"][-1]))

    with pytest.raises(
        DriverError, match=r"^inverter.*without success for .* s; the safe command was not accepted: inverter"
    ):
        until(fault, "the fault")
    assert preload
    assert rig._safe_lines["preload_unit"]._line.read("enable") == 0.0


@pytest.mark.slow
def test_the_safe_command_of_a_hung_unit_fails_by_name_and_is_sent_to_the_others(line):
    rig, proxy = line
    proxy.hung.set()
    with pytest.raises(DriverError, match=r"^inverter\.control"):
        rig.make_safe()
    assert rig._safe_lines["preload_unit"]._line.read("enable") == 0.0


def test_the_safe_command_needs_nothing_that_a_hanging_read_holds(driver):
    arrive(driver, PARAMETERS)
    with driver._lock:  # as a `read` that never comes back would
        driver.make_safe()
    until(lambda: abs(next_reading(driver).daq["preload"][-1]) < 0.01, "no preload")


def test_a_stop_during_a_reset_is_not_undone_by_it(driver, monkeypatch):
    arrive(driver, PARAMETERS)
    wait = driver._wait_for_samples

    def stopped_meanwhile():
        driver.make_safe()
        wait()

    monkeypatch.setattr(driver, "_wait_for_samples", stopped_meanwhile)
    driver.reset()
    until(lambda: abs(next_reading(driver).daq["preload"][-1]) < 0.01, "no preload")
    for _ in range(50):
        assert abs(next_reading(driver).daq["preload"][-1]) < 0.01
    monkeypatch.undo()
    driver.reset()
    arrive(driver, PARAMETERS)


def test_a_reset_that_fails_and_a_close_after_it_command_the_units_to_stop(twin, tmp_path, monkeypatch):
    rig = HardwareRig()
    rig.open(PARAMETERS, with_counter(twin, tmp_path))
    arrive(rig, PARAMETERS)

    def gone(*_arguments, **_more):
        raise DriverError("no openDAQ device answers")

    commanded = []
    outside = HardwareRig.make_safe_from_outside
    monkeypatch.setattr(
        HardwareRig, "make_safe_from_outside", lambda *arguments: commanded.append(outside(*arguments[-1:]))
    )
    with monkeypatch.context() as patched:
        patched.setattr("squeal_rig.drivers.hardware.Streams", gone)
        with pytest.raises(DriverError, match="no openDAQ device answers"):
            rig.reset()
    assert len(commanded) == 1
    rig.close()
    assert len(commanded) == 2


def test_a_safe_command_longer_than_the_watchdogs_patience_is_refused(twin, tmp_path):
    settings = with_counter(twin, tmp_path, ("safe_timeout: 5.0", "safe_timeout: 0.5"))
    HardwareRig().capabilities(settings)
    with pytest.raises(ParameterError, match=r"safe_timeout = 0\.5 s lets a safe command last 1\.5 s"):
        HardwareRig().capabilities(dataclasses.replace(settings, supervisor_required=True))


def test_what_nobody_asks_for_in_time_is_dropped_with_a_sentence(twin, tmp_path):
    rig = HardwareRig()
    rig.open(PARAMETERS, with_counter(twin, tmp_path, ("queue: 60.0", "queue: 0.1")))
    first = next_reading(rig)
    until(lambda: rig._ready and rig._ready[0].lost > 512, "a full queue")
    second = next_reading(rig)
    assert second.daq["counter"][0] - first.daq["counter"][-1] == 1 + second.lost
    assert any("more slowly than they come" in sentence for sentence in second.warnings)
    rig.close()
