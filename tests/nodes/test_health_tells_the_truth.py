"""While something is wrong no node says OK, and what was wrong can be counted afterwards."""

import numpy as np
import pytest

from squeal_rig.instruments.channels import DAQ_RECORD
from squeal_rig.instruments.description import RigDescription
from squeal_rig.model import RigParameters
from tests.graph.statuses import health_of

pytest.importorskip("rclpy")

from std_msgs.msg import String

from squeal_rig.graph.conversions import cloud

CONSUMERS = ("friction_estimator", "stability", "squeal_detector")
OK, WARN, ERROR = 0, 1, 2
SIZE, RATE = 512, 51200
# Number of the first block: further from 0 than anybody who is held up can lose blocks.
FIRST = 10**5
TEXT = RigDescription(RigParameters.preset("yavuz_sen_2023"), preset="yavuz_sen_2023").to_yaml()


class FakeRig:
    """Speaks as the rig does, a block at a time; its numbers and stamps go on as those of a rig."""

    def __init__(self, observer, health, nodes):
        self.observer, self.health, self.nodes = observer, health, nodes
        self.blocks, self.description = observer.publisher("daq/samples"), observer.publisher("rig/description")
        self.number = FIRST

    def block(self, number=None, **values):
        """The next block, or one of that number, as of now."""
        samples = np.zeros(SIZE, DAQ_RECORD)
        seq = np.arange(SIZE) + (self.number if number is None else number) * SIZE
        usual = {"preload": 50.0, "belt_speed": 1.0, "t": np.arange(SIZE) / RATE, "seq": seq}
        for name, value in {**usual, **values}.items():
            samples[name] = value
        self.blocks.publish(cloud(samples, 10**18 + self.number * SIZE * 10**9 // RATE))
        self.number += 1

    def describe(self, text):
        self.description.publish(String(data=text))

    def expect(self, level, words, speak, names=CONSUMERS, meets=lambda name, values: True):
        """Speak on until every node is at that level with these words and meets more; returns the values of each."""
        self.health.clear()

        def told(name):
            speak()
            assert self.nodes[name].running, self.nodes[name].errors
            state = health_of(self.health, name)
            return state and state[0] == level and words in state[1] and meets(name, state[2]) and state[2]

        return {name: self.observer.wait_for(lambda n=name: told(n), f"{words!r} of {name}") for name in names}


@pytest.fixture(scope="module")
def rig(compiled, processes, observer, config_file):
    nodes = {name: processes.node(name, "--params-file", str(config_file)) for name in CONSUMERS}
    rig = FakeRig(observer, observer.follow("/diagnostics"), nodes)
    for publisher in (rig.blocks, rig.description):
        observer.wait_for(lambda p=publisher: p.get_subscription_count() == len(CONSUMERS), "listeners")
    rig.expect(WARN, "no rig/description yet", rig.block)
    rig.describe(TEXT)
    yield rig
    assert [node.end()[0] for node in nodes.values()] == [0, 0, 0]


@pytest.fixture(autouse=True)
def running(rig):
    """Everything is well before a test; how often each thing had happened until then."""
    return rig.expect(OK, "running", rig.block)


def grown(before, after, key):
    return {name: int(after[name][key]) - int(before[name][key]) for name in after}


def no_jump_is_lost(before, after):
    """Whether the numbers of another rig count as lost for nobody; who was held up may have lost some blocks."""
    return all(0 <= lost < FIRST * SIZE / 2 for lost in grown(before, after, "lost samples").values())


def test_blocks_that_are_all_refused_are_an_error_and_some_a_warning(rig, running):
    after = rig.expect(ERROR, "messages were refused, the last one: ", lambda: rig.block(t=np.nan))
    assert min(grown(running, after, "rejected messages").values()) > 0

    def one_of_two():
        rig.block()
        rig.block(t=np.nan)

    rig.expect(WARN, "messages were refused, the last one: ", one_of_two)


def test_a_description_that_is_refused_is_an_error_until_a_good_one_comes(rig, running):
    rig.describe(TEXT.replace("preload: 50.0", "preload: -50.0"))
    words = "the rig's description was refused, the one before is in use: rig/description is not one of this version"
    after = rig.expect(ERROR, words, rig.block)
    assert set(grown(running, after, "refused descriptions").values()) == {1}
    rig.expect(ERROR, words, rig.block)  # as long as it lasts
    rig.describe(TEXT)
    rig.expect(OK, "running", rig.block)


def test_a_text_that_is_no_utf_8_is_refused_like_any_other(rig):
    rig.description.publish(b"\x00\x01\x00\x00" + b"\x04\x00\x00\x00" + b"\xff\xfe\xfd\x00")
    rig.expect(ERROR, "the rig's description was refused", rig.block)
    rig.describe(TEXT)


def test_samples_that_are_no_numbers_are_a_warning(rig, running):
    after = rig.expect(WARN, "samples hold a value that is not finite", lambda: rig.block(x=np.nan))
    assert min(grown(running, after, "samples not finite").values()) >= SIZE


def test_two_rigs_at_once_are_an_error_and_no_lost_samples(rig, running):
    def both():
        rig.block()
        rig.block(number=rig.number + 10 * FIRST)

    after = rig.expect(ERROR, "samples of more than one rig", both)
    assert no_jump_is_lost(running, after)
    rig.expect(OK, "running", rig.block)


def test_blocks_that_did_not_arrive_are_a_warning_and_counted(rig, running):
    def with_gaps():
        rig.number += 1
        rig.block()

    after = rig.expect(WARN, "samples were lost on the way here", with_gaps)
    lost = grown(running, after, "lost samples")
    assert min(lost.values()) >= SIZE
    assert all(count % SIZE == 0 for count in lost.values())


def test_a_rig_started_again_is_counted_and_nothing_is_lost(rig, running):
    rig.number, later = 0, rig.number
    rig.block(number=0)

    def restarted(name, values):  # a health of before is well, too
        return int(values["restarts"]) > int(running[name]["restarts"])

    after = rig.expect(OK, "running", rig.block, meets=restarted)
    assert set(grown(running, after, "restarts").values()) == {1}
    assert no_jump_is_lost(running, after)
    rig.number = later
