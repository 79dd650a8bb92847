"""The fuzz suite itself: it makes inputs, and it sees what it is there to see."""

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from mcap.reader import make_reader

from squeal_rig.errors import RecordingError
from tests.made_bag import write_squeal

from . import bags, records, yaml_files
from .__main__ import signature
from .bounded import Notes


@pytest.mark.parametrize("kind", [records, yaml_files])
def test_generators_make_inputs_that_differ(tmp_path, kind):
    kind.make_corpus(tmp_path)
    seen = set()

    @settings(
        max_examples=20, database=None, deadline=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck)
    )
    @given(kind.cases(tmp_path))
    def draw(case):
        seen.update(case.files.values())

    draw()
    assert len(seen) > 10


def test_a_file_taken_apart_and_put_together_is_the_same_file(tmp_path):
    """Else all that lies in a rebuilt file would be found at once, and nothing behind it."""
    write_squeal(tmp_path / "bag")
    data = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    parts = bags.records_in(data)
    assert bags.rebuilt(parts, relocate=True) == data


def test_what_moves_in_a_rebuilt_file_is_found_where_the_index_says(tmp_path):
    write_squeal(tmp_path / "bag")
    parts = bags.records_in((tmp_path / "bag" / "bag_0.mcap").read_bytes())
    more = [parts[0], bags.Record(0x80, b"of another program"), *parts[1:]]
    path = tmp_path / "longer.mcap"
    path.write_bytes(bags.rebuilt(more, relocate=True))
    with open(path, "rb") as stream:
        assert sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages()) == 201


def test_errors_of_others_are_findings_and_ours_are_not():
    def refuse():
        raise RecordingError("no")

    def fail(value):
        return value[3]

    steps = []
    notes = Notes(steps.append)
    assert notes.step("refused", refuse) is None
    assert not notes.found
    for value in ([], [1]):
        notes.step("failed", fail, value)
    assert [signature(text) for text in notes.found] == ["exception in failed IndexError"] * 2
    assert steps == ["refused", "failed", "failed"]
