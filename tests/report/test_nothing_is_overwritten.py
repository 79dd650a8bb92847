"""What the user has is never overwritten without --force, and links are not followed."""

import os
import stat

import pytest
from recorded_rig import record
from test_odd_bags import squeal_rig

from squeal_rig.configuration.new_files import new_file
from squeal_rig.errors import RecordingError
from squeal_rig.samples.export import export_bag


@pytest.fixture
def run(tmp_path, compiled_zones):
    record(tmp_path / "run", blocks=60)
    return tmp_path / "run"


@pytest.fixture
def precious(tmp_path):
    path = tmp_path / "precious.txt"
    path.write_text("the user's")
    yield path
    assert path.read_text() == "the user's"


def test_analyse_overwrites_nothing_and_follows_no_link(run, precious):
    picture = run / "report.png"
    picture.symlink_to(precious)
    code, text = squeal_rig("analyse", run)
    assert (code, "exists already; --force overwrites it." in text) == (2, True)
    assert picture.is_symlink()
    assert squeal_rig("analyse", run, "--force")[0] == 0
    assert not picture.is_symlink()
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert squeal_rig("analyse", run)[0] == 2


@pytest.mark.parametrize(
    ("name", "code"),
    [("new/folder/a.png", 0), ("a.docx", 2), ("folder", 2), ("folder.png", 2), ("precious.txt/a.png", 2)],
)
def test_pictures_of_any_name_are_written_or_refused(run, precious, tmp_path, name, code):
    for folder in ("folder", "folder.png"):
        (tmp_path / folder).mkdir()
    got, text = squeal_rig("analyse", run, "--picture", tmp_path / name, "--force")
    assert got == code, text
    assert (tmp_path / "new" / "folder" / "a.png").is_file() == (code == 0)


def test_export_overwrites_nothing_and_follows_no_link(run, precious, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    part, file = out / "daq_samples.csv.part", out / "daq_samples.csv"
    part.write_text("the user's too")
    file.symlink_to(precious)
    with pytest.raises(RecordingError, match=r"daq_samples.csv exists already; --force overwrites it\.$"):
        export_bag(run, "csv", out, ["daq/samples"])
    export_bag(run, "csv", out, ["daq/samples"], force=True)
    assert not file.is_symlink()
    assert part.read_text() == "the user's too"
    code, _ = squeal_rig("bag", "export", run, out, "--to", "csv", "--topic", "daq/samples")
    assert code == 2
    assert squeal_rig("bag", "export", run, out, "--to", "csv", "--topic", "daq/samples", "--force")[0] == 0
    assert {path.name for path in out.iterdir()} == {part.name, file.name}


def test_a_dangling_link_counts_as_a_file(tmp_path):
    path = tmp_path / "a.txt"
    path.symlink_to(tmp_path / "nowhere")
    with pytest.raises(RecordingError, match="exists already"), new_file(path):
        pass
    assert not (tmp_path / "nowhere").exists()


def test_a_file_that_came_meanwhile_is_kept_and_the_draft_goes(tmp_path):
    path = tmp_path / "a.txt"

    def write():
        with new_file(path) as draft:
            draft.write_text("ours")
            path.write_text("somebody's")

    with pytest.raises(RecordingError, match="exists already"):
        write()
    assert path.read_text() == "somebody's"
    assert list(tmp_path.iterdir()) == [path]


def test_a_new_file_has_the_rights_of_any_new_file(tmp_path):
    before = os.umask(0o027)
    try:
        with new_file(tmp_path / "a.txt") as draft:
            draft.write_text("ours")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == 0o640


def test_a_closing_bag_writes_through_no_link_in_its_folder(tmp_path, precious):
    from squeal_rig.recording import Bag, BagWriter

    writer = BagWriter(tmp_path / "run")
    for name in ("metadata.yaml", "metadata.tmp"):
        (tmp_path / "run" / name).symlink_to(precious)
    writer.close("complete")
    assert Bag(tmp_path / "run").ending == "complete"
