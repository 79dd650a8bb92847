"""Long series through the data sheets `typical`: false alarms of squeal, and coverage of the law's coefficients."""

import numpy as np
import pytest

from squeal_rig.estimation.settings import SquealSettings, ToneSettings
from squeal_rig.estimation.squeal import SquealDetector
from squeal_rig.estimation.squeal_events import SquealEvents
from squeal_rig.instruments.acquisition import Acquisition
from squeal_rig.instruments.chain import Chain
from squeal_rig.instruments.data_sheets import DataSheets, load_data_sheets
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.instruments.virtual import VirtualRig
from squeal_rig.model import RigParameters
from squeal_rig.studies.friction_bias.campaign import coverage, described, repeats

SLIDING = RigParameters().replace(damping_x=20.0, damping_y=20.0, pad_stiffness=1e7)


def alarms(instruments: str, minutes: float, p: RigParameters) -> int:
    """Windows and tones called squeal while the rig slides steadily, 51.2 kHz through every instrument.

    Ten seconds of motion with the sheets' actuators, read again and again by instruments that go on.
    """
    sheets, settings = load_data_sheets(instruments), RigSettings()
    rig = Acquisition(VirtualRig(DataSheets(hydraulics=sheets.hydraulics, belt_drive=sheets.belt_drive)), p, settings)
    rig.start(0)
    for _ in range(200):
        rig.next_block()
    stretch = [rig.next_block().daq for _ in range(1000)]
    chain, detector = Chain(sheets, settings.sample_rate, 1), SquealDetector(settings.sample_rate, SquealSettings())
    tones = SquealEvents(settings.sample_rate, SquealSettings(), ToneSettings())
    detector.take_rig(described(p, sheets, settings))
    called, seq = 0, 0
    for number in range(round(minutes * 6000)):
        seen = stretch[number % len(stretch)].copy()
        chain.measure(seen)
        seen["seq"] = (seq + np.arange(len(seen))) % 2**32
        seq += len(seen)
        called += sum(state.detected for state in detector.add_samples(0, seen))
        tones.add_samples(seen)
    return called + tones.count


@pytest.mark.long
@pytest.mark.parametrize("instruments", ["typical", "poor"])
def test_thirty_minutes_of_stable_running_raise_no_alarm(instruments: str):
    assert alarms(instruments, 30.0, SLIDING.replace(preload=50.0)) == 0


@pytest.mark.long
def test_intervals_of_the_laws_coefficients_cover_as_often_as_they_say():
    # Seeds that the intervals were not made with. Seen: 0.955, 0.960, 0.975, 0.985 in the first 200 and 0.950, 0.965,
    # 0.970, 0.975 in the others; a binomial of 200 scatters by 0.015 about 0.95.
    shares = coverage(list(repeats(SLIDING, load_data_sheets("typical"), range(200, 600))), SLIDING)
    assert all(0.91 <= share <= 0.98 for share in shares.values()), shares


@pytest.mark.slow
def test_a_campaign_through_typical_instruments_gives_every_coefficient_an_interval_that_holds_it():
    (model,) = repeats(SLIDING, load_data_sheets("typical"), range(3, 4))
    assert model.operating_points == 12
    for name, value in model.coefficients.items():
        assert 0.0 < model.systematic[name] < model.half_widths[name]
        # Twice the half width: one specimen in twenty lies outside of it.
        assert abs(value - getattr(SLIDING, name)) <= 2.0 * model.half_widths[name]
