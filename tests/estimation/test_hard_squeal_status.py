"""The status of hard squeal: the numbers of the cycles' own functions, and a sentence where there are none."""

import numpy as np
import pytest

from squeal_rig.estimation import hard_squeal
from squeal_rig.estimation.settings import SquealSettings
from squeal_rig.estimation.squeal import SquealDetector
from squeal_rig.instruments.channels import DAQ_CHANNELS
from squeal_rig.model import RigParameters, safe_hit, simulate, smallest_hit, zone

DAMPED = RigParameters(preload=50.0, belt_speed=1.0, k1=4e7, k2=4e7, damping_x=1000.0, damping_y=1000.0)


def test_a_bistable_point_has_its_borders_its_hit_and_its_squeal():
    level, name, message, values = hard_squeal.hard_squeal(DAMPED)
    found, hit = zone(DAMPED), smallest_hit(DAMPED)
    assert (level, name, values["zone"]) == (1, "stability: hard squeal", "bistable")
    assert message == f"bistable: quiet until hit, a hit of {hit.impulse:.3g} N s starts squeal"
    assert float(values["mu beyond fold"]) == found.to_fold_mu
    assert float(values["mu beyond flutter"]) == found.to_flutter_mu
    assert float(values["cycle frequency [Hz]"]) == found.squeal.frequency
    assert float(values["smallest hit [N s]"]) == pytest.approx(hit.impulse, rel=1e-3)
    assert float(values["safe hit [N s]"]) == safe_hit(DAMPED) < hit.impulse


def test_the_expected_level_is_what_the_detector_measures():
    _, _, _, values = hard_squeal.hard_squeal(DAMPED)
    cycle = zone(DAMPED).squeal
    run = simulate(DAMPED, 0.5, 51200.0, cycle.state)
    daq = np.zeros(len(run.x), dtype=[(channel.name, channel.code) for channel in DAQ_CHANNELS])
    daq["x"], daq["seq"] = run.x, np.arange(len(run.x))
    states = SquealDetector(51200, SquealSettings()).add_samples(0, daq)
    assert states[-1].level == pytest.approx(float(values["cycle level [dB re 1 um]"]), abs=0.2)
    assert states[-1].frequency == pytest.approx(float(values["cycle frequency [Hz]"]), rel=1e-3)


def test_a_rig_that_squeals_by_itself_bears_no_hit():
    _, _, message, values = hard_squeal.hard_squeal(DAMPED.replace(mu0=0.9))
    assert message == "squeal: by itself"
    assert float(values["smallest hit [N s]"]) == float(values["safe hit [N s]"]) == 0.0


@pytest.mark.parametrize("changes", [{"damping_x": 0.0, "damping_y": 0.0}, {"friction_direction": "slip"}])
def test_what_has_no_zone_is_not_available_and_says_why(changes):
    level, _, message, values = hard_squeal.hard_squeal(DAMPED.replace(**changes))
    assert level == 0
    assert message.startswith("not available: ")
    assert values == {"hard squeal": "not available"}
