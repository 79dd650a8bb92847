"""Friction and stability computed again from a log: what the live nodes published, field by field."""

import numpy as np
import pytest
from recorded_rig import record

from squeal_rig.analysis.estimate import compare_estimates, estimate_bag
from squeal_rig.recording import Bag, samples_from_cdr
from squeal_rig.recording.verify import verify

WITH_OUTPUT = ("friction/samples", "friction/windows", "friction/mu", "stability/summary", "stability/eigenvalues")


@pytest.fixture(scope="module", params=["/", "/lab/"])
def recorded(request, tmp_path_factory):
    directory = tmp_path_factory.mktemp("estimate") / "run"
    return request.param, directory, record(directory, prefix=request.param)


def test_what_is_computed_again_equals_what_was_published_in_every_field(recorded, tmp_path):
    prefix, directory, _ = recorded
    report = estimate_bag(directory, tmp_path / "again")
    assert report.unexplained == 0
    compared = {c.topic: c for c in compare_estimates(Bag(directory), Bag(tmp_path / "again"))}
    for name in WITH_OUTPUT:
        c = compared[prefix + name]
        assert c.recorded == c.computed == c.equal > 3, c
    assert verify(tmp_path / "again").sound


def test_the_comparison_sees_a_single_bit(recorded, tmp_path):
    from squeal_rig.recording import BagWriter

    prefix, directory, _ = recorded
    bag = Bag(directory)
    name = f"{prefix}friction/windows"
    with BagWriter(tmp_path / "other") as writer:
        handle = writer.add_topic(name, bag.topics[name].type_name, schema=bag.topics[name].schema)
        for number, message in enumerate(bag.messages([name])):
            data = bytearray(message.data)
            if number == 2:
                window = samples_from_cdr(message.data).samples[0]
                at = message.data.index(np.float64(window["mu"]).tobytes())
                data[at] ^= 1
            writer.write(handle, bytes(data), message.log_time, message.publish_time)
    (compared,) = compare_estimates(bag, Bag(tmp_path / "other"))
    assert compared.equal == compared.recorded - 1


def test_a_log_of_samples_alone_is_enough(tmp_path):
    """No friction, no stability in the bag: their definitions come from elsewhere or are asked for in a sentence."""
    pytest.importorskip("rclpy", reason="the definitions of messages that the bag lacks come from ROS")
    record(tmp_path / "live", blocks=80)
    record(tmp_path / "run", blocks=80, live=False)
    estimate_bag(tmp_path / "run", tmp_path / "again")
    compared = {c.topic: c for c in compare_estimates(Bag(tmp_path / "live"), Bag(tmp_path / "again"))}
    for name in ("/friction/samples", "/friction/windows", "/friction/mu"):
        assert compared[name].recorded == compared[name].computed == compared[name].equal > 0
    assert compared["/stability/summary"].computed > 3
