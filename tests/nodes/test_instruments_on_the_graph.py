"""A rig with data sheets: what its description tells is what its samples do."""

import numpy as np
import pytest

from squeal_rig.instruments.data_sheets import load_data_sheets
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.instruments.tolerances import full_scale_of, noise_of, ripple_of
from tests.graph.processes import parameters

pytest.importorskip("rclpy")


@pytest.mark.slow
def test_the_description_tells_noise_ripple_and_full_scale(compiled, processes, observer):
    blocks = observer.follow_samples("daq/samples")
    rig = processes.node("simulator", *parameters(instruments="typical", damping_x=20.0, damping_y=20.0))
    description = observer.description()
    sheets = load_data_sheets("typical")
    assert description.instruments == "typical"
    assert description.noise == pytest.approx(noise_of(sheets, 51200))
    assert description.ripple == pytest.approx(ripple_of(sheets, description.parameters, RigSettings()))
    assert description.full_scale == full_scale_of(sheets)
    observer.wait_for(lambda: len(blocks) >= 20, "blocks")
    force = np.concatenate([block.samples["arm_left"] for block in list(blocks)[-10:]])
    assert np.std(force) == pytest.approx(description.noise["arm_left"], rel=0.2)
    assert observer.set({"preload": 100.0}) == [(True, "")]
    observer.wait_for(lambda: observer.description().ripple["preload"] == 0.2, "the ripple of the new set point")
    assert rig.end()[0] == 0
