"""Every fault of the matrix ends in its documented state, and none in an unhandled exception."""

import os
import platform
import signal
from datetime import datetime, timezone
from pathlib import Path

import pytest

from tests.graph.statuses import status_of

pytest.importorskip("rclpy")

from .bench import LEVELS, running_bench
from .matrix import CASES, STOP, TABLE

_SILENT = "no heartbeat of the supervisor"
_HEAD = """# Fault matrix

Written by `make faults` from a run of `tests/faults`; do not edit. Each fault is injected into a running rig with its
supervisor, on the ROS graph; *ends* is the level that it must end in, *within* the longest time to there with the
settings of this run, *measured*
the time of this run from the injection: to the trip, where the supervisor finds it; to the safe command accepted by the
driver, where the rig or the process beside it (watchdog) does. No process may end that is not named in the matrix, and
no log may hold a traceback. The rig is then mended by the procedure of [supervisor](supervisor.md) before the next
fault.

"""


@pytest.fixture(scope="module")
def bench(compiled, tmp_path_factory, config_file):
    with (
        pytest.MonkeyPatch.context() as patch,
        running_bench(tmp_path_factory.mktemp("faults"), patch, config_file) as b,
    ):
        yield b


@pytest.fixture(scope="module")
def rows():
    """Rows of the table; written at the end where a file is named for it."""
    found = []
    yield found
    if TABLE and found:
        Path(TABLE).write_text(table(found), encoding="utf-8")


def table(rows):
    lines = ["| fault | ends | found by | within [s] | measured [s] | |", "|---|---|---|---|---|---|"]
    for case, measured in rows:
        verdict = "in time" if measured <= case.within else "LATE"
        lines.append(f"| {case.name} | {case.ends} | {case.by} | {case.within:g} | {measured:.3f} | {verdict} |")
    late = sum(measured > case.within for case, measured in rows)
    now = f"{datetime.now(timezone.utc):%Y-%m-%d}"
    load = f"load of the machine with other work on it (1 min average) {os.getloadavg()[0]:.1f}, {os.cpu_count()} cores"
    made = f"{now}, {platform.machine()}, Python {platform.python_version()}; {load}"
    summary = f"\n{len(rows)} faults, {late} late. {made}.\n"
    return _HEAD + "\n".join(lines) + "\n" + summary


def _parameters():
    return [pytest.param(case, id=case.name, marks=() if case.normal else pytest.mark.slow) for case in CASES]


class DisturbedError(Exception):
    """The machine stood still for so long that the rig fell for another reason than the case's."""


def _told(bench, case, begun):
    """Time [ns] at which the supervisor told the fault at its level; None where it has not."""
    for message in bench.trips:
        _, sentence, values = status_of(message, "supervisor trip")
        at = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        if case.says in sentence and LEVELS[values["level"]] >= LEVELS[case.ends] and at >= begun:
            return at
    return None


def _highest(bench, case):
    """The highest level at which the supervisor told the fault."""
    told = [status_of(message, "supervisor trip") for message in bench.trips]
    return max((values["level"] for _, sentence, values in told if case.says in sentence), key=LEVELS.get)


def _stopped(bench, case, begun):
    """Time [ns] at which the driver had accepted the stop that the rig found."""
    state = bench.status(bench.safe, "rig safe")
    if state and state[2]["stopped"] == "true" and state[2]["accepted"] == "true" and case.says in state[1]:
        at = int(state[2]["accepted [ns]"])
        return at if at >= begun else None
    return None


def _stopped_from_outside(bench, _case, begun):
    mark = bench.faults / "done from outside"
    text = mark.read_text() if mark.exists() else ""
    return int(text.split()[0]) if text and int(text.split()[0]) >= begun else None


def _refuse_disturbed(bench, case):
    """Raise `DisturbedError` where the rig's own stop or the process beside it was faster than the case."""
    state = bench.status(bench.safe, "rig safe")
    if state and state[2]["stopped"] == "true" and _SILENT in state[1] and case.says != _SILENT:
        raise DisturbedError(state[1])
    rig = bench.nodes["rig"]
    if not rig.running and "rig" not in case.dies and rig.wait() == -signal.SIGKILL:
        if (bench.faults / "done from outside").exists():
            raise DisturbedError("the rig was killed by the process beside it")


@pytest.mark.parametrize("case", _parameters())
def test_a_fault_ends_where_it_is_documented_to(bench, rows, measured, case):
    seconds = None
    for _ in range(3):
        try:
            seconds = run(bench, case)
        except DisturbedError as disturbed:
            measured(f"{case.name}: injected again, the rig had fallen before: {disturbed}")
        finally:
            case.after(bench)
            errors = {name: node.errors for name, node in bench.nodes.items()}  # before any is started again
            for trip in bench.mend():
                measured(f"{case.name}: while it was mended the rig tripped again: {trip}")
        assert not [name for name, text in errors.items() if "Traceback" in text], errors
        if seconds is not None:
            break
    assert seconds is not None, "the machine stood still three times"
    rows.append((case, seconds))
    measured(f"{case.name}: {seconds:.3f} s, documented {case.within:g} s")


def run(bench, case):
    """Inject a fault and see where it ends; returns after how long [s] that was found."""
    observer = bench.observer
    before = {name: node.process.pid for name, node in bench.nodes.items()}
    begun = case.inject(bench)
    find = {"supervisor": _told, "rig": _stopped, "watchdog": _stopped_from_outside}[case.by]

    def told():
        at = find(bench, case, 1e9 * begun)  # not one of before
        if at is None:
            _refuse_disturbed(bench, case)
        return at

    found = observer.wait_for(told, f"{case.ends}: {case.says}")
    if "supervisor" not in case.dies and "supervisor hung" not in case.name:
        observer.wait_for(lambda: LEVELS[bench.level()] >= LEVELS[case.ends], f"level {case.ends}")
        if case.ends != STOP:
            observer.spin(0.5)
            # No higher; what a busy machine adds beside it, as samples that come late, is not this fault.
            assert _highest(bench, case) == case.ends
    if case.ends == STOP and "rig" not in case.dies:
        if bench.nodes["rig"].process.pid == before["rig"]:
            observer.wait_for(bench.is_safe, "the rig's safe state")
    for name in case.dies:
        observer.wait_for_end(bench.nodes[name])
    _refuse_disturbed(bench, case)
    died = {name for name, node in bench.nodes.items() if not node.running}
    assert died == set(case.dies)
    return 1e-9 * found - begun
