"""A recorded run analysed offline: written with the real writer from the real virtual rig, without ROS."""

from pathlib import Path

import numpy as np
import pytest

from squeal_rig.analysis.segments import analyse_bag, segment_rows
from squeal_rig.errors import RecordingError
from squeal_rig.instruments.acquisition import Acquisition
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.instruments.virtual import VirtualRig
from squeal_rig.model import RigParameters
from squeal_rig.recording import BagWriter, MessageSchema, cdr_from_samples
from squeal_rig.report.run_figure import draw_run
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
