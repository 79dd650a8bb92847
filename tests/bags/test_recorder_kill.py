"""Kill -9 of the recorder under full load: all but the last second comes back, byte for byte."""

import random
import signal
import time

import pytest

from squeal_rig.recording import Bag, samples_from_cdr
from squeal_rig.recording.recover import recover
from squeal_rig.recording.verify import verify
from tests.graph.processes import parameters
from tests.graph.statuses import health_of, healths_of

from .full_load import CLOUDS, ROWS, SMALL, payload, published, small_payload, start_load

_MATCHING = 500_000_000  # [ns]


def same(got, sent):
    """Whether all bytes sent are there; the middleware fills a payload up to four bytes with zeros."""
    return got[: len(sent)] == sent and got[len(sent) :] == bytes(-len(sent) % 4)


def kill_and_recover(processes, observer, health, tmp_path, number, moment):
    """Record the load into a new bag, kill at `moment` [s] after all topics come in; check what comes back."""
    directory = tmp_path / f"run{number}"
    health.clear()
    recorder = processes.node("recorder", *parameters(directory=directory))
    rates = []

    def full_rate():
        """Twice between two reports of the recorder, a second apart, all topics came in: discovery is over.

        So the last report but one, even of those that are here by now, is of some time after that.
        """
        found = health_of(health, "recorder")
        told = found[2] if found else {}
        # What the one before still told may only arrive now.
        if told.get("directory") == str(directory) and told["messages"] not in map(str, rates):
            rates.append(int(told["messages"]))
        return len(rates) > 2 and min(rates[-1] - rates[-2], rates[-2] - rates[-3]) >= 480

    observer.wait_for(full_rate, "five topics at 100 Hz")
    time.sleep(moment)  # the moment of the kill itself, not a wait for something
    recorder.send(signal.SIGKILL)
    killed = time.time_ns()
    recorder.wait()
    observer.spin(0.5)  # what it has told is on its way
    # A message was lost on the way once a later one has come: what the last word counts is true of the word before.
    last_word, word_before = [
        told for _, _, told in healths_of(health, "recorder") if told["directory"] == str(directory)
    ][:2]
    told_lost, told_taken = int(last_word["lost messages"]), int(word_before["last taken of /daq/samples"])
    report = recover(directory, tmp_path / f"out{number}")
    assert not report.closed
    assert report.lost == report.damaged_chunks == report.unproved == 0
    bag = Bag(tmp_path / f"out{number}")
    numbers = {topic: [] for topic in (*CLOUDS, *SMALL)}
    last = 0
    for message in bag.messages():
        last = max(last, message.log_time)
        if message.topic in CLOUDS:
            block = int(samples_from_cdr(message.data).samples["seq"][0]) // ROWS
            assert same(message.data, payload(message.topic, block))
            numbers[message.topic].append((message.log_time, block))
        elif message.topic in SMALL:
            seconds, rest = (int.from_bytes(message.data[at : at + 4], "little") for at in (4, 8))
            block = (seconds - 1_700_000_000) * 100 + rest // 10_000_000
            assert same(message.data, small_payload(message.topic, block))
            numbers[message.topic].append((message.log_time, block))
    missing = 0
    for topic, taken in numbers.items():
        # While publisher and subscription find one another, single messages may not come; the kill has no part in that.
        got = [block for time, block in taken if time >= taken[0][0] + _MATCHING]
        assert got == sorted(set(got)), topic
        # The publisher's own numbers are those of its blocks, from 1.
        there = [block for block in got if block < told_taken]
        assert there, f"nothing of {topic} from before its last words"
        missing += there[-1] - there[0] + 1 - len(there)
    # All is there but what a busy machine lost on the way here, which was told. Gaps that the kill left would be in
    # `report.lost`, by the recorder's own numbers, up to the very end.
    assert missing <= told_lost
    findings = verify(tmp_path / f"out{number}").findings
    # Samples that the first moments missed are checked above.
    assert not [f for f in findings if f.level == "error" and "samples are missing" not in f.sentence]
    return (killed - last) * 1e-9


@pytest.fixture
def load(processes, tmp_path):
    log = tmp_path / "load.txt"
    start_load(processes, log)
    return log


@pytest.mark.slow
def test_a_killed_recorder_loses_less_than_the_last_second(
    processes, observer, health, tmp_path, load, record_property
):
    moments = random.Random(31)
    lost = []
    # A recorder that a busy machine has held up loses what has not come to it yet, too: that is no word about its disk.
    while sum(seconds < 1.0 for seconds in lost) < 2:
        assert len(lost) < 5, lost
        lost.append(kill_and_recover(processes, observer, health, tmp_path, len(lost), moments.uniform(1.0, 2.0)))
    record_property("seconds_lost", lost)
    assert published(load)[0] > 0


@pytest.mark.bench
def test_50_kills(processes, observer, health, tmp_path, load):
    moments = random.Random(32)
    lost = [kill_and_recover(processes, observer, health, tmp_path, n, moments.uniform(1.0, 3.0)) for n in range(50)]
    assert max(lost) < 1.0
    print(f"\n50 kills: lost at most {max(lost):.3f} s, {sum(lost) / len(lost):.3f} s in the mean")  # noqa: T201
