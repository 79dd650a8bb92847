"""Parameters: what is accepted, what is refused and with which sentence, reading and writing YAML."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from squeal_rig.configuration.declared import declarations
from squeal_rig.errors import ConfigurationError, ParameterError, SquealRigError
from squeal_rig.model import RigParameters, preset_names

BAD_YAML = Path(__file__).parent / "bad_yaml"
MASS = "it must be 0.001 to 100000 kg"
NOT_A_MAPPING = "{file}: expected a mapping of parameter names to values, got "
PRESETS = "there are yavuz_sen_2023, yavuz_sen_2023_as_printed"
#: File in bad_yaml/ -> the sentence, as far as it is ours; what the YAML reader words itself is left out.
SENTENCES = {
    "angle_in_degrees": "{file}: arm_angle_1 = 135 rad is out of bounds: it must be -3.14159 to 3.14159 rad",
    "angle_just_above_pi": "{file}: arm_angle_2 = 3.14159265359 rad is out of bounds: it must be -3.14159 to ",
    "comment_only": NOT_A_MAPPING + "None",
    "empty": NOT_A_MAPPING + "None",
    "huge_integer": "{file}: mass = 1000000000",
    "impossible_date": "{file}: not valid YAML: ",
    "key_duplicate": '{file}, line 3: not valid YAML: found duplicate key "mass"',
    "key_misspelt": "{file}: unknown parameter 'prelaod': did you mean 'preload'?",
    "key_null": "{file}: unknown parameter 'None'",
    "key_number": "{file}: unknown parameter '1'",
    "key_of_python_only": "{file}: unknown parameter 'pad_stiffness'",
    "key_unknown": "{file}: unknown parameter 'colour'",
    "list_of_keys": NOT_A_MAPPING + "['mass', 'preload']",
    "mass_bool": "{file}: mass = True is not a number: " + MASS,
    "mass_date": "{file}: mass = datetime.date(2023, 1, 1) is not a number: " + MASS,
    "mass_list": "{file}: mass = [11.5] is not a number: " + MASS,
    "mass_mapping": "{file}: mass = {'value': 11.5} is not a number: " + MASS,
    "mass_nan": "{file}: mass = nan kg is not finite: " + MASS,
    "mass_negative": "{file}: mass = -11.5 kg is out of bounds: " + MASS,
    "mass_null": "{file}: mass = None is not a number: " + MASS,
    "mass_quoted": "{file}: mass = '11.5' is not a number: " + MASS,
    "mass_text": "{file}: mass = 'heavy' is not a number: " + MASS,
    "mass_with_unit": "{file}: mass = '11.5 kg' is not a number: " + MASS,
    "mass_zero": "{file}: mass = 0 kg is out of bounds: " + MASS,
    "not_utf8": "cannot read {file}: not UTF-8 text",
    "null_byte": "{file}: not valid YAML: ",
    "overflow": "{file}: k1 = inf N/m is not finite: it must be 0 to 1e+10 N/m",
    "preload_above_bound": "{file}: preload = 3000 N is out of bounds: it must be 0 to 2000 N",
    "preload_minus_inf": "{file}: preload = -inf N is not finite: it must be 0 to 2000 N",
    "preset_and_bad_value": "{file}: belt_speed = 21 m/s is out of bounds: it must be 0 to 20 m/s",
    "preset_empty": "{file}: no preset 'None': " + PRESETS,
    "preset_unknown": "{file}: no preset 'golf': " + PRESETS,
    "python_object": "{file}, line 1: not valid YAML: ",
    "scalar": NOT_A_MAPPING + "'mass'",
    "speed_negative": "{file}: belt_speed = -1 m/s is out of bounds: it must be 0 to 20 m/s",
    "stiffness_above_bound": "{file}: k1 = 100000000000 N/m is out of bounds: it must be 0 to 1e+10 N/m",
    "stiffness_inf": "{file}: contact_stiffness = inf N/m is not finite: it must be 0.001 to 1e+12 N/m",
    "switch_bool": "{file}: preload_direction = True is not a text: it must be one of vertical, arms",
    "switch_number": "{file}: friction_speed = 1 is not a text: it must be one of belt, slip",
    "switch_unknown": "{file}: friction_direction = 'backwards' is not known: it must be one of constant, slip",
    "tab_indent": "{file}, line 2: not valid YAML: ",
    "two_documents": "{file}, line 2: not valid YAML: ",
    "unclosed_bracket": "{file}, line 2: not valid YAML: ",
    "undefined_alias": "{file}, line 1: not valid YAML: ",
    "unknown_tag": "{file}, line 1: not valid YAML: ",
    "wrong_tag": "{file}: not valid YAML: ",
}


@pytest.mark.parametrize("path", sorted(BAD_YAML.glob("*.yaml")), ids=lambda path: path.stem)
def test_a_bad_file_is_refused_with_one_sentence_that_names_it(path):
    with pytest.raises(SquealRigError) as refusal:
        RigParameters.from_yaml(path)
    sentence = str(refusal.value)
    assert sentence.startswith(SENTENCES[path.stem].replace("{file}", str(path)))
    assert "\n" not in sentence


def test_every_expected_sentence_has_its_file():
    assert {path.stem for path in BAD_YAML.glob("*.yaml")} == set(SENTENCES)


def test_a_missing_file_and_a_folder_are_refused_with_a_sentence(tmp_path):
    with pytest.raises(ConfigurationError, match=r"^cannot read .*none\.yaml: No such file or directory$"):
        RigParameters.from_yaml(tmp_path / "none.yaml")
    with pytest.raises(ConfigurationError, match=r"^cannot read .*: Is a directory$"):
        RigParameters.from_yaml(tmp_path)


def test_a_file_nested_too_deeply_is_refused_with_a_sentence(tmp_path):
    path = tmp_path / "deep.yaml"
    path.write_text("mass: " + "[" * 5000, encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"not valid YAML: nested too deeply$"):
        RigParameters.from_yaml(path)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("6e7", 6e7),  # a number in YAML 1.2, a text in YAML 1.1
        ("6.0e+7", 6e7),
        ("6.0e7", 6e7),
        ("60000000", 6e7),
        ("60000000.0", 6e7),
        ("+6.0E+07", 6e7),
        ("0", 0.0),
        ("1.0e+10", 1e10),
    ],
)
def test_a_good_number_is_read_however_it_is_written(tmp_path, text, value):
    path = tmp_path / "good.yaml"
    path.write_text(f"k1: {text}\n", encoding="utf-8")
    p = RigParameters.from_yaml(path)
    assert p.k1 == value
    assert type(p.k1) is float
    assert p == RigParameters(k1=value)


def test_bounds_are_inclusive():
    for name, declaration in declarations(RigParameters).items():
        if declaration.kind is float:
            for bound in (declaration.lower, declaration.upper):
                assert getattr(RigParameters(**{name: bound}), name) == bound
            with pytest.raises(ParameterError, match=f"^{name} = "):
                RigParameters(**{name: math.nextafter(declaration.upper, math.inf)})
            with pytest.raises(ParameterError, match=f"^{name} = "):
                RigParameters(**{name: math.nextafter(declaration.lower, -math.inf)})


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, "1.0", None, True, [1.0], 1j])
@pytest.mark.parametrize(
    "name", [name for name, declared in declarations(RigParameters).items() if declared.kind is float]
)
def test_no_number_of_the_rig_can_be_anything_but_a_finite_number(name, bad):
    with pytest.raises(ParameterError, match=f"^{name} = "):
        RigParameters().replace(**{name: bad})


def test_numpy_numbers_and_integers_become_floats():
    p = RigParameters(mass=12, preload=np.float32(50.0), belt_speed=np.int64(2))
    assert [type(value) for value in (p.mass, p.preload, p.belt_speed)] == [float, float, float]


def declared_floats():
    return {
        name: st.floats(declared.lower, declared.upper)
        for name, declared in declarations(RigParameters).items()
        if declared.kind is float
    }


@settings(max_examples=60)
@given(
    st.fixed_dictionaries(
        {
            **declared_floats(),
            "friction_direction": st.sampled_from(["constant", "slip"]),
            "preload_direction": st.sampled_from(["vertical", "arms"]),
        }
    )
)
def test_yaml_round_trip_is_bit_for_bit_and_yaml_1_1_readers_see_numbers(tmp_path_factory, values):
    p = RigParameters(**values)
    path = tmp_path_factory.getbasetemp() / "round_trip.yaml"
    p.to_yaml(path)
    again = RigParameters.from_yaml(path)
    assert again == p
    pyyaml = yaml.safe_load(path.read_text(encoding="utf-8"))
    for field in dataclasses.fields(p):
        value, read = getattr(p, field.name), pyyaml[field.name]
        assert type(read) is type(value)
        if isinstance(value, float):
            assert read.hex() == value.hex() == getattr(again, field.name).hex()
        else:
            assert read == value


def test_the_defaults_are_the_calibrated_preset():
    assert RigParameters() == RigParameters.preset("yavuz_sen_2023")


def test_the_calibrated_preset_is_the_published_calibration():
    p = RigParameters.preset("yavuz_sen_2023")
    assert (p.contact_stiffness, p.k3, p.k4, p.mass) == (6.5074e8, 2.3250e8, 2.3250e8, 11.499)
    assert (p.mu0, p.mu_speed, p.mu_preload, p.mu_speed_preload) == (0.25010, 9.1366e-3, 2.3202e-3, -5.1639e-4)
    assert p.arm_angle_1 == p.arm_angle_2 == 27 * math.pi / 36
    assert (p.damping_x, p.damping_y) == (0.0, 0.0)
    assert (p.friction_direction, p.friction_speed, p.preload_direction) == ("constant", "belt", "vertical")


def test_the_preset_as_printed_differs_in_its_mirrored_right_arm_alone():
    printed = RigParameters.preset("yavuz_sen_2023_as_printed")
    assert printed.arm_angle_2 == pytest.approx(math.pi - printed.arm_angle_1, abs=1e-15)
    assert printed.replace(arm_angle_2=printed.arm_angle_1) == RigParameters.preset("yavuz_sen_2023")


def test_preset_names_are_those_that_can_be_loaded():
    variants = ("", "_as_printed", "_calibrated", "_mirrored")
    assert preset_names() == [f"yavuz_sen_2023{variant}" for variant in variants]
    with pytest.raises(ConfigurationError, match=r"^no preset '\.\./presets/yavuz_sen_2023': " + PRESETS):
        RigParameters.preset("../presets/yavuz_sen_2023")


def test_a_file_that_names_a_preset_lists_only_what_differs(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("preset: yavuz_sen_2023_as_printed\npreload: 300\n", encoding="utf-8")
    assert RigParameters.from_yaml(path) == RigParameters.preset("yavuz_sen_2023_as_printed").replace(preload=300.0)


def test_pad_stiffness_sets_both_arms():
    p = RigParameters(k1=1e7, k2=2e7).replace(pad_stiffness=6e7, preload=300.0)
    assert (p.k1, p.k2, p.preload) == (6e7, 6e7, 300.0)


def test_an_arm_named_beside_pad_stiffness_wins():
    p = RigParameters().replace(pad_stiffness=6e7, k2=5e7)
    assert (p.k1, p.k2) == (6e7, 5e7)


def test_replace_refuses_what_a_file_would():
    p = RigParameters()
    with pytest.raises(ParameterError, match=r"^unknown parameter 'pad_stifness': did you mean"):
        p.replace(pad_stifness=6e7)
    with pytest.raises(ParameterError, match=r"^k1 = -1 N/m is out of bounds: it must be 0 to 1e\+10 N/m$"):
        p.replace(pad_stiffness=-1.0)
    assert p == RigParameters()


def test_parameters_cannot_be_changed_in_place():
    with pytest.raises(dataclasses.FrozenInstanceError):
        RigParameters().mass = 1.0


def test_every_parameter_tells_its_unit_bounds_and_concern():
    for name, declared in declarations(RigParameters).items():
        assert declared.name == name
        assert declared.description
        assert declared.concern in ("machine", "contact", "friction law", "operating point")
        if declared.kind is float:
            assert math.isfinite(declared.lower)
            assert math.isfinite(declared.upper)
            assert declared.unit or name == "mu0"
        else:
            assert declared.default in declared.options
    assumed = {name for name, declared in declarations(RigParameters).items() if declared.assumed}
    assert {"arm_length_1", "arm_length_2", "pretension_length", "contact_smoothing"} <= assumed
