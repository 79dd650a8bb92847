"""A session: the nodes as processes, the live console, and a plan run on the rig if there is one."""

from __future__ import annotations

import json
import math
import os
import shutil
import signal
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import Any

from lifecycle_msgs.msg import Transition
from rich.console import Console

from squeal_rig.configuration.files import load_yaml, yaml_scalar
from squeal_rig.configuration.node_files import node_of, parameter_blocks
from squeal_rig.errors import ExperimentError
from squeal_rig.experiments.engine import RUN_ENDED, RUN_STARTED, STEP_BEGUN, RunEvent, run_plan
from squeal_rig.experiments.plan import Plan
from squeal_rig.recording.replay import matching_topics
from squeal_rig.recording.settings import DEFAULT_TOPICS
from squeal_rig.recording.writer import refuse_written
from squeal_rig.session.console import StateDisplay
from squeal_rig.session.live import LiveGraph
from squeal_rig.session.processes import NodeProcess, stop_all

# The node that is the rig: one of them, by its driver.
RIGS = ("simulator", "rig")
CONSUMERS = ("friction_estimator", "stability", "squeal_detector")
SUPERVISOR = "supervisor"
PAGE = "page"
# Compiling for the first time takes tens of seconds on a slow machine.
_START_TIMEOUT = 120.0
# Publisher and subscriber were seen to match after 2.3 s at worst.
_LATE_RECORDER = 3.0


class InterruptedByOperator(Exception):  # noqa: N818
    """The operator has asked to end."""


@dataclass(frozen=True)
class SessionOptions:
    """What to run: parameter file, bag to write (None: no recording), plan or longest duration [s] (None: endless).

    `work`, where given, is done on the running rig in place of a plan: it gets the graph and what takes its events;
    `facts` of it are told as the run starts.
    `instruments` are data sheets in place of those of the parameter file.
    `page`: ROS arguments of the node `page`; None: no page.
    """

    config: Path
    bag: Path | None = None
    plan: Plan | None = None
    duration: float | None = None
    work: Callable[[LiveGraph, Callable[[RunEvent], None]], None] | None = None
    facts: Mapping[str, object] = field(default_factory=dict)
    instruments: str | None = None
    page: Sequence[str] | None = None


@dataclass
class SessionResult:
    """How a session ended: exit codes by node, whether the operator ended it."""

    exit_codes: dict[str, int] = field(default_factory=dict)
    interrupted: bool = False


class SignalWatch:
    """Turns SIGINT and SIGTERM into `InterruptedByOperator` at the next moment somebody asks."""

    def __init__(self) -> None:
        self._asked = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def _on_signal(self, *_details: object) -> None:
        self._asked = True

    def check(self) -> None:
        """Raise `InterruptedByOperator` if a signal has come."""
        if self._asked:
            raise InterruptedByOperator("ended by the operator")


def keep_to_this_machine() -> str:
    """Keep the ROS graph to this machine, unless the user has said how far it reaches; tells domain and range.

    The domain stays the user's, so that any tool on this machine sees the rig.
    """
    reach = os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return f"ROS_DOMAIN_ID {os.environ.get('ROS_DOMAIN_ID') or 0}, ROS_AUTOMATIC_DISCOVERY_RANGE {reach}"


def private_domain() -> None:
    """Keep the ROS graph to this machine and to this run, before the first node starts."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    # Domains up to 101 use ports below Linux's ephemeral range.
    os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)


def run_session(options: SessionOptions, console: Console, watch: SignalWatch) -> SessionResult:
    """Start the nodes, follow them, run the plan, end them.

    Raises:
        RecordingError: the bag is there already.
        ExperimentError: a rig is there already, a node did not start or died, or the plan could not be run.
    """
    if options.bag is not None:
        refuse_written(options.bag)
    result = SessionResult()
    nodes: list[NodeProcess] = []
    spared: set[str] = set()
    recorded: list[str] = []  # topics of samples, once the run has begun: until then the rig may be somebody else's

    def watched() -> None:
        watch.check()
        for node in list(nodes):
            try:
                node.check()
            except ExperimentError as error:
                if node.name not in spared:
                    raise
                nodes.remove(node)
                console.print(f"the run goes on without: {error}")

    console.print(keep_to_this_machine())
    graph = LiveGraph(watched)
    log_directory = Path(tempfile.mkdtemp(prefix="squeal_rig_"))
    try:
        graph.refuse_other_rig()
        recorded = _start(options, nodes, log_directory, graph)
        spared.add(PAGE)  # the rig and its recorder do not need it
        with StateDisplay(console, graph.state) as display:
            _follow(options, graph, display)
    except InterruptedByOperator:
        result.interrupted = True
    finally:
        # The rig first, so that everybody else still takes its last block; the recorder last.
        running, nodes = list(nodes), []
        if recorded:
            holders = [node for node in running if node.name in (*RIGS, "recorder")]
            graph.hand_over(recorded, lambda: all(node.wait(0.0) is None for node in holders))
        for names in (RIGS, (*CONSUMERS, SUPERVISOR, PAGE), ("recorder",)):
            chosen = [n for n in running if n.name in names]
            result.exit_codes |= stop_all(chosen, options.bag if "recorder" in names else None)
        graph.close()
        try:
            if options.bag is not None and options.bag.is_dir():
                shutil.copytree(log_directory, options.bag / "logs", dirs_exist_ok=True)
        except OSError as error:  # how the run went is told all the same
            console.print(f"the nodes' logs could not be kept in the bag: {str(error)[:200]}", markup=False)
        shutil.rmtree(log_directory, ignore_errors=True)
    return result


def _start(options: SessionOptions, nodes: list[NodeProcess], logs: Path, graph: LiveGraph) -> list[str]:
    """Start every node; the rig begins to sample once everybody listens, so that no first block is lost.

    Returns the topics of samples that are recorded.
    """
    files = ["--params-file", str(options.config)]
    # What does not run in real time is no machine, and nobody follows it in time to stop it.
    supervised = not _has_own_clock(options.config)
    if not supervised:
        files = [*files, "-p", "use_sim_time:=true"]
    for name in CONSUMERS:
        nodes.append(NodeProcess(name, logs, files))
    if supervised:
        watched = ["rig", *CONSUMERS, *(["recorder"] if options.bag is not None else [])]
        nodes.append(NodeProcess(SUPERVISOR, logs, [*files, "-p", f"nodes:={json.dumps(watched)}"]))
    if options.page is not None:
        nodes.append(NodeProcess(PAGE, logs, [*files, *options.page]))
    # The rig itself makes the clock, so it does not follow it.
    own = ["-p", "use_sim_time:=false", "-p", "autostart:=false"]
    own += ["-p", f"supervisor_required:={json.dumps(supervised)}"]
    if options.instruments is not None:
        own += ["-p", f"instruments:={yaml_scalar(options.instruments)}"]
    rig = "rig" if _parameter(options.config, "rig", "driver", "virtual") != "virtual" else "simulator"
    nodes.append(NodeProcess(rig, logs, [*files, *own]))
    graph.transition(Transition.TRANSITION_CONFIGURE, _START_TIMEOUT)
    # The recorder comes last, so that its bag begins about when the run does, not while code is compiled.
    if options.bag is not None:
        nodes.append(NodeProcess("recorder", logs, [*files, "-p", f"directory:={yaml_scalar(str(options.bag))}"]))
    wanted = _wanted_listeners(options, len(nodes))
    graph.wait_for(lambda: graph.is_heard(wanted), "all nodes to listen", _START_TIMEOUT)
    recorded = _sampled(options, graph)
    graph.wait_for(lambda: graph.is_recorded(recorded), "the recorder to know the topics of samples", _START_TIMEOUT)
    graph.transition(Transition.TRANSITION_ACTIVATE, _START_TIMEOUT)
    graph.wait_for(lambda: graph.sampled_time() > 0.0, "the first block of samples", _START_TIMEOUT)
    return recorded


def _sampled(options: SessionOptions, graph: LiveGraph) -> list[str]:
    """Topics of samples that the rig publishes and this session records."""
    if options.bag is None:
        return []
    sampled = [name for name in ("daq/samples", "truth/samples") if name in graph.state.listeners]
    return [name for name in sampled if matching_topics([f"/{name}"], _recorded(options))]


def _wanted_listeners(options: SessionOptions, nodes: int) -> dict[str, int]:
    """Topic -> listeners that are waited for: the bag then begins with the run, in what is estimated too."""
    wanted = {"daq/samples": nodes, "friction/windows": 1}  # all nodes but the rig, and ourselves
    if options.bag is not None:
        recorded = _recorded(options)
        wanted["daq/samples"] -= 1  # the recorder, which takes what it has been told to
        for name in ("daq/samples", "friction/samples", "friction/windows", "friction/mu"):
            wanted[name] = wanted.get(name, 0) + len(matching_topics([f"/{name}"], recorded))
    return wanted


def _recorded(options: SessionOptions) -> Sequence[str]:
    """Patterns of the topics that the recorder writes."""
    patterns: Sequence[str] = _parameter(options.config, "recorder", "topics", DEFAULT_TOPICS)
    return patterns


def _has_own_clock(config: Path) -> bool:
    """Whether the rig of a parameter file publishes `/clock`: where it does not run in real time."""
    return bool(_parameter(config, "rig", "real_time_factor", 1.0) != 1.0)


def _parameter(config: Path, node: str, name: str, default: Any) -> Any:
    """A node's parameter in a parameter file; a block for the node alone counts before one for every node."""
    blocks = sorted(((node_of(key), values) for key, values in parameter_blocks(load_yaml(config))), key=itemgetter(0))
    found = [values[name] for whose, values in blocks if whose in ("", node) and name in values]
    return found[-1] if found else default


def _follow(options: SessionOptions, graph: LiveGraph, display: StateDisplay) -> None:
    """Run the plan, or let the rig run; how it went is told on the graph, so that a bag keeps it."""
    graph.on_spin = display.refresh
    plan = options.plan

    def tell(event: RunEvent) -> None:
        graph.tell(event)
        if event.what == STEP_BEGUN:
            display.note("step {step} of {of}: {title}".format_map(event.facts))

    planned = {"plan": plan.title, "steps": len(plan.steps), "duration [s]": plan.duration} if plan is not None else {}
    tell(RunEvent(RUN_STARTED, {**planned, **options.facts, "config": options.config}))
    outcome, failed = "done", False
    try:
        graph.ends_with_trip = options.work is not None or plan is not None
        if options.work is not None:
            options.work(graph, tell)
        elif plan is not None:
            run_plan(plan, graph, tell)
        else:
            end = math.inf if options.duration is None else graph.sampled_time() + options.duration
            while graph.sampled_time() < end:
                graph.spin()
    except BaseException as error:
        outcome, failed = str(error) or type(error).__name__, not isinstance(error, InterruptedByOperator)
        raise
    finally:
        tell(RunEvent(RUN_ENDED, {"outcome": outcome}, failed))
        if options.bag is not None:  # a run can end before the recorder has found the topic
            graph.wait_for_reader_of_events(_LATE_RECORDER)


def wait_for_end(process: NodeProcess, check: Callable[[], None], timeout: float) -> int:
    """Wait for a process to end by itself, calling `check` meanwhile; its exit code."""
    deadline = time.monotonic() + timeout
    while True:
        check()
        code = process.wait(0.05)
        if code is not None:
            return code
        if time.monotonic() > deadline:
            raise ExperimentError(f"node {process.name} did not end within {timeout:g} s")
