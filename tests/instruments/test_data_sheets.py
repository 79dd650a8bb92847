"""Data sheets: those that ship, and wrong ones refused in one sentence."""

import re

import pytest

from squeal_rig.catalogue.checking import check_file
from squeal_rig.configuration.files import config_directory
from squeal_rig.errors import ConfigurationError, ParameterError, SquealRigError
from squeal_rig.instruments.chain import Chain
from squeal_rig.instruments.channels import DAQ_CHANNELS
from squeal_rig.instruments.data_sheets import BLOCKS, Daq, DataSheets, data_sheet_names, load_data_sheets
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.instruments.tolerances import full_scale_of, noise_of, ripple_of
from squeal_rig.model import RigParameters


def test_the_shipped_sheets_are_in_order_and_complete():
    assert data_sheet_names() == ["ideal", "poor", "typical"]
    for name in data_sheet_names():
        path = config_directory() / "instruments" / f"{name}.yaml"
        assert check_file(path) == "data sheets of 9 channels"
        assert load_data_sheets(name).name == name
        assert load_data_sheets(str(path)) == load_data_sheets(name)
        for block in BLOCKS:
            assert re.search(rf"^{block}:", path.read_text(), re.MULTILINE), (name, block)


def test_every_channel_has_an_instrument():
    assert {channel.name for channel in DAQ_CHANNELS} == {"t", "seq", "motor_torque", *DataSheets().analog}


def test_ideal_sheets_promise_nothing_but_the_truth():
    ideal = load_data_sheets("ideal")
    assert ideal == DataSheets()
    assert noise_of(ideal, 51200) == full_scale_of(ideal) == ripple_of(ideal, RigParameters(), RigSettings()) == {}


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("arm_forces: {range: 1.0}\n", r"unknown block 'arm_forces': it must be one of arm_force, "),
        ("arm_force: {rang: 1.0}\n", r"sheet.yaml, arm_force: unknown parameter 'rang': did you mean 'range'\?"),
        ("arm_force: {range: -1.0}\n", r"arm_force: range = -1 N is out of bounds: it must be 0 to 1e\+09 N"),
        ("displacement: {noise_density: .nan}\n", r"noise_density = nan m/sqrt\(Hz\) is not finite"),
        ("belt_speed: {range: fast}\n", r"range = 'fast' is not a number: it must be 0 to 1e\+09 m/s"),
        ("motor_torque: {update_rate: 2.5}\n", r"update_rate = 2.5 is not an integer"),
        ("motor_torque: {update_rate: 10000000000}\n", r"update_rate = .* Hz is out of bounds"),
        (
            f"motor_torque: {{update_rate: {10**400}}}\n",
            r"update_rate = 10+ is out of bounds: it must be 0 to 1e\+06 Hz",
        ),
        ("motor_torque: {delay: 3600.0}\n", r"delay = 3600 s is out of bounds: it must be 0 to 1 s"),
        ("preload: {hysteresis: 0.01}\n", r"hysteresis is a share of the range, which is 0"),
        ("motor_torque: {offset: 0.01}\n", r"offset is a share of the range, which is 0"),
        ("daq: {bits: 24}\n", r"bits = 24 need an input range, but the sensor of x has none"),
        ("daq: {bits: 1}\n", r"bits = 1 holds no sign"),
        ("daq: {anti_alias_cutoff: 0.5}\n", r"anti_alias_cutoff = 0.5 share of the sample rate is out of bounds"),
        ("belt_drive: {run_out: 0.001}\n", r"run_out is of a drum that turns: it needs an inertia above 0 kg m\^2"),
        (
            "belt_drive: {inertia: 1.0e-9}\n",
            r"inertia = 1e-09 kg m\^2 is out of bounds: it must be 0 \(none\) or 0.0001",
        ),
        (
            "arm_force: {bandwidth: 1.0e-300}\n",
            r"bandwidth = 1e-300 Hz is out of bounds: it must be 0 \(none\) or 1 Hz",
        ),
        ("hydraulics: 3\n", r"hydraulics: expected a mapping of names to values, got 3"),
        ("- 1\n", r"data sheets are a mapping of arm_force, .* got \[1\]"),
        ("arm_force: {range: [1, 2]}\n", r"range = \[1, 2\] is not a number"),
        ("1: {range: 2}\n", r"unknown block '1'"),
        ("arm_force: {1: 2}\n", r"unknown parameter '1'"),
        ("arm_force: {range: &a 1}\nclip_force: {range: *a}\n", r"aliases"),
        ("arm_force: {", r"not valid YAML"),
    ],
)
def test_wrong_sheets_are_refused_in_one_sentence(tmp_path, text, sentence):
    path = tmp_path / "sheet.yaml"
    path.write_text(text)
    with pytest.raises(SquealRigError, match=sentence):
        load_data_sheets(str(path))


def test_what_is_left_out_is_ideal(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("displacement: {noise_density: 1.0e-9}\n")
    sheets = load_data_sheets(str(path))
    assert sheets.name == "mine"
    assert set(noise_of(sheets, 51200)) == {"x", "y"}
    assert sheets.daq == Daq()


def test_an_unknown_name_is_refused_with_those_there_are():
    with pytest.raises(ConfigurationError, match="instruments = 'best' is not known: there are ideal, poor, typical"):
        load_data_sheets("best")
    with pytest.raises(ConfigurationError, match=r"cannot read nowhere/best\.yaml"):
        load_data_sheets("nowhere/best.yaml")


def test_the_rigs_parameter_file_is_checked_with_its_sheets(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text("/**/rig:\n  ros__parameters:\n    instruments: best\n")
    with pytest.raises(ConfigurationError, match="instruments = 'best' is not known"):
        check_file(path)
    path.write_text("arm_force: {range: -1.0}\n")
    with pytest.raises(ParameterError, match="arm_force: range = -1 N"):
        check_file(path)


def test_a_specimen_stays_within_its_tolerances_and_differs_by_seed():
    sheets = load_data_sheets("poor")
    chains = [Chain(sheets, 51200, seed) for seed in range(50)]
    for channel, sheet in {**sheets.analog, "motor_torque": sheets.motor_torque}.items():
        errors = [chain.specimens[channel].sensitivity_error for chain in chains]
        assert max(map(abs, errors)) <= sheet.sensitivity_error
        assert min(errors) < -0.5 * sheet.sensitivity_error
        assert max(errors) > 0.5 * sheet.sensitivity_error
    assert Chain(sheets, 51200, 7).specimens == chains[7].specimens
    assert chains[0].specimens["arm_left"] != chains[0].specimens["arm_right"]
