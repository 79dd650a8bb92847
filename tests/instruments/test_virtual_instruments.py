"""The virtual rig behind its data sheets: what is in force moves the pad, truth stays true."""

import dataclasses

import numpy as np
import pytest

from squeal_rig.configuration.files import dump_yaml
from squeal_rig.errors import ParameterError
from squeal_rig.instruments.acquisition import Acquisition
from squeal_rig.instruments.data_sheets import load_data_sheets
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.numbering import Numbering
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.instruments.tolerances import full_scale_of, noise_of, ripple_of
from squeal_rig.instruments.virtual import VirtualRig
from squeal_rig.model import RigParameters
from squeal_rig.model.core.law import friction_coefficient

P = RigParameters().replace(damping_x=20.0, damping_y=20.0)


def rig(instruments: str, parameters: RigParameters = P, **settings: object) -> Acquisition:
    made = Acquisition(VirtualRig(), parameters, RigSettings(instruments=instruments, **settings))
    made.start(10**18)
    return made


def sheet(tmp_path, **blocks: object) -> str:
    path = tmp_path / "sheet.yaml"
    path.write_text(dump_yaml(blocks))
    return str(path)


def equal(a, b) -> bool:
    return all(np.array_equal(a[name], b[name]) for name in a.dtype.names)


def together(made: Acquisition, blocks: int):
    read = [made.next_block() for _ in range(blocks)]
    return np.concatenate([block.daq for block in read]), np.concatenate([block.truth for block in read])


def test_sensors_change_what_is_read_and_not_what_happens(tmp_path):
    path = sheet(tmp_path, arm_force={"noise_density": 0.1}, displacement={"noise_density": 1e-9})
    (daq, truth), (true_daq, same) = together(rig(path), 10), together(rig("ideal"), 10)
    assert equal(truth, same)
    assert not np.any(daq["x"] == true_daq["x"])
    assert np.array_equal(daq["clip_left"], true_daq["clip_left"])


def test_the_same_seed_gives_the_same_run():
    first, again, other = (together(rig("poor", instruments_seed=seed), 5)[0] for seed in (3, 3, 4))
    assert equal(first, again)
    assert not np.array_equal(first["arm_left"], other["arm_left"])


def test_the_law_sees_the_preload_that_is_really_in_force(tmp_path):
    path = sheet(tmp_path, hydraulics={"ripple": 0.1, "ripple_frequency": 90.0})
    daq, truth = together(rig(path), 20)
    assert daq["preload"].max() == pytest.approx(55.0, rel=0.01)
    assert daq["preload"].min() == pytest.approx(45.0, rel=0.01)
    for sample in range(0, len(daq), 500):
        assert truth["mu"][sample] == pytest.approx(friction_coefficient(P, preload=float(daq["preload"][sample])))
    assert list(np.flatnonzero(np.diff(daq["preload"][:512]))) == list(range(63, 511, 64))  # pieces of 64 samples
    assert np.std(truth["normal_force"]) > 1.0


def test_the_motors_torque_carries_the_drum(tmp_path):
    path = sheet(tmp_path, belt_drive={"inertia": 0.3, "control_bandwidth": 20.0})
    made = rig(path)
    daq, truth = together(made, 20)
    assert daq["motor_torque"] == pytest.approx(truth["tangential_force"] * made.settings.drum_radius, rel=1e-3)
    made.set_point = P.replace(belt_speed=3.0)
    daq, truth = together(made, 30)
    inertia = daq["motor_torque"][-512:] - truth["tangential_force"][-512:] * 0.05
    assert inertia == pytest.approx(0.3 * made.settings.belt_acceleration / 0.05, rel=0.02)


def test_made_safe_preload_and_belt_follow_their_inertia():
    made = rig("typical", preload_slew_rate=1e4, belt_acceleration=50.0)
    made.next_block()
    made.make_safe()
    daq, _ = together(made, 150)
    assert daq["preload"][0] > 40.0  # not at once
    assert daq["belt_speed"][0] > 0.9
    assert abs(daq["preload"][-512:].mean()) < 1.0
    assert abs(daq["belt_speed"][-512:].mean()) < 0.05


def test_a_gap_shows_in_the_numbers_and_in_the_stamps(tmp_path):
    made = rig(sheet(tmp_path, daq={"drop_rate": 20.0, "drop_length": 0.002}))
    blocks = [made.next_block() for _ in range(100)]
    numbering = Numbering()
    for block in blocks:
        begin, restarted = numbering.take(block.stamp, block.daq, 51200)
        assert not restarted
        assert block.stamp == 10**18 + begin * 10**9 // 51200
        assert len(block.daq) == len(block.truth)
    lost = 51200 - sum(len(block.daq) for block in blocks)
    assert lost > 0
    assert lost % 102 == 0
    assert numbering.lost_samples == lost - int(blocks[0].daq["seq"][0])
    assert made.samples == 51200


def test_a_clock_that_is_off_shows_in_the_frequency(tmp_path):
    # The pad's motion in squeal is the same, sampled faster or slower by clock_error: f is told as f / (1 + error).
    p = P.replace(preload=300.0)
    path = sheet(tmp_path, daq={"clock_error": 1000.0})
    frequencies, errors = [], []
    for instruments in ("ideal", path):
        made = rig(instruments, p, instruments_seed=4)
        made.impact()
        together(made, 300)
        daq, _ = together(made, 200)
        x = daq["x"] - daq["x"].mean()
        phase = np.unwrap(np.angle(analytic(x)))
        frequencies.append(np.polyfit(np.arange(len(phase)), phase, 1)[0])
        errors.append(made._driver._chain.clock_error)  # type: ignore[attr-defined]
    assert 1e-4 < abs(errors[1]) <= 1e-3
    assert frequencies[1] / frequencies[0] - 1.0 == pytest.approx(1.0 / (1.0 + errors[1]) - 1.0, rel=0.05)


def analytic(x):
    spectrum = np.fft.fft(x * np.hanning(len(x)))
    spectrum[len(x) // 2 :] = 0.0
    peak = np.argmax(np.abs(spectrum))
    spectrum[: peak - 200] = spectrum[peak + 200 :] = 0.0
    return np.fft.ifft(spectrum)[len(x) // 4 : -len(x) // 4]


@pytest.mark.parametrize("name", ["typical", "poor"])
def test_what_the_description_promises_holds_in_a_run(name):
    made = rig(name)
    sheets = load_data_sheets(name)
    together(made, 100)
    daq, _ = together(made, 60)
    noise, ripple = noise_of(sheets, 51200), ripple_of(sheets, P, made.settings)
    for channel in ("x", "y", "arm_left", "arm_right", "clip_left", "clip_right"):
        assert np.std(daq[channel]) == pytest.approx(noise[channel], rel=0.1), channel
    for channel, amplitude in ripple.items():
        bound = noise[channel] ** 2 + 0.5 * amplitude**2
        assert 0.9 * noise[channel] ** 2 < np.var(daq[channel]) < 1.15 * bound, channel
    description = RigDescription(P, instruments=name, noise=noise, ripple=ripple, full_scale=full_scale_of(sheets))
    assert RigDescription.from_yaml(description.to_yaml()) == description


@pytest.mark.parametrize("rate", [1000, 44100, 200_000])
def test_typical_instruments_at_other_sample_rates(rate):
    daq, truth = together(rig("typical", sample_rate=rate), 5)
    assert all(np.all(np.isfinite(daq[name])) for name in daq.dtype.names)
    assert daq["arm_left"].mean() == pytest.approx(236.0, rel=0.02)
    assert truth["mu"].mean() == pytest.approx(friction_coefficient(P), rel=1e-3)


def test_wrong_sheets_stop_the_opening_in_one_sentence(tmp_path):
    with pytest.raises(ParameterError, match="arm_force: range = -1 N is out of bounds"):
        rig(sheet(tmp_path, arm_force={"range": -1.0}))


def test_opening_twice_begins_anew():
    driver, settings = VirtualRig(), RigSettings(instruments="typical")
    readings = []
    for _ in range(2):
        driver.open(P, settings)
        readings.append(driver.read(P))
    assert equal(readings[0].daq, readings[1].daq)
    assert dataclasses.replace(readings[0]).lost == 0
