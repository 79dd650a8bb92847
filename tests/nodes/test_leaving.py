"""Nodes leave the graph, and end in bounded time where the middleware does not let them."""

import re
import signal
import sys
import time

import pytest

pytest.importorskip("rclpy")

from squeal_rig.graph.leaving import PATIENCE

# Starting and ending Python, on a busy machine [s].
_BUSY = 20.0


def _guest(processes, what, *seconds):
    return processes.start([sys.executable, "-m", "tests.graph.guest", what, *seconds])


def test_who_has_left_is_seen_no_more(processes, observer):
    def there():
        return "guest" in observer.node.get_node_names()

    guest = _guest(processes, "stay")
    observer.wait_for(there, "the guest")
    guest.send(signal.SIGINT)
    observer.wait_for(lambda: guest.output, "its leave")
    # A participant that says nothing is forgotten after 20 s.
    observer.wait_for(lambda: not there(), "a graph without it", 5.0)
    assert guest.output.split()[1] == "left"
    guest.kill()


def test_a_rig_that_has_left_says_nothing_more(processes, observer):
    rig = processes.node("simulator")
    observer.wait_for(lambda: "rig" in observer.node.get_node_names(), "the rig")
    rig.end()
    assert "Warning" not in rig.errors
    assert "Failed" not in rig.errors


def test_a_middleware_that_does_not_let_go_is_left_with_the_exit_code_of_the_process(processes):
    guest = _guest(processes, "stuck")
    assert guest.wait() == 3
    assert guest.output.split()[1] == "kept"
    assert f"did not let us leave the graph within {PATIENCE:g} s" in guest.errors


@pytest.mark.long
def test_every_leave_ends_while_news_come_in(processes, measured):
    """Without the bound, about one in two thousand hangs for good."""
    seconds = 240.0
    churners = [_guest(processes, "churn", seconds + 60.0) for _ in range(2)]
    told, end = [], time.monotonic() + seconds
    while (left := end - time.monotonic()) > 1.0:
        for guest in [_guest(processes, "come-and-go", min(left, 60.0)) for _ in range(4)]:
            code = guest.wait(60.0 + PATIENCE + _BUSY)
            # Fast DDS writes there, too.
            lines = re.findall(r"^([\d.]+) (left|kept)$", guest.output, flags=re.MULTILINE)
            assert lines, guest.errors
            assert code == (3 if lines[-1][1] == "kept" else 0), guest.errors
            told += lines
        assert all(churner.running for churner in churners)
    kept = sum(how == "kept" for _, how in told)
    measured(f"{len(told)} leaves, longest {max(float(took) for took, _ in told):.2f} s, not let go {kept}")
