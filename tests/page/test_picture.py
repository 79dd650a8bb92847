"""What the page shows, against what was put in."""

from pathlib import Path

import numpy as np

from squeal_rig.estimation import hard_squeal
from squeal_rig.estimation.stability_follower import IN_FORCE
from squeal_rig.instruments.channels import DAQ_RECORD
from squeal_rig.instruments.description import RigDescription
from squeal_rig.model import RigParameters
from squeal_rig.page.picture import COLUMN_LINES, Picture
from squeal_rig.page.recorded import RecordedPicture
from squeal_rig.page.sound import Sound
from tests.made_bag import write_squeal
from tests.page.test_server import unpacked


def tone(rate, seconds, frequency=2200.0):
    return 3e-6 * np.sin(2.0 * np.pi * frequency * np.arange(round(seconds * rate)) / rate)


def test_a_piece_that_is_not_finite_is_a_dark_column_and_keeps_its_place():
    rate, picture = 12800, Picture(False)
    picture.take_rig(RigDescription(RigParameters(), sample_rate=rate))
    x = tone(rate, 3.0)
    x[round(1.2 * rate)] = np.nan
    for first in range(0, len(x), 128):
        daq = np.zeros(128, DAQ_RECORD)
        daq["seq"], daq["x"] = first + np.arange(128), x[first : first + 128]
        picture.take_block(daq)
    head, arrays = unpacked(picture.state())
    columns = np.frombuffer(arrays["spectrogram"], np.uint8).reshape(head["columns"], COLUMN_LINES)
    assert len(columns) == 12
    # The first one comes before its window is full, the sixth, of 1.05 to 1.25 s, holds the nan.
    assert np.flatnonzero(columns.max(axis=1) == 0).tolist() == [0, 5]


def test_nodes_of_another_rig_are_listed_and_are_not_this_ones():
    picture = Picture(False, namespace="b/")
    for name in ("a/rig", "b/rig"):
        picture.take_health(name, (0, "running", {"state": name}))
    head, _ = unpacked(picture.state())
    assert {node["name"]: node["values"] for node in head["nodes"]} == {"a/rig": {}, "b/rig": {"state": "b/rig"}}
    assert unpacked(picture.hello())[0]["namespace"] == "b/"


class Clock:
    """A time [s] that a test sets."""

    def __init__(self):
        self.now = 1000.0

    def __call__(self):
        return self.now


def state_of(picture):
    head, arrays = unpacked(picture.state())
    return head, {name: np.frombuffer(data, np.float32) for name, data in arrays.items() if name != "spectrogram"}


def squeal(detected, since=None):
    values = {"detected": str(detected).lower(), "level [dB re 1 um]": "12.0", "frequency [Hz]": "2200.0"}
    return (1, "squeal", {**values, "since [s]": "none" if since is None else str(since)})


def test_a_node_whose_data_is_stale_is_not_gone():
    clock = Clock()
    picture = Picture(False, clock=clock)
    picture.take_health("supervisor", (3, "stale: no samples", {}))
    picture.take_health("stability", (0, "running", {}))
    clock.now += 3.0
    picture.take_health("supervisor", (3, "stale: no samples", {}))
    clock.now += 1.0
    told = {node["name"]: (node["gone"], node["level"]) for node in unpacked(picture.state())[0]["nodes"]}
    assert told == {"supervisor": (False, 3), "stability": (True, 3)}


def test_what_is_told_again_and_again_is_left_out_once_it_is_old():
    clock = Clock()
    picture = Picture(False, clock=clock)
    picture.take_squeal(10.0, squeal(True))
    picture.take_window(20.0, 0.35, 0.36, 0.35)
    clock.now += 2.0
    head, arrays = state_of(picture)
    assert head["numbers"]["squealing"] is True
    assert head["mu"]["windows"] == 0.35
    assert arrays["mu_t"] == arrays["level_t"] == [-2.0]
    clock.now += 2.0
    head, arrays = state_of(picture)
    assert not {"squealing", "level", "frequency", "tones", "events"} & head["numbers"].keys()
    assert "mu" not in head
    assert arrays["mu_t"] == arrays["level_t"] == [-4.0]
    clock.now += 60.0
    assert state_of(picture)[1]["mu_t"].size == 0


def test_a_squeal_began_when_the_detector_says():
    picture = Picture(False)
    picture.take_squeal(100.0, squeal(True, since=40.0))
    assert unpacked(picture.state())[0]["squeals"][0]["begin"] == 40.0


def test_what_came_before_a_pause_is_shown_as_old_as_it_is():
    rate, clock = 12800, Clock()
    picture = Picture(False, clock=clock)
    picture.take_rig(RigDescription(RigParameters(), sample_rate=rate))
    x = tone(rate, 2.0)

    def run(first):
        for place in range(first, first + rate, 128):
            daq = np.zeros(128, DAQ_RECORD)
            daq["seq"], daq["x"] = place + np.arange(128), x[place : place + 128]
            picture.take_block(daq, clock.now)
            clock.now += 0.01

    def lit():
        head, arrays = unpacked(picture.state())
        columns = np.frombuffer(arrays["spectrogram"], np.uint8).reshape(head["columns"], COLUMN_LINES)
        return (columns.max(axis=1) > 0).tolist()

    run(0)
    first = lit()  # its first column comes before the window is full
    assert first[1:] == [True] * len(first[1:])
    clock.now += 10.0
    assert lit() == first + 40 * [False]
    run(rate)
    again = lit()
    assert again[: len(first) + 40] == first + 40 * [False]
    assert again[len(first) + 40 :] in (3 * [True], 4 * [True], 5 * [True])
    clock.now += 3600.0
    assert lit() == 240 * [False]


def test_a_point_without_equilibrium_is_neither_stable_nor_unstable():
    picture = Picture(False)
    hard = (hard_squeal.NAME, (0, "", {"zone": "bistable", "smallest hit [N s]": "0.02"}))
    for message, verdict in (("stable", True), ("unstable", True), ("no equilibrium", None)):
        picture.take_stability(dict([(IN_FORCE, (0, message, {})), hard]))
        numbers = unpacked(picture.state())[0]["numbers"]
        assert numbers["stability"] == message
        assert numbers["unstable"] == (message == "unstable" if verdict else None)
        assert numbers["zone"] == "bistable"
    picture.take_stability({IN_FORCE: (0, "stable", {})})
    assert not {"zone", "smallest_hit"} & unpacked(picture.state())[0]["numbers"].keys()


def test_a_time_of_a_bag_that_cannot_be_read_shows_nothing_but_why(tmp_path):
    folder = tmp_path / "bag"
    write_squeal(folder)
    recorded = RecordedPicture(folder)
    shown = unpacked(recorded.at(0.9)[1])[0]
    assert (shown["time"], shown["trouble"]) == (0.9, "")
    assert shown["columns"]
    file = next(folder.glob("*.mcap"))
    data = bytearray(file.read_bytes())
    for place in range(len(data) // 3, len(data) * 9 // 10, len(data) // 50):
        data[place : place + 64] = bytes(64)
    file.write_bytes(data)
    frame, state = recorded.at(0.9)
    assert len(unpacked(frame)[1]["x"]) == 0
    assert unpacked(state)[0]["trouble"]
    assert unpacked(state)[0]["columns"] == 0


def test_sound_begins_anew_after_what_is_not_finite():
    sound, rate = Sound(), 51200
    sound.listen({48000})
    heard = []
    for number in range(20):
        daq = np.zeros(512, DAQ_RECORD)
        daq["seq"], daq["x"] = 512 * number + np.arange(512), tone(rate, 0.01)
        if number == 7:
            daq["x"][5] = np.nan
        heard += [unpacked(message) for _, message in sound.take_block(daq, rate)]
    assert {head["origin"] for head, _ in heard} == {0, 512 * 8}
    assert all(np.isfinite(arrays["sound"]).all() for _, arrays in heard)


def test_trends_of_a_short_bag_span_the_bag():
    recorded = RecordedPicture(Path(__file__).parents[2] / "bags" / "reference")
    duration = recorded.bag.duration
    assert 1.0 < duration < 3.0
    head, _ = unpacked(recorded.picture.hello())
    assert head["trend"] == duration
    head, arrays = unpacked(recorded.at(duration)[1])
    columns = np.frombuffer(arrays["spectrogram"], np.uint8).reshape(head["columns"], COLUMN_LINES)
    assert len(columns) == int(4.0 * duration) + 1  # one a quarter of a second
    assert len({bytes(column) for column in columns[1:]}) == len(columns) - 1  # each read by itself


def test_names_of_strangers_take_no_place_of_this_rigs_nodes():
    picture = Picture(control=False)
    for k in range(200):
        picture.take_health(f"x{k}", (0, "running", {}))
    for name in ("rig", "supervisor", "recorder"):
        picture.take_health(name, (0, "running", {}))
    for k in range(200):
        picture.take_health(f"y{k}", (0, "running", {}))
    names = [node["name"] for node in unpacked(picture.state())[0]["nodes"]]
    assert {"rig", "supervisor", "recorder"} < set(names)
    assert len(names) == 64
