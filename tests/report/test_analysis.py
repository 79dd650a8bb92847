"""A recorded run analysed offline: written with the real writer from the real virtual rig, without ROS."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from squeal_rig.analysis import segments
from squeal_rig.analysis.segments import analyse_bag, segment_rows
from squeal_rig.errors import RecordingError
from squeal_rig.instruments.acquisition import Acquisition
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.instruments.virtual import VirtualRig
from squeal_rig.model import RigParameters, zone
from squeal_rig.recording import BagWriter, MessageSchema, cdr_from_samples
from squeal_rig.report.run_figure import draw_run
from squeal_rig.report.tables import SegmentTable, zone_sentences
from squeal_rig.report.terminal import PlainConsole
from squeal_rig.samples.blocks import recorded_blocks
from tests.messages import string_cdr

PARAMETERS = RigParameters().replace(damping_x=20.0, damping_y=20.0)
CLOUD = MessageSchema("sensor_msgs/msg/PointCloud2")
STRING = MessageSchema("std_msgs/msg/String", text="string data")


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half a second of quiet at 50 N, then 300 N: ramp and squeal."""
    path = tmp_path_factory.mktemp("analysis") / "bag"
    rig = Acquisition(VirtualRig(), PARAMETERS, RigSettings())
    rig.start(10**18)
    with BagWriter(path) as writer:
        description = writer.add_topic("/rig/description", STRING.type_name, schema=STRING)
        daq = writer.add_topic("/daq/samples", CLOUD.type_name, schema=CLOUD)
        truth = writer.add_topic("/truth/samples", CLOUD.type_name, schema=CLOUD)
        writer.write(description, string_cdr(RigDescription(PARAMETERS).to_yaml()), 10**18, 10**18)
        for number in range(260):
            if number == 60:
                rig.set_point = PARAMETERS.replace(preload=300.0)
            block = rig.next_block()
            writer.write(daq, cdr_from_samples(block.daq, block.stamp), block.stamp, block.stamp)
            writer.write(truth, cdr_from_samples(block.truth, block.stamp), block.stamp + 1, block.stamp)
    return path


def test_blocks_come_out_joined_with_their_truth(bag: Path):
    from squeal_rig.recording import Bag

    blocks = list(recorded_blocks(Bag(bag)))
    assert len(blocks) == 260
    for block in blocks:
        assert np.array_equal(block.daq["x"], block.truth["x"])
        assert block.rig.parameters == PARAMETERS


def test_truth_is_joined_however_late_and_missed_only_where_it_is_not_there(bag: Path, tmp_path: Path):
    from squeal_rig.recording import Bag

    source, late = Bag(bag), tmp_path / "late"
    with BagWriter(late) as writer:
        handles = {
            name: writer.add_topic(name, CLOUD.type_name, schema=CLOUD) for name in source.topics if "samp" in name
        }
        handles["/rig/description"] = writer.add_topic("/rig/description", STRING.type_name, schema=STRING)
        for run in range(2):  # the rig is started anew: its numbers begin at zero again
            shift, held, number = run * 5 * 10**9, [], -1
            for message in source.messages():
                number += message.topic == "/daq/samples"
                truth = message.topic == "/truth/samples"
                if truth and 20 <= number < 60:  # a recorder that is held up takes topic by topic
                    held.append(message)
                    continue
                if not (truth and number in (100, 259)):  # these two are lost
                    writer.write(handles[message.topic], message.data, message.log_time + shift, 10**18)
                for one in held if number == 60 else ():
                    writer.write(handles[one.topic], one.data, message.log_time + shift, 10**18)
                held = [] if number == 60 else held
    blocks = list(recorded_blocks(Bag(late)))
    assert [int(b.daq["seq"][0]) for b in blocks] == [512 * number for number in range(260)] * 2
    assert [place for place, b in enumerate(blocks) if b.truth is None] == [100, 259, 360, 519]
    assert all(np.array_equal(b.daq["x"], b.truth["x"]) for b in blocks if b.truth is not None)


def test_a_left_over_truth_is_not_joined_to_the_next_runs_block_of_its_number(tmp_path: Path):
    from squeal_rig.recording import Bag

    with BagWriter(tmp_path / "bag") as writer:
        description = writer.add_topic("/rig/description", STRING.type_name, schema=STRING)
        daq = writer.add_topic("/daq/samples", CLOUD.type_name, schema=CLOUD)
        truth = writer.add_topic("/truth/samples", CLOUD.type_name, schema=CLOUD)
        writer.write(description, string_cdr(RigDescription(PARAMETERS).to_yaml()), 10**18, 10**18)
        for run, (lost_block, lost_truth) in enumerate(((7, 0), (0, 7))):
            rig = Acquisition(VirtualRig(), PARAMETERS.replace(preload=50.0 + 100.0 * run), RigSettings())
            rig.start(10**18 + run * 10**9)
            for number in range(1, 21):
                block = rig.next_block()
                topics = ((daq, block.daq, lost_block), (truth, block.truth, lost_truth))
                # The second run's truths come first.
                for topic, samples, lost in topics if run == 0 else topics[::-1]:
                    if number != lost:
                        writer.write(topic, cdr_from_samples(samples, block.stamp), block.stamp, block.stamp)
            rig.close()
    blocks = list(recorded_blocks(Bag(tmp_path / "bag")))
    assert [place for place, block in enumerate(blocks) if block.truth is None] == [19 + 6]
    assert all(np.array_equal(b.daq["x"], b.truth["x"]) for b in blocks if b.truth is not None)


def test_the_run_falls_into_quiet_and_squeal(bag: Path):
    analysis = analyse_bag(bag)
    quiet, squeal = list(segment_rows(analysis))
    assert analysis.lost_samples == 0
    assert analysis.duration == pytest.approx(2.6)
    assert (quiet["rig"], quiet["eigenvalues"]) == ("quiet", "stable")
    assert (squeal["rig"], squeal["eigenvalues"]) == ("squeal", "unstable")
    assert quiet["mu (2.2)"] == pytest.approx(quiet["mu set"], rel=1e-3)
    assert quiet["off belt share"] == 0.0
    # The nonlinear frequency lies below the linear one, 961 and 1152 Hz here; the bounds leave room for the transient.
    assert 930.0 < squeal["f squeal [Hz]"] < 1000.0
    assert squeal["f eigen [Hz]"] == pytest.approx(1152.0, abs=1.0)
    assert 0.5 < squeal["off belt share"] < 0.65


def record(
    path: Path,
    parameters: RigParameters,
    steps: dict[int, str],
    blocks: int,
    with_truth: bool = False,
    settings: RigSettings | None = None,
) -> Path:
    """A bag of the virtual rig's samples, with impacts and resets at given blocks."""
    rig = Acquisition(VirtualRig(), parameters, settings or RigSettings())
    rig.start(10**18)
    with BagWriter(path) as writer:
        description = writer.add_topic("/rig/description", STRING.type_name, schema=STRING)
        daq = writer.add_topic("/daq/samples", CLOUD.type_name, schema=CLOUD)
        truth = writer.add_topic("/truth/samples", CLOUD.type_name, schema=CLOUD) if with_truth else None
        writer.write(description, string_cdr(RigDescription(parameters).to_yaml()), 10**18, 10**18)
        for number in range(blocks):
            if number in steps:
                getattr(rig, steps[number])()
            block = rig.next_block()
            writer.write(daq, cdr_from_samples(block.daq, block.stamp), block.stamp, block.stamp)
            if truth is not None:
                writer.write(truth, cdr_from_samples(block.truth, block.stamp), block.stamp + 1, block.stamp)
    rig.close()
    return path


def test_each_operating_point_has_its_zone(bag: Path):
    analysis = analyse_bag(bag)
    assert [row["zone"] for row in segment_rows(analysis)] == ["bistable", "squeal"]
    # At 300 N the eigenvalues tell it: no hard squeal.
    assert zone_sentences(analysis) == []


@pytest.mark.parametrize(("width", "tables"), [(60, 2), (200, 1)])
def test_a_narrow_terminal_gets_every_number_whole(bag: Path, width: int, tables: int):
    found = analyse_bag(bag)
    analysis = replace(found, segments=found.segments * 3)
    console = PlainConsole(width=width)
    with console.capture() as shown:
        console.print(SegmentTable(analysis))
    text = shown.get()
    assert "\N{HORIZONTAL ELLIPSIS}" not in text
    assert text.count("k_cr [N/m]") == tables
    assert text.count(f"{analysis.segments[0].parameters.belt_speed:.2f}") >= len(analysis.segments)
    assert text.count("Operating points of") == 1


def test_squeal_that_the_eigenvalues_call_stable_is_said_to_be_so(tmp_path: Path):
    # The impact of the default settings, 0.05 N s, is above the smallest hit at 50 N.
    analysis = analyse_bag(record(tmp_path / "bag", PARAMETERS, {50: "impact"}, 160))
    quiet, squeal = list(segment_rows(analysis))
    assert (quiet["rig"], quiet["zone"], squeal["rig"], squeal["zone"]) == ("quiet", "bistable", "squeal", "bistable")
    assert squeal["eigenvalues"] == "stable"
    assert zone_sentences(analysis) == [
        "hard squeal: operating point 2 (zone: bistable) squeals where the eigenvalues call the rig stable"
    ]


@pytest.mark.parametrize(("decay", "rig"), [(0.0, "squeal"), (0.85, "rings down")])
def test_what_rings_down_after_a_hit_is_no_hard_squeal(tmp_path: Path, decay: float, rig: str):
    """0.85 1/s is what c = 20 N s/m makes of free vibration, 7.4 dB/s."""
    analysis = analyse_bag(record(tmp_path / "bag", PARAMETERS, {50: "impact"}, 160))
    squeal = analysis.segments[1]
    squeal.levels = [-20.0 * math.log10(math.e) * decay * 0.1 * n for n in range(10)]
    assert list(segment_rows(analysis))[1]["rig"] == rig
    assert len(zone_sentences(analysis)) == (rig == "squeal")


def test_equal_operating_points_are_asked_for_their_zone_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    asked = []
    monkeypatch.setattr(segments, "zone", lambda p: asked.append(p) or zone(p))
    analysis = analyse_bag(record(tmp_path / "bag", PARAMETERS, {50: "impact", 120: "reset", 170: "impact"}, 240))
    assert len(analysis.segments) >= 3
    assert len(asked) == 1
    assert zone_sentences(analysis)[0].startswith("hard squeal: operating points 2 (zone: bistable), ")
    monkeypatch.setattr(segments, "_MOST_ZONES", 0)
    assert segments._find_zones(analysis.segments) == "it is computed for the first 0 different operating points"


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"damping_x": 0.0, "damping_y": 0.0}, "need damping"),
        ({"friction_direction": "slip"}, "friction_direction = slip"),
    ],
)
def test_a_rig_without_zones_says_why(tmp_path: Path, changes: dict, reason: str):
    analysis = analyse_bag(record(tmp_path / "bag", PARAMETERS.replace(**changes), {}, 60))
    assert {row["zone"] for row in segment_rows(analysis)} == {"not available"}
    (sentence,) = zone_sentences(analysis)
    assert sentence.startswith("zone not available: cycles, zones and hits")
    assert reason in sentence
    draw_run(analysis, tmp_path / "run.png")


def test_the_picture_is_a_png_of_some_substance(bag: Path, tmp_path: Path):
    draw_run(analyse_bag(bag), tmp_path / "run.png")
    data = (tmp_path / "run.png").read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    assert len(data) > 50_000


def test_a_bag_without_samples_is_refused(tmp_path: Path):
    with BagWriter(tmp_path / "empty") as writer:
        writer.write(writer.add_topic("/talk", STRING.type_name, schema=STRING), string_cdr("hello"), 1, 1)
    with pytest.raises(RecordingError, match="not a recording of the rig"):
        analyse_bag(tmp_path / "empty")


def test_importing_the_report_loads_no_matplotlib():
    import subprocess
    import sys

    code = "import sys, squeal_rig.report.run_figure, squeal_rig.cli; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_rig_that_was_started_again_is_no_gap_of_2_to_the_32(tmp_path: Path):
    path = tmp_path / "bag"
    with BagWriter(path) as writer:
        description = writer.add_topic("/rig/description", STRING.type_name, schema=STRING)
        daq = writer.add_topic("/daq/samples", CLOUD.type_name, schema=CLOUD)
        writer.write(description, string_cdr(RigDescription(PARAMETERS).to_yaml()), 10**18, 10**18)
        for run, blocks in enumerate((90, 60)):
            rig = Acquisition(VirtualRig(), PARAMETERS, RigSettings())
            rig.start(10**18 + run * 5 * 10**9)
            for _ in range(blocks):
                block = rig.next_block()
                writer.write(daq, cdr_from_samples(block.daq, block.stamp), block.stamp, block.stamp)
    analysis = analyse_bag(path)
    assert (analysis.restarts, analysis.lost_samples) == (1, 0)
    assert analysis.duration == pytest.approx(1.5)
    times = analysis.course.block_column("t")
    np.testing.assert_allclose(np.diff(times), 0.01, rtol=1e-9)
    # Windows of both parts lie where their blocks do: whole ones of 0.2 s, none across the joint.
    starts = analysis.course.window_column("t_start")
    assert len(starts) >= 5
    assert np.all(np.diff(starts) > 0.19)
    assert starts[-1] > 0.9
    assert np.max(analysis.course.window_column("t_end")) <= 1.5 + 1e-9


@pytest.mark.parametrize("with_truth", [True, False])
def test_a_slow_ring_down_is_no_hard_squeal(tmp_path: Path, with_truth: bool):
    """At c = 5 N s/m free motion falls by 1.9 dB/s only, and is above the level of squeal for seconds."""
    p = RigParameters().replace(damping_x=5.0, damping_y=5.0)
    settings = RigSettings(impact_impulse=0.04, impact_direction=0.0)
    path = record(tmp_path / "bag", p, {30: "impact"}, 300, with_truth, settings)
    loud = [s for s in analyse_bag(path).segments if s.squealing]
    assert loud
    assert all(s.rings_down and not s.hard_squeal for s in loud)


def test_no_spectrum_goes_across_a_gap(bag: Path, tmp_path: Path):
    from squeal_rig.recording import Bag

    source, cut = Bag(bag), tmp_path / "cut"
    with BagWriter(cut) as writer:
        handles = {"/daq/samples": writer.add_topic("/daq/samples", CLOUD.type_name, schema=CLOUD)}
        handles["/rig/description"] = writer.add_topic("/rig/description", STRING.type_name, schema=STRING)
        for number, message in enumerate(source.messages(list(handles))):
            if number != 240:
                writer.write(handles[message.topic], message.data, message.log_time, message.publish_time)
    squeal = analyse_bag(cut).segments[-1]
    assert squeal.squealing
    assert len(squeal.signal) == 260 - 240


def test_squeal_of_an_unstable_rig_that_settles_from_above_does_not_ring_down(bag: Path):
    squeal = analyse_bag(bag).segments[1]
    assert squeal.stability.unstable
    squeal.levels = [20.0 - 0.3 * 0.1 * n for n in range(15)]
    assert not squeal.rings_down
    squeal.levels = [20.0 - 4.0 * 0.1 * n for n in range(15)]
    assert squeal.rings_down
