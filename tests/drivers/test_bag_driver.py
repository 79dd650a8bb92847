"""A recorded run as if it were the rig: its samples, pace, losses and restarts; nobody moves it."""

import dataclasses
import itertools
import time

import numpy as np
import pytest

from squeal_rig.drivers.bag import BagRig
from squeal_rig.errors import DriverError, SquealRigError
from squeal_rig.instruments.acquisition import Acquisition, change_refusal
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.instruments.virtual import VirtualRig
from squeal_rig.model import RigParameters
from squeal_rig.recording import BagWriter, QosProfile, cdr_from_samples
from tests.messages import schema_of, string_cdr

PARAMETERS = RigParameters(damping_x=20.0, damping_y=20.0)
START = 1_700_000_000 * 10**9
RATE = 12800
SETTINGS = {"sample_rate": RATE, "driver": "bag"}


@pytest.fixture(scope="module")
def blocks():
    """Half a second of the virtual rig."""
    rig = Acquisition(VirtualRig(), PARAMETERS, RigSettings(sample_rate=RATE))
    rig.start(START)
    return [rig.next_block() for _ in range(50)]


def write(folder, blocks, truth=True):
    """A bag of these blocks."""
    string, cloud = schema_of("std_msgs/msg/String"), schema_of("sensor_msgs/msg/PointCloud2")
    with BagWriter(folder) as writer:
        description = writer.add_topic("/rig/description", string.type_name, [QosProfile(depth=1)], string)
        names = ("daq/samples", "truth/samples") if truth else ("daq/samples",)
        topics = [writer.add_topic(f"/{name}", cloud.type_name, [QosProfile()], cloud) for name in names]
        writer.write(description, string_cdr(RigDescription(PARAMETERS, sample_rate=RATE).to_yaml()), START, START)
        for number, block in enumerate(blocks):
            for topic, samples in zip(topics, (block.daq, block.truth), strict=False):
                log_time = START + number * 10**7
                writer.write(topic, cdr_from_samples(samples, block.stamp), log_time, log_time)
    return folder


def opened(folder, bag, parameters=PARAMETERS, **more):
    """The driver on a bag, and its acquisition."""
    config = folder / "driver.yaml"
    lines = "".join(f"{name}: {value}\n" for name, value in more.items())
    config.write_text(f"driver: bag\nbag: {bag}\n{lines}")
    settings = RigSettings.from_mapping({**SETTINGS, "driver_config": str(config)})
    driver = BagRig()
    can = driver.capabilities(settings)
    return driver, can, Acquisition(driver, parameters, settings)


def read_all(acquisition, count):
    found, deadline = [], time.monotonic() + 120.0
    while len(found) < count:
        block = acquisition.poll()
        if block is not None:
            found.append(block)
        assert time.monotonic() < deadline
        time.sleep(0.0005)
    return found


def shifted(block, seconds=0.0, seq=0):
    """The block later, and numbered on by that much."""
    daq, truth = block.daq.copy(), block.truth.copy()
    for samples in (daq, truth):
        samples["seq"] += np.uint32(seq)
    return dataclasses.replace(block, stamp=block.stamp + round(seconds * 1e9), daq=daq, truth=truth)


def test_samples_and_truth_are_those_of_the_bag(blocks, tmp_path):
    _, can, rig = opened(tmp_path, write(tmp_path / "bag", blocks))
    assert (can.knows_truth, can.can_hit, can.keeps_time, can.set_points) == (True, False, True, frozenset())
    found = read_all(rig, len(blocks))
    for given, block in zip(blocks, found, strict=True):
        assert np.array_equal(given.daq, block.daq)
        assert np.array_equal(given.truth, block.truth)
        assert block.warnings == ()
    steps = np.diff([block.stamp for block in found])
    assert set(steps) == set(np.diff([block.stamp for block in blocks]))


def test_its_end_is_told_and_a_reset_begins_it_anew(blocks, tmp_path):
    driver, _, rig = opened(tmp_path, write(tmp_path / "bag", blocks[:5]))
    read_all(rig, 5)
    for _ in range(2):
        with pytest.raises(DriverError, match=r"bag has ended after 5 blocks$"):
            driver.read(PARAMETERS)
    rig.reset()
    again = read_all(rig, 5)
    assert np.array_equal(again[0].daq["x"], blocks[0].daq["x"])
    assert int(again[0].daq["seq"][0]) == 5 * len(blocks[0].daq)


def test_what_was_lost_then_is_lost_again(blocks, tmp_path):
    kept = [block for number, block in enumerate(blocks) if number not in (3, 4, 7)]
    _, _, rig = opened(tmp_path, write(tmp_path / "bag", kept))
    found = read_all(rig, len(kept))
    for given, block in zip(kept, found, strict=True):
        assert np.array_equal(given.daq["seq"], block.daq["seq"])
    assert found[3].stamp - found[2].stamp == kept[3].stamp - kept[2].stamp


def test_a_rig_that_was_started_anew_is_told(blocks, tmp_path):
    second = [shifted(block, seconds=0.3) for block in blocks[:5]]
    _, _, rig = opened(tmp_path, write(tmp_path / "bag", [*blocks[:10], *second]))
    found = read_all(rig, 15)
    assert found[10].warnings == ("the recorded rig was started anew here",)
    assert [len(block.warnings) for block in found].count(0) == 14
    assert int(found[10].daq["seq"][0]) == 10 * len(blocks[0].daq)


def test_stamps_that_run_back_and_long_pauses_are_told_and_do_not_stop_time(blocks, tmp_path):
    size = len(blocks[0].daq)
    back = [shifted(block, seconds=-100.0) for block in blocks[5:10]]
    late = [shifted(block, seconds=5000.0, seq=0) for block in blocks[10:15]]
    _, _, rig = opened(tmp_path, write(tmp_path / "bag", [*blocks[:5], *back, *late]), longest_pause=0.05)
    found = read_all(rig, 15)
    stamps = [block.stamp for block in found]
    assert all(after > before for before, after in itertools.pairwise(stamps))
    told = [sentence for block in found for sentence in block.warnings]
    assert any("recorded stamps run back here, by 100 s" in sentence for sentence in told)
    assert any("is cut to 0.06 s" in sentence for sentence in told)
    assert int(found[-1].daq["seq"][-1]) >= 15 * size - 1


def test_a_bag_without_truth_is_a_rig_without(blocks, tmp_path):
    _, can, rig = opened(tmp_path, write(tmp_path / "bag", blocks[:3], truth=False))
    assert not can.knows_truth
    assert all(block.truth is None for block in read_all(rig, 3))


def test_nothing_can_be_moved_or_hit(blocks, tmp_path):
    driver, can, rig = opened(tmp_path, write(tmp_path / "bag", blocks[:3]))
    assert "cannot be moved by this rig's driver" in str(change_refusal("preload", can))
    with pytest.raises(DriverError, match="cannot be given an impact"):
        rig.impact()
    rig.make_safe()
    driver.close()
    with pytest.raises(DriverError, match="not open"):
        driver.read(PARAMETERS)


def test_constants_and_rate_have_to_be_those_of_the_bag(blocks, tmp_path):
    bag = write(tmp_path / "bag", blocks[:3])
    with pytest.raises(DriverError, match=r"^mass = 5.0, but the rig of .* was one of 11.499$"):
        opened(tmp_path, bag, PARAMETERS.replace(mass=5.0))
    config = tmp_path / "driver.yaml"
    settings = RigSettings(driver="bag", driver_config=str(config))
    with pytest.raises(DriverError, match=r"^sample_rate = 51200 Hz, but .* was recorded at 12800 Hz$"):
        BagRig().open(PARAMETERS, settings)
    opened(tmp_path, bag, PARAMETERS.replace(preload=300.0))  # an operating point is not the bag's


@pytest.mark.parametrize("text", ["driver: bag\n", "driver: bag\nbag: /nowhere/at/all\n", "driver: bag\nbag: 3\n"])
def test_no_bag_is_said_before_it_is_opened(text, tmp_path):
    config = tmp_path / "driver.yaml"
    config.write_text(text)
    with pytest.raises(SquealRigError):
        BagRig().capabilities(RigSettings(driver="bag", driver_config=str(config)))
    with pytest.raises(SquealRigError, match="names no file"):
        BagRig().capabilities(RigSettings(driver="bag"))
