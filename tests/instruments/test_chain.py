"""The chain of instruments against theory: each effect alone, by the numbers of its data sheet."""

import dataclasses
import math

import numpy as np
import pytest
from scipy import signal, stats

from squeal_rig.instruments import chain as chains
from squeal_rig.instruments.chain import Chain, Filter, anti_alias, noise_gain, report_noise_gain, sensor_low_pass
from squeal_rig.instruments.channels import DAQ_RECORD
from squeal_rig.instruments.data_sheets import (
    Daq,
    DataSheets,
    DisplacementSensor,
    Environment,
    ForceSensor,
    TorqueReport,
    load_data_sheets,
)
from squeal_rig.instruments.tolerances import noise_of

RATE = 51200


def measured(sheets: DataSheets, channel: str, true, rate: int = RATE, seed: int = 1, block: int = 0):
    """What a channel shows of true values (n,), measured in blocks of so many samples (0: at one go)."""
    chain = Chain(sheets, rate, seed)
    return taken(chain, channel, true, block)


def taken(chain: Chain, channel: str, true, block: int = 0):
    out = np.zeros(len(true), DAQ_RECORD)
    out[channel] = true
    for first in range(0, len(true), block or len(true)):
        chain.measure(out[first : first + (block or len(true))])
    return np.array(out[channel])


def of_arms(**fields: object) -> DataSheets:
    return DataSheets(arm_force=ForceSensor.from_mapping(fields))


def of_torque(**fields: object) -> DataSheets:
    return DataSheets(motor_torque=TorqueReport.from_mapping(fields))


# --- the chain as a whole


def same(a, b):
    """Whether two records agree in every field; the bytes between fields are nobody's."""
    return all(np.array_equal(a[name], b[name]) for name in a.dtype.names)


SIZES = {
    "x": 1e-5,
    "y": 1e-5,
    "arm_left": 600.0,
    "arm_right": 600.0,
    "clip_left": 2000.0,
    "clip_right": 2000.0,
    "motor_torque": 30.0,
    "belt_speed": 1.0,
    "preload": 300.0,
}


def everything(n: int, seed: int = 3):
    random = np.random.default_rng(seed)
    true = np.zeros(n, DAQ_RECORD)
    for channel, size in SIZES.items():
        true[channel] = size * (0.5 + 0.3 * np.cumsum(random.standard_normal(n)) / math.sqrt(n))
    return true


@pytest.mark.parametrize("name", ["typical", "poor"])
@pytest.mark.parametrize("block", [1, 7, 512, 1000])
def test_samples_do_not_depend_on_how_they_are_divided_into_blocks(name, block):
    sheets, n = load_data_sheets(name), 1200
    whole, pieces = everything(n), everything(n)
    Chain(sheets, RATE, 5).measure(whole)
    divided = Chain(sheets, RATE, 5)
    for first in range(0, n, block):
        divided.measure(pieces[first : first + block])
    assert same(whole, pieces)
    assert not same(whole, everything(n))


def test_ideal_instruments_change_no_bit():
    true = everything(2000)
    true["x"][3], true["arm_left"][4] = -0.0, 5e-324
    seen = true.copy()
    Chain(load_data_sheets("ideal"), RATE, 1).measure(seen)
    assert same(seen, true)
    assert np.signbit(seen["x"][3])


def test_another_seed_is_another_noise_and_the_same_seed_the_same():
    sheets = of_arms(noise_density=1.0)
    zeros = np.zeros(1000)
    first, again, other = (measured(sheets, "arm_left", zeros, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert abs(np.corrcoef(first, other)[0, 1]) < 4.0 / math.sqrt(1000)
    both = np.zeros(1000, DAQ_RECORD)
    Chain(sheets, RATE, 1).measure(both)
    assert abs(np.corrcoef(both["arm_left"], both["arm_right"])[0, 1]) < 4.0 / math.sqrt(1000)


# --- noise


def test_noise_density_is_that_of_the_sheet_by_welch():
    # K periodograms of segments without overlap: each bin is density^2 chi^2_{2K} / 2K.
    segment, count, density = 512, 400, 2.5e-10
    noise = measured(
        DataSheets(displacement=DisplacementSensor(noise_density=density)), "x", np.zeros(segment * count), block=512
    )
    _, found = signal.welch(noise, RATE, "boxcar", segment, noverlap=0, detrend=False)
    bins = found[1:-1] / density**2
    low, high = stats.chi2.ppf([0.5e-6, 1.0 - 0.5e-6], 2 * count) / (2 * count)  # 255 bins: 3e-4 that one is outside
    assert low < bins.min()
    assert bins.max() < high
    total = stats.chi2.ppf([1e-6, 1.0 - 1e-6], segment * count) / (segment * count)
    assert total[0] < noise.var() / (density**2 * RATE / 2) < total[1]
    assert np.mean(bins) != pytest.approx(1.1, abs=0.05)  # a tenth more density would be seen


@pytest.mark.parametrize("rate", [10_000, 51200])
@pytest.mark.parametrize("name", ["typical", "poor"])
def test_noise_of_the_description_is_that_of_a_run(name, rate):
    sheets = load_data_sheets(name)
    promised = noise_of(sheets, rate)
    n = 40_000
    still = np.zeros(n, DAQ_RECORD)
    warm = dataclasses.replace(sheets, environment=Environment())
    Chain(warm, rate, 11).measure(still)
    settled = still[n // 4 :]
    assert set(promised) == {"motor_torque", *sheets.analog}
    for channel, deviation in promised.items():
        if channel != "motor_torque":  # held values are few: below
            assert np.std(settled[channel]) == pytest.approx(deviation, rel=0.03), channel


def test_noise_of_the_motors_torque_is_that_of_a_run():
    sheet = TorqueReport(noise_density=0.2, filter_time=0.002, update_rate=500, delay=0.003, resolution=0.6)
    n = 30 * RATE
    told = measured(DataSheets(motor_torque=sheet), "motor_torque", np.zeros(n), block=RATE)
    values = told[RATE :: RATE // 500]
    # 15000 values, correlated by exp(-1) from one to the next: their deviation is known to 0.7 %.
    assert np.std(values) == pytest.approx(noise_of(DataSheets(motor_torque=sheet), RATE)["motor_torque"], rel=0.03)


@pytest.mark.parametrize(("order", "cutoff"), [(1, 0.1), (4, 0.35), (8, 0.4), (8, 0.01)])
def test_noise_gain_is_the_energy_of_the_impulse_response(order, cutoff):
    sections = anti_alias(order, cutoff)
    impulse = np.zeros(200_000)
    impulse[0] = 1.0
    assert noise_gain(sections) == pytest.approx(np.sum(signal.sosfilt(sections, impulse) ** 2), rel=1e-9)


def test_noise_gain_of_the_inverters_filter():
    sections = chains.report_low_pass(0.001, RATE)
    assert report_noise_gain(0.001, RATE) == pytest.approx(noise_gain(sections), rel=1e-9)
    assert report_noise_gain(0.0, RATE) == 1.0


# --- bandwidth


def response(sheets: DataSheets, channel: str, frequency: float, amplitude: float = 1.0) -> float:
    """Amplitude ratio for a sine, over whole periods once settled."""
    n = 8 * RATE // 50
    t = np.arange(n) / RATE
    out = measured(sheets, channel, amplitude * np.sin(2.0 * np.pi * frequency * t), block=512)
    settled = slice(n // 2, n)
    return float(2.0 * abs(np.mean(out[settled] * np.exp(-2j * np.pi * frequency * t[settled]))) / amplitude)


SWEEP = (50.0, 500.0, 1000.0, 2000.0, 5000.0, 10_000.0, 20_000.0)  # whole periods in 80 ms


@pytest.mark.parametrize("bandwidth", [1000.0, 5000.0])
def test_bandwidth_by_sine_sweep(bandwidth):
    sheets = of_arms(bandwidth=bandwidth)
    for frequency in SWEEP:
        ratio = math.tan(math.pi * frequency / RATE) / math.tan(math.pi * bandwidth / RATE)
        assert response(sheets, "arm_left", frequency) == pytest.approx(1.0 / math.sqrt(1.0 + ratio**4), rel=1e-6)
    assert response(sheets, "arm_left", bandwidth) == pytest.approx(math.sqrt(0.5), rel=1e-6)


def test_a_bandwidth_that_the_sampling_cannot_show_is_left_out():
    assert sensor_low_pass(100_000.0, RATE) is None
    assert response(of_arms(bandwidth=100_000.0), "arm_left", 20_000.0) == pytest.approx(1.0, rel=1e-9)


def test_anti_alias_filter_by_sine_sweep():
    sheets = DataSheets(daq=Daq(anti_alias_order=8, anti_alias_cutoff=0.3))
    for frequency in SWEEP:
        ratio = math.tan(math.pi * frequency / RATE) / math.tan(math.pi * 0.3)
        assert response(sheets, "clip_left", frequency) == pytest.approx(1.0 / math.sqrt(1.0 + ratio**16), rel=1e-6)


def test_all_analog_channels_are_sampled_at_the_same_moment():
    true = np.zeros(4096, DAQ_RECORD)
    wave = np.sin(np.arange(4096) * 0.3)
    for channel in DataSheets().analog:
        true[channel] = wave
    Chain(DataSheets(daq=Daq(anti_alias_order=8)), RATE, 1).measure(true)
    assert all(np.array_equal(true[channel], true["x"]) for channel in DataSheets().analog)


def test_a_filter_is_scipys():
    rows = np.random.default_rng(1).standard_normal((3, 400))
    sections = np.array([anti_alias(4, cutoff) for cutoff in (0.1, 0.2, 0.4)])
    own = Filter(sections)
    pieces = np.concatenate([own(rows[:, first : first + 50].copy()) for first in range(0, 400, 50)], axis=1)
    for sos, row, found in zip(sections, rows, pieces, strict=True):
        assert found == pytest.approx(signal.sosfilt(sos, row, zi=signal.sosfilt_zi(sos) * row[0])[0], abs=1e-12)


def test_a_filter_starts_settled():
    assert Filter(anti_alias(8, 0.2))(np.full((2, 50), 3.0)) == pytest.approx(3.0, rel=1e-9)


# --- static errors


def test_quantisation_steps_are_exact():
    sheet = ForceSensor(range=1000.0)
    sheets = DataSheets(*[sheet] * 2, DisplacementSensor(range=1.0), sheet, load_data_sheets("typical").belt_speed)
    sheets = dataclasses.replace(sheets, daq=Daq(bits=12, headroom=1.28))
    step = 2.0 * 1280.0 / 2**12  # 0.625 N, exact in binary
    true = np.linspace(-999.0, 999.0, 20001)
    out = measured(sheets, "arm_left", true)
    assert np.array_equal(out, np.rint(true / step) * step)
    assert set(np.diff(np.unique(out))) == {step}
    assert np.max(np.abs(out - true)) <= 0.5 * step


def test_quantisation_noise_is_a_twelfth_of_the_squared_step():
    sheets = of_torque(resolution=0.1)
    true = np.random.default_rng(0).uniform(0.0, 50.0, 100_000)
    error = measured(sheets, "motor_torque", true) - true
    assert np.std(error) == pytest.approx(noise_of(sheets, RATE)["motor_torque"], rel=0.01)


def test_saturation_at_the_range_and_never_beyond_the_input():
    out = measured(of_arms(range=500.0), "arm_left", np.array([-900.0, -500.0, 0.0, 499.0, 500.0, 1e9]))
    assert list(out) == [-500.0, -500.0, 0.0, 499.0, 500.0, 500.0]
    assert list(measured(of_torque(range=60.0), "motor_torque", np.array([-99.0, 30.0, 99.0]))) == [-60.0, 30.0, 60.0]
    typical = load_data_sheets("typical")
    end = typical.arm_force.range * typical.daq.headroom
    ringing = measured(typical, "arm_left", 1e6 * np.sign(np.sin(np.arange(5000) * 0.05)))
    assert np.max(np.abs(ringing)) <= end


def test_linearity_deviates_most_at_half_the_range_and_nowhere_at_its_ends():
    true = np.linspace(-1000.0, 1000.0, 2001)
    error = measured(of_arms(range=1000.0, linearity=0.002), "arm_left", true) - true
    assert error[[0, 1000, 2000]] == pytest.approx(0.0, abs=1e-12)
    assert np.max(error) == pytest.approx(2.0, rel=1e-12)
    assert true[np.argmax(error)] == 500.0
    assert error == pytest.approx(-error[::-1], abs=1e-12)


@pytest.mark.parametrize("amplitude", [200.0, 600.0, 1000.0])
def test_hysteresis_loop_area(amplitude):
    # The play operator's parallelogram, of half width w: 2 w (2 A - 2 w), seen by its share h / (2 w / range).
    width, loop = chains.PLAY * 1000.0, 0.002 * 1000.0
    true = amplitude * np.sin(2.0 * np.pi * np.arange(3 * 20_000) / 20_000)
    out = measured(of_arms(range=1000.0, hysteresis=0.002), "arm_left", true)
    last, seen = true[-20_000:], out[-20_000:]
    area = abs(0.5 * np.sum(last * np.roll(seen, -1) - np.roll(last, -1) * seen))
    assert area == pytest.approx(loop * (2.0 * amplitude - 2.0 * width), rel=1e-4)
    rising, falling = np.gradient(last) > 0.0, np.gradient(last) < 0.0
    middle = np.abs(last) < amplitude - 2.0 * width
    if middle.any():
        levels = np.linspace(-0.5, 0.5, 11) * (amplitude - 2.0 * width)

        def of(branch):
            order = np.argsort(last[branch])
            return np.interp(levels, last[branch][order], seen[branch][order])

        assert np.abs(of(rising) - of(falling)) == pytest.approx(loop, rel=1e-3)


def test_motions_smaller_than_the_play_close_no_loop():
    true = 90.0 * np.sin(2.0 * np.pi * np.arange(40_000) / 20_000)
    out = measured(of_arms(range=1000.0, hysteresis=0.002), "arm_left", true)
    assert out == pytest.approx(true * (1.0 - 0.002 / (2.0 * chains.PLAY)), abs=1e-9)


def test_sensitivity_and_offset_are_those_of_the_specimen():
    chain = Chain(of_arms(range=1000.0, sensitivity_error=0.01, offset=0.005), RATE, 4)
    specimen = chain.specimens["arm_left"]
    out = taken(chain, "arm_left", np.array([0.0, 400.0]))
    assert out[0] == pytest.approx(specimen.offset, rel=1e-12)
    assert out[1] - out[0] == pytest.approx(400.0 * (1.0 + specimen.sensitivity_error), rel=1e-12)
    assert 0.0 < abs(specimen.offset) <= 5.0


def test_drift_follows_the_temperature():
    # Zero: drift dT (1 - exp(-t/tau)), so the rate at the start is drift dT / tau.
    sheets = dataclasses.replace(
        of_arms(range=1000.0, zero_drift=1e-3, sensitivity_drift=2e-3), environment=Environment(10.0, 50.0)
    )
    rate = 1000
    t = np.arange(100 * rate) / rate
    for true in (0.0, 300.0):
        chain = Chain(sheets, rate, 8)
        specimen = chain.specimens["arm_right"]
        out = taken(chain, "arm_right", np.full(len(t), true), block=4096)
        drift = specimen.zero_drift + true * specimen.sensitivity_drift
        assert out - true == pytest.approx(drift * 10.0 * (1.0 - np.exp(-t / 50.0)), abs=1e-12 * max(1.0, true))
        assert (out[rate] - out[0]) / 1.0 == pytest.approx(drift * 10.0 / 50.0, rel=0.011)


# --- the inverter's report


def test_torque_is_late_by_its_delay():
    true = np.arange(5000.0)
    late = measured(of_torque(delay=0.01), "motor_torque", true, block=512)
    assert np.array_equal(late[512:], true[:-512])
    assert not late[:512].any()


@pytest.mark.parametrize(("rate", "update"), [(51200, 1000), (51200, 10), (44100, 300), (1000, 100_000)])
def test_torque_is_held_at_the_inverters_own_rate(rate, update):
    n, late = 3 * rate, round(0.003 * rate)
    told = measured(of_torque(delay=0.003, update_rate=update), "motor_torque", np.arange(float(n)), rate, block=173)
    for sample in range(late, n, 97):  # value k is taken at k / update, at the next sample
        value = (sample - late) * update // rate
        assert told[sample] == math.ceil(value * rate / update)
    changes = np.flatnonzero(np.diff(told))
    if update < rate:
        assert len(changes) == pytest.approx((3.0 - 0.003) * update, abs=2)


def test_noise_that_the_low_pass_takes_away_does_not_pull_the_torques_mean_from_its_range():
    noisy = of_torque(range=60.0, noise_density=0.3, filter_time=0.02)  # 48 N m before the low-pass
    told = measured(noisy, "motor_torque", np.full(4 * RATE, 40.0))
    assert np.mean(told[RATE:]) == pytest.approx(40.0, abs=0.5)


def test_torques_low_pass_by_its_step():
    n = 4000
    true = np.where(np.arange(n) < 1000, 0.0, 20.0)
    out = measured(of_torque(filter_time=0.01), "motor_torque", true, block=64)
    t = (np.arange(1000, n) - 999) / RATE
    assert out[1000:] == pytest.approx(20.0 * (1.0 - np.exp(-t / 0.01)), rel=1e-9)


# --- clock and gaps


def test_gaps_come_at_their_rate():
    rate_of_gaps, length, seconds = 5.0, 0.002, 400
    chain = Chain(DataSheets(daq=Daq(drop_rate=rate_of_gaps, drop_length=length)), RATE, 2)
    lost = [chain.gaps.take(512) for _ in range(100 * seconds)]
    expected = rate_of_gaps * seconds
    assert sum(lost) / round(length * RATE) == pytest.approx(expected, abs=4.5 * math.sqrt(expected))  # Poisson
    assert max(lost) <= 256
    assert not any(Chain(DataSheets(), RATE, 2).gaps.take(512) for _ in range(1000))
