"""Bad values at run time: each is refused with a sentence by both services, and changes nothing."""

import math

import pytest

from squeal_rig.configuration.declared import declarations
from squeal_rig.instruments.settings import PresetChoice, RigSettings
from squeal_rig.model.parameters import RigParameters

pytest.importorskip("rclpy")

_NAMES = [name for kind in (PresetChoice, RigParameters, RigSettings) for name in declarations(kind)]
_CONSTANT = "cannot change while the rig is active"
_READ_ONLY = "read-only"
# rclpy looks at type and range first and words its own refusal.
_TYPE, _RANGE = "ype", "range"

# Name of the fact -> (what to set, all at once; a piece of the sentence).
BAD = {
    "nan": ({"preload": math.nan}, "value: nan"),
    "inf": ({"preload": math.inf}, _RANGE),
    "minus_inf": ({"mu0": -math.inf}, _RANGE),
    "negative_preload": ({"preload": -1.0}, _RANGE),
    "too_much_preload": ({"preload": 2000.1}, _RANGE),
    "too_fast_a_belt": ({"belt_speed": 1e3}, _RANGE),
    "belt_backwards": ({"belt_speed": -1.0}, _RANGE),
    "negative_stiffness": ({"k1": -4e7}, _RANGE),
    "zero_slew_rate": ({"preload_slew_rate": 0.0}, _RANGE),
    "nan_impact": ({"impact_impulse": math.nan}, "value: nan"),
    "integer_out_of_bounds": ({"preload": 2001}, _RANGE),
    "huge_integer": ({"preload": 2**62}, _RANGE),
    "text_for_a_number": ({"preload": "lots"}, _TYPE),
    "truth_value_for_a_number": ({"preload": True}, _TYPE),
    "list_for_a_number": ({"preload": [100.0, 200.0]}, _TYPE),
    "number_for_a_text": ({"friction_direction": 1.0}, _TYPE),
    "unknown_option": ({"friction_direction": "sideways"}, "must be one of constant, slip"),
    "unknown_key": ({"preloda": 100.0}, "unknown parameter 'preloda': did you mean 'preload'?"),
    "empty_name": ({"": 1.0}, ""),
    "negative_mass": ({"mass": -1.0}, _RANGE),
    "mass_while_active": ({"mass": 12.0}, f"mass is a constant of the machine: it {_CONSTANT}"),
    "contact_while_active": ({"contact_stiffness": 7e8}, f"a constant of the contact: it {_CONSTANT}"),
    "damping_while_active": ({"damping_x": 0}, f"damping_x is a constant of the machine: it {_CONSTANT}"),
    "preload_direction_while_active": ({"preload_direction": "arms"}, _CONSTANT),
    "preset": ({"preset": "yavuz_sen_2023_as_printed"}, _READ_ONLY),
    "driver": ({"driver": "virtual"}, _READ_ONLY),
    "sample_rate": ({"sample_rate": 10000}, _READ_ONLY),
    "real_time_factor": ({"real_time_factor": 2.0}, _READ_ONLY),
    "autostart": ({"autostart": False}, _READ_ONLY),
    "drum_radius": ({"drum_radius": 0.1}, _READ_ONLY),
    "negative_friction": ({"mu0": -1.0}, "the friction law gives mu = -0.9007 at preload = 50 N"),
    "negative_friction_point": ({"preload": 300.0, "belt_speed": 10.0}, "it must be 0 or more"),
    "one_bad_among_good": ({"preload": 100.0, "belt_speed": 2.0, "k1": math.nan}, "Parameter k1 out of range"),
}  # fmt: skip


@pytest.fixture
def unchanged(bench):
    """Compares parameters and description after the test with those before."""
    before = bench.observer.get(_NAMES), bench.observer.description()
    yield
    after = bench.observer.get(_NAMES), bench.observer.description()
    assert after == before
    assert bench.next_block().samples["preload"][-1] == 50.0


@pytest.mark.parametrize("name", BAD)
def test_a_bad_value_is_refused_by_set_parameters_atomically(bench, unchanged, name):
    values, sentence = BAD[name]
    (successful, reason), *rest = bench.observer.set(values, atomically=True)
    assert not successful
    assert not rest
    assert len(reason) > 10
    assert sentence in reason


@pytest.mark.parametrize("name", [name for name, (values, _) in BAD.items() if len(values) == 1])
def test_a_bad_value_is_refused_by_set_parameters(bench, unchanged, name):
    values, sentence = BAD[name]
    ((successful, reason),) = bench.observer.set(values)
    assert not successful
    assert len(reason) > 10
    assert sentence in reason


def test_a_parameter_cannot_be_deleted(bench, unchanged):
    from rcl_interfaces.msg import Parameter, ParameterValue

    nothing = Parameter(name="preload", value=ParameterValue())
    for atomically in (False, True):
        ((successful, reason),) = bench.observer.set({"preload": nothing}, atomically=atomically)
        assert not successful
        assert len(reason) > 10


def test_an_integer_is_taken_where_a_float_is_meant(bench):
    assert bench.observer.set({"preload": 60, "impact_impulse": 1}) == [(True, ""), (True, "")]
    assert bench.observer.set({"belt_speed": 2, "k1": 50_000_000}, atomically=True) == [(True, "")]
    now = bench.observer.get(["preload", "impact_impulse", "belt_speed", "k1"])
    assert now == {"preload": 60.0, "impact_impulse": 1.0, "belt_speed": 2.0, "k1": 5e7}
    assert all(isinstance(value, float) for value in now.values())
    assert bench.observer.description().parameters.k1 == 5e7


def test_set_parameters_takes_the_good_ones_and_refuses_the_bad_one(bench):
    results = bench.observer.set({"preload": 60.0, "belt_speed": math.nan, "mu0": 0.3})
    assert [successful for successful, _ in results] == [True, False, True]
    assert bench.observer.get(["preload", "belt_speed", "mu0"]) == {"preload": 60.0, "belt_speed": 1.0, "mu0": 0.3}


@pytest.mark.parametrize(
    ("node", "values"),
    [
        ("friction_estimator", {"window": 0.1}),
        ("friction_estimator", {"minimum_normal_load": 1.0}),
        ("friction_estimator", {"preload": 1.0}),
        ("squeal_detector", {"on_level": 0.0}),
        ("squeal_detector", {"band_low": "low"}),
        ("stability", {"window": 1.0}),
    ],
)
def test_the_other_nodes_refuse_too(bench, node, values):
    (name,) = values
    known = bench.observer.get([name], node)
    for atomically in (False, True):
        ((successful, reason),) = bench.observer.set(values, node, atomically)
        assert not successful
        assert len(reason) > 10
    assert bench.observer.get([name], node) == known
