"""Compares two recordings topic by topic, field by field: what was estimated live and what was computed again."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from squeal_rig.analysis.estimate_output import ESTIMATED
from squeal_rig.recording import Bag, TopicInfo, as_mapping, decoder_of, samples_from_cdr
from squeal_rig.recording.gaps import CLOUD_TYPE


@dataclass(frozen=True)
class TopicComparison:
    """Messages recorded, computed again, and how many of the recorded ones are among those, equal in every field."""

    topic: str
    recorded: int
    computed: int
    equal: int


def compare_estimates(recorded: Bag, computed: Bag) -> list[TopicComparison]:
    """Compare the estimated topics of both bags; floats must be equal bit for bit, padding does not count."""
    names = sorted(topic for topic in computed.topics if topic.endswith(tuple(ESTIMATED)))
    comparisons = []
    for name in names:
        if name in recorded.topics:
            first, second = _fingerprints(recorded, name), _fingerprints(computed, name)
            equal = sum((first & second).values())
            comparisons.append(TopicComparison(name, first.total(), second.total(), equal))
    return comparisons


def _fingerprints(bag: Bag, topic: str) -> Counter[bytes]:
    fingerprint = _fingerprint_of(bag.topics[topic])
    return Counter(fingerprint(message.data) for message in bag.messages([topic]))


def _fingerprint_of(topic: TopicInfo) -> Callable[[bytes], bytes]:
    """A function from CDR bytes to a digest of all decoded fields."""
    if topic.type_name == CLOUD_TYPE:
        return _cloud_fingerprint
    decode = decoder_of(topic.schema)
    # repr of a float tells every bit of it but those of a nan
    return lambda data: hashlib.blake2b(repr(as_mapping(decode(data))).encode(), digest_size=16).digest()


def _cloud_fingerprint(data: bytes) -> bytes:
    stamp, frame, samples = samples_from_cdr(data)
    digest = hashlib.blake2b(f"{stamp} {frame} {samples.dtype.descr}".encode(), digest_size=16)
    for name in samples.dtype.names or ():
        digest.update(samples[name].tobytes())
    return digest.digest()
