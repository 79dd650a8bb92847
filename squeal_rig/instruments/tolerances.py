"""What data sheets promise of each channel, in closed form: noise, ripple, full scale, and errors that stay."""

from __future__ import annotations

import math
from collections.abc import Mapping

from squeal_rig.instruments.chain import anti_alias, noise_gain, report_noise_gain, step_of
from squeal_rig.instruments.data_sheets import DataSheets
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.model.parameters import RigParameters


def noise_of(sheets: DataSheets, sample_rate: int) -> dict[str, float]:
    """Channel -> standard deviation of one sample [its unit], after all filters; channels without noise are left out.

    sigma^2 = density^2 fs/2 g + step^2/12: g is the filters' `noise_gain`, step/sqrt(12) the error of rounding
    (Bennett, Bell System Technical Journal 27, 1948). Samples are not independent where a filter is narrow: the
    inverter's torque is the same number until the next is told.
    """
    daq, report = sheets.daq, sheets.motor_torque
    gain = noise_gain(anti_alias(daq.anti_alias_order, daq.anti_alias_cutoff)) if daq.anti_alias_order else 1.0
    found = {
        channel: _deviation(sensor.noise_density, gain, step_of(sensor, daq.bits, daq.headroom), sample_rate)
        for channel, sensor in sheets.analog.items()
    }
    gain = report_noise_gain(report.filter_time, sample_rate)
    found["motor_torque"] = _deviation(report.noise_density, gain, report.resolution, sample_rate)
    return {channel: value for channel, value in found.items() if value > 0.0}


def ripple_of(sheets: DataSheets, p: RigParameters, settings: RigSettings) -> dict[str, float]:
    """Channel -> largest periodic deviation of what is in force at set points `p`; those without are left out."""
    drive = sheets.belt_drive
    share = drive.run_out / settings.drum_radius + drive.speed_ripple if drive.inertia else 0.0
    found = {"preload": sheets.hydraulics.ripple * p.preload, "belt_speed": share * p.belt_speed}
    return {channel: value for channel, value in found.items() if value > 0.0}


def promises(sheets: DataSheets, p: RigParameters, settings: RigSettings) -> dict[str, Mapping[str, float]]:
    """All of it at set points `p`, under the names that `RigDescription` has for it."""
    return {
        "noise": noise_of(sheets, settings.sample_rate),
        "ripple": ripple_of(sheets, p, settings),
        "full_scale": full_scale_of(sheets),
        "correlation": correlation_of(sheets, settings.sample_rate),
        "gain_error": gain_error_of(sheets),
        "offset_error": offset_error_of(sheets),
    }


def correlation_of(sheets: DataSheets, sample_rate: int) -> dict[str, float]:
    """Channel -> time over which its noise stays alike [s]; those without noise are left out.

    A mean over a longer T has the variance density^2/(2 T), so the time is density^2/(2 noise^2); at least one sample,
    and as long as a value is held.
    """
    densities = {channel: sensor.noise_density for channel, sensor in sheets.analog.items()}
    densities["motor_torque"] = sheets.motor_torque.noise_density
    held = {"motor_torque": sheets.motor_torque.update_rate or sample_rate}
    return {
        channel: max(0.5 * (densities[channel] / noise) ** 2, 1.0 / held.get(channel, sample_rate))
        for channel, noise in noise_of(sheets, sample_rate).items()
    }


def gain_error_of(sheets: DataSheets) -> dict[str, float]:
    """Channel -> bound of its gain error once the rig is warm, as a share; those without are left out.

    Sensitivity, its drift and the straight line, as the root of the sum of squares of independent bounds (JCGM
    100:2008, 5.1.2). A deviation that is a parabola between zero and range, at most `linearity` of it, is a gain error
    of four times that share where the reading is small against the range.
    """
    rise = sheets.environment.temperature_rise
    found = {
        name: math.hypot(s.sensitivity_error, s.sensitivity_drift * rise, 4.0 * s.linearity)
        for name, s in sheets.analog.items()
    }
    found["motor_torque"] = sheets.motor_torque.sensitivity_error
    return {channel: value for channel, value in found.items() if value > 0.0}


def offset_error_of(sheets: DataSheets) -> dict[str, float]:
    """Channel -> bound of what it is off by at any reading [its unit], once warm; those without are left out.

    Zero, its drift and half the hysteresis on either side, combined as in `gain_error_of`.
    """
    rise = sheets.environment.temperature_rise
    found = {
        channel: s.range * math.hypot(s.offset, s.zero_drift * rise, 0.5 * s.hysteresis)
        for channel, s in sheets.analog.items()
    }
    found["motor_torque"] = sheets.motor_torque.range * sheets.motor_torque.offset
    return {channel: value for channel, value in found.items() if value > 0.0}


def full_scale_of(sheets: DataSheets) -> dict[str, float]:
    """Channel -> magnitude at which it is at its end [its unit]; those without an end are left out.

    One step below the range: what is clipped is rounded to a step afterwards.
    """
    daq = sheets.daq
    found = {
        channel: sensor.range - step_of(sensor, daq.bits, daq.headroom) for channel, sensor in sheets.analog.items()
    }
    found["motor_torque"] = sheets.motor_torque.range - sheets.motor_torque.resolution
    return {channel: value for channel, value in found.items() if value > 0.0}


def _deviation(density: float, gain: float, step: float, sample_rate: int) -> float:
    return math.sqrt(0.5 * sample_rate * gain * density**2 + step**2 / 12.0)
