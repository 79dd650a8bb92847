"""`squeal-rig bag ...` as a user runs it: what it prints, its exit codes, never a traceback."""

import pytest
from bag_making import write_bag

from tests.command_line import in_this_process


def squeal_rig(*arguments):
    """(exit code, what was printed) of the command line."""
    code, output, errors = in_this_process(*arguments)
    return code, output + errors


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    directory = tmp_path_factory.mktemp("commands") / "run"
    write_bag(directory, blocks=50, skip=(20,))
    return directory


def test_info_shows_rates_gaps_provenance_and_ending(bag):
    for command in (("bag", "info"), ("info",)):
        code, text = squeal_rig(*command, bag)
        assert code == 0
        for piece in ("complete", "seed", "/daq/samples", "3136", "64", "/rig"):
            assert piece in text
    assert "Samples" not in squeal_rig("bag", "info", bag, "--quick")[1]


def test_verify_tells_by_its_exit_code(bag, tmp_path):
    code, text = squeal_rig("bag", "verify", bag)
    assert code == 1
    assert "error: /daq/samples: 64 samples are missing in 1 gaps by seq" in text
    write_bag(tmp_path / "sound", blocks=10)
    code, text = squeal_rig("bag", "verify", tmp_path / "sound")
    assert (code, text.startswith("sound: 21 messages")) == (0, True)
    (tmp_path / "text.mcap").write_text("no bag at all")
    for nothing in (tmp_path / "nothing", tmp_path / "text.mcap"):
        assert squeal_rig("bag", "verify", nothing)[0] == 2


def test_recover_tells_what_is_lost(bag, tmp_path):
    file = tmp_path / "broken_0.mcap"
    file.write_bytes((bag / "run_0.mcap").read_bytes()[:-2000])
    code, text = squeal_rig("bag", "recover", file, tmp_path / "out")
    assert code == 1
    assert "saved" in text
    assert "was not closed" in text
    assert squeal_rig("bag", "recover", file, tmp_path / "out")[0] == 2, "an existing folder is not written to"
    code, text = squeal_rig("bag", "recover", bag, tmp_path / "whole")
    assert (code, "nothing is missing" in text) == (0, True)


def test_cut_merge_and_export_say_where_they_wrote(bag, tmp_path):
    assert squeal_rig("bag", "cut", bag, tmp_path / "a", "--end", "0.2")[0] == 0
    assert squeal_rig("bag", "cut", bag, tmp_path / "b", "--start", "0.2", "--topic", "daq/*")[0] == 0
    code, text = squeal_rig("bag", "merge", tmp_path / "a", tmp_path / "b", tmp_path / "ab")
    assert (code, "messages written to" in text) == (0, True)
    code, text = squeal_rig("bag", "export", tmp_path / "ab", tmp_path / "out", "--to", "csv")
    assert (code, "3136 rows" in text) == (0, True)
    code, text = squeal_rig("bag", "export", tmp_path / "ab", tmp_path / "out", "--to", "docx")
    assert code == 2
    assert "'docx'; it must be one of parquet, csv, hdf5, wav" in text.replace("\n", " ")


def test_what_is_no_recording_of_a_rig_cannot_be_estimated(bag, tmp_path):
    """This bag's description is not one of the rig's."""
    code, text = squeal_rig("bag", "estimate", bag, tmp_path / "out")
    assert code == 2
    assert "rig/description" in text
