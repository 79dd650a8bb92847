"""What the page shows, against what was put in."""

from pathlib import Path

import numpy as np

from squeal_rig.instruments.channels import DAQ_RECORD
from squeal_rig.instruments.description import RigDescription
from squeal_rig.model import RigParameters
from squeal_rig.page.picture import COLUMN_LINES, Picture
from squeal_rig.page.recorded import RecordedPicture
from squeal_rig.page.sound import Sound
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
