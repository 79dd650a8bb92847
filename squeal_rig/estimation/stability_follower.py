"""Complex eigenvalue analysis of a rig as it runs: of the set point, of what is in force, with the estimated mu.

The node and offline estimation share it. Each status tells what it was computed from, so that the same numbers can be
computed again from a log, whatever the order in which messages happened to arrive.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass

from squeal_rig.configuration.declared import checked, declarations
from squeal_rig.errors import ModelError
from squeal_rig.instruments.description import RigDescription
from squeal_rig.model.core.law import friction_coefficient, with_constant_friction
from squeal_rig.model.linear.eigen import stability_report
from squeal_rig.model.parameters import RigParameters
from squeal_rig.recording.cdr import text_of

#: While the operating point slews, what is in force is analysed at most this often [s].
IN_FORCE_PERIOD = 0.05
#: Keys of the statuses' values that tell what they were computed from.
DESCRIPTION_KEY, SAMPLE_KEY, WINDOW_KEY = "description crc32", "sample", "window end [s]"
EIGENVALUE_LABELS = ("eigenvalue [rad/s]", "re, im")
SUMMARY_FRAME = "rig"
_BOUNDS = declarations(RigParameters)
_OK, _WARN, _ERROR = 0, 1, 2  # levels of diagnostic_msgs/DiagnosticStatus


@dataclass(frozen=True)
class StabilityStatus:
    """One status of a summary: its level as in DiagnosticStatus, name, message and values as texts."""

    level: int
    name: str
    message: str
    values: Mapping[str, str]


@dataclass(frozen=True)
class StabilitySummary:
    """Statuses, and the eigenvalues of the set point as rows (re, im) [rad/s]; None where there is no equilibrium."""

    statuses: tuple[StabilityStatus, ...]
    eigenvalues: list[tuple[float, float]] | None


@dataclass(frozen=True)
class InForce:
    """Preload [N] and belt speed [m/s] at the last sample of a block, and that sample's number.

    Raises:
        ParameterError: one of them is out of the bounds of the rig's parameters, or not finite.
    """

    preload: float
    belt_speed: float
    sample: int

    def __post_init__(self) -> None:
        checked(_BOUNDS["preload"], self.preload)
        checked(_BOUNDS["belt_speed"], self.belt_speed)


@dataclass(frozen=True)
class Estimate:
    """The ratio of means of a friction window, nan where it has none, and the window's end [s].

    Raises:
        ParameterError: it is out of the bounds of a friction coefficient.
    """

    mu: float
    window_end: float

    def __post_init__(self) -> None:
        if not math.isnan(self.mu):
            checked(_BOUNDS["mu0"], self.mu)


def summary_of(
    rig: RigDescription, in_force: InForce | None = None, estimate: Estimate | None = None
) -> StabilitySummary:
    """Analyse the set point and, as far as they are known, what is in force and that with the estimated mu."""
    identity = {DESCRIPTION_KEY: description_crc(rig)}
    status, eigenvalues = _analysed("set point", rig.parameters, "set", identity)
    statuses = [status]
    if in_force is not None:
        point = rig.parameters.replace(preload=in_force.preload, belt_speed=in_force.belt_speed)
        cause = {SAMPLE_KEY: str(in_force.sample)}
        statuses.append(_analysed("in force", point, "set", cause)[0])
        if estimate is not None and math.isfinite(estimate.mu):
            fixed = with_constant_friction(point, estimate.mu)
            cause = {WINDOW_KEY: text_of(estimate.window_end)}
            statuses.append(_analysed("in force, estimated mu", fixed, "estimated", cause)[0])
    return StabilitySummary(tuple(statuses), eigenvalues)


def description_crc(rig: RigDescription) -> str:
    """A short name of a description: the CRC-32 of its text."""
    return f"{zlib.crc32(rig.to_yaml().encode()):08x}"


class StabilityFollower:
    """Keeps what is known of a running rig and says when a summary is due.

    Times are of any steady clock [s]: the node's own, or the samples' in offline estimation.
    """

    def __init__(self) -> None:
        self._rig: RigDescription | None = None
        self._in_force: InForce | None = None
        self._estimate: Estimate | None = None
        self._last = -math.inf
        self._due = False

    def take_rig(self, rig: RigDescription) -> None:
        """The rig's description has changed: a summary is due at once."""
        self._rig, self._due, self._last = rig, True, -math.inf

    def take_block(self, in_force: InForce) -> None:
        """A block has come; a summary is due when it changed what is in force."""
        known = self._in_force
        moved = known is None or (known.preload, known.belt_speed) != (in_force.preload, in_force.belt_speed)
        self._in_force, self._due = in_force, self._due or moved

    def take_estimate(self, estimate: Estimate) -> None:
        """A window of friction has come."""
        self._estimate, self._due = estimate, True

    def is_due(self, now: float) -> bool:
        """Whether a summary is to be made now."""
        return self._rig is not None and self._due and now - self._last >= IN_FORCE_PERIOD

    def summary(self, now: float) -> StabilitySummary:
        """Make the summary of what is known; a description must have been taken."""
        assert self._rig is not None
        self._last, self._due = now, False
        return summary_of(self._rig, self._in_force, self._estimate)


def _analysed(
    name: str, p: RigParameters, source: str, cause: Mapping[str, str]
) -> tuple[StabilityStatus, list[tuple[float, float]] | None]:
    point: dict[str, object] = {
        "preload [N]": p.preload,
        "belt speed [m/s]": p.belt_speed,
        "mu": friction_coefficient(p),
        "mu source": source,
        **cause,
    }
    try:
        report = stability_report(p)
    except ModelError as error:
        return StabilityStatus(_ERROR, f"stability: {name}", str(error), _texts(point)), None
    values: dict[str, object] = {
        "k [N/m]": report.pad_stiffness,
        "k_cr [N/m]": report.critical_pad_stiffness,
        "k_upper [N/m]": report.upper_pad_stiffness,
        "margin": report.margin,
        "growth rate [1/s]": report.growth_rate,
        "damping ratio": report.damping_ratio,
        "squeal frequency [Hz]": report.squeal_frequency,
    }
    level, text = (_WARN, "unstable") if report.unstable else (_OK, "stable")
    status = StabilityStatus(level, f"stability: {name}", text, _texts({**values, **point}))
    return status, [(value.real, value.imag) for value in report.eigenvalues]


def _texts(values: Mapping[str, object]) -> dict[str, str]:
    return {key: text_of(value) for key, value in values.items()}
