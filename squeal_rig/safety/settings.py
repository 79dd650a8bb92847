"""Limits of the supervisor."""

from __future__ import annotations

from dataclasses import dataclass

from squeal_rig.configuration.declared import Declared, declarations, quantity
from squeal_rig.errors import ParameterError

# Quantities with three limits, each named <quantity>_warn, _ramp_down, _stop.
LIMITED = ("force", "displacement", "torque", "speed_deviation")
_MORE_PAIRS = (
    ("squeal_warn", "squeal_ramp_down"),
    ("stale_warn", "stale_stop"),
    ("parameter_rate", "parameter_rate_ramp_down"),
)


@dataclass(frozen=True)
class SupervisorSettings(Declared):
    """Settings of the supervisor. The defaults let the rig squeal: that is what it is for."""

    force_warn: float = quantity(
        1.0e4, "force in an arm or a clip, or preload, that is warned of", unit="N", lower=1e-3, upper=1e9
    )
    force_ramp_down: float = quantity(
        1.5e4, "force in an arm or a clip, or preload, at which the rig is ramped down", unit="N", lower=1e-3, upper=1e9
    )
    force_stop: float = quantity(
        2.0e4,
        "force in an arm or a clip, or preload, at which the rig is stopped at once",
        unit="N",
        lower=1e-3,
        upper=1e9,
    )
    displacement_warn: float = quantity(
        1.0e-4, "displacement of the pad that is warned of", unit="m", lower=1e-9, upper=1.0
    )
    displacement_ramp_down: float = quantity(
        2.0e-4, "displacement of the pad at which the rig is ramped down", unit="m", lower=1e-9, upper=1.0
    )
    displacement_stop: float = quantity(
        4.0e-4, "displacement of the pad at which the rig is stopped at once", unit="m", lower=1e-9, upper=1.0
    )
    torque_warn: float = quantity(500.0, "motor torque that is warned of", unit="N m", lower=1e-3, upper=1e6)
    torque_ramp_down: float = quantity(
        750.0, "motor torque at which the rig is ramped down", unit="N m", lower=1e-3, upper=1e6
    )
    torque_stop: float = quantity(
        1000.0, "motor torque at which the rig is stopped at once", unit="N m", lower=1e-3, upper=1e6
    )
    speed_deviation_warn: float = quantity(
        0.1, "difference of the belt speed from its set point that is warned of", unit="m/s", lower=1e-3, upper=100.0
    )
    speed_deviation_ramp_down: float = quantity(
        0.3,
        "difference of the belt speed from its set point at which the rig is ramped down",
        unit="m/s",
        lower=1e-3,
        upper=100.0,
    )
    speed_deviation_stop: float = quantity(
        1.0,
        "difference of the belt speed from its set point at which the rig is stopped at once",
        unit="m/s",
        lower=1e-3,
        upper=100.0,
    )
    speed_time: float = quantity(
        0.1, "time that a deviation of the speed lasts before it counts", unit="s", lower=0.0, upper=60.0
    )
    speed_settling: float = quantity(
        5.0,
        "longest time the belt may take from one set point to the next; until then its speed may lie in between",
        unit="s",
        lower=0.0,
        upper=600.0,
    )
    squeal_warn: float = quantity(
        30.0, "level of squeal that is warned of", unit="dB re 1 um", lower=-200.0, upper=200.0
    )
    squeal_ramp_down: float = quantity(
        35.0, "level of squeal at which the rig is ramped down", unit="dB re 1 um", lower=-200.0, upper=200.0
    )
    squeal_duration: float = quantity(
        600.0, "time squeal of any level lasts before the rig is ramped down", unit="s", lower=0.1, upper=1e6
    )
    spike_samples: int = quantity(
        3,
        "so many samples of a block beyond a limit, or fewer, are a spike, which is only warned of",
        lower=0,
        upper=10000,
    )
    saturation_time: float = quantity(
        0.1, "time a channel is at its full scale before the rig is ramped down", unit="s", lower=0.0, upper=60.0
    )
    not_finite_time: float = quantity(
        0.1, "time a channel is not finite before the rig is ramped down", unit="s", lower=0.0, upper=60.0
    )
    stuck_time: float = quantity(
        0.5,
        "time a channel does not change by a bit, while what must change with it does, before the rig is ramped down",
        unit="s",
        lower=0.05,
        upper=600.0,
    )
    lost_share: float = quantity(
        0.1, "share of the last second's samples that has to be lost for a ramp down", lower=1e-6, upper=1.0
    )
    disorder: int = quantity(
        3, "blocks out of order within ten seconds at which the rig is ramped down", lower=1, upper=1000
    )
    time_jump: float = quantity(
        0.05, "jump of the stamps ahead of the samples' numbers that is warned of", unit="s", lower=1e-4, upper=60.0
    )
    stale_warn: float = quantity(
        0.2, "time without samples of a running rig that is warned of", unit="s", lower=0.02, upper=60.0
    )
    stale_stop: float = quantity(
        1.0, "time without samples of a running rig after which it is stopped", unit="s", lower=0.05, upper=60.0
    )
    parameter_rate: float = quantity(
        50.0, "changes of the rig's parameters in a second that are warned of", unit="1/s", lower=1.0, upper=1e6
    )
    parameter_rate_ramp_down: float = quantity(
        150.0,
        "changes of the rig's parameters in a second at which the rig is ramped down",
        unit="1/s",
        lower=1.0,
        upper=1e6,
    )
    nodes: tuple[str, ...] = quantity(
        ("rig", "friction_estimator", "stability", "squeal_detector"),
        "nodes of the rig's namespace whose health must come: the rig's always, others' once they were well",
        read_only=True,
    )
    node_timeout: float = quantity(
        10.0,
        "time without a node's health, which comes once a second, after which it is lost",
        unit="s",
        lower=1.5,
        upper=600.0,
    )
    ramp_time: float = quantity(
        10.0, "longest time of a ramp down; then the rig is stopped", unit="s", lower=0.1, upper=600.0
    )
    reset_reason: str = quantity("", "what was found and mended; ~/reset wants one, and uses it up")

    def __post_init__(self) -> None:
        super().__post_init__()
        pairs = [(f"{q}_{low}", f"{q}_{high}") for q in LIMITED for low, high in _ORDER]
        for low, high in (*pairs, *_MORE_PAIRS):
            if not getattr(self, low) <= getattr(self, high):
                unit = declarations(SupervisorSettings)[low].unit
                raise ParameterError(
                    f"{low} = {getattr(self, low):g} {unit} must not be above {high} = {getattr(self, high):g} {unit}"
                )


_ORDER = (("warn", "ramp_down"), ("ramp_down", "stop"))
