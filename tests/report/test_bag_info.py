"""What `bag info` tells besides counts."""

from squeal_rig.recording import BagWriter
from squeal_rig.recording.cdr import diagnostics_message
from squeal_rig.report.bag_info import bag_info
from squeal_rig.report.terminal import PlainConsole
from tests.messages import schema_of, string_cdr

STATUSES = schema_of("diagnostic_msgs/msg/DiagnosticArray")
TEXT = schema_of("std_msgs/msg/String")


def told(bag, quick=False):
    console = PlainConsole(width=200)
    with console.capture() as shown:
        console.print(bag_info(bag, quick))
    return shown.get()


def bag_of_trips(directory, trips):
    """A bag that begins at 1 s; a trip is (seconds after its beginning, level, raised the level, sentence)."""
    with BagWriter(directory) as writer:
        words = writer.add_topic("/rig/description", TEXT.type_name, schema=TEXT)
        topic = writer.add_topic("/left/supervisor/trips", STATUSES.type_name, schema=STATUSES)
        writer.write(words, string_cdr("x"), 10**9, 10**9)
        for seconds, level, raised, sentence in trips:
            time = round((1.0 + seconds) * 1e9)
            values = {"rule": "force", "level": level, "raised the level": raised}
            data = diagnostics_message(time, "rig", [(2, "supervisor trip", sentence, values)])
            writer.write(topic, data, max(time, 10**9), time)
    return directory


def test_a_run_that_was_tripped_is_not_only_called_complete(tmp_path):
    trips = [
        (0.5, "warn", "true", "a force is high"),
        (1.5, "ramp down", "true", "a force is too high"),
        (2.25, "emergency stop", "true", "somebody asked for it"),
        (2.5, "emergency stop", "false", "asked for again"),
        (3.0, "ok", "false", "reset: found and mended"),
    ]
    text = told(bag_of_trips(tmp_path / "run", trips))
    assert "ramp down at 1.5 s: a force is too high" in text
    assert "emergency stop at 2.2 s: somebody asked for it" in text
    assert text.count("supervisor  ") == 2
    for silent in ("a force is high", "asked for again", "mended"):
        assert silent not in text


def test_a_run_without_trips_says_nothing_of_the_supervisor(tmp_path):
    text = told(bag_of_trips(tmp_path / "run", [(0.5, "warn", "true", "a force is high")]))
    assert "complete" in text
    assert "supervisor  " not in text


def test_trips_of_a_run_before_are_not_those_of_this_bag(tmp_path):
    text = told(bag_of_trips(tmp_path / "run", [(-0.5, "emergency stop", "true", "in the morning")]))
    assert "in the morning" not in text


def test_many_trips_are_counted(tmp_path):
    trips = [(number, "emergency stop", "true", f"number {number}") for number in range(9)]
    text = told(bag_of_trips(tmp_path / "run", trips))
    assert "number 4" in text
    assert "number 5" not in text
    assert "4 more" in text


def test_trips_of_another_type_are_a_sentence(tmp_path):
    with BagWriter(tmp_path / "run") as writer:
        topic = writer.add_topic("/supervisor/trips", TEXT.type_name, schema=TEXT)
        writer.write(topic, string_cdr("x"), 1, 1)
    assert "its trips cannot be read: A message holds no diagnostic statuses" in told(tmp_path / "run")
