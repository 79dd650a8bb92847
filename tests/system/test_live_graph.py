"""What the command line makes of the samples that it sees."""

import numpy as np
import pytest

from squeal_rig.instruments.channels import DAQ_RECORD
from squeal_rig.recording import cdr_from_samples

pytest.importorskip("rclpy")

_ROWS, _RATE = 512, 51200


@pytest.fixture
def graph(domain, monkeypatch):
    from squeal_rig.session.live import LiveGraph

    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    node = LiveGraph(lambda: None)
    yield node
    node.close()


def _block(seq):
    daq = np.zeros(_ROWS, DAQ_RECORD)
    daq["t"] = np.arange(_ROWS) / _RATE
    daq["seq"] = np.arange(seq, seq + _ROWS) % 2**32
    return cdr_from_samples(daq, 10**18)


@pytest.mark.parametrize(
    ("numbers", "blocks"),
    [
        ((0, 1, 2), 3),
        ((5, 6, 9), 5),  # two were lost
        ((100, 101, 0, 1), 4),  # a rig started again
        ((2**23 - 1, 0, 1), 3),  # numbers wrap
        ((7, 7), 2),  # a replay begun again
    ],
)
def test_sampled_time_counts_lost_blocks_and_no_more(graph, numbers, blocks):
    for number in numbers:
        graph._on_daq(_block(number * _ROWS))
    assert graph.sampled_time() == pytest.approx(blocks * _ROWS / _RATE)
