"""`squeal-rig run` on the twin of the hardware: a plan with a change of springs by hand, recorded, ended well."""

import numpy as np
import pytest

from squeal_rig.configuration.files import config_directory
from squeal_rig.recording import Bag, decoder_of, samples_from_cdr
from tests.drivers.conftest import needs_extra, serve_twin

pytest.importorskip("rclpy")

_PLAN = """\
title: two springs
steps:
  - set: {preload: 60.0}
    wait: 1.0
  - spring: stiff
    dwell: 1.0
    wait: 1.0
"""


@pytest.mark.slow
def test_a_plan_fits_springs_by_hand_on_a_rig_that_stands(compiled, processes, tmp_path):
    needs_extra()
    twin = serve_twin(tmp_path)
    try:
        text = (config_directory() / "rig.yaml").read_text()
        config = tmp_path / "rig.yaml"
        config.write_text(
            text.replace("driver: virtual", "driver: opendaq")
            .replace('driver_config: ""', f'driver_config: "{twin.config}"')
            .replace("watchdog_timeout: 1.0", "watchdog_timeout: 20.0")
        )
        (tmp_path / "plan.yaml").write_text(_PLAN)
        child = processes.command(
            "run",
            *("--config", config, "--plan", tmp_path / "plan.yaml", "--bag", tmp_path / "bag"),
            cwd=tmp_path,
        )
        assert child.wait(400.0) == 0, child.errors
    finally:
        twin.kill()
    bag = Bag(tmp_path / "bag")
    blocks = [samples_from_cdr(message.data) for message in bag.messages(["/daq/samples"])]
    preload = np.array([block.samples["preload"][-1] for block in blocks])
    speed = np.array([block.samples["belt_speed"][-1] for block in blocks])
    loaded = np.flatnonzero(preload > 55.0)
    standing = np.flatnonzero((preload < 5.0) & (speed < 0.02))
    between = standing[(standing > loaded[0]) & (standing < loaded[-1])]
    assert len(between) > 0, "the rig stood between the springs"
    decode = decoder_of(bag.topics["/run/events"].schema)
    events = [decode(message.data).status[0] for message in bag.messages(["/run/events"])]
    facts = [{item.key: item.value for item in event.values} for event in events if event.message == "step ended"]
    assert [fact["outcome"] for fact in facts] == ["done", "done"]
    assert facts[1]["answer"] == "fitted by hand, 1 s have passed"
    assert float(facts[1]["stiffness [N/m]"]) == 6e7
    last = decoder_of(bag.topics["/rig/description"].schema)
    described = [last(message.data).data for message in bag.messages(["/rig/description"])][-1]
    assert "k1: 60000000.0" in described
    assert "preload: 60.0" in described
