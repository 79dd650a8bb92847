"""A small bag of samples as the rig publishes them, and where its chunks are."""

from collections import namedtuple

import numpy as np
from mcap.records import ChunkIndex
from mcap.stream_reader import StreamReader

from squeal_rig.recording import BagWriter, QosProfile, cdr_from_samples
from tests.messages import schema_of, string_cdr

LATCHED = QosProfile(depth=1, durability="transient_local")
START = 1_700_000_000_000_000_000
BLOCK = np.dtype({"names": ["t", "x", "seq"], "formats": ["<f8", "<f8", "<u4"], "offsets": [0, 8, 16], "itemsize": 24})
ROWS = 64

Sent = namedtuple("Sent", "topic data log_time publish_time")


def block_cdr(number, stamp, seed=7):
    """Block `number` of noise: 64 samples, numbered on."""
    samples = np.zeros(ROWS, BLOCK)
    samples["t"] = np.arange(ROWS) / 6400.0
    samples["x"] = np.random.default_rng(seed + number).normal(size=ROWS)
    samples["seq"] = np.arange(number * ROWS, (number + 1) * ROWS)
    return cdr_from_samples(samples, stamp)


def write_bag(directory, blocks=200, skip=(), chunk_size=16384, ending="complete", start=START, **options):
    """Write a description, then blocks at 100 Hz on two topics; returns everything that was sent, in order."""
    sent = []
    writer = BagWriter(directory, chunk_size=chunk_size, custom_data={"seed": "7"}, **options)
    description = writer.add_topic(
        "/rig/description", "std_msgs/msg/String", [LATCHED], schema_of("std_msgs/msg/String")
    )
    cloud = schema_of("sensor_msgs/msg/PointCloud2")
    handles = [
        writer.add_topic(name, cloud.type_name, [QosProfile()], cloud) for name in ("/daq/samples", "/truth/samples")
    ]

    def send(handle, data, time):
        writer.write(handle, data, time, time - 1000)
        sent.append(Sent(handle.topic, data, time, time - 1000))

    send(description, string_cdr("sample_rate: 6400"), start)
    for number in range(blocks):
        stamp = start + number * 10_000_000
        if number not in skip:
            send(handles[0], block_cdr(number, stamp), stamp + 1000)
            send(handles[1], block_cdr(number, stamp, seed=70_000), stamp + 2000)
    writer.add_metadata("parameters", {"node": "/rig", "time_ns": str(start), "values": "preload: 50.0\n"})
    if ending is not None:
        writer.close(ending)
    else:
        writer.flush()
    return sent


def chunk_places(path):
    """(start, end, messages) of every chunk record of a closed file."""
    with open(path, "rb") as stream:
        indexes = [r for r in StreamReader(stream, emit_chunks=True).records if isinstance(r, ChunkIndex)]
    return sorted((index.chunk_start_offset, index.chunk_start_offset + index.chunk_length) for index in indexes)


def messages_of(bag):
    """Everything in a bag as it was sent."""
    return [Sent(m.topic, m.data, m.log_time, m.publish_time) for m in bag.messages()]
