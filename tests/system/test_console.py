"""The live console shows what others wrote, and nothing that they may write ends it."""

import io

import pytest

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rich.console import Console

from squeal_rig.session.console import StateDisplay
from squeal_rig.session.live import LiveGraph, LiveState

HOSTILE = "[/x] [bold]loud[/bold] \x1b[2J\x07"


@pytest.mark.parametrize("terminal", [False, True])
def test_texts_of_others_are_shown_as_they_are_without_control_characters(terminal):
    out = io.StringIO()
    console = Console(file=out, force_terminal=terminal, width=200, color_system=None)
    state = LiveState(health={HOSTILE: (2, HOSTILE)})
    with StateDisplay(console, state) as display:
        display.note(HOSTILE)
        display.refresh()
    shown = out.getvalue()
    assert "[/x] [bold]loud[/bold] " in shown
    assert "\x1b[2J" not in shown
    assert "\x07" not in shown


def test_statuses_that_lack_what_is_looked_for_are_taken(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    graph = LiveGraph(lambda: None)
    try:
        graph._on_stability(DiagnosticArray())
        graph._on_squeal(DiagnosticArray())
        graph._on_squeal(DiagnosticArray(status=[DiagnosticStatus()]))
        graph._on_health(DiagnosticArray(status=[DiagnosticStatus(name="recorder")]))
        assert graph.state.squealing is False
        assert graph.state.health == {"recorder": (0, "")}
    finally:
        graph.close()
