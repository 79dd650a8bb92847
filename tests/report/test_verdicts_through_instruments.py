"""A short run like the demo's, through ideal and through typical instruments: the same verdicts at every point."""

from pathlib import Path

import pytest

from squeal_rig.analysis.segments import Analysis, analyse_bag, segment_rows
from squeal_rig.instruments.acquisition import Acquisition
from squeal_rig.instruments.data_sheets import load_data_sheets
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.instruments.tolerances import promises
from squeal_rig.instruments.virtual import VirtualRig
from squeal_rig.model import RigParameters
from squeal_rig.recording import BagWriter, MessageSchema, cdr_from_samples
from tests.messages import string_cdr

pytestmark = pytest.mark.long  # 16 s of squeal and quiet, half of it through every instrument

PARAMETERS = RigParameters().replace(damping_x=20.0, damping_y=20.0)
CLOUD = MessageSchema("sensor_msgs/msg/PointCloud2")
STRING = MessageSchema("std_msgs/msg/String", text="string data")
# Block -> what happens at it: quiet, squeal, back to quiet, a hit into hard squeal.
STEPS = {100: "preload", 380: "back", 480: "reset", 620: "impact"}
BLOCKS = 800


def record(path: Path, instruments: str, seed: int = 1) -> Path:
    settings = RigSettings(instruments=instruments, instruments_seed=seed)
    sheets = load_data_sheets(instruments)
    rig = Acquisition(VirtualRig(), PARAMETERS, settings)
    rig.start(10**18)
    with BagWriter(path) as writer:
        description = writer.add_topic("/rig/description", STRING.type_name, schema=STRING)
        daq = writer.add_topic("/daq/samples", CLOUD.type_name, schema=CLOUD)
        truth = writer.add_topic("/truth/samples", CLOUD.type_name, schema=CLOUD)

        def describe(p: RigParameters, stamp: int) -> None:
            told = RigDescription(p, instruments=instruments, **promises(sheets, p, settings))
            writer.write(description, string_cdr(told.to_yaml()), stamp, stamp)

        describe(PARAMETERS, 10**18)
        stamp = 10**18
        for number in range(BLOCKS):
            step = STEPS.get(number)
            if step in ("preload", "back"):
                rig.set_point = PARAMETERS.replace(preload=300.0) if step == "preload" else PARAMETERS
                describe(rig.set_point, stamp + 2)
            elif step:
                getattr(rig, step)()
            block = rig.next_block()
            stamp = block.stamp
            writer.write(daq, cdr_from_samples(block.daq, block.stamp), block.stamp, block.stamp)
            writer.write(truth, cdr_from_samples(block.truth, block.stamp), block.stamp + 1, block.stamp)
    rig.close()
    return path


@pytest.fixture(scope="module")
def analyses(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Analysis]:
    folder = tmp_path_factory.mktemp("verdicts")
    return {name: analyse_bag(record(folder / name, name)) for name in ("ideal", "typical")}


def verdicts(analysis: Analysis) -> list[tuple]:
    rows = segment_rows(analysis)
    return [tuple(row[name] for name in ("F [N]", "V [m/s]", "eigenvalues", "zone", "rig")) for row in rows]


def test_typical_instruments_give_the_same_verdicts_at_every_operating_point(analyses: dict[str, Analysis]):
    ideal, typical = (verdicts(analyses[name]) for name in ("ideal", "typical"))
    assert {row[4] for row in ideal} >= {"quiet", "squeal"}
    assert len({row[0] for row in ideal}) == 2
    assert typical == ideal


def test_friction_of_steady_sliding_is_within_its_stated_confidence(analyses: dict[str, Analysis]):
    rows = list(segment_rows(analyses["typical"]))
    steady = [row for row in rows if row["rig"] == "quiet"]
    assert len(steady) >= 2
    for row in steady:
        assert abs(row["mu ratio"] - row["mu true"]) <= row["± 95 % with sheets"]
        assert row["± 95 % with sheets"] > row["± 95 % scatter"] > 0.0


def test_squeal_has_its_frequency_within_a_line(analyses: dict[str, Analysis]):
    found = [[row["f squeal [Hz]"] for row in segment_rows(a) if row["rig"] == "squeal"] for a in analyses.values()]
    # A line of half a second is 2 Hz; the preload's ripple moves the frequency a little.
    assert found[1] == pytest.approx(found[0], abs=4.0)
