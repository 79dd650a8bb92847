"""Checks bags that are finished, in a process of low priority beside the run."""

import os
import shutil
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from squeal_rig.recording import Bag
from squeal_rig.recording.messages import decoder_of, statuses
from squeal_rig.recording.recover import recover
from squeal_rig.report.bag_info import sample_counts

_SAMPLES_A_BLOCK = 512
_HEALTH = "/diagnostics"
_SAMPLED = ("/daq/samples", "/truth/samples")
_SILENCE = 150.0  # s: longer than a rig takes to come back, and its recorder to find it


def _is_patient():
    os.nice(19)


def said_last(bag):
    """How many messages its recorder said to be lost, as the bag has its health: what a killed one leaves of that."""
    lost = 0
    if _HEALTH in bag.topics:
        decode = decoder_of(bag.topics[_HEALTH].schema)
        for message in bag.messages([_HEALTH]):
            told = dict(statuses(decode(message.data))).get("recorder")
            lost = lost if told is None else int(told[2].get("lost messages", lost))
    return lost


def comes_to_the_end(bag, topic):
    """Whether a topic has messages shortly before the end: a recorder that hears nothing of it misses none either."""
    late = bag.end_time - round(_SILENCE * 1e9)
    return topic in bag.topics and next(iter(bag.messages([topic], start=late)), None) is not None


def faults_of_bag(path, killed):
    """A sentence for each loss that the bag does not count itself. Removes the bag where there is none."""
    source, faults = path, []
    if killed:
        source = path.with_name(f"{path.name}_recovered")
        recover(path, source)
    bag = Bag(source)
    told = (said_last(bag) if killed else int(bag.custom_data.get("lost_messages", 0))) * _SAMPLES_A_BLOCK
    for topic in _SAMPLED:
        if bag.duration > _SILENCE and not comes_to_the_end(bag, topic):
            faults.append(f"{source.name}: nothing of {topic} in the last {_SILENCE:g} s of {bag.duration:.0f} s")
    for topic, count in sample_counts(bag).items():
        if count.damaged:
            faults.append(f"{source.name}: {count.damaged} damaged blocks of {topic}")
        if count.lost > told and topic.endswith("/samples") and "friction" not in topic:
            faults.append(f"{source.name}: {count.lost} samples of {topic} are missing, {told} were reported")
    if not faults:
        for folder in (path, source):
            shutil.rmtree(folder, ignore_errors=True)
    return faults


class BagChecks:
    """Checks one bag after the other; a check that fails is a fault too."""

    def __init__(self):
        # A process of its own kind: ours has threads and a ROS graph.
        self._pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_is_patient)
        self._results = {}

    def check(self, path, killed):
        """Have a bag checked; once is enough."""
        if path not in self._results:
            self._results[path] = self._pool.submit(faults_of_bag, path, killed)

    def faults(self):
        """Wait for all of them; their sentences."""
        found = []
        for path, result in self._results.items():
            try:
                found += result.result()
            except Exception as error:
                found.append(f"{path.name} could not be checked: {type(error).__name__}: {error}")
        self._pool.shutdown()
        return found
