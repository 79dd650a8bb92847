"""A bag being played: spacing, rate, pause, step, seek, loop, start offset, names."""

import threading
import time
from itertools import pairwise

import pytest
from bag_making import START, write_bag

from squeal_rig.errors import ParameterError, RecordingError
from squeal_rig.recording import Bag
from squeal_rig.recording.replay import Beat, ReplayClock, remapped
from squeal_rig.recording.settings import PlayerSettings
from squeal_rig.recording.transport import Transport

DAQ = ("/daq/samples",)
PATIENCE = 100.0


class Player:
    """A transport in a thread, and what it played: (message, steady time)."""

    def __init__(self, bag, topics=DAQ, rate=1.0, start=0.0, limit=50e6, **flags):
        self.transport = Transport(Bag(bag), topics, rate, limit, start)
        for name, value in flags.items():
            if name == "paused":
                self.transport.pause()
            else:
                setattr(self.transport, name, value)
        self.played, self.ticks = [], []
        self.once_at = {}  # number of a message -> what is called as it is played, for the first time
        self._grew = threading.Condition()
        self.thread = threading.Thread(target=self.transport.run, args=(self._publish, self._tick))

    def _publish(self, message):
        with self._grew:
            self.played.append((message, time.monotonic()))
            self._grew.notify_all()
        if (call := self.once_at.pop(self._number(message), None)) is not None:
            call()

    def _tick(self, log_time):
        self.ticks.append(log_time)
        return 0.01

    def wait(self, count):
        with self._grew:
            assert self._grew.wait_for(lambda: len(self.played) >= count, PATIENCE)

    def grows_within(self, seconds):
        """Whether more than what may have been on its way is played in that time."""
        with self._grew:
            count = len(self.played) + 1
            return self._grew.wait_for(lambda: len(self.played) > count, seconds)

    def numbers(self):
        return [self._number(m) for m, _ in self.played if m.topic == DAQ[0]]

    @staticmethod
    def _number(message):
        return round((message.log_time - START - 1000) / 1e7)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.transport.stop()
        self.thread.join(PATIENCE)
        assert not self.thread.is_alive()

    def finish(self):
        self.thread.join(PATIENCE)
        assert not self.thread.is_alive()


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    directory = tmp_path_factory.mktemp("transport") / "run"
    write_bag(directory, blocks=100)
    return directory


@pytest.mark.parametrize("rate", [1.0, 4.0])
def test_no_message_is_played_before_its_moment_and_moments_keep_the_recorded_spacing(bag, rate):
    """How late they are is measured, by `make bench-bags`: a busy machine is late."""
    with Player(bag, rate=rate) as player:
        player.finish()
    assert player.numbers() == list(range(100))
    moments = [player.transport._clock.due(m.log_time) for m, _ in player.played]
    assert all(played >= moment for (_, played), moment in zip(player.played, moments, strict=True))
    spacing = [later - earlier for earlier, later in pairwise(moments)]
    assert spacing == pytest.approx([0.01 / rate] * 99, rel=1e-6)


def test_rate_0_is_bounded_by_bytes_per_second(bag):
    size = sum(len(m.data) for m in Bag(bag).messages(DAQ))
    with Player(bag, rate=0.0, limit=size / 0.5) as player:
        player.finish()
    begun = player.transport._clock._steady
    assert player.played[-1][1] - begun > 0.99 * 0.495, "99 messages of 100 are due after what was sent before them"
    with Player(bag, rate=0.0, limit=1e9) as fast:
        fast.finish()
    last = fast.played[-1][0].log_time
    assert fast.transport._clock.due(last) - fast.transport._clock._steady < 0.01, "without the bound it is due sooner"


def test_pause_stops_and_resume_goes_on_without_a_gap(bag):
    with Player(bag) as player:
        player.wait(10)
        player.transport.pause()
        position = player.transport.position
        assert not player.grows_within(0.1)
        assert player.transport.position == position
        player.transport.resume()
        player.finish()
    assert player.numbers() == list(range(100))


def test_step_plays_one_message_while_paused(bag):
    with Player(bag, paused=True) as player:
        for count in (1, 2, 3):
            player.transport.step()
            player.wait(count)
        assert not player.grows_within(0.1)
    assert player.numbers() == [0, 1, 2]


def test_step_while_playing_is_refused(bag):
    transport = Transport(Bag(bag), DAQ, 1.0, 1e6)
    with pytest.raises(RecordingError, match="pause first"):
        transport.step()


def test_seek_goes_on_elsewhere_forwards_and_back(bag):
    player = Player(bag, rate=10.0)
    player.once_at = {5: lambda: player.transport.seek(0.8), 80: lambda: player.transport.seek(0.2)}
    with player:
        player.finish()
    numbers = player.numbers()
    assert 80 in numbers
    back = numbers.index(20, numbers.index(80))
    assert numbers[back:] == list(range(20, 100))


def test_a_start_within_the_bag_begins_with_the_latched_values(bag):
    with Player(bag, topics=(*DAQ, "/rig/description"), rate=100.0, start=0.5) as player:
        player.finish()
    assert player.played[0][0].topic == "/rig/description"
    assert player.numbers() == list(range(50, 100))


def test_a_loop_over_nothing_ends_with_a_sentence(bag):
    played = []
    transport = Transport(Bag(bag), ("/rig/description",), 1.0, 50e6, start=0.5)
    transport.loop = True
    with pytest.raises(RecordingError, match="a loop would repeat nothing"):
        transport.run(played.append, lambda _: 0.01)
    assert [message.topic for message in played] == ["/rig/description"]  # what was latched before


def test_a_loop_over_one_message_does_not_flood(bag):
    begun = time.monotonic()
    with Player(bag, topics=("/rig/description",), rate=100.0, loop=True) as player:
        player.wait(6)
        time.sleep(0.3)  # in which it could play thousands
    assert len(player.played) <= (time.monotonic() - begun) / 0.1 + 1


def test_a_loop_begins_again_at_the_start(bag):
    with Player(bag, rate=100.0, start=0.9, loop=True) as player:
        player.wait(25)
    assert player.numbers()[:25] == [*range(90, 100), *range(90, 100), *range(90, 95)]


def test_the_rate_can_be_changed_on_the_way(bag):
    with Player(bag, rate=0.01) as player:
        player.wait(1)
        player.transport.set_rate(100.0)
        player.finish()
    assert player.numbers() == list(range(100))


def test_ticks_never_run_ahead_of_the_messages(bag):
    with Player(bag, rate=20.0) as player:
        player.finish()
    assert player.ticks == sorted(player.ticks)
    assert player.ticks[-1] == player.played[-1][0].log_time


def test_a_place_behind_the_end_is_refused(bag):
    with pytest.raises(RecordingError, match=r"start_offset = 5 s is out of bounds: the bag ends at .* s"):
        Transport(Bag(bag), DAQ, 1.0, 1e6, start=5.0)


def test_the_clock_keeps_its_time_through_pause_and_change_of_rate():
    clock = ReplayClock(START, 1.0, 1e6, now=10.0)
    assert clock.due(START + 10**9) == 11.0
    clock.pause(10.5)
    assert clock.due(START + 10**9) == float("inf")
    clock.resume(20.0)
    assert clock.due(START + 10**9) == pytest.approx(20.5)
    clock.set_rate(2.0, 20.25)
    assert clock.due(START + 10**9) == pytest.approx(20.375)
    assert clock.now(20.375) == START + 10**9


@pytest.mark.parametrize(
    ("rules", "names"),
    [
        (["/daq/samples:=/old/daq"], {"/daq/samples": "/old/daq", "/x": "/x"}),
        (["/:=/lab/"], {"/daq/samples": "/lab/daq/samples", "/x": "/lab/x"}),
        (["/daq/:=/lab/daq/"], {"/daq/samples": "/lab/daq/samples", "/x": "/x"}),
    ],
)
def test_topics_are_played_under_other_names(rules, names):
    assert remapped(["/daq/samples", "/x"], rules) == names


@pytest.mark.parametrize("rule", ["/x", "x:=/y", "/x:=y", "/x:=/y/", "/no:=/y", "/x:=/daq/samples", "/x:=/1"])
def test_a_rule_that_means_nothing_is_refused(rule):
    with pytest.raises(RecordingError, match="remap"):
        remapped(["/daq/samples", "/x"], [rule])


@pytest.mark.parametrize("rate", [0.001, -1.0, 101.0])
def test_a_rate_out_of_bounds_is_refused(rate):
    with pytest.raises(ParameterError, match="rate"):
        PlayerSettings(rate=rate)


def test_a_beat_keeps_its_period_though_it_is_always_asked_a_little_early_or_late():
    beat = Beat(0.01)
    # Asked every 9.9 ms, as by messages that come about as often as the beat: a second holds a hundred.
    asked = [5.0 + 0.0099 * number for number in range(102)]
    times = [now for now in asked if beat.due(now)]
    assert 98 <= len(times) <= 101
    # Held up for 35 ms: once, and on the grid again.
    assert beat.due(7.035)
    assert not beat.due(7.0399)
    assert beat.left(7.0399) == pytest.approx(1e-4)
    assert beat.due(7.0401)
