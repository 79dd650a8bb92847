"""A campaign on the live graph: the same plan as the engine's, through the rig's parameters and services."""

from __future__ import annotations

import json
import math
import re
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from squeal_rig.catalogue.checking import check_file
from squeal_rig.configuration.declared import declarations
from squeal_rig.configuration.files import load_yaml, parse_yaml, read_text, yaml_scalar
from squeal_rig.configuration.new_files import new_file
from squeal_rig.configuration.node_files import ROS_KEY, node_of, parameter_blocks
from squeal_rig.errors import ConfigurationError, ExperimentError, ModelError, NoHitError
from squeal_rig.estimation.tolerances import PointTolerance, set_point_tolerance
from squeal_rig.experiments.campaign.measuring import FAILED, Point, head, measure_point, tables_of
from squeal_rig.experiments.campaign.plans import EVENTS, LEVEL, PAD_STIFFNESS, Campaign, Phase
from squeal_rig.experiments.campaign.running import Progress
from squeal_rig.experiments.campaign.store import Store
from squeal_rig.experiments.engine import STEP_BEGUN, STEP_ENDED, RunEvent
from squeal_rig.instruments.acquisition import NOT_MOVABLE
from squeal_rig.instruments.driver import Capabilities, Samples, driver_class
from squeal_rig.instruments.numbering import SEQ_MODULUS, samples_ahead
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.model.parameters import RUN_TIME_PARAMETERS, RigParameters
from squeal_rig.recording.gaps import samples_missing
from squeal_rig.session.live import LiveGraph
from squeal_rig.session.run import SessionOptions, SignalWatch, run_session

Values = NDArray[np.float64]

#: The parameter file of a live campaign, kept beside its plan.
CONFIG = "rig_config.yaml"
_BAGS = "bags"
_POINT, _SPRINGS = ("preload", "belt_speed"), (PAD_STIFFNESS, "k1", "k2")
# What is set counts as in force this near, as a share; and how long it may take beyond the slew rates [s].
_IN_FORCE, _PATIENCE = 1e-6, 20.0
# Sampled time after what was asked before samples are taken for what came after it [s]; where a rig tells from which
# sample on that is; and how long a window of friction is waited for [s].
_AFTER, _LATE_WINDOW = 0.05, 1.0
_FROM = re.compile(r"from sample (\d+) on")


class LostSamplesError(ModelError):
    """Samples are missing in what is measured: as with any `ModelError`, the point has no numbers, and says why."""


class _Told(tuple[Phase, ...]):
    """Phases that tell which of them begins: mu is of the dwell, and a bench is only told to run."""

    begins: Callable[[Phase], None]

    def __iter__(self) -> Iterator[Phase]:
        for phase in super().__iter__():
            self.begins(phase)
            yield phase


@dataclass(frozen=True)
class _Dwell:
    """The last dwell: `seq` of its first sample, how many; preload [N] and belt speed [m/s] that were set, and by what
    they may be read otherwise.
    """

    begin: int
    samples: int
    preload: float
    belt_speed: float
    allowed: PointTolerance


class LiveBench:
    """The rig of the graph under a campaign. With `by_hand` a mechanic fits the springs: no driver moves them."""

    def __init__(self, graph: LiveGraph, base: RigParameters, settings: RigSettings, by_hand: bool = False) -> None:
        self._graph, self._settings, self._by_hand = graph, settings, by_hand
        self.sample_rate = settings.sample_rate
        self._set: dict[str, float] = {name: getattr(base, name) for name in ("preload", "belt_speed", "k1", "k2")}
        self._waiting: deque[tuple[int, Values]] = deque()
        self._arrival = 0.0
        self._phase = Phase("reset")
        self._dwell: _Dwell | None = None
        self._expected: int | None = None  # `seq` that what is run next must begin with
        self._changed: int | None = None  # `seq` from which on what was set or hit last is surely in the samples
        self._begun = False
        self.first_sample = self.next_sample = 0  # `seq` of the first that is taken, and of the next to come
        # Of this point: places where samples were lost, and how many; how often it was measured, whether it was cut.
        self.gaps = self.lost = self.measured = 0
        self._cut = False
        graph.on_samples = self._take
        graph.keeps_windows = True

    def measure(self, campaign: Campaign, values: Mapping[str, float]) -> Point:
        """Measure a point: what comes from now on is its own. Where samples are lost in it, once more."""
        self.gaps = self.lost = 0
        protocol = _Told(campaign.protocol)
        protocol.begins = self._begins
        for self.measured in (1, 2):
            self._from_here()
            del self._graph.windows[:]
            self._dwell, self._cut = None, False
            point = measure_point(replace(campaign, protocol=protocol), values, self)
            if not self._cut:
                break
        return point

    def _begins(self, phase: Phase) -> None:
        self._phase = phase

    def _take(self, daq: Samples) -> None:
        seq = int(daq["seq"][0])
        if self._begun and (missing := samples_missing(self.next_sample, seq)):
            self.gaps, self.lost = self.gaps + 1, self.lost + missing
        self._begun = True
        self.next_sample = (seq + len(daq)) % SEQ_MODULUS
        self._waiting.append((seq, np.array(daq["x"], dtype=np.float64)))

    def _from_here(self) -> None:
        self._waiting.clear()
        self.first_sample = self.next_sample
        self._expected = self.next_sample if self._begun else None
        self._changed = None

    def springs_to_fit(self, values: Mapping[str, float]) -> str:
        """Name of the springs that a mechanic has to fit before those values are set; empty where nobody has to."""
        stiffness = values.get(PAD_STIFFNESS, math.nan)
        fitted = not self._by_hand or math.isnan(stiffness) or self._set["k1"] == self._set["k2"] == stiffness
        return "" if fitted else f"{stiffness:.6g} N/m"

    def set_parameters(self, values: Mapping[str, float]) -> None:
        changes = {name: float(value) for name, value in values.items()}
        springs, before = self.springs_to_fit(changes), dict(self._set)
        if PAD_STIFFNESS in changes:
            stiffness = changes.pop(PAD_STIFFNESS)
            fitted = {"k1": stiffness, "k2": stiffness}
            if springs:
                self._graph.change_springs(springs, stiffness, math.inf)
                self._from_here()  # the rig may number its samples anew
                del self._graph.windows[:]
                before |= {**fitted, "preload": 0.0, "belt_speed": 0.0}  # it stood, and comes to its set points anew
            elif not self._by_hand:
                changes |= fitted
            self._set |= fitted
        if changes:
            self._graph.set_parameters(changes)
            self._changed = self.next_sample
        self._set |= {name: value for name, value in changes.items() if name in self._set}
        s = self._settings
        rates = {
            "preload": s.preload_slew_rate, "belt_speed": s.belt_acceleration,
            "k1": s.stiffness_slew_rate, "k2": s.stiffness_slew_rate,
        }  # fmt: skip
        longest = max(abs(self._set[name] - before[name]) / rate for name, rate in rates.items())
        self._arrival = self._graph.sampled_time() + longest

    def reset(self) -> None:
        graph = self._graph
        graph.wait_until(self._arrival + _AFTER)
        allowed, state = set_point_tolerance(graph.description, 1), graph.state
        graph.wait_for(
            lambda: _in_force(self._set, allowed, state.preload, state.belt_speed),
            "the operating point to come into force",
            _PATIENCE,
        )
        answer = _FROM.search(graph.call("reset"))
        if answer:
            self.first_sample = self._expected = int(answer[1]) % SEQ_MODULUS
            self._changed = None
        else:  # hardware: its samples come late, and are at rest anyway; it may number them anew
            graph.wait_until(graph.sampled_time() + _AFTER)
            self._from_here()

    def friction(self, own: Mapping[str, float]) -> list[float]:
        """Ratios of means of the friction windows that lie within the last dwell, at its preload and belt speed; none
        where it was not held at the point's `own`, since a ramp before it had moved them.
        """
        dwell = self._dwell
        if dwell is None or any(getattr(dwell, name) != own[name] for name in _POINT):
            return []
        set_point = {name: float(getattr(dwell, name)) for name in _POINT}
        return [
            float(window["mu_ratio_of_means"])
            for window in self._graph.windows
            if self._place(window["t_start"], dwell) >= 0
            and self._place(window["t_end"], dwell) <= dwell.samples
            and _in_force(set_point, dwell.allowed, float(window["preload"]), float(window["belt_speed"]))
        ]

    def windows_are_past(self) -> bool:
        """Whether friction windows beyond the last dwell have come, or there was none: no more of it will."""
        dwell = self._dwell
        return dwell is None or any(self._place(w["t_end"], dwell) > dwell.samples for w in self._graph.windows)

    def _place(self, time: float, dwell: _Dwell) -> int:
        """Samples from the begin of a dwell to a time of the run [s]; `seq` wraps, so the nearer of both ways."""
        return samples_ahead(round(float(time) * self.sample_rate), dwell.begin)

    def hit(self, impulse: float, direction: float) -> None:
        self._graph.set_parameters({"impact_impulse": impulse, "impact_direction": direction})
        self._graph.call("impact")
        self._changed = self.next_sample

    def smallest_hit(self) -> tuple[float, float]:
        try:
            return self._graph.smallest_hit()
        except NoHitError:
            return math.nan, math.nan

    def run(self, duration: float) -> Iterator[Values]:
        """As `Bench.run`; what was sampled before the last change came to the rig comes first, beyond the duration."""
        count = round(duration * self.sample_rate)
        left = count + self._before_change()
        end = None
        while left > 0:
            while not self._waiting:
                self._graph.wait_until(self._graph.sampled_time() + 1e-9)
            seq, x = self._waiting.popleft()
            old = samples_ahead(self.first_sample, seq)
            if old > 0:  # from before the reset
                seq, x = (seq + old) % SEQ_MODULUS, x[old:]
                if not len(x):
                    continue
            if self._expected not in (None, seq):
                self._cut = True
                raise LostSamplesError(f"samples were lost before sample {seq}: nothing is measured across a gap")
            if len(x) > left:
                self._waiting.appendleft(((seq + left) % SEQ_MODULUS, x[left:]))
            x = x[:left]
            self._expected = end = (seq + len(x)) % SEQ_MODULUS
            left -= len(x)
            yield x
        if self._phase.kind == "dwell" and end is not None:
            allowed = set_point_tolerance(self._graph.description, 1)
            self._dwell = _Dwell(
                (end - count) % SEQ_MODULUS, count, self._set["preload"], self._set["belt_speed"], allowed
            )

    def _before_change(self) -> int:
        """Samples that are to be run and were taken before the last change: an answer may come late."""
        changed, self._changed = self._changed, None
        if changed is None or self._expected is None:
            return 0
        return samples_missing(self._expected, changed) or 0


def _in_force(set_point: Mapping[str, float], allowed: PointTolerance, preload: float, belt_speed: float) -> bool:
    """Whether preload [N] and belt speed [m/s] are those that are set, within what the rig's data sheets allow."""
    seen = {"preload": preload, "belt_speed": belt_speed}
    return all(
        abs(seen[name] - set_point[name]) <= getattr(allowed, name) + _IN_FORCE * abs(set_point[name])
        for name in _POINT
    )


def live_config(campaign: Campaign, config: Path) -> str:
    """Text of a parameter file on which a campaign can run live.

    Raises:
        SquealRigError: the file is out of order or holds no blocks of nodes, or the plan cannot run live on it.
    """
    check_file(config)
    text = read_text(config)
    blocks = list(parameter_blocks(parse_yaml(text, str(config))))
    if not blocks:
        raise ConfigurationError(f"{config}: it has no block of a node, as /**/rig: with {ROS_KEY} in it")
    if campaign.measure == LEVEL:
        raise ExperimentError(
            f"measure: {LEVEL} is the engine's own and needs no graph: run it without --live, or measure: {EVENTS}"
        )
    _refuse_constants(campaign)
    _refuse_incapable(campaign, _rig_of(blocks, campaign.base)[1])
    return text


def keep_config(folder: Path, text: str) -> None:
    """Keep the parameter file of a live campaign in its folder, for all of its runs."""
    with new_file(folder / CONFIG, force=True) as draft:
        draft.write_text(text, encoding="utf-8")


def resumed_config(folder: Path, campaign: Campaign, given: Path | None) -> str:
    """Text of the parameter file with which a live campaign was begun.

    Raises:
        SquealRigError: another one is given, or none is kept and none given; and as `live_config`.
    """
    kept = folder / CONFIG
    if not kept.exists():
        if given is None:
            raise ExperimentError(f"{folder} keeps no {CONFIG}: give the --config that the campaign was begun with")
        return live_config(campaign, given)
    if given is not None and read_text(given) != read_text(kept):
        raise ExperimentError(f"{given} is not what the campaign was begun with, {kept}: leave --config out")
    return live_config(campaign, kept)


def run_live(store: Store, console: Console, watch: SignalWatch) -> Progress:
    """Measure every point that is missing, on a rig started for it with the parameters kept; a bag is kept of each run.

    Raises:
        ExperimentError: a factor is a constant of a running rig, the rig did not start, or a rule of the plan ended it.
    """
    campaign = store.campaign
    number = sum(entry["what"] == "run started" for entry in store.entries)
    bag = Path(_BAGS) / f"{number:04d}"
    ros, settings = _ros_file(store.folder / f"rig_{number:04d}.yaml", store.folder / CONFIG, campaign.base)
    by_hand = not _moves(settings, PAD_STIFFNESS)
    done = sum(int(entry["rows"]) for entry in store.done.values())
    store.note("run started", bag=str(bag), done=done)
    outcome = "done"
    progress = [Progress(done, campaign.design.count, 0, 0.0)]

    def work(graph: LiveGraph, tell: Callable[[RunEvent], None]) -> None:
        bench = LiveBench(graph, campaign.base, settings, by_hand)
        failures, begin = 0, graph.sampled_time()
        for place in store.missing():
            verdict = _point(store, bench, graph, place, str(bag), tell)
            failures += verdict == FAILED
            now = progress[0]
            progress[0] = Progress(now.done + 1, now.total, now.measured + 1, graph.sampled_time() - begin)
            if failures >= campaign.stop.failures:
                raise ExperimentError(
                    f"{failures} points failed, which ends the plan: stop.failures = {campaign.stop.failures}"
                )
            if progress[0].spent > campaign.stop.duration:
                raise ExperimentError(f"the plan's time of {campaign.stop.duration:g} s is over; resume goes on")

    facts = {
        "campaign": campaign.title, "plan": campaign.crc, "points": campaign.design.count, "done before": done,
        "plan text": campaign.text,
    }  # fmt: skip
    try:
        result = run_session(SessionOptions(ros, store.folder / bag, work=work, facts=facts), console, watch)
        if result.interrupted:
            outcome = "ended by the operator"
    except BaseException as error:
        outcome = str(error) or type(error).__name__
        raise
    finally:
        store.note("run ended", outcome=outcome, done=progress[0].done)
    return progress[0]


def _point(
    store: Store, bench: LiveBench, graph: LiveGraph, place: int, bag: str, tell: Callable[[RunEvent], None]
) -> str:
    """Measure the point at one place of the order, keep it, and tell of it on the graph; its verdict."""
    campaign = store.campaign
    base = head(campaign, place, place + 1)
    values = {f.name: float(base[f.name][0]) for f in campaign.design.factors}
    title = ", ".join(f"{name} = {value:.6g}" for name, value in values.items())
    if springs := bench.springs_to_fit(values):
        title += f"; springs to fit: {springs}"
    facts: dict[str, Any] = {
        "step": place + 1,
        "of": campaign.design.count,
        "title": title,
        "point": int(base["point"][0]),
    }
    tell(RunEvent(STEP_BEGUN, {**facts, "begin [s]": graph.sampled_time()}))
    try:
        point = bench.measure(campaign, values)
    except BaseException as error:
        tell(RunEvent(STEP_ENDED, {**facts, "end [s]": graph.sampled_time(), "outcome": str(error)}, failed=True))
        raise
    own = campaign.rig(values).as_mapping()
    last_sample, mu = bench.next_sample, []
    if point.row["verdict"] != FAILED:
        graph.comes(lambda: bool(bench.friction(own)) or bench.windows_are_past(), _LATE_WINDOW)
        mu = bench.friction(own)  # none, where none is whole in a short dwell
    point.row |= {"mu_measured": mu[-1] if mu else math.nan, "bag": bag, "first_sample": bench.first_sample}
    point.row |= {"last_sample": last_sample, "lost_blocks": bench.gaps}
    if bench.gaps or bench.measured > 1:
        lost = f"{bench.lost} samples were lost" + (f" in {bench.gaps} places" if bench.gaps > 1 else "")
        lost += "; measured again" if bench.measured > 1 else ""
        point.row["note"] = f"{point.row['note']}; {lost}" if point.row["note"] else lost
    store.add(place, tables_of(base, [point]))
    verdict = str(point.row["verdict"])
    seen = {name: point.row[name] for name in ("verdict", "level", "frequency", "squeal_from", "squeal_to", "note")}
    tell(RunEvent(STEP_ENDED, {**facts, "end [s]": graph.sampled_time(), "outcome": "done", **seen}))
    return verdict


def _refuse_constants(campaign: Campaign) -> None:
    names = [f.name for f in campaign.design.factors]
    names += [phase.parameter for phase in campaign.protocol if phase.kind == "ramp"]
    for name in names:
        if name != PAD_STIFFNESS and name not in RUN_TIME_PARAMETERS:
            raise ExperimentError(
                f"{name} is a constant of the rig: it cannot change while the rig runs; run it directly"
            )


def _refuse_incapable(campaign: Campaign, settings: RigSettings) -> None:
    """Refuse what the rig's driver cannot do; springs may be changed by hand, those of both arms at once."""
    if any(phase.kind == "hit" for phase in campaign.protocol) and not _capabilities(settings).can_hit:
        raise ExperimentError(f"hit: this rig's driver, {settings.driver!r}, cannot give the pad an impact")
    ramped = [phase.parameter for phase in campaign.protocol if phase.kind == "ramp"]
    for name in (*ramped, *(f.name for f in campaign.design.factors)):
        if _moves(settings, name) or (name == PAD_STIFFNESS and name in campaign.design.by_hand and name not in ramped):
            continue
        hand = f"; springs are changed by hand as a factor {PAD_STIFFNESS} under by_hand" if name in _SPRINGS else ""
        raise ExperimentError(f"{name} {NOT_MOVABLE}, {settings.driver!r}{hand}")


def _moves(settings: RigSettings, name: str) -> bool:
    """Whether the rig's driver can move a parameter while it samples."""
    return set(("k1", "k2") if name == PAD_STIFFNESS else (name,)) <= _capabilities(settings).set_points


def _capabilities(settings: RigSettings) -> Capabilities:
    return driver_class(settings.driver)().capabilities(settings)


def _rig_of(blocks: list[tuple[str, dict[str, Any]]], base: RigParameters) -> tuple[dict[str, Any], RigSettings]:
    """Parameters of the rig's node with the campaign's rig among them, and its settings; those for every node count
    where it has none of its own.
    """
    own: dict[str, Any] = {}
    shared: dict[str, Any] = {}
    for key, values in blocks:
        {"": shared, "rig": own}.get(node_of(key), {}).update(values)
    own |= base.as_mapping()
    known = declarations(RigSettings)
    return own, RigSettings.from_mapping({n: v for n, v in {**shared, **own}.items() if n in known})


def _ros_file(path: Path, config: Path, base: RigParameters) -> tuple[Path, RigSettings]:
    """The parameter file with the campaign's rig in it, for a run; and the rig's settings.

    Of blocks with wildcards the last one counts in rclpy, so the rig's comes last.
    """
    blocks = list(parameter_blocks(load_yaml(config)))
    own, settings = _rig_of(blocks, base)
    lines = []
    for key, values in (*(block for block in blocks if node_of(block[0]) != "rig"), ("/**/rig", own)):
        if not values:
            continue
        lines.append(f"{key}:\n  {ROS_KEY}:\n")
        for name, value in values.items():
            text = json.dumps(value) if isinstance(value, list) else yaml_scalar(value)
            lines.append(f"    {name}: {text}\n")
    with new_file(path, force=True) as draft:
        draft.write_text("".join(lines), encoding="utf-8")
    return path, settings
