"""The driver contract suite: every promise of `squeal_rig.instruments.driver.Driver`, for any driver.

    pytest --pyargs squeal_rig.testing.driver_contract --driver NAME [--driver-config FILE] [--rig-config FILE]

Set points that the driver says it can move are moved, a little way from those of the rig's configuration and to
nothing: on hardware, be there. Nothing is asserted of how long anything takes, but nothing is waited for longer than
`--patience`.
"""

from __future__ import annotations

import dataclasses
import itertools
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from squeal_rig.configuration.files import load_yaml
from squeal_rig.configuration.node_files import node_of, parameter_blocks
from squeal_rig.errors import DriverError, SquealRigError
from squeal_rig.instruments.acquisition import Acquisition, change_refusal
from squeal_rig.instruments.channels import DAQ_RECORD, TRUTH_RECORD
from squeal_rig.instruments.driver import Capabilities, Driver, Reading, driver_class
from squeal_rig.instruments.driver_config import check_driver_config
from squeal_rig.instruments.numbering import SEQ_MODULUS
from squeal_rig.instruments.settings import PresetChoice, RigSettings
from squeal_rig.model.parameters import RUN_TIME_PARAMETERS, RigParameters

METHODS = ("capabilities", "open", "close", "reset", "impact", "read", "make_safe")
# What no rig of this kind reaches in these units; micrometres or kilonewtons by mistake are far beyond or far below.
LARGEST = {
    "x": 0.1,
    "y": 0.1,
    **dict.fromkeys(("arm_left", "arm_right", "clip_left", "clip_right"), 1e6),
    "motor_torque": 1e5,
    "belt_speed": 100.0,
    "preload": 1e5,
}
BLOCKS = 8
# Share of a set point that what is measured may differ from it by, and what counts as nothing [N], [m/s].
CLOSE, NOTHING = 0.1, {"preload": 5.0, "belt_speed": 0.05}
LATEST = 2**31 * 10**9  # a stamp's seconds are an int32
MOMENT = 0.002


class Bench:
    """The driver under test with the rig's configuration, and how to wait for what it does."""

    def __init__(self, name: str, config: str, rig_config: str, patience: float) -> None:
        values = _rig_block(rig_config)
        preset = str(values.pop("preset", PresetChoice().preset))
        base = RigParameters.preset(preset).replace(damping_x=20.0, damping_y=20.0)
        of_rig = {key: values.pop(key) for key in list(values) if key in base.as_mapping()}
        self.parameters = RigParameters.from_mapping(of_rig, base)
        given = {**values, "driver": name, **({"driver_config": config} if config else {})}
        self.settings = RigSettings.from_mapping(given)
        self.name, self.patience = name, patience
        self.driver: Driver = driver_class(name)()
        self.can: Capabilities = self.driver.capabilities(self.settings)

    def until(self, condition: Callable[[], Any], what: str) -> Any:
        """The condition's value once it holds."""
        deadline = time.monotonic() + self.patience
        while not (value := condition()):
            assert time.monotonic() < deadline, f"{what}: not within {self.patience:g} s"
            time.sleep(MOMENT)
        return value

    def reading(self, driver: Driver, p: RigParameters) -> Reading:
        """The next block, waited for."""
        found: Reading = self.until(lambda: driver.read(p), "a block of samples")
        return found

    def readings(self, driver: Driver, count: int = BLOCKS) -> list[Reading]:
        """The next blocks at the configured operating point."""
        return [self.reading(driver, self.parameters) for _ in range(count)]

    def follows(self, driver: Driver, p: RigParameters, names: frozenset[str]) -> None:
        """Read until these channels are close to their set points."""
        goals = {name: getattr(p, name) for name in names}

        def arrived() -> bool:
            daq = self.reading(driver, p).daq
            return all(
                abs(float(daq[name].mean()) - goal) <= CLOSE * abs(goal) + NOTHING[name] for name, goal in goals.items()
            )

        self.until(arrived, f"{', '.join(names)} at the set points {goals}")


def _rig_block(path: str) -> dict[str, Any]:
    if not path:
        return {}
    blocks = parameter_blocks(load_yaml(path))
    return {name: value for key, values in blocks if node_of(key) in ("", "rig") for name, value in values.items()}


@pytest.fixture(scope="module")
def bench(request: pytest.FixtureRequest) -> Bench:
    """The driver by its name, not opened."""
    option = request.config.getoption
    return Bench(option("--driver"), option("--driver-config"), option("--rig-config"), option("--patience"))


@pytest.fixture
def driver(bench: Bench) -> Iterator[Driver]:
    """The driver, open."""
    bench.driver.open(bench.parameters, bench.settings)
    yield bench.driver
    bench.driver.close()


def movable(bench: Bench) -> frozenset[str]:
    """What of the operating point can be moved and is measured."""
    return bench.can.set_points & frozenset(NOTHING)


# --- what it says of itself


def test_it_has_every_method_and_is_made_without_arguments(bench: Bench) -> None:
    for method in METHODS:
        assert callable(getattr(bench.driver, method, None)), f"it has no method {method}"


def test_its_capabilities_are_the_same_when_asked_again_and_name_set_points_of_the_rig(bench: Bench) -> None:
    can = driver_class(bench.name)().capabilities(bench.settings)
    assert can == bench.can
    assert can.set_points <= RUN_TIME_PARAMETERS, "constants of the machine cannot move while it samples"
    for name in ("knows_truth", "can_hit", "keeps_time"):
        assert isinstance(getattr(can, name), bool), name


def test_every_set_point_that_it_cannot_move_is_refused_with_a_sentence(bench: Bench) -> None:
    for name in bench.parameters.as_mapping():
        assert (change_refusal(name, bench.can) is None) == (name in bench.can.set_points), name


def test_settings_of_another_driver_are_refused_by_name(bench: Bench, tmp_path: Path) -> None:
    foreign = tmp_path / "foreign.yaml"
    foreign.write_text("driver: some_other\n")
    with pytest.raises(SquealRigError, match="some_other"):
        check_driver_config(str(foreign), bench.name)


def test_a_setting_that_it_does_not_have_is_refused_by_name(bench: Bench, tmp_path: Path) -> None:
    odd = tmp_path / "odd.yaml"
    odd.write_text(f"driver: {bench.name}\nsteam_pressure: 3.0\n")
    with pytest.raises(SquealRigError, match="steam_pressure"):
        check_driver_config(str(odd), bench.name)


def test_before_it_is_opened_it_says_so(bench: Bench) -> None:
    fresh: Driver = driver_class(bench.name)()
    with pytest.raises(DriverError):
        fresh.read(bench.parameters)
    with pytest.raises(DriverError):
        fresh.reset()


# --- blocks


def test_a_block_has_every_channel_in_its_type_and_as_many_samples_as_a_block_has(bench: Bench, driver: Driver) -> None:
    for reading in bench.readings(driver):
        for samples, record in ((reading.daq, DAQ_RECORD), (reading.truth, TRUTH_RECORD)):
            if samples is None:
                continue
            assert samples.ndim == 1
            whole = bench.settings.block_size
            assert len(samples) == whole or len(samples) + reading.lost == whole, "what is missing was lost"
            assert samples.dtype.itemsize % 8 == 0
            assert samples.flags.writeable, "the rig fills t and seq"
            for name in record.names or ():
                assert samples.dtype[name] == record[name], name
        assert (reading.truth is not None) == bench.can.knows_truth
        assert all(isinstance(sentence, str) for sentence in reading.warnings)


def test_what_it_reads_is_finite_and_in_the_channels_units(bench: Bench, driver: Driver) -> None:
    for reading in bench.readings(driver):
        for name, largest in LARGEST.items():
            values = reading.daq[name]
            assert np.all(np.isfinite(values)), name
            assert float(np.max(np.abs(values))) < largest, f"{name}: not in its unit"


def test_a_block_that_was_given_away_is_never_written_again(bench: Bench, driver: Driver) -> None:
    first = bench.reading(driver, bench.parameters)
    kept = first.daq.copy()
    bench.readings(driver)
    assert np.array_equal(first.daq, kept)


def test_stamps_are_the_devices_time_or_left_to_the_rig(bench: Bench, driver: Driver) -> None:
    readings = bench.readings(driver)
    if not bench.can.keeps_time:
        assert all(reading.stamp is None and reading.lost >= 0 for reading in readings)
        return
    rate = bench.settings.sample_rate
    for before, after in itertools.pairwise(readings):
        assert isinstance(after.stamp, int)
        assert isinstance(before.stamp, int)
        assert 0 <= before.stamp < after.stamp < LATEST
        assert after.lost >= 0
        if not after.warnings:
            expected = (len(before.daq) + after.lost) * 10**9 / rate
            assert abs(after.stamp - before.stamp - expected) <= 1e6 + 10**9 / rate, "1 ms and a sample"


def test_a_driver_that_keeps_time_has_no_block_before_it_was_sampled(bench: Bench, driver: Driver) -> None:
    if bench.can.keeps_time:
        bench.reading(driver, bench.parameters)
        bench.until(lambda: driver.read(bench.parameters) is None, "a moment without a block")


def test_samples_are_numbered_and_what_was_lost_is_missing(bench: Bench) -> None:
    acquisition = Acquisition(bench.driver, bench.parameters, bench.settings)
    acquisition.start(10**18)
    following: int | None = None
    for _ in range(BLOCKS):
        before = acquisition.samples
        block = bench.until(acquisition.poll, "a block of samples")
        seq = block.daq["seq"]
        lost = acquisition.samples - before - len(seq)
        if following is not None:
            assert int(seq[0]) == (following + lost) % SEQ_MODULUS
        assert np.all(np.diff(seq.astype(np.int64)) == 1)
        following = (int(seq[-1]) + 1) % SEQ_MODULUS
    acquisition.close()


# --- set points, hits, the safe state


def test_set_points_that_it_can_move_are_followed(bench: Bench, driver: Driver) -> None:
    names = movable(bench)
    if not names:
        pytest.skip("it moves neither preload nor belt speed")
    bench.follows(driver, bench.parameters, names)
    moved = bench.parameters.replace(**{name: 1.5 * getattr(bench.parameters, name) for name in names})
    bench.follows(driver, moved, names)
    bench.follows(driver, bench.parameters, names)


def test_a_hit_is_given_or_refused(bench: Bench, driver: Driver) -> None:
    bench.readings(driver, 2)
    if bench.can.can_hit:
        driver.impact(0.0, -0.01)
        bench.readings(driver, 2)
    else:
        with pytest.raises(DriverError):
            driver.impact(0.0, -0.01)


def test_made_safe_from_another_thread_while_it_is_read_it_obeys_nobody_until_reset(
    bench: Bench, driver: Driver
) -> None:
    names = movable(bench)
    bench.follows(driver, bench.parameters, names)
    errors: list[BaseException] = []

    def make_safe() -> None:
        try:
            driver.make_safe()
            driver.make_safe()  # a second time changes nothing
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=make_safe, daemon=True)
    thread.start()
    bench.until(lambda: bench.readings(driver, 1) and not thread.is_alive(), "the end of make_safe")
    assert not errors, errors
    rest = bench.parameters.replace(preload=0.0, belt_speed=0.0)

    def at_rest() -> bool:
        daq = bench.reading(driver, bench.parameters).daq  # set points that are not to be obeyed
        return all(abs(float(daq[name].mean()) - getattr(rest, name)) <= NOTHING[name] for name in names)

    bench.until(at_rest, f"{', '.join(names)} at nothing")
    for _ in range(BLOCKS):
        assert at_rest()
    driver.reset()
    bench.follows(driver, bench.parameters, names)


def test_a_reset_gives_blocks_again(bench: Bench, driver: Driver) -> None:
    bench.readings(driver, 2)
    driver.reset()
    bench.readings(driver)


def test_the_safe_state_can_be_commanded_before_opening_and_after_closing(bench: Bench) -> None:
    fresh: Driver = driver_class(bench.name)()
    fresh.capabilities(bench.settings)
    with suppress(DriverError):  # it may say that nothing is there to command
        fresh.make_safe()
    fresh.open(bench.parameters, bench.settings)
    bench.readings(fresh, 1)
    fresh.close()
    with suppress(DriverError):
        fresh.make_safe()
    fresh.close()


def test_the_safe_state_can_be_commanded_from_outside(bench: Bench, driver: Driver) -> None:
    outside = getattr(driver_class(bench.name), "make_safe_from_outside", None)
    if outside is None:
        pytest.skip("it has no make_safe_from_outside: nothing stands behind it, or a watchdog cannot stop it")
    bench.readings(driver, 2)
    outside(bench.settings)
    driver.reset()
    bench.follows(driver, bench.parameters, movable(bench))


def test_it_can_be_closed_and_opened_again(bench: Bench) -> None:
    for _ in range(2):
        bench.driver.open(bench.parameters, bench.settings)
        bench.readings(bench.driver, 3)
        bench.driver.close()
    with pytest.raises(DriverError):
        bench.driver.read(bench.parameters)
    bench.driver.close()


def test_readings_stand_alone(bench: Bench, driver: Driver) -> None:
    """A reading is frozen: what the rig has of it, nobody changes behind its back."""
    reading = bench.reading(driver, bench.parameters)
    with pytest.raises(dataclasses.FrozenInstanceError):
        reading.lost = 1  # type: ignore[misc]
