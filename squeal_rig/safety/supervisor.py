"""The supervisor without ROS: rules to levels, levels to commands, and the latch between them.

The caller says what has come and what time it is; what is to be published and commanded is asked for.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from dataclasses import dataclass

from squeal_rig.errors import SafetyError
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import Samples
from squeal_rig.safety.awake import AwakeTime
from squeal_rig.safety.levels import Event, Finding, Level, shortened
from squeal_rig.safety.sample_rules import SIGMAS, SampleRules
from squeal_rig.safety.settings import SupervisorSettings

#: What the rig's health says it is doing, by the key STATE_KEY.
STATE_KEY = "state"
#: Whether its driver can move the belt: a recorded run keeps to no set point.
MOVES_BELT = "moves the belt"
RUNNING, PAUSED, INACTIVE, WAITING, FAULT, ENDED = "running", "paused", "inactive", "waiting", "fault", "ended"
RIG = "rig"
# A finding of samples stands for so long [s] after it was last made: a block is 10 ms, and people read states.
_STANDS = 1.0
# Samples are counted over so long [s], and may be so much fewer than they should be.
_RATE_TIME, _SLOWEST = 2.0, 0.8
# A supervisor that comes to a running rig finds its samples within so long [s], on top of the time for stale ones.
_MEETING = 5.0
# What counts as no preload [N] and a belt at rest [m/s] after a ramp.
_REST = {"preload": 1.0, "belt_speed": 0.01}
_HEALTH_OK, _HEALTH_ERROR = 0, 2
_NOT_TOLD = "the rig has not reported yet that it is stopped"


@dataclass(frozen=True)
class RigSafe:
    """What `rig/safe` tells: whether the rig is stopped, why, by which number of request, and whether accepted.

    `by_service` are the requests so far where the last came by the rig's service, which nobody else hears; else 0.
    """

    stopped: bool
    reason: str = ""
    number: int = 0
    accepted: bool = True
    by_service: int = 0


@dataclass
class _Node:
    heard: float
    level: int
    told: str


class Supervisor:
    """Watches one rig.

    Args:
        settings: may be replaced at any time; so may `moves_belt`, whether the rig's driver can move the belt.
        now: time [s] of a steady clock, as in every method that has it.
    """

    def __init__(self, settings: SupervisorSettings, now: float) -> None:
        self.settings = settings
        self._awake = AwakeTime(now)
        self._rules = SampleRules()
        self._findings: dict[str, tuple[Finding, float | None]] = {}
        self._events: list[Event] = []
        self._rig: RigDescription | None = None
        self._rig_state = ""
        self._last_block: float | None = None
        self._in_force: dict[str, float] = {}
        self._rest: dict[str, float] = {}
        self._nodes: dict[str, _Node] = {}
        self._changes: deque[float] = deque()
        self._squeal_since: float | None = None
        self._safe = RigSafe(False)
        self._known_stop = self._known_service = 0
        self._ramp_since = 0.0
        self._rate_since = 0.0, 0.0
        self.latched = Level.OK
        self.reason = ""
        self.trips = self.stops_asked = 0
        self.moves_belt = True

    # --- what comes in

    def take_rig(self, rig: RigDescription) -> None:
        """A new description of the rig."""
        self._rig = rig

    def take_block(self, stamp: int, daq: Samples, now: float) -> None:
        """A block of `daq/samples`."""
        time = self._awake.look(now)
        if self._rig is None or not len(daq):
            return
        if self._last_block is None:
            self._rules.forget()
        self._last_block = time
        self._findings.pop("stale", None)
        if RIG in self._nodes:  # a rig that samples is alive, also where a busy machine holds its health back
            self._nodes[RIG].heard = time
        self._in_force = {name: abs(float(daq[name].mean())) for name in _REST}
        self._rest = {name: _rest_of(name, self._rig, len(daq)) for name in _REST}
        for finding in self._rules.take(stamp, daq, self._rig, self._belt(), self.settings):
            self._find(finding, time + _STANDS)

    def _belt(self) -> float | None:
        if not self.moves_belt or self._rig is None:
            return None
        return 0.0 if self._safe.stopped else self._rig.parameters.belt_speed

    def take_squeal(self, detected: bool, level: float, now: float) -> None:
        """A state of squeal: level [dB re 1 um]."""
        time = self._awake.look(now)
        if not detected:
            self._squeal_since = None
            return
        self._squeal_since = time if self._squeal_since is None else self._squeal_since
        s, lasted = self.settings, time - self._squeal_since
        told = f"the rig squeals at {level:.1f} dB re 1 um"
        if level >= s.squeal_warn:
            high = level >= s.squeal_ramp_down
            limit = s.squeal_ramp_down if high else s.squeal_warn
            reached = Level.RAMP_DOWN if high else Level.WARN
            self._find(Finding("squeal", reached, f"{told}, the limit is {limit:g} dB"), time + _STANDS)
        if lasted > s.squeal_duration:
            sentence = f"{told} for {lasted:.0f} s, the limit is {s.squeal_duration:g} s"
            self._find(Finding("squeal duration", Level.RAMP_DOWN, sentence), time + _STANDS)

    def take_health(self, node: str, level: int, message: str, state: str, now: float) -> None:
        """A node's health; `node` is its name in the rig's namespace, `state` is told by the rig alone."""
        time = self._awake.look(now)
        if node == RIG and state:
            self._take_rig_state(state, message, time)
        if node not in self.settings.nodes or (node == RIG and state == ENDED):
            return
        # One that has never been well is still starting: compiling for the first time takes long. Not so the rig, which
        # may be stopped since before we came.
        if node == RIG or node in self._nodes or level == _HEALTH_OK:
            self._nodes[node] = _Node(time, level, message)
        self._findings.pop(f"node {node}", None)
        # The rig's ERROR of being stopped is our own word.
        if level == _HEALTH_ERROR and not (node == RIG and self._safe.stopped):
            self._find(Finding(f"health {node}", Level.WARN, f"{node} reports an error: {message}"), time + 2.0)

    def _take_rig_state(self, state: str, message: str, time: float) -> None:
        if state != self._rig_state:
            # The wait for samples begins anew, and they need not follow those before.
            first = 0.0 if self._rig_state else _MEETING
            self._last_block = time + first if state == RUNNING else None
            self._rules.forget()
            self._findings.pop("stale", None)
            self._findings.pop("fault", None)
        self._rig_state = state
        if state == FAULT:
            self._find(Finding("fault", Level.STOP, f"the rig has a fault: {message}"), None)
        if state == ENDED:
            self._nodes.pop(RIG, None)

    def take_changes(self, count: int, now: float) -> None:
        """So many parameters of the rig have changed."""
        time = self._awake.look(now)
        self._changes.extend([time] * min(count, 10_000))
        while self._changes and time - self._changes[0] > 1.0:
            self._changes.popleft()
        s, rate = self.settings, len(self._changes)
        if rate > s.parameter_rate:
            high = rate > s.parameter_rate_ramp_down
            limit = s.parameter_rate_ramp_down if high else s.parameter_rate
            told = f"{rate} changes of the rig's parameters within a second, the limit is {limit:g}"
            self._find(Finding("parameters", Level.RAMP_DOWN if high else Level.WARN, told), time + _STANDS)

    def take_safe(self, safe: RigSafe, now: float) -> None:
        """What the rig tells of its safe state: a stop that did not come from here is one of ours from now on."""
        time = self._awake.look(now)
        self._safe = safe
        anew = safe.number != self._known_stop or (safe.by_service > self._known_service and not self.latched)
        if safe.stopped and anew:
            self._known_stop = safe.number
            self._trip(Finding("rig stopped", Level.STOP, f"the rig was stopped: {safe.reason}"), time)
        if safe.by_service:
            self._known_service = safe.by_service
        if not safe.stopped:
            self._known_stop = self._known_service = 0

    def ask_stop(self, reason: str, now: float) -> None:
        """Somebody asks for an emergency stop."""
        self.stops_asked += 1
        told = f"asked for: {shortened(reason) or 'no reason given'}"
        self._trip(Finding("request", Level.STOP, told), self._awake.look(now))

    def tick(self, now: float) -> None:
        """Judge what has not come; to be called some twenty times a second."""
        time, s = self._awake.look(now), self.settings
        for rule, (_, until) in list(self._findings.items()):
            if until is not None and time > until:
                del self._findings[rule]
        self._judge_stale(time)
        self._judge_rate(time)
        for name, node in self._nodes.items():
            silent = time - node.heard
            if silent > s.node_timeout:
                level = self._level_of_silence(name)
                told = f"{name} has not reported its health for {silent:.1f} s, the limit is {s.node_timeout:g} s"
                self._find(Finding(f"node {name}", level, told), None)
        if self.latched == Level.RAMP_DOWN and self._moves() and time - self._ramp_since > s.ramp_time:
            told = f"the rig is not at rest {s.ramp_time:g} s after the ramp down began: {self._what_moves()}"
            self._trip(Finding("ramp", Level.STOP, told), time)

    def _level_of_silence(self, node: str) -> Level:
        """An inactive rig moves nothing, and is silent while its first start ever compiles the model."""
        if node != RIG:
            return Level.RAMP_DOWN
        return Level.WARN if self._rig_state == INACTIVE else Level.STOP

    def _judge_stale(self, time: float) -> None:
        if self._last_block is None or self._rig_state in (PAUSED, INACTIVE, WAITING, ENDED):
            return
        s, silent = self.settings, time - self._last_block
        if silent > s.stale_warn:
            stop = silent > s.stale_stop
            limit = s.stale_stop if stop else s.stale_warn
            told = f"no samples of the rig for {silent:.2f} s, the limit is {limit:g} s"
            self._find(Finding("stale", Level.STOP if stop else Level.WARN, told), None)

    def _judge_rate(self, time: float) -> None:
        """A driver or a machine that is too slow: samples that come, and too few of them."""
        begun, sampled = self._rate_since
        if self._rig_state not in ("", RUNNING) or self._last_block is None:
            self._rate_since = time, self._rules.time
        elif time - begun >= _RATE_TIME:
            share = (self._rules.time - sampled) / (time - begun)
            if share < _SLOWEST:
                told = f"samples come at {100.0 * share:.0f} % of their rate, {100.0 * _SLOWEST:g} % is the limit"
                self._find(Finding("rate", Level.WARN, told), time + 1.5 * _RATE_TIME)
            self._rate_since = time, self._rules.time

    # --- levels

    @property
    def level(self) -> Level:
        """The latched level, or that of the worst finding."""
        return max((self.latched, *(finding.level for finding, _ in self._findings.values())))

    @property
    def sentence(self) -> str:
        """What the level is for."""
        if self.latched:
            return self.reason
        worst = max((f for f, _ in self._findings.values()), key=lambda f: f.level, default=None)
        return "within all limits" if worst is None else worst.sentence

    @property
    def findings(self) -> list[Finding]:
        """What is wrong now."""
        return [finding for finding, _ in self._findings.values()]

    @property
    def watched(self) -> list[str]:
        """Nodes that are missed where their health stays away: the rig once heard, others once they were well."""
        return sorted(self._nodes)

    def events(self) -> list[Event]:
        """What is to be published and logged since this was last asked."""
        told, self._events = self._events, []
        return told

    @property
    def wants_rest(self) -> bool:
        """Whether set points of preload and belt speed are to be set to zero: ramped down, and they are not."""
        if self.latched != Level.RAMP_DOWN or self._rig is None:
            return False
        return self._rig.parameters.preload != 0.0 or self._rig.parameters.belt_speed != 0.0

    @property
    def wants_stop(self) -> bool:
        """Whether the rig is to be stopped and does not say that it is."""
        return self.latched == Level.STOP and not (self._safe.stopped and self._safe.accepted)

    def _find(self, finding: Finding, until: float | None) -> None:
        """Note a finding that stands until a time [s], or until it is taken back."""
        before = self._findings.get(finding.rule)
        if before is not None and before[0].level > finding.level and before[1] is not None:
            return  # the worse one stands for its time
        self._findings[finding.rule] = (finding, until)
        if before is None or finding.level > before[0].level:
            if finding.level >= Level.RAMP_DOWN:
                self._trip(finding, self._awake.time)
            else:
                self._events.append(Event(finding.rule, finding.level, finding.sentence))

    def _trip(self, finding: Finding, time: float) -> None:
        raised = finding.level > self.latched
        if raised:
            self.latched, self.reason = finding.level, finding.sentence
            self._ramp_since = time
        self.trips += 1
        self._events.append(Event(finding.rule, finding.level, finding.sentence, raised))

    def _moves(self) -> bool:
        # What is not a number is not at rest.
        return any(not value <= self._rest[name] for name, value in self._in_force.items())

    def _what_moves(self) -> str:
        return "preload {preload:.4g} N, belt {belt_speed:.4g} m/s".format(**self._in_force)

    # --- reset

    def reset(self, now: float) -> str:
        """Release the latch; returns a sentence and uses the reason up.

        Raises:
            SafetyError: nothing is latched, there is no reason, or the rig is not healthy.
        """
        self.tick(now)
        reason = self.settings.reset_reason.strip()
        if not self.latched:
            raise SafetyError("nothing to reset: the level is " + self.level.words)
        if not reason:
            raise SafetyError("reset_reason is empty: set it to what was found and mended, then reset again")
        unhealthy = self._unhealthy()
        if unhealthy:
            raise SafetyError(f"the rig is not healthy: {'; '.join(unhealthy)}")
        if self.wants_stop:
            # A stop on its way would otherwise reach a rig that was started again after the latch was released.
            waits = "the driver has not accepted the safe command" if self._safe.stopped else _NOT_TOLD
            raise SafetyError(waits)
        released = self.latched
        self.latched, self.reason = Level.OK, ""
        self.settings = dataclasses.replace(self.settings, reset_reason="")
        self._events.append(Event("reset", Level.OK, f"{released.words} released: {reason}"))
        then = "; the rig stays safe until its own ~/reset" if self._safe.stopped else ""
        return f"{released.words} released: {reason}{then}"

    def _unhealthy(self) -> list[str]:
        found = [f.sentence for f in self.findings if f.level >= Level.RAMP_DOWN or f.rule == "stale"]
        if self._last_block is None and self._rig_state not in (PAUSED, INACTIVE):
            found.append("no samples of it have come")
        silent = [name for name in self.settings.nodes if name not in self._nodes and name == RIG]
        return [*found, *(f"{name} has not reported its health" for name in silent)]


def _rest_of(channel: str, rig: RigDescription, samples: int) -> float:
    """What the mean of a block of a channel at rest may reach: noise, ripple and offset are no motion."""
    noise = SIGMAS * rig.noise.get(channel, 0.0) / math.sqrt(samples)
    return _REST[channel] + noise + rig.ripple.get(channel, 0.0) + rig.offset_error.get(channel, 0.0)
