"""Every event that ends is told in `squeal/state`, also where several end between two messages."""

from types import SimpleNamespace

import pytest

from squeal_rig.estimation.squeal import SquealState
from squeal_rig.estimation.squeal_events import SquealEvent

pytest.importorskip("rclpy")

from squeal_rig.graph.conversions import status_values  # needs ROS
from squeal_rig.nodes.squeal_detector import SquealDetectorNode  # needs ROS


def _event(number, frequency):
    return SquealEvent(number, 0.1 * number, 0.1 * number + 0.5, [0.2], [frequency], [-10.0])


def _told(*blocks):
    """The values of `squeal/state` where blocks end these events; a block is (events, whether a message is due)."""
    messages = []
    node = SimpleNamespace(_ended=[], _told=0, _publisher=SimpleNamespace(publish=messages.append))
    for ended, due in blocks:
        states = [SquealState(0, False, -40.0, 0.0, None)] if due else []
        node._events = SimpleNamespace(current=[], tones=[], count=9, add_samples=lambda _daq, ended=ended: ended)
        node._detector = SimpleNamespace(add_samples=lambda _stamp, _daq, states=states: states)
        SquealDetectorNode._on_block(node, 0, None)
    return [status_values(message.status[0]) for message in messages]


def test_all_events_that_ended_since_the_last_message_are_in_the_next():
    first, second, third, fourth = (_event(number, 1000.0 + number) for number in range(1, 5))
    told = _told(([], True), ([first, second], False), ([third], True), ([], True), ([fourth], True))
    assert [values["ended events"] for values in told] == ["none", "1 2 3", "none", "4"]
    assert [values["ended event"] for values in told] == ["0", "3", "3", "4"]
    assert [told[1][f"ended event{place}"] for place in (" 2", " 3")] == ["2", "1"]
    assert float(told[1]["ended frequency [Hz]"]) == 1003.0
    assert float(told[1]["ended frequency [Hz] 2"]) == 1002.0
    assert float(told[1]["ended frequency [Hz] 3"]) == 1001.0
    for values in (told[0], *told[2:]):
        assert "ended event 2" not in values
