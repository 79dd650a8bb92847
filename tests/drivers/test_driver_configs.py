"""Drivers' own YAML files: what ships is in order, what is wrong is said in one sentence."""

from pathlib import Path

import pytest

from squeal_rig.catalogue.checking import check_file
from squeal_rig.configuration.files import config_directory
from squeal_rig.drivers.hardware_settings import load_hardware
from squeal_rig.errors import SquealRigError

SHIPPED = sorted((config_directory() / "drivers").glob("*.yaml"))
GOOD = (config_directory() / "drivers" / "twin.yaml").read_text()

WRONG = {
    "no device": (('connection: "daq.ns://127.0.0.1:17420"', ""), "connection = '' names no device"),
    "unknown key": (("channels:", "stale_afer: 1.0\nchannels:"), "unknown parameter 'stale_afer': did you mean"),
    "channel left out": (("  y:            {signal: y, unit: m, scale: 1.0e-6}\n", ""), "channels says nothing of y"),
    "two sources": (
        ("{signal: arm_left, unit: N}", "{signal: arm_left, fixed: 0.0}"),
        "exactly one of signal, register",
    ),
    "no source": (("{signal: arm_left, unit: N}", "{unit: N}"), "channels.arm_left: exactly one of"),
    "wrong unit": (
        ("{signal: arm_left, unit: N}", "{signal: arm_left, unit: kN}"),
        "unit = 'kN', but the channel is in N",
    ),
    "sign": (("{signal: arm_left, unit: N}", "{signal: arm_left, unit: N, sign: 0}"), "sign = 0 must be 1 or -1"),
    "sign bound": (("{signal: arm_left, unit: N}", "{signal: arm_left, unit: N, sign: 7}"), "must be -1 to 1"),
    "text for a number": (("scale: 1.0e-6}            #", "scale: big}   #"), "scale = 'big' is not a number"),
    "seq": (("channels:\n", "channels:\n  seq: {signal: counter}\n"), "channels.seq: the rig itself fills it"),
    "no such register": (("register: inverter.torque", "register: inverter.turning"), "no register 'inverter.turning'"),
    "set point of the pad": (
        ("belt_speed: inverter.speed\n", "mu0: inverter.speed\n"),
        "set_points.mu0: there is no such set point",
    ),
    "set point to an input": (
        ("preload: preload_unit.command\n", "preload: preload_unit.force\n"),
        "preload_unit.force is an input register",
    ),
    "set point in another unit": (
        ("word_order: little, unit: N}\n      force", "word_order: little, unit: kN}\n      force"),
        "preload_unit.command is in 'kN', but N is needed",
    ),
    "function": (("type: uint16, write_function: 6}", "type: uint16, write_function: 5}"), "write_function = 5"),
    "function 7": (("type: uint16, write_function: 6}", "type: uint16, write_function: 7}"), "must be 6 or 16"),
    "function 6 of a float": (
        (
            "command: {address: 1, type: float32, word_order",
            "command: {address: 1, write_function: 6, type: float32, word_order",
        ),
        "write_function = 6 writes 16 bits",
    ),
    "address": (("control:      {address: 0", "control:      {address: 70000"), "address = 70000"),
    "type": (("type: int16, write_function", "type: bcd, write_function"), "type = 'bcd' is not known"),
    "nothing safe": (("    safe: [{control: 0}, {speed: 0.0}]\n", ""), "safe says nothing"),
    "safe is no list": (("safe: [{control: 0}, {speed: 0.0}]", "safe: 0"), "a list of at most 32 writes"),
    "safe names no register": (("safe: [{control: 0}, ", "safe: [{brake: 1}, "), "'brake' is no holding register"),
    "safe value": (("safe: [{control: 0}, ", "safe: [{control: off}, "), "control = 'off' is not a number"),
    "safe value too large": (
        ("safe: [{control: 0}, ", "safe: [{control: 70000}, "),
        "does not fit",
    ),
    "fixed without end": (("{signal: arm_left, unit: N}", "{fixed: .inf}"), "fixed = inf is not finite"),
    "fixed and huge": (("{signal: arm_left, unit: N}", "{fixed: " + "9" * 400 + "}"), "fixed = 999"),
    "fixed and more": (
        ("{signal: arm_left, unit: N}", "{fixed: 0.0, unit: N, sign: -1}"),
        "fixed stands alone, one number in N: without effect beside it: sign, unit",
    ),
    "fixed text": (("{signal: arm_left, unit: N}", "{fixed: none}"), "fixed = 'none' is not a number"),
    "no host": (("    host: 127.0.0.1\n", ""), "host = '' names no address"),
    "another driver": (("driver: opendaq", "driver: opendoc"), "driver = 'opendoc' is not known"),
    "delay of a register": (
        ('torque, unit: "N m"}\n  belt', 'torque, unit: "N m", delay: 3}\n  belt'),
        "delay is for signals",
    ),
}


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_files_that_ship_are_in_order(path: Path):
    assert check_file(path) == f"settings of the driver {_driver_of(path)!r}"


def _driver_of(path):
    return next(line.split()[1] for line in path.read_text().splitlines() if line.startswith("driver:"))


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_said_in_one_sentence(name, tmp_path):
    (old, new), sentence = WRONG[name]
    assert old in GOOD
    file = tmp_path / "rig.yaml"
    file.write_text(GOOD.replace(old, new))
    with pytest.raises(SquealRigError) as caught:
        check_file(file)
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_only_signals_make_blocks(tmp_path):
    file = tmp_path / "rig.yaml"
    file.write_text(
        "driver: opendaq\nconnection: daq.ns://127.0.0.1\nchannels:\n"
        + "".join(
            f"  {name}: {{fixed: 0.0}}\n"
            for name in "x y arm_left arm_right clip_left clip_right motor_torque belt_speed preload".split()
        )
    )
    with pytest.raises(SquealRigError, match="no channel comes from a signal"):
        load_hardware(str(file))


def test_channels_beside_the_rigs_become_columns_and_fixed_ones_are_told(tmp_path):
    file = tmp_path / "rig.yaml"
    text = GOOD.replace("{signal: clip_left, unit: N}", "{fixed: 0.5}")
    file.write_text(text.replace("set_points:", '  temperature: {signal: t1, unit: "degC"}\nset_points:'))
    config = load_hardware(str(file))
    block = config.empty_block(7)
    assert block.shape == (7,)
    assert "temperature" in block.dtype.names
    assert set(block["clip_left"]) == {0.5}
    assert list(config.fixed) == ["clip_left"]
    assert block.dtype.itemsize % 8 == 0


def test_a_parameter_file_names_a_drivers_file_that_is_checked_with_it(tmp_path):
    broken = tmp_path / "driver.yaml"
    broken.write_text(GOOD.replace("signal: y", "sginal: y"))
    rig = tmp_path / "rig.yaml"
    rig.write_text(f"/**/rig:\n  ros__parameters:\n    driver: opendaq\n    driver_config: {broken}\n")
    with pytest.raises(SquealRigError, match=r"driver\.yaml"):
        check_file(rig)


@pytest.mark.parametrize("driver", ["virtual", "bag", "opendaq"])
def test_a_file_for_another_driver_is_refused(driver, tmp_path):
    file = tmp_path / "driver.yaml"
    file.write_text("driver: somebody\n")
    rig = tmp_path / "rig.yaml"
    rig.write_text(f"/**/rig:\n  ros__parameters:\n    driver: {driver}\n    driver_config: {file}\n")
    with pytest.raises(SquealRigError, match=f"driver = 'somebody', and it is read for the driver {driver!r}"):
        check_file(rig)
