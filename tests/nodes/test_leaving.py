"""Nodes leave the graph in bounded time, whatever the middleware does then."""

import sys
import time

import pytest

pytest.importorskip("rclpy")

# As `squeal_rig.graph.leaving` has it, and what a busy machine needs to start and end Python.
_PATIENCE = 4.0
_ENDING = 20.0


def _child(processes, what, seconds=0.0):
    return processes.start([sys.executable, "-m", "tests.graph.leaves", what, seconds])


def test_a_middleware_that_does_not_let_go_is_left_with_the_exit_code_of_the_process(processes):
    child = _child(processes, "stuck")
    assert child.wait() == 3
    assert child.output.split()[1] == "kept"
    assert "did not let us leave the graph within 4 s" in child.errors


@pytest.mark.long
def test_every_leave_ends_while_news_come_in(processes, measured):
    """Without the bound, one in some thousand hangs for good and leaves nobody a processor."""
    seconds = 240.0
    for _ in range(2):
        _child(processes, "churn", seconds + _ENDING)
    told, end = [], time.monotonic() + seconds
    while (left := end - time.monotonic()) > 1.0:
        guests = [_child(processes, "come-and-go", min(left, 60.0)) for _ in range(4)]
        for guest in guests:
            code = guest.wait(60.0 + _PATIENCE + _ENDING)
            lines = [line.split() for line in guest.output.splitlines()]
            assert code == (3 if lines[-1][1] == "kept" else 0), guest.errors
            told += lines
    took = [float(seconds) for seconds, _ in told]
    assert max(took) < _PATIENCE + _ENDING
    kept = sum(how == "kept" for _, how in told)
    measured(f"{len(told)} leaves, longest {max(took):.2f} s, not let go {kept}")
