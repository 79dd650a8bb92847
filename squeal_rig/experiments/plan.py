"""Plans: an experiment as data, read from YAML and checked before anything moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from squeal_rig.configuration.declared import checked, declarations, unknown_name
from squeal_rig.configuration.files import load_yaml
from squeal_rig.errors import ConfigurationError, ParameterError
from squeal_rig.experiments.springs import Spring, load_springs
from squeal_rig.model.parameters import RUN_TIME_CONCERNS, RigParameters

CALLS = ("reset", "impact", "zero")
_STEP_KEYS = ("note", "set", "call", "hit", "spring", "dwell", "wait")
#: Longest time for a mechanic to change both springs and to confirm it [s], where a step does not say.
DWELL = 600.0
_LONGEST_WAIT = 86400.0
_LARGEST_HIT = 100.0


@dataclass(frozen=True)
class Step:
    """One step: set parameters, call a service of the rig, hit the pad, then wait [s of sampled time].

    Each may be left out. `hit` is an impact as a share of the smallest one that starts squeal at the set point, in its
    direction; 0 is none. `spring` is a pair of the plan's catalogue to be fitted, which a mechanic confirms within
    `dwell` [s]; it is empty where they stay.
    """

    note: str = ""
    set: Mapping[str, float | str] = field(default_factory=dict)
    call: str = ""
    hit: float = 0.0
    wait: float = 0.0
    spring: str = ""
    dwell: float = DWELL

    @property
    def title(self) -> str:
        """The step in words."""
        what = self.call or (f"{self.hit:g} of the smallest hit" if self.hit else "wait")
        if self.spring:  # always named: a mechanic needs it
            return f"{self.note and f'{self.note}: '}fit the springs {self.spring!r}"
        return self.note or ", ".join([*(f"{name} = {value}" for name, value in self.set.items()), what])


@dataclass(frozen=True)
class Plan:
    """A title and its steps, and the springs that there are, where a step fits some."""

    title: str
    steps: tuple[Step, ...]
    springs: Mapping[str, Spring] = field(default_factory=dict)

    @property
    def duration(self) -> float:
        """Sampled time the plan waits in all [s]."""
        return sum(step.wait for step in self.steps)


def load_plan(path: Path | str) -> Plan:
    """Read and check a plan.

    Raises:
        ConfigurationError: the file or a step is not as it must be; the sentence names the step.
    """
    content = load_yaml(path)
    if not isinstance(content, dict) or not isinstance(content.get("steps"), list) or not content["steps"]:
        raise ConfigurationError(f"{path}: a plan is a mapping with a title and a list of steps")
    for key in content:
        if key not in ("title", "springs", "steps"):
            raise ConfigurationError(f"{path}: unknown key {key!r}: a plan has title, springs and steps")
    steps = tuple(_step(f"{path}, step {number}", raw) for number, raw in enumerate(content["steps"], 1))
    title = str(content.get("title", Path(path).stem))
    if "springs" not in content and not any(step.spring for step in steps):
        return Plan(title, steps)
    catalogue = content.get("springs")
    if catalogue is not None and not isinstance(catalogue, str):
        raise ConfigurationError(f"{path}: springs = {catalogue!r} is not the path of a catalogue")
    springs = load_springs(catalogue)
    for number, step in enumerate(steps, 1):
        if step.spring and step.spring not in springs:
            there = ", ".join(springs)
            raise ConfigurationError(f"{path}, step {number}: spring = {step.spring!r} is not known: there are {there}")
    return Plan(title, steps, springs)


def _step(where: str, raw: object) -> Step:
    if not isinstance(raw, dict):
        raise ConfigurationError(f"{where}: a step is a mapping of {', '.join(_STEP_KEYS)}, got {raw!r}")
    for key in raw:
        if key not in _STEP_KEYS:
            raise ConfigurationError(f"{where}: unknown key {key!r}: a step has {', '.join(_STEP_KEYS)}")
    call, wait, changes = raw.get("call", ""), raw.get("wait", 0.0), raw.get("set", {})
    if call and call not in CALLS:
        raise ConfigurationError(f"{where}: call = {call!r} is not known: it must be one of {', '.join(CALLS)}")
    hit, spring, dwell = raw.get("hit", 0.0), raw.get("spring", ""), raw.get("dwell", DWELL)
    for name, value, most, unit in (
        ("wait", wait, _LONGEST_WAIT, " s"),
        ("dwell", dwell, _LONGEST_WAIT, " s"),
        ("hit", hit, _LARGEST_HIT, ""),
    ):
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= most:
            raise ConfigurationError(f"{where}: {name} = {value!r} is out of bounds: it must be 0 to {most:g}{unit}")
    if hit and (call or changes):
        raise ConfigurationError(f"{where}: a hit is a step of its own: what was set has to be in force before it")
    if not isinstance(spring, str):
        raise ConfigurationError(f"{where}: spring = {spring!r} is not a name of the catalogue")
    if spring and (call or changes or hit):
        raise ConfigurationError(f"{where}: a change of springs is a step of its own: the rig stands meanwhile")
    if "dwell" in raw and not spring:
        raise ConfigurationError(f"{where}: dwell is the time to fit a spring, and there is none in this step")
    if not isinstance(changes, dict):
        raise ConfigurationError(f"{where}: set is a mapping of parameter names to values, got {changes!r}")
    try:
        return Step(str(raw.get("note", "")), _changes(changes), call, float(hit), float(wait), spring, float(dwell))
    except ParameterError as error:
        raise ConfigurationError(f"{where}: {error}") from None


def _changes(raw: Mapping[str, object]) -> dict[str, float | str]:
    known = declarations(RigParameters)
    values = {}
    for name, value in raw.items():
        if name not in known:
            raise unknown_name(str(name), known)
        if known[name].concern not in RUN_TIME_CONCERNS:
            raise ParameterError(f"{name} is a constant of the {known[name].concern}: it cannot change during a plan")
        values[name] = checked(known[name], value)
    return values
