"""Complex eigenvalue analysis of a rig as it runs: of the set point, of what is in force, with the estimated mu.

The node and offline estimation share it and its messages. Each status tells what it was computed from, so that the same
numbers can be computed again from a log, whatever the order in which messages happened to arrive.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from squeal_rig.configuration.declared import checked, declarations
from squeal_rig.errors import ModelError
from squeal_rig.estimation import hard_squeal
from squeal_rig.estimation.hard_squeal import Status
from squeal_rig.estimation.tolerances import PointTolerance, measured_point, point_tolerance
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.settings import BLOCKS_PER_SECOND
from squeal_rig.model.core.law import friction_coefficient, with_constant_friction
from squeal_rig.model.linear.eigen import stability_report
from squeal_rig.model.parameters import RigParameters
from squeal_rig.recording.cdr import diagnostics_message, multi_array_message, text_of

SUMMARY, EIGENVALUES = "stability/summary", "stability/eigenvalues"
#: While the operating point slews, what is in force is analysed at most this often [s].
IN_FORCE_PERIOD = 0.05
#: Names of the statuses of a summary.
SET_POINT, IN_FORCE, WITH_ESTIMATE = (
    f"stability: {what}" for what in ("set point", "in force", "in force, estimated mu")
)
#: Keys of the statuses' values that tell what they were computed from.
DESCRIPTION_KEY, SAMPLE_KEY, WINDOW_KEY = "description crc32", "sample", "window end [s]"
_EIGENVALUE_LABELS = ("eigenvalue [rad/s]", "re, im")
_FRAME = "rig"
_BOUNDS = declarations(RigParameters)
_OK, _WARN, _ERROR = 0, 1, 2  # levels of diagnostic_msgs/DiagnosticStatus

Message = tuple[str, bytes]  # relative topic, serialised


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

    @classmethod
    def after(cls, daq: NDArray[np.void], rig: RigDescription | None = None) -> InForce:
        """What is in force after a block of `daq/samples`; where the rig has noise the block's means tell it."""
        last = daq[-1]
        if rig is None:
            return cls(float(last["preload"]), float(last["belt_speed"]), int(last["seq"]))
        return cls(*measured_point(rig, daq), int(last["seq"]))


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

    @classmethod
    def of(cls, window: Any) -> Estimate:
        """That of one point of `friction/windows`."""
        return cls(float(window["mu_ratio_of_means"]), float(window["t_end"]))


def summary_of(
    rig: RigDescription, in_force: InForce | None, estimate: Estimate | None, stamp: int, hard: Status | None = None
) -> list[Message]:
    """Analyse the set point and, as far as they are known, what is in force and that with the estimated mu.

    Gives the summary of that moment [ns], after the set point's eigenvalues, which are missing where it has no
    equilibrium. The set point's status of hard squeal comes last, where there is one.
    """
    identity = {DESCRIPTION_KEY: description_crc(rig)}
    status, eigenvalues = _analysed(SET_POINT, rig.parameters, "set", identity)
    statuses = [status]
    if in_force is not None:
        point = rig.parameters.replace(preload=in_force.preload, belt_speed=in_force.belt_speed)
        cause = {SAMPLE_KEY: str(in_force.sample)}
        statuses.append(_analysed(IN_FORCE, point, "set", cause)[0])
        if estimate is not None and math.isfinite(estimate.mu):
            fixed = with_constant_friction(point, estimate.mu)
            cause = {WINDOW_KEY: text_of(estimate.window_end)}
            statuses.append(_analysed(WITH_ESTIMATE, fixed, "estimated", cause)[0])
    if hard is not None:
        statuses.append(hard)
    messages = [(EIGENVALUES, multi_array_message(eigenvalues, *_EIGENVALUE_LABELS))] if eigenvalues else []
    return [*messages, (SUMMARY, diagnostics_message(stamp, _FRAME, statuses))]


def description_crc(rig: RigDescription) -> str:
    """A short name of a description: the CRC-32 of its text."""
    return text_crc(rig.to_yaml())


def text_crc(text: str) -> str:
    """That of a text."""
    return f"{zlib.crc32(text.encode()):08x}"


class StabilityFollower:
    """Keeps what is known of a running rig and says when a summary is due.

    Times are of any steady clock [s]: the node's own, or the samples' in offline estimation. Where hard squeal is
    looked for (`looks_for_hard_squeal`), its status is pending until it is taken.
    """

    def __init__(self, looks_for_hard_squeal: bool = True) -> None:
        self._looks = looks_for_hard_squeal
        self._hard: tuple[RigParameters, Status] | None = None
        self._rig: RigDescription | None = None
        self._in_force: InForce | None = None
        self._told: InForce | None = None
        self._tolerance = PointTolerance()
        self._estimate: Estimate | None = None
        self._last = -math.inf
        self._due = False

    def take_rig(self, rig: RigDescription) -> None:
        """The rig's description has changed: a summary is due at once."""
        self._rig, self._due, self._last = rig, True, -math.inf
        self._tolerance = point_tolerance(rig, rig.sample_rate // BLOCKS_PER_SECOND)

    def take_block(self, in_force: InForce) -> None:
        """A block has come; a summary is due when it changed what is in force, by more than noise does."""
        # Without noise one differs from the block before; with it, from what was told last: slow ramps add up.
        known = self._in_force if self._tolerance.exact else self._told
        moved = (
            known is None
            or abs(known.preload - in_force.preload) > self._tolerance.preload
            or abs(known.belt_speed - in_force.belt_speed) > self._tolerance.belt_speed
        )
        self._in_force, self._due = in_force, self._due or moved

    def take_estimate(self, estimate: Estimate) -> None:
        """A window of friction has come."""
        self._estimate, self._due = estimate, True

    def look_for_hard_squeal(self, looks: bool) -> None:
        """Whether it is looked for from now on; a summary is due at once."""
        self._looks, self._due, self._last = looks, True, -math.inf

    def take_hard_squeal(self, p: RigParameters, found: Status) -> None:
        """The status of hard squeal of some set point; a summary is due at once where it is the present one."""
        self._hard = p, found
        if self._rig is not None and self._rig.parameters == p:
            self._due, self._last = True, -math.inf

    def lacks_hard_squeal(self) -> RigParameters | None:
        """The set point whose status of hard squeal is to be found; None where it is known or not looked for."""
        if self._rig is None or not self._looks:
            return None
        return None if self._hard is not None and self._hard[0] == self._rig.parameters else self._rig.parameters

    def is_due(self, now: float) -> bool:
        """Whether a summary is to be made now."""
        return self._rig is not None and self._due and now - self._last >= IN_FORCE_PERIOD

    def summary(self, now: float, stamp: int) -> list[Message]:
        """Make the summary of what is known, for a stamp [ns]; a description must have been taken."""
        assert self._rig is not None
        self._last, self._due, self._told = now, False, self._in_force
        hard = None
        if self._looks:
            hard = hard_squeal.pending() if self._hard is None or self.lacks_hard_squeal() else self._hard[1]
        return summary_of(self._rig, self._in_force, self._estimate, stamp, hard)


def _analysed(
    name: str, p: RigParameters, source: str, cause: Mapping[str, str]
) -> tuple[Status, list[tuple[float, float]]]:
    """Status and eigenvalues as rows (re, im) [rad/s]; none where there is no equilibrium."""
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
        return (_ERROR, name, str(error), _texts(point)), []
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
    eigenvalues = [(value.real, value.imag) for value in report.eigenvalues]
    return (level, name, text, _texts({**values, **point})), eigenvalues


def _texts(values: Mapping[str, object]) -> dict[str, str]:
    return {key: text_of(value) for key, value in values.items()}
