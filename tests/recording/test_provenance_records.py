"""What a bag tells about its run: facts that come late, parameters and their changes, in every file."""

import time

import pytest
from bag_making import START, block_cdr

from squeal_rig.recording import Bag, BagWriter
from squeal_rig.recording.parameter_log import ParameterLog, parameters_of
from squeal_rig.recording.recover import recover
from tests.messages import schema_of


def test_parameters_at_start_and_changes_read_back_as_they_were():
    log = ParameterLog()
    start = {"preload": 50.0, "driver": "virtual", "topics": ["a", "b"], "autostart": True, "rate": 51200}
    name, record = log.at_start("/rig", start, 5)
    assert (name, parameters_of(record)) == ("parameters", ("/rig", 5, start))
    name, record = log.changed("/rig", {"preload": 0.1 + 0.2}, ("driver",), 6)
    assert (name, parameters_of(record)) == ("parameter_change", ("/rig", 6, {"preload": 0.1 + 0.2, "driver": None}))
    ((name, record),) = log.current(7)
    after = {key: value for key, value in start.items() if key != "driver"} | {"preload": 0.1 + 0.2}
    assert (name, parameters_of(record)) == ("parameters", ("/rig", 7, after))


def test_a_change_of_a_node_not_yet_known_is_a_record_too():
    name, record = ParameterLog().changed("/late", {"x": 1}, (), 3)
    assert (name, parameters_of(record)) == ("parameter_change", ("/late", 3, {"x": 1}))


@pytest.fixture
def split_bag(tmp_path):
    log = ParameterLog()
    cloud = schema_of("sensor_msgs/msg/PointCloud2")
    with BagWriter(tmp_path / "run") as writer:
        writer.keep_in_every_file(lambda: log.current(START))
        writer.add_metadata(*log.at_start("/rig", {"preload": 50.0}, START))
        writer.add_custom_data({"preset": "yavuz_sen_2023"})
        handle = writer.add_topic("/daq/samples", cloud.type_name, schema=cloud)
        for number in range(4):
            writer.write(handle, block_cdr(number, START + number), START + number, START)
            if number < 3:
                writer.split()
    return tmp_path / "run"


def test_every_file_of_a_split_bag_tells_parameters_and_facts(split_bag):
    files = sorted(split_bag.glob("*.mcap"))
    assert len(files) == 4
    for path in files:
        alone = Bag(path)
        assert alone.custom_data["preset"] == "yavuz_sen_2023"
        ((_, _, values),) = [parameters_of(r.values) for r in alone.metadata_records if r.name == "parameters"]
        assert values == {"preload": 50.0}


def test_facts_that_came_late_survive_a_kill(tmp_path):
    cloud = schema_of("sensor_msgs/msg/PointCloud2")
    writer = BagWriter(tmp_path / "run", custom_data={"seed": "7"})
    writer.add_custom_data({"preset": "yavuz_sen_2023"})
    handle = writer.add_topic("/daq/samples", cloud.type_name, schema=cloud)
    writer.write(handle, block_cdr(0, START), START, START)
    writer.flush()  # and never closed
    recover(tmp_path / "run" / "run_0.mcap", tmp_path / "out")
    saved = Bag(tmp_path / "out")
    assert (saved.custom_data["seed"], saved.custom_data["preset"]) == ("7", "yavuz_sen_2023")
    assert saved.ending == "aborted: the recording was not closed; recovered"
    writer.close("complete")


def test_numbers_of_messages_go_on_over_the_files_of_a_bag(split_bag):
    assert [message.sequence for message in Bag(split_bag).messages()] == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("value", "sentence"),
    [([0.5] * 1_000_000, "left out: 1000000 values"), ("x" * 10**7, "left out: 10000000 characters")],
)
def test_a_value_that_would_hold_the_recorder_up_is_left_out_and_the_others_are_not(value, sentence):
    log = ParameterLog()
    begin = time.monotonic()
    _, record = log.at_start("/other", {"before": 1, "large": value, "after": "there"}, 5)
    expected = {"before": 1, "large": sentence, "after": "there"}
    assert parameters_of(record)[2] == expected
    _, record = log.changed("/other", {"large": value}, (), 6)
    assert parameters_of(record)[2] == {"large": sentence}
    assert parameters_of(log.current(7)[0][1])[2] == expected
    _, record = log.at_start("/many", {f"parameter_{k}": 0.5 for k in range(100_000)}, 8)
    kept = parameters_of(record)[2]
    assert kept.pop("left out") == f"{100_000 - len(kept)} parameters"
    assert 1000 < len(kept) < 10_000
    (many,) = (record for _, record in log.current(9) if record["node"] == "/many")
    again = parameters_of(many)[2]
    assert again == {**kept, "left out": f"{100_000 - len(kept)} parameters"}
    assert time.monotonic() - begin < 60.0  # minutes without the bound
