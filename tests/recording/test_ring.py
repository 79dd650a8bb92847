"""The last seconds in memory: what is kept, what goes, what a snapshot begins with."""

import tracemalloc

from bag_making import LATCHED
from hypothesis import given
from hypothesis import strategies as st

from squeal_rig.recording import BagWriter
from squeal_rig.recording.ring import KeptMessage, MessageRing
from tests.messages import schema_of

_S = 10**9


def handles(tmp_path):
    text = schema_of("std_msgs/msg/String")
    with BagWriter(tmp_path / "bag") as writer:
        return writer.add_topic("/often", text.type_name, schema=text), writer.add_topic(
            "/latched", text.type_name, [LATCHED], text
        )


def test_messages_older_than_the_duration_go(tmp_path):
    often, _ = handles(tmp_path)
    ring = MessageRing(2.0, 10**9)
    for second in range(10):
        ring.add(KeptMessage(often, b"x", second * _S, 0))
    assert [m.log_time // _S for m in ring.take()] == [7, 8, 9]
    assert len(ring) == 0
    assert ring.bytes == 0


def test_a_latched_value_from_before_comes_first_with_its_own_publish_time(tmp_path):
    often, latched = handles(tmp_path)
    ring = MessageRing(2.0, 10**9)
    ring.add(KeptMessage(latched, b"old", 0, 5), latched=True)
    ring.add(KeptMessage(latched, b"description", 1 * _S, 6), latched=True)
    for second in range(2, 10):
        ring.add(KeptMessage(often, b"x", second * _S, 0))
    taken = ring.take()
    assert (taken[0].data, taken[0].log_time, taken[0].publish_time) == (b"description", 7 * _S, 6)
    assert [m.data for m in taken[1:]] == [b"x"] * 3
    ring.add(KeptMessage(often, b"y", 10 * _S, 0))
    assert [m.data for m in ring.take()] == [b"description", b"y"], "the next snapshot has it too"


@given(st.lists(st.integers(0, 400), max_size=60), st.integers(1, 20_000))
def test_memory_stays_within_its_bound(tmp_path_factory, sizes, bound):
    ring = MessageRing(1e6, bound)
    often, _ = _HANDLES or _HANDLES.extend(handles(tmp_path_factory.mktemp("ring"))) or _HANDLES
    for time, size in enumerate(sizes):
        ring.add(KeptMessage(often, bytes(size), time, time))
        assert ring.bytes <= bound
    assert ring.shortened == (len(ring) < len(sizes))


def test_small_messages_take_no_more_memory_than_the_bound(tmp_path):
    often, _ = handles(tmp_path)
    ring = MessageRing(1e6, 2_000_000)
    tracemalloc.start()
    for number in range(100_000):
        ring.add(KeptMessage(often, b"%07d" % number, 2**60 + number, 2**60 - number))
    taken = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert ring.shortened
    assert 1_500_000 < taken < 2_200_000


def test_latched_values_count_against_the_bound(tmp_path):
    often, latched = handles(tmp_path)
    ring = MessageRing(2.0, 10_000)
    ring.add(KeptMessage(latched, bytes(6000), 0, 0), latched=True)
    for number in range(10):
        ring.add(KeptMessage(often, bytes(1000), (10 + number) * _S, 0))
        assert ring.bytes <= 10_000
    assert [len(m.data) for m in ring.take()] == [6000, 1000, 1000, 1000]
    ring.add(KeptMessage(latched, bytes(9000), 30 * _S, 0), latched=True)
    assert [len(m.data) for m in ring.take()] == [9000], "the newer value replaces the older one"


_HANDLES = []
