"""What a killed recorder leaves behind."""

import os
import random
import signal
import subprocess
import sys
import time

import pytest
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Chunk, Message, Metadata
from mcap.stream_reader import StreamReader, breakup_chunk

from squeal_rig.errors import RecordingError
from squeal_rig.recording import Bag

# Writes numbered messages at 2000 a second, tells each one after it was taken, and flushes every 0.25 s.
RECORDER = """
import sys, time
from squeal_rig.recording import BagWriter, MessageSchema
writer = BagWriter(sys.argv[1], flush_interval=0.25, custom_data={"seed": "7"})
handle = writer.add_topic("/raw", "far_away/msg/Thing", schema=MessageSchema("far_away/msg/Thing"))
flushed = time.monotonic()
for number in range(10**9):
    now = time.monotonic_ns()
    writer.write(handle, number.to_bytes(8, "little") * 100, now, now)
    print(number, now, flush=True)
    if time.monotonic() - flushed >= 0.25:
        writer.flush()
        flushed = time.monotonic()
    time.sleep(0.0005)
"""


def intact_chunks(path):
    """Chunks from the front of the file until it ends, each with a good CRC; and the metadata records."""
    chunks, metadata = [], []
    with open(path, "rb") as stream:
        try:
            for record in StreamReader(stream, emit_chunks=True).records:
                if isinstance(record, Chunk):
                    chunks.append(breakup_chunk(record, validate_crc=True))
                elif isinstance(record, Metadata):
                    metadata.append(record)
        except EndOfFile:
            pass
    return chunks, metadata


@pytest.mark.parametrize("moment", [0.1, 0.8, random.Random(5).uniform(0.3, 1.5)])
def test_kill_9_costs_less_than_the_last_second(tmp_path, moment):
    bag = tmp_path / "run"
    process = subprocess.Popen(
        [sys.executable, "-c", RECORDER, str(bag)], stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        told = [process.stdout.readline()]  # the recorder runs
        deadline = time.monotonic() + moment
        while time.monotonic() < deadline:
            told.append(process.stdout.readline())
    finally:
        os.kill(process.pid, signal.SIGKILL)
    told += process.stdout.read().splitlines()
    process.wait(timeout=10)
    last_number, last_time = (int(word) for word in [line for line in told if line.strip()][-1].split())

    chunks, metadata = intact_chunks(bag / "run_0.mcap")
    messages = [record for chunk in chunks for record in chunk if isinstance(record, Message)]
    numbers = [int.from_bytes(message.data[:8], "little") for message in messages]
    assert numbers == list(range(len(numbers))), "a gap before the end"
    assert all(message.data == message.data[:8] * 100 for message in messages)
    assert [message.sequence for message in messages] == numbers
    end = messages[-1].log_time if messages else last_time - int(moment * 1e9)
    # flush_interval 0.25 s, and the machine may be busy: the promise is one second.
    assert last_time - end < 1e9
    assert len(numbers) <= last_number + 2
    assert all(any(isinstance(record, Channel) for record in chunk) for chunk in chunks)
    assert "seed: '7'" in metadata[0].metadata["serialized_metadata"]
    with pytest.raises(RecordingError, match="was not closed"):
        Bag(bag)
